"""Summaries of lost trials, as numbers and as text."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest

from localization.experiments.live_trial import SCENARIOS
from localization.experiments.lost import (
    Case,
    Kind,
    LostResult,
    brier_excess_std,
    brier_score,
    expected_brier_score,
    summaries,
    words,
)


def case(kind: Kind, seed: int) -> Case:
    return Case(kind, "several_walls", SCENARIOS["exact"], seed)


def test_calm_runs_count_their_alarms_and_weigh_by_time() -> None:
    # Runs of 600, 300 and 900 s: half an hour in total.
    (found,) = summaries({
        case(Kind.TRACKING, 0): LostResult(600.0, 0, 0.1, 1.0),
        case(Kind.TRACKING, 1): LostResult(300.0, 3, 0.4, 2.0),
        case(Kind.TRACKING, 2): LostResult(900.0, 0, 0.0, None),
    })
    assert (found.runs, found.false_alarms, found.alarmed, found.hours) == (3, 3, 1, 0.5)
    # DEGRADED for a tenth of 600 s and four tenths of 300 s.
    assert found.degraded == pytest.approx((60.0 + 120.0) / 1800.0)
    # Squared errors 1 and 2 by time; the third run has none.
    assert found.rmse_in == pytest.approx(2.0**0.5)
    assert found.detected is found.found is None
    assert "3 false alarms in 1 runs; DEGRADED 10.00% of the time; position RMSE 1.41 in" in words(found)


def test_kidnapping_summary_counts_alarms_and_recoveries() -> None:
    # Detected after 2, 7, 3 s and never; recovered correctly twice, once at a wrong place.
    (found,) = summaries({
        case(Kind.KIDNAPPED, 0): LostResult(40.0, 0, 0.0, 0.3, 2.0, 1.0, True),
        case(Kind.KIDNAPPED, 1): LostResult(40.0, 0, 0.0, 0.3, 7.0, 9.0, True),
        case(Kind.KIDNAPPED, 2): LostResult(40.0, 0, 0.0, 0.3, 3.0, 2.0, False),
        case(Kind.KIDNAPPED, 3): LostResult(40.0, 0, 0.0, 0.3, None, None, False),
    })
    # Two of the detections took at most 5 s.
    assert (found.detected, found.soon, found.found, found.mistaken) == (3, 2, 2, 1)
    assert found.detected_s == (3.0, 7.0)
    # Correct recoveries took 1 and 9 s: the upper median, and the longest.
    assert found.found_s == (9.0, 9.0)
    text = words(found)
    assert "detected (LOST): 3, 2 of them within 5 s (median 3.0 s, at most 7.0 s)" in text
    assert "correct recoveries: 2 (median 9.0 s, at most 9.0 s); wrong recoveries: 1" in text


def test_ok_before_any_unambiguous_place_is_counted() -> None:
    times = [(10.0, 4.0), (10.0, 10.0), (10.0, 11.0), (10.0, None), (None, 5.0), (None, None)]
    (found,) = summaries({
        case(Kind.WRONG_DOOR, seed): LostResult(60.0, 0, 0.0, None, None, ok_s, True, 3, (), unambiguous_s)
        for seed, (ok_s, unambiguous_s) in enumerate(times)
    })
    # The third and the fourth.
    assert found.early == 2
    assert "OK before an unambiguous place: 2 of 6" in words(found)


def test_summary_without_recoveries_has_no_times() -> None:
    (found,) = summaries({case(Kind.UNKNOWN_START, 0): LostResult(90.0, 0, 0.0, None)})
    assert found.found == 0
    assert words(found).splitlines()[1] == "  correct recoveries: 0; wrong recoveries: 0"


def test_summaries_per_kind_in_order_of_cases() -> None:
    outcome = LostResult(60.0, 0, 0.0, 0.2)
    found = summaries({case(kind, 0): outcome for kind in (Kind.UNKNOWN_START, Kind.TRACKING)})
    assert [summary.kind for summary in found] == ["nowhere", "calm"]


@pytest.mark.parametrize("probabilities", [(0.25,) * 4, (0.7, 0.2), (1.0,), (0.1,) * 8])
def test_the_expected_brier_score_is_the_mean_over_outcomes(probabilities: tuple[float, ...]) -> None:
    """Oracle: the score of each outcome, elsewhere among them, weighted by its probability."""
    outcomes = [*range(len(probabilities)), None]
    weights = [*probabilities, 1.0 - sum(probabilities)]
    instants = [[(p, i == right) for i, p in enumerate(probabilities)] for right in outcomes]
    scores = [brier_score([instant]) for instant in instants]
    mean = sum(weight * score for weight, score in zip(weights, scores, strict=True) if score is not None)
    assert expected_brier_score([instants[0]]) == pytest.approx(mean, abs=1e-9)
    assert expected_brier_score([]) is None


def test_two_right_hypotheses_are_one_outcome() -> None:
    assert brier_score([[(0.6, True), (0.4, True)]]) == pytest.approx(0.0)
    assert brier_score([[(0.5, True), (0.2, True), (0.3, False)]]) == pytest.approx(0.18)
    assert brier_score([[(0.5, False), (0.3, False)]]) == pytest.approx(0.25 + 0.09 + 0.64)


def test_standard_error_of_the_brier_score_is_that_of_repeats() -> None:
    """Oracle: the scatter over 300 experiments of 60 runs, whose one to six instants are all right or all wrong."""
    rng = np.random.default_rng(5)
    excesses, stated_errors = [], []
    for _ in range(300):
        runs = []
        for probability, count in zip(rng.uniform(0.5, 1.0, 60).tolist(), rng.integers(1, 7, 60).tolist(), strict=True):
            is_right = bool(rng.random() < probability)
            runs.append([[(probability, is_right), (1.0 - probability, not is_right)]] * count)
        instants = [*chain(*runs)]
        score, expected, error = brier_score(instants), expected_brier_score(instants), brier_excess_std(runs)
        assert score is not None
        assert expected is not None
        assert error is not None
        excesses.append(score - expected)
        stated_errors.append(error)
    assert np.mean(stated_errors) == pytest.approx(np.std(excesses), rel=0.1)
    assert brier_excess_std([[[(1.0, True)]], []]) is None
    (found,) = summaries({
        case(Kind.UNKNOWN_START, seed): LostResult(60.0, 0, 0.0, None, stated=[[(0.8, is_right), (0.2, not is_right)]])
        for seed, is_right in enumerate((True, False))
    })
    # Scores 0.08 and 1.28, 0.32 expected: 0.36 more, with a standard error of 0.6 of two runs.
    assert "Brier score 0.680, 0.320 expected if calibrated (standard error of the difference 0.600)" in words(found)
