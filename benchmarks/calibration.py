"""How well a guided run finds what a robot gets wrong: many robots, each with errors of its own, against the truth.

    python benchmarks/calibration.py [--seeds N] [--first SEED] [--json] [-- OPTION ...]

Every seed draws a robot (way and turn 3 to 6 % off, drift 0.5 to 1.5 mrad/in, sonars 1 to 2 in, ring 2 to 4 degrees,
each either way), simulates it with the setup `measured` (a Polaroid ring) and CHANCE of the wheels, and runs `nomad
calibrate` on it with whatever stands after `--`. Rules: one process, one run after the other. Nothing here is a test.
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

CHANCE: Final = "0.02,0.02,0.0005"
"""Of the wheels: in after 1 in, rad after 1 rad, rad after 1 in."""
SETUP: Final = """
base = "measured"
[motion]
alpha1 = 4e-4
alpha2 = 2.5e-7
alpha3 = 4e-4
"""
WORLD: Final = "thesis_room"
WITHIN: Final = 0.1
COLUMNS: Final = ("way", "turn", "drift", "sonars, mean of 16", "sonars, worst of 16", "ring")


class Outcome(NamedTuple):
    """Of one robot: errors as shares of the truth and in their own standard deviations, both by COLUMNS."""

    seed: int
    shares: tuple[float, ...]
    sigmas: tuple[float, ...]
    stds: tuple[float, ...]
    said: dict[str, Any]


def robot(seed: int) -> Calibration:
    """What the robot of this seed gets wrong."""
    chance = np.random.default_rng(seed)

    def either(low: float, high: float, count: int = 1) -> list[float]:
        return [float(drawn) for drawn in chance.choice([-1.0, 1.0]) * chance.uniform(low, high, count)]

    (way,), (turn,), (drift,) = either(0.03, 0.06), either(0.03, 0.06), either(0.0005, 0.0015)
    offsets, (turned_deg,) = either(1.0, 2.0, SONARS), either(2.0, 4.0)
    return Calibration(1.0 + way, 1.0 + turn, drift, tuple(offsets), float(np.radians(turned_deg)))


def calibrated(seed: int, words: list[str]) -> Outcome:
    """A guided run of the robot of this seed."""
    true = robot(seed)
    with tempfile.TemporaryDirectory() as folder:
        model, setup = Path(folder, "model.toml"), Path(folder, "setup.toml")
        model.write_text(format_calibration("n150", true), encoding="utf-8")
        setup.write_text(SETUP, encoding="utf-8")
        address = f"sim:{WORLD}?seed={seed}&setup={setup}&model_file={model}"
        told = io.StringIO()
        with contextlib.redirect_stdout(told):
            code = cli.main(["calibrate", address, "--world", WORLD, "--odometry-noise", CHANCE, "--json", *words])
    if code:
        raise SystemExit(f"seed {seed}: nomad calibrate ended with {code}")
    return outcome(seed, true, json.loads(told.getvalue()))


def outcome(seed: int, true: Calibration, said: dict[str, Any]) -> Outcome:
    """What was found against the truth."""
    spread = said["spread"]
    offsets, offset_stds = np.array(said["offsets_in"]), np.array(spread["offsets_in"])
    off = offsets - true.offsets_in
    worst = int(np.argmax(np.abs(off / true.offsets_in)))
    rows = (
        (said["way_scale"] - true.distance_scale, true.distance_scale - 1.0, spread["way_scale"]),
        (said["turn_scale"] - true.turn_scale, true.turn_scale - 1.0, spread["turn_scale"]),
        (said["drift_rad_in"] - true.drift_rad_in, true.drift_rad_in, spread["drift_rad_in"]),
        (float(off.mean()), float(np.mean(true.offsets_in)), float(offset_stds.mean())),
        (float(off[worst]), true.offsets_in[worst], float(offset_stds[worst])),
        (said["turned_rad"] - true.turned_rad, true.turned_rad, spread["turned_rad"]),
    )
    shares, sigmas = tuple(off / truth for off, truth, _ in rows), tuple(off / std for off, _, std in rows)
    return Outcome(seed, shares, sigmas, tuple(std for *_, std in rows), said)


def table(outcomes: list[Outcome]) -> str:
    """All of them, as the table of docs/calibration.md."""
    shares, sigmas = (np.array([getattr(one, name) for one in outcomes]) for name in ("shares", "sigmas"))
    rows = {
        "root mean square": [f"{share:.1%}" for share in np.sqrt(np.mean(shares**2, axis=0))],
        "the worst run": [f"{share:.1%}" for share in np.abs(shares).max(axis=0)],
        "runs within 10 %": [f"{count}" for count in (np.abs(shares) <= WITHIN).sum(axis=0)],
        "errors in standard deviations, rms": [f"{value:.2f}" for value in np.sqrt(np.mean(sigmas**2, axis=0))],
        "standard deviation told, mean": _stds(outcomes),
    }
    lines = [["", *COLUMNS], ["---"] * (1 + len(COLUMNS)), *([name, *row] for name, row in rows.items())]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _stds(outcomes: list[Outcome]) -> list[str]:
    way, turn, drift, mean, worst, ring = np.mean([one.stds for one in outcomes], axis=0)
    return [f"{way:.2%}", f"{turn:.2%}", f"{1e3 * drift:.3f} mrad/in", f"{mean:.3f} in", f"{worst:.3f} in",
            f"{degrees(ring):.2f} deg"]  # fmt: skip


def options_parser() -> argparse.ArgumentParser:
    """Of what stands before `--`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="how many robots (default %(default)s)")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="the first seed (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print each outcome as JSON, alone on stdout")
    return parser


def main(words: list[str] | None = None) -> int:
    """The command."""
    words = list(sys.argv[1:] if words is None else words)
    cut = words.index("--") if "--" in words else len(words)
    options = options_parser().parse_args(words[:cut])
    outcomes = []
    for seed in range(options.first, options.first + options.seeds):
        outcomes.append(calibrated(seed, words[cut + 1 :]))
        print(seed, *(f"{share:+.1%}" for share in outcomes[-1].shares), file=sys.stderr, flush=True)
    print(json.dumps([one._asdict() for one in outcomes]) if options.json else table(outcomes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
