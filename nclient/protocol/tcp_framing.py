"""Frames of Nserver's protocol over TCP: building messages, and finding whole ones in a byte stream.

    int16 type | uint16 count | count x int32     all big-endian; for a 64-bit client a word takes eight bytes:
    request word  00 00 00 00 + value             reply word  value + four bytes that it ignores

The framer returns the frames that are complete; it never waits and never raises. A count is checked against the limits
of its type before any payload is buffered; an invalid frame is skipped, counted and reported.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from nclient.errors import WireError
from nclient.protocol.commands import BY_TCP_TYPE, MAX_REPLY_WORDS

_HEADER = struct.Struct(">hH")
MAX_UNKNOWN_WORDS = 1024
"""A message of unknown type or wrong count is skipped whole up to this count. With a larger count synchronisation is
lost: it is reported once, and the search continues byte by byte until a valid message is found."""
UNKNOWN_TYPE, WRONG_COUNT = 1, 2
# create, connect and disconnect: their first argument, the robot number, distinguishes 32-bit from 64-bit clients.
_CONNECT_TYPES = (101, 102, 103)
Bounds = Callable[[int], tuple[int, int] | None]
"""Minimum and maximum number of words by message type: request_bounds or reply_bounds."""


class TcpFrame(NamedTuple):
    """A whole message; its words are big-endian 32-bit for 64-bit clients, too."""

    type: int
    payload: bytes


class InvalidFrame(NamedTuple):
    """A message that was rejected: code for the ERROR reply, and the reason."""

    code: int
    reason: str
    fatal: bool
    """True if synchronisation was lost, so that later bytes may be misread."""


def request_bounds(message_type: int) -> tuple[int, int] | None:
    """Return the minimum and maximum words of a request of this type; None for an unknown type."""
    row = BY_TCP_TYPE.get(message_type)
    return row.tcp_words if row else None


def reply_bounds(message_type: int) -> tuple[int, int] | None:
    """Return the minimum and maximum words of a reply of this type; None for an unknown type."""
    most = MAX_REPLY_WORDS.get(message_type)
    return None if most is None else (1, most)


def limit_words(bounds: Bounds, max_words: int) -> Bounds:
    """Return the same bounds with the maximum limited to `max_words`."""

    def limited(message_type: int) -> tuple[int, int] | None:
        found = bounds(message_type)
        return None if found is None else (found[0], min(found[1], max_words))

    return limited


def build_frame(frame_type: int, payload: bytes, *, wide: bool = False, reply: bool = False) -> bytes:
    """Return the bytes of a message.

    Parameters
    ----------
    frame_type
        Message type.
    payload
        Words as big-endian 32-bit bytes.
    wide
        True for or from a 64-bit client.
    reply
        True for a reply; with `wide` its padding differs from that of a request.

    Raises
    ------
    WireError
        If the payload is not whole words, or has more than 65535.
    """
    words = len(payload) // 4
    if len(payload) % 4 or words > 0xFFFF:
        raise WireError(f"a message is whole words, at most 65535; got {len(payload)} bytes")
    return _HEADER.pack(frame_type, words) + (_widen(payload, reply) if wide else payload)


def parse_single_frame(data: bytes, bounds: Bounds, wide: bool) -> TcpFrame:
    """Parse bytes that must be exactly one message. Raises WireError otherwise."""
    framer = TcpFramer(bounds, wide)
    found = framer.receive(data)
    if not found:
        raise WireError(f"truncated: {len(data)} bytes are no whole message")
    first = found[0]
    if isinstance(first, InvalidFrame):
        raise WireError(first.reason)
    if len(found) > 1 or framer.pending or framer.skipped_bytes:
        size = _HEADER.size + len(first.payload) * (2 if wide else 1)
        raise WireError(f"{len(data) - size} bytes behind the message: {data[size:][:8].hex()}")
    return first


class TcpFramer:
    """Incremental parser of the requests or replies in a byte stream.

    Parameters
    ----------
    bounds
        request_bounds or reply_bounds.
    wide
        True for a 64-bit client, False for a 32-bit one, None to detect it from CONNECT: robot numbers are at least
        1, so that a first word of zero comes from a 64-bit client.
    drop_after_loss
        True to drop everything after synchronisation was lost instead of searching for the next message.
    """

    def __init__(self, bounds: Bounds, wide: bool | None = None, drop_after_loss: bool = False) -> None:
        self.wide = wide
        self.frames = 0
        self.skipped_bytes = 0
        self._replies = bounds is reply_bounds
        self._bounds = bounds
        self._buffer = bytearray()
        self._to_skip = 0
        self._lost = False
        self._drop_after_loss = drop_after_loss

    @property
    def pending(self) -> int:
        """Return the number of buffered bytes of an incomplete frame."""
        return len(self._buffer)

    @property
    def bytes_to_skip(self) -> int:
        """Return the number of bytes still to arrive of a rejected message that is being skipped."""
        return self._to_skip

    def receive(self, data: bytes) -> list[TcpFrame | InvalidFrame]:
        """Add bytes, and return the frames and rejected frames that they complete, in order."""
        if self._lost and self._drop_after_loss:
            self.skipped_bytes += len(data)
            return []
        self._buffer += data
        found: list[TcpFrame | InvalidFrame] = []
        while (not self._to_skip or self._skip()) and len(self._buffer) >= _HEADER.size:
            # 1. Check type and count before waiting for the payload.
            message_type, count = _HEADER.unpack_from(self._buffer)
            bounds = self._bounds(message_type)
            if bounds is None or not bounds[0] <= count <= bounds[1]:
                self._reject(message_type, count, bounds, found)
                if self._lost and self._drop_after_loss:
                    self._to_skip = len(self._buffer)
                continue
            # 2. Determine the word size, then wait until the whole message is there.
            if not self._detect_word_size(message_type):
                break
            frame = self._take_frame(message_type, count)
            if frame is None:
                break
            found.append(frame)
        return found

    def _skip(self) -> bool:
        """Discard bytes of a rejected message; return True when none are left to skip."""
        gone = min(self._to_skip, len(self._buffer))
        del self._buffer[:gone]
        self._to_skip -= gone
        self.skipped_bytes += gone
        return not self._to_skip

    def _reject(
        self, message_type: int, count: int, bounds: tuple[int, int] | None, found: list[TcpFrame | InvalidFrame]
    ) -> None:
        fatal = self._lost or count > MAX_UNKNOWN_WORDS
        if not self._lost:
            if bounds is None:
                found.append(InvalidFrame(UNKNOWN_TYPE, f"unknown message type {message_type}", fatal))
            else:
                wanted = f"{bounds[0]}" if bounds[0] == bounds[1] else f"{bounds[0]} to {bounds[1]}"
                reason = f"type {message_type} takes {wanted} words, not {count}"
                found.append(InvalidFrame(WRONG_COUNT, reason, fatal))
        self._lost = fatal
        # Without synchronisation only one byte is skipped: a message may begin at the next one.
        self._to_skip = 1 if fatal else _HEADER.size + self._word_size * count

    @property
    def _word_size(self) -> int:
        return 8 if self.wide else 4

    def _detect_word_size(self, message_type: int) -> bool:
        """Set `wide` from the first CONNECT; return False if more bytes are needed for that."""
        if self.wide is None and message_type in _CONNECT_TYPES:
            if len(self._buffer) < _HEADER.size + 4:
                return False
            self.wide = not any(self._buffer[_HEADER.size : _HEADER.size + 4])
        return True

    def _take_frame(self, message_type: int, count: int) -> TcpFrame | None:
        end = _HEADER.size + self._word_size * count
        if len(self._buffer) < end:
            return None
        payload = bytes(self._buffer[_HEADER.size : end])
        del self._buffer[:end]
        self.frames += 1
        self._lost = False
        return TcpFrame(message_type, _narrow(payload, self._replies) if self.wide else payload)


def _widen(payload: bytes, reply: bool) -> bytes:
    layout = "4s4x" if reply else "4x4s"
    words = [payload[k : k + 4] for k in range(0, len(payload), 4)]
    return struct.pack(">" + layout * len(words), *words)


def _narrow(payload: bytes, reply: bool) -> bytes:
    start = 0 if reply else 4
    return b"".join(payload[k : k + 4] for k in range(start, len(payload), 8))
