"""States longer than a pose: their derivative against finite differences, and constants found from positions alone."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Belief, difference, independent
from localization.filters.odometry import (
    OdometryNoise,
    OdometryParameter,
    move_states,
    predict,
    transition,
    true_step,
    with_parameters,
    with_pose,
)

QUIET = OdometryNoise(0.0, 0.0, 0.0)
STATE = np.array([3.0, -2.0, 0.7, 0.05, -0.03, 0.002])
STEPS = [np.array([1.5, 0.2]), np.array([-0.8, 0.6]), np.array([2.0, 0.0]), np.array([0.0, -0.4])]


@pytest.mark.parametrize("size", [3, 4, 5, 6])
@pytest.mark.parametrize("step", STEPS)
def test_the_covariance_follows_finite_differences(size: int, step: np.ndarray) -> None:
    state, tiny = STATE[:size], 1e-6
    columns = [
        difference(move_states(state + tiny * unit, step), move_states(state - tiny * unit, step)) / (2 * tiny)
        for unit in np.eye(size)
    ]
    by_state = np.stack(columns, axis=-1)
    root = np.random.default_rng(1).normal(size=(size, size))
    cov = root @ root.T
    np.testing.assert_allclose(predict(Belief(state, cov), step, QUIET).cov, by_state @ cov @ by_state.T, atol=1e-6)


@pytest.mark.parametrize("step", STEPS)
def test_a_bare_pose_is_predicted_as_by_the_filter_without_constants(step: np.ndarray) -> None:
    belief = independent([3.0, -2.0, 0.7], [0.1, 0.2, 0.03])
    mean, F, Q = transition(belief.mean, step, OdometryNoise())
    same = predict(belief, step, OdometryNoise())
    np.testing.assert_allclose(same.mean, mean, atol=1e-15)
    np.testing.assert_allclose(same.cov, F @ belief.cov @ F.T + Q, atol=1e-15)


def test_the_true_step_by_hand() -> None:
    np.testing.assert_allclose(true_step(STATE, np.array([2.0, 0.5])), [2.1, 0.5 * 0.97 + 0.004])
    np.testing.assert_array_equal(true_step(STATE[:3], np.array([2.0, 0.5])), [2.0, 0.5])


def test_many_states_at_once_are_each_their_own() -> None:
    states, steps = np.stack([STATE, -STATE]), np.stack([STEPS[0], STEPS[1]])
    both = predict(Belief(states, np.stack([np.eye(6), 2 * np.eye(6)])), steps, OdometryNoise())
    for row in range(2):
        alone = predict(Belief(states[row], (row + 1) * np.eye(6)), steps[row], OdometryNoise())
        np.testing.assert_allclose(both.mean[row], alone.mean, atol=1e-14)
        np.testing.assert_allclose(both.cov[row], alone.cov, atol=1e-13)


def test_a_scale_is_found_by_one_who_is_told_positions() -> None:
    truth = np.array([0.0, 0.0, 0.0, 0.08])
    belief = with_parameters(independent([0.0, 0.0, 0.0], [0.1, 0.1, 0.01]), (0.1,))
    step = np.array([1.0, 0.02])
    for _ in range(60):
        truth = move_states(truth, step)
        belief = predict(belief, step, OdometryNoise(0.01, 0.01, 0.0005))
        gain = belief.cov[:, :2] @ np.linalg.inv(belief.cov[:2, :2] + 0.01 * np.eye(2))
        belief = Belief(belief.mean + gain @ (truth - belief.mean)[:2], belief.cov - gain @ belief.cov[:2])
    assert belief.mean[OdometryParameter.DISTANCE_SCALE] == pytest.approx(0.08, abs=0.004)
    assert belief.std[OdometryParameter.DISTANCE_SCALE] < 0.02


def test_constants_begin_at_zero_and_as_uncertain_as_told() -> None:
    longer = with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.2, 0.03]), (0.05, 0.02))
    np.testing.assert_array_equal(longer.mean, [1.0, 2.0, 0.3, 0.0, 0.0])
    np.testing.assert_allclose(longer.std, [0.1, 0.2, 0.03, 0.05, 0.02])
    same = with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.2, 0.03]), ())
    assert same.mean.shape == (3,)


def test_a_state_moved_to_another_pose_keeps_its_constants_and_what_is_known_of_them() -> None:
    root = np.random.default_rng(3).standard_normal((5, 5))
    known, pose = Belief(STATE[:5], root @ root.T), independent([7.0, 8.0, -3.0], [0.1, 0.2, 0.03])
    moved = with_pose(pose, known)
    np.testing.assert_array_equal(moved.mean, [7.0, 8.0, -3.0, *STATE[3:5]])
    np.testing.assert_array_equal(moved.cov[:3, :3], pose.cov)
    np.testing.assert_array_equal(moved.cov[3:, 3:], known.cov[3:, 3:])
    assert not moved.cov[:3, 3:].any()
    assert not moved.cov[3:, :3].any()


def test_states_of_a_wrong_size_are_refused() -> None:
    with pytest.raises(ValueError, match="3 constants"):
        with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.2, 0.03]), (1.0,) * 4)
    with pytest.raises(ValueError, match="coordinates, not 7"):
        predict(Belief(np.zeros(7), np.eye(7)), STEPS[0], QUIET)
