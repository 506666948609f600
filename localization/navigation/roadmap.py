"""How near straight ways come to walls. Rules: pure arrays of plane geometry; inches; no robot, no path.

    ways (n, 4), walls (m, 4)    rows x1 y1 x2 y2

The shortest way for a round robot among walls: straight lines and arcs about the ends of walls, exactly.

    walls grown by the radius have borders of lines and arcs; the shortest way among them is a taut string: lines that
    touch two of the circles about the walls' ends, and free arcs of those circles between
    nodes    where such a line touches a circle         edges    free lines, and free arcs from one node to the next
    path     A* over them, from a start and to a goal whose own tangents are added

(the visibility graph of Lozano-Perez and Wesley 1979, for circles as Liu and Arimoto 1992.) A start or goal nearer to a
wall than the radius is left, or reached, by the shortest straight way that comes no nearer.
Rules: pure; walls of the map, a radius, points; no robot, no estimate. A Roadmap is built once for many paths.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from math import inf, pi, tau
from typing import NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.path import (
    SLACK_IN,
    CornerCircle,
    Leg,
    on_circles,
    room,
    straight,
    tangents,
    tangents_from,
)
from nclient.errors import NomadError
from worlds.geometry import nearest_points


def clearances(ways: Floats, walls: Floats) -> Floats:
    """The least distance (n,) of each way to any wall; 0 where they cross, inf where there are no walls.

    Two segments that do not cross are nearest at an end of one of them.
    """
    if not len(walls) or not len(ways):
        return np.full(len(ways), np.inf)
    nearest = np.full(len(ways), np.inf)
    for end in (slice(0, 2), slice(2, 4)):
        _, of_way = nearest_points(ways[:, end], walls)
        _, of_wall = nearest_points(walls[:, end], ways)
        nearest = np.minimum(nearest, np.minimum(of_way.min(axis=1), of_wall.min(axis=0)))
    nearest[_crossing(ways, walls).any(axis=1)] = 0.0
    return nearest


def _crossing(ways: Floats, walls: Floats) -> np.typing.NDArray[np.bool_]:
    """Which way crosses which wall, (n, m)."""
    one, other = ways[:, None, :], walls[None, :, :]
    sides = _side(one, other[..., :2]) * _side(one, other[..., 2:])
    other_sides = _side(other, one[..., :2]) * _side(other, one[..., 2:])
    crossing: np.typing.NDArray[np.bool_] = (sides < 0.0) & (other_sides < 0.0)
    return crossing


def _side(segments: Floats, points: Floats) -> Floats:
    along = segments[..., 2:] - segments[..., :2]
    off = points - segments[..., :2]
    side: Floats = along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0]
    return side


START, GOAL = 0, 1
_REACH_IN, _STEP_IN, _DIRECTIONS = 12.0, 0.25, 72
Point = tuple[float, float]


class NoPathError(NomadError):
    """There is no way that the robot fits through."""


class _Arc(NamedTuple):
    """An edge along a circle: the circle, the angle it begins at, and the turn about the centre."""

    circle: int
    from_rad: float
    turn_rad: float


class _Graph:
    """Nodes (n, 2), the first two start and goal; `edges` of each: length, the other end, the arc or None."""

    def __init__(self, points: Floats) -> None:
        self.points = points
        self.edges: dict[int, list[tuple[float, int, _Arc | None]]] = defaultdict(list)

    def join(self, one: int, other: int, length_in: float, arc: _Arc | None = None) -> None:
        back = arc and _Arc(arc.circle, arc.from_rad + arc.turn_rad, -arc.turn_rad)
        self.edges[one].append((length_in, other, arc))
        self.edges[other].append((length_in, one, back))

    def shortest(self) -> list[tuple[int, int, _Arc | None]] | None:
        """The edges from start to goal, in order (A*, the straight line as what is left at least)."""
        left = np.hypot(*(self.points - self.points[GOAL]).T).tolist()
        reached: dict[int, float] = {START: 0.0}
        before: dict[int, tuple[int, _Arc | None]] = {}
        queue: list[tuple[float, int]] = [(left[START], START)]
        done: set[int] = set()
        while queue:
            _, node = heapq.heappop(queue)
            if node == GOAL:
                return _back(before)
            if node in done:
                continue
            done.add(node)
            for length, other, arc in self.edges[node]:
                further = reached[node] + length
                if further < reached.get(other, inf):
                    reached[other], before[other] = further, (node, arc)
                    heapq.heappush(queue, (further + left[other], other))
        return None


def _back(before: dict[int, tuple[int, _Arc | None]]) -> list[tuple[int, int, _Arc | None]]:
    node, edges = GOAL, []
    while node != START:
        earlier, arc = before[node]
        edges.append((earlier, node, arc))
        node = earlier
    return edges[::-1]


class Roadmap:
    """Ways among walls (m, 4) for a robot whose axis keeps `radius_in` from them all."""

    def __init__(self, walls: Floats, radius_in: float) -> None:
        self.walls, self.radius_in = np.asarray(walls, dtype=np.float64).reshape(-1, 4), radius_in
        self._centres = np.unique(self.walls.reshape(-1, 2), axis=0)
        self._rims = [CornerCircle(centre, self.walls, radius_in) for centre in self._centres]
        angles, circles = tangents(self._centres, radius_in)
        ends = [on_circles(self._centres, circles[:, k], angles[:, k], radius_in) for k in (0, 1)]
        free = self._free(np.concatenate(ends, axis=1), radius_in)
        self._angles, self._circles = angles[free].reshape(-1), circles[free].reshape(-1)
        self._nodes = np.stack(ends, axis=1)[free].reshape(-1, 2)

    def path(self, start: Point, goal: Point, least_room_in: float | None = None) -> list[Leg]:
        """The shortest way from start to goal; none where they are one point.

        `least_room_in`: how near to a wall the goal may lie (the radius, where it is not given). Raises NoPathError
        where there is no way, saying which end has no room.
        """
        ends = np.array([start, goal], dtype=np.float64)
        rooms = room(ends, self.walls)
        least = self.radius_in if least_room_in is None else least_room_in
        if rooms[1] < least - SLACK_IN:
            raise NoPathError(f"no room at ({goal[0]:g}, {goal[1]:g}): {rooms[1]:.1f} in to a wall, {least:.1f} wanted")
        if self._free(ends.reshape(1, 4), min(self.radius_in, *rooms))[0]:
            return [straight(start, goal)]
        inner = np.stack([self._pushed(end, far) for end, far in zip(ends, rooms, strict=True)])
        legs = self._among(inner)
        if legs is None:
            raise NoPathError(
                f"no way from ({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g}) for a robot of "
                f"{self.radius_in:.1f} in radius"
            )
        return [straight(start, inner[START].tolist()), *legs, straight(inner[GOAL].tolist(), goal)]

    def require_free(self, points: Sequence[Point]) -> None:
        """Raises NoPathError, naming it, for the first straight way from point to point that comes too near to a wall;
        the first point alone may lie nearer."""
        ways = np.array([[*one, *other] for one, other in pairwise(points)], dtype=np.float64).reshape(-1, 4)
        wanted = np.full(len(ways), self.radius_in)
        wanted[:1] = np.minimum(wanted[:1], room(ways[:1, :2], self.walls))
        near = clearances(ways, self.walls)
        for (x1, y1, x2, y2), far, least in zip(ways.tolist(), near, wanted, strict=True):
            if far < least - SLACK_IN:
                raise NoPathError(
                    f"the way from ({x1:g}, {y1:g}) to ({x2:g}, {y2:g}) comes within {far:.1f} in of a "
                    f"wall, {least:.1f} wanted"
                )

    def _free(self, ways: Floats, wanted_in: float) -> np.typing.NDArray[np.bool_]:
        """Which straight ways (n, 4) keep so far from all walls."""
        free: np.typing.NDArray[np.bool_] = clearances(ways, self.walls) >= wanted_in - SLACK_IN
        return free

    def _pushed(self, point: Floats, room_in: float) -> Floats:
        """The nearest point with room that is reached straight, coming no nearer; the point itself where it has room,
        or where there is none."""
        if room_in >= self.radius_in - SLACK_IN:
            return point
        angles = np.arange(_DIRECTIONS) * (tau / _DIRECTIONS)
        ways = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        for far in np.arange(_STEP_IN, _REACH_IN, _STEP_IN):
            there = point + far * ways
            there = there[room(there, self.walls) >= self.radius_in]
            here = np.broadcast_to(point, there.shape)
            free = self._free(np.concatenate((here, there), axis=1), room_in)
            if free.any():
                pushed: Floats = there[free][0]
                return pushed
        return point

    def _among(self, ends: Floats) -> list[Leg] | None:
        """The shortest way from ends[0] to ends[1] (2, 2); None where there is none."""
        points, angles, circles = [ends], [], []
        lines: list[tuple[int, int, float]] = []
        if self._free(ends.reshape(1, 4), self.radius_in)[0]:
            lines.append((START, GOAL, float(np.hypot(*(ends[1] - ends[0])))))
        count = 2
        for number, end in enumerate(ends):
            angle, circle = tangents_from(end, self._centres, self.radius_in)
            there = on_circles(self._centres, circle, angle, self.radius_in)
            free = self._free(np.concatenate((np.broadcast_to(end, there.shape), there), axis=1), self.radius_in)
            points.append(there[free])
            angles.append(angle[free])
            circles.append(circle[free])
            lengths = np.hypot(*(there[free] - end).T)
            lines += [(number, count + k, float(length)) for k, length in enumerate(lengths)]
            count += len(lengths)
        graph = _Graph(np.concatenate([*points, self._nodes]))
        for line in lines:
            graph.join(*line)
        for k in range(0, len(self._nodes), 2):
            graph.join(count + k, count + k + 1, float(np.hypot(*(self._nodes[k + 1] - self._nodes[k]))))
        self._join_arcs(graph, np.concatenate([*angles, self._angles]), np.concatenate([*circles, self._circles]))
        edges = graph.shortest()
        return None if edges is None else _joined([self._leg(graph, *edge) for edge in edges])

    def _join_arcs(self, graph: _Graph, angles: Floats, circles: np.typing.NDArray[np.intp]) -> None:
        """Join the nodes on each circle to the next ones where the arc between is free; nodes are counted from 2."""
        for number, rim in enumerate(self._rims):
            there = np.flatnonzero(circles == number)
            if not len(there):
                continue
            there = there[np.argsort(angles[there])]
            turns = np.diff(angles[there], append=angles[there[0]] + tau)
            around = zip(there, np.roll(there, -1), turns, rim.free(angles[there]), strict=True)
            for one, other, turn, free in around:
                if free:
                    arc = _Arc(number, float(angles[one]), float(turn))
                    graph.join(int(one) + 2, int(other) + 2, self.radius_in * float(turn), arc)

    def _leg(self, graph: _Graph, one: int, other: int, arc: _Arc | None) -> Leg:
        x, y = graph.points[one].tolist()
        if arc is None:
            return straight((x, y), graph.points[other].tolist())
        left = 1.0 if arc.turn_rad >= 0.0 else -1.0
        return Leg(x, y, arc.from_rad + left * 0.5 * pi, left / self.radius_in, self.radius_in * abs(arc.turn_rad))


def _joined(legs: list[Leg]) -> list[Leg]:
    """The same way, arcs that go on in one another as one."""
    joined: list[Leg] = []
    for leg in legs:
        if joined and leg.curvature and leg.curvature == joined[-1].curvature:
            joined[-1] = joined[-1]._replace(length_in=joined[-1].length_in + leg.length_in)
        else:
            joined.append(leg)
    return joined


def length_in(legs: list[Leg]) -> float:
    """The length of a way."""
    return sum(leg.length_in for leg in legs)
