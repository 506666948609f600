"""Build the distribution, install it in clean environments, and check that it works there.

    built(folder) ──> wheel, sdist ──> Environment(folder, python).install(wheel, "shell") ──> faults(environment, ...)

Run as a program (scripts/package-check) it does so for every Python there is and each extra alone.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import urllib.request
import zipfile
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
VERSION: str = PROJECT["version"]
EXTRAS = tuple(name for name in PROJECT["optional-dependencies"] if name not in ("dev", "bench", "all", "notebook"))
ALL = tuple(re.findall(r"\w+", PROJECT["optional-dependencies"]["all"][0].partition("[")[2]))
"""The extras in the extra `all`: those for users, without those for developers."""
PYTHONS = ("3.11", "3.12", "3.13")
USER_SCRIPT = Path(__file__).parent / "user_script.py"
_TIMEOUT_S = 300


class Check(NamedTuple):
    """A command, a pattern of its output, and the extra that it needs; without it, an error names the extra.

    `is_hinted` is False for commands whose error does not name the extra; they are not checked without it.
    """

    words: tuple[str, ...]
    prints: str
    extra: str = ""
    is_hinted: bool = True


LOCALIZE = ("nomad", "localize", "sim:thesis_room?noisy=1&seed=3", "--map", "thesis_room", "--waypoints", "0,0", "10,0")
EXPERIMENT = ("python", "-m", "localization.experiments", "5.2", "--seeds", "1")
MACHINE_CODE = (
    "from nserver_emu.simulation.visibility import NEAREST_OBSTACLE; print('loaded', NEAREST_OBSTACLE.load())"
)
WRITE_MCAP = (
    "import sys; from pathlib import Path; from nclient.cli.main import main; "
    "from nclient.recording.convert import write_drive; from nclient.recording.drive import Drive, Sample; "
    "write_drive(Drive([Sample(0.0)]), Path('drive.csv')); "
    "code = main(['convert', 'drive.csv', 'drive.mcap']); print('written'); sys.exit(code)"
)
ROS_TYPE = (
    "from nserver_emu.ros.dds import RosTypes; "
    "print(RosTypes('jazzy').dds_type('nav_msgs/msg/Odometry').__idl_typename__.replace('.', '::'))"
)
MAKE_ENVIRONMENT = (
    "import gymnasium, nserver_emu.gym; "
    "print('made', type(gymnasium.make('Nomad/GoTo-v0').unwrapped).__name__)"
)
CHECKS = (
    Check(("nomad", "--version"), rf"nomad {VERSION}\n"),
    Check(("nserver", "--version"), rf"nserver {VERSION}\n"),
    Check(("nomad", "--help"), "localize .*shell .*state .*wire "),
    Check(("nserver", "--list-worlds"), "thesis_room"),
    Check(("nomad", "shell", "sim:thesis_room?setup=worn", "--command", "pr 240 0 0; wait"), r"x 24\.\d in"),
    Check(("nomad", "doctor", "sim:thesis_room", "--exchanges", "3"), "OK"),
    Check(("nomad", "wire", "encode", "gs"), "000f0000"),
    Check(("nomad", "wire", "dissector"), "tcp_proto:register_heuristic"),
    Check(("python", "-c", WRITE_MCAP), "written", "ros"),
    Check(LOCALIZE, "2 of 2 waypoints reached"),
    Check(("python", str(USER_SCRIPT)), "nearest .*turned 90 deg"),
    Check(("nomad", "completion", "bash"), "_nomad_whole_words nomad.*_nserver_whole_words nserver", "shell"),
    Check(("python", "-c", "from nclient.cli.shell_prompt import PromptReader; print('reads')"), "reads", "shell",
          is_hinted=False),
    Check((*LOCALIZE, "--picture", "run.png"), "2 of 2 waypoints reached", "plot"),
    Check((*EXPERIMENT, "--jobs", "1"), "5.2", "plot"),
    Check((*EXPERIMENT, "--no-pictures", "--cluster", "127.0.0.1:1"), "no Dask scheduler answers", "cluster"),
    Check(("nomad", "map", "export", "flat", "--out", "flat.yaml"), "254 x 194 cells", "maps"),
    Check(("nserver", "thesis_room", "--port", "0", "--viewer", "0"), "listening viewer", "viewer"),
    Check(("python", "-c", ROS_TYPE), "nav_msgs::msg::dds_::Odometry_", "ros2", is_hinted=False),
    Check(("python", "-c", MAKE_ENVIRONMENT), "made RobotEnv", "gym", is_hinted=False),
    Check(("python", "-c", MACHINE_CODE), "loaded True", "fast", is_hinted=False),
    Check(("python", "-c", MACHINE_CODE), "loaded"),
    Check(("python", "-c", "import furo, myst_parser, sphinx; print('builds')"), "builds", "docs", is_hinted=False),
)  # fmt: skip
"""The checks made in every environment. A check without an extra must pass in all of them."""


class Environment:
    """A separate Python environment, without the packages of this one."""

    def __init__(self, folder: Path, python: str = sys.executable) -> None:
        self.folder = folder
        subprocess.run([python, "-m", "venv", "--without-pip", folder], check=True, capture_output=True)

    @property
    def python(self) -> Path:
        """Return its interpreter."""
        return self.folder / "bin" / "python"

    def install(self, file: Path, extra: str = "") -> None:
        """Install a wheel or an sdist with an extra, using the pip of this environment."""
        self._pip("install", "--quiet", "--no-compile", f"{file}[{extra}]" if extra else str(file))

    def install_with_links(self, wheel: Path) -> None:
        """Install a wheel, with links to the packages of this Python that it requires: quicker than their 300 MB.

        `pip check` confirms that no requirement of any of them is missing.
        """
        self._pip("install", "--quiet", "--no-compile", "--no-deps", str(wheel))
        (packages,) = self.folder.glob("lib/python*/site-packages")
        waiting, linked = list(metadata.distributions(path=[str(packages)])), set[str]()
        while waiting:
            for distribution in required_by(waiting.pop()):
                if distribution.name in linked:
                    continue
                linked.add(distribution.name)
                waiting.append(distribution)
                # Top folders and modules of the package, without scripts and caches.
                for name in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
                    (packages / name).symlink_to(str(distribution.locate_file(name)))
        self._pip("check")

    def _pip(self, *words: str) -> None:
        pip = [sys.executable, "-m", "pip", "--python", str(self.python), "--disable-pip-version-check", *words]
        done = subprocess.run(pip, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    def run(self, words: Iterable[str]) -> subprocess.CompletedProcess[str]:
        """Run a command of this environment in a folder without project files."""
        program, *rest = words
        command = [str(self.folder / "bin" / program), *rest]
        try:
            return subprocess.run(
                command, cwd=self.folder, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired as error:
            return subprocess.CompletedProcess(command, 124, str(error.stdout), str(error.stderr))


def required_by(distribution: metadata.Distribution) -> Iterator[metadata.Distribution]:
    """Yield the installed distributions that this one requires on this machine, without extras."""
    for requirement in map(Requirement, distribution.requires or ()):
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield metadata.distribution(requirement.name)


def tracked_files() -> set[str]:
    """Return the files that git tracks, or would track once added; empty without git."""
    if not (ROOT / ".git").exists():
        return set()
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, capture_output=True, check=True)
    names = map(os.fsdecode, done.stdout.split(b"\0"))
    return {name for name in names if name and (ROOT / name).is_file()}


def build_distribution(folder: Path) -> tuple[Path, Path]:
    """Build sdist and wheel, the wheel from the sdist, as a distributor does.

    The source is a fresh copy of the tracked files: setuptools adds the files of an earlier sdist to the next.
    """
    tree = ROOT
    for name in tracked_files():
        # Only tracked files: a build must not depend on leftovers of the working tree.
        tree = folder / "tree"
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tree / name)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(tree)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


def find_missing_files(wheel: Path) -> set[str]:
    """Return files of the packages that are not in the wheel: code, worlds, the viewer page, py.typed."""
    kinds = {".py", ".toml", ".typed", ".js", ".css", ".html", ".lua"}
    packages = ("nclient", "nserver_emu", "localization", "worlds")
    files = (path for package in packages for path in (ROOT / package).rglob("*"))
    wanted = {path.relative_to(ROOT).as_posix() for path in files if path.suffix in kinds}
    wanted |= {f"{package}/py.typed" for package in packages}
    with zipfile.ZipFile(wheel) as archive:
        return wanted - set(archive.namelist())


def find_failures(environment: Environment, extras: Iterable[str], checks: Iterable[Check] = CHECKS) -> Iterator[str]:
    """Yield the failed checks in an environment with these extras."""
    installed = frozenset(extras)
    for check in checks:
        if check.extra and check.extra not in installed:
            yield from _check_missing_extra(environment, check) if check.is_hinted else ()
        elif "--viewer" in check.words:
            yield from _check_page(environment, check)
        else:
            done = environment.run(check.words)
            output = done.stdout + done.stderr
            # A traceback is a failure even if the output is right.
            if not re.search(check.prints, output, re.DOTALL) or "Traceback" in output:
                yield f"{' '.join(check.words)}: {check.prints!r} is not in: {output}"


def _check_missing_extra(environment: Environment, check: Check) -> Iterator[str]:
    """Check that the command fails with an error that names the missing extra."""
    done = environment.run(check.words)
    # The error must name the command that installs the extra.
    clear = f"install -e '.[{check.extra}]'" in done.stderr and "Traceback" not in done.stderr
    if not clear or done.returncode != 2:
        yield f"{' '.join(check.words)}: the extra {check.extra} is not named: {done.returncode} {done.stderr}"


def _check_page(environment: Environment, check: Check) -> Iterator[str]:
    """Request the viewer page and one of its files, which the wheel must contain."""
    program, *rest = check.words
    command = [str(environment.folder / "bin" / program), *rest]
    with subprocess.Popen(command, cwd=environment.folder, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        try:
            lines = [daemon.stdout.readline() for _ in range(2)]
            address = re.search(r"(http://[^/\s]+)(/\?token=\S+)", "".join(lines))
            if address is None:
                yield f"no page: {lines}"
                return
            # The page itself, and a file that only the wheel's data can provide.
            for name in (address[2], "/page/main.js"):
                with urllib.request.urlopen(address[1] + name, timeout=30) as page:
                    if not page.read():
                        yield f"{name} is empty"
        finally:
            daemon.terminate()


def find_type_errors(environment: Environment, version: str) -> Iterator[str]:
    """Yield the errors of mypy --strict for a user's script in an environment."""
    # Outside of this tree: next to the package `tests`, mypy would find the sources instead of the installed wheel.
    script = environment.folder / USER_SCRIPT.name
    script.write_bytes(USER_SCRIPT.read_bytes())
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--python-version", version,
               "--cache-dir", str(ROOT / ".mypy_cache" / "installed"),
               "--python-executable", str(environment.python), str(script)]  # fmt: skip
    done = subprocess.run(command, cwd=environment.folder, capture_output=True, text=True, check=False)
    if done.returncode:
        yield done.stdout + done.stderr


