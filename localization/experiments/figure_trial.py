"""What each figure of the thesis is run with. Data, and the one function that lays a figure out in its world.

Rules: numbers only, each with its source; nothing is computed from results, and no noise is tuned to reach one. What
the text leaves open (noise, start, way-point radius) is fixed here once for all figures.

The chance of the experiments: for every seed its own streams, one a purpose.

Rules: a number depends on its seed, its purpose and its place in the stream and on nothing else; so neither the size of
a batch nor the number of processes changes a result, and two figures with the same seed meet the same noise
(common random numbers): step k of seed s strays by the same standard normals in both.

Whether a filter is as good as it says: NEES, the band it must keep, and the bound no filter can beat.

Rules: pure functions on arrays; knows errors, covariances and Jacobians, not the runs they come from.
NIS needs no truth and is the filter's own: ekf.update_ring.

One figure driven by a batch of seeds at once: true robots, their sonars, their filters, step by step.

Rules: arrays with a leading dimension of seeds; no process, no file, no picture. The truth is used to move, to make
readings and to keep the bound, and never reaches the filter or the control law. Without the filter the robot is steered
by its odometry, from the true start. A robot that has reached its last goal stands still until the others have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.filters.base import THESIS_ODOMETRY
from localization.filters.belief import Belief, Floats, add, chi_square_quantile, independent
from localization.filters.ekf import update_ring
from localization.filters.odometry import (
    OdometryNoise,
    move,
    predict,
    process_covariance,
    step_jacobians,
    step_variance,
)
from localization.filters.sonar_ray import (
    IDEAL_SONAR,
    RaySonar,
    SonarRing,
    WallMap,
    observe_ring,
    ranges_from,
    wall_map,
)
from localization.navigation.control_law import ControlGains, is_reached, next_step
from worlds.io import load_world
from worlds.raycast import NO_WALL
from worlds.robots import N150

WAYPOINT_RADIUS_IN: Final = 0.25
"""A way-point counts as reached when the estimate is this near to it."""

START_STD: Final = (0.1, 0.1, 0.01)
"""What the filter starts with: in, in, rad; its first estimate is drawn from that."""

NOISE: Final = THESIS_ODOMETRY
"""How the true motion strays; the filter knows these numbers."""

PATIENCE: Final = 3
"""A run longer than this many times the way it had to go, at full steps, is lost and ends."""

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


FIGURES: Final[Mapping[str, Figure]] = MappingProxyType(
    {
        figure.name: figure
        for figure in (
            Figure("5.2", "Without the filter", "thesis_room", "5.3", filtered=False),
            Figure("5.4", "With the filter", "thesis_room", "5.5", steps_thesis=1199),
            Figure("5.6", "Badly chosen limits", "thesis_room", "5.7", gains=_BADLY_CHOSEN, steps_thesis=150),
            Figure("5.8", "Guided path between several walls", "several_walls"),
            Figure("5.9", "Guided path around a vertex", "centre_vertex"),
        )
    }
)


@dataclass(frozen=True, slots=True)
class FigureSetup:
    """All that a trial needs: where the robot starts (3,), where it must go (k, 2), what it sees, and how it errs."""

    start: Floats
    goals_in: Floats
    walls: WallMap
    body: SonarRing
    gains: ControlGains
    filtered: bool = True
    start_std: tuple[float, float, float] = START_STD
    noise: OdometryNoise = NOISE
    sonar: RaySonar = IDEAL_SONAR
    waypoint_radius_in: float = WAYPOINT_RADIUS_IN

    @property
    def angles_rad(self) -> Floats:
        """Angle of each sonar from the heading, (n,): the turret turns with the steering."""
        return np.asarray(self.body.sonar_angles_rad, dtype=np.float64)

    @property
    def length_in(self) -> float:
        """The length of the polyline from the start through all goals."""
        corners = np.vstack([self.start[:2], self.goals_in])
        return float(np.hypot(*np.diff(corners, axis=0).T).sum())

    @property
    def least_steps(self) -> int:
        """How many whole steps of full length the way takes at least."""
        return math.floor(self.length_in / self.gains.drho_max_in)

    @property
    def most_steps(self) -> int:
        """The length at which a run is given up."""
        return PATIENCE * self.least_steps + 1


def figure_setup(figure: Figure) -> FigureSetup:
    """The figure laid out in its world: the N150's ring, its turret turning with the steering as in the thesis."""
    world = load_world(figure.world)
    path = world.paths[figure.name]
    return FigureSetup(
        start=np.array([path.start.x_in, path.start.y_in, path.start.steering_rad]),
        goals_in=np.array(path.goals_in, dtype=np.float64),
        walls=wall_map(world.walls),
        body=N150,
        gains=figure.gains,
        filtered=figure.filtered,
    )


