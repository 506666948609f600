"""A robot with its estimate, one control period at a time: command in, estimate and obstacles out.

    period(command):    drive ──> wait for the rest of PERIOD_S ──> refresh ──> localizer ──> obstacles ──> observers

Waiting is a parameter; the time is the robot's clock. Observers are called in every period and may end it by raising.
Leaving the controller's `with` block stops the robot.
"""

import contextlib
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import Belief, Floats
from localization.filters.registry import DEFAULT_METHOD
from localization.live.localizer import Estimate
from localization.live.publish import Publisher, build_message
from localization.live.run import GroundTruth
from localization.navigation.limits import MODEL_LIMITS, STAND, StateGapLimiter, VelocityCommand
from localization.navigation.mission_settings import Point
from localization.navigation.obstacles import ObstacleTracker, filter_unmapped, update_obstacles
from localization.navigation.roadmap import Planner
from localization.navigation.waypoints import (
    COMMAND_TIMEOUT_S,
    Speeds,
    drive_unless_held,
    start_localizer,
    wait_for_next_state,
)
from nclient.errors import BumperHit, NomadError
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.robots import Body


class Observation(NamedTuple):
    """One period: the estimate and the robot's state."""

    estimate: Estimate
    state: RobotState


Observer = Callable[[Observation], None]
Wait = Callable[[float], None]


class RobotController:
    """A robot localized from an initial belief and commanded one period at a time.

    Parameters
    ----------
    robot : Robot
    config : LocalizationConfig
        Map, robot, sensor and noise models.
    body : Body
    belief : Belief
        Initial belief.
    wait : callable
        `wait(seconds)` lets time of the robot pass.
    method : str or Filter
        Name of a filter, or a filter.
    speed_in_s : float
        Top speed.
    """

    def __init__(
        self,
        robot: Robot,
        config: LocalizationConfig,
        body: Body,
        belief: Belief,
        wait: Wait,
        method: str | Filter = DEFAULT_METHOD,
        speed_in_s: float = Speeds().translation_in_s,
    ) -> None:
        walls = np.asarray(config.walls, dtype=np.float64)
        self.robot, self.body, self._wait = robot, body, wait
        self.limits = MODEL_LIMITS[body.name].capped(speed_in_s, Speeds().steering_rad_s)
        self.planner = Planner(walls, body.radius_in)
        self.obstacles = ObstacleTracker(walls, body.sonar_ring_radius_in)
        self.observers: list[Observer] = []
        robot.set_timeout(COMMAND_TIMEOUT_S)
        self._gap_limiter = StateGapLimiter()
        self._localizer = start_localizer(robot, config, belief, method)
        state = robot.refresh()
        self.last = Observation(self._localizer.update(state), state)
        """The observation of the last period."""
        self._moved_s = self.clock_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(*(() if error is None else (NomadError,))):
            self.robot.stop()

    @property
    def clock_s(self) -> float:
        """The robot's clock at the last estimate."""
        return self.last.estimate.clock_s

    @property
    def unmoved_s(self) -> float:
        """Time for which the robot has been commanded to move and stands without contact."""
        return self.clock_s - self._moved_s

    def add_fence(self, edges: Floats) -> None:
        """Treat edges (k, 4) as walls in all future plans."""
        self.planner = Planner(np.concatenate((self.planner.walls, edges)), self.body.radius_in)

    def period(self, command: VelocityCommand = STAND) -> Observation:
        """Drive for one period, slower if states arrive far apart, and return the observation at its end.

        Errors of the robot and of observers are propagated; contacts are not errors here.
        """
        # 1. Command and wait.
        before = self.last.state
        after, fraction = before, self._gap_limiter.speed_fraction(self.clock_s)
        with contextlib.suppress(BumperHit):
            after = drive_unless_held(
                self.robot,
                translation_in_s=fraction * command.translation_in_s,
                steering_rad_s=fraction * command.steering_rad_s,
            )
        # 2. Estimate.
        self.last = self._observe(wait_for_next_state(self.robot, before, after, self._wait))
        if command == STAND or self.last.state.touching or _has_moved(before, self.last.state):
            self._moved_s = self.clock_s
        # 3. Notify.
        for observer in self.observers:
            observer(self.last)
        return self.last

    def _observe(self, state: RobotState) -> Observation:
        ring = self.body.ring
        angles, shortest_in = ring.angles_rad, ring.plain(ring.min_range_in)
        seen = filter_unmapped(self.obstacles, self.last.estimate, state, angles, shortest_in)
        estimate = self._localizer.update(seen)
        update_obstacles(self.obstacles, estimate, state, angles)
        return Observation(estimate, state)


def _has_moved(before: RobotState, after: RobotState) -> bool:
    return (before.x_in, before.y_in, before.steering_rad) != (after.x_in, after.y_in, after.steering_rad)


class ProgressPublisher:
    """Observer that shows the mission on the page of an nserver (`--publish URL` of `nomad go` and `nomad mission`).

    Waypoints set on the page are ignored, because the mission has its own. `goals` are shown as waypoints and may
    change; the ground truth is shown beside the estimate where it is available.
    """

    def __init__(self, publisher: Publisher, ground_truth: GroundTruth, goals: Sequence[Point]) -> None:
        self._publisher, self._ground_truth, self._goals = publisher, ground_truth, goals

    def __call__(self, observation: Observation) -> None:
        """Publish the estimate, the odometry and the ground truth of this period."""
        moment = self._ground_truth.moment(*observation)
        self._publisher.publish(build_message(self._ground_truth.robot_id, moment, self._goals))
