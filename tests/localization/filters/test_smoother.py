"""The fixed-lag smoother against filterpy's Rauch-Tung-Striebel, and against the truth of drawn runs."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats, add, difference, independent
from localization.filters.ekf import KalmanFilter
from localization.filters.odometry import OdometryNoise, move, step_jacobians, step_variance, with_parameters
from localization.filters.smoother import FixedLagSmoother
from localization.filters.update import Association, Covariance, MeasurementUpdate, Refusal, State

NOISE = OdometryNoise(0.05, 0.05, 0.002)
ROWS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
VARIANCE = np.array([0.01, 0.01, 0.01, 1e-4])


class Straight:
    """A sense of readings linear in the pose: number `sonar` reads row `sonar`."""

    def associate(
        self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float
    ) -> Association:
        del P
        assert (turret_offset_rad, np.isfinite(reading_in)) == (0.0, True)
        # A measurement that is linear in the pose: its row of H depends on the sonar only.
        row = ROWS[sonar]

        def expect(poses: Floats) -> tuple[Floats, Floats]:
            return (poses * row).sum(axis=-1), np.broadcast_to(row, (*poses.shape[:-1], 3))

        range_in = float(row @ x[:3])
        return Association(Refusal.NONE, 1.0, [range_in], [row.tolist()], [VARIANCE[sonar]], [0.0], [1.0], expect)


def steps(count: int) -> Floats:
    return np.stack([np.full(count, 0.5), 0.05 * np.sin(np.arange(count))], axis=-1)


def smoother(belief: Belief, lag: int) -> FixedLagSmoother:
    return FixedLagSmoother(belief, MeasurementUpdate(Straight()), NOISE, lag)


@pytest.mark.parametrize("lag", [1, 5, 12])
@pytest.mark.parametrize("size", [3, 4])
def test_smoother_equals_filterpy_rts(lag: int, size: int) -> None:
    """filterpy smooths errors about the predicted path: x_k+1 - F x_k there is what `later - predicted` is here."""
    from filterpy.kalman import rts_smoother

    rng = np.random.default_rng(7)
    made = smoother(with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.1, 0.01]), (0.02,) * (size - 3)), lag)
    # All that filterpy needs: covariances, F and Q of each step.
    filtered, predicted, by_state, noise = [made.belief], [made.belief], [], []
    for number, step in enumerate(steps(12)):
        by_state.append(step_jacobians(made.belief.mean, step)[0])
        made.predict(*step.tolist())
        predicted.append(made.belief)
        # Q is what the prediction adds to F P F'.
        noise.append(made.belief.cov - by_state[-1] @ filtered[-1].cov @ by_state[-1].T)
        expected = ROWS[number % 4] @ made.belief.mean[:3]
        made.update(number % 4, 0.0, float(expected + 0.05 * rng.standard_normal()))
        filtered.append(made.belief)
    first = len(filtered) - 1 - lag
    # filterpy smooths a linear system; the state is the deviation from the predicted path.
    errors = [np.zeros(size)]
    for k in range(first, len(filtered) - 1):
        errors.append(by_state[k] @ errors[-1] + difference(filtered[k + 1].mean, predicted[k + 1].mean))
    covs = np.stack([belief.cov for belief in filtered[first:]])
    xs, ps, _, _ = rts_smoother(np.stack(errors), covs, by_state[first:], noise[first:])
    smoothed = made.smoothed()
    np.testing.assert_allclose(difference(smoothed.mean, filtered[first].mean), xs[0], atol=1e-10)
    np.testing.assert_allclose(smoothed.cov, ps[0], atol=1e-10)


def test_smoother_without_motion_returns_belief() -> None:
    belief = independent([1.0, 2.0, 0.3], [0.1, 0.1, 0.01])
    made = smoother(belief, 3)
    np.testing.assert_array_equal(made.smoothed().mean, belief.mean)
    made.update(0, 0.0, 1.1)
    np.testing.assert_array_equal(made.smoothed().mean, made.belief.mean)
    filter_ = KalmanFilter(belief, MeasurementUpdate(Straight()), NOISE)
    assert (made.lag, filter_.lag, filter_.smoothed()) == (3, 0, None)


def test_a_coordinate_that_is_certain_stays() -> None:
    made = smoother(with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.1, 0.01]), (0.0,)), 4)
    for number, step in enumerate(steps(6)):
        made.predict(*step.tolist())
        made.update(number % 4, 0.0, float(ROWS[number % 4] @ made.belief.mean[:3] + 0.05))
    smoothed = made.smoothed()
    assert smoothed.mean[3] == 0.0
    assert smoothed.cov[3, 3] == 0.0
    assert np.linalg.eigvalsh(smoothed.cov).min() > -1e-15


def test_a_lag_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        smoother(independent([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), 0)


@pytest.mark.long
def test_smoothing_is_more_accurate_and_consistent() -> None:
    rng = np.random.default_rng(11)
    start, lag = independent([0.0, 0.0, 0.0], [0.3, 0.3, 0.02]), 8
    squared, normalised = np.zeros(2), []
    # 150 runs with drawn truths: mean NEES of three elements has a standard deviation of 0.2.
    for _ in range(150):
        truths = [add(start.mean, start.std * rng.standard_normal(3))]
        made, beliefs = smoother(start, lag), [start]
        for number, step in enumerate(steps(20)):
            truths.append(move(truths[-1], step + np.sqrt(step_variance(step, NOISE)) * rng.standard_normal(2)))
            made.predict(*step.tolist())
            row = number % 4
            made.update(row, 0.0, float(ROWS[row] @ truths[-1] + np.sqrt(VARIANCE[row]) * rng.standard_normal()))
            beliefs.append(made.belief)
        smoothed = made.smoothed()
        # Error of the smoothed pose, eight steps in the past.
        error = difference(smoothed.mean, truths[-1 - lag])
        squared += [float(error[:2] @ error[:2]), float(np.sum((beliefs[-1 - lag].mean - truths[-1 - lag])[:2] ** 2))]
        normalised.append(float(error @ np.linalg.solve(smoothed.cov, error)))
        assert (smoothed.std < beliefs[-1 - lag].std).all()
    # Squared position errors shrink by a fifth at least, with NEES of three degrees of freedom at 3.
    assert squared[0] < 0.8 * squared[1]
    assert 2.4 < np.mean(normalised) < 3.6
