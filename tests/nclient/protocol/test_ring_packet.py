"""The ring packet: readings to bytes and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol.client_state import pack_ring, parse_ring
from nclient.protocol.layouts import MAX_PACKET_DATA
from worlds.rings import MAX_SONARS


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 480_000), max_size=MAX_SONARS))
def test_readings_survive_the_packet(clock_ms: int, thousandths: list[int]) -> None:
    data = pack_ring(clock_ms, [number / 1000 for number in thousandths])
    assert len(data) <= MAX_PACKET_DATA
    readings = parse_ring(data)
    assert readings.clock_s == clock_ms / 1000
    assert readings.readings_in == tuple(number / 1000 for number in thousandths)


# 0x01020304 ms low byte first, 2 readings, 1500 = 0x0005dc and 255000 = 0x03e418 thousandths of an inch.
def test_low_bytes_come_first() -> None:
    assert pack_ring(0x01020304, [1.5, 255]) == bytes.fromhex("04030201 02 dc0500 18e403")


# Nothing; no whole clock; a count of 2 with one reading; a count of 0 with one byte too many.
@pytest.mark.parametrize("data", ["", "0403", "04030201 02 dc0500", "04030201 00 00"])
def test_other_data_are_refused(data: str) -> None:
    with pytest.raises(WireError, match="bytes"):
        parse_ring(bytes.fromhex(data))
