"""The pieces of messages on their own: sign-magnitude, halves of bytes, bumper bytes, lasers, what cannot be."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from construct import ConstructError, FormatFieldError, StreamError
from hypothesis import given, settings

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.layouts import (
    BYTES,
    LINE_LONG,
    LINE_SIGNED,
    BumperBytes,
    LineLaser,
    LineNibbles,
    LineSlots,
    LineStamps,
)
from nclient.protocol.replies import Reply, TcpLayout
from nclient.protocol.types import (
    EVERYTHING,
    LASER_SLOT,
    N150,
    N200,
    NO_STAMP,
    SCOUT,
    Mask,
    Model,
    Position,
    Stamp,
    WireState,
    serial_wire_state,
    tcp_wire_state,
)
from tests.nclient.protocol.strategies import masks, signed16, word

STAMP = Stamp(-1, 2, -3, 4, -5, 6, -7, 2**32 - 1, 9)
quick = settings(max_examples=40)


def terms_with(*slots: int, position: int = 0) -> WireState:
    # A N200 is the only model with a mask that can be set.
    wire_state = serial_wire_state(N200)
    wire_state.set_mask(Mask((position, *[int(k in slots) for k in range(1, 44)])))
    return wire_state


@pytest.mark.parametrize(("value", "wire"), [
    # The top bit of the second byte is the sign: 0x8000 + 50 = 0x8032, low byte first, is "3280".
    (0, "0000"), (1, "0100"), (-1, "0180"), (-50, "3280"), (450, "c201"), (32767, "ff7f"), (-32767, "ffff"),
])
def test_sign_magnitude_low_byte_first(value: int, wire: str) -> None:
    assert LINE_SIGNED.build(value).hex() == wire
    assert LINE_SIGNED.parse(bytes.fromhex(wire)) == value


def test_minus_nothing_reads_nothing() -> None:
    # "Minus zero": the sign bit alone.
    assert LINE_SIGNED.parse(b"\x00\x80") == 0
    assert LINE_LONG.parse(b"\x00\x00\x00\x80") == 0


@quick
@given(signed16, word.filter(lambda value: value != -(2**31)))
def test_sign_magnitude_in_both_directions(short: int, long: int) -> None:
    assert LINE_SIGNED.parse(LINE_SIGNED.build(short)) == short
    assert LINE_LONG.parse(LINE_LONG.build(long)) == long
    # Bit 31, the top bit of the fourth byte, is set exactly for negative numbers.
    assert LINE_LONG.build(long)[3] >> 7 == (long < 0)


@pytest.mark.parametrize("value", [32768, -32768, 40000, 10**9])
def test_numbers_too_big_for_sign_magnitude(value: int) -> None:
    with pytest.raises(FormatFieldError, match=f"{value} does not fit"):
        LINE_SIGNED.build(value)


TCP = tcp_wire_state(N200)


def layout_of(**parts: Any) -> TcpLayout:
    """Return a layout of these parts alone."""
    return TcpLayout("part", **parts)


def test_words_are_counted() -> None:
    # A payload is a whole number of words of 4 bytes: 6 bytes are none, and 4 and 12 bytes are not two words.
    assert codec.parse_tcp_payload(layout_of(values=None), b"", TCP).values == ()
    for layout, size in ((layout_of(values=None), 6), (layout_of(values=2), 4), (layout_of(values=2), 12)):
        with pytest.raises(WireError, match=f"{size} bytes"):
            codec.parse_tcp_payload(layout, bytes(size), TCP)
    with pytest.raises(WireError, match=r"2 words.*, 1"):
        codec.build_tcp_payload(layout_of(values=2), Reply("part", values=(1,)), TCP)
    with pytest.raises(WireError, match="not 2147483648"):
        codec.build_tcp_payload(layout_of(values=1), Reply("part", values=(2**31,)), TCP)


def test_slots_over_tcp_default_to_0() -> None:
    layout = layout_of(slots=range(34, 37))
    assert codec.build_tcp_payload(layout, Reply("part", {35: -2}), TCP) == struct.pack(">3i", 0, -2, 0)
    assert codec.parse_tcp_payload(layout, struct.pack(">3i", 7, 8, 9), TCP).slots == {34: 7, 35: 8, 36: 9}
    with pytest.raises(WireError, match="not 2147483648"):
        codec.build_tcp_payload(layout, Reply("part", {35: 2**31}), TCP)


@quick
@given(masks)
def test_stamps_over_tcp_follow_the_position_bits_alone(mask: Mask) -> None:
    wire_state, layout = tcp_wire_state(N200), layout_of(stamps=tuple(Position))
    wire_state.set_mask(mask)
    # Sensors with a stamp for each position-data bit; a stamp is 9 words, which are 36 bytes.
    sensors = {1: 16, 2: 16, 4: 1, 8: 1, 16: 1}
    expected = sum(count for bit, count in sensors.items() if mask.position & bit)
    built = codec.build_tcp_payload(layout, Reply("part", stamps={"sonar_3": STAMP}), wire_state)
    assert len(built) == 36 * expected
    parsed = codec.parse_tcp_payload(layout, built, wire_state).stamps
    assert parsed.get("sonar_3", STAMP) == STAMP
    assert all(stamp == NO_STAMP for name, stamp in parsed.items() if name != "sonar_3")


def test_stamps_of_one_kind_of_sensor() -> None:
    wire_state = tcp_wire_state(N200)
    # The mask allows more stamps than a reply has: get_cp and get_sn carry those of their own sensor only.
    wire_state.set_mask(EVERYTHING.with_position(Position.COMPASS | Position.BUMPER))
    compass, sonar = layout_of(stamps=(Position.COMPASS,)), layout_of(stamps=(Position.SONAR,))
    assert list(codec.parse_tcp_payload(compass, bytes(36), wire_state).stamps) == ["compass"]
    assert codec.parse_tcp_payload(sonar, b"", wire_state).stamps == {}


@pytest.mark.parametrize("count", [-1, 483, 2**31 - 1])
def test_a_laser_over_tcp_has_0_to_482_readings(count: int) -> None:
    layout = layout_of(laser_width=lambda _: 2)
    with pytest.raises(WireError, match=f"not {count}"):
        # The count alone decides: it is checked before the readings, so that a large one reserves no memory.
        codec.parse_tcp_payload(layout, struct.pack(">i", count) + bytes(16), TCP)
    with pytest.raises(WireError, match=f"not {count}"):
        codec.build_tcp_payload(layout, Reply("part", laser=(count, 1, 2)), TCP)


def test_a_laser_vector_has_as_many_numbers_as_it_says() -> None:
    # Initially the laser is in point mode 51: 2 words a reading.
    layout = layout_of(laser_width=lambda wire_state: wire_state.laser_width)
    assert codec.build_tcp_payload(layout, Reply("part"), TCP) == bytes(4)
    data = codec.build_tcp_payload(layout, Reply("part", laser=(2, 1, -2, 3, -4)), TCP)
    assert codec.parse_tcp_payload(layout, data, TCP).laser == (2, 1, -2, 3, -4)
    with pytest.raises(WireError, match=r" 4 numbers .*not 3"):
        codec.build_tcp_payload(layout, Reply("part", laser=(2, 1, 2, 3)), TCP)
    # Two points are 4 words, but only 3 follow the count.
    with pytest.raises(WireError, match="16 bytes"):
        codec.parse_tcp_payload(layout, struct.pack(">4i", 2, 1, 2, 3), TCP)


def test_infrareds_are_packed_low_half_first_and_padded() -> None:
    # Slots 2, 5, 16 are on: 0xA fills the low half of byte 0, 0xB the high half, 0xC the low half of byte 1. Slot 3
    # is off.
    nibbles = LineNibbles(1, 16)
    wire_state = terms_with(2, 5, 16)
    assert nibbles.build({2: 0xA, 5: 0xB, 16: 0xC, 3: 9}, wire_state=wire_state).hex() == "ba0c"
    # The last high half is padding: its value, here 0xF, is ignored.
    assert nibbles.parse(bytes.fromhex("bafc"), wire_state=wire_state) == {2: 0xA, 5: 0xB, 16: 0xC}
    # The reply to get_ir always carries all 16: 8 bytes.
    assert len(LineNibbles(1, 16, masked=False).build({}, wire_state=wire_state)) == 8


def test_slots_on_the_line_follow_the_mask() -> None:
    slots = LineSlots(17, 32, BYTES)
    # Slots 17 and 32 are on: the value of slot 20 is not sent.
    assert slots.build({17: 1, 20: 2, 32: 3}, wire_state=terms_with(17, 32)) == b"\x01\x03"
    assert slots.parse(b"\x05", wire_state=terms_with(20)) == {20: 5}
    with pytest.raises(ConstructError):
        slots.build({20: 256}, wire_state=terms_with(20))


# b2 + 256 b1 + 65536 b0 on N150 and N200, the reverse on the Scout.
@pytest.mark.parametrize(("model", "wire"), [(N150, "563412"), (N200, "563412"), (SCOUT, "123456")])
def test_bumper_bytes_in_the_order_of_the_model(model: Model, wire: str) -> None:
    assert BumperBytes(33).build({33: 0x563412}, wire_state=serial_wire_state(model)).hex() == wire
    assert BumperBytes(33).parse(bytes.fromhex(wire), wire_state=serial_wire_state(model)) == {33: 0x563412}


def test_serial_stamps_are_sign_magnitude_and_masked() -> None:
    in_packet, in_answer = LineStamps(Position.SONAR, range(17, 33)), LineStamps(Position.SONAR)
    # Sonars 0 and 3 are on: two stamps, of which the first is 36 zero bytes.
    wire_state = terms_with(17, 20, position=2)
    built = in_packet.build({"sonar_3": STAMP}, wire_state=wire_state)
    # Seven words of pose and velocities: the sign is bit 31. Two unsigned words of times.
    assert built == bytes(36) + bytes.fromhex(
        "01000080 02000000 03000080 04000000 05000080 06000000 07000080 ffffffff 09000000"
    )
    assert in_packet.parse(built, wire_state=wire_state) == {"sonar_0": NO_STAMP, "sonar_3": STAMP}
    # The reply to get_sn has all 16 stamps, whatever the mask.
    assert len(in_answer.build({}, wire_state=wire_state)) == 16 * 36
    # Position bits 29 = 1 + 4 + 8 + 16: all except the sonars' bit, 2.
    assert in_packet.build({"sonar_3": STAMP}, wire_state=terms_with(17, position=29)) == b""


def test_a_laser_on_the_line() -> None:
    lines, pixels = LineLaser(lambda _: 4, masked_by=LASER_SLOT), LineLaser(lambda _: 1)
    seen, unseen = terms_with(42), terms_with(41)
    # A count of 1, then one line of four numbers: -1, 2, -3, 4.
    assert lines.build((1, -1, 2, -3, 4), wire_state=seen).hex() == "0100" "0180" "0200" "0380" "0400"
    assert lines.parse(bytes.fromhex("0100" "0180" "0200" "0380" "0400"), wire_state=seen) == (1, -1, 2, -3, 4)
    assert lines.build((1, -1, 2, -3, 4), wire_state=unseen) == b""
    assert lines.parse(b"", wire_state=unseen) is None
    # A robot without readings sends the count 0.
    assert lines.build(None, wire_state=seen) == b"\0\0"
    # Pixels are unsigned: 0x8001 is 32769, and not -1.
    assert pixels.parse(bytes.fromhex("0200" "ffff" "0180"), wire_state=unseen) == (2, 65535, 32769)
    # 0x01e3 = 483, one more than the camera has columns, with 483 x 2 bytes behind it.
    with pytest.raises(StreamError, match="not 483"):
        pixels.parse(b"\xe3\x01" + bytes(966), wire_state=unseen)
    with pytest.raises(FormatFieldError, match="vector of 2"):
        pixels.build((2, 1), wire_state=unseen)
