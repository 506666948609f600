"""Listens to one connection from outside: cuts what goes by into frames and says what each one is.

    to_robot(bytes) ──> framer ──> Transcript ──> objects as `nomad wire decode` prints them
    to_host(bytes)  ──> framer ──^

Rules: no I/O, no clock; never raises for what goes by, since a line is never clean: bytes that are no frame become an
{"error": ...}. A host empties its input before it asks, so half an answer is given up when a request goes out.

Writes down what goes over connections: one recorder a file, one tape a connection.

    recorder.open(name, line, model) ──> tape.to_robot(bytes)   tape.to_host(bytes)   tape.close()
    recorder.stepped(dt_s)               simulated time passed that nobody asked for

Rules: the clock is handed in; without one, time is the robot's own clock as its answers tell it, so that a run in
simulated time is recorded the same whenever it is made. OFF records nothing and costs nothing.

A stream around a stream that writes down what goes through it, and a program's recording of all its streams.

Rules: bytes are noted as they went, so in the order and the pieces in which the program had them; what failed to go out
is noted too, since part of it may have gone. A connection made anew is another connection of the same file, which is
closed whenever none is open. No clock here: the recorder has one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from nclient.common.hints import version
from nclient.protocol import serial_framing, tcp_framing
from nclient.protocol.client_state import HANDSHAKE_SIZE
from nclient.protocol.decode import WireDecoder
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFramer
from nclient.protocol.tcp_framing import InvalidFrame, TcpFrame, TcpFramer, reply_bounds, request_bounds
from nclient.protocol.types import Model
from nclient.protocol.wire_state import WireState
from nclient.recording.format import CLOSE, IN, OPEN, OUT, TIME, Entry, RecordingWriter
from nclient.transports.stream import ByteStream, Deadline

TCP, SERIAL, HANDSHAKE_FIRST = "tcp", "serial", "hello"
LINES: Final = (TCP, SERIAL, HANDSHAKE_FIRST)
"""The languages of a connection: an Nserver's, a robot's own, and that with eleven bare bytes from the robot first."""
Decoded = dict[str, Any]


class Frame(NamedTuple):
    """The bytes of a whole frame, or what is wrong with some that are none."""

    data: bytes
    wrong: str = ""


class FrameTap(Protocol):
    """The framers of a language, both ways."""

    wide: bool
    """Whether the client is known to be one of 64 bits."""

    def resume(self, wide: bool) -> None: ...
    def to_robot(self, data: bytes) -> list[Frame]: ...
    def to_host(self, data: bytes) -> list[Frame]: ...


def frame_tap_for(line: str, model: Model) -> FrameTap:
    """What cuts the frames of one of LINES. Only a model that has a mask says hello with it."""
    return TcpFrameTap() if line == TCP else SerialFrameTap(line == HANDSHAKE_FIRST and model.sends_mask)


class FrameDecoder:
    """One connection, heard from outside. `line`: one of LINES."""

    def __init__(self, line: str, model: Model) -> None:
        self._ears = frame_tap_for(line, model)
        self._line, self._model = line, model
        self._transcript: WireDecoder | None = None

    def resume(self, wire_state: WireState) -> None:
        """Listen to a connection that went on unheard so far and has come to these terms; between two requests."""
        self._ears.resume(wire_state.wide)
        self._whole().set_wire_state(wire_state)

    def to_robot(self, data: bytes) -> list[Decoded]:
        """What these bytes to the robot made whole."""
        return [self._said(frame, to_robot=True) for frame in self._ears.to_robot(data)]

    def to_host(self, data: bytes) -> list[Decoded]:
        """What these bytes from the robot made whole."""
        return [self._said(frame, to_robot=False) for frame in self._ears.to_host(data)]

    @property
    def clock_s(self) -> float:
        """The robot's clock as it was told last; 0 before."""
        return (self._transcript.client_state.clock or 0) / 1000 if self._transcript else 0.0

    def _said(self, frame: Frame, to_robot: bool) -> Decoded:
        if frame.wrong:
            return {"error": frame.wrong}
        return self._whole().request(frame.data) if to_robot else self._whole().reply(frame.data)

    def _whole(self) -> WireDecoder:
        """A transcript in the language that is spoken; whether words are of 64 bits shows in the first request."""
        if self._transcript is None:
            wire = SERIAL if self._line != TCP else "tcp64" if self._ears.wide else TCP
            self._transcript = WireDecoder(wire, self._model)
        return self._transcript


