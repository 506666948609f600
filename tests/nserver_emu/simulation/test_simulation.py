"""A whole simulation: in steps of any size, restored, repeated."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from nclient.errors import StartError
from nserver_emu.simulation.noise import IDEAL, NOISY, SETUPS, RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from worlds.world import Polygon, StartPose, World

Lone = Callable[..., tuple[Simulation, SimulatedRobot]]


def roam(simulation: Simulation, robot: SimulatedRobot, steps: int, cuts: int = 1) -> list[Any]:
    """Drive about, in steps of 0.1 s cut into pieces; all that can be seen after each step."""
    seen: list[Any] = []
    for step in range(steps):
        if step % 20 == 0:
            robot.set_velocities(15.0, 0.3, -0.4)
        elif step % 20 == 7:
            robot.move_relative(-9.0, 0.5, 0.2)
        for _ in range(cuts):
            simulation.step(0.1 / cuts)
        seen.append((robot.encoder, robot.actual, robot.velocities, robot.moving, robot.bumpers))
        seen.append((robot.sonar.readings_in, robot.sonar.stamps, simulation.time_s))
    return seen


def flat(seen: Any) -> list[float]:
    """All numbers in nested tuples."""
    if isinstance(seen, (tuple, list)):
        return [number for part in seen for number in flat(part)]
    return [float(seen)]


@pytest.mark.long
@pytest.mark.parametrize("setup", [IDEAL, RobotSetup("ramps", True, IDEAL.motion, IDEAL.sonar)], ids=["ideal", "ramps"])
def test_ten_times_a_tenth_is_a_hundred_times_a_hundredth(lone: Lone, setup: RobotSetup) -> None:
    start = StartPose(83.0, 40.0, 0.3, 0.0)
    whole = flat(roam(*lone(start, setup), 80))
    for cuts in (10, 8):
        np.testing.assert_allclose(flat(roam(*lone(start, setup), 80, cuts)), whole, rtol=0.0, atol=1e-9)


def test_the_roaming_robot_of_these_tests_meets_a_wall(lone: Lone) -> None:
    simulation, robot = lone(StartPose(83.0, 40.0, 0.3, 0.0))
    assert len({row[4] for row in roam(simulation, robot, 80)[::2]}) > 1


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(SETUPS))
def test_a_restored_simulation_continues_bit_for_bit(lone: Lone, name: str) -> None:
    simulation, robot = lone(StartPose(83.0, 40.0, 0.3, 0.0), SETUPS[name])
    robot.set_timeout(1.5)
    roam(simulation, robot, 33)
    simulation.step(0.05)
    twin = Simulation.from_state(simulation.to_state())
    assert roam(simulation, robot, 50) == roam(twin, twin.robots[1], 50)
    assert twin.world.starts == simulation.world.starts
    assert not twin.world.walls.flags.writeable


def test_the_same_seed_gives_the_same_run_and_another_another(lone: Lone) -> None:
    motions = [roam(*lone(setup=NOISY, seed=seed), 20) for seed in (3, 3, 4)]
    assert motions[0] == motions[1]
    assert motions[0] != motions[2]


@pytest.mark.long
def test_robots_have_random_streams_of_their_own(room: World) -> None:
    alone, together = Simulation(room, 3), Simulation(room, 3)
    for simulation in (alone, together):
        simulation.add_robot(2, StartPose(50.0, 50.0), setup=NOISY)
    other = together.add_robot(1, StartPose(-50.0, -50.0), setup=NOISY)
    other.set_velocities(5.0, 0.1, 0.2)
    paths = [roam(simulation, simulation.robots[2], 10, cuts=10)[::2] for simulation in (alone, together)]
    assert paths[0] == paths[1]
    assert other.actual.x_in != other.encoder.x_in


def test_reading_sensors_changes_nothing(lone: Lone) -> None:
    watched, blind = lone(setup=NOISY), lone(setup=NOISY)
    # The first robot is read after each step, the second never.
    seen = roam(*watched, 20)
    simulation, robot = blind
    for step in range(20):
        # The same commands at the same instants.
        if step == 0:
            robot.set_velocities(15.0, 0.3, -0.4)
        elif step == 7:
            robot.move_relative(-9.0, 0.5, 0.2)
        simulation.step(0.1)
    assert (robot.sonar.readings_in, robot.sonar.stamps, simulation.time_s) == seen[-1]


def test_starts(room: World) -> None:
    # Without a start it is placed at the origin.
    simulation = Simulation(room)
    first = simulation.add_robot(1)
    assert first.actual == (0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="here already"):
        simulation.add_robot(1)
    # 5 in from the wall there is no room; the failed robot leaves nothing.
    with pytest.raises(StartError):
        simulation.add_robot(2, StartPose(95.0, 0.0))
    assert list(simulation.robots) == [1]
    # A robot that is added later has the time of the simulation.
    simulation.step(2.5)
    second = simulation.add_robot(2, StartPose(50.0, 0.0))
    assert second.time_s == simulation.time_s == 2.5
    assert second.sonar.stamps[0].sensor_time_s == 2.5
    simulation.step(1.0)
    assert second.time_s == 3.5


def test_time_runs_forward_only(lone: Lone) -> None:
    simulation, _ = lone()
    with pytest.raises(ValueError, match="0 s or more"):
        simulation.step(-0.1)
    simulation.step(0.0)
    assert simulation.time_s == 0.0


def test_a_changed_world_is_touched_and_measured(lone: Lone) -> None:
    simulation, robot = lone()
    # A block 30 in ahead appears.
    before = robot.sonar.readings_in[0]
    block = Polygon(((30.0, -20.0), (50.0, -20.0), (50.0, 20.0), (30.0, 20.0)))
    simulation.change_world(simulation.world.with_obstacles((block,)))
    # The reading is that of the last firing: 100 - 9.06 in.
    assert robot.sonar.readings_in[0] == before == 91
    robot.set_velocities(10.0, 0.0, 0.0)
    simulation.step(5.0)
    # Contact at the block, where a sonar reads its minimum of 6 in.
    assert robot.actual.x_in == pytest.approx(30.0 - 9.72)
    assert robot.sonar.readings_in[0] == 6
    # Without the block the bumper is released at once.
    simulation.change_world(simulation.world.with_obstacles(()))
    assert robot.bumpers == 0


def test_stamps_are_one_firing_interval_apart(lone: Lone) -> None:
    simulation, robot = lone()
    simulation.step(5.0)
    times = sorted(stamp.sensor_time_s for stamp in robot.sonar.stamps)
    assert [later - sooner for sooner, later in pairwise(times)] == pytest.approx([0.06] * 15)
