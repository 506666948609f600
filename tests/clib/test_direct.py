"""What a call gives on a robot's own line where all is not well: silence, rubbish, late answers, other models."""

from __future__ import annotations

import fcntl
import os
import socket
import subprocess
import termios
from pathlib import Path
from typing import Any

import pytest
from answering import on_socket
from building import PROGRAMS, SANITIZED, Workshop, held
from robot_line import NAK, Late, ScriptedLine
from scripted_lines import on_line

from nclient.errors import ConnectionLost
from nclient.protocol.commands import Call
from nclient.protocol.hello import Hello, build_hello
from nclient.protocol.mask import EVERYTHING
from nclient.protocol.models import N200, SCOUT, Model
from nclient.protocol.replies import Reply
from nclient.protocol.serial_frame import build_frame
from nclient.transports.serial_port import SerialStream


@pytest.fixture(scope="module")
def direct(workshop: Workshop) -> str:
    return str(workshop.program(PROGRAMS / "replay.c", SANITIZED, "ndirect"))


def with_line(direct: str, robot: ScriptedLine, *calls: str) -> list[dict[str, Any]]:
    with on_line(robot) as device:
        *found, _ = held([direct, str(robot.model.number), device, "38400"], "\n".join(("connect_robot 1", *calls, "")))
    assert found[0]["return"] == 1
    after: list[dict[str, Any]] = found[1:]
    return after


def test_numbers_on_a_line_are_brought_within_and_waits_go_in_pieces(direct: str) -> None:
    robot = ScriptedLine()
    robot.slots[41] = 1
    found = with_line(direct, robot, "pr 40000 -40000 1", "sp -5 70000 450", "conf_tm 300", "place_robot 40000 1 2 3",
                      "ws 1 0 0 600", "ws 0 1 0 600", "conf_ser 1 9600")  # fmt: skip
    assert [after["return"] for after in found] == [1] * 7
    assert robot.calls == [
        Call("pr", (32767, -32767, 1)), Call("sp", (0, 65535, 450)), Call("conf_tm", (255,)),
        Call("dp", (32767, 1)), Call("da", (2, 3)),
        Call("ws", (1, 0, 0, 255)), Call("ws", (1, 0, 0, 255)), Call("ws", (1, 0, 0, 90)), Call("ws", (0, 1, 0, 255)),
        Call("conf_ser", (1, 9600)),
    ]  # fmt: skip


@pytest.mark.usefixtures("quick")
def test_a_nak_is_done_and_silence_is_not(direct: str) -> None:
    robot = ScriptedLine({"vm": NAK, "gs": [None]})
    nak, silent, fine = with_line(direct, robot, "vm 1 2 3", "gs", "gs")
    assert (nak["return"], nak["State"][17]) == (1, 0)
    assert (silent["return"], silent["error"]) == (0, "gs: no good answer came")
    assert (fine["return"], fine["State"][17], fine["State"][33]) == (1, 57, 0xF00000)


@pytest.mark.usefixtures("quick")
def test_rubbish_and_late_answers_are_passed_over(direct: str) -> None:
    robot = ScriptedLine()
    good = robot.frame("get_rv")
    spoiled = bytes((*good[:6], good[6] ^ 4, *good[7:]))
    robot.answers["get_rv"] = [b"\x01\xff\x7f" + good, b"\x01\x05" + robot.frame("get_rc") + good, spoiled, good]
    found = with_line(direct, robot, "get_rv", "get_rv", "get_rv", "get_rv")
    assert [after["return"] for after in found] == [1, 1, 0, 1]


def velocities(*numbers: int) -> Reply:
    return Reply("velocity", dict(zip((38, 39, 40), numbers, strict=True)))


@pytest.mark.usefixtures("quick")
def test_a_late_answer_is_never_the_next_ones(direct: str) -> None:
    robot = ScriptedLine({"get_rv": [Late(velocities(1, 1, 1)), velocities(2, 2, 2)], "st": [None]})
    late, fine, silent, stopped = with_line(direct, robot, "get_rv", "get_rv", "st", "st")
    assert [after["return"] for after in (late, fine, silent, stopped)] == [0, 1, 0, 1]
    assert fine["State"][38:41] == [2, 2, 2]
    assert robot.names() == ["get_rv", "get_ra", "get_rv", "st", "st", "get_ra", "st"]


@pytest.mark.usefixtures("quick")
def test_a_nak_may_be_an_older_questions(direct: str) -> None:
    robot = ScriptedLine({"vm": [None], "st": NAK})
    lost, nobodys, held_back = with_line(direct, robot, "vm 1 2 3", "st", "vm 1 2 3")
    assert [after["return"] for after in (lost, nobodys, held_back)] == [0, 0, 1]


