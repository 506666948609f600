"""Speed of the batch simulation: 10,000 robots on all cores, and one robot of the single simulation in the same run.

    python benchmarks/batch.py [--robots N] [--steps N] [--rounds N] [--setup NAME] [--threads N] [--json]

Every robot drives between the 50 walls of the benchmark's room, each from another start, and its 16 sonars are read
after every step of 0.1 s. The ring is measured twice: at its usual rate, 1.7 firings per step, and with every sonar
firing anew in each step, 25 firings. Robot-steps per second are by the clock, which other processes on the machine
slow down; `cpu` is processor time of all threads.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from functools import partial
from math import tau
from time import perf_counter, process_time
from typing import Final

import numpy as np
from scenes import FREE_IN, HALF_IN, WALLS, room

from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nserver_emu.simulation.batch import BatchSimulation
from nserver_emu.simulation.models import N150
from nserver_emu.simulation.noise import SETUPS
from nserver_emu.simulation.simulation import Simulation
from worlds.geometry import FloatArray
from worlds.world import StartPose, World

Result = dict[str, float | int | str]

DT_S: Final = 0.1
# Rare commands, so that setting velocities takes a small part of the time.
TURN_EVERY: Final = 20
"""Steps between two commands."""
FASTEST_RATE: Final = 1
"""A firing every 4 ms: 25 in a step."""
SINGLE_STEPS: Final = 200
TARGET_STEPS_PER_S: Final = 300_000
"""Required robot-steps per second on two cores."""
TARGET_BYTES: Final = 4096
"""Most memory of a robot."""


def starts(robots: int, world: World) -> FloatArray:
    """Return free poses (n, 4) in the room of the benchmark."""
    rng = np.random.default_rng(7)
    found = np.empty((0, 4))
    # Rejected poses are drawn again, until there are enough.
    while len(found) < robots:
        half_in = HALF_IN - N150.body.radius_in - 1.0
        low, high = (-half_in, -half_in, 0.0, 0.0), (half_in, half_in, tau, tau)
        tried = rng.uniform(low, high, (2 * robots, 4))
        # A 30 in wall reaches 15 in from its middle.
        middles = 0.5 * (world.inner_walls[:, :2] + world.inner_walls[:, 2:])
        nearest_in = np.hypot(*(tried[:, None, :2] - middles).T).min(axis=0)
        found = np.concatenate((found, tried[nearest_in > 16.0 + N150.body.radius_in]))
    return found[:robots]


def velocities(robots: int, step: int) -> FloatArray:
    """Return the velocities (3, n) that are commanded at a step: arcs forward and back."""
    # A generator for each step: all sizes of a batch have the same commands.
    rng = np.random.default_rng(step)
    low, high = np.array([[-12.0], [-0.5], [-0.3]]), np.array([[18.0], [0.5], [0.3]])
    found: FloatArray = low + (high - low) * rng.random((3, robots))
    return found


def drive_batch(batch: BatchSimulation, steps: int) -> None:
    for step in range(steps):
        if step % TURN_EVERY == 0:
            batch.set_velocities(*velocities(len(batch), step))
        batch.step(DT_S)
        # Reading the ranges is part of the step: sonars that are not read are not computed.
        assert batch.ranges_in.shape == (len(batch), 16)


def drive_single(simulation: Simulation, steps: int) -> None:
    robot = simulation.robots[1]
    for step in range(steps):
        if step % TURN_EVERY == 0:
            robot.set_velocities(*velocities(1, step)[:, 0].tolist())
        simulation.step(DT_S)
        assert len(robot.sonar.readings_in) == 16


def best(works: Sequence[Callable[[], object]], rounds: int) -> list[tuple[float, float]]:
    """Return the shortest time by the clock and of the processor of each function, called alternately."""
    shortest = [(float("inf"), float("inf"))] * len(works)
    for _ in range(rounds):
        for number, work in enumerate(works):
            # By turns: a slower clock of the processor affects both.
            wall, cpu = perf_counter(), process_time()
            work()
            wall_s, cpu_s = perf_counter() - wall, process_time() - cpu
            shortest[number] = min(shortest[number][0], wall_s), min(shortest[number][1], cpu_s)
    return shortest


def measure(robots: int, steps: int, rounds: int, setup: str, threads: int | None) -> dict[str, Result]:
    """Return all measurements by name."""
    world = room(HALF_IN, WALLS, np.zeros((1, 2)), FREE_IN)
    places = starts(robots, world)
    found: dict[str, Result] = {}
    for name, rate in (("ring at its usual rate", DEFAULT_SONAR_RATE), ("all sonars in every step", FASTEST_RATE)):
        # Same world, same start and same commands; only the single simulation is limited to one robot and one core.
        batch = BatchSimulation(world, robots, starts=places, setup=SETUPS[setup], seed=1, threads=threads)
        single = Simulation(world, seed=1)
        single.add_robot(1, StartPose(*places[0].tolist()), setup=SETUPS[setup])
        batch.configure_sonars(rate, DEFAULT_SONAR_ORDER)
        single.robots[1].configure_sonars(rate, DEFAULT_SONAR_ORDER)
        # The first calls compile, or read the cache.
        drive_batch(batch, 1)
        drive_single(single, 1)
        works = (partial(drive_batch, batch, steps), partial(drive_single, single, SINGLE_STEPS))
        (wall_s, cpu_s), (_, single_s) = best(works, rounds)
        done = robots * steps
        found[name] = {
            "setup": setup,
            "robots": robots,
            "walls": len(world.walls),
            "threads": batch.threads,
            "robot_steps_per_s": round(done / wall_s),
            "target_robot_steps_per_s": TARGET_STEPS_PER_S,
            "cpu_us_per_robot_step": round(cpu_s / done * 1e6, 3),
            "robot_steps_per_cpu_s": round(done / cpu_s),
            "single_cpu_us_per_step": round(single_s / SINGLE_STEPS * 1e6, 1),
            "times_faster_per_cpu": round(single_s / SINGLE_STEPS / (cpu_s / done), 1),
            "bytes_per_robot": round(batch.bytes_per_robot),
            "target_bytes_per_robot": TARGET_BYTES,
            # Robots that touch something are cheaper: the number shows how many there were.
            "touching": int((batch.bumpers != 0).sum()),
        }
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=10_000, help="robots of the batch (default: 10000)")
    parser.add_argument("--steps", type=int, default=40, help="steps of 0.1 s in a round (default: 40)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the best counts (default: 5)")
    parser.add_argument("--setup", choices=("ideal", "noisy", "worn"), default="ideal", help="default: ideal")
    parser.add_argument("--threads", type=int, help="threads of the batch (default: one per core)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    found = measure(options.robots, options.steps, options.rounds, options.setup, options.threads)
    if options.json:
        print(json.dumps(found))
        return 0
    for name, result in found.items():
        print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in result.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
