"""The monitor: a CUSUM by hand, its false alarms against Wald's bound, each status; slips by scipy's densities."""

from __future__ import annotations

from math import exp, log

import numpy as np
import pytest

from localization.filters.belief import independent
from localization.filters.health import (
    ALLOWANCE_NATS,
    COUNTS,
    DISPLACEMENTS_IN,
    HEALTHY,
    MAX_GAIN_NATS,
    MAX_NATS_OF_ONE_SIDE,
    MAX_NIS,
    MAX_SIDE_NATS,
    MAX_SLIP_PROBABILITY,
    ROUNDS_PER_SLIP,
    SLIP_RATE_SHAPE,
    SLIPS,
    HealthLimits,
    HealthStatus,
    IntegrityMonitor,
    displacement_evidence,
    max_slip_evidence,
    most_likely_slip,
    slip_probability,
)
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


@pytest.mark.long
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

SLIPPING = HealthLimits(slip_nats=6.0)


def densities_ratio(innovation: float, std: float, shift: float) -> float:
    """Log ratio of two normal densities with outliers: no density falls below that of MAX_NIS."""
    from scipy.stats import norm

    floor = float(norm.logpdf(np.sqrt(MAX_NIS) * std, 0.0, std))
    shifted, expected = norm.logpdf(innovation, shift, std), norm.logpdf(innovation, 0.0, std)
    return max(float(shifted), floor) - max(float(expected), floor)


@pytest.mark.long
@pytest.mark.parametrize("shift", [-5.0, -1.3, 0.4, 3.0])
@pytest.mark.parametrize("innovation", [-2.9, -0.3, 0.7, 1.6, 4.0])
def test_evidence_is_the_ratio_of_normal_densities(innovation: float, shift: float) -> None:
    std = 0.8
    nis = (innovation / std) ** 2
    assert displacement_evidence(innovation, nis, shift) == pytest.approx(densities_ratio(innovation, std, shift))


@pytest.mark.long
def test_slip_test_is_the_cusum_of_each_displacement() -> None:
    """Sums written out, of all displacements and both sides, for readings of a robot that is 2 in behind from half."""
    rng, std, test = np.random.default_rng(2), 0.8, IntegrityMonitor()
    sums = np.zeros((2, len(DISPLACEMENTS_IN)))
    for number, slope in enumerate(rng.choice([-1.0, -0.7, 0.6, 1.0], 40).tolist()):
        innovation = std * float(rng.standard_normal()) + (-2.0 * slope if number >= 20 else 0.0)
        test.add_innovation(innovation, (innovation / std) ** 2, slope)
        for j, displacement in enumerate(DISPLACEMENTS_IN):
            gain = min(densities_ratio(innovation, std, slope * displacement), MAX_GAIN_NATS) - ALLOWANCE_NATS
            one = sums[int(slope > 0.0), j] + gain
            sums[int(slope > 0.0), j] = min(max(0.0, one), MAX_SIDE_NATS)
        best = int(sums.sum(axis=0).argmax())
        _, evidence = most_likely_slip(test.slip_sums)
        assert evidence == pytest.approx(np.minimum(sums, MAX_NATS_OF_ONE_SIDE)[:, best].sum())
        assert evidence <= max_slip_evidence(test.slip_sums)
    assert most_likely_slip(test.slip_sums)[0] == -2.0
    assert evidence > SLIPPING.slip_nats


@pytest.mark.parametrize("displacement", [-4.0, -2.0, 2.5])
def test_slip_is_found_within_a_ring(displacement: float) -> None:
    monitor, slopes = IntegrityMonitor(SLIPPING), np.cos(np.arange(16) * np.pi / 8).tolist()
    readings, found = 0, 0.0
    while found == 0.0:
        slope = slopes[readings]
        innovation = displacement * slope
        monitor.add(outcome(nis=(innovation / 0.6) ** 2))
        monitor.add_innovation(innovation, (innovation / 0.6) ** 2, slope)
        found = monitor.take_slip()
        readings += 1
    assert readings <= 12
    assert abs(found - displacement) <= 1.0
    # DEGRADED for some readings more; the test begins anew.
    reasons = []
    for _ in range(SLIPPING.after_slip + 1):
        reasons.append(monitor.health(np.eye(3)).reason)
        monitor.add(outcome())
    assert ["slipped" in reason for reason in reasons] == [True] * SLIPPING.after_slip + [False]
    assert monitor.take_slip() == 0.0


