"""How fast the filter is: against filterpy given the same h and H, with ray casting, and for many seeds at once.

    python benchmarks/ekf.py [--json] [--rounds N] [--seeds N]

Rules: both sides are timed in this run, turn about, on the same numbers, and must agree before they are timed. Medians;
nothing here is a test.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple, TypedDict

import numpy as np
from filterpy.kalman import KalmanFilter

from localization import ekf
from localization.belief import Belief, Floats, independent
from localization.experiments.settings import FIGURES, Course, course_of
from localization.experiments.trial import run
from localization.gating import observe
from localization.measurement import meet, rays, sight
from localization.motion import transition
from localization.observation import Observation

TARGET_RATIO: Final = 5.0
"""How many times faster than filterpy a step given h and H must be."""

BLOCK: Final = 20
"""Steps of one kind on end, as in a running filter."""

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
    """Microseconds are medians a step, `p99` beside them; `..._steps_per_s` are filter steps a second."""

    given_h_us: float
    filterpy_us: float
    given_h_ratio: float
    ratio_target: float
    with_rays_us: float
    with_rays_p99_us: float
    batch_seeds: int
    batch_steps_per_s: float
    single_steps_per_s: float
    batch_ratio: float


def make_case() -> Case:
    """A robot that uses all sixteen beams."""
    course = course_of(FIGURES["5.4"])
    belief = independent(POSE, STD)
    step = np.array(STEP)
    predicted = ekf.predict(belief, step, course.noise)
    aimed = rays(predicted.mean[None], course.beams)
    ranges = sight(aimed, course.walls.lines[meet(aimed, course.walls)]).ranges_in
    readings = ranges + 0.1 * np.sin(np.arange(len(ranges)))
    observation = observe(predicted, course.beams, readings, course.walls, course.sonar)
    if not observation.used.all():
        raise SystemExit(f"the case is meant to use all beams, but: {observation.reasons()}")
    return Case(course, belief, step, readings, observation)


def ours_given_h(case: Case) -> Belief:
    """Predict, and correct by sixteen innovations and their Jacobian."""
    return ekf.correct(ekf.predict(case.belief, case.step, case.course.noise), case.observation)


class Peer:
    """filterpy's filter, and all that it is given ready made: F, Q, the mean moved, and sixteen linear readings."""

    def __init__(self, case: Case) -> None:
        self._filter = KalmanFilter(dim_x=3, dim_z=1)
        self._belief = case.belief
        self._moved, self._by_pose, self._process_cov = transition(case.belief.mean, case.step, case.course.noise)
        seen = case.observation
        readings = seen.innovation + seen.jacobian @ self._moved
        self._updates = list(zip(readings, seen.variance, seen.jacobian[:, None, :], strict=True))

    def given_h(self) -> Belief:
        """Predict, and sixteen scalar updates of the same linearisation."""
        kalman = self._filter
        kalman.x, kalman.P = self._belief.mean, self._belief.cov
        kalman.predict(F=self._by_pose, Q=self._process_cov)
        kalman.x = self._moved
        for reading, variance, row in self._updates:
            kalman.update(reading, R=variance, H=row)
        return Belief(kalman.x, kalman.P)


def ours_with_rays(case: Case) -> Belief:
    """A full step: predict, cast rays, choose beams, correct."""
    course = case.course
    predicted = ekf.predict(case.belief, case.step, course.noise)
    return ekf.correct(predicted, observe(predicted, course.beams, case.readings_in, course.walls, course.sonar))


def times_us(works: list[Callable[[], object]], rounds: int) -> list[list[float]]:
    """Microseconds of each single piece of work, the pieces by turns in blocks, the first of each block not counted."""
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(rounds):
        for work, record in zip(works, taken, strict=True):
            work()
            for _ in range(BLOCK):
                begin = time.perf_counter_ns()
                work()
                record.append((time.perf_counter_ns() - begin) / 1e3)
    return taken


def batch_steps_per_s(seeds: int) -> float:
    """Steps a second of whole trials (figure 5.6: truth, readings, bound and filter) of that many seeds at once."""
    course = course_of(FIGURES["5.6"])
    begin = time.perf_counter()
    runs = run(course, range(seeds))
    return float(runs.steps.sum()) / (time.perf_counter() - begin)


def measure(rounds: int, seeds: int) -> Result:
    """Run all three measurements."""
    case = make_case()
    peer = Peer(case)
    theirs, ours = peer.given_h(), ours_given_h(case)
    if not (np.allclose(theirs.mean, ours.mean, rtol=1e-9) and np.allclose(theirs.cov, ours.cov, rtol=1e-6)):
        raise SystemExit("the two filters disagree; nothing to compare")
    works: list[Callable[[], object]] = [
        partial(ours_given_h, case),
        peer.given_h,
        partial(ours_with_rays, case),
    ]
    samples = times_us(works, rounds)
    given_us, peer_us, full_us = (statistics.median(sample) for sample in samples)
    single, batch = batch_steps_per_s(1), batch_steps_per_s(seeds)
    return Result(
        given_h_us=given_us,
        filterpy_us=peer_us,
        given_h_ratio=peer_us / given_us,
        ratio_target=TARGET_RATIO,
        with_rays_us=full_us,
        with_rays_p99_us=float(np.quantile(samples[2], 0.99)),
        batch_seeds=seeds,
        batch_steps_per_s=batch,
        single_steps_per_s=single,
        batch_ratio=batch / single,
    )


def table(result: Result) -> str:
    """The result for people."""
    against = result["filterpy_us"] / result["with_rays_us"]
    rows = [
        ("predict, correct, 16 sonars, given h and H", result["given_h_us"], "us", ""),
        ("  filterpy, 16 scalar updates", result["filterpy_us"], "us", f"ratio {result['given_h_ratio']:.1f}"),
        ("with ray casting and gate", result["with_rays_us"], "us", f"p99 {result['with_rays_p99_us']:.0f} us"),
        ("  filterpy without either", result["filterpy_us"], "us", f"ratio {against:.1f}"),
        (f"trial of {result['batch_seeds']} seeds at once", result["batch_steps_per_s"], "steps/s", ""),
        ("  of one seed", result["single_steps_per_s"], "steps/s", f"ratio {result['batch_ratio']:.1f}"),
    ]
    lines = [f"{name:44}{value:10.1f} {unit:8}{note}".rstrip() for name, value, unit, note in rows]
    return "\n".join([*lines, f"target: a ratio of {result['ratio_target']:g} given h and H"])


def main() -> None:
    """Read the options, measure, print."""
    parser = argparse.ArgumentParser(description="Time the extended Kalman filter against filterpy and in batches.")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--rounds", type=int, default=100, metavar="N", help=f"blocks of {BLOCK} steps (default 100)")
    parser.add_argument("--seeds", type=int, default=1000, metavar="N", help="seeds of the batch (default 1000)")
    options = parser.parse_args()
    if options.rounds < 1 or options.seeds < 1:
        parser.error("--rounds and --seeds must be 1 or more")
    result = measure(options.rounds, options.seeds)
    print(json.dumps(result) if options.json else table(result))


if __name__ == "__main__":
    main()
