"""Calls to a server under faults: error replies, time-outs, closed connections, invalid addresses."""

from __future__ import annotations

import contextlib
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply, text_values
from tests.clib.clib_build import NARROW_SANITIZED, PROGRAMS, SANITIZED, BuildCache, BuildKind, run_calls
from tests.nclient.protocol.recorded import TCP
from tests.nclient.scripted_server import ScriptedServer, by_script, error, on_socket, simple


@pytest.fixture(scope="module")
def client(builds: BuildCache) -> str:
    return str(builds.program(PROGRAMS / "replay.c", SANITIZED))


def calls_with_server(client: str, server: ScriptedServer, request_count: int, *calls: str) -> list[dict[str, Any]]:
    """Connect, make the calls, and return the state after each; the server receives `request_count` of the calls."""
    # connect_robot and ct, and then the calls.
    with on_socket(by_script(server, 2 + request_count)) as port:
        *found, _ = run_calls([client, str(port)], "\n".join(("connect_robot 1", *calls, "")))
    assert found[0]["return"] == 7019
    after: list[dict[str, Any]] = found[1:]
    return after


def test_error_reply_returns_zero_and_sets_state_44(client: str) -> None:
    server = ScriptedServer({"vm": error(5)})
    server.slots = {0: 10, 17: 80}
    refused, fine = calls_with_server(client, server, 2, "vm 1 2 3", "gs")
    assert (refused["return"], refused["State"][44], refused["State"][17]) == (0, 5, 80)
    why = "not allowed by the setup or a limit, or another client drives the robot"
    assert refused["error"] == f"vm: error 5, {why}"
    assert (fine["return"], fine["State"][44]) == (1, 0)


@pytest.mark.parametrize(("call", "reason"), [
    ("mv 6 0 0 0 0 0", "modes 6, 7 and 8"),
    ("mv 0 0 7 0 0 0", "modes 6, 7 and 8"),
    ("mv 0 0 0 0 8 0", "modes 6, 7 and 8"),
    ("pa 1 2 3", "robot's own line"),
    ("conf_ser 1 9600", "robot's own line"),
    ("mask 32", "not a sum of 1, 2, 4, 8, 16"),
    ("posDataRequest -1", "not a sum of 1, 2, 4, 8, 16"),
    ("tk " + "x" * 256, "at most 255"),
    ("add_obstacle 0", "1 to 10 vertices"),
    ("move_obstacle 11 0 0", "1 to 10 vertices"),
])  # fmt: skip
def test_invalid_calls_are_not_sent(client: str, call: str, reason: str) -> None:
    server = ScriptedServer()
    (found,) = calls_with_server(client, server, 0, call)
    assert found["return"] == 0
    assert reason in found["error"]
    assert server.names() == []


def test_unknown_robot(client: str) -> None:
    server = ScriptedServer({"connect_robot": simple(0)})
    with on_socket(by_script(server, 1)) as port:
        connected, queried, left, _ = run_calls([client, str(port)], "connect_robot 9\ngs\ndisconnect_robot 9\n")
    assert [connected["return"], queried["return"], left["return"]] == [0, 0, 0]
    assert connected["error"] == "connect_robot: the server has no robot number 9"
    assert queried["error"] == "gs: no robot is connected; call connect_robot first"


def test_robot_cannot_be_created(client: str) -> None:
    server = ScriptedServer({"create_robot": simple(0)})
    with on_socket(by_script(server, 1)) as port:
        (created, *_) = run_calls([client, str(port)], "create_robot 9\n")
    assert created["return"] == 0
    assert created["error"] == (
        "create_robot: the server cannot create robot number 9: no free space, or the number of robots is limited "
        "(see nserver -v)"
    )


@pytest.mark.usefixtures("short_timeout")
def test_silent_server_is_disconnected(client: str) -> None:
    server = ScriptedServer({"gs": None})

    def talk(connection: socket.socket) -> None:
        by_script(server, 3)(connection)
        # The client closes the connection without another request.
        assert connection.recv(1) == b""

    with on_socket(talk) as port:
        _, silent, after, _ = run_calls([client, str(port)], "connect_robot 1\ngs\nst\n")
    assert (silent["return"], after["return"]) == (0, 0)
    assert silent["error"] == "gs: no reply in time; the connection is closed"


