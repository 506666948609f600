"""Shortest paths: against the closed form around one end of a wall, against Dijkstra on a fine grid, and between the
shortest paths around polygons in and around the grown walls, by a visibility graph of another kind."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import acos, atan2, cos, hypot, pi, sqrt

import numpy as np
import pytest
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import ConvexHull

from localization.filters.belief import Floats
from localization.navigation.path import PathElement, total_length_in
from localization.navigation.roadmap import NoPathError, Roadmap, segment_clearances
from worlds.geometry import nearest_points
from worlds.io import load_world
from worlds.robots import N150

RADIUS_IN = N150.radius_in + 1.0
CORNERS = 24
WORLDS = ["thesis_room", "several_walls", "centre_vertex"]


def points_of(elements: list[PathElement]) -> Floats:
    return np.array(
        [element.at(share * element.length_in)[:2] for element in elements for share in np.linspace(0.0, 1.0, 60)]
    )


def end_of(elements: list[PathElement]) -> tuple[float, float]:
    last = elements[-1].at(elements[-1].length_in)
    return last.x_in, last.y_in


def test_in_an_empty_world_the_path_is_straight() -> None:
    (element,) = Roadmap(np.zeros((0, 4)), 10.0).path((0.0, 0.0), (30.0, 40.0))
    assert element == pytest.approx((0.0, 0.0, atan2(4.0, 3.0), 0.0, 50.0))


@pytest.mark.parametrize("height", [0.0, 5.0, -20.0])
def test_path_around_wall_end_is_two_tangents_and_an_arc(height: float) -> None:
    """The wall ends in the origin and goes down; the paths touch the circle of the radius about it."""
    roadmap, half = Roadmap(np.array([[0.0, 0.0, 0.0, -500.0]]), 10.0), 60.0
    # Two tangents from the ends to the circle, and the arc between them.
    path = roadmap.path((-half, height), (half, height))
    far = hypot(half, height)
    arc = 2.0 * (atan2(half, height) - acos(10.0 / far))
    exact = 2.0 * sqrt(far * far - 100.0) + 10.0 * max(arc, 0.0)
    # High enough, the straight line passes the circle.
    if arc <= 0.0:
        exact = 2.0 * half
    assert total_length_in(path) == pytest.approx(exact, abs=1e-5)


class Polygons:
    """Shortest paths among walls grown to polygons of a corner radius: Cyrus and Beck's clipping, then Dijkstra."""

    def __init__(self, walls: Floats, corner_in: float) -> None:
        angles = np.arange(CORNERS) * (2.0 * pi / CORNERS)
        ring = corner_in * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        hulls = [ConvexHull(np.concatenate((wall[:2] + ring, wall[2:] + ring))) for wall in walls]
        self._planes = [hull.equations for hull in hulls]
        corners = np.concatenate([hull.points[hull.vertices] for hull in hulls])
        self._corners = corners[[self._outside(corner) for corner in corners]]

    def _outside(self, point: Floats) -> bool:
        return all((planes[:, :2] @ point + planes[:, 2]).max() > -1e-6 for planes in self._planes)

    def _free(self, one: Floats, other: Floats) -> np.typing.NDArray[np.bool_]:
        """Return which of the paths (n, 2) to (n, 2) meet the inside of no polygon."""
        free = np.ones(len(one), dtype=bool)
        for planes in self._planes:
            # Clip the segment at each half plane (Cyrus and Beck).
            begin = one @ planes[:, :2].T + planes[:, 2] + 1e-7
            slope = (other - one) @ planes[:, :2].T
            with np.errstate(divide="ignore", invalid="ignore"):
                share = -begin / slope
            enters = np.where(slope < 0.0, share, np.where((slope == 0.0) & (begin > 0.0), np.inf, 0.0)).max(axis=1)
            leaves = np.where(slope > 0.0, share, 1.0).min(axis=1)
            free &= np.maximum(enters, 0.0) >= np.minimum(leaves, 1.0)
        return free

    def length_in(self, start: tuple[float, float], goal: tuple[float, float]) -> float:
        nodes = np.concatenate((np.array([start, goal]), self._corners))
        one, other = np.triu_indices(len(nodes), 1)
        free = self._free(nodes[one], nodes[other])
        one, other = one[free], other[free]
        lengths = np.hypot(*(nodes[one] - nodes[other]).T)
        graph = csr_matrix((lengths, (one, other)), shape=(len(nodes),) * 2)
        return float(dijkstra(graph, directed=False, indices=0)[1])


@cache
def polygons(world: str) -> tuple[Polygons, Polygons]:
    """In the grown walls, and around them."""
    walls = np.array(load_world(world).walls)
    return Polygons(walls, RADIUS_IN), Polygons(walls, RADIUS_IN / cos(pi / CORNERS))


def grid_length(walls: np.ndarray, start: tuple[float, float], goal: tuple[float, float]) -> float:
    """Dijkstra on a grid of 1 in with sixteen directions: longer than the shortest by 2.7 % at most, and its cells."""
    cells = 115
    # Grid points with enough distance to walls are nodes.
    x, y = np.meshgrid(np.arange(cells) - 12.0, np.arange(cells) - 12.0)
    points = np.stack((x.ravel(), y.ravel()), axis=-1)
    free = (nearest_points(points, walls)[1].min(axis=1) >= RADIUS_IN).reshape(cells, cells)
    rows, columns, lengths = [], [], []
    number = np.arange(cells * cells).reshape(cells, cells)
    # Eight directions and their opposites: straight, diagonal and knight's moves.
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
    # The nodes at start and goal; grid coordinates begin at -12 in.
    ends = [int(number[round(point[1] + 12), round(point[0] + 12)]) for point in (start, goal)]
    return float(dijkstra(graph.tocsr(), directed=False, indices=ends[0])[ends[1]])


