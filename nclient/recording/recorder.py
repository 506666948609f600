"""Recording of connections: frames, decoder, recorder and the recording stream.

    to_robot(bytes) ──> FrameTap ──> WireDecoder ──> dictionaries as `nomad wire decode` prints them
    to_host(bytes)  ──> FrameTap ──^                          (class FrameDecoder)

    recorder.open(name, line, model) ──> to_robot(bytes)   to_host(bytes)   close()
    recorder.record_step(dt_s)           simulated time that passed without a request

Invalid bytes never raise: they become {"error": ...}. On the serial line a host discards its input before each
request, so an incomplete reply is given up when a request is sent.

The clock is passed in; without one, times are the robot's clock in its replies, so that a run in simulated time gives
the same file every time.
"""

from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from nclient.errors import version
from nclient.protocol import codec, serial_framing
from nclient.protocol.client_state import HANDSHAKE_SIZE
from nclient.protocol.codec import InvalidFrame, TcpFrame, TcpFramer, reply_bounds, request_bounds
from nclient.protocol.decode import WireDecoder
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFramer
from nclient.protocol.types import Model, WireState
from nclient.recording.format import CLOSE, IN, OPEN, OUT, TIME, Entry, RecordingWriter
from nclient.transports.stream import ByteStream, Deadline

TCP, SERIAL, HANDSHAKE_FIRST = "tcp", "serial", "hello"
LINES: Final = (TCP, SERIAL, HANDSHAKE_FIRST)
"""Protocols of a connection: Nserver's, the serial line's, and the serial line's after a handshake of the robot."""
Decoded = dict[str, Any]


# -- frames and their decoding ----------------------------------------------------------------------------------------


class Frame(NamedTuple):
    """Bytes of a whole frame, or the reason why bytes were rejected."""

    data: bytes
    error: str = ""


class TcpFrameTap:
    """Messages of a 32-bit or 64-bit client of Nserver."""

    def __init__(self) -> None:
        self._requests = TcpFramer(request_bounds)
        self._replies = TcpFramer(reply_bounds, wide=False)
        self.wide = False

    def resume(self, wide: bool) -> None:
        """Continue in words of 8 bytes (`wide`) or 4, without a CONNECT."""
        self._requests.wide = self._replies.wide = self.wide = wide

    def to_robot(self, data: bytes) -> list[Frame]:
        """Return completed requests; a CONNECT decides the word size of both directions."""
        items = self._requests.receive(data)
        self.wide = self._replies.wide = bool(self._requests.wide)
        return self._frames(items, reply=False)

    def to_host(self, data: bytes) -> list[Frame]:
        """Return completed replies."""
        return self._frames(self._replies.receive(data), reply=True)

    def _frames(self, items: list[TcpFrame | InvalidFrame], reply: bool) -> list[Frame]:
        return [Frame(codec.build_frame(item.type, item.payload, wide=self.wide, reply=reply))
                if isinstance(item, TcpFrame) else Frame(b"", item.reason) for item in items]


class SerialFrameTap:
    """Frames of the serial line among other bytes; with `has_handshake` eleven bytes of the robot come first."""

    wide = False

    def __init__(self, has_handshake: bool) -> None:
        self._requests = SerialFramer(HOST_LIMIT)
        self._replies = SerialFramer()
        self._handshake: bytes | None = b"" if has_handshake else None

    def resume(self, wide: bool) -> None:
        """Continue without expecting a handshake."""
        del wide
        self._handshake = None

    def to_robot(self, data: bytes) -> list[Frame]:
        """Return completed requests, and what was discarded of an incomplete reply."""
        # A host discards what it has received before it sends a request.
        missed = self._replies.pending
        self._replies.clear()
        discarded = [Frame(b"", f"{missed} bytes of an answer that never became whole")] if missed else []
        return discarded + _frames_of(self._requests, data)

    def to_host(self, data: bytes) -> list[Frame]:
        """Return the handshake if one is expected, then completed replies."""
        if self._handshake is None:
            return _frames_of(self._replies, data)
        self._handshake += data
        if len(self._handshake) < HANDSHAKE_SIZE:
            return []
        handshake, rest = self._handshake[:HANDSHAKE_SIZE], self._handshake[HANDSHAKE_SIZE:]
        self._handshake = None
        return [Frame(handshake), *_frames_of(self._replies, rest)]


def _frames_of(framer: SerialFramer, data: bytes) -> list[Frame]:
    before = framer.skipped_bytes
    frames = [Frame(serial_framing.build_frame(frame.type, frame.data)) for frame in framer.receive(data)]
    skipped = framer.skipped_bytes - before
    return [Frame(b"", f"{skipped} bytes that are no frame"), *frames] if skipped else frames


FrameTap = TcpFrameTap | SerialFrameTap
"""Framers of one connection, in both directions; `wide` is True if the client is known to be a 64-bit one."""


