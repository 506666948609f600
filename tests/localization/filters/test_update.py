"""The update by a reading of several reflectors, against the mixture integrated on a fine grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats, pack, unpack
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import range_variance
from localization.filters.update import Association, PdaResult, Refusal, kalman_update, pda_update

MODEL = ConeSonar(outlier_probability=0.2)
CONSTANT = 0.06
BELIEF = Belief(np.array([0.0, 0.0, 0.0]), np.diag([1.5**2, 0.4**2, 0.02**2]))


def unknown(_: Floats) -> tuple[Floats, Floats]:
    raise AssertionError("the linear rule asks for nothing elsewhere")


def returns(*found: tuple[float, tuple[float, float, float], float], model: ConeSonar = MODEL) -> Association:
    ranges, rows, probability = zip(*found, strict=True) if found else ((), (), ())
    R = [range_variance(model, range_in) for range_in in ranges]
    return Association(
        Refusal.NONE, 1.0, ranges, rows, R, [CONSTANT] * len(R), probability, unknown,
        model.outlier_probability, model.outlier_density,
    )  # fmt: skip


def updated(belief: Belief, reading_in: float, association: Association, count: int = 1) -> tuple[Belief, PdaResult]:
    x, P = unpack(belief)
    result = pda_update(x, P, reading_in, association, count=count)
    return pack(x, P), result


TWO = returns((40.0, (-1.0, 0.0, 0.0), 0.6), (43.0, (-1.0, 0.0, 0.0), 0.3))
"""Two reflectors straight ahead in x: the mixture is one-dimensional."""


@pytest.mark.parametrize("reading", [40.0, 41.5, 43.0, 46.0, 120.0])
def test_moments_of_the_mixture_by_quadrature(reading: float) -> None:
    # Bayes' rule on a grid of 200,001 states: prior, outliers, two reflectors.
    x = np.linspace(-15, 15, 200_001)
    prior = np.exp(-0.5 * (x / 1.5) ** 2)
    # Weight 0.2 is the outlier probability; 0.1 is the probability of no echo from either reflector.
    likelihood = np.full_like(x, MODEL.outlier_density * (0.2 + 0.8 * 0.1))
    for at, probability in ((40.0, 0.6), (43.0, 0.3)):
        variance = float(MODEL.variance(np.array(at)))
        density = np.exp(-0.5 * (reading - (at - x)) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        likelihood += 0.8 * probability * density
    posterior = prior * likelihood / (prior * likelihood).sum()
    mean = (posterior * x).sum()
    # The update gives mean and variance of this posterior.
    after, result = updated(BELIEF, reading, TWO)
    assert after.mean[0] == pytest.approx(mean, abs=1e-6)
    assert after.cov[0, 0] == pytest.approx((posterior * (x - mean) ** 2).sum(), rel=1e-5)
    assert sum(result.beta) == pytest.approx(1.0)


def test_one_certain_reflector_is_the_kalman_update() -> None:
    sure = replace(MODEL, outlier_probability=0.0)
    one = returns((40.0, (-0.8, 0.6, 2.0), 1.0), model=sure)
    after, result = updated(BELIEF, 41.0, one)
    # The Kalman update of the textbook: S = H P H' + R, K = P H' / S.
    H, R = np.array([-0.8, 0.6, 2.0]), range_variance(sure, 40.0)
    S = H @ BELIEF.cov @ H + R
    K = BELIEF.cov @ H / S
    np.testing.assert_allclose(after.mean, BELIEF.mean + K, atol=1e-12)
    np.testing.assert_allclose(after.cov, BELIEF.cov - S * np.outer(K, K), atol=1e-12)
    assert result.nis == pytest.approx(1.0 / S)
    # kalman_update changes x and P in place and gives the same.
    x, P = unpack(BELIEF)
    assert kalman_update(x, P, H.tolist(), R, 1.0) == pytest.approx(1.0 / S)
    np.testing.assert_allclose(pack(x, P).mean, after.mean, atol=1e-15)
    np.testing.assert_allclose(pack(x, P).cov, after.cov, atol=1e-15)


def test_a_reading_of_nothing_on_the_map_changes_nothing() -> None:
    after, result = updated(BELIEF, 200.0, TWO)
    np.testing.assert_allclose(after.mean, BELIEF.mean, atol=1e-12)
    np.testing.assert_allclose(after.cov, BELIEF.cov, atol=1e-12)
    assert result.beta[-1] == pytest.approx(1.0)


def test_without_reflectors_every_reading_is_an_outlier() -> None:
    after, result = updated(BELIEF, 50.0, returns())
    assert result.beta[-1] == 1.0
    assert result.likelihood == MODEL.outlier_density
    assert np.isnan(result.nis)
    np.testing.assert_array_equal(after.mean, BELIEF.mean)


def test_parameters_are_corrected_through_their_correlation() -> None:
    cov = np.diag([1.0, 1.0, 0.01, 0.0025])
    cov[0, 3] = cov[3, 0] = 0.04
    after, _ = updated(Belief(np.zeros(4), cov), 39.0, returns((40.0, (-1.0, 0.0, 0.0), 1.0)))
    assert after.mean[0] > 0.5
    assert after.mean[3] == pytest.approx(0.04 * after.mean[0])
    assert after.cov[3, 3] < cov[3, 3]


def after_readings(readings: Floats) -> Belief:
    """Return BELIEF after readings of a wall at x = 40 from one pose."""
    wall = returns((40.0, (-1.0, 0.0, 0.0), 1.0), model=replace(MODEL, outlier_probability=0.0))
    belief = BELIEF
    for number, reading in enumerate(readings, start=1):
        here = wall._replace(ranges_in=[40.0 - float(belief.mean[0])])
        belief, _ = updated(belief, float(reading), here, number)
    return belief


def test_repeated_readings_give_the_true_variance() -> None:
    """The estimate is linear in the readings; its true variance follows from their whole covariance."""
    count, prior = 6, BELIEF.cov[0, 0]
    none = after_readings(np.full(count, 40.0)).mean[0]
    weights = np.array([after_readings(40.0 + one).mean[0] - none for one in np.eye(count)])
    noise = np.eye(count) * (range_variance(MODEL, 40.0) - CONSTANT) + CONSTANT
    true = (1.0 + weights.sum()) ** 2 * prior + weights @ noise @ weights
    assert after_readings(np.full(count, 40.0)).cov[0, 0] == pytest.approx(true, rel=1e-9)


def test_a_repeated_reading_is_associated_like_the_first() -> None:
    (first, first_result), (fifth, fifth_result) = (updated(BELIEF, 41.5, TWO, count) for count in (1, 5))
    assert fifth_result == first_result
    assert abs(fifth.mean[0]) < abs(first.mean[0])


@pytest.mark.parametrize("reading", [42.0, 44.5, 45.5])
def test_probable_outliers_do_not_correct_while_most_fit(reading: float) -> None:
    near = Belief(BELIEF.mean, 0.1 * BELIEF.cov)
    (x, P), one = unpack(near), returns((40.0, (-1.0, 0.0, 0.5), 0.9))
    full, plain = updated(near, reading, one)
    held = pda_update(x, P, reading, one, outlier_fraction=0.5)
    # The association is the same; the state is corrected by readings that are more probably echoes only.
    assert held == plain
    is_outlier = held.beta[-1] > 0.5
    assert is_outlier == (reading > 42.0)
    expected = near if is_outlier else full
    np.testing.assert_array_equal(pack(x, P).mean, expected.mean)
    np.testing.assert_array_equal(pack(x, P).cov, expected.cov)
    # Where most do not fit, the belief may be wrong, and they correct.
    x, P = unpack(near)
    pda_update(x, P, reading, one, outlier_fraction=0.6)
    np.testing.assert_array_equal(pack(x, P).cov, full.cov)
    assert not np.array_equal(full.cov, near.cov)
