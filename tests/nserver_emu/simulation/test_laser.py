"""The laser: reach, columns, the robot's frame, and lines against the walls and against an eigenvector."""

from __future__ import annotations

from math import asin, atan2, cos, hypot, inf, pi, radians, sin
from typing import Any

import numpy as np
import pytest

from nserver_emu.simulation.models import N200 as SIMULATED_N200
from nserver_emu.simulation.sensors import ANGLES_RAD, COLUMNS, LineFit, lines, pixels, points, ranges, select_columns
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.simulation.visibility import RobotPositions, SensorPose
from worlds.geometry import FloatArray
from worlds.io import load_world
from worlds.robots import N200
from worlds.world import Polygon, StartPose

RADIUS = N200.radius_in
HERE = SensorPose(0.0, 0.0, 0.0)


def ahead(gap: float, half: float = 500.0) -> np.ndarray:
    return np.array([[RADIUS + gap, -half, RADIUS + gap, half]])


def test_walls_are_measured_from_6_to_180_inches() -> None:
    for gap in (6.01, 60.0, 155.0):
        assert ranges(HERE, ahead(gap), N200) == pytest.approx(gap / np.cos(ANGLES_RAD))
    assert (ranges(HERE, ahead(5.0), N200)[240:242] == inf).all()
    far = ranges(HERE, ahead(170.0), N200)
    assert ((far < inf) == (170.0 / np.cos(ANGLES_RAD) <= 180.0)).all()
    assert (ranges(HERE, np.empty((0, 4)), N200) == inf).all()
    assert (len(ANGLES_RAD), ANGLES_RAD[0], ANGLES_RAD[-1]) == (COLUMNS, -pi / 6, pi / 6)


def test_points_lie_on_the_wall_in_the_frame_of_the_turret() -> None:
    turret, x, y = 2.0, 30.0, -20.0
    # A wall at right angles to the direction 2.2 rad, 90 in away from the sensor.
    normal, distance = np.array([cos(2.2), sin(2.2)]), 90.0
    along = np.array([-normal[1], normal[0]]) * 400.0
    foot = np.array([x, y]) + distance * normal
    found = points(ranges(SensorPose(x, y, turret), np.array([[*(foot - along), *(foot + along)]]), N200), N200)
    assert len(found) == COLUMNS
    # Back into the frame of the world: all points lie on the wall.
    back = np.array([[cos(turret), sin(turret)], [-sin(turret), cos(turret)]])
    assert (found @ back) @ normal == pytest.approx(np.full(COLUMNS, distance))
    # Columns are in order from right to left.
    assert (np.diff(found[:, 1]) > 0.0).all()


def test_another_robot_is_measured() -> None:
    discs = np.array([[0.0, 0.0, 9.0], [0.0, 50.0, 9.0]])
    seen = ranges(SensorPose(0.0, 0.0, pi / 2, RobotPositions(discs), 0), np.empty((0, 4)), N200)
    assert seen.min() == pytest.approx(50.0 - 18.0, abs=1e-3)


def test_another_robot_hides_the_wall_behind_its_arc() -> None:
    discs = np.array([[70.0, 5.0, 9.72], [0.0, 0.0, 9.0]])
    found = points(ranges(SensorPose(0.0, 0.0, 0.0, RobotPositions(discs), 1), ahead(100.0), N200), N200)
    assert len(found) == COLUMNS
    off_rim = np.hypot(found[:, 0] - 70.0, found[:, 1] - 5.0)
    on_arc = np.isclose(off_rim, 9.72, atol=1e-9)
    assert found[~on_arc, 0] == pytest.approx(np.full((~on_arc).sum(), 109.0))
    distance, middle = hypot(70.0 - RADIUS, 5.0), atan2(5.0, 70.0 - RADIUS)
    assert (on_arc == (np.abs(ANGLES_RAD - middle) < asin(9.72 / distance))).all()


def test_pixels_grow_with_nearness_and_columns_are_selected() -> None:
    rows = pixels(ranges(HERE, ahead(6.5, 1.0), N200))
    assert max(rows) == round(2880 / 6.5)
    assert rows[0] == 0
    seen = ranges(HERE, ahead(60.0), N200)
    for most in (1, 7, 100, 481):
        assert (select_columns(seen, most) < inf).sum() == most
    assert select_columns(seen, 0) is seen


