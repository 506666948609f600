"""Every reply layout under any terms: built, parsed, compared by field, built again, and its length counted apart."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import (
    codec,
    serial_framing,
    tcp_framing,
)
from nclient.protocol import replies as shape
from nclient.protocol.commands import BY_LINE_TYPE, BY_NAME, MAX_REPLY_WORDS, REPLY_TYPES, Command
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import ROBOT_LIMIT, SerialFrame
from nclient.protocol.types import MODELS, N150, N200, NO_STAMP, Model
from nclient.protocol.wire_state import Terms, line_terms, tcp_terms
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
_TCP_VALUES = {"prediction": 44, "simple": 1, "truth": 8, "control": 4, "configuration": 4, "special": 9}
_LINE_LASERS = {"get_sg": 4, "get_ls": 1}


def check_carried(parsed: Reply, sent: Reply) -> None:
    """What a layout carries arrives as it was sent; what it does not carry is not invented."""
    assert dict(parsed.slots).items() <= dict(sent.slots).items()
    assert dict(parsed.stamps).items() <= dict(sent.stamps).items()
    for mine, theirs in ((parsed.laser, sent.laser), (parsed.clock, sent.clock), (parsed.volts, sent.volts)):
        assert mine in (None, theirs)
    assert parsed.values in ((), sent.values)


def tcp_width(row: Command, terms: Terms) -> int:
    return {"get_sg": 4, "get_ls": terms.get_laser_width}.get(row.name, terms.laser_width)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("row", [row for row in TCP_ROWS if row.has_tcp_reply], ids=lambda row: row.name)
@quick
@given(data=st.data())
def test_the_reply_to_every_command_over_tcp(row: Command, wide: bool, data: st.DataObject) -> None:
    terms = data.draw(tcp_agreements(wide))
    kind = row.tcp_reply.kind
    count = 4 if row.tcp_reply is shape.COLLISION else _TCP_VALUES.get(kind, 0)
    sent = tcp_reply_of(kind, data.draw(seeds), (data.draw(laser_counts), tcp_width(row, terms)), count)
    built = codec.tcp_reply(row, sent, terms)
    frame = tcp_framing.only_frame(built, tcp_framing.reply_bounds, wide)
    parsed = codec.read_tcp_reply(row, frame, terms)
    assert frame.type == REPLY_TYPES[row.tcp_reply]
    check_carried(parsed, sent)
    assert parsed.slots or parsed.laser or parsed.values
    assert codec.tcp_reply(row, parsed, terms) == built


@settings(max_examples=30)
@given(tcp_agreements(wide=False), seeds, laser_counts)
def test_a_state_reply_over_tcp_is_as_long_as_documented(terms: Terms, seed: int, count: int) -> None:
    sent = tcp_reply_of("state", seed, (count, terms.laser_width), 0)
    payload = shape.STATE.build(sent, terms)
    sensors = {1: 16, 2: 16, 4: 1, 8: 1, 16: 1}
    stamps = sum(n for bit, n in sensors.items() if terms.mask.position & bit)
    assert len(payload) == 4 * (45 + 1 + count * terms.laser_width + 9 * stamps + 3)
    parsed = shape.STATE.parse(payload, terms)
    assert parsed.slots == sent.slots
    assert (parsed.laser, parsed.clock, parsed.volts) == (sent.laser, sent.clock, sent.volts)
    assert list(parsed.stamps) == [name for name in ALL_STAMPS if name in parsed.stamps]
    assert len(parsed.stamps) == stamps


@pytest.mark.parametrize(("row", "model"), LINE_CASES, ids=LINE_CASE_NAMES)
@quick
@given(data=st.data())
def test_the_reply_to_every_command_on_the_line(row: Command, model: Model, data: st.DataObject) -> None:
    terms = data.draw(line_agreements(model))
    kind = row.line_reply.kind
    width = _LINE_LASERS.get(row.name, 4 if terms.laser_mode & 0x1E == 0 else 1)
    values = {"special": 12}.get(kind, 3 if row.name == "conf_cp" else 0)
    signed = row.name != "get_cp"
    sent = line_reply_of(kind, data.draw(seeds), (data.draw(laser_counts), width), values, signed)
    built = codec.line_reply(row, sent, terms)
    parsed = codec.read_line_reply(serial_framing.only_frame(built), terms)
    check_carried(parsed, sent)
    assert parsed.slots or parsed.laser or parsed.values or row.name == "get_ra"
    assert codec.line_reply(BY_NAME[row.name], parsed, terms) == built


@settings(max_examples=40)
@given(line_agreements(N200), seeds, laser_counts)
def test_a_state_packet_holds_what_the_mask_allows(terms: Terms, seed: int, count: int) -> None:
    width = 4 if terms.laser_mode & 0x1E == 0 else 1
    data = shape.LINE_STATE.build(line_reply_of("state", seed, (count, width), 0, True), terms)
    on, position = terms.mask.smask, terms.mask.position
    infrareds, sonars = sum(on[1:17]), sum(on[17:33])
    stamps = (
        infrareds * (position & 1) + sonars * (position >> 1 & 1) + on[33] * (position >> 2 & 1)
        + on[42] * (position >> 3 & 1) + on[43] * (position >> 4)
    )
    laser = on[42] * (2 + 2 * count * width)
    assert len(data) == (infrareds + 1) // 2 + sonars + 3 * on[33] + 2 * sum(on[34:41]) + 2 * on[43] + laser \
        + 36 * stamps + 1 + 4 + 2
    parsed = shape.LINE_STATE.parse(data, terms)
    assert set(parsed.slots) == {slot for slot in (*range(1, 41), 43) if on[slot]} | {41}
    assert (parsed.laser is None) == (not on[42])


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_the_packets_of_n150_and_scout_have_a_fixed_length(model: Model) -> None:
    size = len(shape.LINE_STATE.build(Reply("state"), line_terms(model)))
    assert size == {"n150": 42, "scout": 42, "n200": 52}[model.name]


def test_the_longest_replies_fit_the_bounds_of_the_framers() -> None:
    terms = tcp_terms(N200)
    terms.note_mask(FULL)
    terms.note_laser_mode(33)
    longest = shape.STATE.build(tcp_reply_of("state", 1, (482, 4), 0), terms)
    assert len(longest) == 4 * MAX_REPLY_WORDS[80]
    packet = shape.LINE_STATE.build(line_reply_of("state", 1, (482, 4), 0, True), terms)
    built = serial_framing.build_frame(7, packet)
    assert len(built) == ROBOT_LIMIT
    assert serial_framing.SerialFramer().receive(built) == [SerialFrame(7, packet)]


_FIXED_WORDS = {
    shape.INFRARED: 83, shape.SONAR: 84, shape.COMPASS: 86, shape.BUMPER: 87, shape.CONFIGURATION: 88,
    shape.VELOCITY: 89, shape.ERROR: 91, shape.TRUTH: 1000, shape.CONTROL: 1001,
}


@pytest.mark.parametrize(("layout", "kind"), _FIXED_WORDS.items(), ids=lambda value: str(getattr(value, "kind", value)))
def test_the_most_words_a_type_can_carry(layout: shape.ReplyShape, kind: int) -> None:
    terms = tcp_terms(N200)
    terms.note_mask(FULL)
    values = {"error": 1, "truth": 8, "control": 4}.get(layout.kind, 0)
    assert len(layout.build(tcp_reply_of(layout.kind, 3, (0, 1), values), terms)) == 4 * MAX_REPLY_WORDS[kind]


def test_what_is_not_given_is_sent_as_nothing() -> None:
    parsed = shape.STATE.parse(shape.STATE.build(Reply("state"), tcp_terms(N150)), tcp_terms(N150))
    assert set(parsed.slots.values()) == {0}
    assert (parsed.laser, parsed.clock, parsed.volts) == ((0,), 0, (0, 0))
    terms = tcp_terms(N150)
    terms.note_mask(FULL)
    assert set(shape.SONAR.parse(shape.SONAR.build(Reply("sonar"), terms), terms).stamps.values()) == {NO_STAMP}


@settings(max_examples=40)
@given(st.binary(max_size=300), st.sampled_from(sorted(REPLY_TYPES.values())), tcp_agreements(wide=False))
def test_any_bytes_are_a_reply_or_a_wire_error(data: bytes, kind: int, terms: Terms) -> None:
    for layout in (layout for layout, its_type in REPLY_TYPES.items() if its_type == kind):
        try:
            reply = layout.parse(data, terms)
        except WireError:
            continue
        assert layout.build(reply, terms) == data


@settings(max_examples=60)
@given(st.binary(max_size=200), st.sampled_from([row.line_type for row, _ in LINE_CASES]), line_agreements(N200))
def test_any_bytes_are_an_answer_on_the_line_or_a_wire_error(data: bytes, kind: int, terms: Terms) -> None:
    try:
        reply = codec.read_line_reply(SerialFrame(kind, data), terms)
    except WireError:
        return
    row = BY_LINE_TYPE.get(kind, BY_NAME["gs"])
    again = serial_framing.only_frame(codec.line_reply(row, reply, terms))
    assert codec.read_line_reply(again, terms) == reply


def test_truncated_and_overlong_replies() -> None:
    terms = tcp_terms(N150)
    payload = shape.STATE.build(Reply("state"), terms)
    for wrong in (payload[:-4], payload + bytes(4), payload[:100], b""):
        with pytest.raises(WireError, match="no state reply of this shape"):
            shape.STATE.parse(wrong, terms)


@pytest.mark.parametrize("reply", [
    Reply("state", slots={34: 2**31}), Reply("state", clock=-1), Reply("state", volts=(2**31, 0)),
    Reply("state", laser=(2, 1, 2, 3)), Reply("state", laser=(483,)),
])
def test_what_a_state_reply_cannot_carry(reply: Reply) -> None:
    with pytest.raises(WireError, match="a state reply cannot carry this"):
        shape.STATE.build(reply, tcp_terms(N150))


@pytest.mark.parametrize("reply", [
    Reply("state", slots={34: 32768}), Reply("state", slots={17: 256}), Reply("state", volts=(256, 0)),
    Reply("state", clock=2**32),
])
def test_what_a_state_packet_cannot_carry(reply: Reply) -> None:
    with pytest.raises(WireError, match="a state reply cannot carry this"):
        shape.LINE_STATE.build(reply, line_terms(N150))


def test_a_nak_and_an_error_go_by_their_own_layouts() -> None:
    nak = codec.line_reply(BY_NAME["vm"], Reply("nak"), line_terms(N150))
    assert nak.hex() == "010200080b5c"
    assert codec.read_line_reply(serial_framing.only_frame(nak), line_terms(N150)) == Reply("nak")
    error = codec.tcp_reply(BY_NAME["vm"], Reply("error", values=(4,)), tcp_terms(N150))
    assert error == struct.pack(">hHi", 91, 1, 4)
    with pytest.raises(WireError, match="no nak reply"):
        codec.read_line_reply(SerialFrame(8, b"\0"), line_terms(N150))


def test_a_row_without_a_line_has_no_answer_there() -> None:
    with pytest.raises(WireError, match="get_rpx does not exist on a robot's own line"):
        codec.line_reply(BY_NAME["get_rpx"], Reply("state"), line_terms(N200))
