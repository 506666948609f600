"""Health of an estimate, judged by its readings: OK, DEGRADED or LOST, and the reason.

    evidence        for each reading ln( p(reading | estimate) / p(reading | anywhere on the map) ): above 0 it supports
                    the estimate, below 0 it contradicts it
    LOST            the evidence has fallen by `lost_nats` from its maximum: a CUSUM test
    suspicious      it has fallen by `suspicious_nats`, or few readings are explained: worth a search for another pose
    DEGRADED        the matched fraction or the NIS of the last readings, or the standard deviation, is beyond its limit
    slip            the last readings agree on another place along the heading: the probability of that widens what
                    is reported; above 1/2 DEGRADED; and a filter widens its covariance (`IntegrityMonitor.take_slip`)
    NIS ratio       mean NIS of the window, if that is significantly above 1: what is reported is widened by it

The CUSUM test decides between two hypotheses, here or anywhere. Of independent readings a false alarm would come once
in exp(lost_nats); they are not independent where an unmapped object hides a wall, so the limit is higher.

References: Page, Continuous inspection schemes (1954).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from math import expm1, hypot, inf, log, sqrt
from typing import Final, NamedTuple

import numpy as np

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

    @property
    def is_lost(self) -> bool:
        """True if the estimate has no meaning."""
        return self.status is HealthStatus.LOST


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
    slip_nats
        Evidence of a slip (the slip test) that widens the covariance.
    heading_nats
        Evidence of another heading (`HeadingTest`) that corrects it.
    after_slip
        Number of readings after a slip for which the estimate is DEGRADED.
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
    slip_nats: float = inf
    heading_nats: float = inf
    after_slip: int = 12


BUILDING: Final = HealthLimits(max_std_in=18.0, nis_probability=1.0 - 1e-6)
"""In a building: half the width of a door, as nothing bounds the error along a corridor, and 3 in are soon exceeded;
and a wider limit of the NIS, as the innovations of two hypotheses have heavier tails than a normal distribution."""
HEALTHY: Final = FilterHealth(HealthStatus.OK, "")


# The slip test: whether recent readings agree that the robot is displaced along its heading, and by how much.
#
# A generalized likelihood ratio test for a step. The range of a reading changes by h for each inch that the robot is
# displaced forwards (`update.forward_slope`), so its innovation, of variance S, has the mean 0 without a slip and h d
# after one by d. The log likelihood ratio of both, 1/2 (nu^2 - (nu - h d)^2) / S, is summed for each d of
# DISPLACEMENTS_IN from the instant at which the sum was last 0: the most likely instant of the slip (CUSUM). The
# largest sum decides (`take_slip`). Bad readings agree on no displacement.
#
# The mean of the ratios over the displacements, times the odds of a slip in a round of the ring, are its odds after
# the readings (`slip_probability`). Slips are a Poisson process: their rate has a gamma distribution of the shape
# k = SLIP_RATE_SHAPE, of which one slip in ROUNDS_PER_SLIP is the mean before the first reading, and
# (k + slips) / (k ROUNDS_PER_SLIP + rounds) later.
#
# References: Basseville, Nikiforov, Detection of Abrupt Changes (1993), sections 2.4 and 7.2.

DISPLACEMENTS_IN: Final = (-5.0, -3.0, -2.0, 2.0, 3.0, 5.0)
"""Displacements along the heading that are tested, inches."""
MIN_DISPLACEMENT_IN: Final = min(map(abs, DISPLACEMENTS_IN))
LARGEST: Final = len(DISPLACEMENTS_IN)
"""Column of the largest sum (`SlipSums`)."""
NO_SLIP: Final = (0.0, 0.0)
MAX_NIS: Final = 12.0
"""A reading is an outlier rather than so many standard deviations, squared, off: 2 ln of both densities' ratio."""
MAX_GAIN_NATS: Final = 3.0
"""One reading adds so much at most: no displacement is of one reading alone."""
MAX_SIDE_NATS: Final = 8.0
"""Readings that a displacement forwards shortens, or lengthens, add so much at most: old evidence is soon refuted."""
MAX_NATS_OF_ONE_SIDE: Final = 4.0
"""And so much at most to the evidence that moves the belief: something unmapped is on one side only."""
ALLOWANCE_NATS: Final = 0.1
"""Each reading takes away so much: innovations are correlated."""
ROUNDS_PER_SLIP: Final = 600.0
"""Wheels that roll freely slip once in so many rounds of the ring, of a second each: the mean over all floors."""
SLIP_RATE_SHAPE: Final = 0.1
"""Shape of the gamma distribution of the rate of slips, whose relative standard deviation is 1 / sqrt(shape), 3.2: on
most floors wheels hardly ever slip, on some every few seconds. With the shape 1 (an exponential distribution) a dozen
slips in two minutes leave a rate of a sixth of theirs, with 0.1 of two thirds."""
READINGS_PER_ROUND: Final = 16
MAX_SLIP_PROBABILITY: Final = 0.5
"""Beyond this the estimate is DEGRADED: the wheels have more probably slipped than not."""


