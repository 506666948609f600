"""Driving while the map grows: straight legs on the mapper's pose, slower where sonars measure something ahead.

    refresh --> mapper --> driver --> speed guard --> drive --> wait for the rest of the period, and again

The drivers are `WaypointDriver` here and `Explorer` in explore.py; without one a person drives, and the loop only reads
states. Nothing is known of a room at first, so the guard relies on readings. Where the map is sound, its walls stop the
robot as well.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from itertools import chain, pairwise
from math import copysign, cos, degrees, dist, hypot, inf, pi, radians, sin
from typing import Final, NamedTuple, Protocol

import numpy as np

from localization.filters.belief import Floats, rotate, wrap_angle
from localization.filters.sonar_cone import ConeSonar
from localization.live.sensor_input import FiringSchedule, FiringTime, restart_ring
from localization.mapping.live import LiveMapper, passed
from localization.mapping.measurements import COMPARED_ROUNDS, DriveCollector, DriveLog, compare_rounds
from localization.mapping.problem import HALF_CONE_RAD
from localization.mapping.reflectors import crossings
from localization.navigation.control_law import (
    STAND,
    AxisLimits,
    BackOff,
    StallDetector,
    StateGapLimiter,
    VelocityCommand,
)
from localization.navigation.path import (
    PathFollower,
    angle_difference,
    round_corners,
    split_into_sections,
    wall_distances,
)
from localization.navigation.waypoints import drive_unless_held, stop_on_exit, wait_for_next_state
from nclient.errors import BumperHit, NomadError
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.geometry import nearest_points
from worlds.robots import Body

Point = tuple[float, float]

GUARD_S: Final = 2.0
"""Readings considered by the guard: two turns of the ring, so that one bad reading of a sonar is not the only one."""
NEAR_S, NEAR_IN = 4.0, 24.0
"""The same of a reading of at most this length while its sonar measures nothing: the end of a wall that was measured
may return no echo from nearer. A single bad reading of a sonar that measures nothing is one of these. If two agree, the
sonar may also measure what is behind: the wall at which a box stands, past the edge of the box."""
CONFIRMED_S, CONFIRMED_IN, NEAR_BY_IN = 30.0, 2.0, 6.0
"""If two readings one after the other agree within CONFIRMED_IN, that is remembered for CONFIRMED_S, while the robot is
within NEAR_BY_IN of where it measured them: it may stand there, and turn."""
HIDDEN_IN: Final = 20.0
"""So far from where a wall was measured it counts while its sonar has its lower limit: a robot that neared one by 15
degrees touched it after 19 in. It is across the axis of that sonar by 15 degrees or so, and 5 in off after 20 in."""
REACTION_S: Final = 1.5
"""The speed is such that the free distance ahead lasts this long at least: a turn of the ring, and braking."""
COMMAND_TIMEOUT_S: Final = 1
"""Without a command the robot stops by itself after this time, which is within REACTION_S: solving the map may take
longer."""
GUARD_MARGIN_IN: Final = 1.5
SPOT_S, SPOT_IN = 30.0, 20.0
"""Where a ray of at most this length ended something is for so long: ends of walls come to lie between two rays. One at
the lower limit ended somewhere up to that; half of it counts."""
SPOT_MARGIN_IN: Final = 1.5
"""Space beside the body to these spots, which are a turn of the ring apart. A gap of 24 in leaves 2.3 in."""
ASIDE_RAD: Final = radians(80.0)
"""Obstacles farther aside are not approached."""
DEAD_ZONE_RAD: Final = radians(60.0)
"""A reading at the lower limit of 6 in may be anything from 0 to 6: nearer to the direction than this it blocks."""
DRIVEN_ZONE_RAD: Final = radians(30.0)
"""The same where the robot comes from."""
TRAIL_STEP_IN, TRAIL_IN = 2.0, 0.7
"""It comes from where it was on the trail, if it was so near to the place that is a step ahead."""
TRAIL_POINT_IN, TRAIL_POINTS = 0.5, 120
"""The trail: so many points at this distance at least, its last 60 in."""
MOVED_IN, STOOD_IN, STOOD_RAD = 3.0, 1.0, 0.05
"""What is nearer by the first, while the sonar has moved and turned by less than the others, has moved."""
TOUCHED_IN: Final = 5.0
"""So near to where it touched something nothing is free for having been driven."""
BLIND_IN: Final = 8.0
"""Beside a wall nearer than sonars measure a leg goes on for this far: at up to 30 degrees off its direction the body
comes 4 in nearer, of the 5.3 in that it has."""
BLIND_IN_S: Final = 3.0
GAP_IN_S, DOOR_IN_S = 2.0, 4.5
"""Speeds through a gap that is narrower than sonars measure, and through a door in which all readings are above their
lower limit: what has come there since is measured in time (OPTIONAL_IN_S)."""
GAP_STEPS_IN: Final = (2.0, 4.0, 6.0, 8.0)
"""How far ahead the map must show space: the first three for a gap, all for a door."""
GAP_SPACE_IN, DOOR_SPACE_AHEAD_IN = 1.2, 3.0
"""Space beside the body in a gap, and in a door."""
MAP_MARGIN_IN: Final = 0.8
"""Space beside the body to walls of the map, below which it does not approach them. Paths leave `explore.MARGIN_IN`."""
BESIDE_MARGIN_IN, ALONG_IN = 2.0, 0.05
"""The same beside what is nearer than sonars measure, unless there is such a wall at both sides: the map may have it an
inch farther off than it is, and nothing shows that. What nears it by less than ALONG_IN a step leads along it."""
MAP_STEPS_IN: Final = tuple(0.5 * step for step in range(1, 29))
"""Where the map is looked up: as far as the robot drives in REACTION_S at 9 in/s."""
DOOR_SPACE_IN: Final = 1.2
"""Space beside the path in a door that the map does not have: as much as paths leave."""
KNOWN_IN: Final = 12.0
"""The map must show a wall this near to the body: that of a door, or one that the sonars cannot measure."""
SHORT_IN: Final = 6.0
"""Readings up to this above the lower limit must be of walls of the map as well."""
NEAR_CONE_RAD: Final = radians(6.0)
"""Added to the half cone, for the headings of the map and of the last two seconds."""
MIN_SPEED_IN_S: Final = 0.8
"""A slower speed counts as blocked."""
BLOCKED_S: Final = 2.2
"""A leg that is blocked for this long is given up: longer than GUARD_S, in which a bad reading blocks it. One of a
sonar that measures nothing else blocks it for NEAR_S."""
REVERSE_RAD: Final = radians(100.0)
"""A larger turn is saved by driving backwards: turns are what odometry measures worst."""
BACK_OFF_IN, BACK_OFF_IN_S = 3.0, 2.0
MAX_CONTACTS: Final = 3
MAX_NOTES_OUTSIDE: Final = 3
"""A robot that is outside of its geofence, after more notes than this, does not come back."""
REACHED_IN: Final = 2.0
OPTIONAL_FREE_IN, OPTIONAL_IN_S = 6.0, 4.5
"""The optional end of a path is left out where less than the one is free ahead, and driven at this speed at most. An
edge that returns no echo before it is 6 in from a sonar is 5.3 in from the body, and measured within a turn of the
ring: meanwhile, and until it stands, the robot drives 5.3 in."""
NEAR_END_IN: Final = 1.0
"""Nearer to its end a leg is done."""
LEG_TURNED_RAD: Final = 0.12
"""A turn in place ends within this heading error, which leads 0.27 in aside."""
ROUNDED_IN, ROUNDED_SPACE_IN = 4.0, 2.0
"""Arcs pass corners of a path within this, and leave so much space beside the body."""
MAX_ROUND_PERIODS: Final = 100
"""Periods in which the compared rounds of the ring must be complete: 10 s."""


class RobotMoved(NomadError):
    """A robot does not stand where the drive ended that is to go on."""


@dataclass(frozen=True, slots=True)
class Geofence:
    """A rectangle that the robot's axis must not leave, inches, in the frame of the start."""

    low: Point
    high: Point

    def contains(self, x_in: float, y_in: float) -> bool:
        """Return True for a point inside."""
        return self.low[0] <= x_in <= self.high[0] and self.low[1] <= y_in <= self.high[1]


