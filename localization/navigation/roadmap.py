"""Shortest paths for a round robot among walls: exact, of straight lines and arcs about the ends of walls.

Walls inflated by the radius have borders of lines and arcs. The shortest path among them is a taut string: lines that
touch two of the circles about the walls' ends, and free arcs of those circles in between.

    nodes    points where such a tangent touches a circle
    edges    free tangents, and free arcs from one node to the next on a circle
    path     A* from the start to the goal, whose own tangents are added to the graph

The tangents of a circle are computed when A* first reaches it, so time and memory follow the paths and not the size of
the map. Only ends of walls that see one another have common tangents, whatever the radius: WallEnds.

A start or goal nearer to a wall than the radius is left, or reached, by the shortest straight line that comes no
nearer. A Roadmap is used for many paths and stores the circles that they reached. Lengths in inches, angles in radians.

A path close to walls is slow, because an estimate is never exact; a wider one costs little length, up to a point.
Of the paths with each of MARGINS_IN the Planner takes the widest that is at most DETOUR longer than the shortest one
the bare body fits through; if all are longer, the narrowest. Around obstacles that the map does not contain it takes
the widest path there is: their extent is unknown, and sonars do not measure at short distances.

References
----------
Lozano-Perez, Wesley: An algorithm for planning collision-free paths among polyhedral obstacles (1979).
Liu, Arimoto: Path planning using a tangent graph for mobile robots among polygonal and curved obstacles (1992).
"""

import heapq
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from math import acos, atan2, hypot, inf, pi, tau
from typing import Any, Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.control_law import AxisLimits
from localization.navigation.path import (
    SLACK_IN,
    PathElement,
    PathSection,
    line_between,
    round_corners,
    split_into_sections,
    total_length_in,
    wall_distances,
)
from nclient.errors import NomadError
from worlds.geometry import crosses, crossings, expand, nearest_points, nearest_points_of_pairs

START, GOAL = 0, 1
ESCAPE_IN, ESCAPE_STEP_IN, ESCAPE_DIRECTIONS = 12.0, 0.25, 72
"""How far, in which steps and in how many directions a free point near a start or goal is searched."""
MAX_PAIRS: Final = 100_000
"""Segments times walls that are compared at once: about 10 MB of arrays."""
_FIRST_WALLS: Final = 16
"""Walls that all segments are compared with; the number doubles from step to step."""
_NEAREST_WALLS: Final = 8
"""Walls at each circle that discard most tangents before they are compared with others."""
TOUCH_IN: Final = 1e-3
"""A wall that ends so near to a line does not cross it: far more than SLACK_IN, by which a tangent may be too near."""
MAX_SEEN: Final = 10_000
"""Points whose visible ends are stored."""
NEAR_IN: Final = 0.01
"""Added to the distance within which walls matter for a circle, for rounding errors."""
_MIN_DISTANCE: Final = 1e-12
Point = tuple[float, float]
Indices = np.typing.NDArray[np.intp]
Mask = np.typing.NDArray[np.bool_]


class NoPathError(NomadError):
    """The robot does not fit through anywhere between start and goal."""


def segment_clearances(segments: Floats, walls: Floats) -> Floats:
    """Return the smallest distance (n,) of each segment (n, 4) to any wall (m, 4); 0 where they cross.

    Rows are x1 y1 x2 y2 in inches; the result is inf if there are no walls. Two segments that do not cross are
    nearest at an end of one of them.
    """
    if not len(walls) or not len(segments):
        return np.full(len(segments), np.inf)
    nearest = np.full(len(segments), np.inf)
    for end in (slice(0, 2), slice(2, 4)):
        _, from_segment = nearest_points(segments[:, end], walls)
        _, from_wall = nearest_points(walls[:, end], segments)
        nearest = np.minimum(nearest, np.minimum(from_segment.min(axis=1), from_wall.min(axis=0)))
    nearest[crossings(segments, walls).any(axis=1)] = 0.0
    return nearest


