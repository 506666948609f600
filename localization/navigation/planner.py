"""Where to drive from here to there: the shortest way, or one that is little longer and leaves more room.

    of the ways at each of MARGINS_IN from all walls the widest that is no more than LONGER longer than the shortest
    that the body fits through at all, and no wider than both ends have room; the narrowest, where all are longer

A way close to walls is slow, for an estimate is never exact; a wider one costs little, up to where it does. Around what
was found besides it is the widest there is: nobody knows how far that reaches, and sonars are blind for what is near.
Rules: pure; walls of the map, what was found besides, points. Planners keep their roadmaps of the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from math import inf
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.path import Stretch, length_of, room, round_corners, stretches
from localization.navigation.roadmap import NoPathError, Point, Roadmap, length_in
from localization.navigation.speed import AxisLimits

MARGINS_IN: Final = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Room between body and walls that ways are planned with; the first is the least."""
LONGER: Final = 0.02
"""What room may cost, as a share of the shortest way without any; a drive is longer than its plan by up to as much."""


class Plan(NamedTuple):
    """A course, and the room it leaves: between the body and the nearest wall, but for its two ends."""

    course: tuple[Stretch, ...]
    margin_in: float

    @property
    def length_in(self) -> float:
        """Of the whole course."""
        return length_of(self.course)


class Planner:
    """Plans for a robot of `body_in` radius in a map of walls (m, 4)."""

    def __init__(self, walls: Floats, body_in: float, margins_in: Sequence[float] = MARGINS_IN) -> None:
        self.walls = np.asarray(walls, dtype=np.float64).reshape(-1, 4)
        self.body_in, self._margins = body_in, tuple(margins_in)
        self._roadmap = cache(self._made)

    def _made(self, margin_in: float) -> Roadmap:
        return Roadmap(self.walls, self.body_in + margin_in)

    def plan(self, start: Point, goal: Point, besides: Floats | None = None, least_in: float = 0.0) -> Plan:
        """A way from start to goal around the map's walls and those found `besides` (k, 4), with `least_in` of margin
        where that is more than the least. Raises NoPathError."""
        rooms = room(np.array([start, goal]), self.walls) - self.body_in
        most = max(least_in, self._margins[0], float(rooms.min()))
        margins = [margin for margin in self._margins if least_in <= margin <= most] or [least_in]
        least = self.body_in + self._margins[0]
        if besides is not None and len(besides):
            return self._widest(start, goal, besides, margins)
        best, most_in = None, inf
        with suppress(NoPathError):
            most_in = (1.0 + LONGER) * length_in(self._roadmap(0.0).path(start, goal, 0.0))
        for margin in margins:
            try:
                legs = self._roadmap(margin).path(start, goal, least)
            except NoPathError:
                if best is None:
                    raise
                break
            if best is not None and length_in(legs) > most_in:
                break
            best = Plan(stretches(legs), margin)
        assert best is not None
        return best

    def along(self, points: Sequence[Point], within_in: float, limits: AxisLimits) -> Plan:
        """The straight ways from point to point, corners made round within `within_in` of them. Raises NoPathError
        they come too near to a wall."""
        margin = self._margins[0]
        roadmap = self._roadmap(margin)
        roadmap.require_free(points)
        legs = round_corners(points, within_in, limits, self.walls, self.body_in + margin)
        return Plan(stretches(legs), margin)

    def _widest(self, start: Point, goal: Point, besides: Floats, margins: Sequence[float]) -> Plan:
        """The shortest way with the most room there is. Raises NoPathError where there is none with the least."""
        walls, least = np.concatenate((self.walls, besides)), self.body_in + self._margins[0]
        *wide, narrow = sorted(margins, reverse=True)
        for margin in wide:
            with suppress(NoPathError):
                return Plan(stretches(Roadmap(walls, self.body_in + margin).path(start, goal, least)), margin)
        return Plan(stretches(Roadmap(walls, self.body_in + narrow).path(start, goal, least)), narrow)
