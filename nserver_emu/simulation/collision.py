"""What a round robot touches, and when on its way. Geometry of discs and capsules; no robot, no motors, no time steps.

Whatever can be touched is a capsule: a segment with a thickness. A wall is one of thickness 0, another robot one of
length 0. The gap to a capsule is a convex function of the way along a straight line: once it stops falling it never
falls again, so a robot that touches may leave in every direction in which the gap does not fall.

    path -> chords no farther from it than CHORD_ERROR_IN -> first chord that touches -> Newton on the path itself

Arrays only say which walls are near; the few things that can be touched are looked at in plain numbers.

Bumpers: which of them a touch sets. Pure: directions in, bits out; what touches is found in contact.py.

A touch sets the bumper nearest to its direction, and both neighbours where it lies midway: all that are no farther
from it than half their spacing. Walls and robots reach from the floor to above both rings, so the rings count as one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import ceil, cos, hypot, inf, sin, sqrt, tau
from typing import Final, NamedTuple

from nserver_emu.simulation.segments import Stretch, short_way
from worlds.geometry import FloatArray, nearest_points

CHORD_ERROR_IN: Final = 1e-4
"""Chords stay this near to their arc: a tenth of TOUCH_IN, so that no touch is missed by more than bumpers can tell."""

TOUCH_IN: Final = 1e-3
"""A gap this small is a touch: contacts are found to better than 1e-4 in, rooms and bumpers are worse by far."""

PRESSING: Final = 1e-9
"""Least cosine between motion and wall that presses on: driving along a wall, rounding tilts it by some 1e-16."""

GAP_SOLVED_IN: Final = 1e-10
"""Newton stops when the gap is this small; coordinates up to 1e4 in are rounded at 2e-12."""

MOST_STEPS: Final = 60
"""Newton doubles its digits from 1e-4 in three steps; halving a window of seconds down to GAP_SOLVED_IN takes forty."""


class Contact(NamedTuple):
    """The first touch on a path: when, and the unit vector from the touched thing to the robot's centre."""

    time_s: float
    away_x: float
    away_y: float

    def pressed_by(self, heading_rad: float, velocity: float) -> bool:
        """Whether motion along the heading (backwards where the velocity is negative) presses on."""
        way = self.away_x * cos(heading_rad) + self.away_y * sin(heading_rad)
        return way < -PRESSING if velocity > 0.0 else way > PRESSING


class Thing(NamedTuple):
    """A capsule: the segment from (x1, y1) to (x2, y2), and how thick it is all around, inches."""

    x1: float
    y1: float
    x2: float
    y2: float
    thickness: float = 0.0

    @classmethod
    def disc(cls, x_in: float, y_in: float, radius_in: float) -> Thing:
        """Another robot."""
        return cls(x_in, y_in, x_in, y_in, radius_in)

    def away(self, radius_in: float, x_in: float, y_in: float) -> tuple[float, float, float]:
        """Its gap to a disc, and the unit vector from it to the centre of that.

        With the centre on the thing no direction is right; the vector is then 0, which nothing presses against.
        """
        x1, y1, x2, y2, thickness = self
        along_x, along_y = x2 - x1, y2 - y1
        dx, dy = x_in - x1, y_in - y1
        squared = along_x * along_x + along_y * along_y
        if squared:
            share = min(max((dx * along_x + dy * along_y) / squared, 0.0), 1.0)
            dx, dy = dx - share * along_x, dy - share * along_y
        distance = hypot(dx, dy)
        per = 1.0 / distance if distance else 0.0
        return distance - thickness - radius_in, dx * per, dy * per

    def free_share(self, x_in: float, y_in: float, dx_in: float, dy_in: float, radius_in: float) -> float:
        """The share of a straight way (dx, dy) from (x, y) that a disc can go before it touches; inf if it never does.

        In the frame of the thing, `along` it and `across`: its side is reached where |across| falls to the reach, its
        rounded ends by the quadratic equation of a point and a circle; the nearest of the three that is real counts.
        """
        x1, y1, x2, y2, thickness = self
        reach, length = thickness + radius_in, hypot(x2 - x1, y2 - y1)
        unit_x, unit_y = ((x2 - x1) / length, (y2 - y1) / length) if length else (1.0, 0.0)
        x, y = x_in - x1, y_in - y1
        along, across = x * unit_x + y * unit_y, y * unit_x - x * unit_y
        d_along, d_across = dx_in * unit_x + dy_in * unit_y, dy_in * unit_x - dx_in * unit_y
        beyond = along - min(max(along, 0.0), length)
        distance, way = hypot(beyond, across), hypot(d_along, d_across)
        if beyond * d_along + across * d_across >= -PRESSING * distance * way:
            return inf
        if distance <= reach:
            return 0.0
        share = min(_to_circle(along - end, across, d_along, d_across, reach) for end in (0.0, length))
        closing = -d_across if across > 0.0 else d_across
        if closing > 0.0:
            side = (abs(across) - reach) / closing
            if side >= 0.0 and 0.0 <= along + side * d_along <= length:
                share = min(share, side)
        return share


