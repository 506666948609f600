"""Live trials: a simulated robot driven along a path on its estimate, over the same interface as a real one.

A Scenario defines the robot's errors and the filter's models; Record is the history of a trial; TrialResult and
LiveSummary are its results. The ground truth never reaches the filter. Simulated time advances with the exchanges
only, two per period (state and command), so a trial never waits.

    RMSE          root of the mean squared error of position and heading
    NEES          mean of e' P^-1 e of the pose, ideally 3
    coverage      fraction of estimates whose truth lies in the 95 % ellipse of the position
    jitter        RMS change of the estimate's error from one estimate to the next, relative to the odometry's
    lost          trials with a position error above LOST_IN at any evaluated time

A trial is a value that decides its numbers to the bit, except computing times, so that results can be cached.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Final, NamedTuple, TypedDict

import numpy as np

from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import Floats, add, chi_square_quantile, difference, independent, nees
from localization.filters.odometry import OdometryNoise, with_parameters
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar
from localization.live.localizer import Estimate, Localizer, Smoothed
from localization.live.sensor_input import CLOCK_STEP_S, FiringSchedule, SensorInput, restart_ring, with_readings
from localization.navigation.waypoints import PERIOD_S, Navigator, Speeds
from nclient import connect
from nclient.protocol.types import MAX_SONAR_IN, MIN_SONAR_IN
from nclient.robot import Robot
from nclient.state import Pose
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import StartPose, World

COURSES: Final[Mapping[str, str]] = MappingProxyType(
    {"5.4": "thesis_room", "5.8": "several_walls", "5.9": "centre_vertex"}
)
"""Paths of live trials by figure, and their worlds."""

START_STD: Final = (0.2, 0.2, 0.01)
"""Initial standard deviations: inches, inches, radians."""
QUIET: Final = OdometryNoise(translation_std=0.05, rotation_std=0.05, drift_std=0.002)
"""Odometry noise of scenarios without noise in the simulation."""
EXACT_RAYS: Final = RaySonar(range_std_relative=0.0, range_std_floor_in=0.02,
                             rounding_var_in2=WIRE_SONAR.rounding_var_in2, lowest_in=WIRE_SONAR.lowest_in,
                             highest_in=WIRE_SONAR.highest_in)
"""Rays without noise, in whole inches."""
SCALE, BAD = 1, 2
"""Random streams of a seed."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """Errors of the simulated robot, and the models of its filter.

    Attributes
    ----------
    base
        Named setup of the simulation.
    odometry
        Random odometry noise, also used by the filter.
    scale_std
        Standard deviation of the odometry scale, drawn for each run and estimated by the filter.
    mean_scale
        Mean of the odometry scale, which the filter does not know.
    outlier_fraction
        Fraction of the readings replaced by a random one from 6 to 255 in.
    sonar, method
        Sonar model and method of the filter.
    judged_after_in
        Distance driven after which the estimate is evaluated.
    line
        True to use the serial protocol: no timestamps, and a clock with steps of 16.4 ms.
    """

    name: str
    base: str
    sonar: RaySonar | ConeSonar
    odometry: OdometryNoise = QUIET
    scale_std: float = 0.0
    mean_scale: float = 1.0
    outlier_fraction: float = 0.0
    judged_after_in: float = 0.0
    speed_in_s: float = 5.0
    method: str = "ekf"
    line: bool = False

    def setup(self, seed: int) -> str:
        """Return the setup file of a run, in TOML."""
        # The setup file has variances, OdometryNoise standard deviations.
        noise = self.odometry
        clock = f"clock_step_s = {CLOCK_STEP_S}\n" if self.line else ""
        return (
            f'base = "{self.base}"\nramps = true\nname = "{self.name}"\n{clock}'
            f"[odometry]\nscales = [{self.scale(seed)!r}, 1.0, 1.0]\n"
            f"[motion]\nalpha1 = {noise.rotation_std**2!r}\nalpha2 = {noise.drift_std**2!r}\n"
            f"alpha3 = {noise.translation_std**2!r}\nalpha4 = 0.0\n"
        )

    def scale(self, seed: int) -> float:
        """Return the true distance per counted distance in the run of this seed."""
        # Clipped at 4 sigma, so that no seed has a robot outside its scenario.
        draw = float(np.random.default_rng([seed, SCALE]).standard_normal())
        return self.mean_scale + self.scale_std * float(np.clip(draw, -4.0, 4.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """Standard deviations of the odometry parameters that the filter estimates."""
        return (self.scale_std,) if self.scale_std else ()


_MEASURED: Final = Scenario("measured", "measured", ConeSonar(), scale_std=0.05, outlier_fraction=0.2,
                            judged_after_in=24.0)
SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType({
    scenario.name: scenario
    for scenario in (
        Scenario("exact", "ideal", EXACT_RAYS),
        Scenario("noisy", "noisy", WIRE_SONAR, THESIS_ODOMETRY),
        _MEASURED,
        # Over the serial protocol, which has neither timestamps nor a fine clock.
        Scenario("exact_line", "ideal", EXACT_RAYS, line=True),
        replace(_MEASURED, name="measured_line", line=True),
    )
})
"""`exact`: exact rays. `noisy`: rays and odometry with the noise of the figures. `measured`: the sonars of a real ring,
a fifth of the readings outliers, and an unknown scale. `_line`: the same over the serial protocol."""


# The range of an N150's sonars: 6 in is the shortest reading, 255 means no echo.
MIN_OUTLIER_IN, MAX_OUTLIER_IN = MIN_SONAR_IN, MAX_SONAR_IN
_OUTLIERS_IN: Final = (MIN_OUTLIER_IN, MAX_OUTLIER_IN + 1)
"""Lowest outlier, and the end of the range."""
_EARLY_S: Final = 1e-6
"""More than rounding errors of sums of clocks and intervals."""


class BadReadings:
    """Replace a fraction of all echoes by random whole inches from 6 to 255.

    An echo is decided once, when it is first reported; the firing schedule determines which echo a state reports.
    """

    def __init__(self, fraction: float, schedule: FiringSchedule, rng: np.random.Generator) -> None:
        self._fraction, self._schedule, self._rng = fraction, schedule, rng
        # Seconds from the start of a round of firings until each sonar fires.
        self._late_s = [schedule.order.index(sonar) * schedule.interval_s for sonar in range(len(schedule.order))]
        self._round_s = schedule.round_s
        # By sonar: seconds since the start before which no new firing is reported, less than a rounding error early.
        self._due_s = [-math.inf] * len(schedule.order)
        # By sonar: number of the last round, and the outlier of that round (None: the true reading).
        self._rounds: list[int | None] = [None] * len(schedule.order)
        self._instead: list[int | None] = [None] * len(schedule.order)

    def apply(self, state: SensorInput) -> SensorInput:
        """Return the state with outliers, as the filter receives it."""
        if not self._fraction or state.clock_s is None:
            return state
        since_s, rounds, instead = state.clock_s - self._schedule.start_s, self._rounds, self._instead
        for sonar, due_s in enumerate(self._due_s):
            # Most states repeat most readings, and so the same decisions.
            if since_s < due_s:
                continue
            # 1. Round of the firing that the reading is from.
            late_s = self._late_s[sonar]
            turn = int((since_s - late_s) // self._round_s)
            self._due_s[sonar] = late_s + (turn + 1) * self._round_s - _EARLY_S
            # 2. A new firing: draw whether it is an outlier, and its range.
            if turn != rounds[sonar]:
                is_bad, range_in = self._rng.random() < self._fraction, self._rng.integers(*_OUTLIERS_IN)
                rounds[sonar], instead[sonar] = turn, int(range_in) if is_bad else None
        pairs = zip(state.sonars_in, instead, strict=True)
        readings = [int(reading) if outlier is None else outlier for reading, outlier in pairs]
        return with_readings(state, tuple(readings))


Timer = Callable[[], float]

# State and command: each exchange advances simulated time by half a period.
EXCHANGES_PER_PERIOD: Final = 2
MAX_PERIODS: Final = 3000
"""Five minutes: more than three times the duration of any path."""
START: Final = 0
"""Random stream of the initial estimate's error."""


