"""The ray caster: the one numeric kernel that sonars, infrareds, the filter and the page all look through.

Arrays in, arrays out; no robot, no noise, no sensor limits here. Each ray is turned into its own frame:

    side    how far a corner of a wall lies to the left of the ray's line      (direction x corner)
    ahead   how far along the ray it lies                                      (direction . corner)

A wall is met where its two corners lie on different sides; the range is the mean of their two `ahead`s weighted
by the opposite sides: a convex mean, which nothing can cancel out of. Both walls at a shared corner compute
the same side for it, so no ray slips between them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from worlds.geometry import FloatArray

IndexArray = npt.NDArray[np.intp]

ON_LINE_IN: Final = 1e-9
"""A corner this near to a ray's line lies on it, inches. Rounding of coordinates up to 1e5 in is about
2e-11, and the smallest thing a robot can tell apart is 1e-2: 1e-9 is far from both. So an answer is exact for
walls whose corners moved by no more than this."""

ON_WALL_IN: Final = 1e-9
"""A ray that starts this little past a wall starts on it, inches; the same reason. A ray on a wall meets it at 0."""

NO_WALL: Final = -1
"""What stands in `walls_hit` where a ray meets nothing."""


def cast_rays(
    origins: npt.ArrayLike, directions: npt.ArrayLike, walls: npt.ArrayLike
) -> tuple[FloatArray, IndexArray]:
    """The range from each origin along its direction to the first wall, and which wall that is.

    origins     (..., 2) inches, and directions (..., 2) unit vectors; their leading dimensions broadcast
    walls       (m, 4) segments, rows x1 y1 x2 y2 in inches; m may be 0
    returns     ranges (...) >= 0 in inches, inf where nothing is met; walls_hit (...) rows of `walls`, -1 there

    Walls are closed: a ray through a corner meets it. A ray that starts on a wall meets it at range 0, wherever it
    points. A wall seen end-on is met at its nearer end. Where walls are met at one range (a shared corner) any one
    of them is named. All numbers must be finite.
    """
    starts, ways = np.broadcast_arrays(
        np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
    )
    shape = starts.shape[:-1]
    segments = np.asarray(walls, dtype=np.float64)
    if segments.shape[0] == 0:
        return np.full(shape, np.inf), np.full(shape, NO_WALL, dtype=np.intp)
    ranges, hits = _first(_meetings(starts.reshape(-1, 2), ways.reshape(-1, 2), segments))
    return ranges.reshape(shape), hits.reshape(shape)


def _meetings(origins: FloatArray, directions: FloatArray, walls: FloatArray) -> FloatArray:
    """Ranges (m, n) at which n rays meet m walls, inf where they do not."""
    dx, dy = directions.T
    ox, oy = origins.T
    left = np.array((-dy, dx))
    ends = walls.reshape(-1, 2)
    side = ends @ left - (dx * oy - dy * ox)
    ahead = ends @ directions.T - (dx * ox + dy * oy)
    side *= np.abs(side) > ON_LINE_IN
    side_1, side_2, ahead_1, ahead_2 = side[0::2], side[1::2], ahead[0::2], ahead[1::2]
    width = side_2 - side_1
    end_on = width == 0.0
    ranges: FloatArray = (ahead_1 * side_2 - ahead_2 * side_1) / np.where(end_on, 1.0, width)
    nearer = np.minimum(ahead_1, ahead_2)
    farther = np.maximum(ahead_1, ahead_2)
    ranges = np.where(end_on, np.where(farther < -ON_WALL_IN, farther, np.maximum(nearer, 0.0)), ranges)
    ranges[(side_1 * side_2 > 0.0) | (ranges < -ON_WALL_IN)] = np.inf
    return np.maximum(ranges, 0.0)


def _first(ranges: FloatArray) -> tuple[FloatArray, IndexArray]:
    """The smallest of ranges (m, n) for each ray (n,), and its row (n,)."""
    hits = ranges.argmin(axis=0)
    nearest = np.take_along_axis(ranges, hits[np.newaxis], axis=0)[0]
    hits[np.isinf(nearest)] = NO_WALL
    return nearest, hits
