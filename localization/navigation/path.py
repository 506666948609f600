"""Geometry and timing of a planned path: lines and arcs, rounded corners, speed profile.

    PathElement   a line or an arc: start, direction, curvature (1/in, left positive, 0 straight), length
    PathSection   elements that continue in each other's direction, driven without stopping
    path          a sequence of sections; between two of them the robot turns in place

Lengths are in inches, angles in radians.

Follow a planned path on an estimate: turn in place where a section begins, then drive it at its profile's speeds.

On a section, at the lateral error e (left positive), the heading error p and the speed v:

    steering = v (c - e / L^2 - 2 p / L)

which is critically damped over the distance L at any speed; c is the curvature a little ahead, because the steering
needs time to accelerate.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from math import atan2, ceil, copysign, cos, hypot, inf, pi, remainder, sin, sqrt, tan, tau
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.control_law import STAND, AxisLimits, VelocityCommand
from worlds.geometry import nearest_points

CONTINUES_RAD: Final = 0.02
"""Elements whose directions differ by less belong to one section: 0.3 in/s sideways at the N150's top speed."""
MIN_LENGTH_IN: Final = 1e-6
SLACK_IN: Final = 1e-6
"""Tolerance of clearance checks: a path that touches an inflated wall is free, whatever the rounding error."""
_STRAIGHT: Final = 1e-9

LATERAL_SHIFT_IN: Final = 0.1
"""Largest lateral error that the steering's acceleration may cause at the start of an arc."""
STEP_IN: Final = 0.25
"""Resolution of speed profiles and of clearance checks along arcs."""
PLANNED_ACCELERATION: Final = 0.5
"""Fraction of the translation's acceleration that is planned with; the controller has the rest."""
APPROACH_HZ: Final = 2.0
"""Near the end, at most this fraction of the remaining length per second: the estimate moves as well."""
CREEP_IN_S: Final = 0.5
"""Lowest commanded speed, so that every section ends."""

_MAX_CORNER_RAD = 0.9 * pi
"""A sharper corner is a reversal and is not rounded."""
_MIN_CORNER_RAD = 1e-3
MIN_ARC_SPEED_IN_S: Final = 1.0
"""An arc so tight that it is driven slower than this is replaced by a turn in place."""


class PathPoint(NamedTuple):
    """A point of a path (in), its direction (rad) and its curvature (1/in)."""

    x_in: float
    y_in: float
    heading_rad: float
    curvature: float


class PathElement(NamedTuple):
    """A line or an arc: start point, start direction, curvature (1/in, left positive), length."""

    x_in: float
    y_in: float
    heading_rad: float
    curvature: float
    length_in: float

    def at(self, along_in: float) -> PathPoint:
        """Return the point at an arc length."""
        turn = self.curvature * along_in
        # The chord of an arc has the length s sin(turn / 2) / (turn / 2) and half the turn's direction.
        half = 0.5 * turn
        chord = along_in * sin(half) / half if half else along_in
        middle = self.heading_rad + half
        return PathPoint(self.x_in + chord * cos(middle), self.y_in + chord * sin(middle), self.heading_rad + turn,
                         self.curvature)

    def nearest(self, x_in: float, y_in: float) -> float:
        """Return the arc length of the point nearest to (x_in, y_in)."""
        dx, dy = x_in - self.x_in, y_in - self.y_in
        ahead = dx * cos(self.heading_rad) + dy * sin(self.heading_rad)
        # 1. On a line: project onto it.
        if abs(self.curvature) < _STRAIGHT:
            return min(max(ahead, 0.0), self.length_in)
        # 2. On an arc: take the angle seen from its centre.
        curved = abs(self.curvature)
        inward = (dy * cos(self.heading_rad) - dx * sin(self.heading_rad)) * copysign(1.0, self.curvature)
        along = atan2(curved * ahead, 1.0 - curved * inward) % tau / curved
        if along <= self.length_in:
            return along
        # 3. Beyond the arc: the nearer of its two ends.
        last = self.at(self.length_in)
        return 0.0 if hypot(dx, dy) < hypot(x_in - last.x_in, y_in - last.y_in) else self.length_in


