"""Several robots: contact, detection of one another, and no permanent priority."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from math import hypot, pi, radians

import numpy as np
import pytest

from nclient.errors import StartError
from nserver_emu.simulation.models import N150, N200, SCOUT, RobotModel
from nserver_emu.simulation.multi_robot import SLACK_IN, TICK_PS, candidate_pairs, discs_of, neighbours
from nserver_emu.simulation.noise import IDEAL, NOISY, RobotSetup
from nserver_emu.simulation.odometry import MotionNoise, Odometry
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.sonar import SonarNoise
from worlds.world import Polygon, StartPose, World

pytestmark = pytest.mark.long

TOUCHING = 2.0 * N150.body.radius_in
TOUCHING_N200 = N150.body.radius_in + N200.body.radius_in


def two(room: World, gap_in: float, setup: RobotSetup = IDEAL) -> Simulation:
    """Two N150 on the x axis, face to face, so far apart."""
    simulation = Simulation(room)
    distance = 0.5 * (gap_in + TOUCHING)
    simulation.add_robot(1, StartPose(-distance, 0.0), setup=setup)
    simulation.add_robot(2, StartPose(distance, 0.0, pi, pi), setup=setup)
    return simulation


def apart(simulation: Simulation) -> float:
    """Least gap between two robots, inches."""
    discs = [robot.disc for robot in simulation.robots.values()]
    return min(hypot(x - u, y - v) - r - s for (x, y, r), (u, v, s) in combinations(discs, 2))


def test_a_robot_stops_at_one_that_stands(room: World) -> None:
    simulation = two(room, 40.0)
    first, second = simulation.robots.values()
    first.set_velocities(20.0, 0.0, 0.0)
    # The gap of 40 in takes 2 s at 20 in/s: no contact yet.
    simulation.step(1.9)
    assert first.bumpers == second.bumpers == 0
    simulation.step(3.0)
    # The first drives until both touch; the second stays where it is.
    assert apart(simulation) == pytest.approx(0.0, abs=1e-9)
    assert not first.moving[0]
    # Bumper 0 is ahead, bumper 10 is behind.
    assert (first.bumpers, second.bumpers) == (1 << 0, 1 << 10)
    assert second.actual.x_in == pytest.approx(0.5 * (40.0 + TOUCHING))
    # Pressing on does not move.
    first.set_velocities(5.0, 0.0, 0.0)
    simulation.step(0.5)
    assert not first.moving[0]
    # The other may leave.
    second.set_velocities(-10.0, 0.0, 0.0)
    simulation.step(1.0)
    assert apart(simulation) == pytest.approx(10.0)
    assert (first.bumpers, second.bumpers) == (0, 0)


@pytest.mark.parametrize("step_s", [0.1, 0.0137, 1.0])
def test_approaching_robots_stop_and_never_overlap(room: World, step_s: float) -> None:
    simulation = two(room, 40.0)
    # Both drive towards each other at 10 in/s.
    for robot in simulation.robots.values():
        robot.set_velocities(10.0, 0.0, 0.0)
    for _ in range(round(4.0 / step_s)):
        simulation.step(step_s)
        assert apart(simulation) >= -1e-9
    first, second = simulation.robots.values()
    assert apart(simulation) == pytest.approx(0.0, abs=1e-9)
    assert not first.moving[0]
    assert not second.moving[0]
    # They meet in the middle, to a tick of both.
    assert first.actual.x_in + second.actual.x_in == pytest.approx(0.0, abs=0.21)


def test_many_robots_never_overlap_and_runs_repeat(room: World) -> None:
    # Six robots of three models in random motion; contact occurs often.
    def motion() -> list[tuple[float, ...]]:
        simulation, rng = Simulation(room, 3), np.random.default_rng(4)
        for number in range(6):
            model = (N150, N200, SCOUT)[number % 3]
            simulation.add_robot(number + 1, StartPose(-60.0 + 24.0 * number, 5.0 * number), model, NOISY)
        for _ in range(40):
            for robot in simulation.robots.values():
                first, second = rng.uniform(-15.0, 15.0, 2).tolist()
                robot.set_velocities(first, second, 0.0)
            simulation.step(0.25)
            # Rims may overlap by rounding only.
            assert apart(simulation) >= -1e-6
        return [robot.actual for robot in simulation.robots.values()]

    assert motion() == motion()


def test_sonars_detect_other_robots(room: World) -> None:
    simulation = two(room, 40.0)
    first, second = simulation.robots.values()
    simulation.step(1.0)
    # From the ring of one to the rim of the other.
    seen = 40.0 + N150.body.radius_in - N150.body.sonar_ring_radius_in
    assert first.sonar.readings_in[0] == second.sonar.readings_in[0] == round(seen)
    # The back sonars measure the walls of the room.
    assert first.sonar.readings_in[8] == second.sonar.readings_in[8] < 65
    # Moved aside, the wall is measured again.
    second.place(0.5 * (40.0 + TOUCHING), 60.0, pi, pi)
    simulation.step(1.0)
    assert first.sonar.readings_in[0] > 100


def test_a_new_robot_is_detected_and_detects_at_once(room: World) -> None:
    simulation = two(room, 40.0)
    assert simulation.robots[2].sonar.readings_in[0] == 41
    assert simulation.robots[1].sonar.readings_in[0] == round(100.0 + 0.5 * (40.0 + TOUCHING) - 9.06)


def test_moving_robots_are_detected_where_they_were_a_tick_ago(room: World) -> None:
    readings = []
    # Steps of the simulation must not decide where an echo comes from.
    for step_s in (0.5, 0.01, 0.007):
        simulation = two(room, 60.0)
        # Only sonar 0 fires, every 20 ms.
        simulation.robots[1].configure_sonars(5, (0, 255))
        simulation.robots[2].set_velocities(20.0, 0.0, 0.0)
        while simulation.time_s < 1.5 - 1e-9:
            simulation.step(min(step_s, 1.5 - simulation.time_s))
        readings.append(simulation.robots[1].sonar.readings_in[0])
        fired = simulation.robots[1].sonar.stamps[0].sensor_time_s
        # A tick of 10 ms and rounding to whole inches.
        assert readings[-1] == pytest.approx(60.66 - 20.0 * fired, abs=0.71)
    assert len(set(readings)) == 1


def test_starts_keep_clear_of_other_robots(room: World) -> None:
    simulation = Simulation(room)
    # With a radius of 9.72 in, robots overlap 15 in apart, and do not 20 in apart.
    simulation.add_robot(2, StartPose(0.0, 0.0))
    with pytest.raises(StartError, match="touches robot 2"):
        simulation.add_robot(1, StartPose(15.0, 0.0))
    simulation.add_robot(1, StartPose(20.0, 0.0))
    assert list(simulation.robots) == [1, 2]
    # A place for robot 2 next to robot 1: its own place does not count.
    with pytest.raises(StartError, match="robot 1"):
        simulation.require_free(15.0, 0.0, 9.72, robot_id=2)
    simulation.require_free(-1.0, 0.0, 9.72, robot_id=2)


def test_neighbours_by_their_gaps() -> None:
    discs = np.array([[0.0, 0.0, 9.0], [18.0 + 1.9, 0.0, 9.0], [0.0, 17.0 + 2.1, 8.0]])
    assert neighbours(discs, 2.0) == [(0, 1)]
    assert neighbours(discs[:1], 2.0) == neighbours(discs[:0], 2.0) == []


@pytest.mark.parametrize("count", [2, 7, 60])
def test_neighbours_equal_a_search_of_all_pairs(count: int) -> None:
    rng = np.random.default_rng(count)
    discs = np.column_stack((rng.uniform(-100.0, 100.0, (count, 2)), rng.uniform(5.0, 9.0, count)))
    pairs = combinations(enumerate(discs.tolist()), 2)
    found = [(row, other) for (row, (x, y, r)), (other, (u, v, s)) in pairs if hypot(x - u, y - v) - r - s < 6.0]
    assert neighbours(discs, 6.0) == found


@pytest.mark.parametrize("model", [N150, SCOUT])
def test_candidate_pairs_depend_on_speed(room: World, model: RobotModel) -> None:
    simulation = Simulation(room)
    robots = [simulation.add_robot(number, StartPose(35.0 * number, 0.0), model) for number in (0, 1)]
    gap = 35.0 - 2.0 * model.body.radius_in
    second = 100 * TICK_PS
    assert candidate_pairs(robots, second) == []
    robots[0].set_velocities(15.0, 15.0, 0.0)
    assert candidate_pairs(robots, round(second * (gap - 2.0 * SLACK_IN) / 15.0)) == []
    assert candidate_pairs(robots, round(second * gap / 15.0)) == [(0, 1)]


@pytest.mark.parametrize("model", [N150, SCOUT])
def test_noise_and_odometry_errors_widen_the_bounds(room: World, model: RobotModel) -> None:
    # Noise of distance and turn only.
    noise = RobotSetup("sideways", False, MotionNoise(alpha3=0.01, alpha4=0.04), SonarNoise())
    robots = [
        Simulation(room).add_robot(1, model=model, setup=setup)
        for setup in (noise, replace(noise, odometry=Odometry(scales=(1.21, 1.21, 1.0))))
    ]
    # At rest it cannot move at all.
    assert [robot.max_travel_in(2.0) for robot in robots] == [0.0, 0.0]
    for robot in robots:
        # Speeds along and turning; a Scout turns by its wheels.
        robot.set_velocities(*((10.0, 0.5, 0.0) if model is N150 else (10.0, 6.0, 0.0)))
    turn_rad = 1.0 if model.track_in is None else 2.0 * 16.0 / model.track_in
    # Variance of the distance in 2 s: alpha3 x 20 in + alpha4 x turn.
    std_in = (0.01 * 20.0 + 0.04 * turn_rad) ** 0.5
    # Six standard deviations on top of the distance, scaled by the odometry.
    assert robots[0].max_travel_in(2.0) == pytest.approx(20.0 + 6.0 * std_in)
    assert robots[1].max_travel_in(2.0) == pytest.approx(24.2 + 6.6 * std_in)
    for robot in robots:
        # A turret alone moves nothing.
        robot.set_velocities(0.0, 0.0, 1.0)
    assert [robot.max_travel_in(2.0) for robot in robots] == [0.0, 0.0]


def roaming(seed: int, world: World, setup: RobotSetup, count: int = 14) -> Iterator[Simulation]:
    """Yield a simulation of several robots of three models in a small room, at each new command, every 0.3 s."""
    rng, simulation = np.random.default_rng(seed), Simulation(world, seed)
    # Three models in turn, on a grid with room for each.
    for number in range(count):
        start = StartPose(-75.0 + 37.0 * (number % 5), -60.0 + 40.0 * (number // 5), number, number)
        simulation.add_robot(number + 1, start, (N150, N200, SCOUT)[number % 3], setup)
    for _ in range(25):
        for robot in simulation.robots.values():
            # Not all get a new command each time: motions of different length overlap.
            if rng.uniform() < 0.7:
                first, second = rng.uniform(-18.0, 18.0, 2).tolist()
                robot.set_velocities(first, first + 0.2 * second if robot.model is SCOUT else 0.05 * second, 0.1)
        yield simulation


def by_ticks(simulation: Simulation, begin_ps: int, end_ps: int) -> None:
    """Advance all robots by ticks, each against all others: the brute-force form of `RobotGroup`."""
    robots = list(simulation.robots.values())
    for tick in range(begin_ps // TICK_PS, end_ps // TICK_PS):
        for turn in range(len(robots)):
            robot = robots[(tick + turn) % len(robots)]
            robot.set_obstacles([other.disc for other in robots if other is not robot])
            robot.advance_to((tick + 1) * TICK_PS)


@pytest.mark.parametrize("seed", range(2))
def test_advancing_pairs_equals_advancing_all_by_ticks(room: World, seed: int) -> None:
    """To the bit it cannot be: a path that is not cut at ticks sums up otherwise, and a contact is solved to 1e-10."""
    touched = 0
    ramps = RobotSetup("ramps", seed % 2 == 0, IDEAL.motion, IDEAL.sonar)
    # 30 ticks of 10 ms at a time.
    for step, (quick, slow) in enumerate(zip(roaming(seed, room, ramps), roaming(seed, room, ramps), strict=True)):
        quick.step(0.3)
        by_ticks(slow, 30 * step * TICK_PS, 30 * (step + 1) * TICK_PS)
        for robot, other in zip(quick.robots.values(), slow.robots.values(), strict=True):
            assert robot.actual[:2] == pytest.approx(other.actual[:2], abs=1e-8)
            assert (robot.moving, robot.bumpers) == (other.moving, other.bumpers)
        assert apart(quick) > -1e-9
        touched += apart(quick) < 1e-3
    # Contacts must have occurred.
    assert touched > 2


@pytest.mark.parametrize("setup", [IDEAL, NOISY])
def test_meeting_robots_repeat_also_after_a_restore(room: World, setup: RobotSetup) -> None:
    def states(simulation: Simulation) -> list[object]:
        return [(robot.actual, robot.encoder, robot.bumpers) for robot in simulation.robots.values()]

    for step, (first, again) in enumerate(zip(roaming(9, room, setup), roaming(9, room, setup), strict=True)):
        # Each eighth state is saved and restored.
        twin = Simulation.from_state(first.to_state()) if step % 8 == 0 else again
        for simulation in {id(one): one for one in (first, again, twin)}.values():
            simulation.step(0.3)
        assert states(first) == states(again) == states(twin)
        assert apart(first) > -1e-6


@pytest.mark.parametrize("setup", [IDEAL, RobotSetup("ramps", True, IDEAL.motion, IDEAL.sonar)])
def test_past_positions_follow_the_trajectory(room: World, setup: RobotSetup) -> None:
    def robots() -> Simulation:
        simulation = two(room, 60.0, setup)
        # Not a multiple of a tick.
        simulation.step(0.0037)
        simulation.robots[1].set_velocities(20.0, 2.0, 0.0)
        simulation.robots[2].move_relative(0.4, 0.0, 0.0)
        return simulation

    whole = list(robots().robots.values())
    # A recorded trajectory, once as a whole.
    for robot in whole:
        robot.start_trajectory()
        robot.advance_to(12 * TICK_PS)
    # Compared with robots that are advanced to each tick.
    for tick in range(1, 13):
        again = robots()
        for robot in again.robots.values():
            robot.advance_to(tick * TICK_PS)
        np.testing.assert_allclose(discs_of(whole, tick * TICK_PS), discs_of(again.robots.values()), atol=1e-12)


def test_a_robot_far_from_the_others_runs_as_if_alone(room: World) -> None:
    # The same robot with and without another far away.
    alone, together = Simulation(room, 3), Simulation(room, 3)
    for simulation in (alone, together):
        simulation.add_robot(2, StartPose(50.0, 50.0), setup=NOISY)
    together.add_robot(1, StartPose(-50.0, -50.0), setup=NOISY)
    for simulation in (alone, together):
        simulation.robots[2].set_velocities(5.0, 0.3, 0.2)
        for _ in range(20):
            simulation.step(0.1)
    # Random streams belong to robots: the same noise to the bit.
    assert alone.robots[2].actual == together.robots[2].actual
    assert alone.robots[2].actual != alone.robots[2].encoder


def test_restored_robots_continue_bit_for_bit(room: World) -> None:
    simulation = two(room, 20.0, NOISY)
    for robot in simulation.robots.values():
        robot.set_velocities(6.0, 0.05, radians(10.0))
    # Saved between two ticks.
    simulation.step(0.777)
    twin = Simulation.from_state(simulation.to_state())
    for one in (simulation, twin):
        one.step(2.0)
    for robot, other in zip(simulation.robots.values(), twin.robots.values(), strict=True):
        assert (robot.actual, robot.encoder, robot.bumpers) == (other.actual, other.encoder, other.bumpers)
        assert robot.sonar.readings_in == other.sonar.readings_in


def test_a_change_of_the_world_keeps_the_other_robots(room: World) -> None:
    simulation = two(room, 1.0)
    simulation.step(0.1)
    simulation.change_world(simulation.world.with_obstacles(()))
    simulation.robots[1].set_velocities(20.0, 0.0, 0.0)
    simulation.step(0.5)
    assert apart(simulation) == pytest.approx(0.0, abs=1e-9)


def test_bumpers_stay_pressed_when_the_world_changes(room: World) -> None:
    # In contact: bumper 0 of one and 10 of the other.
    simulation = two(room, 10.0)
    first, second = simulation.robots.values()
    first.set_velocities(20.0, 0.0, 0.0)
    simulation.step(1.0)
    felt = (1 << 0, 1 << 10)
    assert (first.bumpers, second.bumpers) == felt
    # An obstacle far away changes nothing.
    block = Polygon(((80.0, 80.0), (90.0, 80.0), (90.0, 90.0)))
    simulation.change_world(simulation.world.with_obstacles((block,)))
    assert (first.bumpers, second.bumpers) == felt
    # A step of no length neither.
    simulation.step(0.0)
    assert (first.bumpers, second.bumpers) == felt
    simulation.change_world(simulation.world.with_obstacles(()))
    first.set_velocities(5.0, 0.0, 0.0)
    # Pressing on is still no motion.
    simulation.step(0.001)
    assert not first.moving[0]


@pytest.mark.parametrize("before_s", [0.0, 0.013, 0.02])
def test_a_placed_robot_is_detected_there_at_once(room: World, before_s: float) -> None:
    simulation = Simulation(room)
    watcher = simulation.add_robot(1, StartPose(0.0, 0.0), N200)
    other = simulation.add_robot(2, StartPose(50.0, 0.0))
    simulation.step(before_s)
    # The laser sees the other robot ahead.
    clear = watcher.scan_laser().min()
    simulation.place(2, 0.0, 40.0, 0.0, 0.0)
    # After it was placed aside, sonar 4 (90 degrees left) measures it.
    watcher.configure_sonars(15, (4,))
    assert watcher.sonar.readings_in[4] == round(40.0 - N150.body.radius_in - N200.body.sonar_ring_radius_in)
    assert watcher.scan_laser().min() > clear + 10.0
    # Placed in contact: bumpers at once.
    simulation.place(2, TOUCHING_N200, 0.0, 0.0, 0.0)
    assert watcher.bumpers == 1 << 0
    assert other.bumpers == 1 << 10
    # Placed away: free again.
    simulation.place(2, 50.0, 50.0, 0.0, 0.0)
    assert (watcher.bumpers, other.bumpers) == (0, 0)
    watcher.configure_sonars(15, (4,))
    assert watcher.sonar.readings_in[4] == round(100.0 - N200.body.sonar_ring_radius_in)


def test_robots_powered_on_together_detect_each_other(room: World) -> None:
    def wakes(order: tuple[int, ...]) -> list[tuple[float, ...]]:
        simulation = Simulation(room)
        # Powered off, sensors have no readings.
        for number in order:
            simulation.add_robot(number, StartPose(40.0 * number, 0.0, 0.0, 0.0), N200, NOISY, powered=False)
        assert not any(robot.powered for robot in simulation.robots.values())
        # A second call has no effect.
        simulation.power_on()
        simulation.power_on()
        return [
            (*robot.sonar.readings_in, *robot.infrared.readings)
            for robot in simulation.robots.values()
            if robot.infrared is not None
        ]

    # The order of creation must not matter.
    first, *others = (wakes(order) for order in ((0, 1, 2), (2, 1, 0), (1, 2, 0)))
    assert others == [first] * 2
    assert first[0][0] == pytest.approx(40.0 - N200.body.radius_in - N200.body.sonar_ring_radius_in, abs=2.0)
    assert first[1][8] == pytest.approx(first[0][0], abs=2.0)


def strayed(room: World, seed: int, *others: StartPose, speed: float = 0.0) -> tuple[float, float]:
    """Return the final deviations of a noisy robot among others: along its path and across it."""
    simulation = Simulation(room, seed)
    robot = simulation.add_robot(1, StartPose(-60.0, 0.0), setup=NOISY)
    for number, start in enumerate(others, start=2):
        simulation.add_robot(number, start, setup=NOISY).set_velocities(speed, 0.0, 0.0)
    robot.move_relative(50.0, 0.0, 0.0)
    simulation.step(4.0)
    return robot.actual.x_in + 10.0, robot.actual.y_in


BESIDE = StartPose(-10.0 + TOUCHING + 4.0, 0.0, pi, 0.0)
"""Return True before the end of the path."""


def test_distant_or_standing_robots_change_no_random_draws(room: World) -> None:
    alone = strayed(room, 3)
    assert alone == strayed(room, 3, StartPose(60.0, 60.0), StartPose(60.0, -60.0), speed=1.0)
    assert alone == strayed(room, 3, BESIDE)


def test_near_moving_robots_change_draws_but_not_their_spread(room: World) -> None:
    alone = np.array([strayed(room, seed) for seed in range(60)])
    near_another = np.array([strayed(room, seed, BESIDE, speed=0.5) for seed in range(60)])
    assert (alone != near_another).any(axis=1).sum() > 10
    spread = alone.std(axis=0)
    assert np.abs(near_another.mean(axis=0) - alone.mean(axis=0)).max() < 4.0 * spread.max() * (2.0 / 60) ** 0.5
    assert near_another.std(axis=0) / spread == pytest.approx(1.0, abs=4.0 / 60**0.5)
