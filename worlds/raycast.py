"""The ray caster: the one numeric kernel that sonars, infrareds, the filter and the page all look through.

Arrays in, arrays out; no robot, no noise, no sensor limits here. Each corner of a wall is seen in the ray's frame:

    ahead   how far along the ray it lies                           direction . (corner - origin)
    side    how far it lies to the left of the ray's line           direction x (corner - origin)

A wall is met where its two corners lie on different sides; the range is the mean of their two `ahead`s, each
weighted with the other's side: a convex mean, out of which nothing cancels. A corner that two walls share is on one
side for both (or, within ON_LINE_IN, on the line for one of them), so no ray slips between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Final

import numpy as np
import numpy.typing as npt

from worlds.geometry import FloatArray
from worlds.ray import ON_LINE_IN, ON_WALL_IN, WORTH_A_LOOK, meeting_before

IndexArray = npt.NDArray[np.intp]

NO_WALL: Final = -1
"""What stands in `walls_hit` where a ray meets nothing."""

_BEHIND: Final = -2.0 * ON_WALL_IN
"""A corner this far behind is clearly behind, however its product was rounded."""

_NEVER_ZERO: Final = 1e-200
"""Added to a difference of sides: changes none but 0, which it keeps from being divided by."""

_FEW_RAYS: Final = 4
"""So many rays are worked out sooner without sorting out what lies behind them in arrays."""

_BLOCK: Final = 7000
"""Pairs of ray and wall worked on at a time: so no array reaches the 128 kB from which on the C library takes fresh
pages from the system for each, which took half as long again."""


def cast_rays(origins: npt.ArrayLike, directions: npt.ArrayLike, walls: npt.ArrayLike) -> tuple[FloatArray, IndexArray]:
    """The range from each origin along its direction to the first wall, and which wall that is.

    origins     (..., 2) inches, and directions (..., 2) unit vectors; their leading dimensions broadcast
    walls       (m, 4) segments, rows x1 y1 x2 y2 in inches; m may be 0
    returns     ranges (...) >= 0 in inches, inf where nothing is met; walls_hit (...) rows of `walls`, -1 there

    Walls are closed: a ray through a corner meets it. A ray that starts on a wall meets it at range 0, wherever it
    points (but for one that leaves a slanted wall at less than 1e-5 rad without lying in it: rounding decides).
    A wall seen end-on is met at its nearer end. Where walls are met at one range (a shared corner) any one of them
    is named. All numbers are finite and coordinates at most 1e5 in; this is not checked.
    """
    starts = np.asarray(origins, dtype=np.float64)
    ways = np.asarray(directions, dtype=np.float64)
    segments = np.ascontiguousarray(walls, dtype=np.float64)
    if starts.ndim == ways.ndim == 1 and len(segments):
        (x, y), (dx, dy) = starts.tolist(), ways.tolist()
        nearest, row = cast_ray(x, y, dx, dy, segments)
        return np.array(nearest), np.array(row, dtype=np.intp)
    shape = np.broadcast_shapes(starts.shape, ways.shape)
    ranges, rows = _cast_many(
        np.broadcast_to(starts, shape).reshape(-1, 2), np.broadcast_to(ways, shape).reshape(-1, 2), segments
    )
    return ranges.reshape(shape[:-1]), rows.reshape(shape[:-1])


def cast_discs(origins: npt.ArrayLike, directions: npt.ArrayLike, discs: npt.ArrayLike) -> FloatArray:
    """The range from each origin along its direction to the first disc: where its rim is met.

    origins     (..., 2) inches, and directions (..., 2) unit vectors; their leading dimensions broadcast
    discs       (k, 3), rows x y radius in inches; k may be 0
    returns     ranges (...) >= 0 in inches, inf where nothing is met; 0 from inside a disc

    With the centre `ahead` along the ray and `side` to its left the rim is met at ahead - sqrt(radius^2 - side^2).
    """
    starts = np.asarray(origins, dtype=np.float64)[..., None, :]
    ways = np.asarray(directions, dtype=np.float64)[..., None, :]
    circles = np.asarray(discs, dtype=np.float64).reshape(-1, 3)
    to_x, to_y = circles[:, 0] - starts[..., 0], circles[:, 1] - starts[..., 1]
    ahead = to_x * ways[..., 0] + to_y * ways[..., 1]
    side = ways[..., 0] * to_y - ways[..., 1] * to_x
    half_chord = np.sqrt(np.maximum(circles[:, 2] ** 2 - side * side, 0.0))
    missed = (np.abs(side) > circles[:, 2]) | (ahead + half_chord < 0.0)
    ranges: FloatArray = np.where(missed, inf, np.maximum(ahead - half_chord, 0.0)).min(axis=-1, initial=inf)
    return ranges


def cast_ray(x: float, y: float, dx: float, dy: float, walls: FloatArray) -> tuple[float, int]:
    """`cast_rays` of a single ray from (x, y) along (dx, dy), in numbers: the quickest way for one.

    walls       (m, 4) as there, contiguous
    returns     the range, and the row of the wall that is met

    Arrays only say which walls are worth a look. There a corner is the complex number x + iy; times the conjugate of
    the direction it is ahead + i side. Some processors round such products once, others twice, so ranges are worked
    out in plain numbers.
    """
    sides = ((walls.view(np.complex128) - complex(x, y)) * complex(dx, -dy)).imag
    rows = (sides[:, 0] * sides[:, 1] <= WORTH_A_LOOK).nonzero()[0]
    nearest, hit = inf, NO_WALL
    for row, wall in zip(rows.tolist(), walls.take(rows, axis=0).tolist(), strict=True):
        met = meeting_before(nearest, x, y, dx, dy, *wall)
        if met < nearest:
            nearest, hit = met, row
    return max(nearest, 0.0), hit


def cast_each(origins: Sequence[complex], ways: Sequence[complex], walls: FloatArray) -> list[float]:
    """The ranges of `cast_ray` for n rays, one by one or all at once: to the same bit, however many there are.

    origins, ways   x + iy, and unit vectors dx + i dy
    walls           (m, 4) as there, contiguous

    What is worth a look is looked at in plain numbers, in the order of the walls.
    """
    if len(origins) == 1:
        (origin,), (way,) = origins, ways
        return [cast_ray(origin.real, origin.imag, way.real, way.imag, walls)[0]]
    corners = walls.view(np.complex128).reshape(1, -1)
    seen = (corners - np.array(origins)[:, np.newaxis]) * np.array(ways).conj()[:, np.newaxis]
    frames = seen.view(np.float64).reshape(len(origins) * len(walls), 4)
    rows = (frames[:, 1] * frames[:, 3] <= WORTH_A_LOOK).nonzero()[0]
    if len(origins) > _FEW_RAYS:
        rows = rows[(frames[rows, 0] >= _BEHIND) | (frames[rows, 2] >= _BEHIND)]
    ranges = [inf] * len(origins)
    rays, which = np.divmod(rows, max(len(walls), 1))
    for ray, wall in zip(rays.tolist(), walls[which].tolist(), strict=True):
        origin, way = origins[ray], ways[ray]
        ranges[ray] = meeting_before(ranges[ray], origin.real, origin.imag, way.real, way.imag, *wall)
    return [max(nearest, 0.0) for nearest in ranges]


def _cast_many(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Ranges and rows (n,) for n rays (n, 2), a block of rays at a time."""
    count = len(origins)
    ranges = np.full(count, inf)
    rows = np.full(count, NO_WALL, dtype=np.intp)
    if not len(walls):
        return ranges, rows
    step = max(1, _BLOCK // len(walls))
    for first in range(0, count, step):
        block = slice(first, first + step)
        ranges[block], rows[block] = _first(_meetings(origins[block], directions[block], walls))
    return ranges, rows


def _meetings(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> FloatArray:
    """`meeting` of n rays (n, 2) with m walls (m, 4): (m, n), inf where they do not meet or meet behind."""
    (side_1, side_2), (ahead_1, ahead_2) = sides, _ = _in_ray_frames(origins, directions, walls)
    met: FloatArray = ahead_1 * side_2
    met -= ahead_2 * side_1
    width = side_2 - side_1
    width += _NEVER_ZERO
    met /= width
    missed = side_1 * side_2 > 0.0
    on_line = np.abs(sides) <= ON_LINE_IN
    if on_line.any():
        missed &= ~on_line.any(axis=0)
        nearer, farther = np.minimum(ahead_1, ahead_2), np.maximum(ahead_1, ahead_2)
        end_on = np.where(farther < 0.0, farther, np.maximum(nearer, 0.0))
        met = np.where(on_line.all(axis=0), end_on, np.clip(met, nearer, farther))
    missed |= met < -ON_WALL_IN
    np.copyto(met, inf, where=missed)
    return met


def _in_ray_frames(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sides (2, m, n) and aheads (2, m, n) of the first and the second corners.

    One product each: rows (x, y, 1) of the corners times columns of the rays.
    """
    x, y = origins.T
    dx, dy = directions.T
    corners = np.ones((2, len(walls), 3))
    corners[0, :, :2] = walls[:, :2]
    corners[1, :, :2] = walls[:, 2:]
    sides: FloatArray = corners @ np.stack((-dy, dx, x * dy - y * dx))
    aheads: FloatArray = corners @ np.stack((dx, dy, -(x * dx + y * dy)))
    return sides, aheads


def _first(met: FloatArray) -> tuple[FloatArray, IndexArray]:
    """The smallest of the ranges (m, n) of each ray (n,), not below 0, and its row (n,)."""
    nearest: FloatArray = met.min(axis=0)
    rows = np.arange(len(met), dtype=np.int32)[:, np.newaxis]
    hits = np.where(met == nearest, rows, np.int32(len(met))).min(axis=0).astype(np.intp)
    hits[nearest == inf] = NO_WALL
    return np.maximum(nearest, 0.0), hits
