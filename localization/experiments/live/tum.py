"""Paths in TUM's form, for evo and its like: a line a pose, "time x y z qx qy qz qw", seconds, metres, a quaternion.

Rules: text and files only. A trial has three paths: `truth`, `odometry` (where the encoders say it is), `estimate`; of
a method that looks back all three are of the instants it tells of.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from localization.experiments.live.matrix import Trial
from localization.experiments.live.trial import Record
from localization.filters.belief import Floats

METRES_PER_INCH: Final = 0.0254


def lines(clock_s: Floats, poses: Floats) -> str:
    """Poses (T, 3) in inches and radians at instants (T,) as text."""
    x, y = (METRES_PER_INCH * poses[:, :2]).T
    half = 0.5 * poses[:, 2]
    rows = zip(clock_s, x, y, np.sin(half), np.cos(half), strict=True)
    return "".join(f"{t:.6f} {east:.9f} {north:.9f} 0 0 0 {qz:.12f} {qw:.12f}\n" for t, east, north, qz, qw in rows)


def paths(folder: Path, trial: Trial) -> dict[str, Path]:
    """Where the paths of a trial are written: truth, odometry, estimate."""
    stem = f"{'_'.join(trial.cell)}_{trial.seed:04d}"
    return {name: folder / f"{stem}_{name}.tum" for name in ("truth", "odometry", "estimate")}


def write(folder: Path, trial: Trial, record: Record) -> None:
    """Write the paths of a trial, and the folder they stand in."""
    folder.mkdir(parents=True, exist_ok=True)
    poses = {"truth": record.truth, "odometry": record.encoders, "estimate": record.mean}
    for name, path in paths(folder, trial).items():
        path.write_text(lines(record.clock_s, poses[name]), encoding="utf-8")