_START, _MOTION, _SONAR = range(3)

_BLOCK: Final = 128
"""Steps drawn at once: a call a step and seed would cost more than the filter."""


def draw_start_errors(seeds: Sequence[int]) -> Floats:
    """Standard normals (seeds, 3) for the error of the first estimate."""
    return np.stack([_generator(seed, _START).standard_normal(3) for seed in seeds])


def draw_step_errors(seeds: Sequence[int], beams: int) -> Iterator[tuple[Floats, Floats]]:
    """For each step, without end: standard normals (seeds, 2) for the motion and (seeds, beams) for the sonars."""
    motion = [_generator(seed, _MOTION) for seed in seeds]
    sonar = [_generator(seed, _SONAR) for seed in seeds]
    while True:
        moves = np.stack([rng.standard_normal((_BLOCK, 2)) for rng in motion], axis=1)
        sounds = np.stack([rng.standard_normal((_BLOCK, beams)) for rng in sonar], axis=1)
        yield from zip(moves, sounds, strict=True)


def _generator(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose,)))


def nees(error: Floats, cov: Floats) -> Floats:
    """Normalised estimation error squared (...): error' cov^-1 error of errors (..., n) and covariances (..., n, n).

    Chi-square of n degrees of freedom where the covariance is honest, so n on average. Raises LinAlgError where a
    covariance is singular.
    """
    value: Floats = (error * np.linalg.solve(cov, error[..., None])[..., 0]).sum(axis=-1)
    return value


