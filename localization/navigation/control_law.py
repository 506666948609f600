"""The control law of the thesis, its speed limits, and what a robot does that has no estimate.

The control law leads from an estimated pose to the next small step towards a goal. All its functions accept arrays with
leading dimensions; numba compiles `step_to` for floats. In the batch experiments the limits are inches and radians per
step; in live runs a step is made every T seconds, so a limit divided by T is a speed.

Speed limits are those of each robot model, of an uncertain estimate, and of states that arrive too far apart. All
controllers return a VelocityCommand, and steer by a smoothed pose.

RecoveryBehavior turns in place and then drives where the sonars ahead measure free space: poses that look alike from
one position are distinguished on the path to another. Where the filter states a direction in which they differ, it
drives there. After a contact it backs off and turns away. ContactDetector reports a bumper that closes, MisfitDetector
a start that the readings do not fit, StallDetector a robot that presses against something or whose wheels stand.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import cos, inf, radians, sin, tau
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import (
    HEADING,
    POSE,
    Floats,
    Number,
    add,
    atan2,
    choose,
    clip,
    difference,
    hypot,
    unit_vector,
    wrap_angle,
)
from localization.filters.odometry import move, step_between
from localization.filters.update import OUTLIER_THRESHOLD, Refusal
from localization.live.estimate import Estimate
from localization.live.sensor_input import MAX_GAP_S, SensorInput, sonar_readings
from nclient.state import RobotState
from worlds.geometry import nearest_points
from worlds.rings import Ring
from worlds.robots import N150

OBSERVED_STATES: Final = 6
"""Number of recent states whose gaps are considered: a busy machine is late repeatedly."""
SIGMAS: Final = 3.0
"""Standard deviations of position error that must fit between the body and the walls."""
FULL_SPEED_RATIO: Final = 1.6
"""Free space divided by 3 sigma from which full speed is allowed; at 1 the robot stops."""
MIN_FRACTION: Final = 0.1
"""Smaller fractions count as 0; otherwise the robot would approach its stopping point for ever."""
_RECEDING_IN: Final = 0.05
_MIN_LENGTH_IN: Final = 1e-6
_MIN_SINE: Final = 1e-12


class VelocityCommand(NamedTuple):
    """Velocities for the robot's axes: translation in in/s, steering in rad/s (counter-clockwise positive)."""

    translation_in_s: float
    steering_rad_s: float


STAND: Final = VelocityCommand(0.0, 0.0)
"""The command that stops both axes."""


