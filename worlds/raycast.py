"""The ray caster: the range along a ray to the nearest wall segment or disc.

Simulated sonars, infrareds and lasers, the filter and the viewer all use it. Each end of a wall is expressed in the
frame of the ray:

    ahead   distance along the ray                      direction . (end - origin)
    side    distance to the left of the ray's line      direction x (end - origin)

A ray meets a wall whose ends lie on different sides of its line. The range is the mean of both `ahead`, each weighted
with the other's `side`: a convex mean, so nothing cancels. Two walls that share an end agree on its side, so no ray
passes between them.

    intersect, nearest_wall, sole_wall, nearest_obstacle    plain numbers; numba compiles these same functions
    cast_ray, cast_each                          the same for many walls or several rays: arrays select, numbers decide
    cast_rays, cast_discs                        arrays, for many rays at once
    cast_fan                                     many rays from one point, among many walls

The formula therefore stands here twice: `intersect` in numbers, `_meet` in arrays. A simulated sonar or a live
filter casts one to three rays at a time; in arrays that takes about ten times as long
(docs/decisions/023-numba.md).
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from math import inf, sqrt
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from worlds.compiled import is_compiled_for
from worlds.geometry import FloatArray, nearest_points

IndexArray = npt.NDArray[np.intp]
WallRows = Iterable[Sequence[float] | FloatArray]
"""Walls as rows x1, y1, x2, y2: lists in plain Python, zipped columns for numba, which cannot unpack a row of an
array."""

NO_WALL: Final = -1
"""The row reported for a ray that meets nothing."""

ON_LINE_IN: Final = 1e-9
"""An end this close to a ray's line counts as on it, inches. Rounding of coordinates up to 1e5 in is about 1e-11 and
the finest unit of a robot is 1e-2, so 1e-9 is far from both: answers are exact for walls moved by no more than this."""

ON_WALL_IN: Final = 1e-9
"""A ray that starts this little behind a wall starts on it, inches; for the same reason."""

SAME_SIDE_IN2: Final = ON_LINE_IN * 4e5
"""Two ends whose sides multiply to more than this lie clearly on one side: no side exceeds 4e5 in."""

FAR_IN: Final = 1e6
"""Farther than any wall."""

_BEHIND: Final = -2.0 * ON_WALL_IN
"""An end this far behind is clearly behind, whatever the rounding of its product."""

_NEVER_ZERO: Final = 1e-200
"""Added to a difference of sides: changes only 0, to avoid the division by it."""

_BLOCK: Final = 7000
"""Pairs of ray and wall per block: keeps every array below 128 kB, from which on the C library requests new pages from
the system for each, which took half as long again."""

MAX_LOOP_WALLS: Final = 20
"""Up to so many walls, a loop in plain Python is faster than the selection in arrays."""

MAX_SINGLE_RAYS: Final = 2
"""Up to so many rays, selecting the walls for each ray in turn is faster than for all rays at once."""

MAX_PAIRED_WALLS: Final = 400
"""With more walls, arrays of all pairs of ray and wall leave the processor's cache."""

FAN_MARGIN_RAD: Final = 1e-9
"""A wall's end this far from a ray's direction counts as on it when rays are selected: far more than rounding."""


# One ray, in plain numbers. numba compiles these functions unchanged, and caches the result for as long as this file
# does not change: whatever they call must stand in this file.


def intersect(ahead_1: float, side_1: float, ahead_2: float, side_2: float) -> float:
    """Return the range at which a ray's line meets a wall, from the ends of the wall in the frame of the ray.

    Returns
    -------
    float
        Inches; negative behind the origin, inf where they do not meet.
    """
    on_line_1, on_line_2 = abs(side_1) <= ON_LINE_IN, abs(side_2) <= ON_LINE_IN
    if not (on_line_1 or on_line_2):
        return inf if side_1 * side_2 > 0.0 else mean_ahead(ahead_1, side_1, ahead_2, side_2)
    nearer, farther = min(ahead_1, ahead_2), max(ahead_1, ahead_2)
    if on_line_1 and on_line_2:  # the wall is seen end-on
        return farther if farther < 0.0 else max(nearer, 0.0)
    return min(max(mean_ahead(ahead_1, side_1, ahead_2, side_2), nearer), farther)


