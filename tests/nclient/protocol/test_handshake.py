"""The eleven bare bytes of a N200 on TCP, against bit positions written down by hand."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol.client_state import HANDSHAKE_SIZE, Handshake, apply_handshake, build_handshake, read_handshake
from nclient.protocol.types import N200, Mask, serial_wire_state
from tests.nclient.protocol.strategies import line_masks


def test_where_the_bits_are() -> None:
    # b0 = 01: slot 1; b2 = 80: slot 24; b4 = 02: slot 34; then compass (43) and 25 = laser (42) + 2 x 18; mode 21 =
    # 33. Smask[41] is not sent and reads 1.
    found = read_handshake(bytes.fromhex("01 00 80 00 02" "01" "25" "21" "aabbcc"))
    assert [slot for slot in range(1, 44) if found.mask.has(slot)] == [1, 24, 34, 41, 42, 43]
    # 18 = 2 + 16: position data of sonars and compass.
    assert (found.mask.position, found.laser_mode) == (18, 33)
    # Only bit 0 of the compass byte counts: fe is "off".
    without = read_handshake(bytes.fromhex("00 00 00 00 00" "fe" "00" "00" "000000"))
    assert [slot for slot in range(1, 44) if without.mask.has(slot)] == [41]


@settings(max_examples=40)
@given(line_masks, st.integers(0, 255))
def test_hellos_come_back_from_their_bytes(mask: Mask, mode: int) -> None:
    built = build_handshake(Handshake(mask, mode))
    assert len(built) == HANDSHAKE_SIZE
    assert read_handshake(built) == Handshake(mask, mode)


def test_the_host_adopts_mask_and_mode() -> None:
    wire_state = serial_wire_state(N200)
    mask = wire_state.mask.with_position(4)
    apply_handshake(Handshake(mask, 33), wire_state)
    assert (wire_state.mask, wire_state.laser_mode, wire_state.laser_width) == (mask, 33, 4)


@pytest.mark.parametrize("size", [0, 10, 12])
def test_no_other_number_of_bytes(size: int) -> None:
    with pytest.raises(WireError, match=f"11 bytes, not {size}"):
        read_handshake(bytes(size))


def test_a_mode_that_is_no_byte() -> None:
    with pytest.raises(WireError, match="hello cannot carry"):
        build_handshake(Handshake(serial_wire_state(N200).mask, 256))
