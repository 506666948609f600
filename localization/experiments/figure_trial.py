"""Batch simulation of the figures of the thesis: settings, random numbers, consistency measures, and the trial itself.

All robots of a batch of seeds are simulated at once in arrays: true poses, sonars, filters and controllers, step by
step. The truth is used to move, to simulate readings and to compute the bound; filter and control law never use it.
Without a filter the robot is steered by its odometry, from the true start.

Each seed has an independent random stream per purpose, so results depend neither on the batch size nor on the number
of processes, and two figures with the same seed have the same noise (common random numbers). Settings that the thesis
does not state (noise, start, waypoint radius) are fixed once for all figures; no noise is tuned to a result.

Results of the figures of the thesis: what is stored of each seed, and the summary over seeds.

The result of a seed depends on that seed only (sums by math.fsum, exact in any order), and the summary on the seeds in
their order: the numbers are the same to the bit however the work is divided.

The runs of a figure in machine code: numba compiles the formulas of the filter and of the control law.

What stands here is `figure_trial._advance` robot by robot and step by step; the formulas are the functions of odometry,
sonar_ray, update and control_law that a live robot runs. Results agree with those in arrays to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import islice
from math import sqrt
from statistics import median
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypedDict, cast

import numpy as np
import numpy.typing as npt

from localization.filters import compiled, odometry, sonar_ray
from localization.filters.base import THESIS_ODOMETRY
from localization.filters.belief import (
    HEADING,
    POSE,
    Belief,
    Floats,
    add,
    add_outer,
    chi_square_quantile,
    difference,
    hypot,
    independent,
    nees,
    unit_vector,
    wrap_angle,
)
from localization.filters.ekf import update_ring
from localization.filters.odometry import predict_state, process_variance
from localization.filters.update import NONE, apply_gain, pose_gain
from localization.navigation import control_law
from localization.navigation.control_law import ControlGains, is_reached, next_step, step_to
from worlds.compiled import checksum, compile_function, make_compilable
from worlds.io import load_world
from worlds.raycast import NO_WALL, nearest_wall
from worlds.robots import N150

WAYPOINT_RADIUS_IN: Final = 0.25
"""Distance between estimate and waypoint at which the waypoint counts as reached."""

START_STD: Final = (0.1, 0.1, 0.01)
"""Initial standard deviations (in, in, rad); the first estimate is drawn from them."""

NOISE: Final = THESIS_ODOMETRY
"""Noise of the true motion; the filter uses the same numbers."""

MAX_STEPS_FACTOR: Final = 3
"""A run ends after this multiple of the minimum number of steps."""

# The control laws of the figures: inches and radians per step, and gains without unit.
_SLOW: Final = ControlGains(drho_max_in=0.05, dtheta_max_rad=0.05, alpha_rho=0.1, alpha_theta=0.1)
_BADLY_CHOSEN: Final = ControlGains(drho_max_in=0.5, dtheta_max_rad=0.5, alpha_rho=0.08, alpha_theta=0.8)


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the thesis: its world and control law, whether the filter runs, and what the text counts.

    `errors_figure` is the number of the figure that shows the errors of the same run, "" where there is none.
    """

    name: str
    title: str
    world: str
    errors_figure: str = ""
    gains: ControlGains = _SLOW
    filtered: bool = True
    steps_thesis: int | None = None


FIGURES: Final[Mapping[str, Figure]] = MappingProxyType({
    figure.name: figure
    for figure in (
        Figure("5.2", "Without the filter", "thesis_room", "5.3", filtered=False),
        Figure("5.4", "With the filter", "thesis_room", "5.5", steps_thesis=1199),
        Figure("5.6", "Badly chosen limits", "thesis_room", "5.7", gains=_BADLY_CHOSEN, steps_thesis=150),
        Figure("5.8", "Guided path between several walls", "several_walls"),
        Figure("5.9", "Guided path around a vertex", "centre_vertex"),
    )
})


