"""The thesis' control law: from where the robot believes it is to the next small step towards a goal.

Rules: pure functions; no clock, no robot, no filter. In the experiments the limits are inches and radians a step;
live, at a step every T seconds, limit / T is a speed. Which pose is handed in (estimate or odometry) is the caller's.

How much slower a robot is driven whose states come far apart, as over a slow line or on a busy machine.

    share = min(1, LONGEST_GAP_S / longest gap between the last few states)

So it goes and turns no farther between two states than it would at full speed in LONGEST_GAP_S. Driven faster its way
between them is no single arc any more, as odometry takes it to be, and what is commanded is done long after it was
right. Rules: pure; clocks of states in, a share of the speed out, 1 to the bit where states come often enough.

A steadier pose for whoever steers by an estimate: corrections come in bit by bit instead of at a stroke.

    shown  = shown moved by the odometry's step, then brought towards the estimate by the share 1 - exp(-dt / time_s)

A correction of the filter says that the robot was elsewhere all along, not that it jumped. Shown at a stroke it makes
the steering twitch; spread over `time_s` it lags by as much and twitches less. Rules: pure; the filter never sees it.

How fast an uncertain robot may go: its 3-sigma against the room that walls leave it.

    q = min over walls of (distance - body) / (3 sigma towards the wall)      full speed from ENOUGH on, none at 1

A wall counts by the nearer of the robot's place and the place a little ahead; one that it only goes away from does not.
Rules: pure; a place, a covariance, walls.

How fast the axes of each model go: what a way is smoothed to. Data; numbers as in ROBOTS.md.

    translation_in_s, _in_s2      speed and acceleration along the way
    steering_rad_s, _rad_s2       of the heading

A Scout turns by its two wheels, which share what they can do: 20 in/s and 90 deg/s at once are 31 of a wheel's 39 in/s;
15 in/s2 and 126 deg/s2 are its 30 in/s2.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, radians
from types import MappingProxyType
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, Floats, add, difference, wrap_angle
from localization.filters.odometry import move, step_between
from localization.live.sensor_input import MAX_GAP_S
from worlds.geometry import nearest_points


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Limits of one step (`drho_max_in`, `dtheta_max_rad`) and the share of the error one step corrects."""

    drho_max_in: float = 0.05
    dtheta_max_rad: float = 0.05
    alpha_rho: float = 0.1
    alpha_theta: float = 0.1


def distance_to(pose: Floats, goal: Floats) -> Floats:
    """Inches (...) from poses (..., 3) to goals (..., 2) in inches."""
    distance: Floats = np.hypot(goal[..., 0] - pose[..., 0], goal[..., 1] - pose[..., 1])
    return distance


def reached(pose: Floats, goal: Floats, radius_in: float) -> npt.NDArray[np.bool_]:
    """Whether poses (..., 3) are within `radius_in` of their goals (..., 2)."""
    within: npt.NDArray[np.bool_] = distance_to(pose, goal) <= radius_in
    return within


def bearing_error(pose: Floats, goal: Floats) -> Floats:
    """Radians (...) in [-pi, pi] from the heading of poses (..., 3) to the direction of goals (..., 2)."""
    direction = np.arctan2(goal[..., 1] - pose[..., 1], goal[..., 0] - pose[..., 0])
    return wrap_angle(direction - pose[..., HEADING])


def next_step(pose: Floats, goal: Floats, gains: ControlGains) -> Floats:
    """The step (..., 2) of drho_in and dtheta_rad to command at poses (..., 3) towards goals (..., 2).

    drho = min(drho_max, alpha_rho distance), dtheta = sign(delta) min(dtheta_max, alpha_theta |delta|) with delta
    the bearing error. The law rolls at full length even when the goal lies behind: it turns on a circle of radius
    drho_max / dtheta_max.
    """
    delta = bearing_error(pose, goal)
    step = np.empty((*delta.shape, 2))
    step[..., 0] = np.minimum(gains.drho_max_in, gains.alpha_rho * distance_to(pose, goal))
    step[..., 1] = np.clip(gains.alpha_theta * delta, -gains.dtheta_max_rad, gains.dtheta_max_rad)
    return step


