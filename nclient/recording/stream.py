"""A stream around a stream that writes down what goes through it. The streams that are recorded run unchanged.

Rules: bytes are noted as they went, so in the order and the pieces in which the program had them; what failed to go out
is noted too, since part of it may have gone. No clock here: the recorder has one.
"""

from __future__ import annotations

from nclient.recording.recorder import Tape
from nclient.transports.byte_stream import ByteStream, Deadline


class RecordingStream:
    """`stream`, with what passes noted on `tape`."""

    def __init__(self, stream: ByteStream, tape: Tape) -> None:
        self._stream = stream
        self._tape = tape

    def send(self, data: bytes) -> None:
        """Send all of it. Raises as the stream does."""
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
        self._tape.close()
