"""A way for a robot to drive: straight legs and arcs, one after another. Values and their geometry.

    Leg         from a point, in a direction, of a curvature (1/in, left positive, 0 straight), so long
    Stretch     legs that go on in one another's direction: driven without stopping
    a course is stretches; between two of them the robot turns in place

Rules: pure; inches, radians. No speed, no robot.

Circles about the ends of walls, where a round robot's axis may run: which arcs are free, and their common tangents.

    arcs        between the angles where a circle meets the border of any grown wall, all of one kind: free, or not
    tangents    of two circles of one radius: two outer ones, parallel to the line of the centres, and, where they do
                not overlap, two inner ones, crossed at acos(2 radius / distance) from it

Rules: pure plane geometry; inches, radians; no robot, no path.

How fast to go along a stretch: as fast as the axes can, with room to turn into every arc and to stop at its end.

    v |c| <= w                              the steering's speed w, on an arc of curvature c
    v^4 |c|^3 / (24 a^2) <= SHIFT_IN        its acceleration a: a heading that ramps up to v c over v c / a seconds,
                                            half of them before the arc begins, runs beside it by this (the shift
                                            of a railway's easement, l^2 c / 24, with l = v^2 c / a)
    v dv/ds <= translation's acceleration   in both directions; 0 at the end

Rules: pure; a profile is made once for a stretch, and asked where the robot is.

Corners of a way made round where that is quicker: a polyline in, lines and arcs out.

    an arc that touches both sides of a corner of turn b at the distance d from it has the radius d / tan(b / 2) and
    passes the corner at d (1 - cos(b / 2)) / sin(b / 2): no farther than `within_in`, so that a way-point is still
    visited, and only where it keeps its distance to all walls

Not quicker: where the steering's speed would have the robot crawl around it longer than stop, turn and go takes.
Rules: pure; a corner is looked at by itself, an arc takes no more than half of either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import acos, atan2, ceil, copysign, cos, hypot, inf, pi, remainder, sin, sqrt, tan, tau
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.speed import AxisLimits
from worlds.geometry import nearest_points

SAME_WAY_RAD: Final = 0.02
"""Legs whose directions differ by less go on in one another: 0.3 in/s sideways at the N150's top speed."""
SHORTEST_IN: Final = 1e-6
_STRAIGHT: Final = 1e-9


class Place(NamedTuple):
    """A point of a way, its direction, and how it curves there."""

    x_in: float
    y_in: float
    heading_rad: float
    curvature: float


class Leg(NamedTuple):
    """See the head of this file."""

    x_in: float
    y_in: float
    heading_rad: float
    curvature: float
    length_in: float

    def at(self, along_in: float) -> Place:
        """The place so far along it."""
        turn = self.curvature * along_in
        chord = along_in * float(np.sinc(0.5 * turn / pi))
        middle = self.heading_rad + 0.5 * turn
        return Place(
            self.x_in + chord * cos(middle), self.y_in + chord * sin(middle), self.heading_rad + turn, self.curvature
        )

    def nearest(self, x_in: float, y_in: float) -> float:
        """How far along it is nearest to a point."""
        dx, dy = x_in - self.x_in, y_in - self.y_in
        ahead = dx * cos(self.heading_rad) + dy * sin(self.heading_rad)
        if abs(self.curvature) < _STRAIGHT:
            return min(max(ahead, 0.0), self.length_in)
        curved = abs(self.curvature)
        inside = (dy * cos(self.heading_rad) - dx * sin(self.heading_rad)) * copysign(1.0, self.curvature)
        along = atan2(curved * ahead, 1.0 - curved * inside) % tau / curved
        if along <= self.length_in:
            return along
        last = self.at(self.length_in)
        return 0.0 if hypot(dx, dy) < hypot(x_in - last.x_in, y_in - last.y_in) else self.length_in


def straight(start: Sequence[float], end: Sequence[float]) -> Leg:
    """The leg from one point to another."""
    dx, dy = float(end[0] - start[0]), float(end[1] - start[1])
    return Leg(float(start[0]), float(start[1]), atan2(dy, dx), 0.0, hypot(dx, dy))


@dataclass(frozen=True)
class Stretch:
    """Legs that go on in one another's direction, at least one."""

    legs: tuple[Leg, ...]

    @cached_property
    def starts_in(self) -> Floats:
        """How far along each leg begins, and the length of all: (legs + 1,)."""
        return np.concatenate(([0.0], np.cumsum([leg.length_in for leg in self.legs])))

    @property
    def length_in(self) -> float:
        """Of all legs together."""
        return float(self.starts_in[-1])

    def at(self, along_in: float) -> Place:
        """The place so far along it; its ends beyond them."""
        along = min(max(along_in, 0.0), self.length_in)
        number = min(int(np.searchsorted(self.starts_in, along, side="right")) - 1, len(self.legs) - 1)
        return self.legs[number].at(along - float(self.starts_in[number]))

    def nearest(self, x_in: float, y_in: float, first_in: float = 0.0, last_in: float = inf) -> float:
        """How far along it is nearest to a point, looking from `first_in` to `last_in`."""
        best, found = inf, first_in
        for leg, start in zip(self.legs, self.starts_in, strict=False):
            if start > last_in or start + leg.length_in < first_in:
                continue
            along = min(max(float(start) + leg.nearest(x_in, y_in), first_in), last_in, self.length_in)
            place = self.at(along)
            far = hypot(place.x_in - x_in, place.y_in - y_in)
            if far < best:
                best, found = far, along
        return found

    def points(self, step_in: float, first_in: float = 0.0) -> Floats:
        """Points (n, 2) along it from `first_in` on, no farther apart than `step_in`, its end included."""
        count = max(1, int(np.ceil((self.length_in - first_in) / step_in)))
        return np.array([self.at(along)[:2] for along in np.linspace(first_in, self.length_in, count + 1)])