def mean_band(dof: int, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Where the mean of `runs` independent chi-squares of `dof` lies with that probability, symmetric in its tails."""
    tail = 0.5 * (1.0 - probability)
    low, high = (chi_square_quantile(p, dof * runs) / runs for p in (tail, 1.0 - tail))
    return low, high


def information(jacobian: Floats, variance: Floats) -> Floats:
    """What n readings of `variance` (..., n) tell of m coordinates: H' R^-1 H, (..., m, m), of H (..., n, m)."""
    by_state: Floats = np.swapaxes(jacobian / variance[..., None], -1, -2) @ jacobian
    return by_state


def bound_step(cov: Floats, by_state: Floats, process_cov: Floats, gained: Floats) -> Floats:
    """One step of the posterior Cramer-Rao bound (Tichavsky, Muravchik, Nehorai 1998), all arrays (..., n, n).

    Their recursion of the information J, J' = D22 - D21 (J + D11)^-1 D12, needs Q^-1; here Q has rank 2. With the
    matrix inversion lemma it is the same as, for C = J^-1,

        C- = F C F' + Q        C' = (C-^-1 + gained)^-1 = (I + C- gained)^-1 C-

    which needs no inverse of Q. F, Q and `gained` (see `information`) are taken along the true path.
    """
    prior = by_state @ cov @ np.swapaxes(by_state, -1, -2) + process_cov
    bound = np.asarray(np.linalg.solve(np.eye(cov.shape[-1]) + prior @ gained, prior), dtype=np.float64)
    halves: Floats = 0.5 * (bound + np.swapaxes(bound, -1, -2))
    return halves


Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch of n robots after a step: `truth` (n, 3), what each filter believes, the `bound` (n, 3, 3) on its
    covariance, the goal each drives to (`leg`, (n,), as many as there are goals when all are reached), and the NIS
    (n,) of its last correction with the number of beams `used` (n,)."""

    truth: Floats
    belief: Belief
    bound: Floats
    leg: Indices
    nis: Floats
    used: Indices


@dataclass(frozen=True, slots=True)
class Runs:
    """What a batch of n seeds did in at most T steps; row k is after step k + 1, and means nothing where k + 1 is more
    than the steps of that robot.

    `steps` (n,), `reached` (n,) whether every goal was; `truth` and `mean` (T, n, 3); `cov` and `bound` (T, n, 3, 3);
    `nis` and `used` (T, n).
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


def run(course: FigureSetup, seeds: Sequence[int], tick: Callable[[int], None] = lambda _: None) -> Runs:
    """Drive the course once with each seed; after each step `tick` is told how many robots took it."""
    batch = _start(course, seeds)
    history: list[Batch] = []
    steps = np.zeros(len(seeds), dtype=np.intp)
    chance = draw_step_errors(seeds, len(course.body.sonar_angles_rad))
    for motion_error, sonar_error in islice(chance, course.most_steps):
        driving = batch.leg < len(course.goals_in)
        if not driving.any():
            break
        batch = _advance(course, batch, motion_error, sonar_error)
        history.append(batch)
        steps += driving
        tick(int(driving.sum()))
    return Runs(
        tuple(seeds),
        steps,
        batch.leg == len(course.goals_in),
        np.stack([past.truth for past in history]),
        np.stack([past.belief.mean for past in history]),
        np.stack([past.belief.cov for past in history]),
        np.stack([past.bound for past in history]),
        np.stack([past.nis for past in history]),
        np.stack([past.used for past in history]),
    )


def _start(course: FigureSetup, seeds: Sequence[int]) -> Batch:
    """All robots at the start; each filter a little off, as its covariance says; without the filter exactly there."""
    count = len(seeds)
    truth = np.tile(course.start, (count, 1))
    std = np.array(course.start_std) if course.filtered else np.zeros(3)
    belief = independent(add(truth, std * draw_start_errors(seeds)), std)
    nothing = np.zeros(count, dtype=np.intp)
    return Batch(truth, belief, belief.cov, nothing, np.zeros(count), nothing)


def _advance(course: FigureSetup, batch: Batch, motion_error: Floats, sonar_error: Floats) -> Batch:
    """One step of all robots: command, move, predict, and with the filter look and correct."""
    driving = batch.leg < len(course.goals_in)
    goals = course.goals_in[np.minimum(batch.leg, len(course.goals_in) - 1)]
    step = next_step(batch.belief.mean, goals, course.gains) * driving[:, None]
    truth = move(batch.truth, step + np.sqrt(step_variance(step, course.noise)) * motion_error)
    belief = predict(batch.belief, step, course.noise)
    bound, nis, used = batch.bound, batch.nis, batch.used
    if course.filtered:
        readings, gain = _sound(course, truth, sonar_error)
        belief, nis, used = _correct(course, belief, readings)
        F, G = step_jacobians(batch.truth, step)
        bound = bound_step(bound, F, process_covariance(G, step, course.noise), gain)
    arrived = driving & is_reached(belief.mean, goals, course.waypoint_radius_in)
    return Batch(truth, belief, bound, batch.leg + arrived, nis, used)


def _sound(course: FigureSetup, truth: Floats, sonar_error: Floats) -> tuple[Floats, Floats]:
    """The readings (n, 16) the sonars make at the truth (n, 3), and what a perfect filter could gain from all beams
    that meet a wall: information (n, 3, 3)."""
    expected = ranges_from(truth, course.angles_rad, course.body, course.walls)
    seen = expected.row != NO_WALL
    variance = course.sonar.variance(expected.range_in)
    H = np.where(seen[..., None], np.stack(expected.H, axis=-1), 0.0)
    gain = information(H, np.where(seen, variance, 1.0))
    return expected.range_in + np.sqrt(variance) * sonar_error, gain


def _correct(course: FigureSetup, belief: Belief, readings_in: Floats) -> tuple[Belief, Floats, Indices]:
    """Beliefs corrected by readings (n, 16): the beliefs, the NIS (n,) of the correction and the beams used (n,)."""
    observation = observe_ring(belief, course.angles_rad, readings_in, course.body, course.walls, course.sonar)
    corrected, nis = update_ring(belief, observation)
    return corrected, nis, observation.used.sum(axis=-1)