def mean_ahead(ahead_1: float, side_1: float, ahead_2: float, side_2: float) -> float:
    """Return the mean of both `ahead`, each weighted with the other's `side`: where the ray's line meets the wall's."""
    return (ahead_1 * side_2 - ahead_2 * side_1) / (side_2 - side_1 + _NEVER_ZERO)


def nearest_wall(x: float, y: float, dx: float, dy: float, walls: WallRows) -> tuple[float, int]:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest wall, and its row.

    Parameters
    ----------
    walls
        Rows x1, y1, x2, y2 of m walls, inches.

    Returns
    -------
    tuple of float and int
        Range >= 0 in inches and row; inf and NO_WALL where nothing is met.
    """
    nearest, hit = inf, NO_WALL
    for row, (x1, y1, x2, y2) in enumerate(walls):
        # 1. Both ends clearly on one side of the ray: the usual case, decided with the fewest operations.
        to_x_1, to_y_1, to_x_2, to_y_2 = x1 - x, y1 - y, x2 - x, y2 - y
        side_1, side_2 = dx * to_y_1 - dy * to_x_1, dx * to_y_2 - dy * to_x_2
        if side_1 * side_2 > SAME_SIDE_IN2:
            continue
        # 2. Wholly behind, or beyond the nearest so far.
        ahead_1, ahead_2 = to_x_1 * dx + to_y_1 * dy, to_x_2 * dx + to_y_2 * dy
        if (ahead_1 < -ON_WALL_IN and ahead_2 < -ON_WALL_IN) or (ahead_1 >= nearest and ahead_2 >= nearest):
            continue
        # 3. The intersection.
        range_in = intersect(ahead_1, side_1, ahead_2, side_2)
        if -ON_WALL_IN <= range_in < nearest:
            nearest, hit = range_in, row
    return max(nearest, 0.0), hit


def sole_wall(x: float, y: float, dx: float, dy: float, walls: WallRows, margin_in: float) -> int:
    """Return the row of the only wall that this ray and all rays near it can meet; NO_WALL if that is uncertain.

    A ray is near if it moves no end of a wall by more than the margin in the frame of the ray, and its origin by no
    more than that. This is a test of one loop, and sufficient only: where it fails, cast the rays.
    """
    sole, row = NO_WALL, -1
    origin_side, origin_ahead = dx * y - dy * x, x * dx + y * dy
    for x1, y1, x2, y2 in walls:
        row += 1
        # 1. Both ends clearly on one side, or clearly behind: no near ray meets the wall.
        side_1, side_2 = dx * y1 - dy * x1 - origin_side, dx * y2 - dy * x2 - origin_side
        if (side_1 > margin_in and side_2 > margin_in) or (side_1 < -margin_in and side_2 < -margin_in):
            continue
        ahead_1, ahead_2 = x1 * dx + y1 * dy - origin_ahead, x2 * dx + y2 * dy - origin_ahead
        if ahead_1 < -margin_in and ahead_2 < -margin_in:
            continue
        # 2. The ends clearly on different sides, the origin clearly on one side of the wall: all near rays meet it
        #    ahead, or none does. The weighted mean of `intersect`: the cross product is the distance to the wall times
        #    its length.
        cross = ahead_1 * side_2 - ahead_2 * side_1
        if (
            abs(side_1) <= margin_in
            or abs(side_2) <= margin_in
            or abs(cross) <= margin_in * (abs(x2 - x1) + abs(y2 - y1))
        ):
            return NO_WALL
        if (cross > 0.0) == (side_2 > side_1):
            if sole != NO_WALL:
                return NO_WALL
            sole = row
    return sole


def ray_to_disc(x: float, y: float, dx: float, dy: float, disc: Sequence[float] | FloatArray) -> float:
    """Return `cast_discs` of a single ray and one disc (x, y, radius), to the same bit."""
    to_x, to_y, radius = disc[0] - x, disc[1] - y, disc[2]
    ahead, side = to_x * dx + to_y * dy, dx * to_y - dy * to_x
    if abs(side) > radius:
        return inf
    half_chord = sqrt(radius * radius - side * side)
    return inf if ahead + half_chord < 0.0 else max(ahead - half_chord, 0.0)


def nearest_obstacle(
    x: float,
    y: float,
    dx: float,
    dy: float,
    walls: FloatArray,
    discs: FloatArray,
    own: int,
    widest_in: float,
    farthest_in: float,
) -> float:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest wall or disc, inches; inf for none.

    Parameters
    ----------
    walls
        (m, 4), rows x1 y1 x2 y2.
    discs
        (k, 4), rows x y radius number, sorted by x; number `own` is not met.
    widest_in
        No less than any radius.
    farthest_in
        Discs whose x is farther than this are not met.
    """
    rows = zip(walls[:, 0], walls[:, 1], walls[:, 2], walls[:, 3])  # noqa: B905  for numba
    nearest = nearest_wall(x, y, dx, dy, rows)[0]
    # 1. The interval of x in which a disc can be nearer than the wall, and its first row by bisection.
    reach_x = min(nearest, FAR_IN) * dx
    low = max(x + min(reach_x, 0.0) - widest_in, x - farthest_in)
    high = min(x + max(reach_x, 0.0) + widest_in, x + farthest_in)
    row, end = 0, len(discs)
    while row < end:
        middle = (row + end) // 2
        if discs[middle, 0] < low:
            row = middle + 1
        else:
            end = middle
    # 2. The nearest of the discs in it.
    while row < len(discs) and discs[row, 0] <= high:
        if discs[row, 3] != own:
            nearest = min(nearest, ray_to_disc(x, y, dx, dy, discs[row]))
        row += 1
    return nearest


