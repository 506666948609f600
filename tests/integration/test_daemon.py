"""The daemon on real sockets: several clients, rude ones among them, and a clean end."""

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
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.tcp_framing import InvalidFrame, TcpFrame
from nserver_emu.server.connection import MAX_BYTES_PER_TURN, MAX_REQUESTS_PER_TURN, TcpConnection
from nserver_emu.server.context import Allowed, SimulationClock
from nserver_emu.server.daemon import Daemon, stop_on_signals
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import Session
from tests.nserver_emu.server.daemon_house import House, with_daemon
from tests.nserver_emu.server.wire_client import simulation
from worlds.world import StartPose

GS = codec.tcp_request(Call("gs"))


def test_a_robot_drives_in_real_time_for_one_client_and_another_sees_it() -> None:
    async def scenario(house: House) -> None:
        driver, watcher = await house.call(), await house.call()
        assert (await driver.ask("vm", 100, 0, 0)).slots[38] == 100
        while (await watcher.ask("gs")).slots[34] < 3:
            await asyncio.sleep(0.005)
        assert (await driver.ask("gs")).slots[0] == 10

    with_daemon(scenario)


def test_the_machines_own_host_name_is_served_on_debians_address_too() -> None:
    async def scenario(house: House) -> None:
        client = await house.call("127.0.1.1")
        assert (await client.ask("gs")).kind == "state"

    with_daemon(scenario)


@pytest.mark.parametrize(("speed", "shown"), [(50.0, 500), (None, 9999)])
def test_time_runs_as_fast_as_told_and_ws_answers_on_it(speed: float | None, shown: int) -> None:
    async def scenario(house: House) -> None:
        client = await house.call()
        await client.ask("sp", 100, 450, 450)
        await client.ask("pr", 200, 0, 0)
        reply = await client.ask("ws", 1, 1, 1, 100)
        assert (reply.slots[0], reply.slots[34], reply.slots[38]) == (shown, 200, 0)

    with_daemon(scenario, speed)


def test_a_client_that_vanishes_leaves_a_robot_that_stands() -> None:
    async def scenario(house: House) -> None:
        rude, other = await house.call(), await house.call()
        await rude.ask("vm", 100, 0, 0)
        rude.writer.write(GS[:3])
        rude.writer.transport.abort()
        while (await other.ask("get_rv")).slots[38]:
            await asyncio.sleep(0.005)

    with_daemon(scenario)


