"""Driving without an estimate, and detection of a robot that does not move.

RecoveryBehavior turns in place and then drives where the sonars ahead measure free space: poses that look alike from
one position are distinguished on the path to another. Where the filter states a direction in which they differ, it
drives there. After a contact it backs off and turns away. ContactDetector reports a bumper that closes, MisfitDetector
a start that the readings do not fit, StallDetector a robot that presses against something or whose wheels stand.
"""

from dataclasses import dataclass
from math import cos, hypot, tau
from typing import Final

import numpy as np

from localization.filters.belief import Floats, difference
from localization.filters.health import HealthStatus
from localization.filters.update import OUTLIER_THRESHOLD, Refusal
from localization.live.localizer import Estimate
from localization.live.sensor_input import SensorInput, sonar_readings
from localization.navigation.control_law import distance_to
from nclient.state import RobotState
from worlds.rings import Ring
from worlds.robots import N150

TURN_RAD_S: Final = 0.4
SCAN_RAD: Final = 4.0
"""Turn before driving on: two thirds of a revolution, in which each sonar measures a wall or two."""
DRIVE_IN_S, MAX_DRIVE_IN_S = 3.0, 8.0
"""Speeds beside walls, and far from any."""
FREE_S: Final = 5.0
"""The free way ahead lasts this long at least: five rings."""
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
        ahead_in = _free_ahead_in(state, self._ring)
        is_free = ahead_in > FREE_AHEAD_IN
        if turn_rad is not None and self._avoiding_rad <= 0.0:
            if abs(turn_rad) > ALIGNED_RAD:
                return 0.0, TURN_RAD_S if turn_rad > 0.0 else -TURN_RAD_S
            self._scanned_rad = SCAN_RAD
        if self._scanned_rad >= SCAN_RAD and is_free and self._avoiding_rad <= AVOID_RAD - TURN_AWAY_RAD:
            self._avoiding_rad -= turn
            return min(max(ahead_in / FREE_S, DRIVE_IN_S), self._max_speed_in_s), 0.0
        # 3. Something is: turn until it is not, and drive on before turning back to it.
        if not is_free:
            self._avoiding_rad = AVOID_RAD - TURN_AWAY_RAD
        else:
            self._avoiding_rad -= turn
        self._scanned_rad += turn
        return 0.0, TURN_RAD_S


def _free_ahead_in(state: SensorInput, ring: Ring) -> float:
    """Return the shortest reading of the sonars that look ahead."""
    readings = sonar_readings(state)[: ring.count]
    directions = np.array(ring.angles_rad[: len(readings)]) + state.turret_rad - state.steering_rad
    beams = zip(readings, directions, strict=True)
    return min((reading for reading, direction in beams if cos(direction) >= AHEAD), default=0)


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
        if estimate.health.status is HealthStatus.LOST:
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
        return hypot(x, y) >= PROGRESS_IN or abs(turned) >= PROGRESS_RAD
