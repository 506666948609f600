"""One reading that may be several things, against the same mixture worked out on a fine grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats
from localization.filters.ekf import correct
from localization.filters.sonar_cone import ConeSonar
from localization.filters.update import Hypotheses, Observation, pda_update

MODEL = ConeSonar(outlier_probability=0.2)
CONSTANT = 0.06
BELIEF = Belief(np.array([0.0, 0.0, 0.0]), np.diag([1.5**2, 0.4**2, 0.02**2]))


def unknown(_: Floats) -> tuple[Floats, Floats]:
    raise AssertionError("the linear rule asks for nothing elsewhere")


def returns(*found: tuple[float, tuple[float, float, float], float], model: ConeSonar = MODEL) -> Hypotheses:
    ranges, rows, chances = (np.array(column) for column in zip(*found, strict=True))
    variance, constant = model.variance(ranges), np.full(len(ranges), CONSTANT)
    return Hypotheses(ranges, rows, variance, constant, chances, unknown, model.outlier_probability, model.bad_density)


TWO = returns((40.0, (-1.0, 0.0, 0.0), 0.6), (43.0, (-1.0, 0.0, 0.0), 0.3))
"""Two reflectors straight ahead in x: the mixture is one-dimensional."""


@pytest.mark.parametrize("reading", [40.0, 41.5, 43.0, 46.0, 120.0])
def test_moments_of_the_mixture_by_quadrature(reading: float) -> None:
    x = np.linspace(-15, 15, 200_001)
    prior = np.exp(-0.5 * (x / 1.5) ** 2)
    likelihood = np.full_like(x, MODEL.bad_density * (0.2 + 0.8 * 0.1))
    for at, chance in ((40.0, 0.6), (43.0, 0.3)):
        variance = float(MODEL.variance(np.array(at)))
        likelihood += 0.8 * chance * np.exp(-0.5 * (reading - (at - x)) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
    posterior = prior * likelihood / (prior * likelihood).sum()
    mean = (posterior * x).sum()
    taken = pda_update(BELIEF, reading, TWO)
    assert taken.belief.mean[0] == pytest.approx(mean, abs=1e-6)
    assert taken.belief.cov[0, 0] == pytest.approx((posterior * (x - mean) ** 2).sum(), rel=1e-5)
    assert sum(taken.shares) == pytest.approx(1.0)


def test_one_sure_reflector_and_no_bad_readings_is_the_kalman_filter() -> None:
    sure = replace(MODEL, outlier_probability=0.0)
    one = returns((40.0, (-0.8, 0.6, 2.0), 1.0), model=sure)
    taken = pda_update(BELIEF, 41.0, one)
    variance = sure.variance(np.array([40.0]))
    plain = correct(BELIEF, Observation(np.array([1.0]), one.jacobian, variance, np.zeros(1, np.int8)))
    np.testing.assert_allclose(taken.belief.mean, plain.mean, atol=1e-12)
    np.testing.assert_allclose(taken.belief.cov, plain.cov, atol=1e-12)
    assert taken.nis == pytest.approx(1.0 / float((one.jacobian @ BELIEF.cov @ one.jacobian.T)[0, 0] + variance[0]))


def test_a_reading_of_nothing_in_the_map_changes_nothing() -> None:
    taken = pda_update(BELIEF, 200.0, TWO)
    np.testing.assert_allclose(taken.belief.mean, BELIEF.mean, atol=1e-12)
    np.testing.assert_allclose(taken.belief.cov, BELIEF.cov, atol=1e-12)
    assert taken.outlier_probability == pytest.approx(1.0)


def test_where_nothing_can_be_heard_every_reading_is_bad() -> None:
    empty = np.zeros(0)
    none = Hypotheses(empty, np.zeros((0, 3)), empty, empty, empty, unknown, 0.2, MODEL.bad_density)
    taken = pda_update(BELIEF, 50.0, none)
    assert taken.outlier_probability == 1.0
    assert taken.likelihood == MODEL.bad_density
    assert np.isnan(taken.nis)
    np.testing.assert_array_equal(taken.belief.mean, BELIEF.mean)


def test_constants_are_corrected_through_their_correlation() -> None:
    cov = np.diag([1.0, 1.0, 0.01, 0.0025])
    cov[0, 3] = cov[3, 0] = 0.04
    taken = pda_update(Belief(np.zeros(4), cov), 39.0, returns((40.0, (-1.0, 0.0, 0.0), 1.0)))
    assert taken.belief.mean[0] > 0.5
    assert taken.belief.mean[3] == pytest.approx(0.04 * taken.belief.mean[0])
    assert taken.belief.cov[3, 3] < cov[3, 3]


def after(readings: Floats) -> Belief:
    """BELIEF after readings of a wall at x = 40, heard from one place."""
    wall = returns((40.0, (-1.0, 0.0, 0.0), 1.0), model=replace(MODEL, outlier_probability=0.0))
    belief = BELIEF
    for number, reading in enumerate(readings, start=1):
        here = wall._replace(ranges_in=40.0 - belief.mean[:1])
        belief = pda_update(belief, float(reading), here, times=number).belief
    return belief


def test_what_is_claimed_of_readings_from_one_place_is_so() -> None:
    """The estimate is linear in the readings; its true variance follows from their whole covariance."""
    count, prior = 6, BELIEF.cov[0, 0]
    none = after(np.full(count, 40.0)).mean[0]
    shares = np.array([after(40.0 + one).mean[0] - none for one in np.eye(count)])
    noise = np.eye(count) * (float(MODEL.variance(np.array(40.0))) - CONSTANT) + CONSTANT
    true = (1.0 + shares.sum()) ** 2 * prior + shares @ noise @ shares
    assert after(np.full(count, 40.0)).cov[0, 0] == pytest.approx(true, rel=1e-9)


def test_what_a_reading_is_of_is_judged_as_at_first() -> None:
    first, fifth = (pda_update(BELIEF, 41.5, TWO, times=times) for times in (1, 5))
    assert fifth[1:] == first[1:]
    assert abs(fifth.belief.mean[0]) < abs(first.belief.mean[0])
