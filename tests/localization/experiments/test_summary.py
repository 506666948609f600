"""Statistics of live trials, on made-up records with exact results."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.experiments.live_trial import LOST_IN, Record, result_of, summarize


def record(errors: list[tuple[float, float, float]], seed: int = 0, *, reached: bool = True) -> Record:
    """Along x, 10 in apart; the encoders' errors step by 0.1 in; covariances of 0.04, 0.04, 0.01."""
    count = len(errors)
    truth = np.zeros((count, 3))
    # True x is 0, 10, 20, .. in.
    truth[:, 0] = 10.0 * np.arange(count)
    encoders = truth.copy()
    # Encoder errors alternate, so that each step is off by 0.1 in.
    encoders[:, 1] = 0.1 * (np.arange(count) % 2)
    cov = np.tile(np.diag([0.04, 0.04, 0.01]), (count, 1, 1))
    spent = 1e-6 * np.arange(1.0, count + 1.0)
    return Record(seed, reached, np.arange(float(count)), truth[:, 0], truth, encoders, truth + errors, cov, spent)


def test_the_numbers_of_one_trial() -> None:
    result = result_of(record([(0.2, 0.0, 0.1), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)]))
    assert (result.seed, result.reached, result.judged, result.within, result.lost) == (0, True, 3, 2, False)
    output = (result.position_in2, result.heading_rad2, result.nees, result.worst_in, result.spent_us)
    assert output == pytest.approx((1.04, 0.01, 1.0 + 1.0 + 25.0, 1.0, 2.0))
    assert (result.estimate_steps_in2, result.odometry_steps_in2) == pytest.approx((0.04 + 1.0, 0.02))


def test_steps_before_judged_path_count_for_jitter_only() -> None:
    result = result_of(record([(9.0, 0.0, 1.0), (0.2, 0.0, 0.1)]), after_in=10.0)
    assert result.judged == 1
    assert result.worst_in == pytest.approx(0.2)
    assert result.estimate_steps_in2 == pytest.approx(8.8**2)


def test_a_summary_is_over_all_estimates_of_all_trials() -> None:
    # Three estimates off by 0.2 in and 0.1 rad, one off by more than the limit of lost.
    long, short = record([(0.2, 0.0, 0.1)] * 3), record([(0.0, LOST_IN + 0.1, 0.0)], seed=1, reached=False)
    summary = summarize([result_of(long), result_of(short)])
    assert (summary["seeds"], summary["reached"], summary["lost"]) == (2, 1, 1)
    # LOST_IN is 12 in: the fourth error is 12.1 in.
    assert summary["rmse_position_in"] == pytest.approx(math.sqrt((3 * 0.04 + 12.1**2) / 4))
    assert summary["rmse_heading_deg"] == pytest.approx(math.degrees(math.sqrt(0.03 / 4)))
    assert summary["nees_mean"] == pytest.approx((3 * 2.0 + 12.1**2 / 0.04) / 4)
    assert summary["coverage95"] == pytest.approx(0.75)
    assert summary["jitter"] == pytest.approx(0.0, abs=1e-12)
    assert summary["worst_in"] == pytest.approx(12.1)
    assert summary["step_us"] == pytest.approx(1.5)


def test_summary_without_judged_steps_has_no_numbers() -> None:
    summary = summarize([result_of(record([(0.0, 0.0, 0.0)]), after_in=24.0)])
    assert summary["seeds"] == 1
    for key in ("rmse_position_in", "rmse_heading_deg", "nees_mean", "coverage95", "jitter", "worst_in"):
        assert summary[key] is None