class _AcrossAxis(NamedTuple):
    """A reading as a wall across the axis of its sonar, in the frame of the encoders."""

    clock_s: float
    axis_rad: float
    reading_in: float
    x_in: float
    y_in: float
    """The position of the robot's axis."""
    distance_in: float
    """Of the wall, from the origin."""
    is_confirmed: bool = False
    """True if the reading before of the same sonar shows the wall at the same place."""

    def range_from(self, encoders: Floats) -> float:
        """Return the distance (in) of the wall, along the axis of the sonar, from the axis of a robot at a pose."""
        return self.distance_in - float(encoders[0] * cos(self.axis_rad) + encoders[1] * sin(self.axis_rad))


class _Spot(NamedTuple):
    """The end of a near ray, in the frame of the encoders."""

    clock_s: float
    x_in: float
    y_in: float
    is_guessed: bool
    """True if the reading was the lower limit, so that it ended somewhere up to that."""


class SpeedGuard:
    """The free distance ahead by the readings of the last seconds, in the frame of the encoders.

    A cone measures the nearest wall perpendicularly, so each reading is taken for a wall across its axis. Whatever is
    nearest to the robot reflects into one of its sonars, as their cones cover all directions. Exact rays leave gaps
    between them, so where near ones ended is remembered for longer.

    Parameters
    ----------
    body
        Size and sonars of the robot.
    rays
        True if sonars measure along exact rays.
    """

    def __init__(self, body: Body, *, rays: bool = False) -> None:
        self._rays = rays
        self._ring_in, self.body_in, self.shortest_in = body.ring.radius_in, body.radius_in, body.ring.min_range_in
        self._sonars, self._longest_in = body.ring.count, body.ring.max_range_in
        # Readings of the last GUARD_S; near ones before whose sonar does not measure them any more.
        self._walls: deque[_AcrossAxis] = deque()
        self._near: list[_AcrossAxis] = []
        self._spots: deque[_Spot] = deque()
        # Where the robot was, and where it touched something, in the frame of the encoders.
        self._trail: deque[Point] = deque(maxlen=TRAIL_POINTS)
        self._touched: list[Point] = []
        self.is_blind = False
        """True if something was nearer aside than sonars measure, at the last question."""
        self.is_beside = False
        """True if something ahead or aside was nearer than sonars measure, at the last question."""
        self.confirmed_in = inf
        """The free distance at the last question without the reading that left least of it: that may be a bad one."""

    def add(self, clock_s: float, encoders: Floats, axis_rad: float, reading_in: float) -> None:
        """Take a reading into account, of a sonar with this axis at an encoder pose."""
        x, y = float(encoders[0]), float(encoders[1])
        c, s = cos(axis_rad), sin(axis_rad)
        # 1. Readings that are too old. The near ones that have vanished since are kept for longer.
        while self._walls and self._walls[0].clock_s < clock_s - GUARD_S:
            wall = self._walls.popleft()
            if wall.reading_in <= NEAR_IN and self._is_unseen_now(wall, self._walls, encoders):
                self._near.append(wall)
        # 2. The reading. Something that has come nearer by itself may also be where the robot came from.
        wall = _AcrossAxis(clock_s, axis_rad, reading_in, x, y, x * c + y * s + self._ring_in + reading_in)
        self._remember_near(wall, encoders)
        same_sonar = (before for before in reversed(self._walls) if self._is_same_sonar(before.axis_rad, axis_rad))
        before = next(same_sonar, None)
        if before is not None and before.reading_in < self._longest_in:
            if self._has_moved(before, wall):
                self._trail.clear()
            difference = before.range_from(encoders) - wall.range_from(encoders)
            wall = wall._replace(is_confirmed=abs(difference) < CONFIRMED_IN)
        self._walls.append(wall)
        # 3. Where the robot is, and where a ray ended.
        if not self._trail or dist(self._trail[-1], (x, y)) >= TRAIL_POINT_IN:
            self._trail.append((x, y))
        while self._spots and self._spots[0].clock_s < clock_s - SPOT_S:
            self._spots.popleft()
        if self._rays and reading_in <= SPOT_IN:
            is_guessed = reading_in <= self.shortest_in
            away = self._ring_in + (0.5 * self.shortest_in if is_guessed else reading_in)
            self._spots.append(_Spot(clock_s, x + away * c, y + away * s, is_guessed))

    def _remember_near(self, wall: _AcrossAxis, encoders: Floats) -> None:
        """Keep those of the near walls that count beside a new reading.

        What is too near to be measured now is where it was measured, for some inches: a wall is not quite across the
        axis of the sonar.
        """
        place, kept = (wall.x_in, wall.y_in), list[_AcrossAxis]()
        for before in self._near:
            is_same, near = self._is_same_sonar(before.axis_rad, wall.axis_rad), before
            if is_same and wall.reading_in <= self.shortest_in and dist(place, (near.x_in, near.y_in)) < HIDDEN_IN:
                near = before._replace(clock_s=wall.clock_s)
            if self._is_remembered(near, wall.clock_s, place) and (
                not is_same or self._is_unseen_now(near, [wall], encoders)
            ):
                kept.append(near)
        self._near = kept

    def _is_same_sonar(self, one_rad: float, other_rad: float) -> bool:
        """Return True if two axes are of one sonar, or of two of which the one looks now where the other did."""
        return abs(angle_difference(one_rad, other_rad)) < pi / self._sonars

    def _is_unseen_now(self, near: _AcrossAxis, later: Iterable[_AcrossAxis], encoders: Floats) -> bool:
        """Return True if the sonar of a near wall has fired again and not measured it: it may stand there all the same.

        The sonar has measured nothing at all, or its lower limit: the wall is too near. Or, if the wall is confirmed
        and not older than NEAR_S, what is behind: another reading is then no proof that the wall has gone.
        """
        readings = [wall for wall in later if self._is_same_sonar(wall.axis_rad, near.axis_rad)]
        behind_in = near.range_from(encoders) + CONFIRMED_IN
        return bool(readings) and all(
            wall.reading_in >= self._longest_in
            or wall.reading_in <= self.shortest_in < near.reading_in
            or (near.is_confirmed and wall.clock_s < near.clock_s + NEAR_S and wall.range_from(encoders) > behind_in)
            for wall in readings
        )

    def _is_remembered(self, wall: _AcrossAxis, clock_s: float, place: Point) -> bool:
        """Return True if a near wall that its sonar does not measure any more still counts."""
        is_here = wall.is_confirmed and dist(place, (wall.x_in, wall.y_in)) < NEAR_BY_IN
        return wall.clock_s >= clock_s - (CONFIRMED_S if is_here else NEAR_S)

    def _has_moved(self, before: _AcrossAxis, wall: _AcrossAxis) -> bool:
        """Return True if a reading is at the lower limit, and the one before from the same place was clearly more."""
        is_here = hypot(before.x_in - wall.x_in, before.y_in - wall.y_in) < STOOD_IN
        is_here &= abs(angle_difference(before.axis_rad, wall.axis_rad)) < STOOD_RAD
        return is_here and wall.reading_in <= self.shortest_in < before.reading_in - MOVED_IN

    def on_contact(self, encoders: Floats) -> None:
        """Forget where the robot was, and remember the encoder pose at which it touched something."""
        self._trail.clear()
        self._touched.append((float(encoders[0]), float(encoders[1])))

    def comes_from(self, encoders: Floats, direction_rad: float) -> bool:
        """Return True if a step in a direction leads back along the trail, and not to where it touched something."""
        here = float(encoders[0]), float(encoders[1])
        step = here[0] + TRAIL_STEP_IN * cos(direction_rad), here[1] + TRAIL_STEP_IN * sin(direction_rad)
        if any(dist(step, touched) < min(TOUCHED_IN, dist(here, touched)) for touched in self._touched):
            return False
        return any(dist(step, was) < TRAIL_IN for was in self._trail)

    def is_complete(self, clock_s: float) -> bool:
        """Return True if the readings of the last GUARD_S are at least a turn of the ring: fewer leave gaps."""
        return sum(wall.clock_s >= clock_s - GUARD_S for wall in self._walls) >= self._sonars

    def near_beams(self, encoders: Floats) -> Floats:
        """Return x, y, axis and range (k, 4) of readings that are short, or of what is near by now.

        From the sonar, in the frame of an encoder pose.
        """
        limit_in = self.shortest_in + SHORT_IN
        found = [
            (wall.x_in + self._ring_in * cos(wall.axis_rad), wall.y_in + self._ring_in * sin(wall.axis_rad),
             wall.axis_rad, wall.reading_in)
            for wall in chain(self._near, self._walls)
            if min(wall.reading_in, wall.range_from(encoders) - self._ring_in) <= limit_in
        ]
        beams = np.array(found).reshape(-1, 4)
        beams[:, :2] = rotate(beams[:, :2] - encoders[:2], np.full(len(beams), -float(encoders[2])))
        beams[:, 2] -= encoders[2]
        return beams

    def free_of_spots_in(self, encoders: Floats, direction_rad: float) -> float:
        """Return how far the body may move from an encoder pose to the spots where near rays ended; inf without any."""
        nearest, c, s = inf, cos(direction_rad), sin(direction_rad)
        reach = self.body_in + SPOT_MARGIN_IN
        goes_back = self.comes_from(encoders, direction_rad)
        for _, x, y, is_guessed in self._spots:
            # On the trail nothing was as near as half of the limit.
            if goes_back and is_guessed:
                continue
            off_x, off_y = x - float(encoders[0]), y - float(encoders[1])
            ahead, aside = off_x * c + off_y * s, abs(off_y * c - off_x * s)
            if ahead > 0.0 and aside < reach:
                nearest = min(nearest, ahead - (reach * reach - aside * aside) ** 0.5 - GUARD_MARGIN_IN)
        return max(nearest, 0.0)

    def free_in(self, encoders: Floats, direction_rad: float) -> float:
        """Return how far the body may move from an encoder pose in a direction; inf if nothing is ahead."""
        spots_in, self.is_blind, self.is_beside = self.free_of_spots_in(encoders, direction_rad), False, False
        nearest = second = inf
        # Where the robot comes from it has space, unless something has moved straight into its way.
        zone = DRIVEN_ZONE_RAD if self.comes_from(encoders, direction_rad) else DEAD_ZONE_RAD
        for wall in chain(self._near, self._walls):
            off = max(abs(angle_difference(direction_rad, wall.axis_rad)) - HALF_CONE_RAD, 0.0)
            if off > ASIDE_RAD:
                continue
            if wall.reading_in <= self.shortest_in:
                self.is_blind |= off >= zone
                self.is_beside = True
                free = 0.0 if off < zone else inf
            else:
                free = max(wall.range_from(encoders) - self.body_in - GUARD_MARGIN_IN, 0.0) / cos(off)
            if free < second:
                nearest, second = min(nearest, free), max(nearest, free)
        self.confirmed_in = second
        return min(nearest, spots_in)


