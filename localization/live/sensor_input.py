"""What a robot tells the filter: its clock, where its encoders are, and the last reading of each sonar. Values, pure.

    RobotState ──> retold: a calibration's, without some sonars, with bad readings ──> Localizer.update

A robot that is known to err: what it tells as a faultless one would, and what is left to find out of its wheels.

    readings    less their sonars' offsets; limits stay limits      turret    turned as the ring really stands
    wheels      the filter's constants (systematic) begin at what was found, as uncertain as that is

Rules: pure; what it errs is worlds.robots's.

Which echo is new: State shows the last reading of each sonar and says of none when it was taken.

    conf_sn restarts the ring at the clock of its answer; entry k of the order fires k intervals later, and round again

So order and clock tell which sonar fired when, on every line, stamps or not. Rules: pure; no robot, no filter. An echo
is handed out once, and only while its sonar cannot have fired again. `CLOCK_STEP_S`: a robot's clock goes in steps,
so an instant is taken as past only a step later.

Where the encoders were at any recent instant, by interpolation between the states that were polled.

Rules: encoder poses only, in the encoders' own frame; no filter. Between two polls the robot is taken to have gone
evenly; beyond them nothing is made up.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np

from localization.filters.belief import HEADING, Belief, Floats, add, difference, wrapped
from localization.filters.odometry import POSE, with_parameters
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE, SONAR_RATE_STEP_S
from worlds.robots import IDEAL_CALIBRATION, Calibration


class SensorInput(Protocol):
    """What the filter wants of a robot's state; nclient's RobotState has it. Seconds, inches, radians."""

    @property
    def clock_s(self) -> float | None: ...
    @property
    def x_in(self) -> float: ...
    @property
    def y_in(self) -> float: ...
    @property
    def steering_rad(self) -> float: ...
    @property
    def turret_rad(self) -> float: ...
    @property
    def sonars_in(self) -> tuple[float, ...]: ...


@dataclass(frozen=True, slots=True)
class SensorData:
    """The same, no longer as the robot said it."""

    clock_s: float | None
    x_in: float
    y_in: float
    steering_rad: float
    turret_rad: float
    sonars_in: tuple[float, ...]


def with_readings(told: SensorInput, sonars_in: tuple[float, ...], turret_rad: float | None = None) -> SensorData:
    """It with other readings of the sonars, and with the ring turned to `turret_rad` where that is given."""
    turret = told.turret_rad if turret_rad is None else turret_rad
    return SensorData(told.clock_s, told.x_in, told.y_in, told.steering_rad, turret, sonars_in)


LOWEST_IN: Final = 6
HIGHEST_IN: Final = 255
_INSIDE_IN: Final = 1e-3


def of(told: SensorInput, errs: Calibration) -> SensorInput:
    """What a robot tells, without what its sonars are known to get wrong."""
    if errs is IDEAL_CALIBRATION:
        return told
    sonars = tuple(_range_in(read, off) for read, off in zip(told.sonars_in, errs.offsets_in, strict=True))
    return with_readings(told, sonars, told.turret_rad + errs.turned_rad)


def with_wheels(pose: Belief, errs: Calibration) -> Belief:
    """A belief over poses (3,) with the constants of such wheels; those of a faultless robot change nothing."""
    if errs is IDEAL_CALIBRATION:
        return pose
    spread = errs.spread
    longer = with_parameters(pose, (spread.way_scale, spread.turn_scale, spread.drift_rad_in))
    longer.mean[POSE:] = np.array([errs.way_scale - 1.0, errs.turn_scale - 1.0, errs.drift_rad_in])
    return longer


def _range_in(reading_in: float, offset_in: float) -> float:
    """A reading at a limit says nothing of the range, and goes on saying it."""
    if not LOWEST_IN < reading_in < HIGHEST_IN:
        return reading_in
    return min(max(reading_in - offset_in, LOWEST_IN + _INSIDE_IN), HIGHEST_IN - _INSIDE_IN)


CLOCK_STEP_S = 0.0164
_TINY = 1e-9


class FiringTime(NamedTuple):
    """A sonar that fired, and when by the robot's clock."""

    sonar: int
    instant_s: float


