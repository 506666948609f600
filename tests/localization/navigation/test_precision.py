"""Required precision of parameters, and parameters that are noise."""

from __future__ import annotations

from dataclasses import replace
from math import radians

from localization.cli.calibrate import missing, noise_in, numbers
from worlds.robots import Calibration, Spread

KNOWN = Spread(0.001, 0.001, 0.000025, (0.033,) * 16, radians(0.1))


def test_small_parameter_needs_typical_precision() -> None:
    found = Calibration(1.0019, 0.9979, 0.00006, (0.0, 0.07, *(0.0,) * 14), radians(-0.2), KNOWN)
    assert missing(found) == []
    assert missing(replace(found, spread=replace(KNOWN, turn_scale=0.00101))) == ["turn"]
    assert "turn" not in noise_in(found)
    assert "sonar 1" not in noise_in(found)
    assert noise_in(found)[:3] == ["way", "ring", "sonar 0"]
    assert [number.words for number in numbers(found)[:2]] == ["within noise of zero", "accurate to 47.6%"]


def test_large_parameter_needs_a_thirtieth_of_itself() -> None:
    spread = replace(KNOWN, distance_scale=0.0019, drift_rad_in=0.00005)
    assert missing(Calibration(0.94, 1.0, 0.0015, spread=spread)) == []
    assert missing(Calibration(0.95, 1.0, -0.00149, spread=spread)) == ["way", "drift"]