@dataclass(frozen=True, slots=True)
class FigureSetup:
    """Configuration of a trial: start (3,), goals (k, 2), map, sonars, gains and noise."""

    start: Floats
    goals_in: Floats
    walls: sonar_ray.WallMap
    body: sonar_ray.SonarRing
    gains: ControlGains
    filtered: bool = True
    start_std: tuple[float, float, float] = START_STD
    noise: odometry.OdometryNoise = NOISE
    sonar: sonar_ray.RaySonar = sonar_ray.IDEAL_SONAR
    waypoint_radius_in: float = WAYPOINT_RADIUS_IN

    @property
    def angles_rad(self) -> Floats:
        """Angle of each sonar from the heading, (n,): the turret turns with the steering."""
        return np.asarray(self.body.sonar_angles_rad, dtype=np.float64)

    @property
    def length_in(self) -> float:
        """Length of the polyline from the start through all goals, inches."""
        corners = np.vstack([self.start[:2], self.goals_in])
        return float(np.hypot(*np.diff(corners, axis=0).T).sum())

    @property
    def min_steps(self) -> int:
        """Minimum number of full steps."""
        return math.floor(self.length_in / self.gains.drho_max_in)

    @property
    def max_steps(self) -> int:
        """Number of steps after which a run ends."""
        return MAX_STEPS_FACTOR * self.min_steps + 1


def figure_setup(figure: Figure) -> FigureSetup:
    """Return the configuration of a figure: the N150's ring, its turret turning with the steering as in the thesis."""
    world = load_world(figure.world)
    path = world.paths[figure.name]
    return FigureSetup(start=np.array([path.start.x_in, path.start.y_in, path.start.steering_rad]),
                       goals_in=np.array(path.goals_in, dtype=np.float64), walls=sonar_ray.wall_map(world.walls),
                       body=N150, gains=figure.gains, filtered=figure.filtered)


_START, _MOTION, _SONAR = range(3)

_BLOCK: Final = 128
"""Steps drawn per call: one call per step and seed would take longer than the filter."""


def draw_start_errors(seeds: Sequence[int]) -> Floats:
    """Return standard normals (seeds, 3) for the error of the first estimate."""
    return np.stack([_generator(seed, _START).standard_normal(3) for seed in seeds])


def draw_step_errors(seeds: Sequence[int], beams: int) -> Iterator[tuple[Floats, Floats]]:
    """Yield for each step, without end, standard normals (seeds, 2) of the motion and (seeds, beams) of the sonars."""
    for moves, ranges in draw_blocks(seeds, beams):
        yield from zip(moves, ranges, strict=True)


def draw_blocks(seeds: Sequence[int], beams: int) -> Iterator[tuple[Floats, Floats]]:
    """Yield the numbers of `draw_step_errors` for _BLOCK steps at a time, (_BLOCK, seeds, 2 or beams)."""
    motion = [_generator(seed, _MOTION) for seed in seeds]
    sonar = [_generator(seed, _SONAR) for seed in seeds]
    while True:
        moves = np.stack([rng.standard_normal((_BLOCK, 2)) for rng in motion], axis=1)
        yield moves, np.stack([rng.standard_normal((_BLOCK, beams)) for rng in sonar], axis=1)


def _generator(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose,)))


