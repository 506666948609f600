"""The walls of a map for single rays, against the ray caster in arrays, and the rays near a ray."""

from __future__ import annotations

from math import atan2, cos, hypot, inf, sin

import numpy as np
import pytest

from localization.filters.sonar_ray import nearest, wall_map
from worlds.geometry import MAX_LOOP_WALLS, FloatArray
from worlds.io import load_world
from worlds.raycast import NO_WALL, sole_wall
from worlds.raycast_arrays import cast_rays

ROOM = np.array(load_world("several_walls").walls)
MANY = np.random.default_rng(7).uniform(-90.0, 90.0, size=(MAX_LOOP_WALLS + 20, 4))
"""More than are looked through one by one."""


def asked(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> tuple[FloatArray, list[int]]:
    """Return ranges and rows by the ray caster in arrays."""
    ranges, rows = cast_rays(origins, directions, walls)
    return ranges, rows.tolist()


@pytest.mark.parametrize("walls", [ROOM, ROOM[:3], MANY])
def test_random_rays_agree_with_ray_caster(walls: FloatArray) -> None:
    rng = np.random.default_rng(3)
    origins, angles = rng.uniform(-20.0, 110.0, size=(400, 2)), rng.uniform(-np.pi, np.pi, size=400)
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    ranges, rows = asked(origins, directions, walls)
    room = wall_map(walls)
    assert len(set(rows)) > 3
    for (x, y), (dx, dy), far, row in zip(origins.tolist(), directions.tolist(), ranges, rows, strict=True):
        met, which = nearest(x, y, dx, dy, room)
        assert which == row
        assert met == pytest.approx(far, abs=1e-9) or met == far == inf


def test_rays_through_corners_and_along_walls_meet_them() -> None:
    walls = np.array([[50.0, 0.0, 50.0, 20.0], [50.0, 20.0, 80.0, 20.0], [60.0, -5.0, 90.0, -5.0], [99, -50, 99, 50]])
    room = wall_map(walls)
    length = hypot(50.0, 20.0)
    for far, (x, y, dx, dy), rows in (
        (length, (0.0, 0.0, 50.0 / length, 20.0 / length), {0, 1}),
        (60.0, (0.0, -5.0, 1.0, 0.0), {2}),
        (0.0, (50.0, 10.0, cos(1.0), sin(1.0)), {0}),
        (inf, (0.0, 0.0, -1.0, 0.0), {NO_WALL}),
    ):
        met, row = nearest(x, y, dx, dy, room)
        assert met == pytest.approx(far)
        assert row in rows


def test_walls_beside_and_behind_are_not_met() -> None:
    room = wall_map([[10.0, -1.0, 10.0, 1.0]])
    for angle, row in ((0.0, 0), (0.2, NO_WALL), (np.pi, NO_WALL), (atan2(1.0, 10.0) - 0.01, 0)):
        assert nearest(0.0, 0.0, cos(angle), sin(angle), room)[1] == row


def test_a_wall_parallel_to_the_ray_is_no_division_by_zero() -> None:
    room = wall_map([[10.0, 5.0, 20.0, 5.0], [30.0, -5.0, 30.0, 5.0]])
    assert nearest(0.0, 0.0, 1.0, 0.0, room) == (30.0, 1)


def test_no_walls_are_met_by_nothing() -> None:
    nowhere = wall_map(np.empty((0, 4)))
    assert nearest(1.0, 2.0, 1.0, 0.0, nowhere) == (inf, NO_WALL)


def test_all_near_rays_meet_a_sole_wall() -> None:
    """Rays displaced and turned at random, so that no end moves by more than the margin in their frame."""
    rng, found, walls = np.random.default_rng(5), 0, ROOM
    far_in = float(np.hypot(*np.ptp(walls.reshape(-1, 2), axis=0)))
    for _ in range(600):
        at, angle, margin_in = rng.uniform(5.0, 85.0, size=2), rng.uniform(-np.pi, np.pi), rng.choice([0.1, 1.0, 5.0])
        x, y = at.tolist()
        row = sole_wall(x, y, cos(angle), sin(angle), walls.tolist(), margin_in)
        if row == NO_WALL:
            continue
        found += 1
        share, around = rng.uniform(size=50), rng.uniform(-np.pi, np.pi, size=50)
        origins = at + (share * margin_in * np.array([np.cos(around), np.sin(around)])).T
        angles = angle + (1.0 - share) * margin_in / far_in * rng.choice([-1.0, 1.0], 50)
        _, rows = cast_rays(origins, np.stack((np.cos(angles), np.sin(angles)), axis=-1), walls)
        assert (rows == row).all()
    assert found > 100
