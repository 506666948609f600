"""The ray caster: the range along a ray to the nearest wall.

    nearest_wall   walls in rows of numbers: the loop that simulated sonars and the filter run, as it stands or compiled
    cast_ray       the same for walls in an array
    sole_wall      for the filter: the only wall that a ray can meet while its origin is uncertain
    ray_to_disc    range to a robot, which is a disc; those near a ray are found in nserver_emu/simulation/visibility.py

Rays by the hundred are cast in raycast_arrays.py.

For each wall, from p1 to p2, and a ray from o along the unit vector d:

    1. Set up       the ends in the frame of the ray
                        ahead_i = d . (p_i - o)      distance along the ray
                        side_i  = d x (p_i - o)      distance to its left
    2. Intersect    ends on different sides: the line of the ray divides the wall in the ratio side_1 : -side_2, at
                        range = (ahead_1 side_2 - ahead_2 side_1) / (side_2 - side_1)
    3. Nearest      the smallest range that is not behind

Here d . v = dx v_x + dy v_y, and d x v = dx v_y - dy v_x. The range is a mean of ahead_1 and ahead_2 with positive
weights, so nothing cancels. Two walls that share an end agree
on its side, so no ray passes between them.

References
----------
Ericson, Real-Time Collision Detection (2005): 5.1.9.1 for a segment (signed areas), 5.3.2 for a circle.
"""

from collections.abc import Iterable, Sequence
from math import inf, sqrt
from typing import Any, Final

import numpy as np

from worlds.geometry import MAX_LOOP_WALLS, FloatArray

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
"""Two ends whose sides multiply to more than this lie on one side, neither of them on the line: no side exceeds 4e5 in,
so the smaller one exceeds ON_LINE_IN."""

_NEVER_ZERO: Final = 1e-200
"""Added to a difference of sides: changes only 0, to avoid the division by it."""


# Walls.


def nearest_wall(x: float, y: float, dx: float, dy: float, walls: WallRows) -> tuple[float, int]:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest wall, and its row.

    Walls are closed: a ray through an end meets it. A ray that starts on a wall meets it at range 0, in any direction
    (except one that leaves a slanted wall at less than 1e-5 rad without lying in it: rounding decides). A wall seen
    end-on is met at its nearer end.

    Parameters
    ----------
    walls
        Rows x1, y1, x2, y2 of m walls, inches; coordinates at most 1e5 in, which is not checked.

    Returns
    -------
    tuple of float and int
        Range >= 0 in inches and row; inf and NO_WALL where nothing is met.
    """
    nearest, hit = inf, NO_WALL
    for row, (x1, y1, x2, y2) in enumerate(walls):
        # 1. Set up: most walls have both ends clearly on one side, some are wholly behind or farther than the nearest.
        to_x_1, to_y_1, to_x_2, to_y_2 = x1 - x, y1 - y, x2 - x, y2 - y
        side_1, side_2 = dx * to_y_1 - dy * to_x_1, dx * to_y_2 - dy * to_x_2
        if side_1 * side_2 > SAME_SIDE_IN2:
            continue
        ahead_1, ahead_2 = to_x_1 * dx + to_y_1 * dy, to_x_2 * dx + to_y_2 * dy
        if (ahead_1 < -ON_WALL_IN and ahead_2 < -ON_WALL_IN) or (ahead_1 >= nearest and ahead_2 >= nearest):
            continue
        # 2. Intersect.
        range_in = intersect(ahead_1, side_1, ahead_2, side_2)
        # 3. Nearest.
        if -ON_WALL_IN <= range_in < nearest:
            nearest, hit = range_in, row
    return max(nearest, 0.0), hit


def intersect(ahead_1: float, side_1: float, ahead_2: float, side_2: float) -> float:
    """Return the range at which a ray's line meets a wall, from the ends of the wall in the frame of the ray.

    Returns
    -------
    float
        Inches; negative behind the origin, inf where they do not meet.
    """
    on_line_1, on_line_2 = abs(side_1) <= ON_LINE_IN, abs(side_2) <= ON_LINE_IN
    if not (on_line_1 or on_line_2):
        return inf if side_1 * side_2 > 0.0 else float(mean_ahead(ahead_1, side_1, ahead_2, side_2))
    nearer, farther = min(ahead_1, ahead_2), max(ahead_1, ahead_2)
    if on_line_1 and on_line_2:  # the wall is seen end-on
        return farther if farther < 0.0 else max(nearer, 0.0)
    return min(max(float(mean_ahead(ahead_1, side_1, ahead_2, side_2)), nearer), farther)


def mean_ahead(ahead_1: Any, side_1: Any, ahead_2: Any, side_2: Any) -> Any:
    """Return the mean of both `ahead`, each weighted with the other's `side`: where two lines meet; of arrays, too."""
    return (ahead_1 * side_2 - ahead_2 * side_1) / (side_2 - side_1 + _NEVER_ZERO)


