"""Relative turns in place, summed from heading to heading."""

from __future__ import annotations

from math import radians, remainder, tau

import pytest

from localization.navigation.path import TurnProgress


@pytest.mark.parametrize("by_deg", [0, 30, 180, -180, 270, 360, -720, 3600])
def test_relative_turn_is_independent_of_heading_wrap(by_deg: float) -> None:
    by, step, heading, turned = radians(by_deg), radians(7), radians(170), 0.0
    turning = TurnProgress(heading, by)
    while abs(left := turning.remaining_rad(remainder(heading, tau))) > 1e-9:
        assert left == pytest.approx(by - turned, abs=1e-9)
        move = max(-step, min(step, left))
        heading, turned = heading + move, turned + move
    assert turned == pytest.approx(by, abs=1e-9)


def test_overshoot_is_turned_back() -> None:
    assert TurnProgress(0.0, 1.0).remaining_rad(1.2) == pytest.approx(-0.2)