def line_between(start: Sequence[float], end: Sequence[float]) -> PathElement:
    """Return the straight element from one point (x, y) to another, inches."""
    dx, dy = float(end[0] - start[0]), float(end[1] - start[1])
    return PathElement(float(start[0]), float(start[1]), atan2(dy, dx), 0.0, hypot(dx, dy))


@dataclass(frozen=True)
class PathSection:
    """One or more elements that continue in each other's direction."""

    elements: tuple[PathElement, ...]

    @cached_property
    def starts_in(self) -> list[float]:
        """Arc length at which each element starts, and the total length: (elements + 1)."""
        return [0.0, *accumulate(element.length_in for element in self.elements)]

    @property
    def length_in(self) -> float:
        """Total length."""
        return self.starts_in[-1]

    def at(self, along_in: float) -> PathPoint:
        """Return the point at an arc length, limited to the section."""
        along = min(max(along_in, 0.0), self.length_in)
        number = min(bisect_right(self.starts_in, along) - 1, len(self.elements) - 1)
        return self.elements[number].at(along - self.starts_in[number])

    def nearest(self, x_in: float, y_in: float, first_in: float = 0.0, last_in: float = inf) -> float:
        """Return the arc length of the nearest point, searched from `first_in` to `last_in`."""
        smallest, found = inf, first_in
        for element, start in zip(self.elements, self.starts_in, strict=False):
            if start > last_in or start + element.length_in < first_in:
                continue
            along = min(max(start + element.nearest(x_in, y_in), first_in), last_in, self.length_in)
            point = self.at(along)
            distance = hypot(point.x_in - x_in, point.y_in - y_in)
            if distance < smallest:
                smallest, found = distance, along
        return found

    def points(self, step_in: float, first_in: float = 0.0, limit: int | None = None) -> Floats:
        """Return points (n, 2) from `first_in` to the end, at most `step_in` apart; at most `limit` of them."""
        count = max(1, int(np.ceil((self.length_in - first_in) / step_in)))
        along_in = np.linspace(first_in, self.length_in, count + 1)[:limit].tolist()
        return np.array([self.at(along)[:2] for along in along_in])


def split_into_sections(elements: Sequence[PathElement]) -> tuple[PathSection, ...]:
    """Group elements into sections; elements without length are dropped."""
    groups: list[list[PathElement]] = []
    for element in elements:
        if element.length_in <= MIN_LENGTH_IN:
            continue
        last = groups[-1][-1] if groups else None
        if last and abs(angle_difference(last.at(last.length_in).heading_rad, element.heading_rad)) <= CONTINUES_RAD:
            groups[-1].append(element)
        else:
            groups.append([element])
    return tuple(PathSection(tuple(group)) for group in groups)


def sample_waypoints(elements: Sequence[PathElement], step_in: float = 3.0) -> list[tuple[float, float]]:
    """Return the ends of all elements, and points on arcs at most `step_in` apart, for point-to-point controllers."""
    found = []
    for element in elements:
        count = max(1, int(np.ceil(element.length_in / step_in))) if element.curvature else 1
        found += [element.at(element.length_in * number / count)[:2] for number in range(1, count + 1)]
    return found


def total_length_in(parts: Sequence[PathElement] | Sequence[PathSection]) -> float:
    """Return the total length of elements or sections in inches."""
    return sum(part.length_in for part in parts)


def angle_difference(first_rad: float, second_rad: float) -> float:
    """Return the smallest turn from one direction to another, in [-pi, pi]."""
    return remainder(second_rad - first_rad, tau)


def wall_distances(points: Floats, walls: Floats) -> Floats:
    """Return the distance (n,) of points (n, 2) to the nearest of walls (m, 4); inf if there are no walls."""
    if not len(walls):
        return np.full(len(points), np.inf)
    _, distances = nearest_points(points, walls)
    nearest: Floats = distances.min(axis=1)
    return nearest


def max_arc_speed_in_s(curvature: float, limits: AxisLimits) -> float:
    """Return the highest speed v on an arc of curvature c.

    Two limits of the steering apply:

    - its speed w: v abs(c) <= w;
    - its acceleration a: v^4 abs(c)^3 / (24 a^2) <= LATERAL_SHIFT_IN. The heading ramps up to v c within v c / a
      seconds, half of them before the arc begins, and runs beside it by that much.

    References
    ----------
    The shift of a railway's transition curve, l^2 c / 24 with l = v^2 c / a.
    """
    if not curvature:
        return limits.translation_in_s
    curved = abs(curvature)
    by_speed = limits.steering_rad_s / curved
    by_acceleration: float = (24.0 * limits.steering_rad_s2**2 * LATERAL_SHIFT_IN / curved**3) ** 0.25
    return min(limits.translation_in_s, by_speed, by_acceleration)


