"""Frames on a line that is never clean: good ones come out whatever is around them, and every byte is accounted for."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol.serial_framing import ROBOT_LIMIT, SerialFrame, SerialFramer, build_frame, parse_single_frame
from tests.nclient.protocol.strategies import cuts, in_pieces

frames = st.lists(st.builds(SerialFrame, st.integers(0, 255), st.binary(max_size=40)), max_size=6)
# Without 0x01 no byte of the noise can look like the start of a frame.
noise_without_start = st.binary(max_size=30).map(lambda data: data.replace(b"\x01", b"\x02"))
# vm(100, -50, 0): start, length 8, type 5, three int16 in sign-magnitude, checksum 0x24, end.
VM = bytes.fromhex("01080005640032800000245c")
quick = settings(max_examples=60)


def bytes_of(sent: list[SerialFrame]) -> bytes:
    return b"".join(build_frame(*frame) for frame in sent)


def accounted(framer: SerialFramer, found: list[SerialFrame]) -> int:
    assert framer.frames == len(found)
    # A frame has 6 bytes besides its data: start, length (2), type, checksum, end.
    return sum(len(frame.data) + 6 for frame in found) + framer.skipped_bytes + framer.pending


def test_the_documented_frame() -> None:
    assert build_frame(5, bytes.fromhex("640032800000")) == VM
    assert SerialFramer().receive(VM) == [SerialFrame(5, VM[4:10])]


@quick
@given(frames, cuts)
def test_any_cuts(sent: list[SerialFrame], places: list[int]) -> None:
    framer = SerialFramer()
    found = [frame for piece in in_pieces(bytes_of(sent), places) for frame in framer.receive(piece)]
    assert found == sent
    assert (framer.skipped_bytes, framer.pending) == (0, 0)


@quick
@given(frames)
def test_byte_by_byte(sent: list[SerialFrame]) -> None:
    framer = SerialFramer()
    assert [frame for byte in bytes_of(sent) for frame in framer.receive(bytes((byte,)))] == sent


@quick
@given(frames, st.lists(noise_without_start, min_size=7, max_size=7), cuts)
def test_noise_between_frames_is_skipped_and_counted(
    sent: list[SerialFrame], noise: list[bytes], places: list[int]
) -> None:
    stream = b"".join(dirt + build_frame(*frame) for dirt, frame in zip(noise, sent, strict=False)) + noise[-1]
    framer = SerialFramer()
    found = [frame for piece in in_pieces(stream, places) for frame in framer.receive(piece)]
    assert found == sent
    assert framer.skipped_bytes == sum(map(len, noise[: len(sent)])) + len(noise[-1])


@quick
@given(st.binary(max_size=60), cuts)
# Noise may contain a start and a length, and then hides the frame behind it.
def test_noise_hides_a_frame_at_most_until_the_deadline(noise: bytes, places: list[int]) -> None:
    framer = SerialFramer()
    found = [frame for piece in in_pieces(noise + VM, places) for frame in framer.receive(piece)]
    # The deadline: the incomplete frame is dropped, and the bytes behind its start are searched again.
    found += framer.expire()
    assert SerialFrame(5, VM[4:10]) in found
    assert framer.pending == 0
    assert accounted(framer, found) == len(noise) + len(VM)


@quick
# Whole frames, the first half of one, and noise, in any order.
@given(st.lists(st.one_of(st.binary(max_size=80), st.just(VM), st.just(VM[:7])), max_size=8))
def test_whatever_comes_every_byte_is_accounted_for(pieces: list[bytes]) -> None:
    framer = SerialFramer(limit=255)
    found = [frame for piece in pieces for frame in framer.receive(piece)]
    assert accounted(framer, found) == sum(map(len, pieces))
    assert framer.pending <= 255


# A length below type and checksum; one byte more than a robot's longest frame; the largest number of the field.
@pytest.mark.parametrize("length", [0, ROBOT_LIMIT - 3, 0xFFFF])
def test_a_length_that_cannot_be_costs_one_byte_and_no_frame(length: int) -> None:
    framer = SerialFramer()
    # Only the length is corrupt: its first byte is skipped, then the search finds no start before the next frame.
    corrupt = VM[:1] + length.to_bytes(2, "little") + VM[3:]
    assert framer.receive(corrupt + VM) == [SerialFrame(5, VM[4:10])]
    assert framer.skipped_bytes == len(corrupt)


def test_corrupt_length_only_waits_for_more_bytes() -> None:
    framer = SerialFramer()
    # 0x0040 = 64: a valid length, so that the frame seems to have 68 bytes, and 24 are there.
    corrupt = VM[:1] + b"\x40\x00" + VM[3:]
    assert framer.receive(corrupt + VM) == []
    more = framer.receive(VM * 5)
    # With 84 bytes the candidate is complete and fails. The search continues one byte later, and finds all six
    # frames.
    assert more == [SerialFrame(5, VM[4:10])] * 6
    assert framer.skipped_bytes == len(corrupt)


def test_a_wrong_checksum_and_a_wrong_end() -> None:
    framer = SerialFramer()
    # The checksum is 25 instead of 24, and the end is right: a checksum error.
    assert framer.receive(VM[:-2] + b"\x25\x5c") == []
    assert framer.bad_checksums == 1
    # The checksum is right, and the end is wrong: these bytes are no frame, and no checksum error is counted.
    assert framer.receive(VM[:-1] + b"\x5d") == []
    assert framer.bad_checksums == 1
    # Both were skipped whole: 2 x 12 bytes.
    assert framer.skipped_bytes == 24


def test_a_trailing_half_stays_until_the_rest_or_the_deadline() -> None:
    framer = SerialFramer()
    assert framer.receive(VM + VM[:5]) == [SerialFrame(5, VM[4:10])]
    assert framer.pending == 5
    # The second half completes the frame.
    assert framer.receive(VM[5:]) == [SerialFrame(5, VM[4:10])]
    # The second half does not come before the deadline.
    framer.receive(VM[:5])
    assert framer.expire() == []
    assert framer.skipped_bytes == 5


def test_a_host_forgets_what_came_before_it_asks() -> None:
    # A late half reply would otherwise swallow the beginning of the next reply.
    framer = SerialFramer()
    framer.receive(VM[:8])
    framer.clear()
    assert (framer.pending, framer.skipped_bytes) == (0, 8)
    assert framer.receive(VM) == [SerialFrame(5, VM[4:10])]


# The length field counts type and checksum too: 65534 + 2 is beyond its 16 bits. A type is one byte.
@pytest.mark.parametrize(("kind", "size"), [(5, 65534), (256, 0), (-1, 0)])
def test_frames_that_cannot_be(kind: int, size: int) -> None:
    with pytest.raises(WireError, match=f"type {kind} with {size} bytes"):
        build_frame(kind, bytes(size))


@pytest.mark.parametrize(("text", "wrong"), [
    ("", "starts with 01, not with nothing"),
    ("5c", "starts with 01, not with 5c"),
    ("01", "truncated: 1 bytes of a frame of unknown length"),
    ("010800", "truncated: 3 bytes of a frame of 12"),
    ("01080005640032800000245c00", "1 bytes behind the frame: 00"),
    ("01080005640032800000245d", "ends with 5c, not with 5d"),
    ("01080005640032800000255c", "wrong checksum: 25, but the bytes before it give 24"),
    ("0101005c5c", "6 to 5174 bytes, not 5"),
])
def test_what_is_wrong_with_one_line_of_a_recording(text: str, wrong: str) -> None:
    with pytest.raises(WireError, match=wrong):
        parse_single_frame(bytes.fromhex(text))


@quick
@given(st.integers(0, 255), st.binary(max_size=40))
def test_the_one_frame_there_is(kind: int, data: bytes) -> None:
    assert parse_single_frame(build_frame(kind, data)) == SerialFrame(kind, data)


def test_a_frame_longer_than_the_other_end_sends() -> None:
    with pytest.raises(WireError, match="255 bytes, not 260"):
        parse_single_frame(build_frame(128, bytes(254)), limit=255)
