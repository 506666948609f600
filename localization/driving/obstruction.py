"""Whether a robot that is driven to a way-point gets nowhere: it presses against something, or its wheels stand.

    free         it makes way where its encoders move by WAY_IN or turn by TURN_RAD
    touching     wheels may slip and bodies slide: it makes way where the estimate comes nearer to it by SLIDE_IN

Without way for `patience_s` there is something that the map does not have, or the way-point is where no robot can be.
Rules: pure; states and estimates in, a reason in words out; times are of the robot's clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np

from localization.driving.control import distance_to
from localization.filters.belief import Floats, difference
from nclient.robot_state import RobotState

PATIENCE_S: Final = 5.0
WAY_IN: Final = 0.2
TURN_RAD: Final = 0.1
SLIDE_IN: Final = 0.5


@dataclass(frozen=True, slots=True)
class _Mark:
    """Where it last made way: encoders (3,), the way-point (2,), the distance from it."""

    clock_s: float
    encoders: Floats
    goal: Floats
    left_in: float


class Obstruction:
    """Looks on a period at a time. `speed_in_s` > 0: it is driven no faster; the slower, the more patient this is."""

    def __init__(self, speed_in_s: float) -> None:
        self.patience_s = max(PATIENCE_S, 2.0 * WAY_IN / speed_in_s)
        self._mark: _Mark | None = None

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
            self._mark = mark = _Mark(clock_s, encoders, goal, left_in)
        if clock_s - mark.clock_s < self.patience_s:
            return ""
        where = f"{clock_s - mark.clock_s:.0f} s long, {left_in:.1f} in before ({goal[0]:g}, {goal[1]:g})"
        if state.touching:
            return f"it presses against something {where}: bumpers {', '.join(map(str, state.bumpers))} touch"
        return (f"it makes no way {where}, though it is told to drive: is it held (nserver ctl status tells), or its "
                "emergency button pressed?")

    @staticmethod
    def _makes_way(mark: _Mark, state: RobotState, encoders: Floats, left_in: float) -> bool:
        if state.touching:
            return left_in <= mark.left_in - SLIDE_IN
        x, y, turned = difference(encoders, mark.encoders)
        return hypot(x, y) >= WAY_IN or abs(turned) >= TURN_RAD
