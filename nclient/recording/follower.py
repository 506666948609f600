"""Listens to one connection from outside: cuts what goes by into frames and says what each one is.

    to_robot(bytes) ──> framer ──> Transcript ──> objects as `nomad wire decode` prints them
    to_host(bytes)  ──> framer ──^

Rules: no I/O, no clock; never raises for what goes by, since a line is never clean: bytes that are no frame become an
{"error": ...}. A host empties its input before it asks, so half an answer is given up when a request goes out.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, Protocol

from nclient.protocol import serial_frame, tcp_frame
from nclient.protocol.hello import HELLO_SIZE
from nclient.protocol.models import Model
from nclient.protocol.serial_frame import HOST_LIMIT, SerialFramer
from nclient.protocol.tcp_frame import Refused, TcpFrame, TcpFramer, reply_bounds, request_bounds
from nclient.protocol.terms import Terms
from nclient.protocol.transcript import Transcript

TCP, SERIAL, HELLO_FIRST = "tcp", "serial", "hello"
LINES: Final = (TCP, SERIAL, HELLO_FIRST)
"""The languages of a connection: an Nserver's, a robot's own, and that with eleven bare bytes from the robot first."""
Decoded = dict[str, Any]


class Frame(NamedTuple):
    """The bytes of a whole frame, or what is wrong with some that are none."""

    data: bytes
    wrong: str = ""


class Ears(Protocol):
    """The framers of a language, both ways."""

    wide: bool
    """Whether the client is known to be one of 64 bits."""

    def take_up(self, wide: bool) -> None: ...
    def to_robot(self, data: bytes) -> list[Frame]: ...
    def to_host(self, data: bytes) -> list[Frame]: ...


def ears_for(line: str, model: Model) -> Ears:
    """What cuts the frames of one of LINES. Only a model that has a mask says hello with it."""
    return _TcpEars() if line == TCP else _LineEars(line == HELLO_FIRST and model.sends_mask)


class Follower:
    """One connection, heard from outside. `line`: one of LINES."""

    def __init__(self, line: str, model: Model) -> None:
        self._ears = ears_for(line, model)
        self._line, self._model = line, model
        self._transcript: Transcript | None = None

    def take_up(self, terms: Terms) -> None:
        """Listen to a connection that went on unheard so far and has come to these terms; between two requests."""
        self._ears.take_up(terms.wide)
        self._whole().agree(terms)

    def to_robot(self, data: bytes) -> list[Decoded]:
        """What these bytes to the robot made whole."""
        return [self._said(frame, to_robot=True) for frame in self._ears.to_robot(data)]

    def to_host(self, data: bytes) -> list[Decoded]:
        """What these bytes from the robot made whole."""
        return [self._said(frame, to_robot=False) for frame in self._ears.to_host(data)]

    @property
    def clock_s(self) -> float:
        """The robot's clock as it was told last; 0 before."""
        return (self._transcript.held.clock or 0) / 1000 if self._transcript else 0.0

    def _said(self, frame: Frame, to_robot: bool) -> Decoded:
        if frame.wrong:
            return {"error": frame.wrong}
        return self._whole().request(frame.data) if to_robot else self._whole().reply(frame.data)

    def _whole(self) -> Transcript:
        """A transcript in the language that is spoken; whether words are of 64 bits shows in the first request."""
        if self._transcript is None:
            wire = SERIAL if self._line != TCP else "tcp64" if self._ears.wide else TCP
            self._transcript = Transcript(wire, self._model)
        return self._transcript


class _TcpEars:
    """Messages of an Nserver's clients, of 32 bits or of 64."""

    def __init__(self) -> None:
        self._requests = TcpFramer(request_bounds)
        self._replies = TcpFramer(reply_bounds, wide=False)
        self.wide = False

    def take_up(self, wide: bool) -> None:
        self._requests.wide = self._replies.wide = self.wide = wide

    def to_robot(self, data: bytes) -> list[Frame]:
        items = self._requests.receive(data)
        self.wide = self._replies.wide = bool(self._requests.wide)
        return self._frames(items, reply=False)

    def to_host(self, data: bytes) -> list[Frame]:
        return self._frames(self._replies.receive(data), reply=True)

    def _frames(self, items: list[TcpFrame | Refused], reply: bool) -> list[Frame]:
        return [
            Frame(tcp_frame.build_frame(item.type, item.payload, wide=self.wide, reply=reply))
            if isinstance(item, TcpFrame)
            else Frame(b"", item.reason)
            for item in items
        ]


class _LineEars:
    """Frames on a robot's own line, among whatever else comes there. `greets`: eleven bare bytes come first."""

    wide = False

    def __init__(self, greets: bool) -> None:
        self._requests = SerialFramer(HOST_LIMIT)
        self._answers = SerialFramer()
        self._hello: bytes | None = b"" if greets else None

    def take_up(self, wide: bool) -> None:
        del wide
        self._hello = None

    def to_robot(self, data: bytes) -> list[Frame]:
        missed = self._answers.pending
        self._answers.clear()
        given_up = [Frame(b"", f"{missed} bytes of an answer that never became whole")] if missed else []
        return given_up + _cut(self._requests, data)

    def to_host(self, data: bytes) -> list[Frame]:
        if self._hello is None:
            return _cut(self._answers, data)
        self._hello += data
        if len(self._hello) < HELLO_SIZE:
            return []
        hello, rest = self._hello[:HELLO_SIZE], self._hello[HELLO_SIZE:]
        self._hello = None
        return [Frame(hello), *_cut(self._answers, rest)]


def _cut(framer: SerialFramer, data: bytes) -> list[Frame]:
    before = framer.skipped_bytes
    found = [Frame(serial_frame.build_frame(frame.type, frame.data)) for frame in framer.receive(data)]
    passed_over = framer.skipped_bytes - before
    return [Frame(b"", f"{passed_over} bytes that are no frame"), *found] if passed_over else found
