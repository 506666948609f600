"""Path planning: the shortest path, or one that is a little longer and leaves more space.

A path close to walls is slow, because an estimate is never exact; a wider one costs little length, up to a point.
Of the paths with each of MARGINS_IN the planner takes the widest that is at most DETOUR longer than the shortest one
the bare body fits through; if all are longer, the narrowest. Around obstacles that the map does not contain it takes
the widest path there is: their extent is unknown, and sonars do not measure at short distances.
"""

from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from math import inf
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.limits import AxisLimits
from localization.navigation.path import (
    PathSection,
    round_corners,
    split_into_sections,
    total_length_in,
    wall_distances,
)
from localization.navigation.roadmap import NoPathError, Point, Roadmap

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

    def __init__(self, walls: Floats, body_in: float, margins_in: Sequence[float] = MARGINS_IN) -> None:
        self.walls = np.asarray(walls, dtype=np.float64).reshape(-1, 4)
        self.body_in, self._margins = body_in, tuple(margins_in)
        self._roadmap = cache(self._build_roadmap)

    def _build_roadmap(self, margin_in: float) -> Roadmap:
        return Roadmap(self.walls, self.body_in + margin_in)

    def plan(
        self, start: Point, goal: Point, obstacles: Floats | None = None, min_margin_in: float = 0.0
    ) -> PlannedPath:
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
        largest = max(min_margin_in, self._margins[0], float(spaces.min()))
        margins = [margin for margin in self._margins if min_margin_in <= margin <= largest] or [min_margin_in]
        if obstacles is not None and len(obstacles):
            return self._widest(start, goal, obstacles, margins)
        # 2. The longest accepted path.
        longest_in = inf
        with suppress(NoPathError):
            longest_in = (1.0 + DETOUR) * total_length_in(self._roadmap(0.0).path(start, goal, 0.0))
        # 3. Increase the margin until the path becomes too long.
        min_goal_distance = self.body_in + self._margins[0]
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
        margin = self._margins[0]
        self._roadmap(margin).require_free(points)
        elements = round_corners(points, within_in, limits, self.walls, self.body_in + margin)
        return PlannedPath(split_into_sections(elements), margin)

    def _widest(self, start: Point, goal: Point, obstacles: Floats, margins: Sequence[float]) -> PlannedPath:
        """Return the shortest path with the largest possible margin, or raise NoPathError."""
        walls = np.concatenate((self.walls, obstacles))
        min_goal_distance = self.body_in + self._margins[0]
        *wide, narrow = sorted(margins, reverse=True)
        for margin in wide:
            with suppress(NoPathError):
                elements = Roadmap(walls, self.body_in + margin).path(start, goal, min_goal_distance)
                return PlannedPath(split_into_sections(elements), margin)
        elements = Roadmap(walls, self.body_in + narrow).path(start, goal, min_goal_distance)
        return PlannedPath(split_into_sections(elements), narrow)
