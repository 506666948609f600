"""`python -m localization.experiments lost`: how reliably the filter `finder` detects that it is lost, and recovers.

Long runs with the filter `finder`, which detects when it is lost: random driving, kidnapping, unknown start.

    tracking        the robot starts at a given pose and drives to random positions; every LOST is a false alarm
    kidnapped       the same, then it is moved elsewhere without its encoders: time until LOST and until recovery
    unknown start   no initial pose: time until recovery
    wrong door      the initial pose is one that looks like the true one, with a standard deviation that covers both
    uncertain start the same, but the initial pose is drawn: the true one as often as that deviation says

While localized the robot drives shortest paths with the control law of the thesis; while lost it turns and drives
where there is free space. Recovery means localized without LOST for CERTAIN_S. The truth never reaches the filter.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import Enum
from itertools import groupby, pairwise
from math import atan2, hypot, sqrt, tau
from pathlib import Path
from typing import Final

import numpy as np

from localization.cli.arguments import make_folder
from localization.experiments import execution
from localization.experiments.live_trial import BAD, SCENARIOS, START_STD, BadReadings, Scenario, simulated_robot
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
from localization.navigation.control_law import STAND, TURN_RAD_S, RecoveryBehavior, VelocityCommand, bearing_error
from localization.navigation.path import sample_waypoints
from localization.navigation.roadmap import NoPathError, Roadmap
from localization.navigation.waypoints import PERIOD_S, Navigator, Speeds
from nclient.common.arguments import add_value, whole_number
from nclient.robot import Robot
from nclient.state import Pose
from worlds.io import load_world, world_names
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
    UNCERTAIN_START = "uncertain"


GIVEN: Final = (Kind.WRONG_DOOR, Kind.UNCERTAIN_START)
"""Kinds whose runs begin with a pose that looks like others."""
STARTS: Final = (Kind.UNKNOWN_START, *GIVEN)
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
    unambiguous_s
        Time until the robot was first at a pose that looks like no other, from an unknown start; None if never.
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
    unambiguous_s: float | None = None

    @property
    def is_early(self) -> bool:
        """True if the robot was localized before it had been at any pose that looks like no other."""
        before = self.unambiguous_s is None or (self.found_after_s or 0.0) < self.unambiguous_s
        return self.found_after_s is not None and before


def drive(case: Case) -> LostResult:
    """Make one run in its own simulation."""
    world = load_world(case.world)
    positions, rng = free_positions(world), np.random.default_rng([case.seed, POSITIONS])
    pose, alike = _drawn(positions, rng), list[Floats]()
    aliases: AliasFinder | None = None
    if case.kind in STARTS:
        # What `nomad map check` says of this start; a wrong door needs another place that looks like it.
        aliases = AliasFinder(world.walls, N150.radius_in, [(start.x_in, start.y_in) for start in world.starts])
        alike = aliases.aliases(_pose(pose))
        for _ in range(MAX_DRAWS if case.kind in GIVEN and not alike else 0):
            pose = _drawn(positions, rng)
            if alike := aliases.aliases(_pose(pose)):
                break
    with simulated_robot(case.world, case.scenario, case.seed, pose) as robot:
        return _Run(robot, case, world, positions, pose, alike, aliases).drive()


class _Run:
    """A run in progress."""

    def __init__(self, robot: Robot, case: Case, world: World, positions: Floats, pose: Pose, alike: Sequence[Floats],
                 aliases: AliasFinder | None) -> None:  # fmt: skip
        self._robot, self._case, self._positions, self._aliases = robot, case, positions, aliases
        schedule, state = restart_ring(robot, N150.ring)
        assert state.clock_s is not None
        # 1. Firing schedule: the clock of this reply is that of the first sonar.
        self._start_s = state.clock_s
        # 2. Initial estimate, drawn from START_STD; none for an unknown start.
        rng = np.random.default_rng([case.seed, START])
        initial = None
        if case.kind in GIVEN:
            given = _covering(_pose(pose), alike)
            if case.kind is Kind.UNCERTAIN_START:
                given = _drawn_start(_pose(pose), alike, given.cov, rng)
            initial = with_parameters(given, case.scenario.constants)
        elif case.kind is not Kind.UNKNOWN_START:
            guess = _pose(pose) + np.array(START_STD) * rng.standard_normal(3)
            initial = with_parameters(independent(guess, START_STD), case.scenario.constants)
        # 3. Filter, outliers and controller, each with its own random stream of the seed.
        clearance = N150.radius_in
        config = LocalizationConfig(world.walls, N150, case.scenario.odometry, case.scenario.sonar,
                                    clearance_in=clearance)
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
        self._alike = len(alike)
        self._unambiguous_s: float | None = None
        self._stated: list[list[tuple[float, bool]]] = []
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
            case Kind.UNKNOWN_START | Kind.WRONG_DOOR | Kind.UNCERTAIN_START:
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
        """Record the probabilities that are stated, and whether the robot's place is unambiguous, once a second."""
        self._periods += 1
        if self._periods % round(1.0 / PERIOD_S):
            return
        if self._unambiguous_s is None and self._aliases and not self._aliases.aliases(self._truth):
            self._unambiguous_s = self._now_s
        if estimate.places:
            self._stated.append([
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
        if estimate.health.status is HealthStatus.LOST:
            command = self._explorer.recover(state, estimate.informative_turn_rad)
        else:
            command = self._explorer.command(estimate.pose)
        self._robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
        return estimate

    def _outcome(self, lost_after_s: float | None = None, found_after_s: float | None = None,
                 right: bool = False) -> LostResult:
        rmse = float(np.sqrt(np.mean(self._squares))) if self._squares else None
        degraded = self._degraded / self._polls if self._polls else 0.0
        return LostResult(self._now_s, self._alarms, degraded, rmse, lost_after_s, found_after_s, right, self._alike,
                          self._stated, self._unambiguous_s)  # fmt: skip


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
    return points[world.clearances(points) >= N150.radius_in + MARGIN_IN]


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


def _drawn_start(pose: Floats, alike: Sequence[Floats], cov: Floats, rng: np.random.Generator) -> Belief:
    """Return a belief of a covariance at a pose or one that looks like it, drawn so that the belief is calibrated.

    Each is drawn in proportion to the density of the belief at the true pose. Where all are as probable before,
    the true pose has its posterior probability given the one that was drawn: Bayes' theorem.
    """
    starts = [pose, *alike]
    offsets = np.array([difference(start, pose)[:POSE] for start in starts])
    weights = np.exp(-0.5 * np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(cov), offsets))
    return Belief(starts[rng.choice(len(starts), p=weights / weights.sum())], cov)


def _is_right(estimate: Floats, truth: Floats) -> bool:
    off = difference(estimate[:POSE], truth)
    return bool(hypot(off[0], off[1]) <= RIGHT_IN and abs(off[HEADING]) <= RIGHT_RAD)


def _pose(pose: Pose) -> Floats:
    return np.array([pose.x_in, pose.y_in, atan2(np.sin(pose.steering_rad), np.cos(pose.steering_rad))])


# At the scenarios' 5 in/s the robot has driven at most 25 in by then.
SOON_S: Final = 5.0
"""A kidnapping should be detected within this time."""


@dataclass(frozen=True, slots=True)
class LostSummary:
    """Results of all runs of a kind in a world; None where a number does not apply.

    Attributes
    ----------
    hours
        Simulated time in hours.
    false_alarms, alarmed
        Number of times a localized robot was reported LOST, and number of runs with such alarms.
    degraded
        Fraction of the time with status DEGRADED.
    rmse_in
        Position RMSE while localized, in inches.
    detected, soon
        Number of detected kidnappings, and of those detected within SOON_S.
    detected_s, found_s
        Median and maximum of the times until detection and until recovery, in seconds.
    found, mistaken
        Number of runs with a correct and with a wrong recovery.
    alike, unique_found
        Number of unknown starts that look like other places of the map, and correct recoveries from the others.
    early
        Number of recoveries before the robot had been at any pose that looks like no other.
    brier
        Mean Brier score of the probabilities that are stated meanwhile, 0 (certain and right) to 2.
    brier_expected
        The score that calibrated probabilities would have on average: k equal ones have 1 - 1 / k.
    brier_std
        Standard error of `brier` less `brier_expected`, from how the runs differ; None for a single run.
    reliability
        For bins of stated probabilities: their mean, the fraction that was right, and their number.
    """

    kind: str
    world: str
    scenario: str
    runs: int
    hours: float
    false_alarms: int
    alarmed: int
    degraded: float
    rmse_in: float | None
    detected: int | None = None
    soon: int | None = None
    detected_s: tuple[float, float] | None = None
    found: int | None = None
    mistaken: int | None = None
    found_s: tuple[float, float] | None = None
    alike: int | None = None
    unique_found: int | None = None
    early: int | None = None
    brier: float | None = None
    brier_expected: float | None = None
    brier_std: float | None = None
    reliability: Sequence[tuple[float, float, int]] = ()


def summaries(results: Mapping[Case, LostResult]) -> list[LostSummary]:
    """Return the summary of each kind, world and scenario, in the order of the cases."""

    def group(case: Case) -> tuple[Kind, str, str]:
        return case.kind, case.world, case.scenario.name

    return [summarize(*name, [results[case] for case in cases]) for name, cases in groupby(results, group)]


def summarize(kind: Kind, world: str, scenario: str, results: Sequence[LostResult]) -> LostSummary:
    """Return the summary of one or more runs."""
    seconds = sum(result.seconds for result in results)
    # 1. Numbers that every kind of run has.
    summary = LostSummary(
        kind=kind.value,
        world=world,
        scenario=scenario,
        runs=len(results),
        hours=seconds / 3600.0,
        false_alarms=sum(result.alarms for result in results),
        alarmed=sum(result.alarms > 0 for result in results),
        # Weighted by duration, because runs end at different times.
        degraded=sum(result.degraded * result.seconds for result in results) / seconds,
        rmse_in=_rmse_in(results),
    )
    # 2. Numbers of detection and recovery, where they apply.
    if kind is Kind.KIDNAPPED:
        after = [result.lost_after_s for result in results if result.lost_after_s is not None]
        soon = sum(seconds <= SOON_S for seconds in after)
        summary = replace(summary, detected=len(after), detected_s=_spread(after), soon=soon)
    if kind is not Kind.TRACKING:
        # A recovery counts as correct if the recovered pose was within the tolerance.
        found = [result for result in results if result.found_after_s is not None]
        rightly = [result.found_after_s for result in found if result.found_after_s is not None and result.right]
        mistaken = len(found) - len(rightly)
        summary = replace(summary, found=len(rightly), found_s=_spread(rightly), mistaken=mistaken)
    if kind not in STARTS:
        return summary
    # 3. Numbers of starts that look like others, and of the probabilities that are stated meanwhile.
    unique = [result for result in results if not result.alike]
    stated = [instant for result in results for instant in result.stated]
    return replace(summary, alike=len(results) - len(unique),
                   unique_found=sum(result.found_after_s is not None and result.right for result in unique),
                   early=sum(result.is_early for result in results), brier=brier_score(stated),
                   brier_expected=expected_brier_score(stated),
                   brier_std=brier_excess_std([result.stated for result in results]), reliability=reliability(stated))


Stated = Sequence[Sequence[tuple[float, bool]]]
"""For each instant the probabilities of the hypotheses, and which was right."""
BINS: Final = (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)


def brier_score(stated: Stated) -> float | None:
    """Return the mean of sum_i (p_i - [i is right])^2 over instants; where none is right, elsewhere was.

    References
    ----------
    Brier, Verification of forecasts expressed in terms of probability (1950).
    """
    if not stated:
        return None
    total = 0.0
    for instant in stated:
        # Hypotheses that are all right within the tolerance are one outcome.
        of_right = [probability for probability, right in instant if right]
        total += sum(probability**2 for probability, right in instant if not right)
        rest = sum(of_right) if of_right else 1.0 - sum(probability for probability, _ in instant)
        total += (1.0 - rest) ** 2
    return total / len(stated)


def expected_brier_score(stated: Stated) -> float | None:
    """Return the mean of `brier_score` if the stated probabilities, and elsewhere with the rest, are the true ones.

    The score of outcome i is 1 - 2 p_i + S, S = sum_j p_j^2, and that of elsewhere S + (1 - p)^2, p its probability.
    The mean is 1 - p + p (1 - p)^2 - S. Of k equal probabilities it is 1 - 1 / k.

    References
    ----------
    Brocker, Reliability, sufficiency, and the decomposition of proper scores (2009): the entropy of a forecast.
    """
    if not stated:
        return None
    total = 0.0
    for instant in stated:
        elsewhere = max(1.0 - sum(probability for probability, _ in instant), 0.0)
        squares = sum(probability**2 for probability, _ in instant)
        total += 1.0 - elsewhere + elsewhere * (1.0 - elsewhere) ** 2 - squares
    return total / len(stated)


def brier_excess_std(runs: Sequence[Stated]) -> float | None:
    """Return the standard error of `brier_score` less `expected_brier_score` over the instants of all runs.

    The instants of a run are correlated as they may be, runs are independent: the error of a ratio of two sums over
    runs, of excess and of number of instants. None for fewer than two runs that state anything.

    References
    ----------
    Cochran, Sampling Techniques (1977), equation 6.13; Cameron and Miller, A practitioner's guide to cluster-robust
    inference (2015), equation 11.
    """
    excess, count = [], []
    for stated in runs:
        score, expected = brier_score(stated), expected_brier_score(stated)
        if score is not None and expected is not None:
            excess.append(score - expected)
            count.append(len(stated))
    if len(count) < 2:
        return None
    n = np.array(count, dtype=np.float64)
    total = n * excess
    # What each run adds to the sum beyond the mean excess of all instants.
    off = total - n * (total.sum() / n.sum())
    return sqrt(len(n) / (len(n) - 1.0) * float(off @ off)) / float(n.sum())


def reliability(stated: Stated) -> list[tuple[float, float, int]]:
    """Return mean probability, fraction right and number of the stated probabilities in each bin that has any."""
    pairs = [pair for instant in stated for pair in instant]
    rows = []
    for low, high in pairwise(BINS):
        among = [pair for pair in pairs if low < pair[0] <= high]
        if among:
            mean = sum(probability for probability, _ in among) / len(among)
            rows.append((mean, sum(right for _, right in among) / len(among), len(among)))
    return rows


def _rmse_in(results: Sequence[LostResult]) -> float | None:
    """Return the position RMSE over the time localized."""
    # Squares are averaged with the durations as weights, then the root is taken.
    squares = [(result.rmse_in**2, result.seconds) for result in results if result.rmse_in is not None]
    total_s = sum(seconds for _, seconds in squares)
    return sqrt(sum(square * seconds for square, seconds in squares) / total_s) if total_s else None


def words(summary: LostSummary) -> str:
    """Return a summary as text."""
    lines = [
        f"{summary.kind} in {summary.world}, {summary.scenario}: {summary.runs} runs, "
        f"{summary.hours:.1f} simulated hours"
    ]
    if summary.rmse_in is not None:
        lines.append(
            f"  {summary.false_alarms} false alarms in {summary.alarmed} runs; DEGRADED "
            f"{summary.degraded:.2%} of the time; position RMSE {summary.rmse_in:.2f} in"
        )
    if summary.detected is not None:
        lines.append(
            f"  detected (LOST): {summary.detected}, {summary.soon} of them within {SOON_S:g} s"
            f"{_times(summary.detected_s)}"
        )
    if summary.found is not None:
        lines.append(
            f"  correct recoveries: {summary.found}{_times(summary.found_s)}; wrong recoveries: "
            f"{summary.mistaken}"
        )
    if summary.alike is not None:
        lines.append(
            f"  starts that look like other places: {summary.alike}; localized correctly within {START_LIMIT_S:g} s "
            f"of the other {summary.runs - summary.alike}: {summary.unique_found}"
        )
        lines.append(f"  OK before an unambiguous place: {summary.early} of {summary.runs}")
    if summary.brier is not None:
        rows = ", ".join(f"{stated:.0%}: {right:.0%} of {count}" for stated, right, count in summary.reliability)
        std = summary.brier_std
        error = "" if std is None else f" (standard error of the difference {std:.3f})"
        lines.append(
            f"  stated probabilities: Brier score {summary.brier:.3f}, {summary.brier_expected:.3f} expected if "
            f"calibrated{error}; right of those stated: {rows}"
        )
    return "\n".join(lines)


def _spread(times: Sequence[float]) -> tuple[float, float] | None:
    """Return median and maximum."""
    return (sorted(times)[len(times) // 2], max(times)) if times else None


def _times(spread: tuple[float, float] | None) -> str:
    return "" if spread is None else f" (median {spread[0]:.1f} s, at most {spread[1]:.1f} s)"


WORLD: Final = "several_walls"
# False alarms are rare, so tracking needs the most runs; 300 of 10 min are 50 simulated hours.
RUNS: Final = {
    Kind.TRACKING: 300, Kind.KIDNAPPED: 100, Kind.UNKNOWN_START: 100, Kind.WRONG_DOOR: 20, Kind.UNCERTAIN_START: 20,
}  # fmt: skip


def main(arguments: Sequence[str]) -> None:
    """Run the command; errors of execution and files are propagated."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    for world in options.worlds:
        load_world(world)
    # 1. All runs, by kind.
    cases = [
        Case(kind, world, SCENARIOS[options.scenario], seed, 60.0 * options.minutes)
        for kind in options.kinds
        for world in options.worlds
        for seed in range(options.first_seed, options.first_seed + (options.runs or RUNS[kind]))
    ]
    # 2. Results, from the cache or by running them.
    cache = run_cache(options.out / "runs", execution.code_hash())
    with execution.progress(len(cases), "lost", "runs") as tally:
        found = summaries(execution.run_cached(cases, cache, execution.executor_for(run, options), tally))
    # 3. Summary, as JSON file and as text.
    rows = [asdict(summary) for summary in found]
    execution.write_results(options, "lost.json", rows, "\n".join(map(words, found)))


def run_cache(folder: Path, code: str) -> execution.ResultCache[Case, LostResult]:
    """Return the cache of runs made by code with this hash."""
    return execution.ResultCache(folder, code, LostResult, lambda case: (case.name, case))


def run(case: Case) -> tuple[Case, LostResult]:
    """Make one run."""
    return case, drive(case)


def _kind(text: str) -> Kind:
    try:
        return Kind(text)
    except ValueError:
        # argparse shows this message instead of the name of the function.
        there = ", ".join(kind.value for kind in Kind)
        raise argparse.ArgumentTypeError(f"unknown kind {text!r}; expected one of {there}") from None


def _parser() -> argparse.ArgumentParser:
    parser = execution.parser_of("lost", "kidnapped --runs 20",
                                 "Long runs of the method `finder`: tracking (calm), in which every LOST is a false "
                                 "alarm; robots moved elsewhere (kidnapped); robots with an unknown start (nowhere), "
                                 "a start that looks like the true one (door), or one of the two (uncertain). Results "
                                 "are cached.")
    parser.add_argument(
        "kinds", nargs="*", type=_kind, default=[kind for kind in Kind if kind not in GIVEN], metavar="KIND",
        help=f"kinds of runs: {', '.join(kind.value for kind in Kind)} (default: all but door and uncertain)",
    )  # fmt: skip
    parser.add_argument("--world", "--worlds", dest="worlds", nargs="+", default=[WORLD], metavar="WORLD",
                        help=f"shipped worlds or world files: {', '.join(world_names())} (default: {WORLD})")
    execution.add_choice(parser, "--scenario", SCENARIOS, "measured", "error scenario")
    numbers = ", ".join(f"{runs} {kind.value}" for kind, runs in RUNS.items())
    add_value(parser, "--runs --seeds", "N", execution.positive, f"number of runs of each kind (default: {numbers})")
    add_value(parser, "--first-seed", "N", whole_number("the number", 0), "seed of the first run of each kind", 0)
    add_value(parser, "--minutes", "M", float, "length of tracking runs in min", 10.0)
    execution.add_execution_options(parser)
    execution.add_output(parser, Path("out/experiments"), "kind")
    return parser
