"""Traffic for the page: a recorder that decodes the frames of all connections and passes them to the real recorder.

    row     {"time_s": simulated, "who": connection, "to": "robot" | "host", "what": C name or kind of reply,
             "of": C name of the request that this is or answers, "text": readable form, "hex": its bytes, "size": how
             many, "parts": of a request [["code", its number], [name, value] ...], of a reply []}

Nothing is decoded while no page watches. Decoding of a connection starts between two requests, from the wire state of
its session. At most MAX_ROWS rows are sent with a picture: further ones are counted, and decoding of the connection
starts again with the next picture.
"""

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

MAX_ROWS: Final = 40
MAX_PENDING: Final = 64
"""Requests of a connection that wait for their reply."""
HANDSHAKE: Final = "hello"
"""The unrequested reply with which a robot's own line begins."""
MAX_HEX: Final = 512
"""Bytes of a row that are shown."""
WireStateOf = Callable[[str], WireState | None]
"""Maps the name of a connection to its wire state; None within a request, or for an unknown connection."""
Row = dict[str, Any]


class TrafficMonitor:
    """Recorder that makes rows for the page.

    Parameters
    ----------
    inner : the recorder to which everything is passed on.
    wire_state_of : wire states of connections by name.
    time_s : returns simulated time.
    """

    def __init__(self, inner: TrafficRecorder, wire_state_of: WireStateOf, time_s: Callable[[], float]) -> None:
        self.inner = inner
        self.watched = False
        """True while a page watches."""
        self.missed = 0
        """Frames that were not decoded since the last rows."""
        self.wire_state_of = wire_state_of
        self._time_s = time_s
        self._rows: list[Row] = []

    def rows(self) -> list[Row]:
        """Return the rows since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        """Return the recorder of a connection."""
        return _ConnectionTraffic(self, name, line, model, self.inner.open(name, line, model, robot_id))

    def record_step(self, dt_s: float) -> None:
        """Pass on a step of simulated time."""
        self.inner.record_step(dt_s)

    def record_pace(self, factor: float | None, paused: bool) -> None:
        """Pass on a change of pace."""
        self.inner.record_pace(factor, paused)

    def record_change(self, what: Mapping[str, Any]) -> None:
        """Pass on a change of the simulation."""
        self.inner.record_change(what)

    def close(self) -> None:
        """Close the inner recorder."""
        self.inner.close()

    @property
    def is_full(self) -> bool:
        """True if no more rows are made until the present ones have been fetched."""
        return len(self._rows) >= MAX_ROWS

    def add(self, name: str, to: str, data: bytes, frames: list[Decoded], pending: deque[str], line: str) -> None:
        """Add the rows of decoded frames; `pending` has the connection's requests that wait for a reply."""
        for frame in frames:
            self._rows.append({
                "time_s": round(self._time_s(), 3), "who": name, "to": to,
                "what": frame.get("call") or frame.get("reply") or "error", "of": _command_of(frame, pending),
                "text": format_frame(frame),
                "hex": data[:MAX_HEX].hex(" "), "size": len(data), "parts": parts(frame, line),
            })  # fmt: skip


def _command_of(frame: Decoded, pending: deque[str]) -> str:
    """Return the command that a frame is or answers; replies come in the order of the requests."""
    name: str = frame.get("call", "")
    if name and BY_NAME[name].has_tcp_reply:
        pending.append(name)
    return name or (pending.popleft() if "reply" in frame and frame["reply"] != HANDSHAKE and pending else "")


def parts(frame: Decoded, line: str) -> list[list[Any]]:
    """Return a request's code and its arguments by name; arguments of variable number are numbered from 1."""
    if "call" not in frame:
        return []
    row = BY_NAME[frame["call"]]
    names = [argument.name for argument in row.arguments]
    extra: list[list[Any]] = []
    if row.extra_arguments is not None:
        name, position = row.extra_arguments
        del names[position]
        extra = [[name, frame[name]]] if name in frame else []
    args = frame["args"]
    names = names[: len(args)] + [str(k + 1) for k in range(len(args) - len(names))]
    code = row.tcp_type if line == TCP else row.line_type
    return [["code", code], *extra, *map(list, zip(names, args, strict=True))]


class _ConnectionTraffic:
    """Recorder of one connection."""

    def __init__(
        self, traffic: TrafficMonitor, name: str, line: str, model: Model, inner: ConnectionRecorder
    ) -> None:
        self._traffic, self._inner = traffic, inner
        self._name, self._line, self._model = name, line, model
        self._decoder: FrameDecoder | None = FrameDecoder(line, model)
        self._pending: deque[str] = deque(maxlen=MAX_PENDING)

    def to_robot(self, data: bytes) -> None:
        """Record a request."""
        self._inner.to_robot(data)
        if self._is_watched():
            if self._decoder is None:
                self._start_decoding()
            if self._decoder is not None:
                self._traffic.add(self._name, "robot", data, self._decoder.to_robot(data), self._pending, self._line)

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        """Record a reply."""
        self._inner.to_host(data, by_time)
        if self._is_watched() and self._decoder is not None:
            self._traffic.add(self._name, "host", data, self._decoder.to_host(data), self._pending, self._line)

    def close(self) -> None:
        """Close the inner recorder."""
        self._inner.close()

    def _is_watched(self) -> bool:
        if self._traffic.watched and not self._traffic.is_full:
            return True
        self._traffic.missed += self._traffic.watched
        self._decoder = None
        self._pending.clear()
        return False

    def _start_decoding(self) -> None:
        wire_state = self._traffic.wire_state_of(self._name)
        if wire_state is None:
            return
        self._decoder = FrameDecoder(SERIAL if self._line == HANDSHAKE_FIRST else self._line, self._model)
        self._decoder.resume(wire_state)
