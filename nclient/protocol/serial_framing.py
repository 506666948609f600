"""Frames of the robot's own serial line: building them, and finding whole ones in a byte stream.

    0x01 | length, 2 bytes low first | type | data ... | checksum | 0x5C
    length counts type + data + checksum; checksum = sum of every byte before it, the 0x01 included, modulo 256

The framer returns the frames that are complete; it never waits and never raises. Lines lose and corrupt bytes: after a
length out of range, a wrong checksum or a wrong end byte the search continues at the next 0x01. A corrupt length hides
the frames behind it only until more bytes arrive, or until the caller's deadline calls `expire`.
"""

from collections.abc import Iterator
from typing import NamedTuple

from nclient.errors import WireError

START, END = 0x01, 0x5C
# Bytes that the length field does not count: start, length (2) and end.
_OVERHEAD = 4
# Type and checksum: the length of a frame without data.
_MIN_LENGTH = 2
MIN_FRAME = _OVERHEAD + _MIN_LENGTH
"""Size of a frame without data in bytes."""
HOST_LIMIT = 255
"""Maximum size of a frame that a host sends."""
ROBOT_LIMIT = 5174
"""Maximum size of a frame that a robot sends: a state packet with every sensor, every stamp and 482 laser lines."""


class SerialFrame(NamedTuple):
    """A whole frame with a valid checksum."""

    type: int
    data: bytes


def build_frame(frame_type: int, data: bytes = b"") -> bytes:
    """Return the bytes of one frame. Raises WireError if type or length do not fit their fields."""
    length = len(data) + 2
    if length > 0xFFFF or not 0 <= frame_type <= 0xFF:
        raise WireError(f"a frame of type {frame_type} with {len(data)} bytes cannot be")
    body = bytes((START, length & 255, length >> 8, frame_type)) + data
    return body + bytes((sum(body) & 255, END))


def parse_single_frame(data: bytes, limit: int = ROBOT_LIMIT) -> SerialFrame:
    """Parse bytes that must be exactly one frame. Raises WireError otherwise."""
    if not data or data[0] != START:
        raise WireError(f"a frame starts with 01, not with {data[:1].hex() or 'nothing'}")
    size = _OVERHEAD + int.from_bytes(data[1:3], "little")
    if len(data) < max(3, size):
        raise WireError(f"truncated: {len(data)} bytes of a frame of {size if len(data) > 2 else 'unknown length'}")
    if not MIN_FRAME <= size <= limit:
        raise WireError(f"a frame has {MIN_FRAME} to {limit} bytes, not {size}")
    if len(data) > size:
        raise WireError(f"{len(data) - size} bytes behind the frame: {data[size:][:8].hex()}")
    if data[-1] != END:
        raise WireError(f"a frame ends with 5c, not with {data[-1]:02x}")
    checksum = sum(data[:-2]) & 255
    if checksum != data[-2]:
        raise WireError(f"wrong checksum: {data[-2]:02x}, but the bytes before it give {checksum:02x}")
    return SerialFrame(data[3], data[4:-2])


def _is_frame(data: bytes, limit: int) -> bool:
    """Return True if these bytes are exactly one valid frame."""
    size = len(data)
    return (_OVERHEAD + _MIN_LENGTH <= size <= limit and data[0] == START and data[1] | data[2] << 8 == size - _OVERHEAD
            and data[-1] == END and sum(data[:-2]) & 255 == data[-2])


class SerialFramer:
    """Incremental parser of the frames in a byte stream.

    Parameters
    ----------
    limit
        Maximum size of a frame from the other end, in bytes: HOST_LIMIT or ROBOT_LIMIT.
    """

    def __init__(self, limit: int = ROBOT_LIMIT) -> None:
        self.limit = limit
        self.frames = 0
        self.skipped_bytes = 0
        self.bad_checksums = 0
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Return the number of buffered bytes of an incomplete frame."""
        return len(self._buffer)

    def receive(self, data: bytes) -> list[SerialFrame]:
        """Add bytes, and return the frames that they complete, in order."""
        # Fast path: on a clean line the bytes are often exactly one frame.
        if not self._buffer and _is_frame(data, self.limit):
            self.frames += 1
            return [SerialFrame(data[3], bytes(data[4:-2]))]
        return [found for found in self.split(data) if isinstance(found, SerialFrame)]

    def expire(self) -> list[SerialFrame]:
        """Discard the incomplete frame, and return frames found in the bytes after its first one."""
        return [found for found in self.split_rest() if isinstance(found, SerialFrame)]

    def clear(self) -> None:
        """Discard the buffered bytes, as a host does before each request."""
        self._skip(len(self._buffer))

    def split(self, data: bytes) -> Iterator[SerialFrame | bytes]:
        """Add bytes, and yield in order the frames that they complete and the bytes that belong to no frame."""
        self._buffer += data
        while self._buffer:
            # 1. A frame starts with 0x01.
            start = self._buffer.find(START)
            if start:
                yield self._skip(len(self._buffer) if start < 0 else start)
                continue
            # 2. A valid length, low byte first, and as many bytes.
            if len(self._buffer) < 3:
                return
            size = _OVERHEAD + (self._buffer[1] | self._buffer[2] << 8)
            if MIN_FRAME <= size <= self.limit:
                if len(self._buffer) < size:
                    return
                # 3. The right checksum and end; otherwise 0x01 is an ordinary byte.
                candidate = bytes(self._buffer[:size])
                if _is_frame(candidate, self.limit):
                    del self._buffer[:size]
                    self.frames += 1
                    yield SerialFrame(candidate[3], candidate[4:-2])
                    continue
                # Only a frame that ends correctly counts as a checksum error; others are lost synchronisation.
                self.bad_checksums += candidate[-1] == END
            yield self._skip(1)

    def split_rest(self) -> Iterator[SerialFrame | bytes]:
        """Yield the buffered bytes, of which the first starts no frame, with the frames found behind it."""
        while self._buffer:
            yield self._skip(1)
            yield from self.split(b"")

    def _skip(self, count: int) -> bytes:
        skipped = bytes(self._buffer[:count])
        del self._buffer[:count]
        self.skipped_bytes += count
        return skipped
