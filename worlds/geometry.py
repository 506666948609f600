"""Plane geometry on arrays: nearest points, distances, point in polygon, crossing outlines.

Lengths in inches. Rays are cast in raycast.py.

    segments (m, 4)     rows x1 y1 x2 y2
    corners (n, 2)      a closed polygon; the edge from the last corner to the first is implied
"""

from collections.abc import Iterator
from itertools import count
from math import ceil, inf, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IndexArray = npt.NDArray[np.intp]

MAX_ALL_PAIRS: Final = 64
"""Up to so many segments, all pairs are faster than a grid."""

MAX_PAIRS: Final = 30_000_000
"""Candidate pairs of one search, about three seconds of work; a map of rooms has about ten per wall."""

MAX_CELLS_PER_SEGMENT: Final = 16
"""Mean number of cells of a segment; bounds the memory of the grid."""

PAIR_BLOCK: Final = 4000
"""Pairs per block: keeps arrays within 128 kB, from which on the C library requests new pages for each."""

GRID_MARGIN_IN: Final = 1e-4
"""Rounding of positions within a grid; a slope is at most 1e5 / UPRIGHT_IN, coordinates are rounded to 1e-11 in."""

MIN_BLOCK, BLOCK_PAIRS = 32, 100_000
"""Least number of points, and usual number of pairs of point and segment, that are computed at once."""

MAX_LOOP_WALLS: Final = 20
"""Up to so many walls, a loop in plain Python is faster than a selection of them in arrays."""

UPRIGHT_IN: Final = 0.1
"""A segment narrower than this counts as upright in a grid, so that no slope magnifies rounding."""

NO_DISCS: FloatArray = np.zeros((0, 3))
"""No discs: rows x y radius in inches."""


def polyline_segments(points: npt.ArrayLike) -> FloatArray:
    """Return the segments (k - 1, 4) that join k >= 1 points (k, 2) in order."""
    array = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return np.concatenate((array[:-1], array[1:]), axis=1)


def polygon_segments(corners: npt.ArrayLike) -> FloatArray:
    """Return the edges (n, 4) of the closed polygon with corners (n, 2), the closing edge last."""
    array = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return np.concatenate((array, np.concatenate((array[1:], array[:1]))), axis=1)


def lengths(segments: FloatArray) -> FloatArray:
    """Return the lengths (m,) of segments (m, 4)."""
    return np.hypot(segments[..., 2] - segments[..., 0], segments[..., 3] - segments[..., 1])


def normals(segments: FloatArray) -> FloatArray:
    """Return unit normals (m, 2) to the left of segments (m, 4), seen from the first end; no segment may have length 0.

    Of a polygon with counter-clockwise corners the left is the inside.
    """
    across = np.stack((segments[..., 1] - segments[..., 3], segments[..., 2] - segments[..., 0]), axis=-1)
    return across / lengths(segments)[..., np.newaxis]


