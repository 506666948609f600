"""One ray in plain numbers: where it meets a wall, a disc, and the first of many. raycast.py does the same in arrays.

All of it is written so that compiled.py can make machine code of it: loops, numbers, rows of arrays. numba keeps that
code for as long as this file stays what it is, so whatever a function here calls stands in this file too.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, sqrt
from typing import Final

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
