"""Turns in place by so much, added up from heading to heading."""

from __future__ import annotations

from math import radians, remainder, tau

import pytest

from localization.missions.mission import TurnProgress


@pytest.mark.parametrize("by_deg", [0, 30, 180, -180, 270, 360, -720, 3600])
def test_it_goes_by_so_much_in_that_direction_wherever_headings_wrap(by_deg: float) -> None:
    by, step, heading, turned = radians(by_deg), radians(7), radians(170), 0.0
    turning = TurnProgress(heading, by)
    while abs(left := turning.remaining_rad(remainder(heading, tau))) > 1e-9:
        assert left == pytest.approx(by - turned, abs=1e-9)
        move = max(-step, min(step, left))
        heading, turned = heading + move, turned + move
    assert turned == pytest.approx(by, abs=1e-9)


def test_what_was_turned_too_far_is_turned_back() -> None:
    assert TurnProgress(0.0, 1.0).remaining_rad(1.2) == pytest.approx(-0.2)
