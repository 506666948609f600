"""Driving while the map grows: straight legs on the mapper's pose, slower where sonars measure something ahead.

    refresh --> mapper --> driver --> speed guard --> drive --> wait for the rest of the period, and again

The drivers are `WaypointDriver` here and `Explorer` in explore.py; without one a person drives, and the loop only reads
states. Nothing is known of a room at first, so the guard trusts readings alone, not the map.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, degrees, hypot, inf, pi, radians, sin
from typing import Final, NamedTuple, Protocol

import numpy as np

from localization.filters.belief import Floats
from localization.live.sensor_input import FiringTime, restart_ring
from localization.mapping.live import LiveMapper
from localization.mapping.measurements import DriveCollector
from localization.navigation.limits import STAND, AxisLimits, StateGapLimiter, VelocityCommand
from localization.navigation.path import PathSection, angle_difference, line_between, wall_distances
from localization.navigation.path_follower import PathFollower
from localization.navigation.waypoints import COMMAND_TIMEOUT_S, PERIOD_S, stop_on_exit
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.robots import Body

Point = tuple[float, float]

GUARD_S: Final = 2.0
"""Readings considered by the guard: two turns of the ring, so that one bad reading of a sonar is not the only one."""
REACTION_S: Final = 1.5
"""The way ahead lasts this long at least: a turn of the ring, and braking."""
GUARD_MARGIN_IN: Final = 1.5
HALF_CONE_RAD: Final = radians(12.5)
ASIDE_RAD: Final = radians(80.0)
"""Obstacles farther aside are not approached."""
DEAD_ZONE_RAD: Final = radians(60.0)
"""A reading at the lower limit of 6 in may be anything from 0 to 6: nearer to the direction than this it blocks."""
BLIND_IN: Final = 8.0
"""Beside a wall nearer than sonars measure a leg goes on for this far: at up to 30 degrees off its direction the body
comes 4 in nearer, of the 5.3 in that it has."""
BLIND_IN_S: Final = 3.0
GAP_IN_S: Final = 2.0
PASSED_IN: Final = (2.0, 4.0, 6.0)
"""Through a gap narrower than sonars measure: speed, and how far ahead the map must show space."""
GAP_SPACE_IN: Final = 1.2
KNOWN_IN: Final = 8.0
"""The map must show a wall this near to the body: that is what the sonars cannot measure."""
MIN_SPEED_IN_S: Final = 0.8
"""A slower speed counts as blocked."""
BLOCKED_S: Final = 3.0
"""A leg that is blocked for this long is given up."""
REVERSE_RAD: Final = radians(100.0)
"""A larger turn is saved by driving backwards: turns are what odometry measures worst."""
BACK_OFF_IN, BACK_OFF_IN_S = 3.0, 2.0
MAX_CONTACTS: Final = 3
REACHED_IN: Final = 2.0


@dataclass(frozen=True, slots=True)
class Geofence:
    """A rectangle that the robot's axis must not leave, inches, in the frame of the start."""

    low: Point
    high: Point

    def contains(self, x_in: float, y_in: float) -> bool:
        """Return True for a point inside."""
        return self.low[0] <= x_in <= self.high[0] and self.low[1] <= y_in <= self.high[1]


class SpeedGuard:
    """The free way ahead by the readings of the last seconds, in the frame of the encoders.

    A cone measures the nearest wall perpendicularly, so each reading is taken for a wall across its axis. Whatever is
    nearest to the robot reflects into one of its sonars, as their cones cover all directions.
    """

    def __init__(self, body: Body) -> None:
        self._ring_in, self.body_in, self._shortest_in = body.ring.radius_in, body.radius_in, body.ring.min_range_in
        self._walls: deque[tuple[float, float, float, float]] = deque()
        self.is_blind = False
        """True if something was nearer aside than sonars measure, at the last question."""

    def add(self, clock_s: float, encoders: Floats, axis_rad: float, reading_in: float) -> None:
        """Take a reading into account, of a sonar with this axis at an encoder pose."""
        while self._walls and self._walls[0][0] < clock_s - GUARD_S:
            self._walls.popleft()
        distance = float(encoders[0] * np.cos(axis_rad) + encoders[1] * np.sin(axis_rad)) + self._ring_in + reading_in
        self._walls.append((clock_s, axis_rad, distance, reading_in))

    def free_in(self, encoders: Floats, direction_rad: float) -> float:
        """Return how far the body may move from an encoder pose in a direction; inf if nothing is ahead."""
        nearest, self.is_blind = inf, False
        for _, axis, distance, reading in self._walls:
            off = max(abs(angle_difference(direction_rad, axis)) - HALF_CONE_RAD, 0.0)
            if off > ASIDE_RAD:
                continue
            if reading <= self._shortest_in:
                if off < DEAD_ZONE_RAD:
                    return 0.0
                self.is_blind = True
                continue
            gap = distance - float(encoders[0] * np.cos(axis) + encoders[1] * np.sin(axis)) - self.body_in
            nearest = min(nearest, (gap - GUARD_MARGIN_IN) / cos(off))
        return max(nearest, 0.0)


