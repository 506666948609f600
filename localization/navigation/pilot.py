"""A robot with its estimate, and a pilot that drives it to goals until there is a reason to give up.

    plan ──> follow ──> (obstacle on the path, off the path, too uncertain) ──> plan again
      │        └─ bumper contact ──> stop, back off, plan around the contact; give up after max_touches
      └─ no path because of obstacles: stand and wait for them to move; give up after blocked_s

All goals but the last are waypoints that are passed within `within_in`; at the last one the robot stops and turns to
the heading. A pilot has no clock but that of the estimates, and all its waits are limited. An estimate that is LOST
ends it; recovery is the caller's task.

Settings of a mission are here as well. Arguments of a Python program are checked against the types of files
(worlds.schema), so that both get the same error messages, for example "go_to: x_in: expected a length, a number, found
the text '15'". All errors are MissionFileError: which step or settings, which argument, what was expected and what was
found.

The controller drives one control period at a time: command in, estimate and obstacles out.

    period(command):    drive ──> wait for the rest of PERIOD_S ──> refresh ──> localizer ──> obstacles ──> observers

Waiting is a parameter; the time is the robot's clock. Observers are called in every period and may end it by raising.
Leaving the controller's `with` block stops the robot.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import hypot, inf, pi
from os import PathLike, fspath
from types import MappingProxyType, TracebackType
from typing import Annotated, Any, Final, NamedTuple, Self

import numpy as np
from msgspec import Meta

from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import Belief, Floats
from localization.filters.registry import DEFAULT_METHOD
from localization.live.estimate import Estimate
from localization.live.run import GroundTruth, Publisher, build_message
from localization.live.sensor_input import SensorInput
from localization.navigation import control_law, waypoints
from localization.navigation.control_law import STAND, VelocityCommand, allowed_speed_fraction
from localization.navigation.obstacles import ObstacleTracker, filter_unmapped, position_std_in, update_obstacles
from localization.navigation.path import TURNED_RAD, PathFollower, angle_difference, turn_command, wall_distances
from localization.navigation.roadmap import MARGINS_IN, NoPathError, PlannedPath, Planner
from nclient.common.validation import InvalidValue, Text, convert, describe_value, field_types, reported_as
from nclient.errors import BumperHit, MissionFileError, NomadError
from nclient.robot import Robot
from nclient.state import RobotState
from worlds.robots import Body
from worlds.schema import MAX_COORDINATE_IN, Angle, LengthIn, Point, PointsIn, points, require_outline

__all__ = ["OnLost", "Point", "Settings"]

MIN_TIME_S, MAX_TIME_S = 0.1, 86_400.0
MIN_WITHIN_IN, MAX_WITHIN_IN = 0.1, 100.0
MAX_RETRIES, MAX_ROUNDS = 100, 10_000
MAX_TURN_DEG: Final = 3600.0
"""Ten revolutions: a larger angle is nearly always a mistake, such as a wrong unit."""
# Seconds of the robot's clock, for missions that state no limit.
TIME_LIMIT_S: Final = 600.0

Seconds = Annotated[float, Meta(ge=0.0, le=MAX_TIME_S)]
TimeLimit = Annotated[float, Meta(ge=MIN_TIME_S, le=MAX_TIME_S)]
TurnAngle = Annotated[float, Meta(ge=-MAX_TURN_DEG, le=MAX_TURN_DEG, description="angle to turn by, degrees")]
Within = Annotated[
    float, Meta(ge=MIN_WITHIN_IN, le=MAX_WITHIN_IN, description="distance at which the goal is reached, inches")
]
Retries = Annotated[int, Meta(ge=0, le=MAX_RETRIES, description="number of retries")]
Rounds = Annotated[int, Meta(ge=1, le=MAX_ROUNDS, description="number of rounds")]


class OnLost(Enum):
    """Behaviour when the estimate is LOST, for at most lost_s."""

    STOP = "stop"
    """Stand until the robot is localized again."""
    SEARCH = "search"
    """Turn, then drive where there is free space, until the robot is localized again."""
    GIVE_UP = "give_up"
    """End the mission."""


LostPolicy = Annotated[OnLost, Meta(extra_json_schema={"enum": [policy.value for policy in OnLost]})]
MaybeText = Annotated[str, Meta(pattern=r"^$|\S", title="a text")]


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a mission.

    Attributes
    ----------
    title
        Title of the report.
    map
        Walls: a shipped world or a TOML file; "" if given on the command line.
    time_limit_s
        Time limit of the mission, seconds of the robot's clock.
    fence_in
        Corners of a polygon that the robot must stay inside; empty for no fence.
    on_lost, lost_s
        Behaviour when the estimate is LOST (or its name), and for how long.

    Raises
    ------
    MissionFileError
        If a value is wrong; the message names it.
    """

    title: MaybeText = ""
    map: MaybeText = ""
    time_limit_s: TimeLimit = TIME_LIMIT_S
    fence_in: tuple[Point, ...] = ()
    on_lost: LostPolicy = OnLost.STOP
    lost_s: TimeLimit = 60.0

    def __post_init__(self) -> None:
        # Settings of programs are checked against the types of files: one set of limits and messages.
        kinds = field_types(Settings) | {"fence_in": points(3).type_for(MAX_COORDINATE_IN)}
        with reported_as(MissionFileError, "Settings"):
            for key, kind in kinds.items():
                value = to_plain_value(getattr(self, key))
                # The dataclass is frozen, so checked values are set past its __setattr__.
                object.__setattr__(self, key, () if key == "fence_in" and value == [] else convert(value, kind, key))
            if self.fence_in:
                require_outline("fence_in", self.fence_in)


