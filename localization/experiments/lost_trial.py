"""Long runs with the filter `finder`, which detects when it is lost: random driving, kidnapping, unknown start.

    tracking        the robot starts at a given pose and drives to random positions; every LOST is a false alarm
    kidnapped       the same, then it is moved elsewhere without its encoders: time until LOST and until recovery
    unknown start   no initial pose: time until recovery
    wrong door      the initial pose is one that looks like the true one, with a standard deviation that covers both

While localized the robot drives shortest paths with the control law of the thesis; while lost it turns and drives
where there is free space. Recovery means localized without LOST for CERTAIN_S. The truth never reaches the filter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from math import atan2, hypot, tau
from pathlib import Path
from typing import Final

import numpy as np

from localization.experiments.live_trial import BAD, START_STD, BadReadings, Scenario, simulated_robot
from localization.filters.base import LocalizationConfig
from localization.filters.belief import HEADING, POSE, Belief, Floats, difference, independent
from localization.filters.health import HealthStatus
from localization.filters.odometry import with_parameters
from localization.filters.range_table import connected, floor_grid
from localization.filters.registry import finder
from localization.live.background_search import cached_search
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import SensorInput, restart_ring
from localization.mapping.aliases import AliasFinder
from localization.navigation.control_law import bearing_error
from localization.navigation.limits import STAND, VelocityCommand
from localization.navigation.path import sample_waypoints
from localization.navigation.recovery import TURN_RAD_S, RecoveryBehavior
from localization.navigation.roadmap import NoPathError, Roadmap
from localization.navigation.waypoints import PERIOD_S, Navigator, Speeds
from nclient.robot import Robot
from nclient.state import Pose, RobotState
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import World

TURN_FIRST_RAD: Final = 1.0
"""With a larger bearing error the robot turns in place: the control law alone would drive a circle."""


class RandomExplorer:
    """Controller that drives to random positions of `positions` (n, 2) on a roadmap."""

    def __init__(self, roadmap: Roadmap, positions: Floats, speeds: Speeds, rng: np.random.Generator) -> None:
        self._roadmap, self._positions, self._speeds, self._rng = roadmap, positions, speeds, rng
        self._navigator: Navigator | None = None
        self._recovery = RecoveryBehavior(PERIOD_S)

    def command(self, pose: Floats) -> VelocityCommand:
        """Return the velocities at an estimated pose (3,)."""
        # A localized robot starts its next recovery from the beginning.
        self._recovery.reset()
        # 1. No path, or its end reached: plan the next one and stand for this period.
        if self._navigator is None or (command := self._navigator.command(pose)) is None:
            self._navigator = self._random_navigator(pose)
            return STAND
        # 2. Far off the bearing: turn in place first.
        goal = self._navigator.goal
        assert goal is not None
        error = float(bearing_error(pose, goal))
        if abs(error) > TURN_FIRST_RAD:
            return VelocityCommand(0.0, float(np.copysign(TURN_RAD_S, error)))
        return command

    def recover(self, state: SensorInput, turn_rad: float | None = None) -> VelocityCommand:
        """Return the velocities while the estimate is lost."""
        # The path was planned from a pose that was wrong: plan again after recovery.
        self._navigator = None
        return VelocityCommand(*self._recovery.command(state, turn_rad))

    def _random_navigator(self, pose: Floats) -> Navigator | None:
        goal = self._positions[self._rng.integers(len(self._positions))]
        try:
            path = self._roadmap.path((float(pose[0]), float(pose[1])), (float(goal[0]), float(goal[1])))
        # The estimate may be too near to a wall; the next period draws another goal.
        except NoPathError:
            return None
        return Navigator(sample_waypoints(path), self._speeds)


MARGIN_IN: Final = 3.0
"""Space between body and walls."""
KIDNAPPED_S: Final = (20.0, 40.0)
"""Interval of the time of the kidnapping."""
FAR_IN, FAR_RAD = 24.0, 1.0
"""Minimum displacement or turn of a kidnapping."""
# Timeout of the wait until the robot stands, seconds.
STILL_S: Final = 10
# Time without LOST, in seconds, after which a wrong hypothesis would normally have been rejected.
CERTAIN_S: Final = 3.0
SEARCH_LIMIT_S: Final = 90.0
"""Time limit for detecting a kidnapping and for recovering."""
START_LIMIT_S: Final = 60.0
"""Time limit for an unknown start: a minute of driving."""
RIGHT_IN, RIGHT_RAD = 6.0, 0.25
"""Error tolerance of a correct recovery."""
LARGE_IN2, LARGE_STEP_IN = 4e4, 6.0
"""In a larger world than one room of 5 m the positions are farther apart."""
GOALS, POSITIONS, START = 11, 12, 13
"""Random streams of a seed."""


class Kind(Enum):
    """Kind of a run; the values are names of arguments and JSON."""

    TRACKING = "calm"
    KIDNAPPED = "kidnapped"
    UNKNOWN_START = "nowhere"
    WRONG_DOOR = "door"


STARTS: Final = (Kind.UNKNOWN_START, Kind.WRONG_DOOR)
"""Kinds whose runs begin without an estimate."""
MAX_DRAWS: Final = 50
"""Starts that are drawn until one looks like another place."""


@dataclass(frozen=True, slots=True)
class Case:
    """A run to make, with everything that decides its result; `seconds` is the length of a tracking run."""

    kind: Kind
    world: str
    scenario: Scenario
    seed: int
    seconds: float = 600.0

    @property
    def name(self) -> str:
        """Name of the run in files and tables."""
        return f"{self.kind.value}_{Path(self.world).stem}_{self.scenario.name}_{self.seed:04d}"


@dataclass(frozen=True, slots=True)
class LostResult:
    """Result of a run; times in seconds, None for events that did not occur.

    Attributes
    ----------
    seconds
        Duration of the run.
    alarms
        Number of transitions to LOST before a kidnapping or in a tracking run.
    degraded
        Fraction of the time with status DEGRADED.
    rmse_in
        Position RMSE while localized and before a kidnapping.
    lost_after_s
        Time from the kidnapping to LOST.
    found_after_s
        Time from LOST, or from an unknown start, to recovery.
    right
        True if the recovered pose was correct.
    alike
        Number of places that look like an unknown start.
    stated
        Each second of an unknown start: the probabilities of the hypotheses, and which was right.
    """

    seconds: float
    alarms: int
    degraded: float
    rmse_in: float | None
    lost_after_s: float | None = None
    found_after_s: float | None = None
    right: bool = False
    alike: int = 0
    stated: Sequence[Sequence[tuple[float, bool]]] = ()


def drive(case: Case) -> LostResult:
    """Make one run in its own simulation."""
    world = load_world(case.world)
    positions, rng = free_positions(world), np.random.default_rng([case.seed, POSITIONS])
    pose, alike = _drawn(positions, rng), list[Floats]()
    if case.kind in STARTS:
        # What `nomad map check` says of this start; a wrong door needs another place that looks like it.
        aliases = AliasFinder(world.walls, N150.radius_in, [(start.x_in, start.y_in) for start in world.starts])
        alike = aliases.aliases(_pose(pose))
        for _ in range(MAX_DRAWS if case.kind is Kind.WRONG_DOOR and not alike else 0):
            pose = _drawn(positions, rng)
            if alike := aliases.aliases(_pose(pose)):
                break
    with simulated_robot(case.world, case.scenario, case.seed, pose) as robot:
        run = _Run(robot, case, world, positions, pose, alike)
        result = run.drive()
    return replace(result, alike=len(alike), stated=run.stated)


class _Run:
    """A run in progress."""

    def __init__(
        self, robot: Robot, case: Case, world: World, positions: Floats, pose: Pose, alike: Sequence[Floats]
    ) -> None:
        self._robot, self._case, self._positions = robot, case, positions
        schedule, state = restart_ring(robot, N150.ring)
        assert state.clock_s is not None
        # 1. Firing schedule: the clock of this reply is that of the first sonar.
        self._start_s = state.clock_s
        # 2. Initial estimate, drawn from START_STD; none for an unknown start.
        rng = np.random.default_rng([case.seed, START])
        initial = None
        if case.kind is Kind.WRONG_DOOR:
            initial = with_parameters(_covering(_pose(pose), alike), case.scenario.constants)
        elif case.kind is not Kind.UNKNOWN_START:
            guess = _pose(pose) + np.array(START_STD) * rng.standard_normal(3)
            initial = with_parameters(independent(guess, START_STD), case.scenario.constants)
        # 3. Filter, outliers and controller, each with its own random stream of the seed.
        clearance = N150.radius_in
        config = LocalizationConfig(
            world.walls, N150, case.scenario.odometry, case.scenario.sonar, clearance_in=clearance
        )
        self._filter = finder(config, initial, case.scenario.constants, cached_search(config))
        self._localizer = Localizer(config, self._filter.belief, schedule, self._filter)
        self._outliers = BadReadings(case.scenario.outlier_fraction, schedule, np.random.default_rng([case.seed, BAD]))
        speeds = Speeds(translation_in_s=case.scenario.speed_in_s)
        roadmap = Roadmap(world.walls, clearance + MARGIN_IN)
        self._explorer = RandomExplorer(roadmap, positions, speeds, np.random.default_rng([case.seed, GOALS]))
        self._rng = rng
        # 4. Counters of `_until`, and the last true pose and time.
        self._alarms = self._polls = self._degraded = 0
        self._squares: list[float] = []
        self.stated: list[list[tuple[float, bool]]] = []
        self._periods = 0
        self._truth = _pose(pose)
        self._now_s = 0.0

    def drive(self) -> LostResult:
        """Make the whole run."""
        match self._case.kind:
            case Kind.TRACKING:
                self._until(self._case.seconds)
                return self._outcome()
            case Kind.KIDNAPPED:
                self._until(float(self._rng.uniform(*KIDNAPPED_S)))
                self._kidnap()
                return self._find(*self._until_lost())
            case Kind.UNKNOWN_START | Kind.WRONG_DOOR:
                return self._find(None, 0.0)

    def _until(self, end_s: float) -> None:
        """Drive to random positions and count status changes."""
        # Transitions to LOST are counted, not periods: one alarm may last several periods.
        before = HealthStatus.OK
        while self._now_s < end_s:
            estimate = self._period()
            status = estimate.health.status
            self._alarms += status is HealthStatus.LOST and before is not HealthStatus.LOST
            self._degraded += status is HealthStatus.DEGRADED
            self._polls += 1
            before = status
            # The estimate has no meaning while lost, so its error is not part of the RMSE.
            if status is not HealthStatus.LOST:
                self._squares.append(hypot(*(estimate.pose - self._truth)[:2]) ** 2)

    def _kidnap(self) -> None:
        """Stop the robot and move it elsewhere with unchanged turret angle and encoders.

        A moving robot would continue turning meanwhile, and the ring would no longer agree with the encoders.
        """
        # 1. Wait until the robot stands.
        self._robot.stop()
        state = self._robot.wait_until_still(timeout_s=STILL_S)
        truth = self._robot.truth()
        # 2. Draw a pose that is far enough from the true one.
        here = _pose(truth)
        while True:
            there = _drawn(self._positions, self._rng)
            off = difference(_pose(there), here)
            if hypot(off[0], off[1]) >= FAR_IN or abs(off[HEADING]) >= FAR_RAD:
                break
        # 3. Place the robot there, then restore the encoders, which `place` sets to the new pose.
        turned = truth.turret_rad - truth.steering_rad
        self._robot.place(Pose(there.x_in, there.y_in, there.steering_rad, there.steering_rad + turned))
        self._robot.set_position(x_in=state.x_in, y_in=state.y_in)
        self._robot.set_angles(steering_rad=state.steering_rad, turret_rad=state.turret_rad)

    def _until_lost(self) -> tuple[float | None, float]:
        """Return the seconds until LOST (None if never) and the time."""
        since_s = self._now_s
        while self._now_s < since_s + SEARCH_LIMIT_S:
            if self._period().health.status is HealthStatus.LOST:
                return self._now_s - since_s, self._now_s
        return None, self._now_s

    def _find(self, lost_after_s: float | None, since_s: float) -> LostResult:
        """Drive until the robot is localized for CERTAIN_S or the time limit, and return the result."""
        # Start of the current time without LOST; None while lost.
        sure_s: float | None = None
        limit_s = START_LIMIT_S + CERTAIN_S if self._case.kind in STARTS else SEARCH_LIMIT_S
        while self._now_s < since_s + limit_s:
            estimate = self._period()
            if self._case.kind in STARTS:
                self._note(estimate)
            if estimate.health.status is HealthStatus.LOST:
                sure_s = None
                continue
            sure_s = self._now_s if sure_s is None else sure_s
            # Recovered: the time counts from the beginning of these CERTAIN_S.
            if self._now_s - sure_s >= CERTAIN_S:
                return self._outcome(lost_after_s, sure_s - since_s, _is_right(estimate.pose, self._truth))
        return self._outcome(lost_after_s)

    def _note(self, estimate: Estimate) -> None:
        """Record the probabilities that are stated, once a second."""
        self._periods += 1
        if self._periods % round(1.0 / PERIOD_S) == 0 and estimate.places:
            self.stated.append([
                (round(place.probability, 4), _is_right(place.belief.mean, self._truth)) for place in estimate.places
            ])  # fmt: skip

    def _period(self) -> Estimate:
        """Run one period: state, estimate, command."""
        # 1. State and ground truth of the same instant: the query of the truth takes no simulated time.
        state = self._robot.refresh()
        assert state.clock_s is not None
        self._now_s = state.clock_s - self._start_s
        self._truth = _pose(self._robot.truth())
        # 2. Estimate from the state with outliers.
        estimate = self._localizer.update(self._outliers.apply(state))
        # 3. Command from the estimate alone.
        command = self._command(state, estimate)
        self._robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
        return estimate

    def _command(self, state: RobotState, estimate: Estimate) -> VelocityCommand:
        if estimate.health.status is HealthStatus.LOST:
            return self._explorer.recover(state, estimate.informative_turn_rad)
        return self._explorer.command(estimate.pose)

    def _outcome(
        self, lost_after_s: float | None = None, found_after_s: float | None = None, right: bool = False
    ) -> LostResult:
        rmse = float(np.sqrt(np.mean(self._squares))) if self._squares else None
        degraded = self._degraded / self._polls if self._polls else 0.0
        return LostResult(self._now_s, self._alarms, degraded, rmse, lost_after_s, found_after_s, right)


def free_positions(world: World) -> Floats:
    """Return a grid of positions (n, 2) with enough space for the robot, connected to the starts."""
    low, high = world.walls.reshape(-1, 2).min(axis=0), world.walls.reshape(-1, 2).max(axis=0)
    if np.prod(high - low) > LARGE_IN2:
        origin, free = floor_grid(world.walls, N150.radius_in + MARGIN_IN, LARGE_STEP_IN)
        starts = np.array([(start.y_in, start.x_in) for start in world.starts])
        reached = connected(free, [(row, column) for row, column in np.rint((starts - origin[::-1]) / LARGE_STEP_IN)
                                   .astype(int).tolist()])  # fmt: skip
        rows, columns = np.nonzero(reached)
        return np.asarray(origin + LARGE_STEP_IN * np.stack((columns, rows), axis=-1), dtype=np.float64)
    # Grid points 2 in apart, over the bounding box of all walls.
    x, y = np.meshgrid(np.arange(low[0], high[0], 2.0), np.arange(low[1], high[1], 2.0))
    points = np.stack((x.ravel(), y.ravel()), axis=-1)
    small: Floats = points[world.clearances(points) >= N150.radius_in + MARGIN_IN]
    return small


def _drawn(positions: Floats, rng: np.random.Generator) -> Pose:
    x, y = positions[rng.integers(len(positions))]
    # Turret and steering have the same direction.
    turn = float(rng.uniform(0.0, tau))
    return Pose(float(x), float(y), turn, turn)


def _covering(pose: Floats, alike: Sequence[Floats]) -> Belief:
    """Return a belief at the nearest of the poses that look like a pose, which covers both; at the pose without any."""
    if not alike:
        return independent(pose, (2.0 * FAR_IN, 2.0 * FAR_IN, FAR_RAD))
    other = min(alike, key=lambda one: float(np.abs(difference(one, pose)[:POSE] / (1.0, 1.0, 0.01)).sum()))
    dx, dy, turn = np.abs(difference(other, pose)).tolist()
    std_in = max(dx, dy)
    return independent(other, (std_in, std_in, max(turn, 0.1)))


def _is_right(estimate: Floats, truth: Floats) -> bool:
    off = difference(estimate[:POSE], truth)
    return bool(hypot(off[0], off[1]) <= RIGHT_IN and abs(off[HEADING]) <= RIGHT_RAD)


def _pose(pose: Pose) -> Floats:
    return np.array([pose.x_in, pose.y_in, atan2(np.sin(pose.steering_rad), np.cos(pose.steering_rad))])