class Period(NamedTuple):
    """A period: estimate, true pose and encoders (x_in, y_in, heading_rad), and the computing time in s."""

    estimate: Estimate
    truth: tuple[float, float, float]
    encoders: tuple[float, float, float]
    spent_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """History of a trial of T estimates.

    Attributes
    ----------
    clock_s, distance_in : (T,) array
        Time of each estimate, and distance driven by then.
    truth, encoders, mean : (T, 3) array
    cov : (T, 3, 3) array
    spent_s : (periods,) array
        Computing time per state.

    A smoother's estimates are those of past times; the robot is always driven on the current ones.
    """

    seed: int
    reached: bool
    clock_s: Floats
    distance_in: Floats
    truth: Floats
    encoders: Floats
    mean: Floats
    cov: Floats
    spent_s: Floats

    @property
    def error(self) -> Floats:
        """Estimate minus truth (T, 3)."""
        return difference(self.mean, self.truth)


def drive(scenario: Scenario, figure: str, seed: int, periods: int = MAX_PERIODS, timer: Timer = lambda: 0.0) -> Record:
    """Run one trial in its own simulation.

    Parameters
    ----------
    scenario : Scenario
    figure : str
        Figure whose path is driven, a key of COURSES.
    seed : int
        Seed of all random numbers of the trial.
    periods : int
        Maximum number of periods of 0.1 s.
    timer : callable
        Returns seconds, for the computing time.
    """
    world = load_world(COURSES[figure])
    start = world.paths[figure].start
    # The connection is closed before the history is built.
    with simulated_robot(world.name, scenario, seed, start, line=scenario.line) as robot:
        localizer, outliers = _start_localizer(robot, scenario, world, figure, seed)
        navigator = Navigator(world.paths[figure].goals_in, Speeds(translation_in_s=scenario.speed_in_s))
        followed = _follow(robot, localizer, outliers, navigator, periods, timer)
    return _record(seed, navigator.finished, followed)