# One or a few rays: arrays select the walls worth a look, plain numbers decide.


def cast_ray(x: float, y: float, dx: float, dy: float, walls: FloatArray) -> tuple[float, int]:
    """Return range and row of `nearest_wall` for many walls (m, 4), contiguous, to the same bit.

    An end times the conjugate of the direction is ahead + i side. Some processors round such products once, others
    twice, so arrays only select the candidates.
    """
    sides = ((walls.view(np.complex128) - complex(x, y)) * complex(dx, -dy)).imag
    rows = (sides[:, 0] * sides[:, 1] <= SAME_SIDE_IN2).nonzero()[0]
    nearest, at = nearest_wall(x, y, dx, dy, walls.take(rows, axis=0).tolist())
    return nearest, NO_WALL if at == NO_WALL else int(rows[at])


def cast_each(origins: Sequence[complex], directions: Sequence[complex], walls: FloatArray) -> list[float]:
    """Return the ranges of `nearest_wall` for n rays, to the same bit for any number of rays and walls.

    Parameters
    ----------
    origins, directions
        Complex numbers x + iy, and unit vectors dx + i dy.
    walls
        (m, 4), contiguous.
    """
    rays = [(o.real, o.imag, d.real, d.imag) for o, d in zip(origins, directions, strict=True)]
    # Few walls, few rays, or too many walls for an array of all pairs.
    if len(walls) <= MAX_LOOP_WALLS:
        rows = walls.tolist()
        return [nearest_wall(*ray, rows)[0] for ray in rays]
    if len(rays) <= MAX_SINGLE_RAYS or len(walls) > MAX_PAIRED_WALLS:
        return [cast_ray(*ray, walls)[0] for ray in rays]
    # 1. All ends in the frames of all rays; the pairs of ray and wall worth a look, in the order of the rays.
    ends = walls.view(np.complex128).reshape(1, -1)
    in_frames = (ends - np.array(origins)[:, np.newaxis]) * np.array(directions).conj()[:, np.newaxis]
    frames = in_frames.view(np.float64).reshape(len(origins) * len(walls), 4)
    pairs = (frames[:, 1] * frames[:, 3] <= SAME_SIDE_IN2).nonzero()[0]
    pairs = pairs[(frames[pairs, 0] >= _BEHIND) | (frames[pairs, 2] >= _BEHIND)]
    rows, ordered = walls.take(pairs % len(walls), axis=0).tolist(), pairs.tolist()
    # 2. For each ray the nearest of its walls, in plain numbers.
    ranges, start = [], 0
    for number, ray in enumerate(rays, 1):
        end = bisect_left(ordered, number * len(walls), start)
        ranges.append(nearest_wall(*ray, rows[start:end])[0])
        start = end
    return ranges