class SpeedProfile:
    """Speeds along a section: as fast as the axes allow, slowing down for every arc and for the end.

    v dv/ds stays within the planned acceleration in both directions, and v is 0 at both ends. `duration_s` is the
    time that driving the section takes.
    """

    def __init__(self, section: PathSection, limits: AxisLimits) -> None:
        count = max(3, ceil(section.length_in / STEP_IN) + 1)
        self._along = np.linspace(0.0, section.length_in, count)
        # 1. Limit the speed at each point by the curvature of all elements that meet there.
        highest = np.full(count, limits.translation_in_s)
        for element, start in zip(section.elements, section.starts_in, strict=False):
            inside = (self._along >= start - STEP_IN) & (self._along <= start + element.length_in + STEP_IN)
            highest[inside] = np.minimum(highest[inside], max_arc_speed_in_s(element.curvature, limits))
        speeds = highest.tolist()
        # 2. Limit the acceleration forwards, then the deceleration backwards: v^2 grows by at most 2 a ds per step.
        gain = 2.0 * PLANNED_ACCELERATION * limits.translation_in_s2 * float(self._along[1])
        speeds[0] = speeds[-1] = 0.0
        for k in range(1, count):
            speeds[k] = min(speeds[k], sqrt(speeds[k - 1] * speeds[k - 1] + gain))
        for k in range(count - 2, -1, -1):
            speeds[k] = min(speeds[k], sqrt(speeds[k + 1] * speeds[k + 1] + gain))
        self._speeds = np.array(speeds)
        self._limits, self._end = limits, section.length_in
        # 3. Integrate the time with the mean speed of each step.
        step = float(self._along[1])
        self.duration_s = sum(2.0 * step / (one + other) for one, other in pairwise(speeds))

    def speed_in_s(self, along_in: float) -> float:
        """Return the speed to command at an arc length, CREEP_IN_S at least.

        The speed is read one step ahead: at the very start it would be 0 for ever.
        """
        ahead = float(np.interp(min(along_in + STEP_IN, 0.5 * (along_in + self._end)), self._along, self._speeds))
        approach = CREEP_IN_S + APPROACH_HZ * (self._end - along_in)
        return max(CREEP_IN_S, min(self._limits.translation_in_s, ahead, approach))


def round_corners(points: Sequence[tuple[float, float]], within_in: float, limits: AxisLimits, walls: Floats,
                  radius_in: float) -> list[PathElement]:
    """Return a polyline with its corners rounded where that is faster.

    An arc that touches both sides of a corner of turn b at the distance d from it has the radius d / tan(b / 2) and
    passes the corner at d (1 - cos(b / 2)) / sin(b / 2). Each corner is considered separately; an arc uses at most
    half of either side.

    Parameters
    ----------
    points : sequence of (x, y)
        Polyline in inches.
    within_in : float
        Largest distance between an arc and its corner, so that a waypoint still counts as passed.
    limits : AxisLimits
    walls : (m, 4) array
        Walls in inches.
    radius_in : float
        Distance that arcs keep from all walls.
    """
    sides = [
        line_between(one, other) for one, other in pairwise(points) if hypot(one[0] - other[0], one[1] - other[1]) > 0
    ]
    arcs = [_corner_arc(one, other, within_in, limits) for one, other in pairwise(sides)]
    arcs = [arc if arc and _is_clear(arc[0], walls, radius_in) else None for arc in arcs]
    elements: list[PathElement] = []
    cut = 0.0
    for side, arc in zip(sides, [*arcs, None], strict=True):
        # Shorten each side by the arcs at its two ends.
        before, cut = cut, arc[1] if arc else 0.0
        x, y, heading, _ = side.at(before)
        elements.append(PathElement(x, y, heading, 0.0, side.length_in - before - cut))
        if arc:
            elements.append(arc[0])
    return elements


