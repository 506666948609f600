"""From runs to numbers: what is kept of each seed, and the summary of a figure.

Rules: pure. What is kept of a seed depends on that seed alone (sums by math.fsum, exact in any order), and the summary
on the seeds in their order: to the bit the same numbers however the work was cut up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final, TypedDict

import numpy as np

from localization.experiments.figure_trial import Figure, Runs, mean_band, nees
from localization.filters.belief import Floats, difference

TRACKED_SEEDS: Final = 20
"""Of the seeds below this number the whole run is kept, for the pictures."""


@dataclass(frozen=True, slots=True)
class SeedResult:
    """What is kept of one run: its steps, whether every goal was reached, the distance between estimate and truth at
    the end, and sums over its steps: squared errors, NEES, NIS, beams used, and the bound on the squared position."""

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
    """One whole run of T steps: `truth` and `mean` (T, 3), `cov` (T, 3, 3)."""

    seed: int
    truth: Floats
    mean: Floats
    cov: Floats


@dataclass(frozen=True, slots=True)
class FigureResult:
    """What came of a figure, or of a part of its seeds."""

    results: tuple[SeedResult, ...]
    tracks: tuple[Track, ...]


class Summary(TypedDict):
    """The numbers of a figure; None where a number has no meaning for it.

    Root mean squares and means are over all steps of all seeds. `nees_band95` is where the mean NEES of that many
    independent runs lies with 95 %. `nis_mean` is a beam's share: the sum of NIS over the sum of beams used, so 1 is
    right. `pcrb_position_in` is the root mean square the posterior Cramer-Rao bound allows, with all beams that meet a
    wall.
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
    """What is kept of runs; NEES, NIS and the bound only where there was a filter."""
    results = []
    tracks = []
    for row, seed in enumerate(runs.seeds):
        span = slice(int(runs.steps[row]))
        track = Track(seed, runs.truth[span, row], runs.mean[span, row], runs.cov[span, row])
        bound = runs.bound[span, row, 0, 0] + runs.bound[span, row, 1, 1]
        extra = (runs.nis[span, row], runs.used[span, row], bound)
        sums = [math.fsum(values) for values in extra] if filtered else [0.0, 0.0, 0.0]
        results.append(_result(track, bool(runs.reached[row]), filtered, sums))
        if seed < TRACKED_SEEDS:
            tracks.append(track)
    return FigureResult(tuple(results), tuple(tracks))


def _result(track: Track, reached: bool, filtered: bool, sums: list[float]) -> SeedResult:
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
    """The outcomes of parts of the seeds as one, in the order given."""
    return FigureResult(
        tuple(result for part in parts for result in part.results),
        tuple(track for part in parts for track in part.tracks),
    )


def summarize(figure: Figure, results: Sequence[SeedResult]) -> Summary:
    """The numbers of a figure over all seeds."""
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
    """Of the tracks the one whose end error is the (upper) median: the one to draw."""
    ranked = sorted(tracks, key=lambda track: float(np.hypot(*(track.mean - track.truth)[-1, :2])))
    return ranked[len(ranked) // 2]