# arguments of steps


def check_arguments(step: str, **arguments: object) -> None:
    """Check the arguments of a step; optional ones may be None. Raises MissionFileError."""
    with reported_as(MissionFileError, step):
        for key, argument in arguments.items():
            value = to_plain_value(argument)
            if key == "condition":
                if not callable(value):
                    raise InvalidValue(f"expected a function of what is seen, found {describe_value(value)}", key)
            # A time limit that a program may have computed: inf means none.
            elif not ((value is None and (step, key) in _OPTIONAL) or (key == "limit_s" and value == inf)):
                convert(value, _ARGUMENTS[key], key)


def read_points(step: str, points_in: object) -> tuple[Point, ...]:
    """Return one or more points as plain numbers. Raises MissionFileError."""
    with reported_as(MissionFileError, step):
        points: tuple[Point, ...] = convert(to_plain_value(points_in), PointsIn, "points_in")
        return points


def to_plain_value(value: object) -> object:
    """Return a value as a file would contain it: lists for collections and arrays, Python numbers, text for paths."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Collection) and not isinstance(value, str | bytes | Mapping):
        return [to_plain_value(one) for one in value]
    if isinstance(value, Enum):
        return value.value
    return fspath(value) if isinstance(value, PathLike) else value


_OPTIONAL: Final = frozenset({("go_to", "heading_deg"), ("turn", "heading_deg"), ("turn", "by_deg")})
_ARGUMENTS: Final[Mapping[str, Any]] = MappingProxyType({
    "x_in": LengthIn, "y_in": LengthIn, "heading_deg": Angle, "by_deg": TurnAngle, "within_in": Within,
    "seconds": Seconds, "words": Text, "rounds": Rounds, "limit_s": Seconds, "retries": Retries,
})  # fmt: skip
"""Type of every argument of a step, except points and conditions."""


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

    def __init__(self, robot: Robot, config: LocalizationConfig, body: Body, belief: Belief, wait: Wait,
                 method: str | Filter = DEFAULT_METHOD,
                 speed_in_s: float = waypoints.Speeds().translation_in_s) -> None:  # fmt: skip
        walls = np.asarray(config.walls, dtype=np.float64)
        self.robot, self.body, self._wait = robot, body, wait
        self.limits = control_law.MODEL_LIMITS[body.name].capped(speed_in_s, waypoints.Speeds().steering_rad_s)
        self.planner = Planner(walls, body.radius_in)
        self.obstacles = ObstacleTracker(walls, body.sonar_ring_radius_in)
        self.observers: list[Observer] = []
        robot.set_timeout(waypoints.COMMAND_TIMEOUT_S)
        self._gap_limiter = control_law.StateGapLimiter()
        self._localizer = waypoints.start_localizer(robot, config, belief, method)
        state = robot.refresh()
        self.last = Observation(self._localizer.update(state), state)
        """The observation of the last period."""
        self._moved_s = self.clock_s

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
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
            after = waypoints.drive_unless_held(self.robot, translation_in_s=fraction * command.translation_in_s,
                                                steering_rad_s=fraction * command.steering_rad_s)
        # 2. Estimate.
        self.last = self._observe(waypoints.wait_for_next_state(self.robot, before, after, self._wait))
        state = self.last.state
        has_moved = (state.x_in, state.y_in, state.steering_rad) != (before.x_in, before.y_in, before.steering_rad)
        if command == STAND or state.touching or has_moved:
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


class Ending(Enum):
    """Reason for which a drive to goals ended."""

    ARRIVED = "arrived"
    BLOCKED = "blocked"
    TOUCHED = "touched"
    UNCERTAIN = "uncertain"
    ASTRAY = "astray"
    LOST = "lost"


class PilotResult(NamedTuple):
    """The ending of a drive, and the reason as text."""

    ending: Ending
    reason: str


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Tolerances and limits of a drive.

    Attributes
    ----------
    within_in, heading_rad
        Tolerances of the last goal.
    max_touches
        Number of contacts at which the pilot gives up.
    max_plans
        Number of plans per goal at which the pilot gives up.
    blocked_s
        Longest wait for an obstacle to move.
    uncertain_s
        Longest wait for the estimate to improve.
    back_off_in, back_off_in_s, back_off_s
        Distance, speed and longest time of backing off after a contact.
    """

    within_in: float = 1.0
    heading_rad: float = 0.05
    max_touches: int = 4
    max_plans: int = 60
    blocked_s: float = 20.0
    uncertain_s: float = 10.0
    back_off_in: float = 4.0
    back_off_in_s: float = 2.0
    back_off_s: float = 4.0


