"""Driving without an estimate: turning on the spot to look around, and then on wherever the sonars ahead hear room.

Places that look alike from one spot are told apart on the way to another. Rules: readings in, velocities out; no map,
no robot, no clock: it is asked once a period.

Whether a robot that is driven to a way-point gets nowhere: it presses against something, or its wheels stand.

    free         it makes way where its encoders move by WAY_IN or turn by TURN_RAD
    touching     wheels may slip and bodies slide: it makes way where the estimate comes nearer to it by SLIDE_IN

Without way for `patience_s` there is something that the map does not have, or the way-point is where no robot can be.
Rules: pure; states and estimates in, a reason in words out; times are of the robot's clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, tau
from typing import Final, Protocol

import numpy as np

from localization.filters.belief import Floats, difference
from localization.navigation.speed import distance_to
from nclient.state import RobotState

TURN_RAD_S: Final = 0.4
LOOK_RAD: Final = 4.0
"""How far it turns before it drives on: two thirds of a turn, in which each sonar hears a wall or two."""
DRIVE_IN_S: Final = 3.0
ROOM_AHEAD_IN: Final = 18.0
AHEAD: Final = cos(tau / 8)


class SonarState(Protocol):
    """What is looked at of a robot's state."""

    @property
    def sonars_in(self) -> tuple[int, ...]: ...
    @property
    def steering_rad(self) -> float: ...
    @property
    def turret_rad(self) -> float: ...


class RecoveryBehavior:
    """See the head of this file. `period_s`: how often it is asked."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._looked_rad = 0.0

    def reset(self) -> None:
        """The place is known again; the next time begins with a look around."""
        self._looked_rad = 0.0

    def command(self, state: SonarState) -> tuple[float, float]:
        """Translation in in/s and steering in rad/s."""
        if self._looked_rad < LOOK_RAD or not _room_ahead(state):
            self._looked_rad += TURN_RAD_S * self._period_s
            return 0.0, TURN_RAD_S
        return DRIVE_IN_S, 0.0


def _room_ahead(state: SonarState) -> bool:
    """Whether all sonars that look ahead, an eighth of a turn to either side, hear nothing near."""
    looking = np.arange(len(state.sonars_in)) * (tau / len(state.sonars_in)) + state.turret_rad - state.steering_rad
    heard = zip(state.sonars_in, looking, strict=True)
    return all(reading > ROOM_AHEAD_IN for reading, way in heard if cos(way) >= AHEAD)


PATIENCE_S: Final = 5.0
WAY_IN: Final = 0.2
TURN_RAD: Final = 0.1
SLIDE_IN: Final = 0.5


@dataclass(frozen=True, slots=True)
class ProgressMark:
    """Where it last made way: encoders (3,), the way-point (2,), the distance from it."""

    clock_s: float
    encoders: Floats
    goal: Floats
    left_in: float


class StallDetector:
    """Looks on a period at a time. `speed_in_s` > 0: it is driven no faster; the slower, the more patient this is."""

    def __init__(self, speed_in_s: float) -> None:
        self.patience_s = max(PATIENCE_S, 2.0 * WAY_IN / speed_in_s)
        self._mark: ProgressMark | None = None

    def reason(self, clock_s: float, state: RobotState, pose: Floats, goal: Floats | None) -> str:
        """Why there is no use in driving on to `goal` (2,) from the estimate `pose` (3,); "" while there is.

        A robot that is sent nowhere (None) is in nobody's way.
        """
        if goal is None:
            self._mark = None
            return ""
        encoders = np.array([state.x_in, state.y_in, state.steering_rad])
        left_in = float(distance_to(pose, goal))
        mark = self._mark
        if mark is None or not np.array_equal(mark.goal, goal) or self._makes_way(mark, state, encoders, left_in):
            self._mark = mark = ProgressMark(clock_s, encoders, goal, left_in)
        if clock_s - mark.clock_s < self.patience_s:
            return ""
        where = f"{clock_s - mark.clock_s:.0f} s long, {left_in:.1f} in before ({goal[0]:g}, {goal[1]:g})"
        if state.touching:
            return f"it presses against something {where}: bumpers {', '.join(map(str, state.bumpers))} touch"
        return (
            f"it makes no way {where}, though it is told to drive: is it held (nserver ctl status tells), or its "
            "emergency button pressed?"
        )

    @staticmethod
    def _makes_way(mark: ProgressMark, state: RobotState, encoders: Floats, left_in: float) -> bool:
        if state.touching:
            return left_in <= mark.left_in - SLIDE_IN
        x, y, turned = difference(encoders, mark.encoders)
        return hypot(x, y) >= WAY_IN or abs(turned) >= TURN_RAD
