"""Shortest ways: against the closed form around one end of a wall, and against Dijkstra on a fine grid."""

from __future__ import annotations

from itertools import pairwise
from math import acos, atan2, cos, hypot, pi, sqrt

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from localization.planning.clearance import clearances
from localization.planning.roadmap import NoWayError, Roadmap, length_in
from worlds.bodies import N150
from worlds.files import load_world
from worlds.geometry import nearest_points

RADIUS_IN = N150.radius_in + 1.0


def test_in_an_empty_world_the_way_is_straight() -> None:
    assert Roadmap(np.zeros((0, 4)), 10.0).path((0.0, 0.0), (30.0, 40.0)) == [(0.0, 0.0), (30.0, 40.0)]


@pytest.mark.parametrize("height", [0.0, 5.0, -20.0])
def test_around_the_end_of_a_wall_it_is_two_tangents_and_an_arc(height: float) -> None:
    """The wall ends in the origin and goes down; the ways touch the circle of the radius about it."""
    roadmap, half = Roadmap(np.array([[0.0, 0.0, 0.0, -500.0]]), 10.0), 60.0
    path = roadmap.path((-half, height), (half, height))
    far = hypot(half, height)
    arc = 2.0 * (atan2(half, height) - acos(10.0 / far))
    exact = 2.0 * sqrt(far * far - 100.0) + 10.0 * max(arc, 0.0)
    if arc <= 0.0:
        exact = 2.0 * half
    assert exact - 1e-3 <= length_in(path) <= exact / cos(pi / 24)


def grid_length(walls: np.ndarray, start: tuple[float, float], goal: tuple[float, float]) -> float:
    """Dijkstra on a grid of 1 in with sixteen directions: longer than the shortest by 2.7 % at most, and its cells."""
    cells = 115
    x, y = np.meshgrid(np.arange(cells) - 12.0, np.arange(cells) - 12.0)
    points = np.stack((x.ravel(), y.ravel()), axis=-1)
    free = (nearest_points(points, walls)[1].min(axis=1) >= RADIUS_IN).reshape(cells, cells)
    rows, columns, lengths = [], [], []
    number = np.arange(cells * cells).reshape(cells, cells)
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1)):
        near = (slice(max(0, -dy), cells - max(0, dy)), slice(0, cells - dx))
        far = (slice(max(0, dy), cells - max(0, -dy)), slice(dx, cells))
        both = free[near] & free[far]
        rows.append(number[near][both])
        columns.append(number[far][both])
        lengths.append(np.full(int(both.sum()), hypot(dx, dy)))
    graph = coo_matrix(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(cells * cells,) * 2
    )
    ends = [int(number[round(point[1] + 12), round(point[0] + 12)]) for point in (start, goal)]
    return float(dijkstra(graph.tocsr(), directed=False, indices=ends[0])[ends[1]])


@pytest.mark.parametrize("world", ["thesis_room", "several_walls", "centre_vertex"])
def test_between_random_places_it_is_free_and_no_longer_than_on_a_fine_grid(world: str) -> None:
    walls = np.array(load_world(world).walls)
    roadmap, chance = Roadmap(walls, RADIUS_IN), np.random.default_rng(8)
    tried = 0
    while tried < 12:
        start, goal = ((float(a), float(b)) for a, b in chance.integers(0, 90, (2, 2)))
        if nearest_points([start, goal], walls)[1].min() < RADIUS_IN:
            continue
        tried += 1
        path = roadmap.path(start, goal)
        ways = np.array([[*one, *other] for one, other in pairwise(path)])
        if start != goal:
            assert clearances(ways, walls).min() >= RADIUS_IN - 1e-5
        on_grid = grid_length(walls, start, goal)
        assert length_in(path) <= on_grid * 1.005 + 0.5
        assert length_in(path) >= on_grid / 1.028 - 3.0


def test_a_start_too_near_a_wall_is_left_and_a_goal_too_near_is_refused() -> None:
    roadmap = Roadmap(np.array(load_world("thesis_room").walls), RADIUS_IN)
    assert roadmap.path((-2.0, 40.0), (60.0, 40.0))[0] == (-2.0, 40.0)
    with pytest.raises(NoWayError, match=r"no room at \(-2, 40\): 10.0 in to a wall, 10.7 wanted"):
        roadmap.path((60.0, 40.0), (-2.0, 40.0))


def test_where_there_is_no_way_it_says_so() -> None:
    box = np.array([[0, 0, 60, 0], [60, 0, 60, 60], [60, 60, 0, 60], [0, 60, 0, 0]], dtype=float)
    with pytest.raises(NoWayError, match="no way from"):
        Roadmap(box, 10.0).path((30.0, 30.0), (200.0, 30.0))


def test_clearances_by_hand() -> None:
    walls = np.array([[0.0, 0.0, 0.0, 10.0]])
    ways = np.array([[3.0, 0.0, 3.0, 5.0], [-1.0, 5.0, 1.0, 5.0], [3.0, 14.0, -3.0, 14.0], [5.0, -3.0, 4.0, 20.0]])
    np.testing.assert_allclose(clearances(ways, walls)[:3], [3.0, 0.0, 4.0])
    dense = np.linspace(ways[3, :2], ways[3, 2:], 10_001)
    np.testing.assert_allclose(clearances(ways, walls)[3], nearest_points(dense, walls)[1].min(), atol=1e-3)
    assert clearances(ways, np.zeros((0, 4))).min() == np.inf
    assert clearances(np.zeros((0, 4)), walls).shape == (0,)