SlipSums = list[list[float]] | Floats
"""Evidence of each displacement, and last the largest: a row of the readings that a displacement forwards shortens, and
one of those that it lengthens; and a row of counts (SLIPS, READINGS, SINCE_SLIP). Lists in plain Python, an array for
compiled code."""
COUNTS = 2
"""Row of the counts."""
SLIPS, READINGS, SINCE_SLIP = range(3)
"""Columns of the counts: slips so far, readings that were looked at for slips, and readings since the last slip."""


def empty_slip_sums() -> list[list[float]]:
    """Return the sums and counts before the first reading."""
    return [[0.0] * (LARGEST + 1), [0.0] * (LARGEST + 1), [0.0, 0.0, inf] + [0.0] * (LARGEST - 2)]


def displacement_evidence(innovation_in: float, nis: float, shift_in: float) -> float:
    """Return the log likelihood ratio of a reading whose mean is shifted to one as expected, nats.

    Both densities are normal, of the variance that innovation and NIS imply, and bounded below: an outlier is
    as probable either way.
    """
    ratio = 1.0 - shift_in / innovation_in
    shifted_nis = ratio * ratio * nis
    # Comparisons: in plain Python calls of min take most of the time.
    return 0.5 * ((MAX_NIS if nis > MAX_NIS else nis) - (MAX_NIS if shifted_nis > MAX_NIS else shifted_nis))


def add_slip_evidence(slip_sums: SlipSums, innovation_in: float, nis: float, slope: float) -> None:
    """Add the evidence of a reading to that of each displacement, in place: one step of the CUSUM of the slip test.

    Parameters
    ----------
    slope
        Change of the range for each inch that the robot is displaced forwards.
    """
    sums = slip_sums[1 if slope > 0.0 else 0]
    # 1. An innovation of less than half the least shift supports no displacement: it can only lower a sum.
    is_small = abs(innovation_in) <= 0.5 * MIN_DISPLACEMENT_IN * abs(slope)
    if innovation_in == 0.0 or (is_small and sums[LARGEST] == 0.0):
        return
    # 2. sum = clip(sum + gain - allowance) of each displacement.
    largest = 0.0
    for j in range(LARGEST):
        gain = displacement_evidence(innovation_in, nis, slope * DISPLACEMENTS_IN[j])
        total = sums[j] + (MAX_GAIN_NATS if gain > MAX_GAIN_NATS else gain) - ALLOWANCE_NATS
        sums[j] = total = (MAX_SIDE_NATS if total > MAX_SIDE_NATS else total) if total > 0.0 else 0.0
        largest = total if total > largest else largest
    sums[LARGEST] = largest


def max_slip_evidence(slip_sums: SlipSums) -> float:
    """Return an upper bound of the evidence of a slip, nats: exact if both sides are of one displacement."""
    shortened, lengthened = slip_sums[0][LARGEST], slip_sums[1][LARGEST]
    return min(shortened, MAX_NATS_OF_ONE_SIDE) + min(lengthened, MAX_NATS_OF_ONE_SIDE)


def most_likely_slip(slip_sums: SlipSums) -> tuple[float, float]:
    """Return the most likely displacement by both sides together, inches forwards, and its evidence.

    The evidence is its log likelihood ratio to none, with MAX_NATS_OF_ONE_SIDE; without any the displacement is 0.
    """
    shortened, lengthened = slip_sums[0], slip_sums[1]
    best = 0
    for j in range(LARGEST):
        if shortened[j] + lengthened[j] > shortened[best] + lengthened[best]:
            best = j
    evidence = min(shortened[best], MAX_NATS_OF_ONE_SIDE) + min(lengthened[best], MAX_NATS_OF_ONE_SIDE)
    return DISPLACEMENTS_IN[best] if evidence > 0.0 else 0.0, evidence


