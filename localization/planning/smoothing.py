"""Corners of a way made round where that is quicker: a polyline in, lines and arcs out.

    an arc that touches both sides of a corner of turn b at the distance d from it has the radius d / tan(b / 2) and
    passes the corner at d (1 - cos(b / 2)) / sin(b / 2): no farther than `within_in`, so that a way-point is still
    visited, and only where it keeps its distance to all walls

Not quicker: where the steering's speed would have the robot crawl around it longer than stop, turn and go takes.
Rules: pure; a corner is looked at by itself, an arc takes no more than half of either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import cos, hypot, pi, sin, tan
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from localization.planning.circles import SLACK_IN, room
from localization.planning.course import Leg, Stretch, straight, turn_between
from localization.planning.limits import AxisLimits
from localization.planning.profile import BRAKING_SHARE, fastest_in_s

_SHARPEST_RAD = 0.9 * pi
"""Beyond it a corner is a way back."""
_LEAST_RAD = 1e-3
SLOWEST_IN_S: Final = 1.0
"""An arc so tight that it is driven slower than this is a turn in place."""


def rounded(
    points: Sequence[tuple[float, float]], within_in: float, limits: AxisLimits, walls: Floats, radius_in: float
) -> list[Leg]:
    """The legs along points, corners made round within `within_in` of them; arcs keep `radius_in` from all walls."""
    sides = [straight(one, other) for one, other in pairwise(points) if hypot(one[0] - other[0], one[1] - other[1]) > 0]
    arcs = [_arc(one, other, within_in, limits) for one, other in pairwise(sides)]
    arcs = [arc if arc and _clear(arc[0], walls, radius_in) else None for arc in arcs]
    legs: list[Leg] = []
    cut = 0.0
    for side, arc in zip(sides, [*arcs, None], strict=True):
        before, cut = cut, arc[1] if arc else 0.0
        x, y, heading, _ = side.at(before)
        legs.append(Leg(x, y, heading, 0.0, side.length_in - before - cut))
        if arc:
            legs.append(arc[0])
    return legs


def _arc(one: Leg, other: Leg, within_in: float, limits: AxisLimits) -> tuple[Leg, float] | None:
    """The arc instead of a corner, and how much of either side it takes; None where none is quicker."""
    turn = turn_between(one.heading_rad, other.heading_rad)
    if not _LEAST_RAD < abs(turn) < _SHARPEST_RAD:
        return None
    half = 0.5 * abs(turn)
    cut = min(0.5 * one.length_in, 0.5 * other.length_in, within_in * sin(half) / (1.0 - cos(half)))
    radius = cut / tan(half)
    x, y, heading, _ = one.at(one.length_in - cut)
    arc = Leg(x, y, heading, (1.0 if turn > 0.0 else -1.0) / radius, radius * abs(turn))
    speed = fastest_in_s(arc.curvature, limits)
    if speed < SLOWEST_IN_S:
        return None
    return (arc, cut) if _around_s(arc, speed, limits) < _stop_s(2.0 * cut, abs(turn), limits) else None


def _around_s(arc: Leg, speed: float, limits: AxisLimits) -> float:
    """How long the arc takes, slowing down to its speed and getting up to the full one again included."""
    slower = limits.translation_in_s - speed
    return arc.length_in / speed + slower**2 / (BRAKING_SHARE * limits.translation_in_s2 * limits.translation_in_s)


def _stop_s(length: float, turn: float, limits: AxisLimits) -> float:
    """How long the corner takes: its sides, stopping, turning on the spot by a trapezoid, and setting off."""
    top, push = limits.translation_in_s, BRAKING_SHARE * limits.translation_in_s2
    ramp = limits.steering_rad_s / limits.steering_rad_s2
    turning = turn / limits.steering_rad_s + ramp
    if turn < limits.steering_rad_s * ramp:
        turning = 2.0 * float(np.sqrt(turn / limits.steering_rad_s2))
    return length / top + top / push + turning


def _clear(arc: Leg, walls: Floats, radius_in: float) -> bool:
    points = Stretch((arc,)).points(0.25)
    return bool(room(points, walls).min() >= radius_in - SLACK_IN)
