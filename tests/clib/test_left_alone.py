"""A robot on its cable whose C program is gone, or stands still, comes to rest; and what connecting says for that.

The line's other end stays open, as a cable's does, so that the robot's own time-out alone stops it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from answering import ScriptedServer, by_script, on_socket
from building import PROGRAMS, SANITIZED, Workshop, daemon, held
from robot_line import ScriptedLine
from scripted_lines import on_line

from nclient import connect
from nclient.protocol.commands import Call
from nclient.robot import Robot

PATIENCE_S = 30.0


def until(true: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def moves(eye: Robot) -> bool:
    """By the truth, over a tenth of a second; whoever watches feeds no motion that another drives."""
    before = eye.truth()
    until(lambda: eye.truth().time_s > before.time_s + 0.1)
    return eye.truth().x_in != before.x_in


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "asleep"])
def test_a_robot_whose_c_program_says_nothing_more_comes_to_rest(
    workshop: Workshop, end: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, link = workshop.program(PROGRAMS / "drives_on.c", SANITIZED, "ndirect"), tmp_path / "line"
    monkeypatch.setenv("NOMAD_ROBOT", f"serial://{link}?model=n150&tm_s=2")
    with (
        daemon("thesis_room", "--robot", "n150", "--serial-link", str(link)) as port,
        connect(f"nserver://127.0.0.1:{port}/1?tm_s=0") as eye,
    ):
        cable = os.open(link, os.O_RDWR | os.O_NOCTTY)
        with subprocess.Popen([str(program)], stdout=subprocess.PIPE) as driving:
            assert driving.stdout is not None
            assert driving.stdout.readline() == b"driving\n"
            time.sleep(2.5)
            assert moves(eye), "it is fed by what the program asks"
            driving.send_signal(end)
            until(lambda: not moves(eye))
            driving.kill()
        assert not moves(eye)
        os.close(cable)


@pytest.mark.parametrize(("option", "said"), [
    ("", [Call("conf_tm", (5,))]), ("&tm_s=9", [Call("conf_tm", (9,))]), ("&tm_s=0", []),
])  # fmt: skip
def test_a_line_that_is_named_outside_has_its_time_out_set(
    workshop: Workshop, option: str, said: list[Call], monkeypatch: pytest.MonkeyPatch
) -> None:
    direct, robot = str(workshop.program(PROGRAMS / "replay.c", SANITIZED, "ndirect")), ScriptedLine()
    with on_line(robot) as device:
        monkeypatch.setenv("NOMAD_ROBOT", f"serial://{device}?model=n150{option}")
        assert held([direct], "connect_robot 1\n")[0]["return"] == 1
    assert robot.calls == said


def test_a_line_that_the_program_names_has_what_the_old_library_says(workshop: Workshop) -> None:
    direct, robot = str(workshop.program(PROGRAMS / "replay.c", SANITIZED, "ndirect")), ScriptedLine()
    with on_line(robot) as device:
        assert held([direct, "1", device, "38400"], "connect_robot 1\n")[0]["return"] == 1
    assert robot.calls == []


def test_no_robot_is_connected_that_would_not_stop(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    direct, robot = str(workshop.program(PROGRAMS / "replay.c", SANITIZED, "ndirect")), ScriptedLine({"conf_tm": b""})
    with on_line(robot) as device:
        monkeypatch.setenv("NOMAD_ROBOT", f"serial://{device}?model=n150")
        monkeypatch.setenv("REPLAY_TIMEOUT_MS", "200")
        connected, moved, _ = held([direct], "connect_robot 1\nvm 10 0 0\n")
    assert (connected["return"], moved["return"]) == (0, 0)
    assert "conf_tm: " in connected["error"]
    assert "vm" not in robot.names()


@pytest.mark.parametrize(("option", "said"), [("", []), ("?tm_s=0", []), ("?tm_s=7", [Call("conf_tm", (7,))])])
def test_a_server_stops_its_robots_itself_unless_more_is_asked_for(
    workshop: Workshop, option: str, said: list[Call], monkeypatch: pytest.MonkeyPatch
) -> None:
    client, server = str(workshop.program(PROGRAMS / "replay.c", SANITIZED)), ScriptedServer()
    with on_socket(by_script(server, 9)) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}/1{option}")
        assert held([client], "connect_robot 1\ngs\n")[0]["return"] == 7019
    assert [call for call in server.calls if call.name == "conf_tm"] == said


@pytest.mark.parametrize("text", ["1", "256", "-2", "2.5", "", "0x5", "9999999999999999999999"])
def test_a_time_out_that_is_none_is_refused(workshop: Workshop, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    direct = str(workshop.program(PROGRAMS / "replay.c", SANITIZED, "ndirect"))
    monkeypatch.setenv("NOMAD_ROBOT", f"robotd://127.0.0.1:1?model=n150&tm_s={text}")
    found, _ = held([direct], "connect_robot 1\n")
    assert found["return"] == 0
    assert f"tm_s={text} is no option here; there are model=n150, n200 or scout, baud=, and tm_s=" in found["error"]
