"""Results of the figures of the thesis: what is stored of each seed, and the summary over seeds.

The result of a seed depends on that seed only (sums by math.fsum, exact in any order), and the summary on the seeds in
their order: the numbers are the same to the bit however the work is divided.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final, TypedDict

import numpy as np

from localization.experiments.figure_trial import Figure, Runs, mean_band, nees
from localization.filters.belief import Floats, difference

TRACKED_SEEDS: Final = 20
"""Complete runs are stored for seeds below this number, for the pictures."""


@dataclass(frozen=True, slots=True)
class SeedResult:
    """Result of one run.

    Attributes
    ----------
    steps
        Number of steps T.
    reached
        True if all goals were reached, by the estimate.
    end_error_in
        Position error after the last step, in inches.
    position_in2, heading_rad2, nees, nis
        Sums over the steps of the squared position error (in^2), the squared heading error (rad^2), NEES and NIS.
    used
        Number of beams used in all steps.
    bound_in2
        Sum over the steps of the bound on the squared position error (in^2).
    """

    seed: int
    steps: int
    reached: bool
    end_error_in: float
    position_in2: float
    heading_rad2: float
    nees: float
    nis: float
    used: float
    bound_in2: float


@dataclass(frozen=True, slots=True)
class Track:
    """A complete run of T steps: `truth` and `mean` (T, 3), `cov` (T, 3, 3)."""

    seed: int
    truth: Floats
    mean: Floats
    cov: Floats


@dataclass(frozen=True, slots=True)
class FigureResult:
    """Results of a figure for all or some of its seeds."""

    results: tuple[SeedResult, ...]
    tracks: tuple[Track, ...]


class Summary(TypedDict):
    """Results of a figure over all seeds; None where a number does not apply.

    Root mean squares and means are over all steps of all seeds. `nees_band95` is the 95 % interval of the mean NEES of
    that many independent runs. `nis_mean` is per beam: the sum of NIS over the number of beams used, ideally 1.
    `pcrb_position_in` is the posterior Cramer-Rao bound on the RMSE, with all beams that meet a wall.
    """

    figure: str
    seeds: int
    steps_median: float
    steps_thesis: int | None
    end_error_median_in: float
    reached: int
    rmse_position_in: float
    rmse_heading_deg: float
    nees_mean: float | None
    nees_band95: list[float] | None
    nis_mean: float | None
    pcrb_position_in: float | None


def figure_result(runs: Runs, filtered: bool) -> FigureResult:
    """Return the results of runs; NEES, NIS and the bound only with a filter."""
    results = []
    tracks = []
    # One row of the arrays per seed; after its last step a row has no meaning.
    for row, seed in enumerate(runs.seeds):
        span = slice(int(runs.steps[row]))
        track = Track(seed, runs.truth[span, row], runs.mean[span, row], runs.cov[span, row])
        # Bound on the squared position error: the trace of the position block of the covariance bound.
        bound = runs.bound[span, row, 0, 0] + runs.bound[span, row, 1, 1]
        extra = (runs.nis[span, row], runs.used[span, row], bound)
        sums = [math.fsum(values) for values in extra] if filtered else [0.0, 0.0, 0.0]
        results.append(_result(track, bool(runs.reached[row]), filtered, sums))
        if seed < TRACKED_SEEDS:
            tracks.append(track)
    return FigureResult(tuple(results), tuple(tracks))


def _result(track: Track, reached: bool, filtered: bool, sums: list[float]) -> SeedResult:
    # Estimate minus truth (T, 3), headings wrapped.
    error = difference(track.mean, track.truth)
    square = error[:, 0] ** 2 + error[:, 1] ** 2
    nis, used, bound = sums
    return SeedResult(
        seed=track.seed,
        steps=len(error),
        reached=reached,
        end_error_in=math.sqrt(square[-1]),
        position_in2=math.fsum(square),
        heading_rad2=math.fsum(error[:, 2] ** 2),
        nees=math.fsum(nees(error, track.cov)) if filtered else 0.0,
        nis=nis,
        used=used,
        bound_in2=bound,
    )


def join_results(parts: Sequence[FigureResult]) -> FigureResult:
    """Return the results of several batches as one, in the given order."""
    return FigureResult(
        tuple(result for part in parts for result in part.results),
        tuple(track for part in parts for track in part.tracks),
    )


def summarize(figure: Figure, results: Sequence[SeedResult]) -> Summary:
    """Return the summary of a figure over all seeds."""
    # Means over all steps of all seeds; math.fsum makes them independent of the batches.
    count = len(results)
    steps = sum(result.steps for result in results)
    nees_mean = nees_band = nis_mean = bound_in = None
    if figure.filtered:
        nees_mean = math.fsum(result.nees for result in results) / steps
        nees_band = list(mean_band(3, count))
        used = math.fsum(result.used for result in results)
        nis_mean = math.fsum(result.nis for result in results) / used if used else None
        bound_in = math.sqrt(math.fsum(result.bound_in2 for result in results) / steps)
    return Summary(
        figure=figure.name,
        seeds=count,
        steps_median=float(median(result.steps for result in results)),
        steps_thesis=figure.steps_thesis,
        end_error_median_in=median(result.end_error_in for result in results),
        reached=sum(result.reached for result in results),
        rmse_position_in=math.sqrt(math.fsum(result.position_in2 for result in results) / steps),
        rmse_heading_deg=math.degrees(math.sqrt(math.fsum(r.heading_rad2 for r in results) / steps)),
        nees_mean=nees_mean,
        nees_band95=nees_band,
        nis_mean=nis_mean,
        pcrb_position_in=bound_in,
    )


def typical(tracks: Sequence[Track]) -> Track:
    """Return the track with the (upper) median final error, for drawing."""
    # By the position error of the last step, inches.
    ranked = sorted(tracks, key=lambda track: float(np.hypot(*(track.mean - track.truth)[-1, :2])))
    return ranked[len(ranked) // 2]