# Many rays, in arrays.


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
    ranges, rows = _cast_many(
        np.broadcast_to(starts, shape).reshape(-1, 2), np.broadcast_to(along, shape).reshape(-1, 2), segments
    )
    return ranges.reshape(shape[:-1]), rows.reshape(shape[:-1])


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
    begins, stops = (
        np.column_stack([
            np.searchsorted(rays, bound + shift + margin) for shift in (-2.0 * np.pi, 0.0, 2.0 * np.pi)
        ])
        for bound, margin in ((low, -FAN_MARGIN_RAD), (high, FAN_MARGIN_RAD))
    )
    begin = np.where(begins < stops, begins, len(rays)).min(axis=1, initial=len(rays))
    stop = np.where(begins < stops, stops, 0).max(axis=1, initial=0)
    # 4. Nearest walls first, a block of pairs at a time: what stands behind them is left out.
    order = np.argsort(offsets, kind="stable")
    order = order[begin[order] < stop[order]]
    directions = np.stack((np.cos(angles_rad), np.sin(angles_rad)), axis=1)
    while len(order):
        counts = stop[order] - begin[order]
        taken = order[: max(1, int(np.searchsorted(np.cumsum(counts), _BLOCK)))]
        ray, wall = _pairs(begin[taken], stop[taken])
        hits = _meet(*_pair_frames(x, y, directions[ray], walls[taken[wall]]))
        np.minimum.at(ranges, ray, hits)
        order = order[len(taken):]
        order = order[offsets[order] <= _farthest(ranges, begin[order], stop[order])]
    np.maximum(ranges, 0.0, out=ranges)
    ranges[ranges > reach_in] = inf
    return ranges


def near_walls(x: float, y: float, reach_in: float, walls: FloatArray) -> FloatArray:
    """Return the walls (k, 4) that reach into the square of this half width around a point."""
    if len(walls) <= MAX_LOOP_WALLS:
        return walls
    low_x, low_y, high_x, high_y = _bounds(walls)
    is_near = low_x <= x + reach_in
    is_near &= high_x >= x - reach_in
    is_near &= low_y <= y + reach_in
    is_near &= high_y >= y - reach_in
    near: FloatArray = walls.take(is_near.nonzero()[0], axis=0)
    return near


# Bounds of the walls that were used last: those of worlds are read-only and used again and again.
_MAX_CACHED_BOUNDS: Final = 4
_cached_bounds: list[tuple[FloatArray, FloatArray]] = []


def _bounds(walls: FloatArray) -> FloatArray:
    """Return the bounds of walls (m, 4) as columns low x, low y, high x, high y (4, m)."""
    for cached, bounds in _cached_bounds:
        if cached is walls:
            return bounds
    ends = np.ascontiguousarray(walls.T)
    bounds = np.concatenate((np.minimum(ends[:2], ends[2:]), np.maximum(ends[:2], ends[2:])))
    if not walls.flags.writeable:
        _cached_bounds.insert(0, (walls, bounds))
        del _cached_bounds[_MAX_CACHED_BOUNDS:]
    return bounds


