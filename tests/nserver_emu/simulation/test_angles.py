"""Directions come back to one turn, whichever side of 0 rounding puts them."""

from __future__ import annotations

from math import cos, pi, sin, tau

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nserver_emu.simulation.segments import wrap_to_2pi, wrap_to_pi


@given(st.floats(-1e3, 1e3))
def test_both_forms_are_the_same_direction(angle: float) -> None:
    for form, low, high in ((wrap_to_2pi(angle), 0.0, tau), (wrap_to_pi(angle), -pi, pi)):
        assert low <= form <= high
        assert (cos(form), sin(form)) == pytest.approx((cos(angle), sin(angle)), abs=1e-12)


def test_the_ends_of_the_ranges() -> None:
    assert wrap_to_2pi(-1e-17) == 0.0
    assert wrap_to_2pi(tau) == 0.0
    assert wrap_to_pi(pi) == wrap_to_pi(-pi) == pi
    assert wrap_to_pi(3.5 * pi) == pytest.approx(-0.5 * pi)