class Ground:
    """Walls (m, 4), rows x1 y1 x2 y2 in inches."""

    def __init__(self, walls: FloatArray) -> None:
        self.walls = walls

    def near(self, x_in: float, y_in: float, reach_in: float) -> tuple[tuple[Thing, ...], float]:
        """The walls no farther than that from a point, in their order, and how far the nearest of the rest is."""
        _, distances = nearest_points((x_in, y_in), self.walls)
        near = distances <= reach_in
        things = tuple(Thing(*wall) for wall in self.walls[near].tolist())
        return things, float(distances[~near].min(initial=inf))


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


def first_contact(course: Course, radius_in: float, things: Sequence[Thing]) -> Contact | None:
    """Where a disc on its course first touches one of some things, or None if it stays free.

    A disc that touches already, or overlaps, is in contact at 0 s if it presses on; if not, it is free to leave.
    Contacts are found to CHORD_ERROR_IN or better, to GAP_SOLVED_IN unless the path only grazes.
    """
    stretch, duration = course.stretch, course.stretch.duration_s
    sagittas = stretch.length_bound(duration) * stretch.turn_bound(duration) / (8.0 * CHORD_ERROR_IN)
    count = max(1, ceil(sqrt(sagittas)))
    x, y = course.place(0.0)
    for chord in range(count):
        end_x, end_y = course.place(duration * (chord + 1) / count)
        share, row = _first_touched(x, y, end_x - x, end_y - y, radius_in, things)
        if share <= 1.0:
            thing = things[row]
            window = duration * max(chord - 1, 0) / count, duration * min(chord + 2, count) / count
            time = _solve(course, thing, radius_in, duration * (chord + share) / count, window)
            _, away_x, away_y = thing.away(radius_in, *course.place(time))
            return Contact(time, away_x, away_y)
        x, y = end_x, end_y
    return None


def _first_touched(
    x_in: float, y_in: float, dx_in: float, dy_in: float, radius_in: float, things: Sequence[Thing]
) -> tuple[float, int]:
    """The share of a straight way that is free of all things, inf for more than that, and the row of the first met."""
    least, first = inf, 0
    for row, thing in enumerate(things):
        share = thing.free_share(x_in, y_in, dx_in, dy_in, radius_in)
        if share < least:
            least, first = share, row
    return least, first


def _solve(course: Course, thing: Thing, radius_in: float, guess_s: float, window_s: tuple[float, float]) -> float:
    """The time in a window at which the gap is 0: Newton's steps, halves of what is left where they would lead out of
    it; the guess where there is no such time. Robots gather speed, so a guess by the way alone may be off."""
    time, (before_s, after_s) = guess_s, window_s
    for _ in range(MOST_STEPS):
        gap, away_x, away_y = thing.away(radius_in, *course.place(time))
        if abs(gap) < GAP_SOLVED_IN:
            return time
        vx, vy = course.velocity(time)
        rate = away_x * vx + away_y * vy
        if gap > 0.0 > rate:
            before_s = time
        else:
            after_s = time
        newton = time - gap / rate if rate < 0.0 else inf
        time = newton if before_s < newton < after_s else 0.5 * (before_s + after_s)
    return guess_s


def _to_circle(x: float, y: float, dx: float, dy: float, radius: float) -> float:
    """The share of the way (dx, dy) after which the point (x, y), outside, meets the circle around 0; inf if never."""
    squared, dot = dx * dx + dy * dy, x * dx + y * dy
    root = dot * dot - squared * (x * x + y * y - radius * radius)
    return (-dot - sqrt(root)) / squared if root >= 0.0 and dot < 0.0 else inf


MIDWAY_RAD: Final = 1e-6
"""A touch this near to midway is midway: 1e-5 in on the rim, where contacts are found to 1e-4 in at worst."""


def pressed(directions_rad: Iterable[float], bumper_angles_rad: tuple[float, ...]) -> int:
    """Bit i is set where bumper number i is pressed.

    directions_rad      where things touch, in the frame of the bumpers, counter-clockwise
    bumper_angles_rad   of a ring with equal spacing, in the same frame
    """
    half = 0.5 * tau / len(bumper_angles_rad) + MIDWAY_RAD
    bits = 0
    for direction in directions_rad:
        for number, angle in enumerate(bumper_angles_rad):
            if abs(short_way(direction - angle)) <= half:
                bits |= 1 << number
    return bits
