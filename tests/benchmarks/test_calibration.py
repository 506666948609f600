"""The calibration benchmark: one short run, and its statistics."""

from __future__ import annotations

import json
from typing import Any

import calibration
import pytest


def estimate(off: float) -> dict[str, Any]:
    """Return an estimate whose parameters are all too large by this fraction, with standard deviations of 0.01."""
    true = calibration.draw_robot(3)
    stds = dict.fromkeys(("way_scale", "turn_scale", "drift_rad_in", "turned_rad"), 0.01)
    factor = 1.0 + off
    return {
        "way_scale": 1.0 + factor * (true.distance_scale - 1.0),
        "turn_scale": 1.0 + factor * (true.turn_scale - 1.0),
        "drift_rad_in": factor * true.drift_rad_in,
        "offsets_in": [factor * offset for offset in true.offsets_in],
        "turned_rad": factor * true.turned_rad,
        "spread": {**stds, "offsets_in": [0.01] * 16},
    }


def test_fractions_and_counts() -> None:
    true = calibration.draw_robot(3)
    outcomes = [calibration.compare(3, true, estimate(off)) for off in (0.05, -0.2)]
    assert outcomes[0].relative_errors == pytest.approx([0.05] * 6)
    assert outcomes[1].normalized_errors[0] == pytest.approx(-0.2 * (true.distance_scale - 1.0) / 0.01)
    lines = calibration.format_table(outcomes).splitlines()
    # The root mean square of 5 and 20 percent is 14.6 percent.
    assert lines[2].startswith("| root mean square | 14.6% | 14.6%")
    assert lines[4] == "| runs within 10 % | 1 | 1 | 1 | 1 | 1 | 1 |"


def test_robots_have_the_given_noise() -> None:
    robots = [calibration.draw_robot(seed) for seed in range(30)]
    # Errors are drawn away from zero, so that relative errors have a meaning.
    assert all(0.03 <= abs(robot.distance_scale - 1.0) <= 0.06 for robot in robots)
    assert all(1.0 <= abs(offset) <= 2.0 for robot in robots for offset in robot.offsets_in)
    assert {robot.turned_rad > 0.0 for robot in robots} == {True, False}


def test_complete_run(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--", "--sonars", "cones", "--laps", "1", "--square", "5,5,30", "--spins", "0"]
    assert calibration.main(["--seeds", "1", "--first", "4", "--json", *words]) == 0
    (outcome,) = json.loads(capsys.readouterr().out)
    assert outcome["seed"] == 4
    assert len(outcome["shares"]) == 6
