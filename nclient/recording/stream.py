"""A stream around a stream that writes down what goes through it, and a program's recording of all its streams.

Rules: bytes are noted as they went, so in the order and the pieces in which the program had them; what failed to go out
is noted too, since part of it may have gone. A connection made anew is another connection of the same file, which is
closed whenever none is open. No clock here: the recorder has one.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from nclient.distribution import version
from nclient.protocol.models import Model
from nclient.recording.log import LogWriter
from nclient.recording.recorder import Recorder, Tape
from nclient.transports.byte_stream import ByteStream, Deadline


class RecordingStream:
    """`stream`, with what passes noted on `tape`."""

    def __init__(self, stream: ByteStream, tape: Tape) -> None:
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


class Recorded(NamedTuple):
    """Whom a program records: the address, the language (one of follower.LINES) and the robot's model."""

    address: str
    line: str
    model: Model


class ProgramsRecording:
    """What one program records of one address, over however many connections.

    clock    seconds since the start; None: the robot's own clock, so that the same run is the same file
    started  when that start was

    Raises RecordingError when the file cannot be made.
    """

    def __init__(
        self, path: Path, what: Recorded, clock: Callable[[], float] | None = None, started: datetime | None = None
    ) -> None:
        header = {
            "package": version(),
            "started": started and started.isoformat(timespec="seconds"),
            "time": "the robot's clock" if clock is None else "seconds since the start",
            "address": what.address, "wire": what.line, "model": what.model.name,
        }  # fmt: skip
        self._recorder = Recorder(LogWriter(path, header), clock)
        self._line, self._model = what.line, what.model
        self._count = 0

    def around(self, stream: ByteStream) -> RecordingStream:
        """The stream, recorded."""
        self._count += 1
        tape = self._recorder.open(str(self._count), self._line, self._model)
        return RecordingStream(stream, _Resting(tape, self._recorder))


class _Resting:
    """A tape after which the file rests."""

    def __init__(self, tape: Tape, recorder: Recorder) -> None:
        self._tape, self._recorder = tape, recorder
        self.to_robot, self.to_host = tape.to_robot, tape.to_host

    def close(self) -> None:
        self._tape.close()
        self._recorder.rest()