def nearest_points(points: npt.ArrayLike, segments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the nearest point of each segment to each point, and its distance.

    Parameters
    ----------
    points : (..., 2) array
    segments : (m, 4) array
        A segment of length 0 is a point.

    Returns
    -------
    nearest : (..., m, 2) array
    distances : (..., m) array
    """
    return nearest_points_of_pairs(np.asarray(points, dtype=np.float64)[..., np.newaxis, :], segments)


def nearest_points_of_pairs(points: FloatArray, segments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the nearest point (..., 2) of segment (..., 4) to point (..., 2), and the distance (...), elementwise."""
    x, y = points[..., 0], points[..., 1]
    x1, y1, x2, y2 = np.moveaxis(segments, -1, 0)
    along_x, along_y = x2 - x1, y2 - y1
    # The foot of the perpendicular, as a fraction of the segment, limited to its two ends.
    squared = along_x * along_x + along_y * along_y
    squared[squared == 0.0] = 1.0
    fraction = ((x - x1) * along_x + (y - y1) * along_y) / squared
    fraction = np.minimum(np.maximum(fraction, 0.0), 1.0)
    nearest_x, nearest_y = x1 + fraction * along_x, y1 + fraction * along_y
    return np.stack((nearest_x, nearest_y), axis=-1), np.hypot(x - nearest_x, y - nearest_y)


def nearest_distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Return the distance (...) of points (..., 2) to the nearest of segments (m, 4); inf if there are none.

    Points are taken in blocks, and segments that are too far from a whole block are skipped: fast if neighbours in the
    array are neighbours in the plane. The result is that of `nearest_points`, to the bit.
    """
    flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    nearest = np.full(len(flat), inf)
    if len(segments):
        for part in _blocks(len(flat), len(segments)):
            block, near = flat[part], segments
            if len(flat) > len(block):
                # A segment may be nearest if it is nearer to the centre than the nearest one plus the block's size.
                centre = (block.min(axis=0) + block.max(axis=0)) / 2.0
                size = 2.0 * float(np.hypot(*(block - centre).T).max())
                from_centre = nearest_points(centre, segments)[1]
                near = segments[from_centre <= (from_centre.min() + size) * (1.0 + 1e-9) + 1e-9]
            nearest[part] = nearest_points(block, near)[1].min(axis=-1)
    return nearest.reshape(np.shape(points)[:-1])


def _blocks(points: int, segments: int) -> Iterator[slice]:
    """Yield slices of `points` that make arrays of bounded size with `segments`."""
    step = max(MIN_BLOCK, BLOCK_PAIRS // max(segments, 1))
    return (slice(first, first + step) for first in range(0, points, step))


def inside(points: npt.ArrayLike, edges: FloatArray, firsts: npt.ArrayLike = (0,)) -> BoolArray:
    """Return True where a point lies inside a closed polygon.

    Even-odd rule: a point is inside if a half line to the right crosses an odd number of edges. The test compares
    signs and needs no division. A point on an edge may count as inside or outside.

    Parameters
    ----------
    points : (..., 2) array
    edges : (n, 4) array
        Edges of all p polygons, one polygon after the other, in either orientation.
    firsts : (p,) array of int
        Row of the first edge of each polygon.

    Returns
    -------
    (..., p) array of bool
    """
    here, rows = np.asarray(points, dtype=np.float64), np.asarray(firsts, dtype=np.intp)
    flat = here.reshape(-1, 2)
    within = np.zeros((len(flat), len(rows)), dtype=bool)
    low, high = np.minimum(edges[:, 1], edges[:, 3]), np.maximum(edges[:, 1], edges[:, 3])
    for part in _blocks(len(flat), len(edges)):
        # 1. Edges beside the points of the block; the others are not crossed.
        x, y = flat[part, :1], flat[part, 1:]
        near = np.flatnonzero((low <= y.max()) & (high >= y.min()))
        if not len(near):
            continue
        # Their polygons, and where each polygon's edges begin among them.
        polygons = rows.searchsorted(near, side="right") - 1
        starts = np.flatnonzero(np.concatenate(([True], polygons[1:] != polygons[:-1])))
        # 2. Edges crossed, and their parity for each polygon.
        x1, y1, x2, y2 = edges[near].T
        spans = (y1 > y) != (y2 > y)
        left_of_edge = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1) > 0.0
        crossed = spans & (left_of_edge == (y2 > y1))
        within[part, polygons[starts]] = np.logical_xor.reduceat(crossed, starts, axis=-1)
    return within.reshape(*here.shape[:-1], len(rows))


def area(corners: npt.ArrayLike) -> float:
    """Return the area of a polygon with corners (n, 2), positive if they run counter-clockwise (shoelace formula)."""
    x1, y1, x2, y2 = polygon_segments(corners).T
    # Relative to a corner instead of a distant origin, to avoid cancellation.
    x0, y0 = x1[0], y1[0]
    return float(((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)).sum() / 2.0)


def crossing(edges: FloatArray) -> tuple[int, int] | None:
    """Return the rows (i, j), i < j, of two of edges (n, 4) that cross; None if no two do.

    Two edges cross if each has its ends on both sides of the other: edges that only touch do not cross.

    Raises
    ------
    ValueError
        As for `candidate_pairs`.
    """
    for one, other in candidate_pairs(edges):
        first, second = edges[one], edges[other]
        crossed = np.flatnonzero(_parts(first, second))
        crossed = crossed[_parts(second[crossed], first[crossed])]
        if len(crossed):
            return int(one[crossed[0]]), int(other[crossed[0]])
    return None


def crossings(segments: FloatArray, others: FloatArray, touch_in: float = 0.0) -> BoolArray:
    """Return a matrix (n, m): True where a segment (n, 4) crosses another (m, 4); see `crosses`."""
    return crosses(segments[:, np.newaxis], others[np.newaxis], touch_in)


def crosses(segments: FloatArray, others: FloatArray, touch_in: float = 0.0) -> BoolArray:
    """Return True (...) where two segments (..., 4) cross, the ends of both more than `touch_in` beyond."""
    return _parts(segments, others, touch_in) & _parts(others, segments, touch_in)


def _parts(lines: FloatArray, segments: FloatArray, touch_in: float = 0.0) -> BoolArray:
    """Return True (...) where a line has both ends of a segment farther than `touch_in` from it, on two sides."""
    along_x, along_y = lines[..., 2] - lines[..., 0], lines[..., 3] - lines[..., 1]
    # Cross products: positive for an end to the left of the line.
    first = along_x * (segments[..., 1] - lines[..., 1]) - along_y * (segments[..., 0] - lines[..., 0])
    second = along_x * (segments[..., 3] - lines[..., 1]) - along_y * (segments[..., 2] - lines[..., 0])
    parts: BoolArray = first * second < 0.0
    if touch_in > 0.0:
        least = touch_in * lengths(lines)
        parts &= (np.abs(first) > least) & (np.abs(second) > least)
    return parts


def candidate_pairs(segments: FloatArray, reach_in: float = 0.0) -> Iterator[tuple[IndexArray, IndexArray]]:
    """Yield pairs of rows of segments (m, 4) in blocks: at least all pairs that come within a distance of each other.

    Segments are entered into a grid of about m cells, and only those in the same cell are paired: time and memory in
    proportion to m, as long as walls are not much longer than their distances. A pair may be yielded repeatedly.

    Yields
    ------
    one, other : (k,) arrays of int
        Rows, one < other elementwise.

    Raises
    ------
    ValueError
        If there are more than MAX_PAIRS pairs.
    """
    # 1. Few segments: all pairs.
    if len(segments) <= MAX_ALL_PAIRS:
        yield np.triu_indices(len(segments), 1)
        return
    # 2. Entries (cell, row), sorted by cell and then by row.
    cells, rows = _enter_into_grid(segments, reach_in)
    order = cells.argsort(kind="stable")
    cells, rows = cells[order], rows[order]
    # 3. Each entry with the next one of its cell, then with the one after it, and so on.
    entries, total = np.arange(len(cells)), 0
    for ahead in count(1):
        entries = entries[: np.searchsorted(entries, len(cells) - ahead)]
        entries = entries[cells[entries] == cells[entries + ahead]]
        if not len(entries):
            return
        total += len(entries)
        if total > MAX_PAIRS:
            raise ValueError(f"more than {MAX_PAIRS} pairs of walls lie close together")
        for begin in range(0, len(entries), PAIR_BLOCK):
            block = entries[begin : begin + PAIR_BLOCK]
            yield rows[block], rows[block + ahead]


def _enter_into_grid(segments: FloatArray, reach_in: float) -> tuple[IndexArray, IndexArray]:
    """Return the cells that each segment passes within a distance, and the row of that segment."""
    margin = reach_in + GRID_MARGIN_IN
    x1, y1, x2, y2 = segments.T
    along_x, along_y = x2 - x1, y2 - y1
    low_x, high_x = np.minimum(x1, x2), np.maximum(x1, x2)
    divisor = np.where(along_x == 0.0, 1.0, along_x)
    upright = np.abs(along_x) < UPRIGHT_IN
    side = ceil(sqrt(len(segments)))
    while True:
        # 1. Lines of the grid at quantiles of the ends: cells are small where there are many walls.
        at = np.linspace(0.0, 1.0, side + 1)[1:-1]
        lines_x = np.unique(np.quantile(segments[:, 0::2], at))
        lines_y = np.unique(np.quantile(segments[:, 1::2], at))
        # 2. The columns of each segment.
        first = np.searchsorted(lines_x, low_x - margin)
        rows, columns = expand(first, np.searchsorted(lines_x, high_x + margin, side="right"))
        # 3. Its part in each column, and the cells of that part.
        bounds = np.concatenate(([-inf], lines_x, [inf]))
        left = np.maximum(bounds[columns] - margin, low_x[rows])
        right = np.minimum(bounds[columns + 1] + margin, high_x[rows])
        ends_y = [y1[rows] + np.clip((x - x1[rows]) / divisor[rows], 0.0, 1.0) * along_y[rows] for x in (left, right)]
        low_y = np.where(upright[rows], np.minimum(y1, y2)[rows], np.minimum(*ends_y))
        high_y = np.where(upright[rows], np.maximum(y1, y2)[rows], np.maximum(*ends_y))
        first = np.searchsorted(lines_y, low_y - margin)
        last = np.searchsorted(lines_y, high_y + margin, side="right")
        # 4. A coarser grid if long segments pass too many cells.
        if int((last - first + 1).sum()) <= MAX_CELLS_PER_SEGMENT * len(segments) or side <= 2:
            parts, lines = expand(first, last)
            return columns[parts] * (len(lines_y) + 1) + lines, rows[parts]
        side //= 2


def expand(first: IndexArray, last: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return all numbers of n ranges, each from `first` to `last`, and before them the index of the range."""
    counts = last - first + 1
    indices = np.repeat(np.arange(len(first)), counts)
    return indices, np.arange(len(indices)) - np.repeat(counts.cumsum() - counts, counts) + first[indices]


def near_walls(x: float, y: float, reach_in: float, walls: FloatArray) -> FloatArray:
    """Return the walls (k, 4), read-only, that reach into the square of this half width around a point."""
    if len(walls) <= MAX_LOOP_WALLS:
        return walls
    low_x, low_y, high_x, high_y = _bounds(walls)
    is_near = low_x <= x + reach_in
    is_near &= high_x >= x - reach_in
    is_near &= low_y <= y + reach_in
    is_near &= high_y >= y - reach_in
    near: FloatArray = walls.take(is_near.nonzero()[0], axis=0)
    near.setflags(write=False)
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
