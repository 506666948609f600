"""What a live trial is run with: world and path, how the simulated robot errs, and what the filter knows of it. Data.

Rules: numbers only. A scenario makes the text of a setup file for each seed, for what is drawn anew with each run; the
simulation is reached by a `sim:` address like any robot.

Readings made bad on purpose: of each echo decided once, as it is first shown, whether it is replaced and by what.

Rules: the filter sees the same interface; all chance is the seed's. Which echo a state shows is the schedule's to tell.

One live trial: a robot by its address, driven along a path on its estimate, and what came of it at every period.

Rules: speaks to the robot through nclient; the truth is asked for beside and never reaches the filter. Simulated time
passes with the exchanges alone: two a period, the question and the command, so a trial takes no time to wait.

From live trials to numbers: what is kept of each, and the summary of many.

    RMSE          root of the mean squared error of position, of heading
    NEES          mean of error' P^-1 error of the pose: 3 is right
    coverage      share of estimates whose truth lies in the 95 % ellipse of the position
    jitter        root mean square of how the estimate's error changes from one to the next, over that of the
                  odometry's: below 1.5 a steering hand does not feel the filter
    lost          trials whose estimate is farther than LOST_IN from the truth at any time that is judged

Rules: pure. What is kept of a trial depends on it alone (sums by math.fsum, exact in any order) and on disk is the same
to the bit; only the time spent is the machine's. All but reached and jitter is after the way that is not judged.

The matrix of live trials: method by scenario by path, a trial a seed. Data, and what runs one of them.

Rules: a trial is a value that decides its numbers to the bit (the time it took apart), whoever runs it and wherever, so
that results can be kept by it. No process, no file.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Final, NamedTuple, TypedDict

import numpy as np

from localization.experiments.figure_trial import nees
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import Floats, add, chi_square_quantile, difference, independent
from localization.filters.odometry import OdometryNoise, with_parameters
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar
from localization.live.localizer import Estimate, Localizer, Smoothed
from localization.live.sensor_input import CLOCK_STEP_S, FiringSchedule, SensorInput, with_readings
from localization.navigation.waypoints import PERIOD_S, Navigator, Speeds
from nclient import connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from worlds.io import load_world
from worlds.robots import N150
from worlds.world import World

COURSES: Final[Mapping[str, str]] = MappingProxyType(
    {"5.4": "thesis_room", "5.8": "several_walls", "5.9": "centre_vertex"}
)
"""The paths that live trials are driven on, by their figures, and the world of each."""

START_STD: Final = (0.2, 0.2, 0.01)
"""How well the robot is placed: inches, inches, radians."""
QUIET: Final = OdometryNoise(translation_std=0.05, rotation_std=0.05, drift_std=0.002)
"""How the true motion strays from the encoders', in the figures' model."""
EXACT_RAYS: Final = RaySonar(
    range_std_relative=0.0, range_std_floor_in=0.02, rounding_var_in2=1.0 / 12.0, lowest_in=6.0, highest_in=255.0
)
"""Rays without noise, read in whole inches."""
SCALE, BAD = 1, 2
"""Which stream of a seed's chance each is drawn from."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """One way to run a trial; the filter is told all of it but the draws.

    base                 the simulation's named setup          odometry      its random walk, known to the filter
    scale_std            std of the odometry's scale, drawn for each run; the filter finds it out
    bad_share            of the readings replaced by one anywhere from 6 to 255 in
    sonar                how the filter understands readings   method        its method
    judged_after_in      inches of way after which the estimate is judged
    line                 over the robot's own line: no stamps, and a clock in steps of 16.4 ms
    """

    name: str
    base: str
    sonar: RaySonar | ConeSonar
    odometry: OdometryNoise = QUIET
    scale_std: float = 0.0
    bad_share: float = 0.0
    judged_after_in: float = 0.0
    speed_in_s: float = 5.0
    method: str = "ekf"
    line: bool = False

    def setup(self, seed: int) -> str:
        """The setup file of a run, in TOML."""
        noise = self.odometry
        clock = f"clock_step_s = {CLOCK_STEP_S}\n" if self.line else ""
        return (
            f'base = "{self.base}"\nramps = true\nname = "{self.name}"\n{clock}'
            f"[odometry]\nscales = [{self.scale(seed)!r}, 1.0, 1.0]\n"
            f"[motion]\nalpha1 = {noise.rotation_std**2!r}\nalpha2 = {noise.drift_std**2!r}\n"
            f"alpha3 = {noise.translation_std**2!r}\nalpha4 = 0.0\n"
        )

    def scale(self, seed: int) -> float:
        """True travel per counted travel in the run of this seed."""
        draw = float(np.random.default_rng([seed, SCALE]).standard_normal())
        return 1.0 + self.scale_std * float(np.clip(draw, -4.0, 4.0))

    @property
    def constants(self) -> tuple[float, ...]:
        """What else the filter finds out, as uncertain as it is (systematic)."""
        return (self.scale_std,) if self.scale_std else ()


SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType(
    {
        scenario.name: scenario
        for scenario in (
            Scenario("exact", "ideal", EXACT_RAYS),
            Scenario("noisy", "noisy", WIRE_SONAR, THESIS_ODOMETRY),
            Scenario("measured", "measured", ConeSonar(), scale_std=0.05, bad_share=0.2, judged_after_in=24.0),
            Scenario("exact_line", "ideal", EXACT_RAYS, line=True),
            Scenario("measured_line", "measured", ConeSonar(), scale_std=0.05, bad_share=0.2, judged_after_in=24.0,
                     line=True),
        )
    }
)
"""`exact`: exact rays. `noisy`: rays and odometry as noisy as the figures'. `measured`: a real ring's sonars, a fifth
of its readings bad besides, and a scale to find. `_line`: the same over the robot's own line."""