def interpreters() -> dict[str, str]:
    """Return the available Python versions of PYTHONS: this one, in PATH, or of pyenv."""
    found = {}
    for version in PYTHONS:
        homes = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
        candidates = (sys.executable, shutil.which(f"python{version}"), *map(str, homes))
        path = next((path for path in candidates if path and _is(path, version)), None)
        if path is not None:
            found[version] = path
    return found


def _is(path: str, version: str) -> bool:
    # venv is missing in some distributions of Python, which cannot make environments then.
    asked = [path, "-c", "import sys, venv; print('%d.%d' % sys.version_info[:2])"]
    return subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() == version


def main() -> int:
    """Check all environments. Return the number of those with failures."""
    parser = argparse.ArgumentParser(description="Build, install and try the distribution in clean environments.")
    parser.add_argument("--python", action="append", choices=PYTHONS, help="versions to try (default: all there are)")
    parser.add_argument("--extra", action="append", choices=("none", *EXTRAS, "all"),
                        help="extras to try, each alone; none: without (default: every one)")
    options = parser.parse_args()
    failures = 0
    with tempfile.TemporaryDirectory() as folder:
        wheel, sdist = build_distribution(Path(folder))
        lacking = find_missing_files(wheel)
        print(f"{wheel.name} ({wheel.stat().st_size} bytes), {sdist.name}; missing: {', '.join(lacking) or 'nothing'}")
        failures += bool(lacking)
        installed = interpreters()
        for version in options.python or PYTHONS:
            if version not in installed:
                print(f"{version:6} is not installed on this machine")
                continue
            for extra in options.extra or ("none", *EXTRAS, "all"):
                # One environment at a time: each takes hundreds of megabytes.
                name = "" if extra == "none" else extra
                failures += _check_environment(Path(folder), wheel, version, installed[version], name)
        failures += _check_environment(Path(folder), sdist, "sdist", sys.executable, "")
    return failures


def _check_environment(folder: Path, file: Path, version: str, python: str, extra: str) -> bool:
    """Check one temporary environment. Return True if a check failed."""
    environment = Environment(folder / "environment", python)
    try:
        environment.install(file, extra)
        installed = ALL if extra == "all" else (extra,)
        output = list(find_failures(environment, installed))
        if not extra and version in PYTHONS:
            output += find_type_errors(environment, version)
    finally:
        shutil.rmtree(environment.folder)
    verdict = "FAILED" if output else "passed"
    print(f"{version:6} {extra or 'no extra':10} {verdict}", *output, sep="\n  ", flush=True)
    return bool(output)


if __name__ == "__main__":
    sys.exit(main())