class Plan(NamedTuple):
    """A path to drive, and how."""

    points: list[Point]
    pace: float = 1.0
    """Fraction of the top speed."""
    optional_in: float = 0.0
    """Length (in) of its end, of which nothing is known yet: driven slowly, as far as it turns out to be free."""
    waits: bool = True
    """False if the path is given up as soon as two readings, or the map, block it; else after BLOCKED_S."""


class Driver(Protocol):
    """Choice of the next path. `leg` returns it, None at the end."""

    def leg(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]
    ) -> Plan | None:
        """Return the next path from a pose; None if there is nothing left to do.

        `free_in(direction_rad)` is the distance that sonars and map show to be free in a direction of the map.
        """
        ...

    def end_leg(self, pose: Floats, reason: str, direction_rad: float = 0.0) -> None:
        """Take note that a path has ended: at its end (""), or for a reason that lies in a direction from the pose."""
        ...


class WaypointDriver:
    """Drives to points in order, in the frame of the start; blocked ones are left out."""

    def __init__(self, waypoints: Sequence[Point]) -> None:
        self._waypoints = list(waypoints)
        self.skipped: list[tuple[Point, str]] = []
        """Waypoints that were not reached, and why."""

    @property
    def remaining(self) -> list[Point]:
        """Waypoints to come."""
        return self._waypoints

    def leg(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]  # noqa: ARG002
    ) -> Plan | None:
        """Return the next waypoint."""
        return Plan([self._waypoints[0]]) if self._waypoints else None

    def end_leg(self, pose: Floats, reason: str, direction_rad: float = 0.0) -> None:  # noqa: ARG002
        """Go on with the waypoint after it."""
        point = self._waypoints.pop(0)
        if reason:
            self.skipped.append((point, reason))


