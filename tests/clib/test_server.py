"""What a call gives with a server where all is not well, or not simple: refusals, silence, a server that has gone."""

from __future__ import annotations

import contextlib
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from answering import ScriptedServer, by_script, error, on_socket, simple
from building import NARROW_SANITIZED, PROGRAMS, SANITIZED, Kind, Workshop, held
from recorded import TCP

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply


@pytest.fixture(scope="module")
def client(workshop: Workshop) -> str:
    return str(workshop.program(PROGRAMS / "replay.c", SANITIZED))


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
    why = "not allowed by the setup or a limit, or another client drives the robot"
    assert refused["error"] == f"vm: refused with error 5, {why}"
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


def test_no_robot_is_made(client: str) -> None:
    server = ScriptedServer({"create_robot": simple(0)})
    with on_socket(by_script(server, 1)) as port:
        (created, *_) = held([client, str(port)], "create_robot 9\n")
    assert created["return"] == 0
    assert created["error"] == (
        "create_robot: the server makes no robot number 9: no room for one more, or no more are made (nserver -v)"
    )


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


NOBODY = "no robot is connected; connect_robot comes first"


def test_a_loop_that_asks_on_is_told_once_that_nobody_is_connected(client: str) -> None:
    server = ScriptedServer()
    with on_socket(by_script(server, 3)) as port:
        script = "vm 1 2 3\n", "connect_robot 1\n", "disconnect_robot 1\n", "gs\n" * 100, "st\n"
        before, _, left, *loop, after, said = held([client, str(port)], "".join(script))
    assert before["error"] == f"vm: {NOBODY}"
    assert left["return"] == 1
    assert {asked["error"] for asked in loop} == {f"gs: {NOBODY}"}
    assert {asked["return"] for asked in loop} == {0}
    assert after["error"] == f"st: {NOBODY}"
    assert said["stderr"] == f"Nclient: vm: {NOBODY}\nNclient: gs: {NOBODY}\n"


def test_a_server_that_has_gone_is_told_of_in_two_lines(client: str) -> None:
    with on_socket(by_script(ScriptedServer(), 2)) as port:
        *_, said = held([client, str(port)], "connect_robot 1\n" + "gs\n" * 50)
    gone = "gs: the server has gone; the connection is closed"
    assert said["stderr"] == f"Nclient: {gone}\nNclient: gs: {NOBODY}\n"


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


@pytest.mark.parametrize("call", ["connect_robot", "create_robot"])
def test_the_robot_that_an_address_names_is_the_programs_or_none_is_moved(
    client: str, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{nobody.getsockname()[1]}/2")
        refused, running, _ = held([client], f"{call} 1\nserver_is_running\n")
        nobody.settimeout(10)
        nobody.accept()[0].close()  # who only looked
        nobody.settimeout(0)
        with pytest.raises(BlockingIOError):
            nobody.accept()
    assert (refused["return"], running["return"]) == (0, 1)
    assert refused["error"] == ("NOMAD_ROBOT names robot 2, the program asks for robot 1: let both say the same, or "
                                "leave the number out of the address")  # fmt: skip
    for path in ("/2", "/2/", "/", ""):
        server = ScriptedServer()
        with on_socket(by_script(server, 2)) as port:
            monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}{path}")
            assert held([client], f"{call} 2\n")[0]["return"] == 7019
        assert server.calls[0].args[0] == 2


@pytest.mark.parametrize(("address", "reason"), [
    ("lab:7019", "no address such as nserver://host:7019/1"),
    ("serial:///dev/ttyUSB0", "link it with -lndirect"),
    ("nserver://127.0.0.1:1/1?color=red", "color=red is no option"),
    ("nserver://127.0.0.1:1/1?model=n300", "model=n300 is no option"),
    ("nserver://[::1]:1/1", "nobody answers at ::1:1"),
    ("nserver://" + "x" * 120, "longer than the name of a machine"),
    ("nserver://127.0.0.1:1/one", "the robot's number, 1 or more, not /one"),
    ("nserver://127.0.0.1:1/0", "the robot's number, 1 or more, not /0"),
    ("nserver://127.0.0.1:1/1/2", "the robot's number, 1 or more, not /1/2"),
    ("nserver://127.0.0.1:1/99999999999", "the robot's number, 1 or more, not /99999999999"),
    ("nserver://no.such.host.invalid/1", "there is no host no.such.host.invalid"),
])  # fmt: skip
def test_an_address_that_leads_nowhere(client: str, monkeypatch: pytest.MonkeyPatch, address: str, reason: str) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", address)
    found, _ = held([client], "connect_robot 1\n")
    assert found["return"] == 0
    assert reason in found["error"]


@pytest.mark.usefixtures("can_build")
@pytest.mark.parametrize("width", [SANITIZED, NARROW_SANITIZED], ids=lambda kind: kind.name)
def test_a_port_that_is_none_is_not_taken_for_another(
    workshop: Workshop, width: Kind, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source = tmp_path / "machine.c"
    source.write_text("""\
#include "Nclient.h"
#include <stdlib.h>
#include <string.h>
int main(int count, char **words)
{
    if (count > 1)
        strcpy(SERVER_MACHINE_NAME, words[1]);
    if (count > 2)
        SERV_TCP_PORT = atoi(words[2]);
    return server_is_running() || connect_robot(1) ? 0 : 9;
}
""")
    program = str(workshop.program(source, width))

    def refused(*words: str) -> str:
        done = subprocess.run([program, *words], capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 9
        return done.stderr

    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        wrapped = port + 65536
        why = f"a port is 1 to 65535, not {wrapped}\n"
        assert refused(f"127.0.0.1:{wrapped}") == f"Nclient: 127.0.0.1:{wrapped}: {why}"
        assert refused("127.0.0.1", str(wrapped)) == f"Nclient: 127.0.0.1: {why}"
        assert refused("", str(wrapped)).endswith(why)
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{wrapped}/1")
        assert refused() == f"Nclient: 127.0.0.1:{wrapped}: {why}"
        for none in ("70x9", "0", "-1", f"+{port}", "99999999999999999999"):
            assert refused(f"127.0.0.1:{none}").endswith(f"a port is 1 to 65535, not {none}\n")
            assert refused(f"[::1]:{none}").endswith(f"a port is 1 to 65535, not {none}\n")
        assert refused("127.0.0.1", "0").endswith("not 0\n")
        assert refused("127.0.0.1", "-58517").endswith("not -58517\n")


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
