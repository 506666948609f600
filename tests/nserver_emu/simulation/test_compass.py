"""The compass: ten readings a second, deviation, and the turn that takes it away."""

from __future__ import annotations

from collections.abc import Callable
from math import pi, radians, sin, tau

import numpy as np
import pytest

from nserver_emu.simulation.noise import IDEAL, RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import to_ps
from nserver_emu.simulation.sensors import (
    COMPASS_INTERVAL_PS,
    NO_COMPASS_NOISE,
    Compass,
    CompassMode,
    CompassNoise,
    last_reading_ps,
)
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose

Lone = Callable[..., tuple[Simulation, SimulatedRobot]]
IRON = CompassNoise(deviation_rad=radians(6.0))


def needle_of(robot: SimulatedRobot) -> Compass:
    assert robot.compass is not None
    return robot.compass


def compass(noise: CompassNoise = NO_COMPASS_NOISE) -> Compass:
    return Compass(noise, 0.0, 0, np.random.default_rng(2))


def test_readings_are_due_every_tenth_of_a_second() -> None:
    needle = compass()
    assert needle.due_ps == COMPASS_INTERVAL_PS
    assert last_reading_ps(COMPASS_INTERVAL_PS) == COMPASS_INTERVAL_PS
    assert last_reading_ps(to_ps(0.78)) == 7 * COMPASS_INTERVAL_PS
    needle.read(7 * COMPASS_INTERVAL_PS, 1.0, 1.0)
    expected = (1.0, 7 * COMPASS_INTERVAL_PS, 8 * COMPASS_INTERVAL_PS)
    assert (needle.direction_rad, needle.read_ps, needle.due_ps) == expected


@pytest.mark.parametrize("step_s", [0.01, 0.037, 0.5, 3.0])
def test_the_step_size_changes_no_compass_reading(lone: Lone, step_s: float) -> None:
    simulation, robot = lone()
    robot.set_velocities(0.0, 0.0, 0.7)
    for _ in range(round(3.0 / step_s)):
        simulation.step(step_s)
    simulation.step(3.05 - simulation.time_s)
    assert needle_of(robot).direction_rad == pytest.approx(0.7 * 3.0)
    assert robot.actual.turret_rad == pytest.approx(0.7 * 3.05)


def test_it_follows_turns_that_end_between_readings(lone: Lone) -> None:
    simulation, robot = lone(StartPose(0.0, 0.0, 0.0, 0.5), RobotSetup("r", True, IDEAL.motion, IDEAL.sonar))
    assert needle_of(robot).direction_rad == 0.5
    # An empty order switches the sonars off: no readings in between.
    robot.configure_sonars(15, ())
    robot.move_relative(0.0, 0.0, 0.3)
    simulation.step(20.0)
    assert needle_of(robot).direction_rad == pytest.approx(0.8)
    # Placing changes the direction without a turn.
    robot.place(0.0, 0.0, 0.0, 2.0)
    simulation.step(0.1)
    assert needle_of(robot).direction_rad == pytest.approx(2.0)


def test_calibration_by_a_full_turn_removes_the_deviation() -> None:
    needle = compass(IRON)

    def turn(count: int) -> None:
        start = needle.read_ps // COMPASS_INTERVAL_PS
        # Readings at the interval of the compass, 0.1 rad apart.
        for number in range(start + 1, start + 1 + count):
            needle.read(number * COMPASS_INTERVAL_PS, (0.1 * number) % tau, 0.1 * number)

    turn(10)
    # After 10 readings: 1.0 rad and the deviation of the iron.
    assert needle.direction_rad == pytest.approx(1.0 + radians(6.0) * sin(1.0 + IRON.phase_rad))
    turn(70)
    needle.configure(2, 8.0)
    # 62 steps of 0.1 rad are less than a full turn of 6.28 rad, 64 are more.
    turn(62)
    assert (needle.calibrated, needle.mode) == (False, CompassMode.CALIBRATING)
    turn(2)
    assert (needle.calibrated, needle.mode) == (True, CompassMode.ON)
    turn(1)
    # The deviation is gone: 145 steps of 0.1 rad, modulo two turns.
    assert needle.direction_rad == pytest.approx(14.5 - 2 * tau)


