"""From an estimate to what the axes shall do, until the goals are reached or there is a reason why not.

    plan ──> follow ──> (a find in the way, off the course, known too badly) ──> plan again
      │        └─ a bumper touches ──> stop, back off, plan again around what was felt; after most_touches give up
      └─ no way because of finds: stand and wait, for things are moved; after blocked_s give up

Goals are way-points: all but the last are passed by within `within_in`, the last is stopped at, and a heading turned to
there. Rules: no robot, no clock but the estimate's; waits end. An estimate that is LOST ends it: others see to that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import hypot, inf, pi
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.filters.health import HealthStatus
from localization.live.localizer import Estimate
from localization.navigation.obstacles import ObstacleTracker
from localization.navigation.path import angle_difference, room
from localization.navigation.path_follower import STAND, TURNED_RAD, Follower, Velocities, turn
from localization.navigation.planner import MARGINS_IN, Plan, Planner
from localization.navigation.roadmap import NoPathError, Point
from localization.navigation.speed import AxisLimits, allowed_speed_fraction
from nclient.state import RobotState


class Ending(Enum):
    """How driving to goals ended."""

    ARRIVED = "arrived"
    BLOCKED = "blocked"
    TOUCHED = "touched"
    UNCERTAIN = "uncertain"
    ASTRAY = "astray"
    LOST = "lost"


class Outcome(NamedTuple):
    """How it ended, and why in words."""

    ending: Ending
    reason: str


@dataclass(frozen=True, slots=True)
class Patience:
    """When to give up, and how to help oneself.

    within_in       the last goal counts as reached within this         heading_rad     and its heading within this
    most_touches    touches, the last of which is one too many          most_plans      plans for one goal
    blocked_s       waiting for what is in the way to go away           uncertain_s     standing to hear more
    back_off_in     after a touch, at back_off_in_s, back_off_s at most
    """

    within_in: float = 1.0
    heading_rad: float = 0.05
    most_touches: int = 4
    most_plans: int = 60
    blocked_s: float = 20.0
    uncertain_s: float = 10.0
    back_off_in: float = 4.0
    back_off_in_s: float = 2.0
    back_off_s: float = 4.0


ASIDE_IN: Final = 3.0
"""Farther beside its course than this the robot plans anew."""
FIND_MARGIN_IN: Final = 1.5
"""Room between body and a find that a course must leave, or half of what it was planned with where that is less."""
SUSPECT_IN, SUSPECT_S, STOP_BEFORE_IN = 30.0, 3.0, 2.0
"""Three rings make a suspect sure; until then the robot keeps so far from where it would touch it."""
BESIDE_IN, BESIDE_IN_S = 12.0, 3.0
"""No faster than this where a find is so near."""
PASSING: Final = 0.6
"""Share of `within_in` that a course may pass a way-point by: the robot is not exactly on it."""
PUT_ASIDE_S: Final = 1.0
"""Time between plans for the same reason."""


@dataclass
class _Backing:
    """Going back from a touch: which way, since when, from where the encoders stood."""

    velocity_in_s: float
    since_s: float
    encoders: tuple[float, float]


@dataclass
class Log:
    """What happened on the way."""

    plans: list[Plan] = field(default_factory=list)
    touches: list[Point] = field(default_factory=list)
    notes: list[tuple[float, str]] = field(default_factory=list)
    """Clock and words."""


class Pilot:
    """Drives to goals; asked once a period. `heading_rad`: to turn to at the last goal, None for any."""

    def __init__(
        self,
        planner: Planner,
        limits: AxisLimits,
        unmapped: ObstacleTracker,
        goals: Sequence[Point],
        heading_rad: float | None = None,
        patience: Patience | None = None,
    ) -> None:
        self._planner, self._limits, self._unmapped = planner, limits, unmapped
        self._goals, self._heading_rad = list(goals), heading_rad
        self.patience = patience or Patience()
        self.log = Log()
        self.outcome: Outcome | None = None
        self._follower: Follower | None = None
        self._backing: _Backing | None = None
        self._towards = 1.0
        self._least_in = 0.0
        self._blocked_s = self._uncertain_s = inf
        self._tried_s = -inf

    @property
    def goals_left(self) -> tuple[Point, ...]:
        """Those not reached yet."""
        return tuple(self._goals)

    def step(self, estimate: Estimate, state: RobotState) -> Velocities:
        """What to do in the next period; STAND once there is an outcome."""
        if self.outcome:
            return STAND
        command = self._step(estimate, state)
        if command.translation_in_s:
            self._towards = command.translation_in_s
        return command

    def _step(self, estimate: Estimate, state: RobotState) -> Velocities:
        if estimate.health.status is HealthStatus.LOST:
            return self._end(Ending.LOST, estimate.health.reason)
        if self._backing:
            return self._back_off(estimate, state, self._backing)
        if state.touching:
            return self._touched(estimate, state)
        self._pass_by(estimate.pose)
        if self._follower is None or self._stale(self._follower, estimate.clock_s):
            planned = self._plan(estimate)
            if planned is None:
                return STAND
            self._follower = planned
        if self._follower.finished:
            return self._at_the_end(estimate)
        return self._drive(self._follower, estimate)

    # the way

    def _pass_by(self, pose: Floats) -> None:
        while len(self._goals) > 1 and hypot(*(pose[:2] - self._goals[0])) <= self.patience.within_in:
            del self._goals[0]

    def _stale(self, follower: Follower, now_s: float) -> bool:
        """Whether finds stand in what is left of the course, or the robot is far beside it."""
        if abs(follower.aside_in) > ASIDE_IN:
            self.log.notes.append((now_s, f"{abs(follower.aside_in):.1f} in beside the course"))
            return True
        finds = self._unmapped.segments
        left = follower.left()
        if not len(finds) or not len(left) or now_s < self._tried_s + PUT_ASIDE_S:
            return False
        kept_in = min(FIND_MARGIN_IN, 0.5 * self.log.plans[-1].margin_in)
        return bool(room(left, finds).min() < self._planner.body_in + kept_in)

    def _plan(self, estimate: Estimate) -> Follower | None:
        """A new course; None while there is none, and once there is an outcome."""
        now_s, finds = estimate.clock_s, self._unmapped.segments
        if self._blocked_s < inf and now_s < self._tried_s + PUT_ASIDE_S:
            return None
        self._tried_s = now_s
        if len(self.log.plans) >= self.patience.most_plans:
            self._end(Ending.ASTRAY, f"planned {len(self.log.plans)} times and not arrived")
            return None
        start = (float(estimate.pose[0]), float(estimate.pose[1]))
        try:
            plan = self._course(start, finds)
        except NoPathError as error:
            self._blocked(now_s, error, bool(len(finds)))
            return None
        self._blocked_s = inf
        self.log.plans.append(plan)
        return Follower(plan.course, self._limits)

    def _course(self, start: Point, finds: Floats) -> Plan:
        if len(self._goals) > 1:
            plan = self._planner.along([start, *self._goals], PASSING * self.patience.within_in, self._limits)
            points = np.concatenate([stretch.points(1.0) for stretch in plan.course])
            if not len(finds) or room(points, finds).min() >= self._planner.body_in + FIND_MARGIN_IN:
                return plan
        return self._planner.plan(start, self._goals[0], finds, self._least_in)

    def _blocked(self, now_s: float, error: NoPathError, by_finds: bool) -> None:
        self._follower = None
        if not by_finds:
            self._end(Ending.BLOCKED, str(error))
            return
        self._blocked_s = min(self._blocked_s, now_s)
        if now_s - self._blocked_s >= self.patience.blocked_s:
            self._end(Ending.BLOCKED, f"something that the map does not have is in the way: {error}")

    def _at_the_end(self, estimate: Estimate) -> Velocities:
        """The course is behind: turn to the heading, or plan again where the estimate has moved meanwhile."""
        if hypot(*(estimate.pose[:2] - self._goals[0])) > self.patience.within_in:
            self._follower = None
            return STAND
        if len(self._goals) > 1:
            del self._goals[0]
            self._follower = None
            return STAND
        if self._heading_rad is not None:
            left = angle_difference(float(estimate.pose[2]), self._heading_rad)
            if abs(left) > min(TURNED_RAD, self.patience.heading_rad):
                return turn(left, self._limits)
        return self._end(Ending.ARRIVED, "arrived")

    def _drive(self, follower: Follower, estimate: Estimate) -> Velocities:
        """Go on, as fast as the estimate allows."""
        command = follower.command(estimate.pose)
        ahead = follower.ahead(self._reach_in(command))
        if ahead is None or not command.translation_in_s:
            return command
        cov = estimate.belief.cov[:3, :3]
        share = allowed_speed_fraction(estimate.pose, ahead, cov, self._planner.walls, self._planner.body_in)
        if share > 0.0:
            self._uncertain_s = inf
            careful = min(self._unless_suspect(follower, command), self._beside_finds(estimate, command))
            return follower.command(estimate.pose, min(share, careful))
        return self._too_uncertain(estimate, ahead)

    def _unless_suspect(self, follower: Follower, command: Velocities) -> float:
        """The share of the speed at which what is suspected on the next SUSPECT_IN of the course is not reached before
        it is sure, or seen through: SUSPECT_S."""
        suspects = self._unmapped.suspects
        if not len(suspects):
            return 1.0
        near = room(follower.left(1.0, SUSPECT_IN), suspects) < self._planner.body_in + FIND_MARGIN_IN
        if not near.any():
            return 1.0
        left = float(near.argmax()) - STOP_BEFORE_IN
        return min(1.0, max(0.0, left / SUSPECT_S) / command.translation_in_s)

    def _beside_finds(self, estimate: Estimate, command: Velocities) -> float:
        """The share of the speed beside what the map does not have: how far it reaches is not known."""
        finds = self._unmapped.segments
        if not len(finds) or room(estimate.pose[None, :2], finds)[0] > self._planner.body_in + BESIDE_IN:
            return 1.0
        return min(1.0, BESIDE_IN_S / command.translation_in_s)

    def _reach_in(self, command: Velocities) -> float:
        """How far ahead a robot at this speed comes before it stands, and a little more."""
        speed = command.translation_in_s
        return 1.0 + 0.3 * speed + speed * speed / self._limits.translation_in_s2

    def _too_uncertain(self, estimate: Estimate, ahead: Floats) -> Velocities:
        """Stand and listen; then plan with more room, and give up where there is none."""
        now_s = estimate.clock_s
        self._uncertain_s = min(self._uncertain_s, now_s)
        if now_s - self._uncertain_s < self.patience.uncertain_s:
            return STAND
        there_is = max(self._least_in, self.log.plans[-1].margin_in)
        wider = [margin for margin in MARGINS_IN if margin > there_is]
        if wider:
            self._least_in, self._uncertain_s, self._follower = wider[0], inf, None
            self.log.notes.append((now_s, f"known too badly for the room there is: {wider[0]:g} in wanted from now on"))
            return STAND
        spread = 3.0 * float(np.sqrt(np.linalg.eigvalsh(estimate.belief.cov[:2, :2])[-1]))
        left = float(room(ahead[None, :], self._planner.walls)[0]) - self._planner.body_in
        return self._end(Ending.UNCERTAIN, f"the place is known to {spread:.1f} in (3 sigma), {left:.1f} in are left")

    # touches

    def _touched(self, estimate: Estimate, state: RobotState) -> Velocities:
        x, y, heading = (float(value) for value in estimate.pose)
        self._unmapped.touch(
            estimate.clock_s, (x, y), heading if self._towards > 0.0 else heading + pi, self._planner.body_in
        )
        self.log.touches.append((x, y))
        self.log.notes.append((estimate.clock_s, f"touched something at ({x:.1f}, {y:.1f})"))
        if len(self.log.touches) >= self.patience.most_touches:
            return self._end(
                Ending.TOUCHED, f"touched something {len(self.log.touches)} times, last at ({x:.1f}, {y:.1f})"
            )
        back = -self.patience.back_off_in_s if self._towards > 0.0 else self.patience.back_off_in_s
        self._backing = _Backing(back, estimate.clock_s, (state.x_in, state.y_in))
        return STAND

    def _back_off(self, estimate: Estimate, state: RobotState, backing: _Backing) -> Velocities:
        gone = hypot(state.x_in - backing.encoders[0], state.y_in - backing.encoders[1])
        if gone < self.patience.back_off_in and estimate.clock_s - backing.since_s < self.patience.back_off_s:
            return Velocities(backing.velocity_in_s, 0.0)
        self._backing, self._follower = None, None
        return STAND

    def _end(self, ending: Ending, reason: str) -> Velocities:
        self.outcome = Outcome(ending, reason)
        return STAND