@dataclass(frozen=True, slots=True)
class FiringSchedule:
    """A ring restarted at `start_s` of the robot's clock. `order`: sonar numbers, each at most once."""

    start_s: float
    rate: int = DEFAULT_SONAR_RATE
    order: tuple[int, ...] = DEFAULT_SONAR_ORDER

    @property
    def interval_s(self) -> float:
        """Seconds from one sonar to the next."""
        return self.rate * SONAR_RATE_STEP_S

    @property
    def round_s(self) -> float:
        """Seconds until the same sonar fires again."""
        return self.interval_s * len(self.order)

    def readable(self, after_s: float, now_s: float) -> list[FiringTime]:
        """Firings later than `after_s` whose echoes a state of clock `now_s` shows for certain, in order of time."""
        since_start = (after_s - self.start_s) / self.interval_s
        first = max(0, math.floor(since_start + _TINY) + 1) if after_s >= self.start_s else 0
        overwritten_s = now_s + CLOCK_STEP_S - self.round_s
        first = max(first, math.floor((overwritten_s - self.start_s) / self.interval_s + _TINY) + 1)
        last = math.floor((now_s - CLOCK_STEP_S - self.start_s) / self.interval_s + _TINY)
        return [
            FiringTime(self.order[k % len(self.order)], self.start_s + k * self.interval_s)
            for k in range(first, last + 1)
        ]


LONGEST_GAP_S = 0.5
"""Beyond this the way between two states is no single arc any more, and the estimate gets too sure of itself."""
REMEMBERED_S = 2.0
"""Longer than a ring takes, so that every echo still readable has its pose."""


class EncoderPose(NamedTuple):
    """The encoders at an instant: `pose` (3,) x_in, y_in, heading of the steering; the turret's angle beside it."""

    clock_s: float
    pose: Floats
    turret_rad: float

    @property
    def turret_offset_rad(self) -> float:
        """Turret less steering: where the ring's front looks, seen from the heading."""
        return self.turret_rad - float(self.pose[HEADING])


class PoseHistory:
    """The encoder poses of the last seconds."""

    def __init__(self) -> None:
        self._poses: deque[EncoderPose] = deque()

    @property
    def last_two(self) -> tuple[EncoderPose, EncoderPose]:
        """The last one added and the one before it; of one alone it is both."""
        return self._poses[max(len(self._poses) - 2, 0)], self._poses[-1]

    def add(self, pose: EncoderPose) -> None:
        """A pose later than all others; the oldest are forgotten."""
        self._poses.append(pose)
        while len(self._poses) > 2 and self._poses[1].clock_s < pose.clock_s - REMEMBERED_S:
            self._poses.popleft()

    @property
    def latest(self) -> EncoderPose:
        """The last one added."""
        return self._poses[-1]

    def at(self, instant_s: float) -> EncoderPose:
        """The pose at an instant; the nearest there is where it lies before or after all of them."""
        later = None
        for earlier in reversed(self._poses):
            if earlier.clock_s < instant_s:
                return earlier._replace(clock_s=instant_s) if later is None else _between(earlier, later, instant_s)
            later = earlier
        return self._poses[0]._replace(clock_s=instant_s)


def _between(earlier: EncoderPose, later: EncoderPose, instant_s: float) -> EncoderPose:
    share = (instant_s - earlier.clock_s) / (later.clock_s - earlier.clock_s)
    turned = wrapped(later.turret_rad - earlier.turret_rad)
    pose = add(earlier.pose, share * difference(later.pose, earlier.pose))
    return EncoderPose(instant_s, pose, earlier.turret_rad + share * turned)