class BackOff(NamedTuple):
    """Backing off after a contact: velocity, encoder position at its start, end by the clock, and distance."""

    velocity_in_s: float
    start: Sequence[float]
    until_s: float
    distance_in: float

    def command(self, clock_s: float, position: Sequence[float]) -> VelocityCommand | None:
        """Return the velocities at an encoder position (x, y, ...); None at the end."""
        driven_in = math.hypot(position[0] - self.start[0], position[1] - self.start[1])
        is_over = driven_in >= self.distance_in or clock_s >= self.until_s
        return None if is_over else VelocityCommand(self.velocity_in_s, 0.0)


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Speed and acceleration limits of the translation axis (in/s, in/s^2) and of the heading (rad/s, rad/s^2)."""

    translation_in_s: float
    translation_in_s2: float
    steering_rad_s: float
    steering_rad_s2: float

    def capped(self, translation_in_s: float, steering_rad_s: float = inf) -> AxisLimits:
        """Return these limits with lower top speeds."""
        return replace(self, translation_in_s=min(self.translation_in_s, translation_in_s),
                       steering_rad_s=min(self.steering_rad_s, steering_rad_s))


_SYNCHRO_DRIVE: Final = AxisLimits(20.0, 30.0, radians(45.0), radians(50.0))
# The Scout steers by its two wheels, which share their limits: 20 in/s and 90 deg/s together are 31 of a wheel's
# 39 in/s; 15 in/s^2 and 126 deg/s^2 together are its 30 in/s^2.
_SCOUT: Final = AxisLimits(20.0, 15.0, radians(90.0), radians(126.0))
MODEL_LIMITS: Final[Mapping[str, AxisLimits]] = MappingProxyType(
    {"n150": _SYNCHRO_DRIVE, "n200": _SYNCHRO_DRIVE, "scout": _SCOUT}
)
"""Limits by model name, with the accelerations after power-on (ROBOTS.md)."""


class StateGapLimiter:
    """Reduce the speed when states arrive far apart, as over a slow line or on a busy machine.

    The robot then drives and turns no farther between two states than at full speed in MAX_GAP_S. Driven faster,
    its path between two states is no longer a single arc, as odometry assumes, and commands take effect too late.
    """

    def __init__(self) -> None:
        self._clocks: deque[float] = deque(maxlen=OBSERVED_STATES)

    def speed_fraction(self, clock_s: float) -> float:
        """Return the allowed fraction of the speed, in (0, 1], after a state with this robot clock.

        It is min(1, MAX_GAP_S / longest gap between the recent states); exactly 1 if states arrive in time.
        """
        self._clocks.append(clock_s)
        longest_s = max((after - before for before, after in pairwise(self._clocks)), default=0.0)
        return 1.0 if longest_s <= MAX_GAP_S else MAX_GAP_S / longest_s


class PoseSmoother:
    """Apply corrections of the estimate to the steering pose gradually instead of at once.

    The smoothed pose moves by the odometry step, then towards the estimate by the fraction 1 - exp(-dt / time_s).
    A correction means that the estimate was wrong before, not that the robot jumped; applied at once it makes the
    steering twitch. The filter itself never uses the smoothed pose.

    Parameters
    ----------
    time_s : float
        Time constant in seconds, 0 or more; 0 follows the estimate at once.

    Raises
    ------
    ValueError
        If `time_s` is negative.
    """

    def __init__(self, time_s: float) -> None:
        if not time_s >= 0.0:
            raise ValueError(f"a time constant is 0 s or more, not {time_s}")
        self._time_s = time_s
        self._smoothed: Floats | None = None
        self._odometry: Floats | None = None
        self._clock_s = 0.0

    def reset(self) -> None:
        """Follow the next estimate at once, for example after the robot was lost."""
        self._smoothed = None

    def update(self, clock_s: float, estimate: Floats, odometry: Floats) -> Floats:
        """Return the pose (3,) to steer by.

        Parameters
        ----------
        clock_s : float
            Robot clock of the estimate.
        estimate, odometry : (3,) array
            Estimated pose and encoder pose at that time.
        """
        if self._smoothed is None or self._odometry is None or not self._time_s:
            self._smoothed = np.array(estimate)
        else:
            # 1. Move by the odometry step.
            predicted = move(self._smoothed, step_between(self._odometry, odometry))
            # 2. Correct a fraction of the difference from the estimate.
            fraction = 1.0 - math.exp(-(clock_s - self._clock_s) / self._time_s)
            self._smoothed = add(predicted, fraction * difference(estimate, predicted))
        self._odometry, self._clock_s = np.array(odometry), clock_s
        return self._smoothed


def allowed_speed_fraction(pose: Floats, ahead: Floats, cov: Floats, walls: Floats, body_in: float) -> float:
    """Return the fraction of the speed that an uncertain robot may drive at.

    With q = min over walls of (distance - body radius) / (3 sigma towards the wall): full speed from
    q = FULL_SPEED_RATIO on, none at q = 1. A wall counts by the nearer of the current and the next position; a wall
    that the robot only moves away from does not count.

    Parameters
    ----------
    pose : (3,) array
        Estimated pose, in and rad.
    ahead : (2,) array
        Position a little ahead, where the heading error has an effect as well.
    cov : (3, 3) array
        Covariance of the pose.
    walls : (m, 4) array
        Walls x1 y1 x2 y2 in inches.
    body_in : float
        Radius of the robot in inches.

    Returns
    -------
    float
        0, or MIN_FRACTION to 1.
    """
    if not len(walls):
        return 1.0
    # 1. Keep the walls that the robot does not move away from.
    here = pose[:2]
    nearest, distances = nearest_points(np.stack((here, ahead)), walls)
    closing = distances[1] < distances[0] + _RECEDING_IN
    if not closing.any():
        return 1.0
    # 2. Compute the standard deviation of the position ahead, towards each wall.
    offset = (nearest[0] - here)[closing]
    direction = offset / np.maximum(np.hypot(offset[:, 0], offset[:, 1]), _MIN_LENGTH_IN)[:, None]
    dx, dy = ahead - here
    jacobian = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx]])
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", direction, jacobian @ cov @ jacobian.T, direction))
    # 3. Compare it with the free space.
    space = np.minimum(distances[0], distances[1])[closing] - body_in
    ratio = float((space / np.maximum(SIGMAS * sigma, _MIN_LENGTH_IN)).min())
    fraction = min(1.0, (ratio - 1.0) / (FULL_SPEED_RATIO - 1.0))
    return fraction if fraction >= MIN_FRACTION else 0.0


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Limits of one step and the fraction of the error that one step corrects.

    Attributes
    ----------
    drho_max_in, dtheta_max_rad
        Longest step (in) and largest turn (rad).
    alpha_rho, alpha_theta
        Proportional gains of distance and bearing error, 0 to 1.
    """

    drho_max_in: float = 0.05
    dtheta_max_rad: float = 0.05
    alpha_rho: float = 0.1
    alpha_theta: float = 0.1