@pytest.mark.usefixtures("quick")
def test_a_question_is_held_back_while_the_line_is_dead(direct: str) -> None:
    robot = ScriptedLine({"get_rv": [None], "get_ra": None})
    _, held_back = with_line(direct, robot, "get_rv", "get_rv")
    assert held_back["error"] == "get_rv: held back, since a late answer could have passed for its own"


@pytest.mark.usefixtures("quick")
def test_where_every_question_is_owed_quiet_is_waited_for(direct: str) -> None:
    asked = ("get_ra", "get_rv", "get_rc", "get_bp", "get_sn")
    robot = ScriptedLine({name: [None] for name in asked})
    *silent, fine = with_line(direct, robot, *asked, "get_rv")
    assert [after["return"] for after in (*silent, fine)] == [0, 0, 0, 0, 0, 1]
    assert robot.names() == [*asked, "get_rv"]


@pytest.mark.usefixtures("quick")
def test_a_mask_that_nobody_answered_is_said_again(direct: str) -> None:
    robot = ScriptedLine(model=N200)
    robot.answers["ct"] = [robot.frame("ct"), None]
    lost, after = with_line(direct, robot, "posDataRequest 2", "gs")
    assert (lost["return"], after["return"]) == (0, 1)
    assert robot.names() == ["ct", "ct", "get_ra", "ct", "gs"]
    assert after["State"][17] == 57


@pytest.mark.usefixtures("quick")
def test_a_command_is_held_back_while_the_shape_of_states_is_unknown(direct: str) -> None:
    robot = ScriptedLine(model=N200)
    robot.answers["ct"] = [robot.frame("ct"), None, None]
    _, held_back, after = with_line(direct, robot, "posDataRequest 2", "gs", "gs")
    assert held_back["error"] == "gs: held back, since ct before it was not answered"
    assert after["return"] == 1


def test_a_mask_that_was_not_acknowledged_is_not_in_force(direct: str) -> None:
    robot = ScriptedLine(model=N200)
    robot.answers["ct"] = [robot.frame("ct"), NAK]
    nak, after = with_line(direct, robot, "posDataRequest 2", "gs")
    assert (nak["return"], after["return"]) == (1, 1)


def test_a_robot_of_another_model_is_not_understood(direct: str) -> None:
    robot = ScriptedLine({"gs": build_frame(7, b"123")})
    (found,) = with_line(direct, robot, "gs")
    assert (found["return"], found["error"]) == (0, "gs: the answer does not fit it; is the robot of this model?")


def test_a_line_that_is_gone(direct: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with on_socket(lambda _: None) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"robotd://127.0.0.1:{port}?model=n150&tm_s=0")
        connected, gone, after, _ = held([direct], "connect_robot 1\ngs\ngs\n")
    assert [connected["return"], gone["return"], after["return"]] == [1, 0, 0]
    assert gone["error"] == "gs: the line is gone; connect again"
    assert after["error"] == "gs: no robot is connected; connect_robot comes first"


@pytest.mark.parametrize(("model", "call", "reason"), [
    (SCOUT, "tk hello", "a Scout does not have it"),
    (N200, "conf_ser 1 9600", "a N200 does not have it"),
    (N200, "real_robot", "exists only on an Nserver"),
    (N200, "create_robot 2", "exists only on an Nserver"),
    (N200, "tk " + "x" * 250, "at most 255 bytes"),
])  # fmt: skip
def test_what_a_line_does_not_have(direct: str, model: Model, call: str, reason: str) -> None:
    robot = ScriptedLine(model=model)
    (found,) = with_line(direct, robot, call)
    assert found["return"] == 0
    assert reason in found["error"]
    assert [name for name in robot.names() if name != "ct"] == []


def test_a_n200_over_tcp_says_its_mask(direct: str) -> None:
    mask = EVERYTHING.with_position(2)
    hello = build_hello(Hello(mask, 33))

    def talk(connection: socket.socket) -> None:
        connection.sendall(hello)
        connection.recv(1)

    with on_socket(talk) as port:
        found, _ = held([direct, "0", "127.0.0.1", str(port)], "connect_robot 1\n")
    assert (found["return"], found["pos"]) == (1, 2)
    with on_socket(lambda connection: connection.sendall(hello[:-1])) as port:
        found, _ = held([direct, "0", "127.0.0.1", str(port)], "connect_robot 1\n")
    assert found["return"] == 0
    assert "11 bytes first" in found["error"]