def stretches(legs: Sequence[Leg]) -> tuple[Stretch, ...]:
    """The course that legs make, those without a length left out."""
    groups: list[list[Leg]] = []
    for leg in legs:
        if leg.length_in <= SHORTEST_IN:
            continue
        before = groups[-1][-1] if groups else None
        if before and abs(angle_difference(before.at(before.length_in).heading_rad, leg.heading_rad)) <= SAME_WAY_RAD:
            groups[-1].append(leg)
        else:
            groups.append([leg])
    return tuple(Stretch(tuple(group)) for group in groups)


def waypoints(legs: Sequence[Leg], step_in: float = 3.0) -> list[tuple[float, float]]:
    """The ends of all legs, and points of the curved ones no farther apart than `step_in`: for who drives to points."""
    found = []
    for leg in legs:
        count = max(1, int(np.ceil(leg.length_in / step_in))) if leg.curvature else 1
        found += [leg.at(leg.length_in * number / count)[:2] for number in range(1, count + 1)]
    return found


def length_of(course: Sequence[Stretch]) -> float:
    """The length of a course in inches."""
    return sum(stretch.length_in for stretch in course)


def angle_difference(first_rad: float, second_rad: float) -> float:
    """The short turn from one direction to another, in [-pi, pi]."""
    return remainder(second_rad - first_rad, tau)


SLACK_IN: Final = 1e-6
"""A way that touches a grown wall is free, whatever rounding says."""
_NEAR: Final = 1e-12


def room(points: Floats, walls: Floats) -> Floats:
    """The distance (n,) of points (n, 2) to the nearest wall; inf where there is none."""
    if not len(walls):
        return np.full(len(points), np.inf)
    _, far = nearest_points(points, walls)
    nearest: Floats = far.min(axis=1)
    return nearest


class CornerCircle:
    """The circle of a radius about an end of a wall, and which parts of it are that far from all walls."""

    def __init__(self, centre: Floats, walls: Floats, radius_in: float) -> None:
        borders = np.unique(np.concatenate(([0.0], _borders(centre, walls, radius_in))))
        middles = borders + 0.5 * np.diff(borders, append=borders[0] + tau)
        points = centre + radius_in * np.stack((np.cos(middles), np.sin(middles)), axis=-1)
        self._borders = borders
        self._free = room(points, walls) >= radius_in - SLACK_IN

    def free(self, angles: Floats) -> list[bool]:
        """For n > 0 angles sorted in [0, 2 pi): whether the arc from each to the next, around to the first, is free."""
        blocked = ~self._free
        ends = np.append(self._borders[1:], tau)
        found = []
        for first, last in zip(angles, np.append(angles[1:], angles[0] + tau), strict=True):
            spans = [(first, min(last, tau)), (0.0, last - tau)]
            found.append(
                not any(
                    bool((blocked & (self._borders < b - _NEAR) & (ends > a + _NEAR)).any()) for a, b in spans if b > a
                )
            )
        return found


def _borders(centre: Floats, walls: Floats, radius_in: float) -> Floats:
    """Where the circle meets the border of a wall grown by the same radius, angles in [0, 2 pi)."""
    found: list[float] = []
    for x1, y1, x2, y2 in (walls - np.tile(centre, 2)).tolist():
        for x, y in ((x1, y1), (x2, y2)):
            far = hypot(x, y)
            if _NEAR < far <= 2.0 * radius_in:
                found += [atan2(y, x) + side * acos(0.5 * far / radius_in) for side in (-1.0, 1.0)]
        length = hypot(x2 - x1, y2 - y1)
        if length <= _NEAR:
            continue
        normal, offset = atan2(x2 - x1, y1 - y2), (x2 * y1 - x1 * y2) / length
        for line in (offset - radius_in, offset + radius_in):
            if abs(line) <= radius_in + SLACK_IN:
                turn = acos(max(-1.0, min(1.0, line / radius_in)))
                found += [normal - turn, normal + turn]
    return np.array(found) % tau


