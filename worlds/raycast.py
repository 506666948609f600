"""The ray caster: the range along a ray to the nearest wall or robot.

Simulated sonars, the filter's prediction of a reading, and the course all call it: `nearest_wall` for walls in lists,
`cast_ray` for walls in an array, `nearest_obstacle` with robots. Rays by the hundred are cast in raycast_arrays.py.

For each wall, from p1 to p2, and a ray from o along the unit vector d:

    1. Set up       the ends in the frame of the ray
                        ahead_i = d . (p_i - o)      distance along the ray
                        side_i  = d x (p_i - o)      distance to its left
    2. Intersect    ends on different sides: the line of the ray divides the wall in the ratio side_1 : -side_2, at
                        range = (ahead_1 side_2 - ahead_2 side_1) / (side_2 - side_1)
    3. Nearest      the smallest range that is not behind

The range is a mean of ahead_1 and ahead_2 with positive weights, so nothing cancels. Two walls that share an end agree
on its side, so no ray passes between them.

References
----------
Ericson, Real-Time Collision Detection (2005): 5.1.9.1 for a segment (signed areas), 5.3.2 for a circle.
"""

import sys
from collections.abc import Iterable, Sequence
from math import inf, sqrt
from typing import Any, Final

import numpy as np

from worlds.compiled import CompiledFunction, is_compiled_for
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
"""Two ends whose sides multiply to more than this lie clearly on one side: no side exceeds 4e5 in."""

FAR_IN: Final = 1e6
"""Farther than any wall."""

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

    Among many walls, those with ends on both sides are selected in arrays: an end times the conjugate of the direction
    is ahead + i side. Some processors round such products once, others twice, so they decide no range.
    """
    if len(walls) <= MAX_LOOP_WALLS:
        return nearest_wall(x, y, dx, dy, walls.tolist())
    sides = ((walls.view(np.complex128) - complex(x, y)) * complex(dx, -dy)).imag
    rows = (sides[:, 0] * sides[:, 1] <= SAME_SIDE_IN2).nonzero()[0]
    nearest, at = nearest_wall(x, y, dx, dy, walls.take(rows, axis=0).tolist())
    return nearest, NO_WALL if at == NO_WALL else int(rows[at])


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


def nearest_disc(
    x: float,
    y: float,
    dx: float,
    dy: float,
    wall_in: float,
    discs: Sequence[Sequence[float]] | FloatArray,
    own: int,
    max_radius_in: float,
    max_range_in: float,
) -> float:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest disc, or to a nearer wall, inches.

    Parameters
    ----------
    wall_in
        Range to the nearest wall, inches; inf for none.
    discs
        Rows x y radius number, sorted by x; number `own` is not met.
    max_radius_in
        No less than any radius.
    max_range_in
        Discs whose x is farther than this are not met.
    """
    # 1. The interval of x in which a disc can be nearer than the wall, and its first row by bisection.
    reach_x = min(wall_in, FAR_IN) * dx
    low = max(x + min(reach_x, 0.0) - max_radius_in, x - max_range_in)
    high = min(x + max(reach_x, 0.0) + max_radius_in, x + max_range_in)
    row, end = 0, len(discs)
    while row < end:
        middle = (row + end) // 2
        if discs[middle][0] < low:
            row = middle + 1
        else:
            end = middle
    # 2. The nearest of the discs in it.
    nearest = wall_in
    while row < len(discs) and discs[row][0] <= high:
        if discs[row][3] != own:
            nearest = min(nearest, ray_to_disc(x, y, dx, dy, discs[row]))
        row += 1
    return nearest


def nearest_obstacle(
    x: float,
    y: float,
    dx: float,
    dy: float,
    walls: FloatArray,
    discs: FloatArray,
    own: int,
    max_radius_in: float,
    max_range_in: float,
) -> float:
    """Return the range to the nearest of walls (m, 4) and discs (k, 4), as `nearest_disc`: what is compiled."""
    rows = zip(walls[:, 0], walls[:, 1], walls[:, 2], walls[:, 3])  # noqa: B905  for numba
    wall_in = nearest_wall(x, y, dx, dy, rows)[0]
    return nearest_disc(x, y, dx, dy, wall_in, discs, own, max_radius_in, max_range_in)


def _example() -> tuple[Any, ...]:
    walls = np.zeros((1, 4))
    walls.setflags(write=False)
    return 0.0, 0.0, 1.0, 0.0, walls, np.zeros((0, 4)), 0, 1.0, 1.0


NEAREST_OBSTACLE: Final = CompiledFunction(nearest_obstacle, lambda: (sys.modules[__name__],), _example)
"""`nearest_obstacle`, for read-only walls, where it is compiled; plain, `cast_ray` and `nearest_disc` are faster."""


def load_compiled(robots: int) -> None:
    """Compile `NEAREST_OBSTACLE`, or load it, if NOMAD_COMPILED asks for it with so many robots."""
    if not NEAREST_OBSTACLE.is_compiled and is_compiled_for(robots):
        NEAREST_OBSTACLE.load()