class _Leg:
    """A path with rounded corners, of sections that are driven forwards or backwards: the smaller turn before each."""

    def __init__(self, pose: Floats, plan: Plan, limits: AxisLimits, walls: Floats, body_in: float) -> None:
        self.plan, limits = plan, limits.capped(plan.pace * limits.translation_in_s)
        corners = [(float(pose[0]), float(pose[1]))]
        for point in plan.points:
            if dist(point, corners[-1]) > REACHED_IN / 2.0:
                corners.append(point)
        self.goal: Floats = np.array(corners[-1])
        self._corners = corners
        space_in = body_in + ROUNDED_SPACE_IN
        elements = round_corners(corners, ROUNDED_IN, limits, walls, space_in) if len(corners) > 1 else []
        self._sections = list(split_into_sections(elements))
        self._limits = limits
        self._follower: PathFollower | None = None
        self._back = 0.0

    def is_optional(self, pose: Floats) -> bool:
        """Return True on the optional part of the path, the end of its last straight line."""
        if not self.plan.optional_in:
            return False
        back = np.array(self._corners[-2]) - self.goal
        back /= max(float(np.hypot(*back)), 1e-9)
        x, y = (pose[:2] - self.goal).tolist()
        left_in, aside_in = x * back[0] + y * back[1], abs(x * back[1] - y * back[0])
        return bool(left_in < self.plan.optional_in and aside_in < ROUNDED_IN)

    def command(self, pose: Floats) -> VelocityCommand | None:
        """Return the velocities at a pose (3,); None at the end."""
        while self._sections:
            if self._follower is None:
                # A section that would begin with a turn above REVERSE_RAD is driven backwards.
                turn = angle_difference(float(pose[2]), self._sections[0].at(0.0).heading_rad)
                self._back = pi if abs(turn) > REVERSE_RAD else 0.0
                self._follower = PathFollower(self._sections[:1], self._limits, LEG_TURNED_RAD)
            speed, steering = self._follower.command(np.array((pose[0], pose[1], pose[2] + self._back)))
            # The last fractions of an inch would take longest.
            is_near = len(self._sections) == 1 and dist(self.goal, pose[:2]) < NEAR_END_IN
            if not self._follower.finished and not is_near:
                return VelocityCommand(-speed if self._back else speed, steering)
            del self._sections[0]
            self._follower = None
        return None


