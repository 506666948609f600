"""What a round robot touches, and when on its way. Geometry of discs and capsules; no robot, no motors, no time steps.

Whatever can be touched is a capsule: a segment with a thickness. A wall is one of thickness 0, another robot one of
length 0. The gap to a capsule is a convex function of the way along a straight line: once it stops falling it never
falls again, so a robot that touches may leave in every direction in which the gap does not fall.

    path -> chords no farther from it than CHORD_ERROR_IN -> first chord that touches -> Newton on the path itself
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, cos, hypot, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.stretch import Stretch
from worlds.geometry import FloatArray, nearest_points

CHORD_ERROR_IN: Final = 1e-4
"""Chords stay this near to their arc: a tenth of TOUCH_IN, so that no touch is missed by more than bumpers can tell."""

TOUCH_IN: Final = 1e-3
"""A gap this small is a touch: contacts are found to better than 1e-4 in, rooms and bumpers are worse by far."""

PRESSING: Final = 1e-9
"""Least cosine between motion and wall that presses on: driving along a wall, rounding tilts it by some 1e-16."""

GAP_SOLVED_IN: Final = 1e-10
"""Newton stops when the gap is this small; coordinates up to 1e4 in are rounded at 2e-12."""

NEWTON_STEPS: Final = 12
"""Doubling its digits from 1e-4 takes three steps; the rest is for paths that graze or brake to a standstill."""


class Contact(NamedTuple):
    """The first touch on a path: when, and the unit vector from the touched thing to the robot's centre."""

    time_s: float
    away_x: float
    away_y: float

    def pressed_by(self, heading_rad: float, velocity: float) -> bool:
        """Whether motion along the heading (backwards where the velocity is negative) presses on."""
        way = self.away_x * cos(heading_rad) + self.away_y * sin(heading_rad)
        return way < -PRESSING if velocity > 0.0 else way > PRESSING


@dataclass(frozen=True, eq=False)
class Ground:
    """All that can be touched: capsules as segments (m, 4), rows x1 y1 x2 y2, and thickness (m,), inches."""

    segments: FloatArray
    thickness: FloatArray

    @classmethod
    def of(cls, walls: FloatArray, discs: FloatArray | None = None) -> Ground:
        """Walls (m, 4), rows x1 y1 x2 y2, and discs (k, 3), rows x y radius, inches."""
        round_things = np.empty((0, 3)) if discs is None else discs
        segments = np.concatenate((walls, round_things[:, [0, 1, 0, 1]]))
        return cls(segments, np.concatenate((np.zeros(len(walls)), round_things[:, 2])))

    def clearance(self, x_in: float, y_in: float) -> float:
        """Distance from a point to the nearest thing, inches; inf where there is none."""
        _, distances = nearest_points((x_in, y_in), self.segments)
        return float((distances - self.thickness).min(initial=np.inf))

    def touched(self, x_in: float, y_in: float, reach_in: float) -> FloatArray:
        """Directions (k,) in which things lie no farther than `reach_in` from a point, radians."""
        nearest, distances = nearest_points((x_in, y_in), self.segments)
        close = distances - self.thickness <= reach_in
        towards: FloatArray = np.arctan2(nearest[close, 1] - y_in, nearest[close, 0] - x_in)
        return towards

    def away(self, row: int, radius_in: float, x_in: float, y_in: float) -> tuple[float, float, float]:
        """Gap between thing number `row` and a disc, and the unit vector from the one to the centre of the other.

        With the centre on the thing no direction is right; the vector is then 0, which nothing presses against.
        """
        x1, y1, x2, y2 = self.segments[row].tolist()
        along_x, along_y = x2 - x1, y2 - y1
        squared = along_x * along_x + along_y * along_y
        share = ((x_in - x1) * along_x + (y_in - y1) * along_y) / squared if squared else 0.0
        share = min(max(share, 0.0), 1.0)
        dx, dy = x_in - x1 - share * along_x, y_in - y1 - share * along_y
        distance = hypot(dx, dy)
        per = 1.0 / distance if distance else 0.0
        return distance - float(self.thickness[row]) - radius_in, dx * per, dy * per


class Course(NamedTuple):
    """A stretch laid into the plane: where it starts, in inches, and with which heading, in radians."""

    x_in: float
    y_in: float
    heading_rad: float
    stretch: Stretch

    def place(self, time_s: float) -> tuple[float, float]:
        """(x, y) in inches, `time_s` into the stretch."""
        dx, dy = self.stretch.displacement(self.heading_rad, time_s)
        return self.x_in + dx, self.y_in + dy

    def velocity(self, time_s: float) -> tuple[float, float]:
        """(vx, vy) in in/s, `time_s` into the stretch."""
        speed = self.stretch.velocity_at(time_s)
        heading = self.heading_rad + self.stretch.turn_at(time_s)
        return speed * cos(heading), speed * sin(heading)


