"""The monitor: a CUSUM by hand, its false alarms against Wald's bound, and each status."""

from __future__ import annotations

from math import exp, log

import numpy as np
import pytest

from localization.filters.belief import independent
from localization.filters.health import HEALTHY, HealthLimits, HealthStatus, IntegrityMonitor
from localization.filters.update import Refusal, UpdateResult

SHARP, BLUNT = independent([0, 0, 0], [0.2, 0.2, 0.01]), independent([0, 0, 0], [0.2, 4.0, 0.01])


def outcome(outlier_probability: float = 0.0, nis: float = 1.0) -> UpdateResult:
    return UpdateResult(Refusal.NONE, 0.0, nis, outlier_probability)


def test_evidence_falls_from_its_maximum_within_limits() -> None:
    monitor = IntegrityMonitor(HealthLimits(lost_nats=10.0, max_loss_nats=4.0, max_gain_nats=1.0))
    # Likelihood against that of an outlier, in nats: losses are limited to 4, gains to 1 per reading.
    for likelihood, expected in ((10.0, 0.0), (exp(-2.0), 2.0), (exp(1.0), 1.0), (1e-9, 5.0), (1e9, 4.0)):
        monitor.add_evidence(likelihood, 1.0, None)
        assert monitor.fall_nats == pytest.approx(expected)
    assert monitor.health(SHARP.cov) == HEALTHY
    # Two losses of 4 more exceed the 10 nats.
    monitor.add_evidence(1e-9, 1.0, None)
    monitor.add_evidence(1e-9, 1.0, None)
    health = monitor.health(SHARP.cov)
    assert health.status is HealthStatus.LOST
    assert "anywhere" in health.reason
    monitor.reset()
    assert monitor.health(SHARP.cov) == HEALTHY


def test_false_alarms_are_no_more_frequent_than_walds_bound() -> None:
    """Readings that really come from the estimate: two gaussians a standard deviation apart, in place of ranges."""
    rng, alarms, readings = np.random.default_rng(5), 0, 20_000
    # Limits per reading are so wide that they have no influence: Wald's bound needs the plain ratio.
    monitor = IntegrityMonitor(HealthLimits(lost_nats=3.5, max_loss_nats=50.0, max_gain_nats=50.0))
    for z in rng.standard_normal(readings).tolist():
        monitor.add_evidence(exp(-0.5 * z * z), exp(-0.5 * (z - 1.0) ** 2), None)
        if monitor.health(SHARP.cov).status is HealthStatus.LOST:
            alarms += 1
            monitor.reset()
    # Wald: the probability of a false alarm after a restart is at most exp(-threshold).
    assert 0 < alarms <= readings * exp(-3.5)


def test_a_spread_position_is_degraded_from_the_beginning() -> None:
    health = IntegrityMonitor().health(BLUNT.cov)
    assert health.status is HealthStatus.DEGRADED
    assert "4.0 in" in health.reason


def test_few_explained_echoes_degrade() -> None:
    monitor = IntegrityMonitor(HealthLimits(window=10, min_matched=0.35))
    # 3 of 10 echoes are explained: less than 0.35.
    for index in range(10):
        monitor.add_evidence(1.0, 1.0, outcome(outlier_probability=0.0 if index < 3 else 1.0))
    assert monitor.health(SHARP.cov).status is HealthStatus.DEGRADED
    assert "30% of the last 10" in monitor.health(SHARP.cov).reason
    # Four more explained ones replace unexplained ones of the window: 7 of 10.
    monitor.add_evidence(1.0, 1.0, outcome())
    monitor.add_evidence(1.0, 1.0, outcome())
    monitor.add_evidence(1.0, 1.0, outcome())
    monitor.add_evidence(1.0, 1.0, outcome())
    assert monitor.health(SHARP.cov) == HEALTHY


