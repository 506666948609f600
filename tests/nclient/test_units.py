"""Units in, tenths out: judged by the definition of the inch and of the radian, and by hypothesis."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nclient.state import AxisCommand, AxisMode, firing_order, points_tenths, tenths_of

LENGTHS = st.floats(-1e5, 1e5)


@pytest.mark.parametrize(
    ("quantity", "tenths"),
    [
        ({"translation_in_s": 2.5}, 25),
        ({"translation_in_s": -2.5}, -25),
        ({"translation_m_s": 0.254}, 100),
        ({"translation_in": 0.04}, 0),
        # 1 m = 39.37 in = 393.7 tenths, rounded.
        ({"translation_m": 1.0}, 394),
        ({"steering_deg": 45}, 450),
        ({"steering_rad": math.pi}, 1800),
        ({"turret_rad_s": -math.pi / 2}, -900),
        ({"turret_deg_s2": 50}, 500),
        ({"translation_m_s2": 0.0254}, 10),
        ({"x_in": 1e-9, "x_m": None}, 0),
    ],
)
def test_the_keyword_names_the_unit(quantity: dict[str, Any], tenths: int) -> None:
    assert tenths_of(**quantity) == tenths


@given(LENGTHS)
def test_metres_are_rounded_to_half_a_tenth_inch(metres: float) -> None:
    # Half a tenth of an inch in metres, and the rounding of floats.
    assert abs(tenths_of(x_m=metres) / 10 * 0.0254 - metres) <= 0.05 * 0.0254 * (1 + 1e-9)


@given(st.floats(-1e4, 1e4))
def test_radians_are_rounded_to_half_a_tenth_degree(angle_rad: float) -> None:
    assert abs(math.radians(tenths_of(a_rad=angle_rad) / 10) - angle_rad) <= math.radians(0.05) * (1 + 1e-9)


def test_the_default_without_value() -> None:
    assert tenths_of(x_in=None, x_m=None) == 0
    assert tenths_of(default=7, x_in=None) == 7


def test_two_units_of_one_quantity_are_rejected() -> None:
    with pytest.raises(TypeError, match=r"one of .*x_in.*x_m"):
        tenths_of(x_in=1, x_m=1)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_rejected(value: float) -> None:
    with pytest.raises(ValueError, match=r"steering_deg .*finite"):
        tenths_of(steering_deg=value)


def test_points_have_one_unit() -> None:
    assert points_tenths([(1, 2), (-3, 0.5)], None) == (10, 20, -30, 5)
    assert points_tenths(None, [(0.0254, 0.254)]) == (10, 100)
    for both in ([(0, 0)], None):
        with pytest.raises(TypeError, match="one of them"):
            points_tenths(both, both)


def test_a_firing_order_is_filled_up_with_255() -> None:
    assert firing_order(range(16)) == tuple(range(16))
    assert firing_order([3, 0]) == (3, 0, *[255] * 14)
    assert firing_order(()) == (255,) * 16


@pytest.mark.parametrize("order", [[16], [-1], [255], [0] * 17])
def test_an_invalid_firing_order_is_rejected(order: list[int]) -> None:
    with pytest.raises(ValueError, match=r"at most 16"):
        firing_order(order)


def test_axis_commands_have_a_mode_and_tenths() -> None:
    assert AxisCommand() == (0, 0)
    assert AxisCommand.velocity(m_s=0.254) == (AxisMode.VELOCITY, 100)
    assert AxisCommand.velocity(in_s=-3) == (1, -30)
    assert AxisCommand.relative(by_rad=math.pi) == (AxisMode.RELATIVE, 1800)
    assert AxisCommand.relative(by_in=2) == AxisCommand.relative(by_m=0.0508)
    assert AxisCommand.limp() == (3, 0)
    assert AxisCommand.acceleration(deg_s2=50) == (4, 500)
    assert AxisCommand.speed(rad_s=math.pi / 4) == (5, 450)
    with pytest.raises(TypeError):
        AxisCommand.velocity(in_s=1, deg_s=1)
