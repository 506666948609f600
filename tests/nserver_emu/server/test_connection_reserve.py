"""Connections that do nothing cannot lock others out, and nothing runs out of descriptors."""

from __future__ import annotations

import asyncio
import errno
import socket
import subprocess
import sys
from dataclasses import dataclass, field

import pytest

from nclient import connect
from nserver_emu.server import admission, daemon
from nserver_emu.server.admission import (
    MIN_IDLE_S,
    MIN_RESERVED_S,
    RESERVED_CONNECTIONS,
    RESERVED_S,
    AcceptErrorHandler,
    AdmissionControl,
    ConnectionReserve,
    Limits,
    ReservableConnection,
)
from tests.nserver_emu.server.running_server import running_server


@dataclass
class Connection:
    """A connection of a given age."""

    host: str = "127.0.0.1"
    idle_s: float = 0.0
    opened_s: float = 0.0
    moves: bool = False
    reasons: list[str] = field(default_factory=list)

    def close_because(self, reason: str) -> None:
        self.reasons.append(reason)


def may_close(connection: ReservableConnection) -> bool:
    assert isinstance(connection, Connection)
    return not connection.moves


def reserve(connections: int = 3, per_address: int = 3) -> ConnectionReserve:
    # Three connections at most, or three from one address.
    return ConnectionReserve(AdmissionControl(Limits(connections=connections, per_address=per_address)), may_close)


def test_the_longest_idle_connection_makes_room() -> None:
    present = [Connection(idle_s=MIN_IDLE_S + age) for age in (1.0, 3.0, 2.0)]
    assert reserve().make_room("127.0.0.1", present, 100.0)
    assert [bool(one.reasons) for one in present] == [False, True, False]


def test_a_connection_that_moves_a_robot_stays() -> None:
    # The longest idle one moves a robot, so the next is closed.
    present = [Connection(idle_s=1000.0, moves=True), Connection(idle_s=MIN_IDLE_S), Connection()]
    assert reserve().make_room("127.0.0.1", present, 100.0)
    assert [bool(one.reasons) for one in present] == [False, True, False]


def test_one_address_makes_room_from_its_own_connections() -> None:
    # Limit of one address: only its own connections may be closed, not the longer idle one of another.
    present = [Connection("10.0.0.2", idle_s=1000.0), Connection(idle_s=MIN_IDLE_S), Connection()]
    assert reserve(connections=9, per_address=2).make_room("127.0.0.1", present, 100.0)
    assert [bool(one.reasons) for one in present] == [False, True, False]


def test_busy_connections_leave_the_reserve() -> None:
    # The limit is reached, and none of the connections is idle.
    present = [Connection(opened_s=float(number)) for number in range(3)]
    late = [Connection(opened_s=10.0 + number) for number in range(RESERVED_CONNECTIONS)]
    places = reserve()
    for number in range(RESERVED_CONNECTIONS):
        assert places.make_room("127.0.0.1", present + late[:number], 10.0 + number)
    # The oldest of the reserve gives way to the next, but not at once.
    assert places.make_room("127.0.0.1", present + late, late[0].opened_s + 1.1 * MIN_RESERVED_S)
    assert [bool(one.reasons) for one in present + late] == [False] * 3 + [True] + [False] * (len(late) - 1)
    assert not places.make_room("127.0.0.1", present + late, late[0].opened_s + 0.9 * MIN_RESERVED_S)


def test_places_of_the_reserve_are_for_a_short_time() -> None:
    # Four connections at a limit of three: the last one is in the reserve.
    present = [Connection(), Connection(opened_s=1.0), Connection(opened_s=2.0), Connection(opened_s=3.0)]
    places = reserve()
    places.check(present, 3.0 + 0.9 * RESERVED_S)
    assert not any(one.reasons for one in present)
    places.check(present, 3.0 + RESERVED_S)
    assert [bool(one.reasons) for one in present] == [False, False, False, True]
    # An idle connection is closed instead of the one in the reserve.
    present[1].idle_s = MIN_IDLE_S
    places.check([*present[:3], Connection(opened_s=4.0)], 6.0)
    assert present[1].reasons, "it is idle by now"
    present[1].reasons.clear()
    places.check(present[1:], 100.0)
    assert not any(one.reasons for one in present[1:3]), "there is room again"