LOWEST_IN, HIGHEST_IN = 6, 255


class BadReadings:
    """Replaces a share of all echoes by whole inches anywhere from 6 to 255."""

    def __init__(self, share: float, schedule: FiringSchedule, chance: np.random.Generator) -> None:
        self._share, self._schedule, self._chance = share, schedule, chance
        self._late_s = [schedule.order.index(sonar) * schedule.interval_s for sonar in range(len(schedule.order))]
        self._round_s = schedule.round_s
        self._replaced: dict[int, tuple[int, int | None]] = {}

    def of(self, told: SensorInput) -> SensorInput:
        """What the robot told as the filter is shown it."""
        if not self._share or told.clock_s is None:
            return told
        readings = [self._reading(sonar, told.clock_s, int(heard)) for sonar, heard in enumerate(told.sonars_in)]
        return with_readings(told, tuple(readings))

    def _reading(self, sonar: int, clock_s: float, heard_in: int) -> int:
        since_s = clock_s - self._schedule.start_s - self._late_s[sonar]
        turn = int(since_s // self._round_s)
        if self._replaced.get(sonar, (None, None))[0] != turn:
            bad, instead = self._chance.random() < self._share, int(self._chance.integers(LOWEST_IN, HIGHEST_IN + 1))
            self._replaced[sonar] = turn, instead if bad else None
        instead_in = self._replaced[sonar][1]
        return heard_in if instead_in is None else instead_in


Timer = Callable[[], float]

EXCHANGES_A_PERIOD: Final = 2
MAX_PERIODS: Final = 3000
"""Five minutes: longer than any path takes three times over."""
START: Final = 0
"""Stream of a seed's chance from which the error of the first estimate is drawn."""


class Period(NamedTuple):
    """A period: the estimate, truth and encoders (3,) at its clock, and the seconds of the timer spent on it."""

    estimate: Estimate
    truth: Floats
    encoders: Floats
    spent_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """A trial of T estimates: `clock_s` (T,), the instant each is of; `way_in` (T,) gone by then, `truth`, `encoders`
    and `mean` (T, 3), `cov` (T, 3, 3). `spent_s` (periods,): what each state took to be worked in, of the timer's time.

    A method that looks back has its estimates of a while ago here (filters.smoother); the robot is driven on those of
    the present whatever the method.
    """

    seed: int
    reached: bool
    clock_s: Floats
    way_in: Floats
    truth: Floats
    encoders: Floats
    mean: Floats
    cov: Floats
    spent_s: Floats

    @property
    def error(self) -> Floats:
        """Estimate less truth (T, 3)."""
        return difference(self.mean, self.truth)


def drive(
    scenario: Scenario, figure: str, seed: int, periods: int = MAX_PERIODS, timer: Timer = lambda: 0.0
) -> Record:
    """Run one trial of so many periods at most in a simulation of its own; `timer` tells seconds."""
    world = load_world(COURSES[figure])
    start = world.paths[figure].start
    pose = f"{start.x_in},{start.y_in},{np.degrees(start.steering_rad)},{np.degrees(start.turret_rad)}"
    with tempfile.TemporaryDirectory() as folder:
        setup = Path(folder) / "setup.toml"
        setup.write_text(scenario.setup(seed), encoding="utf-8")
        step_s = PERIOD_S / EXCHANGES_A_PERIOD
        options = f"setup={setup}&seed={seed}&start={pose}&step_s={step_s}&line={int(scenario.line)}"
        with connect(f"sim:{world.name}?{options}") as robot:
            localizer, shown = _listening(robot, scenario, world, figure, seed)
            navigator = Navigator(world.paths[figure].goals_in, Speeds(translation_in_s=scenario.speed_in_s))
            followed = _follow(robot, localizer, shown, navigator, periods, timer)
    return _record(seed, navigator.finished, followed)


def _listening(
    robot: Robot, scenario: Scenario, world: World, figure: str, seed: int
) -> tuple[Localizer, BadReadings]:
    """The filter at the start, a little off, and what spoils its readings."""
    start = world.paths[figure].start
    state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    schedule = FiringSchedule(state.clock_s)
    off = np.array(START_STD) * np.random.default_rng([seed, START]).standard_normal(3)
    guess = add(np.array([start.x_in, start.y_in, start.steering_rad]), off)
    belief = with_parameters(independent(guess, START_STD), scenario.constants)
    known = LocalizationConfig(world.walls, N150, scenario.odometry, scenario.sonar)
    localizer = Localizer(known, belief, schedule, scenario.method, seed)
    return localizer, BadReadings(scenario.bad_share, schedule, np.random.default_rng([seed, BAD]))


def _follow(
    robot: Robot, localizer: Localizer, shown: BadReadings, navigator: Navigator, periods: int, timer: Timer
) -> list[Period]:
    """Drive on the estimate until the last goal, or until the periods are over."""
    followed: list[Period] = []
    for _ in range(periods):
        state, actual = robot.refresh(), robot.truth()
        report = shown.of(state)
        before_s = timer()
        estimate = localizer.update(report)
        spent_s = timer() - before_s
        truth = np.array([actual.x_in, actual.y_in, actual.steering_rad])
        followed.append(Period(estimate, truth, np.array([state.x_in, state.y_in, state.steering_rad]), spent_s))
        command = navigator.command(estimate.pose)
        if command is None:
            break
        robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
    return followed


def _record(seed: int, reached: bool, periods: Sequence[Period]) -> Record:
    """The trial in columns; of estimates that look back, each instant once, as told last."""
    polled_s = np.array([period.estimate.clock_s for period in periods])
    truth = np.stack([period.truth for period in periods])
    encoders = np.stack([period.encoders for period in periods])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    spent = np.array([period.spent_s for period in periods])
    told = [_told(period.estimate) for period in periods]
    fresh = [k for k in range(len(told)) if k == len(told) - 1 or told[k + 1].clock_s > told[k].clock_s]
    clock = np.array([told[k].clock_s for k in fresh])
    means = np.stack([told[k].belief.mean[:3] for k in fresh])
    covs = np.stack([told[k].belief.cov[:3, :3] for k in fresh])
    way = np.interp(clock, polled_s, way)
    return Record(
        seed, reached, clock, way, _at(clock, polled_s, truth), _at(clock, polled_s, encoders), means, covs, spent
    )


def _told(estimate: Estimate) -> Smoothed:
    """What the method stands for: the past of one that looks back, else the present."""
    return estimate.smoothed or Smoothed(estimate.clock_s, estimate.belief)


def _at(clock_s: Floats, polled_s: Floats, poses: Floats) -> Floats:
    """Poses (n, 3) at instants (n,) between those of poses (T, 3) at (T,), the robot going evenly between them."""
    turned = np.unwrap(poses[:, 2])
    columns = [np.interp(clock_s, polled_s, column) for column in (poses[:, 0], poses[:, 1], turned)]
    between = np.stack(columns, axis=-1)
    return add(between, np.zeros_like(between))


LOST_IN: Final = 12.0
"""Farther off than this a robot no longer knows which way round a thing it is."""


@dataclass(frozen=True, slots=True)
class TrialResult:
    """What is kept of a trial: sums over its judged estimates, those for the jitter over all. `spent_us`: the median of
    what a state took to be worked in."""

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
        """Whether the estimate ever was as good as none."""
        return self.worst_in > LOST_IN

    def same_numbers(self, other: TrialResult) -> bool:
        """Whether two results are the same to the bit, the time they took apart."""
        return replace(self, spent_us=0.0) == replace(other, spent_us=0.0)


class LiveSummary(TypedDict):
    """The numbers of a method in a scenario on a path; None where nothing was judged."""

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
    """What is kept of a trial that is judged where its way is `after_in` or longer."""
    judged = record.way_in >= after_in
    errors, covs = record.error[judged], record.cov[judged]
    square = errors[:, 0] ** 2 + errors[:, 1] ** 2
    within = nees(errors[:, :2], covs[:, :2, :2]) <= chi_square_quantile(0.95, 2)
    return TrialResult(
        seed=record.seed,
        reached=record.reached,
        judged=len(errors),
        position_in2=math.fsum(square),
        heading_rad2=math.fsum(errors[:, 2] ** 2),
        nees=math.fsum(nees(errors, covs)),
        within=int(within.sum()),
        worst_in=math.sqrt(max(square, default=0.0)),
        estimate_steps_in2=_squared_steps(record.error),
        odometry_steps_in2=_squared_steps(difference(record.encoders, record.truth)),
        spent_us=1e6 * float(np.median(record.spent_s)),
    )


def summarize(results: Sequence[TrialResult]) -> LiveSummary:
    """The numbers of one trial or more."""
    count = sum(result.judged for result in results)

    def mean(part: Callable[[TrialResult], float]) -> float | None:
        return math.fsum(part(result) for result in results) / count if count else None

    position, heading = mean(lambda result: result.position_in2), mean(lambda result: result.heading_rad2)
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
    """How much errors (T, 3) of the position change from one to the next, squared and added up."""
    return math.fsum((np.diff(errors[:, :2], axis=0) ** 2).ravel())


COMPARED: Final = ("ekf", "iekf", "ukf", "smoother", "mcl")
"""Methods that are told where they start."""


class Cell(NamedTuple):
    """A place in the matrix, by names."""

    scenario: str
    figure: str
    method: str

    @property
    def world(self) -> str:
        """The world the path of that figure lies in."""
        return COURSES[self.figure]


@dataclass(frozen=True, slots=True)
class Trial:
    """One live trial: its scenario with the method in it, path, seed, and how many periods it may last."""

    scenario: Scenario
    figure: str
    seed: int
    periods: int = MAX_PERIODS

    @property
    def cell(self) -> Cell:
        """Where in the matrix it belongs."""
        return Cell(self.scenario.name, self.figure, self.scenario.method)


class FinishedTrial(NamedTuple):
    """A trial with what is kept of it, and all of it where that was asked for."""

    trial: Trial
    result: TrialResult
    record: Record | None


class TrialJob(NamedTuple):
    """A trial to run, and whether its whole record is wanted."""

    trial: Trial
    whole: bool = False


def trials(
    scenarios: Iterable[str], figures: Sequence[str], methods: Sequence[str], seeds: int, periods: int = MAX_PERIODS
) -> list[Trial]:
    """All trials of a matrix, cell by cell."""
    return [
        Trial(replace(SCENARIOS[scenario], method=method), figure, seed, periods)
        for scenario in scenarios
        for figure in figures
        for method in methods
        for seed in range(seeds)
    ]


def run(job: TrialJob) -> FinishedTrial:
    """Run one trial here and now; the time it takes is the processor's, whatever else the machine does."""
    scenario, figure, seed, periods = job.trial.scenario, job.trial.figure, job.trial.seed, job.trial.periods
    record = drive(scenario, figure, seed, periods, time.thread_time)
    return FinishedTrial(job.trial, result_of(record, scenario.judged_after_in), record if job.whole else None)


def summaries(results: Mapping[Trial, TrialResult]) -> dict[Cell, LiveSummary]:
    """The numbers of each cell, in the order of its first trial; those of a cell in the order of their seeds."""
    cells: dict[Cell, list[TrialResult]] = {}
    for done, result in results.items():
        cells.setdefault(done.cell, []).append(result)
    return {cell: summarize(sorted(found, key=lambda result: result.seed)) for cell, found in cells.items()}