def _corner_arc(one: PathElement, other: PathElement, within_in: float,
                limits: AxisLimits) -> tuple[PathElement, float] | None:
    """Return the arc for a corner and the length it cuts off either side; None if stopping is faster."""
    turn = angle_difference(one.heading_rad, other.heading_rad)
    if not _MIN_CORNER_RAD < abs(turn) < _MAX_CORNER_RAD:
        return None
    half = 0.5 * abs(turn)
    cut = min(0.5 * one.length_in, 0.5 * other.length_in, within_in * sin(half) / (1.0 - cos(half)))
    radius = cut / tan(half)
    x, y, heading, _ = one.at(one.length_in - cut)
    arc = PathElement(x, y, heading, (1.0 if turn > 0.0 else -1.0) / radius, radius * abs(turn))
    speed = max_arc_speed_in_s(arc.curvature, limits)
    if speed < MIN_ARC_SPEED_IN_S:
        return None
    return (arc, cut) if _arc_duration_s(arc, speed, limits) < _stop_duration_s(2.0 * cut, abs(turn), limits) else None


def _arc_duration_s(arc: PathElement, speed: float, limits: AxisLimits) -> float:
    """Return the time for an arc, including slowing down for it and speeding up again."""
    slower = limits.translation_in_s - speed
    ramps = slower**2 / (PLANNED_ACCELERATION * limits.translation_in_s2 * limits.translation_in_s)
    return arc.length_in / speed + ramps


def _stop_duration_s(length: float, turn: float, limits: AxisLimits) -> float:
    """Return the time for a corner with a stop: its sides, stopping, turning in place and starting again."""
    top, acceleration = limits.translation_in_s, PLANNED_ACCELERATION * limits.translation_in_s2
    # The turn has a trapezoidal speed profile, triangular if the top speed is not reached.
    ramp = limits.steering_rad_s / limits.steering_rad_s2
    turning = turn / limits.steering_rad_s + ramp
    if turn < limits.steering_rad_s * ramp:
        turning = 2.0 * float(np.sqrt(turn / limits.steering_rad_s2))
    return length / top + top / acceleration + turning


def _is_clear(arc: PathElement, walls: Floats, radius_in: float) -> bool:
    points = PathSection((arc,)).points(STEP_IN)
    return bool(wall_distances(points, walls).min() >= radius_in - SLACK_IN)


DAMPING_IN: Final = 6.0
"""L, the distance within which errors decay."""
DELAY_S: Final = 0.1
"""One control period: a command takes effect that much later."""
LOOKAHEAD_S: Final = 0.5
TURNED_RAD: Final = 0.04
"""A turn in place ends within this heading error."""
MAX_HEADING_ERROR_RAD: Final = 0.7
"""With a larger heading error the robot stops and turns in place."""
SEARCH_BACK_IN, SEARCH_AHEAD_IN = 2.0, 8.0
"""Range around the last position on the path in which the next one is searched."""
END_TOLERANCE_IN: Final = 0.25
_MIN_TURN_RAD_S: Final = 0.05


