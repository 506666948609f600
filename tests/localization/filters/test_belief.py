"""Beliefs: wrapped headings, differences by the shorter turn, standard deviations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localization.filters.belief import Belief, add, component, difference, independent, wrap_angle

angles = st.floats(-1000.0, 1000.0)


@given(angles)
def test_a_wrapped_angle_is_the_same_direction_and_small(angle: float) -> None:
    small = float(wrap_angle(np.array(angle)))
    assert -math.pi <= small <= math.pi
    assert math.cos(small) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(small) == pytest.approx(math.sin(angle), abs=1e-9)
    assert wrap_angle(angle) == small


@given(st.floats(-math.pi, math.pi))
def test_an_angle_already_small_keeps_every_bit(angle: float) -> None:
    assert float(wrap_angle(np.array(angle))) == angle


def test_heading_difference_is_wrapped() -> None:
    state, origin = np.array([1.0, 2.0, 3.1]), np.array([0.5, 0.0, -3.1])
    assert difference(state, origin) == pytest.approx([0.5, 2.0, 6.2 - 2 * math.pi])


@given(st.lists(st.floats(-50.0, 50.0), min_size=4, max_size=4), st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4))
def test_a_difference_added_leads_back(state: list[float], origin: list[float]) -> None:
    there, here = np.array(state), np.array(origin)
    back = add(here, difference(there, here))
    assert back[[0, 1, 3]] == pytest.approx(there[[0, 1, 3]], abs=1e-9)
    assert math.cos(back[2] - there[2]) == pytest.approx(1.0)


def test_adding_changes_neither_operand() -> None:
    state, change = np.array([0.0, 0.0, 3.0]), np.array([1.0, 1.0, 1.0])
    add(state, change)
    assert state.tolist() == [0.0, 0.0, 3.0]
    assert change.tolist() == [1.0, 1.0, 1.0]


def test_an_independent_belief_has_its_standard_deviations() -> None:
    belief = independent([[1.0, 2.0, 4.0], [0.0, 0.0, 0.0]], (0.1, 0.2, 0.3))
    assert belief.cov.shape == (2, 3, 3)
    assert belief.cov[0] == pytest.approx(np.diag([0.01, 0.04, 0.09]))
    assert belief.std == pytest.approx(np.tile([0.1, 0.2, 0.3], (2, 1)))
    assert belief.mean[0, 2] == pytest.approx(4.0 - 2 * math.pi)


def test_batch_elements_have_own_std() -> None:
    belief = independent(np.zeros((2, 3)), [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    assert belief.std.tolist() == [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]


def test_a_negative_spread_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be negative"):
        independent(np.zeros(3), (0.1, -0.1, 0.1))


def test_a_belief_cannot_be_changed_in_place() -> None:
    belief = Belief(np.zeros(3), np.eye(3))
    with pytest.raises(AttributeError):
        belief.mean = np.ones(3)  # type: ignore[misc]


def test_a_component_is_a_scalar_of_one_state() -> None:
    assert isinstance(component(np.array([1.0, 2.0]), 1), np.float64)
    assert component(np.array([[1.0, 2.0], [3.0, 4.0]]), 1).tolist() == [2.0, 4.0]
