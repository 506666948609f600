"""The daemon on real sockets: several clients, hostile clients, and a clean end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import struct
from collections import Counter

import pytest

from nclient.errors import ConnectionLost
from nclient.protocol import codec
from nclient.protocol.codec import InvalidFrame, TcpFrame
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.server.connection import MAX_BYTES_PER_TURN, MAX_REQUESTS_PER_TURN, ConnectionState, TcpConnection
from nserver_emu.server.daemon import Daemon, stop_on_signals
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed, SimulationClock
from nserver_emu.server.session import Session
from tests.nserver_emu.server.running_server import RunningServer, running_server
from tests.nserver_emu.server.wire_client import simulation
from worlds.world import StartPose

GS = codec.encode_tcp_request(Call("gs"))


async def test_all_clients_see_motion_in_real_time() -> None:
    async with running_server() as server:
        driver, watcher = await server.connect_client(), await server.connect_client()
        assert (await driver.ask("vm", 100, 0, 0)).slots[38] == 100
        # 0.3 in after some 30 ms of real time at 10 in/s.
        while (await watcher.ask("gs")).slots[34] < 3:
            await asyncio.sleep(0.005)
        assert (await driver.ask("gs")).slots[0] == 10


async def test_host_name_address_127_0_1_1_is_served() -> None:
    async with running_server() as server:
        client = await server.connect_client("127.0.1.1")
        assert (await client.ask("gs")).kind == "state"


@pytest.mark.parametrize(("speed", "shown"), [(50.0, 500), (None, 9999)])
async def test_ws_waits_in_simulated_time(speed: float | None, shown: int) -> None:
    async with running_server(speed) as server:
        client = await server.connect_client()
        await client.ask("sp", 100, 450, 450)
        await client.ask("pr", 200, 0, 0)
        reply = await client.ask("ws", 1, 1, 1, 100)
        assert (reply.slots[0], reply.slots[34], reply.slots[38]) == (shown, 200, 0)


async def test_lost_client_stops_its_robot() -> None:
    async with running_server() as server:
        hostile, other = await server.connect_client(), await server.connect_client()
        await hostile.ask("vm", 100, 0, 0)
        # Three bytes of a request, then RST: the connection ends in mid-request.
        hostile.writer.write(GS[:3])
        hostile.writer.transport.abort()
        while (await other.ask("get_rv")).slots[38]:
            await asyncio.sleep(0.005)


async def test_invalid_bytes_close_only_their_connection(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    async with running_server() as server:
        other = await server.connect_client()
        hostile = await server.open_client()
        hostile.writer.write(b"GET / HTTP/1.1\r\n\r\n" * 50)
        # Type 005b (ERROR), one word; the rest of the bytes is dropped.
        assert (await hostile.reader.read(-1)).startswith(b"\x00\x5b\x00\x01")
        assert (await other.ask("gs")).kind == "state"
    assert len([record for record in caplog.records if "refused" in record.message]) == 1


async def test_flooding_client_does_not_delay_others() -> None:
    async with running_server() as server:
        flooding, other = await server.connect_client(), await server.connect_client()
        count = 40 * MAX_REQUESTS_PER_TURN
        flooding.writer.write(GS * count)
        answered = 0

        async def drain() -> None:
            nonlocal answered
            for _ in range(count):
                await flooding.reply("gs")
                answered += 1

        # The other client is answered before the flooding one has all of its replies.
        draining = asyncio.create_task(drain())
        await asyncio.sleep(0)
        assert (await other.ask("gs")).kind == "state"
        assert answered < count
        await draining
        assert answered == count


async def test_bytes_and_requests_per_turn_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    received: Counter[int] = Counter()
    answered: Counter[int] = Counter()
    turn = 0
    receive, answer = Session.receive, Session._process_one

    # The number of bytes and requests in each iteration of the loop is counted from outside of the server.
    def receiving(session: Session, data: bytes) -> None:
        received[turn] += len(data)
        receive(session, data)

    def answering(session: Session, request: TcpFrame | InvalidFrame) -> bytes:
        answered[turn] += 1
        return answer(session, request)

    # This task runs once per iteration.
    async def turns() -> None:
        nonlocal turn
        while True:
            turn += 1
            await asyncio.sleep(0)

    async with running_server() as server:
        flooding = await server.connect_client()
        monkeypatch.setattr(Session, "receive", receiving)
        monkeypatch.setattr(Session, "_process_one", answering)
        counting = asyncio.create_task(turns())
        # 3000 requests of 4 bytes, more than one turn may take.
        flooding.writer.write(GS * 3000)
        for _ in range(3000):
            await flooding.reply("gs")
        counting.cancel()
    assert (received.total(), answered.total()) == (12_000, 3000)
    assert max(received.values()) == MAX_BYTES_PER_TURN
    assert max(answered.values()) == MAX_REQUESTS_PER_TURN


async def test_reading_pauses_while_reply_is_deferred(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = 0
    run_turn_original = TcpConnection.run_turn

    def run_turn(connection: TcpConnection) -> None:
        nonlocal turns
        # A turn during a deferred reply can do nothing.
        turns += connection.session.waiting
        run_turn_original(connection)

    monkeypatch.setattr(TcpConnection, "run_turn", run_turn)
    async with running_server() as server:
        waiting, other = await server.connect_client(), await server.connect_client()
        await waiting.ask("vm", 0, 0, 20)
        # ws has no end of its own; behind it more requests than the queue holds.
        waiting.writer.write(codec.encode_tcp_request(Call("ws", (1, 1, 1, 2**31 - 1))) + GS * 1000)
        while not any(connection.session.is_queue_full for connection in server.daemon.connections):
            assert (await other.ask("gs")).kind == "state"
        before = turns
        for _ in range(50):
            assert (await other.ask("gs")).kind == "state"
        assert turns == before, "no turn without work"
        await other.ask("st")
        # After st ws is answered, then all others in order.
        for name in ("ws", *["gs"] * 1000):
            await waiting.reply(name)


async def test_slow_reader_delays_no_other_and_loses_nothing() -> None:
    async with running_server() as server:
        slow, other = await server.connect_client(), await server.connect_client()
        # Without limits the system would store ten times as many replies before the daemon has to pause.
        # Small buffers on both ends, so that the daemon's own buffer fills soon.
        slow.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        for connection in server.daemon.connections:
            assert isinstance(connection, TcpConnection)
            connection._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)
        slow.transport.pause_reading()
        count = 5_000
        slow.writer.write(GS * count)
        while not any(connection.state is ConnectionState.PAUSED for connection in server.daemon.connections):
            assert (await other.ask("gs")).kind == "state"
        for _ in range(20):
            assert (await other.ask("gs")).kind == "state"
        slow.transport.resume_reading()
        for _ in range(count):
            assert (await slow.reply("gs")).kind == "state"
        assert not any(connection.state is ConnectionState.PAUSED for connection in server.daemon.connections)


async def test_client_lost_during_wait_stops_its_robot() -> None:
    async with running_server() as server:
        waiting, other = await server.connect_client(), await server.connect_client()
        await waiting.ask("vm", 0, 0, 20)
        waiting.writer.write(codec.encode_tcp_request(Call("ws", (1, 1, 1, 2**31 - 1))))
        while not any(connection.session.waiting for connection in server.daemon.connections):
            await asyncio.sleep(0.001)
        waiting.writer.close()
        while (await other.ask("get_rv")).slots[40]:
            await asyncio.sleep(0.005)


async def test_many_invalid_clients_do_not_stop_time() -> None:
    async with running_server() as server:
        other = await server.connect_client()
        hostile_clients = [await server.open_client() for _ in range(30)]
        for hostile in hostile_clients:
            # No valid header in it: each connection is refused and closed, and the rest of its bytes dropped.
            hostile.writer.write(b"\x7f" * 200_000)
        for _ in range(20):
            before = server.daemon.emulator.clock_ms
            async with asyncio.timeout(5):
                await other.ask("gs")
            await asyncio.sleep(0.02)
            # Simulated time advances, although 30 clients flood the server.
            assert server.daemon.emulator.clock_ms > before
        for hostile in hostile_clients:
            with contextlib.suppress(ConnectionError):
                await hostile.reader.read(-1)
        assert len(server.daemon.connections) == 1


async def test_incomplete_request_and_reset_log_one_line_each(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    async with running_server() as server:
        half, abrupt, other = [await server.connect_client() for _ in range(3)]
        # vm with 5 of its 16 bytes.
        half.writer.write(b"\x00\x0c\x00\x03\x00")
        await half.writer.drain()
        await asyncio.sleep(0.02)
        half.writer.close()
        # Lingering for 0 s makes close() send a reset.
        linger = struct.pack("ii", 1, 0)
        abrupt.writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        abrupt.writer.close()
        while len(server.daemon.connections) > 1:
            assert (await other.ask("gs")).kind == "state"
    messages = [record.getMessage() for record in caplog.records]
    assert len([message for message in messages if "connection lost in mid-request" in message]) == 1
    assert len([message for message in messages if "connection lost:" in message]) == 1


@pytest.mark.parametrize("is_scheduled", [False, True])
# The three places where a session runs inside of a turn.
@pytest.mark.parametrize("stage", ["receive", "call_to_prepare", "_answer"])
async def test_internal_error_closes_one_connection(
    stage: str, is_scheduled: bool, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running_server() as server:
        clients = [await server.connect_client(), await server.connect_client()]
        faulty = next(iter(server.daemon.connections))

        def broken(*_: object) -> Reply:
            raise RuntimeError("broken")

        # Through the scheduler or at once: both paths must catch it.
        monkeypatch.setattr(server.daemon.scheduler, "may_run_now", lambda *_: not is_scheduled)
        monkeypatch.setattr(faulty.session, stage, broken)
        received = []
        for client in clients:
            client.writer.write(GS)
            received.append(bool(await client.reader.read(1000)))
        # One client gets the end of its connection, the other a reply.
        assert sorted(received) == [False, True]
    assert "internal error; connection closed" in caplog.text


async def test_used_port_error_names_remedy() -> None:
    async with running_server() as server:
        with pytest.raises(ConnectionLost, match="--port 0"):
            await Daemon(Emulator(simulation())).listen("127.0.0.1", server.port)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
async def test_signals_end_the_server_cleanly(number: signal.Signals) -> None:
    daemon, stop = Daemon(Emulator(simulation())), asyncio.Event()
    stop_on_signals(stop)
    server = RunningServer(daemon, await daemon.listen("127.0.0.1", 0))
    serving = asyncio.create_task(daemon.serve(stop))
    client = await server.connect_client()
    os.kill(os.getpid(), number)
    await serving
    assert await client.reader.read(-1) == b""
    await server.close_clients()


async def test_nohup_ignores_sighup() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        stop = asyncio.Event()
        stop_on_signals(stop)
        os.kill(os.getpid(), signal.SIGHUP)
        await asyncio.sleep(0)
        assert not stop.is_set()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_suspended_time_is_skipped_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    daemon = Daemon(Emulator(simulation()), speed=2.0)
    with caplog.at_level(logging.INFO):
        daemon._advance(10.25)
    assert "10.00 s of real time lost" in caplog.text
    # 0.25 s of real time, the longest catch-up, at speed 2.
    assert daemon.emulator.simulation.time_s == pytest.approx(0.5)


async def test_failing_simulation_ends_the_server() -> None:
    daemon = Daemon(Emulator(simulation()))
    await daemon.listen("127.0.0.1", 0)
    # A simulation that raises in each step: the daemon must not run on without time.
    daemon.emulator.simulation.step = None  # type: ignore[method-assign,assignment]
    with pytest.raises(TypeError):
        await daemon.serve(asyncio.Event())


async def test_pause_step_and_resume() -> None:
    emulator = Emulator(simulation(), clock=SimulationClock(paused=True), allowed=Allowed(control=True))
    async with running_server(emulator=emulator) as server:
        client = await server.connect_client()
        await client.ask("vm", 100, 0, 0)
        assert (await client.ask("gs")).slots[0] == 0
        # Five seconds of real time pass, but the clock is paused.
        server.daemon._advance(5.0)
        assert (await client.ask("gs")).clock == 0
        # Verb 4 steps by milliseconds: 1 s at 10 in/s, 100 tenths.
        assert (await client.ask("sim_control", 4, 1000)).values == (1, 1000, 10, 1)
        assert (await client.ask("get_rc")).slots[34] == 100
        await client.ask("sim_control", 2, 0)
        while (await client.ask("get_rc")).slots[34] < 101:
            await asyncio.sleep(0.005)


async def test_lockstep_time_advances_with_requests() -> None:
    async with running_server(emulator=Emulator(simulation(), clock=SimulationClock(lockstep_s=0.1))) as server:
        client = await server.connect_client()
        await client.ask("sp", 100, 450, 450)
        server.daemon._advance(5.0)
        # sp and gs took one step of 0.1 s each; real time has no effect.
        assert (await client.ask("gs")).clock == 200
        await client.ask("pr", 200, 0, 0)
        reply = await client.ask("ws", 1, 1, 1, 100)
        assert (reply.slots[0], reply.slots[34], reply.slots[38]) == (0, 200, 0)
        # pr at 0.3 s, then 20 in at 10 in/s.
        assert reply.clock == 2300


async def test_quit_server_is_answered() -> None:
    daemon = Daemon(Emulator(simulation(), allowed=Allowed(quit=True)))
    server = RunningServer(daemon, await daemon.listen("127.0.0.1", 0))
    serving = asyncio.create_task(daemon.serve(asyncio.Event()))
    client = await server.connect_client()
    assert (await client.ask("quit_server")).values == (0,)
    async with asyncio.timeout(10):
        await serving
    assert await client.reader.read(-1) == b""
    await server.close_clients()


async def test_second_connection_finds_its_robot_until_both_close() -> None:
    async with running_server() as server:
        server.daemon.emulator.simulation.add_robot(2, StartPose(60.0, 0.0))
        first = [await server.open_client() for _ in range(2)]
        second = []
        for number, client in enumerate(first, start=1):
            assert (await client.ask("connect_robot", number, 1)).values == (server.port,)
            second.append(await server.open_client())
            assert (await second[-1].ask("sim_truth")).values[-1] == number
        for client in first:
            client.writer.close()
        # The first connections are closed, one second one says DISCONNECT, the other only closes.
        second[0].writer.write(codec.encode_tcp_request(Call("disconnect_robot", (1, 1))))
        second[1].writer.close()
        while server.daemon.connections or len(server.daemon.client_registry):
            await asyncio.sleep(0.005)
        late = await server.open_client()
        # Nothing is left to continue: error 3.
        assert (await late.ask("gs")).values == (3,)
