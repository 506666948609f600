"""The square of a calibration run and the path around it."""

from __future__ import annotations

from itertools import pairwise, product
from math import hypot, pi, tau

import numpy as np
import pytest

from localization.cli.calibrate import (
    MARGIN_IN,
    Driver,
    DriveTo,
    NoSquareError,
    Spin,
    Square,
    is_clear,
    largest_square,
    path_to,
    tasks,
)
from localization.filters.belief import HEADING
from localization.filters.odometry import move
from localization.navigation.roadmap import NoPathError, segment_clearances
from localization.navigation.waypoints import PERIOD_S
from worlds.io import load_world, world_names
from worlds.world import Polygon, World

RADIUS_IN = 9.72


@pytest.mark.long
@pytest.mark.parametrize("name", world_names())
def test_every_shipped_world_has_one_that_retains_clear(name: str) -> None:
    world = load_world(name)
    square = largest_square(world, RADIUS_IN, (0.0, 0.0))
    for (x1, y1), (x2, y2) in zip(square.corners, square.corners[1:] + square.corners[:1], strict=True):
        for share in np.linspace(0.0, 1.0, 50):
            assert world.clearance(x1 + share * (x2 - x1), y1 + share * (y2 - y1)) >= RADIUS_IN + MARGIN_IN - 1e-9


def test_square_is_largest_and_nearest() -> None:
    room = World("room", rooms=(Polygon(((0.0, 0.0), (140.0, 0.0), (140.0, 100.0), (0.0, 100.0))),))
    square = largest_square(room, 9.0, (140.0, 0.0))
    assert square.side_in == 68.0
    assert square.x_in + square.side_in == 124.0
    assert largest_square(room, 9.0, (0.0, 0.0)).x_in == 16.0


@pytest.mark.parametrize(("name", "near"), [
    ("centre_vertex", (0.0, 0.0)), ("several_walls", (60.0, 20.0)), ("thesis_room", (30.0, 90.0)),
])  # fmt: skip
def test_square_equals_that_of_trying_all(name: str, near: tuple[float, float]) -> None:
    world = load_world(name)
    low, high = world.walls.reshape(-1, 2).min(axis=0), world.walls.reshape(-1, 2).max(axis=0)
    found = largest_square(world, RADIUS_IN, near)
    # The next larger size, and of this size all that are nearer: none of them may be clear.
    for side in (found.side_in, found.side_in + 4.0):
        for x, y in product(np.arange(low[0], high[0] - side, 4.0), np.arange(low[1], high[1] - side, 4.0)):
            square = Square(float(x), float(y), side)
            if side > found.side_in or distance(square, near) < distance(found, near) - 1e-9:
                assert not is_clear(square, world, RADIUS_IN)


def distance(square: Square, near: tuple[float, float]) -> float:
    return min(hypot(x - near[0], y - near[1]) for x, y in square.corners)


def test_small_room_has_no_square() -> None:
    cupboard = World("cupboard", rooms=(Polygon(((0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0))),))
    with pytest.raises(NoSquareError, match="no space"):
        largest_square(cupboard, RADIUS_IN, (20.0, 20.0))
    assert not is_clear(Square(-30.0, -30.0, 12.0), cupboard, RADIUS_IN)


@pytest.mark.parametrize("start", [(5.0, 5.0), (80.0, 0.0), (0.0, 0.0)])
def test_path_to_square_leaves_space_for_odometry_error(start: tuple[float, float]) -> None:
    """Its arcs are driven as chords, from point to point: cut to the body's own radius, they would touch."""
    world = load_world("several_walls")
    square = largest_square(world, RADIUS_IN, start)
    corner = min(square.corners, key=lambda corner: hypot(corner[0] - start[0], corner[1] - start[1]))
    places = [start, *(tuple(task) for task in path_to(corner, start, world, RADIUS_IN))]
    assert places[-1] == pytest.approx(corner)
    sides = np.array([[*one, *other] for one, other in pairwise(places)])
    assert segment_clearances(sides[1:], world.walls).min() > RADIUS_IN + 0.8


