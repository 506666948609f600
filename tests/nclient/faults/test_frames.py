"""Cutting a stream into frames: no byte is lost or added, whatever comes, and the frames are those that were sent."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.faults.inject import Frames, LineFrames, StreamPiece, TcpFrames
from nclient.protocol import codec
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFrame, SerialFramer, build_frame
from tests.nclient.protocol.strategies import cuts, in_pieces

quick = settings(max_examples=80)
sent_frames = st.lists(st.builds(build_frame, st.integers(0, 255), st.binary(max_size=40)), max_size=6)
dirt = st.binary(max_size=20)
# Bytes that occur in frames often: 0x01 and 0x5C, and small numbers as lengths.
likely = st.lists(st.sampled_from([0, 1, 2, 3, 5, 8, 0x5C]) | st.integers(0, 255), max_size=60).map(bytes)
words = st.lists(st.integers(-(2**31), 2**31 - 1), max_size=8).map(
    lambda numbers: b"".join(number.to_bytes(4, "big", signed=True) for number in numbers)
)
# Types of requests, of replies, and one that does not exist: the stream is cut by the count alone.
messages = st.tuples(st.sampled_from([12, 15, 16, 102, 300, 80, 91, 999]), words)


def pieces_of(frames: Frames, data: bytes, places: list[int]) -> list[StreamPiece]:
    return [piece for part in in_pieces(data, places) for piece in frames.receive(part)]


def whole(pieces: list[StreamPiece]) -> list[bytes]:
    return [piece.data for piece in pieces if piece.type is not None]


def everything(pieces: list[StreamPiece]) -> bytes:
    return b"".join(piece.data for piece in pieces)


@quick
@given(sent_frames, cuts)
def test_the_frames_of_a_clean_line(sent: list[bytes], places: list[int]) -> None:
    frames = LineFrames()
    found = pieces_of(frames, b"".join(sent), places)
    assert found == [StreamPiece(frame, frame[3]) for frame in sent]
    assert frames.flush() == []


@quick
@given(st.lists(st.tuples(dirt | likely, sent_frames), max_size=4), dirt | likely, cuts)
def test_noisy_line_gives_the_frames_of_the_serial_framer(
    stretches: list[tuple[bytes, list[bytes]]], end: bytes, places: list[int]
) -> None:
    data = b"".join(noise + b"".join(sent) for noise, sent in stretches) + end
    frames, framer = LineFrames(), SerialFramer()
    found = pieces_of(frames, data, places) + frames.flush()
    assert everything(found) == data
    # The oracle is the framer that clients use: it finds the same frames in the same bytes.
    assert [build_frame(*frame) for frame in framer.receive(data) + framer.expire()] == whole(found)


@quick
@given(likely, cuts)
def test_no_byte_is_lost_of_what_makes_no_sense(data: bytes, places: list[int]) -> None:
    # Each kind of framer, with noise that is cut at any place: the pieces joined are the noise.
    for frames in (LineFrames(), LineFrames(HOST_LIMIT), LineFrames(bare=11), TcpFrames(), TcpFrames(None)):
        assert everything(pieces_of(frames, data, places) + frames.flush()) == data


def test_bytes_before_the_first_frame_are_one_piece() -> None:
    frames = LineFrames(bare=11)
    frame = build_frame(7)
    # A valid frame's head within the handshake must not be taken for a frame.
    hello = bytes.fromhex("01080005640032800000ff")
    assert frames.receive(hello[:5]) == []
    assert frames.pending_bytes == 5
    assert frames.receive(hello[5:] + frame) == [StreamPiece(hello, None), StreamPiece(frame, 7)]


def test_a_length_beyond_the_limit_begins_no_frame() -> None:
    long = build_frame(5, bytes(300))
    assert whole(LineFrames().receive(long)) == [long]
    assert whole(LineFrames(HOST_LIMIT).receive(long)) == []


def test_flush_returns_an_incomplete_frame() -> None:
    frames = LineFrames()
    good = build_frame(9, b"\x05")
    # A length of 32 is awaited, with the good frame inside it.
    assert frames.receive(b"\x01\x20\x00\x07" + good) == []
    assert frames.flush() == [StreamPiece(b"\x01\x20\x00\x07", None), StreamPiece(good, 9)]


@quick
@given(st.lists(messages, max_size=6), cuts, st.booleans(), st.booleans())
def test_the_messages_of_a_connection(
    sent: list[tuple[int, bytes]], places: list[int], wide: bool, replies: bool
) -> None:
    built = [codec.build_frame(number, payload, wide=wide, reply=replies) for number, payload in sent]
    frames = TcpFrames(wide)
    found = pieces_of(frames, b"".join(built), places)
    assert found == [StreamPiece(data, number) for data, (number, _) in zip(built, sent, strict=True)]


@pytest.mark.parametrize("wide", [False, True])
@given(cuts)
def test_connect_determines_the_word_size(wide: bool, places: list[int]) -> None:
    connect = codec.build_frame(102, (1).to_bytes(4, "big") + (77).to_bytes(4, "big"), wide=wide)
    gs = codec.build_frame(15, b"", wide=wide)
    frames = TcpFrames(None)
    frames.receive(b"")
    assert frames.pending_bytes == 0
    assert pieces_of(frames, connect + gs, places) == [StreamPiece(connect, 102), StreamPiece(gs, 15)]
    assert frames.wide is wide


def test_bytes_after_an_impossible_count_pass_unchanged() -> None:
    frames = TcpFrames()
    # Type 15 with 65535 words is impossible: from here on no boundary of a message is certain.
    assert frames.receive(b"\x00\x0f\xff\xff") == [StreamPiece(b"\x00\x0f\xff\xff", None)]
    assert frames.receive(b"\x00\x0f\x00\x00") == [StreamPiece(b"\x00\x0f\x00\x00", None)]


def test_a_framer_s_frame_is_rebuilt_to_the_same_bytes() -> None:
    frame = build_frame(21, bytes(range(8)))
    assert SerialFramer().receive(frame) == [SerialFrame(21, bytes(range(8)))]
