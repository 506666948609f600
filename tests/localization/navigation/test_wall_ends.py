"""Which ends of walls see one another, and the tangents of roadmaps that share it, against all pairs one by one."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Floats
from localization.navigation.path import SLACK_IN
from localization.navigation.roadmap import (
    Roadmap,
    WallEnds,
    common_tangents,
    pair_clearances,
    points_on_circles,
    segment_clearances,
)
from worlds.io import load_world
from worlds.raycast import cast_ray


def random_walls(seed: int) -> Floats:
    """Slanted walls, walls on a grid that share ends or touch others in the middle, and lines of three ends."""
    rng = np.random.default_rng(seed)
    slanted = rng.uniform(0.0, 100.0, (6, 4))
    grid = 10.0 * rng.integers(0, 10, (10, 2)).astype(float)
    steps = 10.0 * rng.integers(1, 4, (10, 1)) * np.eye(2)[rng.integers(0, 2, 10)]
    return np.concatenate((slanted, np.concatenate((grid, grid + steps), axis=1)))


@pytest.mark.parametrize("seed", range(6))
def test_roadmaps_of_all_radii_have_every_free_tangent(seed: int) -> None:
    walls = random_walls(seed)
    ends = WallEnds(walls, 9.0)
    first, second = np.triu_indices(len(ends.points), 1)
    total = 0
    for radius in (2.0, 5.0, 9.0):
        roadmap = Roadmap(walls, radius, ends)
        angles, circles, _ = common_tangents(ends.points, np.stack((first, second), axis=-1), radius)
        lines = points_on_circles(ends.points, circles, angles, radius).reshape(-1, 4)
        free = segment_clearances(lines, walls) >= radius - SLACK_IN
        for number in range(len(ends.points)):
            here = np.concatenate([angles[free & (circles[:, k] == number), k] for k in (0, 1)])
            nodes = roadmap.circle_nodes(number)
            np.testing.assert_allclose(np.sort(nodes.angles), np.sort(here), atol=1e-12)
            total += len(here)
    assert total > 50


def test_a_larger_roadmap_does_not_use_the_ends_of_smaller_ones() -> None:
    walls = random_walls(0)
    shared, alone = (Roadmap(walls, 12.0, ends) for ends in (WallEnds(walls, 9.0), None))
    for number in range(5):
        np.testing.assert_array_equal(shared.circle_nodes(number).angles, alone.circle_nodes(number).angles)


def test_ends_behind_a_wall_are_not_visible() -> None:
    walls = np.asarray(load_world("flat").walls)
    ends = WallEnds(walls, 9.0)
    for x, y in ends.points[::9].tolist():
        seen = set(ends.visible_from((x, y)).tolist())
        for number, (to_x, to_y) in enumerate(ends.points.tolist()):
            distance = float(np.hypot(to_x - x, to_y - y))
            if distance == 0.0:
                continue
            # A ray that meets a wall half an inch before the end, begun half an inch beyond this one.
            dx, dy = (to_x - x) / distance, (to_y - y) / distance
            if number in seen:
                continue
            met, _ = cast_ray(x + 0.5 * dx, y + 0.5 * dy, dx, dy, walls)
            assert met < distance, (x, y, to_x, to_y)
        assert len(seen) < len(ends.points) - 1


def test_clearances_of_pairs_are_those_of_all() -> None:
    segments, walls = random_walls(1), random_walls(2)
    every = [segment_clearances(segments, wall[None]) for wall in walls]
    pairs = pair_clearances(np.repeat(segments, len(walls), axis=0), np.tile(walls, (len(segments), 1)))
    np.testing.assert_array_equal(pairs, np.stack(every, axis=1).ravel())
    assert (pairs == 0.0).any()
