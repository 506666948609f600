"""A robot under emergency stop ignores motions, informs its clients, and moves again after release."""

from __future__ import annotations

import math

import pytest

from docs.generate.commands import examples
from nclient.errors import HELD
from nclient.protocol.client_state import READ, RING_PACKET
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply, text_of
from nclient.protocol.types import N150, serial_wire_state
from nserver_emu.server.estop import EStop, moves
from nserver_emu.server.handlers.table import HANDLERS, Emulator
from nserver_emu.server.session import ConnectionContext, error_reply
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import meet, simulation
from worlds.io import load_world
from worlds.world import StartPose

# Any motion of all axes; mv has pairs of mode and value: 1 velocity, 2 distance.
MOVING = {
    "vm": (100, 200, 300), "pr": (100, 200, 300), "pa": (100, 200, 300), "mv": (1, 100, 2, 200, 3, 0),
    "zr": (), "lp": (),
}  # fmt: skip


def held() -> Emulator:
    emulator = Emulator(simulation())
    emulator.hold(1, "viewer 1")
    return emulator


@pytest.mark.parametrize("name", MOVING)
def test_motions_are_refused_and_move_nothing(name: str) -> None:
    emulator = held()
    client, _ = meet(emulator)
    before = emulator.simulation.robots[1].actual
    assert client.ask(name, *MOVING[name]) == error_reply(HELD)
    state = client.ask("gs")
    # Slots 38 to 40 are the velocities, 44 the error word.
    assert [state.slots[slot] for slot in (38, 39, 40, 44)] == [0, 0, 0, HELD]
    assert text_of(client.ask("held_by").values) == "viewer 1"
    emulator.pass_time(2.0)
    assert emulator.simulation.robots[1].actual == before
    assert emulator.estop.as_dict() == {"1": {"by": "viewer 1", "ignored": 1}}


def test_a_moving_robot_stops_and_ws_replies() -> None:
    emulator = Emulator(simulation())
    client, _ = meet(emulator)
    client.ask("vm", 100, 300, 0)
    emulator.pass_time(1.0)
    emulator.hold(1, "viewer 1")
    # The setup is ideal: axes stop at once, without a ramp.
    at = emulator.simulation.robots[1].actual
    assert client.ask("ws", 1, 1, 1, 60).slots[38] == 0
    emulator.pass_time(1.0)
    assert emulator.simulation.robots[1].actual == at
    assert at.x_in > 0.0


@pytest.mark.parametrize("name", MOVING)
def test_silent_hold_of_old_recording_returns_state(name: str) -> None:
    emulator = Emulator(simulation())
    emulator.hold(1, "viewer 1", is_silent=True)
    client, _ = meet(emulator)
    reply = client.ask(name, *MOVING[name])
    assert reply.kind == "state"
    assert [reply.slots[slot] for slot in (38, 39, 40, 44)] == [0, 0, 0, 0]
    assert emulator.estop.as_dict() == {"1": {"by": "viewer 1", "ignored": 1}}


def test_line_of_held_robot_carries_the_state_as_before() -> None:
    emulator = held()
    # On a serial line there is no error reply: the state shows velocities of 0.
    context = ConnectionContext(serial_wire_state(N150), 1)
    reply = emulator.answer(Call("vm", (100, 0, 0)), context)
    assert isinstance(reply, Reply)
    assert (reply.kind, reply.slots[38]) == ("state", 0)


@pytest.mark.parametrize("call", [Call("ws", (1, 1, 1, 60)), Call("zr")], ids=lambda call: call.name)
def test_stop_ends_a_wait_with_an_error(call: Call) -> None:
    emulator = Emulator(simulation())
    context = ConnectionContext(robot_id=1)
    # The robot moves, so that ws and zr have something to wait for.
    emulator.answer(Call("vm", (100, 300, 0)), context)
    emulator.pass_time(2.0)
    poll = emulator.answer(call, context)
    emulator.pass_time(0.05)
    assert callable(poll)
    assert poll() is None
    emulator.hold(1, "viewer 1")
    emulator.pass_time(0.1)
    assert poll() == error_reply(HELD)


def test_release_clears_the_mark_at_once() -> None:
    emulator = held()
    client, _ = meet(emulator)
    assert client.ask("gs").slots[44] == HELD
    emulator.release(1)
    assert client.ask("gs").slots[44] == 0
    assert text_of(client.ask("held_by").values) == ""


