"""What a link has been through: counts, and how long answers took. Robot.link gives it; print it for a summary.

    latencies: bucket k counts answers within 0.1 ms x 2^k, the last bucket those beyond 52 s

Rules: numbers only; whoever does a thing counts it. One object for a robot's whole life, through every reconnection.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, fields

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