def test_server_closes_connection(client: str) -> None:
    closed, after = calls_with_server(client, ScriptedServer(), 0, "gs", "st")
    assert closed["return"] == after["return"] == 0
    assert closed["error"] == "gs: the server closed the connection; the connection is closed"
    assert after["error"] == "st: no robot is connected; call connect_robot first"


NOT_CONNECTED = "no robot is connected; call connect_robot first"


def test_missing_connection_is_printed_once(client: str) -> None:
    server = ScriptedServer()
    with on_socket(by_script(server, 3)) as port:
        script = "vm 1 2 3\n", "connect_robot 1\n", "disconnect_robot 1\n", "gs\n" * 100, "st\n"
        before, _, left, *loop, after, last = run_calls([client, str(port)], "".join(script))
    assert before["error"] == f"vm: {NOT_CONNECTED}"
    assert left["return"] == 1
    assert {queried["error"] for queried in loop} == {f"gs: {NOT_CONNECTED}"}
    assert {queried["return"] for queried in loop} == {0}
    assert after["error"] == f"st: {NOT_CONNECTED}"
    assert last["stderr"] == f"Nclient: vm: {NOT_CONNECTED}\nNclient: gs: {NOT_CONNECTED}\n"


def test_lost_connection_prints_two_lines(client: str) -> None:
    with on_socket(by_script(ScriptedServer(), 2)) as port:
        *_, last = run_calls([client, str(port)], "connect_robot 1\n" + "gs\n" * 50)
    closed = "gs: the server closed the connection; the connection is closed"
    assert last["stderr"] == f"Nclient: {closed}\nNclient: gs: {NOT_CONNECTED}\n"


# Types 91 and 82 without words; a state of one word; a state of 65535 words.
@pytest.mark.parametrize("reply", ["005b0000", "00500001000000ff", "0050ffff", "00520000"])
def test_invalid_reply_closes_connection(client: str, reply: str) -> None:
    mismatches, after = calls_with_server(client, ScriptedServer({"gs": bytes.fromhex(reply)}), 1, "gs", "st")
    assert (mismatches["return"], after["return"]) == (0, 0)
    assert mismatches["error"].endswith("; the connection is closed")


def test_reply_arriving_byte_by_byte(client: str) -> None:
    case = TCP["session_1"][0]

    def dribble(connection: socket.socket) -> None:
        # Without TCP_NODELAY the kernel would join the bytes.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for exchange in case["exchanges"]:
            connection.recv(4096)
            for byte in bytes.fromhex(exchange["reply"]):
                connection.sendall(bytes((byte,)))

    with on_socket(dribble) as port:
        found, _ = run_calls([client, str(port)], "connect_robot 1\n")
    assert (found["return"], found["State"]) == (7019, case["decoded"]["State"])


def test_lists_are_limited_to_array_sizes(client: str) -> None:
    # 300 lines of four numbers: more than the 964 numbers of the array after the count.
    lines = (300, *range(1200))
    server = ScriptedServer({
        "get_rpx": simple(12, *range(36)), "get_sg": Reply("laser", laser=lines),
        "move_obstacle": simple(2, 1, 2, 3, 4),
    })  # fmt: skip
    robots, segments, moved = calls_with_server(
        client, server, 3, "get_rpx", "get_sg", "move_obstacle 3 0 0 50 0 0 50 10 -20")
    # The C arrays hold 10 robots, and 241 lines (964 / 4).
    assert robots["obs"] == [10, *range(30)]
    assert segments["Laser"] == [241, *range(6)]
    assert (moved["return"], moved["obs"][0]) == (0, 3)
    assert "counts 2" in moved["error"]


