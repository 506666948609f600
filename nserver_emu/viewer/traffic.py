"""What clients say and are answered, for who watches: a recorder that listens in before it hands on to the real one.

    row     {"time_s": simulated, "who": connection, "to": "robot" | "host", "what": C name or kind of reply,
             "of": C name of what is asked or answered, "text": in words, "hex": the bytes it came in, "size": how many,
             "parts": of a request, [["code", its number], [name, value] ...]; of a reply, which has no code, none}

Rules: while nobody watches, nothing is decoded. A connection is taken up between two requests, on the terms that its
session has come to by then. No more than MOST_ROWS are told a picture: what is beyond is counted, and the
connection taken up anew with the next.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from nclient.protocol.commands import BY_NAME
from nclient.protocol.types import Model
from nclient.protocol.wire_state import WireState
from nclient.recording.format import format_frame
from nclient.recording.recorder import (
    HANDSHAKE_FIRST,
    SERIAL,
    TCP,
    ConnectionRecorder,
    Decoded,
    FrameDecoder,
    TrafficRecorder,
)

MOST_ROWS: Final = 40
MOST_ASKED: Final = 64
"""Requests of a connection that are remembered until they are answered."""
GREETING: Final = "hello"
"""The reply that nobody asked for, when a robot's own line begins."""
MOST_HEX: Final = 512
"""Bytes of a row that are shown."""
TermsOf = Callable[[str], WireState | None]
"""The terms of the connection of that name; None: it is in the middle of a request, or unknown."""
Row = dict[str, Any]


class Listening:
    """See the head of this file. `watched`: whether anybody looks; `time_s`: simulated time."""

    def __init__(self, inner: TrafficRecorder, wire_state_of: TermsOf, time_s: Callable[[], float]) -> None:
        self.inner = inner
        self.watched = False
        self.missed = 0
        self.wire_state_of = wire_state_of
        self._time_s = time_s
        self._rows: list[Row] = []

    def rows(self) -> list[Row]:
        """What was said since this was asked last."""
        rows, self._rows = self._rows, []
        return rows

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        """A tape that listens, before the real one's."""
        return _Ear(self, name, line, model, self.inner.open(name, line, model, robot_id))

    def record_step(self, dt_s: float) -> None:
        """Handed on."""
        self.inner.record_step(dt_s)

    def record_pace(self, factor: float | None, paused: bool) -> None:
        """Handed on."""
        self.inner.record_pace(factor, paused)

    def record_change(self, what: Mapping[str, Any]) -> None:
        """Handed on."""
        self.inner.record_change(what)

    def close(self) -> None:
        """Handed on."""
        self.inner.close()

    @property
    def full(self) -> bool:
        """Whether no more rows are told until somebody has fetched those there are."""
        return len(self._rows) >= MOST_ROWS

    def note(self, who: str, to: str, data: bytes, found: list[Decoded], asked: deque[str], line: str) -> None:
        """These frames went by; `asked`: what is not answered yet; `line`: how they went."""
        for frame in found:
            self._rows.append({
                "time_s": round(self._time_s(), 3), "who": who, "to": to,
                "what": frame.get("call") or frame.get("reply") or "error", "of": _of(frame, asked),
                "text": format_frame(frame),
                "hex": data[:MOST_HEX].hex(" "), "size": len(data), "parts": parts(frame, line),
            })  # fmt: skip


def _of(frame: Decoded, asked: deque[str]) -> str:
    """The command that a frame is, or that it answers: answers come in the order of what was asked."""
    name: str = frame.get("call", "")
    if name and BY_NAME[name].has_tcp_reply:
        asked.append(name)
    return name or (asked.popleft() if "reply" in frame and frame["reply"] != GREETING and asked else "")


def parts(frame: Decoded, line: str) -> list[list[Any]]:
    """The code of a request and its arguments, by name; those that vary in number are numbered from 1."""
    if "call" not in frame:
        return []
    row = BY_NAME[frame["call"]]
    names = [argument.name for argument in row.arguments]
    beside: list[list[Any]] = []
    if row.extra_arguments is not None:
        name, place = row.extra_arguments
        del names[place]
        beside = [[name, frame[name]]] if name in frame else []
    args = frame["args"]
    names = names[: len(args)] + [str(k + 1) for k in range(len(args) - len(names))]
    code = row.tcp_type if line == TCP else row.line_type
    return [["code", code], *beside, *map(list, zip(names, args, strict=True))]


class _Ear:
    """The tape of one connection."""

    def __init__(self, listening: Listening, name: str, line: str, model: Model, inner: ConnectionRecorder) -> None:
        self._listening, self._inner = listening, inner
        self._name, self._line, self._model = name, line, model
        self._follower: FrameDecoder | None = FrameDecoder(line, model)
        self._asked: deque[str] = deque(maxlen=MOST_ASKED)

    def to_robot(self, data: bytes) -> None:
        self._inner.to_robot(data)
        if self._hears():
            if self._follower is None:
                self._take_up()
            if self._follower is not None:
                self._listening.note(self._name, "robot", data, self._follower.to_robot(data), self._asked,
                                     self._line)

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        self._inner.to_host(data, by_time)
        if self._hears() and self._follower is not None:
            self._listening.note(self._name, "host", data, self._follower.to_host(data), self._asked, self._line)

    def close(self) -> None:
        self._inner.close()

    def _hears(self) -> bool:
        if self._listening.watched and not self._listening.full:
            return True
        self._listening.missed += self._listening.watched
        self._follower = None
        self._asked.clear()
        return False

    def _take_up(self) -> None:
        wire_state = self._listening.wire_state_of(self._name)
        if wire_state is None:
            return
        self._follower = FrameDecoder(SERIAL if self._line == HANDSHAKE_FIRST else self._line, self._model)
        self._follower.resume(wire_state)
