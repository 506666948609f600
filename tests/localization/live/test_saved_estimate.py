"""A saved estimate on disk: exact round trip, and errors that name the key."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from localization.filters.belief import Belief, independent
from localization.filters.odometry import MAX_STATE
from localization.live.estimate import MAX_BYTES, MapSignature, SavedEstimate, load, save
from localization.live.sensor_input import EncoderPose
from nclient.errors import EstimateFileError

SAVED = SavedEstimate(
    MapSignature("thesis_room", "0123456789abcdef", "n150"),
    EncoderPose.of(12.3, np.array([1.1, -2.2, 3.0]), 0.1),
    independent([1.0, -2.0, 3.1, 1 / 3], [0.1, 0.2, 0.01, 0.05]),
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "here.json"
    save(path, SAVED)
    return path


def test_estimate_round_trips_exactly(file: Path) -> None:
    back = load(file)
    assert back.signature == SAVED.signature
    assert back.encoders.clock_s == 12.3
    assert back.encoders.turret_rad == 0.1
    assert (back.encoders.pose == SAVED.encoders.pose).all()
    assert (back.belief.mean == SAVED.belief.mean).all()
    assert (back.belief.cov == SAVED.belief.cov).all()
    assert [path.name for path in file.parent.iterdir()] == ["here.json"]


@pytest.mark.parametrize(
    "key", ["format", "world", "walls", "body", "clock_s", "encoders", "turret_rad", "mean", "cov"]
)
def test_a_missing_key_is_reported(file: Path, key: str) -> None:
    values = json.loads(file.read_text())
    del values[key]
    file.write_text(json.dumps(values))
    with pytest.raises(EstimateFileError, match=rf"here\.json: {key}(\[\d\])*: "):
        load(file)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("world", 3), ("body", None), ("clock_s", "now"), ("clock_s", [1.0]), ("turret_rad", float("nan")),
        ("encoders", [1.0, 2.0]), ("encoders", [1.0, 2.0, {}]), ("mean", [1.0, 2.0]), ("mean", 4.0),
        ("mean", [0.0] * 99), ("mean", [1.0, 2.0, 3.0, 10**400]), ("cov", [[1.0]]),
        # A negative variance, and a matrix that is not symmetric.
        ("cov", np.diag([1.0, 1.0, 1.0, -1.0]).tolist()), ("cov", (np.eye(4) + np.eye(4, k=1)).tolist()),
        ("mean", [1e300, 2.0, 3.0, 4.0]),
        ("cov", (1e308 * np.eye(4)).tolist()), ("clock_s", 1e13), ("colour", "red"), ("format", "nomad estimate 0"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_reported(file: Path, key: str, value: Any) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))
    with pytest.raises(EstimateFileError, match=rf"here\.json: {key}(\[\d\])*: "):
        load(file)


@pytest.mark.parametrize("text", ["", "[" * 100_000, "\x00", "3", "[]"])
def test_other_content_is_reported(file: Path, text: str) -> None:
    file.write_text(text)
    with pytest.raises(EstimateFileError, match=r"here\.json: "):
        load(file)


def test_largest_state_fits_and_longer_file_is_refused(file: Path) -> None:
    # The longest numbers that JSON writes.
    cov = np.full((MAX_STATE, MAX_STATE), -1.2345678901234567e-300) + np.eye(MAX_STATE)
    save(
        file,
        SavedEstimate(
            MapSignature("x" * 1000, *SAVED.signature[1:]), SAVED.encoders, Belief(np.full(MAX_STATE, -1 / 3e9), cov)
        ),
    )
    assert file.stat().st_size < MAX_BYTES / 10
    assert len(load(file).belief.mean) == MAX_STATE
    # Blanks are allowed by JSON, and make the file too long.
    file.write_text(file.read_text() + " " * MAX_BYTES)
    with pytest.raises(EstimateFileError, match=rf"here\.json: .*longer than {MAX_BYTES}"):
        load(file)


def test_missing_file_and_folder_are_reported(tmp_path: Path) -> None:
    with pytest.raises(EstimateFileError, match="cannot be read"):
        load(tmp_path / "nothing.json")
    with pytest.raises(EstimateFileError, match="cannot be written"):
        save(tmp_path / "nowhere" / "here.json", SAVED)
