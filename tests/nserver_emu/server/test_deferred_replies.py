"""Deferred replies are built at the time they are due, whatever the step size."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import InProcess
from nserver_emu.server.server_state import Allowed, SimulationClock
from nserver_emu.server.session import ConnectionContext, DeferredReplies, Session
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation

STEP = 4
TURN = (0, 450, 0)
"""An eighth of a turn of the steering: a second at its top speed."""


def waiting(emulator: Emulator, seconds: int) -> tuple[WireClient, Session]:
    """A client that waits for its steering to stand still, so long at most."""
    client, session = meet(emulator)
    client.ask(*(("pr", *TURN) if seconds > 10 else ("vm", *TURN)))
    session.receive(codec.encode_tcp_request(Call("ws", (1, 1, 1, seconds))))
    assert session.process_requests(max_requests=1) == b""
    return client, session


@pytest.mark.long
@pytest.mark.parametrize("seconds", [1, 60])
def test_a_deferred_reply_has_its_due_time_in_a_long_step(seconds: int) -> None:
    emulator = Emulator(simulation(), clock=SimulationClock(paused=True), allowed=Allowed(control=True))
    client, session = waiting(emulator, seconds)
    other, _ = meet(emulator)
    assert other.ask("sim_control", STEP, 60_000).values[1] == 60_000
    (reply,) = client.read("ws", session.tick())
    assert reply.clock is not None
    assert 1000 <= reply.clock <= 1100
    assert reply.slots[39] == (450 if seconds == 1 else 0)
    assert session.tick() == b""


@pytest.mark.long
def test_a_deferred_reply_has_its_due_time_at_high_speed() -> None:
    emulator = Emulator(simulation())
    daemon = Daemon(emulator, speed=100.0)
    client, session = waiting(emulator, 1)
    daemon._advance(0.25)
    (reply,) = client.read("ws", session.tick())
    assert (reply.clock, emulator.simulation.time_s) == (1000, 25.0)


def test_a_deferred_reply_has_its_due_time_in_lockstep() -> None:
    emulator = Emulator(simulation())
    client, session = waiting(emulator, 1)
    emulator.clock.lockstep_s = 10.0
    meet(emulator)[0].ask("gs")
    (reply,) = client.read("ws", session.tick())
    assert reply.clock == 1000


@pytest.mark.long
def test_in_process_it_is_answered_in_time_too() -> None:
    end = InProcess(Emulator(simulation(), allowed=Allowed(control=True)), step_s=5.0)

    def exchange(data: bytes) -> bytes:
        end.send(data)
        return end.receive()

    client = WireClient(exchange)
    client.ask("connect_robot", 1, 1)
    client.ask("vm", *TURN)
    assert client.ask("ws", 1, 1, 1, 6).clock == 16_000


def test_steps_of_any_size_add_up_exactly() -> None:
    emulator = Emulator(simulation())
    for _ in range(10):
        emulator.pass_time(0.7)
    assert emulator.simulation.time_s == 7.0
    with pytest.raises(ValueError, match="0 s or more"):
        emulator.pass_time(-1.0)


def test_cancelled_replies_are_not_polled() -> None:
    promises, one, other = DeferredReplies(), ConnectionContext(), ConnectionContext()
    asked: list[ConnectionContext] = []
    for context in (one, other):
        promises.add(context, lambda context=context: asked.append(context))  # type: ignore[misc]
    promises.cancel(one)
    promises.poll()
    assert asked == [other]
    assert len(promises) == 1


def test_a_connection_that_leaves_while_it_waits_is_forgotten() -> None:
    emulator = Emulator(simulation())
    _, session = waiting(emulator, 60)
    assert len(emulator.deferred) == 1
    emulator.on_disconnect(session.context)
    assert len(emulator.deferred) == 0


@pytest.mark.long
@pytest.mark.parametrize("call", ["ws", "zr"])
def test_waiting_feeds_the_watchdog_until_the_reply(call: str) -> None:
    emulator = Emulator(simulation())
    client, session = meet(emulator)
    client.ask("conf_tm", 1)
    client.ask("sp", 50, 30, 30)
    if call == "zr":
        client.ask("place_robot", 0, 0, 900, 900)
        session.receive(codec.encode_tcp_request(Call("zr")))
    else:
        client.ask("pr", 0, 900, 900)
        session.receive(codec.encode_tcp_request(Call("ws", (1, 1, 1, 25))))
    assert session.process_requests(max_requests=1) == b""
    emulator.pass_time(24.0)
    assert emulator.simulation.robots[1].moving[1:] == (True, True)
    emulator.pass_time(6.5)
    (reply,) = client.read("ws", session.tick())
    assert (reply.clock or 0) // 1000 == (25 if call == "ws" else 30)
    assert emulator.simulation.robots[1].moving[1:] == (False, False)
