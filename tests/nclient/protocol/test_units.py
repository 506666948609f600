"""Wire units against exact decimal arithmetic and the recorded volts' formula."""

from __future__ import annotations

import math
from decimal import ROUND_HALF_UP, Decimal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.protocol import types


@settings(max_examples=100)
@given(st.integers(-(10**7), 10**7))
def test_tenths_round_to_the_nearest_and_ties_away_from_zero(hundredths: int) -> None:
    # Decimal arithmetic has no binary rounding error; its ROUND_HALF_UP rounds ties away from zero.
    exact = Decimal(hundredths).scaleb(-1).quantize(Decimal(1), ROUND_HALF_UP)
    assert types.tenths(hundredths / 100) == int(exact)


# -0.04 and 359.96 degrees round to 0 and 3600 tenths, and 3600 is shown as 0.
@pytest.mark.parametrize(("degrees", "tenths"), [(0, 0), (90, 900), (-90, 2700), (360, 0), (-0.04, 0), (359.96, 0)])
def test_a_heading_is_0_to_3599(degrees: float, tenths: int) -> None:
    assert types.heading_tenths(math.radians(degrees)) == tenths


@settings(max_examples=50)
@given(st.integers(-36000, 36000))
def test_tenths_to_radians_and_back(tenths: int) -> None:
    assert types.tenths_from_rad(types.rad_from_tenths(tenths)) == tenths
    assert types.rad_from_tenths(tenths) == pytest.approx(tenths * math.pi / 1800, abs=1e-12)


@pytest.mark.parametrize("full_range_v", [types.CPU_RANGE_V, types.MOTOR_RANGE_V])
def test_volts_of_every_byte_and_back(full_range_v: float) -> None:
    # (2 + 3 r / 255) x range / 5: 2/5 of the range for the raw byte 0, all of it for 255.
    assert types.volts(0, full_range_v) == pytest.approx(0.4 * full_range_v)
    assert types.volts(255, full_range_v) == pytest.approx(full_range_v)
    assert [types.raw_volts(types.volts(raw, full_range_v), full_range_v) for raw in range(256)] == list(range(256))
    assert types.raw_volts(0.0, full_range_v) == 0
    assert types.raw_volts(99.0, full_range_v) == 255


@given(st.integers(-(2**40), 2**40))
def test_words_are_clamped_or_go_round(value: int) -> None:
    clamped, wrapped = types.clamp_word(value), types.wrap_word(value)
    assert -(2**31) <= clamped < 2**31
    assert clamped == value or abs(value) >= 2**31
    # The oracle takes the lowest 32 bits as two's complement.
    assert int.from_bytes((value % 2**32).to_bytes(4, "big"), "big", signed=True) == wrapped
    assert types.unwrap_word(wrapped) == value % 2**32
