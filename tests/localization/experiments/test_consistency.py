"""NEES, its band and the Cramer-Rao bound, each against another path to the same number."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gammaincinv

from localization.experiments.figure_trial import bound_step, information, mean_band
from localization.filters.belief import Floats, nees


def some_covariance(rng: np.random.Generator, size: int = 3) -> Floats:
    root = rng.normal(size=(size, size))
    return np.asarray(root @ root.T + 0.1 * np.eye(size))


def test_nees_is_the_squared_mahalanobis_distance() -> None:
    rng = np.random.default_rng(1)
    errors, covs = rng.normal(size=(5, 3)), np.stack([some_covariance(rng) for _ in range(5)])
    expected = [error @ np.linalg.inv(cov) @ error for error, cov in zip(errors, covs, strict=True)]
    assert nees(errors, covs) == pytest.approx(expected)


def test_the_band_of_a_hundred_runs() -> None:
    low, high = mean_band(3, 100)
    assert (round(low, 2), round(high, 2)) == (2.54, 3.50)
    assert [low, high] == pytest.approx(2.0 * gammaincinv(300 / 2, [0.025, 0.975]) / 100)


def test_mean_nees_is_in_band_with_given_probability() -> None:
    rng = np.random.default_rng(2)
    means = (rng.standard_normal((4000, 20, 3)) ** 2).sum(axis=-1).mean(axis=-1)
    low, high = mean_band(3, 20, probability=0.9)
    assert ((means > low) & (means < high)).mean() == pytest.approx(0.9, abs=0.02)


def test_the_bound_is_that_of_the_published_recursion() -> None:
    """Tichavsky's J' = D22 - D21 (J + D11)^-1 D12, where Q can be inverted."""
    rng = np.random.default_rng(3)
    by_state, process_cov, cov = rng.normal(size=(3, 3)), some_covariance(rng), some_covariance(rng)
    jacobian, variance = rng.normal(size=(16, 3)), rng.uniform(0.1, 2.0, 16)
    inverse = np.linalg.inv(process_cov)
    # The blocks D11, D12 and D22 of Tichavsky et al. for linear models with Gaussian noise.
    d11, d12 = by_state.T @ inverse @ by_state, -by_state.T @ inverse
    d22 = inverse + jacobian.T @ np.diag(1 / variance) @ jacobian
    expected = np.linalg.inv(d22 - d12.T @ np.linalg.inv(np.linalg.inv(cov) + d11) @ d12)
    # The recursion of the module needs no inverse of Q.
    assert bound_step(cov, by_state, process_cov, information(jacobian, variance)) == pytest.approx(expected)


def test_the_bound_needs_no_inverse_of_the_process_noise() -> None:
    """With no process noise at all it is the bound of all readings together on a standing state."""
    rng = np.random.default_rng(4)
    cov = some_covariance(rng)
    gained = [information(rng.normal(size=(4, 3)), np.ones(4)) for _ in range(5)]
    bound = cov
    for one in gained:
        bound = bound_step(bound, np.eye(3), np.zeros((3, 3)), one)
    assert bound == pytest.approx(np.linalg.inv(np.linalg.inv(cov) + sum(gained)))


def test_readings_can_only_lower_the_bound() -> None:
    rng = np.random.default_rng(5)
    cov, by_state = some_covariance(rng), np.eye(3)
    with_readings = bound_step(cov, by_state, 0.1 * np.eye(3), information(rng.normal(size=(2, 3)), np.ones(2)))
    without = bound_step(cov, by_state, 0.1 * np.eye(3), np.zeros((3, 3)))
    assert without == pytest.approx(cov + 0.1 * np.eye(3))
    assert np.linalg.eigvalsh(without - with_readings).min() > -1e-12
