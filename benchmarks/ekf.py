"""How fast the filter is: a step against filterpy and Stone-Soup, with ray casting, particles, and many seeds at once.

    python benchmarks/ekf.py [--json] [--rounds N] [--seeds N] [--jobs N]

Rules: all are timed in this run, turn about, on the same numbers, and must agree before they are timed. Medians; each
number that is asked for stands beside its bound. Steps are timed by the processor, whatever else the machine does, a
whole figure by the clock on the wall. Nothing here is a test.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple, TypedDict

import numpy as np
from ekf_peers import FilterPy, Linear, StoneSoup

from localization.experiments.execution import drive
from localization.experiments.figure_trial import FIGURES, Course, course_of, run
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, Floats, independent
from localization.filters.ekf import correct
from localization.filters.odometry import predict, transition
from localization.filters.particles import MonteCarlo
from localization.filters.registry import make
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar, meet, observe, rays, sight
from localization.filters.update import Observation
from worlds.io import load_world
from worlds.robots import N150

BOUNDS: Final = {
    "full_us": 150.0,
    "full_p99_us": 1000.0,
    "compiled_us": 150.0,
    "compiled_p99_us": 1000.0,
    "filterpy_ratio": 5.0,
    "stonesoup_ratio": 20.0,
    "figure_s": 60.0,
    "figure_cpu_s": 60.0,
    "particles_rays_ms": 50.0,
    "particles_cones_ms": 50.0,
}
"""What is asked for: at most; of ratios at least. Particles must keep up with 20 rings a second."""

BLOCK: Final = 20
"""Steps of one kind on end, as in a running filter."""

RINGS: Final = 5
"""Rings of the particle filters on end."""

FIGURE: Final = "5.4"
POSE: Final = (40.3, 45.7, 0.15)
STD: Final = (0.05, 0.05, 0.002)
STEP: Final = (0.05, 0.01)


class Case(NamedTuple):
    """One robot in the thesis room: what it believes, does, reads, and what is made of the reading."""

    course: Course
    belief: Belief
    step: Floats
    readings_in: Floats
    observation: Observation


class Result(TypedDict):
    """Microseconds are medians a step, `p99` beside them; `..._ratio` how many times faster than the other;
    `..._steps_per_s` filter steps a second. `bounds`: what is asked for."""

    given_h_us: float
    filterpy_us: float
    filterpy_ratio: float
    stonesoup_us: float
    stonesoup_ratio: float
    full_us: float
    full_p99_us: float
    compiled_us: float | None
    compiled_p99_us: float | None
    particles: int
    particles_rays_ms: float
    particles_cones_ms: float
    batch_seeds: int
    batch_jobs: int
    figure_s: float
    figure_cpu_s: float
    batch_steps_per_s: float
    single_steps_per_s: float
    batch_ratio: float
    bounds: dict[str, float]


def make_case() -> Case:
    """A robot that uses all sixteen beams."""
    course = course_of(FIGURES["5.4"])
    belief = independent(POSE, STD)
    step = np.array(STEP)
    predicted = predict(belief, step, course.noise)
    aimed = rays(predicted.mean[None], course.beams)
    ranges = sight(aimed, course.walls.lines[meet(aimed, course.walls)]).ranges_in
    readings = ranges + 0.1 * np.sin(np.arange(len(ranges)))
    observation = observe(predicted, course.beams, readings, course.walls, course.sonar)
    if not observation.used.all():
        raise SystemExit(f"the case is meant to use all beams, but: {observation.reasons()}")
    return Case(course, belief, step, readings, observation)


def ours_given_h(case: Case) -> Belief:
    """Predict, and correct by sixteen innovations and their Jacobian."""
    return correct(predict(case.belief, case.step, case.course.noise), case.observation)


def linear(case: Case) -> Linear:
    """The same step for others: all that is dear is given."""
    moved, by_pose, process_cov = transition(case.belief.mean, case.step, case.course.noise)
    seen = case.observation
    readings = seen.innovation + seen.jacobian @ moved
    return Linear(case.belief, moved, by_pose, process_cov, readings, seen.variance, seen.jacobian)


def ours_with_rays(case: Case) -> Belief:
    """A full step: predict, cast rays, choose beams, correct."""
    course = case.course
    predicted = predict(case.belief, case.step, course.noise)
    return correct(predicted, observe(predicted, course.beams, case.readings_in, course.walls, course.sonar))


def times_us(works: list[Callable[[], object]], rounds: int, block: int = BLOCK) -> list[list[float]]:
    """Processor microseconds of each single piece of work, by turns in blocks, the first of each block not counted."""
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(rounds):
        for work, record in zip(works, taken, strict=True):
            work()
            for _ in range(block):
                begin = time.thread_time_ns()
                work()
                record.append((time.thread_time_ns() - begin) / 1e3)
    return taken


def particle_ring(sonar: RaySonar | ConeSonar) -> Callable[[], object]:
    """A ring of sixteen readings, each of the wall ahead, for a particle filter: it moves and weighs, and resamples."""
    world = load_world("several_walls")
    belief = independent(POSE, (0.2, 0.2, 0.01))
    known = LocalizationConfig(world.walls, N150, sonar=sonar)
    particles = make("mcl", known, belief)
    course = course_of(FIGURES["5.8"])
    aimed = rays(belief.mean[None], course.beams)
    readings = np.rint(sight(aimed, course.walls.lines[meet(aimed, course.walls)]).ranges_in).tolist()

    def ring() -> None:
        for number, reading in enumerate(readings):
            sign = 1.0 if number % 2 else -1.0
            particles.move(sign * np.array(STEP))
            particles.hear(number, 0.0, reading)

    return ring


def batch_steps_per_s(seeds: int) -> float:
    """Steps a second of whole trials (figure 5.6: truth, readings, bound and filter) of that many seeds at once."""
    course = course_of(FIGURES["5.6"])
    begin = time.thread_time()
    runs = run(course, range(seeds))
    return float(runs.steps.sum()) / (time.thread_time() - begin)


def figure_s(seeds: int, jobs: int) -> tuple[float, float]:
    """Seconds that a whole figure takes with so many seeds in so many processes, their start and all: by the clock on
    the wall, and of each processor, which is what a machine with nothing else to do takes."""
    begin, before = time.perf_counter(), os.times()
    drive(FIGURES[FIGURE], range(seeds), jobs)
    spent = sum(os.times()[:4]) - sum(before[:4])
    return time.perf_counter() - begin, spent / jobs


def same(one: Belief, other: Belief) -> bool:
    """Whether two filters agree."""
    return np.allclose(one.mean, other.mean, rtol=1e-9) and np.allclose(one.cov, other.cov, rtol=1e-6)


def measure(rounds: int, seeds: int, jobs: int) -> Result:
    """Run all measurements."""
    case = make_case()
    filterpy, stonesoup = FilterPy(linear(case)), StoneSoup(linear(case))
    if not (same(ours_given_h(case), filterpy.step()) and same(ours_given_h(case), stonesoup.step())):
        raise SystemExit("the filters disagree; nothing to compare")
    ours, full = partial(ours_given_h, case), partial(ours_with_rays, case)
    works: list[Callable[[], object]] = [ours, filterpy.step, stonesoup.step, full]
    samples = times_us(works, rounds)
    given_us, filterpy_us, stonesoup_us, full_us = (statistics.median(sample) for sample in samples)
    rings = times_us([particle_ring(WIRE_SONAR), particle_ring(ConeSonar())], max(1, rounds // BLOCK), RINGS)
    rays_ms, cones_ms = (statistics.median(sample) / 1e3 for sample in rings)
    wall_s, cpu_s = figure_s(seeds, jobs)
    single, batch = batch_steps_per_s(1), batch_steps_per_s(min(seeds, 100))
    return Result(
        given_h_us=given_us,
        filterpy_us=filterpy_us,
        filterpy_ratio=filterpy_us / given_us,
        stonesoup_us=stonesoup_us,
        stonesoup_ratio=stonesoup_us / given_us,
        full_us=full_us,
        full_p99_us=float(np.quantile(samples[3], 0.99)),
        compiled_us=None,
        compiled_p99_us=None,
        particles=MonteCarlo().particles,
        particles_rays_ms=rays_ms,
        particles_cones_ms=cones_ms,
        batch_seeds=seeds,
        batch_jobs=jobs,
        figure_s=wall_s,
        figure_cpu_s=cpu_s,
        batch_steps_per_s=batch,
        single_steps_per_s=single,
        batch_ratio=batch / single,
        bounds=BOUNDS,
    )


def table(result: Result) -> str:
    """The result for people."""
    particles = f"particle filter, {result['particles']} particles, a ring of 16"
    rows: list[tuple[str, float | None, str, str]] = [
        ("a full step (16 sonars, association, gate, update), arrays", result["full_us"], "us", "full_us"),
        ("  its 99th percentile", result["full_p99_us"], "us", "full_p99_us"),
        ("  machine code (extra fast)", result["compiled_us"], "us", "compiled_us"),
        ("  its 99th percentile", result["compiled_p99_us"], "us", "compiled_p99_us"),
        ("predict and correct, 16 sonars, given h and H", result["given_h_us"], "us", ""),
        ("  filterpy, 16 scalar updates", result["filterpy_us"], "us", ""),
        ("  filterpy / ours", result["filterpy_ratio"], "times", "filterpy_ratio"),
        ("  Stone-Soup, 16 scalar updates", result["stonesoup_us"], "us", ""),
        ("  Stone-Soup / ours", result["stonesoup_ratio"], "times", "stonesoup_ratio"),
        (f"{particles} rays", result["particles_rays_ms"], "ms", "particles_rays_ms"),
        (f"{particles} cones", result["particles_cones_ms"], "ms", "particles_cones_ms"),
        (f"figure {FIGURE}, {result['batch_seeds']} seeds, {result['batch_jobs']} jobs", result["figure_s"], "s",
         "figure_s"),
        ("  of each processor", result["figure_cpu_s"], "s", "figure_cpu_s"),
        ("steps of a trial, many seeds at once", result["batch_steps_per_s"], "1/s", ""),
        ("  of one seed", result["single_steps_per_s"], "1/s", ""),
    ]  # fmt: skip
    lines = [
        f"{name:58}{value:10.1f} {unit:6}{_bound(key, value)}".rstrip() if value is not None else f"{name:58}  no numba"
        for name, value, unit, key in rows
    ]
    return "\n".join(lines)


def _bound(key: str, value: float) -> str:
    if key not in BOUNDS:
        return ""
    ratio = key.endswith("_ratio")
    kept = value >= BOUNDS[key] if ratio else value <= BOUNDS[key]
    return f"asked: {'at least' if ratio else 'at most'} {BOUNDS[key]:g}{'' if kept else ', MISSED'}"


def main() -> None:
    """Read the options, measure, print."""
    parser = argparse.ArgumentParser(description="Time the filters against filterpy and Stone-Soup and in batches.")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--rounds", type=int, default=100, metavar="N", help=f"blocks of {BLOCK} steps (default 100)")
    parser.add_argument("--seeds", type=int, default=1000, metavar="N", help="seeds of the figure (default 1000)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes for them (default 2)")
    options = parser.parse_args()
    if min(options.rounds, options.seeds, options.jobs) < 1:
        parser.error("--rounds, --seeds and --jobs must be 1 or more")
    result = measure(options.rounds, options.seeds, options.jobs)
    print(json.dumps(result) if options.json else table(result))


if __name__ == "__main__":
    main()
