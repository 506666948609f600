"""The unscented filter: sigma points against filterpy's, the closed form of a linear step, and drawn robots."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters import odometry
from localization.filters.belief import Belief, Floats, difference, independent
from localization.filters.odometry import OdometryNoise, move, step_variance, with_parameters
from localization.filters.ukf import Spread, offsets, predict, root_of, weights

NOISE = OdometryNoise(0.1, 0.1, 0.005)


def some_belief(size: int) -> Belief:
    rng = np.random.default_rng(size)
    root = 0.1 * rng.normal(size=(size, size))
    return Belief(0.1 * rng.normal(size=size), root @ root.T + 1e-4 * np.eye(size))


@pytest.mark.parametrize("size", [1, 3, 6])
@pytest.mark.parametrize("spread", [Spread(), Spread(0.1, 2.0, 1.0), Spread(1.0, 0.0, 0.5)])
def test_points_and_weights_are_filterpys(size: int, spread: Spread) -> None:
    from filterpy.kalman import MerweScaledSigmaPoints

    peer = MerweScaledSigmaPoints(size, spread.alpha, spread.beta, spread.kappa)
    belief, weight = some_belief(size), weights(size, spread)
    np.testing.assert_allclose(weight.mean, peer.Wm, rtol=1e-12)
    np.testing.assert_allclose(weight.cov, peer.Wc, rtol=1e-12)
    away = offsets(root_of(belief.cov), weight.reach)
    np.testing.assert_allclose(belief.mean + away, peer.sigma_points(belief.mean, belief.cov), atol=1e-12)


def test_no_weight_is_negative() -> None:
    for size in range(3, 9):
        assert weights(size).mean.min() >= 0.0
        assert weights(size).cov.min() >= 0.0


def test_points_that_would_lie_nowhere_are_refused() -> None:
    with pytest.raises(ValueError, match="positive, not 0"):
        weights(3, Spread(kappa=-3.0))


def test_a_certain_coordinate_has_a_root_too() -> None:
    cov = np.diag([1.0, 0.0, 4.0])
    root = root_of(cov)
    np.testing.assert_allclose(root @ root.T, cov, atol=1e-12)


@pytest.mark.parametrize("size", [3, 4, 6])
def test_a_prediction_is_that_of_filterpys_augmented_filter(size: int) -> None:
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    belief, step = some_belief(size), np.array([3.0, 0.4])
    # Process noise as two more states: the augmented form of the filter.
    whole = np.zeros((size + 2, size + 2))
    whole[:size, :size] = belief.cov
    whole[size:, size:] = np.diag(step_variance(step, NOISE))

    def moved(state: Floats, _: float) -> Floats:
        after = state.copy()
        after[:size] = move(state[:size], step + state[size:])
        return after

    # Sigma points of the augmented state with the parameters of the module.
    points = MerweScaledSigmaPoints(size + 2, 1.0, 2.0, 0.0)
    peer = UnscentedKalmanFilter(size + 2, 1, 1.0, None, moved, points)
    peer.x, peer.P, peer.Q = np.append(belief.mean, [0.0, 0.0]), whole, np.zeros_like(whole)
    peer.predict()
    predicted = predict(belief, step, NOISE)
    np.testing.assert_allclose(predicted.mean, peer.x[:size], atol=1e-12)
    np.testing.assert_allclose(predicted.cov, peer.P[:size, :size], atol=1e-12)


def test_nearly_linear_motion_is_predicted_as_by_the_ekf() -> None:
    belief, step = independent([1.0, 2.0, 3.1], [0.1, 0.2, 1e-4]), np.array([2.0, 0.1])
    quiet = OdometryNoise(0.01, 1e-4, 1e-5)
    sigma, extended = predict(belief, step, quiet), odometry.predict(belief, step, quiet)
    np.testing.assert_allclose(difference(sigma.mean, extended.mean), np.zeros(3), atol=1e-6)
    np.testing.assert_allclose(sigma.cov, extended.cov, atol=1e-9)
    assert abs(sigma.mean[2]) <= np.pi


def test_standing_still_changes_nothing() -> None:
    belief = with_parameters(some_belief(3), (0.0,))
    still = predict(belief, np.zeros(2), NOISE)
    np.testing.assert_allclose(still.mean, belief.mean, atol=1e-15)
    np.testing.assert_allclose(still.cov, belief.cov, atol=1e-15)


def test_a_wide_heading_bends_the_mean_as_drawn_robots_show() -> None:
    """100 in ahead, heading std 0.3 rad: the mean falls short by 4.4 %, which no derivative at the mean shows."""
    rng = np.random.default_rng(5)
    belief, step = independent([0.0, 0.0, 0.0], [1.0, 1.0, 0.3]), np.array([100.0, 0.0])
    # 200,000 drawn robots as the oracle: cos of a heading with std 0.3 has the mean 0.956.
    drawn = belief.mean + belief.std * rng.standard_normal((200_000, 3))
    robots = move(drawn, step + np.sqrt(step_variance(step, NOISE)) * rng.standard_normal((200_000, 2)))
    sigma, extended = predict(belief, step, NOISE), odometry.predict(belief, step, NOISE)
    assert sigma.mean[0] == pytest.approx(robots[:, 0].mean(), abs=0.3)
    assert extended.mean[0] == pytest.approx(100.0)
    # The spread across grows; the spread ahead is what a linearization cannot have.
    assert np.sqrt(sigma.cov[1, 1]) == pytest.approx(robots[:, 1].std(), rel=0.05)
    assert np.sqrt(sigma.cov[0, 0]) > 3.0 * np.sqrt(extended.cov[0, 0])
