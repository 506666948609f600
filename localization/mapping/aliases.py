"""Places of a map that look alike to a ring of sonars, over a neighbourhood: aliases.

    scan           ranges in all directions from a place
    candidates     places whose scans have nearly the same Fourier magnitudes, which no rotation changes
    fit            the motion that takes the one place to the other: rotation by correlation, then Gauss-Newton
    aliases        motions that also take the surroundings, what can be seen from them, to what looks the same

A robot that starts at a place with an alias has to leave the neighbourhood before any reading tells the two apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, Floats, add, difference, wrap_angle
from localization.filters.range_table import connected, floor_grid
from worlds.geometry import nearest_points
from worlds.raycast_arrays import cast_rays

RAYS: Final = 72
"""Rays of a scan: 5 degrees apart."""
STEP_IN: Final = 18.0
"""Grid of the places that are compared; the fit bridges half of its diagonal."""
HALF_DIAGONAL: Final = 0.75
"""Farthest that a place is from the next one of the grid, in steps: half of the diagonal, and a little more."""
FLOOR_CELL_IN: Final = 6.0
"""Grid on which the floor is found."""
MAX_GRID: Final = 4000
"""Places that are compared; the grid is coarser on a larger floor."""
MAX_RANGE_IN: Final = 200.0
"""Farther walls are not compared: a sonar of 255 in sees few of them."""
MIN_INCIDENCE_COS: Final = 0.5
"""Rays that meet a wall at more than 60 degrees from its normal are not compared: no sonar sees it there."""
COMPARED: Final = 400
"""Places with the most similar magnitudes, whose scans are compared."""
CANDIDATES: Final = 60
"""Of these, places with the most similar scans, which are fitted: three for each of twenty equal doors."""
FIT_STEPS: Final = 4
COARSE_MATCH: Final = 0.6
"""Fraction of the rays that must agree to a grid step before the fit."""
MIN_MATCH, MIN_NEIGHBORHOOD_MATCH = 0.95, 0.97
"""Fractions of the rays that must agree after it, at the place and over its neighbourhood."""
TOLERANCE_IN, TOLERANCE = 4.0, 0.03
"""Agreement of two ranges: inches, and a fraction of them."""
NEIGHBORHOOD_IN: Final = 200.0
"""Radius of the neighbourhood that must look alike: what a lost robot explores within a minute."""
NEIGHBORS: Final = 24
MAX_SAMPLES: Final = 120
"""Places of a map that are examined."""
SAME_IN, SAME_RAD = 24.0, 0.5
"""A motion by less is none: the place itself."""
_ANGLES: Final[Floats] = np.arange(RAYS, dtype=np.float64) * (2.0 * np.pi / RAYS)
_ROTATIONS: Final = (np.arange(RAYS)[:, None] + np.arange(RAYS)) % RAYS
"""Row k has the rays in the order of a scan that is rotated by k rays."""
_BLOCK_IN: Final = 120.0
"""Places of a block of this size share their walls."""


@dataclass(frozen=True)
class Alias:
    """Poses (3,) that look like `pose` (3,), from which robots see the same: inches and radians."""

    pose: Floats
    alike: tuple[Floats, ...]


class AliasFinder:
    """Find aliases on the floor of a map.

    Parameters
    ----------
    walls
        (m, 4) segments.
    radius_in
        Of the robot.
    near
        Points (n, 2) of the floor that matters: what is connected to them. Default: all of the floor.
    """

    def __init__(self, walls: npt.ArrayLike, radius_in: float, near: npt.ArrayLike = ()) -> None:
        self._walls = np.asarray(walls, dtype=np.float64).reshape(-1, 4)
        origin, free = floor_grid(self._walls, radius_in, FLOOR_CELL_IN)
        seeds = np.rint((np.asarray(near, dtype=np.float64).reshape(-1, 2) - origin) / FLOOR_CELL_IN).astype(int)
        if len(seeds):
            free = connected(free, [(row, column) for column, row in seeds.tolist()])
        rows, columns = np.nonzero(free)
        floor = origin + FLOOR_CELL_IN * np.stack((columns, rows), axis=-1)
        # One place in each square; the squares are larger on a large floor.
        self._side_in = max(STEP_IN, FLOOR_CELL_IN * float(np.sqrt(len(floor) / MAX_GRID)))
        _, chosen = np.unique(np.floor(floor / self._side_in).astype(int), axis=0, return_index=True)
        self._floor: Floats = floor[np.sort(chosen)]

    def aliases(self, pose: Sequence[float] | Floats) -> list[Floats]:
        """Return the poses (3,) at which a robot sees what it sees at `pose` (3,), there and in its neighbourhood."""
        here = np.array(pose, dtype=np.float64)
        if not len(self._floor):
            return []
        # In the map's direction: the fitted poses are rotations then.
        place = np.array([here[0], here[1], 0.0])
        scan, seen = self._scan(place[None])
        found: list[Floats] = []
        candidates = self._candidates(scan[0], seen[0])
        for fitted in self._fitted(scan[0], seen[0], np.array(candidates)) if candidates else ():
            if self._is_near(fitted, place):
                continue
            moved = add(fitted, np.array([0.0, 0.0, here[HEADING]]))
            if any(self._is_near(moved, other) for other in found):
                continue
            if self._neighborhood_match(place, fitted) >= MIN_NEIGHBORHOOD_MATCH:
                found.append(moved)
        return found

    def samples(self, count: int = MAX_SAMPLES) -> Floats:
        """Return places (n, 2) spread over the floor."""
        chosen = np.linspace(0, len(self._floor) - 1, min(count, len(self._floor))).astype(int)
        places: Floats = self._floor[chosen]
        return places

    @cached_property
    def _signatures(self) -> tuple[Floats, npt.NDArray[np.bool_], Floats]:
        """Scans (n, RAYS) of the floor, which of their rays count, and the magnitudes of their Fourier coefficients."""
        scans, seen = self._scan(np.column_stack((self._floor, np.zeros(len(self._floor)))))
        return scans, seen, _magnitudes(scans)

    def _scan(self, poses: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Return ranges (n, RAYS) at poses (n, 3), in directions of the map, and which rays a sonar sees."""
        ranges, normals = self._cast(poses, _ANGLES)
        return ranges, _visible(ranges, normals, _ANGLES)

    def _cast(self, poses: Floats, angles: Floats) -> tuple[Floats, Floats]:
        """Return ranges (n, k) at poses (n, 3) along angles (k,) from their headings, and the walls' directions."""
        ranges = np.full((len(poses), len(angles)), MAX_RANGE_IN)
        along = np.zeros_like(ranges)
        wall_angles = np.arctan2(self._walls[:, 3] - self._walls[:, 1], self._walls[:, 2] - self._walls[:, 0])
        blocks = np.floor(poses[:, :2] / _BLOCK_IN).astype(int)
        for block in np.unique(blocks, axis=0):
            at = np.nonzero((blocks == block).all(axis=1))[0]
            middle = (block + 0.5) * _BLOCK_IN
            near = nearest_points(middle, self._walls)[1] <= MAX_RANGE_IN + _BLOCK_IN
            if not near.any():
                continue
            heading = poses[at, HEADING, None] + angles
            directions = np.stack((np.cos(heading), np.sin(heading)), axis=-1)
            range_in, rows = cast_rays(poses[at, None, :2], directions, self._walls[near])
            met = range_in <= MAX_RANGE_IN
            ranges[at] = np.where(met, range_in, MAX_RANGE_IN)
            along[at] = np.where(met, wall_angles[near][np.maximum(rows, 0)] - poses[at, HEADING, None], np.nan)
        return ranges, along

    def _candidates(self, scan: Floats, seen: npt.NDArray[np.bool_]) -> list[Floats]:
        """Return poses (3,) on the grid, headings being rotations, whose scans are similar."""
        scans, _, magnitudes = self._signatures
        apart = np.abs(magnitudes - _magnitudes(scan[None])).sum(axis=1)
        found: list[tuple[float, Floats]] = []
        for number in np.argsort(apart)[:COMPARED]:
            # The rotation by which the scan there fits best.
            shifts = scans[number][_ROTATIONS]
            agree = (np.abs(shifts - scan) <= HALF_DIAGONAL * self._side_in) & seen
            shift = int(agree.sum(axis=1).argmax())
            if agree[shift].sum() >= COARSE_MATCH * seen.sum():
                # Closer agreement first: the fit begins near its solution.
                off = np.where(seen, np.minimum(np.abs(shifts[shift] - scan), self._side_in), 0.0).sum()
                found.append((float(off), np.array([*self._floor[number], wrap_angle(float(_ANGLES[shift]))])))
        return [pose for _, pose in sorted(found, key=lambda pair: pair[0])[:CANDIDATES]]

    def _fitted(self, scan: Floats, seen: npt.NDArray[np.bool_], poses: Floats) -> Floats:
        """Return those poses near `poses` (n, 3) that have the scan."""
        for _ in range(FIT_STEPS):
            ranges, walls = self._cast(poses, _ANGLES)
            use = seen & _visible(ranges, walls, _ANGLES) & np.isfinite(walls)
            use &= np.abs(ranges - scan) <= 2.0 * HALF_DIAGONAL * self._side_in
            # 1. Moving by d along the ray's frame changes a range by -d.n / (u.n), turning by r tan(incidence).
            normal = np.where(use, walls, 0.0) + 0.5 * np.pi
            incidence = np.where(use, np.cos(_ANGLES - normal), 1.0)
            slopes = np.stack((-np.cos(normal), -np.sin(normal), ranges * np.sin(_ANGLES - normal)), axis=-1)
            slopes /= incidence[..., None]
            innovation = scan - ranges
            # 2. Robust least squares: a weight of 1 below the tolerance. A small prior holds the direction that
            #    corridors leave open.
            weight = np.where(use, 1.0 / np.maximum(np.abs(innovation) / TOLERANCE_IN, 1.0), 0.0)
            information = np.einsum("nki,nk,nkj->nij", slopes, weight, slopes) + np.diag([0.01, 0.01, 25.0])
            gradient = np.einsum("nki,nk->ni", slopes, weight * innovation)
            change = np.linalg.solve(information, gradient[..., None])[..., 0]
            dx, dy = np.clip(change[:, :2], -self._side_in, self._side_in).T
            cos, sin = np.cos(poses[:, HEADING]), np.sin(poses[:, HEADING])
            turn = np.clip(change[:, 2], -SAME_RAD, SAME_RAD)
            poses = add(poses, np.stack((cos * dx - sin * dy, sin * dx + cos * dy, turn), axis=-1))
        ranges, walls = self._cast(poses, _ANGLES)
        fits: Floats = poses[_match(scan, seen, ranges, _visible(ranges, walls, _ANGLES)) >= MIN_MATCH]
        return fits

    def _neighborhood_match(self, here: Floats, there: Floats) -> float:
        """Return the fraction of rays that agree around `here` (3,) and around the pose it is moved to."""
        # 1. Neighbours that can be seen: the straight path to them is free.
        offset = self._floor - here[:2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        ranges, _ = self._scan(here[None])
        direction = np.rint(np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * np.pi) * RAYS).astype(int) % RAYS
        near = np.nonzero((distance <= NEIGHBORHOOD_IN) & (distance < ranges[0][direction]))[0]
        if not len(near):
            return 1.0
        offset = offset[near[np.linspace(0, len(near) - 1, min(NEIGHBORS, len(near))).astype(int)]]
        # 2. The same from both.
        cos, sin = np.cos(there[HEADING]), np.sin(there[HEADING])
        moved = there[:2] + offset @ np.array([[cos, sin], [-sin, cos]])
        zeros = np.zeros(len(offset))
        one, one_seen = self._scan(np.column_stack((here[:2] + offset, zeros)))
        other, walls = self._cast(np.column_stack((moved, zeros + there[HEADING])), _ANGLES)
        return float(_match(one, one_seen, other, _visible(other, walls, _ANGLES)).mean())

    @staticmethod
    def _is_near(one: Floats, other: Floats) -> bool:
        dx, dy, turn = difference(one, other).tolist()
        return bool(np.hypot(dx, dy) < SAME_IN and abs(turn) < SAME_RAD)


