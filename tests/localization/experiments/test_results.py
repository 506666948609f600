"""Statistics of figure trials, on made-up runs with exact results."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.experiments.figure_trial import (
    FIGURES,
    TRACKED_SEEDS,
    FigureResult,
    Runs,
    SeedResult,
    Summary,
    figure_result,
    join_results,
    summarize,
    typical,
)


def made_up_runs(first_seed: int = 0) -> Runs:
    """Two seeds, of two and of three steps, off by (3, 4) in and 0.1 rad, and by nothing; what comes after is wild."""
    truth = np.zeros((3, 2, 3))
    mean = np.zeros((3, 2, 3))
    # Seed 0 has two steps; the third row must not count.
    mean[:2, 0] = (3.0, 4.0, 0.1)
    mean[2, 0] = 1e6
    return Runs(
        seeds=(first_seed, first_seed + 1),
        steps=np.array([2, 3]),
        reached=np.array([True, False]),
        truth=truth,
        mean=mean,
        cov=np.tile(np.diag([1.0, 4.0, 0.01]), (3, 2, 1, 1)),
        bound=np.tile(np.diag([0.25, 0.75, 0.01]), (3, 2, 1, 1)),
        nis=np.array([[8.0, 16.0], [8.0, 16.0], [1e6, 16.0]]),
        used=np.array([[10, 16], [10, 16], [99, 16]]),
    )


def test_a_seed_is_summed_over_its_own_steps() -> None:
    first, second = figure_result(made_up_runs(), filtered=True).results
    # Errors of 5 in at each of two steps: 50 in^2 in total; used beams 10 + 10.
    assert first == SeedResult(
        seed=0,
        steps=2,
        reached=True,
        end_error_in=5.0,
        position_in2=50.0,
        heading_rad2=2 * 0.1**2,
        nees=first.nees,
        nis=16.0,
        used=20.0,
        bound_in2=2.0,
    )
    # NEES of one step: 3^2 / 1 + 4^2 / 4 + 0.1^2 / 0.01.
    assert first.nees == pytest.approx(2 * (9 + 4 + 1))
    assert (second.steps, second.reached, second.end_error_in, second.bound_in2) == (3, False, 0.0, 3.0)


def test_a_figure_is_summed_over_all_steps_of_all_seeds() -> None:
    summary = summarize(FIGURES["5.4"], figure_result(made_up_runs(), filtered=True).results)
    assert list(summary) == list(Summary.__annotations__)
    assert summary["figure"] == "5.4"
    assert (summary["seeds"], summary["reached"]) == (2, 1)
    # Medians of 2 and 3 steps; the thesis reports 1199.
    assert (summary["steps_median"], summary["steps_thesis"]) == (2.5, 1199)
    assert summary["end_error_median_in"] == 2.5
    # Five steps in all, two of them with errors.
    assert summary["rmse_position_in"] == pytest.approx(math.sqrt(50 / 5))
    assert summary["rmse_heading_deg"] == pytest.approx(math.degrees(math.sqrt(0.02 / 5)))
    assert summary["nees_mean"] == pytest.approx(28 / 5)
    # 64 is the sum of NIS over steps within the runs, 68 the number of beams.
    assert summary["nis_mean"] == pytest.approx(64 / 68)
    assert summary["pcrb_position_in"] == pytest.approx(1.0)
    assert summary["nees_band95"] is not None


def test_without_the_filter_its_numbers_have_no_meaning() -> None:
    summary = summarize(FIGURES["5.2"], figure_result(made_up_runs(), filtered=False).results)
    empty = {key for key, value in summary.items() if value is None}
    assert empty == {"steps_thesis", "nees_mean", "nees_band95", "nis_mean", "pcrb_position_in"}
    assert summary["rmse_position_in"] == pytest.approx(math.sqrt(50 / 5))


def test_nis_is_none_without_used_beams() -> None:
    (result, _) = figure_result(made_up_runs(), filtered=False).results
    assert summarize(FIGURES["5.4"], [result])["nis_mean"] is None


def test_whole_runs_are_saved_of_the_first_seeds_only() -> None:
    assert [track.seed for track in figure_result(made_up_runs(), True).tracks] == [0, 1]
    assert [track.seed for track in figure_result(made_up_runs(TRACKED_SEEDS - 1), True).tracks] == [TRACKED_SEEDS - 1]
    assert figure_result(made_up_runs(), True).tracks[0].mean.shape == (2, 3)


def test_parts_are_joined_in_their_order() -> None:
    parts = [figure_result(made_up_runs(seed), True) for seed in (0, 2)]
    whole = join_results(parts)
    assert [result.seed for result in whole.results] == [0, 1, 2, 3]
    assert [track.seed for track in whole.tracks] == [0, 1, 2, 3]
    assert join_results([]) == FigureResult((), ())


def test_the_typical_run_ends_with_the_median_error() -> None:
    tracks = figure_result(made_up_runs(), True).tracks
    assert typical([tracks[1], tracks[0], tracks[1]]) is tracks[1]
    assert typical([tracks[1], tracks[0]]) is tracks[0]
