"""How fast may be driven on states that come far apart: numbers by hand."""

from __future__ import annotations

import pytest

from localization.navigation.limits import OBSERVED_STATES, StateGapLimiter


def shares(clocks_s: list[float]) -> list[float]:
    limiter = StateGapLimiter()
    return [limiter.speed_fraction(clock_s) for clock_s in clocks_s]


def test_states_that_come_often_enough_leave_the_speed_as_it_is_to_the_bit() -> None:
    assert shares([10.0, 10.1, 10.2, 10.7, 10.8]) == [1.0] * 5


def test_between_two_states_it_goes_as_far_as_in_half_a_second_at_full_speed() -> None:
    output = shares([0.0, 1.25, 2.5])
    assert output == [1.0, pytest.approx(0.4), pytest.approx(0.4)]
    assert 1.25 * output[1] == pytest.approx(0.5)


def test_a_long_gap_is_remembered_for_some_states_and_forgotten_then() -> None:
    output = shares([0.0, 2.0, *(2.0 + 0.1 * tick for tick in range(1, OBSERVED_STATES + 1))])
    assert output[1:OBSERVED_STATES] == [0.25] * (OBSERVED_STATES - 1)
    assert output[OBSERVED_STATES:] == [1.0] * 2
