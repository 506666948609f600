"""Unmapped obstacles: confirmed by repeated readings, not by random ones, and removed again."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, tau

import numpy as np
import pytest

from localization.navigation.obstacles import CONFIRM_WEIGHT, DECAY_S, MAX_WEIGHT, ObstacleTracker
from worlds.io import load_world
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150

WALLS = np.array(load_world("several_walls").walls)
RING_IN = N150.sonar_ring_radius_in
HERE = (20.0, 20.0)


def add_readings(
    obstacles: ObstacleTracker, towards: float, reading: float, times: int = 1, clock_s: float = 0.0
) -> None:
    for _ in range(times):
        obstacles.add_reading(clock_s, HERE, towards, reading, 0.2)


def test_repeated_readings_confirm_obstacle_at_their_place() -> None:
    obstacles = ObstacleTracker(WALLS, RING_IN)
    # Two readings are not enough, the third confirms.
    add_readings(obstacles, 0.3, 15.0, times=2)
    assert not len(obstacles.confirmed)
    add_readings(obstacles, 0.35, 15.0)
    ((x1, y1, x2, y2),) = obstacles.confirmed
    # An obstacle is a segment of 10 in, across the beams' mean direction.
    assert hypot(x2 - x1, y2 - y1) == pytest.approx(10.0)
    assert (0.5 * (x1 + x2), 0.5 * (y1 + y2)) == pytest.approx(
        (20.0 + 24.06 * cos(0.32), 20.0 + 24.06 * sin(0.32)), abs=0.6
    )
    assert atan2(y2 - y1, x2 - x1) == pytest.approx(0.32 + pi / 2.0, abs=0.05)


@pytest.mark.long
def test_mapped_walls_and_second_echoes_confirm_nothing() -> None:
    """Exact ranges of rays, and longer ones as second echoes are, from many places."""
    obstacles, rng = ObstacleTracker(WALLS, RING_IN), np.random.default_rng(2)
    # 300 places and directions, each with the range of the wall, a longer one, and none.
    for _ in range(300):
        place, towards = rng.uniform(12.0, 30.0, 2), float(rng.uniform(0.0, tau))
        ray = float(cast_rays(place, np.array([cos(towards), sin(towards)]), WALLS)[0]) - RING_IN
        for reading in (ray, ray + float(rng.exponential(30.0)), 255.0):
            obstacles.add_reading(
                0.0, (float(place[0]), float(place[1])), towards, float(np.round(max(reading, 0.0))), 0.2
            )
    assert not len(obstacles.confirmed)


@pytest.mark.long
def test_one_fifth_random_readings_confirms_no_obstacle() -> None:
    """Ten minutes of a standing robot in the square room: the rest goes through to the walls."""
    walls, rng = np.array(load_world("thesis_room").walls), np.random.default_rng(7)
    obstacles, found = ObstacleTracker(walls, RING_IN), 0
    angles = np.array(N150.sonar_angles_rad)
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    # True ranges from the middle of the square room.
    true = cast_rays(np.broadcast_to(np.array((45.0, 45.0)), directions.shape), directions, walls)[0] - RING_IN
    # 600 rounds; a fifth of the readings is uniform over all ranges.
    for number in range(600 * 16):
        sonar = number % 16
        bad = rng.random() < 0.2
        reading = float(rng.integers(6, 256)) if bad else float(round(true[sonar]))
        obstacles.add_reading(number * 0.06, (45.0, 45.0), float(angles[sonar]), reading, 0.2)
        found += len(obstacles.confirmed) > 0
    # Random readings confirm something in less than 2 % of the time.
    assert found / (600 * 16) < 0.02


def test_obstacle_is_removed_when_readings_pass_through() -> None:
    obstacles = ObstacleTracker(WALLS, RING_IN)
    add_readings(obstacles, 0.3, 15.0, times=4)
    add_readings(obstacles, 0.3 + 0.3, 40.0, times=10)
    assert len(obstacles.confirmed) == 1
    add_readings(obstacles, 0.3, 40.0, times=10)
    assert len(obstacles.confirmed) == 0


def test_obstacle_decays_from_bounded_weight() -> None:
    obstacles = ObstacleTracker(WALLS, RING_IN)
    add_readings(obstacles, 0.3, 15.0, times=100)
    add_readings(obstacles, pi, 200.0, clock_s=DECAY_S * np.log(MAX_WEIGHT) - 0.5)
    assert len(obstacles.confirmed) == 1
    add_readings(obstacles, pi, 200.0, clock_s=DECAY_S * np.log(MAX_WEIGHT) + 0.5)
    assert len(obstacles.confirmed) == 0
    assert CONFIRM_WEIGHT < MAX_WEIGHT


def test_contact_is_confirmed_at_once_until_cleared() -> None:
    obstacles = ObstacleTracker(WALLS, RING_IN)
    obstacles.add_contact(0.0, HERE, pi / 2.0, 9.72)
    # A contact is an obstacle of 10 in at the rim of the robot, 9.72 in ahead.
    np.testing.assert_allclose(obstacles.confirmed, [[25.0, 29.72, 15.0, 29.72]])
    # Readings that pass through it do not remove a contact.
    add_readings(obstacles, pi / 2.0, 72.0, times=20)
    assert len(obstacles.confirmed) == 1
    add_readings(obstacles, pi / 2.0, 21.0, times=2)
    assert len(obstacles.confirmed) == 1
    # Only clearing does.
    obstacles.clear()
    assert len(obstacles.confirmed) == 0


@pytest.mark.parametrize(("reading", "std"), [(0.0, 0.2), (5.0, 0.2), (15.0, 2.0), (70.0, 0.2)])
def test_unusable_readings_or_uncertain_pose_add_nothing(reading: float, std: float) -> None:
    obstacles = ObstacleTracker(np.array(load_world("thesis_room").walls), RING_IN)
    for _ in range(5):
        obstacles.add_reading(0.0, (0.0, 0.0), 0.7, reading, std)
    assert len(obstacles.confirmed) == 0


def test_empty_map_makes_near_readings_unmapped() -> None:
    obstacles = ObstacleTracker(np.zeros((0, 4)), RING_IN)
    near = obstacles.find_unmapped(HERE, np.array([0.0, 1.0, 2.0]), np.array([20.0, 5.0, 255.0]), 0.1)
    assert near.tolist() == [True, False, False]
