"""Wherever a robot comes within a span, it comes no nearer to anything than its reach says."""

from __future__ import annotations

from dataclasses import replace
from math import cos, hypot, pi, sin, tau

import numpy as np
import pytest

from nserver_emu.simulation.models import N150, SCOUT, RobotModel
from nserver_emu.simulation.multi_robot import STATIONARY, SweptBounds
from nserver_emu.simulation.noise import IDEAL, WORN, RobotSetup
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose, World

RAMPS = replace(IDEAL, name="ramps", ramps=True)


@pytest.mark.long
@pytest.mark.parametrize("setup", [IDEAL, RAMPS, WORN], ids=lambda setup: setup.name)
@pytest.mark.parametrize("model", [N150, SCOUT], ids=lambda model: model.name)
def test_no_path_is_longer_than_its_bound(room: World, model: RobotModel, setup: RobotSetup) -> None:
    rng = np.random.default_rng(7)
    closest = np.inf
    # 60 random motions, with velocities changed on the way.
    for number in range(60):
        simulation = Simulation(room, number)
        robot = simulation.add_robot(1, StartPose(0.0, 0.0, rng.uniform(0.0, tau)), model, setup)
        for _ in range(2):
            first, second = rng.uniform(-15.0, 15.0, 2).tolist()
            robot.set_velocities(first, second if model is SCOUT else 0.06 * second, 0.0)
            simulation.step(rng.uniform(0.1, 0.6))
        # Each third robot moves to a target.
        if number % 3 == 0:
            first, second = rng.uniform(-4.0, 4.0, 2).tolist()
            robot.move_relative(first, second, 0.0)
        span_s = rng.uniform(0.02, 0.4)
        # Bounds of the next 0.02 to 0.4 s.
        reach, max_travel_in, (x, y, _, _) = robot.swept_bounds(span_s), robot.max_travel_in(span_s), robot.actual
        for _ in range(8):
            simulation.step(span_s / 8.0)
            dx, dy = robot.actual.x_in - x, robot.actual.y_in - y
            assert hypot(dx, dy) <= max_travel_in + 1e-9
            # In each of 24 directions the robot stays within its bound.
            for angle in np.linspace(0.0, tau, 24):
                room_left = reach.towards(cos(angle), sin(angle)) - (dx * cos(angle) + dy * sin(angle))
                assert room_left > -1e-9
                if hypot(dx, dy) > 0.3:
                    closest = min(closest, room_left / hypot(dx, dy))
    # The bound is not much too wide: for worn odometry 1.5 times, else half of the path.
    assert closest < (1.5 if setup is WORN else 0.5)


def test_a_robot_that_drives_away_comes_no_nearer(room: World) -> None:
    robot = Simulation(room).add_robot(1, StartPose(0.0, 0.0))
    # Standing and turning in place sweep nothing.
    assert robot.swept_bounds(1.0) is STATIONARY
    robot.set_velocities(0.0, 0.5, 0.5)
    assert robot.swept_bounds(1.0) is STATIONARY
    # 5 in ahead in half a second, nothing behind; 60 degrees aside half of it.
    robot.set_velocities(10.0, 0.0, 0.0)
    assert robot.swept_bounds(0.5) == SweptBounds(5.0, 0.0, 0.0, 0.0, 0.0)
    assert robot.swept_bounds(0.5).towards(-1.0, 0.0) == 0.0
    assert robot.swept_bounds(0.5).towards(cos(pi / 3), sin(pi / 3)) == pytest.approx(2.5)
    # Backwards with a turn: the path bends by up to 0.5 in.
    robot.set_velocities(-10.0, 0.2, 0.0)
    assert robot.swept_bounds(0.5) == pytest.approx(SweptBounds(0.0, 0.0, -5.0, 0.0, 0.5))
    assert robot.swept_bounds(0.5).towards(-1.0, 0.0) == pytest.approx(5.5)


def test_reversing_ramps_reach_ahead_and_behind(room: World) -> None:
    robot = (simulation := Simulation(room)).add_robot(1, StartPose(0.0, 0.0), setup=RAMPS)
    robot.set_velocities(10.0, 0.0, 0.0)
    simulation.step(2.0)
    robot.set_velocities(-5.0, 0.0, 0.0)
    assert robot.swept_bounds(1.0) == SweptBounds(10.0, 0.0, -5.0, 0.0, 0.0)
