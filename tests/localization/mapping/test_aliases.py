"""Places that look alike: against the symmetries of maps that are known by construction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.belief import difference
from localization.mapping.aliases import AliasFinder, find_aliases
from worlds.io import load_world
from worlds.robots import N150

DOOR_IN = 156.0
"""Distance of neighbouring doors of the corridor."""


def finder(name: str) -> AliasFinder:
    world = load_world(name)
    return AliasFinder(world.walls, N150.radius_in, [(start.x_in, start.y_in) for start in world.starts])


@pytest.mark.long
def test_a_pose_in_the_corridor_looks_like_those_at_other_doors() -> None:
    here = np.array([787.4, 39.4, 0.5])
    found = finder("corridor").aliases(here)
    along = [pose for pose in found if abs(difference(pose, here)[2]) < 0.1]
    shifts = sorted(float(pose[0] - here[0]) / DOOR_IN for pose in along)
    assert len(shifts) >= 3
    # Whole numbers of doors, at the same distance from the walls.
    np.testing.assert_allclose(shifts, np.round(shifts), atol=0.01)
    np.testing.assert_allclose([pose[1] for pose in along], here[1], atol=1.0)
    # The others look along the corridor from the other side.
    turned = [pose for pose in found if abs(difference(pose, here)[2]) >= 0.1]
    assert turned
    for pose in turned:
        assert abs(math.remainder(pose[2] - here[2] - math.pi, math.tau)) < 0.05


@pytest.mark.long
@pytest.mark.parametrize("door", [2, 3, 5])
def test_a_place_in_a_doorway_looks_like_those_at_other_doors(door: int) -> None:
    here = np.array([79.4 + DOOR_IN * door, 69.1, 1.1])
    found = finder("corridor").aliases(here)
    # All doors of this side whose neighbourhood, 200 in to either side, holds no end of the corridor.
    for other in {2, 3, 4, 5, 6, 7} - {door}:
        expected = here + np.array([DOOR_IN * (other - door), 0.0, 0.0])
        assert any(np.abs(difference(pose, expected)).max() < 0.5 for pose in found)


@pytest.mark.long
def test_ends_of_the_corridor_and_rooms_of_the_flat_are_unique() -> None:
    # The niche at the west end is in sight.
    assert not finder("corridor").aliases((40.0, 39.4, 0.0))
    flat = finder("flat")
    assert not find_aliases(flat, np.column_stack((flat.samples(12), np.zeros(12))))


@pytest.mark.long
@pytest.mark.parametrize(("turn", "max_grid"), [(0.0, 4000), (2.0, 4000), (2.0, 20)])
def test_a_rotated_copy_of_a_room_is_found(turn: float, max_grid: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two rooms that are apart: the same walls, moved and turned; also on the coarse grid of a large floor."""
    monkeypatch.setattr("localization.mapping.aliases.MAX_GRID", max_grid)
    rng = np.random.default_rng(3)
    corners = np.array([(0, 0), (150, 0), (150, 60), (110, 60), (110, 130), (30, 130), (0, 90)], dtype=float)
    walls = np.concatenate((corners, np.roll(corners, -1, axis=0)), axis=1)
    cos, sin = math.cos(turn), math.sin(turn)
    moved = (walls.reshape(-1, 2) @ np.array([[cos, sin], [-sin, cos]]) + np.array([600.0, 50.0])).reshape(-1, 4)
    both = AliasFinder(np.concatenate((walls, moved)), N150.radius_in)
    for x, y in rng.uniform((20.0, 20.0), (100.0, 80.0), (3, 2)):
        (found,) = both.aliases((x, y, 1.0))
        expected = np.array([600.0 + cos * x - sin * y, 50.0 + sin * x + cos * y, 1.0 + turn])
        off = difference(found, expected)
        assert np.hypot(off[0], off[1]) < 1.0
        assert abs(off[2]) < 0.02
