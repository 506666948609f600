"""`python -m localization.experiments disturbed`: a filter under errors that its models do not have, one row for each.

A simulated N150 drives between random positions of `several_walls`, turning on the spot before each, or presses against
a wall. It is steered by the ground truth: a wrong estimate causes no contact, and all methods see the same drive.
The filter has the models of `nomad localize`: the default odometry noise, and rays or cones.

    OK and wrong        fraction of the time in which the status is OK and the error above 3 sigma and WRONG_IN
    OK if right         fraction of the time with an error below RIGHT_IN in which the status is OK
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from localization.cli.arguments import START_STD, make_folder
from localization.experiments import execution
from localization.experiments.live_trial import LOST_IN, Scenario, simulated_robot
from localization.experiments.lost import GOALS, MARGIN_IN, POSITIONS, START, RandomExplorer, free_positions
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import Floats, add, chi_square_quantile, difference, independent, nees
from localization.filters.health import HealthStatus
from localization.filters.registry import DEFAULT_METHOD, METHODS
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule, SensorData
from localization.navigation.control_law import VelocityCommand
from localization.navigation.roadmap import Roadmap
from localization.navigation.waypoints import PERIOD_S, Speeds
from nclient.common.arguments import add_value
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.state import Pose, RobotState
from worlds.io import load_world
from worlds.robots import N150

WORLD: Final = "several_walls"
SPEED_IN_S: Final = 5.0
WRONG_IN: Final = 2.0
RIGHT_IN: Final = 1.0
THREE_SIGMA: Final = chi_square_quantile(0.9973, 2)
"""Squared Mahalanobis distance of a position: exceeded as rarely as 3 sigma by a normal variable."""
WALL: Final = 6
"""Row of the map that is missing or displaced: the wall from (60, 102) to (60, 75)."""
SLIP_INTERVAL_S: Final = 10.0
SLIP_RATE_IN: Final = 0.5
"""Distance that the wheels slip in a period, until the slip is complete: their top speed."""
PERSON_RADIUS_IN, PERSON_SPEED_IN_S = 7.0, 20.0
CLOCK, PERSON = 14, 15
"""Random streams of a seed."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Errors of one row.

    Attributes
    ----------
    offset_in, scale
        Of all readings: scale * range + offset.
    map_scale
        The map of the filter is larger than the world by this factor, about the middle.
    wall_off_in
        Displacement of one wall in the map of the filter; NaN: it is missing.
    person
        True if somebody walks about, unknown to the map.
    wheel_scale
        True distance per counted distance.
    slip_in
        Distance that the wheels slip every SLIP_INTERVAL_S while the robot drives.
    clock_s
        The clock of a state is late by up to this.
    poll
        Number of periods from one state to the next.
    target
        Point towards which the robot drives and then presses; None: it drives about.
    seconds
        Duration.
    """

    offset_in: float = 0.0
    scale: float = 1.0
    map_scale: float = 1.0
    wall_off_in: float = 0.0
    person: bool = False
    wheel_scale: float = 1.0
    slip_in: float = 0.0
    clock_s: float = 0.0
    poll: int = 1
    target: tuple[float, float] | None = None
    seconds: float = 120.0


ROWS: Final[Mapping[str, Disturbance]] = MappingProxyType({
    "undisturbed": Disturbance(),
    "sonars -1 in": Disturbance(offset_in=-1.0),
    "sonars -0.5 in": Disturbance(offset_in=-0.5),
    "sonars +0.5 in": Disturbance(offset_in=0.5),
    "sonars +1 in": Disturbance(offset_in=1.0),
    "ranges x 0.98": Disturbance(scale=0.98),
    "ranges x 1.02": Disturbance(scale=1.02),
    "map 1 % off": Disturbance(map_scale=1.01),
    "map 2 % off": Disturbance(map_scale=1.02),
    "wall missing": Disturbance(wall_off_in=math.nan),
    "wall 3 in off": Disturbance(wall_off_in=3.0),
    "person": Disturbance(person=True),
    "carpet 8 %": Disturbance(wheel_scale=0.92),
    "slips of 3 in": Disturbance(slip_in=3.0),
    "slips of 6 in": Disturbance(slip_in=6.0),
    "sonars +3 in": Disturbance(offset_in=3.0),
    "clock 100 ms": Disturbance(clock_s=0.1),
    "states at 2 Hz": Disturbance(poll=5),
    "pressed: wall": Disturbance(target=(35.0, 110.0), seconds=600.0),
    "pressed: post": Disturbance(target=(60.0, 80.0), seconds=600.0),
})
"""All rows by name."""


@dataclass(frozen=True, slots=True)
class Case:
    """A run to make."""

    row: str
    setup: str
    method: str
    seed: int


@dataclass(frozen=True, slots=True)
class Tally:
    """Sums over the estimates of a run; those of several runs add up.

    Attributes
    ----------
    count, lost
        Number of estimates, and 1 if the error ever exceeded LOST_IN.
    square_in2, variance_in2, nees
        Sums of squared errors, stated variances, and NEES.
    ok, ok_wrong, right, ok_right
        Number of estimates that are OK; OK and wrong; right; both OK and right.
    ok_nees
        Sum of the NEES where OK.
    steps_in2, odometry_steps_in2
        Sums of squared changes of the error from one estimate to the next: of the estimate, and of the odometry.
    """

    count: int
    lost: int
    square_in2: float
    variance_in2: float
    nees: float
    ok: int
    ok_wrong: int
    right: int
    ok_right: int
    ok_nees: float
    steps_in2: float
    odometry_steps_in2: float

    def __add__(self, other: Tally) -> Tally:
        """Return the sums over both."""
        return Tally(*(one + two for one, two in zip(astuple(self), astuple(other), strict=True)))


class Disturber:
    """Turns the states of a robot into those that the filter receives."""

    def __init__(self, disturbance: Disturbance, seed: int) -> None:
        self._disturbance = disturbance
        self._clock, self._walk = np.random.default_rng([seed, CLOCK]), np.random.default_rng([seed, PERSON])
        self._slipping_in, self._slipped = 0.0, np.zeros(2)
        self._person, self._goal = np.array([45.0, 45.0]), np.array([45.0, 45.0])

    def apply(self, state: RobotState, truth: Floats, time_s: float, is_driving: bool) -> SensorData:
        """Return what the filter receives of a state of a robot at pose `truth`."""
        assert state.clock_s is not None
        disturbance = self._disturbance
        sonars = tuple(map(float, state.sonars_in))
        if disturbance.person:
            sonars = self._hidden(sonars, truth, state.turret_rad - state.steering_rad)
        sonars = tuple(self._biased(reading) for reading in sonars)
        self._slip(time_s, is_driving, state.steering_rad)
        late_s = disturbance.clock_s * float(self._clock.random())
        x, y = self._slipped
        return SensorData(state.clock_s + late_s, state.x_in + x, state.y_in + y, state.steering_rad, state.turret_rad,
                          sonars, state.touching)  # fmt: skip

    def _biased(self, reading_in: float) -> float:
        low, high = N150.ring.min_range_in, N150.ring.max_range_in
        if not low < reading_in < high:
            return reading_in
        biased = self._disturbance.scale * reading_in + self._disturbance.offset_in
        return min(max(biased, low), high)

    def _slip(self, time_s: float, is_driving: bool, heading_rad: float) -> None:
        """Let the wheels turn on the spot, a part of the slip in each period of driving."""
        if is_driving and time_s % SLIP_INTERVAL_S < PERIOD_S and time_s >= SLIP_INTERVAL_S:
            self._slipping_in = self._disturbance.slip_in
        step_in = min(SLIP_RATE_IN, self._slipping_in) if is_driving else 0.0
        self._slipping_in -= step_in
        self._slipped += step_in * np.array([math.cos(heading_rad), math.sin(heading_rad)])

    def _hidden(self, sonars: tuple[float, ...], truth: Floats, turret_rad: float) -> tuple[float, ...]:
        """Return the readings with the person before them, who walks from one random point to another."""
        # 1. A step of the person.
        to_goal = self._goal - self._person
        distance = float(np.hypot(*to_goal))
        if distance < PERSON_SPEED_IN_S * PERIOD_S:
            self._goal = self._walk.uniform(0.0, 90.0, 2)
        else:
            self._person = self._person + to_goal * (PERSON_SPEED_IN_S * PERIOD_S / distance)
        # 2. Sonars that look at the person.
        dx, dy = self._person - truth[:2]
        range_in = math.hypot(dx, dy) - PERSON_RADIUS_IN - N150.sonar_ring_radius_in
        half_rad = math.atan2(PERSON_RADIUS_IN, max(math.hypot(dx, dy), PERSON_RADIUS_IN))
        hidden = []
        for angle_rad, reading_in in zip(N150.sonar_angles_rad, sonars, strict=True):
            off_rad = math.remainder(math.atan2(dy, dx) - truth[2] - turret_rad - angle_rad, math.tau)
            is_before = abs(off_rad) < half_rad and range_in < reading_in
            hidden.append(max(N150.ring.min_range_in, float(round(range_in))) if is_before else reading_in)
        return tuple(hidden)


def filter_map(walls: Floats, disturbance: Disturbance) -> Floats:
    """Return the map that the filter has of these walls."""
    ends = walls.reshape(-1, 2)
    middle = 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    seen: Floats = ((ends - middle) * disturbance.map_scale + middle).reshape(-1, 4)
    if math.isnan(disturbance.wall_off_in):
        seen = np.delete(seen, WALL, axis=0)
    else:
        seen[WALL, [0, 2]] += disturbance.wall_off_in
    return seen


@lru_cache(maxsize=1)
def _places() -> tuple[Roadmap, Floats]:
    """Return the roadmap of the world, and random positions on it with space around."""
    world = load_world(WORLD)
    return Roadmap(world.walls, N150.radius_in + MARGIN_IN), free_positions(world)


def scenario_of(setup: str, wheel_scale: float = 1.0) -> Scenario:
    """Return the simulation of a setup; its filter has the models of `nomad localize`."""
    sonar: RaySonar | ConeSonar = ConeSonar() if setup == "measured" else WIRE_SONAR
    return Scenario(setup, setup, sonar, THESIS_ODOMETRY, mean_scale=wheel_scale)


class Sample(NamedTuple):
    """A state of the robot, its true pose (3,), and True if it drives."""

    state: RobotState
    truth: Floats
    is_driving: bool


@lru_cache(maxsize=4)
def record_drive(setup: str, seed: int, wheel_scale: float, target: tuple[float, float] | None,
                 seconds: float) -> tuple[float, tuple[Sample, ...]]:
    """Return the clock at which the sonars start, and the samples of a drive: see `Disturbance` for the arguments.

    Most rows disturb the readings of one drive, or the map of the filter: they share it.
    """
    # 1. A random start, or one in front of the target.
    roadmap, places = _places()
    x, y = places[np.random.default_rng([seed, POSITIONS]).integers(len(places))]
    heading = float(np.random.default_rng([seed, START]).uniform(-math.pi, math.pi))
    if target:
        x, y, heading = target[0] + 0.3 * (seed % 5 - 2), 55.0, 0.5 * math.pi
    start = Pose(float(x), float(y), heading, heading)
    explorer = RandomExplorer(roadmap, places, Speeds(translation_in_s=SPEED_IN_S),
                              np.random.default_rng([seed, GOALS]))
    # 2. The drive, steered by the truth.
    samples, command = [], VelocityCommand(0.0, 0.0)
    with simulated_robot(WORLD, scenario_of(setup, wheel_scale), seed, start) as robot:
        clock_s = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER).clock_s
        assert clock_s is not None
        for _ in range(round(seconds / PERIOD_S)):
            state, actual = robot.refresh(), robot.truth()
            truth = np.array([actual.x_in, actual.y_in, actual.steering_rad])
            samples.append(Sample(state, truth, command.translation_in_s > 0.5 * SPEED_IN_S))
            command = VelocityCommand(SPEED_IN_S, 0.0) if target else explorer.command(truth)
            robot.drive(translation_in_s=command.translation_in_s, steering_rad_s=command.steering_rad_s)
    return clock_s, tuple(samples)


Moment = tuple[Estimate, Floats, Floats]
"""Estimate, true pose (3,) and odometry (3,)."""


def run(case: Case) -> tuple[Case, Tally]:
    """Make one run: a filter on a disturbed drive."""
    disturbance, seed = ROWS[case.row], case.seed
    clock_s, samples = record_drive(case.setup, seed, disturbance.wheel_scale, disturbance.target, disturbance.seconds)
    # 1. The filter, with a random error of its start.
    scenario = scenario_of(case.setup)
    noise = np.array(START_STD) * np.random.default_rng([seed, START, 1]).standard_normal(3)
    belief = independent(add(samples[0].truth, noise), START_STD)
    walls = filter_map(np.asarray(load_world(WORLD).walls), disturbance)
    config = LocalizationConfig(walls, N150, scenario.odometry, scenario.sonar)
    localizer = Localizer(config, belief, FiringSchedule(clock_s), case.method, seed)
    # 2. Its estimates.
    disturber, moments = Disturber(disturbance, seed), []
    for number, (state, truth, is_driving) in enumerate(samples):
        received = disturber.apply(state, truth, number * PERIOD_S, is_driving)
        if number % disturbance.poll == 0:
            odometry = np.array([received.x_in, received.y_in, received.steering_rad])
            moments.append((localizer.update(received), truth, odometry))
    return case, _tally(moments)


def _tally(moments: Sequence[Moment]) -> Tally:
    """Return the sums over a run."""
    truth = np.stack([true for _, true, _ in moments])
    errors = difference(np.stack([estimate.belief.mean[:3] for estimate, _, _ in moments]), truth)
    covs = np.stack([estimate.belief.cov[:3, :3] for estimate, _, _ in moments])
    odometry = difference(np.stack([pose for _, _, pose in moments]), truth)
    ok = np.array([estimate.health.status is HealthStatus.OK for estimate, _, _ in moments])
    error_in, squared = np.hypot(errors[:, 0], errors[:, 1]), nees(errors, covs)
    wrong = (error_in > WRONG_IN) & (nees(errors[:, :2], covs[:, :2, :2]) > THREE_SIGMA)
    right = error_in < RIGHT_IN
    return Tally(count=len(moments), lost=int(error_in.max() > LOST_IN), square_in2=math.fsum(error_in**2),
                 variance_in2=math.fsum(covs[:, 0, 0] + covs[:, 1, 1]), nees=math.fsum(squared), ok=int(ok.sum()),
                 ok_wrong=int((ok & wrong).sum()), right=int(right.sum()), ok_right=int((ok & right).sum()),
                 ok_nees=math.fsum(squared[ok]), steps_in2=math.fsum((np.diff(errors[:, :2], axis=0) ** 2).ravel()),
                 odometry_steps_in2=math.fsum((np.diff(odometry[:, :2], axis=0) ** 2).ravel()))


def summarize(row: str, setup: str, method: str, tallies: Sequence[Tally]) -> dict[str, Any]:
    """Return the numbers of a row; None where there is nothing to divide by."""
    total = sum(tallies[1:], tallies[0])

    def share(part: float, of: float) -> float | None:
        return part / of if of else None

    jitter = share(total.steps_in2, total.odometry_steps_in2)
    return {
        "disturbance": row,
        "setup": setup,
        "method": method,
        "runs": len(tallies),
        "lost": total.lost / len(tallies),
        "rmse_in": math.sqrt(total.square_in2 / total.count),
        "stated_in": math.sqrt(total.variance_in2 / total.count),
        "nees": total.nees / total.count,
        "ok": total.ok / total.count,
        "ok_wrong": total.ok_wrong / total.count,
        "ok_if_right": share(total.ok_right, total.right),
        "nees_ok": share(total.ok_nees, total.ok),
        "jitter": None if jitter is None else math.sqrt(jitter),
    }


_COLUMNS: Final = (
    ("lost", "lost", ".0%"), ("RMSE (in)", "rmse_in", ".2f"),
    ("stated (in)", "stated_in", ".2f"), ("NEES", "nees", ".1f"), ("OK", "ok", ".1%"),
    ("OK and wrong", "ok_wrong", ".2%"), ("OK if right", "ok_if_right", ".1%"),
    ("NEES if OK", "nees_ok", ".1f"), ("jitter", "jitter", ".2f"),
)  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as a text table."""
    names = {"disturbance": "disturbance", "setup": "setup", "method": "method"}
    return execution.table_of(names, _COLUMNS, rows)


