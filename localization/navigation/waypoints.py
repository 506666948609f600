"""Driving to way-points on an estimate: the thesis' control law, turned into velocities for a real robot's axes.

    refresh ──> localizer ──> navigator ──> drive ──> wait for the rest of the period, and round again

Rules: speaks to a robot through nclient's names only; waiting is handed in, so the loop knows no clock of its own.
The law's limits are a step's; at a step every PERIOD_S they are speeds.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import Belief, Floats
from localization.filters.health import HealthStatus
from localization.filters.registry import DEFAULT_METHOD
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule
from localization.navigation.recovery import RecoveryBehavior
from localization.navigation.speed import ControlGains, Pace, PoseSmoother, distance_to, next_step
from nclient.errors import NomadError
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from nclient.state import RobotState

PERIOD_S = 0.1
"""The law's step (ROBOTS.md)."""
STOP_RADIUS_IN = 1.0
"""A way-point of a live run counts as reached within this."""
SHORTEST_WAIT_S = 0.001
"""A robot's clock counts in milliseconds at the finest."""
COMMAND_TIMEOUT_S = 2
"""The robot stops by itself when no command comes for so long."""


@dataclass(frozen=True, slots=True)
class Speeds:
    """Limits of a live run. The shares of the error that a period corrects are the thesis'."""

    translation_in_s: float = 5.0
    steering_rad_s: float = 0.5
    alpha_rho: float = 0.1
    alpha_theta: float = 0.1

    @property
    def gains(self) -> ControlGains:
        """The same as limits of one step."""
        return ControlGains(
            self.translation_in_s * PERIOD_S, self.steering_rad_s * PERIOD_S, self.alpha_rho, self.alpha_theta
        )


class Command(NamedTuple):
    """Velocities to drive at."""

    translation_in_s: float
    steering_rad_s: float


class Navigator:
    """From way-point to way-point. `waypoints`: (x, y) in inches, visited in order; `stays`: where there is nowhere
    left to go the robot stands, ready to be sent on."""

    def __init__(
        self,
        waypoints: Sequence[tuple[float, float]],
        speeds: Speeds | None = None,
        radius_in: float = STOP_RADIUS_IN,
        *,
        stays: bool = False,
    ) -> None:
        self._stays = stays
        self._goals = [np.array(point, dtype=np.float64) for point in waypoints]
        self._gains = (speeds or Speeds()).gains
        self._radius_in = radius_in
        self.passed = 0
        """How many way-points are behind."""

    @property
    def finished(self) -> bool:
        """Whether the last way-point was reached."""
        return self.passed == len(self._goals)

    @property
    def goal(self) -> Floats | None:
        """The way-point ahead (2,); None behind the last."""
        return None if self.finished else self._goals[self.passed]

    def go(self, waypoints: Sequence[tuple[float, float]]) -> None:
        """Leave the way-points that are left, and go to these."""
        self._goals = [np.array(point, dtype=np.float64) for point in waypoints]
        self.passed = 0

    def command(self, pose: Floats) -> Command | None:
        """What to do at this pose (3,); None when there is nowhere left to go and nothing to wait for."""
        while not self.finished and distance_to(pose, self._goals[self.passed]) <= self._radius_in:
            self.passed += 1
        if self.finished:
            return Command(0.0, 0.0) if self._stays else None
        step = next_step(pose, self._goals[self.passed], self._gains) / PERIOD_S
        return Command(float(step[0]), float(step[1]))


class Progress(NamedTuple):
    """A moment of a run."""

    estimate: Estimate
    state: RobotState
    passed: int


def begin(robot: Robot, known: LocalizationConfig, belief: Belief, method: str | Filter = DEFAULT_METHOD) -> Localizer:
    """Restart the robot's ring, so that its firing instants are known, and start a filter on it: a name of
    filters.table, or one that is made."""
    state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    localizer = Localizer(known, belief, FiringSchedule(state.clock_s), method)
    localizer.update(state)
    return localizer


def follow(
    robot: Robot,
    localizer: Localizer,
    navigator: Navigator,
    wait: Callable[[float], None],
    steady: PoseSmoother | None = None,
) -> Generator[Progress, None, None]:
    """Drive until the navigator is done, and tell of each period; the robot stands at the end, however it ends. While
    it is LOST it looks for itself (groping) instead. Where states come far apart it goes slower (pace).

    `wait(seconds)` lets real time pass; it is asked only for what the robot's own clock has not gone by itself.
    `steady`: what makes the pose to steer by of the estimates; the estimates themselves where there is none.
    """
    steady, groping, pace = steady or PoseSmoother(0.0), RecoveryBehavior(PERIOD_S), Pace()
    robot.set_timeout(COMMAND_TIMEOUT_S)
    state = robot.refresh()
    with stop_on_exit(robot):
        while True:
            estimate = localizer.update(state)
            encoders = np.array([state.x_in, state.y_in, state.steering_rad])
            command: Command | None
            if estimate.health.status is HealthStatus.LOST:
                steady.forget()
                command = Command(*groping.command(state))
            else:
                groping.reset()
                command = navigator.command(steady.update(estimate.clock_s, estimate.pose, encoders))
            yield Progress(estimate, state, navigator.passed)
            if command is None:
                return
            translation_in_s, steering_rad_s = (pace.share(estimate.clock_s) * speed for speed in command)
            after = robot.drive(translation_in_s=translation_in_s, steering_rad_s=steering_rad_s)
            state = wait_for_next_state(robot, state, after, wait)


@contextlib.contextmanager
def stop_on_exit(robot: Robot) -> Iterator[None]:
    """The robot stands at the end of this, however it ends; where an error ends it, that is what is told, not what
    stopping has against it."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(NomadError):
            robot.stop()
        raise
    robot.stop()


def wait_for_next_state(
    robot: Robot, before: RobotState, after: RobotState, wait: Callable[[float], None]
) -> RobotState:
    """The state a period after `before`. A real robot shows no speed of time: its time is ours."""
    left_s = PERIOD_S - ((after.clock_s or 0.0) - (before.clock_s or 0.0))
    if left_s >= SHORTEST_WAIT_S:
        wait(left_s / (after.speed_factor or 1.0))
    return robot.refresh()
