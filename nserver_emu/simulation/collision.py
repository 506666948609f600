"""Contact of a round robot with walls and other robots: where on its path, and which bumpers it sets.

Every obstacle is a capsule: a line segment with a radius. A wall has radius 0, another robot has length 0. The gap to a
capsule is a convex function of the distance along a straight line: once it stops falling it never falls again, so a
robot in contact may leave in every direction in which the gap does not fall.

    path -> chords no farther from it than CHORD_ERROR_IN -> first chord that touches -> Newton on the path itself

Arrays only select the walls nearby; the few candidates are examined in plain numbers.

A touch sets the bumper nearest to its direction, and both neighbours where it lies midway between them: all bumpers
that are no farther from it than half their spacing. Walls and robots reach from the floor to above both bands of
bumpers, so the bands count as one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import ceil, cos, inf, sin, sqrt, tau
from typing import Final, NamedTuple

from nserver_emu.simulation.segments import ConstantAccelerationSegment, wrap_to_pi
from worlds.geometry import FloatArray, near_walls, nearest_points

CHORD_ERROR_IN: Final = 1e-4
"""Largest distance of a chord from its arc: a tenth of TOUCH_IN, so that no touch is missed by more than bumpers
resolve."""

TOUCH_IN: Final = 1e-3
"""A gap this small is a touch: contacts are located to better than 1e-4 in, real rooms and bumpers are far coarser."""

PRESSING: Final = 1e-9
"""Smallest cosine between motion and wall that counts as pressing: driving along a wall, rounding tilts it by 1e-16."""

GAP_SOLVED_IN: Final = 1e-10
"""Newton's method stops at a gap this small; coordinates up to 1e4 in are rounded at 2e-12."""

MAX_STEPS: Final = 60
"""Newton doubles the digits of 1e-4 in three steps; bisecting a window of seconds to GAP_SOLVED_IN takes forty."""

AROUND_IN: Final = 240.0
"""Of many walls, those so much farther away than searched are examined first."""

MIDWAY_RAD: Final = 1e-6
"""A touch this near to midway between two bumpers sets both: 1e-5 in on the rim; contacts are located to 1e-4 in."""


class Contact(NamedTuple):
    """The first touch on a path: its time, and the unit vector from the obstacle to the robot's centre."""

    time_s: float
    away_x: float
    away_y: float

    def pressed_by(self, heading_rad: float, velocity: float) -> bool:
        """Return True if motion along the heading (backwards where the velocity is negative) presses on."""
        outward = self.away_x * cos(heading_rad) + self.away_y * sin(heading_rad)
        return outward < -PRESSING if velocity > 0.0 else outward > PRESSING


NO_CONTACT: Final = Contact(inf, 0.0, 0.0)
"""The contact of a path that stays free."""


