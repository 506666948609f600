"""Frames of the Nserver language: finding whole messages in a stream of bytes, and making them.

    int16 type | uint16 count | count x int32     all big-endian; a 64-bit client's words take eight bytes:
    request word  00 00 00 00 + value             reply word  value + four bytes that it ignores

Rules: the framer answers "these frames, or not yet"; it never waits and never raises. A count is checked against
what its type can carry before a byte of it is kept; a frame that cannot be is passed over, counted and reported.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from nclient.errors import WireError
from nclient.protocol.commands import BY_TCP_TYPE, MAX_REPLY_WORDS

_HEADER = struct.Struct(">hH")
MAX_UNKNOWN_WORDS = 1024
"""A message of unknown type or wrong count is passed over whole up to this count; beyond it the frame is lost,
and the search goes on byte by byte, reported once, until a good message is found."""
UNKNOWN_TYPE, WRONG_COUNT = 1, 2
_CONNECT_TYPES = (101, 102, 103)
Bounds = Callable[[int], tuple[int, int] | None]
"""Fewest and most words of a message by its type: request_bounds or reply_bounds."""


class TcpFrame(NamedTuple):
    """A whole message, its words as big-endian 32-bit bytes whatever the client's word is."""

    type: int
    payload: bytes


class InvalidFrame(NamedTuple):
    """Bytes that are no message we can take: the ERROR code they deserve, and what was wrong."""

    code: int
    reason: str
    fatal: bool
    """Whether the stream lost its frame, so that what follows cannot be trusted."""


def request_bounds(message_type: int) -> tuple[int, int] | None:
    """Fewest and most words that a request of this type can carry; None for a type nobody knows."""
    row = BY_TCP_TYPE.get(message_type)
    return row.tcp_words if row else None


def reply_bounds(message_type: int) -> tuple[int, int] | None:
    """Fewest and most words that a reply of this type can carry; None for a type nobody knows."""
    most = MAX_REPLY_WORDS.get(message_type)
    return None if most is None else (1, most)


def limit_words(bounds: Bounds, most_words: int) -> Bounds:
    """The same bounds, but no message longer than so many words."""

    def shortened(message_type: int) -> tuple[int, int] | None:
        found = bounds(message_type)
        return None if found is None else (found[0], min(found[1], most_words))

    return shortened


def build_frame(frame_type: int, payload: bytes, *, wide: bool = False, reply: bool = False) -> bytes:
    """The bytes of a message. `payload`: its words as 32-bit bytes; `wide`: for or from a 64-bit client."""
    words = len(payload) // 4
    if len(payload) % 4 or words > 0xFFFF:
        raise WireError(f"a message is whole words, at most 65535; got {len(payload)} bytes")
    return _HEADER.pack(frame_type, words) + (_widen(payload, reply) if wide else payload)


def parse_single_frame(data: bytes, bounds: Bounds, wide: bool) -> TcpFrame:
    """The one message that these bytes are, nothing behind it. Raises WireError, saying what is wrong."""
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
    """Requests or replies out of a stream. Give it bytes as they come; it gives back what is whole.

    `bounds` is request_bounds or reply_bounds. `wide` is None until a CONNECT tells a 32-bit client from a
    64-bit one: robot ids are at least 1, so a first word of zero comes from the latter. `gives_up`: what comes
    after the frame was lost is not searched for more, but dropped.
    """

    def __init__(self, bounds: Bounds, wide: bool | None = None, gives_up: bool = False) -> None:
        self.wide = wide
        self.frames = 0
        self.skipped_bytes = 0
        self._replies = bounds is reply_bounds
        self._bounds = bounds
        self._buffer = bytearray()
        self._to_skip = 0
        self._lost = False
        self._gives_up = gives_up

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that is not whole yet."""
        return len(self._buffer)

    @property
    def owed(self) -> int:
        """Bytes still to come of a message that was refused and is passed over."""
        return self._to_skip

    def receive(self, data: bytes) -> list[TcpFrame | InvalidFrame]:
        """The frames and refusals that these bytes complete, in order."""
        if self._lost and self._gives_up:
            self.skipped_bytes += len(data)
            return []
        self._buffer += data
        found: list[TcpFrame | InvalidFrame] = []
        while (not self._to_skip or self._skip()) and len(self._buffer) >= _HEADER.size:
            message_type, count = _HEADER.unpack_from(self._buffer)
            bounds = self._bounds(message_type)
            if bounds is None or not bounds[0] <= count <= bounds[1]:
                self._refuse(message_type, count, bounds, found)
                if self._lost and self._gives_up:
                    self._to_skip = len(self._buffer)
                continue
            if not self._width_known(message_type):
                break
            frame = self._whole(message_type, count)
            if frame is None:
                break
            found.append(frame)
        return found

    def _skip(self) -> bool:
        """Pass over what was refused; True when all of it is gone."""
        gone = min(self._to_skip, len(self._buffer))
        del self._buffer[:gone]
        self._to_skip -= gone
        self.skipped_bytes += gone
        return not self._to_skip

    def _refuse(
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
        self._to_skip = 1 if fatal else _HEADER.size + self._word_size * count

    @property
    def _word_size(self) -> int:
        return 8 if self.wide else 4

    def _width_known(self, message_type: int) -> bool:
        if self.wide is None and message_type in _CONNECT_TYPES:
            if len(self._buffer) < _HEADER.size + 4:
                return False
            self.wide = not any(self._buffer[_HEADER.size : _HEADER.size + 4])
        return True

    def _whole(self, message_type: int, count: int) -> TcpFrame | None:
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