@pytest.mark.long
@pytest.mark.parametrize("world", WORLDS)
def test_random_paths_are_free_and_shortest(world: str) -> None:
    walls = np.array(load_world(world).walls)
    roadmap, rng = Roadmap(walls, RADIUS_IN), np.random.default_rng(8)
    within, around = polygons(world)
    tried = 0
    while tried < 12:
        # Random ends that are free.
        start, goal = ((float(a), float(b)) for a, b in rng.integers(0, 90, (2, 2)))
        if nearest_points([start, goal], walls)[1].min() < RADIUS_IN * 1.01 or start == goal:
            continue
        tried += 1
        path = roadmap.path(start, goal)
        # All points of the path have the clearance.
        assert nearest_points(points_of(path), walls)[1].min() >= RADIUS_IN - 1e-5
        assert end_of(path) == pytest.approx(goal, abs=1e-6)
        # Elements join without a gap.
        for element, following in pairwise(path):
            assert element.at(element.length_in)[:2] == pytest.approx((following.x_in, following.y_in), abs=1e-6)
        length = total_length_in(path)
        # Polygons inside and outside of the circles bound the length from both sides.
        assert within.length_in(start, goal) - 1e-5 <= length <= around.length_in(start, goal) + 1e-5
        # The grid is at most 2.8 % longer, and up to a cell at each end.
        on_grid = grid_length(walls, start, goal)
        assert on_grid / 1.028 - 3.0 <= length <= on_grid * 1.005 + 0.5


def test_lines_go_over_into_arcs_without_a_turn() -> None:
    path = Roadmap(np.array(load_world("several_walls").walls), RADIUS_IN).path((5.0, 5.0), (90.0, 0.0))
    elements = [element for element in path if element.length_in > 1e-6]
    assert [bool(element.curvature) for element in elements] == [False, True, False, True, False]
    for element, following in pairwise(elements):
        assert np.cos(element.at(element.length_in).heading_rad - following.heading_rad) == pytest.approx(1.0, abs=1e-9)


def test_start_near_wall_is_left_straight_goal_is_refused() -> None:
    roadmap = Roadmap(np.array(load_world("several_walls").walls), RADIUS_IN)
    path = roadmap.path((-2.0, 10.0), (80.0, 0.0))
    assert (path[0].x_in, path[0].y_in) == (-2.0, 10.0)
    assert path[0].length_in == pytest.approx(0.72, abs=0.3)
    assert total_length_in(path) < total_length_in(roadmap.path((-1.2, 10.0), (80.0, 0.0))) + 2.0
    with pytest.raises(NoPathError, match=r"no space.*\(-2, 40\).* 0\.0 in .* 10\.7 in"):
        roadmap.path((60.0, 60.0), (-2.0, 40.0))
    assert end_of(roadmap.path((80.0, 0.0), (-2.0, 10.0), 9.72)) == pytest.approx((-2.0, 10.0))


def test_a_start_without_any_room_has_no_path() -> None:
    narrow = np.array([[-500.0, 0.0, 500.0, 0.0], [-500.0, 12.0, 500.0, 12.0]])
    with pytest.raises(NoPathError, match=r"no path.*\(0, 6\).*\(0, 60\)"):
        Roadmap(narrow, 10.0).path((0.0, 6.0), (0.0, 60.0))


def test_missing_path_raises() -> None:
    box = np.array([[0, 0, 60, 0], [60, 0, 60, 60], [60, 60, 0, 60], [0, 60, 0, 0]], dtype=float)
    with pytest.raises(NoPathError, match="no path from"):
        Roadmap(box, 10.0).path((30.0, 30.0), (200.0, 30.0))


def test_given_paths_too_near_to_walls_are_refused() -> None:
    roadmap = Roadmap(np.array([[0.0, 0.0, 0.0, -500.0]]), 10.0)
    roadmap.require_free([(-5.0, 0.0), (-20.0, 0.0), (-20.0, 30.0)])
    with pytest.raises(NoPathError, match=r"\(-20, 0\).*\(20, 0\) comes within"):
        roadmap.require_free([(-20.0, 20.0), (-20.0, 0.0), (20.0, 0.0)])


def test_clearances_by_hand() -> None:
    walls = np.array([[0.0, 0.0, 0.0, 10.0]])
    segments = np.array([[3.0, 0.0, 3.0, 5.0], [-1.0, 5.0, 1.0, 5.0], [3.0, 14.0, -3.0, 14.0], [5.0, -3.0, 4.0, 20.0]])
    np.testing.assert_allclose(segment_clearances(segments, walls)[:3], [3.0, 0.0, 4.0])
    dense = np.linspace(segments[3, :2], segments[3, 2:], 10_001)
    np.testing.assert_allclose(segment_clearances(segments, walls)[3], nearest_points(dense, walls)[1].min(), atol=1e-3)
    assert segment_clearances(segments, np.zeros((0, 4))).min() == np.inf
    assert segment_clearances(np.zeros((0, 4)), walls).shape == (0,)