class PathFollower:
    """Controller for a path of sections; `command` is called once per period.

    Parameters
    ----------
    path, limits
    turned_rad
        Heading error within which a turn in place ends and the robot drives. The rest decays on the section, and leads
        aside by turned_rad DAMPING_IN / e at most.
    """

    def __init__(self, path: Sequence[PathSection], limits: AxisLimits, turned_rad: float = TURNED_RAD) -> None:
        self._path, self._limits, self._turned_rad = tuple(path), limits, turned_rad
        self._profiles = [SpeedProfile(section, limits) for section in self._path]
        self._number, self._along_in, self._is_turning = 0, 0.0, True
        self.lateral_error_in = 0.0
        """Distance of the robot from its path at the last command, left positive."""

    @property
    def finished(self) -> bool:
        """True once the end of the path is reached."""
        return self._number == len(self._path)

    def command(self, pose: Floats, fraction: float = 1.0) -> VelocityCommand:
        """Return the velocities at a pose (3,), scaled by `fraction` (0 to 1); STAND at the end of the path."""
        while not self.finished:
            section = self._path[self._number]
            # 1. Find the position on the path near the previous one.
            self._along_in = section.nearest(float(pose[0]), float(pose[1]), max(0.0, self._along_in - SEARCH_BACK_IN),
                                             self._along_in + SEARCH_AHEAD_IN)  # fmt: skip
            point = section.at(self._along_in)
            heading_error = angle_difference(point.heading_rad, float(pose[2]))
            # 2. At the end of a section go on with the next one.
            if section.length_in - self._along_in <= END_TOLERANCE_IN:
                self._number, self._along_in, self._is_turning = self._number + 1, 0.0, True
                continue
            # 3. Turn in place or drive; the two thresholds form a hysteresis.
            self._is_turning = abs(heading_error) > (self._turned_rad if self._is_turning else MAX_HEADING_ERROR_RAD)
            if self._is_turning:
                return turn_command(-heading_error, self._limits)
            return self._drive(section, point, pose, heading_error, fraction)
        return STAND

    def ahead(self, distance_in: float) -> Floats | None:
        """Return the point (2,) this far ahead on the section; None during a turn in place and at the end."""
        if self.finished or self._is_turning:
            return None
        return np.array(self._path[self._number].at(self._along_in + distance_in)[:2])

    def remaining_points(self, step_in: float = 1.0, distance_in: float = inf) -> Floats:
        """Return points (n, 2) of the remaining path, `step_in` apart, as far as `distance_in`."""
        limit = None if distance_in == inf else max(1, int(distance_in / step_in))
        points, first_in = np.zeros((0, 2)), self._along_in
        for section in self._path[self._number :]:
            points = np.concatenate((points, section.points(step_in, min(first_in, section.length_in), limit)))
            if limit is not None and len(points) >= limit:
                break
            first_in = 0.0
        return points[:limit]

    def _drive(self, section: PathSection, point: PathPoint, pose: Floats, heading_error: float,
               fraction: float) -> VelocityCommand:
        # 1. Lateral error; before the start and beyond the end of the section the full distance counts.
        dx, dy = float(pose[0]) - point.x_in, float(pose[1]) - point.y_in
        self.lateral_error_in = dy * cos(point.heading_rad) - dx * sin(point.heading_rad)
        distance_to_end_in = hypot(dx, dy) if self._along_in in (0.0, section.length_in) else 0.0
        self.lateral_error_in = copysign(max(abs(self.lateral_error_in), distance_to_end_in), self.lateral_error_in)
        # 2. Speed of the profile, reduced while the heading is off.
        speed = fraction * self._profiles[self._number].speed_in_s(self._along_in) * max(0.0, cos(heading_error))
        # 3. Steering law.
        #    It steers for the curvature ahead: by one period and half of the steering's ramp into or out of an arc.
        ahead = section.at(self._along_in + LOOKAHEAD_S * speed).curvature
        lead_s = DELAY_S + 0.5 * speed * max(abs(point.curvature), abs(ahead)) / self._limits.steering_rad_s2
        curvature = section.at(self._along_in + lead_s * speed).curvature
        steering = speed * (curvature - self.lateral_error_in / DAMPING_IN**2 - 2.0 * heading_error / DAMPING_IN)
        limit = self._limits.steering_rad_s
        return VelocityCommand(speed, min(limit, max(-limit, steering)))


def turn_command(angle_rad: float, limits: AxisLimits) -> VelocityCommand:
    """Return the velocities of a turn in place with this angle left, braking in time."""
    braking = sqrt(2.0 * PLANNED_ACCELERATION * limits.steering_rad_s2 * abs(angle_rad))
    return VelocityCommand(0.0, copysign(max(_MIN_TURN_RAD_S, min(limits.steering_rad_s, braking)), angle_rad))


class TurnProgress:
    """A turn in place by an angle, counter-clockwise positive, possibly of several revolutions.

    Headings passed one after another must differ by less than half a revolution. The progress survives retries, and a
    robot that was lost meanwhile still ends at the same heading.
    """

    def __init__(self, heading_rad: float, by_rad: float) -> None:
        self._heading_rad, self._remaining_rad = heading_rad, by_rad

    def remaining_rad(self, heading_rad: float) -> float:
        """Return the rest of the turn at this heading."""
        self._remaining_rad -= angle_difference(self._heading_rad, heading_rad)
        self._heading_rad = heading_rad
        return self._remaining_rad
