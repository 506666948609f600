"""Plane geometry on arrays: nearest points, distances, point in polygon, crossing outlines.

Lengths in inches. Rays are cast in raycast.py.

    segments (m, 4)     rows x1 y1 x2 y2
    corners (n, 2)      a closed polygon; the edge from the last corner to the first is implied
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

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
    unit: FloatArray = across / lengths(segments)[..., np.newaxis]
    return unit


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
    here = np.asarray(points, dtype=np.float64)[..., np.newaxis]
    x, y = here[..., 0, :], here[..., 1, :]
    x1, y1, x2, y2 = segments.T
    along_x, along_y = x2 - x1, y2 - y1
    # The foot of the perpendicular, as a fraction of the segment, limited to its two ends.
    squared = along_x * along_x + along_y * along_y
    squared[squared == 0.0] = 1.0
    fraction = ((x - x1) * along_x + (y - y1) * along_y) / squared
    fraction = np.minimum(np.maximum(fraction, 0.0), 1.0)
    nearest_x, nearest_y = x1 + fraction * along_x, y1 + fraction * along_y
    return np.stack((nearest_x, nearest_y), axis=-1), np.hypot(x - nearest_x, y - nearest_y)


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
    here = np.asarray(points, dtype=np.float64)[..., np.newaxis]
    x, y = here[..., 0, :], here[..., 1, :]
    x1, y1, x2, y2 = edges.T
    spans = (y1 > y) != (y2 > y)
    left_of_edge = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1) > 0.0
    crossed = spans & (left_of_edge == (y2 > y1))
    odd: BoolArray = np.logical_xor.reduceat(crossed, np.asarray(firsts, dtype=np.intp), axis=-1)
    return odd


def area(corners: npt.ArrayLike) -> float:
    """Return the area of a polygon with corners (n, 2), positive if they run counter-clockwise (shoelace formula)."""
    x1, y1, x2, y2 = polygon_segments(corners).T
    # Relative to a corner instead of a distant origin, to avoid cancellation.
    x0, y0 = x1[0], y1[0]
    return float(((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)).sum() / 2.0)


def crossing(edges: FloatArray) -> tuple[int, int] | None:
    """Return the rows (i, j), i < j, of the first two of edges (n, 4) that cross; None if no two do.

    Two edges cross if each has its ends on both sides of the other: edges that only touch do not cross.
    """
    first, second = edges[:, :2], edges[:, 2:]
    sides_1 = _sides(first, second, first)
    sides_2 = _sides(first, second, second)
    parted = sides_1 * sides_2 < 0.0
    rows = np.argwhere(np.triu(parted & parted.T))
    return (int(rows[0, 0]), int(rows[0, 1])) if len(rows) else None


def _sides(first: FloatArray, second: FloatArray, points: FloatArray) -> FloatArray:
    """Return the sides (n, k) of k points relative to lines from n first to n second ends: left positive."""
    along = (second - first)[:, np.newaxis]
    offset = points[np.newaxis] - first[:, np.newaxis]
    sides: FloatArray = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    return sides
