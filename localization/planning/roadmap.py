"""The shortest way for a round robot among walls: a visibility graph on walls grown by the robot's radius.

    nodes    corners around every end of a wall, on a polygon about the circle of that radius, where there is room
    edges    straight ways between nodes that come no nearer to any wall than the radius, exactly
    path     A* over them, from a start to a goal that are joined to all nodes they see

A circle taken as a polygon of CORNERS sides makes a path longer by 1 / cos(pi / CORNERS) of its arcs at most: 1 %.
Rules: pure; walls of the map, a radius, points; no robot, no estimate. A Roadmap is built once for many paths.
"""

from __future__ import annotations

import heapq
from itertools import pairwise
from math import cos, hypot, inf, pi, tau
from typing import Final

import numpy as np

from localization.belief import Floats
from localization.planning.clearance import clearances
from nclient.errors import NomadError
from worlds.geometry import nearest_points

CORNERS: Final = 24
_SLACK_IN: Final = 1e-6
"""A way that touches its own corner's circle is free, whatever rounding says."""


class NoWayError(NomadError):
    """There is no way that the robot fits through."""


class Roadmap:
    """Ways among walls (m, 4) for a robot whose axis keeps `radius_in` from them all."""

    def __init__(self, walls: Floats, radius_in: float) -> None:
        self.walls, self.radius_in = walls, radius_in
        self.nodes = self._corners()
        self._ways = self._visible(self.nodes, self.nodes)

    def path(self, start: tuple[float, float], goal: tuple[float, float]) -> list[tuple[float, float]]:
        """The shortest polyline from start to goal, both included.

        A start that is nearer to a wall than the radius may leave it straight, coming no nearer. Raises NoWayError
        where there is none, saying which end has no room.
        """
        points = np.array([start, goal], dtype=np.float64)
        room = self._room(points)
        if room[1] < self.radius_in - _SLACK_IN:
            raise NoWayError(
                f"no room at ({goal[0]:g}, {goal[1]:g}): {room[1]:.1f} in to a wall, {self.radius_in:.1f} wanted"
            )
        direct = self._visible(points[:1], points[1:], float(room[0]))[0, 0]
        if direct < inf:
            return [start, goal]
        from_start = self._visible(points[:1], self.nodes, float(room[0]))[0]
        to_goal = self._visible(self.nodes, points[1:])[:, 0]
        order = self._shortest(from_start, to_goal, points[1])
        if order is None:
            raise NoWayError(f"no way from ({start[0]:g}, {start[1]:g}) to ({goal[0]:g}, {goal[1]:g}) for a robot of "
                             f"{self.radius_in:.1f} in radius")
        corners = [(float(x), float(y)) for x, y in self.nodes[order]]
        return [start, *corners, goal]

    def _room(self, points: Floats) -> Floats:
        if not len(self.walls):
            return np.full(len(points), inf)
        _, far = nearest_points(points, self.walls)
        nearest: Floats = far.min(axis=1)
        return nearest

    def _corners(self) -> Floats:
        """Corners around the ends of all walls that the robot may stand at."""
        ends = np.unique(self.walls.reshape(-1, 2), axis=0)
        angles = np.arange(CORNERS) * (tau / CORNERS)
        out = self.radius_in / cos(pi / CORNERS) + _SLACK_IN
        around = ends[:, None, :] + out * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        corners = around.reshape(-1, 2)
        kept: Floats = corners[self._room(corners) >= self.radius_in - _SLACK_IN]
        return kept

    def _visible(self, starts: Floats, ends: Floats, start_room_in: float = inf) -> Floats:
        """Lengths (a, b) of the ways from starts (a, 2) to ends (b, 2); inf where there is no room on one."""
        pairs = np.concatenate(
            (np.repeat(starts, len(ends), axis=0), np.tile(ends, (len(starts), 1))), axis=1
        )
        wanted = min(self.radius_in, start_room_in) - _SLACK_IN
        free = clearances(pairs, self.walls) >= wanted
        lengths = np.hypot(pairs[:, 2] - pairs[:, 0], pairs[:, 3] - pairs[:, 1])
        found: Floats = np.where(free, lengths, inf).reshape(len(starts), len(ends))
        return found

    def _shortest(self, from_start: Floats, to_goal: Floats, goal: Floats) -> list[int] | None:
        """Node numbers of the shortest path, in order (A*, the straight line as what is left at least)."""
        left = np.hypot(*(self.nodes - goal).T) if len(self.nodes) else np.zeros(0)
        reached = from_start.copy()
        before = np.full(len(self.nodes), -1)
        queue = [(float(reached[node] + left[node]), int(node)) for node in np.flatnonzero(reached < inf)]
        heapq.heapify(queue)
        best, last, done = inf, -1, np.zeros(len(self.nodes), dtype=bool)
        while queue and queue[0][0] < best:
            _, node = heapq.heappop(queue)
            if done[node]:
                continue
            done[node] = True
            if reached[node] + to_goal[node] < best:
                best, last = float(reached[node] + to_goal[node]), node
            further = reached[node] + self._ways[node]
            for other in np.flatnonzero(further < reached):
                reached[other], before[other] = further[other], node
                heapq.heappush(queue, (float(reached[other] + left[other]), int(other)))
        if last < 0:
            return None
        order = [last]
        while before[order[-1]] >= 0:
            order.append(int(before[order[-1]]))
        return order[::-1]


def length_in(path: list[tuple[float, float]]) -> float:
    """The length of a polyline."""
    return sum(hypot(x2 - x1, y2 - y1) for (x1, y1), (x2, y2) in pairwise(path))
