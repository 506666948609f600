"""Speech and the arm's packets over the wire."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.control.snapshot import dumps, loads
from nserver_emu.server.graphics import MAX_UTTERANCES, Utterance
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import Session
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import ORIGIN, WireClient, meet, simulation
from worlds.io import load_world

RELATIVE = 2


@pytest.fixture
def emulator() -> Emulator:
    made = Simulation(load_world("thesis_room"))
    made.add_robot(1, ORIGIN, MODELS["n200"], IDEAL)
    return Emulator(made)


@pytest.fixture
def connected(emulator: Emulator) -> tuple[WireClient, Session]:
    client, session = meet(emulator)
    return client, session


def answer(reply: Reply) -> tuple[int, ...]:
    """Packet type and the 32-bit numbers of a packet that says its own length rightly."""
    low, high, serial, packet_type, *data = reply.values
    assert (low + 256 * high, serial) == (len(reply.values), 0)
    return packet_type, *[int.from_bytes(bytes(data[k : k + 4]), "little") for k in range(0, len(data), 4)]


def later(emulator: Emulator, session: Session, client: WireClient, name: str, *args: int) -> tuple[float, Reply]:
    """A question that is answered later: after how many seconds, and what."""
    began_s = emulator.simulation.time_s
    assert client.send(name, codec.encode_tcp_request(Call(name, args))) == []
    for _ in range(2000):
        emulator.simulation.step(0.01)
        if data := session.tick():
            (reply,) = client.read(name, data)
            return emulator.simulation.time_s - began_s, reply
    raise AssertionError("never answered")


def test_spoken_texts_are_logged_with_robot_and_time(emulator: Emulator, connected: tuple[WireClient, Session]) -> None:
    emulator.simulation.step(1.5)
    connected[0].send("tk", codec.encode_tcp_request(Call("tk", ("hello",))))
    assert list(emulator.transcript) == [Utterance(1.5, 1, "hello")]


def test_a_transcript_forgets_its_oldest(emulator: Emulator) -> None:
    for number in range(MAX_UTTERANCES + 5):
        emulator.transcript.append(Utterance(0.0, 1, str(number)))
    assert (len(emulator.transcript), emulator.transcript[0].text) == (MAX_UTTERANCES, "5")


def test_the_arm_moves_and_wait_answers_when_it_is_there(
    emulator: Emulator, connected: tuple[WireClient, Session]
) -> None:
    client, session = connected
    assert answer(client.ask("arm_mv", RELATIVE, 1000, RELATIVE, 200)) == (42, 1)
    seconds, reply = later(emulator, session, client, "arm_ws", 1, 1, 30_000)
    # Lift 10 in at 5 in/s with ramps of 10 in/s^2: d/v + v/a.
    assert seconds == pytest.approx(10 / 5 + 5 / 10, abs=0.02)
    packet_type, result, left_ms = answer(reply)
    assert (packet_type, result) == (41, 1)
    assert left_ms == pytest.approx(30_000 - 1000 * seconds, abs=2)
    assert emulator.arms[1].lift.position_in == pytest.approx(10.0)
    # Both at rest: result 1 at once, with the whole time left.
    assert answer(client.ask("arm_ws", 1, 1, 500)) == (41, 1, 500)


def test_arm_ws_returns_0_on_timeout_of_selected_axes(
    emulator: Emulator, connected: tuple[WireClient, Session]
) -> None:
    client, session = connected
    client.ask("arm_mv", RELATIVE, 4000, 0, 0)
    # Only the grip is selected, and it is at rest.
    assert answer(client.ask("arm_ws", 0, 1, 1000)) == (41, 1, 1000)
    # The lift moves, but the timeout is 0.
    assert answer(client.ask("arm_ws", 1, 0, 0)) == (41, 0, 0)
    seconds, reply = later(emulator, session, client, "arm_ws", 1, 0, 500)
    assert seconds == pytest.approx(0.5, abs=0.02)
    assert answer(reply) == (41, 0, 0)


@pytest.mark.long
def test_zero_answers_when_the_arm_is_home(emulator: Emulator, connected: tuple[WireClient, Session]) -> None:
    client, session = connected
    client.ask("arm_mv", RELATIVE, 500, RELATIVE, 100)
    emulator.simulation.step(10.0)
    seconds, reply = later(emulator, session, client, "arm_zr", 0)
    assert seconds > 1.0
    assert answer(reply) == (40, 1)
    assert emulator.arms[1].lift.position_in == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("mode", [-1, 6, 99])
def test_a_mode_the_arm_does_not_have_is_refused(connected: tuple[WireClient, Session], mode: int) -> None:
    assert connected[0].ask("arm_mv", mode, 0, 0, 0).values == (2,)


@pytest.mark.parametrize(
    ("name", "args"), [("arm_mv", (0, 0, 0, 0)), ("arm_zr", (0,)), ("arm_ws", (1, 1, 0)), ("special_request", (99, 1))]
)
def test_a_robot_without_an_arm_refuses(name: str, args: tuple[int, ...]) -> None:
    client, _ = meet(Emulator(simulation()))
    assert client.ask(name, *args).values == (4,)


def test_an_unknown_user_packet_is_refused(connected: tuple[WireClient, Session]) -> None:
    assert connected[0].ask("special_request", 99, 1, 2, 3).values == (4,)


def running(emulator: Emulator) -> tuple[WireClient, Session]:
    """A client whose arm's lift runs up at 1 in/s."""
    client, session = meet(emulator)
    # Mode 1: velocity, in hundredths of an inch per second.
    client.ask("arm_mv", 1, 100, 0, 0)
    emulator.pass_time(1.0)
    assert emulator.arms[1].lift.moving
    return client, session