def mean_band(dof: int, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Return the interval that contains the mean of `runs` chi-square variables of `dof` with this probability."""
    # The sum of `runs` chi-square variables is chi-square with dof * runs degrees of freedom.
    tail = 0.5 * (1.0 - probability)
    low, high = (chi_square_quantile(p, dof * runs) / runs for p in (tail, 1.0 - tail))
    return low, high


def information(jacobian: Floats, variance: Floats) -> Floats:
    """Return the Fisher information H' R^-1 H (..., m, m) of n readings, with H (..., n, m) and variances (..., n)."""
    return np.swapaxes(jacobian / variance[..., None], -1, -2) @ jacobian


def bound_step(cov: Floats, jacobian: Floats, process_cov: Floats, gain: Floats) -> Floats:
    """Return the posterior Cramer-Rao bound after one more step; all arrays are (..., n, n).

    The recursion of the information J, J' = D22 - D21 (J + D11)^-1 D12, needs Q^-1; here Q has rank 2. With the
    matrix inversion lemma it is the same as, for C = J^-1,

        C- = F C F' + Q        C' = (C-^-1 + gain)^-1 = (I + C- gain)^-1 C-

    which needs no inverse of Q. F, Q and `gain` (see `information`) are taken along the true path.

    References
    ----------
    Tichavsky, Muravchik, Nehorai: Posterior Cramer-Rao bounds for discrete-time nonlinear filtering (1998).
    """
    prior = jacobian @ cov @ np.swapaxes(jacobian, -1, -2) + process_cov
    bound = np.asarray(np.linalg.solve(np.eye(cov.shape[-1]) + prior @ gain, prior), dtype=np.float64)
    return 0.5 * (bound + np.swapaxes(bound, -1, -2))


Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch of n robots after a step.

    Attributes
    ----------
    truth : (n, 3) array
    belief : Belief
        Beliefs of the filters.
    bound : (n, 3, 3) array
        Cramer-Rao bound on the covariance.
    leg : (n,) array of int
        Index of the current goal; the number of goals if all are reached.
    nis, used : (n,) array
        NIS of the last update, and number of beams used.
    """

    truth: Floats
    belief: Belief
    bound: Floats
    leg: Indices
    nis: Floats
    used: Indices


@dataclass(frozen=True, slots=True)
class Runs:
    """History of a batch of n seeds over at most T steps; row k is after step k + 1 of each robot.

    `steps` (n,); `reached` (n,), True if all goals were reached; `truth` and `mean` (T, n, 3);
    `cov` and `bound` (T, n, 3, 3); `nis` and `used` (T, n).
    """

    seeds: tuple[int, ...]
    steps: Indices
    reached: npt.NDArray[np.bool_]
    truth: Floats
    mean: Floats
    cov: Floats
    bound: Floats
    nis: Floats
    used: Indices


def run(setup: FigureSetup, seeds: Sequence[int], tick: Callable[[int], None] = lambda _: None) -> Runs:
    """Simulate a trial once per seed in arrays; after each step `tick` is called with the number of moving robots."""
    batch = _start(setup, seeds)
    history: list[tuple[Floats | Indices, ...]] = []
    steps = np.zeros(len(seeds), dtype=np.intp)
    errors = draw_step_errors(seeds, len(setup.body.sonar_angles_rad))
    for motion_error, sonar_error in islice(errors, setup.max_steps):
        driving = batch.leg < len(setup.goals_in)
        if not driving.any():
            break
        batch = _advance(setup, batch, motion_error, sonar_error)
        history.append((batch.truth, batch.belief.mean, batch.belief.cov, batch.bound, batch.nis, batch.used))
        steps += driving
        tick(int(driving.sum()))
    states: Any = map(np.stack, zip(*history, strict=True))
    return Runs(tuple(seeds), steps, batch.leg == len(setup.goals_in), *states)


def run_compiled(setup: FigureSetup, seeds: Sequence[int]) -> Runs:
    """Simulate a trial with a filter once per seed in machine code: the numbers of `run`, to rounding.

    Rows of a robot after its last step are 0.
    """
    drive_robots, trial = load_drive(), trial_of(setup)
    start, count, most = _start(setup, seeds), len(seeds), setup.max_steps
    robots = Robots(start.truth, start.belief.mean.copy(), start.belief.cov.copy(), start.bound.copy(),
                    start.leg.copy(), np.zeros(count, dtype=np.intp))  # fmt: skip
    poses, covariances = (most, count, 3), (most, count, 3, 3)
    history = History(np.zeros(poses), np.zeros(poses), np.zeros(covariances), np.zeros(covariances),
                      np.zeros((most, count)), np.zeros((most, count), dtype=np.intp))  # fmt: skip
    is_moving = np.ones(count, dtype=np.bool_)
    for motion_error, sonar_error in draw_blocks(seeds, len(setup.body.sonar_angles_rad)):
        drive_robots(robots, history, motion_error, sonar_error, is_moving, trial)
        if not is_moving.any():
            break
    longest = slice(int(robots.steps.max()))
    states: Any = (rows[longest] for rows in history)
    return Runs(tuple(seeds), robots.steps, robots.leg == len(setup.goals_in), *states)


def _start(setup: FigureSetup, seeds: Sequence[int]) -> Batch:
    """Return all robots at the start; with a filter, the estimates are drawn from the initial covariance."""
    # Odometry alone starts at the true pose with covariance 0.
    count = len(seeds)
    truth = np.tile(setup.start, (count, 1))
    std = np.array(setup.start_std) if setup.filtered else np.zeros(3)
    belief = independent(add(truth, std * draw_start_errors(seeds)), std)
    nothing = np.zeros(count, dtype=np.intp)
    return Batch(truth, belief, belief.cov, nothing, np.zeros(count), nothing)


def _advance(setup: FigureSetup, batch: Batch, motion_error: Floats, sonar_error: Floats) -> Batch:
    """Simulate one step of all robots, in arrays."""
    # 1. Command; robots at their last goal stand.
    driving = batch.leg < len(setup.goals_in)
    goals = setup.goals_in[np.minimum(batch.leg, len(setup.goals_in) - 1)]
    step = next_step(batch.belief.mean, goals, setup.gains) * driving[:, None]
    # 2. Move and predict.
    truth = odometry.move(batch.truth, step + np.sqrt(odometry.step_variance(step, setup.noise)) * motion_error)
    belief = odometry.predict(batch.belief, step, setup.noise)
    # 3. Measure and update.
    bound, nis, used = batch.bound, batch.nis, batch.used
    if setup.filtered:
        readings, gain = _measure(setup, truth, sonar_error)
        belief, nis, used = _update(setup, belief, readings)
        F, G = odometry.step_jacobians(batch.truth, step)
        bound = bound_step(bound, F, odometry.process_covariance(G, step, setup.noise), gain)
    # 4. Goals reached.
    arrived = driving & is_reached(belief.mean, goals, setup.waypoint_radius_in)
    return Batch(truth, belief, bound, batch.leg + arrived, nis, used)


def _measure(setup: FigureSetup, truth: Floats, sonar_error: Floats) -> tuple[Floats, Floats]:
    """Return readings (n, 16) at the true poses (n, 3), and the information (n, 3, 3) of all beams that meet a wall."""
    expected = sonar_ray.ranges_from(truth, setup.angles_rad, setup.body, setup.walls)
    seen = expected.row != NO_WALL
    variance = setup.sonar.variance(expected.range_in)
    H = np.where(seen[..., None], np.stack(expected.H, axis=-1), 0.0)
    gain = information(H, np.where(seen, variance, 1.0))
    return expected.range_in + np.sqrt(variance) * sonar_error, gain


def _update(setup: FigureSetup, belief: Belief, readings_in: Floats) -> tuple[Belief, Floats, Indices]:
    """Return the beliefs updated by readings (n, 16), the NIS (n,) and the number of beams used (n,)."""
    observation = sonar_ray.observe_ring(belief, setup.angles_rad, readings_in, setup.body, setup.walls, setup.sonar)
    corrected, nis = update_ring(belief, observation)
    return corrected, nis, observation.used.sum(axis=-1)


TRACKED_SEEDS: Final = 20
"""Complete runs are stored for seeds below this number, for the pictures."""


@dataclass(frozen=True, slots=True)
class SeedResult:
    """Result of one run.

    Attributes
    ----------
    steps
        Number of steps T.
    reached
        True if all goals were reached, by the estimate.
    end_error_in
        Position error after the last step, in inches.
    position_in2, heading_rad2, nees, nis
        Sums over the steps of the squared position error (in^2), the squared heading error (rad^2), NEES and NIS.
    used
        Number of beams used in all steps.
    bound_in2
        Sum over the steps of the bound on the squared position error (in^2).
    """

    seed: int
    steps: int
    reached: bool
    end_error_in: float
    position_in2: float
    heading_rad2: float
    nees: float
    nis: float
    used: float
    bound_in2: float


@dataclass(frozen=True, slots=True)
class Track:
    """A complete run of T steps: `truth` and `mean` (T, 3), `cov` (T, 3, 3)."""

    seed: int
    truth: Floats
    mean: Floats
    cov: Floats


@dataclass(frozen=True, slots=True)
class FigureResult:
    """Results of a figure for all or some of its seeds."""

    results: tuple[SeedResult, ...]
    tracks: tuple[Track, ...]


class Summary(TypedDict):
    """Results of a figure over all seeds; None where a number does not apply.

    Root mean squares and means are over all steps of all seeds. `nees_band95` is the 95 % interval of the mean NEES of
    that many independent runs. `nis_mean` is per beam: the sum of NIS over the number of beams used, ideally 1.
    `pcrb_position_in` is the posterior Cramer-Rao bound on the RMSE, with all beams that meet a wall.
    """

    figure: str
    seeds: int
    steps_median: float
    steps_thesis: int | None
    end_error_median_in: float
    reached: int
    rmse_position_in: float
    rmse_heading_deg: float
    nees_mean: float | None
    nees_band95: list[float] | None
    nis_mean: float | None
    pcrb_position_in: float | None


def figure_result(runs: Runs, filtered: bool) -> FigureResult:
    """Return the results of runs; NEES, NIS and the bound only with a filter."""
    results, tracks = [], []
    # One row of the arrays per seed; after its last step a row has no meaning.
    for row, seed in enumerate(runs.seeds):
        span = slice(int(runs.steps[row]))
        track = Track(seed, runs.truth[span, row], runs.mean[span, row], runs.cov[span, row])
        # 1. Estimate minus truth (T, 3), headings wrapped.
        error = difference(track.mean, track.truth)
        square = error[:, 0] ** 2 + error[:, 1] ** 2
        # 2. Bound on the squared position error: the trace of the position block of the covariance bound.
        bound = runs.bound[span, row, 0, 0] + runs.bound[span, row, 1, 1]
        sums = [0.0] * 4
        if filtered:
            extra = (nees(error, track.cov), runs.nis[span, row], runs.used[span, row], bound)
            sums = [math.fsum(values) for values in extra]
        results.append(SeedResult(seed, len(error), bool(runs.reached[row]), math.sqrt(square[-1]), math.fsum(square),
                                  math.fsum(error[:, 2] ** 2), *sums))
        if seed < TRACKED_SEEDS:
            tracks.append(track)
    return FigureResult(tuple(results), tuple(tracks))


def join_results(parts: Sequence[FigureResult]) -> FigureResult:
    """Return the results of several batches as one, in the given order."""
    return FigureResult(tuple(result for part in parts for result in part.results),
                        tuple(track for part in parts for track in part.tracks))


def summarize(figure: Figure, results: Sequence[SeedResult]) -> Summary:
    """Return the summary of a figure over all seeds."""
    # Means over all steps of all seeds; math.fsum makes them independent of the batches.
    count = len(results)
    steps = sum(result.steps for result in results)
    nees_mean = nees_band = nis_mean = bound_in = None
    if figure.filtered:
        nees_mean = math.fsum(result.nees for result in results) / steps
        nees_band = list(mean_band(3, count))
        used = math.fsum(result.used for result in results)
        nis_mean = math.fsum(result.nis for result in results) / used if used else None
        bound_in = math.sqrt(math.fsum(result.bound_in2 for result in results) / steps)
    return Summary(
        figure=figure.name,
        seeds=count,
        steps_median=float(median(result.steps for result in results)),
        steps_thesis=figure.steps_thesis,
        end_error_median_in=median(result.end_error_in for result in results),
        reached=sum(result.reached for result in results),
        rmse_position_in=math.sqrt(math.fsum(result.position_in2 for result in results) / steps),
        rmse_heading_deg=math.degrees(math.sqrt(math.fsum(r.heading_rad2 for r in results) / steps)),
        nees_mean=nees_mean,
        nees_band95=nees_band,
        nis_mean=nis_mean,
        pcrb_position_in=bound_in,
    )


def typical(tracks: Sequence[Track]) -> Track:
    """Return the track with the (upper) median final error, for drawing."""
    # By the position error of the last step, inches.
    ranked = sorted(tracks, key=lambda track: float(np.hypot(*(track.mean - track.truth)[-1, :2])))
    return ranked[len(ranked) // 2]


Drive = Callable[..., None]

GainsRow = NamedTuple("GainsRow", [(field.name, float) for field in fields(ControlGains)])  # type: ignore[misc]


class Trial(NamedTuple):
    """A `FigureSetup` as compiled code takes it."""

    goals_in: Floats
    waypoint_radius_in: float
    gains: Any
    noise: Any
    sonar: Any
    gate: Any
    threshold: float
    walls: Any
    angles_rad: Floats
    ring_in: float


class Robots(NamedTuple):
    """n robots: truth, mean (n, 3), cov, bound (n, 3, 3), leg and steps so far (n,), as in `figure_trial.Batch`."""

    truth: Floats
    mean: Floats
    cov: Floats
    bound: Floats
    leg: Any
    steps: Any


class History(NamedTuple):
    """State of n robots after each of T steps, as in `figure_trial.Runs`: (T, n, ...)."""

    truth: Floats
    mean: Floats
    cov: Floats
    bound: Floats
    nis: Floats
    used: Any


def copy_row(row: Any, to: Any) -> None:
    """Copy a row; numba compiles `to[:] = row` for seconds, for the text of its error."""
    for number in range(len(row)):
        to[number] = row[number]


def make_drive(sources: int) -> Drive:
    """Return the loop in Python; the checksum of what it calls is part of its key in numba's cache."""

    def drive_robots(robots: Any, history: Any, motion_error: Floats, sonar_error: Floats, is_moving: Any,
                     trial: Any) -> None:
        """Drive n robots for k steps, in place, or to their last goals.

        Parameters
        ----------
        motion_error, sonar_error
            Standard normals (k, n, 2) and (k, n, beams).
        is_moving
            (n,), overwritten: True for each that has a goal left and a row left in the history.
        """
        truth, mean, cov, bound, leg, steps = robots
        goals, noise, sonar, gate, walls, angles_rad = (trial.goals_in, trial.noise, trial.sonar, trial.gate,
                                                        trial.walls, trial.angles_rad)  # fmt: skip
        count = len(angles_rad)
        # By beam; each is written before it is read. Lists: numba compiles `np.zeros` for seconds.
        H, is_used = [(0.0, 0.0, 0.0) for _ in range(count)], [False for _ in range(count)]
        R, innovation = [0.0 for _ in range(count)], [0.0 for _ in range(count)]
        change, before = mean[0].copy(), mean[0].copy()
        rows = list(sonar_ray.wall_rows(walls))
        listed: Any = compiled.ListedWalls(walls.segments, walls.lines, walls.middle, rows)
        for i in range(len(truth)):
            x, P = mean[i], cov[i]
            for k in range(len(motion_error)):
                row, goal = steps[i], leg[i]
                is_moving[i] = goal < len(goals) and row < len(history.nis)
                if not is_moving[i]:
                    break
                # 1. The command.
                distance, turn = step_to(x[0], x[1], x[HEADING], goals[goal, 0], goals[goal, 1], trial.gains)
                # 2. The bound along the true path, and the belief, are predicted by the same function.
                copy_row(truth[i], before)
                predict_state(before, bound[i], distance, turn, noise)
                predict_state(x, P, distance, turn, noise)
                # 3. The true step has the noise of the model.
                q_distance, q_turn = process_variance(distance, turn, noise)
                true_distance = distance + sqrt(q_distance) * motion_error[k, i, 0]
                true_turn = turn + sqrt(q_turn) * motion_error[k, i, 1]
                c, s = unit_vector(truth[i, HEADING] + 0.5 * true_turn)
                truth[i, 0] += true_distance * c
                truth[i, 1] += true_distance * s
                truth[i, HEADING] = wrap_angle(truth[i, HEADING] + true_turn)
                used = 0
                for beam in range(count):
                    is_used[beam] = False
                    # 4. The true range, the information in it for the bound, and the reading.
                    dx, dy = unit_vector(truth[i, HEADING] + angles_rad[beam])
                    wall = nearest_wall(truth[i, 0], truth[i, 1], dx, dy, rows)[1]
                    if wall == NO_WALL:
                        continue
                    line = sonar_ray.line_of(wall, listed)
                    along, slope, _ = sonar_ray.intersect_line(truth[i, 0], truth[i, 1], dx, dy, line, 0.0)
                    R_true = sonar_ray.range_variance(sonar, along - trial.ring_in)
                    K, S = pose_gain(bound[i], slope, R_true)
                    add_outer(bound[i], -S, K)
                    reading = along - trial.ring_in + sqrt(R_true) * sonar_error[k, i, beam]
                    if not sonar.lowest_in < reading < sonar.highest_in:
                        continue
                    # 5. The expected reading, and the chi-square gate; linearised at the mean before the whole ring.
                    expected = sonar_ray.predict_beam(x, P, angles_rad[beam], trial.ring_in, listed, gate, 0.0)
                    if expected.refusal != NONE:
                        continue
                    R_beam, error = sonar_ray.range_variance(sonar, expected.range_in), reading - expected.range_in
                    if error * error <= trial.threshold * (sonar_ray.predicted_variance(P, expected.H) + R_beam):
                        innovation[beam], R[beam], is_used[beam] = error, R_beam, True
                        H[beam] = expected.H
                        used += 1
                # 6. The update by the whole ring, reading by reading, as `ekf.update_ring`.
                nis = 0.0
                for coordinate in range(POSE):
                    change[coordinate] = 0.0
                for beam in range(count):
                    if is_used[beam]:
                        a, b, c = H[beam]
                        left = innovation[beam] - (a * change[0] + b * change[1] + c * change[2])
                        K, S = pose_gain(P, H[beam], R[beam])
                        nis += apply_gain(change, P, K, S, left)
                x[0] += change[0]
                x[1] += change[1]
                x[HEADING] = wrap_angle(x[HEADING] + change[HEADING])
                # 7. The step is over; a goal may be reached.
                copy_row(truth[i], history.truth[row, i])
                copy_row(x, history.mean[row, i])
                for coordinate in range(POSE):
                    copy_row(P[coordinate], history.cov[row, i, coordinate])
                    copy_row(bound[i, coordinate], history.bound[row, i, coordinate])
                history.nis[row, i], history.used[row, i] = nis, used
                steps[i] = row + 1
                if hypot(goals[goal, 0] - x[0], goals[goal, 1] - x[1]) <= trial.waypoint_radius_in:
                    leg[i] = goal + 1
        assert sources >= 0

    return drive_robots


@cache
def load_drive() -> Drive:
    """Return the compiled loop. Raises ImportError without numba."""
    compiled.load()
    make_compilable([step_to, copy_row])
    sources = checksum(__file__, control_law.__file__, *(module.__file__ for module in compiled.SOURCES))
    # A division by zero gives what it gives in arrays.
    return cast("Drive", compile_function(make_drive(sources), is_division_tested=False))


def trial_of(setup: FigureSetup) -> Trial:
    """Return a configuration as compiled code takes it."""
    return Trial(goals_in=np.ascontiguousarray(setup.goals_in, dtype=np.float64),
                 waypoint_radius_in=float(setup.waypoint_radius_in), gains=compiled.row_of(GainsRow, setup.gains),
                 noise=compiled.row_of(compiled.NoiseRow, setup.noise),
                 sonar=compiled.row_of(compiled.RaySonarRow, setup.sonar),
                 gate=compiled.row_of(compiled.GateRow, sonar_ray.STRICT), threshold=sonar_ray.STRICT.threshold,
                 walls=compiled.PackedWalls(setup.walls.segments, setup.walls.lines, setup.walls.middle),
                 angles_rad=np.ascontiguousarray(setup.angles_rad), ring_in=float(setup.body.sonar_ring_radius_in))