def distance_to(pose: Floats, goal: Floats) -> Floats:
    """Return the distance (...) in inches from poses (..., 3) to goals (..., 2)."""
    return np.hypot(goal[..., 0] - pose[..., 0], goal[..., 1] - pose[..., 1])


def is_reached(pose: Floats, goal: Floats, radius_in: float) -> npt.NDArray[np.bool_]:
    """Return True (...) where poses (..., 3) are within `radius_in` of their goals (..., 2)."""
    return distance_to(pose, goal) <= radius_in


def bearing_error(pose: Floats, goal: Floats) -> Floats:
    """Return the angle (...) in [-pi, pi] from the heading of poses (..., 3) to the direction of goals (..., 2)."""
    direction = np.arctan2(goal[..., 1] - pose[..., 1], goal[..., 0] - pose[..., 0])
    return wrap_angle(direction - pose[..., HEADING])


def step_to(x: Number, y: Number, heading: Number, goal_x: Number, goal_y: Number,
            gains: ControlGains) -> tuple[Number, Number]:
    """Return drho and dtheta of `next_step`."""
    distance = hypot(goal_x - x, goal_y - y)
    delta = wrap_angle(atan2(goal_y - y, goal_x - x) - heading)
    return (clip(gains.alpha_rho * distance, 0.0, gains.drho_max_in),
            clip(gains.alpha_theta * delta, -gains.dtheta_max_rad, gains.dtheta_max_rad))


def next_step(pose: Floats, goal: Floats, gains: ControlGains) -> Floats:
    """Return the commanded step towards a goal.

    The robot keeps rolling at full length even when the goal lies behind it: it then turns on a circle of radius
    drho_max / dtheta_max.

    Parameters
    ----------
    pose : (..., 3) array
        x, y in inches, heading in radians.
    goal : (..., 2) array
        x, y in inches.
    gains : ControlGains

    Returns
    -------
    (..., 2) array
        drho in inches and dtheta in radians, with the bearing error delta:
        drho = min(drho_max, alpha_rho distance), dtheta = sign(delta) min(dtheta_max, alpha_theta abs(delta)).
    """
    x, y, heading = (pose[..., index] for index in range(POSE))
    return np.stack(np.broadcast_arrays(*step_to(x, y, heading, goal[..., 0], goal[..., 1], gains)), axis=-1)


