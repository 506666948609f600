"""Calls on a robot's own line under faults: time-outs, noise, late replies, other models."""

from __future__ import annotations

import fcntl
import os
import socket
import subprocess
import termios
from pathlib import Path
from typing import Any

import pytest

from nclient.errors import ConnectionLost
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import build_frame
from nclient.protocol.types import EVERYTHING, N200, SCOUT, Model
from nclient.transports.serial import SerialStream
from tests.clib.clib_build import PROGRAMS, SANITIZED, BuildCache, run_calls
from tests.clib.scripted_pty import serve_pty
from tests.nclient.scripted_line import NAK, Late, ScriptedLine
from tests.nclient.scripted_server import on_socket


@pytest.fixture(scope="module")
def direct(builds: BuildCache) -> str:
    return str(builds.program(PROGRAMS / "replay.c", SANITIZED, "ndirect"))


def calls_with_line(direct: str, robot: ScriptedLine, *calls: str) -> list[dict[str, Any]]:
    with serve_pty(robot) as device:
        program = [direct, str(robot.model.number), device, "38400"]
        *found, _ = run_calls(program, "\n".join(("connect_robot 1", *calls, "")))
    assert found[0]["return"] == 1
    after: list[dict[str, Any]] = found[1:]
    return after


def test_numbers_are_clamped(direct: str) -> None:
    robot = ScriptedLine()
    found = calls_with_line(direct, robot, "pr 40000 -40000 1", "sp -5 70000 450", "conf_tm 255",
                            "place_robot 40000 1 2 3", "ws 1 0 0 255", "conf_ser 1 9600")  # fmt: skip
    assert [after["return"] for after in found] == [1] * 6
    # Sign-magnitude of 16 bits, unsigned 16 bits, one byte. place_robot is sent as dp and da.
    assert robot.calls == [
        Call("pr", (32767, -32767, 1)), Call("sp", (0, 65535, 450)), Call("conf_tm", (255,)),
        Call("dp", (32767, 1)), Call("da", (2, 3)),
        Call("ws", (1, 0, 0, 255)), Call("conf_ser", (1, 9600)),
    ]  # fmt: skip


@pytest.mark.usefixtures("short_timeout")
def test_nak_succeeds_and_timeout_fails(direct: str) -> None:
    robot = ScriptedLine({"vm": NAK, "gs": [None]})
    nak, silent, fine = calls_with_line(direct, robot, "vm 1 2 3", "gs", "gs")
    # A NAK is success with State unchanged; a missing reply is failure, and the session goes on.
    assert (nak["return"], nak["State"][17]) == (1, 0)
    assert (silent["return"], silent["error"]) == (0, "gs: no valid reply in time")
    assert (fine["return"], fine["State"][17], fine["State"][33]) == (1, 57, 0xF00000)


@pytest.mark.usefixtures("short_timeout")
def test_noise_and_late_replies_are_skipped(direct: str) -> None:
    robot = ScriptedLine()
    good = robot.frame("get_rv")
    # One bit of the data is wrong, so that the checksum is, too.
    spoiled = bytes((*good[:6], good[6] ^ 4, *good[7:]))
    # Noise that looks like a start; the head of a frame and the reply to another command; a corrupt reply; a good
    # one.
    robot.answers["get_rv"] = [b"\x01\xff\x7f" + good, b"\x01\x05" + robot.frame("get_rc") + good, spoiled, good]
    found = calls_with_line(direct, robot, "get_rv", "get_rv", "get_rv", "get_rv")
    assert [after["return"] for after in found] == [1, 1, 0, 1]


def velocities(*numbers: int) -> Reply:
    return Reply("velocity", dict(zip((38, 39, 40), numbers, strict=True)))


@pytest.mark.usefixtures("short_timeout")
def test_late_reply_is_not_used_for_next_call(direct: str) -> None:
    # The first reply to get_rv comes with the next command, after the time-out.
    robot = ScriptedLine({"get_rv": [Late(velocities(1, 1, 1)), velocities(2, 2, 2)], "st": [None]})
    late, fine, silent, stopped = calls_with_line(direct, robot, "get_rv", "get_rv", "st", "st")
    assert [after["return"] for after in (late, fine, silent, stopped)] == [0, 1, 0, 1]
    assert fine["State"][38:41] == [2, 2, 2]
    # get_ra is a probe: once it is answered, no older reply can arrive. st is sent at once, and again after the
    # probe.
    assert robot.names() == ["get_rv", "get_ra", "get_rv", "st", "st", "get_ra", "st"]


