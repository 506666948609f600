"""What a link has been through: counts, and how long answers took. Robot.link gives it; print it for a summary.

    latencies: bucket k counts answers within 0.1 ms x 2^k, the last bucket those beyond 52 s

Rules: numbers only; whoever does a thing counts it. One object for a robot's whole life, through every reconnection.

The seam between the verbs and the languages: who answers a call.

    execute(call) -> reply   close()   and what was agreed: terms, greeting

Rules: a call goes out once, unless a backend says that it retries; an answer belongs to its call or is
nobody's. Whatever wraps a backend (a retry, a speed cap, a log) is a backend again. One thread at a time: Robot locks.

A backend around a backend, which changes nothing: what every wrapper is made from.

Rules: a wrapper overrides `execute`, and whatever else it means to change, and hands on the rest.

ws in pieces: a wait longer than one may be silent, asked again and again until the axes are still.

Rules: the answer is the last piece's, as if the whole had been asked at once; a piece lasts whole seconds.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Protocol

from nclient.protocol.commands import Call
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.wire_state import WireState

BUCKETS_S: tuple[float, ...] = tuple(0.0001 * (1 << k) for k in range(20))
"""Upper edges of the latency buckets but the last, which has none."""


@dataclass(slots=True)
class LinkStatistics:
    """Counts since connecting. An exchange is one request sent; `exchanges` less `answers` is what went wrong."""

    exchanges: int = 0
    answers: int = 0
    """Exchanges that ended with an answer that was believed, a NAK included."""
    frames: int = 0
    """Whole frames that came, with a good checksum."""
    skipped_bytes: int = 0
    """Bytes that came and belonged to no good frame."""
    checksum_errors: int = 0
    """Frames whose end was there and whose checksum was wrong."""
    misfits: int = 0
    """Frames with a good checksum whose data fit no answer of this model and mask."""
    implausible: int = 0
    """Answers whose numbers no robot can have had, not believed."""
    strays: int = 0
    """Frames that answered nothing that was being waited for: late answers, mostly."""
    naks: int = 0
    timeouts: int = 0
    """Exchanges without a good answer in time, whether nothing came or nothing good."""
    retries: int = 0
    losses: int = 0
    """Connections that broke."""
    reconnects: int = 0
    latencies: list[int] = field(default_factory=lambda: [0] * (len(BUCKETS_S) + 1))
    longest_s: float = 0.0
    """The longest that an answer took."""

    def took(self, seconds: float) -> None:
        """An answer came after so many seconds."""
        self.answers += 1
        self.latencies[bisect_left(BUCKETS_S, seconds)] += 1
        self.longest_s = max(self.longest_s, seconds)

    def latency_s(self, share: float) -> float:
        """Seconds within which that share (0 to 1) of the answers came: the upper edge of a bucket; 0 before any."""
        wanted, seen = share * sum(self.latencies), 0
        for edge, count in zip(BUCKETS_S, self.latencies, strict=False):
            seen += count
            if seen >= wanted:
                return min(edge, self.longest_s)
        return self.longest_s

    def counts(self) -> dict[str, int]:
        """The plain counts by name."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name not in _TIMES}

    def __str__(self) -> str:
        """A line of what was, one of what went wrong, one of times."""
        bad = [f"{count} {name.replace('_', ' ')}" for name, count in self.counts().items()
               if count and name not in _USUAL]
        times = ", ".join(f"{share:.0%} within {1000 * self.latency_s(share):.3g} ms" for share in (0.5, 0.99))
        return "\n".join([
            f"{self.exchanges} exchanges, {self.answers} answers",
            ", ".join(bad) or "no faults seen",
            f"{times}, the longest {1000 * self.longest_s:.3g} ms" if self.answers else "no times yet",
        ])


_TIMES = frozenset({"latencies", "longest_s"})
_USUAL = frozenset({"exchanges", "answers", "frames"})


class Backend(Protocol):
    """One conversation with one robot."""

    @property
    def wire_state(self) -> WireState:
        """What the two ends have agreed: model, mask, laser shape."""
        ...

    @property
    def greeting(self) -> Reply | None:
        """The state that came with connecting, where one did."""
        ...

    @property
    def port(self) -> int:
        """What connecting was answered: the port that the other end takes connections on, 1 where it has none."""
        ...

    @property
    def closed(self) -> bool:
        """Whether the conversation is over; every call then raises ConnectionLost."""
        ...

    @property
    def link(self) -> LinkStatistics | None:
        """What the link has been through; None where nobody counts."""
        ...

    def execute(self, call: Call) -> Reply:
        """Say it and give the answer; for a call that has none, an empty reply.

        Raises RobotRefused (and stays usable), WireError for a call that cannot be sent (nothing was), ConnectionLost
        (and is closed), or ReplyTimeout (and is closed over TCP, usable on a robot's own line: `closed` tells).
        """
        ...

    def close(self) -> None:
        """Say goodbye where the language has a word for it, and leave; never waits for an answer. Twice is fine.

        From another thread than the one in `execute` it just leaves, and that one gets ConnectionLost.
        """
        ...


class Wrapper:
    """The backend inside, by all of its names."""

    def __init__(self, inner: Backend) -> None:
        self._inner = inner

    @property
    def wire_state(self) -> WireState:
        """What the two ends have agreed."""
        return self._inner.wire_state

    @property
    def greeting(self) -> Reply | None:
        """The state that came with connecting, where one did."""
        return self._inner.greeting

    @property
    def port(self) -> int:
        """What connecting was answered."""
        return self._inner.port

    @property
    def closed(self) -> bool:
        """Whether the conversation is over."""
        return self._inner.closed

    @property
    def link(self) -> LinkStatistics | None:
        """What the link has been through, where somebody counts."""
        return self._inner.link

    def execute(self, call: Call) -> Reply:
        """The answer of the backend inside. Raises what it raises."""
        return self._inner.execute(call)

    def close(self) -> None:
        """Close the backend inside."""
        self._inner.close()


_ARGUMENTS = 4


def is_wait(call: Call) -> bool:
    """Whether it is a ws that can be cut."""
    return call.name == "ws" and len(call.args) == _ARGUMENTS


def in_pieces(call: Call, longest_s: int, say: Callable[[Call], Reply]) -> Reply:
    """The answer to a ws, said in pieces of at most so many seconds: the axes named are still, or its time is over."""
    *flags, left = call.args
    while True:
        piece = max(0, min(left, longest_s))
        left -= piece
        reply = say(Call("ws", (*flags, piece)))
        motors = reply.slots.get(MOTOR_SLOT, 0)
        if left <= 0 or not any(flag and motors >> axis & 1 for axis, flag in enumerate(flags)):
            return reply
