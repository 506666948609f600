"""What a connection speaks, as far as faults need it: where its frames end, and which command each belongs to.

Rules: no I/O. On a robot's own line a reply names its command; over TCP replies are those of the requests that went
through, in their order. A NAK over TCP is an ERROR reply, and as no robot said it, its code is 5: refused.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from nclient.faults.frames import Frames, LineFrames, Piece, TcpFrames
from nclient.faults.injector import LINE_NAK
from nclient.faults.plan import GREETING
from nclient.protocol.commands import BY_LINE_TYPE, BY_TCP_TYPE, ERROR_TYPE, NAK_TYPE
from nclient.protocol.hello import HELLO_SIZE
from nclient.protocol.serial_frame import HOST_LIMIT
from nclient.protocol.tcp_frame import build_frame

NAK_ERROR = 5
"""The code of the ERROR reply that stands for a NAK."""
_MOST_OUTSTANDING = 1 << 16


class Language(Protocol):
    """What a connection speaks: where its frames end, and which command each belongs to."""

    requests: Frames
    replies: Frames
    patience_s: float | None
    """How long a part of a request may be kept: on a line a frame may never become whole."""

    @property
    def nak(self) -> bytes:
        """A refusal."""
        ...

    def request_name(self, piece: Piece) -> str:
        """The command that a request is; "" for what is none."""
        ...

    def went_through(self, command: str) -> None:
        """The robot has a request of this command before it."""
        ...

    def reply_name(self, piece: Piece) -> str:
        """The command that a reply answers; "" where that is not known."""
        ...


class LineLanguage:
    """A robot's own line. `greets`: it begins with a hello, as an N200 does over TCP."""

    nak = LINE_NAK
    patience_s: float | None = 0.25

    def __init__(self, greets: bool = False) -> None:
        self.requests: Frames = LineFrames(HOST_LIMIT)
        self.replies: Frames = LineFrames(bare=HELLO_SIZE if greets else 0)
        self._greets = greets
        self._asked = ""

    def request_name(self, piece: Piece) -> str:
        return _line_name(piece)

    def went_through(self, command: str) -> None:
        self._asked = command

    def reply_name(self, piece: Piece) -> str:
        if self._greets:
            self._greets = False
            return GREETING
        return self._asked if piece.type == NAK_TYPE else _line_name(piece)


class TcpLanguage:
    """Nserver's protocol. `wide`: whether the client is a 64-bit one, None until its CONNECT tells."""

    patience_s: float | None = None

    def __init__(self, wide: bool | None = None) -> None:
        self.requests: Frames
        self.replies: Frames
        self.requests, self.replies = self._asking, self._answering = TcpFrames(wide), TcpFrames(wide)
        self._outstanding: deque[str] = deque(maxlen=_MOST_OUTSTANDING)

    @property
    def nak(self) -> bytes:
        return build_frame(ERROR_TYPE, NAK_ERROR.to_bytes(4, "big"), wide=bool(self._asking.wide), reply=True)

    def request_name(self, piece: Piece) -> str:
        self._answering.wide = bool(self._asking.wide)
        row = None if piece.type is None else BY_TCP_TYPE.get(piece.type)
        return row.name if row else ""

    def went_through(self, command: str) -> None:
        self._outstanding.append(command)

    def reply_name(self, piece: Piece) -> str:
        whole = piece.type is not None and self._outstanding
        return self._outstanding.popleft() if whole else ""


def _line_name(piece: Piece) -> str:
    row = None if piece.type is None else BY_LINE_TYPE.get(piece.type)
    return row.name if row else ""