class Driver(Protocol):
    """Choice of the next path. `leg` returns the points of the next path, None at the end."""

    def leg(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]
    ) -> list[Point] | None:
        """Return the waypoints of the next path from a pose; None if there is nothing left to do.

        `free_in(direction_rad)` is the way that the sonars show to be free in a direction of the map.
        """
        ...

    def end_leg(self, pose: Floats, reason: str) -> None:
        """Take note that a path has ended: at its end (""), or for a reason."""
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
    ) -> list[Point] | None:
        """Return the next waypoint."""
        return [self._waypoints[0]] if self._waypoints else None

    def end_leg(self, pose: Floats, reason: str) -> None:  # noqa: ARG002
        """Go on with the waypoint after it."""
        point = self._waypoints.pop(0)
        if reason:
            self.skipped.append((point, reason))


class _Leg:
    """A path of straight pieces, each driven forwards or backwards, whichever takes the smaller turn."""

    def __init__(self, pose: Floats, points: Sequence[Point], limits: AxisLimits) -> None:
        corners = [(float(pose[0]), float(pose[1])), *points]
        self._sections = [
            PathSection((line_between(one, other),))
            for one, other in pairwise(corners)
            if hypot(other[0] - one[0], other[1] - one[1]) > REACHED_IN / 2.0
        ]
        self._limits = limits
        self._follower: PathFollower | None = None
        self._back = 0.0

    def command(self, pose: Floats) -> VelocityCommand | None:
        """Return the velocities at a pose (3,); None at the end."""
        while self._sections:
            if self._follower is None:
                # A section is driven backwards rather than after a large turn.
                turn = angle_difference(float(pose[2]), self._sections[0].at(0.0).heading_rad)
                self._back = pi if abs(turn) > REVERSE_RAD else 0.0
                self._follower = PathFollower(self._sections[:1], self._limits)
            speed, steering = self._follower.command(np.array((pose[0], pose[1], pose[2] + self._back)))
            if not self._follower.finished:
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
        self._blocked_s = inf
        self._speed_in_s = 0.0
        self._back_off: tuple[float, Floats, float] | None = None
        self._blind_since: Floats | None = None
        self.log = SurveyLog()

    def command(
        self, elapsed_s: float, state: RobotState, encoders: Floats, pose: Floats, mapper: LiveMapper
    ) -> VelocityCommand | str:
        """Return the velocities, or why the drive ends."""
        # 1. Contacts: back off, away from where it drove to.
        if state.touching and self._back_off is None:
            self.log.contacts.append((float(pose[0]), float(pose[1])))
            self.log.notes.append((elapsed_s, f"touched something at ({pose[0]:.1f}, {pose[1]:.1f})"))
            if len(self.log.contacts) >= MAX_CONTACTS:
                return f"touched something {MAX_CONTACTS} times"
            speed = -BACK_OFF_IN_S if self._speed_in_s > 0.0 else BACK_OFF_IN_S
            self._back_off = speed, encoders, elapsed_s
            self._give_up(pose, "contact")
        if self._back_off is not None:
            speed, since, since_s = self._back_off
            if hypot(*(encoders - since)[:2]) < BACK_OFF_IN and elapsed_s - since_s < 3.0 * BACK_OFF_IN / BACK_OFF_IN_S:
                return VelocityCommand(speed, 0.0)
            self._back_off = None
        # 2. The next leg.
        if self._leg is None:
            turned = float(encoders[2] - pose[2])
            points = self._driver.leg(elapsed_s, pose, mapper, lambda way: self._guard.free_in(encoders, way + turned))
            if points is None:
                return "done"
            self._leg, self._blocked_s, self._blind_since = _Leg(pose, points, self._limits), inf, None
        command = self._leg.command(pose)
        if command is None:
            self._leg = None
            self._driver.end_leg(pose, "")
            return STAND
        return self._guarded(command, elapsed_s, encoders, pose, mapper)

    def _fits(self, pose: Floats, direction_rad: float, mapper: LiveMapper) -> bool:
        """Return True if the map shows space ahead, and what is too near for the sonars."""
        if not mapper.is_sound or not len(mapper.walls):
            return False
        along = np.array((cos(direction_rad), sin(direction_rad)))
        places = pose[:2] + np.outer((0.0, *PASSED_IN), along)
        here, *ahead = (wall_distances(places, mapper.walls) - self._guard.body_in).tolist()
        return bool(here < KNOWN_IN and min(ahead) > GAP_SPACE_IN)

    def _give_up(self, pose: Floats, reason: str) -> None:
        if self._leg is not None:
            self._leg = None
            self._driver.end_leg(pose, reason)

    def _guarded(
        self, command: VelocityCommand, elapsed_s: float, encoders: Floats, pose: Floats, mapper: LiveMapper
    ) -> VelocityCommand | str:
        """Return a command that is slow enough for what is ahead, and give up a leg that is blocked."""
        speed, steering = command
        if not speed:
            return command
        back = pi if speed < 0.0 else 0.0
        free_in = self._guard.free_in(encoders, float(encoders[2]) + back)
        allowed = free_in / REACTION_S
        # Beside a wall that is too near to measure, neither far nor fast.
        if not self._guard.is_blind:
            self._blind_since = None
        elif self._blind_since is None:
            self._blind_since = encoders
        if self._blind_since is not None:
            blind_in = hypot(*(encoders - self._blind_since)[:2])
            allowed = 0.0 if blind_in > BLIND_IN else min(allowed, BLIND_IN_S)
        if allowed < GAP_IN_S and self._fits(pose, float(pose[2]) + back, mapper):
            allowed = GAP_IN_S
        if self._fence is not None:
            # Where it would be after braking.
            ahead = REACTION_S * speed
            x, y = float(pose[0] + ahead * np.cos(pose[2])), float(pose[1] + ahead * np.sin(pose[2]))
            if not self._fence.contains(x, y):
                if not self._fence.contains(float(pose[0]), float(pose[1])) and len(self.log.notes) > MAX_CONTACTS:
                    return "outside of the geofence"
                allowed = 0.0
        if allowed < min(MIN_SPEED_IN_S, abs(speed)):
            self._blocked_s = min(self._blocked_s, elapsed_s)
            if elapsed_s - self._blocked_s > BLOCKED_S:
                where = f"({pose[0]:.1f}, {pose[1]:.1f}) in {degrees(pose[2] + back):.0f} deg"
                self.log.notes.append((elapsed_s, f"blocked at {where}"))
                self._give_up(pose, "blocked")
            return STAND
        self._blocked_s = inf
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
        `wait(seconds)` lets real time pass.
    fence
        Where the robot must stay.
    collector
        The drive so far, of one that goes on.
    """
    # 1. The ring, so that it is known when each sonar fires.
    schedule, state = restart_ring(robot, body.ring)
    collector = collector or DriveCollector(robot.model.name)
    mapper = mapper_of(collector)
    collector.restart(state, schedule)
    start_s = state.clock_s or 0.0
    guard, gaps = SpeedGuard(body), StateGapLimiter()
    motion = None if driver is None else _Motion(driver, guard, limits, fence)
    log = SurveyLog() if motion is None else motion.log
    if driver is not None:
        robot.set_timeout(COMMAND_TIMEOUT_S)
    with nullcontext() if driver is None else stop_on_exit(robot):
        while True:
            # 2. The map.
            state = robot.refresh()
            _add_readings(guard, collector, body, state, mapper.add(state))
            elapsed_s = (state.clock_s or 0.0) - start_s
            encoders = collector.encoders_at((state.clock_s or 0.0) + collector.shift_s)
            pose = mapper.pose(encoders) if mapper.is_ready else None
            # 3. Where to: nowhere before the first pose.
            command: VelocityCommand | str = STAND
            # A turn of the ring, so that the guard has seen everything.
            if motion is not None and pose is not None and len(collector) >= body.ring.count:
                command = motion.command(elapsed_s, state, encoders[:3], pose, mapper)
            if isinstance(command, str):
                yield SurveyStep(elapsed_s, state, pose, command), mapper, log
                return
            yield SurveyStep(elapsed_s, state, pose), mapper, log
            # 4. Drive for the rest of the period.
            after = state
            if motion is not None:
                fraction = gaps.speed_fraction(state.clock_s or 0.0)
                after = robot.drive(
                    translation_in_s=fraction * command.translation_in_s,
                    steering_rad_s=fraction * command.steering_rad_s,
                )
                _add_readings(guard, collector, body, after, mapper.add(after))
            if mapper.is_due:
                mapper.solve()
            remaining_s = PERIOD_S - ((after.clock_s or 0.0) - (state.clock_s or 0.0))
            if remaining_s > 0.0:
                wait(remaining_s / (after.speed_factor or 1.0))


def _add_readings(
    guard: SpeedGuard, collector: DriveCollector, body: Body, state: RobotState, firings: Sequence[FiringTime]
) -> None:
    for sonar, instant_s in firings:
        encoders = collector.encoders_at(instant_s + collector.shift_s)
        axis = float(encoders[3]) + body.ring.angles_rad[sonar]
        guard.add(instant_s, encoders, axis, float(state.sonars_in[sonar]))
