"""Live trials: short ones through the whole simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.experiments import live_trial
from localization.experiments.live_trial import SCENARIOS, START_STD, drive
from localization.filters.smoother import LAG

PERIODS = 40


@pytest.mark.long
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_trial_drives_and_estimate_stays_near_truth(scenario: str) -> None:
    record = drive(SCENARIOS[scenario], "5.8", 3, PERIODS)
    # The periods are too few to arrive.
    assert not record.reached
    assert record.truth.shape == record.mean.shape == record.encoders.shape == (PERIODS, 3)
    assert record.cov.shape == (PERIODS, 3, 3)
    # The clock advances by 0.1 s per period, in its steps of 16.4 ms.
    np.testing.assert_allclose(np.diff(record.clock_s), 0.1, atol=0.02)
    assert record.distance_in[-1] > 10.0
    assert np.hypot(*record.error[:, :2].T).max() < 1.0
    # The initial error is drawn from the initial belief.
    assert (np.abs(record.error[0]) < 4.0 * np.array(START_STD)).all()
    # Time is only measured on request.
    assert record.spent_s.tolist() == [0.0] * PERIODS


@pytest.mark.long
def test_same_seed_gives_the_same_run() -> None:
    one, again, other = (drive(SCENARIOS["measured"], "5.4", seed, 15) for seed in (1, 1, 2))
    assert (one.mean == again.mean).all()
    assert (one.truth == again.truth).all()
    assert not (one.mean == other.mean).all()


@pytest.mark.long
def test_a_trial_ends_at_the_last_goal() -> None:
    record = drive(SCENARIOS["exact"], "5.4", 0)
    assert record.reached
    assert 100 < len(record.mean) < 300


@pytest.mark.long
def test_the_timer_is_asked_before_and_after_each_estimate() -> None:
    ticks = iter(range(1000))
    record = drive(SCENARIOS["exact"], "5.4", 0, 10, lambda: float(next(ticks)))
    assert record.spent_s.tolist() == [1.0] * 10
    assert next(ticks) == 20


def test_smoother_record_lags_and_path_is_the_same() -> None:
    # The same trial without and with a smoother.
    plain = drive(SCENARIOS["exact"], "5.8", 3, PERIODS)
    looking = drive(replace(SCENARIOS["exact"], method="smoother"), "5.8", 3, PERIODS)
    assert looking.clock_s[0] == plain.clock_s[0]
    assert (np.diff(looking.clock_s) > 0.0).all()
    # The smoothed pose is older by the lag of the smoother, 60 ms per firing.
    assert plain.clock_s[-1] - looking.clock_s[-1] == pytest.approx(0.06 * LAG, abs=0.1)
    assert len(looking.spent_s) == PERIODS
    for column in (looking.truth, looking.encoders):
        assert column.shape == looking.mean.shape
    # The recorded truth is that of the smoothed instant, between two periods.
    at_end = np.searchsorted(plain.clock_s, looking.clock_s[-1])
    before, after = plain.truth[at_end - 1], plain.truth[at_end]
    assert min(before[0], after[0]) - 1e-9 <= looking.truth[-1, 0] <= max(before[0], after[0]) + 1e-9
    assert np.hypot(*looking.error[:, :2].T).max() < 0.5


def test_between_two_polls_the_heading_takes_the_short_path() -> None:
    poses = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]])
    middle = live_trial._interpolate(np.array([0.5]), np.array([0.0, 1.0]), poses)
    np.testing.assert_allclose(np.abs(middle), [[0.5, 1.0, np.pi]], atol=1e-12)