class SurveyStep(NamedTuple):
    """One period of a drive: robot clock since its start, state, pose in the map, and why it ends, "" if it does not.

    `ended` is "done" when the driver has finished.
    """

    elapsed_s: float
    state: RobotState | None
    pose: Floats | None
    ended: str = ""


@dataclass(slots=True)
class SurveyLog:
    """Events of a drive: contacts (x, y) in inches, and notes with their time."""

    contacts: list[Point] = field(default_factory=list)
    notes: list[tuple[float, str]] = field(default_factory=list)


class _Motion:
    """The commands of a drive: legs, the guard, backing off after contacts, the geofence."""

    def __init__(self, driver: Driver, guard: SpeedGuard, limits: AxisLimits, fence: Geofence | None) -> None:
        self._driver, self._guard, self._limits, self._fence = driver, guard, limits, fence
        self._leg: _Leg | None = None
        self._blocked_since_s = inf
        self._speed_in_s = 0.0
        self._back_off: BackOff | None = None
        self._blind_from: Floats | None = None
        self.log = SurveyLog()

    def command(
        self, elapsed_s: float, is_touching: bool, encoders: Floats, pose: Floats, mapper: LiveMapper
    ) -> VelocityCommand | str:
        """Return the velocities, or why the drive ends."""
        # 1. Contacts: back off, away from where it drove to.
        if is_touching and self._back_off is None:
            self._guard.on_contact(encoders)
            self.log.contacts.append((float(pose[0]), float(pose[1])))
            self.log.notes.append((elapsed_s, f"touched something at ({pose[0]:.1f}, {pose[1]:.1f})"))
            if len(self.log.contacts) >= MAX_CONTACTS:
                return f"touched something {MAX_CONTACTS} times"
            limit_s = elapsed_s + 3.0 * BACK_OFF_IN / BACK_OFF_IN_S
            self._back_off = BackOff(self._back_off_speed_in_s(encoders), encoders.tolist(), limit_s, BACK_OFF_IN)
            self._give_up(pose, "contact", pi if self._speed_in_s < 0.0 else 0.0)
        if self._back_off is not None:
            back_off = self._back_off.command(elapsed_s, encoders.tolist())
            if back_off is not None:
                return back_off
            self._back_off = None
        # 2. The next leg.
        if self._leg is None:
            turned = float(encoders[2] - pose[2])

            def free_in(direction_rad: float) -> float:
                measured_in = self._guard.free_in(encoders, direction_rad + turned)
                return min(measured_in, self._free_of_map_in(pose, direction_rad, mapper))

            plan = self._driver.leg(elapsed_s, pose, mapper, free_in)
            if plan is None:
                return "done"
            self._leg = _Leg(pose, plan, self._limits, mapper.walls, self._guard.body_in)
            self._blocked_since_s = inf
        command = self._leg.command(pose)
        if command is None:
            self._leg = None
            self._driver.end_leg(pose, "")
            return STAND
        return self._guarded(command, elapsed_s, encoders, pose, mapper)

    def _back_off_speed_in_s(self, encoders: Floats) -> float:
        """Return the speed of backing off: to where it came from, or if it has not driven to where more is free."""
        if self._speed_in_s:
            return -BACK_OFF_IN_S if self._speed_in_s > 0.0 else BACK_OFF_IN_S
        ahead, behind = (self._guard.free_in(encoders, float(encoders[2]) + turn) for turn in (0.0, pi))
        if max(ahead, behind) < BACK_OFF_IN:
            return 0.0
        return BACK_OFF_IN_S if ahead > behind else -BACK_OFF_IN_S

    @property
    def goal(self) -> Floats | None:
        """End (2,) of the leg; None without one, and while the guard or a contact keeps the robot from driving it."""
        is_held = self._leg is None or self._back_off is not None or self._blocked_since_s < inf
        return None if self._leg is None or is_held else self._leg.goal

    def _free_of_map_in(
        self, pose: Floats, direction_rad: float, mapper: LiveMapper, margin_in: float = MAP_MARGIN_IN
    ) -> float:
        """Return how far the body may move until a wall of a sound map is too near; inf if none is within 14 in.

        Within `margin_in` of a wall it may still drive along it, but come no nearer than MAP_MARGIN_IN.
        """
        if not mapper.is_sound or not len(mapper.walls):
            return inf
        body_in, walls, path = self._guard.body_in, mapper.walls, mapper.poses[:, :2]
        near = walls[nearest_points(pose[None, :2], walls)[1][0] < body_in + MAP_STEPS_IN[-1] + margin_in]
        # Where the robot has driven through a wall of the map there is a door.
        has_door = crossings(path[:-1], path[1:], near).any(axis=0)
        near = np.concatenate((near[~has_door], passed(near[has_door], path, body_in + DOOR_SPACE_IN)))
        if not len(near):
            return inf
        places = pose[:2] + np.outer((0.0, *MAP_STEPS_IN), np.array((cos(direction_rad), sin(direction_rad))))
        spaces = (wall_distances(places, near) - body_in).tolist()
        for moved_in, (before, space) in zip((0.0, *MAP_STEPS_IN), pairwise(spaces), strict=False):
            if space < min(before, MAP_MARGIN_IN) or space < min(before - ALONG_IN, margin_in):
                return moved_in
        return inf

    def _gap_in_s(self, pose: Floats, encoders: Floats, direction_rad: float, mapper: LiveMapper) -> float:
        """Return the speed in a gap of the map: 0 unless this shows space ahead, and all that the sonars measure near.

        A reading counts as a wall that goes on for ever; the map shows that it ends at a door.
        """
        if not mapper.is_sound or not len(walls := mapper.walls_facing(pose[:2])):
            return 0.0
        along = np.array((cos(direction_rad), sin(direction_rad)))
        ahead = pose[:2] + np.outer(GAP_STEPS_IN, along)
        is_near = wall_distances(pose[None, :2], walls)[0] < self._guard.body_in + KNOWN_IN
        spaces = wall_distances(ahead, mapper.walls) - self._guard.body_in
        if not is_near or spaces[:-1].min() <= GAP_SPACE_IN:
            return 0.0
        # Each near reading must be of a wall of the map, not of one that it does not have yet.
        beams = self._guard.near_beams(encoders)
        faces = pose[:2] + rotate(beams[:, :2], np.full(len(beams), float(pose[2])))
        nearest, distances = nearest_points(faces, walls)
        off = nearest - faces[:, None]
        aside = wrap_angle(np.arctan2(off[..., 1], off[..., 0]) - beams[:, 2:3] - float(pose[2]))
        explains = (np.abs(aside) < HALF_CONE_RAD + NEAR_CONE_RAD) & (distances < beams[:, 3:] + GUARD_MARGIN_IN)
        if not explains.any(axis=1).all():
            return 0.0
        is_door = spaces.min() > DOOR_SPACE_AHEAD_IN and bool((beams[:, 3] > self._guard.shortest_in).all())
        return DOOR_IN_S if is_door else GAP_IN_S

    def _is_between(self, pose: Floats, mapper: LiveMapper) -> bool:
        """Return True if the map shows walls at both sides of the body that are too near to be measured."""
        walls = mapper.walls_facing(pose[:2])
        off = rotate(nearest_points(pose[None, :2], walls)[0][0] - pose[:2], np.full(len(walls), -float(pose[2])))
        reach_in = self._guard.body_in + self._guard.shortest_in + GUARD_MARGIN_IN
        aside = off[(np.abs(off[:, 1]) > np.abs(off[:, 0])) & (np.hypot(*off.T) < reach_in), 1]
        return bool((aside > 0.0).any() and (aside < 0.0).any())

    def _give_up(self, pose: Floats, reason: str, back_rad: float) -> None:
        if self._leg is not None:
            self._leg = None
            self._driver.end_leg(pose, reason, float(pose[2]) + back_rad)

    def _safe_speeds(self, encoders: Floats, pose: Floats, back: float, mapper: LiveMapper) -> tuple[float, float]:
        """Return the speed that readings and map allow, forward (`back` 0) or backward (pi), and that which is certain.

        The reading that leaves least may be a bad one: the second speed is the one without it.
        """
        direction_rad, of_pose_rad = float(encoders[2]) + back, float(pose[2]) + back
        allowed = self._guard.free_in(encoders, direction_rad) / REACTION_S
        confirmed = self._guard.confirmed_in / REACTION_S
        # 1. Beside a wall that is too near to measure, neither far nor fast, however many legs it is; back is free.
        if not self._guard.is_blind:
            self._blind_from = None
        elif self._blind_from is None:
            self._blind_from = encoders
        if self._blind_from is not None:
            x, y = (encoders - self._blind_from)[:2].tolist()
            goes_on = x * cos(direction_rad) + y * sin(direction_rad) > 0.0
            allowed = 0.0 if goes_on and hypot(x, y) > BLIND_IN else min(allowed, BLIND_IN_S)
        # 2. In gaps and doors of the map. Whatever it shows, something is where a ray ended.
        gap_in_s = self._gap_in_s(pose, encoders, of_pose_rad, mapper) if allowed < DOOR_IN_S else 0.0
        if gap_in_s > allowed:
            allowed = min(gap_in_s, self._guard.free_of_spots_in(encoders, direction_rad) / REACTION_S)
        # 3. The end of a wall may be between two rays, or nearer than sonars measure: the map shows it all the same.
        is_alone = self._guard.is_beside and not self._is_between(pose, mapper)
        margin_in = BESIDE_MARGIN_IN if is_alone else MAP_MARGIN_IN
        of_map = self._free_of_map_in(pose, of_pose_rad, mapper, margin_in) / REACTION_S
        return min(allowed, of_map), min(confirmed, of_map)

    def _guarded(
        self, command: VelocityCommand, elapsed_s: float, encoders: Floats, pose: Floats, mapper: LiveMapper
    ) -> VelocityCommand | str:
        """Return a command that is slow enough for what is ahead, and give up a leg that is blocked."""
        speed, steering = command
        if not speed:
            return command
        back = pi if speed < 0.0 else 0.0
        allowed, confirmed = self._safe_speeds(encoders, pose, back, mapper)
        assert self._leg is not None
        is_optional = self._leg.is_optional(pose)
        if is_optional:
            allowed = min(allowed, OPTIONAL_IN_S)
        if self._fence is not None:
            # Where it would be after braking.
            ahead = REACTION_S * copysign(min(abs(speed), allowed), speed)
            x, y = float(pose[0] + ahead * np.cos(pose[2])), float(pose[1] + ahead * np.sin(pose[2]))
            if not self._fence.contains(x, y):
                if not self._fence.contains(float(pose[0]), float(pose[1])) and len(self.log.notes) > MAX_NOTES_OUTSIDE:
                    return "outside of the geofence"
                allowed = confirmed = 0.0
        if is_optional and confirmed * REACTION_S < OPTIONAL_FREE_IN:
            self._give_up(pose, "", back)
            return STAND
        if allowed < min(MIN_SPEED_IN_S, abs(speed)):
            self._blocked_since_s = min(self._blocked_since_s, elapsed_s)
            is_certain = confirmed < MIN_SPEED_IN_S and not self._leg.plan.waits
            if is_certain or elapsed_s - self._blocked_since_s > BLOCKED_S:
                where = f"({pose[0]:.1f}, {pose[1]:.1f}) in {degrees(pose[2] + back):.0f} deg"
                self.log.notes.append((elapsed_s, f"blocked at {where}"))
                self._give_up(pose, "blocked", back)
            return STAND
        self._blocked_since_s = inf
        fraction = min(1.0, allowed / abs(speed))
        self._speed_in_s = fraction * speed
        return VelocityCommand(fraction * speed, fraction * steering)