def test_a_room_corner_and_a_gap_become_three_lines() -> None:
    # A wall with a gap of 30 in, and a corner.
    walls = np.array(
        [[109.0, -80.0, 109.0, -10.0], [109.0, 20.0, 109.0, 40.0], [109.0, 40.0, 69.0, 80.0]]
    )
    found = lines(points(ranges(HERE, walls, N200), N200), LineFit())
    assert len(found) == 3
    assert found[0][[0, 2]] == pytest.approx([109.0, 109.0], abs=1e-6)
    assert found[0][3] == pytest.approx(-10.0, abs=0.5)
    # Ends are accurate to a column of the scan.
    assert found[1] == pytest.approx([109.0, 20.0, 109.0, 40.0], abs=0.5)
    assert found[2][:2] == pytest.approx([109.0, 40.0], abs=0.5)
    # The third wall is the line x + y = 149.
    assert found[2][0] + found[2][1] == pytest.approx(149.0, abs=1e-2)


def test_settings_decide_what_is_a_line() -> None:
    # Two walls 6 in apart: one line or two, depending on the largest gap.
    found = points(ranges(HERE, np.array([[60.0, -9.0, 60.0, -3.0], [60.0, 3.0, 60.0, 9.0]]), N200), N200)
    assert len(lines(found, LineFit(gap_in=5.0))) == 2
    assert len(lines(found, LineFit(gap_in=7.0))) == 1
    assert len(lines(found, LineFit(gap_in=5.0, min_points=len(found)))) == 0
    # A bend of 2 in at most off the chord.
    bent = np.array([[float(x), abs(x) / 10.0] for x in range(-20, 21)])
    assert len(lines(bent, LineFit(threshold_in=2.1))) == 1
    assert len(lines(bent, LineFit(threshold_in=1.9))) == 2
    assert lines(np.empty((0, 2)), LineFit()).shape == (0, 4)
    assert len(lines(np.ones((9, 2)), LineFit())) == 1


@pytest.mark.parametrize("turn", [0.0, 40.0, 90.0, 133.0, 270.0])
def test_a_line_is_the_one_of_least_squared_distances(turn: float) -> None:
    # Random points around a line, 0.2 in off.
    rng = np.random.default_rng(1)
    direction = np.array([cos(radians(turn)), sin(radians(turn))])
    found = 50.0 + np.outer(np.linspace(0.0, 40.0, 60), direction) + rng.normal(0.0, 0.2, (60, 2))
    (line,) = lines(found, LineFit(threshold_in=5.0))
    # The line of least squared distances is the main axis of the covariance.
    values, vectors = np.linalg.eigh(np.cov(found.T))
    fitted = line[2:] - line[:2]
    assert abs(fitted @ vectors[:, 1]) == pytest.approx(np.hypot(*fitted))
    assert values[1] > values[0]
    assert fitted @ direction > 0.0
    assert abs((line[:2] - found.mean(axis=0)) @ vectors[:, 0]) < 1e-9


def test_a_robot_that_stands_is_scanned_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scans = 0

    def counted(*args: Any) -> FloatArray:
        nonlocal scans
        scans += 1
        return ranges(*args)

    monkeypatch.setattr("nserver_emu.simulation.robot.ranges", counted)
    simulation = Simulation(load_world("several_walls"))
    robot = simulation.add_robot(1, model=SIMULATED_N200)

    def scanned() -> int:
        before = scans
        pose = SensorPose(robot.actual.x_in, robot.actual.y_in, robot.actual.turret_rad)
        expected = ranges(pose, simulation.world.walls, N200)
        np.testing.assert_array_equal(robot.scan_laser(), select_columns(expected, 0))
        np.testing.assert_array_equal(robot.scan_laser(51), select_columns(expected, 51))
        return scans - before

    assert scanned() == 1
    simulation.step(1.0)
    assert scanned() == 0
    # A turn of the turret, a place elsewhere, an obstacle.
    robot.move_relative(0.0, 0.0, 0.1)
    simulation.step(1.0)
    assert scanned() == 1
    simulation.place(1, 40.0, 50.0, 0.0, 0.0)
    assert scanned() == 1
    box = Polygon(((70.0, 40.0), (75.0, 40.0), (75.0, 60.0), (70.0, 60.0)))
    simulation.change_world(simulation.world.with_obstacles((box,)))
    assert scanned() == 1
    assert scanned() == 0


def test_others_are_looked_for_in_each_scan() -> None:
    simulation = Simulation(load_world("arena"))
    robot = simulation.add_robot(1, model=SIMULATED_N200)
    at = robot.actual
    ahead = [(at.x_in + far * cos(at.turret_rad), at.y_in + far * sin(at.turret_rad)) for far in (40.0, 30.0)]
    simulation.add_robot(2, StartPose(*ahead[0]))
    far_in = robot.scan_laser()[COLUMNS // 2]
    simulation.place(2, *ahead[1], 0.0, 0.0)
    assert robot.scan_laser()[COLUMNS // 2] == pytest.approx(far_in - 10.0, abs=0.01)