def slip_probability(slip_sums: SlipSums) -> tuple[float, float]:
    """Return the probability of a slip, and the mean square of the displacement by it, in^2: 0 without a slip."""
    shortened, lengthened, counts = slip_sums[0], slip_sums[1], slip_sums[COUNTS]
    if shortened[LARGEST] == 0.0 and lengthened[LARGEST] == 0.0:
        return NO_SLIP
    rounds = SLIP_RATE_SHAPE * ROUNDS_PER_SLIP + counts[READINGS] / READINGS_PER_ROUND
    before = (SLIP_RATE_SHAPE + counts[SLIPS]) / rounds
    total = squares = 0.0
    for j in range(LARGEST):
        # A displacement without evidence is none.
        odds = before * expm1(shortened[j] + lengthened[j]) / LARGEST
        total += odds
        squares += odds * (DISPLACEMENTS_IN[j] * DISPLACEMENTS_IN[j])
    return total / (1.0 + total), squares / (1.0 + total)


def take_slip(slip_sums: SlipSums, slip_nats: float) -> float:
    """Return the displacement along the heading, inches, of a slip that readings show, and begin anew; 0 without."""
    if max_slip_evidence(slip_sums) < slip_nats:
        return 0.0
    displacement, evidence = most_likely_slip(slip_sums)
    if evidence < slip_nats:
        return 0.0
    counts = slip_sums[COUNTS]
    counts[SLIPS] += 1.0
    counts[SINCE_SLIP] = 0.0
    clear_slips(slip_sums)
    return displacement


def clear_slips(slip_sums: SlipSums) -> None:
    """Set the sums to 0; the counts, and so the rate of slips, stay."""
    for j in range(LARGEST + 1):
        slip_sums[0][j] = slip_sums[1][j] = 0.0


# The window of the last readings.

Windows = list[list[float]] | Floats
"""Two windows of readings, a row each: the probability that a reading is explained by the map (MATCHED), and the NIS of
those that are (NIS). A row begins with the number of readings in it (COUNT) and the column that the next one takes
(NEXT); the readings are in the columns from FIRST on. Lists in plain Python, an array for compiled code."""
MATCHED, NIS = range(2)
COUNT, NEXT, FIRST = range(3)


def empty_windows(size: int) -> list[list[float]]:
    """Return windows of so many readings, without any yet."""
    return [[0.0, float(FIRST)] + [0.0] * size for _ in range(2)]


def add_to_window(window: list[float], value: float) -> None:
    """Replace the oldest value of a full window, or append one."""
    column = int(window[NEXT])
    window[column] = value
    window[NEXT] = float(column + 1 if column + 1 < len(window) else FIRST)
    if window[COUNT] < len(window) - FIRST:
        window[COUNT] += 1.0


def window_sum(window: list[float]) -> float:
    """Return the sum of a window, the oldest value first: `sum` rounds differently from one Python to the next."""
    oldest, total = int(window[NEXT]), 0.0
    for value in window[oldest:]:
        total += value
    for value in window[FIRST:oldest]:
        total += value
    return total


def add_reading(windows: Windows, slip_sums: SlipSums, nis: float, outlier_probability: float) -> None:
    """Take note of the outcome of a range, in place."""
    add_to_window(windows[MATCHED], 1.0 - outlier_probability)
    slip_sums[COUNTS][SINCE_SLIP] += 1.0
    if outlier_probability < OUTLIER_THRESHOLD:
        add_to_window(windows[NIS], nis)


def is_full(window: Sequence[float]) -> bool:
    """Return True if as many readings were added as a window has room for."""
    return window[COUNT] == len(window) - FIRST


def matched_fraction(windows: Windows) -> float:
    """Return the fraction of the window that is explained; 1 until the window is full."""
    matched = windows[MATCHED]
    return window_sum(matched) / matched[COUNT] if is_full(matched) else 1.0


def mean_nis(windows: Windows, max_totals: Sequence[float]) -> float:
    """Return the mean NIS of the window, if that is significantly above 1; else 1.

    Parameters
    ----------
    max_totals
        Largest sum of so many NIS that is not significant (`nis_limits`).
    """
    nis = windows[NIS]
    if not is_full(windows[MATCHED]):
        return 1.0
    count, total = int(nis[COUNT]), window_sum(nis)
    return total / count if total > max_totals[count] else 1.0


@cache
def nis_limits(probability: float, size: int) -> tuple[float, ...]:
    """Return the sum that 0, 1, ... `size` NIS of a consistent filter stay below with this probability."""
    return inf, *(chi_square_quantile(probability, count) for count in range(1, size + 1))


Signs = tuple[float, float, float, float, float, float]
"""What health is judged by: the standard deviation of the position along its worst direction, inches; the matched
fraction; the mean NIS, if significant; the number of readings since a slip; the probability of a slip now, and the mean
square of the displacement by it, in^2."""