@pytest.mark.long
async def test_a_stop_gets_through_300_idle_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission, "MIN_IDLE_S", 0.0)
    async with running_server() as server:
        # 30 connections of one address, the limit: the 31st takes the place of the longest idle one.
        server.daemon.admission.limits = Limits(per_address=30)
        driver = await server.connect_client()
        await driver.ask("vm", 0, 0, 100)
        idle = [await server.connect_client() for _ in range(29)]
        stop = await server.connect_client()
        assert (await stop.ask("st")).kind == "state"
        assert await idle[0].reader.read() == b""
        assert not (await driver.ask("get_rv")).slots[40]


async def test_a_stop_gets_through_busy_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    # The place is checked below instead of after a time, which a busy machine may spend elsewhere.
    monkeypatch.setattr(daemon, "RESERVED_S", 1000.0)
    monkeypatch.setattr(admission, "MIN_IDLE_S", 1000.0)
    async with running_server() as server:
        server.daemon.admission.limits = Limits(per_address=2)
        driver, _busy = await server.connect_client(), await server.connect_client()
        await driver.ask("vm", 0, 0, 100)
        stop = await server.connect_client()
        assert (await stop.ask("st")).kind == "state"
        assert not (await driver.ask("get_rv")).slots[40]
        now_s = asyncio.get_running_loop().time()
        server.daemon._reserve.check(server.daemon._tcp_connections(), now_s + RESERVED_S)
        assert await stop.reader.read() == b"", "its place was for a short time"


def test_without_descriptors_waiting_connections_are_closed(caplog: pytest.LogCaptureFixture) -> None:
    handler, loop = AcceptErrorHandler(), asyncio.new_event_loop()
    with socket.create_server(("127.0.0.1", 0)) as port:
        port.setblocking(False)
        clients = [socket.create_connection(port.getsockname()) for _ in range(3)]
        # The error that asyncio reports if accept() has no free descriptor; its spare descriptors must be used again
        # in the second round.
        error = OSError(errno.EMFILE, "Too many open files")
        for _ in range(2):
            handler(loop, {"message": "socket.accept() out of system resource", "exception": error, "socket": port})
        for client in clients:
            # An end of file: the connection was accepted and closed, so the client does not wait.
            with client:
                assert client.recv(1) == b""
    assert caplog.messages == ["no connection can be accepted for a second: Too many open files"] * 2
    handler.close()
    caplog.clear()
    handler(loop, {"message": "something else"})
    assert caplog.messages == ["something else"]
    handled: list[dict[str, object]] = []
    other = AcceptErrorHandler(lambda _loop, context: handled.append(context))
    other(loop, {"message": "for the program around it"})
    assert [context["message"] for context in handled] == ["for the program around it"]
    other.close()
    loop.close()


@pytest.mark.long
def test_64_descriptors_are_no_tracebacks() -> None:
    # 64 descriptors for the daemon, and 100 connections.
    command = ["sh", "-c", 'ulimit -n 64; exec "$0" -m nserver_emu --port 0', sys.executable]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        host, _, port = address.partition(":")
        sockets = [socket.create_connection((host, int(port)), timeout=20) for _ in range(100)]
        for one in sockets:
            one.close()
        with connect(f"nserver://{address}/1?tm_s=0") as robot:
            robot.refresh()
        process.terminate()
        _, log = process.communicate(timeout=60)
    assert "Traceback" not in log
    assert len(log.splitlines()) < 40
    assert process.returncode == 0