def test_long_is_clamped_to_word(client: str) -> None:
    server = ScriptedServer({"move_obstacle": simple(1, 5, 6)})
    # A long of 64 bits is clamped to the word of 32 bits.
    (found,) = calls_with_server(client, server, 1, f"move_obstacle 1 7 8 {1 << 40} {-(1 << 40)}")
    assert server.last() == Call("move_obstacle", (1, 7, 8, 2**31 - 1, -(2**31)))
    assert (found["return"], found["obs"][:3]) == (1, [1, 5, 6])


def test_simulator_and_scout_calls(client: str) -> None:
    server = ScriptedServer({"sim_truth": Reply("truth", values=(1, 500, -2, 3, 4, 5, 6, 7))})
    truth, control, wheels, moved = calls_with_server(
        client, server, 4, "sim_truth", "sim_control 3 100", "scout_vm 100 -450", "scout_pr 0 450")
    assert truth["obs"][:8] == [1, 500, -2, 3, 4, 5, 6, 7]
    assert control["return"] == wheels["return"] == moved["return"] == 1
    assert server.calls[3:] == [Call("sim_control", (3, 100)), Call("vm", (47, 153, 0)), Call("pr", (53, -53, 0))]


def test_held_robot_is_error_7_and_printed_once(client: str) -> None:
    # Error 7: a person holds the robot, which the client reports once for all calls during the hold.
    server = ScriptedServer({"vm": error(7), "pr": error(7), "held_by": simple(*text_values("viewer 1"))})
    script = "connect_robot 1\nvm 1 2 3\nvm 1 2 3\npr 1 2 3\ngs\nheld_by\n"
    with on_socket(by_script(server, 7)) as port:
        _, refused, *more, state, name, last = run_calls([client, str(port)], script)
    assert last["stderr"].count("error 7") == 1
    assert [found["return"] for found in (refused, *more, state)] == [0, 0, 0, 1]
    assert [found["State"][44] for found in (refused, *more, state)] == [7, 7, 7, 0]
    assert "release" in refused["error"]
    assert bytes(name["obs"]).rstrip(b"\0") == b"viewer 1"


def test_each_hold_is_printed_once(client: str) -> None:
    held, free = [ScriptedServer().state()._replace(slots={0: 10, 44: word}) for word in (7, 0)]
    server = ScriptedServer({"vm": error(7), "st": held, "gs": free})
    # A stop succeeds during a hold; a state without the mark ends it.
    script = "connect_robot 1\nvm 1 2 3\nst\nvm 1 2 3\ngs\nvm 1 2 3\n"
    with on_socket(by_script(server, 7)) as port:
        *_, last = run_calls([client, str(port)], script)
    assert last["stderr"].count("error 7") == 2


def test_server_from_environment(client: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with on_socket(by_script(ScriptedServer(), 2)) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}/1?model=n150")
        found, _ = run_calls([client], "create_robot 1\n")
        assert found["return"] == 7019


@pytest.mark.parametrize("call", ["connect_robot", "create_robot"])
def test_robot_number_in_address_must_match(
    client: str, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{listener.getsockname()[1]}/2")
        refused, running, _ = run_calls([client], f"{call} 1\nserver_is_running\n")
        listener.settimeout(0)
        with pytest.raises(BlockingIOError):
            # The number is checked before the connection is made.
            listener.accept()
    assert (refused["return"], running["return"]) == (0, 0)
    assert refused["error"] == ("NOMAD_ROBOT names robot 2, the program connects to robot 1: use the same number, or "
                                "leave it out of the address")  # fmt: skip
    for path in ("/2", "/2/", "/", ""):
        server = ScriptedServer()
        with on_socket(by_script(server, 2)) as port:
            monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}{path}")
            assert run_calls([client], f"{call} 2\n")[0]["return"] == 7019
        assert server.calls[0].args[0] == 2


