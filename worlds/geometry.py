"""Small array kernels of plane geometry: nearest points, distances, inside or outside, crossing outlines.

Arrays in, arrays out; inches; nothing here knows what a wall, a room or a robot is. Rays live in raycast.py.

    segments (m, 4)     rows x1 y1 x2 y2
    corners (n, 2)      a closed polygon; the edge from the last corner to the first goes without saying
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def polyline_segments(points: npt.ArrayLike) -> FloatArray:
    """The k - 1 segments (k - 1, 4) that join k >= 1 points (k, 2) in their order."""
    array = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return np.concatenate((array[:-1], array[1:]), axis=1)


def polygon_segments(corners: npt.ArrayLike) -> FloatArray:
    """The n edges (n, 4) of the closed polygon with n corners (n, 2), the closing edge last."""
    array = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return np.concatenate((array, np.concatenate((array[1:], array[:1]))), axis=1)


def lengths(segments: FloatArray) -> FloatArray:
    """Lengths (m,) of segments (m, 4)."""
    return np.hypot(segments[..., 2] - segments[..., 0], segments[..., 3] - segments[..., 1])


def normals(segments: FloatArray) -> FloatArray:
    """Unit normals (m, 2) to the left of each segment (m, 4) seen from its first end; none may have length 0.

    For a polygon whose corners run counter-clockwise the left is the inside.
    """
    across = np.stack((segments[..., 1] - segments[..., 3], segments[..., 2] - segments[..., 0]), axis=-1)
    unit: FloatArray = across / lengths(segments)[..., np.newaxis]
    return unit


def nearest_points(points: npt.ArrayLike, segments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """For points (..., 2) and segments (m, 4): nearest points (..., m, 2) and their distances (..., m).

    The foot of the perpendicular, held between the two ends; a segment of length 0 is its point.
    """
    here = np.asarray(points, dtype=np.float64)[..., np.newaxis]
    x, y = here[..., 0, :], here[..., 1, :]
    x1, y1, x2, y2 = segments.T
    along_x, along_y = x2 - x1, y2 - y1
    squared = along_x * along_x + along_y * along_y
    squared[squared == 0.0] = 1.0
    share = ((x - x1) * along_x + (y - y1) * along_y) / squared
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    nearest_x, nearest_y = x1 + share * along_x, y1 + share * along_y
    return np.stack((nearest_x, nearest_y), axis=-1), np.hypot(x - nearest_x, y - nearest_y)


def inside(points: npt.ArrayLike, edges: FloatArray, firsts: npt.ArrayLike = (0,)) -> BoolArray:
    """For points (..., 2) and p closed polygons: inside which of them each lies, (..., p).

    edges (n, 4) are those of all polygons, one below the other, either way round; firsts (p,) the row at which each
    polygon begins. Even-odd rule: a point is inside when a half line from it to the right crosses an odd number of
    edges; a test of signs, without a division. A point on an edge may count as either.
    """
    here = np.asarray(points, dtype=np.float64)[..., np.newaxis]
    x, y = here[..., 0, :], here[..., 1, :]
    x1, y1, x2, y2 = edges.T
    spans = (y1 > y) != (y2 > y)
    left_of_edge = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1) > 0.0
    crossed = spans & (left_of_edge == (y2 > y1))
    odd: BoolArray = np.logical_xor.reduceat(crossed, np.asarray(firsts, dtype=np.intp), axis=-1)
    return odd


def area(corners: npt.ArrayLike) -> float:
    """The area of a polygon with corners (n, 2), positive where they run counter-clockwise (shoelace formula)."""
    x1, y1, x2, y2 = polygon_segments(corners).T
    x0, y0 = x1[0], y1[0]  # from a corner, not from a far origin: nothing cancels
    return float(((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)).sum() / 2.0)


def crossing(edges: FloatArray) -> tuple[int, int] | None:
    """The first two of the edges (n, 4) that cross each other, as rows (i, j) with i < j; None if no two do.

    Only crossings count where each edge has its ends on both sides of the other: edges that touch do not cross.
    """
    first, second = edges[:, :2], edges[:, 2:]
    sides_1 = _sides(first, second, first)
    sides_2 = _sides(first, second, second)
    parted = sides_1 * sides_2 < 0.0
    rows = np.argwhere(np.triu(parted & parted.T))
    return (int(rows[0, 0]), int(rows[0, 1])) if len(rows) else None


def _sides(first: FloatArray, second: FloatArray, points: FloatArray) -> FloatArray:
    """Sides (n, k) of k points against the lines from n first to n second ends: left positive."""
    along = (second - first)[:, np.newaxis]
    offset = points[np.newaxis] - first[:, np.newaxis]
    sides: FloatArray = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    return sides
