"""The interface of byte streams, and the deadline of every wait.

A stream knows nothing of messages. Two errors leave it: ReplyTimeout if nothing came in time, ConnectionLost if nothing
will ever come. What wraps a stream (a recorder, a fault injector) is a `ByteStream` again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol


class Deadline:
    """A moment on a clock in seconds: the monotonic one unless another is given, such as that of a simulation."""

    __slots__ = ("_at_s", "_clock")

    def __init__(self, at_s: float, clock: Callable[[], float] | None = None) -> None:
        self._at_s = at_s
        self._clock = clock or time.monotonic

    @classmethod
    def after(cls, seconds: float, clock: Callable[[], float] | None = None) -> Deadline:
        """Return the deadline that many seconds from now."""
        clock = clock or time.monotonic
        return cls(clock() + seconds, clock)

    def remaining(self) -> float:
        """Return the seconds left, 0 if the deadline has passed."""
        return max(0.0, self._at_s - self._clock())


class ByteStream(Protocol):
    """Bytes to and from the other end of a connection."""

    def send(self, data: bytes) -> None:
        """Send all bytes. Raises ConnectionLost."""

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte, as soon as there is one.

        A deadline that has passed still returns what has already arrived.

        Raises
        ------
        ReplyTimeout
            If nothing arrives before the deadline.
        ConnectionLost
            If either end has closed the connection.
        """

    def close(self) -> None:
        """Close the stream; a `receive` in another thread ends with ConnectionLost. May be called twice."""
