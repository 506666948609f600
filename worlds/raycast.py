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
weights, so nothing cancels. Two walls that share an end agree on its side, so no ray passes between them.

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

MAX_SIDE_IN: Final = 4e5
"""No end is farther from the line of a ray: coordinates are at most 1e5 in."""

SAME_SIDE_IN2: Final = ON_LINE_IN * MAX_SIDE_IN
"""If side_1 * side_2 is more than this, both ends are on one side, and neither is on the line: the smaller side is
more than ON_LINE_IN, since the larger is at most MAX_SIDE_IN."""

_NEVER_ZERO: Final = 1e-200
"""Added to a difference of sides: changes only 0, to avoid the division by it."""


# Walls.


def nearest_wall(x: float, y: float, dx: float, dy: float, walls: WallRows) -> tuple[float, int]:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest wall, and its row.

    Walls are closed: a ray through an end meets it. A ray that starts on a wall meets it at range 0, in any direction.
    A wall seen end-on is met at its nearer end.

    Parameters
    ----------
    walls
        Rows x1, y1, x2, y2 of m walls, inches; coordinates at most 1e5 in, which is not checked.

    Returns
    -------
    tuple of float and int
        Range >= 0 in inches and row; inf and NO_WALL where nothing is met.

    Notes
    -----
    Rounding decides whether a ray meets the wall that it starts on if it leaves that wall at less than 1e-5 rad.
    """
    nearest, hit = inf, NO_WALL
    for row, (x1, y1, x2, y2) in enumerate(walls):
        # 1. Set up: most walls have both ends clearly on one side, some are wholly behind or farther than the nearest.
        to_x_1, to_y_1 = x1 - x, y1 - y
        to_x_2, to_y_2 = x2 - x, y2 - y
        side_1 = dx * to_y_1 - dy * to_x_1
        side_2 = dx * to_y_2 - dy * to_x_2
        if side_1 * side_2 > SAME_SIDE_IN2:
            continue
        ahead_1 = to_x_1 * dx + to_y_1 * dy
        ahead_2 = to_x_2 * dx + to_y_2 * dy
        if (ahead_1 < -ON_WALL_IN and ahead_2 < -ON_WALL_IN) or (ahead_1 >= nearest and ahead_2 >= nearest):
            continue
        # 2. Intersect.
        range_in = intersect(ahead_1, side_1, ahead_2, side_2)
        # 3. Nearest.
        if -ON_WALL_IN <= range_in < nearest:
            nearest, hit = range_in, row
    return max(nearest, 0.0), hit


def sort_by_range(rows: list[Any]) -> None:
    """Sort a few rows by their first number, a range, in place; those of equal ranges stay in their order.

    By insertion: to compile `list.sort` takes a fifth of the time that numba needs for the functions that sort here.
    """
    for number in range(1, len(rows)):
        row, place = rows[number], number
        while place > 0 and rows[place - 1][0] > row[0]:
            rows[place] = rows[place - 1]
            place -= 1
        rows[place] = row


def intersect(ahead_1: float, side_1: float, ahead_2: float, side_2: float) -> float:
    """Return the range at which a ray's line meets a wall, from the ends of the wall in the frame of the ray.

    Returns
    -------
    float
        Inches; negative behind the origin, inf where they do not meet.
    """
    on_line_1, on_line_2 = abs(side_1) <= ON_LINE_IN, abs(side_2) <= ON_LINE_IN
    # 1. Neither end is on the line: it meets the wall if they are on different sides of it.
    if not (on_line_1 or on_line_2):
        return inf if side_1 * side_2 > 0.0 else float(mean_ahead(ahead_1, side_1, ahead_2, side_2))
    nearer, farther = min(ahead_1, ahead_2), max(ahead_1, ahead_2)
    # 2. Both are, so the wall lies in the line: behind the origin, or met at its nearer end, or all around the origin.
    if on_line_1 and on_line_2:
        return farther if farther < 0.0 else max(nearer, 0.0)
    # 3. One is, to either side within ON_LINE_IN. If both are on the same side, the mean is beyond that end: limit it
    #    to the wall.
    return min(max(float(mean_ahead(ahead_1, side_1, ahead_2, side_2)), nearer), farther)


def mean_ahead(ahead_1: Any, side_1: Any, ahead_2: Any, side_2: Any) -> Any:
    """Return the mean of both `ahead`, each weighted with the other's `side`: where two lines meet; of arrays, too."""
    return (ahead_1 * side_2 - ahead_2 * side_1) / (side_2 - side_1 + _NEVER_ZERO)