def are_clear(segments: Floats, walls: Floats, distance_in: float) -> Mask:
    """Return True (n,) for segments (n, 4) that keep a distance to all walls (m, 4).

    The same as `segment_clearances(segments, walls) >= distance_in`, but fast if the first walls block most.
    """
    clear = np.zeros(len(segments), dtype=np.bool_)
    clear[_passing(segments, walls, lambda part, near: segment_clearances(part, near) >= distance_in)] = True
    return clear


def _passing(segments: Floats, walls: Floats, passes: Callable[[Floats, Floats], Any]) -> Indices:
    """Return the rows of segments (n, 4) that pass walls (m, 4).

    A segment is compared with further walls only while it passes those before.
    """
    remaining = np.arange(len(segments))
    first, count = 0, _FIRST_WALLS
    while first < len(walls) and len(remaining):
        count = max(1, min(count, MAX_PAIRS // len(remaining)))
        near = walls[first : first + count]
        first, count = first + count, 2 * count
        remaining = remaining[passes(segments[remaining], near)]
    return remaining


class CornerCircle:
    """Circle of the robot's radius about an end of a wall, with the arcs that keep that distance to all walls."""

    def __init__(self, centre: Floats, walls: Floats, radius_in: float) -> None:
        # Between the angles where the circle meets an inflated wall an arc is free as a whole, or not at all.
        borders = np.unique(np.concatenate(([0.0], _border_angles(centre, walls, radius_in))))
        middles = borders + 0.5 * np.diff(borders, append=borders[0] + tau)
        points = centre + radius_in * np.stack((np.cos(middles), np.sin(middles)), axis=-1)
        self._borders = borders
        self._free = wall_distances(points, walls) >= radius_in - SLACK_IN

    def free(self, angles: Floats) -> list[bool]:
        """Return for each angle if the arc from it to the next one, and from the last to the first, is free.

        Parameters
        ----------
        angles : (n,) array
            Sorted angles in [0, 2 pi), n > 0.
        """
        begins, ends = self._borders[~self._free], np.append(self._borders[1:], tau)[~self._free]
        found = []
        for first, last in zip(angles, np.append(angles[1:], angles[0] + tau), strict=True):
            # An arc across angle 0 is checked as two spans.
            spans = [(first, min(last, tau)), (0.0, last - tau)]
            found.append(not any(
                ((begins < b - _MIN_DISTANCE) & (ends > a + _MIN_DISTANCE)).any() for a, b in spans if b > a
            ))  # fmt: skip
        return found


def _border_angles(centre: Floats, walls: Floats, radius_in: float) -> Floats:
    """Return the angles in [0, 2 pi) where the circle meets the border of a wall inflated by the same radius."""
    found: list[float] = []
    for x1, y1, x2, y2 in (walls - np.tile(centre, 2)).tolist():
        # 1. The circles about the two ends of the wall.
        for x, y in ((x1, y1), (x2, y2)):
            distance = hypot(x, y)
            if _MIN_DISTANCE < distance <= 2.0 * radius_in:
                found += [atan2(y, x) + side * acos(0.5 * distance / radius_in) for side in (-1.0, 1.0)]
        # 2. The two lines parallel to the wall.
        length = hypot(x2 - x1, y2 - y1)
        if length <= _MIN_DISTANCE:
            continue
        normal, offset = atan2(x2 - x1, y1 - y2), (x2 * y1 - x1 * y2) / length
        for line in (offset - radius_in, offset + radius_in):
            if abs(line) <= radius_in + SLACK_IN:
                turn = acos(max(-1.0, min(1.0, line / radius_in)))
                found += [normal - turn, normal + turn]
    return np.array(found) % tau


def common_tangents(centres: Floats, pairs: Indices, radius_in: float) -> tuple[Floats, Indices, Indices]:
    """Return the common tangents of pairs of circles of one radius.

    Two circles have two outer tangents, parallel to the line of their centres, and, if they do not overlap, two inner
    ones, at the angle acos(2 radius / distance) from it.

    Parameters
    ----------
    centres : (n, 2) array
    pairs : (p, 2) array of int
        Two different circles each.

    Returns
    -------
    angles : (k, 2) array
        Angle of the two touching points, each on its circle.
    circles : (k, 2) array of int
        The circles that these points lie on.
    kinds : (k,) array of int
        0 and 2 for outer, 1 and 3 for inner tangents: each at most once for a pair.
    """
    offset = centres[pairs[:, 1]] - centres[pairs[:, 0]]
    distance, along = np.hypot(offset[:, 0], offset[:, 1]), np.arctan2(offset[:, 1], offset[:, 0])
    apart = distance >= 2.0 * radius_in
    cross = np.arccos(np.minimum(1.0, 2.0 * radius_in / distance))
    angles, circles = [], []
    for side in (-1.0, 1.0):
        outer = along + side * 0.5 * pi
        angles.append(np.stack((outer, outer), axis=-1))
        inner = (along + side * cross)[apart]
        angles.append(np.stack((inner, inner + pi), axis=-1))
        circles += [pairs, pairs[apart]]
    kinds = np.repeat(np.arange(4), [len(part) for part in circles])
    return np.concatenate(angles) % tau, np.concatenate(circles), kinds


def tangents_from(point: Floats, centres: Floats, radius_in: float) -> tuple[Floats, Indices]:
    """Return the tangents from a point to circles (n, 2): angles (k,) of the touching points, their circles (k,)."""
    offset = point - centres
    distance, along = np.hypot(offset[:, 0], offset[:, 1]), np.arctan2(offset[:, 1], offset[:, 0])
    outside = np.flatnonzero(distance >= radius_in)
    turn = np.arccos(radius_in / distance[outside])
    angles = np.concatenate((along[outside] - turn, along[outside] + turn)) % tau
    return angles, np.concatenate((outside, outside))


def points_on_circles(centres: Floats, circles: Indices, angles: Floats, radius_in: float) -> Floats:
    """Return the points (..., 2) at angles (...) on circles (...)."""
    return centres[circles] + radius_in * np.stack((np.cos(angles), np.sin(angles)), axis=-1)


class _Arc(NamedTuple):
    """An edge along a circle: the circle's number, the start angle, and the turn about the centre."""

    circle: int
    from_rad: float
    turn_rad: float


class _CircleNodes(NamedTuple):
    """Nodes of one circle: the touching points of its free tangents, in the order of their numbers."""

    numbers: Indices
    """(k,) numbers of the nodes; the other end of the tangent has `number ^ 1`."""
    angles: Floats
    """(k,) angles on the circle."""
    points: Floats
    """(k, 2) touching points."""
    other_circles: Indices
    """(k,) circles of the other ends."""
    other_points: Floats
    """(k, 2) other ends."""


class _Search:
    """A* from START to GOAL, at two points (2, 2); the nodes and edges of a circle are added when it is reached.

    The numbers of nodes, and with them the choice among paths of one length, do not depend on earlier searches.
    """

    def __init__(self, ends: Floats) -> None:
        self._goal = ends[GOAL]
        self.points: dict[int, Point] = {}
        self._remaining: dict[int, float] = {}
        self._circle_of: dict[int, int] = {}
        self._edges: dict[int, list[tuple[float, int, _Arc | None]]] = defaultdict(list)
        self._ends_on: dict[int, list[tuple[int, float]]] = defaultdict(list)
        self._add_nodes([START, GOAL], ends)

    def add_end_tangents(self, end: int, numbers: Indices, angles: Floats, circles: Indices, points: Floats) -> None:
        """Add the free tangents from START or GOAL: angles (k,) on circles (k,), touching points (k, 2)."""
        self._add_nodes(numbers.tolist(), points)
        lengths = np.hypot(*(points - np.array(self.points[end])).T)
        for number, angle, circle, length in zip(
            numbers.tolist(), angles.tolist(), circles.tolist(), lengths.tolist(), strict=True
        ):
            self._circle_of[number] = circle
            self._ends_on[circle].append((number, angle))
            self.join(end, number, length)

    def join(self, one: int, other: int, length_in: float, arc: _Arc | None = None) -> None:
        """Add an edge in both directions."""
        back = arc and _Arc(arc.circle, arc.from_rad + arc.turn_rad, -arc.turn_rad)
        self._edges[one].append((length_in, other, arc))
        self._edges[other].append((length_in, one, back))

    def shortest(self, roadmap: "Roadmap") -> list[tuple[int, int, _Arc | None]] | None:
        """Return the edges from start to goal in order; None if they are not connected."""
        reached: dict[int, float] = {START: 0.0}
        before: dict[int, tuple[int, _Arc | None]] = {}
        queue: list[tuple[float, int]] = [(self._remaining[START], START)]
        done: set[int] = set()
        added: set[int] = set()
        while queue:
            _, node = heapq.heappop(queue)
            if node == GOAL:
                return _trace_back(before)
            if node in done:
                continue
            done.add(node)
            circle = self._circle_of.get(node)
            if circle is not None and circle not in added:
                added.add(circle)
                self._add_circle(circle, roadmap)
            for length, other, arc in self._edges[node]:
                total = reached[node] + length
                if total < reached.get(other, inf):
                    reached[other], before[other] = total, (node, arc)
                    heapq.heappush(queue, (total + self._remaining[other], other))
        return None

    def _add_nodes(self, numbers: list[int], points: Floats) -> None:
        # The straight distance to the goal never exceeds the remaining length: an admissible heuristic.
        remaining = np.hypot(*(points - self._goal).T).tolist()
        self.points.update(zip(numbers, map(tuple, points.tolist()), strict=True))
        self._remaining.update(zip(numbers, remaining, strict=True))

    def _add_circle(self, circle: int, roadmap: "Roadmap") -> None:
        """Add the nodes of a circle, the far ends of its tangents, and its edges."""
        nodes = roadmap.circle_nodes(circle)
        numbers = nodes.numbers.tolist()
        # 1. The free tangents.
        others = [number ^ 1 for number in numbers]
        self._add_nodes(numbers, nodes.points)
        self._add_nodes(others, nodes.other_points)
        self._circle_of.update(dict.fromkeys(numbers, circle))
        self._circle_of.update(zip(others, nodes.other_circles.tolist(), strict=True))
        lengths = np.hypot(*(nodes.other_points - nodes.points).T).tolist()
        for number, other, length in zip(numbers, others, lengths, strict=True):
            self._edges[number].append((length, other, None))
        # 2. Free arcs between neighbours, with the nodes of the start and the goal.
        ends = self._ends_on[circle]
        angles = np.concatenate(([angle for _, angle in ends], nodes.angles))
        numbers = [number for number, _ in ends] + numbers
        order = np.argsort(angles)
        angles = angles[order]
        turns = np.diff(angles, append=angles[0] + tau).tolist()
        free = roadmap.corner_circle(circle).free(angles)
        for k, (first, last) in enumerate(zip(order, np.roll(order, -1), strict=True)):
            if free[k]:
                arc = _Arc(circle, float(angles[k]), turns[k])
                self.join(numbers[first], numbers[last], roadmap.radius_in * turns[k], arc)


def _trace_back(before: dict[int, tuple[int, _Arc | None]]) -> list[tuple[int, int, _Arc | None]]:
    node, edges = GOAL, []
    while node != START:
        earlier, arc = before[node]
        edges.append((earlier, node, arc))
        node = earlier
    return edges[::-1]


class WallEnds:
    """The ends of walls (m, 4), and which of them see one another: the same for robots of all radii.

    A robot that drives along a common tangent of two circles covers the line between their centres, whatever its
    radius, so no wall crosses that line. The tangent is within the radius of it: only walls within twice the largest
    radius, `max_radius_in`, of the line can be too near.
    """

    def __init__(self, walls: Floats, max_radius_in: float) -> None:
        self.walls, self.max_radius_in = np.asarray(walls, dtype=np.float64).reshape(-1, 4), max_radius_in
        self.points: Floats = np.unique(self.walls.reshape(-1, 2), axis=0)
        self.visible_from = lru_cache(MAX_SEEN)(self._visible_from)
        self.walls_beside = cache(self._walls_beside)

    @cached_property
    def nearest(self) -> Indices:
        """The numbers (n, k) of the walls nearest to each end."""
        count = min(_NEAREST_WALLS, len(self.walls))
        if not count:
            return np.zeros((0, 0), dtype=np.intp)
        parts = np.array_split(self.points, -(-len(self.points) * len(self.walls) // MAX_PAIRS))
        distances = (nearest_points(part, self.walls)[1] for part in parts)
        return np.concatenate([np.argpartition(part, count - 1, axis=1)[:, :count] for part in distances])

    def _visible_from(self, point: Point) -> Indices:
        """Return the numbers of the ends that no wall hides from a point; of two that a wall touches both count."""
        nearest_first = self.walls[np.argsort(nearest_points(np.array(point), self.walls)[1], kind="stable")]
        segments = np.concatenate((np.broadcast_to(point, self.points.shape), self.points), axis=1)
        others = np.flatnonzero((segments[:, :2] != segments[:, 2:]).any(axis=1))
        seen = _passing(segments[others], nearest_first, lambda ray, near: ~crossings(ray, near, TOUCH_IN).any(axis=1))
        return others[seen]

    def _walls_beside(self, number: int) -> tuple[Indices, Indices]:
        """Return the walls near the lines from an end to those visible from it, in the order of `visible_from`.

        The numbers of the walls, and for each line the first of its walls, with the end of the last.
        """
        x, y = self.points[number].tolist()
        ends, reach_in = self.points[self.visible_from((x, y))], 2.0 * self.max_radius_in + NEAR_IN
        low, high = (function(ends, (x, y)) for function in (np.minimum, np.maximum))
        wall_low, wall_high = (function(self.walls[:, :2], self.walls[:, 2:]) for function in (np.minimum, np.maximum))
        apart = (wall_low > high[:, None] + reach_in) | (wall_high < low[:, None] - reach_in)
        lines, walls = np.nonzero(~apart.any(axis=-1))
        return walls, np.searchsorted(lines, np.arange(len(ends) + 1))


def pair_clearances(segments: Floats, walls: Floats) -> Floats:
    """Return `segment_clearances` of pairs (n,) of a segment and a wall, (n, 4) each."""
    nearest = np.full(len(segments), np.inf)
    for one, other in ((segments, walls), (walls, segments)):
        for end in (slice(0, 2), slice(2, 4)):
            np.minimum(nearest, nearest_points_of_pairs(one[:, end], other)[1], out=nearest)
    nearest[crosses(segments, walls)] = 0.0
    return nearest


class Roadmap:
    """Tangent graph among walls (m, 4) for a robot whose axis keeps `radius_in` from all of them.

    `ends` are those of the walls, for several roadmaps of one map.
    """

    def __init__(self, walls: Floats, radius_in: float, ends: WallEnds | None = None) -> None:
        self.walls, self.radius_in = np.asarray(walls, dtype=np.float64).reshape(-1, 4), radius_in
        self._ends = ends if ends and radius_in <= ends.max_radius_in else WallEnds(self.walls, radius_in)
        self._centres = self._ends.points
        self.corner_circle = cache(self._corner_circle)
        self.circle_nodes = cache(self._circle_nodes)

    def _corner_circle(self, number: int) -> CornerCircle:
        # Walls farther away do not come within the radius of a point on the circle.
        distances = nearest_points(self._centres[number], self.walls)[1]
        near = self.walls[distances <= 2.0 * self.radius_in + NEAR_IN]
        return CornerCircle(self._centres[number], near, self.radius_in)

    def _circle_nodes(self, number: int) -> _CircleNodes:
        """Return the free tangents of a circle."""
        count = len(self._centres)
        # 1. All tangents of pairs with this circle that see one another, the smaller number first.
        x, y = self._centres[number].tolist()
        others = self._ends.visible_from((x, y))
        pairs = np.stack((np.minimum(others, number), np.maximum(others, number)), axis=-1)
        angles, circles, kinds = common_tangents(self._centres, pairs, self.radius_in)
        points = points_on_circles(self._centres, circles, angles, self.radius_in)
        own = (circles[:, 1] == number).astype(np.intp)
        # 2. Discard those with an end too near to a wall, then those that pass too near to one.
        rows = np.arange(len(circles))
        for end in (own, 1 - own):
            near = self.walls[self._ends.nearest[circles[rows, end[rows]]]]
            _, distances = nearest_points_of_pairs(points[rows, end[rows], None], near)
            rows = rows[distances.min(axis=1) >= self.radius_in - SLACK_IN]
        walls_beside, first = self._ends.walls_beside(number)
        line = np.searchsorted(others, circles[rows].sum(axis=1) - number)
        row, at = expand(first[line], first[line + 1] - 1)
        clearance = pair_clearances(points[rows].reshape(-1, 4)[row], self.walls[walls_beside[at]])
        too_near = np.unique(row[clearance < self.radius_in - SLACK_IN])
        rows = np.delete(rows, too_near)
        # 3. Number the nodes after those of start and goal: by kind, pair and end.
        own, other = own[rows], 1 - own[rows]
        tangents = (kinds[rows] * count + circles[rows, 0]) * count + circles[rows, 1]
        return _CircleNodes(2 + 4 * count + 2 * tangents + own, angles[rows, own], points[rows, own],
                            circles[rows, other], points[rows, other])  # fmt: skip

    def path(self, start: Point, goal: Point, min_goal_distance_in: float | None = None) -> list[PathElement]:
        """Return the shortest path from start to goal; empty if they are the same point.

        Parameters
        ----------
        start, goal : (x, y)
            Inches.
        min_goal_distance_in : float, optional
            Required distance of the goal from walls. Default: the radius.

        Raises
        ------
        NoPathError
            If there is no path, or no space at the goal.
        """
        ends = np.array([start, goal], dtype=np.float64)
        distances = wall_distances(ends, self.walls)
        required = self.radius_in if min_goal_distance_in is None else min_goal_distance_in
        if distances[1] < required - SLACK_IN:
            raise NoPathError(
                f"no space at ({goal[0]:g}, {goal[1]:g}): {distances[1]:.1f} in to a wall, {required:.1f} in needed"
            )
        # 1. The straight line, if it is free.
        if self._are_free(ends.reshape(1, 4), min(self.radius_in, *distances), ends[0])[0]:
            return [line_between(start, goal)]
        # 2. Otherwise from a free point near the start to one near the goal.
        inner = np.stack([self._free_point_near(end, far) for end, far in zip(ends, distances, strict=True)])
        elements = self._search(inner)
        if elements is None:
            raise NoPathError(
                f"no path from ({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g}) for a robot of "
                f"{self.radius_in:.1f} in radius"
            )
        return [line_between(start, inner[START].tolist()), *elements, line_between(inner[GOAL].tolist(), goal)]

    def require_free(self, points: Sequence[Point]) -> None:
        """Raise NoPathError for the first straight line between points that comes too near to a wall.

        Only the first point may lie nearer to a wall than the radius.
        """
        lines = np.array([[*one, *other] for one, other in pairwise(points)], dtype=np.float64).reshape(-1, 4)
        required = np.full(len(lines), self.radius_in)
        required[:1] = np.minimum(required[:1], wall_distances(lines[:1, :2], self.walls))
        clearances = segment_clearances(lines, self.walls)
        for (x1, y1, x2, y2), distance, least in zip(lines.tolist(), clearances, required, strict=True):
            if distance < least - SLACK_IN:
                raise NoPathError(
                    f"the line from ({x1:g}, {y1:g}) to ({x2:g}, {y2:g}) comes within {distance:.1f} in of a "
                    f"wall, {least:.1f} in needed"
                )

    def _are_free(self, segments: Floats, distance_in: float, around: Floats) -> Mask:
        """Return True (n,) for segments (n, 4) that keep the distance to all walls; fast if all begin `around` here."""
        nearest_first = np.argsort(nearest_points(around, self.walls)[1], kind="stable")
        return are_clear(segments, self.walls[nearest_first], distance_in - SLACK_IN)

    def _free_point_near(self, point: Floats, distance_in: float) -> Floats:
        """Return the nearest point with enough distance that is reached straight, coming no nearer to a wall.

        Returns the point itself if its distance suffices, or if none is found.
        """
        if distance_in >= self.radius_in - SLACK_IN:
            return point
        angles = np.arange(ESCAPE_DIRECTIONS) * (tau / ESCAPE_DIRECTIONS)
        directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        for offset in np.arange(ESCAPE_STEP_IN, ESCAPE_IN, ESCAPE_STEP_IN):
            there = point + offset * directions
            there = there[wall_distances(there, self.walls) >= self.radius_in]
            here = np.broadcast_to(point, there.shape)
            free = self._are_free(np.concatenate((here, there), axis=1), distance_in, point)
            if free.any():
                found: Floats = there[free][0]
                return found
        return point

    def _search(self, ends: Floats) -> list[PathElement] | None:
        """Return the shortest path from ends[0] to ends[1] (2, 2); None if there is none."""
        search = _Search(ends)
        # 1. The direct line.
        if self._are_free(ends.reshape(1, 4), self.radius_in, ends[0])[0]:
            search.join(START, GOAL, float(np.hypot(*(ends[1] - ends[0]))))
        # 2. Free tangents from start and goal to all circles.
        count = 2
        for number, end in enumerate(ends):
            x, y = end.tolist()
            seen = self._ends.visible_from((x, y))
            angle, among = tangents_from(end, self._centres[seen], self.radius_in)
            circle = seen[among]
            there = points_on_circles(self._centres, circle, angle, self.radius_in)
            lines = np.concatenate((np.broadcast_to(end, there.shape), there), axis=1)
            free = self._are_free(lines, self.radius_in, end)
            numbers = np.arange(count, count + int(free.sum()))
            search.add_end_tangents(number, numbers, angle[free], circle[free], there[free])
            count += len(numbers)
        # 3. Search.
        edges = search.shortest(self)
        return None if edges is None else _join_elements([self._element(search, *edge) for edge in edges])

    def _element(self, search: _Search, one: int, other: int, arc: _Arc | None) -> PathElement:
        x, y = search.points[one]
        if arc is None:
            return line_between((x, y), search.points[other])
        left = 1.0 if arc.turn_rad >= 0.0 else -1.0
        heading = arc.from_rad + left * 0.5 * pi
        return PathElement(x, y, heading, left / self.radius_in, self.radius_in * abs(arc.turn_rad))


def _join_elements(elements: list[PathElement]) -> list[PathElement]:
    """Return the same path with consecutive arcs of one circle joined."""
    joined: list[PathElement] = []
    for element in elements:
        if joined and element.curvature and element.curvature == joined[-1].curvature:
            joined[-1] = joined[-1]._replace(length_in=joined[-1].length_in + element.length_in)
        else:
            joined.append(element)
    return joined


MARGINS_IN: Final = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Space between body and walls that paths are planned with; the first is the minimum."""
DETOUR: Final = 0.02
"""Accepted extra length, as a fraction of the shortest path without margin."""


class PlannedPath(NamedTuple):
    """Sections of a path, and the space it leaves between body and walls (in), except at its two ends."""

    sections: tuple[PathSection, ...]
    margin_in: float

    @property
    def length_in(self) -> float:
        """Length of the whole path."""
        return total_length_in(self.sections)


class Planner:
    """Path planner for a robot of `body_in` radius in a map of walls (m, 4); roadmaps are built once per margin."""

    def __init__(self, walls: Floats, body_in: float) -> None:
        self.walls = np.asarray(walls, dtype=np.float64).reshape(-1, 4)
        self.body_in = body_in
        self._ends = WallEnds(self.walls, body_in + MARGINS_IN[-1])
        self._roadmap = cache(lambda margin_in: Roadmap(self.walls, body_in + margin_in, self._ends))

    def plan(self, start: Point, goal: Point, obstacles: Floats | None = None,
             min_margin_in: float = 0.0) -> PlannedPath:
        """Return a path from start to goal.

        Parameters
        ----------
        start, goal : (x, y)
            Inches.
        obstacles : (k, 4) array, optional
            Segments to avoid in addition to the map's walls.
        min_margin_in : float
            Required margin, if larger than the smallest of the planner.

        Raises
        ------
        NoPathError
            If there is no path.
        """
        # 1. Margins that both ends have space for.
        spaces = wall_distances(np.array([start, goal]), self.walls) - self.body_in
        largest = max(min_margin_in, MARGINS_IN[0], float(spaces.min()))
        margins = [margin for margin in MARGINS_IN if min_margin_in <= margin <= largest] or [min_margin_in]
        if obstacles is not None and len(obstacles):
            return self._widest(start, goal, obstacles, margins)
        # 2. The longest accepted path.
        longest_in = inf
        with suppress(NoPathError):
            longest_in = (1.0 + DETOUR) * total_length_in(self._roadmap(0.0).path(start, goal, 0.0))
        # 3. Increase the margin until the path becomes too long.
        min_goal_distance = self.body_in + MARGINS_IN[0]
        best = None
        for margin in margins:
            try:
                elements = self._roadmap(margin).path(start, goal, min_goal_distance)
            except NoPathError:
                if best is None:
                    raise
                break
            if best is not None and total_length_in(elements) > longest_in:
                break
            best = PlannedPath(split_into_sections(elements), margin)
        assert best is not None
        return best

    def along(self, points: Sequence[Point], within_in: float, limits: AxisLimits) -> PlannedPath:
        """Return the straight lines from point to point, their corners rounded within `within_in` of the points.

        Raises
        ------
        NoPathError
            If a line comes too near to a wall.
        """
        margin = MARGINS_IN[0]
        self._roadmap(margin).require_free(points)
        elements = round_corners(points, within_in, limits, self.walls, self.body_in + margin)
        return PlannedPath(split_into_sections(elements), margin)

    def _widest(self, start: Point, goal: Point, obstacles: Floats, margins: Sequence[float]) -> PlannedPath:
        """Return the shortest path with the largest possible margin, or raise NoPathError."""
        walls = np.concatenate((self.walls, obstacles))
        ends = WallEnds(walls, self.body_in + max(margins))
        min_goal_distance = self.body_in + MARGINS_IN[0]
        *wide, narrow = sorted(margins, reverse=True)
        for margin in wide:
            with suppress(NoPathError):
                elements = Roadmap(walls, self.body_in + margin, ends).path(start, goal, min_goal_distance)
                return PlannedPath(split_into_sections(elements), margin)
        elements = Roadmap(walls, self.body_in + narrow, ends).path(start, goal, min_goal_distance)
        return PlannedPath(split_into_sections(elements), narrow)