def slow_for_turn(drho: Number, x: Number, y: Number, heading: Number, goal_x: Number, goal_y: Number,
                  gains: ControlGains) -> Number:
    """Return the length of a step towards a goal, shortened until the robot's turning circle reaches the goal.

    A goal inside the smallest circle of `next_step` is never reached: the robot drives around it, up to two radii
    beside the straight line. A goal aside is approached with the component of the step towards it, so that the arc
    stays near the straight line, on which the map is free; a goal behind the robot is turned to on the spot.

    Parameters
    ----------
    drho
        Length of the step of `next_step`, inches.
    x, y, heading
        Pose, inches and radians.
    goal_x, goal_y
        Inches.

    Returns
    -------
    number
        The arc from the pose through a goal at the distance d and the bearing error delta has the radius
        d / (2 sin abs(delta)): drho is at most dtheta_max times this, and at most cos(delta) times that of the step; 0
        where abs(delta) is 90 degrees or more.
    """
    cosine, sine = unit_vector(wrap_angle(atan2(goal_y - y, goal_x - x) - heading))
    towards = clip(drho * cosine, 0.0, inf)
    # No division by zero: ahead, any length is allowed.
    longest = gains.dtheta_max_rad * hypot(goal_x - x, goal_y - y) / clip(2.0 * abs(sine), _MIN_SINE, 2.0)
    shortened: Number = choose(towards < longest, towards, longest)
    return shortened


TURN_RAD_S: Final = 0.4
SCAN_RAD: Final = 4.0
"""Turn before driving on: two thirds of a revolution, in which each sonar measures a wall or two."""
DRIVE_IN_S, MAX_DRIVE_IN_S = 3.0, 15.0
"""Speeds towards walls, and far from any: in 45 s half of a corridor of 40 m, whose end tells equal doors apart."""
FREE_S: Final = 5.0
"""The free way ahead lasts this long at least: five rings."""
LANE_IN: Final = 20.0
"""Half the width of the way ahead: the body, and what it strays from a straight line in five seconds. Walls farther to
the side, as of a corridor, do not slow the robot."""
FREE_AHEAD_IN: Final = 18.0
"""Shortest reading of the sonars ahead at which the robot drives on."""
ALIGNED_RAD: Final = 0.3
"""The robot drives where the direction worth driving in is this near to its heading."""
BACK_OFF_S, BACK_OFF_IN_S = 2.0, 3.0
"""Time and speed of backing off after a contact."""
TURN_AWAY_RAD: Final = 0.8
"""Turn after a contact before driving on."""
AVOID_RAD: Final = TURN_AWAY_RAD + 1.2
"""While something was in the way the robot does not turn back to it: for this turn, or three seconds of driving."""
AHEAD: Final = cos(tau / 8)
"""Sonars within an eighth of a turn of the heading look ahead."""

STALL_S: Final = 5.0
"""Shortest time without progress that counts as a stall."""
PROGRESS_IN: Final = 0.2
PROGRESS_RAD: Final = 0.1
"""Encoder motion that counts as progress."""
CONTACT_PROGRESS_IN: Final = 0.5
"""In contact, the estimate must come this much nearer to the waypoint: wheels may slip and bodies slide."""


FIRST_RANGES: Final = 24
"""A ring and a half: the first ranges, which decide whether the start is right."""
MIN_EXPLAINED: Final = 0.25
"""Fraction of them that must be explained; of a right start more than half are, among bad readings and people."""
_MISFIT_REMEDY: Final = "check --map and --start, or search with --start unknown"


