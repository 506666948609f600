"""The motion model and the prediction: closed forms, central differences, drawn samples, longer states."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localization.filters.belief import Belief, Floats, difference, independent
from localization.filters.odometry import (
    OdometryNoise,
    OdometryParameter,
    move,
    predict,
    process_covariance,
    step_between,
    step_jacobians,
    step_variance,
    true_step,
    with_parameters,
    with_pose,
)

NOISE = OdometryNoise(translation_std=0.1, rotation_std=0.2, drift_std=0.03)

poses = st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-3.1, 3.1)).map(np.array)
steps = st.tuples(st.floats(-5, 5), st.floats(-1, 1)).map(np.array)


def test_a_straight_step_goes_along_the_heading() -> None:
    assert move(np.array([1.0, 2.0, math.pi / 2]), np.array([3.0, 0.0])) == pytest.approx([1.0, 5.0, math.pi / 2])


def test_a_step_backwards_undoes_a_step() -> None:
    start = np.array([1.0, 2.0, 0.3])
    assert move(move(start, np.array([3.0, 0.0])), np.array([-3.0, 0.0])) == pytest.approx(start)


def test_many_small_steps_draw_the_arc_of_the_closed_form() -> None:
    radius, turn, count = 10.0, 2.0, 1000
    pose = np.zeros(3)
    for _ in range(count):
        pose = move(pose, np.array([radius * turn / count, turn / count]))
    assert pose == pytest.approx([radius * math.sin(turn), radius * (1 - math.cos(turn)), turn], abs=1e-5)


def test_heading_wraps_while_driving() -> None:
    assert move(np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.5]))[2] == pytest.approx(3.5 - 2 * math.pi)


def covariance_of(pose: Floats, step: Floats, noise: OdometryNoise = NOISE) -> Floats:
    """Return G Q G' of a step."""
    return process_covariance(step_jacobians(pose, step)[1], step, noise)


def moved_from(pose: Floats, step: Floats, row: int, shift: float) -> Floats:
    return move(pose + shift * np.eye(3)[row], step)


@given(poses, steps)
def test_f_is_that_of_central_differences(pose: Floats, step: Floats) -> None:
    width = 1e-6
    columns = [
        difference(moved_from(pose, step, row, width), moved_from(pose, step, row, -width)) / (2 * width)
        for row in range(3)
    ]
    assert step_jacobians(pose, step)[0] == pytest.approx(np.stack(columns, axis=-1), abs=1e-6)


@given(poses, steps)
def test_gqg_is_that_of_central_differences_by_the_step(pose: Floats, step: Floats) -> None:
    width = 1e-6
    columns = [
        difference(move(pose, step + width * unit), move(pose, step - width * unit)) / (2 * width) for unit in np.eye(2)
    ]
    by_step = np.stack(columns, axis=-1)
    expected = by_step @ np.diag(step_variance(step, NOISE)) @ by_step.T
    assert covariance_of(pose, step) == pytest.approx(expected, abs=1e-6)


def test_the_covariance_added_is_that_of_drawn_samples() -> None:
    pose, step = np.array([5.0, 3.0, 0.7]), np.array([2.0, 0.1])
    rng = np.random.default_rng(1)
    noise = OdometryNoise(0.01, 0.02, 0.003)
    drawn = step + np.sqrt(step_variance(step, noise)) * rng.standard_normal((200_000, 2))
    samples = np.cov(move(np.tile(pose, (len(drawn), 1)), drawn).T)
    assert samples == pytest.approx(covariance_of(pose, step, noise), rel=0.02, abs=1e-7)


def test_the_covariance_added_has_rank_two() -> None:
    covariance = covariance_of(np.array([0.0, 0.0, 0.4]), np.array([1.0, 0.2]))
    assert np.linalg.matrix_rank(covariance) == 2


def test_variances_grow_with_the_distance_in_both_directions() -> None:
    assert step_variance(np.array([-3.0, -0.5]), NOISE) == pytest.approx([0.01 * 3, 0.04 * 0.5 + 0.0009 * 3])
    assert step_variance(np.array([0.0, 0.0]), NOISE).tolist() == [0.0, 0.0]


def test_two_half_steps_add_the_variance_of_one() -> None:
    whole, half = np.array([3.0, 0.5]), np.array([1.5, 0.25])
    assert 2 * step_variance(half, NOISE) == pytest.approx(step_variance(whole, NOISE))


@given(poses, steps)
def test_step_between_is_the_inverse_of_move(pose: Floats, step: Floats) -> None:
    assert step_between(pose, move(pose, step)) == pytest.approx(step, abs=1e-9)


def test_batch_equals_single_results() -> None:
    rng = np.random.default_rng(2)
    many, steps_of = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 2))
    together = (move(many, steps_of), *step_jacobians(many, steps_of), covariance_of(many, steps_of))
    between = step_between(many, move(many, steps_of))
    # Each element of the 4 x 5 batch equals the function of one pose and one step.
    for index in np.ndindex(4, 5):
        pose, step = many[index], steps_of[index]
        alone = (move(pose, step), *step_jacobians(pose, step), covariance_of(pose, step))
        for whole, single in zip(together, alone, strict=True):
            assert whole[index] == pytest.approx(single, abs=1e-14)
        assert between[index] == pytest.approx(step)


