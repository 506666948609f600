"""A Scout as a whole: wheels, sonars and bumpers that turn with the body, and its zero."""

from __future__ import annotations

from math import cos, pi, radians, sin

import pytest

from nserver_emu.simulation.models import SCOUT, SCOUT_TRACK_IN
from nserver_emu.simulation.noise import NOISY
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose, World

QUARTER_IN = 90.0 * 0.118597
"""Travel of each wheel for a quarter turn on the spot."""


def scout(room: World, x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> tuple[Simulation, SimulatedRobot]:
    simulation = Simulation(room)
    return simulation, simulation.add_robot(1, StartPose(x, y, heading, 1.0), SCOUT)


def test_wheels_draw_the_arc_and_turret_is_heading(room: World) -> None:
    simulation, robot = scout(room)
    robot.set_velocities(12.0, 8.0, 99.0)
    assert robot.velocities == (12.0, 8.0, 0.0)
    assert robot.moving == (True, True, False)
    simulation.step(2.0)
    turn, radius = 4.0 / SCOUT_TRACK_IN * 2.0, 0.5 * SCOUT_TRACK_IN * 20.0 / 4.0
    expected = radius * sin(turn), radius * (1.0 - cos(turn)), turn, turn
    assert robot.encoder == robot.actual == pytest.approx(expected)


def test_sonars_turn_with_the_body(room: World) -> None:
    simulation, robot = scout(room, 30.0, -10.0)
    assert [robot.sonar.readings_in[number] for number in (0, 4, 8, 12)] == [62, 102, 122, 82]
    robot.move_relative(QUARTER_IN, -QUARTER_IN, 0.0)
    simulation.step(2.0)
    assert robot.is_still((0, 1))
    assert [robot.sonar.readings_in[number] for number in (0, 4, 8, 12)] == [102, 122, 82, 62]


def test_six_bumpers_turn_with_the_body(room: World) -> None:
    simulation, robot = scout(room, 80.0)
    # 12 in to the wall, at 10 in/s.
    robot.set_velocities(10.0, 10.0, 0.0)
    simulation.step(3.0)
    assert robot.actual.x_in == pytest.approx(92.0)
    assert (robot.bumpers, robot.moving) == (1, (False, False, False))
    # A third of two quarters is 60 degrees: the next of six bumpers faces the wall.
    for turned in (1, 2, 3):
        robot.move_relative(QUARTER_IN * 2.0 / 3.0, -QUARTER_IN * 2.0 / 3.0, 0.0)
        simulation.step(2.0)
        assert robot.bumpers == 1 << (6 - turned)
    # After 180 degrees it drives away.
    robot.set_velocities(10.0, 10.0, 0.0)
    simulation.step(1.0)
    assert robot.actual.x_in == pytest.approx(82.0)


def test_zero_stops_and_reads_0_where_it_stands(room: World) -> None:
    simulation, robot = scout(room, 10.0, 20.0, radians(50.0))
    robot.set_velocities(5.0, -5.0, 0.0)
    robot.zero()
    assert (robot.zeroing, robot.encoder) == (False, (0.0, 0.0, 0.0, 0.0))
    assert robot.actual == pytest.approx((10.0, 20.0, radians(50.0), radians(50.0)))
    robot.move_relative(10.0, 10.0, 0.0)
    simulation.step(3.0)
    assert robot.encoder == pytest.approx((10.0, 0.0, 0.0, 0.0))


def test_the_encoders_have_one_angle(room: World) -> None:
    _, robot = scout(room)
    robot.define_angles(pi / 2, 1.0)
    assert robot.encoder == pytest.approx((0.0, 0.0, pi / 2, pi / 2))
    robot.place(5.0, 5.0, 0.25, 2.0)
    assert robot.encoder == robot.actual == pytest.approx((5.0, 5.0, 0.25, 0.25))


def test_noise_keeps_turret_and_heading_one(room: World) -> None:
    simulation = Simulation(room, 5)
    robot = simulation.add_robot(1, model=SCOUT, setup=NOISY)
    robot.set_velocities(9.0, 11.0, 0.0)
    simulation.step(4.0)
    assert robot.actual.steering_rad == robot.actual.turret_rad != robot.encoder.steering_rad