def test_garbage_is_refused_and_closed_and_the_others_go_on(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(house: House) -> None:
        polite = await house.call()
        rude = await house.knock()
        rude.writer.write(b"GET / HTTP/1.1\r\n\r\n" * 50)
        assert (await rude.reader.read(-1)).startswith(b"\x00\x5b\x00\x01")
        assert (await polite.ask("gs")).kind == "state"

    with caplog.at_level(logging.WARNING):
        with_daemon(scenario)
    assert len([record for record in caplog.records if "refused" in record.message]) == 1


def test_a_flood_gets_all_its_answers_and_does_not_keep_another_waiting() -> None:
    async def scenario(house: House) -> None:
        flood, polite = await house.call(), await house.call()
        count = 40 * MAX_REQUESTS_PER_TURN
        flood.writer.write(GS * count)
        answered = 0

        async def drain() -> None:
            nonlocal answered
            for _ in range(count):
                await flood.reply("gs")
                answered += 1

        draining = asyncio.create_task(drain())
        await asyncio.sleep(0)
        assert (await polite.ask("gs")).kind == "state"
        assert answered < count
        await draining
        assert answered == count

    with_daemon(scenario)


def test_a_flood_is_looked_at_and_answered_little_by_little_between_the_others_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heard: Counter[int] = Counter()
    answered: Counter[int] = Counter()
    turn = 0
    receive, answer = Session.receive, Session._process_one

    def receiving(session: Session, data: bytes) -> None:
        heard[turn] += len(data)
        receive(session, data)

    def answering(session: Session, request: TcpFrame | InvalidFrame) -> bytes:
        answered[turn] += 1
        return answer(session, request)

    async def turns() -> None:
        nonlocal turn
        while True:
            turn += 1
            await asyncio.sleep(0)

    async def scenario(house: House) -> None:
        flood = await house.call()
        monkeypatch.setattr(Session, "receive", receiving)
        monkeypatch.setattr(Session, "_process_one", answering)
        counting = asyncio.create_task(turns())
        flood.writer.write(GS * 3000)
        for _ in range(3000):
            await flood.reply("gs")
        counting.cancel()

    with_daemon(scenario)
    assert (heard.total(), answered.total()) == (12_000, 3000)
    assert max(heard.values()) == MAX_BYTES_PER_TURN
    assert max(answered.values()) == MAX_REQUESTS_PER_TURN


def test_what_comes_while_an_answer_takes_its_time_is_looked_at_up_to_a_crowd_and_then_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    turns = 0
    honest = TcpConnection._next_turn

    def next_turn(connection: TcpConnection) -> None:
        nonlocal turns
        turns += 1
        honest(connection)

    monkeypatch.setattr(TcpConnection, "_next_turn", next_turn)

    async def scenario(house: House) -> None:
        waiting, other = await house.call(), await house.call()
        await waiting.ask("vm", 0, 0, 20)
        waiting.writer.write(codec.tcp_request(Call("ws", (1, 1, 1, 2**31 - 1))) + GS * 1000)
        while not any(connection.session.is_queue_full for connection in house.daemon.connections):
            assert (await other.ask("gs")).kind == "state"
        before = turns
        for _ in range(50):
            assert (await other.ask("gs")).kind == "state"
        assert turns == before, "nobody takes a turn for nothing"
        await other.ask("st")
        for name in ("ws", *["gs"] * 1000):
            await waiting.reply(name)

    with_daemon(scenario)


def test_a_client_that_does_not_read_is_not_waited_for_and_loses_nothing() -> None:
    async def scenario(house: House) -> None:
        deaf, polite = await house.call(), await house.call()
        deaf.transport.pause_reading()  # a reader that has better things to do
        count = 60_000
        deaf.writer.write(GS * count)
        while not any(connection.is_write_paused for connection in house.daemon.connections):
            assert (await polite.ask("gs")).kind == "state"
        for _ in range(20):
            assert (await polite.ask("gs")).kind == "state"
        deaf.transport.resume_reading()
        for _ in range(count):
            assert (await deaf.reply("gs")).kind == "state"
        assert not any(connection.is_write_paused for connection in house.daemon.connections)

    with_daemon(scenario)


def test_a_client_that_vanishes_while_it_waits_leaves_a_robot_that_stands() -> None:
    async def scenario(house: House) -> None:
        waiting, other = await house.call(), await house.call()
        await waiting.ask("vm", 0, 0, 20)
        waiting.writer.write(codec.tcp_request(Call("ws", (1, 1, 1, 2**31 - 1))))
        while not any(connection.session.waiting for connection in house.daemon.connections):
            await asyncio.sleep(0.001)
        waiting.writer.close()
        while (await other.ask("get_rv")).slots[40]:
            await asyncio.sleep(0.005)

    with_daemon(scenario)


def test_many_who_shout_garbage_do_not_stop_time_for_others() -> None:
    async def scenario(house: House) -> None:
        polite = await house.call()
        shouters = [await house.knock() for _ in range(30)]
        for shouter in shouters:
            shouter.writer.write(b"\x7f" * 200_000)
        for _ in range(20):
            before = house.daemon.emulator.clock_ms
            async with asyncio.timeout(5):
                await polite.ask("gs")
            await asyncio.sleep(0.02)
            assert house.daemon.emulator.clock_ms > before
        for shouter in shouters:
            with contextlib.suppress(ConnectionError):
                await shouter.reader.read(-1)
        assert len(house.daemon.connections) == 1

    with_daemon(scenario)


def test_half_a_request_and_an_abrupt_end_leave_one_line_each(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(house: House) -> None:
        half, abrupt, polite = await house.call(), await house.call(), await house.call()
        half.writer.write(b"\x00\x0c\x00\x03\x00")
        await half.writer.drain()
        await asyncio.sleep(0.02)
        half.writer.close()
        linger = struct.pack("ii", 1, 0)
        abrupt.writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        abrupt.writer.close()
        while len(house.daemon.connections) > 1:
            assert (await polite.ask("gs")).kind == "state"

    with caplog.at_level(logging.WARNING):
        with_daemon(scenario)
    messages = [record.getMessage() for record in caplog.records]
    assert len([message for message in messages if "connection lost in mid-request" in message]) == 1
    assert len([message for message in messages if "connection lost:" in message]) == 1


def test_a_fault_of_ours_costs_one_connection_only(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(house: House) -> None:
        clients = [await house.call(), await house.call()]
        faulty = next(iter(house.daemon.connections))

        def broken(*_: object) -> Reply:
            raise RuntimeError("a fault")

        faulty.session._answer = broken
        heard = []
        for client in clients:
            client.writer.write(GS)
            heard.append(bool(await client.reader.read(1000)))
        assert sorted(heard) == [False, True]

    with_daemon(scenario)
    assert "internal error; connection closed" in caplog.text


def test_a_port_that_is_taken_says_so_and_names_the_remedy() -> None:
    async def scenario(house: House) -> None:
        with pytest.raises(ConnectionLost, match=f"127.0.0.1:{house.port}.*--port 0"):
            await Daemon(Emulator(simulation())).listen("127.0.0.1", house.port)

    with_daemon(scenario)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signals_end_it_cleanly(number: signal.Signals) -> None:
    async def evening() -> None:
        daemon, stop = Daemon(Emulator(simulation())), asyncio.Event()
        stop_on_signals(stop)
        house = House(daemon, await daemon.listen("127.0.0.1", 0))
        serving = asyncio.create_task(daemon.serve(stop))
        client = await house.call()
        os.kill(os.getpid(), number)
        await serving
        assert await client.reader.read(-1) == b""
        await house.see_out()

    asyncio.run(evening())


def test_under_nohup_a_closed_terminal_ends_nothing() -> None:
    async def evening() -> None:
        stop = asyncio.Event()
        stop_on_signals(stop)
        os.kill(os.getpid(), signal.SIGHUP)
        await asyncio.sleep(0)
        assert not stop.is_set()

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        asyncio.run(evening())
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_machine_that_slept_loses_the_time_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    daemon = Daemon(Emulator(simulation()), speed=2.0)
    with caplog.at_level(logging.INFO):
        daemon._advance(10.25)
    assert "10.00 s of real time lost" in caplog.text
    assert daemon.emulator.simulation.time_s == pytest.approx(0.5)


def test_a_clock_that_fails_ends_the_daemon_with_its_reason() -> None:
    async def house() -> None:
        daemon = Daemon(Emulator(simulation()))
        await daemon.listen("127.0.0.1", 0)
        daemon.emulator.simulation.step = None  # type: ignore[method-assign,assignment]
        await daemon.serve(asyncio.Event())

    with pytest.raises(TypeError):
        asyncio.run(house())


def test_a_paused_simulation_stands_until_it_is_stepped_or_resumed() -> None:
    async def scenario(house: House) -> None:
        client = await house.call()
        await client.ask("vm", 100, 0, 0)
        assert (await client.ask("gs")).slots[0] == 0
        house.daemon._advance(5.0)
        assert (await client.ask("gs")).clock == 0
        assert (await client.ask("sim_control", 4, 1000)).values == (1, 1000, 10, 1)
        assert (await client.ask("get_rc")).slots[34] == 100
        await client.ask("sim_control", 2, 0)
        while (await client.ask("get_rc")).slots[34] < 101:
            await asyncio.sleep(0.005)

    with_daemon(
        scenario, emulator=Emulator(simulation(), clock=SimulationClock(paused=True), allowed=Allowed(control=True))
    )


def test_in_lockstep_time_waits_for_clients_and_passes_for_one_that_waits() -> None:
    async def scenario(house: House) -> None:
        client = await house.call()
        await client.ask("sp", 100, 450, 450)
        house.daemon._advance(5.0)
        assert (await client.ask("gs")).clock == 200
        await client.ask("pr", 200, 0, 0)
        reply = await client.ask("ws", 1, 1, 1, 100)
        assert (reply.slots[0], reply.slots[34], reply.slots[38]) == (0, 200, 0)
        assert reply.clock == 2300

    with_daemon(scenario, emulator=Emulator(simulation(), clock=SimulationClock(lockstep_s=0.1)))


def test_a_client_that_may_ends_the_server_and_still_has_its_answer() -> None:
    async def evening() -> None:
        daemon = Daemon(Emulator(simulation(), allowed=Allowed(quit=True)))
        house = House(daemon, await daemon.listen("127.0.0.1", 0))
        serving = asyncio.create_task(daemon.serve(asyncio.Event()))
        client = await house.call()
        assert (await client.ask("quit_server")).values == (0,)
        async with asyncio.timeout(10):
            await serving
        assert await client.reader.read(-1) == b""
        await house.see_out()

    asyncio.run(evening())


def test_second_connections_find_their_own_robots_and_the_gone_are_forgotten() -> None:
    async def scenario(house: House) -> None:
        house.daemon.emulator.simulation.add_robot(2, StartPose(60.0, 0.0))
        first = [await house.knock() for _ in range(2)]
        for number, client in enumerate(first, start=1):
            assert (await client.ask("connect_robot", number, 1)).values == (house.port,)
        second = [await house.knock() for _ in range(2)]
        assert [(await client.ask("sim_truth")).values[-1] for client in second] == [1, 2]
        for client in first:
            client.writer.close()
        second[0].writer.write(codec.tcp_request(Call("disconnect_robot", (1, 1))))
        second[1].writer.close()
        while house.daemon.connections or len(house.daemon.client_registry):
            await asyncio.sleep(0.005)
        stranger = await house.knock()
        assert (await stranger.ask("gs")).values == (3,)

    with_daemon(scenario)
