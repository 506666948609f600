"""A robot and its estimate, a period at a time: command out, state in, estimate, finds.

    period(command):    drive ──> wait for the rest of PERIOD_S ──> refresh ──> localizer ──> unmapped ──> watchers

Rules: speaks to a robot through nclient's names only; waiting is handed in, the time is the robot's clock. Watchers see
every period and may end it by raising. Whoever holds a helm stops the robot: leaving its `with` block does.

What is believed on the way, shown on the page of an nserver (`nomad go|mission --publish URL`).

    helm ──> every period: estimate, verdict, places ──> publishing

Rules: it looks on; way-points that are set at the page are not gone to, for the mission knows its own. A page that
cannot be reached at the beginning is an error, before anything moves.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, Floats
from localization.filters.registry import DEFAULT_METHOD
from localization.live.localizer import Estimate
from localization.live.publish import Publisher, message
from localization.live.run import GroundTruth, RunMoment
from localization.missions.settings import Point
from localization.navigation.obstacles import ObstacleTracker, filter_unmapped, update_obstacles
from localization.navigation.path_follower import STAND, Velocities
from localization.navigation.planner import Planner
from localization.navigation.speed import LIMITS, Pace
from localization.navigation.waypoints import COMMAND_TIMEOUT_S, Speeds, begin, wait_for_next_state
from nclient.errors import BumperHit, NomadError
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.robots import Body


class Observation(NamedTuple):
    """A period: what is believed, and what the robot said."""

    estimate: Estimate
    state: RobotState


Watcher = Callable[[Observation], None]
Wait = Callable[[float], None]


class RobotController:
    """A robot that stands where `belief` says, and is told what to do a period at a time.

    `speed_in_s`, `turn_rad_s`: it is driven no faster. `wait(seconds)` lets real time pass, as in navigation.
    """

    def __init__(
        self,
        robot: Robot,
        known: LocalizationConfig,
        body: Body,
        belief: Belief,
        wait: Wait,
        method: str = DEFAULT_METHOD,
        speed_in_s: float = Speeds().translation_in_s,
        turn_rad_s: float = Speeds().steering_rad_s,
    ) -> None:
        self.robot, self.body, self._wait = robot, body, wait
        self.limits = LIMITS[body.name].capped(speed_in_s, turn_rad_s)
        self.planner = Planner(_walls(known), body.radius_in)
        self.unmapped = ObstacleTracker(_walls(known), body.sonar_ring_radius_in)
        self.watchers: list[Watcher] = []
        robot.set_timeout(COMMAND_TIMEOUT_S)
        self._pace = Pace()
        self._localizer = begin(robot, known, belief, method)
        state = robot.refresh()
        self.sight = Observation(self._localizer.update(state), state)
        self._obeyed_s = self.clock_s

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
        return self.sight.estimate.clock_s

    @property
    def unmoved_s(self) -> float:
        """For how long it was told to move now and stands, touching nothing."""
        return self.clock_s - self._obeyed_s

    def fence(self, edges: Floats) -> None:
        """Keep inside of these edges (k, 4) as if they were walls, from the next plan on."""
        self.planner = Planner(np.concatenate((self.planner.walls, edges)), self.body.radius_in)

    def period(self, command: Velocities = STAND) -> Observation:
        """Drive so for a period, slower where states come far apart (pace); what is seen at its end. Raises what robot
        and watchers raise."""
        before = self.sight.state
        after, share = before, self._pace.share(self.clock_s)
        with contextlib.suppress(BumperHit):
            after = self.robot.drive(
                translation_in_s=share * command.translation_in_s, steering_rad_s=share * command.steering_rad_s
            )
        self.sight = self._look(wait_for_next_state(self.robot, before, after, self._wait))
        if command == STAND or self.sight.state.touching or _moved(before, self.sight.state):
            self._obeyed_s = self.clock_s
        for watcher in self.watchers:
            watcher(self.sight)
        return self.sight

    def _look(self, state: RobotState) -> Observation:
        angles = self.body.sonar_angles_rad
        estimate = self._localizer.update(filter_unmapped(self.unmapped, self.sight.estimate, state, angles))
        update_obstacles(self.unmapped, estimate, state, angles)
        return Observation(estimate, state)


def _moved(before: RobotState, after: RobotState) -> bool:
    return (before.x_in, before.y_in, before.steering_rad) != (after.x_in, after.y_in, after.steering_rad)


def _walls(known: LocalizationConfig) -> Floats:
    return np.asarray(known.walls, dtype=np.float64)


class ProgressPublisher:
    """A watcher of a helm. `goals`: what is shown as way-points, whenever it changes; the truth beside the estimate is
    the witness's."""

    def __init__(self, publisher: Publisher, witness: GroundTruth, goals: Sequence[Point]) -> None:
        self._publisher, self._witness, self._goals = publisher, witness, goals

    def __call__(self, sight: Observation) -> None:
        estimate, state = sight
        odometry = (state.x_in, state.y_in, state.steering_rad)
        moment = RunMoment(estimate, odometry, self._witness.at(estimate.clock_s), 0, state.turret_rad)
        turned = state.turret_rad - state.steering_rad
        self._publisher.tell(message(self._witness.robot_id, moment, turned, self._goals))