class TcpFrameTap:
    """Messages of an Nserver's clients, of 32 bits or of 64."""

    def __init__(self) -> None:
        self._requests = TcpFramer(request_bounds)
        self._replies = TcpFramer(reply_bounds, wide=False)
        self.wide = False

    def resume(self, wide: bool) -> None:
        self._requests.wide = self._replies.wide = self.wide = wide

    def to_robot(self, data: bytes) -> list[Frame]:
        items = self._requests.receive(data)
        self.wide = self._replies.wide = bool(self._requests.wide)
        return self._frames(items, reply=False)

    def to_host(self, data: bytes) -> list[Frame]:
        return self._frames(self._replies.receive(data), reply=True)

    def _frames(self, items: list[TcpFrame | InvalidFrame], reply: bool) -> list[Frame]:
        return [
            Frame(tcp_framing.build_frame(item.type, item.payload, wide=self.wide, reply=reply))
            if isinstance(item, TcpFrame)
            else Frame(b"", item.reason)
            for item in items
        ]


class SerialFrameTap:
    """Frames on a robot's own line, among whatever else comes there. `greets`: eleven bare bytes come first."""

    wide = False

    def __init__(self, has_handshake: bool) -> None:
        self._requests = SerialFramer(HOST_LIMIT)
        self._answers = SerialFramer()
        self._hello: bytes | None = b"" if has_handshake else None

    def resume(self, wide: bool) -> None:
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
        if len(self._hello) < HANDSHAKE_SIZE:
            return []
        hello, rest = self._hello[:HANDSHAKE_SIZE], self._hello[HANDSHAKE_SIZE:]
        self._hello = None
        return [Frame(hello), *_cut(self._answers, rest)]


def _cut(framer: SerialFramer, data: bytes) -> list[Frame]:
    before = framer.skipped_bytes
    found = [Frame(serial_framing.build_frame(frame.type, frame.data)) for frame in framer.receive(data)]
    passed_over = framer.skipped_bytes - before
    return [Frame(b"", f"{passed_over} bytes that are no frame"), *found] if passed_over else found


_MOST_PIECES: Final = 1000
"""Different pieces of time that are kept before they are written down."""
_DIGITS: Final = 6


class ConnectionRecorder(Protocol):
    """What records one connection."""

    def to_robot(self, data: bytes) -> None:
        """These bytes went to the robot."""
        ...

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        """These came from it; none: it was asked something, and has said nothing yet. `by_time`: since time passed."""
        ...

    def close(self) -> None:
        """The connection is over. Twice is fine."""
        ...


class Recorder:
    """Everything of a daemon, or of a client.

    clock       seconds since the start; None: the robot's own clock
    line_clock  what a daemon takes the age of half a frame from on a robot's own line, noted as `at`
    """

    def __init__(
        self,
        log: RecordingWriter,
        clock: Callable[[], float] | None = None,
        line_clock: Callable[[], float] | None = None,
    ) -> None:
        self._log = log
        self._clock = clock
        self.line_clock = line_clock
        self._steps: list[tuple[float, int]] = []

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        """A tape for a connection of that name. `line`: one of follower.LINES; `robot_id`: whose own line it is."""
        tape = _ConnectionTape(self, name, FrameDecoder(line, model), None if line == TCP else self.line_clock)
        whose: dict[str, object] = {} if robot_id is None else {"robot_id": robot_id}
        self.write(OPEN, name, 0.0, more={"wire": line, "model": model.name} | whose)
        return tape

    def record_step(self, dt_s: float) -> None:
        """So much simulated time passed in one piece, not by a request."""
        if self._steps and self._steps[-1][0] == dt_s:
            self._steps[-1] = (dt_s, self._steps[-1][1] + 1)
            return
        if len(self._steps) >= _MOST_PIECES:
            self.write(TIME, "", 0.0)
        self._steps.append((dt_s, 1))

    def record_pace(self, factor: float | None, paused: bool) -> None:
        """Time goes otherwise from now on, by no request; State[0] shows it."""
        self.write(TIME, "", 0.0, more={"pace": [factor, paused]})

    def record_change(self, what: Mapping[str, Any]) -> None:
        """The simulation was changed so from now on, by no request."""
        self.write(TIME, "", 0.0, more=dict(what))

    def write(
        self, kind: str, name: str, robots_clock_s: float, data: bytes = b"",
        decoded: tuple[dict[str, object], ...] = (), more: dict[str, object] | None = None,
    ) -> None:  # fmt: skip
        """Add an entry, and the time that passed before it."""
        now_s = round(robots_clock_s if self._clock is None else self._clock(), _DIGITS)
        passed: dict[str, object] = {"steps": [list(piece) for piece in self._steps]} if self._steps else {}
        self._steps.clear()
        self._log.write(Entry(now_s, kind, name, data, decoded, (more or {}) | passed))

    def rest(self) -> None:
        """Let the file go until there is something to write again."""
        self._log.rest()

    def close(self) -> None:
        """Write what time passed last, and let the file go."""
        if self._steps:
            self.write(TIME, "", 0.0)
        self._log.close()