def test_something_unmapped_on_one_side_is_no_slip() -> None:
    monitor = IntegrityMonitor(SLIPPING)
    for _ in range(100):
        monitor.add(outcome())
        monitor.add_innovation(-3.0, 25.0, -1.0)
        assert monitor.take_slip() == 0.0
    # It may be one, though.
    assert "slipped" in monitor.health(np.eye(3)).reason


@pytest.mark.long
@pytest.mark.parametrize("bad", [0.0, 0.2])
def test_consistent_or_bad_readings_seldom_mean_a_slip(bad: float) -> None:
    """Readings of a consistent filter; then a fifth of them anywhere, which agree on no displacement."""
    rng, monitor = np.random.default_rng(3), IntegrityMonitor(SLIPPING)
    slips, suspected, std = 0, 0, 0.6
    for angle in rng.uniform(0.0, 2.0 * np.pi, 10_000).tolist():
        innovation = std * float(rng.standard_normal()) if rng.random() >= bad else float(rng.uniform(-30.0, 200.0))
        monitor.add_innovation(innovation, (innovation / std) ** 2, float(np.cos(angle)))
        suspected += slip_probability(monitor.slip_sums)[0] > MAX_SLIP_PROBABILITY
        slips += monitor.take_slip() != 0.0
    assert slips <= 10
    assert suspected <= 50


def test_probability_of_a_slip_is_by_bayes_rule() -> None:
    """Three readings after a slip by 3 in, densities by scipy, among slips by each displacement and none."""
    test, std, slopes = IntegrityMonitor(), 1.0, [-0.9, -0.4, -0.6]
    innovations = [-3.0 * slope for slope in slopes]
    for innovation, slope in zip(innovations, slopes, strict=True):
        test.add_innovation(innovation, (innovation / std) ** 2, slope)
    weights = []
    for displacement in DISPLACEMENTS_IN:
        nats = 0.0
        for innovation, slope in zip(innovations, slopes, strict=True):
            gain = min(densities_ratio(innovation, std, slope * displacement), MAX_GAIN_NATS) - ALLOWANCE_NATS
            nats = min(max(0.0, nats + gain), MAX_SIDE_NATS)
        before = SLIP_RATE_SHAPE / (SLIP_RATE_SHAPE * ROUNDS_PER_SLIP + 3 / 16)
        weights.append((exp(nats) - 1.0) / len(DISPLACEMENTS_IN) * before)
    posterior = np.array(weights) / (1.0 + sum(weights))
    probability, squared_in2 = slip_probability(test.slip_sums)
    assert probability == pytest.approx(posterior.sum())
    assert squared_in2 == pytest.approx(posterior @ np.square(DISPLACEMENTS_IN))
    # Too little for DEGRADED, enough to widen what is reported.
    assert 0.01 < probability < MAX_SLIP_PROBABILITY


def test_wheels_that_slipped_are_expected_to_slip_again() -> None:
    """The mean of the rate given its slips, by integration of prior times the Poisson probability of the count."""
    from scipy.stats import gamma, poisson

    test, rounds, slips = IntegrityMonitor(), 120.0, 4
    test.slip_sums[COUNTS][SLIPS] = float(slips)
    for _ in range(int(16 * rounds) - 1):
        test.add_innovation(0.0, 0.0, 1.0)
    test.add_innovation(1.9, 3.61, 1.0)
    # Mean 1 / ROUNDS_PER_SLIP, whatever the shape; its density is infinite at 0.
    rates = np.linspace(0.0, 1.0, 200_001)[1:]
    prior = gamma(SLIP_RATE_SHAPE, scale=1.0 / (SLIP_RATE_SHAPE * ROUNDS_PER_SLIP))
    assert prior.mean() == pytest.approx(1.0 / ROUNDS_PER_SLIP)
    weights = prior.pdf(rates) * poisson.pmf(slips, rates * rounds)
    alone = IntegrityMonitor()
    alone.add_innovation(1.9, 3.61, 1.0)
    # The same reading, at the rate learned and at the first.
    odds, first = (p / (1.0 - p) for p in (slip_probability(test.slip_sums)[0], slip_probability(alone.slip_sums)[0]))
    before = (weights @ rates) / weights.sum()
    assert odds / first == pytest.approx(before * (ROUNDS_PER_SLIP + 1 / 16 / SLIP_RATE_SHAPE), rel=1e-4)
    # Four slips in two minutes, one in 30 rounds: the rate is that within a factor of two.
    assert 1 / 60 < before < 1 / 30