def survey(
    robot: Robot, body: Body, mapper_of: Callable[[DriveCollector], LiveMapper], driver: Driver | None,
    limits: AxisLimits, wait: Callable[[float], None], *, fence: Geofence | None = None,
    collector: DriveCollector | None = None,
) -> Generator[tuple[SurveyStep, LiveMapper, SurveyLog], None, None]:  # fmt: skip
    """Drive until the driver has finished, and yield each period; the robot is stopped at the end in any case.

    Parameters
    ----------
    robot
    body
        Size and sonars of the robot.
    mapper_of
        Makes the mapper of a drive.
    driver
        Where to drive; None if a person drives: then the robot gets no command.
    limits
        Speeds and accelerations.
    wait
        `wait(seconds)` lets time of the robot pass.
    fence
        Where the robot must stay.
    collector
        The drive so far, of one that goes on.

    Raises
    ------
    RobotMoved
        If the robot does not stand where the drive ended that goes on.
    """
    # 1. The ring, so that it is known when each sonar fires.
    schedule, state = restart_ring(robot, body.ring)
    if collector is not None and collector.has_drive:
        _require_same_place(collector.log(), _first_rounds(robot, schedule, state, wait))
    collector = collector or DriveCollector(robot.model.name)
    mapper = mapper_of(collector)
    collector.restart(state, schedule)
    start_s = clock_s = state.clock_s or 0.0
    guard, gaps = SpeedGuard(body, rays=mapper.rays), StateGapLimiter()
    stall_detector = StallDetector(limits.translation_in_s)
    motion = None if driver is None else _Motion(driver, guard, limits, fence)
    log = SurveyLog() if motion is None else motion.log
    if driver is not None:
        robot.set_timeout(COMMAND_TIMEOUT_S)
    with nullcontext() if driver is None else stop_on_exit(robot):
        state, is_hit = robot.refresh(), False
        while True:
            # 2. The map.
            _add_readings(guard, collector, body, state, mapper.add(state))
            before_s, clock_s = clock_s, state.clock_s or 0.0
            elapsed_s = clock_s - start_s
            encoders = collector.encoders_at(clock_s + collector.shift_s)
            pose = mapper.pose(encoders) if mapper.is_ready else None
            # 3. Where to: nowhere before the first pose, without the readings of a turn of the ring, or while the
            # clock stands: then the encoders and readings may be old.
            command: VelocityCommand | str = STAND
            if clock_s < before_s:
                command = f"the robot's clock went back from {before_s:.1f} to {clock_s:.1f} s: was it restarted?"
            elif motion is not None and pose is not None and guard.is_complete(clock_s) and clock_s > before_s:
                command = motion.command(elapsed_s, state.touching or is_hit, encoders[:3], pose, mapper)
                if not isinstance(command, str):
                    goal = None if command == STAND else motion.goal
                    command = stall_detector.reason(elapsed_s, state, pose, goal) or command
            if isinstance(command, str):
                yield SurveyStep(elapsed_s, state, pose, command), mapper, log
                return
            yield SurveyStep(elapsed_s, state, pose), mapper, log
            # 4. Drive for the rest of the period.
            after, is_hit = state, True
            # With bumper_stop the robot was stopped already, and goes on as after any contact.
            with suppress(BumperHit):
                if motion is not None:
                    fraction = gaps.speed_fraction(clock_s)
                    after = drive_unless_held(
                        robot,
                        translation_in_s=fraction * command.translation_in_s,
                        steering_rad_s=fraction * command.steering_rad_s,
                    )
                    _add_readings(guard, collector, body, after, mapper.add(after))
                is_hit = False
            if mapper.is_due:
                mapper.solve()
            try:
                state = wait_for_next_state(robot, state, after, wait)
            except BumperHit:
                state, is_hit = robot.refresh(), True