def first_contact(course: Course, radius_in: float, ground: Ground) -> Contact | None:
    """Where a disc on its course first touches the ground, or None if it stays free.

    A disc that touches already, or overlaps, is in contact at 0 s if it presses on; if not, it is free to leave.
    Contacts are found to CHORD_ERROR_IN or better, to GAP_SOLVED_IN unless the path only grazes.
    """
    stretch, duration = course.stretch, course.stretch.duration_s
    sagittas = stretch.length_bound(duration) * stretch.turn_bound(duration) / (8.0 * CHORD_ERROR_IN)
    count = max(1, ceil(sqrt(sagittas)))
    times = [duration * number / count for number in range(count + 1)]
    hit = first_chord(np.array([course.place(time) for time in times]), radius_in, ground)
    if hit is None:
        return None
    chord, share, row = hit
    guess = times[chord] + share * (times[chord + 1] - times[chord])
    window = times[max(chord - 1, 0)], times[min(chord + 2, count)]
    time = _solve(course, lambda x, y: ground.away(row, radius_in, x, y), guess, window)
    _, away_x, away_y = ground.away(row, radius_in, *course.place(time))
    return Contact(time, away_x, away_y)


def _solve(
    course: Course,
    away: Callable[[float, float], tuple[float, float, float]],
    guess_s: float,
    window_s: tuple[float, float],
) -> float:
    """The time in a window at which a gap is 0, by Newton's method; the guess where it does not converge.

    away    the gap at a place, inches, and the unit vector along which it grows
    """
    time = guess_s
    for _ in range(NEWTON_STEPS):
        gap, away_x, away_y = away(*course.place(time))
        if abs(gap) < GAP_SOLVED_IN:
            return time
        vx, vy = course.velocity(time)
        rate = away_x * vx + away_y * vy
        if rate >= 0.0:
            break
        time = min(max(time - gap / rate, window_s[0]), window_s[1])
    return guess_s


def first_chord(points: FloatArray, radius_in: float, ground: Ground) -> tuple[int, float, int] | None:
    """The first of the n chords between points (n + 1, 2) on which a disc touches.

    Returns (chord, share of it that is free in [0, 1], row of the thing touched), or None.
    """
    shares = _free_shares(points[:-1, None], np.diff(points, axis=0)[:, None], radius_in, ground)
    touching = np.flatnonzero((shares <= 1.0).any(axis=1))
    if not touching.size:
        return None
    chord = int(touching[0])
    row = int(shares[chord].argmin())
    return chord, float(shares[chord, row]), row


def _free_shares(starts: FloatArray, ways: FloatArray, radius_in: float, ground: Ground) -> FloatArray:
    """Shares (n, m) of n straight ways (n, 1, 2) that a disc can go before it touches each of m things, inf if none.

    In the frame of each thing, `along` it and `across`: its side is reached where |across| falls to the reach, its
    rounded ends by the quadratic equation of a point and a circle; the nearest of the three that is real counts.
    """
    first, axis = ground.segments[:, :2], ground.segments[:, 2:] - ground.segments[:, :2]
    length = np.hypot(axis[:, 0], axis[:, 1])
    unit = axis / np.where(length > 0.0, length, 1.0)[:, None]
    unit[length == 0.0] = (1.0, 0.0)
    offset, reach = starts - first, ground.thickness + radius_in
    along, across = (offset * unit).sum(-1), offset[..., 1] * unit[:, 0] - offset[..., 0] * unit[:, 1]
    d_along, d_across = (ways * unit).sum(-1), ways[..., 1] * unit[:, 0] - ways[..., 0] * unit[:, 1]
    beyond = along - np.clip(along, 0.0, length)
    distance, far = np.hypot(beyond, across), np.hypot(d_along, d_across)
    falls = beyond * d_along + across * d_across < -PRESSING * distance * far
    closing = np.where(across > 0.0, -d_across, d_across)
    side = (np.abs(across) - reach) / np.where(closing > 0.0, closing, np.nan)
    met = along + side * d_along
    shares = np.where((side >= 0.0) & (met >= 0.0) & (met <= length), side, np.inf)
    for end in (np.zeros_like(length), length):
        shares = np.fmin(shares, _to_circle(along - end, across, d_along, d_across, reach))
    return np.where(falls, np.where(distance <= reach, 0.0, shares), np.inf)


def _to_circle(x: FloatArray, y: FloatArray, dx: FloatArray, dy: FloatArray, radius: FloatArray) -> FloatArray:
    """The share of the way (dx, dy) after which the point (x, y), outside, meets the circle around 0; inf if never."""
    squared, dot = dx * dx + dy * dy, x * dx + y * dy
    root = dot * dot - squared * (x * x + y * y - radius * radius)
    meets = (root >= 0.0) & (dot < 0.0)
    share: FloatArray = (-dot - np.sqrt(np.where(meets, root, 0.0))) / np.where(squared > 0.0, squared, 1.0)
    return np.where(meets, share, np.inf)