@contextmanager
def simulated_robot(world: str, scenario: Scenario, seed: int, start: Pose | StartPose, *,
                    line: bool = False) -> Iterator[Robot]:
    """Provide a robot in its own simulation of a shipped world or a file; its time advances with the exchanges only."""
    pose = f"{start.x_in},{start.y_in},{np.degrees(start.steering_rad)},{np.degrees(start.turret_rad)}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(scenario.setup(seed), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_PER_PERIOD
        options = f"setup={setup}&seed={seed}&start={pose}&step_s={step_s}&line={int(line)}"
        with connect(f"sim:{world}?{options}") as robot:
            yield robot


def _start_localizer(robot: Robot, scenario: Scenario, world: World, figure: str,
                     seed: int) -> tuple[Localizer, BadReadings]:
    """Return the localizer, its initial estimate drawn from START_STD, and the source of outliers."""
    start = world.paths[figure].start
    # 1. Firing schedule: the clock of this reply is that of the first sonar.
    schedule, _ = restart_ring(robot, N150.ring)
    # 2. Initial estimate: the true start plus an error with the covariance of the belief.
    off = np.array(START_STD) * np.random.default_rng([seed, START]).standard_normal(3)
    guess = add(np.array([start.x_in, start.y_in, start.steering_rad]), off)
    belief = with_parameters(independent(guess, START_STD), scenario.constants)
    config = LocalizationConfig(world.walls, N150, scenario.odometry, scenario.sonar)
    # 3. Localizer, and outliers from their own random stream.
    localizer = Localizer(config, belief, schedule, scenario.method, seed)
    return localizer, BadReadings(scenario.outlier_fraction, schedule, np.random.default_rng([seed, BAD]))


def _follow(robot: Robot, localizer: Localizer, outliers: BadReadings, navigator: Navigator, periods: int,
            timer: Timer) -> list[Period]:
    """Drive on the estimate until the last goal or for `periods` periods."""
    followed: list[Period] = []
    for _ in range(periods):
        # 1. State and ground truth of the same instant.
        state, actual = robot.refresh(), robot.truth()
        report = outliers.apply(state)
        # 2. Only the filter's computing time is measured, not the simulation's.
        before_s = timer()
        estimate = localizer.update(report)
        spent_s = timer() - before_s
        truth = actual.x_in, actual.y_in, actual.steering_rad
        followed.append(Period(estimate, truth, (state.x_in, state.y_in, state.steering_rad), spent_s))
        # 3. Command from the estimate alone; None at the last goal.
        command = navigator.command(estimate.pose)
        if command is None:
            break
        robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
    return followed


