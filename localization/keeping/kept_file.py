"""A kept belief on disk: JSON, every key checked when it is read.

    {"format": "nomad estimate 1", "world", "walls", "body", "clock_s", "encoders": [x_in, y_in, steering_rad],
     "turret_rad", "mean": [n numbers], "cov": [n rows of n numbers]}

Rules: the only file here that touches the disk; a file is whole, or it is the old one. Whatever is wrong is an
EstimateFileError that names the file and the key.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from localization.filters.belief import Belief, Floats
from localization.filters.odometry import LARGEST, POSE
from localization.keeping.kept import Kept, Site
from localization.live.sensor_input import EncoderPose
from nclient.errors import EstimateFileError
from nclient.file_text import read_text
from nclient.whole_file import write_whole

FORMAT: Final = "nomad estimate 1"
KEYS: Final = ("format", "world", "walls", "body", "clock_s", "encoders", "turret_rad", "mean", "cov")
MOST_BYTES: Final = 1 << 16
"""Twenty times the largest state's; a longer file is something else."""
FARTHEST: Final = 1e12
"""No second, inch or radian of a run, and no square of one, is farther from 0."""
SMALLEST_EIGENVALUE: Final = -1e-9
"""Rounding may leave a covariance that is zero somewhere a little below it."""


def save(path: Path, kept: Kept) -> None:
    """Write it. Raises EstimateFileError where that cannot be."""
    values = {
        "format": FORMAT,
        **kept.site._asdict(),
        "clock_s": kept.encoders.clock_s,
        "encoders": kept.encoders.pose.tolist(),
        "turret_rad": kept.encoders.turret_rad,
        "mean": kept.belief.mean.tolist(),
        "cov": kept.belief.cov.tolist(),
    }
    write_whole(path, json.dumps(values, indent=1) + "\n", EstimateFileError)


def load(path: Path) -> Kept:
    """Read it. Raises EstimateFileError for whatever is no such file."""
    text = read_text(path, MOST_BYTES, EstimateFileError)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise EstimateFileError(f"{path}: is no JSON: {error}") from error
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        _fail(path, "format", f"expected {FORMAT!r}: a file that `nomad localize --save` wrote")
    for key in {*KEYS} ^ {*values}:
        _fail(path, key, "is missing" if key in KEYS else "unknown key")
    site = Site(*(_text(path, key, values[key]) for key in Site._fields))
    clock_s, turret_rad = _numbers(path, "clock_s", values, ()), _numbers(path, "turret_rad", values, ())
    encoders = EncoderPose(float(clock_s), _numbers(path, "encoders", values, (POSE,)), float(turret_rad))
    return Kept(site, encoders, _belief(path, values))


def _belief(path: Path, values: dict[str, Any]) -> Belief:
    size = len(values["mean"]) if isinstance(values["mean"], list) else 0
    if not POSE <= size <= LARGEST:
        _fail(path, "mean", f"expected {POSE} to {LARGEST} numbers")
    mean, cov = _numbers(path, "mean", values, (size,)), _numbers(path, "cov", values, (size, size))
    if not np.allclose(cov, cov.T) or np.linalg.eigvalsh(cov)[0] < SMALLEST_EIGENVALUE:
        _fail(path, "cov", "is no covariance: expected it symmetric, and no variance below 0")
    return Belief(mean, 0.5 * (cov + cov.T))


def _numbers(path: Path, key: str, values: dict[str, Any], shape: tuple[int, ...]) -> Floats:
    wanted = " by ".join(map(str, shape)) + " numbers" if shape else "a number"
    try:
        found = np.array(values[key], dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        _fail(path, key, f"expected {wanted}")
    if found.shape != shape or not all(abs(number) <= FARTHEST for number in found.ravel().tolist()):
        _fail(path, key, f"expected {wanted}, none beyond {FARTHEST:g}")
    return found


def _text(path: Path, key: str, value: object) -> str:
    if not isinstance(value, str):
        _fail(path, key, "expected a text")
    return value


def _fail(path: Path, key: str, complaint: str) -> NoReturn:
    raise EstimateFileError(f"{path}: {key}: {complaint}")
