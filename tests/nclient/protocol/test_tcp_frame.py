"""Messages out of a TCP stream: good ones in any cuts, bad ones passed over, bounded and counted."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol.codec import (
    UNKNOWN_TYPE,
    WRONG_COUNT,
    Bounds,
    InvalidFrame,
    TcpFrame,
    TcpFramer,
    build_frame,
    parse_single_frame,
    reply_bounds,
    request_bounds,
)
from nclient.protocol.commands import BY_TCP_TYPE, MAX_REPLY_WORDS
from tests.nclient.protocol.strategies import cuts, in_pieces

quick = settings(max_examples=60)
GS = build_frame(15, b"")
VM = build_frame(12, struct.pack(">3i", 100, -50, 0))
# robot_id 1 and the process number of the client.
CONNECT = struct.pack(">2i", 1, 4711)


def sized(kind: int, bounds: Bounds) -> st.SearchStrategy[TcpFrame]:
    fewest, most = bounds(kind) or (0, 0)
    # At most 12 words more than the minimum: large frames would make the examples slow and find nothing else.
    counts = st.integers(fewest, min(most, fewest + 12))
    return counts.flatmap(lambda n: st.binary(min_size=4 * n, max_size=4 * n)).map(lambda data: TcpFrame(kind, data))


requests = st.lists(st.sampled_from(sorted(BY_TCP_TYPE)).flatmap(lambda kind: sized(kind, request_bounds)), max_size=6)
answers = st.lists(st.sampled_from(sorted(MAX_REPLY_WORDS)).flatmap(lambda kind: sized(kind, reply_bounds)), max_size=6)


def accounted(framer: TcpFramer, found: list[TcpFrame | InvalidFrame]) -> int:
    good = [frame for frame in found if isinstance(frame, TcpFrame)]
    assert framer.frames == len(good)
    # A 64-bit client sends 8 bytes for each word, and a header of 4 bytes as others do.
    factor = 2 if framer.wide else 1
    return sum(4 + factor * len(frame.payload) for frame in good) + framer.skipped_bytes + framer.pending


@quick
@given(requests, cuts, st.booleans())
def test_requests_in_any_cuts(sent: list[TcpFrame], places: list[int], wide: bool) -> None:
    framer = TcpFramer(request_bounds, wide=wide)
    stream = b"".join(build_frame(*frame, wide=wide) for frame in sent)
    found = [frame for piece in in_pieces(stream, places) for frame in framer.receive(piece)]
    assert found == sent
    assert (framer.pending, framer.skipped_bytes) == (0, 0)


@quick
@given(answers, st.booleans())
def test_replies_byte_by_byte(sent: list[TcpFrame], wide: bool) -> None:
    framer = TcpFramer(reply_bounds, wide=wide)
    stream = b"".join(build_frame(*frame, wide=wide, reply=True) for frame in sent)
    assert [frame for byte in stream for frame in framer.receive(bytes((byte,)))] == sent


@quick
# Noise, whole frames, and a frame of 16 bytes that is cut off after 9.
@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from((GS, VM, VM[:9]))), max_size=8),
       st.sampled_from((request_bounds, reply_bounds)), st.sampled_from((None, False, True)))
def test_whatever_comes_every_byte_is_accounted_for(pieces: list[bytes], bounds: Bounds, wide: bool | None) -> None:
    framer = TcpFramer(bounds, wide)
    found = [frame for piece in pieces for frame in framer.receive(piece)]
    assert accounted(framer, found) == sum(map(len, pieces))


@pytest.mark.long
# A type of a fixed length, an unknown type, and a type of a variable length.
@pytest.mark.parametrize("kind", [12, 9999, 300])
def test_a_count_of_65535_never_makes_the_buffer_grow(kind: int) -> None:
    framer = TcpFramer(request_bounds)
    # The count is far above the limits of its type, so that no payload is awaited: synchronisation is lost.
    (refused,) = framer.receive(struct.pack(">hH", kind, 65535))
    assert isinstance(refused, InvalidFrame)
    assert refused.fatal
    # 0xffff is no type: the search goes on byte by byte, and needs at most 3 bytes of an incomplete header.
    for _ in range(20):
        assert framer.receive(b"\xff" * 500) == []
        assert framer.pending < 4
    assert framer.skipped_bytes + framer.pending == 4 + 10000


def test_unknown_types_and_wrong_counts_are_passed_over_whole() -> None:
    framer = TcpFramer(request_bounds)
    # Type 9999 is unknown. Its count of 3 words gives its size, 4 + 12 bytes, whatever the payload is.
    unknown = struct.pack(">hH", 9999, 3) + VM
    too_few = build_frame(12, bytes(8))
    found = framer.receive(unknown[:16] + too_few + build_frame(300, bytes(8)) + GS)
    assert found == [
        # Only the good frame behind them is returned as a frame, and no search through their payload takes place.
        InvalidFrame(UNKNOWN_TYPE, "unknown message type 9999", False),
        InvalidFrame(WRONG_COUNT, "type 12 takes 3 words, not 2", False),
        InvalidFrame(WRONG_COUNT, "type 300 takes 4 to 254 words, not 2", False),
        TcpFrame(15, b""),
    ]
    # The unknown message of 16 bytes, and two messages of a header and two words.
    assert framer.skipped_bytes == 16 + 12 + 12


def test_a_lost_stream_is_reported_once_and_found_again() -> None:
    framer = TcpFramer(request_bounds)
    # A count of 60000 is above the limit up to which an unknown message is skipped whole.
    lost = struct.pack(">hH", 77, 60000) + b"\xff" * 90
    found = framer.receive(lost + VM + GS)
    assert [isinstance(item, InvalidFrame) for item in found] == [True, False, False]
    assert found[1:] == [TcpFrame(12, VM[4:]), TcpFrame(15, b"")]
    assert framer.skipped_bytes == len(lost)


@pytest.mark.parametrize("wide", [False, True])
def test_first_connect_determines_the_word_size(wide: bool) -> None:
    framer = TcpFramer(request_bounds)
    connect = build_frame(102, CONNECT, wide=wide)
    widths = [framer.wide]
    # The first 7 bytes end within the first word: the word size is not yet decided.
    for piece, found in ((connect[:7], []), (connect[7:], [TcpFrame(102, CONNECT)])):
        assert framer.receive(piece) == found
        widths.append(framer.wide)
    assert widths == [None, None, wide]
    assert framer.receive(build_frame(12, VM[4:], wide=wide)) == [TcpFrame(12, VM[4:])]


def test_words_of_a_64_bit_client() -> None:
    # -50 = 0xffffffce. A request word is padded before the value, a reply word after it.
    payload = struct.pack(">2i", 1, -50)
    assert build_frame(21, payload, wide=True).hex() == "00150002" "0000000000000001" "00000000ffffffce"
    assert build_frame(80, payload, wide=True, reply=True).hex() == "00500002" "0000000100000000" "ffffffce00000000"


# No whole words; 65536 words, one more than the count field holds.
@pytest.mark.parametrize("size", [3, 4 * 65536])
def test_messages_that_cannot_be(size: int) -> None:
    with pytest.raises(WireError, match=f"got {size} bytes"):
        build_frame(80, bytes(size))


@pytest.mark.parametrize(("text", "wrong"), [
    # A header or a payload that is cut off; wrong types and counts; bytes behind a whole message, another message or
    # not.
    ("", "truncated: 0 bytes"),
    ("000f", "truncated: 2 bytes"),
    ("000c000300000064", "truncated: 8 bytes"),
    ("270f0000", "unknown message type 9999"),
    ("000f0001" "00000000", "type 15 takes 0 words, not 1"),
    ("000fffff", "type 15 takes 0 words, not 65535"),
    ("000f0000" "00", "1 bytes behind the message: 00"),
    ("000f0000" "000f0000", "4 bytes behind the message: 000f0000"),
    ("000f0000" "270f0000", "4 bytes behind the message: 270f0000"),
])
def test_what_is_wrong_with_one_line_of_a_recording(text: str, wrong: str) -> None:
    with pytest.raises(WireError, match=wrong):
        parse_single_frame(bytes.fromhex(text), request_bounds, wide=False)


def test_what_is_behind_a_64_bit_message() -> None:
    message = build_frame(21, CONNECT, wide=True)
    assert parse_single_frame(message, request_bounds, wide=True) == TcpFrame(21, CONNECT)
    with pytest.raises(WireError, match=r"2 bytes behind .*abcd"):
        parse_single_frame(message + b"\xab\xcd", request_bounds, wide=True)


def test_bounds_by_type() -> None:
    assert request_bounds(12) == (3, 3)
    assert request_bounds(50) == (3, 21)
    assert reply_bounds(91) == (1, 1)
    # State vector, count, 482 lines of 4 words, 35 stamps of 9 words, clock and two voltages.
    assert reply_bounds(80) == (1, 45 + 1 + 4 * 482 + 35 * 9 + 3)
    assert request_bounds(80) is None
    assert reply_bounds(12) is None


@given(st.binary(max_size=200), st.integers(1, 50))
@settings(max_examples=40)
def test_drop_after_loss_drops_all_later_bytes(after: bytes, cut: int) -> None:
    framer = TcpFramer(request_bounds, wide=False, drop_after_loss=True)
    # Type 0x7f7f is unknown, and its count of 32639 is above the limit for skipping it whole.
    lost = b"\x7f\x7f\x7f\x7f"
    found = framer.receive(lost + after[:cut]) + framer.receive(after[cut:])
    assert [item.fatal for item in found if isinstance(item, InvalidFrame)] == [True]
    assert len(found) == 1
    assert (framer.skipped_bytes, framer.pending) == (len(lost + after), 0)
