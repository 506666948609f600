"""The positions of other robots as sensors see them: sensor poses, and the robots that a ray can meet. Geometry only.

The positions at an instant are shared by all sensors that look at that instant. They may be computed later than they
are requested, but before any sensor uses them.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Final, NamedTuple, Protocol

import numpy as np

from worlds.geometry import NO_DISCS, FloatArray
from worlds.raycast import FAR_IN

MAX_ROBOT_RANGE_IN: Final = 500.0
"""No sensor notices a robot from farther away: readings end at 255 in, second echoes at about 400."""

GRAZING_IN: Final = 1e-6
"""A robot this much farther from a line than its radius still counts as met until its range is computed: rounding."""

NO_NEAR_ROBOTS: Final[FloatArray] = np.zeros((0, 4))
"""No rows x y radius row."""


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
        return self._between(x_in - MAX_ROBOT_RANGE_IN, x_in + MAX_ROBOT_RANGE_IN)

    def ahead(self, x_in: float, reach_x_in: float) -> FloatArray:
        """Return those of `near` that a ray from this x can meet before it has gone `reach_x_in` along x.

        There may be some more among them.
        """
        if len(self.discs) < 2:
            return NO_NEAR_ROBOTS
        radius = self.max_radius_in
        low, high = x_in + min(reach_x_in, 0.0) - radius, x_in + max(reach_x_in, 0.0) + radius
        return self._between(max(low, x_in - MAX_ROBOT_RANGE_IN), min(high, x_in + MAX_ROBOT_RANGE_IN))

    def _between(self, low_in: float, high_in: float) -> FloatArray:
        if len(self.discs) < 2:
            return NO_NEAR_ROBOTS
        xs = self._xs
        return self.sorted[bisect_left(xs, low_in) : bisect_right(xs, high_in)]

    @cached_property
    def max_radius_in(self) -> float:
        """The largest radius, and GRAZING_IN more."""
        return float(self.discs[:, 2].max()) + GRAZING_IN

    @cached_property
    def sorted(self) -> FloatArray:
        """The robots (n, 4), rows x y radius row, sorted by x."""
        order = self.discs[:, 0].argsort(kind="stable")
        return np.column_stack((self.discs[order], order))

    @cached_property
    def _xs(self) -> list[float]:
        xs: list[float] = self.sorted[:, 0].tolist()
        return xs


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


def robots_on_rays(
    sensor_poses: Sequence[SensorPose], directions: Sequence[complex], ranges: Sequence[float]
) -> Iterator[tuple[int, list[float]]]:
    """Yield the other robots that rays can meet: number of the ray, and x y radius in inches; some only graze.

    Parameters
    ----------
    sensor_poses, directions
        Origin of each ray, and its direction, a unit vector dx + i dy.
    ranges
        Range of each ray to the first wall, inches.
    """
    if all(len(pose.robots.discs) < 2 for pose in sensor_poses):
        return
    # 1. Candidates of each ray by their x, all in one array.
    to_wall = [min(far, FAR_IN) for far in ranges]
    near = [
        pose.robots.ahead(pose.x_in, far * direction.real)
        for pose, direction, far in zip(sensor_poses, directions, to_wall, strict=True)
    ]
    counts = [len(robots) for robots in near]
    robots = np.concatenate(near)
    # 2. Their centres in the frame of the ray: x + iy times the conjugate of the direction is ahead + i side.
    origins = np.array([complex(pose.x_in, pose.y_in) for pose in sensor_poses])
    turned = robots.view(np.complex128)[:, 0] - origins.repeat(counts)
    turned *= np.array(directions).conj().repeat(counts)
    # 3. Those that reach to the line, in front of the wall.
    reach = robots[:, 2] + GRAZING_IN
    met = (np.abs(turned.imag) <= reach).nonzero()[0]
    rays = np.searchsorted(np.cumsum(counts), met, side="right")
    ahead = turned.real.take(met).tolist()
    for ray, far, (x, y, radius, row) in zip(rays.tolist(), ahead, robots.take(met, axis=0).tolist(), strict=True):
        reach_in = radius + GRAZING_IN
        if row != sensor_poses[ray].self_index and -reach_in <= far <= to_wall[ray] + reach_in:
            yield ray, [x, y, radius]
