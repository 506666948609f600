"""From live trials to numbers: what is kept of each, and the summary of many.

    RMSE          root of the mean squared error of position, of heading
    NEES          mean of error' P^-1 error of the pose: 3 is right
    coverage      share of estimates whose truth lies in the 95 % ellipse of the position
    jitter        root mean square of how the estimate's error changes from one to the next, over that of the
                  odometry's: below 1.5 a steering hand does not feel the filter
    lost          trials whose estimate is farther than LOST_IN from the truth at any time that is judged

Rules: pure. What is kept of a trial depends on it alone (sums by math.fsum, exact in any order) and on disk is the same
to the bit; only the time spent is the machine's. All but reached and jitter is after the way that is not judged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Final, TypedDict

import numpy as np

from localization.experiments.consistency import nees
from localization.experiments.live.trial import Record
from localization.filters.belief import Floats, chi_square_quantile, difference

LOST_IN: Final = 12.0
"""Farther off than this a robot no longer knows which way round a thing it is."""


@dataclass(frozen=True, slots=True)
class TrialResult:
    """What is kept of a trial: sums over its judged estimates, those for the jitter over all. `spent_us`: the median of
    what a state took to be worked in."""

    seed: int
    reached: bool
    judged: int
    position_in2: float
    heading_rad2: float
    nees: float
    within: int
    worst_in: float
    estimate_steps_in2: float
    odometry_steps_in2: float
    spent_us: float

    @property
    def lost(self) -> bool:
        """Whether the estimate ever was as good as none."""
        return self.worst_in > LOST_IN

    def same_numbers(self, other: TrialResult) -> bool:
        """Whether two results are the same to the bit, the time they took apart."""
        return replace(self, spent_us=0.0) == replace(other, spent_us=0.0)


class LiveSummary(TypedDict):
    """The numbers of a method in a scenario on a path; None where nothing was judged."""

    seeds: int
    reached: int
    lost: int
    rmse_position_in: float | None
    rmse_heading_deg: float | None
    nees_mean: float | None
    coverage95: float | None
    jitter: float | None
    worst_in: float | None
    step_us: float


def result_of(record: Record, after_in: float = 0.0) -> TrialResult:
    """What is kept of a trial that is judged where its way is `after_in` or longer."""
    judged = record.way_in >= after_in
    errors, covs = record.error[judged], record.cov[judged]
    square = errors[:, 0] ** 2 + errors[:, 1] ** 2
    within = nees(errors[:, :2], covs[:, :2, :2]) <= chi_square_quantile(0.95, 2)
    return TrialResult(
        seed=record.seed,
        reached=record.reached,
        judged=len(errors),
        position_in2=math.fsum(square),
        heading_rad2=math.fsum(errors[:, 2] ** 2),
        nees=math.fsum(nees(errors, covs)),
        within=int(within.sum()),
        worst_in=math.sqrt(max(square, default=0.0)),
        estimate_steps_in2=_squared_steps(record.error),
        odometry_steps_in2=_squared_steps(difference(record.encoders, record.truth)),
        spent_us=1e6 * float(np.median(record.spent_s)),
    )


def summarize(results: Sequence[TrialResult]) -> LiveSummary:
    """The numbers of one trial or more."""
    count = sum(result.judged for result in results)

    def mean(part: Callable[[TrialResult], float]) -> float | None:
        return math.fsum(part(result) for result in results) / count if count else None

    position, heading = mean(lambda result: result.position_in2), mean(lambda result: result.heading_rad2)
    odometry = math.fsum(result.odometry_steps_in2 for result in results)
    estimate = math.fsum(result.estimate_steps_in2 for result in results)
    return LiveSummary(
        seeds=len(results),
        reached=sum(result.reached for result in results),
        lost=sum(result.lost for result in results),
        rmse_position_in=None if position is None else math.sqrt(position),
        rmse_heading_deg=None if heading is None else math.degrees(math.sqrt(heading)),
        nees_mean=mean(lambda result: result.nees),
        coverage95=mean(lambda result: result.within),
        jitter=math.sqrt(estimate / odometry) if odometry else None,
        worst_in=max(result.worst_in for result in results) if count else None,
        step_us=median(result.spent_us for result in results),
    )


def _squared_steps(errors: Floats) -> float:
    """How much errors (T, 3) of the position change from one to the next, squared and added up."""
    return math.fsum((np.diff(errors[:, :2], axis=0) ** 2).ravel())