class RecoveryBehavior:
    """Controller for a lost robot; `command` is called every `period_s` seconds, `max_speed_in_s` is the top speed."""

    def __init__(self, period_s: float, max_speed_in_s: float = MAX_DRIVE_IN_S, ring: Ring = N150.ring) -> None:
        self._period_s, self._max_speed_in_s, self._ring = period_s, max_speed_in_s, ring
        self._scanned_rad = self._back_off_s = self._avoiding_rad = 0.0

    def reset(self) -> None:
        """Start with a new scan the next time, because the robot is localized again or has moved."""
        self._scanned_rad = self._back_off_s = self._avoiding_rad = 0.0

    def command(self, state: SensorInput, turn_rad: float | None = None) -> tuple[float, float]:
        """Return translation in in/s and steering in rad/s.

        Parameters
        ----------
        state
        turn_rad
            Turn from the heading to a direction that is worth driving in; None without any.
        """
        # 1. After a contact: back off, then turn away.
        if state.touching and self._back_off_s <= 0.0:
            self._back_off_s, self._avoiding_rad = BACK_OFF_S, AVOID_RAD
        if self._back_off_s > 0.0:
            self._back_off_s -= self._period_s
            return -BACK_OFF_IN_S, 0.0
        # 2. Nothing in the way: turn to the direction that is worth it, or drive on.
        turn = TURN_RAD_S * self._period_s
        nearest_in, lane_in = _free_ahead_in(state, self._ring)
        is_free = nearest_in > FREE_AHEAD_IN
        if turn_rad is not None and self._avoiding_rad <= 0.0:
            if abs(turn_rad) > ALIGNED_RAD:
                return 0.0, TURN_RAD_S if turn_rad > 0.0 else -TURN_RAD_S
            self._scanned_rad = SCAN_RAD
        if self._scanned_rad >= SCAN_RAD and is_free and self._avoiding_rad <= AVOID_RAD - TURN_AWAY_RAD:
            self._avoiding_rad -= turn
            return min(max(lane_in / FREE_S, DRIVE_IN_S), self._max_speed_in_s), 0.0
        # 3. Something is: turn until it is not, and drive on before turning back to it.
        if not is_free:
            self._avoiding_rad = AVOID_RAD - TURN_AWAY_RAD
        else:
            self._avoiding_rad -= turn
        self._scanned_rad += turn
        return 0.0, TURN_RAD_S


def _free_ahead_in(state: SensorInput, ring: Ring) -> tuple[float, float]:
    """Return the shortest reading of the sonars that look ahead, and the free length of the lane ahead, inches.

    An echo lies in the lane if it is at most LANE_IN to the side, were it on the axis of its sonar.
    """
    readings = sonar_readings(state)[: ring.count]
    directions = np.array(ring.angles_rad[: len(readings)]) + state.turret_rad - state.steering_rad
    beams = [
        (reading, reading * cos(direction), abs(reading * sin(direction)))
        for reading, direction in zip(readings, directions, strict=True)
        if cos(direction) >= AHEAD
    ]
    nearest_in = min((reading for reading, _, _ in beams), default=0.0)
    lane_in = min((along for _, along, across in beams if across <= LANE_IN), default=nearest_in)
    return nearest_in, lane_in


@dataclass(frozen=True, slots=True)
class ProgressMark:
    """State at the last progress: encoders (3,), waypoint (2,) and the distance from it."""

    clock_s: float
    encoders: Floats
    goal: Floats
    remaining_in: float


class ContactDetector:
    """Detect a bumper that closes: in the map the path was free, so the map or the estimate is wrong.

    A bumper that is closed at the first state is not reported until it has opened, so that a robot can leave a wall.
    """

    def __init__(self) -> None:
        self._closed: frozenset[int] | None = None

    def reason(self, state: RobotState, pose: Floats, *, backs_off: bool = False) -> str:
        """Return which bumpers have closed since the last state, in words; "" without any.

        Parameters
        ----------
        state : RobotState
        pose : (3,) array
            Estimated pose.
        backs_off : bool
            True while a recovery drives, which leaves obstacles by itself.
        """
        before, self._closed = self._closed, frozenset(state.bumpers)
        if before is None or backs_off or not (closed := self._closed - before):
            return ""
        numbers = ", ".join(map(str, sorted(closed)))
        return (
            f"contact of bumpers {numbers} at the estimate ({pose[0]:z.1f}, {pose[1]:z.1f}) in: drive the robot free "
            "(nomad shell), check map and start pose"
        )