@pytest.mark.parametrize(("words", "reason"), [
    (("7", "/dev/ttyUSB0", "38400"), "a model's number is 0 (N200), 1 (N150) or 2 (Scout), not 7"),
    (("1", "/dev/null", "38400"), "/dev/null cannot be opened as a serial port"),
    (("1", "/dev/no-such-line", "38400"), "No such file or directory"),
    (("1", "/dev/null", "12345"), "12345 is no speed"),
    (("1", "127.0.0.1", "1"), "nobody answers at 127.0.0.1:1"),
    (("1", "127.0.0.1", "65537"), "127.0.0.1: a port is 1 to 65535, not 65537"),
    (("1", "/" + "x" * 90, "38400"), "at most 79 characters"),
])  # fmt: skip
def test_a_line_that_is_not_there(direct: str, words: tuple[str, ...], reason: str) -> None:
    connected, asked, _ = held([direct, *words], "connect_robot 1\ngs\n")
    assert (connected["return"], asked["return"]) == (0, 0)
    assert reason in connected["error"]


def test_one_program_at_a_time(direct: str) -> None:
    robot = ScriptedLine()
    with on_line(robot) as device:
        words = [direct, "1", device, "9600"]
        other = os.open(device, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(other, fcntl.LOCK_EX)
        before = termios.tcgetattr(other)
        refused, asked, _ = held(words, "connect_robot 1\ngs\n")
        assert termios.tcgetattr(other) == before
        os.close(other)
        assert (refused["return"], asked["return"], robot.calls) == (0, 0, [])
        assert refused["error"] == f"{device} is in use by another program; one program at a time can talk to a robot"
        connected, asked, _ = held(words, "connect_robot 1\ngs\n")
        assert (connected["return"], asked["return"]) == (1, 1)


def test_a_line_that_a_c_program_has_is_refused_to_the_next(direct: str) -> None:
    with on_line(ScriptedLine()) as device:
        first = subprocess.Popen([direct, "1", device, "38400"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        with first:
            assert first.stdin is not None
            assert first.stdout is not None
            first.stdin.write(b"connect_robot 1\n")
            first.stdin.flush()
            first.stdout.readline()
            second, _ = held([direct, "1", device, "38400"], "connect_robot 1\n")
            assert (second["return"], "is in use by another program" in second["error"]) == (0, True)
            with pytest.raises(ConnectionLost, match=rf"is in use by .*\(process {first.pid}\)"):
                SerialStream(device)
            first.communicate(timeout=10)
        assert held([direct, "1", device, "38400"], "connect_robot 1\n")[0]["return"] == 1


def test_a_line_can_be_named_outside(direct: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with on_line(ScriptedLine(model=SCOUT)) as device:
        monkeypatch.setenv("NOMAD_ROBOT", f"serial://{device}?model=scout&baud=9600")
        running, connected, asked, again, _ = held(
            [direct], "server_is_running\nconnect_robot 1\ngs\nserver_is_running\n")
    assert [running["return"], connected["return"], asked["return"], again["return"]] == [1, 1, 1, 1]
    assert asked["State"][33] == 0
    monkeypatch.setenv("NOMAD_ROBOT", "nserver://lab/1")
    found, _ = held([direct], "connect_robot 1\n")
    assert "link it with -lnclient" in found["error"]
    monkeypatch.setenv("NOMAD_ROBOT", "robotd://127.0.0.1:1/2?model=n150")
    found, _ = held([direct], "connect_robot 1\n")
    assert "a host and its port follow robotd://, not /2" in found["error"]


def test_the_globals_name_a_line_where_nothing_else_does(workshop: Workshop, tmp_path: Path) -> None:
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
    program = str(workshop.program(source, SANITIZED, "ndirect"))
    with on_line(ScriptedLine(model=SCOUT)) as device:
        assert subprocess.run([program, device], check=False).returncode == 0
        refused = subprocess.run([program, device, "tcp"], capture_output=True, text=True, check=False)
    assert (refused.returncode, "nobody answers at 127.0.0.1:1" in refused.stderr) == (9, True)


def test_the_old_way_of_connecting_without_the_macro(workshop: Workshop, tmp_path: Path) -> None:
    source = tmp_path / "plain.c"
    source.write_text("""\
#include "Nclient.h"
int main(int count, char **words)
{
    return count == 2 && connect_robot(1, MODEL_N150, words[1], 38400) && gs() ? 0 : 9;
}
""")
    program = str(workshop.program(source, SANITIZED, "ndirect", ("-std=c89", "-pedantic", "-Wall", "-Werror")))
    with on_line(ScriptedLine()) as device:
        assert subprocess.run([program, device], check=False).returncode == 0
