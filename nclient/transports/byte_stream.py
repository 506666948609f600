"""The seam between bytes and their meaning: three methods wide. And the deadline that every wait has.

    send(data)   receive(deadline) -> bytes   close()

Rules: a stream knows no message. What fails here is one of two things: nothing came in time (ReplyTimeout), or
nothing will ever come (ConnectionLost). Whatever wraps a stream (a recorder, a fault plan) is a stream again.
"""

from __future__ import annotations

import time
from typing import Protocol


class Deadline:
    """A moment of the monotonic clock by which something must have come."""

    __slots__ = ("_at_s",)

    def __init__(self, at_s: float) -> None:
        self._at_s = at_s

    @classmethod
    def after(cls, seconds: float) -> Deadline:
        """The moment so many seconds from now."""
        return cls(time.monotonic() + seconds)

    def remaining(self) -> float:
        """Seconds left; 0 when it is past."""
        return max(0.0, self._at_s - time.monotonic())


class ByteStream(Protocol):
    """Bytes to the other end and back."""

    def send(self, data: bytes) -> None:
        """Send all of it. Raises ConnectionLost."""
        ...

    def receive(self, deadline: Deadline) -> bytes:
        """At least one byte, as soon as there is one. Raises ReplyTimeout at the deadline, ConnectionLost when closed.

        A deadline that is past still gives what has come already.
        """
        ...

    def close(self) -> None:
        """Let go; what waits in `receive`, on another thread too, ends with ConnectionLost. Closing twice is fine."""
        ...