def tangents(centres: Floats, radius_in: float) -> tuple[Floats, np.typing.NDArray[np.intp]]:
    """All common tangents of circles (n, 2): angles (k, 2) of their two ends, and the circles (k, 2) these lie on."""
    one, other = np.triu_indices(len(centres), 1)
    way = centres[other] - centres[one]
    far, along = np.hypot(way[:, 0], way[:, 1]), np.arctan2(way[:, 1], way[:, 0])
    apart = far >= 2.0 * radius_in
    cross = np.arccos(np.minimum(1.0, 2.0 * radius_in / far))
    angles, circles = [], []
    for side in (-1.0, 1.0):
        outer = along + side * 0.5 * pi
        angles.append(np.stack((outer, outer), axis=-1))
        inner = (along + side * cross)[apart]
        angles.append(np.stack((inner, inner + pi), axis=-1))
        pair = np.stack((one, other), axis=-1)
        circles += [pair, pair[apart]]
    return np.concatenate(angles) % tau, np.concatenate(circles)


def tangents_from(point: Floats, centres: Floats, radius_in: float) -> tuple[Floats, np.typing.NDArray[np.intp]]:
    """The tangents from a point to circles (n, 2): angles (k,) of where they touch, and the circles (k,)."""
    way = point - centres
    far, along = np.hypot(way[:, 0], way[:, 1]), np.arctan2(way[:, 1], way[:, 0])
    outside = np.flatnonzero(far >= radius_in)
    turn = np.arccos(radius_in / far[outside])
    angles = np.concatenate((along[outside] - turn, along[outside] + turn)) % tau
    return angles, np.concatenate((outside, outside))


def on_circles(centres: Floats, circles: np.typing.NDArray[np.intp], angles: Floats, radius_in: float) -> Floats:
    """The points (k, 2) at angles (k,) on circles (k,)."""
    points: Floats = centres[circles] + radius_in * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    return points


SHIFT_IN: Final = 0.1
"""How far beside an arc the steering's ramp may lead."""
STEP_IN: Final = 0.25
BRAKING_SHARE: Final = 0.5
"""Of the translation's acceleration that is planned with: the rest is the controller's."""
APPROACH_HZ: Final = 2.0
"""Near the end no more than this share of the way that is left in a second: the estimate moves as well."""
CREEP_IN_S: Final = 0.5
"""The slowest that anything is driven at, so that it ends."""


def fastest_in_s(curvature: float, limits: AxisLimits) -> float:
    """The highest speed on an arc."""
    if not curvature:
        return limits.translation_in_s
    curved = abs(curvature)
    turning = limits.steering_rad_s / curved
    easing: float = (24.0 * limits.steering_rad_s2**2 * SHIFT_IN / curved**3) ** 0.25
    return min(limits.translation_in_s, turning, easing)


class SpeedProfile:
    """The speeds of a stretch; `duration_s` is what driving it takes."""

    def __init__(self, stretch: Stretch, limits: AxisLimits) -> None:
        count = max(3, ceil(stretch.length_in / STEP_IN) + 1)
        self._along = np.linspace(0.0, stretch.length_in, count)
        speeds = self._tops(stretch, limits)
        push = 2.0 * BRAKING_SHARE * limits.translation_in_s2 * float(self._along[1])
        speeds[0] = speeds[-1] = 0.0
        for way in (range(1, count), range(count - 2, -1, -1)):
            for k in way:
                near = speeds[k - 1] if way.step > 0 else speeds[k + 1]
                speeds[k] = min(speeds[k], sqrt(near * near + push))
        self._speeds = np.array(speeds)
        self._limits, self._end = limits, stretch.length_in
        steps = float(self._along[1])
        self.duration_s = sum(2.0 * steps / (one + other) for one, other in pairwise(speeds))

    def _tops(self, stretch: Stretch, limits: AxisLimits) -> list[float]:
        """The highest speed at each point, by the legs that meet there."""
        tops = np.full(len(self._along), limits.translation_in_s)
        for leg, start in zip(stretch.legs, stretch.starts_in, strict=False):
            there = (self._along >= start - STEP_IN) & (self._along <= start + leg.length_in + STEP_IN)
            tops[there] = np.minimum(tops[there], fastest_in_s(leg.curvature, limits))
        speeds: list[float] = tops.tolist()
        return speeds

    def speed_in_s(self, along_in: float) -> float:
        """The speed so far along; what stops it at the end, and no slower than CREEP_IN_S before.

        Where it sets off the next step's speed counts: at the very first it would be 0 for ever.
        """
        ahead = float(np.interp(min(along_in + STEP_IN, 0.5 * (along_in + self._end)), self._along, self._speeds))
        approach = CREEP_IN_S + APPROACH_HZ * (self._end - along_in)
        return max(CREEP_IN_S, min(self._limits.translation_in_s, ahead, approach))


_SHARPEST_RAD = 0.9 * pi
"""Beyond it a corner is a way back."""
_LEAST_RAD = 1e-3
SLOWEST_IN_S: Final = 1.0
"""An arc so tight that it is driven slower than this is a turn in place."""


def round_corners(
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
    turn = angle_difference(one.heading_rad, other.heading_rad)
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
