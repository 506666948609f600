"""Consistency of a filter for a robot that stands still: the NEES of its pose against the ground truth.

    python benchmarks/standing.py [--noise exact noisy measured] [--seeds N] [--at S ...] [--method ekf]

Every seed places an N150 at a free pose of the world, draws the initial error of its belief, and measures with the
sonars. The normalised estimation error squared (NEES) of a pose has a mean of 3 for a consistent filter (Bar-Shalom, Li
and Kirubarajan, Estimation with Applications to Tracking and Navigation, section 5.4). Simulated time, one process.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from math import degrees
from typing import Any, Final

import numpy as np

from localization.experiments.live_trial import SCENARIOS, START_STD, Scenario
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Floats, difference, independent
from localization.filters.registry import METHODS, make
from localization.live.localizer import Localizer
from localization.live.sensor_input import FiringSchedule
from nclient import connect
from nclient.protocol.types import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from worlds.io import load_world
from worlds.robots import N150

WORLD: Final = load_world("thesis_room")
NOISES: Final = tuple(name for name, scenario in SCENARIOS.items() if not scenario.line)
SECONDS: Final = (2.0, 10.0, 60.0, 300.0)
MARGIN_IN: Final = 1.0


def draw_free_pose(rng: np.random.Generator) -> Floats:
    """Return a random pose (3,) at which the robot touches nothing."""
    corners = WORLD.walls.reshape(-1, 2)
    while True:
        pose: Floats = rng.uniform((*corners.min(axis=0), -np.pi), (*corners.max(axis=0), np.pi))
        if WORLD.clearance(*pose[:2].tolist()) > N150.radius_in + MARGIN_IN:
            return pose


def measure_nees(scenario: Scenario, seed: int, at_s: Sequence[float], method: str = "ekf") -> Floats:
    """Return the NEES of the pose and its position error in inches at each of these times, (n, 2)."""
    config = LocalizationConfig(WORLD.walls, N150, scenario.odometry, scenario.sonar)
    # 1. True pose, and a belief that is wrong by its own standard deviations.
    # Another stream than that of the robot, which has the seed alone.
    rng = np.random.default_rng([seed, 99])
    truth = draw_free_pose(rng)
    belief = independent(truth + np.array(START_STD) * rng.standard_normal(3), START_STD)
    x, y, heading = truth.tolist()
    start = f"{x},{y},{degrees(heading)},{degrees(heading)}"
    # 2. The live localizer on a simulated robot, compared with the true pose.
    rows = []
    with connect(f"sim:{WORLD.name}?setup={scenario.base}&seed={seed}&start={start}&step_s=0.5") as robot:
        state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
        start_s = state.clock_s or 0.0
        localizer = Localizer(config, belief, FiringSchedule(start_s), make(method, config, belief, seed))
        estimate = localizer.update(state)
        for until_s in at_s:
            # The robot stands: each refresh lets 0.5 s of simulated time pass.
            while estimate.clock_s < start_s + until_s:
                estimate = localizer.update(robot.refresh())
            pose = estimate.belief.pose
            error = difference(pose.mean, truth)
            rows.append((float(error @ np.linalg.solve(pose.cov, error)), float(np.hypot(error[0], error[1]))))
    return np.array(rows)


def options_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--noise", nargs="+", choices=NOISES, default=NOISES)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--at", nargs="+", type=float, default=SECONDS, metavar="S", help="seconds from the start")
    parser.add_argument("--method", choices=METHODS, default="ekf")
    parser.add_argument("--json", action="store_true")
    return parser


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and print a table, or JSON with --json."""
    options = options_parser().parse_args(words)
    rows: list[dict[str, Any]] = []
    for name in options.noise:
        seeds = range(options.seeds)
        runs = np.array([measure_nees(SCENARIOS[name], seed, options.at, options.method) for seed in seeds])
        for after_s, (nees, error_in) in zip(options.at, runs.transpose(1, 2, 0), strict=True):
            rmse = float(np.sqrt((error_in**2).mean()))
            rows.append({"noise": name, "after_s": after_s, "nees": float(nees.mean()), "worst": float(nees.max()),
                         "rmse_in": rmse})  # fmt: skip
    if options.json:
        print(json.dumps(rows))
        return
    print(f"{'noise':10}{'after':>8}{'mean NEES':>12}{'worst':>8}{'RMSE':>10}    {options.seeds} robots")
    for row in rows:
        print(f"{row['noise']:10}{row['after_s']:6g} s{row['nees']:12.2f}{row['worst']:8.1f}{row['rmse_in']:7.3f} in")


if __name__ == "__main__":
    main()
