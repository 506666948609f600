"""The seam between bytes and their meaning: three methods wide. And the deadline that every wait has.

    send(data)   receive(deadline) -> bytes   close()

Rules: a stream knows no message. What fails here is one of two things: nothing came in time (ReplyTimeout), or
nothing will ever come (ConnectionLost). Whatever wraps a stream (a recorder, a fault plan) is a stream again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol


class Deadline:
    """A moment by which something must have come. `clock`: seconds; the monotonic one, or that of a simulation."""

    __slots__ = ("_at_s", "_clock")

    def __init__(self, at_s: float, clock: Callable[[], float] | None = None) -> None:
        self._at_s = at_s
        self._clock = clock or time.monotonic

    @classmethod
    def after(cls, seconds: float, clock: Callable[[], float] | None = None) -> Deadline:
        """The moment so many seconds from now."""
        clock = clock or time.monotonic
        return cls(clock() + seconds, clock)

    def remaining(self) -> float:
        """Seconds left; 0 when it is past."""
        return max(0.0, self._at_s - self._clock())


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