def make_frame_tap(line: str, model: Model) -> FrameTap:
    """Return the framers for a protocol of LINES. Only models with a mask send a handshake."""
    return TcpFrameTap() if line == TCP else SerialFrameTap(line == HANDSHAKE_FIRST and model.sends_mask)


class FrameDecoder:
    """Decoder of the bytes of one connection.

    Parameters
    ----------
    line
        Protocol, one of LINES.
    model
        Model of the robot.
    """

    def __init__(self, line: str, model: Model) -> None:
        self._tap = make_frame_tap(line, model)
        self._line, self._model = line, model
        self._decoder: WireDecoder | None = None

    def resume(self, wire_state: WireState) -> None:
        """Continue a connection whose beginning was not seen, between two requests."""
        self._tap.resume(wire_state.wide)
        self._get_decoder().set_wire_state(wire_state)

    def to_robot(self, data: bytes) -> list[Decoded]:
        """Return the decoded frames that these bytes to the robot complete."""
        return [self._decode(frame, to_robot=True) for frame in self._tap.to_robot(data)]

    def to_host(self, data: bytes) -> list[Decoded]:
        """Return the decoded frames that these bytes from the robot complete."""
        return [self._decode(frame, to_robot=False) for frame in self._tap.to_host(data)]

    @property
    def clock_s(self) -> float:
        """Return the robot's clock in its last reply, 0 before the first one."""
        return (self._decoder.client_state.clock or 0) / 1000 if self._decoder else 0.0

    def _decode(self, frame: Frame, to_robot: bool) -> Decoded:
        if frame.error:
            return {"error": frame.error}
        return self._get_decoder().request(frame.data) if to_robot else self._get_decoder().reply(frame.data)

    def _get_decoder(self) -> WireDecoder:
        # Created with the first frame: the first request shows the word size.
        if self._decoder is None:
            wire = SERIAL if self._line != TCP else "tcp64" if self._tap.wide else TCP
            self._decoder = WireDecoder(wire, self._model)
        return self._decoder


# -- recorders --------------------------------------------------------------------------------------------------------

_MAX_STEPS: Final = 1000
"""Maximum number of different time steps that are collected before they are written."""
_DIGITS: Final = 6


class ConnectionRecorder(Protocol):
    """Recorder of one connection."""

    def to_robot(self, data: bytes) -> None:
        """Record bytes sent to the robot."""

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        """Record bytes from the robot.

        Parameters
        ----------
        data
            Empty if there is no reply yet to the last request.
        by_time
            True if the reply was sent because simulated time passed.
        """

    def close(self) -> None:
        """Record the end of the connection; idempotent."""


class TrafficRecorder(Protocol):
    """Interface of a server to its recorder."""

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        """Start the record of a connection."""

    def record_step(self, dt_s: float) -> None:
        """Record a time step of `dt_s` seconds that no request caused."""

    def record_pace(self, factor: float | None, paused: bool) -> None:
        """Record a change of pace that no request caused; State[0] shows the pace."""

    def record_change(self, what: Mapping[str, Any]) -> None:
        """Record a change of the simulation that no request caused."""

    def close(self) -> None:
        """Write the last time steps and close the recording."""


class Recorder:
    """Recorder of all connections of a server or client into one file.

    Parameters
    ----------
    log
        The file.
    clock
        Returns seconds since the start; None for the robot's clock.
    line_clock
        Returns the time from which a server takes the age of an incomplete serial frame, recorded as `at`.
    """

    def __init__(self, log: RecordingWriter, clock: Callable[[], float] | None = None,
                 line_clock: Callable[[], float] | None = None) -> None:
        self._log = log
        self._clock = clock
        self.line_clock = line_clock
        self._steps: list[tuple[float, int]] = []

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        """Record a new connection.

        Parameters
        ----------
        name
            Name of the connection in the file.
        line
            Protocol, one of LINES.
        model
            Model of the robot.
        robot_id
            Number of the robot for a serial line.
        """
        clock = None if line == TCP else self.line_clock
        connection = _ConnectionRecorder(self, name, FrameDecoder(line, model), clock)
        robot: dict[str, object] = {} if robot_id is None else {"robot_id": robot_id}
        self.write(OPEN, name, 0.0, more={"wire": line, "model": model.name} | robot)
        return connection

    def record_step(self, dt_s: float) -> None:
        """Record a time step that no request caused."""
        # Equal steps are counted, so that an idle simulation writes little.
        if self._steps and self._steps[-1][0] == dt_s:
            self._steps[-1] = (dt_s, self._steps[-1][1] + 1)
            return
        if len(self._steps) >= _MAX_STEPS:
            self.write(TIME, "", 0.0)
        self._steps.append((dt_s, 1))

    def record_pace(self, factor: float | None, paused: bool) -> None:
        """Record a change of pace that no request caused; State[0] shows the pace."""
        self.write(TIME, "", 0.0, more={"pace": [factor, paused]})

    def record_change(self, what: Mapping[str, Any]) -> None:
        """Record a change of the simulation that no request caused."""
        self.write(TIME, "", 0.0, more=dict(what))

    def write(self, kind: str, name: str, robots_clock_s: float, data: bytes = b"",
              decoded: tuple[dict[str, object], ...] = (), more: dict[str, object] | None = None) -> None:
        """Write an entry, with the time steps before it."""
        # A given clock, such as that of a simulation, replaces the robot's.
        now_s = round(robots_clock_s if self._clock is None else self._clock(), _DIGITS)
        steps: dict[str, object] = {"steps": [list(step) for step in self._steps]} if self._steps else {}
        self._steps.clear()
        self._log.write(Entry(now_s, kind, name, data, decoded, (more or {}) | steps))

    def release(self) -> None:
        """Close the file until the next entry."""
        self._log.release()

    def close(self) -> None:
        """Write the last time steps and close the file."""
        if self._steps:
            self.write(TIME, "", 0.0)
        self._log.close()


