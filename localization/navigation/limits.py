"""Speed limits: of each robot model, of an uncertain estimate, and of states that arrive too far apart.

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

from localization.filters.belief import Floats, add, difference
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
