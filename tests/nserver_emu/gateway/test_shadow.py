"""The shadow's numbers against numpy's, and what counts as a difference."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from nclient.errors import RecordingError
from nclient.protocol.types import N150, N200, SCOUT
from nserver_emu.gateway.gateway import ALL_SONARS, RunningStatistics, ShadowReport, angle_difference_deg


def state(**slots: int) -> list[int]:
    """A State vector of zeros, sonars 100, but for these: s34=..."""
    whole = [0] * 17 + [100] * 16 + [0] * 12
    for name, value in slots.items():
        whole[int(name[1:])] = value
    return whole


def test_running_statistics_agree_with_numpy() -> None:
    # A large mean and a small spread: the difference of squares would lose all digits.
    numbers = np.random.default_rng(5).normal(1e6, 0.01, 1000)
    running = RunningStatistics()
    assert running.std == 0.0
    for number in numbers.tolist():
        running.add(number)
    assert running.count == 1000
    assert running.mean == pytest.approx(numbers.mean(), rel=1e-12)
    assert running.std == pytest.approx(numbers.std(ddof=1), rel=1e-6)
    assert running.last == numbers[-1]
    running.add(-2e6)
    assert running.largest == -2e6


# In tenths of a degree; +-180 deg is the same direction.
@pytest.mark.parametrize(("tenths", "degrees"), [(5, 0.5), (3595, -0.5), (-3595, 0.5), (1800, -180.0), (-7, -0.7)])
def test_angle_differences_are_wrapped(tenths: int, degrees: float) -> None:
    assert angle_difference_deg(tenths) == pytest.approx(degrees)


def test_states_are_compared_by_quantity() -> None:
    shadow = ShadowReport(N200)
    shadow.compare(
        # Steering 5 and 3595 tenths differ by 1.0 deg. Sonars: 255 no echo, 0 dead; three of the 16 are not compared.
        state(s34=105, s35=-20, s36=5, s37=3599, s38=100, s43=10, s33=0b101, s3=4, s20=110, s21=255, s22=0, s23=255),
        state(s34=100, s35=20, s36=3595, s37=1, s38=90, s43=0, s33=0b110, s3=1, s20=107, s21=90, s22=80, s23=255),
    )
    found = {name: running.last for name, running in shadow.quantities.items() if running.last}
    assert found == pytest.approx({
        "x_in": 0.5, "y_in": -4.0, "steering_deg": 1.0, "turret_deg": -0.2, "translation_in_s": 1.0,
        # Two bumper bits differ.
        "compass_deg": 1.0, "bumpers": 2, "infrared_2": 3, "sonar_3_in": 3,
    })  # fmt: skip
    sonars = shadow.quantities[ALL_SONARS]
    assert (sonars.count, sonars.one_sided, sonars.largest) == (13, 2, 3)
    assert shadow.quantities["sonar_4_in"].one_sided == shadow.quantities["sonar_5_in"].one_sided == 1
    assert shadow.quantities["sonar_6_in"].one_sided == 0
    assert "1 states: x_in +0.50 ± 0.00" in shadow.summary()
    assert "2 echoes measured by one alone" in shadow.summary()


def test_quantities_follow_the_models_axes_and_sensors() -> None:
    assert "infrared_0" not in ShadowReport(N150).quantities
    scout = ShadowReport(SCOUT)
    scout.compare(state(s38=30, s39=10), state(s38=10, s39=40))
    assert scout.quantities["right_wheel_in_s"].last == 2.0
    assert scout.quantities["left_wheel_in_s"].last == -3.0
    assert "turret_deg_s" not in scout.quantities


def test_the_file_name_selects_json_or_csv(tmp_path: Path) -> None:
    shadow = ShadowReport(N150)
    for x in (10, 14, 30):
        shadow.compare(state(s34=x), state(s34=2))
    shadow.write("sim:thesis_room", tmp_path / "shadow.json")
    whole = json.loads((tmp_path / "shadow.json").read_text())
    assert (whole["robot"], whole["model"], whole["states"]) == ("sim:thesis_room", "n150", 3)
    # 10 - 2, 14 - 2 and 30 - 2 tenths.
    differences = np.array([0.8, 1.2, 2.8])
    expected = {"count": 3, "mean": differences.mean(), "std": differences.std(ddof=1), "max": 2.8, "last": 2.8,
                "one_sided": 0}  # fmt: skip
    assert whole["quantities"]["x_in"] == pytest.approx(expected)
    shadow.write("sim:thesis_room", tmp_path / "shadow.CSV")
    rows = list(csv.DictReader((tmp_path / "shadow.CSV").read_text().splitlines()))
    assert [row["quantity"] for row in rows] == list(shadow.quantities)
    assert {name: float(rows[0][name]) for name in expected} == pytest.approx(expected)
    with pytest.raises(RecordingError, match="cannot be written"):
        shadow.write("", tmp_path)
    # /dev/full fails at every write.
    full = "/dev/full: the report of the shadow cannot be written: No space left on device; make room on that disk"
    with pytest.raises(RecordingError, match=full):
        shadow.write("", Path("/dev/full"))
