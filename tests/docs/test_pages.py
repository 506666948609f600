"""Every command and program of the guide's pages, as a reader would run them: real processes, real sockets, real time.

The port 7019 and the cable /dev/ttyUSB0 are replaced by a free port and by an emulated robot's line. Blocks marked
`console` are for other machines and are not run. `scripts/run` is the README's to test.
"""

from __future__ import annotations

import contextlib
import os
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from forked import Forked

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LEFT_OUT = ("scripts/run", ". .venv/bin/activate")


def blocks(page: str, kind: str) -> list[str]:
    """Blocks of a kind, those in lists with their indentation taken away."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = re.findall(rf"^( *)```{kind}\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    return [re.sub(rf"^{indent}", "", block, flags=re.MULTILINE) for indent, block in found]


def commands(page: str) -> list[str]:
    lines = [line for block in blocks(page, "sh") for line in block.splitlines() if line]
    assert lines
    return [line for line in lines if line not in LEFT_OUT]


def run(command: str, folder: Path) -> str:
    """What a command prints; it must succeed."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    bash, environment = ["bash", "-c", command], os.environ | {"PATH": path}
    done = subprocess.run(bash, cwd=folder, env=environment, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@contextlib.contextmanager
def daemon(command: str, *more: str) -> Iterator[str]:
    """The page's daemon on a free port; the port."""
    words = [*shlex.split(command)[1:], "--port", "0", *more]
    with Forked("nserver", *words) as program:
        try:
            port = program.stdout.readline().strip().rpartition(":")[2]
            for _ in range(words.count("--serial-link")):
                assert program.stdout.readline().startswith("listening serial")
            yield port
        finally:
            program.send_signal(signal.SIGTERM)
    assert program.returncode == 0


def test_five_minutes(tmp_path: Path) -> None:
    shell, start, *others = commands("start.md")
    assert "x 24.0 in" in run(shell, tmp_path)
    assert start.startswith("nserver ")
    with daemon(start) as port:
        state, localize = [run(command.replace("7019", port), tmp_path) for command in others]
    assert "sonar" in state
    assert "2 of 2 way-points reached" in localize


def test_the_program_of_five_minutes(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = blocks("start.md", "python")
    exec(compile(program, "start.md", "exec"), {})
    found = re.fullmatch(r"(\d+) in before the wall, (\d+) in from the start\n", capsys.readouterr().out)
    assert found is not None
    assert 10 <= int(found[1]) <= 21
    assert int(found[2]) > 10


def test_a_real_robot(tmp_path: Path) -> None:
    ports, *others = commands("real-robot.md")
    run(ports, tmp_path)
    link = tmp_path / "line"
    with daemon("nserver thesis_room --setup measured", "--serial-link", str(link)):
        said = [run(command.replace("/dev/ttyUSB0", str(link)), tmp_path) for command in others]
    doctor, stop, shell, localize = said
    assert "FAIL" not in doctor
    assert stop.startswith("stands still")
    assert re.search(r"x (5\.9|6\.\d) in", shell)
    assert "2 of 2 way-points reached" in localize


def test_faults_and_recordings(tmp_path: Path) -> None:
    (tmp_path / "docs").symlink_to(DOCS)
    doctor, stop, recorded, dumped, replayed = [run(command, tmp_path) for command in commands("faults.md")]
    assert re.search(r"^\w+ +line ", doctor, re.MULTILINE)
    assert stop.startswith("stands still")
    assert "gs" in dumped
    assert "pose" in recorded
    assert replayed == recorded


def sonars(said: str) -> list[float]:
    """The sixteen of a line that `nomad state` or the shell prints; inf where nothing was heard."""
    (line,) = re.findall(r"^sonar +(.*?) in,", said, re.MULTILINE)
    return [float(reading.replace("-", "inf")) for reading in line.split()]


def test_sensors_and_noise(tmp_path: Path) -> None:
    everything, ideal, measured, at_4_ms, at_60_ms, laser = [run(line, tmp_path) for line in commands("sensors.md")]
    for part in ("infrared", "bumpers", "compass", "battery", "clock"):
        assert re.search(rf"^{part} ", everything, re.MULTILINE)
    assert max(sonars(ideal)) < 255
    heard = [number for number, reading in enumerate(sonars(measured)) if reading < 255]
    assert {0, 4, 8, 12} <= set(heard) <= {0, 2, 4, 6, 8, 10, 12, 14}
    assert sonars(at_4_ms)[:2] == [12, 12]
    assert all(91 <= reading <= 96 for reading in sonars(at_60_ms)[:2])
    assert re.search(r"laser +2 readings, in: \([^,)]+(, [^,)]+){3}\)", laser)


def test_the_program_of_the_sensors_page_repeats(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = blocks("sensors.md", "python")
    exec(compile(program, "sensors.md", "exec"), {})
    first, again, other = [line.partition(": ")[2] for line in capsys.readouterr().out.splitlines()]
    assert first == again != other
    assert all(line.startswith("encoders 60.0 in, true ") for line in (first, other))


def test_localization_explained(tmp_path: Path) -> None:
    said = [run(line, tmp_path) for line in commands("localization.md")]
    rays, cones, too_sure, figures, found, worn = said
    assert all("2 of 2 way-points reached" in told for told in (rays, cones, too_sure, worn))
    assert "1 of 1 way-points reached" in found
    assert "DEGRADED: innovations are" in too_sure
    assert "DEGRADED" not in rays
    assert [float(nees) < 5.5 for nees in re.findall(r"NEES, mean +([\d.]+)", figures)] == [True, True]


@pytest.mark.parametrize("said", re.findall(r"^\| `([^`|]+)` \|", (DOCS / "real-robot.md").read_text().partition(
    "## Serial first aid")[2].partition("## Which system")[0], re.MULTILINE))  # fmt: skip
def test_first_aid_quotes_what_is_said(said: str) -> None:
    generic = said.replace("/dev/ttyUSB0", "{port}").replace("within 1 s", "within {")
    places = [*(ROOT / "nclient").rglob("*.py")]
    plain = generic.replace("a n150", "a {")
    assert any(plain in place.read_text(encoding="utf-8") for place in places), generic


def test_a_c_program(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "clib", tmp_path / "clib", ignore=shutil.ignore_patterns("build"))
    (program,) = blocks("c-programs.md", "c")
    (tmp_path / "hello.c").write_text(program)
    make, compiled, started = commands("c-programs.md")
    run(make, tmp_path)
    run(compiled, tmp_path)
    (start,) = re.findall(r"^With `(nserver [^`]+)` running:$", (DOCS / "c-programs.md").read_text(), re.MULTILINE)
    with daemon(start) as port:
        assert run(started.replace("7019", port), tmp_path) == "at 240, 0 tenths of an inch\n"


def test_the_floors_are_those_of_the_contracts() -> None:
    made = runpy.run_path(str(DOCS / "floors.py"))
    assert made["page"]() == (DOCS / "architecture.md").read_text(), "run python docs/floors.py"
    assert made["floors"]().count("\n") > 15


def test_the_citation_is_of_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {project['version']}\n" in citation
    assert f"\nlicense: {project['license']}\n" in citation
    for key in ("cff-version", "message", "title", "authors"):  # what the format asks for
        assert re.search(rf"^{key}:", citation, re.MULTILINE)