@pytest.mark.parametrize(("address", "reason"), [
    ("lab:7019", "not an address such as nserver://host:7019/1"),
    ("serial:///dev/ttyUSB0", "link it with -lndirect"),
    ("nserver://127.0.0.1:1/1?color=red", "unknown option or value color=red"),
    ("nserver://127.0.0.1:1/1?model=n300", "unknown option or value model=n300"),
    ("nserver://[::1]:1/1", "cannot connect to ::1:1"),
    ("nserver://" + "x" * 120, "longer than a host name"),
    ("nserver://127.0.0.1:1/one", "only a robot number, 1 or more, may follow the host, not /one"),
    ("nserver://127.0.0.1:1/0", "only a robot number, 1 or more, may follow the host, not /0"),
    ("nserver://127.0.0.1:1/1/2", "only a robot number, 1 or more, may follow the host, not /1/2"),
    ("nserver://127.0.0.1:1/99999999999", "only a robot number, 1 or more, may follow the host, not /99999999999"),
    ("nserver://no.such.host.invalid/1", "unknown host no.such.host.invalid"),
])  # fmt: skip
def test_address_errors(client: str, monkeypatch: pytest.MonkeyPatch, address: str, reason: str) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", address)
    found, _ = run_calls([client], "connect_robot 1\n")
    assert found["return"] == 0
    assert reason in found["error"]


