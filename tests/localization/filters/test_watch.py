"""The watch: a CUSUM by hand, its false alarms against Wald's bound, and each reason to be in doubt."""

from __future__ import annotations

from math import exp, log
from typing import NamedTuple

import numpy as np
import pytest

from localization.filters.belief import independent
from localization.filters.health import HEALTHY, Bounds, HealthStatus, IntegrityMonitor

SHARP, BLUNT = independent([0, 0, 0], [0.2, 0.2, 0.01]), independent([0, 0, 0], [0.2, 4.0, 0.01])


class Taken(NamedTuple):
    outlier_probability: float = 0.0
    nis: float = 1.0


def test_evidence_adds_up_from_its_highest_and_each_reading_counts_so_much_at_most() -> None:
    watch = IntegrityMonitor(Bounds(lost_nats=10.0, most_bad_nats=4.0, most_good_nats=1.0))
    for likelihood, expected in ((10.0, 0.0), (exp(-2.0), 2.0), (exp(1.0), 1.0), (1e-9, 5.0), (1e9, 4.0)):
        watch.hear(likelihood, 1.0, None)
        assert watch.fall_nats == pytest.approx(expected)
    assert watch.health(SHARP) == HEALTHY
    watch.hear(1e-9, 1.0, None)
    watch.hear(1e-9, 1.0, None)
    health = watch.health(SHARP)
    assert health.status is HealthStatus.LOST
    assert "fits anywhere better" in health.reason
    watch.reset()
    assert watch.health(SHARP) == HEALTHY


def test_false_alarms_are_no_more_frequent_than_walds_bound() -> None:
    """Readings that really come from the estimate: two gaussians a standard deviation apart, in place of ranges."""
    chance, alarms, readings = np.random.default_rng(5), 0, 20_000
    watch = IntegrityMonitor(Bounds(lost_nats=3.5, most_bad_nats=50.0, most_good_nats=50.0))
    for z in chance.standard_normal(readings).tolist():
        watch.hear(exp(-0.5 * z * z), exp(-0.5 * (z - 1.0) ** 2), None)
        if watch.health(SHARP).status is HealthStatus.LOST:
            alarms += 1
            watch.reset()
    assert 0 < alarms <= readings * exp(-3.5)


def test_a_spread_position_is_degraded_from_the_beginning() -> None:
    health = IntegrityMonitor().health(BLUNT)
    assert health.status is HealthStatus.DEGRADED
    assert "4.0 in" in health.reason


def test_few_explained_echoes_degrade() -> None:
    watch = IntegrityMonitor(Bounds(window=10, least_matched=0.35))
    for index in range(10):
        watch.hear(1.0, 1.0, Taken(outlier_probability=0.0 if index < 3 else 1.0))
    assert watch.health(SHARP).status is HealthStatus.DEGRADED
    assert "30% of the last 10" in watch.health(SHARP).reason
    watch.hear(1.0, 1.0, Taken())
    watch.hear(1.0, 1.0, Taken())
    watch.hear(1.0, 1.0, Taken())
    watch.hear(1.0, 1.0, Taken())
    assert watch.health(SHARP) == HEALTHY


def test_large_innovations_degrade_and_those_of_bad_readings_do_not_count() -> None:
    watch = IntegrityMonitor(Bounds(window=10))
    for _ in range(10):
        watch.hear(1.0, 1.0, Taken(outlier_probability=0.2, nis=4.0))
    assert watch.health(SHARP).status is HealthStatus.DEGRADED
    assert "4.0 times" in watch.health(SHARP).reason
    watch.reset()
    for _ in range(10):
        watch.hear(1.0, 1.0, Taken(outlier_probability=0.55, nis=100.0))
    assert watch.health(SHARP) == HEALTHY


def test_logarithms_are_natural() -> None:
    watch = IntegrityMonitor()
    watch.hear(0.5, 1.0, None)
    assert watch.fall_nats == pytest.approx(log(2.0))


def test_falling_evidence_or_few_explained_echoes_are_a_reason_to_doubt() -> None:
    watch = IntegrityMonitor(Bounds(doubt_nats=6.0, lost_nats=10.0, window=4, least_matched=0.5))
    assert not watch.doubtful
    watch.hear(1e-9, 1.0, None)
    watch.hear(1e-9, 1.0, None)
    assert (watch.doubtful, watch.lost) == (True, False)
    watch.reset()
    for outlier_probability in (1.0, 1.0, 1.0, 0.0):
        assert not watch.doubtful
        watch.hear(1.0, 1.0, Taken(outlier_probability=outlier_probability))
    assert watch.doubtful
