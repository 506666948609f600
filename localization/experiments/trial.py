"""One figure driven by a batch of seeds at once: true robots, their sonars, their filters, step by step.

Rules: arrays with a leading dimension of seeds; no process, no file, no picture. The truth is used to move, to make
readings and to keep the bound, and never reaches the filter or the control law. Without the filter the robot is steered
by its odometry, from the true start. A robot that has reached its last goal stands still until the others have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import numpy.typing as npt

from localization.driving.control import next_step, reached
from localization.experiments import streams
from localization.experiments.consistency import bound_step, information
from localization.experiments.settings import Course
from localization.filters.belief import Belief, Floats, add, independent
from localization.filters.ekf import correct, innovation_squared
from localization.filters.odometry import move, predict, step_variance, transition
from localization.filters.sonar_ray import meet, observe, range_jacobian, rays, sight

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


def run(course: Course, seeds: Sequence[int], tick: Callable[[int], None] = lambda _: None) -> Runs:
    """Drive the course once with each seed; after each step `tick` is told how many robots took it."""
    batch = _start(course, seeds)
    history: list[Batch] = []
    steps = np.zeros(len(seeds), dtype=np.intp)
    chance = streams.step_errors(seeds, len(course.beams.directions))
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


def _start(course: Course, seeds: Sequence[int]) -> Batch:
    """All robots at the start; each filter a little off, as its covariance says; without the filter exactly there."""
    count = len(seeds)
    truth = np.tile(course.start, (count, 1))
    std = np.array(course.start_std) if course.filtered else np.zeros(3)
    belief = independent(add(truth, std * streams.start_errors(seeds)), std)
    nothing = np.zeros(count, dtype=np.intp)
    return Batch(truth, belief, belief.cov, nothing, np.zeros(count), nothing)


def _advance(course: Course, batch: Batch, motion_error: Floats, sonar_error: Floats) -> Batch:
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
        _, by_pose, process_cov = transition(batch.truth, step, course.noise)
        bound = bound_step(bound, by_pose, process_cov, gain)
    arrived = driving & reached(belief.mean, goals, course.waypoint_radius_in)
    return Batch(truth, belief, bound, batch.leg + arrived, nis, used)


def _sound(course: Course, truth: Floats, sonar_error: Floats) -> tuple[Floats, Floats]:
    """The readings (n, 16) the sonars make at the truth (n, 3), and what a perfect filter could gain from all beams
    that meet a wall: information (n, 3, 3)."""
    aimed = rays(truth[:, None, :], course.beams)
    met = meet(aimed, course.walls)
    lines = course.walls.lines[met]
    seen = sight(aimed, lines)
    variance = course.sonar.variance(seen.ranges_in)
    telling = np.where((met >= 0)[..., None], range_jacobian(seen, lines), 0.0)
    gain = information(telling, np.where(met >= 0, variance, 1.0))
    return seen.ranges_in + np.sqrt(variance) * sonar_error, gain


def _correct(course: Course, belief: Belief, readings_in: Floats) -> tuple[Belief, Floats, Indices]:
    """Beliefs corrected by readings (n, 16): the beliefs, the NIS (n,) of the correction and the beams used (n,)."""
    observation = observe(belief, course.beams, readings_in, course.walls, course.sonar)
    corrected = correct(belief, observation)
    nis = innovation_squared(belief, corrected, observation)
    return corrected, nis, observation.used.sum(axis=-1)
