"""From live trials to numbers. Rules: pure; sums over all periods of all trials after the way that is not judged.

    RMSE          root of the mean squared error of position, of heading
    NEES          mean of error' P^-1 error of the pose: 3 is right
    coverage      share of periods whose truth lies in the 95 % ellipse of the position
    jitter        root mean square of how the estimate's error changes from period to period, over that of the
                  odometry's: below 1.5 a steering hand does not feel the filter
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from localization import chi_square
from localization.belief import Floats, difference
from localization.experiments.live.trial import Record


class LiveSummary(TypedDict):
    """The numbers of a scenario on a path."""

    seeds: int
    reached: int
    rmse_position_in: float
    rmse_heading_deg: float
    nees_mean: float
    coverage95: float
    jitter: float
    worst_in: float


def summarize(records: Sequence[Record], after_in: float = 0.0) -> LiveSummary:
    """The numbers of trials, judged where their way is `after_in` or longer."""
    judged = [record.way_in >= after_in for record in records]
    errors = np.concatenate([record.error[rows] for record, rows in zip(records, judged, strict=True)])
    covs = np.concatenate([record.cov[rows] for record, rows in zip(records, judged, strict=True)])
    nees = _squared(errors, covs)
    within = _squared(errors[:, :2], covs[:, :2, :2]) <= chi_square.quantile(0.95, 2)
    position = (errors[:, :2] ** 2).sum(axis=-1)
    return LiveSummary(
        seeds=len(records),
        reached=sum(record.reached for record in records),
        rmse_position_in=float(np.sqrt(position.mean())),
        rmse_heading_deg=float(np.degrees(np.sqrt((errors[:, 2] ** 2).mean()))),
        nees_mean=float(nees.mean()),
        coverage95=float(within.mean()),
        jitter=_jitter(records),
        worst_in=float(np.sqrt(position.max())),
    )


def _squared(errors: Floats, covs: Floats) -> Floats:
    normalised: Floats = (errors * np.linalg.solve(covs, errors[..., None])[..., 0]).sum(axis=-1)
    return normalised


def _jitter(records: Sequence[Record]) -> float:
    """The ratio, over the whole way of all trials."""
    of_estimate = np.concatenate([np.diff(record.error[:, :2], axis=0) for record in records])
    odometry = [difference(record.encoders, record.truth) for record in records]
    of_odometry = np.concatenate([np.diff(error[:, :2], axis=0) for error in odometry])
    return float(np.sqrt((of_estimate**2).sum() / (of_odometry**2).sum()))
