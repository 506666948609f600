"""What a sonar would hear from anywhere in the map, worked out once: for finding a robot nobody knows the place of.

    at [row, column, direction]     range and chance of the likeliest return: the robot on a grid of the free floor, the
                                    sonar looking in that direction, whichever sonar it is

So the likelihood of a whole ring of echoes at a hundred thousand poses is table lookups. Rules: pure; the map alone, no
reading is kept here. Ranges are those of the middle of a cell: whoever looks up widens by `cell_std_in`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats
from localization.filters.reflectors import Reflectors, reflectors
from localization.filters.sonar_cone import ConeSonar, SonarMount, cone_returns
from localization.filters.sonar_ray import RaySonar, SonarRing, wall_map
from worlds.geometry import nearest_points
from worlds.raycast import cast_rays

CELL_IN: Final = 3.0
DIRECTIONS: Final = 120
"""Cells of 3 degrees: a ring's 22.5 degrees are 7.5 of them, so a pose's heading falls anywhere in a cell."""
_BLOCK: Final = 20_000
"""Places and directions worked on at a time: some 100 MB."""
HEADING_STD_RAD: Final = 2.0 * np.pi / DIRECTIONS / np.sqrt(12.0)


HIGHEST_IN: Final = 255
BAD_SHARE: Final = 0.3
"""Of all readings anywhere."""


@dataclass(frozen=True)
class RangeTable:
    """The table, and the free floor.

    origin_in (2,)             the middle of cell [0, 0]
    ranges_in, chances         (rows, columns, DIRECTIONS); chance 0: nothing is heard there
    free (rows, columns)       where the robot's body fits
    """

    origin_in: Floats
    ranges_in: npt.NDArray[np.float32]
    chances: npt.NDArray[np.float32]
    free: npt.NDArray[np.bool_]

    @property
    def places_in(self) -> Floats:
        """The middles of all free cells (k, 2)."""
        rows, columns = np.nonzero(self.free)
        return self.origin_in + CELL_IN * np.stack((columns, rows), axis=-1)

    def density(self, reading_in: float) -> float:
        """How likely a whole-inch reading is that was taken anywhere, BAD_SHARE of them being bad: per inch for a
        range, as a chance for "nothing" (255)."""
        return float(self._densities[min(max(round(reading_in), 0), HIGHEST_IN)])

    @cached_property
    def _densities(self) -> Floats:
        """By whole inches from 0 to 255, smoothed by the size of a cell."""
        weights = self.chances[self.free].ravel()
        counts, _ = np.histogram(self.ranges_in[self.free].ravel(), np.arange(HIGHEST_IN + 2) - 0.5, weights=weights)
        smooth = np.convolve(counts, np.full(5, 0.2), mode="same")
        heard = float(weights.mean()) if len(weights) else 0.0
        densities: Floats = BAD_SHARE / HIGHEST_IN + (1.0 - BAD_SHARE) * heard * smooth / max(float(smooth.sum()), 1e-9)
        densities[HIGHEST_IN] = 1.0 - (1.0 - BAD_SHARE) * heard
        return densities

    def look_up(self, poses: Floats, direction_rad: float) -> tuple[Floats, Floats]:
        """Ranges and chances (n,) of a sonar in that direction from the heading at poses (n, 3); 0 off the floor."""
        column, row = np.rint((poses[:, :2] - self.origin_in) / CELL_IN).astype(np.intp).T
        turn = np.rint((poses[:, 2] + direction_rad) * (DIRECTIONS / (2.0 * np.pi))).astype(np.intp) % DIRECTIONS
        rows, columns = self.free.shape
        here = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        at = np.where(here, row, 0), np.where(here, column, 0), turn
        on_floor = here & self.free[at[0], at[1]]
        ranges: Floats = np.where(on_floor, self.ranges_in[at], 0.0)
        return ranges, np.where(on_floor, self.chances[at], 0.0)


def build_range_table(
    walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar | ConeSonar, clearance_in: float
) -> RangeTable:
    """The atlas of a map of wall segments (m, 4) for this ring, where its axis is `clearance_in` from any wall."""
    segments = wall_map(walls).segments
    low = segments.reshape(-1, 2).min(axis=0) + clearance_in
    high = segments.reshape(-1, 2).max(axis=0) - clearance_in
    columns, rows = np.maximum(np.floor((high - low) / CELL_IN).astype(int) + 1, 1)
    centred = low + 0.5 * (high - low - CELL_IN * np.array([columns - 1, rows - 1]))
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * CELL_IN + centred
    _, far = nearest_points(grid, segments)
    free = far.min(axis=-1) >= clearance_in
    ranges = np.zeros((rows, columns, DIRECTIONS), dtype=np.float32)
    chances = np.zeros_like(ranges)
    turns: Floats = np.arange(DIRECTIONS, dtype=np.float64) * (2.0 * np.pi / DIRECTIONS)
    places = grid[free]
    size = max(1, _BLOCK // DIRECTIONS)
    heard = [
        _heard(_poses(places[first : first + size], turns), segments, body, sonar)
        for first in range(0, len(places), size)
    ]
    if heard:
        ranges[free], chances[free] = (np.concatenate(column) for column in zip(*heard, strict=True))
    return RangeTable(centred, ranges, chances, free)


def _poses(places: Floats, turns: Floats) -> Floats:
    poses = np.empty((len(places), len(turns), 3))
    poses[..., :2] = places[:, None, :]
    poses[..., 2] = turns
    return poses


def _heard(poses: Floats, walls: Floats, body: SonarRing, sonar: RaySonar | ConeSonar) -> tuple[Floats, Floats]:
    """Ranges and chances (...) of the likeliest return of a sonar that looks along poses (..., 3)."""
    if isinstance(sonar, ConeSonar):
        return _likeliest(poses, reflectors(walls), body, sonar)
    directions = np.stack((np.cos(poses[..., 2]), np.sin(poses[..., 2])), axis=-1)
    from_axis, _ = cast_rays(poses[..., :2], directions, walls)
    seen = np.isfinite(from_axis)
    return np.where(seen, from_axis - body.sonar_ring_radius_in, 0.0), seen.astype(np.float64)


def _likeliest(poses: Floats, around: Reflectors, body: SonarRing, sonar: ConeSonar) -> tuple[Floats, Floats]:
    std = np.full(poses.shape[:-1], HEADING_STD_RAD)
    returns = cone_returns(poses, std, SonarMount(0.0, body.sonar_ring_radius_in), around, sonar)
    best = returns.probability.argmax(axis=-1)[..., None]
    ranges = np.take_along_axis(returns.ranges_in, best, axis=-1)[..., 0]
    return ranges, np.take_along_axis(returns.probability, best, axis=-1)[..., 0]