@pytest.mark.usefixtures("short_timeout")
# A NAK does not name its command: with vm outstanding it may belong to vm or to st.
def test_nak_is_ambiguous_while_reply_is_pending(direct: str) -> None:
    robot = ScriptedLine({"vm": [None], "st": NAK})
    lost, ambiguous, not_sent = calls_with_line(direct, robot, "vm 1 2 3", "st", "vm 1 2 3")
    assert [after["return"] for after in (lost, ambiguous, not_sent)] == [0, 0, 1]


@pytest.mark.usefixtures("short_timeout")
def test_query_is_not_sent_on_dead_line(direct: str) -> None:
    robot = ScriptedLine({"get_rv": [None], "get_ra": None})
    _, not_sent = calls_with_line(direct, robot, "get_rv", "get_rv")
    assert not_sent["error"] == "get_rv: not sent, because a late reply could be mistaken for its own"


@pytest.mark.usefixtures("short_timeout")
def test_line_is_drained_if_all_types_are_pending(direct: str) -> None:
    # All types of probes are outstanding, so that only silence shows that no late reply will arrive.
    queried = ("get_ra", "get_rv", "get_rc", "get_bp", "get_sn")
    robot = ScriptedLine({name: [None] for name in queried})
    *silent, fine = calls_with_line(direct, robot, *queried, "get_rv")
    assert [after["return"] for after in (*silent, fine)] == [0, 0, 0, 0, 0, 1]
    assert robot.names() == [*queried, "get_rv"]


@pytest.mark.usefixtures("short_timeout")
def test_mask_without_reply_is_sent_again(direct: str) -> None:
    robot = ScriptedLine(model=N200)
    robot.answers["ct"] = [robot.frame("ct"), None]
    lost, after = calls_with_line(direct, robot, "posDataRequest 2", "gs")
    assert (lost["return"], after["return"]) == (0, 1)
    # ct of the connection; the one without a reply; a probe; ct again, before gs is decoded under that mask.
    assert robot.names() == ["ct", "ct", "get_ra", "ct", "gs"]
    assert after["State"][17] == 57


@pytest.mark.usefixtures("short_timeout")
def test_call_fails_while_state_layout_is_unknown(direct: str) -> None:
    robot = ScriptedLine(model=N200)
    robot.answers["ct"] = [robot.frame("ct"), None, None]
    _, not_sent, after = calls_with_line(direct, robot, "posDataRequest 2", "gs", "gs")
    assert not_sent["error"] == "gs: not sent, because the earlier ct has no reply"
    assert after["return"] == 1


def test_mask_with_nak_is_not_applied(direct: str) -> None:
    robot = ScriptedLine(model=N200)
    robot.answers["ct"] = [robot.frame("ct"), NAK]
    nak, after = calls_with_line(direct, robot, "posDataRequest 2", "gs")
    assert (nak["return"], after["return"]) == (1, 1)


def test_reply_of_another_model_is_rejected(direct: str) -> None:
    # A state packet of three bytes with a valid checksum.
    robot = ScriptedLine({"gs": build_frame(7, b"123")})
    (found,) = calls_with_line(direct, robot, "gs")
    assert (found["return"], found["error"]) == (0, "gs: the reply has the wrong format; is the robot of this model?")


def test_disconnected_line(direct: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # The other end accepts the connection and closes it.
    with on_socket(lambda _: None) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"robotd://127.0.0.1:{port}?model=n150&tm_s=0")
        connected, closed, after, _ = run_calls([direct], "connect_robot 1\ngs\ngs\n")
    assert [connected["return"], closed["return"], after["return"]] == [1, 0, 0]
    assert closed["error"] == "gs: the line is disconnected; connect again"
    assert after["error"] == "gs: no robot is connected; call connect_robot first"