def signs_of(P: Sequence[Sequence[float]] | Floats, windows: Windows, slip_sums: SlipSums,
             max_totals: Sequence[float]) -> Signs:
    """Return the signs of the health of an estimate of covariance P."""
    # The larger eigenvalue of the covariance of the position.
    xx, xy, yy = P[0][0], P[0][1], P[1][1]
    std = sqrt(0.5 * (xx + yy) + hypot(0.5 * (xx - yy), xy))
    slipped, slipped_in2 = slip_probability(slip_sums)
    nis_ratio, since_slip = mean_nis(windows, max_totals), slip_sums[COUNTS][SINCE_SLIP]
    return std, matched_fraction(windows), nis_ratio, since_slip, slipped, slipped_in2


class IntegrityMonitor:
    """Judge an estimate by the outcomes of its readings."""

    def __init__(self, limits: HealthLimits | None = None, *, as_array: bool = False) -> None:
        self.limits = limits or HealthLimits()
        self.fall_nats = 0.0
        """Fall of the evidence from its maximum."""
        windows = empty_windows(self.limits.window)
        self.windows: Windows = np.array(windows) if as_array else windows
        """The last readings."""
        slip_sums = empty_slip_sums()
        self.slip_sums: SlipSums = np.array(slip_sums) if as_array else slip_sums
        """Evidence of a slip."""

    @property
    def max_totals(self) -> tuple[float, ...]:
        """The limits of the sum of a window of NIS."""
        return nis_limits(self.limits.nis_probability, self.limits.window)

    @property
    def is_lost(self) -> bool:
        """True if the evidence alone means LOST."""
        return self.fall_nats >= self.limits.lost_nats

    def reset(self) -> None:
        """Begin with a new estimate."""
        self.fall_nats = 0.0
        for window, empty in zip(self.windows, empty_windows(self.limits.window), strict=True):
            window[:] = empty
        clear_slips(self.slip_sums)

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
        self.fall_nats = max(0.0, self.fall_nats - evidence)
        if result is not None:
            self.add(result)

    def add(self, result: Outcome) -> None:
        """Take note of the outcome of a range; all that a filter can report that considers one pose only."""
        _, _, nis, outlier_probability, _, _ = result
        add_reading(self.windows, self.slip_sums, nis, outlier_probability)

    def add_innovation(self, innovation_in: float, nis: float, slope: float) -> None:
        """Take note of a reading as evidence of a slip, see `add_slip_evidence`."""
        add_slip_evidence(self.slip_sums, innovation_in, nis, slope)
        self.slip_sums[COUNTS][READINGS] += 1.0

    def take_slip(self) -> float:
        """Return the displacement of a slip that readings show, and begin anew: see the function."""
        return take_slip(self.slip_sums, self.limits.slip_nats)

    @property
    def nis_ratio(self) -> float:
        """Mean NIS of the window, if it is beyond its limit; else 1."""
        return mean_nis(self.windows, self.max_totals)

    @property
    def is_suspicious(self) -> bool:
        """True if a search for a better pose is worth its time."""
        return self.fall_nats >= self.limits.suspicious_nats or matched_fraction(self.windows) < self.limits.min_matched

    @property
    def reason(self) -> str:
        """Reason for giving up the estimate."""
        return f"readings fit anywhere on the map better than here, by e^{self.fall_nats:.0f}"

    def signs(self, P: Sequence[Sequence[float]] | Floats) -> Signs:
        """Return the signs of the health of an estimate of covariance P now."""
        return signs_of(P, self.windows, self.slip_sums, self.max_totals)

    def health(self, P: Sequence[Sequence[float]] | Floats) -> FilterHealth:
        """Return the health of an estimate of covariance P now."""
        return self.judge(self.signs(P))

    def judge(self, signs: Signs) -> FilterHealth:
        """Return the health of an estimate with these signs."""
        limits, (std, matched, ratio, since_slip, slipped, _) = self.limits, signs
        if self.is_lost:
            return FilterHealth(HealthStatus.LOST, self.reason)
        if std > limits.max_std_in:
            reason = f"the position is known to {std:.1f} in only"
        # The outcomes of the last readings, once there are enough.
        elif matched < limits.min_matched:
            reason = f"only {matched:.0%} of the last {limits.window} echoes are explained"
        elif since_slip < limits.after_slip or slipped > MAX_SLIP_PROBABILITY:
            reason = "the wheels may have slipped: readings agree on another place along the heading"
        elif ratio > limits.max_nis_ratio:
            reason = f"squared innovations are {ratio:.1f} times as large as they should be"
        else:
            return HEALTHY
        return FilterHealth(HealthStatus.DEGRADED, reason)
