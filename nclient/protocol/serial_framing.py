"""Frames of the robot's own line: finding whole ones in whatever the line delivers, and making them.

    0x01 | length, 2 bytes low first | type | data ... | checksum | 0x5C
    length counts type + data + checksum; checksum = sum of every byte before it, the 0x01 included, modulo 256

Rules: the framer answers "these frames, or not yet"; it never waits and never raises. A line is never clean: a
length out of bounds, a wrong checksum or end costs one byte, and the search goes on at the next 0x01, so a corrupt
length hides the frames behind it only until more bytes come, or until `expire` (the caller's deadline) gives it up.
"""

from __future__ import annotations

from typing import NamedTuple

from nclient.errors import WireError

START, END = 0x01, 0x5C
_OVERHEAD = 4
_SMALLEST_LENGTH = 2
SMALLEST_FRAME = _OVERHEAD + _SMALLEST_LENGTH
"""A frame without data."""
HOST_LIMIT = 255
"""Hosts send less than 256 bytes a frame."""
ROBOT_LIMIT = 5174
"""A state packet with every sensor, every stamp and 482 laser lines: the longest frame a robot can send."""


class SerialFrame(NamedTuple):
    """A whole frame with a good checksum."""

    type: int
    data: bytes


def build_frame(frame_type: int, data: bytes = b"") -> bytes:
    """The bytes of one frame. Raises WireError when the data is longer than a length can say."""
    length = len(data) + 2
    if length > 0xFFFF or not 0 <= frame_type <= 0xFF:
        raise WireError(f"a frame of type {frame_type} with {len(data)} bytes cannot be")
    body = bytes((START, length & 255, length >> 8, frame_type)) + data
    return body + bytes((sum(body) & 255, END))


def parse_single_frame(data: bytes, limit: int = ROBOT_LIMIT) -> SerialFrame:
    """The one frame that these bytes are, nothing before or behind it. Raises WireError, saying what is wrong."""
    if not data or data[0] != START:
        raise WireError(f"a frame starts with 01, not with {data[:1].hex() or 'nothing'}")
    size = _OVERHEAD + int.from_bytes(data[1:3], "little")
    if len(data) < max(3, size):
        raise WireError(f"truncated: {len(data)} bytes of a frame of {size if len(data) > 2 else 'unknown length'}")
    if not SMALLEST_FRAME <= size <= limit:
        raise WireError(f"a frame has {SMALLEST_FRAME} to {limit} bytes, not {size}")
    if len(data) > size:
        raise WireError(f"{len(data) - size} bytes behind the frame: {data[size:][:8].hex()}")
    if data[-1] != END:
        raise WireError(f"a frame ends with 5c, not with {data[-1]:02x}")
    checksum = sum(data[:-2]) & 255
    if checksum != data[-2]:
        raise WireError(f"wrong checksum: {data[-2]:02x}, but the bytes before it give {checksum:02x}")
    return SerialFrame(data[3], data[4:-2])


def _is_frame(data: bytes, limit: int) -> bool:
    """Whether these bytes are one whole frame and nothing else."""
    size = len(data)
    return (
        _OVERHEAD + _SMALLEST_LENGTH <= size <= limit
        and data[0] == START
        and data[1] | data[2] << 8 == size - _OVERHEAD
        and data[-1] == END
        and sum(data[:-2]) & 255 == data[-2]
    )


class SerialFramer:
    """Frames out of a stream. `limit`: the longest whole frame that the other end sends, in bytes."""

    def __init__(self, limit: int = ROBOT_LIMIT) -> None:
        self.limit = limit
        self.frames = 0
        self.skipped_bytes = 0
        self.bad_checksums = 0
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that is not whole yet."""
        return len(self._buffer)

    def receive(self, data: bytes) -> list[SerialFrame]:
        """The frames that these bytes complete, in order."""
        if not self._buffer and _is_frame(data, self.limit):  # what a clean line delivers
            self.frames += 1
            return [SerialFrame(data[3], bytes(data[4:-2]))]
        self._buffer += data
        found: list[SerialFrame] = []
        while (size := self._candidate()) and len(self._buffer) >= size:
            frame = self._take(size)
            if frame:
                found.append(frame)
        return found

    def expire(self) -> list[SerialFrame]:
        """Give up on the frame that is not whole, and look for others in what came after its first byte."""
        found: list[SerialFrame] = []
        while self._buffer:
            self._discard(1)
            found += self.receive(b"")
        return found

    def clear(self) -> None:
        """Forget what has come, as a host does before it asks."""
        self._discard(len(self._buffer))

    def _candidate(self) -> int:
        """Bring a possible frame to the front; its size in bytes, 0 when there is none (yet)."""
        while True:
            start = self._buffer.find(START)
            self._discard(len(self._buffer) if start < 0 else start)
            if len(self._buffer) < 3:
                return 0
            length = self._buffer[1] | self._buffer[2] << 8
            if _SMALLEST_LENGTH <= length <= self.limit - _OVERHEAD:
                return length + _OVERHEAD
            self._discard(1)

    def _take(self, size: int) -> SerialFrame | None:
        candidate = bytes(self._buffer[:size])
        if not _is_frame(candidate, self.limit):
            self.bad_checksums += candidate[-1] == END
            self._discard(1)
            return None
        del self._buffer[:size]
        self.frames += 1
        return SerialFrame(candidate[3], candidate[4:-2])

    def _discard(self, count: int) -> None:
        del self._buffer[:count]
        self.skipped_bytes += count