def _first_rounds(robot: Robot, schedule: FiringSchedule, state: RobotState, wait: Callable[[float], None]) -> DriveLog:
    """Return the first readings after a restart of the ring. Raises RobotMoved if there are none."""
    first = DriveCollector(robot.model.name)
    first.restart(state, schedule)
    for _ in range(MAX_ROUND_PERIODS):
        after = robot.refresh()
        first.add(after)
        if len(first) >= COMPARED_ROUNDS * len(schedule.order):
            return first.log()
        state = wait_for_next_state(robot, state, after, wait)
        first.add(state)
    raise RobotMoved("the robot's clock does not advance, so its readings cannot be compared with those of --resume")


def _require_same_place(before: DriveLog, after: DriveLog) -> None:
    """Raise RobotMoved if the first readings do not fit the last ones of the drive that goes on."""
    found = compare_rounds(before, after, ConeSonar())
    if not found.has_moved:
        return
    x, y = found.displacement_in
    hint = f"; they fit one that was moved by ({x:g}, {y:g}) in (ahead, left)" if found.saved > 0.0 else ""
    raise RobotMoved(
        f"--resume: {found.agreeing} of {found.compared} sonars measure what they did at the end of the drive{hint}: "
        "put the robot back where the drive ended, with its turret in the same direction, or map anew without --resume"
    )


def _add_readings(
    guard: SpeedGuard, collector: DriveCollector, body: Body, state: RobotState, firings: Sequence[FiringTime]
) -> None:
    for sonar, instant_s in firings:
        encoders = collector.encoders_at(instant_s + collector.shift_s)
        axis = float(encoders[3]) + body.ring.angles_rad[sonar]
        guard.add(instant_s, encoders, axis, float(state.sonars_in[sonar]))
