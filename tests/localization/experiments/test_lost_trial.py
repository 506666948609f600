"""Trials of lost robots: short ones through the whole simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from localization.experiments import lost
from localization.experiments.live_trial import SCENARIOS
from localization.experiments.lost import Case, Kind, drive
from localization.filters.health import COUNT, MATCHED, IntegrityMonitor

pytestmark = pytest.mark.long

EXACT = Case(Kind.TRACKING, "several_walls", SCENARIOS["exact"], 3, 12.0)


def test_tracking_run_has_given_length_and_no_alarm() -> None:
    outcome = drive(EXACT)
    assert outcome.seconds == pytest.approx(12.0, abs=0.2)
    assert (outcome.alarms, outcome.degraded, outcome.lost_after_s, outcome.found_after_s) == (0, 0.0, None, None)
    assert outcome.rmse_in is not None
    assert outcome.rmse_in < 0.5
    # The same case again gives the same outcome: all randomness comes from its seed.
    assert outcome == drive(EXACT)


def test_alarms_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A monitor that gives an alarm every thirty echoes, and the robot finds itself between them."""
    monkeypatch.setattr(IntegrityMonitor, "is_lost", property(lambda monitor: monitor.windows[MATCHED][COUNT] >= 30))
    assert drive(EXACT).alarms >= 2


@pytest.mark.parametrize(("seed", "seconds"), [(125, 42.0), (139, 54.0)])
def test_random_fit_of_few_echoes_raises_no_alarm(seed: int, seconds: float) -> None:
    """A fifth of the readings bad and the heading off after a turn: elsewhere fits the last echoes better by e^19."""
    assert drive(Case(Kind.TRACKING, "several_walls", SCENARIOS["measured"], seed, seconds)).alarms == 0


def test_kidnapped_robot_is_detected_and_recovers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lost, "KIDNAPPED_S", (5.0, 6.0))
    outcome = drive(replace(EXACT, kind=Kind.KIDNAPPED, seed=1))
    assert outcome.alarms == 0
    assert outcome.lost_after_s is not None
    assert 0.0 < outcome.lost_after_s <= 5.0
    assert outcome.found_after_s is not None
    assert outcome.right


def test_a_robot_that_is_reported_nothing_finds_itself() -> None:
    outcome = drive(replace(EXACT, kind=Kind.UNKNOWN_START, seed=2))
    assert outcome.rmse_in is None
    assert outcome.found_after_s is not None
    assert outcome.right


def test_in_a_square_room_nothing_is_ever_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lost, "SEARCH_LIMIT_S", 15.0)
    # A square room looks the same from four places, so that no search ends.
    outcome = drive(replace(EXACT, kind=Kind.UNKNOWN_START, world="thesis_room"))
    assert outcome.found_after_s is None
    assert not outcome.right


def test_undetected_kidnapping_has_no_detection_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lost, "KIDNAPPED_S", (2.0, 3.0))
    monkeypatch.setattr(lost, "SEARCH_LIMIT_S", 0.5)
    outcome = drive(replace(EXACT, kind=Kind.KIDNAPPED))
    assert outcome.lost_after_s is None
    assert outcome.found_after_s is None


def test_uncertain_starts_are_as_probable_as_their_belief_says() -> None:
    """Oracle: Bayes' theorem, with SciPy's normal density, for five equal doors of which any may be the true one."""
    doors = [np.array([156.0 * number, 0.0, 0.0]) for number in range(5)]
    cov = np.diag([156.0, 156.0, 0.1]) ** 2
    rng = np.random.default_rng(0)
    counts = np.zeros(5)
    for _ in range(4000):
        start = lost._drawn_start(doors[2], doors[:2] + doors[3:], cov, rng)
        np.testing.assert_array_equal(start.cov, cov)
        counts[round(start.mean[0] / 156.0)] += 1.0
    density = multivariate_normal(doors[2], cov).pdf(doors)
    np.testing.assert_allclose(counts / 4000.0, density / density.sum(), atol=0.03)