@given(poses, steps)
def test_the_prediction_is_f_p_f_plus_g_q_g(pose: Floats, step: Floats) -> None:
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [-0.02, 0.03, 0.05]])
    F, _ = step_jacobians(pose, step)
    predicted = predict(Belief(pose, root @ root.T), step, NOISE)
    np.testing.assert_allclose(difference(predicted.mean, move(pose, step)), 0.0, atol=1e-13)
    np.testing.assert_allclose(predicted.cov, F @ root @ root.T @ F.T + covariance_of(pose, step), atol=1e-12)
    assert (predicted.cov == predicted.cov.T).all()


QUIET = OdometryNoise(0.0, 0.0, 0.0)
STATE = np.array([3.0, -2.0, 0.7, 0.05, -0.03, 0.002])
STEPS = [np.array([1.5, 0.2]), np.array([-0.8, 0.6]), np.array([2.0, 0.0]), np.array([0.0, -0.4])]


@pytest.mark.parametrize("size", [3, 4, 5, 6])
@pytest.mark.parametrize("step", STEPS)
def test_the_covariance_follows_finite_differences(size: int, step: np.ndarray) -> None:
    # Central differences of the motion model, column by column.
    state, tiny = STATE[:size], 1e-6
    columns = [
        difference(move(state + tiny * unit, step), move(state - tiny * unit, step)) / (2 * tiny)
        for unit in np.eye(size)
    ]
    F = np.stack(columns, axis=-1)
    root = np.random.default_rng(1).normal(size=(size, size))
    # A random covariance: the root makes it positive definite.
    cov = root @ root.T
    np.testing.assert_allclose(predict(Belief(state, cov), step, QUIET).cov, F @ cov @ F.T, atol=1e-6)


def test_the_true_step_by_hand() -> None:
    np.testing.assert_allclose(true_step(STATE.tolist(), 2.0, 0.5), [2.1, 0.5 * 0.97 + 0.004])
    np.testing.assert_array_equal(true_step(STATE[:3].tolist(), 2.0, 0.5), [2.0, 0.5])


def test_a_batch_is_predicted_as_each_alone() -> None:
    states, steps = np.stack([STATE, -STATE]), np.stack([STEPS[0], STEPS[1]])
    both = predict(Belief(states, np.stack([np.eye(6), 2 * np.eye(6)])), steps, OdometryNoise())
    for row in range(2):
        alone = predict(Belief(states[row], (row + 1) * np.eye(6)), steps[row], OdometryNoise())
        np.testing.assert_allclose(both.mean[row], alone.mean, atol=1e-14)
        np.testing.assert_allclose(both.cov[row], alone.cov, atol=1e-13)


def test_positions_alone_reveal_a_distance_scale() -> None:
    # The last element is the distance scale: the wheels are 8 % larger than assumed.
    truth = np.array([0.0, 0.0, 0.0, 0.08])
    belief = with_parameters(independent([0.0, 0.0, 0.0], [0.1, 0.1, 0.01]), (0.1,))
    step = np.array([1.0, 0.02])
    for _ in range(60):
        truth = move(truth, step)
        belief = predict(belief, step, OdometryNoise(0.01, 0.01, 0.0005))
        # A textbook update with a position (x, y) of variance 0.01, without using the filter's own.
        gain = belief.cov[:, :2] @ np.linalg.inv(belief.cov[:2, :2] + 0.01 * np.eye(2))
        belief = Belief(belief.mean + gain @ (truth - belief.mean)[:2], belief.cov - gain @ belief.cov[:2])
    assert belief.mean[OdometryParameter.DISTANCE_SCALE] == pytest.approx(0.08, abs=0.004)
    assert belief.std[OdometryParameter.DISTANCE_SCALE] < 0.02


def test_parameters_begin_at_zero_with_their_std() -> None:
    longer = with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.2, 0.03]), (0.05, 0.02))
    np.testing.assert_array_equal(longer.mean, [1.0, 2.0, 0.3, 0.0, 0.0])
    np.testing.assert_allclose(longer.std, [0.1, 0.2, 0.03, 0.05, 0.02])
    same = with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.2, 0.03]), ())
    assert same.mean.shape == (3,)


def test_another_pose_keeps_the_parameters() -> None:
    root = np.random.default_rng(3).standard_normal((5, 5))
    parameters, pose = Belief(STATE[:5], root @ root.T), independent([7.0, 8.0, -3.0], [0.1, 0.2, 0.03])
    moved = with_pose(pose, parameters)
    np.testing.assert_array_equal(moved.mean, [7.0, 8.0, -3.0, *STATE[3:5]])
    np.testing.assert_array_equal(moved.cov[:3, :3], pose.cov)
    np.testing.assert_array_equal(moved.cov[3:, 3:], parameters.cov[3:, 3:])
    assert not moved.cov[:3, 3:].any()
    assert not moved.cov[3:, :3].any()


def test_wrong_state_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match="3 odometry"):
        with_parameters(independent([1.0, 2.0, 0.3], [0.1, 0.2, 0.03]), (1.0,) * 4)
    with pytest.raises(ValueError, match="coordinates, not 7"):
        predict(Belief(np.zeros(7), np.eye(7)), STEPS[0], QUIET)
