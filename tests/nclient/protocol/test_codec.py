"""Every row of the table in every language: calls come back from their bytes, and no bytes break it."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import codec, serial_framing
from nclient.protocol.codec import TcpFrame
from nclient.protocol.commands import BY_TCP_TYPE, Call, Command
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFrame
from nclient.protocol.types import MODELS, N150, N200, Mask, Model, serial_wire_state, tcp_wire_state
from tests.nclient.protocol.strategies import LINE_CASE_NAMES, LINE_CASES, TCP_ROWS, calls

quick = settings(max_examples=8)


@pytest.mark.parametrize("row", TCP_ROWS, ids=lambda row: row.name)
@quick
@given(data=st.data())
def test_calls_over_tcp_come_back_from_their_bytes(row: Command, data: st.DataObject) -> None:
    call = data.draw(calls(row, line=False))
    wide = data.draw(st.booleans())
    built = codec.encode_tcp_request(call, wide=wide)
    frame = codec.parse_single_frame(built, codec.request_bounds, wide)
    assert codec.decode_tcp_request(frame) == call
    # A header of 4 bytes, and 4 or 8 bytes for each word of a 32-bit or 64-bit client.
    assert len(built) == 4 + len(frame.payload) * (1 + wide)


@pytest.mark.parametrize(("row", "model"), LINE_CASES, ids=LINE_CASE_NAMES)
@quick
@given(data=st.data())
def test_calls_on_the_line_come_back_from_their_bytes(row: Command, model: Model, data: st.DataObject) -> None:
    call = data.draw(calls(row, line=True))
    wire_state = serial_wire_state(model)
    built = codec.encode_serial_request(call, wire_state)
    assert len(built) <= HOST_LIMIT
    assert codec.decode_serial_request(serial_framing.parse_single_frame(built), wire_state) == call


@settings(max_examples=120)
# Random words are seldom a valid call; those that are must come back from their own bytes.
@given(st.sampled_from(sorted(BY_TCP_TYPE)), st.lists(st.integers(-(2**31), 2**31 - 1), max_size=20))
def test_any_words_are_a_call_or_a_wire_error(kind: int, words: list[int]) -> None:
    try:
        call = codec.decode_tcp_request(TcpFrame(kind, struct.pack(f">{len(words)}i", *words)))
    except WireError:
        return
    codec.update_from_request(call, tcp_wire_state(N150))
    # The words may differ from the original ones: flags are normalized, and unused words are not stored.
    again = codec.encode_tcp_request(call)
    assert codec.decode_tcp_request(TcpFrame(kind, again[4:])) == call


@settings(max_examples=120)
@given(st.integers(0, 255), st.binary(max_size=40), st.sampled_from(sorted(MODELS)))
def test_any_bytes_on_the_line_are_a_call_or_a_wire_error(kind: int, data: bytes, model: str) -> None:
    wire_state = serial_wire_state(MODELS[model])
    try:
        call = codec.decode_serial_request(SerialFrame(kind, data), wire_state)
    except WireError:
        return
    again = codec.encode_serial_request(call, wire_state)
    assert codec.decode_serial_request(SerialFrame(kind, again[4:-2]), wire_state) == call


@pytest.mark.parametrize("payload", [b"", b"\0" * 3, b"\0" * 12])
def test_payloads_that_no_framer_lets_through(payload: bytes) -> None:
    for kind in (*BY_TCP_TYPE, 9999):
        if kind == 9999:
            with pytest.raises(WireError, match="message type 9999"):
                codec.decode_tcp_request(TcpFrame(kind, payload))
        # Three zero words are a valid payload for a command of at most 3 words; all longer commands refuse them.
        elif BY_TCP_TYPE[kind].tcp_words[0] > 3:
            with pytest.raises(WireError):
                codec.decode_tcp_request(TcpFrame(kind, payload))


# 0, 99, 255: no command. 4: pa of a N200. 8: NAK, which is a reply and no request.
@pytest.mark.parametrize("kind", [0, 4, 8, 99, 255])
def test_types_that_an_n150_does_not_have(kind: int) -> None:
    with pytest.raises(WireError, match=f"type {kind} .* n150"):
        codec.decode_serial_request(SerialFrame(kind, b""), serial_wire_state(N150))
    if kind != 8:
        with pytest.raises(WireError, match=f"answer of type {kind} .* n150"):
            codec.decode_serial_reply(SerialFrame(kind, b""), serial_wire_state(N150))


def test_a_mask_is_noted_by_both_ends_alike() -> None:
    call = Call("ct", (9, *[k % 2 for k in range(43)]))
    sender, taker = tcp_wire_state(N150), tcp_wire_state(N150)
    codec.update_from_request(call, sender)
    # The receiver knows only the bytes: `[4:]` leaves out the header.
    codec.update_from_request(codec.decode_tcp_request(TcpFrame(16, codec.encode_tcp_request(call)[4:])), taker)
    assert sender.mask == taker.mask == Mask(call.args)


def test_a_reply_of_any_type_answers_but_an_error_is_one() -> None:
    row = codec.find_command("get_rv")
    # 90 is the type that old servers send with accelerations; clients look at the type only for 91, the error.
    frame = TcpFrame(90, struct.pack(">3i", 1, -2, 3))
    assert codec.decode_tcp_reply(row, frame, tcp_wire_state(N150)).slots == {38: 1, 39: -2, 40: 3}
    error = codec.decode_tcp_reply(row, TcpFrame(91, struct.pack(">i", 4)), tcp_wire_state(N150))
    assert (error.kind, error.values) == ("error", (4,))


@pytest.mark.parametrize(("call", "reported"), [
    # A word is 32 bits, signed: 2^31 is the first number above it.
    (Call("pr", (1, 2, 2**31)), "pr(1, 2, 2147483648): a word is a whole number, -2^31 to 2^31 - 1, not 2147483648"),
    (Call("pr", (-(2**31) - 1, 2, 3)), "pr(-2147483649, 2, 3): a word is a whole number, -2^31 to 2^31 - 1, not "
     "-2147483649"),
    (Call("vm", (1.5, 0, 0)), "vm(1.5, 0, 0): a word is a whole number, -2^31 to 2^31 - 1, not 1.5"),
    (Call("motion_check", ()), "motion_check(): motion_check takes type 0 (line) or 1 (arc) first"),
])
def test_arguments_that_cannot_be_sent_raise_wire_error(call: Call, reported: str) -> None:
    with pytest.raises(WireError) as refused:
        codec.encode_tcp_request(call)
    assert str(refused.value) == reported


def test_what_cannot_be_sent_on_the_line_names_the_number() -> None:
    with pytest.raises(WireError) as refused:
        codec.encode_serial_request(Call("ws", (1, 1, 1, 300)), serial_wire_state(N200))
    assert str(refused.value).startswith("ws(1, 1, 1, 300): timeout_s: ")
