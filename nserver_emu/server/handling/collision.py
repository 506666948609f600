"""Where a line or an arc first meets a wall: the geometry of motion_check. Pure; inches and radians in and out.

The path is the line or arc itself, without the robot's body: a program that wants room asks for a path beside its own.
The normal is the wall's, on the side from which the path comes: it points into the free room.

    on a wall p + t (q - p), 0 <= t <= 1, an arc's circle |p + t (q - p) - c| = r is a quadratic in t
"""

from __future__ import annotations

from math import atan2, copysign, cos, hypot, pi, remainder, sin, tau
from typing import Final, NamedTuple

import numpy as np

from worlds.geometry import FloatArray, nearest_points
from worlds.raycast import cast_rays

TOUCH_IN: Final = 1e-9
"""A path that misses a wall by no more meets it: coordinates up to 1e5 in are rounded at 1e-11."""

SLANT: Final = 1e-9
"""A path steeper to a wall than this comes from one of its sides; one that is not runs along it or touches it."""


class Hit(NamedTuple):
    """The first meeting: where, and the direction of the wall's normal in (-pi, pi]."""

    x_in: float
    y_in: float
    normal_rad: float


class Arc(NamedTuple):
    """Part of a circle, from one polar angle to another: counter-clockwise where the second is the larger one."""

    centre_x_in: float
    centre_y_in: float
    radius_in: float
    from_rad: float
    to_rad: float


def line_hit(start: tuple[float, float], end: tuple[float, float], walls: FloatArray) -> Hit | None:
    """Where the way from `start` to `end` first meets one of the walls (m, 4); None: nowhere."""
    if not len(walls):
        return None
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = hypot(along_x, along_y)
    way = (along_x / length, along_y / length) if length else (1.0, 0.0)
    if not length:
        _, distances = nearest_points(start, walls)
        row = int(distances.argmin())
        met = float(distances[row])
    else:
        ranges, rows = cast_rays(start, way, walls)
        met, row = float(ranges), int(rows)
    if met > length + TOUCH_IN:
        return None
    reach = min(met, length)
    normal = _normal(walls[row].tolist(), way, (-way[0], -way[1]))
    return Hit(start[0] + reach * way[0], start[1] + reach * way[1], normal)


def arc_hit(arc: Arc, walls: FloatArray) -> Hit | None:
    """Where the arc first meets one of the walls (m, 4); None: nowhere."""
    first: tuple[float, float, int] | None = None
    turn = copysign(1.0, arc.to_rad - arc.from_rad)
    sweep = abs(arc.to_rad - arc.from_rad)
    slack = TOUCH_IN / max(arc.radius_in, TOUCH_IN)
    for row, wall in enumerate(walls.tolist()):
        for angle in _circle_angles(arc, wall):
            swept = turn * (angle - arc.from_rad) % tau
            swept = 0.0 if tau - swept <= slack else swept
            if swept <= sweep + slack and (first is None or swept < first[0]):
                first = (swept, angle, row)
    if first is None:
        return None
    _, angle, row = first
    outward = (cos(angle), sin(angle))
    way = (-turn * outward[1], turn * outward[0])
    normal = _normal(walls[row].tolist(), way, (-outward[0], -outward[1]))
    x, y = arc.centre_x_in + arc.radius_in * outward[0], arc.centre_y_in + arc.radius_in * outward[1]
    return Hit(x, y, normal)


def _circle_angles(arc: Arc, wall: list[float]) -> list[float]:
    """The polar angles at which the arc's whole circle meets a wall: none, one or two; of a wall on it, its ends'."""
    x1, y1 = wall[0] - arc.centre_x_in, wall[1] - arc.centre_y_in
    along_x, along_y = wall[2] - wall[0], wall[3] - wall[1]
    length = hypot(along_x, along_y)
    unit_x, unit_y = along_x / length, along_y / length
    foot = -(x1 * unit_x + y1 * unit_y)
    aside = x1 * unit_y - y1 * unit_x
    if abs(aside) > arc.radius_in + TOUCH_IN:
        return []
    half = float(np.sqrt(max((arc.radius_in - aside) * (arc.radius_in + aside), 0.0)))
    places = [place for place in (foot - half, foot + half) if -TOUCH_IN <= place <= length + TOUCH_IN]
    return [atan2(y1 + place * unit_y, x1 + place * unit_x) for place in places]


def _normal(wall: list[float], way: tuple[float, float], aside: tuple[float, float]) -> float:
    """The wall's normal that faces a path going `way`; the one towards `aside` where the path runs along the wall."""
    normal = atan2(wall[2] - wall[0], wall[1] - wall[3])
    facing = cos(normal) * way[0] + sin(normal) * way[1]
    if abs(facing) <= SLANT:
        facing = -(cos(normal) * aside[0] + sin(normal) * aside[1])
    turned = remainder(normal + (pi if facing > 0.0 else 0.0), tau)
    return turned if turned > -pi else pi
