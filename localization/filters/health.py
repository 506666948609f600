"""Health of an estimate, judged by its readings: OK, DEGRADED or LOST, and the reason.

    evidence        for each reading ln( p(reading | estimate) / p(reading | anywhere on the map) ): above 0 it supports
                    the estimate, below 0 it contradicts it
    LOST            the evidence has fallen by `lost_nats` from its maximum: a CUSUM test
    suspicious      it has fallen by `suspicious_nats`, or few readings are explained: worth a search for another pose
    DEGRADED        the matched fraction or the NIS of the last readings, or the standard deviation, is beyond its limit

The CUSUM test decides between two hypotheses, here or anywhere. Of independent readings a false alarm would come once
in exp(lost_nats); they are not independent where an unmapped object hides a wall, so the limit is higher.

References: Page, Continuous inspection schemes (1954).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot, log, sqrt
from typing import Final, NamedTuple

from localization.filters.belief import Floats, chi_square_quantile
from localization.filters.update import OUTLIER_THRESHOLD, Outcome


class HealthStatus(Enum):
    """Degree to which an estimate can be trusted."""

    OK = "OK"
    DEGRADED = "DEGRADED"
    LOST = "LOST"


class FilterHealth(NamedTuple):
    """Status of an estimate, and the reason in words; "" where it is OK."""

    status: HealthStatus
    reason: str


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """Limits of the monitor.

    Attributes
    ----------
    lost_nats
        Fall of the evidence that means LOST.
    suspicious_nats
        Fall from which a search for a better pose is worth its time.
    max_loss_nats, max_gain_nats
        One reading lowers or raises the evidence by this at most.
    window
        Number of readings for the matched fraction and the NIS.
    min_matched
        Least fraction of them that must be explained.
    nis_probability
        Probability with which the NIS of the window of a consistent filter stays below its limit.
    max_std_in
        Largest standard deviation of the position, along its worst direction.
    """

    lost_nats: float = 45.0
    suspicious_nats: float = 15.0
    max_loss_nats: float = 4.0
    max_gain_nats: float = 4.0
    window: int = 48
    min_matched: float = 0.35
    nis_probability: float = 0.999
    max_std_in: float = 3.0


BUILDING: Final = HealthLimits(max_std_in=18.0, nis_probability=1.0 - 1e-6)
"""In a building: half the width of a door, as nothing bounds the error along a corridor, and 3 in are soon exceeded;
and a wider limit of the NIS, as the innovations of two hypotheses have heavier tails than a normal distribution."""
HEALTHY: Final = FilterHealth(HealthStatus.OK, "")


class IntegrityMonitor:
    """Judge an estimate by the outcomes of its readings."""

    def __init__(self, limits: HealthLimits | None = None) -> None:
        self.limits = limits or HealthLimits()
        self._fall = 0.0
        self._matched: deque[float] = deque(maxlen=self.limits.window)
        self._nis: deque[float] = deque(maxlen=self.limits.window)

    @property
    def is_lost(self) -> bool:
        """True if the evidence alone means LOST."""
        return self._fall >= self.limits.lost_nats

    @property
    def fall_nats(self) -> float:
        """Fall of the evidence from its maximum."""
        return self._fall

    def reset(self) -> None:
        """Begin with a new estimate."""
        self._fall = 0.0
        self._matched.clear()
        self._nis.clear()

    def add_evidence(self, likelihood: float, anywhere: float, result: Outcome | None) -> None:
        """Take note of a reading.

        Parameters
        ----------
        likelihood, anywhere
            Density of the reading given the estimate, and given a pose anywhere on the map.
        result
            Its outcome, where it was a range.
        """
        evidence = max(-self.limits.max_loss_nats, min(self.limits.max_gain_nats, log(likelihood / anywhere)))
        self._fall = max(0.0, self._fall - evidence)
        if result is not None:
            self.add(result)

    def add(self, result: Outcome) -> None:
        """Take note of the outcome of a range; all that a filter can report that considers one pose only."""
        _, _, nis, outlier_probability, _ = result
        self._matched.append(1.0 - outlier_probability)
        if outlier_probability < OUTLIER_THRESHOLD:
            self._nis.append(nis)

    @property
    def is_suspicious(self) -> bool:
        """True if a search for a better pose is worth its time."""
        return self._fall >= self.limits.suspicious_nats or self._matched_fraction() < self.limits.min_matched

    @property
    def reason(self) -> str:
        """Reason for giving up the estimate."""
        return f"readings fit anywhere on the map better than here, by e^{self._fall:.0f}"

    def health(self, P: Sequence[Sequence[float]] | Floats) -> FilterHealth:
        """Return the health of an estimate of covariance P now."""
        limits = self.limits
        if self.is_lost:
            return FilterHealth(HealthStatus.LOST, self.reason)
        # 1. The larger eigenvalue of the covariance of the position.
        xx, xy, yy = P[0][0], P[0][1], P[1][1]
        std = sqrt(0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy))
        if std > limits.max_std_in:
            return FilterHealth(HealthStatus.DEGRADED, f"the position is known to {std:.1f} in only")
        # 2. The outcomes of the last readings, once there are enough.
        if len(self._matched) < limits.window:
            return HEALTHY
        matched = self._matched_fraction()
        if matched < limits.min_matched:
            reason = f"only {matched:.0%} of the last {limits.window} echoes are explained"
            return FilterHealth(HealthStatus.DEGRADED, reason)
        return self._nis_health()

    def _matched_fraction(self) -> float:
        """Return the fraction of the window that is explained; 1 until the window is full."""
        full = len(self._matched) == self.limits.window
        return sum(self._matched) / self.limits.window if full else 1.0

    def _nis_health(self) -> FilterHealth:
        count, total = len(self._nis), sum(self._nis)
        limit = chi_square_quantile(self.limits.nis_probability, count) if count else 0.0
        if total <= limit:
            return HEALTHY
        reason = f"squared innovations are {total / count:.1f} times as large as they should be"
        return FilterHealth(HealthStatus.DEGRADED, reason)
