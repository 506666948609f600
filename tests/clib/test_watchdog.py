"""conf_tm on connecting: a robot on its line stops after its C program ends or hangs.

The line stays open after the program ends, as a cable does, so that only the robot's own time-out stops it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from nclient import connect
from nclient.protocol.commands import Call
from nclient.robot import Robot
from tests.clib.clib_build import PROGRAMS, SANITIZED, BuildCache, run_calls, run_nserver
from tests.clib.scripted_pty import serve_pty
from tests.nclient.scripted_line import ScriptedLine
from tests.nclient.scripted_server import ScriptedServer, by_script, on_socket
from tests.waiting import wait_until

TIMEOUT_S = 30.0


def is_moving(observer: Robot) -> bool:
    """Return True if the true position changes within 0.1 s; the observing client does not reset the time-out."""
    # The simulation runs in real time: 0.1 s of it are awaited.
    before = observer.truth()
    wait_until(lambda: observer.truth().time_s > before.time_s + 0.1)
    return observer.truth().x_in != before.x_in


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "asleep"])
def test_robot_stops_if_program_stops_sending(
    builds: BuildCache, end: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, link = builds.program(PROGRAMS / "drives_on.c", SANITIZED, "ndirect"), tmp_path / "line"
    monkeypatch.setenv("NOMAD_ROBOT", f"serial://{link}?model=n150&tm_s=2")
    with (
        run_nserver("thesis_room", "--robot", "n150", "--serial-link", str(link)) as port,
        connect(f"nserver://127.0.0.1:{port}/1?tm_s=0") as observer,
    ):
        # The line stays open when the program ends, as a cable does: no end of a connection stops the robot.
        cable = os.open(link, os.O_RDWR | os.O_NOCTTY)
        with subprocess.Popen([str(program)], stdout=subprocess.PIPE) as driving:
            assert driving.stdout is not None
            assert driving.stdout.readline() == b"driving\n"
            # Longer than the time-out of 2 s.
            time.sleep(2.5)
            assert is_moving(observer), "the requests of the program reset the time-out"
            # Killed, or stopped without an end: no request is sent any more.
            driving.send_signal(end)
            wait_until(lambda: not is_moving(observer))
            driving.kill()
        assert not is_moving(observer)
        os.close(cable)


# A line from the environment gets a time-out; one from the program's arguments has that of the old library, none.
@pytest.mark.parametrize(("option", "expected"), [
    ("", [Call("conf_tm", (5,))]), ("&tm_s=9", [Call("conf_tm", (9,))]), ("&tm_s=0", []),
])  # fmt: skip
def test_line_from_environment_sets_conf_tm(
    builds: BuildCache, option: str, expected: list[Call], monkeypatch: pytest.MonkeyPatch
) -> None:
    direct, robot = str(builds.program(PROGRAMS / "replay.c", SANITIZED, "ndirect")), ScriptedLine()
    with serve_pty(robot) as device:
        monkeypatch.setenv("NOMAD_ROBOT", f"serial://{device}?model=n150{option}")
        assert run_calls([direct], "connect_robot 1\n")[0]["return"] == 1
    assert robot.calls == expected


def test_line_from_arguments_sets_no_conf_tm(builds: BuildCache) -> None:
    direct, robot = str(builds.program(PROGRAMS / "replay.c", SANITIZED, "ndirect")), ScriptedLine()
    with serve_pty(robot) as device:
        assert run_calls([direct, "1", device, "38400"], "connect_robot 1\n")[0]["return"] == 1
    assert robot.calls == []


def test_connecting_fails_if_conf_tm_fails(builds: BuildCache, monkeypatch: pytest.MonkeyPatch) -> None:
    direct, robot = str(builds.program(PROGRAMS / "replay.c", SANITIZED, "ndirect")), ScriptedLine({"conf_tm": b""})
    with serve_pty(robot) as device:
        monkeypatch.setenv("NOMAD_ROBOT", f"serial://{device}?model=n150")
        monkeypatch.setenv("REPLAY_TIMEOUT_MS", "200")
        connected, moved, _ = run_calls([direct], "connect_robot 1\nvm 10 0 0\n")
    assert (connected["return"], moved["return"]) == (0, 0)
    assert "conf_tm: " in connected["error"]
    assert "vm" not in robot.names()


@pytest.mark.parametrize(("option", "expected"), [("", []), ("?tm_s=0", []), ("?tm_s=7", [Call("conf_tm", (7,))])])
def test_server_gets_conf_tm_only_from_address(
    builds: BuildCache, option: str, expected: list[Call], monkeypatch: pytest.MonkeyPatch
) -> None:
    client, server = str(builds.program(PROGRAMS / "replay.c", SANITIZED)), ScriptedServer()
    with on_socket(by_script(server, 9)) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}/1{option}")
        assert run_calls([client], "connect_robot 1\ngs\n")[0]["return"] == 7019
    assert [call for call in server.calls if call.name == "conf_tm"] == expected


@pytest.mark.parametrize("text", ["1", "256", "-2", "2.5", "", "0x5", "9999999999999999999999"])
def test_invalid_tm_s_is_rejected(builds: BuildCache, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    direct = str(builds.program(PROGRAMS / "replay.c", SANITIZED, "ndirect"))
    monkeypatch.setenv("NOMAD_ROBOT", f"robotd://127.0.0.1:1?model=n150&tm_s={text}")
    found, _ = run_calls([direct], "connect_robot 1\n")
    assert found["return"] == 0
    assert f"unknown option or value tm_s={text}; use model=n150, n200 or scout, baud=, and tm_s=" in found["error"]