def test_all_else_is_done_as_ever() -> None:
    emulator = held()
    client, _ = meet(emulator)
    for name, args in (
        ("gs", ()), ("st", ()), ("sp", (100, 100, 100)), ("ac", (100, 100, 100)), ("conf_tm", (5,)),
        # Modes 4 and 5 of mv set limits; velocity 0 is a stop. Neither is a motion.
        ("mv", (4, 100, 5, 100, 0, 0)), ("mv", (1, 0, 1, 0, 2, 0)),
        ("dp", (70, 80)), ("place_robot", (300, 200, 900, 0)),
    ):  # fmt: skip
        assert client.ask(name, *args).kind != "error"
    # The readings of a ring come as a user packet.
    assert client.ask("special_request", RING_PACKET, READ).kind != "error"
    assert math.degrees(emulator.simulation.robots[1].actual.steering_rad) == pytest.approx(90.0)
    assert emulator.estop.as_dict() == {"1": {"by": "viewer 1", "ignored": 0}}


def test_zero_velocities_are_not_counted_as_motion() -> None:
    emulator = held()
    client, _ = meet(emulator)
    # 1. All velocities 0: executed as a stop, not counted.
    client.ask("vm", 0, 0, 0)
    # 2. One velocity differs from 0: ignored and counted.
    client.ask("vm", 0, 1, 0)
    assert emulator.estop.as_dict()["1"]["ignored"] == 1


def test_the_first_operator_is_reported_until_release() -> None:
    emulator = held()
    emulator.hold(1, "viewer 2")
    assert emulator.estop.as_dict()["1"]["by"] == "viewer 1"
    assert emulator.estop.holds[1].operators == {"viewer 1", "viewer 2"}
    # Releasing twice is no error: two operators may press the button.
    emulator.estop.release(1)
    emulator.estop.release(1)
    assert emulator.estop.as_dict() == {}
    client, _ = meet(emulator)
    assert client.ask("vm", 100, 0, 0).slots[38] == 100
    emulator.pass_time(1.0)
    assert emulator.simulation.robots[1].actual.x_in > 5.0


def test_the_arm_stops_and_is_refused() -> None:
    world = Simulation(load_world("thesis_room"))
    world.add_robot(1, StartPose(0.0, 0.0), N200, IDEAL)
    emulator = Emulator(world)
    context = ConnectionContext(robot_id=1)
    # Lift 5 in and grip 1 in, both relative (mode 2), in hundredths of an inch.
    emulator.answer(Call("arm_mv", (2, 500, 2, 100)), context)
    emulator.pass_time(0.5)
    emulator.hold(1, "viewer 1")
    emulator.pass_time(1.0)  # it brakes
    at = emulator.arms[1].lift.position_in
    # Packet type 99 may move anything, so it is refused too.
    for call in (Call("arm_mv", (2, 100, 2, 100)), Call("arm_zr", (0,)), Call("special_request", (99, 1, 2))):
        reply = emulator.answer(call, context)
        assert reply == error_reply(HELD)
    emulator.pass_time(1.0)
    assert emulator.arms[1].lift.position_in == pytest.approx(at)
    assert 0.0 < at < 5.0


def test_the_first_motion_that_comes_to_nothing_is_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    emulator = held()
    client, _ = meet(emulator)
    # vm with zeros and gs are no motions; pr is the first ignored one, vm the second.
    for name, args in (("vm", (0, 0, 0)), ("gs", ()), ("pr", (100, 0, 0)), ("vm", (50, 0, 0))):
        client.ask(name, *args)
    messages = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    refused = [message for message in messages if "refused:" in message]
    assert [message.split(" (")[0].partition("refused: ")[2] for message in refused] == ["pr: error 7", "vm: error 7"]
    # Besides these of the session, the emergency stop logs only the first ignored motion.
    messages = [message for message in messages if message not in refused]
    assert len(messages) == 1
    assert messages[0].startswith("robot 1: motion command pr ignored: emergency stop by viewer 1;")
    assert "nserver ctl release" in messages[0]


def test_another_robot_goes_on() -> None:
    emulator = held()
    emulator.simulation.add_robot(2, StartPose(40.0, 0.0), N200, IDEAL)
    context = ConnectionContext(robot_id=2)
    emulator.answer(Call("vm", (100, 0, 0)), context)
    assert not emulator.simulation.robots[2].is_still((0,))


@pytest.mark.parametrize("name", HANDLERS)
def test_no_command_moves_a_held_robot(name: str) -> None:
    emulator = held()
    args = MOVING.get(name, examples(BY_NAME[name]))
    emulator.answer(Call(name, args), ConnectionContext(robot_id=1))
    assert emulator.simulation.robots[1].is_still((0, 1, 2))


def test_holds_know_whose_call_it_is() -> None:
    holds = EStop()
    holds.engage(3, "x")
    call = Call("vm", (1, 0, 0))
    assert holds.effective_call(call, None) is call
    assert holds.effective_call(call, 1) is call
    assert holds.effective_call(call, 3) == Call("st", ())
    assert moves(call)