def _pairs(begin: IndexArray, stop: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the numbers from begin to stop of each row, one row after the other, and the number of the row."""
    counts = stop - begin
    row = np.repeat(np.arange(len(begin)), counts)
    number = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts) + begin[row]
    return number, row


def _farthest(ranges: FloatArray, begin: IndexArray, stop: IndexArray) -> FloatArray:
    """Return the largest range from begin to stop of each row; no row is empty."""
    if not len(begin):
        return np.empty(0)
    bounds = np.column_stack((begin, stop)).ravel()
    largest: FloatArray = np.maximum.reduceat(np.append(ranges, 0.0), bounds)[::2]
    return largest


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
        ranges[block], rows[block] = _nearest(_intersections(origins[block], directions[block], walls))
    return ranges, rows


def _intersections(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> FloatArray:
    """Return `intersect` of n rays (n, 2) with m walls (m, 4): (m, n), inf where they do not meet or meet behind."""
    return _meet(*_in_ray_frames(origins, directions, walls))


def _meet(sides: FloatArray, aheads: FloatArray) -> FloatArray:
    """Return `intersect` of walls, from sides and aheads (2, ...) of their ends in the frames of the rays; inf behind.

    The arrays are not changed.
    """
    # 1. Both ends.
    (side_1, side_2), (ahead_1, ahead_2) = sides, aheads
    # 2. The weighted mean.
    hits: FloatArray = ahead_1 * side_2
    hits -= ahead_2 * side_1
    width = side_2 - side_1
    width += _NEVER_ZERO
    hits /= width
    missed = side_1 * side_2 > 0.0
    # 3. Ends on the line of a ray.
    on_line = np.abs(sides) <= ON_LINE_IN
    if on_line.any():
        missed &= ~on_line.any(axis=0)
        nearer, farther = np.minimum(ahead_1, ahead_2), np.maximum(ahead_1, ahead_2)
        end_on = np.where(farther < 0.0, farther, np.maximum(nearer, 0.0))
        hits = np.where(on_line.all(axis=0), end_on, np.clip(hits, nearer, farther))
    missed |= hits < -ON_WALL_IN
    np.copyto(hits, inf, where=missed)
    return hits


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


# The functions of one ray as machine code.

class CompiledKernel:
    """A function compiled by numba from its own source, loaded on demand.

    Compiled code performs the same operations in the same order (no fast math, no fused products): results are equal to
    the bit, so loading changes nothing but the time. Importing numba and reading its cache takes about a second.
    """

    def __init__(self) -> None:
        self.run: Callable[..., float] | None = None
        """The compiled `nearest_obstacle`; None until loaded: `cast_each` is then faster than plain Python."""
        self.tried = False
        """True once loading was tried: a missing numba is looked for only once."""

    def load(self) -> bool:
        """Compile the function or load it from the cache, once; return True if compiled code is available."""
        if not self.tried:
            self.tried = True
            try:
                import numba
                import numba.extending
            except ImportError:
                return False
            self.run = _compile(numba)
        return self.run is not None


RAYCAST_KERNEL: Final = CompiledKernel()
"""The kernel of this process."""


def load_compiled(robots: int) -> None:
    """Load the compiled kernel if NOMAD_COMPILED asks for it with so many robots."""
    if is_compiled_for(robots):
        RAYCAST_KERNEL.load()


def _compile(numba: Any) -> Callable[..., float]:
    """Compile `nearest_obstacle` for read-only arrays, which stand for writable ones too."""
    for helper in (mean_ahead, intersect, ray_to_disc, nearest_wall):
        numba.extending.register_jitable(helper)
    number, rows = numba.float64, numba.types.Array(numba.float64, 2, "C", readonly=True)
    signature = number(number, number, number, number, rows, rows, numba.int64, number, number)
    try:
        compiled: Callable[..., float] = numba.njit(signature, cache=True)(nearest_obstacle)
    except RuntimeError:  # no writable directory for the cache
        compiled = numba.njit(signature)(nearest_obstacle)
    return compiled