def _record(seed: int, reached: bool, periods: Sequence[Period]) -> Record:
    """Return the history in columns; of smoothed estimates each time once, in its last version."""
    # 1. Columns by time of the states.
    polled_s = np.array([period.estimate.clock_s for period in periods])
    truth = np.array([period.truth for period in periods])
    encoders = np.array([period.encoders for period in periods])
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    spent = np.array([period.spent_s for period in periods])
    # 2. A smoother repeats an estimate until a newer one exists: use the last version of each time.
    # The smoothed estimate where the method has one.
    estimates = [each.estimate.smoothed or Smoothed(each.estimate.clock_s, each.estimate.belief) for each in periods]
    fresh = [
        k for k in range(len(estimates)) if k == len(estimates) - 1 or estimates[k + 1].clock_s > estimates[k].clock_s
    ]
    clock = np.array([estimates[k].clock_s for k in fresh])
    means = np.stack([estimates[k].belief.mean[:3] for k in fresh])
    covs = np.stack([estimates[k].belief.cov[:3, :3] for k in fresh])
    # 3. Truth, encoders and distance at the times of the estimates, which may lie between states.
    distance = np.interp(clock, polled_s, distance)
    return Record(seed, reached, clock, distance, _interpolate(clock, polled_s, truth),
                  _interpolate(clock, polled_s, encoders), means, covs, spent)  # fmt: skip


def _interpolate(clock_s: Floats, polled_s: Floats, poses: Floats) -> Floats:
    """Return poses (n, 3) at times (n,), interpolated linearly between poses (T, 3) at times (T,)."""
    # Headings are unwrapped before and wrapped (by `add`) after the interpolation.
    turned = np.unwrap(poses[:, 2])
    columns = [np.interp(clock_s, polled_s, column) for column in (poses[:, 0], poses[:, 1], turned)]
    between = np.stack(columns, axis=-1)
    return add(between, np.zeros_like(between))


# More than the radius of the body: with such an error the robot would hit walls.
LOST_IN: Final = 12.0
"""With a larger position error a run counts as lost."""


@dataclass(frozen=True, slots=True)
class TrialResult:
    """Result of a trial, as sums over its evaluated estimates.

    Attributes
    ----------
    reached
        True if the last goal was reached.
    judged
        Number of evaluated estimates.
    position_in2, heading_rad2, nees
        Sums of squared position errors (in^2), squared heading errors (rad^2) and NEES.
    within
        Number of estimates whose truth lies in the 95 % ellipse of the position.
    worst_in
        Largest position error in inches.
    estimate_steps_in2, odometry_steps_in2
        Sums of squared changes of the position error (in^2) between consecutive estimates, over the whole trial.
    spent_us
        Median computing time per state in microseconds.
    """

    seed: int
    reached: bool
    judged: int
    position_in2: float
    heading_rad2: float
    nees: float
    within: int
    worst_in: float
    estimate_steps_in2: float
    odometry_steps_in2: float
    spent_us: float

    @property
    def lost(self) -> bool:
        """True if the position error ever exceeded LOST_IN."""
        return self.worst_in > LOST_IN

    def same_numbers(self, other: TrialResult) -> bool:
        """Return True if two results are equal to the bit, except their computing times."""
        return replace(self, spent_us=0.0) == replace(other, spent_us=0.0)


class LiveSummary(TypedDict):
    """Results of a method in a scenario on a path; None if nothing was evaluated.

    Attributes
    ----------
    seeds, reached, lost
        Number of trials, of those that reached the last goal, and of those that were lost.
    rmse_position_in, rmse_heading_deg
        Root mean squared errors in inches and degrees.
    nees_mean
        Mean NEES of the pose, ideally 3.
    coverage95
        Fraction of estimates whose truth lies in the 95 % ellipse of the position.
    jitter
        RMS change of the estimate's error per step, relative to the odometry's.
    worst_in
        Largest position error in inches.
    step_us
        Median computing time per state in microseconds.
    """

    seeds: int
    reached: int
    lost: int
    rmse_position_in: float | None
    rmse_heading_deg: float | None
    nees_mean: float | None
    coverage95: float | None
    jitter: float | None
    worst_in: float | None
    step_us: float