def test_large_innovations_degrade_except_of_outliers() -> None:
    monitor = IntegrityMonitor(HealthLimits(window=10))
    for _ in range(10):
        # NIS has one degree of freedom: its expectation is 1.
        monitor.add_evidence(1.0, 1.0, outcome(outlier_probability=0.2, nis=4.0))
    assert monitor.health(SHARP.cov).status is HealthStatus.DEGRADED
    assert "4.0 times" in monitor.health(SHARP.cov).reason
    monitor.reset()
    # Likely outliers: their innovations say nothing of the estimate.
    for _ in range(10):
        monitor.add_evidence(1.0, 1.0, outcome(outlier_probability=0.55, nis=100.0))
    assert monitor.health(SHARP.cov) == HEALTHY


def test_logarithms_are_natural() -> None:
    monitor = IntegrityMonitor()
    monitor.add_evidence(0.5, 1.0, None)
    assert monitor.fall_nats == pytest.approx(log(2.0))


def test_falling_evidence_or_few_matches_are_suspicious() -> None:
    monitor = IntegrityMonitor(HealthLimits(suspicious_nats=6.0, lost_nats=10.0, window=4, min_matched=0.5))
    assert not monitor.is_suspicious
    # Two losses of 4 nats: above 6, below 10.
    monitor.add_evidence(1e-9, 1.0, None)
    monitor.add_evidence(1e-9, 1.0, None)
    assert (monitor.is_suspicious, monitor.is_lost) == (True, False)
    monitor.reset()
    # Without losses, but three of four readings unexplained.
    for outlier_probability in (1.0, 1.0, 1.0, 0.0):
        assert not monitor.is_suspicious
        monitor.add_evidence(1.0, 1.0, outcome(outlier_probability=outlier_probability))
    assert monitor.is_suspicious


# A slip of the wheels.

SLIPPING = HealthLimits(max_unexplained=4.0, max_drift=5.0)


def test_unexplained_echoes_mean_a_slip_once() -> None:
    monitor = IntegrityMonitor(SLIPPING)
    slips, reasons = [], []
    for number in range(40):
        monitor.add(outcome(1.0 if number % 3 == 0 else 0.0))
        slips.append(monitor.take_slip())
        reasons.append(monitor.health(np.eye(3)).reason)
    # Four of the first twelve; from then on as many are usual.
    assert [number for number, slip in enumerate(slips) if slip] == [11]
    assert ["slipped" in reason for reason in reasons] == [11 <= number < 23 for number in range(40)]
    # A slip makes nearly all of them outliers.
    for _ in range(12):
        monitor.add(outcome(1.0))
    assert monitor.take_slip()
    assert monitor.health(np.eye(3)).status is HealthStatus.DEGRADED


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_both_sides_of_the_robot_agree_on_a_slip(sign: float) -> None:
    monitor = IntegrityMonitor(SLIPPING)
    for _ in range(12):
        monitor.add(outcome())
    # Readings before the robot are too long and those behind it too short, or the other way round.
    count = 0
    while not monitor.take_slip():
        monitor.add_drift(2.0 * sign, 1.0)
        monitor.add_drift(-2.0 * sign, -1.0)
        count += 1
    assert count == 2


def test_something_unmapped_on_one_side_is_no_slip() -> None:
    monitor = IntegrityMonitor(SLIPPING)
    for _ in range(100):
        monitor.add(outcome())
        monitor.add_drift(-5.0, 1.0)
        assert not monitor.take_slip()


def test_consistent_innovations_seldom_mean_a_slip() -> None:
    rng, monitor = np.random.default_rng(3), IntegrityMonitor(SLIPPING)
    slips = 0
    for sigmas, angle in zip(rng.standard_normal(20_000), rng.uniform(0.0, 2.0 * np.pi, 20_000), strict=True):
        monitor.add(outcome(nis=sigmas * sigmas))
        monitor.add_drift(float(sigmas), float(np.cos(angle)))
        slips += monitor.take_slip()
    assert slips <= 20
