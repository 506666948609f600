"""Time of the live filter: `Localizer.update` with new echoes, against scalar updates of filterpy and Stone-Soup.

    python benchmarks/ekf.py [--json] [--rounds N] [--seeds N] [--jobs N]

A state with 16 new echoes, or with one: pose history, prediction, ray casting, association, gate and Kalman update of
each, as `nomad localize` runs them. The others do 16 scalar updates, given H, R and the predicted mean. All are timed
in this run by turns, by the processor time of the thread, and must agree before they are timed. The live filter is
timed in plain Python and, where numba is installed, compiled, as it is by default. Then particle filters, and a
whole figure of the thesis by the clock on the wall.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Iterator
from math import nan
from typing import Final, NamedTuple, TypedDict

import numpy as np

from localization.experiments.execution import drive
from localization.experiments.figure_trial import FIGURES, figure_setup, run
from localization.filters import compiled
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, Floats, independent
from localization.filters.ekf import update_ring
from localization.filters.odometry import OdometryNoise, predict, process_covariance, step_jacobians
from localization.filters.particles import PARTICLES
from localization.filters.registry import make
from localization.filters.sonar_cone import ConeSonar, expected_echoes, reflectors
from localization.filters.sonar_ray import IDEAL_SONAR, WIRE_SONAR, RaySonar, observe_ring, ranges_from, wall_map
from localization.filters.update import Refusal
from localization.live.localizer import Localizer
from localization.live.sensor_input import FiringSchedule, SensorData
from worlds.compiled import VARIABLE
from worlds.io import load_world
from worlds.rings import SonarMount
from worlds.robots import N150

BOUNDS: Final = {
    "filterpy_ratio": 1.0,
    "one_echo_ratio": 10.0,
    "cones_ratio": 0.67,
    "compiled_ratio": 4.0,
    "figure_s": 60.0,
    "figure_cpu_s": 60.0,
    "particles_rays_ms": 50.0,
    "particles_cones_ms": 50.0,
}
"""Required: times at most, ratios at least. Particles must keep up with 20 rings a second."""

BLOCK: Final = 20
"""Consecutive steps of one kind, as in a running filter."""

RINGS: Final = 5
"""Consecutive rings of the particle filters."""

FIGURE: Final = "5.4"
WORLD: Final = "thesis_room"
POSE: Final = (40.3, 45.7, 0.15)
# Standard deviations of a filter that has converged.
STD: Final = (0.05, 0.05, 0.002)
# Small steps, as between two echoes 60 ms apart: 0.05 in and 0.01 rad.
STEP: Final = (0.05, 0.01)
SPEED_IN_S: Final = 0.5
NOTHING_IN: Final = 255.0


class Result(TypedDict):
    """Microseconds are medians for a state; `p99` is the 99th percentile.

    `rays_16`: a state with 16 new echoes of exact rays, `cones_1`: with one of a real ring; `compiled_...`: by numba,
    NaN without it. `filterpy_ratio`, `stonesoup_ratio`: how many times as long the other takes as `rays_16`;
    `one_echo_ratio`, `cones_ratio`, `compiled_ratio`: filterpy as `rays_1`, `cones_16`, `compiled_rays_16`. `bounds`:
    what is required.
    """

    rays_16_us: float
    rays_16_p99_us: float
    rays_1_us: float
    rays_1_p99_us: float
    cones_16_us: float
    cones_16_p99_us: float
    cones_1_us: float
    cones_1_p99_us: float
    compiled_rays_16_us: float
    compiled_rays_1_us: float
    compiled_cones_16_us: float
    compiled_cones_1_us: float
    used_rays: float
    used_cones: float
    filterpy_us: float
    filterpy_ratio: float
    one_echo_ratio: float
    cones_ratio: float
    compiled_ratio: float
    stonesoup_us: float
    stonesoup_ratio: float
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


# The live filter.


class Live:
    """A localizer on a robot that drives to and fro, polled so that each state has `echoes` new echoes."""

    def __init__(self, sonar: RaySonar | ConeSonar, echoes: int) -> None:
        self._walls = wall_map(load_world(WORLD).walls)
        config = LocalizationConfig(self._walls.segments, N150, sonar=sonar)
        schedule = FiringSchedule(0.0)
        # One update per period: `echoes` firings of 60 ms.
        self._sonar, self._period_s = sonar, echoes * schedule.interval_s
        self._localizer = Localizer(config, independent(POSE, (0.2, 0.2, 0.01)), schedule)
        self._around = reflectors(self._walls.segments)
        # The first state only initialises the schedule.
        self._states = self._drive()
        self._last = self._localizer.update(next(self._states))
        self.echoes = self.used = 0

    def next_state(self) -> SensorData:
        """Return the next state; made outside of the measurement."""
        return next(self._states)

    def update(self, state: SensorData) -> None:
        """Do the work that is measured, and count."""
        self._last = self._localizer.update(state)

    def count(self) -> None:
        """Count the echoes of the last update and those used."""
        self.echoes += len(self._last.echoes)
        self.used += sum(echo.refusal is Refusal.NONE for echo in self._last.echoes)

    def _drive(self) -> Iterator[SensorData]:
        """Yield states: 200 forwards, 200 backwards, and so on; readings are those at the pose of the state."""
        clock_s, along_in, number = 1.0, 0.0, 0
        while True:
            pose = np.array(POSE) + along_in * np.array([np.cos(POSE[2]), np.sin(POSE[2]), 0.0])
            yield SensorData(clock_s, along_in, 0.0, 0.0, 0.0, self._readings(pose))
            clock_s += self._period_s
            along_in += SPEED_IN_S * self._period_s * (1.0 if number // 20 % 2 == 0 else -1.0)
            number += 1

    def _readings(self, pose: Floats) -> tuple[float, ...]:
        """Return whole inches: along rays, or the most probable echo of a cone, 255 for none."""
        # Readings of the true pose; noise would make refusals depend on the seed.
        angles = np.array(N150.sonar_angles_rad)
        if isinstance(self._sonar, RaySonar):
            return tuple(np.rint(ranges_from(pose, angles, N150, self._walls).range_in).tolist())
        readings = []
        for angle in angles.tolist():
            mount = SonarMount(angle, N150.sonar_ring_radius_in)
            # A blur of 0.01 rad, like the heading of the belief.
            echoes = expected_echoes(pose, np.array(0.01), mount, self._around, self._sonar)
            best = int(echoes.probability.argmax())
            readings.append(float(np.rint(echoes.ranges_in[best])) if echoes.probability[best] > 0.5 else NOTHING_IN)
        return tuple(readings)


def live_us(live: Live, count: int) -> list[float]:
    """Return the processor microseconds of so many updates, one after another; the first is not counted."""
    taken = []
    # CPU time of this thread: other processes do not count.
    # All states are made before the first one is timed.
    for number, state in enumerate([live.next_state() for _ in range(count + 1)]):
        begin = time.thread_time_ns()
        live.update(state)
        if number:
            taken.append((time.thread_time_ns() - begin) / 1e3)
            live.count()
    return taken


# The peers.


class Linear(NamedTuple):
    """A linear step: the belief before it, the predicted mean, F, Q; n readings z of variance R (n,) by H (n, 3)."""

    before: Belief
    predicted: Floats
    F: Floats
    Q: Floats
    z: Floats
    R: Floats
    H: Floats


class Case(NamedTuple):
    """A linear step, and the belief after it."""

    given: Linear
    after: Belief


def make_case() -> Case:
    """Return the step of a robot in the thesis room that uses all sixteen beams."""
    walls, angles, step = wall_map(load_world(WORLD).walls), np.array(N150.sonar_angles_rad), np.array(STEP)
    before, noise = independent(POSE, STD), OdometryNoise()
    # The prediction, then readings off by a sine of 0.1 in, so that all innovations differ.
    predicted = predict(before, step, noise)
    ranges = ranges_from(predicted.mean, angles, N150, walls).range_in
    readings = ranges + 0.1 * np.sin(np.arange(len(ranges)))
    seen = observe_ring(predicted, angles, readings, N150, walls, IDEAL_SONAR)
    # A refused beam would make the peers do more work than the product.
    if not seen.used.all():
        raise SystemExit(f"the case is meant to use all beams, but: {seen.reasons()}")
    F, G = step_jacobians(before.mean, step)
    # The peers get z, F, H, Q and R ready: only their arithmetic is timed.
    z = seen.innovation + seen.H @ predicted.mean
    given = Linear(before, predicted.mean, F, process_covariance(G, step, noise), z, seen.R, seen.H)
    return Case(given, update_ring(predicted, seen)[0])


def is_same(one: Belief, other: Belief) -> bool:
    """Return True if two filters agree."""
    # To rounding; the peers compute the covariance by other formulas, which round more.
    return np.allclose(one.mean, other.mean, rtol=1e-9) and np.allclose(one.cov, other.cov, rtol=1e-6)


def times_us(works: list[Callable[[], object]], rounds: int, block: int = BLOCK) -> list[list[float]]:
    """Return processor microseconds of each piece of work, by turns in blocks; the first of a block is not counted."""
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(rounds):
        for work, record in zip(works, taken, strict=True):
            # Once without timing: caches.
            work()
            for _ in range(block):
                begin = time.thread_time_ns()
                work()
                record.append((time.thread_time_ns() - begin) / 1e3)
    return taken


# Particles and batches.


def particle_ring(sonar: RaySonar | ConeSonar) -> Callable[[], object]:
    """Return a ring of sixteen readings of the wall ahead for a particle filter, which may resample."""
    world = load_world("several_walls")
    belief = independent(POSE, (0.2, 0.2, 0.01))
    particles = make("mcl", LocalizationConfig(world.walls, N150, sonar=sonar), belief)
    ranges = ranges_from(belief.mean, np.array(N150.sonar_angles_rad), N150, wall_map(world.walls)).range_in
    readings = np.rint(ranges).tolist()

    def ring() -> None:
        for number, reading in enumerate(readings):
            # Back and forth: the cloud stays in the room.
            sign = 1.0 if number % 2 else -1.0
            particles.predict(sign * STEP[0], sign * STEP[1])
            particles.update(number, 0.0, reading)

    return ring


def batch_steps_per_s(seeds: int) -> float:
    """Return steps a second of whole trials (figure 5.6: truth, readings, bound, filter) of so many seeds at once."""
    course = figure_setup(FIGURES["5.6"])
    begin = time.thread_time()
    # Processor time of this thread, as for single updates.
    runs = run(course, range(seeds))
    return float(runs.steps.sum()) / (time.thread_time() - begin)


def figure_s(seeds: int, jobs: int) -> tuple[float, float]:
    """Return the seconds of a whole figure: by the clock on the wall, with the start of its processes, and of each."""
    begin, before = time.perf_counter(), os.times()
    drive(FIGURES[FIGURE], range(seeds), jobs)
    # User and system time of this process and its children, in all processes together.
    spent = sum(os.times()[:4]) - sum(before[:4])
    return time.perf_counter() - begin, spent / jobs


def measure(rounds: int, seeds: int, jobs: int, *, plain: bool = False) -> Result:
    """Run all measurements; with `plain` without those of the compiled filter."""
    from ekf_peers import FilterPy, StoneSoup  # not for --help: they take seconds to import

    case = make_case()
    filterpy, stonesoup = FilterPy(case.given), StoneSoup(case.given)
    # Results must agree before times are compared.
    if not (is_same(case.after, filterpy.step()) and is_same(case.after, stonesoup.step())):
        raise SystemExit("the filters disagree; nothing to compare")
    # Both sonar models, with 16 new echoes per state and with one.
    kinds = [(sonar, echoes) for sonar in (WIRE_SONAR, ConeSonar()) for echoes in (16, 1)]
    os.environ[VARIABLE] = "never"
    lives = [Live(sonar, echoes) for sonar, echoes in kinds]
    if not plain and compiled.load():
        os.environ[VARIABLE] = "always"
        lives += [Live(sonar, echoes) for sonar, echoes in kinds]
    live_samples: list[list[float]] = [[] for _ in lives]
    peers: list[list[float]] = [[], []]
    # By turns in blocks, as the speed of the processor changes over seconds.
    for _ in range(rounds):
        for live, samples in zip(lives, live_samples, strict=True):
            samples.extend(live_us(live, BLOCK))
        for samples, more in zip(peers, times_us([filterpy.step, stonesoup.step], 1), strict=True):
            samples.extend(more)
    # Without numba the compiled rows are NaN.
    live_samples += [[nan]] * (2 * len(kinds) - len(live_samples))
    rays_16, rays_1, cones_16, cones_1, *fast = (
        (statistics.median(samples), float(np.quantile(samples, 0.99))) for samples in live_samples
    )
    filterpy_us, stonesoup_us = (statistics.median(samples) for samples in peers)
    # A ring of the particle filter takes milliseconds: fewer rounds.
    rings = times_us([particle_ring(WIRE_SONAR), particle_ring(ConeSonar())], max(1, rounds // BLOCK), RINGS)
    rays_ms, cones_ms = (statistics.median(sample) / 1e3 for sample in rings)
    wall_s, cpu_s = figure_s(seeds, jobs)
    # One seed, and a batch of at most 100.
    single, batch = batch_steps_per_s(1), batch_steps_per_s(min(seeds, 100))
    return Result(
        rays_16_us=rays_16[0],
        rays_16_p99_us=rays_16[1],
        rays_1_us=rays_1[0],
        rays_1_p99_us=rays_1[1],
        cones_16_us=cones_16[0],
        cones_16_p99_us=cones_16[1],
        cones_1_us=cones_1[0],
        cones_1_p99_us=cones_1[1],
        compiled_rays_16_us=fast[0][0],
        compiled_rays_1_us=fast[1][0],
        compiled_cones_16_us=fast[2][0],
        compiled_cones_1_us=fast[3][0],
        used_rays=lives[0].used / lives[0].echoes,
        used_cones=lives[2].used / lives[2].echoes,
        filterpy_us=filterpy_us,
        filterpy_ratio=filterpy_us / rays_16[0],
        one_echo_ratio=filterpy_us / rays_1[0],
        cones_ratio=filterpy_us / cones_16[0],
        compiled_ratio=filterpy_us / fast[0][0],
        stonesoup_us=stonesoup_us,
        stonesoup_ratio=stonesoup_us / rays_16[0],
        particles=PARTICLES,
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
    """Return the result as a table."""
    particles = f"particle filter, {result['particles']} particles, a ring of 16"
    rows: list[tuple[str, float, str, str]] = [
        ("Localizer.update, 16 new echoes, rays", result["rays_16_us"], "us", ""),
        ("  99th percentile", result["rays_16_p99_us"], "us", ""),
        ("  one new echo", result["rays_1_us"], "us", ""),
        ("  99th percentile", result["rays_1_p99_us"], "us", ""),
        ("Localizer.update, 16 new echoes, cones", result["cones_16_us"], "us", ""),
        ("  99th percentile", result["cones_16_p99_us"], "us", ""),
        ("  one new echo", result["cones_1_us"], "us", ""),
        ("  99th percentile", result["cones_1_p99_us"], "us", ""),
        ("compiled, 16 new echoes, rays", result["compiled_rays_16_us"], "us", ""),
        ("  one new echo", result["compiled_rays_1_us"], "us", ""),
        ("compiled, 16 new echoes, cones", result["compiled_cones_16_us"], "us", ""),
        ("  one new echo", result["compiled_cones_1_us"], "us", ""),
        ("filterpy, 16 scalar updates", result["filterpy_us"], "us", ""),
        ("  / Localizer.update, 16 echoes, rays", result["filterpy_ratio"], "times", "filterpy_ratio"),
        ("  / one echo, rays", result["one_echo_ratio"], "times", "one_echo_ratio"),
        ("  / 16 echoes, cones", result["cones_ratio"], "times", "cones_ratio"),
        ("  / compiled, 16 echoes, rays", result["compiled_ratio"], "times", "compiled_ratio"),
        ("Stone-Soup, 16 scalar updates", result["stonesoup_us"], "us", ""),
        ("  / Localizer.update, 16 echoes, rays", result["stonesoup_ratio"], "times", ""),
        (f"{particles} rays", result["particles_rays_ms"], "ms", "particles_rays_ms"),
        (f"{particles} cones", result["particles_cones_ms"], "ms", "particles_cones_ms"),
        (f"figure {FIGURE}, {result['batch_seeds']} seeds, {result['batch_jobs']} jobs", result["figure_s"], "s",
         "figure_s"),
        ("  of each processor", result["figure_cpu_s"], "s", "figure_cpu_s"),
        ("steps of a trial, many seeds at once", result["batch_steps_per_s"], "1/s", ""),
        ("  of one seed", result["single_steps_per_s"], "1/s", ""),
    ]  # fmt: skip
    return "\n".join(
        f"{name:58}{value:10.1f} {unit:6}{_bound(key, value)}".rstrip() for name, value, unit, key in rows
    )


def _bound(key: str, value: float) -> str:
    if key not in BOUNDS:
        return ""
    # Ratios have a minimum, times a maximum.
    ratio = key.endswith("_ratio")
    met = value >= BOUNDS[key] if ratio else value <= BOUNDS[key]
    return f"required: {'at least' if ratio else 'at most'} {BOUNDS[key]:g}{'' if met else ', MISSED'}"


def main() -> None:
    """Read the options, measure, print."""
    parser = argparse.ArgumentParser(description="Time the live filter against filterpy and Stone-Soup, and batches.")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    parser.add_argument("--rounds", type=int, default=100, metavar="N", help=f"blocks of {BLOCK} states (default 100)")
    parser.add_argument("--seeds", type=int, default=1000, metavar="N", help="seeds of the figure (default 1000)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes for them (default 2)")
    parser.add_argument("--plain", action="store_true", help="leave out the compiled filter (a minute)")
    options = parser.parse_args()
    if min(options.rounds, options.seeds, options.jobs) < 1:
        parser.error("--rounds, --seeds and --jobs must be 1 or more")
    result = measure(options.rounds, options.seeds, options.jobs, plain=options.plain)
    print(json.dumps(result) if options.json else table(result))


if __name__ == "__main__":
    main()
