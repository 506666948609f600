"""One ray in plain numbers: where it meets a wall, a disc, and the first of many. raycast.py does the same in arrays.

All of it is written so that compiled.py can make machine code of it: loops, numbers, rows of arrays. numba keeps that
code for as long as this file stays what it is, so whatever a function here calls stands in this file too.

The ray caster: the one numeric kernel that sonars, infrareds, the filter and the page all look through.

Arrays in, arrays out; no robot, no noise, no sensor limits here. Each corner of a wall is seen in the ray's frame:

    ahead   how far along the ray it lies                           direction . (corner - origin)
    side    how far it lies to the left of the ray's line           direction x (corner - origin)

A wall is met where its two corners lie on different sides; the range is the mean of their two `ahead`s, each
weighted with the other's side: a convex mean, out of which nothing cancels. A corner that two walls share is on one
side for both (or, within ON_LINE_IN, on the line for one of them), so no ray slips between them.

A kernel of ray.py as machine code, by numba, where that is installed and worth its while; else everybody's own way.

Machine code does the same operations on the same numbers in the same order (no fast math, no fused products): its
results are those of the arrays to the bit. So whether and when it is used changes how long a simulation takes, and
nothing else.

    pip install 'nomad-nserver[fast]'       numba
    NOMAD_COMPILED=always|crowd|never       from the first robot on; from CROWD robots on (the default); not at all

Loading takes a process about a second: numba is imported, and its code read from the cache beside the source
or, the first time, made. A few robots in real time would never win that back.

Which wall a ray meets first, for who asks the same walls again and again: prepared once.

Rules: the answers are raycast's, to the bit. What a ray meets nothing of has the row after the last.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from math import inf, sqrt
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from nclient.errors import VariableError
from worlds.geometry import FloatArray

ON_LINE_IN: Final = 1e-9
"""A corner this near to a ray's line lies on it, inches. With coordinates up to 1e5 in rounding is some 1e-11, and
the finest thing a robot tells apart is 1e-2: 1e-9 is far from both. So every answer is the exact one for walls whose
corners were moved by no more than this."""

ON_WALL_IN: Final = 1e-9
"""A ray that starts this little behind a wall starts on it, inches; for the same reason."""

WORTH_A_LOOK: Final = ON_LINE_IN * 4e5
"""Two corners whose sides multiply to more than this are clearly both on one side: no side is beyond 4e5 in."""

FAR_IN: Final = 1e6
"""Farther than any wall."""


def meeting(ahead_1: float, side_1: float, ahead_2: float, side_2: float) -> float:
    """Where a ray's line meets a wall, from its two corners; negative behind the origin, inf for not at all."""
    on_line_1, on_line_2 = abs(side_1) <= ON_LINE_IN, abs(side_2) <= ON_LINE_IN
    if not (on_line_1 or on_line_2):
        return inf if side_1 * side_2 > 0.0 else (ahead_1 * side_2 - ahead_2 * side_1) / (side_2 - side_1)
    nearer, farther = min(ahead_1, ahead_2), max(ahead_1, ahead_2)
    if on_line_1 and on_line_2:
        return farther if farther < 0.0 else max(nearer, 0.0)
    mean = (ahead_1 * side_2 - ahead_2 * side_1) / (side_2 - side_1)
    return min(max(mean, nearer), farther)


def ray_to_disc(x: float, y: float, dx: float, dy: float, disc: Sequence[float] | FloatArray) -> float:
    """`cast_discs` of a single ray from (x, y) along (dx, dy) and one disc (x, y, radius), to the same bit."""
    to_x, to_y, radius = disc[0] - x, disc[1] - y, disc[2]
    ahead, side = to_x * dx + to_y * dy, dx * to_y - dy * to_x
    if abs(side) > radius:
        return inf
    half_chord = sqrt(radius * radius - side * side)
    return inf if ahead + half_chord < 0.0 else max(ahead - half_chord, 0.0)


def meeting_before(
    nearest: float, x: float, y: float, dx: float, dy: float, x1: float, y1: float, x2: float, y2: float
) -> float:
    """The range from (x, y) along the unit vector (dx, dy) to the wall from (x1, y1) to (x2, y2) if it is less than
    `nearest`, else that. A little less than 0 where the ray starts on the wall."""
    to_x_1, to_y_1, to_x_2, to_y_2 = x1 - x, y1 - y, x2 - x, y2 - y
    ahead_1, ahead_2 = to_x_1 * dx + to_y_1 * dy, to_x_2 * dx + to_y_2 * dy
    if (ahead_1 < -ON_WALL_IN and ahead_2 < -ON_WALL_IN) or (ahead_1 >= nearest and ahead_2 >= nearest):
        return nearest
    met = meeting(ahead_1, dx * to_y_1 - dy * to_x_1, ahead_2, dx * to_y_2 - dy * to_x_2)
    return met if -ON_WALL_IN <= met < nearest else nearest


