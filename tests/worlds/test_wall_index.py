"""The index of walls against the ray caster: any rays, rays through corners and along walls, and no walls."""

from __future__ import annotations

from math import atan2, cos, hypot, inf, sin

import numpy as np
import pytest

from worlds.geometry import FloatArray
from worlds.io import load_world
from worlds.raycast import MAX_LOOP_WALLS, NO_WALL, WallIndex, cast_rays

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
    index = WallIndex(walls)
    assert len(set(rows)) > 3
    for (x, y), (dx, dy), far, row in zip(origins.tolist(), directions.tolist(), ranges, rows, strict=True):
        met, which = index.nearest(x, y, dx, dy)
        assert which == row
        assert met == pytest.approx(far, abs=1e-9) or met == far == inf


def test_rays_through_corners_and_along_walls_meet_them() -> None:
    walls = np.array([[50.0, 0.0, 50.0, 20.0], [50.0, 20.0, 80.0, 20.0], [60.0, -5.0, 90.0, -5.0], [99, -50, 99, 50]])
    index = WallIndex(walls)
    length = hypot(50.0, 20.0)
    for far, (x, y, dx, dy), rows in (
        (length, (0.0, 0.0, 50.0 / length, 20.0 / length), {0, 1}),
        (60.0, (0.0, -5.0, 1.0, 0.0), {2}),
        (0.0, (50.0, 10.0, cos(1.0), sin(1.0)), {0}),
        (inf, (0.0, 0.0, -1.0, 0.0), {NO_WALL}),
    ):
        met, row = index.nearest(x, y, dx, dy)
        assert met == pytest.approx(far)
        assert row in rows


def test_walls_beside_and_behind_are_not_met() -> None:
    index = WallIndex([[10.0, -1.0, 10.0, 1.0]])
    for angle, row in ((0.0, 0), (0.2, NO_WALL), (np.pi, NO_WALL), (atan2(1.0, 10.0) - 0.01, 0)):
        assert index.nearest(0.0, 0.0, cos(angle), sin(angle))[1] == row


def test_a_wall_parallel_to_the_ray_is_no_division_by_zero() -> None:
    index = WallIndex([[10.0, 5.0, 20.0, 5.0], [30.0, -5.0, 30.0, 5.0]])
    assert index.nearest(0.0, 0.0, 1.0, 0.0) == (30.0, 1)


def test_no_walls_are_met_by_nothing() -> None:
    nowhere = WallIndex(np.empty((0, 4)))
    assert nowhere.nearest(1.0, 2.0, 1.0, 0.0) == (inf, NO_WALL)
