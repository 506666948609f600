"""Health of an estimate, judged by its readings: OK, DEGRADED or LOST, and the reason.

    evidence        for each reading ln( p(reading | estimate) / p(reading | anywhere on the map) ): above 0 it supports
                    the estimate, below 0 it contradicts it
    LOST            the evidence has fallen by `lost_nats` from its maximum: a CUSUM test
    suspicious      it has fallen by `suspicious_nats`, or few readings are explained: worth a search for another pose
    DEGRADED        the matched fraction or the NIS of the last readings, or the standard deviation, is beyond its limit
    slip            so many of the very last readings are outliers, or so many before and behind the robot agree that it
                    is not where the wheels say (a two-sided CUSUM test of signed innovations), that the wheels may
                    have slipped: DEGRADED at once, and a filter widens its covariance (`IntegrityMonitor.take_slip`)
    NIS ratio       mean NIS of the window, if that is significantly above 1: what is reported is widened by it

The CUSUM test decides between two hypotheses, here or anywhere. Of independent readings a false alarm would come once
in exp(lost_nats); they are not independent where an unmapped object hides a wall, so the limit is higher.

References: Page, Continuous inspection schemes (1954).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot, inf, log, sqrt
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
    max_nis_ratio
        Mean NIS from which the estimate is DEGRADED; below, its covariance is widened.
    max_std_in
        Largest standard deviation of the position, along its worst direction.
    recent, max_unexplained
        Number of the very last readings, and the number of outliers among them that means a slip.
    min_rise
        Least rise of the fraction of outliers against the readings before.
    drift, max_drift
        Part of a signed innovation, in standard deviations, that counts for nothing, and the sum of the rest that means
        a slip.
    max_side, max_innovation
        Sonars that look forwards, or backwards, add so much at most: something unmapped is on one side only. An
        innovation counts as so many standard deviations at most.
    """

    lost_nats: float = 45.0
    suspicious_nats: float = 15.0
    max_loss_nats: float = 4.0
    max_gain_nats: float = 4.0
    window: int = 48
    min_matched: float = 0.35
    nis_probability: float = 0.999
    max_nis_ratio: float = 1.0
    max_std_in: float = 3.0
    recent: int = 12
    max_unexplained: float = inf
    min_rise: float = 0.3
    drift: float = 0.5
    max_drift: float = inf
    max_side: float = 3.0
    max_innovation: float = 2.5


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
        self._since_slip = self.limits.recent
        self._drifts = [0.0] * 4
        self._ratio: float | None = 1.0

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
        self._ratio = 1.0

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
        self._since_slip += 1
        self._ratio = None
        if outlier_probability < OUTLIER_THRESHOLD:
            self._nis.append(nis)

    def _unexplained(self) -> float:
        """Return the number of outliers among the very last readings; 0 until there are enough."""
        recent = self.limits.recent
        if len(self._matched) < recent:
            return 0.0
        return recent - sum([self._matched[-k] for k in range(1, recent + 1)])

    def _looks_slipped(self, unexplained: float) -> bool:
        """Return True for more outliers among the very last readings than the model has, and more than before them."""
        limits, before = self.limits, len(self._matched) - self.limits.recent
        if unexplained < limits.max_unexplained:
            return False
        share = (len(self._matched) - sum(self._matched) - unexplained) / before if before >= limits.recent else 0.0
        return unexplained >= limits.recent * (share + limits.min_rise)

    def add_drift(self, sigmas: float, cosine: float) -> None:
        """Take note of an innovation in standard deviations, of a sonar of this cosine to the heading."""
        limits, drifts = self.limits, self._drifts
        bounded = cosine * min(max(sigmas, -limits.max_innovation), limits.max_innovation)
        # The robot is ahead of the estimate (0, 1) or behind it (2, 3), by sonars that look forwards or backwards.
        side = 0 if cosine > 0.0 else 1
        drifts[side] = min(max(0.0, drifts[side] - bounded - limits.drift), limits.max_side)
        drifts[2 + side] = min(max(0.0, drifts[2 + side] + bounded - limits.drift), limits.max_side)

    @property
    def _drift(self) -> float:
        """The larger sum of signed innovations, of both sides together."""
        ahead_forwards, ahead_backwards, behind_forwards, behind_backwards = self._drifts
        return max(ahead_forwards + ahead_backwards, behind_forwards + behind_backwards)

    def take_slip(self) -> bool:
        """Return True if the wheels may have slipped; then False until as many readings again are known."""
        if self._since_slip < self.limits.recent:
            return False
        if self._drift < self.limits.max_drift and not self._looks_slipped(self._unexplained()):
            return False
        self._since_slip = 0
        self._drifts = [0.0] * 4
        return True

    @property
    def nis_ratio(self) -> float:
        """Mean NIS of the window, if it is beyond its limit; else 1."""
        if self._ratio is None:
            self._ratio = 1.0
            count = len(self._nis)
            if len(self._matched) == self.limits.window and count:
                total = sum(self._nis)
                if total > chi_square_quantile(self.limits.nis_probability, count):
                    self._ratio = total / count
        return self._ratio

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
        matched = self._matched_fraction()
        if matched < limits.min_matched:
            reason = f"only {matched:.0%} of the last {limits.window} echoes are explained"
            return FilterHealth(HealthStatus.DEGRADED, reason)
        unexplained = self._unexplained()
        if self._since_slip < limits.recent or self._looks_slipped(unexplained):
            count = limits.recent - unexplained
            reason = f"{count:.0f} of the last {limits.recent} echoes are explained: the wheels may have slipped"
            return FilterHealth(HealthStatus.DEGRADED, reason)
        ratio = self.nis_ratio
        if ratio <= limits.max_nis_ratio:
            return HEALTHY
        reason = f"squared innovations are {ratio:.1f} times as large as they should be"
        return FilterHealth(HealthStatus.DEGRADED, reason)

    def _matched_fraction(self) -> float:
        """Return the fraction of the window that is explained; 1 until the window is full."""
        full = len(self._matched) == self.limits.window
        return sum(self._matched) / self.limits.window if full else 1.0
