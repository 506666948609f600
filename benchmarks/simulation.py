"""Speed of the simulation: one robot, fifty, a thousand, and ir-sim in the same scene.

    python benchmarks/simulation.py [--setup NAME] [--robots N ...] [--rounds N] [--json]
    python benchmarks/simulation.py --growth       the table of README.md: cost by robots, walls and cone rays

Yardstick: cast_rays of 16 rays against the 50 walls of the scene, timed alternately in the same run. A ratio to it
depends less on the machine than steps per second do. All times are processor time, the best of some rounds.

Large groups use compiled code; with NOMAD_COMPILED=always the single robot does too, with
NOMAD_COMPILED=never none does. `compiled` shows it.
"""

from __future__ import annotations

import argparse
import gc
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import radians, tau
from time import process_time
from typing import Final

import numpy as np
from peer import INSTALL, SPEED_IN_S, TURN_RAD_S, peer
from scenes import WALLS, alone, crowd, roam

from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.server.daemon import GC_THRESHOLD
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.multi_robot import SPAN_PS, candidate_pairs
from nserver_emu.simulation.noise import IDEAL, MEASURED, NOISY, SETUPS, RobotSetup
from nserver_emu.simulation.visibility import NEAREST_OBSTACLE
from worlds.geometry import FloatArray
from worlds.raycast_arrays import cast_rays

Result = dict[str, float | int | str]

DT_S: Final = 0.1
CROWD_DT_S: Final = 0.12
"""Step of a group: two firings of a ring."""
TARGET_STEPS_PER_S: Final = 10_000
TARGETS: Final = {50: 10.0, 1000: 1.0}
"""Required speed by number of robots, as a multiple of real time."""
BUNCHED_S: Final = (15, 20)
"""Robots that all drive on gather in clusters: these seconds are measured separately."""
CASTS: Final = 30


