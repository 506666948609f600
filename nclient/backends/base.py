"""The interface of backends, the base class of their wrappers, and statistics of a link.

A backend is one session with one robot: `execute(call)` returns the reply. What wraps a backend (retries, a speed
limit) is a `Backend` again. Backends are not thread-safe: `Robot` holds a lock.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Final, Protocol

from nclient.protocol.commands import Call
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.wire_state import WireState

BUCKETS_S: Final[tuple[float, ...]] = tuple(0.0001 * (1 << k) for k in range(20))
"""Upper edges of the latency buckets, 0.1 ms x 2^k up to 52 s; a last bucket has everything above."""


@dataclass(slots=True)
class LinkStatistics:
    """Counts and latencies of a link since connecting, across reconnects. An exchange is one request sent."""

    exchanges: int = 0
    answers: int = 0
    """Exchanges that ended with an accepted reply, NAKs included."""
    frames: int = 0
    """Frames received with a valid checksum."""
    skipped_bytes: int = 0
    """Bytes received that belong to no valid frame."""
    checksum_errors: int = 0
    """Complete frames with a wrong checksum."""
    misfits: int = 0
    """Valid frames whose data do not fit any reply of this model and mask."""
    implausible: int = 0
    """Replies rejected by validation."""
    strays: int = 0
    """Frames that answer no outstanding request: mostly late replies."""
    naks: int = 0
    timeouts: int = 0
    """Exchanges without an accepted reply in time."""
    retries: int = 0
    losses: int = 0
    """Connections lost."""
    reconnects: int = 0
    latencies: list[int] = field(default_factory=lambda: [0] * (len(BUCKETS_S) + 1))
    """Histogram over `BUCKETS_S`."""
    longest_s: float = 0.0
    """Maximum latency."""

    def record_latency(self, seconds: float) -> None:
        """Count a reply and the time it took."""
        self.answers += 1
        self.latencies[bisect_left(BUCKETS_S, seconds)] += 1
        self.longest_s = max(self.longest_s, seconds)

    def latency_s(self, fraction: float) -> float:
        """Return a quantile of the latencies in seconds.

        Parameters
        ----------
        fraction
            Fraction of replies that took no longer, 0 to 1.

        Returns
        -------
        float
            The upper edge of a bucket, at most the maximum latency; 0 before any reply.
        """
        # Sum up buckets until the fraction is reached; the last bucket has no upper edge.
        needed, count = fraction * sum(self.latencies), 0
        for edge, in_bucket in zip(BUCKETS_S, self.latencies, strict=False):
            count += in_bucket
            if count >= needed:
                return min(edge, self.longest_s)
        return self.longest_s

    def counts(self) -> dict[str, int]:
        """Return the counts by name."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name not in _TIMES}

    def __str__(self) -> str:
        """Return three lines: exchanges, faults, latencies."""
        faults = [f"{count} {name.replace('_', ' ')}" for name, count in self.counts().items()
                  if count and name not in _NO_FAULTS]
        times = ", ".join(f"{part:.0%} within {1000 * self.latency_s(part):.3g} ms" for part in (0.5, 0.99))
        return "\n".join([
            f"{self.exchanges} exchanges, {self.answers} answers",
            ", ".join(faults) or "no faults seen",
            f"{times}, the longest {1000 * self.longest_s:.3g} ms" if self.answers else "no times yet",
        ])


_TIMES: Final = frozenset({"latencies", "longest_s"})
_NO_FAULTS: Final = frozenset({"exchanges", "answers", "frames"})


class Backend(Protocol):
    """A session with one robot."""

    @property
    def wire_state(self) -> WireState:
        """Return model, sensor mask and laser mode, which determine the format of replies."""

    @property
    def greeting(self) -> Reply | None:
        """Return the state received while connecting, None if there was none."""

    @property
    def port(self) -> int:
        """Return the port on which the server accepts connections, as it replied to connect_robot; 1 without server."""

    @property
    def closed(self) -> bool:
        """Return True if the session is over; every call then raises ConnectionLost."""

    @property
    def link(self) -> LinkStatistics | None:
        """Return the statistics of the link, None if nothing is counted."""

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply, an empty one if the command has none.

        Raises
        ------
        RobotRefused
            If the command was refused; the session continues.
        WireError
            If the call cannot be encoded; nothing was sent.
        ConnectionLost
            If the link is lost; the session is closed.
        ReplyTimeout
            If no reply came in time. The session is closed over TCP and continues on a serial line; see `closed`.
        """

    def close(self) -> None:
        """Disconnect without waiting for a reply. May be called twice, and from another thread than `execute`."""


class Wrapper:
    """A backend around another one that changes nothing; subclasses override what they change."""

    def __init__(self, inner: Backend) -> None:
        self._inner = inner

    @property
    def wire_state(self) -> WireState:
        """Return model, sensor mask and laser mode."""
        return self._inner.wire_state

    @property
    def greeting(self) -> Reply | None:
        """Return the state received while connecting, None if there was none."""
        return self._inner.greeting

    @property
    def port(self) -> int:
        """Return the server's port, 1 without server."""
        return self._inner.port

    @property
    def closed(self) -> bool:
        """Return True if the session is over."""
        return self._inner.closed

    @property
    def link(self) -> LinkStatistics | None:
        """Return the statistics of the link, None if nothing is counted."""
        return self._inner.link

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply. Raises as the inner backend."""
        return self._inner.execute(call)

    def close(self) -> None:
        """Close the inner backend."""
        self._inner.close()


def is_wait(call: Call) -> bool:
    """Return True for a complete ws: three axis flags and a timeout in seconds."""
    return call.name == "ws" and len(call.args) == 4


def split_wait(call: Call, max_piece_s: int, execute: Callable[[Call], Reply]) -> Reply:
    """Execute a ws as several shorter ones, between which other requests are possible.

    Parameters
    ----------
    call
        A ws with whole seconds.
    max_piece_s
        Maximum duration of a piece in seconds.
    execute
        Sends one piece and returns its reply.

    Returns
    -------
    Reply
        The reply of the last piece: the selected axes are still, or the whole time is over.
    """
    *flags, left = call.args
    while True:
        # A piece of 0 s is a query; the timeout may be negative.
        piece = max(0, min(left, max_piece_s))
        left -= piece
        reply = execute(Call("ws", (*flags, piece)))
        # Bit k of the motor status is axis k.
        motors = reply.slots.get(MOTOR_SLOT, 0)
        is_moving = any(flag and motors >> axis & 1 for axis, flag in enumerate(flags))
        if left <= 0 or not is_moving:
            return reply
