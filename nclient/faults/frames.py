"""Cuts what passes on a connection into its frames, losing no byte: what makes no frame passes as it is.

    LineFrames   a robot's own line     01 | length low, high | type | ... | checksum | 5c
    TcpFrames    Nserver's protocol     int16 type | uint16 count | count words; a 64-bit client's have eight bytes

Rules: no I/O, and nothing is judged but where a frame ends; the ends of the connection read the frames themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from nclient.protocol.commands import BY_NAME, MAX_REPLY_WORDS
from nclient.protocol.serial_frame import END, ROBOT_LIMIT, START

_LINE_OVERHEAD, _LINE_SMALLEST = 4, 2
_TCP_HEADER, _TYPE_SIZE, _WORD = 4, 2, 4
_CONNECT_TYPES = frozenset(BY_NAME[name].tcp_type for name in ("create_robot", "connect_robot", "disconnect_robot"))
_MOST_WORDS = max(MAX_REPLY_WORDS.values())


class Piece(NamedTuple):
    """Bytes that passed: a whole frame and its type, or None for bytes that are no frame."""

    data: bytes
    type: int | None


class Frames(Protocol):
    """A stream in one direction, cut into pieces."""

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that is not whole yet."""
        ...

    def receive(self, data: bytes) -> list[Piece]:
        """The pieces that these bytes complete, in order."""
        ...

    def rest(self) -> list[Piece]:
        """What was kept of a frame that is not whole, as it is."""
        ...


class LineFrames:
    """One direction of a robot's own line. `limit`: its longest frame, bytes; `bare`: bytes before the first one."""

    def __init__(self, limit: int = ROBOT_LIMIT, bare: int = 0) -> None:
        self._limit = limit
        self._bare = bare
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def receive(self, data: bytes) -> list[Piece]:
        """As Frames says. The bare bytes at the start are one piece."""
        self._buffer += data
        if len(self._buffer) < self._bare:
            return []
        bare = [Piece(self._take(self._bare), None)] if self._bare else []
        self._bare = 0
        return bare + list(self._pieces())

    def rest(self) -> list[Piece]:
        """As Frames says; frames behind a start that led nowhere are found."""
        found: list[Piece] = []
        while self._buffer:
            found.append(Piece(self._take(1), None))
            found += self._pieces()
        return _joined(found)

    def _pieces(self) -> Iterator[Piece]:
        stray = bytearray()
        while self._buffer:
            size = self._size()
            if size is None or len(self._buffer) < size:
                break
            if size == 0:
                stray += self._take(1)
                continue
            if stray:
                yield Piece(bytes(stray), None)
                stray.clear()
            frame = self._take(size)
            yield Piece(frame, frame[3])
        if stray:
            yield Piece(bytes(stray), None)

    def _size(self) -> int | None:
        """Bytes of the frame in front, 0 where none begins, None where that cannot be told yet."""
        buffer = self._buffer
        if buffer[0] != START:
            return 0
        if len(buffer) < 3:
            return None
        length = buffer[1] | buffer[2] << 8
        size = length + _LINE_OVERHEAD
        if not _LINE_SMALLEST <= length <= self._limit - _LINE_OVERHEAD:
            return 0
        if len(buffer) >= size and (buffer[size - 1] != END or sum(buffer[: size - 2]) & 255 != buffer[size - 2]):
            return 0
        return size

    def _take(self, count: int) -> bytes:
        taken = bytes(self._buffer[:count])
        del self._buffer[:count]
        return taken


class TcpFrames:
    """One direction of a connection to an Nserver. `wide`: None until a CONNECT tells a 64-bit client.

    A count beyond every message's means that the stream is lost: from then on all passes as it comes.
    """

    def __init__(self, wide: bool | None = False) -> None:
        self.wide = wide
        self._lost = False
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def receive(self, data: bytes) -> list[Piece]:
        """As Frames says."""
        self._buffer += data
        found: list[Piece] = []
        while not self._lost and len(self._buffer) >= _TCP_HEADER:
            frame_type = int.from_bytes(self._buffer[:_TYPE_SIZE], "big", signed=True)
            count = int.from_bytes(self._buffer[_TYPE_SIZE:_TCP_HEADER], "big")
            self._lost = count > _MOST_WORDS
            if self._lost or not self._width_known(frame_type):
                break
            size = _TCP_HEADER + count * _WORD * (2 if self.wide else 1)
            if len(self._buffer) < size:
                break
            found.append(Piece(bytes(self._buffer[:size]), frame_type))
            del self._buffer[:size]
        return found + self.rest() if self._lost else found

    def rest(self) -> list[Piece]:
        """As Frames says. What follows is taken for the start of a frame."""
        rest = bytes(self._buffer)
        self._buffer.clear()
        return [Piece(rest, None)] if rest else []

    def _width_known(self, frame_type: int) -> bool:
        """Robot numbers are 1 or more: a first word of 0 comes from a 64-bit client."""
        if self.wide is None and frame_type in _CONNECT_TYPES:
            first = self._buffer[_TCP_HEADER : _TCP_HEADER + _WORD]
            if len(first) < _WORD:
                return False
            self.wide = not any(first)
        return True


def _joined(pieces: list[Piece]) -> list[Piece]:
    """Bytes that are no frame and stand side by side as one piece."""
    joined: list[Piece] = []
    for piece in pieces:
        if joined and piece.type is None and joined[-1].type is None:
            joined[-1] = Piece(joined[-1].data + piece.data, None)
        else:
            joined.append(piece)
    return joined
