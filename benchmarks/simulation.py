"""Steps of 0.1 s a second: one ideal N150 roams between 50 walls, sonars firing and read after every step.

Yardstick: cast_rays of 16 rays against the same 50 walls, timed in the same run. The ratio says how many steps cost as
much as one such cast; it moves less from machine to machine than steps a second do.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from math import pi, sin, tau
from time import perf_counter

import numpy as np

from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.setup import SETUPS
from nserver_emu.simulation.simulation import Simulation
from worlds.raycast import cast_rays
from worlds.world import Polygon, World

DT_S = 0.1
HALF_IN = 240.0
WALLS = 50
TARGET_STEPS_PER_S = 3000


def scene() -> World:
    """A square room of 480 in with 46 walls of 30 in strewn into it, none within 40 in of the start: 50 walls."""
    chance = np.random.default_rng(150)
    middles = chance.uniform(-HALF_IN, HALF_IN, (400, 2))
    middles = middles[np.hypot(*middles.T) > 55.0][: WALLS - 4]
    angles = chance.uniform(0.0, pi, len(middles))
    half = 15.0 * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    corners = ((-HALF_IN, -HALF_IN), (HALF_IN, -HALF_IN), (HALF_IN, HALF_IN), (-HALF_IN, HALF_IN))
    return World("benchmark", rooms=(Polygon(corners),), inner_walls=np.hstack((middles - half, middles + half)))


def roam(simulation: Simulation, robot: SimulatedRobot, steps: int) -> None:
    """Drive in arcs that change every two seconds; wherever the robot is stopped it drives back."""
    speed = 12.0
    for step in range(steps):
        stopped = not robot.moving[0]
        if stopped or step % 20 == 0:
            speed = -speed if stopped else speed
            robot.set_velocities(speed, 0.5 * sin(step), 0.2)
        simulation.step(DT_S)
        assert len(robot.sonar.readings_in) == 16


def seconds(work: Callable[[], object], rounds: int) -> float:
    """The least time one round of some work takes."""
    times = []
    for _ in range(rounds):
        begin = perf_counter()
        work()
        times.append(perf_counter() - begin)
    return min(times)


def measure(setup: str, steps: int, rounds: int) -> dict[str, float | int | str]:
    """Run the benchmark; the best of some rounds for work and yardstick alike."""
    world = scene()
    simulation = Simulation(world, seed=1)
    robot = simulation.add_robot(1, setup=SETUPS[setup])
    step_s = seconds(lambda: roam(simulation, robot, steps), rounds) / steps
    angles = np.arange(16) * tau / 16
    ways = np.stack((np.cos(angles), np.sin(angles)), axis=-1)

    def cast() -> None:
        for _ in range(200):
            cast_rays((0.0, 0.0), ways, world.walls)

    cast_s = seconds(cast, rounds) / 200
    return {
        "setup": setup,
        "walls": len(world.walls),
        "steps": steps * rounds,
        "steps_per_s": round(1.0 / step_s),
        "step_us": round(step_s * 1e6, 1),
        "yardstick_us": round(cast_s * 1e6, 1),
        "ratio": round(cast_s / step_s, 3),
        "target_steps_per_s": TARGET_STEPS_PER_S,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Steps of 0.1 s a second of one N150, 16 sonars, 50 walls.")
    parser.add_argument("--setup", choices=sorted(SETUPS), default="ideal", help="how the robot is simulated")
    parser.add_argument("--steps", type=int, default=1000, help="steps a round (1000)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds, the best counts (5)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    result = measure(options.setup, options.steps, options.rounds)
    if options.json:
        print(json.dumps(result))
        return 0
    print(f"{result['steps_per_s']} steps/s ({result['step_us']} us each), {result['walls']} walls, {result['setup']}")
    print(f"yardstick: 16 rays x {result['walls']} walls in {result['yardstick_us']} us; ratio {result['ratio']}")
    print(f"target: {result['target_steps_per_s']} steps/s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
