"""Shortest paths: against the closed form around one end of a wall, against Dijkstra on a fine grid, and between the
shortest paths around polygons in and around the grown walls, by a visibility graph of another kind; on random walls,
against Dijkstra on the graph of all tangents and of arcs cut into small steps."""

from __future__ import annotations

import tracemalloc
from functools import cache
from itertools import pairwise
from math import acos, asin, atan2, cos, hypot, inf, pi, sqrt, tau

import numpy as np
import pytest
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import ConvexHull

from localization.filters.belief import Floats
from localization.navigation import roadmap as module
from localization.navigation.path import PathElement, total_length_in
from localization.navigation.roadmap import NoPathError, Roadmap, are_clear, segment_clearances
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


def random_walls(seed: int, count: int, size_in: float, *, is_on_grid: bool = False) -> Floats:
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0.0, size_in, (count, 2))
    walls = np.concatenate((ends, ends + rng.normal(0.0, 20.0, (count, 2))), axis=1)
    return np.round(walls / 10.0) * 10.0 if is_on_grid else walls


@pytest.mark.parametrize("distance_in", [0.0, 3.0, 20.0])
def test_segments_clear_if_clearance_suffices(distance_in: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PAIRS", 500)
    segments, walls = random_walls(1, 300, 200.0), random_walls(2, 40, 200.0)
    expected = segment_clearances(segments, walls) >= distance_in
    assert 0 < expected.sum() < 300 or distance_in == 0.0
    np.testing.assert_array_equal(are_clear(segments, walls, distance_in), expected)
    assert are_clear(segments, np.zeros((0, 4)), distance_in).all()
    assert are_clear(np.zeros((0, 4)), walls, distance_in).shape == (0,)


def all_tangents_length(walls: Floats, start: Floats, goal: Floats, radius: float) -> float:
    """Return the length by Dijkstra over all tangents of all circles, compared with all walls.

    Start and goal are circles of radius 0. Directed circles, left +1 and right -1, have one tangent from each to each:
    its left normal has the angle at which the difference of the signed radii is the distance of the tangent points
    across the line of centres. The arcs are joined in the direction of travel, in samples of 0.002 rad.
    """
    corners = np.unique(walls.reshape(-1, 2), axis=0)
    circles = [(start, 0.0), (goal, 0.0), *((corner, sign * radius) for corner in corners for sign in (1.0, -1.0))]
    owners, points, turns, lines = [], [], [], []
    for one, (centre, signed) in enumerate(circles):
        for other, (far_centre, far_signed) in enumerate(circles):
            offset = far_centre - centre
            distance = hypot(*offset)
            across = signed - far_signed
            if one == other or distance <= abs(across) or distance < 1e-9:
                continue
            heading = atan2(offset[1], offset[0]) + asin(across / distance)
            # The centre of a left turn is on the left.
            right = np.array([np.sin(heading), -np.cos(heading)])
            owners += [one, other]
            points += [centre + signed * right, far_centre + far_signed * right]
            turns += [heading, heading]
            lines.append((len(points) - 2, len(points) - 1))
    ends = np.array(points)
    segments = ends.reshape(-1, 4)
    free = segment_clearances(segments, walls) >= radius - 1e-6
    lengths = np.hypot(*(segments[:, 2:] - segments[:, :2]).T)
    edges = [(*line, length) for line, length, is_free in zip(lines, lengths, free, strict=True) if is_free]
    used = {node for one, other, _ in edges for node in (one, other)}
    for number, (centre, signed) in enumerate(circles):
        there = sorted((turns[node] % tau, node) for node in used if owners[node] == number)
        for (begin, node), (end, following) in zip(there, there[1:] + there[:1], strict=True):
            turn = (end - begin) % tau if node != following else tau
            headings = begin + np.linspace(0.0, turn, 2 + int(turn / 0.002))
            rim = centre + signed * np.stack((np.sin(headings), -np.cos(headings)), axis=-1)
            if not signed or nearest_points(rim, walls)[1].min() >= radius - 1e-6:
                one, other = (node, following) if signed >= 0.0 else (following, node)
                edges.append((one, other, max(abs(signed) * turn, 1e-12)))
    nodes = len(points)
    edges += [(nodes, node, 1e-12) for node in used if owners[node] == 0]
    edges += [(node, nodes + 1, 1e-12) for node in used if owners[node] == 1]
    begins, finishes, weights = zip(*edges, strict=True)
    graph = csr_matrix((weights, (begins, finishes)), shape=(nodes + 2,) * 2)
    return float(dijkstra(graph, indices=nodes)[nodes + 1])


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_paths_equal_those_of_the_whole_graph(seed: int) -> None:
    walls, radius = random_walls(seed, 14, 200.0, is_on_grid=seed % 2 == 1), 6.0
    roadmap, rng = Roadmap(walls, radius), np.random.default_rng(seed)
    lengths: list[float] = []
    while len(lengths) < 4:
        start, goal = rng.uniform(-10.0, 210.0, (2, 2))
        if nearest_points(np.stack((start, goal)), walls)[1].min() < radius:
            continue
        try:
            length = total_length_in(roadmap.path(tuple(start.tolist()), tuple(goal.tolist())))
        except NoPathError:
            length = inf
        assert length == pytest.approx(all_tangents_length(walls, start, goal, radius), abs=1e-5)
        lengths.append(length - hypot(*(goal - start)))
    # Some paths are not straight.
    assert max(length for length in lengths if length < inf) > 1.0


def test_paths_do_not_depend_on_earlier_ones() -> None:
    walls = random_walls(3, 14, 200.0, is_on_grid=True)
    ends = [((-20.0, 5.0), (220.0, 195.0)), ((100.0, -20.0), (95.0, 220.0)), ((220.0, 5.0), (-20.0, 195.0))]
    roadmap = Roadmap(walls, 6.0)
    for start, goal in [*ends, *reversed(ends)]:
        assert roadmap.path(start, goal) == Roadmap(walls, 6.0).path(start, goal)


def test_arrays_stay_small_in_a_large_map() -> None:
    """A thousand walls have four million tangents; one array of these times the walls would need 30 GiB."""
    # 256 rooms of 100 in, with doors of 40 in.
    lines = np.arange(0.0, 1700.0, 100.0)
    sides = [(x, y, x, y + part) for x in lines for y in lines for part in (30.0, -30.0)]
    walls = np.array([*sides, *((y, x, y + part, x) for x in lines for y in lines for part in (30.0, -30.0))])
    assert len(walls) > 1000
    tracemalloc.start()
    try:
        roadmap = Roadmap(walls, 10.0)
        length = total_length_in(roadmap.path((50.0, 50.0), (250.0, 150.0)))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # From the first room through three doors; around the ends of walls it is longer than straight.
    assert hypot(200.0, 100.0) < length <= 300.0
    assert peak < 50e6
    # The search does not reach most of the circles.
    assert roadmap.circle_nodes.cache_info().currsize < 100
