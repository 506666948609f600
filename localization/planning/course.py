"""A way for a robot to drive: straight legs and arcs, one after another. Values and their geometry.

    Leg         from a point, in a direction, of a curvature (1/in, left positive, 0 straight), so long
    Stretch     legs that go on in one another's direction: driven without stopping
    a course is stretches; between two of them the robot turns in place

Rules: pure; inches, radians. No speed, no robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan2, copysign, cos, hypot, inf, pi, remainder, sin, tau
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats

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
        if before and abs(turn_between(before.at(before.length_in).heading_rad, leg.heading_rad)) <= SAME_WAY_RAD:
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


def turn_between(first_rad: float, second_rad: float) -> float:
    """The short turn from one direction to another, in [-pi, pi]."""
    return remainder(second_rad - first_rad, tau)
