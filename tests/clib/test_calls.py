"""What a call gives where all is not well, or not simple: refusals, silence, numbers out of range, lost robots."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import threading
import tty
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from answering import ScriptedServer, by_script, error, on_socket, simple
from building import PROGRAMS, SANITIZED, Workshop, held
from recorded import TCP
from robot_line import NAK, Late, ScriptedLine

from nclient.protocol.commands import Call
from nclient.protocol.hello import Hello, build_hello
from nclient.protocol.mask import EVERYTHING
from nclient.protocol.models import N200, SCOUT, Model
from nclient.protocol.replies import Reply
from nclient.protocol.serial_frame import build_frame


@pytest.fixture(scope="module")
def client(workshop: Workshop) -> str:
    return str(workshop.program(PROGRAMS / "replay.c", SANITIZED))


@pytest.fixture(scope="module")
def direct(workshop: Workshop) -> str:
    return str(workshop.program(PROGRAMS / "replay.c", SANITIZED, "ndirect"))


@pytest.fixture(autouse=True)
def nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """No robot of the tester's own."""
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """For silence that is waited out."""
    monkeypatch.setenv("REPLAY_TIMEOUT_MS", "400")


# with a server


def with_server(client: str, server: ScriptedServer, asked: int, *calls: str) -> list[dict[str, Any]]:
    """What is held after each call, connected first; the server hears `asked` of them."""
    with on_socket(by_script(server, 2 + asked)) as port:
        *found, _ = held([client, str(port)], "\n".join(("connect_robot 1", *calls, "")))
    assert found[0]["return"] == 7019
    after: list[dict[str, Any]] = found[1:]
    return after


def test_a_refusal_is_zero_and_its_code_stands_in_state_44(client: str) -> None:
    server = ScriptedServer({"vm": error(5)})
    server.slots = {0: 10, 17: 80}
    refused, fine = with_server(client, server, 2, "vm 1 2 3", "gs")
    assert (refused["return"], refused["State"][44], refused["State"][17]) == (0, 5, 80)
    assert refused["error"] == "vm: refused with error 5, refused by the setup"
    assert (fine["return"], fine["State"][44]) == (1, 0)


@pytest.mark.parametrize(("call", "reason"), [
    ("mv 6 0 0 0 0 0", "modes 6, 7 and 8"),
    ("mv 0 0 7 0 0 0", "modes 6, 7 and 8"),
    ("mv 0 0 0 0 8 0", "modes 6, 7 and 8"),
    ("pa 1 2 3", "robot's own line"),
    ("conf_ser 1 9600", "robot's own line"),
    ("mask 32", "no sum of 1, 2, 4, 8, 16"),
    ("posDataRequest -1", "no sum of 1, 2, 4, 8, 16"),
    ("tk " + "x" * 256, "at most 255"),
    ("add_obstacle 0", "1 to 10 vertices"),
    ("move_obstacle 11 0 0", "1 to 10 vertices"),
])  # fmt: skip
def test_what_is_refused_without_a_word_to_the_server(client: str, call: str, reason: str) -> None:
    server = ScriptedServer()
    (found,) = with_server(client, server, 0, call)
    assert found["return"] == 0
    assert reason in found["error"]
    assert server.names() == []


def test_a_robot_that_is_not_there(client: str) -> None:
    server = ScriptedServer({"connect_robot": simple(0)})
    with on_socket(by_script(server, 1)) as port:
        connected, asked, left, _ = held([client, str(port)], "connect_robot 9\ngs\ndisconnect_robot 9\n")
    assert [connected["return"], asked["return"], left["return"]] == [0, 0, 0]
    assert connected["error"] == "connect_robot: the server has no robot number 9"
    assert asked["error"] == "gs: no robot is connected; connect_robot comes first"


@pytest.mark.usefixtures("quick")
def test_a_server_that_is_silent_is_left(client: str) -> None:
    server = ScriptedServer({"gs": None})

    def talk(connection: socket.socket) -> None:
        by_script(server, 3)(connection)
        assert connection.recv(1) == b""  # it hangs up, and asks no more

    with on_socket(talk) as port:
        _, silent, after, _ = held([client, str(port)], "connect_robot 1\ngs\nst\n")
    assert (silent["return"], after["return"]) == (0, 0)
    assert silent["error"] == "gs: no answer in time; the connection is closed"


def test_a_server_that_has_gone(client: str) -> None:
    gone, after = with_server(client, ScriptedServer(), 0, "gs", "st")
    assert gone["return"] == after["return"] == 0
    assert gone["error"] == "gs: the server has gone; the connection is closed"
    assert after["error"] == "st: no robot is connected; connect_robot comes first"


@pytest.mark.parametrize("reply", ["005b0000", "00500001000000ff", "0050ffff", "00520000"])
def test_an_answer_that_does_not_fit_closes_the_connection(client: str, reply: str) -> None:
    wrong, after = with_server(client, ScriptedServer({"gs": bytes.fromhex(reply)}), 1, "gs", "st")
    assert (wrong["return"], after["return"]) == (0, 0)
    assert wrong["error"].endswith("; the connection is closed")