def best_s(works: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Return the shortest processor time of each function, called alternately."""
    shortest = [float("inf")] * len(works)
    for _ in range(rounds):
        for number, work in enumerate(works):
            begin = process_time()
            work()
            shortest[number] = min(shortest[number], process_time() - begin)
    return shortest


def yardstick(walls: FloatArray) -> Callable[[], None]:
    """Return a function that casts 16 rays in all directions against walls, CASTS times."""
    angles = np.arange(16) * tau / 16
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)

    def cast() -> None:
        for _ in range(CASTS):
            cast_rays((0.0, 0.0), directions, walls)

    return cast


def one_robot(setup: RobotSetup, rounds: int, walls: int = WALLS, look_every: int = 1, steps: int = 300) -> Result:
    """Measure the steps per second of one robot whose sonars are read every `look_every` steps."""
    simulation = alone(setup, walls)
    # The yardstick has the same walls in every measurement, whatever the measured scene has.
    cast = yardstick(alone(IDEAL).world.walls)
    step_s, cast_s = best_s((lambda: roam(simulation, steps, DT_S, look_every), cast), rounds)
    step_s, cast_s = step_s / steps, cast_s / CASTS
    return {
        "setup": setup.name,
        "compiled": NEAREST_OBSTACLE.is_compiled,
        "walls": len(simulation.world.walls),
        "steps_per_s": round(1.0 / step_s),
        "step_us": round(step_s * 1e6, 1),
        "yardstick_us": round(cast_s * 1e6, 1),
        "ratio": round(cast_s / step_s, 3),
    }


def many_robots(robots: int, setup: RobotSetup, rounds: int, look_every: int = 8, places_for: int = 0) -> Result:
    """Measure the speed of a group whose rings are read every `look_every` steps, 0 never."""
    simulation, simulated_s = crowd(robots, setup, places_for), 8 * CROWD_DT_S
    # Objects of earlier measurements are exempt: searching them would count as time of this one.
    gc.collect()
    gc.freeze()
    cast = yardstick(alone(IDEAL).world.walls)
    steps = round(simulated_s / CROWD_DT_S)
    run_s, cast_s = best_s((lambda: roam(simulation, steps, CROWD_DT_S, look_every), cast), rounds)
    robot_s = run_s / (simulated_s * robots)
    return {
        "robots": robots,
        "setup": setup.name,
        "compiled": NEAREST_OBSTACLE.is_compiled,
        "times_real_time": round(simulated_s / run_s, 2),
        "us_a_robot_and_second": round(robot_s * 1e6),
        "yardstick_us": round(cast_s / CASTS * 1e6, 1),
        "ratio": round(cast_s / CASTS / robot_s, 3),
    }


def bunched(robots: int, setup: RobotSetup) -> Result:
    """Measure the speed of a group in the seconds BUNCHED_S, with rings read as before.

    Its robots continue as in the first second; blocked ones drive back and meet again. The result is the mean of these
    seconds, which, unlike the best of some rounds, drops on a busy machine; beside it the fastest of their pieces of
    0.96 s, and the slowest piece since the start.
    """
    simulation, cast = crowd(robots, setup), yardstick(alone(IDEAL).world.walls)
    gc.collect()
    gc.freeze()
    pieces_s, cast_s = [], float("inf")
    while simulation.time_s < BUNCHED_S[1]:
        piece_s, some_s = best_s((lambda: roam(simulation, 8, CROWD_DT_S, 8), cast), 1)
        pieces_s.append((simulation.time_s, piece_s))
        cast_s = min(cast_s, some_s)
    # Pieces that begin within the seconds BUNCHED_S.
    late_s = [piece_s for end_s, piece_s in pieces_s if end_s - 8 * CROWD_DT_S >= BUNCHED_S[0]]
    simulated_s = 8 * CROWD_DT_S * len(late_s)
    group = list(simulation.robots.values())
    return {
        "robots": robots,
        "setup": setup.name,
        "compiled": NEAREST_OBSTACLE.is_compiled,
        "near_others": len({row for pair in candidate_pairs(group, SPAN_PS) for row in pair}),
        "stopped": sum(not robot.moving[0] for robot in group),
        "times_real_time": round(simulated_s / sum(late_s), 2),
        "fastest": round(8 * CROWD_DT_S / min(late_s), 2),
        "slowest": round(8 * CROWD_DT_S / max(piece_s for _, piece_s in pieces_s), 2),
        "us_a_robot_and_second": round(sum(late_s) / (simulated_s * robots) * 1e6),
        "yardstick_us": round(cast_s / CASTS * 1e6, 1),
    }


def against_peer(rounds: int) -> Result | None:
    """Measure the steps per second of this simulation and of ir-sim in one scene; None if that is not installed."""
    simulations = [alone(IDEAL), alone(IDEAL)]
    theirs = peer(simulations[0].world)
    if theirs is None:
        return None
    # Rates 15 and 1: 60 ms and 4 ms between firings, 1.7 and 25 rays in a step.
    for simulation, rate in zip(simulations, (15, 1), strict=True):
        robot = simulation.robots[1]
        robot.set_velocities(SPEED_IN_S, TURN_RAD_S, 0.0)
        robot.configure_sonars(rate, DEFAULT_ORDER)

    def ours(number: int) -> None:
        robot = simulations[number].robots[1]
        for _ in range(100):
            simulations[number].step(DT_S)
            assert len(robot.sonar.readings_in) == 16

    usual_s, fastest_s, their_s = best_s((lambda: ours(0), lambda: ours(1), lambda: theirs(100)), rounds)
    # A robot that touches something stands, and is cheaper.
    assert all(simulation.robots[1].moving[0] for simulation in simulations)
    return {
        "steps_per_s": round(100 / usual_s),
        "steps_per_s_25_rays": round(100 / fastest_s),
        "irsim_steps_per_s": round(100 / their_s),
        "ratio": round(their_s / usual_s, 1),
        "ratio_25_rays": round(their_s / fastest_s, 1),
    }


def growth(rounds: int) -> str:
    """Return the table of README.md: each row changes one quantity. Costs per robot and second, in yardsticks."""
    rows = ["| what | | us a robot and second | in yardsticks |", "|---|---|---|---|"]

    def add(what: str, amount: str, result: Result, us: float) -> None:
        rows.append(f"| {what} | {amount} | {us:.0f} | {us / float(result['yardstick_us']):.1f} |")

    # The room is the same for all rows, so that only the number of robots changes.
    for robots in (1, 10, 100, 1000):
        result = many_robots(robots, IDEAL, rounds, places_for=1000)
        add("robots in a room for 1,000, rings read once a second", str(robots), result,
            float(result["us_a_robot_and_second"]))
    for walls in (4, 50, 200, 800):
        result = one_robot(IDEAL, rounds, walls)
        add("walls, one robot, ring read ten times a second", str(walls), result, 10.0 * float(result["step_us"]))
    for degrees in (5, 25, 60):
        cone = replace(MEASURED, sonar=Polaroid(cone_rad=radians(degrees)))
        result = one_robot(cone, rounds, steps=60)
        add("cone of measured sonars, degrees, the same", str(degrees), result, 10.0 * float(result["step_us"]))
    for setup in (IDEAL, NOISY, MEASURED):
        result = one_robot(setup, rounds, look_every=0)
        add("setup, one robot, ring never read", setup.name, result, 10.0 * float(result["step_us"]))
    return "\n".join(rows)


def report(setup: RobotSetup, crowds: Iterable[int], rounds: int) -> dict[str, Result | str]:
    """Return all measurements by name."""
    found: dict[str, Result | str] = {
        "one": one_robot(setup, rounds) | {"target_steps_per_s": TARGET_STEPS_PER_S},
        "one, sonars never read": one_robot(setup, rounds, look_every=0),
    }
    for robots in crowds:
        target: Result = {"target_times_real_time": TARGETS[robots]} if robots in TARGETS else {}
        found[f"{robots} robots"] = many_robots(robots, setup, rounds) | target
        found[f"{robots} robots, seconds {BUNCHED_S[0]} to {BUNCHED_S[1]}"] = bunched(robots, setup) | target
        found[f"{robots} robots, sonars never read"] = many_robots(robots, setup, rounds, look_every=0)
    found["against ir-sim"] = against_peer(rounds) or INSTALL
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--setup", choices=sorted(SETUPS), default="ideal", help="setup of the robots (default: ideal)")
    parser.add_argument("--robots", type=int, nargs="*", default=sorted(TARGETS),
                        help="sizes of groups (default: 50 1000)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the best counts (default: 5)")
    parser.add_argument("--growth", action="store_true", help="print the table of README.md and nothing else")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    gc.set_threshold(GC_THRESHOLD)
    if options.growth:
        print(growth(options.rounds))
        return 0
    found = report(SETUPS[options.setup], options.robots, options.rounds)
    if options.json:
        print(json.dumps(found))
        return 0
    for name, result in found.items():
        text = result if isinstance(result, str) else ", ".join(f"{key} {value}" for key, value in result.items())
        print(f"{name}: {text}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
