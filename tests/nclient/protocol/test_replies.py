"""Every reply layout under any terms: built, parsed, compared by field, built again, and its length counted apart."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import codec, serial_framing
from nclient.protocol import replies as shape
from nclient.protocol.commands import BY_LINE_TYPE, BY_NAME, MAX_REPLY_WORDS, REPLY_TYPES, Command
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import ROBOT_LIMIT, SerialFrame
from nclient.protocol.types import MODELS, N150, N200, NO_STAMP, Model, WireState, serial_wire_state, tcp_wire_state
from tests.nclient.protocol.strategies import (
    ALL_STAMPS,
    FULL,
    LINE_CASE_NAMES,
    LINE_CASES,
    TCP_ROWS,
    laser_counts,
    line_agreements,
    line_reply_of,
    seeds,
    tcp_agreements,
    tcp_reply_of,
)

quick = settings(max_examples=6)
# Numbers of the replies that are not stored in State: 44 words of predict_sensors, 4 of get_robot_conf, and so on.
_TCP_VALUES = {"prediction": 44, "simple": 1, "truth": 8, "control": 4, "configuration": 4, "special": 9}
# These two replies have a fixed reading size, whatever the laser mode is.
_LINE_LASERS = {"get_sg": 4, "get_ls": 1}


def check_carried(parsed: Reply, sent: Reply) -> None:
    """Check that the values of a layout survive the round trip, and that others stay unset."""
    assert dict(parsed.slots).items() <= dict(sent.slots).items()
    assert dict(parsed.stamps).items() <= dict(sent.stamps).items()
    for mine, theirs in ((parsed.laser, sent.laser), (parsed.clock, sent.clock), (parsed.volts, sent.volts)):
        assert mine in (None, theirs)
    assert parsed.values in ((), sent.values)


def tcp_width(row: Command, wire_state: WireState) -> int:
    return {"get_sg": 4, "get_ls": wire_state.get_laser_width}.get(row.name, wire_state.laser_width)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("row", [row for row in TCP_ROWS if row.has_tcp_reply], ids=lambda row: row.name)
@quick
@given(data=st.data())
def test_the_reply_to_every_command_over_tcp(row: Command, wide: bool, data: st.DataObject) -> None:
    wire_state = data.draw(tcp_agreements(wide))
    kind = row.tcp_reply.kind
    count = 4 if row.tcp_reply is shape.COLLISION else _TCP_VALUES.get(kind, 0)
    sent = tcp_reply_of(kind, data.draw(seeds), (data.draw(laser_counts), tcp_width(row, wire_state)), count)
    built = codec.encode_tcp_reply(row, sent, wire_state)
    frame = codec.parse_single_frame(built, codec.reply_bounds, wide)
    parsed = codec.decode_tcp_reply(row, frame, wire_state)
    assert frame.type == REPLY_TYPES[row.tcp_reply]
    check_carried(parsed, sent)
    # A layout without any field would pass all comparisons.
    assert parsed.slots or parsed.laser or parsed.values
    assert codec.encode_tcp_reply(row, parsed, wire_state) == built


@settings(max_examples=30)
@given(tcp_agreements(wide=False), seeds, laser_counts)
def test_a_state_reply_over_tcp_is_as_long_as_documented(wire_state: WireState, seed: int, count: int) -> None:
    sent = tcp_reply_of("state", seed, (count, wire_state.laser_width), 0)
    payload = codec.build_tcp_payload(shape.STATE, sent, wire_state)
    # Stamps that each position-data bit adds.
    sensors = {1: 16, 2: 16, 4: 1, 8: 1, 16: 1}
    stamps = sum(n for bit, n in sensors.items() if wire_state.mask.position & bit)
    # State vector, count of readings, readings, stamps of 9 words, then clock and two voltages; 4 bytes each.
    assert len(payload) == 4 * (45 + 1 + count * wire_state.laser_width + 9 * stamps + 3)
    parsed = codec.parse_tcp_payload(shape.STATE, payload, wire_state)
    assert parsed.slots == sent.slots
    assert (parsed.laser, parsed.clock, parsed.volts) == (sent.laser, sent.clock, sent.volts)
    assert list(parsed.stamps) == [name for name in ALL_STAMPS if name in parsed.stamps]
    assert len(parsed.stamps) == stamps


@pytest.mark.parametrize(("row", "model"), LINE_CASES, ids=LINE_CASE_NAMES)
@quick
@given(data=st.data())
def test_the_reply_to_every_command_on_the_line(row: Command, model: Model, data: st.DataObject) -> None:
    wire_state = data.draw(line_agreements(model))
    kind = row.line_reply.kind
    # A line mode has the bits 1 to 4 clear: 4 numbers a reading; otherwise one pixel.
    width = _LINE_LASERS.get(row.name, 4 if wire_state.laser_mode & 0x1E == 0 else 1)
    values = {"special": 12}.get(kind, 3 if row.name == "conf_cp" else 0)
    # The compass of get_cp is unsigned, that of a state packet is signed.
    signed = row.name != "get_cp"
    sent = line_reply_of(kind, data.draw(seeds), (data.draw(laser_counts), width), values, signed)
    built = codec.encode_serial_reply(row, sent, wire_state)
    parsed = codec.decode_serial_reply(serial_framing.parse_single_frame(built), wire_state)
    check_carried(parsed, sent)
    # get_ra has an empty reply on the serial line.
    assert parsed.slots or parsed.laser or parsed.values or row.name == "get_ra"
    assert codec.encode_serial_reply(BY_NAME[row.name], parsed, wire_state) == built


@settings(max_examples=40)
@given(line_agreements(N200), seeds, laser_counts)
def test_a_state_packet_holds_what_the_mask_allows(wire_state: WireState, seed: int, count: int) -> None:
    width = 4 if wire_state.laser_mode & 0x1E == 0 else 1
    data = shape.LINE_STATE.build(line_reply_of("state", seed, (count, width), 0, True), wire_state)
    on, position = wire_state.mask.smask, wire_state.mask.position
    infrareds, sonars = sum(on[1:17]), sum(on[17:33])
    # On the serial line a stamp needs both the position-data bit and the sensor's own mask entry.
    stamps = (
        infrareds * (position & 1) + sonars * (position >> 1 & 1) + on[33] * (position >> 2 & 1)
        + on[42] * (position >> 3 & 1) + on[43] * (position >> 4)
    )
    laser = on[42] * (2 + 2 * count * width)
    # Half a byte an infrared, padded; a byte a sonar; 3 bumper bytes; int16 pose, velocities and compass; laser;
    # stamps; then motor status, clock (4) and two voltages.
    assert len(data) == (infrareds + 1) // 2 + sonars + 3 * on[33] + 2 * sum(on[34:41]) + 2 * on[43] + laser \
        + 36 * stamps + 1 + 4 + 2
    parsed = shape.LINE_STATE.parse(data, wire_state)
    assert set(parsed.slots) == {slot for slot in (*range(1, 41), 43) if on[slot]} | {41}
    assert (parsed.laser is None) == (not on[42])


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_the_packets_of_n150_and_scout_have_a_fixed_length(model: Model) -> None:
    size = len(shape.LINE_STATE.build(Reply("state"), serial_wire_state(model)))
    # 16 sonars + 3 bumper + 8 pose + 6 velocities + 2 compass + 1 motors + 4 clock + 2 volts = 42; a N200 has 8 bytes
    # of infrared and an empty laser's count of 2 more.
    assert size == {"n150": 42, "scout": 42, "n200": 52}[model.name]


def test_the_longest_replies_fit_the_bounds_of_the_framers() -> None:
    wire_state = tcp_wire_state(N200)
    wire_state.set_mask(FULL)
    wire_state.set_laser_mode(33)
    # 482 columns, each a line of four numbers, with all 35 stamps.
    longest = codec.build_tcp_payload(shape.STATE, tcp_reply_of("state", 1, (482, 4), 0), wire_state)
    assert len(longest) == 4 * MAX_REPLY_WORDS[80]
    packet = shape.LINE_STATE.build(line_reply_of("state", 1, (482, 4), 0, True), wire_state)
    built = serial_framing.build_frame(7, packet)
    assert len(built) == ROBOT_LIMIT
    assert serial_framing.SerialFramer().receive(built) == [SerialFrame(7, packet)]


# The message type of each layout without laser readings: position-data bits alone change its size.
_FIXED_WORDS = {
    shape.INFRARED: 83, shape.SONAR: 84, shape.COMPASS: 86, shape.BUMPER: 87, shape.CONFIGURATION: 88,
    shape.VELOCITY: 89, shape.ERROR: 91, shape.TRUTH: 1000, shape.CONTROL: 1001,
}


@pytest.mark.parametrize(("layout", "kind"), _FIXED_WORDS.items(), ids=lambda value: str(getattr(value, "kind", value)))
def test_the_most_words_a_type_can_carry(layout: shape.TcpLayout, kind: int) -> None:
    wire_state = tcp_wire_state(N200)
    wire_state.set_mask(FULL)
    values = {"error": 1, "truth": 8, "control": 4}.get(layout.kind, 0)
    payload = codec.build_tcp_payload(layout, tcp_reply_of(layout.kind, 3, (0, 1), values), wire_state)
    assert len(payload) == 4 * MAX_REPLY_WORDS[kind]


def test_what_is_not_given_is_sent_as_nothing() -> None:
    wire_state = tcp_wire_state(N150)
    payload = codec.build_tcp_payload(shape.STATE, Reply("state"), wire_state)
    parsed = codec.parse_tcp_payload(shape.STATE, payload, wire_state)
    # Over TCP all 45 slots are always sent.
    assert set(parsed.slots.values()) == {0}
    assert (parsed.laser, parsed.clock, parsed.volts) == ((0,), 0, (0, 0))
    wire_state.set_mask(FULL)
    data = codec.build_tcp_payload(shape.SONAR, Reply("sonar"), wire_state)
    assert set(codec.parse_tcp_payload(shape.SONAR, data, wire_state).stamps.values()) == {NO_STAMP}


@settings(max_examples=40)
@given(st.binary(max_size=300), st.sampled_from(sorted(REPLY_TYPES.values())), tcp_agreements(wide=False))
def test_any_bytes_are_a_reply_or_a_wire_error(data: bytes, kind: int, wire_state: WireState) -> None:
    for layout in (layout for layout, its_type in REPLY_TYPES.items() if its_type == kind):
        try:
            reply = codec.parse_tcp_payload(layout, data, wire_state)
        except WireError:
            continue
        # An accepted payload carries no byte that the reply does not have.
        assert codec.build_tcp_payload(layout, reply, wire_state) == data


@settings(max_examples=60)
@given(st.binary(max_size=200), st.sampled_from([row.line_type for row, _ in LINE_CASES]), line_agreements(N200))
def test_any_bytes_are_an_answer_on_the_line_or_a_wire_error(data: bytes, kind: int, wire_state: WireState) -> None:
    try:
        reply = codec.decode_serial_reply(SerialFrame(kind, data), wire_state)
    except WireError:
        return
    row = BY_LINE_TYPE.get(kind, BY_NAME["gs"])
    again = serial_framing.parse_single_frame(codec.encode_serial_reply(row, reply, wire_state))
    # Compared as replies: the padding of infrareds and a minus zero may differ in the bytes.
    assert codec.decode_serial_reply(again, wire_state) == reply


def test_truncated_and_overlong_replies() -> None:
    wire_state = tcp_wire_state(N150)
    payload = codec.build_tcp_payload(shape.STATE, Reply("state"), wire_state)
    # One word short, one word too long, not even a whole State vector, nothing.
    for wrong in (payload[:-4], payload + bytes(4), payload[:100], b""):
        with pytest.raises(WireError, match="no state reply"):
            codec.parse_tcp_payload(shape.STATE, wrong, wire_state)


@pytest.mark.parametrize("reply", [
    Reply("state", slots={34: 2**31}), Reply("state", clock=-1), Reply("state", volts=(2**31, 0)),
    Reply("state", laser=(2, 1, 2, 3)), Reply("state", laser=(483,)),
])
def test_what_a_state_reply_cannot_carry(reply: Reply) -> None:
    with pytest.raises(WireError, match="reply cannot carry"):
        codec.build_tcp_payload(shape.STATE, reply, tcp_wire_state(N150))


@pytest.mark.parametrize("reply", [
    Reply("state", slots={34: 32768}), Reply("state", slots={17: 256}), Reply("state", volts=(256, 0)),
    Reply("state", clock=2**32),
])
def test_what_a_state_packet_cannot_carry(reply: Reply) -> None:
    with pytest.raises(WireError, match="reply cannot carry"):
        shape.LINE_STATE.build(reply, serial_wire_state(N150))


def test_a_nak_and_an_error_go_by_their_own_layouts() -> None:
    nak = codec.encode_serial_reply(BY_NAME["vm"], Reply("nak"), serial_wire_state(N150))
    # Length 2 (type and checksum), type 8; 0x01 + 0x02 + 0x08 = 0x0b.
    assert nak.hex() == "010200080b5c"
    assert codec.decode_serial_reply(serial_framing.parse_single_frame(nak), serial_wire_state(N150)) == Reply("nak")
    # Type 91, one word: the code 4.
    error = codec.encode_tcp_reply(BY_NAME["vm"], Reply("error", values=(4,)), tcp_wire_state(N150))
    assert error == struct.pack(">hHi", 91, 1, 4)
    with pytest.raises(WireError, match="no nak reply"):
        codec.decode_serial_reply(SerialFrame(8, b"\0"), serial_wire_state(N150))


def test_a_row_without_a_line_has_no_answer_there() -> None:
    with pytest.raises(WireError, match=r"get_rpx .*own line"):
        codec.encode_serial_reply(BY_NAME["get_rpx"], Reply("state"), serial_wire_state(N200))
