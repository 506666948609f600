"""The chi-square distribution against scipy, which the filter must do without."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gammainc, gammaincinv

from localization.filters.belief import chi_square_cdf, chi_square_quantile

dofs = st.floats(0.5, 2000.0)


@given(dofs, st.floats(0.01, 4.0))
def test_probabilities_are_those_of_scipy(dof: float, share: float) -> None:
    value = share * dof
    assert chi_square_cdf(value, dof) == pytest.approx(gammainc(dof / 2.0, value / 2.0), rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("dof", [1, 2, 3, 16, 300, 3000])
@pytest.mark.parametrize("probability", [1e-6, 0.025, 0.5, 0.95, 0.975, 0.999, 1 - 1e-9])
def test_quantiles_are_those_of_scipy(probability: float, dof: int) -> None:
    expected = 2.0 * gammaincinv(dof / 2.0, probability)
    assert chi_square_quantile(probability, dof) == pytest.approx(expected, rel=1e-6)


def test_the_gate_of_the_experiments() -> None:
    assert chi_square_quantile(0.999, 1) == pytest.approx(10.8276, abs=1e-4)


def test_nothing_is_below_zero() -> None:
    assert chi_square_cdf(0.0, 3) == 0.0
    assert chi_square_cdf(-1.0, 3) == 0.0


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, float("nan")])
def test_no_value_has_a_probability_outside_0_to_1(probability: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        chi_square_quantile(probability, 1)


@pytest.mark.parametrize("dof", [0.0, -1.0])
def test_degrees_of_freedom_are_positive(dof: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        chi_square_cdf(1.0, dof)
