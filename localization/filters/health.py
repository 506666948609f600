"""Whether an estimate can be believed, judged by what is heard: OK, DEGRADED, LOST, and why.

    evidence    for each reading ln( p(reading | estimate) / p(reading | anywhere in the map) ): above 0 it speaks for
                the estimate, below against it. A robot somewhere else hears what could be heard anywhere
    LOST        the evidence has fallen by `lost_nats` from the highest it ever stood at: a CUSUM test (Page 1954)
    doubtful    it has fallen by `doubt_nats`, or little is explained: worth looking for a place that explains more
    DEGRADED    the matched share or the NIS of the last readings, or the estimate's own spread, is beyond its bound

The CUSUM decides between two hypotheses, here or anywhere. Were readings independent, a false alarm would come about
once in exp(lost_nats) of them; they are not, where a place hides its walls, so the bound is chosen higher.
Rules: pure; numbers of readings in, a verdict out; no filter, no robot.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from math import hypot, log, sqrt
from typing import Final, NamedTuple, Protocol

from localization.filters.belief import Belief, chi_square_quantile
from localization.filters.update import MOSTLY_BAD


class HealthStatus(Enum):
    """How far an estimate can be believed."""

    OK = "OK"
    DEGRADED = "DEGRADED"
    LOST = "LOST"


class FilterHealth(NamedTuple):
    """How far, and why in words; "" where all is well."""

    status: HealthStatus
    reason: str


class Judged(Protocol):
    """What a filter made of a range; filters.method.Judgement has it."""

    @property
    def outlier_probability(self) -> float: ...
    @property
    def nis(self) -> float: ...


@dataclass(frozen=True, slots=True)
class Bounds:
    """What is beyond belief.

    lost_nats         fall of the evidence that says lost; one reading takes or gives most_bad_nats, most_good_nats
    doubt_nats        fall from which it is worth asking whether another place explains more
    window            readings that share and NIS are looked at over
    least_matched     share of them that is explained
    nis_probability   with which the window's NIS stays in its bound
    most_std_in       spread of the position along its worst direction
    """

    lost_nats: float = 45.0
    doubt_nats: float = 15.0
    most_bad_nats: float = 4.0
    most_good_nats: float = 4.0
    window: int = 48
    least_matched: float = 0.35
    nis_probability: float = 0.999
    most_std_in: float = 3.0


HEALTHY: Final = FilterHealth(HealthStatus.OK, "")


class IntegrityMonitor:
    """Looks on while a filter hears; see the head of this file."""

    def __init__(self, bounds: Bounds | None = None) -> None:
        self.bounds = bounds or Bounds()
        self._fall = 0.0
        self._matched: deque[float] = deque(maxlen=self.bounds.window)
        self._nis: deque[float] = deque(maxlen=self.bounds.window)

    @property
    def lost(self) -> bool:
        """Whether the evidence alone says LOST."""
        return self._fall >= self.bounds.lost_nats

    @property
    def fall_nats(self) -> float:
        """How far the evidence has fallen from its highest."""
        return self._fall

    def reset(self) -> None:
        """A new estimate begins."""
        self._fall = 0.0
        self._matched.clear()
        self._nis.clear()

    def hear(self, likelihood: float, anywhere: float, judged: Judged | None) -> None:
        """A reading: how the estimate explains it, how the map as a whole does, and what the filter made of it, where
        it was a range."""
        evidence = log(likelihood / anywhere)
        self._fall = max(0.0, self._fall - max(-self.bounds.most_bad_nats, min(self.bounds.most_good_nats, evidence)))
        if judged is not None:
            self.look(judged)

    def look(self, judged: Judged) -> None:
        """A range, and what the filter made of it: all that a filter can tell which knows no other place."""
        self._matched.append(1.0 - judged.outlier_probability)
        if judged.outlier_probability < MOSTLY_BAD:
            self._nis.append(judged.nis)

    @property
    def doubtful(self) -> bool:
        """Whether it is worth asking if another place explains more: the evidence falls, or little is explained."""
        return self._fall >= self.bounds.doubt_nats or self._share() < self.bounds.least_matched

    @property
    def reason(self) -> str:
        """Why the estimate would be given up."""
        return f"what is heard fits anywhere better than here, by e^{self._fall:.0f}"

    def health(self, belief: Belief) -> FilterHealth:
        """What is to be thought of the estimate now."""
        bounds = self.bounds
        if self.lost:
            return FilterHealth(HealthStatus.LOST, self.reason)
        (xx, xy), (_, yy) = belief.cov[:2, :2].tolist()
        spread = sqrt(0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy))
        if spread > bounds.most_std_in:
            return FilterHealth(HealthStatus.DEGRADED, f"the position is known to {spread:.1f} in only")
        if len(self._matched) < bounds.window:
            return HEALTHY
        matched = self._share()
        if matched < bounds.least_matched:
            return FilterHealth(
                HealthStatus.DEGRADED, f"only {matched:.0%} of the last {bounds.window} echoes are explained"
            )
        return self._nis_verdict()

    def _share(self) -> float:
        """How many of the window's echoes are explained; all, until it is full."""
        full = len(self._matched) == self.bounds.window
        return sum(self._matched) / self.bounds.window if full else 1.0

    def _nis_verdict(self) -> FilterHealth:
        count, total = len(self._nis), sum(self._nis)
        bound = chi_square_quantile(self.bounds.nis_probability, count) if count else 0.0
        if total <= bound:
            return HEALTHY
        return FilterHealth(
            HealthStatus.DEGRADED, f"innovations are {total / count:.1f} times as large as they should be, squared"
        )