@pytest.mark.usefixtures("skip_unbuildable")
@pytest.mark.parametrize("width", [SANITIZED, NARROW_SANITIZED], ids=lambda kind: kind.name)
def test_invalid_port_is_rejected(
    builds: BuildCache, width: BuildKind, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
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
    program = str(builds.program(source, width))

    def refused(*words: str) -> str:
        done = subprocess.run([program, *words], capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 9
        return done.stderr

    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        # As an int16 the port plus 65536 would be the listening port: it must not be accepted.
        wrapped = port + 65536
        why = f"the port must be 1 to 65535, not {wrapped}\n"
        assert refused(f"127.0.0.1:{wrapped}") == 2 * f"Nclient: 127.0.0.1:{wrapped}: {why}"
        assert refused("127.0.0.1", str(wrapped)) == 2 * f"Nclient: 127.0.0.1: {why}"
        assert refused("", str(wrapped)).endswith(why)
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{wrapped}/1")
        assert refused() == 2 * f"Nclient: 127.0.0.1:{wrapped}: {why}"
        for none in ("70x9", "0", "-1", f"+{port}", "99999999999999999999"):
            assert refused(f"127.0.0.1:{none}").endswith(f"the port must be 1 to 65535, not {none}\n")
            assert refused(f"[::1]:{none}").endswith(f"the port must be 1 to 65535, not {none}\n")
        assert refused("127.0.0.1", "0").endswith("not 0\n")
        # -58517 + 65536 = 7019.
        assert refused("127.0.0.1", "-58517").endswith("not -58517\n")


def test_server_is_running_connects_to_robot_1(client: str) -> None:
    server = ScriptedServer()
    with on_socket(by_script(server, 3)) as port:
        running, queried, _ = run_calls([client, str(port)], "server_is_running\ngs\n")
    assert (running["return"], queried["return"]) == (7019, 1)
    assert [(call.name, call.args[0]) for call in server.calls[:2]] == [("connect_robot", 1), ("ct", 0)]
    assert run_calls([client, str(port)], "server_is_running\n")[0]["return"] == 0


SIMPLE_CALLS = ["tk hello", "real_robot", "simulated_robot", "place_robot 1 2 3 4", "add_obstacle 3 0 0 9 0 0 9",
                "delete_obstacle 3 0 0 9 0 0 9", "new_world", "draw_line 1 2 3 4 5", "refresh_all",
                "quit_server"]  # fmt: skip


@pytest.mark.parametrize("call", SIMPLE_CALLS)
# Calls with a simple reply return 1 and leave State[44] alone, as in the old library.
def test_refused_call_without_values_succeeds(client: str, call: str) -> None:
    server = ScriptedServer({call.split()[0]: error(5), "vm": error(2)})
    _, refused = calls_with_server(client, server, 2, "vm 1 2 3", call)
    assert (refused["return"], refused["State"][44]) == (1, 2)
    assert "error 5" in refused["error"]


# 111 is ECONNREFUSED on Linux, as in the old library.
def test_state_44_is_111_without_server(client: str) -> None:
    found, *_ = run_calls([client, "1"], "connect_robot 1\n")
    assert (found["return"], found["State"][44]) == (0, 111)
    (found, *_) = run_calls([client, "1"], "gs\n")
    assert (found["return"], found["State"][44]) == (0, 111)
    closed, simple_call = calls_with_server(client, ScriptedServer(), 0, "gs", "tk hello")
    assert (closed["State"][44], simple_call["return"], simple_call["State"][44]) == (111, 0, 111)


def test_failed_connect_keeps_connection(client: str) -> None:
    server, other = ScriptedServer(), ScriptedServer({"connect_robot": simple(0)})
    found = in_turn(client, [(server, 3), (other, 1)], "connect_robot 1", "connect_robot 5", "gs")
    assert [after["return"] for after in found] == [7019, 0, 1]
    assert (server.names(), other.calls[0].args[0]) == (["gs"], 5)


def test_create_robot_leaves_state(client: str) -> None:
    first, second = ScriptedServer(), ScriptedServer()
    first.slots, second.slots = {34: 111}, {34: 222}
    _, created, queried = in_turn(client, [(first, 3), (second, 3)], "connect_robot 1", "create_robot 2", "gs")
    assert (created["return"], created["State"][34], queried["State"][34]) == (7019, 111, 222)
    assert first.names() == ["disconnect_robot"]


def in_turn(client: str, servers: list[tuple[ScriptedServer, int]], *calls: str) -> list[dict[str, Any]]:
    """Make calls over several connections that stay open, one for each server; return the states."""
    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(len(servers) + 1) as threads:

        def serve(connection: socket.socket, server: ScriptedServer, count: int) -> None:
            with connection:
                # The connection stays open until the client closes it.
                by_script(server, count)(connection)
                connection.recv(1)

        def accept() -> None:
            for served in [threads.submit(serve, listener.accept()[0], *each) for each in servers]:
                served.result(10)

        serving = threads.submit(accept)
        *found, _ = run_calls([client, str(listener.getsockname()[1])], "\n".join((*calls, "")))
        serving.result(10)
    return found


def test_edges(builds: BuildCache) -> None:
    program = builds.program(PROGRAMS / "edges.c", SANITIZED)
    # A server for each connection: what closes the first may arrive after the first request of the second.
    servers = [ScriptedServer({"special_request": Reply("special", values=(4, 0, 0, 200))}) for _ in range(2)]

    def one_client(connection: socket.socket, server: ScriptedServer) -> None:
        with connection:
            by_script(server, 100)(connection)

    def two_clients() -> None:
        with ThreadPoolExecutor(2) as each:
            for served in [each.submit(one_client, listener.accept()[0], server) for server in servers]:
                served.result(10)

    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as thread:
        serving = thread.submit(two_clients)
        port = str(listener.getsockname()[1])
        done = subprocess.run([str(program), port], capture_output=True, text=True, timeout=60, check=False)
        serving.result(10)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert sum(len(server.calls) for server in servers) == 11
    checks = [call for call in servers[1].calls if call.name == "motion_check"]
    # Thousandths, truncated toward zero to hundredths, and clamped to 32 bits: 2147483647 hundredths.
    assert checks[0].args == (0, -12340, 290, 21474836470, -21474836470)
    assert checks[1].args[:5] == (1, -21474836470, 21474836470, 1570, -3140)


@pytest.mark.usefixtures("short_timeout")
def test_connection_not_accepted_times_out(client: str) -> None:
    with socket.socket() as full, contextlib.ExitStack() as waiting:
        # A queue of one connection: later ones are neither accepted nor rejected.
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        for _ in range(3):  # further connections are neither accepted nor rejected
            first = waiting.enter_context(socket.socket())
            first.setblocking(False)
            first.connect_ex(full.getsockname())
        found, _ = run_calls([client, str(full.getsockname()[1])], "connect_robot 1\n")
    assert found["return"] == 0
    assert "Connection timed out" in found["error"]
