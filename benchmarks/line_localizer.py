"""Compare the localizer's error on a serial line with that over TCP: same filter, path and noise.

    python benchmarks/line_localizer.py [--seeds N] [--speed X] [--json]

A noisy N150 crosses the thesis room on the path of figure 5.4, once over TCP and once over a pseudo-terminal, which has
neither stamps nor a mask. A second connection queries the ground truth. Bounds are those of the tests over TCP: an RMSE
of 0.5 in, and 1 in at the end; odometry alone is shown for comparison.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from localization.cli.arguments import START_STD
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import independent
from localization.live.run import Run, RunMoment, TruthSample
from localization.navigation.waypoints import STOP_RADIUS_IN, Navigator, Speeds, follow_waypoints, start_localizer
from nclient import Robot, connect
from worlds.io import load_world
from worlds.robots import BODIES

WORLD = "thesis_room"
WAYPOINTS = [(0.0, 0.0), (60.0, 40.0)]
RMSE_IN, END_IN = 0.5, 1.0
TIME_LIMIT_S = 60.0


@contextlib.contextmanager
def daemon(seed: int, speed: float) -> Iterator[dict[str, str]]:
    """Run a daemon with a noisy N150 and yield its addresses by protocol."""
    with tempfile.TemporaryDirectory() as folder:
        # Port 0 and a temporary folder: runs do not disturb each other.
        words = [WORLD, "--noisy", "--seed", str(seed), "--speed", str(speed), "--port", "0"]
        command = [sys.executable, "-m", "nserver_emu", *words, "--serial-link", str(Path(folder) / "robot")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            try:
                # Two lines of output: the TCP and the serial address.
                places = dict(program.stdout.readline().split()[1:] for _ in range(2))
                yield {"tcp": f"nserver://{places['nserver']}/1", "serial": f"serial://{places['serial']}?model=n150"}
            finally:
                program.terminate()


def localized(address: str, observer: Robot) -> Run:
    """Return the run of `nomad localize ADDRESS`, with ground truth from a second connection."""
    config = LocalizationConfig(load_world(WORLD).walls, BODIES["n150"], THESIS_ODOMETRY)
    # Truth is read before and after each state, and interpolated at the time of the estimate.
    run, truth_after = Run(WAYPOINTS), _truth(observer)
    with connect(address) as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], START_STD)
        navigator = Navigator(WAYPOINTS, Speeds(), STOP_RADIUS_IN)
        for progress in follow_waypoints(robot, start_localizer(robot, config, belief), navigator, time.sleep):
            truth_before, truth_after = truth_after, _truth(observer)
            state = progress.state
            odometry = (state.x_in, state.y_in, state.steering_rad)
            truth = truth_before.interpolate(truth_after, progress.estimate.clock_s)
            run.add(RunMoment(progress.estimate, odometry, truth, progress.passed))
            if run.duration_s > TIME_LIMIT_S:
                break
    return run


def measure(seeds: int, speed: float) -> dict[str, list[dict[str, Any]]]:
    """Return the summaries of all runs by protocol, each with a new daemon."""
    found: dict[str, list[dict[str, Any]]] = {"tcp": [], "serial": []}
    for seed in range(seeds):
        for line, runs in found.items():
            with daemon(seed, speed) as places, connect(places["tcp"] + "?tm_s=0") as observer:
                # tm_s=0: the observer must not set the motion timeout of the driven robot.
                runs.append(localized(places[line], observer).summary())
    return found


def _truth(observer: Robot) -> TruthSample:
    truth = observer.truth()
    return TruthSample(truth.time_s, (truth.x_in, truth.y_in, truth.steering_rad))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="runs a line (default %(default)s)")
    parser.add_argument("--speed", type=float, default=5.0, help="of the daemon (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    found = measure(options.seeds, options.speed)
    if options.json:
        print(json.dumps(found))
        return
    print(f"| line | goals | RMSE, in (bound {RMSE_IN}) | at the end, in (bound {END_IN:g}) | odometry alone, in |")
    print("|---|---|---|---|---|")
    for line, runs in found.items():
        goals = sum(run["reached"] == len(WAYPOINTS) for run in runs)
        keys = ("rmse_position_in", "end_error_in", "odometry_end_error_in")
        cells = " | ".join(_spread([run[key] for run in runs]) for key in keys)
        print(f"| {line} | {goals} of {len(runs)} | {cells} |")


def _spread(numbers: list[float]) -> str:
    return f"{min(numbers):.2f} to {max(numbers):.2f}, median {statistics.median(numbers):.2f}"


if __name__ == "__main__":
    main()