class _ConnectionRecorder:
    """ConnectionRecorder that writes to a Recorder."""

    def __init__(self, recorder: Recorder, name: str, decoder: FrameDecoder, clock: Callable[[], float] | None) -> None:
        self._recorder, self._name, self._decoder = recorder, name, decoder
        self._clock = clock
        self._closed = False

    def to_robot(self, data: bytes) -> None:
        decoded = tuple(self._decoder.to_robot(data))
        self._recorder.write(OUT, self._name, self._decoder.clock_s, data, decoded, self._at())

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        decoded = tuple(self._decoder.to_host(data))
        more: dict[str, object] = {"by_time": True} if by_time else {}
        self._recorder.write(IN, self._name, self._decoder.clock_s, data, decoded, self._at() | more)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._recorder.write(CLOSE, self._name, self._decoder.clock_s)

    def _at(self) -> dict[str, object]:
        return {} if self._clock is None else {"at": self._clock()}


class _NullRecorder:
    """TrafficRecorder and ConnectionRecorder that record nothing."""

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        del name, line, model, robot_id
        return self

    def to_robot(self, data: bytes) -> None: ...

    def to_host(self, data: bytes, by_time: bool = False) -> None: ...

    def record_step(self, dt_s: float) -> None: ...

    def record_pace(self, factor: float | None, paused: bool) -> None: ...

    def record_change(self, what: Mapping[str, Any]) -> None: ...

    def close(self) -> None: ...


NULL_RECORDER: Final = _NullRecorder()
"""Recorder for servers without --record."""


# -- recording of a program's own connections -------------------------------------------------------------------------


class RecordingStream:
    """A stream that records its traffic in the order and the pieces of the program's calls.

    Bytes are recorded before they are sent, because part of them may be sent even if sending fails.

    Parameters
    ----------
    stream
        The stream to record.
    recorder
        Recorder of this connection.
    on_close
        Called once the end is recorded.
    """

    def __init__(self, stream: ByteStream, recorder: ConnectionRecorder,
                 on_close: Callable[[], None] = lambda: None) -> None:
        self._stream = stream
        self._recorder = recorder
        self._on_close = on_close
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send all bytes. Raises as the stream does."""
        if not self._closed:
            self._recorder.to_robot(data)
        self._stream.send(data)

    def receive(self, deadline: Deadline) -> bytes:
        """Receive as the stream does, errors included."""
        data = self._stream.receive(deadline)
        self._recorder.to_host(data)
        return data

    def close(self) -> None:
        """Close the stream and record it; idempotent."""
        self._stream.close()
        if not self._closed:
            self._closed = True
            self._recorder.close()
            self._on_close()


class ClientRecording:
    """Recording of all connections that a program opens to one address; a reconnect is another connection.

    Parameters
    ----------
    path
        File to write.
    address
        Address of the robot.
    line
        Protocol, one of LINES.
    model
        Model of the robot.
    clock
        Returns seconds since the start; None for the robot's clock, so that the same run gives the same file.
    started
        Date and time of the start.

    Raises
    ------
    RecordingError
        If the file cannot be created.
    """

    def __init__(self, path: Path, address: str, line: str, model: Model, clock: Callable[[], float] | None = None,
                 started: datetime | None = None) -> None:
        header = {
            "package": version(),
            "started": started and started.isoformat(timespec="seconds"),
            "time": "the robot's clock" if clock is None else "seconds since the start",
            "address": address, "wire": line, "model": model.name,
        }  # fmt: skip
        self._recorder = Recorder(RecordingWriter(path, header), clock)
        self._line, self._model = line, model
        self._count = 0

    def wrap(self, stream: ByteStream) -> RecordingStream:
        """Return a stream that records `stream` as the next connection. The file is open as long as a connection is."""
        self._count += 1
        connection = self._recorder.open(str(self._count), self._line, self._model)
        return RecordingStream(stream, connection, self._recorder.release)
