"""Readings of unmapped obstacles, on an emulated robot: a box is found, and its echoes are withheld from the filter."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot

import numpy as np
import pytest

from localization.filters.belief import independent
from localization.filters.health import HEALTHY, FilterHealth, HealthStatus
from localization.filters.update import Refusal
from localization.live.estimate import Echo, Estimate
from localization.navigation.obstacles import MAX_FILTERED, ObstacleTracker, filter_unmapped, update_obstacles
from nclient import connect
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.io import load_world
from worlds.robots import N150

WALLS = np.array(load_world("thesis_room").walls)
BOX = [(28.0, 10.0), (36.0, 10.0), (36.0, 22.0), (28.0, 22.0)]
ANGLES = N150.sonar_angles_rad


@pytest.fixture
def robot() -> Iterator[Robot]:
    """Before a box that the map does not have, all sonars fired."""
    with connect("sim:thesis_room?start=10,16,0,0&step_s=0.1") as robot:
        robot.add_obstacle(corners_in=BOX)
        for _ in range(12):
            robot.refresh()
        yield robot


def estimate(state: RobotState, *sonars: int, health: FilterHealth = HEALTHY) -> Estimate:
    clock = state.clock_s or 0.0
    echoes = tuple(Echo(sonar, clock - 0.05, 6, Refusal.GATE, 0.0) for sonar in sonars)
    belief = independent([state.x_in, state.y_in, state.steering_rad], (0.1, 0.1, 0.01))
    return Estimate(clock, belief, echoes, health)


@pytest.mark.long
def test_only_readings_of_unmapped_obstacles_are_replaced(robot: Robot) -> None:
    state = robot.refresh()
    shown = filter_unmapped(ObstacleTracker(WALLS, N150.sonar_ring_radius_in), estimate(state), state, ANGLES)
    assert state.sonars_in[0] == 9
    assert shown.sonars_in[0] == 6
    differing = [k for k in range(16) if shown.sonars_in[k] != state.sonars_in[k]]
    assert 0 in differing
    assert set(differing) <= {15, 0, 1}
    assert (shown.x_in, shown.y_in, shown.clock_s) == (state.x_in, state.y_in, state.clock_s)


def test_many_short_readings_are_not_filtered(robot: Robot) -> None:
    obstacles, state = ObstacleTracker(np.zeros((0, 4)), N150.sonar_ring_radius_in), robot.refresh()
    near = sum(6 <= reading <= 60 for reading in state.sonars_in)
    assert near > MAX_FILTERED
    assert filter_unmapped(obstacles, estimate(state), state, ANGLES).sonars_in == state.sonars_in


@pytest.mark.long
def test_box_is_confirmed_at_its_place(robot: Robot) -> None:
    obstacles, state = ObstacleTracker(WALLS, N150.sonar_ring_radius_in), robot.refresh()
    for _ in range(3):
        update_obstacles(obstacles, estimate(state, 0, 8, 4), state, ANGLES)
    ((x1, y1, x2, y2),) = obstacles.confirmed
    assert (0.5 * (x1 + x2), 0.5 * (y1 + y2)) == pytest.approx((28.0, 16.0), abs=0.6)


@pytest.mark.long
def test_an_echo_was_measured_where_the_robot_was(robot: Robot) -> None:
    obstacles = ObstacleTracker(WALLS, N150.sonar_ring_radius_in)
    robot.drive(translation_in_s=5.0)
    for _ in range(4):
        state = robot.refresh()
        update_obstacles(obstacles, estimate(state, 0), state, ANGLES)
    ((x1, y1, x2, y2),) = obstacles.confirmed
    assert hypot(0.5 * (x1 + x2) - 28.0, 0.5 * (y1 + y2) - 16.0) < 3.0


def test_lost_estimate_clears_obstacles_and_filters_nothing(robot: Robot) -> None:
    obstacles, state = ObstacleTracker(WALLS, N150.sonar_ring_radius_in), robot.refresh()
    for _ in range(3):
        update_obstacles(obstacles, estimate(state, 0), state, ANGLES)
    lost = estimate(state, 0, health=FilterHealth(HealthStatus.LOST, "searching"))
    assert filter_unmapped(obstacles, lost, state, ANGLES).sonars_in == state.sonars_in
    update_obstacles(obstacles, lost, state, ANGLES)
    assert len(obstacles.confirmed) == 0