def test_off_keeps_the_reading_and_unknown_modes_are_refused() -> None:
    needle = compass()
    # Mode 0 is off: the reading stays and time goes on.
    needle.read(COMPASS_INTERVAL_PS, 1.0, 1.0)
    needle.configure(0, 1.0)
    needle.read(2 * COMPASS_INTERVAL_PS, 2.0, 2.0)
    assert (needle.direction_rad, needle.read_ps) == (1.0, COMPASS_INTERVAL_PS)
    assert needle.due_ps == 3 * COMPASS_INTERVAL_PS
    needle.configure(1, 2.0)
    needle.read(3 * COMPASS_INTERVAL_PS, 2.0, 2.0)
    assert (needle.direction_rad, needle.read_ps) == (2.0, 3 * COMPASS_INTERVAL_PS)
    with pytest.raises(ValueError, match="7"):
        needle.configure(7, 0.0)


def test_each_reading_has_noise_of_its_own() -> None:
    noise = CompassNoise(std_rad=0.01)
    # One compass is read each time, the other only once: noise depends on the number of the interval.
    each, last = compass(noise), compass(noise)
    read = []
    for number in range(1, 2001):
        each.read(number * COMPASS_INTERVAL_PS, pi, 0.0)
        read.append(each.direction_rad)
    last.read(2000 * COMPASS_INTERVAL_PS, pi, 0.0)
    assert last.direction_rad == each.direction_rad
    # The mean of 2000 readings is accurate to 0.01 / 45 rad.
    assert np.mean(read) == pytest.approx(pi, abs=0.001)
    assert np.std(read) == pytest.approx(0.01, rel=0.08)


def turned(simulation: Simulation, robot: SimulatedRobot, turn_rad: float) -> bool:
    """Turn the turret, wait for it, and return True if the compass is calibrated by then."""
    robot.move_relative(0.0, 0.0, turn_rad)
    simulation.step(abs(turn_rad) / radians(45.0) + 0.2)
    return needle_of(robot).calibrated


def test_a_turn_of_359_degrees_does_not_calibrate(lone: Lone) -> None:
    for turn_rad, done in ((tau, True), (-tau, True), (radians(359.0), False), (radians(-359.0), False)):
        simulation, robot = lone(StartPose(0.0, 0.0, 0.0, radians(359.0)))
        simulation.step(0.05)
        robot.configure_compass(2)
        assert turned(simulation, robot, turn_rad) is done


def test_turns_before_calibration_and_while_off_do_not_count(lone: Lone) -> None:
    simulation, robot = lone()
    turned(simulation, robot, 2.0)
    robot.configure_compass(0)
    turned(simulation, robot, 7.0)
    robot.configure_compass(2)
    assert not turned(simulation, robot, radians(350.0))
    assert turned(simulation, robot, radians(10.0))


def test_turning_to_and_fro_is_no_full_turn(lone: Lone) -> None:
    simulation, robot = lone()
    robot.configure_compass(2)
    assert not any(turned(simulation, robot, turn) for turn in (0.2, -0.2) * 40)


def test_a_robot_that_is_put_elsewhere_has_not_turned(lone: Lone) -> None:
    simulation, robot = lone()
    robot.configure_compass(2)
    # Jumps of any size by placing do not count as turns.
    for angle in (radians(359.0), 0.0, 3.0, 12.0, -9.0):
        robot.place(0.0, 0.0, 0.0, angle)
        simulation.step(0.3)
        assert not needle_of(robot).calibrated
    # 200 and 159 degrees are just less than a full turn, 360 in total are enough.
    assert not turned(simulation, robot, radians(200.0))
    robot.place(0.0, 0.0, 0.0, 1.0)
    assert not turned(simulation, robot, radians(159.0))
    assert turned(simulation, robot, radians(1.0))


def test_finding_zero_after_whole_turns_is_no_turn(lone: Lone) -> None:
    simulation, robot = lone()
    turned(simulation, robot, 2 * tau)
    robot.configure_compass(2)
    robot.zero()
    simulation.step(0.3)
    assert not robot.zeroing
    assert not turned(simulation, robot, radians(300.0))
