"""Entry points of the commands: Ctrl-C during an import, in the command itself, and where it is ignored."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

import nomad_start
from nclient.common.exit_codes import ExitCode

ROOT = Path(__file__).parents[1]
INTERRUPT = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"
SWALLOW = f"try:\n    {INTERRUPT.replace(chr(10), chr(10) + '    ')}\nexcept BaseException:\n    pass\n"
COMMANDS = {"nomad": "nclient.cli.main", "nserver": "nserver_emu.cli"}


@pytest.fixture(autouse=True)
def _default_sigint() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def begun(command: str, folder: Path, package: str, cli: str) -> subprocess.CompletedProcess[str]:
    """Run the command as a process with its package replaced by the given sources."""
    main = folder.joinpath(*COMMANDS[command].split("."))
    main.parent.mkdir(parents=True)
    for init in {main.parent, folder / main.relative_to(folder).parts[0]}:
        (init / "__init__.py").write_text("")
    (folder / main.relative_to(folder).parts[0] / "__init__.py").write_text(package)
    main.with_suffix(".py").write_text(cli)
    program = f"import sys; sys.path.insert(0, {str(folder)!r}); import nomad_start; sys.exit(nomad_start.{command}())"
    paths = os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))
    plain = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    return subprocess.run(
        [sys.executable, "-c", program], env=plain | {"PYTHONPATH": paths},
        capture_output=True, text=True, timeout=50, check=False,
    )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("package", "cli"), [(INTERRUPT, ""), ("", INTERRUPT), (SWALLOW, "def main(): return 0")])
def test_ctrl_c_while_it_imports_says_nothing(command: str, package: str, cli: str, tmp_path: Path) -> None:
    done = begun(command, tmp_path, package, cli)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.long
def test_ctrl_c_in_the_command_is_the_commands(tmp_path: Path) -> None:
    handler = "    except KeyboardInterrupt:\n        print('left in order')\n        return 7\n"
    lines = "\n".join(f"        {line}" for line in INTERRUPT.splitlines())
    done = begun("nomad", tmp_path, "", f"def main():\n    try:\n{lines}\n{handler}")
    assert (done.returncode, done.stdout, done.stderr) == (7, "left in order\n", "")


@pytest.mark.parametrize("command", COMMANDS)
def test_it_runs_the_command_with_its_exit_code(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    handlers: list[object] = []

    def main() -> int:
        handlers.append(signal.getsignal(signal.SIGINT))
        return 3

    monkeypatch.setitem(sys.modules, COMMANDS[command], SimpleNamespace(main=main))
    assert getattr(nomad_start, command)() == 3
    assert handlers == [signal.default_int_handler]


def test_an_uncaught_ctrl_c_ends_with_130() -> None:
    def main() -> int:
        raise KeyboardInterrupt

    assert nomad_start._begin(lambda: main) == ExitCode.INTERRUPTED.value


def test_an_import_is_left_there_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(code: int) -> None:
        raise SystemExit(code)

    def imported() -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(os, "_exit", leave)
    with pytest.raises(SystemExit, match="130"):
        nomad_start._begin(imported)  # type: ignore[arg-type]


def test_what_is_ignored_from_the_start_stays_so() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def main() -> int:
        signal.raise_signal(signal.SIGINT)
        return 5

    assert nomad_start._begin(lambda: main) == 5
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_the_commands_are_begun_here() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts == {command: f"nomad_start:{command}" for command in COMMANDS}
    assert all(callable(getattr(nomad_start, command)) for command in scripts)