def settled_in(emulator: Emulator) -> float:
    """Return the height of the lift when it is still, within a minute."""
    emulator.pass_time(60.0)
    assert emulator.arms[1].is_still()
    return emulator.arms[1].lift.position_in


@pytest.mark.long
def test_st_stops_the_arm_too(emulator: Emulator) -> None:
    client, _ = running(emulator)
    client.ask("st")
    # 1 s with a ramp of 0.1 s at each end: 1.0 in.
    assert 0.9 < settled_in(emulator) < 1.1


@pytest.mark.long
def test_only_its_clients_leaving_stops_an_arm(emulator: Emulator) -> None:
    _, session = running(emulator)
    other, other_session = meet(emulator)
    # Settings of the arm (modes 5 and 4) do not make this client its owner.
    other.ask("arm_mv", 5, 100, 4, 100)
    emulator.on_disconnect(other_session.context)
    assert emulator.arms[1].lift.moving
    emulator.on_disconnect(session.context)
    assert 0.9 < settled_in(emulator) < 1.1


@pytest.mark.long
def test_the_arm_keeps_moving_for_its_new_owner(emulator: Emulator) -> None:
    _, session = running(emulator)
    other, _ = meet(emulator)
    # A motion does: the lift goes 10 in farther for the other client.
    other.ask("arm_mv", 2, 1000, 2, 100)
    emulator.on_disconnect(session.context)
    assert settled_in(emulator) == pytest.approx(11.0, abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize("step_s", [0.1, 5.0])
def test_the_time_out_stops_the_arm_when_it_strikes(emulator: Emulator, step_s: float) -> None:
    client, _ = running(emulator)
    client.ask("conf_tm", 2)
    for _ in range(round(5.0 / step_s)):
        emulator.simulation.step(step_s)
    client.ask("gs")
    # 1 in/s until the timeout, which is 2 s after conf_tm at 1 s.
    assert settled_in(emulator) == pytest.approx(3.0, abs=0.1)


def test_waiting_for_the_arm_feeds_the_watchdog(emulator: Emulator) -> None:
    client, session = meet(emulator)
    client.ask("conf_tm", 1)
    # 5 in at 1 in/s take 5 s, longer than the timeout of 1 s.
    client.ask("arm_mv", 5, 100, 0, 0)
    client.ask("arm_mv", 2, 500, 0, 0)
    session.receive(codec.encode_tcp_request(Call("arm_ws", (1, 1, 30_000))))
    assert session.process_requests(max_requests=1) == b""
    assert settled_in(emulator) == pytest.approx(5.0)
    (reply,) = client.read("arm_ws", session.tick())
    assert answer(reply)[:2] == (41, 1)


def test_a_restored_arm_stops_with_its_first_client(emulator: Emulator) -> None:
    running(emulator)
    restored = Emulator(simulation())
    loads(restored, dumps(emulator))
    _, session = meet(restored)
    # The first client after a restore owns the arm.
    restored.on_disconnect(session.context)
    assert 0.9 < settled_in(restored) < 1.1
