"""Accuracy of `nomad calibrate`: calibrate simulated robots with random systematic errors and compare with the truth.

    python benchmarks/calibration.py [--seeds N] [--first SEED] [--json] [-- OPTION ...]

Each seed draws a robot: distance and turn scale off by 3 to 6 %, drift 0.5 to 1.5 mrad/in, sonar offsets 1 to 2 in,
ring rotation 2 to 4 degrees, all with random signs. The robot is simulated with the setup `measured` (a Polaroid ring)
and ODOMETRY_NOISE. The options after `--` are passed to `nomad calibrate`. All runs follow one another in one process.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from math import degrees
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from nclient.cli import main as cli
from worlds.robots import SONARS, Calibration, format_calibration

ODOMETRY_NOISE: Final = "0.02,0.02,0.0005"
"""Standard deviations of the wheels: in after 1 in, rad after 1 rad, rad after 1 in."""
SETUP: Final = """
base = "measured"
[motion]
alpha1 = 4e-4
alpha2 = 2.5e-7
alpha3 = 4e-4
"""
"""Noise of the simulation; the alphas are the variances of ODOMETRY_NOISE."""
WORLD: Final = "thesis_room"
MAX_RELATIVE_ERROR: Final = 0.1
"""Relative error of an accurate run."""
COLUMNS: Final = ("distance", "turn", "drift", "sonars, mean of 16", "sonars, worst of 16", "ring")


class Outcome(NamedTuple):
    """Result of one robot; the tuples are in the order of COLUMNS."""

    seed: int
    relative_errors: tuple[float, ...]
    """Errors as fractions of the true parameters."""
    normalized_errors: tuple[float, ...]
    """Errors in their reported standard deviations."""
    stds: tuple[float, ...]
    estimate: dict[str, Any]
    """Output of `nomad calibrate --json`."""

    def to_json(self) -> dict[str, Any]:
        """Return the outcome for the option --json."""
        return {
            "seed": self.seed,
            "shares": self.relative_errors,
            "sigmas": self.normalized_errors,
            "stds": self.stds,
            "said": self.estimate,
        }


def draw_robot(seed: int) -> Calibration:
    """Return the true systematic errors of the robot of this seed."""
    rng = np.random.default_rng(seed)

    def draw(low: float, high: float, count: int = 1) -> list[float]:
        return [float(drawn) for drawn in rng.choice([-1.0, 1.0]) * rng.uniform(low, high, count)]

    # Ranges of errors as found on worn robots, of either sign, never near zero: relative errors need a true value.
    (distance,), (turn,), (drift,) = draw(0.03, 0.06), draw(0.03, 0.06), draw(0.0005, 0.0015)
    offsets, (turned_deg,) = draw(1.0, 2.0, SONARS), draw(2.0, 4.0)
    return Calibration(1.0 + distance, 1.0 + turn, drift, tuple(offsets), float(np.radians(turned_deg)))


def run_calibration(seed: int, words: list[str]) -> Outcome:
    """Run `nomad calibrate` with additional options on the robot of this seed.

    Raises
    ------
    SystemExit
        The command ended with an exit code other than 0.
    """
    true = draw_robot(seed)
    # The true robot is a model file for the simulator; the command does not get it.
    with tempfile.TemporaryDirectory() as folder:
        model, setup = Path(folder, "model.toml"), Path(folder, "setup.toml")
        model.write_text(format_calibration("n150", true), encoding="utf-8")
        setup.write_text(SETUP, encoding="utf-8")
        address = f"sim:{WORLD}?seed={seed}&setup={setup}&model_file={model}&step_s=0.1"
        output = io.StringIO()
        # Other speeds or laps come from the command line of the benchmark.
        options = ["--world", WORLD, "--odometry-noise", ODOMETRY_NOISE, "--json", *words]
        with contextlib.redirect_stdout(output):
            code = cli.main(["calibrate", address, *options])
    if code:
        raise SystemExit(f"seed {seed}: nomad calibrate ended with {code}")
    return compare(seed, true, json.loads(output.getvalue()))


def compare(seed: int, true: Calibration, estimate: dict[str, Any]) -> Outcome:
    """Return the errors of an estimate, the output of `nomad calibrate --json`, against the true parameters."""
    spread = estimate["spread"]
    offsets, offset_stds = np.array(estimate["offsets_in"]), np.array(spread["offsets_in"])
    off = offsets - true.offsets_in
    # The worst sonar is the one with the largest relative error.
    worst = int(np.argmax(np.abs(off / true.offsets_in)))
    # Rows in the order of COLUMNS: error, true value, reported standard deviation. Scales count from 1.
    rows = (
        (estimate["way_scale"] - true.distance_scale, true.distance_scale - 1.0, spread["way_scale"]),
        (estimate["turn_scale"] - true.turn_scale, true.turn_scale - 1.0, spread["turn_scale"]),
        (estimate["drift_rad_in"] - true.drift_rad_in, true.drift_rad_in, spread["drift_rad_in"]),
        (float(off.mean()), float(np.mean(true.offsets_in)), float(offset_stds.mean())),
        (float(off[worst]), true.offsets_in[worst], float(offset_stds[worst])),
        (estimate["turned_rad"] - true.turned_rad, true.turned_rad, spread["turned_rad"]),
    )
    relative = tuple(error / truth for error, truth, _ in rows)
    normalized = tuple(error / std for error, _, std in rows)
    return Outcome(seed, relative, normalized, tuple(std for *_, std in rows), estimate)


def format_table(outcomes: list[Outcome]) -> str:
    """Return the statistics of all outcomes as a Markdown table (the one of docs/calibration.md)."""
    relative = np.array([outcome.relative_errors for outcome in outcomes])
    normalized = np.array([outcome.normalized_errors for outcome in outcomes])
    rows = {
        "root mean square": [f"{error:.1%}" for error in np.sqrt(np.mean(relative**2, axis=0))],
        "worst run": [f"{error:.1%}" for error in np.abs(relative).max(axis=0)],
        "runs within 10 %": [f"{count}" for count in (np.abs(relative) <= MAX_RELATIVE_ERROR).sum(axis=0)],
        "errors in standard deviations, rms": [f"{error:.2f}" for error in np.sqrt(np.mean(normalized**2, axis=0))],
        "standard deviation, mean": _format_stds(outcomes),
    }
    lines = [["", *COLUMNS], ["---"] * (1 + len(COLUMNS)), *([name, *row] for name, row in rows.items())]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _format_stds(outcomes: list[Outcome]) -> list[str]:
    """Return the mean standard deviations with their units."""
    distance, turn, drift, mean, worst, ring = np.mean([outcome.stds for outcome in outcomes], axis=0)
    return [f"{distance:.2%}", f"{turn:.2%}", f"{1e3 * drift:.3f} mrad/in", f"{mean:.3f} in", f"{worst:.3f} in",
            f"{degrees(ring):.2f} deg"]  # fmt: skip


def options_parser() -> argparse.ArgumentParser:
    """Return the parser of the options before `--`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="number of robots (default %(default)s)")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="the first seed (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print each outcome as JSON, alone on stdout")
    return parser


def main(words: list[str] | None = None) -> int:
    """Run the benchmark with the words of its command line; return its exit code."""
    words = list(sys.argv[1:] if words is None else words)
    # Words after `--` are options of `nomad calibrate`.
    cut = words.index("--") if "--" in words else len(words)
    options = options_parser().parse_args(words[:cut])
    outcomes = []
    for seed in range(options.first, options.first + options.seeds):
        outcomes.append(run_calibration(seed, words[cut + 1 :]))
        errors = outcomes[-1].relative_errors
        print(seed, *(f"{error:+.1%}" for error in errors), file=sys.stderr, flush=True)
    print(json.dumps([outcome.to_json() for outcome in outcomes]) if options.json else format_table(outcomes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
