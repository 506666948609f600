"""The positions of other robots as sensors see them: sensor poses, and the robots in range.

The positions at an instant are shared by all sensors that look at that instant. They may be computed later than they
are requested, but before any sensor uses them.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from functools import cached_property
from math import inf
from typing import Final, NamedTuple, Protocol

import numpy as np

from worlds.geometry import NO_DISCS, FloatArray

MAX_ROBOT_RANGE_IN: Final = 500.0
"""No sensor notices a robot from farther away: readings end at 255 in, second echoes at about 400."""

GRAZING_IN: Final = 1e-6
"""Robots this much farther along x than their radius are looked at, too: rounding."""


class RobotPositions:
    """Positions of all robots at one instant: discs (n, 3), rows x y radius in inches; empty until computed."""

    def __init__(self, discs: FloatArray = NO_DISCS) -> None:
        self.discs = discs

    def at(self, instant_ps: int) -> RobotPositions:
        """Return these positions, whatever the instant: nothing moves (a `PositionProvider`)."""
        del instant_ps
        return self

    def near(self, x_in: float) -> FloatArray:
        """Return the robots (k, 4) whose x is within MAX_ROBOT_RANGE_IN: rows x y radius row, sorted by x."""
        first = bisect_left(self.rows, [x_in - MAX_ROBOT_RANGE_IN])
        return self.sorted[first : bisect_right(self.rows, [x_in + MAX_ROBOT_RANGE_IN, inf])]

    @cached_property
    def max_radius_in(self) -> float:
        """The largest radius, and GRAZING_IN more."""
        return float(self.discs[:, 2].max(initial=0.0)) + GRAZING_IN

    @cached_property
    def sorted(self) -> FloatArray:
        """The robots (n, 4), rows x y radius row, sorted by x."""
        order = self.discs[:, 0].argsort(kind="stable")
        return np.column_stack((self.discs[order], order))

    @cached_property
    def rows(self) -> list[list[float]]:
        """The same in lists, for plain Python."""
        rows: list[list[float]] = self.sorted.tolist()
        return rows


class PositionProvider(Protocol):
    """Provides the positions of the robots at an instant."""

    def at(self, instant_ps: int) -> RobotPositions:
        """Return the positions at an instant in picoseconds."""


NO_OTHERS: Final = RobotPositions()
"""The positions for a robot that is alone."""


class SensorPose(NamedTuple):
    """The true pose of the sensors, and the robots that they may detect.

    Attributes
    ----------
    x_in, y_in, turret_rad
        True position in inches and true direction of the turret in radians.
    robots
        Positions of all robots.
    self_index
        Row of this robot in them, which is not detected.
    """

    x_in: float
    y_in: float
    turret_rad: float
    robots: RobotPositions = NO_OTHERS
    self_index: int = 0

    @property
    def others(self) -> FloatArray:
        """The robots (k, 3) without this one and without those beyond MAX_ROBOT_RANGE_IN."""
        if len(self.robots.discs) < 2:
            return NO_DISCS
        # In the order of the rows, so that results do not depend on the sorting by x.
        near = self.robots.near(self.x_in)
        rows = np.sort(near[:, 3]).astype(np.intp)
        discs = self.robots.discs.take(rows[rows != self.self_index], axis=0)
        others: FloatArray = discs[np.abs(discs[:, 1] - self.y_in) <= MAX_ROBOT_RANGE_IN]
        return others
