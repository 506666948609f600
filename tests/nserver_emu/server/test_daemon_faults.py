"""A fault plan in a daemon, on real sockets: late replies keep their order and stall no other client."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from nclient.faults.plan import Corrupt, Delay, Direction, Drop, Nak, Plan, Rule, When
from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import Call
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.running_server import serving
from tests.nserver_emu.server.wire_client import ORIGIN, simulation
from worlds.io import load_world

REQUEST = frozenset({Direction.REQUEST})


class Client:
    """A plain client, 32-bit or 64-bit, that may ask many things at once."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, wide: bool) -> None:
        self._reader, self._writer, self._wide = reader, writer, wide
        self._framer = TcpFramer(reply_bounds, wide=wide)
        self._frames: list[TcpFrame] = []

    def send(self, *calls: Call) -> None:
        self._writer.write(b"".join(codec.encode_tcp_request(call, wide=self._wide) for call in calls))

    async def types(self, count: int) -> list[int]:
        while len(self._frames) < count:
            data = await self._reader.read(65536)
            assert data, "the daemon closed the connection"
            self._frames += [frame for frame in self._framer.receive(data) if isinstance(frame, TcpFrame)]
        found, self._frames = self._frames[:count], self._frames[count:]
        return [frame.type for frame in found]

    async def close(self) -> None:
        self._writer.close()
        await self._writer.wait_closed()


@contextlib.asynccontextmanager
async def faulty_daemon(
    plan: Plan | None, world: Simulation | None = None
) -> AsyncIterator[tuple[Daemon, Callable[..., Awaitable[Client]]]]:
    """Serve with a fault plan; yield the daemon and a function that opens a connected client."""
    daemon = Daemon(Emulator(world or simulation()))
    port = await daemon.listen("127.0.0.1", 0)
    if plan is not None:
        daemon.faults.put(plan, daemon.lines())
    clients: list[Client] = []

    async def open_client(wide: bool = False) -> Client:
        clients.append(Client(*await asyncio.open_connection("127.0.0.1", port), wide))
        clients[-1].send(Call("connect_robot", (1, 7)))
        assert await clients[-1].types(1) == [82]
        return clients[-1]

    try:
        async with serving(daemon):
            yield daemon, open_client
    finally:
        for client in clients:
            await client.close()


@pytest.mark.long
async def test_delayed_replies_stay_complete_and_in_order() -> None:
    # More replies than the channel holds (16 KB), each delayed by 0.3 s.
    late, count = Plan((Rule("late", (Delay(0.3),), commands=("gs", "get_rc")),)), 1200
    async with faulty_daemon(late) as (daemon, open_client):
        flooding, other = await open_client(), await open_client()
        flooding.send(*[Call("gs"), Call("get_rc")] * count)
        other.send(Call("st"))
        assert await other.types(1) == [80]
        # 80 state, 88 configuration: in the order of the requests.
        assert await flooding.types(2 * count) == [80, 88] * count
        assert daemon.faults.counts()["nserver"]["late"] == {"seen": 2 * count, "delay": 2 * count}


async def test_a_briefly_full_channel_does_not_suspend_reading() -> None:
    """Twenty answers with a laser's columns exceed the transit limit, and none is late."""
    plan = Plan((Rule("late", (Delay(0.01),), commands=("get_rc",)),))
    # 482 points of two words each make a reply of some 4 KB: twenty exceed the 16 KB of a channel.
    laser = Simulation(load_world("thesis_room"))
    laser.add_robot(1, ORIGIN, N200)
    async with faulty_daemon(plan, laser) as (daemon, open_client):
        client = await open_client()
        client.send(*[Call("gs")] * 20)
        assert await client.types(20) == [80] * 20
        client.send(Call("st"))
        assert await client.types(1) == [80]
        await client.close()
        while daemon.connections:
            await asyncio.sleep(0.005)


@pytest.mark.parametrize("wide", [False, True])
async def test_a_client_of_any_width_is_refused_and_goes_on(wide: bool) -> None:
    # Every second vm is answered by an error of the fault injector; the session itself refuses none.
    plan = Plan((Rule("no", (Nak(),), When(every=2), ("vm",), REQUEST),))
    async with faulty_daemon(plan) as (daemon, open_client):
        client = await open_client(wide)
        for answer in (80, 91, 80, 91):
            client.send(Call("vm", (1, 2, 3)))
            assert await client.types(1) == [answer]
        client.send(Call("get_rc"))
        assert await client.types(1) == [88]
        assert [client["refused"] for client in daemon.connected_clients()] == [0]


@pytest.mark.parametrize("wide", [False, True])
async def test_a_plan_comes_and_goes_under_a_connection(wide: bool) -> None:
    plan = Plan((Rule("lost", (Drop(),), commands=("get_rc",)),))
    async with faulty_daemon(None) as (daemon, open_client):
        client = await open_client(wide)
        # Clearing the plan under an open connection takes effect with the next request.
        for in_force, answered in ((False, [88, 80]), (True, [80]), (False, [88, 80]), (True, [80])):
            if in_force:
                daemon.faults.put(plan, daemon.lines())
            else:
                daemon.faults.clear()
            client.send(Call("get_rc"), Call("gs"))
            assert await client.types(len(answered)) == answered


async def test_a_corrupted_type_is_refused_by_the_session_itself() -> None:
    # Byte 0 is the high byte of the type: the message is then of an unknown type.
    plan = Plan((Rule("odd", (Corrupt(place=0),), When(at=(1,)), ("gs",), REQUEST),))
    async with faulty_daemon(plan) as (_, open_client):
        client = await open_client()
        client.send(Call("gs"), Call("gs"))
        assert await client.types(2) == [91, 80]