def test_an_answer_that_comes_byte_by_byte(client: str) -> None:
    case = TCP["session_1"][0]

    def dribble(connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for exchange in case["exchanges"]:
            connection.recv(4096)
            for byte in bytes.fromhex(exchange["reply"]):
                connection.sendall(bytes((byte,)))

    with on_socket(dribble) as port:
        found, _ = held([client, str(port)], "connect_robot 1\n")
    assert (found["return"], found["State"]) == (7019, case["decoded"]["State"])


def test_no_more_robots_or_lines_than_there_is_room_for(client: str) -> None:
    lines = (300, *range(1200))
    server = ScriptedServer({
        "get_rpx": simple(12, *range(36)), "get_sg": Reply("laser", laser=lines),
        "move_obstacle": simple(2, 1, 2, 3, 4),
    })  # fmt: skip
    robots, segments, moved = with_server(
        client, server, 3, "get_rpx", "get_sg", "move_obstacle 3 0 0 50 0 0 50 10 -20")
    assert robots["obs"] == [10, *range(30)]
    assert segments["Laser"] == [241, *range(6)]
    assert (moved["return"], moved["obs"][0]) == (0, 3)
    assert "counts 2" in moved["error"]


def test_a_long_beyond_a_word_is_brought_to_the_nearest(client: str) -> None:
    server = ScriptedServer({"move_obstacle": simple(1, 5, 6)})
    (found,) = with_server(client, server, 1, f"move_obstacle 1 7 8 {1 << 40} {-(1 << 40)}")
    assert server.last() == Call("move_obstacle", (1, 7, 8, 2**31 - 1, -(2**31)))
    assert (found["return"], found["obs"][:3]) == (1, [1, 5, 6])


def test_calls_of_our_own_simulation_and_a_scouts_wheels(client: str) -> None:
    server = ScriptedServer({"sim_truth": Reply("truth", values=(1, 500, -2, 3, 4, 5, 6, 7))})
    truth, control, wheels, way = with_server(
        client, server, 4, "sim_truth", "sim_control 3 100", "scout_vm 100 -450", "scout_pr 0 450")
    assert truth["obs"][:8] == [1, 500, -2, 3, 4, 5, 6, 7]
    assert control["return"] == wheels["return"] == way["return"] == 1
    assert server.calls[3:] == [Call("sim_control", (3, 100)), Call("vm", (47, 153, 0)), Call("pr", (53, -53, 0))]


def test_where_the_server_is_can_be_said_outside(client: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with on_socket(by_script(ScriptedServer(), 2)) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}/1?model=n150")
        found, _ = held([client], "create_robot 1\n")
        assert found["return"] == 7019


@pytest.mark.parametrize(("address", "reason"), [
    ("lab:7019", "no address such as nserver://host:7019/1"),
    ("serial:///dev/ttyUSB0", "link it with -lndirect"),
    ("nserver://127.0.0.1:1/1?color=red", "color=red is no option"),
    ("nserver://127.0.0.1:1/1?model=n300", "model=n300 is no option"),
    ("nserver://[::1]:1/1", "nobody answers at ::1:1"),
    ("nserver://" + "x" * 120, "longer than the name of a machine"),
    ("nserver://no.such.host.invalid/1", "there is no host no.such.host.invalid"),
])  # fmt: skip
def test_an_address_that_leads_nowhere(client: str, monkeypatch: pytest.MonkeyPatch, address: str, reason: str) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", address)
    found, _ = held([client], "connect_robot 1\n")
    assert found["return"] == 0
    assert reason in found["error"]


def test_whether_a_server_runs(client: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = str(listener.getsockname()[1])
        assert held([client, port], "server_is_running\n")[0]["return"] == 1
    assert held([client, port], "server_is_running\n")[0]["return"] == 0


def test_edges(workshop: Workshop) -> None:
    program = workshop.program(PROGRAMS / "edges.c", SANITIZED)
    server = ScriptedServer({"special_request": Reply("special", values=(4, 0, 0, 200))})

    def two_clients() -> None:
        for calls in (3, 11):
            with listener.accept()[0] as connection:
                by_script(server, calls)(connection)
                assert connection.recv(1) == b""

    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as thread:
        serving = thread.submit(two_clients)
        port = str(listener.getsockname()[1])
        done = subprocess.run([str(program), port], capture_output=True, text=True, timeout=60, check=False)
        serving.result(10)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    checks = [call for call in server.calls if call.name == "motion_check"]
    assert checks[0].args == (0, -12340, 290, 21474836470, -21474836470)
    assert checks[1].args[:5] == (1, -21474836470, 21474836470, 1570, -3140)


@pytest.mark.usefixtures("quick")
def test_nobody_takes_the_connection(client: str) -> None:
    with socket.socket() as full, contextlib.ExitStack() as waiting:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        for _ in range(3):  # who comes now is not answered at all
            first = waiting.enter_context(socket.socket())
            first.setblocking(False)
            first.connect_ex(full.getsockname())
        found, _ = held([client, str(full.getsockname()[1])], "connect_robot 1\n")
    assert found["return"] == 0
    assert "Connection timed out" in found["error"]


# on a robot's own line


@contextlib.contextmanager
def on_line(robot: ScriptedLine) -> Iterator[str]:
    """The name of a pseudo-terminal behind which the robot is."""
    master, slave = os.openpty()
    tty.setraw(slave)

    def answer() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(master, 4096):
                robot.send(data)
                os.write(master, robot.receive())

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        os.close(slave)
        thread.join(10)
        os.close(master)


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
        monkeypatch.setenv("NOMAD_ROBOT", f"robotd://127.0.0.1:{port}?model=n150")
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
    (("1", "/" + "x" * 90, "38400"), "at most 79 characters"),
])  # fmt: skip
def test_a_line_that_is_not_there(direct: str, words: tuple[str, ...], reason: str) -> None:
    connected, asked, _ = held([direct, *words], "connect_robot 1\ngs\n")
    assert (connected["return"], asked["return"]) == (0, 0)
    assert reason in connected["error"]


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
