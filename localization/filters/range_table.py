"""A table of expected echoes from anywhere on the map, for localizing a robot whose pose is unknown.

    ranges_in, probabilities    [row, column, direction]: the most probable echo of a sonar that looks in that
                                direction, the robot on a grid over the free floor

With it the likelihood of a ring of echoes at a hundred thousand poses is a matter of look-ups. Ranges are those from
the middle of a cell; the caller widens the variance by the size of a cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats
from localization.filters.reflectors import Reflectors, reflectors
from localization.filters.sonar_cone import ConeSonar, SonarMount, expected_echoes
from localization.filters.sonar_ray import RaySonar, SonarRing, ranges_from, wall_map
from worlds.geometry import nearest_points

CELL_IN: Final = 3.0
"""Side of a cell of the grid."""
DIRECTIONS: Final = 120
"""Directions of 3 degrees: the 22.5 degrees between two sonars are 7.5, so a heading falls anywhere in a cell."""
OUTLIER_PROBABILITY: Final = 0.3
"""Of readings anywhere: more than for a filter that knows its pose, as people may stand around."""
MAX_READING_IN: Final = 255
HEADING_STD_RAD: Final = 2.0 * np.pi / DIRECTIONS / np.sqrt(12.0)
"""Standard deviation of a direction within its cell."""
_BLOCK: Final = 20_000
"""Poses per block: about 100 MB."""
_SMOOTHING: Final = np.full(5, 0.2)
"""Smooths the histogram of ranges by the size of a cell."""


@dataclass(frozen=True)
class RangeTable:
    """The table, and the free floor.

    Attributes
    ----------
    origin_in
        (2,) the middle of cell [0, 0].
    ranges_in, probabilities
        (rows, columns, DIRECTIONS); probability 0: no echo.
    free
        (rows, columns): True where the robot fits.
    """

    origin_in: Floats
    ranges_in: npt.NDArray[np.float32]
    probabilities: npt.NDArray[np.float32]
    free: npt.NDArray[np.bool_]

    @property
    def places_in(self) -> Floats:
        """The middles of all free cells (k, 2)."""
        rows, columns = np.nonzero(self.free)
        return self.origin_in + CELL_IN * np.stack((columns, rows), axis=-1)

    def density(self, reading_in: float) -> float:
        """Return the probability of a whole-inch reading from an unknown pose: per inch, or of "nothing" (255)."""
        return float(self._densities[min(max(round(reading_in), 0), MAX_READING_IN)])

    @cached_property
    def _densities(self) -> Floats:
        """Densities for whole inches from 0 to 255."""
        # 1. The histogram of expected ranges over the free floor.
        weights = self.probabilities[self.free].ravel()
        edges = np.arange(MAX_READING_IN + 2) - 0.5
        counts, _ = np.histogram(self.ranges_in[self.free].ravel(), edges, weights=weights)
        smooth = np.convolve(counts, _SMOOTHING, mode="same")
        # 2. Outliers anywhere, and "nothing" where no echo is expected.
        detected = float(weights.mean()) if len(weights) else 0.0
        inlier = 1.0 - OUTLIER_PROBABILITY
        densities: Floats = OUTLIER_PROBABILITY / MAX_READING_IN + inlier * detected * smooth / max(
            float(smooth.sum()), 1e-9
        )
        densities[MAX_READING_IN] = 1.0 - inlier * detected
        return densities

    def look_up(self, poses: Floats, direction_rad: float) -> tuple[Floats, Floats]:
        """Return ranges and probabilities (n,) of a sonar at an angle from the heading of poses (n, 3); 0 off floor."""
        column, row = np.rint((poses[:, :2] - self.origin_in) / CELL_IN).astype(np.intp).T
        turn = np.rint((poses[:, 2] + direction_rad) * (DIRECTIONS / (2.0 * np.pi))).astype(np.intp) % DIRECTIONS
        rows, columns = self.free.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        at = np.where(inside, row, 0), np.where(inside, column, 0), turn
        on_floor = inside & self.free[at[0], at[1]]
        ranges: Floats = np.where(on_floor, self.ranges_in[at], 0.0)
        return ranges, np.where(on_floor, self.probabilities[at], 0.0)


def build_range_table(
    walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar | ConeSonar, clearance_in: float
) -> RangeTable:
    """Return the table of a map of wall segments (m, 4) for this ring, its axis `clearance_in` from any wall."""
    # 1. The grid, and its free cells.
    segments = wall_map(walls).segments
    low = segments.reshape(-1, 2).min(axis=0) + clearance_in
    high = segments.reshape(-1, 2).max(axis=0) - clearance_in
    columns, rows = np.maximum(np.floor((high - low) / CELL_IN).astype(int) + 1, 1)
    origin = low + 0.5 * (high - low - CELL_IN * np.array([columns - 1, rows - 1]))
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) * CELL_IN + origin
    _, distances = nearest_points(grid, segments)
    free = distances.min(axis=-1) >= clearance_in
    # 2. The most probable echo in every direction, block by block.
    ranges = np.zeros((rows, columns, DIRECTIONS), dtype=np.float32)
    probabilities = np.zeros_like(ranges)
    directions: Floats = np.arange(DIRECTIONS, dtype=np.float64) * (2.0 * np.pi / DIRECTIONS)
    places = grid[free]
    size = max(1, _BLOCK // DIRECTIONS)
    blocks = [
        _expected(_poses(places[first : first + size], directions), segments, body, sonar)
        for first in range(0, len(places), size)
    ]
    if blocks:
        ranges[free], probabilities[free] = (np.concatenate(column) for column in zip(*blocks, strict=True))
    return RangeTable(origin, ranges, probabilities, free)


def _poses(places: Floats, directions: Floats) -> Floats:
    poses = np.empty((len(places), len(directions), 3))
    poses[..., :2] = places[:, None, :]
    poses[..., 2] = directions
    return poses


def _expected(poses: Floats, walls: Floats, body: SonarRing, sonar: RaySonar | ConeSonar) -> tuple[Floats, Floats]:
    """Return ranges and probabilities (...) of the most probable echo of a sonar that looks along poses (..., 3)."""
    if isinstance(sonar, ConeSonar):
        return _most_probable(poses, reflectors(walls), body, sonar)
    range_in = ranges_from(poses, np.zeros(1), body, wall_map(walls)).range_in[..., 0]
    has_wall = np.isfinite(range_in)
    return np.where(has_wall, range_in, 0.0), has_wall.astype(np.float64)


def _most_probable(poses: Floats, around: Reflectors, body: SonarRing, sonar: ConeSonar) -> tuple[Floats, Floats]:
    std = np.full(poses.shape[:-1], HEADING_STD_RAD)
    echoes = expected_echoes(poses, std, SonarMount(0.0, body.sonar_ring_radius_in), around, sonar)
    best = echoes.probability.argmax(axis=-1)[..., None]
    ranges = np.take_along_axis(echoes.ranges_in, best, axis=-1)[..., 0]
    return ranges, np.take_along_axis(echoes.probability, best, axis=-1)[..., 0]