def first_wall(x: float, y: float, dx: float, dy: float, walls: FloatArray) -> float:
    """The range of `raycast.cast_ray`, to the same bit: no array but the walls (m, 4)."""
    nearest = inf
    for row in range(len(walls)):
        nearest = meeting_before(nearest, x, y, dx, dy, walls[row, 0], walls[row, 1], walls[row, 2], walls[row, 3])
    return max(nearest, 0.0)


def first_met(
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
    """The range from (x, y) along the unit vector (dx, dy) to the first wall or disc, inches; inf for none.

    walls          (m, 4), rows x1 y1 x2 y2
    discs          (k, 4), rows x y radius number, sorted by x; number `own` is not met
    widest_in      no less than any radius
    farthest_in    discs whose x is farther than this are not met
    """
    nearest = first_wall(x, y, dx, dy, walls)
    way_x = min(nearest, FAR_IN) * dx
    low = max(x + min(way_x, 0.0) - widest_in, x - farthest_in)
    high = min(x + max(way_x, 0.0) + widest_in, x + farthest_in)
    row, end = 0, len(discs)
    while row < end:
        middle = (row + end) // 2
        if discs[middle, 0] < low:
            row = middle + 1
        else:
            end = middle
    while row < len(discs) and discs[row, 0] <= high:
        if discs[row, 3] != own:
            nearest = min(nearest, ray_to_disc(x, y, dx, dy, discs[row]))
        row += 1
    return nearest


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


VARIABLE: Final = "NOMAD_COMPILED"
"""The environment variable."""

CROWD: Final = 50
"""Where each ring is read once a second, so many robots win back the loading within a minute."""

_FROM_ROBOTS: Final = {"always": 1.0, "crowd": float(CROWD), "never": float("inf")}


class Kernel:
    """`run` is `ray.first_met` as machine code, or None as long as that is not loaded: its caller then works in arrays,
    which is quicker than the plain function."""

    def __init__(self) -> None:
        self.run: Callable[..., float] | None = None
        self.tried = False
        """Whether it was sought already; what cannot be found once is not sought again."""

    def load(self) -> bool:
        """Compile it or take it from the cache, once; returns whether there is machine code."""
        if not self.tried:
            self.tried = True
            try:
                import numba
                import numba.extending
            except ImportError:
                return False
            self.run = _compile(numba)
        return self.run is not None


FIRST_MET: Final = Kernel()
"""The one of this process."""


def load_for(robots: int) -> None:
    """Load the machine code if so many robots are worth it.

    Raises VariableError if the environment variable is none of its words.
    """
    word = os.environ.get(VARIABLE, "crowd")
    if word not in _FROM_ROBOTS:
        raise VariableError(f"{VARIABLE} is {word!r}; it can be {', '.join(_FROM_ROBOTS)}")
    if robots >= _FROM_ROBOTS[word]:
        FIRST_MET.load()


def _compile(numba: Any) -> Callable[..., float]:
    """`ray.first_met` for read-only arrays, which stand for all others too."""
    for helper in (meeting, meeting_before, ray_to_disc, first_wall):
        numba.extending.register_jitable(helper)
    number, rows = numba.float64, numba.types.Array(numba.float64, 2, "C", readonly=True)
    signature = number(number, number, number, number, rows, rows, numba.int64, number, number)
    try:
        compiled: Callable[..., float] = numba.njit(signature, cache=True)(first_met)
    except RuntimeError:  # nowhere to keep a cache
        compiled = numba.njit(signature)(first_met)
    return compiled


FEW: Final = 40
"""So many walls are looked through sooner in numbers, one by one."""


class FirstWall:
    """Walls (m, 4), rows x1 y1 x2 y2 in inches, that stay."""

    def __init__(self, walls: npt.ArrayLike) -> None:
        self._walls = np.ascontiguousarray(walls, dtype=np.float64).reshape(-1, 4)
        self._listed = [tuple(wall) for wall in self._walls.tolist()]
        self.nothing = len(self._walls)
        """The row of no wall."""

    def first(self, x: float, y: float, dx: float, dy: float) -> tuple[float, int]:
        """The range from (x, y) along the unit vector (dx, dy) to the first wall, and its row; inf and the row after
        the last where there is none."""
        if self.nothing > FEW:
            nearest, row = cast_ray(x, y, dx, dy, self._walls)
            return nearest, self.nothing if row == NO_WALL else row
        nearest, hit = inf, self.nothing
        for row, (x1, y1, x2, y2) in enumerate(self._listed):
            if (dx * (y1 - y) - dy * (x1 - x)) * (dx * (y2 - y) - dy * (x2 - x)) <= WORTH_A_LOOK:
                met = meeting_before(nearest, x, y, dx, dy, x1, y1, x2, y2)
                if met < nearest:
                    nearest, hit = met, row
        return max(nearest, 0.0), hit