@pytest.mark.parametrize(("model", "call", "reason"), [
    (SCOUT, "tk hello", "not available on the serial line of model Scout"),
    (N200, "conf_ser 1 9600", "not available on the serial line of model N200"),
    (N200, "refresh_all", "only with an Nserver"),
    (N200, "draw_line 1 2 3 4 5", "only with an Nserver"),
    (N200, "tk " + "x" * 250, "at most 255 bytes"),
])  # fmt: skip
def test_unavailable_commands_are_not_sent(direct: str, model: Model, call: str, reason: str) -> None:
    robot = ScriptedLine(model=model)
    (found,) = calls_with_line(direct, robot, call)
    assert found["return"] == 0
    assert reason in found["error"]
    assert [name for name in robot.names() if name != "ct"] == []


def test_n200_handshake_over_tcp(direct: str) -> None:
    mask = EVERYTHING.with_position(2)
    # Mask with the stamps of the sonars, laser mode 33.
    hello = build_handshake(Handshake(mask, 33))

    def talk(connection: socket.socket) -> None:
        connection.sendall(hello)
        connection.recv(1)

    with on_socket(talk) as port:
        found, _ = run_calls([direct, "0", "127.0.0.1", str(port)], "connect_robot 1\n")
    # The program's mask is the one of the handshake.
    assert (found["return"], found["pos"]) == (1, 2)
    # One byte less than the handshake.
    with on_socket(lambda connection: connection.sendall(hello[:-1])) as port:
        found, _ = run_calls([direct, "0", "127.0.0.1", str(port)], "connect_robot 1\n")
    assert found["return"] == 0
    assert "11 handshake bytes" in found["error"]


@pytest.mark.parametrize(("words", "reason"), [
    (("7", "/dev/ttyUSB0", "38400"), "the model number must be 0 (N200), 1 (N150) or 2 (Scout), not 7"),
    (("1", "/dev/null", "38400"), "/dev/null cannot be opened as a serial port"),
    (("1", "/dev/no-such-line", "38400"), "No such file or directory"),
    (("1", "/dev/null", "12345"), "12345 is not a valid baud rate"),
    (("1", "127.0.0.1", "1"), "cannot connect to 127.0.0.1:1"),
    (("1", "127.0.0.1", "65537"), "127.0.0.1: the port must be 1 to 65535, not 65537"),
    (("1", "/" + "x" * 90, "38400"), "at most 79 characters"),
])  # fmt: skip
def test_connection_errors(direct: str, words: tuple[str, ...], reason: str) -> None:
    connected, queried, _ = run_calls([direct, *words], "connect_robot 1\ngs\n")
    assert (connected["return"], queried["return"]) == (0, 0)
    assert reason in connected["error"]


def test_locked_port_is_not_touched(direct: str) -> None:
    robot = ScriptedLine()
    with serve_pty(robot) as device:
        words = [direct, "1", device, "9600"]
        other = os.open(device, os.O_RDWR | os.O_NOCTTY)
        # Another program holds the lock of the port.
        fcntl.flock(other, fcntl.LOCK_EX)
        before = termios.tcgetattr(other)
        refused, queried, _ = run_calls(words, "connect_robot 1\ngs\n")
        # The settings of the port must not change: the other program is using it.
        assert termios.tcgetattr(other) == before
        os.close(other)
        assert (refused["return"], queried["return"], robot.calls) == (0, 0, [])
        assert refused["error"] == f"{device} is in use by another program; only one program at a time can use a robot"
        connected, queried, _ = run_calls(words, "connect_robot 1\ngs\n")
        assert (connected["return"], queried["return"]) == (1, 1)


