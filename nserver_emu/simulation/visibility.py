"""The positions of other robots as sensors see them: sensor poses, the robots in range, and the nearest on a ray.

The positions at an instant are shared by all sensors that look at that instant. They may be computed later than they
are requested, but before any sensor uses them.
"""

from __future__ import annotations

import sys
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import cached_property
from math import inf
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from worlds import raycast
from worlds.compiled import CompiledFunction, is_compiled_for
from worlds.geometry import NO_DISCS, FloatArray
from worlds.raycast import nearest_wall, ray_to_disc

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


# The nearest robot on a ray.

FAR_IN: Final = 1e6
"""Farther than any wall."""


def nearest_disc(
    x: float,
    y: float,
    dx: float,
    dy: float,
    wall_in: float,
    discs: Sequence[Sequence[float]] | FloatArray,
    own: int,
    max_radius_in: float,
) -> float:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest robot, or to a nearer wall, inches.

    Parameters
    ----------
    wall_in
        Range to the nearest wall, inches; inf for none.
    discs
        Rows x y radius row, sorted by x: `RobotPositions.rows` or `sorted`. Row `own` is not met, nor are those whose x
        is farther than MAX_ROBOT_RANGE_IN.
    max_radius_in
        No less than any radius.
    """
    # 1. The interval of x in which a disc can be nearer than the wall.
    reach_x = min(wall_in, FAR_IN) * dx
    low = max(x + min(reach_x, 0.0) - max_radius_in, x - MAX_ROBOT_RANGE_IN)
    high = min(x + max(reach_x, 0.0) + max_radius_in, x + MAX_ROBOT_RANGE_IN)
    # 2. The nearest of the discs in it.
    nearest = wall_in
    for index in range(_first_from(discs, low), len(discs)):
        disc = discs[index]
        if disc[0] > high:
            break
        if disc[3] != own:
            nearest = min(nearest, ray_to_disc(x, y, dx, dy, disc))
    return nearest


def _first_from(discs: Sequence[Sequence[float]] | FloatArray, low: float) -> int:
    """Return the index of the first disc whose x is at least `low`: bisect_left, which numba does not have."""
    begin, end = 0, len(discs)
    while begin < end:
        middle = (begin + end) // 2
        if discs[middle][0] < low:
            begin = middle + 1
        else:
            end = middle
    return begin


def nearest_obstacle(
    x: float,
    y: float,
    dx: float,
    dy: float,
    walls: FloatArray,
    discs: FloatArray,
    own: int,
    max_radius_in: float,
) -> float:
    """Return the range along a ray to the nearest wall (m, 4) or robot: `nearest_wall`, then `nearest_disc`."""
    rows = zip(walls[:, 0], walls[:, 1], walls[:, 2], walls[:, 3])  # noqa: B905  for numba
    wall_in = nearest_wall(x, y, dx, dy, rows)[0]
    return nearest_disc(x, y, dx, dy, wall_in, discs, own, max_radius_in)


def _example() -> tuple[Any, ...]:
    walls = np.zeros((1, 4))
    walls.setflags(write=False)
    return 0.0, 0.0, 1.0, 0.0, walls, np.zeros((0, 4)), 0, 1.0


NEAREST_OBSTACLE: Final = CompiledFunction(nearest_obstacle, lambda: (raycast, sys.modules[__name__]), _example)
"""`nearest_obstacle`, for read-only walls, where it is compiled; plain, `cast_each` and `nearest_disc` are faster."""


def load_compiled(robots: int) -> None:
    """Compile `NEAREST_OBSTACLE`, or load it, if NOMAD_COMPILED asks for it with so many robots."""
    if not NEAREST_OBSTACLE.is_compiled and is_compiled_for(robots):
        NEAREST_OBSTACLE.load()
