"""`nomad shell` on a pseudo-terminal: keys, Tab, Ctrl-C, Ctrl-D, a closed window."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from nclient import connect
from tests.integration.shell.at_terminal import Terminal

NOMAD = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())"]
WITHOUT_PROMPT_TOOLKIT = [sys.executable, "-c", (
    "import sys; import importlib.util as find; real = find.find_spec\n"
    "find.find_spec = lambda name, package=None: None if name == 'prompt_toolkit' else real(name, package)\n"
    "from nclient.cli.main import main; sys.exit(main())"
)]
CTRL_C, CTRL_D, TAB, UP = "\x03", "\x04", "\t", "\x1b[A"


@contextmanager
def shell(address: str, folder: Path, program: list[str] | None = None) -> Iterator[Terminal]:
    with Terminal([*(program or NOMAD), "shell", address], {"XDG_STATE_HOME": str(folder)}, folder) as terminal:
        yield terminal


@pytest.fixture
def daemon() -> Iterator[str]:
    """Run a server in real time and yield the address of its robot."""
    command = [sys.executable, "-m", "nserver_emu", "thesis_room", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        where = program.stdout.readline().split()[-1]
        try:
            yield f"nserver://{where}/1"
        finally:
            program.terminate()
    assert program.returncode == 0


@pytest.mark.parametrize("program", [NOMAD, WITHOUT_PROMPT_TOOLKIT], ids=["prompt_toolkit", "readline"])
def test_shell_executes_completes_and_saves_history(program: list[str], tmp_path: Path) -> None:
    with shell("sim:thesis_room", tmp_path, program) as terminal:
        terminal.see("help lists all commands.*n150>")
        terminal.type("pr 240 0 0; wait\r")
        terminal.see(r"x 24\.0 in  y 0\.0 in .* standing")
        terminal.see("n150>")
        terminal.type("disc" + TAB)
        terminal.see("disconnect_robot")
        terminal.type("\x15")  # Ctrl-U: the line is empty again
        terminal.type("prr 1\r")
        terminal.see("no command 'prr'; did you mean pr.*n150>")
        # Two commands back: the misspelt one, then the drive.
        terminal.type(UP + UP + "\r")
        terminal.see(r"x 48\.0 in.*standing.*n150>")
        terminal.type(CTRL_D)
        assert terminal.leave() == 0
    history = tmp_path / "nomad" / "history"
    assert "pr 240 0 0; wait" in history.read_text()
    # Only the user may read the history.
    assert history.stat().st_mode & 0o077 == 0


def test_completion_menu_and_status_line(tmp_path: Path) -> None:
    with shell("sim:thesis_room", tmp_path) as terminal:
        terminal.see(r"n150>.*x 0\.0 in  y 0\.0 in .*standing")
        terminal.type("pr 1")
        terminal.see("pr translation steering turret")
        terminal.type("\x15get_s" + TAB)
        terminal.see("ask for the sonars")
        terminal.type("\x15quit\r")
        assert terminal.leave() == 0


def test_ctrl_c_stops_robot_and_shell_continues(daemon: str, tmp_path: Path) -> None:
    with shell(daemon, tmp_path) as terminal, connect(daemon + "?tm_s=0") as watcher:
        terminal.see("n150>")
        terminal.type("vm 50 0 0\r")
        terminal.see("moving: translation.*n150>")
        terminal.type(CTRL_C)  # at the prompt
        terminal.see("stopped: .*n150>")
        assert not _rolls(watcher.refresh().translation_in_s)
        terminal.type("vm 50 0 0; wait 60\r")
        terminal.see("moving: translation")
        # The command waits for the robot when Ctrl-C is pressed.
        time.sleep(0.5)
        terminal.type(CTRL_C)  # while a command runs
        terminal.see("stopped: .*n150>")
        terminal.type("get_rv\r")
        terminal.see(r"translation 0\.0 in/s")
        terminal.type("quit\r")
        assert terminal.leave() == 0


def _rolls(speed_in_s: float) -> bool:
    return abs(speed_in_s) > 0.05


@pytest.mark.parametrize("ending", ["closed window", "quit"])
def test_exit_stops_the_robot(ending: str, daemon: str, tmp_path: Path) -> None:
    with connect(daemon + "?tm_s=0") as watcher:
        output = tmp_path / "output"
        with shell(f"{daemon}?record={output}", tmp_path) as terminal:
            terminal.see("n150>")
            terminal.type("vm 50 0 0\r")
            terminal.see("moving: translation.*n150>")
            assert _rolls(watcher.refresh().translation_in_s)
            if ending == "quit":
                terminal.type("quit\r")
                assert terminal.leave() == 0
        # Sooner than the robot's own time-out of 5 s.
        deadline_s = time.monotonic() + 2
        while _rolls(watcher.refresh().translation_in_s):
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
    # The shell itself has stopped the robot before it disconnected.
    calls = re.findall(r'"call": ?"(\w+)"', output.read_text())
    assert calls[-2:] == ["st", "disconnect_robot"]
