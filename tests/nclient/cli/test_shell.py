"""`nomad shell`: scripts, lines from a pipe, and a conversation, with what each ends with."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient.backends.nserver import NserverBackend
from nclient.cli import main, shell
from nclient.cli.shell import MAX_BYTES, StatusPoller
from nclient.cli.shell_session import Session
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_server import ScriptedServer

SIM = "sim:thesis_room"


@pytest.fixture(autouse=True)
def _at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    # stdin is a terminal here: otherwise the command would read its lines from it.
    stdin = io.StringIO()
    monkeypatch.setattr(stdin, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stdin", stdin)


def script(folder: Path, text: str) -> str:
    path = folder / "drive.nomad"
    path.write_text(text)
    return str(path)


def test_a_script_is_done_line_by_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = script(tmp_path, "# one side\nsp 200 450 450\npr 240 0 0; wait\n\nsleep 1  # rest\nstate pose\n")
    assert main.main(["shell", SIM, "--script", file]) == 0
    reported = capsys.readouterr()
    assert reported.err == ""
    assert reported.out.splitlines()[-1] == "pose        x 24.0 in  y 0.0 in  steering 0.0 deg  turret 0.0 deg"


# How many lines of output precede the error: a syntax error is found before anything is executed, a refusal is not.
@pytest.mark.parametrize(("text", "reported", "shown"), [
    ("pr 240 0 0\npr 1\n", ":2: pr takes 3 numbers, not 1: pr translation steering turret", 0),
    ("pr 240 0 0\npr (\n", ":2: pr: a call is pr(1, 2, 3), one pair of parentheses", 0),
    ("pr 240 0 0\nhlep\n", ":2: no command 'hlep'; did you mean help?; help lists them all", 0),
    ("gs\nquit_server\ngs\n", ":2: quit_server was refused: not allowed by the setup or a limit, or another client "
     "drives the robot (error 5)", 1),
    ("gs\ngs\nvm 50 0 0; wait 1\ngs", ":3: wait: after 1 s the robot is moving: translation 5.0 in/s", 3),
])
def test_script_ends_at_the_first_failing_line(
    text: str, reported: str, shown: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = script(tmp_path, text)
    assert main.main(["shell", SIM, "--script", file]) == 1
    printed = capsys.readouterr()
    assert printed.err == f"nomad: {file}{reported}\n"
    assert len(printed.out.splitlines()) == shown


def test_a_script_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["shell", SIM, "--script", str(tmp_path / "none")]) == 1
    assert "none: cannot be read: No such file or directory" in capsys.readouterr().err
    (tmp_path / "bytes").write_bytes(b"gs\n\xff")
    assert main.main(["shell", SIM, "--script", str(tmp_path / "bytes")]) == 1
    assert "bytes: expected text in UTF-8, found other bytes at 3: invalid start byte" in capsys.readouterr().err
    (tmp_path / "long").write_bytes(b"#" * (MAX_BYTES + 1))
    assert main.main(["shell", SIM, "--script", str(tmp_path / "long")]) == 1
    assert f"long: is longer than {MAX_BYTES} bytes" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--script", "-"], []])
def test_lines_of_a_pipe_are_done_as_they_come(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("State[34]\nquit\nState[35]\n"))
    assert main.main(["shell", SIM, *words]) == 0
    assert capsys.readouterr().out == "State[34] = 0\n"
    monkeypatch.setattr(sys, "stdin", io.StringIO("State[34]\nzzz\n"))
    assert main.main(["shell", SIM, *words]) == 1
    printed = capsys.readouterr()
    assert printed.out == "State[34] = 0\n"
    assert printed.err.startswith("nomad: stdin:2: no command 'zzz'")


def test_one_line_and_the_address_of_the_environment(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", SIM + "?start=10,5,0,0")
    assert main.main(["shell", "-c", "sim_truth"]) == 0
    assert "ground truth x 10.000 in  y 5.000 in" in capsys.readouterr().out
    assert main.main(["shell", "-c", "zzz"]) == 1
    assert "nomad: --command:1: no command 'zzz'" in capsys.readouterr().err


def test_ctrl_c_ends_a_script_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Session, "run", interrupt)
    assert main.main(["shell", SIM, "-c", "gs"]) == 130


class Typed:
    """Keys: a line each, an exception for Ctrl-C, and Ctrl-D at the end."""

    def __init__(self, *lines: str | type[BaseException]) -> None:
        self._lines: Iterator[str | type[BaseException]] = iter(lines)
        self.closed = False

    def read(self, prompt: str) -> str:
        assert prompt == "n150> "
        line = next(self._lines, EOFError)
        if isinstance(line, str):
            return line
        raise line

    def close(self) -> None:
        self.closed = True


def converse(server: ScriptedServer, *lines: str | type[BaseException]) -> int:
    session = Session(NserverBackend(MemoryStream(server)), lambda _: None)
    with session.robot:
        return shell.converse(session, Typed(*lines), StatusPoller(session, 0))


def test_session_continues_after_errors_and_stops_at_exit(capsys: pytest.CaptureFixture[str]) -> None:
    server = ScriptedServer()
    assert converse(server, "prr", "gs", "") == 0
    printed = capsys.readouterr()
    assert "no command 'prr'" in printed.err
    assert "help lists all commands; Ctrl-C stops the robot, Ctrl-D exits" in printed.out
    # One gs for the line; st and disconnect_robot when the session ends.
    assert server.names() == ["gs", "st", "disconnect_robot"]


def test_quit_leaves_what_comes_after() -> None:
    server = ScriptedServer()
    assert converse(server, "quit", "gs") == 0
    assert server.names() == ["st", "disconnect_robot"]


def test_ctrl_c_at_the_prompt_stops_a_moving_robot(capsys: pytest.CaptureFixture[str]) -> None:
    server = ScriptedServer()
    assert converse(server, KeyboardInterrupt) == 0
    # A robot at rest gets no st by Ctrl-C: the one here is that of the end.
    assert server.names() == ["gs", "st", "disconnect_robot"]
    server = ScriptedServer()
    # Motor bit 0: it moves. One st by Ctrl-C, one at the end.
    server.slots[41] = 1
    assert converse(server, KeyboardInterrupt) == 0
    assert server.names() == ["gs", "st", "st", "disconnect_robot"]
    assert "stopped: x 0.0 in" in capsys.readouterr().out


def test_ctrl_c_while_a_command_runs_does_so_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    # The same as at the prompt, but raised within a command.
    server = ScriptedServer()
    server.slots[41] = 1
    monkeypatch.setattr(Session, "run", interrupt)
    assert converse(server, "wait") == 0
    assert server.names() == ["gs", "st", "st", "disconnect_robot"]


def test_a_lost_robot_ends_it_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    # An empty reply: the connection has ended.
    server = ScriptedServer({"gs": b""})
    assert converse(server, KeyboardInterrupt, "gs") == 1
    assert "nomad: gs" in capsys.readouterr().err


def test_keys_are_read_where_there_is_a_terminal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    keys = Typed("gs")
    monkeypatch.setattr(shell, "open_reader", lambda *_: keys)
    assert main.main(["shell", SIM, "--history", str(tmp_path / "history")]) == 0
    assert keys.closed