def test_connected_program_locks_its_port(direct: str) -> None:
    with serve_pty(ScriptedLine()) as device:
        first = subprocess.Popen([direct, "1", device, "38400"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        with first:
            assert first.stdin is not None
            assert first.stdout is not None
            first.stdin.write(b"connect_robot 1\n")
            first.stdin.flush()
            first.stdout.readline()
            second, _ = run_calls([direct, "1", device, "38400"], "connect_robot 1\n")
            assert (second["return"], "is in use by another program" in second["error"]) == (0, True)
            # Both languages use the same lock, so that each sees the other's.
            with pytest.raises(ConnectionLost, match=rf"in use .*\(process {first.pid}\)"):
                SerialStream(device)
            first.communicate(timeout=10)
        assert run_calls([direct, "1", device, "38400"], "connect_robot 1\n")[0]["return"] == 1


def test_line_from_environment(direct: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with serve_pty(ScriptedLine(model=SCOUT)) as device:
        monkeypatch.setenv("NOMAD_ROBOT", f"serial://{device}?model=scout&baud=9600")
        running, connected, queried, again, _ = run_calls(
            [direct], "server_is_running\nconnect_robot 1\ngs\nserver_is_running\n")
    assert [running["return"], connected["return"], queried["return"], again["return"]] == [1, 1, 1, 1]
    # A Scout at rest has no bumper bits; a N150 would show four.
    assert queried["State"][33] == 0
    monkeypatch.setenv("NOMAD_ROBOT", "nserver://lab/1")
    found, _ = run_calls([direct], "connect_robot 1\n")
    assert "link it with -lnclient" in found["error"]
    monkeypatch.setenv("NOMAD_ROBOT", "robotd://127.0.0.1:1/2?model=n150")
    found, _ = run_calls([direct], "connect_robot 1\n")
    assert "only a host and a port may follow robotd://, not /2" in found["error"]


@pytest.mark.parametrize("call", ["real_robot", "simulated_robot", "create_robot 2", "predict_sensors 1 2 3 4",
                                  "add_obstacle 3 0 0 9 0 0 9", "new_world", "get_robot_conf"])  # fmt: skip
def test_calls_for_a_simulation_do_nothing_on_a_line(direct: str, call: str) -> None:
    robot = ScriptedLine()
    queried, found = calls_with_line(direct, robot, "gs", call)
    assert found["return"] == 1
    # The state is that of the call before.
    assert {name: value for name, value in found.items() if name in queried} == queried
    assert robot.names() == ["gs"]


def test_position_data_on_line_of_n150(direct: str) -> None:
    robot = ScriptedLine()
    (found,) = calls_with_line(direct, robot, "posDataRequest 3")
    assert (found["return"], found["pos"], robot.names()) == (1, 0, [])


def test_state_44_is_111_without_line(direct: str) -> None:
    found, *_ = run_calls([direct, "1", "/dev/no-such-line", "38400"], "connect_robot 1\n")
    assert (found["return"], found["State"][44]) == (0, 111)
    (found, *_) = run_calls([direct], "gs\n")
    assert (found["return"], found["State"][44]) == (0, 111)


def test_line_from_globals(builds: BuildCache, tmp_path: Path) -> None:
    source = tmp_path / "globals.c"
    source.write_text("""\
#include "Nclient.h"
#include <string.h>
int main(int count, char **words)
{
    strcpy(DEFAULT_SERIAL_PORT, words[1]);
    DEFAULT_ROBOT_MODEL = MODEL_SCOUT;
    if (count > 2) {
        strcpy(ROBOT_MACHINE_NAME, "127.0.0.1");
        CONN_TCP_PORT = 1;
    }
    return connect_robot(1) && gs() && State[STATE_BUMPER] == 0 ? 0 : 9;
}
""")
    program = str(builds.program(source, SANITIZED, "ndirect"))
    with serve_pty(ScriptedLine(model=SCOUT)) as device:
        assert subprocess.run([program, device], check=False).returncode == 0
        refused = subprocess.run([program, device, "tcp"], capture_output=True, text=True, check=False)
    assert (refused.returncode, "cannot connect to 127.0.0.1:1" in refused.stderr) == (9, True)


def test_connect_robot_without_macro(builds: BuildCache, tmp_path: Path) -> None:
    source = tmp_path / "plain.c"
    source.write_text("""\
#include "Nclient.h"
int main(int count, char **words)
{
    return count == 2 && connect_robot(1, MODEL_N150, words[1], 38400) && gs() ? 0 : 9;
}
""")
    program = str(builds.program(source, SANITIZED, "ndirect", ("-std=c89", "-pedantic", "-Wall", "-Werror")))
    with serve_pty(ScriptedLine()) as device:
        assert subprocess.run([program, device], check=False).returncode == 0