def result_of(record: Record, after_in: float = 0.0) -> TrialResult:
    """Return the result of a trial, evaluated after `after_in` inches."""
    # 1. Estimates of the evaluated part of the path.
    judged = record.distance_in >= after_in
    errors, covs = record.error[judged], record.cov[judged]
    square = errors[:, 0] ** 2 + errors[:, 1] ** 2
    # 2. Position inside the 95 % ellipse: its squared Mahalanobis distance is below the quantile.
    within = nees(errors[:, :2], covs[:, :2, :2]) <= chi_square_quantile(0.95, 2)
    # 3. Sums, not means: trials of different lengths can then be combined exactly.
    return TrialResult(seed=record.seed, reached=record.reached, judged=len(errors), position_in2=math.fsum(square),
                       heading_rad2=math.fsum(errors[:, 2] ** 2), nees=math.fsum(nees(errors, covs)),
                       within=int(within.sum()), worst_in=math.sqrt(max(square, default=0.0)),
                       estimate_steps_in2=_squared_steps(record.error),
                       odometry_steps_in2=_squared_steps(difference(record.encoders, record.truth)),
                       spent_us=1e6 * float(np.median(record.spent_s)))


def summarize(results: Sequence[TrialResult]) -> LiveSummary:
    """Return the summary of one or more trials."""
    # Means are over all evaluated estimates of all trials.
    count = sum(result.judged for result in results)

    def mean(part: Callable[[TrialResult], float]) -> float | None:
        return math.fsum(part(result) for result in results) / count if count else None

    position, heading = mean(lambda result: result.position_in2), mean(lambda result: result.heading_rad2)
    # Jitter relative to the odometry's: 1 means the filter adds none.
    odometry = math.fsum(result.odometry_steps_in2 for result in results)
    estimate = math.fsum(result.estimate_steps_in2 for result in results)
    return LiveSummary(
        seeds=len(results),
        reached=sum(result.reached for result in results),
        lost=sum(result.lost for result in results),
        rmse_position_in=None if position is None else math.sqrt(position),
        rmse_heading_deg=None if heading is None else math.degrees(math.sqrt(heading)),
        nees_mean=mean(lambda result: result.nees),
        coverage95=mean(lambda result: result.within),
        jitter=math.sqrt(estimate / odometry) if odometry else None,
        worst_in=max(result.worst_in for result in results) if count else None,
        step_us=median(result.spent_us for result in results),
    )


def _squared_steps(errors: Floats) -> float:
    """Return the sum of squared changes of the position error, from errors (T, 3)."""
    return math.fsum((np.diff(errors[:, :2], axis=0) ** 2).ravel())


COMPARED: Final = ("ekf", "iekf", "ukf", "smoother", "mcl")
"""Methods compared by default; all start from a given pose."""


class Cell(NamedTuple):
    """A cell of the result table, by names."""

    scenario: str
    figure: str
    method: str

    @property
    def world(self) -> str:
        """World of the path of this figure."""
        return COURSES[self.figure]


@dataclass(frozen=True, slots=True)
class Trial:
    """One live trial: scenario with method, path, seed, maximum number of periods."""

    scenario: Scenario
    figure: str
    seed: int
    periods: int = MAX_PERIODS

    @property
    def cell(self) -> Cell:
        """The cell this trial belongs to."""
        return Cell(self.scenario.name, self.figure, self.scenario.method)


class FinishedTrial(NamedTuple):
    """A trial with its result, and its history if requested."""

    trial: Trial
    result: TrialResult
    record: Record | None


class TrialJob(NamedTuple):
    """A trial to run; `whole` requests its history."""

    trial: Trial
    whole: bool = False


def trials(scenarios: Iterable[str], figures: Sequence[str], methods: Sequence[str], seeds: int,
           periods: int = MAX_PERIODS) -> list[Trial]:
    """Return all trials, cell by cell."""
    return [
        Trial(replace(SCENARIOS[scenario], method=method), figure, seed, periods)
        for scenario in scenarios
        for figure in figures
        # Seeds vary fastest, so that a cell is complete before the next one begins.
        for method in methods
        for seed in range(seeds)
    ]


def run(job: TrialJob) -> FinishedTrial:
    """Run one trial; computing time is processor time of this thread."""
    scenario, figure, seed, periods = job.trial.scenario, job.trial.figure, job.trial.seed, job.trial.periods
    record = drive(scenario, figure, seed, periods, time.thread_time)
    return FinishedTrial(job.trial, result_of(record, scenario.judged_after_in), record if job.whole else None)


def summaries(results: Mapping[Trial, TrialResult]) -> dict[Cell, LiveSummary]:
    """Return the summary of each cell, in the order of first trials."""
    cells: dict[Cell, list[TrialResult]] = {}
    for done, result in results.items():
        cells.setdefault(done.cell, []).append(result)
    return {cell: summarize(sorted(found, key=lambda result: result.seed)) for cell, found in cells.items()}