class MisfitDetector:
    """Detect an estimate that a filter which cannot search has lost, or that the first readings do not fit."""

    def __init__(self) -> None:
        self._explained = self._ranges = 0

    def reason(self, estimate: Estimate) -> str:
        """Return why the estimate is useless, in words; "" if it may be right."""
        if estimate.health.is_lost:
            return f"lost: {estimate.health.reason}; {_MISFIT_REMEDY}"
        if self._ranges >= FIRST_RANGES:
            return ""
        for echo in estimate.echoes:
            is_used = echo.refusal is Refusal.NONE
            self._ranges += is_used or echo.refusal is Refusal.GATE
            self._explained += is_used and echo.outlier_probability < OUTLIER_THRESHOLD
        if self._ranges < FIRST_RANGES or self._explained >= MIN_EXPLAINED * self._ranges:
            return ""
        return f"{self._explained} of the first {self._ranges} ranges fit the map at the start; {_MISFIT_REMEDY}"


class StallDetector:
    """Detect that a robot driven to a waypoint makes no progress.

    Then an obstacle is not in the map, or the waypoint cannot be reached. Progress is encoder motion of PROGRESS_IN or
    PROGRESS_RAD; in contact it is an estimate that comes nearer by CONTACT_PROGRESS_IN.

    Parameters
    ----------
    speed_in_s : float
        Top speed of the robot, > 0; a slower robot gets more time.
    """

    def __init__(self, speed_in_s: float) -> None:
        self.limit_s = max(STALL_S, 2.0 * PROGRESS_IN / speed_in_s)
        self._mark: ProgressMark | None = None

    def reason(self, clock_s: float, state: RobotState, pose: Floats, goal: Floats | None) -> str:
        """Return why the robot is stalled, in words; "" if it is not.

        Parameters
        ----------
        clock_s : float
            Robot clock.
        state : RobotState
        pose : (3,) array
            Estimated pose.
        goal : (2,) array or None
            Current waypoint; without one there is no stall.
        """
        if goal is None:
            self._mark = None
            return ""
        # 1. Compare with the state at the last progress.
        encoders = np.array([state.x_in, state.y_in, state.steering_rad])
        remaining_in = float(distance_to(pose, goal))
        mark = self._mark
        if (
            mark is None
            or not np.array_equal(mark.goal, goal)
            or self._is_progress(mark, state, encoders, remaining_in)
        ):
            self._mark = mark = ProgressMark(clock_s, encoders, goal, remaining_in)
        if clock_s - mark.clock_s < self.limit_s:
            return ""
        # 2. Explain.
        where = f"for {clock_s - mark.clock_s:.0f} s, {remaining_in:.1f} in before ({goal[0]:g}, {goal[1]:g})"
        if state.touching:
            return f"the robot presses against something {where}: bumpers {', '.join(map(str, state.bumpers))} touch"
        return (
            f"the robot does not move {where}, although commanded to: is it held (see nserver ctl status), or its "
            "emergency button pressed?"
        )

    @staticmethod
    def _is_progress(mark: ProgressMark, state: RobotState, encoders: Floats, remaining_in: float) -> bool:
        if state.touching:
            return remaining_in <= mark.remaining_in - CONTACT_PROGRESS_IN
        x, y, turned = difference(encoders, mark.encoders)
        return math.hypot(x, y) >= PROGRESS_IN or abs(turned) >= PROGRESS_RAD