class Capsule(NamedTuple):
    """The segment from (x1, y1) to (x2, y2) with a radius, inches."""

    x1: float
    y1: float
    x2: float
    y2: float
    radius: float = 0.0

    @classmethod
    def disc(cls, x_in: float, y_in: float, radius_in: float) -> Capsule:
        """Return the capsule of another robot."""
        return cls(x_in, y_in, x_in, y_in, radius_in)

    def gap_to(self, radius_in: float, x_in: float, y_in: float) -> tuple[float, float, float]:
        """Return the gap to a disc, and the unit vector from the capsule to the disc's centre.

        With the centre on the segment no direction is right; the vector is then 0, which nothing presses against.
        """
        x1, y1, x2, y2, radius = self
        along_x, along_y = x2 - x1, y2 - y1
        dx, dy = x_in - x1, y_in - y1
        squared = along_x * along_x + along_y * along_y
        if squared:
            fraction = min(max((dx * along_x + dy * along_y) / squared, 0.0), 1.0)
            dx, dy = dx - fraction * along_x, dy - fraction * along_y
        distance = _length(dx, dy)
        per = 1.0 / distance if distance else 0.0
        return distance - radius - radius_in, dx * per, dy * per

    def free_fraction(self, x_in: float, y_in: float, dx_in: float, dy_in: float, radius_in: float) -> float:
        """Return the fraction of a straight path (dx, dy) from (x, y) free for a disc; inf if it never touches."""
        # 1. The path in the frame of the capsule, `along` its segment and `across` it.
        x1, y1, x2, y2, radius = self
        reach, length = radius + radius_in, _length(x2 - x1, y2 - y1)
        unit_x, unit_y = ((x2 - x1) / length, (y2 - y1) / length) if length else (1.0, 0.0)
        x, y = x_in - x1, y_in - y1
        along, across = x * unit_x + y * unit_y, y * unit_x - x * unit_y
        d_along, d_across = dx_in * unit_x + dy_in * unit_y, dy_in * unit_x - dx_in * unit_y
        # 2. A path that does not approach never touches; one that starts in contact is blocked at once.
        beyond = along - min(max(along, 0.0), length)
        distance, travel = _length(beyond, across), _length(d_along, d_across)
        if beyond * d_along + across * d_across >= -PRESSING * distance * travel:
            return inf
        if distance <= reach:
            return 0.0
        # 3. The rounded ends: the quadratic equation of a point and a circle.
        fraction = _to_circle(along, across, d_along, d_across, reach)
        fraction = min(fraction, _to_circle(along - length, across, d_along, d_across, reach))
        # 4. The side, which is reached where |across| falls to the sum of the radii.
        closing = -d_across if across > 0.0 else d_across
        if closing > 0.0:
            side = (abs(across) - reach) / closing
            if side >= 0.0 and 0.0 <= along + side * d_along <= length:
                fraction = min(fraction, side)
        return fraction


def walls_within(x_in: float, y_in: float, distance_in: float,
                 walls: FloatArray) -> tuple[tuple[Capsule, ...], float]:
    """Return the walls (m, 4) within a distance of a point, in their order, and the distance of the nearest other one.

    Rows are x1 y1 x2 y2 in inches.
    """
    # Among many walls only those around, unless the nearest other one is farther away.
    reach_in = distance_in + AROUND_IN
    around = near_walls(x_in, y_in, reach_in, walls)
    found, nearest_other_in = _within(x_in, y_in, distance_in, around)
    if nearest_other_in > reach_in and len(around) < len(walls):
        found, nearest_other_in = _within(x_in, y_in, distance_in, walls)
    return tuple(Capsule(*wall) for wall in found.tolist()), nearest_other_in


def _within(x_in: float, y_in: float, distance_in: float, walls: FloatArray) -> tuple[FloatArray, float]:
    """Return the walls (k, 4) within a distance of a point, and the distance of the nearest other one."""
    _, distances = nearest_points((x_in, y_in), walls)
    near = distances <= distance_in
    return walls[near], float(distances[~near].min(initial=inf))


class PlacedSegment(NamedTuple):
    """A segment in the plane: its start in inches, its heading there in radians."""

    x_in: float
    y_in: float
    heading_rad: float
    segment: ConstantAccelerationSegment

    def position(self, time_s: float) -> tuple[float, float]:
        """Return (x, y) in inches, `time_s` into the segment."""
        dx, dy = self.segment.displacement(self.heading_rad, time_s)
        return self.x_in + dx, self.y_in + dy

    def velocity_vector(self, time_s: float) -> tuple[float, float]:
        """Return (vx, vy) in in/s, `time_s` into the segment."""
        speed = self.segment.velocity_at(time_s)
        heading = self.heading_rad + self.segment.turn_at(time_s)
        return speed * cos(heading), speed * sin(heading)


def first_contact(placed: PlacedSegment, radius_in: float, capsules: Sequence[Capsule]) -> Contact | None:
    """Return `find_contact`, or None if the path stays free."""
    contact = find_contact(placed, radius_in, capsules)
    return contact if contact.time_s < inf else None


