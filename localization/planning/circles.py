"""Circles about the ends of walls, where a round robot's axis may run: which arcs are free, and their common tangents.

    arcs        between the angles where a circle meets the border of any grown wall, all of one kind: free, or not
    tangents    of two circles of one radius: two outer ones, parallel to the line of the centres, and, where they do
                not overlap, two inner ones, crossed at acos(2 radius / distance) from it

Rules: pure plane geometry; inches, radians; no robot, no path.
"""

from __future__ import annotations

from math import acos, atan2, hypot, pi, tau
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from worlds.geometry import nearest_points

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


class Rim:
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
            found.append(not any(bool((blocked & (self._borders < b - _NEAR) & (ends > a + _NEAR)).any())
                                 for a, b in spans if b > a))
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
