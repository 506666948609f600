"""The table of limits, its options and its page; and each limit on a real socket: the one over it, and the others."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import socket
import struct
import time
from collections import Counter
from collections.abc import AsyncIterator
from dataclasses import replace
from ipaddress import ip_network
from pathlib import Path

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import BY_TCP_TYPE, Call
from nclient.transports.listener import Allowlist
from nserver_emu import cli
from nserver_emu.logs import MAX_REPEATS, RepeatLimiter
from nserver_emu.server.admission import TABLE, AdmissionControl, Limits, add_options, limits_of
from nserver_emu.server.connection import MAX_REQUESTS_PER_TURN
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed
from tests.nserver_emu.server.running_server import Client, RunningServer, running_server
from tests.nserver_emu.server.wire_client import simulation

ROOT = Path(__file__).parents[3]
GS = codec.encode_tcp_request(Call("gs"))
# A square of 10 in beside the robot at the origin: the number of corners, then their coordinates in tenths.
BOX = (4, 100, 100, 200, 100, 200, 200, 100, 200)


@contextlib.asynccontextmanager
async def limited_server(limits: Limits, emulator: Emulator | None = None) -> AsyncIterator[RunningServer]:
    """Run a server with these limits."""
    async with running_server(emulator=emulator) as server:
        server.daemon.admission.limits = limits
        yield server


async def is_closed(client: Client) -> bool:
    """Return True if the daemon closes the connection in time."""
    try:
        while data := await asyncio.wait_for(client.reader.read(65536), 30):
            assert data
    except ConnectionError:
        pass
    return True


def parsed(*words: str) -> Limits:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return limits_of(parser.parse_args(words))



def test_every_limit_is_a_row_with_an_enforcer_that_is_there() -> None:
    assert {row.name: row.default for row in TABLE} == {row.name: getattr(Limits(), row.name) for row in TABLE}
    for row in TABLE:
        assert row.min <= row.default <= row.max
        base = ROOT if row.where.startswith("nclient") else ROOT / "nserver_emu"
        assert (base / row.where).is_file(), row.where


@pytest.mark.long
@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_every_limit_has_an_option(row: object, capsys: pytest.CaptureFixture[str]) -> None:
    (limit,) = (one for one in TABLE if one is row)
    assert parsed() == Limits()
    assert parsed(limit.option, str(limit.min)) == replace(Limits(), **{limit.name: limit.min})
    assert limit.option in cli.whole_parser().format_help()
    # Above the maximum, negative, no number; 0 only where it means "no limit".
    for wrong in (str(limit.max + 1), "-1", "many", *(() if limit.may_be_none else ("0",))):
        with pytest.raises(SystemExit):
            parsed(f"{limit.option}={wrong}")
        assert f"{limit.min} to {limit.max}" in capsys.readouterr().err
    if limit.may_be_none:
        assert getattr(parsed(limit.option, "0"), limit.name) == 0


def test_the_longest_frame_is_the_tables() -> None:
    rows = BY_TCP_TYPE.values()
    (frame,) = (row for row in TABLE if row.name == "frame")
    assert frame.default == frame.max == max(row.tcp_words[1] for row in rows)
    assert frame.min == max(row.tcp_words[0] for row in rows)


@pytest.mark.parametrize("limits", [Limits(connections=2), Limits(per_address=2)], ids=["connections", "per address"])
async def test_one_connection_too_many_is_closed_and_the_others_go_on(limits: Limits) -> None:
    async with limited_server(limits) as server:
        first, second = await server.connect_client(), await server.connect_client()
        assert await is_closed(await server.open_client())
        assert server.daemon.admission.rejected == 1
        for client in (first, second):
            assert (await client.ask("gs")).kind == "state"
        # A closed connection makes room for another.
        second.writer.close()
        while len(server.daemon.connections) == 2:
            await asyncio.sleep(0.005)
        assert (await (await server.connect_client()).ask("gs")).kind == "state"


def test_from_another_address_there_is_room() -> None:
    door = AdmissionControl(Limits(per_address=1, connections=2))
    assert "from there" in door.rejection_reason("10.0.0.1", ["10.0.0.1"])
    assert not door.rejection_reason("10.0.0.2", ["10.0.0.1"])
    assert "--limit-connections" in door.rejection_reason("10.0.0.2", ["10.0.0.1", "10.0.0.3"])


def test_rejections_are_logged_per_address_and_then_counted(caplog: pytest.LogCaptureFixture) -> None:
    door = AdmissionControl(access=Allowlist(()))
    assert not door.rejection_reason("10.0.0.1", [])
    fenced = AdmissionControl(access=Allowlist((ip_network("10.9.9.0/24"),)))
    assert "--allow" in fenced.rejection_reason("10.0.0.1", [], "10.0.0.2")
    assert not fenced.rejection_reason("10.0.0.1", [], "10.0.0.1")
    for host in ("10.0.0.1", "10.0.0.2"):
        # One more than the log accepts per address; the rest is only counted.
        for _ in range(MAX_REPEATS + 1):
            door.reject(host, "because")
    written = filter(RepeatLimiter(), caplog.records)
    assert Counter(record.getMessage()[:8] for record in written) == {"10.0.0.1": MAX_REPEATS, "10.0.0.2": MAX_REPEATS}
    assert door.rejected == 2 * MAX_REPEATS + 2


@pytest.mark.long
async def test_a_fast_client_is_slowed_without_loss() -> None:
    async with limited_server(Limits(rate=200)) as server:
        fast, other = await server.connect_client(), await server.connect_client()
        count, began = 60 + MAX_REQUESTS_PER_TURN, time.monotonic()
        fast.writer.write(GS * count)
        assert (await other.ask("gs")).kind == "state"
        for _ in range(count):
            assert (await fast.reply("gs")).kind == "state"
        # 20 at once, one more for CONNECT, then 200 a second.
        assert time.monotonic() - began >= 0.2


async def test_a_fast_client_without_pipelining_is_slowed() -> None:
    async with limited_server(Limits(rate=200)) as server:
        fast, began = await server.connect_client(), time.monotonic()
        for _ in range(60):
            assert (await fast.ask("gs")).kind == "state"
        # 20 at once, one of them CONNECT, then 200 a second.
        assert time.monotonic() - began >= 0.15


async def test_a_request_that_is_too_long_is_refused_and_passed_over() -> None:
    async with limited_server(Limits(), Emulator(simulation(), allowed=Allowed(frame=17))) as server:
        client = await server.connect_client()
        assert (await client.ask("add_obstacle", *BOX)).kind == "simple"
        # 21 words, above the limit of 17: refused with error 2, and skipped whole.
        long = (10, *(number for corner in range(10) for number in (corner * 10, 2000 + corner**2)))
        assert (await client.ask("add_obstacle", *long)).values == (2,)
        assert (await client.ask("gs")).kind == "state"


async def test_only_idle_connections_are_closed(caplog: pytest.LogCaptureFixture) -> None:
    async with limited_server(Limits(idle=2)) as server:
        # `waiting` sends nothing either, but has a reply outstanding: that is not idle.
        silent, active, waiting = [await server.connect_client() for _ in range(3)]
        await waiting.ask("vm", 10, 0, 0)
        waiting.writer.write(codec.encode_tcp_request(Call("ws", (1, 1, 1, 200))))
        while not any(one.session.waiting for one in server.daemon.connections):
            await asyncio.sleep(0.01)
        closed = asyncio.create_task(is_closed(silent))
        while not closed.done():
            await active.ask("gs")
            await asyncio.sleep(0.01)
        assert len(server.daemon.connections) == 2
        assert (await active.ask("gs")).kind == "state"
    assert "idle for 2 s" in caplog.text


@pytest.mark.long
async def test_a_stalled_request_is_closed_despite_single_bytes() -> None:
    async with limited_server(Limits(stall=1)) as server:
        stalled, other = await server.connect_client(), await server.connect_client()
        await stalled.ask("vm", 100, 0, 0)
        closed = asyncio.create_task(is_closed(stalled))
        # vm has 16 bytes: with one byte in 0.15 s it is incomplete for longer than the limit of 1 s.
        for byte in codec.encode_tcp_request(Call("vm", (1, 2, 3)))[:-1] * 100:
            if closed.done():
                break
            stalled.writer.write(bytes([byte]))
            await asyncio.sleep(0.15)
        assert await closed
        assert (await other.ask("gs")).kind == "state"


@pytest.mark.long
async def test_a_stalled_skipped_request_is_closed_and_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with limited_server(Limits(stall=1)) as server:
        stalled = await server.connect_client()
        # An unknown type with 1000 words, of which 25 arrive: the session waits for the rest to skip it.
        stalled.writer.write(struct.pack(">hH", 7777, 1000) + bytes(100))
        assert (await stalled.reply("gs")).kind == "error"
        assert await is_closed(stalled)
    assert "incomplete request" in caplog.text
    # The server itself closed it.
    assert "connection lost" not in caplog.text


@pytest.mark.long
async def test_a_client_that_does_not_read_is_closed(caplog: pytest.LogCaptureFixture) -> None:
    async with limited_server(Limits(stall=1, write_queue=2048)) as server:
        other, deaf = await server.connect_client(), socket.socket()
        # A small receive buffer and replies that are never read: the queue of 2048 bytes is soon full.
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.setblocking(False)
        loop = asyncio.get_running_loop()
        await loop.sock_connect(deaf, ("127.0.0.1", server.port))
        async def ask_on() -> None:
            await loop.sock_sendall(deaf, codec.encode_tcp_request(Call("connect_robot", (1, 1))))
            while True:
                await loop.sock_sendall(deaf, GS * 1000)

        asking = asyncio.create_task(ask_on())
        with deaf:
            while not asking.done():
                assert (await other.ask("gs")).kind == "state"
                await asyncio.sleep(0.01)
        assert isinstance(asking.exception(), ConnectionError)
        assert len(server.daemon.connections) == 1
    assert "not read, for 1 s" in caplog.text


async def test_obstacles_and_drawings_are_as_many_as_allowed() -> None:
    emulator = Emulator(simulation(), allowed=Allowed(obstacles=1, graphics=2))

    async with limited_server(Limits(), emulator) as server:
        client, other = await server.connect_client(), await server.connect_client()
        replies = [await client.ask("add_obstacle", *BOX) for _ in range(2)]
        # The second obstacle is refused (5); of drawings the oldest are dropped instead.
        assert [reply.values for reply in replies] == [(0,), (5,)]
        for number in range(5):
            assert (await client.ask("draw_line", number, 0, 0, 0, 1)).values == (0,)
        assert [shape.numbers[0] for shape in emulator.graphics.shapes] == [3, 4]
        assert (await other.ask("gs")).kind == "state"