MAX_LATERAL_ERROR_IN: Final = 3.0
"""Farther beside its path than this the robot plans again."""
OBSTACLE_MARGIN_IN: Final = 1.5
"""Space between body and an obstacle that a path must leave, or half of its planned margin if that is less."""
TENTATIVE_AHEAD_IN, TENTATIVE_S, STOP_BEFORE_IN = 30.0, 3.0, 2.0
"""Three cycles of the ring confirm a tentative obstacle; until then the robot stays this far from touching it."""
BESIDE_IN, BESIDE_IN_S = 12.0, 3.0
"""Speed limit where a confirmed obstacle is this near."""
PASSING: Final = 0.6
"""Fraction of `within_in` that a planned path may pass a waypoint by: the robot is not exactly on its path."""
REPLAN_INTERVAL_S: Final = 1.0
"""Shortest time between plans for the same reason."""


@dataclass
class PilotLog:
    """Plans, positions of contacts, and notes (clock, text) of a drive."""

    plans: list[PlannedPath] = field(default_factory=list)
    touches: list[Point] = field(default_factory=list)
    notes: list[tuple[float, str]] = field(default_factory=list)


class Pilot:
    """Controller for a drive to goals; `step` is called once per period.

    Parameters
    ----------
    planner : Planner
    limits : AxisLimits
    obstacles : ObstacleTracker
    goals : sequence of (x, y)
        Waypoints and the last goal, inches.
    heading_rad : float, optional
        Heading at the last goal. Default: any.
    policy : RetryPolicy, optional
    """

    def __init__(self, planner: Planner, limits: control_law.AxisLimits, obstacles: ObstacleTracker,
                 goals: Sequence[Point], heading_rad: float | None = None, policy: RetryPolicy | None = None) -> None:
        self._planner, self._limits, self._obstacles = planner, limits, obstacles
        self._goals, self._heading_rad = list(goals), heading_rad
        self.policy = policy or RetryPolicy()
        self.log = PilotLog()
        self.result: PilotResult | None = None
        self._follower: PathFollower | None = None
        self._back_off: control_law.BackOff | None = None
        self._last_speed_in_s = 1.0
        self._min_margin_in = 0.0
        # Times since which there is no path, or the estimate is uncertain; inf while that is not so.
        self._blocked_s = self._uncertain_s = inf
        self._planned_s = -inf

    @property
    def remaining_goals(self) -> tuple[Point, ...]:
        """Goals that are not reached yet."""
        return tuple(self._goals)

    def step(self, estimate: Estimate, state: SensorInput) -> VelocityCommand:
        """Return the velocities for the next period; STAND once there is a result."""
        if self.result:
            return STAND
        command = self._step(estimate, state)
        if command.translation_in_s:
            self._last_speed_in_s = command.translation_in_s
        return command

    def _step(self, estimate: Estimate, state: SensorInput) -> VelocityCommand:
        # 1. Lost or in contact.
        if estimate.health.is_lost:
            return self._end(Ending.LOST, estimate.health.reason)
        if self._back_off:
            command = self._back_off.command(estimate.clock_s, (state.x_in, state.y_in))
            if command is None:
                self._back_off, self._follower = None, None
            return command or STAND
        if state.touching:
            return self._start_back_off(estimate, state)
        # 2. Plan to the goals that are not passed yet if there is no valid path.
        while len(self._goals) > 1 and hypot(*(estimate.pose[:2] - self._goals[0])) <= self.policy.within_in:
            del self._goals[0]
        if self._follower is None or self._needs_plan(self._follower, estimate.clock_s):
            planned = self._plan(estimate)
            if planned is None:
                return STAND
            self._follower = planned
        # 3. Follow it.
        if self._follower.finished:
            return self._finish(estimate)
        return self._drive(self._follower, estimate)

    # planning

    def _needs_plan(self, follower: PathFollower, now_s: float) -> bool:
        """Return True if the robot is far beside its path, or obstacles stand on the rest of it."""
        if abs(follower.lateral_error_in) > MAX_LATERAL_ERROR_IN:
            self.log.notes.append((now_s, f"{abs(follower.lateral_error_in):.1f} in beside the path"))
            return True
        obstacles = self._obstacles.confirmed
        if not len(obstacles) or now_s < self._planned_s + REPLAN_INTERVAL_S:
            return False
        points = follower.remaining_points()
        if not len(points):
            return False
        # A path planned through a narrow gap has less margin from the start.
        margin_in = min(OBSTACLE_MARGIN_IN, 0.5 * self.log.plans[-1].margin_in)
        return bool(wall_distances(points, obstacles).min() < self._planner.body_in + margin_in)

    def _plan(self, estimate: Estimate) -> PathFollower | None:
        """Return a follower of a new path; None while there is no path, and after giving up."""
        now_s, obstacles = estimate.clock_s, self._obstacles.confirmed
        # 1. While blocked, plan again only at intervals.
        if self._blocked_s < inf and now_s < self._planned_s + REPLAN_INTERVAL_S:
            return None
        self._planned_s = now_s
        if len(self.log.plans) >= self.policy.max_plans:
            self._end(Ending.ASTRAY, f"planned {len(self.log.plans)} times and not arrived")
            return None
        # 2. Plan around the confirmed obstacles.
        start = (float(estimate.pose[0]), float(estimate.pose[1]))
        try:
            plan = self._plan_path(start, obstacles)
        except NoPathError as error:
            self._wait_or_give_up(now_s, error, bool(len(obstacles)))
            return None
        self._blocked_s = inf
        self.log.plans.append(plan)
        return PathFollower(plan.sections, self._limits)

    def _plan_path(self, start: Point, obstacles: Floats) -> PlannedPath:
        """Return the path along all goals if it is free, else the shortest path to the next goal."""
        if len(self._goals) > 1:
            plan = self._planner.along([start, *self._goals], PASSING * self.policy.within_in, self._limits)
            # Sampled every inch, as far apart as needed to notice any obstacle.
            points = np.concatenate([section.points(1.0) for section in plan.sections])
            required = self._planner.body_in + OBSTACLE_MARGIN_IN
            if not len(obstacles) or wall_distances(points, obstacles).min() >= required:
                return plan
        return self._planner.plan(start, self._goals[0], obstacles, self._min_margin_in)

    def _wait_or_give_up(self, now_s: float, error: NoPathError, has_obstacles: bool) -> None:
        """Without a path: give up at once, or after blocked_s if an obstacle may be the cause."""
        self._follower = None
        if not has_obstacles:
            self._end(Ending.BLOCKED, str(error))
            return
        self._blocked_s = min(self._blocked_s, now_s)
        if now_s - self._blocked_s >= self.policy.blocked_s:
            self._end(Ending.BLOCKED, f"blocked by an obstacle that is not in the map: {error}")

    # driving

    def _finish(self, estimate: Estimate) -> VelocityCommand:
        """At the end of the path: turn to the heading, or plan again if the estimate has changed."""
        # 1. The estimate has moved away from the goal: plan again.
        if hypot(*(estimate.pose[:2] - self._goals[0])) > self.policy.within_in:
            self._follower = None
            return STAND
        if len(self._goals) > 1:
            del self._goals[0]
            self._follower = None
            return STAND
        # 3. At the last goal: turn to the heading.
        if self._heading_rad is not None:
            remaining = angle_difference(float(estimate.pose[2]), self._heading_rad)
            if abs(remaining) > min(TURNED_RAD, self.policy.heading_rad):
                return turn_command(remaining, self._limits)
        return self._end(Ending.ARRIVED, "arrived")

    def _drive(self, follower: PathFollower, estimate: Estimate) -> VelocityCommand:
        """Follow the path as fast as the estimate and the obstacles allow."""
        command = follower.command(estimate.pose)
        speed = command.translation_in_s
        # As far ahead as the robot needs to stop, with a reserve for delays.
        ahead = follower.ahead(1.0 + 0.3 * speed + speed * speed / self._limits.translation_in_s2)
        if ahead is None or not speed:
            return command
        cov = estimate.belief.cov[:3, :3]
        fraction = allowed_speed_fraction(estimate.pose, ahead, cov, self._planner.walls, self._planner.body_in)
        if fraction > 0.0:
            self._uncertain_s = inf
            cautious = min(self._tentative_fraction(follower, command), self._beside_fraction(estimate, command))
            return follower.command(estimate.pose, min(fraction, cautious))
        return self._wait_for_estimate(estimate, ahead)

    def _tentative_fraction(self, follower: PathFollower, command: VelocityCommand) -> float:
        """Return the speed fraction at which no tentative obstacle on the path is reached within TENTATIVE_S.

        By then it is confirmed or removed.
        """
        tentative = self._obstacles.tentative
        if not len(tentative):
            return 1.0
        required = self._planner.body_in + OBSTACLE_MARGIN_IN
        near = wall_distances(follower.remaining_points(1.0, TENTATIVE_AHEAD_IN), tentative) < required
        if not near.any():
            return 1.0
        remaining_in = float(near.argmax()) - STOP_BEFORE_IN
        return min(1.0, max(0.0, remaining_in / TENTATIVE_S) / command.translation_in_s)

    def _beside_fraction(self, estimate: Estimate, command: VelocityCommand) -> float:
        """Return the speed fraction beside confirmed obstacles, whose extent is unknown."""
        # Infinite without obstacles.
        distance_in = wall_distances(estimate.pose[None, :2], self._obstacles.confirmed)[0]
        is_beside = distance_in <= self._planner.body_in + BESIDE_IN
        return min(1.0, BESIDE_IN_S / command.translation_in_s) if is_beside else 1.0

    def _wait_for_estimate(self, estimate: Estimate, ahead: Floats) -> VelocityCommand:
        """Stand until the estimate improves; then plan with a larger margin, and give up if there is none."""
        now_s = estimate.clock_s
        self._uncertain_s = min(self._uncertain_s, now_s)
        if now_s - self._uncertain_s < self.policy.uncertain_s:
            return STAND
        margin = max(self._min_margin_in, self.log.plans[-1].margin_in)
        wider = [larger for larger in MARGINS_IN if larger > margin]
        if wider:
            self._min_margin_in, self._uncertain_s, self._follower = wider[0], inf, None
            self.log.notes.append((now_s, f"too uncertain for the space: planning with {wider[0]:g} in from now on"))
            return STAND
        spread = 3.0 * position_std_in(estimate)
        space = float(wall_distances(ahead[None, :], self._planner.walls)[0]) - self._planner.body_in
        return self._end(Ending.UNCERTAIN, f"position uncertain by {spread:.1f} in (3 sigma), {space:.1f} in of space")

    # contacts

    def _start_back_off(self, estimate: Estimate, state: SensorInput) -> VelocityCommand:
        x, y, heading = (float(value) for value in estimate.pose)
        is_forward = self._last_speed_in_s > 0.0
        direction = heading if is_forward else heading + pi
        self._obstacles.add_contact(estimate.clock_s, (x, y), direction, self._planner.body_in)
        self.log.touches.append((x, y))
        self.log.notes.append((estimate.clock_s, f"touched something at ({x:.1f}, {y:.1f})"))
        if len(self.log.touches) >= self.policy.max_touches:
            return self._end(Ending.TOUCHED,
                             f"touched something {len(self.log.touches)} times, last at ({x:.1f}, {y:.1f})")
        policy = self.policy
        velocity = -policy.back_off_in_s if is_forward else policy.back_off_in_s
        self._back_off = control_law.BackOff(velocity, (state.x_in, state.y_in), estimate.clock_s + policy.back_off_s,
                                             policy.back_off_in)
        return STAND

    def _end(self, ending: Ending, reason: str) -> VelocityCommand:
        self.result = PilotResult(ending, reason)
        return STAND