class _ConnectionTape:
    """See Tape."""

    def __init__(
        self, recorder: Recorder, name: str, follower: FrameDecoder, clock: Callable[[], float] | None
    ) -> None:
        self._recorder, self._name, self._follower = recorder, name, follower
        self._clock = clock
        self._over = False

    def to_robot(self, data: bytes) -> None:
        decoded = tuple(self._follower.to_robot(data))
        self._recorder.write(OUT, self._name, self._follower.clock_s, data, decoded, self._at())

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        decoded = tuple(self._follower.to_host(data))
        more: dict[str, object] = {"by_time": True} if by_time else {}
        self._recorder.write(IN, self._name, self._follower.clock_s, data, decoded, self._at() | more)

    def close(self) -> None:
        if not self._over:
            self._over = True
            self._recorder.write(CLOSE, self._name, self._follower.clock_s)

    def _at(self) -> dict[str, object]:
        return {} if self._clock is None else {"at": self._clock()}


class _Off:
    """Records nothing."""

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        del name, line, model, robot_id
        return self

    def to_robot(self, data: bytes) -> None: ...

    def to_host(self, data: bytes, by_time: bool = False) -> None: ...

    def record_step(self, dt_s: float) -> None: ...

    def record_pace(self, factor: float | None, paused: bool) -> None: ...

    def record_change(self, what: Mapping[str, Any]) -> None: ...

    def close(self) -> None: ...


NULL_RECORDER: Final = _Off()
"""What whoever is not recorded hands things to."""


class TrafficRecorder(Protocol):
    """What a daemon hands things to, whether they are written down, looked at, or neither."""

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder: ...
    def record_step(self, dt_s: float) -> None: ...
    def record_pace(self, factor: float | None, paused: bool) -> None: ...
    def record_change(self, what: Mapping[str, Any]) -> None: ...
    def close(self) -> None: ...


class RecordingStream:
    """`stream`, with what passes noted on `tape`."""

    def __init__(self, stream: ByteStream, tape: ConnectionRecorder) -> None:
        self._stream = stream
        self._tape = tape
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send all of it. Raises as the stream does."""
        if not self._closed:
            self._tape.to_robot(data)
        self._stream.send(data)

    def receive(self, deadline: Deadline) -> bytes:
        """What the stream gives. Raises as it does."""
        data = self._stream.receive(deadline)
        self._tape.to_host(data)
        return data

    def close(self) -> None:
        """Let go of both."""
        self._stream.close()
        if not self._closed:
            self._closed = True
            self._tape.close()


class RecordingTarget(NamedTuple):
    """Whom a program records: the address, the language (one of follower.LINES) and the robot's model."""

    address: str
    line: str
    model: Model


class ClientRecording:
    """What one program records of one address, over however many connections.

    clock    seconds since the start; None: the robot's own clock, so that the same run is the same file
    started  when that start was

    Raises RecordingError when the file cannot be made.
    """

    def __init__(
        self,
        path: Path,
        what: RecordingTarget,
        clock: Callable[[], float] | None = None,
        started: datetime | None = None,
    ) -> None:
        header = {
            "package": version(),
            "started": started and started.isoformat(timespec="seconds"),
            "time": "the robot's clock" if clock is None else "seconds since the start",
            "address": what.address, "wire": what.line, "model": what.model.name,
        }  # fmt: skip
        self._recorder = Recorder(RecordingWriter(path, header), clock)
        self._line, self._model = what.line, what.model
        self._count = 0

    def wrap(self, stream: ByteStream) -> RecordingStream:
        """The stream, recorded."""
        self._count += 1
        tape = self._recorder.open(str(self._count), self._line, self._model)
        return RecordingStream(stream, _Resting(tape, self._recorder))


class _Resting:
    """A tape after which the file rests."""

    def __init__(self, tape: ConnectionRecorder, recorder: Recorder) -> None:
        self._tape, self._recorder = tape, recorder
        self.to_robot, self.to_host = tape.to_robot, tape.to_host

    def close(self) -> None:
        self._tape.close()
        self._recorder.rest()
