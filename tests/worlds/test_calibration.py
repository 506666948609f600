"""Calibration of a robot: written to text and read back."""

from __future__ import annotations

from math import radians
from pathlib import Path

import pytest

from nclient.errors import WorldFileError
from worlds.robots import IDEAL_CALIBRATION, Calibration, Spread, format_calibration, load_calibration

# Numbers with an exact binary form, so that they can be compared without a tolerance.
OFFSETS = tuple(0.125 * number - 1.0 for number in range(16))
FOUND = Calibration(
    1.03125, 0.96875, -0.00125, OFFSETS, radians(2.5), Spread(0.001, 0.002, 5e-5, (0.03125,) * 16, radians(0.25))
)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_calibration_round_trips(tmp_path: Path) -> None:
    path = written(tmp_path, format_calibration("n150", FOUND, "of mine\nin May"))
    found = load_calibration(path, "n150")
    assert found.offsets_in == OFFSETS
    assert found.spread.offsets_in == FOUND.spread.offsets_in
    for one, other in ((found, FOUND), (found.spread, FOUND.spread)):
        assert (one.distance_scale, one.turn_scale, one.drift_rad_in, one.turned_rad) == pytest.approx(
            (other.distance_scale, other.turn_scale, other.drift_rad_in, other.turned_rad), rel=1e-5
        )
    assert path.read_text().startswith("# of mine\n# in May\n[[model]]\n")


# The calibration of a model is that of its own table, and not of a table before it.
def test_missing_keys_are_ideal(tmp_path: Path) -> None:
    text = '[[model]]\nname = "n200"\n[[model]]\nname = "n150"\nradius_in = 9\n[model.odometry]\nway_scale = 1.1\n'
    path = written(tmp_path, text)
    assert load_calibration(path, "n150") == Calibration(distance_scale=1.1)
    assert load_calibration(path, "n200") == IDEAL_CALIBRATION


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[[model]]\nname = "n200"\n', "has no model 'n150'"),
        ("", "has no model 'n150'"),
        ("[[model", "is no TOML"),
        ('[[model]]\nname = "n150"\n[model.odometry]\nway_scal = 1\n', "did you mean way_scale"),
        ('[[model]]\nname = "n150"\n[model.odometry]\nway_scale = 3\n', r"model\[0\].odometry.way_scale: .* 0.5 to 2"),
        ('[[model]]\nname = "n150"\n[model.odometry]\ndrift_rad_in = 1\n', "drift_rad_in: expected -0.1 to 0.1"),
        ('[[model]]\nname = "n150"\n[model.sonar]\noffsets_in = [1]\n', "list of 16 numbers"),
        ('[[model]]\nname = "n150"\n[model.sonar]\nturned_deg = 90\n', "turned_deg: expected -45 to 45"),
        ('[[model]]\nname = "n150"\n[model.spread]\nway_scale = -1\n', "way_scale: expected 0 to 1"),
        ('[[model]]\nname = "n150"\n[model.spread]\nfar = -1\n', "unknown key"),
    ],
)
def test_invalid_calibration_is_reported(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(WorldFileError, match=expected):
        load_calibration(written(tmp_path, text), "n150")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(WorldFileError, match="cannot be read"):
        load_calibration(tmp_path / "nothing.toml", "n150")
