"""Statistics of the residuals of sonar echoes at walls, the same for real and for simulated runs.

Residual: reading less the perpendicular distance of the wall, of an echo that the wall explains.
Explained: the wall is met at a right angle within the cone, and the residual is at most MAX_RESIDUAL_IN.
Correlation: of each residual with that of the next echo of the same wall (lag 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from localization.filters.belief import HEADING, Floats
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import RingBody

MAX_RESIDUAL_IN: Final = 4.0
"""An echo farther from a wall than this is not of it: doors stand back by up to three and a half inches."""
HALF_CONE_RAD: Final = 0.5 * ConeSonar().cone_rad
HUBER: Final = 1.345
"""Threshold of Huber's weights in standard deviations: 95 % efficient for normal errors."""
MAD_STD: Final = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""
FIT_ITERATIONS: Final = 50
BEYOND_IN: Final = 40.0
"""A fitted wall extends this far beyond its first and its last echo: a metre."""


class Echoes(NamedTuple):
    """Echoes of a run, in order of time; limits left out.

    Attributes
    ----------
    poses
        True pose at each (k, 3), inches and radians; the ring's direction is the heading.
    sonars
        Number of the sonar (k,).
    ranges_in
        Readings (k,), inches from the ring.
    """

    poses: Floats
    sonars: Any
    ranges_in: Floats


class WallStatistics(NamedTuple):
    """Residuals of one wall: their number, mean and standard deviation in inches, and correlation at lag 1."""

    echoes: int
    mean_in: float
    std_in: float
    correlation: float


class ResidualStatistics(NamedTuple):
    """Residuals of each wall, and how many of all echoes the walls explain."""

    walls: tuple[WallStatistics, ...]
    echoes: int
    explained: int

    @property
    def explained_fraction(self) -> float:
        """Fraction of the echoes that the walls explain; 0 without echoes."""
        return self.explained / self.echoes if self.echoes else 0.0


def residual_statistics(echoes: Echoes, walls: Floats, ring: RingBody) -> ResidualStatistics:
    """Return the statistics of the echoes of a run at walls (m, 4), rows x1 y1 x2 y2 in inches."""
    explained, found = np.zeros(len(echoes.sonars), dtype=bool), []
    for wall in walls:
        of_wall, residuals = residuals_at(echoes, wall, ring)
        explained |= of_wall
        found.append(_statistics(residuals))
    return ResidualStatistics(tuple(found), len(explained), int(explained.sum()))


def residuals_at(echoes: Echoes, wall: Floats, ring: RingBody) -> tuple[Any, Floats]:
    """Return True for the echoes that a wall (4,) explains (k,), and their residuals in inches."""
    # 1. Faces and axes of the sonars, and the foot of the perpendicular from each.
    axes = echoes.poses[:, HEADING] + np.array(ring.sonar_angles_rad)[echoes.sonars]
    faces = echoes.poses[:, :2] + ring.sonar_ring_radius_in * np.column_stack((np.cos(axes), np.sin(axes)))
    first, span = wall[:2], wall[2:] - wall[:2]
    length = float(np.hypot(*span))
    from_end = faces - first
    foot = from_end @ (span / length)
    to_wall = foot[:, None] * (span / length) - from_end
    # 2. On the wall, in the cone, near enough.
    off_axis = np.arctan2(to_wall[:, 1], to_wall[:, 0]) - axes
    in_cone = np.abs(np.arctan2(np.sin(off_axis), np.cos(off_axis))) <= HALF_CONE_RAD
    residuals = echoes.ranges_in - np.hypot(to_wall[:, 0], to_wall[:, 1])
    of_wall = in_cone & (foot >= 0.0) & (foot <= length) & (np.abs(residuals) <= MAX_RESIDUAL_IN)
    return of_wall, residuals[of_wall]


def _statistics(residuals: Floats) -> WallStatistics:
    if len(residuals) < 2:
        return WallStatistics(len(residuals), 0.0, 0.0, 0.0)
    deviation = residuals - residuals.mean()
    variance = float((deviation**2).mean())
    correlation = float((deviation[1:] * deviation[:-1]).mean() / variance) if variance else 0.0
    return WallStatistics(len(residuals), float(residuals.mean()), variance**0.5, correlation)


def fit_walls(echoes: Echoes, sonars: Sequence[int], ring: RingBody, max_range_in: float) -> Floats:
    """Return a straight wall (k, 4) for each of these sonars, fitted to where its echoes lie on its axis.

    Least squares with Huber's weights, across the direction of the drive; echoes beyond `max_range_in` are left out.

    References
    ----------
    Huber, Robust Statistics (1981), section 7.8.
    """
    # 1. The direction of the drive: x of the frame in which walls are y = slope x + offset.
    ahead = echoes.poses[-1, :2] - echoes.poses[0, :2]
    ahead = ahead / np.hypot(*ahead)
    frame = np.array([ahead, [-ahead[1], ahead[0]]])
    walls = []
    for sonar in sonars:
        # 2. Points of the echoes on the axis of this sonar.
        mine = (echoes.sonars == sonar) & (echoes.ranges_in <= max_range_in)
        axes = echoes.poses[mine, HEADING] + ring.sonar_angles_rad[sonar]
        reach = ring.sonar_ring_radius_in + echoes.ranges_in[mine]
        points = echoes.poses[mine, :2] + reach[:, None] * np.column_stack((np.cos(axes), np.sin(axes)))
        x, y = (points @ frame.T).T
        # 3. Iteratively reweighted least squares.
        weights = np.ones(len(x))
        for _ in range(FIT_ITERATIONS):
            slope, offset = np.polyfit(x, y, 1, w=np.sqrt(weights))
            residuals = np.abs(y - slope * x - offset)
            limit = HUBER * MAD_STD * float(np.median(residuals))
            weights = np.minimum(1.0, limit / np.maximum(residuals, 1e-12))
        ends = np.array([x.min() - BEYOND_IN, x.max() + BEYOND_IN])
        walls.append((np.column_stack((ends, slope * ends + offset)) @ frame).ravel())
    return np.array(walls)