def cast_ray(x: float, y: float, dx: float, dy: float, walls: FloatArray) -> tuple[float, int]:
    """Return range and row of `nearest_wall` for walls in an array (m, 4), contiguous, to the same bit.

    Among many walls, arrays select those whose ends are not clearly on one side, and the loop decides. So it does not
    matter that arrays may round otherwise, where the processor has a fused multiply-add.
    """
    if len(walls) <= MAX_LOOP_WALLS:
        return nearest_wall(x, y, dx, dy, walls.tolist())
    # side = dx to_y - dy to_x is the imaginary part of (to_x + i to_y) (dx - i dy), which takes one pass over all ends.
    ends = walls.view(np.complex128)
    sides = ((ends - complex(x, y)) * complex(dx, -dy)).imag
    rows = (sides[:, 0] * sides[:, 1] <= SAME_SIDE_IN2).nonzero()[0]
    nearest, at = nearest_wall(x, y, dx, dy, walls.take(rows, axis=0).tolist())
    return nearest, NO_WALL if at == NO_WALL else int(rows[at])


def sole_wall(x: float, y: float, dx: float, dy: float, walls: WallRows, margin_in: float) -> int:
    """Return the row of the only wall that this ray and all rays near it can meet; NO_WALL if that is uncertain.

    The filter asks this before it casts rays from displaced poses, and most often need not cast them
    (localization/filters/sonar_ray.py). In the frame of a near ray, each end of a wall has another `ahead` and `side`
    than in the frame of this one, but neither differs by more than the margin. So a wall whose numbers keep their signs
    when they change by the margin is met by all near rays or by none. The condition is sufficient, not necessary.

    Parameters
    ----------
    margin_in
        Near rays start at most so far from this one, and in their frames no `ahead` and `side` differs by more, inches.

    Returns
    -------
    int
        A row, or NO_WALL: then cast the rays.
    """
    sole = NO_WALL
    origin_side, origin_ahead = dx * y - dy * x, x * dx + y * dy
    for row, (x1, y1, x2, y2) in enumerate(walls):
        # 1. Both ends clearly on one side, or clearly behind: no near ray meets the wall.
        side_1 = dx * y1 - dy * x1 - origin_side
        side_2 = dx * y2 - dy * x2 - origin_side
        if (side_1 > margin_in and side_2 > margin_in) or (side_1 < -margin_in and side_2 < -margin_in):
            continue
        ahead_1 = x1 * dx + y1 * dy - origin_ahead
        ahead_2 = x2 * dx + y2 * dy - origin_ahead
        if ahead_1 < -margin_in and ahead_2 < -margin_in:
            continue
        # 2. (p_1 - o) x (p_2 - o): the distance of the origin from the wall's line, times the wall's length, of which
        #    |x2 - x1| + |y2 - y1| is an upper bound.
        cross = ahead_1 * side_2 - ahead_2 * side_1
        is_end_near_line = abs(side_1) <= margin_in or abs(side_2) <= margin_in
        is_origin_near_wall = abs(cross) <= margin_in * (abs(x2 - x1) + abs(y2 - y1))
        if is_end_near_line or is_origin_near_wall:
            return NO_WALL
        # 3. The ends are on different sides, so the line meets the wall at range = cross / (side_2 - side_1): ahead if
        #    both have the same sign.
        is_met = (cross > 0.0) == (side_2 > side_1)
        if is_met:
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