def main(arguments: Sequence[str]) -> None:
    """Run the command; errors of execution and files are propagated."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    # 1. All runs.
    cells = [(row, setup) for setup in options.setups for row in options.rows]
    seeds = range(options.first, options.first + options.seeds)
    # Seed by seed, as the rows of a seed share drives.
    cases = [
        Case(row, setup, options.method, seed) for setup in options.setups for seed in seeds for row in options.rows
    ]
    # 2. Make those that the cache does not have.
    cache = run_cache(options.out / "disturbed", execution.code_hash())
    with execution.progress(len(cases), "disturbed", "runs") as tally:
        results = execution.run_cached(cases, cache, execution.executor_for(run, options), tally)
    # 3. The table, and the same as a file.
    rows = [
        summarize(row, setup, options.method,
                  [results[case] for case in cases if (case.row, case.setup) == (row, setup)])
        for row, setup in cells
    ]
    execution.write_results(options, f"disturbed_{options.method}.json", rows, table(rows))


def run_cache(folder: Path, code: str) -> execution.ResultCache[Case, Tally]:
    """Return the cache of runs made by code with this hash."""
    return execution.ResultCache(folder, code, Tally,
                                 lambda case: (f"{case.setup}_{case.method}_{case.seed:04d}", (case, ROWS[case.row])))


def _parser() -> argparse.ArgumentParser:
    parser = execution.parser_of("disturbed", "--seeds 2 --setups measured",
                                 "A filter with the models of `nomad localize` under errors that these do not have: "
                                 "biased sonars, wrong maps, slipping wheels, late clocks, contacts. For each the "
                                 "error, the consistency, and how often the status is OK although the estimate is "
                                 "wrong. Results are cached.")
    add_value(parser, "--seeds", "N", execution.positive, "number of runs per row", 20)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="first seed (default: %(default)s)")
    execution.add_choice(parser, "--rows", ROWS, list(ROWS), "disturbances")
    execution.add_choice(parser, "--setups", ("noisy", "measured"), ["noisy", "measured"], "setups: rays, and cones")
    execution.add_choice(parser, "--method", METHODS, DEFAULT_METHOD, "filter")
    execution.add_execution_options(parser)
    execution.add_output(parser, Path("out/experiments"), "row")
    return parser