REMEMBERED: Final = 6
"""States that are looked at: a busy machine is late again and again."""


class Pace:
    """Looks on a state at a time."""

    def __init__(self) -> None:
        self._clocks: deque[float] = deque(maxlen=REMEMBERED)

    def share(self, clock_s: float) -> float:
        """The share of its speed, above 0 and at most 1, that may be driven at after a state of this clock."""
        self._clocks.append(clock_s)
        longest_s = max((after - before for before, after in pairwise(self._clocks)), default=0.0)
        return 1.0 if longest_s <= MAX_GAP_S else MAX_GAP_S / longest_s


class PoseSmoother:
    """A pose that follows estimates with a time constant of `time_s` >= 0 seconds; 0 follows at once.

    Raises ValueError for a negative time.
    """

    def __init__(self, time_s: float) -> None:
        if not time_s >= 0.0:
            raise ValueError(f"a time constant is 0 s or more, not {time_s}")
        self._time_s = time_s
        self._shown: Floats | None = None
        self._odometry: Floats | None = None
        self._clock_s = 0.0

    def forget(self) -> None:
        """Nothing is believed any more: the next estimate is followed at once."""
        self._shown = None

    def update(self, clock_s: float, estimate: Floats, odometry: Floats) -> Floats:
        """What to steer by at this clock: estimate and encoder pose (3,) of that instant in, a pose (3,) out."""
        if self._shown is None or self._odometry is None or not self._time_s:
            self._shown = np.array(estimate)
        else:
            carried = move(self._shown, step_between(self._odometry, odometry))
            share = 1.0 - math.exp(-(clock_s - self._clock_s) / self._time_s)
            self._shown = add(carried, share * difference(estimate, carried))
        self._odometry, self._clock_s = np.array(odometry), clock_s
        return self._shown


SIGMAS: Final = 3.0
ENOUGH: Final = 1.6
LEAST_SHARE: Final = 0.1
"""A smaller share is none: else the robot would creep up to where it must stand and never be there."""
_AWAY_IN: Final = 0.05
_NOTHING_IN: Final = 1e-6


def allowed_speed_fraction(pose: Floats, ahead: Floats, cov: Floats, walls: Floats, body_in: float) -> float:
    """The share of its speed, 0 to 1, that a robot at a pose (3,), known with the covariance (3, 3), may take on its
    way to the place `ahead` (2,), where an error of the heading tells as well."""
    if not len(walls):
        return 1.0
    here = pose[:2]
    nearest, far = nearest_points(np.stack((here, ahead)), walls)
    closing = far[1] < far[0] + _AWAY_IN
    if not closing.any():
        return 1.0
    off = (nearest[0] - here)[closing]
    along = off / np.maximum(np.hypot(off[:, 0], off[:, 1]), _NOTHING_IN)[:, None]
    gone = ahead - here
    by_pose = np.array([[1.0, 0.0, -gone[1]], [0.0, 1.0, gone[0]]])
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", along, by_pose @ cov @ by_pose.T, along))
    room = np.minimum(far[0], far[1])[closing] - body_in
    enough = float((room / np.maximum(SIGMAS * sigma, _NOTHING_IN)).min())
    share = min(1.0, (enough - 1.0) / (ENOUGH - 1.0))
    return share if share >= LEAST_SHARE else 0.0


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """See the head of this file."""

    translation_in_s: float
    translation_in_s2: float
    steering_rad_s: float
    steering_rad_s2: float

    def capped(self, translation_in_s: float, steering_rad_s: float = inf) -> AxisLimits:
        """The same, driving and turning no faster."""
        return replace(
            self,
            translation_in_s=min(self.translation_in_s, translation_in_s),
            steering_rad_s=min(self.steering_rad_s, steering_rad_s),
        )


_SYNCHRO: Final = AxisLimits(20.0, 30.0, radians(45.0), radians(50.0))
LIMITS: Final[Mapping[str, AxisLimits]] = MappingProxyType(
    {"n150": _SYNCHRO, "n200": _SYNCHRO, "scout": AxisLimits(20.0, 15.0, radians(90.0), radians(126.0))}
)
"""By the model's name, at the accelerations that robots have at power-on."""