def test_square_through_gap_fits_or_is_refused() -> None:
    def door(wide_in: float) -> World:
        sides = ((0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (0.0, 100.0))
        posts = np.array([[100.0, 0.0, 100.0, 50.0 - wide_in / 2], [100.0, 50.0 + wide_in / 2, 100.0, 100.0]])
        return World("door", rooms=(Polygon(sides),), inner_walls=posts)

    assert path_to((160.0, 50.0), (40.0, 50.0), door(24.0), 9.0)[-1] == (160.0, 50.0)
    with pytest.raises(NoPathError, match=r"10\.0 in radius"):
        path_to((160.0, 50.0), (40.0, 50.0), door(19.0), 9.0)


def test_laps_go_round_both_ways_from_the_nearest_corner() -> None:
    found = tasks(Square(0.0, 0.0, 10.0), (9.0, 1.0), 1, 2)
    places = [tuple(task) for task in found if isinstance(task, DriveTo)]
    assert places[0] == (10.0, 0.0)
    assert places[1:5] == [(10.0, 10.0), (0.0, 10.0), (0.0, 0.0), (10.0, 0.0)]
    assert places[5:] == [(0.0, 0.0), (0.0, 10.0), (10.0, 10.0), (10.0, 0.0)]
    turns = [task.angle_rad for task in found if isinstance(task, Spin)]
    assert turns == [2 * tau] * 4 + [-2 * tau] * 4
    assert not any(isinstance(task, Spin) for task in tasks(Square(0.0, 0.0, 10.0), (0.0, 0.0), 1, 0))


def test_the_driver_goes_round_and_turns_as_reported() -> None:
    # A square of 60 in, from (10, 10), once round in each direction.
    square = Square(10.0, 10.0, 60.0)
    driver = Driver(tasks(square, (0.0, 0.0), 1, 1), 10.0, 0.7)
    pose, turned, places = np.array([0.0, 0.0, 2.0]), [0.0, 0.0], []
    # At most 400 s, in periods of 0.1 s.
    for _ in range(4000):
        done = driver.passed
        command = driver.command(pose)
        if driver.passed > done:
            places.append(pose[:2].copy())
        if command is None:
            break
        # The limits of the driver: 10 in/s and 0.7 rad/s.
        assert abs(command.translation_in_s) <= 10.0
        assert abs(command.steering_rad_s) <= 0.7
        # Left and right turns are added separately.
        turned[command.steering_rad_s < 0.0] += abs(command.steering_rad_s) * PERIOD_S
        pose = move(pose, PERIOD_S * np.array(command))
        # After the first corner it stays near the sides.
        off_side = min(abs(pose[0] - 10.0), abs(pose[0] - 70.0), abs(pose[1] - 10.0), abs(pose[1] - 70.0))
        assert len(places) == 0 or off_side < 1.5
    # 17 tasks: sides, corners and turns on the spot.
    assert driver.passed == driver.count == 17
    assert hypot(pose[0] - 10.0, pose[1] - 10.0) < 1.0
    # Four full turns and four quarter turns in each direction; it stops within its tolerance.
    assert turned[0] == pytest.approx(4 * tau + 4 * pi / 2, abs=2.0)
    assert turned[1] == pytest.approx(4 * tau + 4 * pi / 2, abs=3.0)


def test_a_goal_that_was_passed_by_is_behind() -> None:
    driver = Driver([DriveTo(10.0, 0.0)], 10.0, 0.5)
    assert driver.command(np.array([0.0, 0.0, 0.0])) is not None
    assert driver.command(np.array([12.0, 0.5, 0.0])) is None
    assert driver.passed == 1


def test_goal_to_the_side_is_turned_to_before_driving() -> None:
    # The goal is 90 degrees to the left.
    driver = Driver([DriveTo(0.0, 10.0)], 10.0, 0.5)
    command = driver.command(np.array([0.0, 0.0, 0.0]))
    assert command is not None
    assert command.translation_in_s == 0.0
    assert command.steering_rad_s > 0.0
    # Facing it, it drives at full speed.
    pose = np.array([0.0, 0.0, pi / 2])
    assert pose[HEADING] > 0
    rolling = driver.command(pose)
    assert rolling is not None
    assert rolling.translation_in_s == pytest.approx(10.0)
