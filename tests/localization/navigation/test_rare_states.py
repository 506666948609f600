"""Speed limit for rare states: numbers by hand."""

from __future__ import annotations

import pytest

from localization.navigation.control_law import OBSERVED_STATES, StateGapLimiter


def shares(clocks_s: list[float]) -> list[float]:
    limiter = StateGapLimiter()
    return [limiter.speed_fraction(clock_s) for clock_s in clocks_s]


def test_frequent_states_leave_speed_unchanged() -> None:
    assert shares([10.0, 10.1, 10.2, 10.7, 10.8]) == [1.0] * 5


def test_rare_states_limit_distance_between_two_states() -> None:
    output = shares([0.0, 1.25, 2.5])
    assert output == [1.0, pytest.approx(0.4), pytest.approx(0.4)]
    assert 1.25 * output[1] == pytest.approx(0.5)


def test_long_gap_limits_speed_for_observed_states() -> None:
    output = shares([0.0, 2.0, *(2.0 + 0.1 * tick for tick in range(1, OBSERVED_STATES + 1))])
    assert output[1:OBSERVED_STATES] == [0.25] * (OBSERVED_STATES - 1)
    assert output[OBSERVED_STATES:] == [1.0] * 2
