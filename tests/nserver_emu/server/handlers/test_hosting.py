"""Commands to the server itself: robots made, real and simulated ones, its end, its time."""

from __future__ import annotations

import logging
import math

import pytest

from nserver_emu.server.handlers import table
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed, SimulationClock
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation

PAUSE, RESUME, SPEED, STEP = 1, 2, 3, 4


def allowed(pace: SimulationClock | None = None) -> tuple[WireClient, Emulator]:
    emulator = Emulator(simulation(), port=7019, clock=pace, allowed=Allowed(quit=True, control=True))
    return meet(emulator)[0], emulator


def test_a_created_robot_obeys_its_client() -> None:
    client, emulator = allowed()
    assert client.ask("create_robot", 2, 1).values == (7019,)
    first, second = (emulator.simulation.robots[number].actual for number in (1, 2))
    # The new robot does not touch the first: two radii of 9.72 in.
    assert math.hypot(first.x_in - second.x_in, first.y_in - second.y_in) > 2 * 9.72
    client.ask("vm", 50, 0, 0)
    assert emulator.simulation.robots[2].moving[0]
    assert not emulator.simulation.robots[1].moving[0]
    # A robot that exists is connected to, not made again.
    assert client.ask("create_robot", 1, 1).values == (7019,)
    assert len(emulator.simulation.robots) == 2


@pytest.mark.parametrize("robot_id", [-1, 0x8000])
def test_what_is_no_robot_id_is_not_made(robot_id: int, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    client, emulator = allowed()
    assert client.ask("create_robot", robot_id, 1).values == (0,)
    assert client.ask("gs").kind == "state"
    assert len(emulator.simulation.robots) == 1
    assert caplog.messages == [f"robot {robot_id} not created: a robot's number is 1 to 32767"]


@pytest.mark.long
def test_robots_are_created_while_space_and_limit_allow(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    client, emulator = allowed()
    ports = [client.ask("create_robot", number, 1).values[0] for number in range(2, 40)]
    assert 0 in ports
    # Once there is no room (0), there is none for later robots: ports, then zeros.
    assert ports == sorted(ports, reverse=True)
    robots = [robot.actual for robot in emulator.simulation.robots.values()]
    assert len(robots) > 8
    gaps = [math.dist(one[:2], other[:2]) for k, one in enumerate(robots) for other in robots[:k]]
    assert min(gaps) > 2 * 9.72
    assert min(emulator.simulation.world.clearance(*robot[:2]) for robot in robots) > 9.72
    assert caplog.messages[-1] == (
        f"robot 39 not created: no free space around the starts of thesis_room for one more than {len(robots)}"
    )
    monkeypatch.setattr(table, "MAX_ROBOTS", 2)
    client, _ = allowed()
    assert [client.ask("create_robot", number, 1).values[0] for number in (2, 3)] == [7019, 0]
    assert caplog.messages[-1] == "robot 3 not created: there are 2 robots already, the maximum"


def test_a_simulation_has_no_real_robot() -> None:
    client, _ = allowed()
    assert client.ask("simulated_robot").values == (0,)
    assert client.ask("real_robot").values == (4,)


def test_quit_ends_the_server_only_where_it_is_allowed() -> None:
    client, emulator = allowed()
    assert client.ask("quit_server").values == (0,)
    assert emulator.quitting
    emulator = Emulator(simulation())
    assert meet(emulator)[0].ask("quit_server").values == (5,)
    assert not emulator.quitting


def test_time_is_controlled_only_where_it_is_allowed() -> None:
    emulator = Emulator(simulation())
    assert meet(emulator)[0].ask("sim_control", PAUSE, 0).values == (5,)
    assert not emulator.clock.paused


def test_pause_step_resume_and_speed_show_in_state_0() -> None:
    client, emulator = allowed()
    # Marker, clock in ms, speed x 10, paused.
    assert client.ask("sim_control", PAUSE, 0).values == (1, 0, 10, 1)
    assert client.ask("gs").slots[0] == 0
    assert client.ask("sim_control", STEP, 1500).values == (1, 1500, 10, 1)
    assert emulator.simulation.time_s == 1.5
    assert client.ask("sim_control", SPEED, 25).values == (1, 1500, 25, 1)
    assert client.ask("sim_control", RESUME, 0).values == (1, 1500, 25, 0)
    assert client.ask("gs").slots[0] == 25
    # Speed 0 means unlimited: State[0] shows 9999.
    assert client.ask("sim_control", SPEED, 0).values == (1, 1500, 0, 0)
    assert client.ask("gs").slots[0] == 9999


# Unknown verbs, a negative speed, above 999.0, a negative step, above 60 s.
@pytest.mark.parametrize("args", [(0, 0), (5, 0), (SPEED, -1), (SPEED, 9991), (STEP, -1), (STEP, 60_001)])
def test_no_verb_and_no_value_out_of_range_is_taken(args: tuple[int, int]) -> None:
    client, emulator = allowed()
    assert client.ask("sim_control", *args).values == (2,)
    assert emulator.simulation.time_s == 0.0


def test_in_lockstep_time_moves_when_a_client_asks() -> None:
    client, emulator = allowed(SimulationClock(lockstep_s=0.25))
    assert emulator.simulation.time_s == 0.0
    # Each gs advances time by 0.25 s; sim_truth and sim_control do not.
    assert [client.ask("gs").clock for _ in range(3)] == [250, 500, 750]
    assert client.ask("gs").slots[0] == 0
    assert client.ask("sim_truth").values[1] == 1000
    # A speed makes no sense in lockstep: refused (5). Pause holds time also for requests.
    assert client.ask("sim_control", SPEED, 20).values == (5,)
    assert client.ask("sim_control", PAUSE, 0).values == (1, 1000, 0, 1)
    assert client.ask("gs").clock == 1000
    assert client.ask("sim_control", STEP, 5).values == (1, 1005, 0, 1)
    assert client.ask("sim_control", RESUME, 0).values == (1, 1005, 0, 0)
    assert client.ask("gs").clock == 1255