def find_contact(placed: PlacedSegment, radius_in: float, capsules: Sequence[Capsule]) -> Contact:
    """Return the first contact of a disc on its path with any of the capsules; NO_CONTACT if it stays free.

    A disc that touches already, or overlaps, is in contact at 0 s if it presses on; otherwise it is free to leave.
    Contacts are located to CHORD_ERROR_IN or better, to GAP_SOLVED_IN unless the path only grazes.
    """
    segment, duration = placed.segment, placed.segment.duration_s
    # 1. As many chords as keep them near the arc: the sagitta of an arc is length x turn / 8.
    sagittas = segment.length_bound(duration) * segment.turn_bound(duration) / (8.0 * CHORD_ERROR_IN)
    count = max(1, ceil(sqrt(sagittas)))
    x, y = placed.position(0.0)
    for chord in range(count):
        # 2. The first capsule that the disc touches on this chord.
        end_x, end_y = placed.position(duration * (chord + 1) / count)
        fraction, row = _first_touched(x, y, end_x - x, end_y - y, radius_in, capsules)
        if fraction <= 1.0:
            # 3. The exact time on the path, near that chord.
            capsule = capsules[row]
            window = duration * max(chord - 1, 0) / count, duration * min(chord + 2, count) / count
            time = _solve(placed, capsule, radius_in, duration * (chord + fraction) / count, window)
            x, y = placed.position(time)
            _, away_x, away_y = capsule.gap_to(radius_in, x, y)
            return Contact(time, away_x, away_y)
        x, y = end_x, end_y
    return NO_CONTACT


def _first_touched(x_in: float, y_in: float, dx_in: float, dy_in: float, radius_in: float,
                   capsules: Sequence[Capsule]) -> tuple[float, int]:
    """Return the free fraction of a straight path (inf: all of it), and the row of the first capsule touched."""
    smallest, first = inf, 0
    for row, capsule in enumerate(capsules):
        fraction = capsule.free_fraction(x_in, y_in, dx_in, dy_in, radius_in)
        if fraction < smallest:
            smallest, first = fraction, row
    return smallest, first


def _solve(placed: PlacedSegment, capsule: Capsule, radius_in: float, guess_s: float,
           window_s: tuple[float, float]) -> float:
    """Return the time in a window at which the gap is 0; the guess where there is no such time.

    Newton's steps, and bisection where they would leave the window: robots accelerate, so a guess by distance alone may
    be off.
    """
    time, (before_s, after_s) = guess_s, window_s
    for _ in range(MAX_STEPS):
        # The rate of the gap is the velocity along the direction away from the capsule.
        x, y = placed.position(time)
        gap, away_x, away_y = capsule.gap_to(radius_in, x, y)
        if abs(gap) < GAP_SOLVED_IN:
            return time
        vx, vy = placed.velocity_vector(time)
        rate = away_x * vx + away_y * vy
        if gap > 0.0 > rate:
            before_s = time
        else:
            after_s = time
        newton = time - gap / rate if rate < 0.0 else inf
        time = newton if before_s < newton < after_s else 0.5 * (before_s + after_s)
    return guess_s


def _length(x: float, y: float) -> float:
    """Return the length of a vector."""
    # A root, because hypot rounds differently in compiled code; no number here comes near its overflow.
    return sqrt(x * x + y * y)


def _to_circle(x: float, y: float, dx: float, dy: float, radius: float) -> float:
    """Return the fraction of (dx, dy) after which a point (x, y) outside meets the circle around 0; inf if never."""
    squared, dot = dx * dx + dy * dy, x * dx + y * dy
    root = dot * dot - squared * (x * x + y * y - radius * radius)
    return (-dot - sqrt(root)) / squared if root >= 0.0 and dot < 0.0 else inf


def pressed_bumpers(directions_rad: Iterable[float], bumper_angles_rad: tuple[float, ...]) -> int:
    """Return the bumpers that are pressed; bit i stands for bumper i.

    Parameters
    ----------
    directions_rad
        Directions of the touches in the frame of the bumpers, counter-clockwise.
    bumper_angles_rad
        Angles of a ring with equal spacing, in the same frame.
    """
    bits = 0
    for direction in directions_rad:
        bits |= touched_bumpers(direction, bumper_angles_rad)
    return bits


def touched_bumpers(direction_rad: float, bumper_angles_rad: Sequence[float]) -> int:
    """Return the bumpers that one touch presses; arguments as of `pressed_bumpers`."""
    half = 0.5 * tau / len(bumper_angles_rad) + MIDWAY_RAD
    bits = 0
    for number, angle in enumerate(bumper_angles_rad):
        if abs(wrap_to_pi(direction_rad - angle)) <= half:
            bits |= 1 << number
    return bits