def find_aliases(finder: AliasFinder, poses: Floats) -> list[Alias]:
    """Return the aliases of those of the poses (n, 3) that have any."""
    found = [Alias(pose, tuple(finder.aliases(pose))) for pose in poses]
    return [alias for alias in found if alias.alike]


def _magnitudes(scans: Floats) -> Floats:
    """Return the magnitudes of the low Fourier coefficients of scans (n, RAYS)."""
    magnitudes: Floats = np.abs(np.fft.rfft(scans, axis=-1))[:, : RAYS // 4]
    return magnitudes


def _visible(ranges: Floats, walls: Floats, angles: Floats) -> npt.NDArray[np.bool_]:
    """Return True for rays that meet a wall at no more than 60 degrees from its normal, or nothing."""
    # The sine of the angle to a wall is the cosine of that to its normal.
    incidence_cos = np.abs(np.sin(angles - np.nan_to_num(walls)))
    visible: npt.NDArray[np.bool_] = np.isnan(walls) | (ranges >= MAX_RANGE_IN) | (incidence_cos >= MIN_INCIDENCE_COS)
    return visible


def _match(
    one: Floats, one_seen: npt.NDArray[np.bool_], other: Floats, other_seen: npt.NDArray[np.bool_]
) -> Floats:
    """Return the fraction (...) of the rays seen in both scans (..., RAYS) that have the same range."""
    # A ray that slants in the one and not in the other passes beside an edge: it counts where both see.
    both = one_seen & other_seen
    agree = np.abs(one - other) <= TOLERANCE_IN + TOLERANCE * np.minimum(one, other)
    fraction: Floats = (agree & both).sum(axis=-1) / np.maximum(both.sum(axis=-1), 1)
    return fraction
