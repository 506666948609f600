"""The control law of the thesis: from an estimated pose to the next small step towards a goal.

All functions accept arrays with leading dimensions; numba compiles `step_to` for floats. In the batch experiments the
limits are inches and radians per step; in live runs a step is made every T seconds, so a limit divided by T is a speed.

Speed limits: of each robot model, of an uncertain estimate, and of states that arrive too far apart.

Also the velocity command that all controllers return, and the smoother of the pose that they steer by.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, radians
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, POSE, Floats, Number, add, atan2, clip, difference, hypot, wrap_angle
from localization.filters.odometry import move, step_between
from localization.live.sensor_input import MAX_GAP_S
from worlds.geometry import nearest_points

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
        return replace(
            self,
            translation_in_s=min(self.translation_in_s, translation_in_s),
            steering_rad_s=min(self.steering_rad_s, steering_rad_s),
        )


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


def step_to(
    x: Number, y: Number, heading: Number, goal_x: Number, goal_y: Number, gains: ControlGains
) -> tuple[Number, Number]:
    """Return drho and dtheta of `next_step`."""
    distance = hypot(goal_x - x, goal_y - y)
    delta = wrap_angle(atan2(goal_y - y, goal_x - x) - heading)
    return (
        clip(gains.alpha_rho * distance, 0.0, gains.drho_max_in),
        clip(gains.alpha_theta * delta, -gains.dtheta_max_rad, gains.dtheta_max_rad),
    )


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


def slow_for_turn(step: Floats, pose: Floats, goal: Floats, gains: ControlGains) -> Floats:
    """Return a step towards a goal that is shortened until the robot's turning circle reaches the goal.

    A goal inside the smallest circle of `next_step` is never reached: the robot drives around it, up to two radii
    beside the straight line. A goal aside is approached with the component of the step towards it, so that the arc
    stays near the straight line, on which the map is free; a goal behind the robot is turned to on the spot.

    Parameters
    ----------
    step : (..., 2) array
        drho in inches and dtheta in radians, of `next_step`.
    pose : (..., 3) array
        x, y in inches, heading in radians.
    goal : (..., 2) array
        x, y in inches.
    gains : ControlGains

    Returns
    -------
    (..., 2) array
        The arc from the pose through a goal at the distance d and the bearing error delta has the radius
        d / (2 sin abs(delta)): drho is at most dtheta_max times this, and at most cos(delta) times that of the step; 0
        where abs(delta) is 90 degrees or more.
    """
    delta = np.abs(bearing_error(pose, goal))
    with np.errstate(divide="ignore"):
        longest = gains.dtheta_max_rad * distance_to(pose, goal) / (2.0 * np.sin(delta))
    towards = np.maximum(step[..., 0] * np.cos(delta), 0.0)
    return np.stack((np.minimum(towards, longest), step[..., 1]), axis=-1)
