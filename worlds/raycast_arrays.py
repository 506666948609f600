"""The ray caster in arrays: many rays at once, for particles, range tables, learned maps and the laser.

The formula is that of raycast.py, whose `mean_ahead` and `intersect` these functions call. The 482 rays of a laser
among 33 walls take 0.4 ms in arrays, 8 ms one by one (docs/decisions/023-numba.md).

    cast_rays     any rays, walls (m, 4)
    cast_each     the rays of a ring of sonars, to the bits of `raycast.cast_ray`
    cast_fan      rays from one point, increasing in direction: a laser among thousands of walls
    cast_discs    any rays, discs (k, 3)
"""

from collections.abc import Sequence
from math import inf
from typing import Final

import numpy as np
import numpy.typing as npt

from worlds.geometry import MAX_LOOP_WALLS, FloatArray, IndexArray, expand, near_walls, nearest_points
from worlds.raycast import NO_WALL, ON_LINE_IN, ON_WALL_IN, SAME_SIDE_IN2, cast_ray, intersect, mean_ahead, nearest_wall

_BLOCK: Final = 7000
"""Pairs of ray and wall per block: keeps every array below 128 kB, from which on the C library requests new pages from
the system for each, which took half as long again."""

MAX_SINGLE_RAYS: Final = 2
"""Up to so many rays, selecting the walls for each ray in turn is faster than for all rays at once."""

FAN_MARGIN_RAD: Final = 1e-9
"""A wall's end this far from a ray's direction counts as on it when rays are selected: far more than rounding."""


def cast_rays(origins: npt.ArrayLike, directions: npt.ArrayLike, walls: npt.ArrayLike) -> tuple[FloatArray, IndexArray]:
    """Return the range from each origin along its direction to the nearest wall, and the row of that wall.

    Walls are closed: a ray through an end meets it. A ray that starts on a wall meets it at range 0, in any direction
    (except one that leaves a slanted wall at less than 1e-5 rad without lying in it: rounding decides). A wall seen
    end-on is met at its nearer end. Where several walls are met at one range (a shared end) any one of them is named.

    Parameters
    ----------
    origins, directions
        (..., 2) inches, and (..., 2) unit vectors; their leading dimensions broadcast. All numbers must be finite and
        coordinates at most 1e5 in; this is not checked.
    walls
        (m, 4) segments, rows x1 y1 x2 y2 in inches; m may be 0.

    Returns
    -------
    tuple of arrays
        Ranges (...) >= 0 in inches, inf where nothing is met; rows (...) of `walls`, NO_WALL there.
    """
    starts = np.asarray(origins, dtype=np.float64)
    along = np.asarray(directions, dtype=np.float64)
    segments = np.ascontiguousarray(walls, dtype=np.float64)
    if starts.ndim == along.ndim == 1 and len(segments):
        (x, y), (dx, dy) = starts.tolist(), along.tolist()
        nearest, row = cast_ray(x, y, dx, dy, segments)
        return np.array(nearest), np.array(row, dtype=np.intp)
    shape = np.broadcast_shapes(starts.shape, along.shape)
    ranges, rows = _cast_many(np.broadcast_to(starts, shape).reshape(-1, 2),
                              np.broadcast_to(along, shape).reshape(-1, 2), segments)
    return ranges.reshape(shape[:-1]), rows.reshape(shape[:-1])