def cast_ray(x: float, y: float, dx: float, dy: float, walls: FloatArray) -> tuple[float, int]:
    """Return range and row of `nearest_wall` for walls in an array (m, 4), contiguous, to the same bit.

    Among many walls, those with ends on both sides are selected in arrays first. Some processors round a sum of
    products once, others twice, so the arrays decide no range.
    """
    if len(walls) <= MAX_LOOP_WALLS:
        return nearest_wall(x, y, dx, dy, walls.tolist())
    # An end as a complex number, times the conjugate of the direction, is ahead + i side: one pass over both ends of
    # all walls, and faster than dx * to_y - dy * to_x.
    ends = walls.view(np.complex128)
    sides = ((ends - complex(x, y)) * complex(dx, -dy)).imag
    rows = (sides[:, 0] * sides[:, 1] <= SAME_SIDE_IN2).nonzero()[0]
    nearest, at = nearest_wall(x, y, dx, dy, walls.take(rows, axis=0).tolist())
    return nearest, NO_WALL if at == NO_WALL else int(rows[at])


def sole_wall(x: float, y: float, dx: float, dy: float, walls: WallRows, margin_in: float) -> int:
    """Return the row of the only wall that this ray and all rays near it can meet; NO_WALL if that is uncertain.

    The filter asks this before it casts rays from displaced poses, and most often need not cast them
    (localization/filters/sonar_ray.py).

    Parameters
    ----------
    margin_in
        A ray is near if it moves no end of a wall by more than this in the frame of the ray, nor its origin, inches.

    Returns
    -------
    int
        The condition is sufficient only: for NO_WALL, cast the rays.
    """
    sole = NO_WALL
    origin_side, origin_ahead = dx * y - dy * x, x * dx + y * dy
    for row, (x1, y1, x2, y2) in enumerate(walls):
        # 1. Both ends clearly on one side, or clearly behind: no near ray meets the wall.
        side_1, side_2 = dx * y1 - dy * x1 - origin_side, dx * y2 - dy * x2 - origin_side
        if (side_1 > margin_in and side_2 > margin_in) or (side_1 < -margin_in and side_2 < -margin_in):
            continue
        ahead_1, ahead_2 = x1 * dx + y1 * dy - origin_ahead, x2 * dx + y2 * dy - origin_ahead
        if ahead_1 < -margin_in and ahead_2 < -margin_in:
            continue
        # 2. The distance of the origin from the wall's line, times the wall's length: (p_1 - o) x (p_2 - o).
        cross = ahead_1 * side_2 - ahead_2 * side_1
        # 3. Uncertain unless the ends are clearly on different sides, and the origin is clearly off the wall's line.
        if (
            abs(side_1) <= margin_in
            or abs(side_2) <= margin_in
            or abs(cross) <= margin_in * (abs(x2 - x1) + abs(y2 - y1))
        ):
            return NO_WALL
        # 4. All near rays meet the wall ahead, where range = cross / (side_2 - side_1) is positive, or none does.
        if (cross > 0.0) == (side_2 > side_1):
            if sole != NO_WALL:
                return NO_WALL
            sole = row
    return sole


# Robots, which are discs.


def ray_to_disc(x: float, y: float, dx: float, dy: float, disc: Sequence[float] | FloatArray) -> float:
    """Return the range to the rim of a disc (x, y, radius); 0 from inside, inf where it is not met.

    With the centre `ahead` along the ray and `side` to its left, the rim is met at ahead - sqrt(radius^2 - side^2).
    """
    to_x, to_y, radius = disc[0] - x, disc[1] - y, disc[2]
    ahead, side = to_x * dx + to_y * dy, dx * to_y - dy * to_x
    if abs(side) > radius:
        return inf
    half_chord = sqrt(radius * radius - side * side)
    return inf if ahead + half_chord < 0.0 else max(ahead - half_chord, 0.0)