def _cast_many(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Return ranges and rows (n,) for n rays (n, 2), a block of rays at a time."""
    count = len(origins)
    ranges = np.full(count, inf)
    rows = np.full(count, NO_WALL, dtype=np.intp)
    if not len(walls):
        return ranges, rows
    step = max(1, _BLOCK // len(walls))
    for first in range(0, count, step):
        block = slice(first, first + step)
        ranges[block], rows[block] = _nearest(_meet(*_in_ray_frames(origins[block], directions[block], walls)))
    return ranges, rows


def _in_ray_frames(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sides (2, m, n) and aheads (2, m, n) of the first and the second ends.

    One product each: rows (x, y, 1) of the ends times columns of the rays.
    """
    x, y = origins.T
    dx, dy = directions.T
    ends = np.ones((2, len(walls), 3))
    ends[0, :, :2] = walls[:, :2]
    ends[1, :, :2] = walls[:, 2:]
    sides: FloatArray = ends @ np.stack((-dy, dx, x * dy - y * dx))
    aheads: FloatArray = ends @ np.stack((dx, dy, -(x * dx + y * dy)))
    return sides, aheads


def _nearest(hits: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Return the smallest of the ranges (m, n) of each ray (n,), not below 0, and its row (n,)."""
    nearest: FloatArray = hits.min(axis=0)
    rows = np.arange(len(hits), dtype=np.int32)[:, np.newaxis]
    hit = np.where(hits == nearest, rows, np.int32(len(hits))).min(axis=0).astype(np.intp)
    hit[nearest == inf] = NO_WALL
    return np.maximum(nearest, 0.0), hit


def _meet(sides: FloatArray, aheads: FloatArray) -> FloatArray:
    """Return `intersect` of sides and aheads (2, ...) of the ends of walls in the frames of rays; inf behind."""
    # 1. Ends on different sides.
    (side_1, side_2), (ahead_1, ahead_2) = sides, aheads
    hits: FloatArray = mean_ahead(ahead_1, side_1, ahead_2, side_2)
    missed = side_1 * side_2 > 0.0
    # 2. Ends on the line of a ray, which are few.
    at = np.nonzero((np.abs(sides) <= ON_LINE_IN).any(axis=0))
    if len(at[0]):
        ends = zip(*(part[at].tolist() for part in (ahead_1, side_1, ahead_2, side_2)), strict=True)
        hits[at] = [intersect(*pair) for pair in ends]
        missed[at] = False
    # 3. Not behind.
    missed |= hits < -ON_WALL_IN
    np.copyto(hits, inf, where=missed)
    return hits


def cast_each(rays: Sequence[tuple[float, float, float, float]], walls: FloatArray) -> list[float]:
    """Return the ranges of `cast_ray` for rays (x, y, dx, dy) and walls (m, 4), contiguous, to the same bit.

    A simulated ring that is read once a second casts its sixteen rays at once: it takes two thirds of the time.
    """
    if len(rays) <= MAX_SINGLE_RAYS or len(walls) <= MAX_LOOP_WALLS:
        return [cast_ray(*ray, walls)[0] for ray in rays]
    # 1. For each ray the walls with ends on both sides, in arrays. 2. The nearest of them, in plain numbers.
    numbers = np.array(rays).view(np.complex128)
    sides = ((walls.view(np.complex128).reshape(1, -1) - numbers[:, :1]) * numbers[:, 1:].conj()).imag
    is_crossed = sides[:, 0::2] * sides[:, 1::2] <= SAME_SIDE_IN2
    return [nearest_wall(*ray, walls.take(row.nonzero()[0], axis=0).tolist())[0]
            for ray, row in zip(rays, is_crossed, strict=True)]


def cast_fan(x: float, y: float, angles_rad: FloatArray, walls: FloatArray, reach_in: float) -> FloatArray:
    """Return `cast_rays` for rays from one point, computing only the pairs of ray and wall that can meet.

    Parameters
    ----------
    angles_rad
        (n,) directions, increasing, over less than half a turn.
    walls
        (m, 4), rows x1 y1 x2 y2 in inches.
    reach_in
        Ranges beyond it count as inf.

    Returns
    -------
    array
        Ranges (n,).
    """
    ranges: FloatArray = np.full(len(angles_rad), inf)
    # 1. Walls within reach, in the frame of the fan's middle; not wholly behind it.
    middle_rad = 0.5 * (angles_rad[0] + angles_rad[-1])
    walls = near_walls(x, y, reach_in, walls)
    ends = (walls.view(np.complex128) - complex(x, y)) * complex(np.cos(middle_rad), -np.sin(middle_rad))
    is_ahead = ends.real.max(axis=1, initial=-inf) >= -ON_WALL_IN
    walls, ends = walls[is_ahead], ends[is_ahead]
    # 2. The interval of directions of each wall. A wall that passes the origin closely has any direction.
    first = np.angle(ends[:, 0])
    turn = np.angle(ends[:, 1] * ends[:, 0].conj())
    low, high = np.minimum(first, first + turn), np.maximum(first, first + turn)
    offsets = nearest_points((x, y), walls)[1]
    is_close = offsets <= 1e3 * ON_WALL_IN
    low[is_close], high[is_close] = -2.0 * np.pi, 2.0 * np.pi
    # 3. The rays in these intervals, which may lie a turn away.
    rays = angles_rad - middle_rad
    turns = (-2.0 * np.pi, 0.0, 2.0 * np.pi)
    begins, stops = (np.column_stack([np.searchsorted(rays, bound + turned + margin) for turned in turns])
                     for bound, margin in ((low, -FAN_MARGIN_RAD), (high, FAN_MARGIN_RAD)))
    begin = np.where(begins < stops, begins, len(rays)).min(axis=1, initial=len(rays))
    stop = np.where(begins < stops, stops, 0).max(axis=1, initial=0)
    # 4. Nearest walls first, a block of pairs at a time: what stands behind them is left out.
    order = np.argsort(offsets, kind="stable")
    order = order[begin[order] < stop[order]]
    directions = np.stack((np.cos(angles_rad), np.sin(angles_rad)), axis=1)
    while len(order):
        counts = stop[order] - begin[order]
        taken = order[: max(1, int(np.searchsorted(np.cumsum(counts), _BLOCK)))]
        wall, ray = expand(begin[taken], stop[taken] - 1)
        hits = _meet(*_pair_frames(x, y, directions[ray], walls[taken[wall]]))
        np.minimum.at(ranges, ray, hits)
        order = order[len(taken):]
        order = order[offsets[order] <= _farthest(ranges, begin[order], stop[order])]
    np.maximum(ranges, 0.0, out=ranges)
    ranges[ranges > reach_in] = inf
    return ranges


def _farthest(ranges: FloatArray, begin: IndexArray, stop: IndexArray) -> FloatArray:
    """Return the largest range from begin to stop of each row; no row is empty."""
    if not len(begin):
        return np.empty(0)
    bounds = np.column_stack((begin, stop)).ravel()
    return np.maximum.reduceat(np.append(ranges, 0.0), bounds)[::2]


def _pair_frames(x: float, y: float, directions: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sides and aheads (2, k) of both ends of k walls, each in the frame of its own ray."""
    dx, dy = directions.T
    to_x, to_y = walls[:, 0::2].T - x, walls[:, 1::2].T - y
    return dx * to_y - dy * to_x, to_x * dx + to_y * dy


def cast_discs(origins: npt.ArrayLike, directions: npt.ArrayLike, discs: npt.ArrayLike) -> FloatArray:
    """Return the range from each origin along its direction to the rim of the nearest disc.

    With the centre `ahead` along the ray and `side` to its left the rim is met at ahead - sqrt(radius^2 - side^2).

    Parameters
    ----------
    origins, directions
        (..., 2) inches, and (..., 2) unit vectors; their leading dimensions broadcast.
    discs
        (k, 3), rows x y radius in inches; k may be 0.

    Returns
    -------
    array
        Ranges (...) >= 0 in inches, inf where nothing is met; 0 from inside a disc.
    """
    starts = np.asarray(origins, dtype=np.float64)[..., None, :]
    along = np.asarray(directions, dtype=np.float64)[..., None, :]
    circles = np.asarray(discs, dtype=np.float64).reshape(-1, 3)
    to_x, to_y = circles[:, 0] - starts[..., 0], circles[:, 1] - starts[..., 1]
    ahead = to_x * along[..., 0] + to_y * along[..., 1]
    side = along[..., 0] * to_y - along[..., 1] * to_x
    half_chord = np.sqrt(np.maximum(circles[:, 2] ** 2 - side * side, 0.0))
    missed = (np.abs(side) > circles[:, 2]) | (ahead + half_chord < 0.0)
    ranges: FloatArray = np.where(missed, inf, np.maximum(ahead - half_chord, 0.0)).min(axis=-1, initial=inf)
    return ranges
