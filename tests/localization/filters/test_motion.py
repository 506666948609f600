"""The motion model against closed forms, central differences and drawn samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localization.filters.belief import Floats, difference
from localization.filters.odometry import OdometryNoise, carried, move, step_between, step_variance, transition

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


def test_the_heading_wraps_on_the_way() -> None:
    assert move(np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.5]))[2] == pytest.approx(3.5 - 2 * math.pi)


def moved_from(pose: Floats, step: Floats, row: int, shift: float) -> Floats:
    return move(pose + shift * np.eye(3)[row], step)


@given(poses, steps)
def test_the_derivative_by_the_pose_is_that_of_central_differences(pose: Floats, step: Floats) -> None:
    width = 1e-6
    columns = [
        difference(moved_from(pose, step, row, width), moved_from(pose, step, row, -width)) / (2 * width)
        for row in range(3)
    ]
    assert transition(pose, step, NOISE).by_pose == pytest.approx(np.stack(columns, axis=-1), abs=1e-6)


@given(poses, steps)
def test_the_covariance_added_is_that_of_central_differences_by_the_step(pose: Floats, step: Floats) -> None:
    width = 1e-6
    columns = [
        difference(move(pose, step + width * unit), move(pose, step - width * unit)) / (2 * width) for unit in np.eye(2)
    ]
    by_step = np.stack(columns, axis=-1)
    expected = by_step @ np.diag(step_variance(step, NOISE)) @ by_step.T
    assert transition(pose, step, NOISE).process_cov == pytest.approx(expected, abs=1e-6)


def test_the_covariance_added_is_that_of_drawn_samples() -> None:
    pose, step = np.array([5.0, 3.0, 0.7]), np.array([2.0, 0.1])
    rng = np.random.default_rng(1)
    noise = OdometryNoise(0.01, 0.02, 0.003)
    drawn = step + np.sqrt(step_variance(step, noise)) * rng.standard_normal((200_000, 2))
    samples = np.cov(move(np.tile(pose, (len(drawn), 1)), drawn).T)
    assert samples == pytest.approx(transition(pose, step, noise).process_cov, rel=0.02, abs=1e-7)


def test_the_covariance_added_has_rank_two() -> None:
    covariance = transition(np.array([0.0, 0.0, 0.4]), np.array([1.0, 0.2]), NOISE).process_cov
    assert np.linalg.matrix_rank(covariance) == 2


def test_variances_grow_with_the_distance_whichever_way_it_goes() -> None:
    assert step_variance(np.array([-3.0, -0.5]), NOISE) == pytest.approx([0.01 * 3, 0.04 * 0.5 + 0.0009 * 3])
    assert step_variance(np.array([0.0, 0.0]), NOISE).tolist() == [0.0, 0.0]


def test_two_half_steps_add_the_variance_of_one() -> None:
    whole, half = np.array([3.0, 0.5]), np.array([1.5, 0.25])
    assert 2 * step_variance(half, NOISE) == pytest.approx(step_variance(whole, NOISE))


@given(poses, steps)
def test_the_step_between_two_poses_leads_from_one_to_the_other(pose: Floats, step: Floats) -> None:
    assert step_between(pose, move(pose, step)) == pytest.approx(step, abs=1e-9)


def test_a_batch_gives_what_each_gives_alone() -> None:
    rng = np.random.default_rng(2)
    many, ways = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 2))
    together = transition(many, ways, NOISE)
    between = step_between(many, move(many, ways))
    for index in np.ndindex(4, 5):
        alone = transition(many[index], ways[index], NOISE)
        for whole, single in zip(together, alone, strict=True):
            assert whole[index] == pytest.approx(single, abs=1e-14)
        assert between[index] == pytest.approx(ways[index])


@given(poses, steps)
def test_one_pose_in_numbers_is_the_same_as_in_arrays(pose: Floats, step: Floats) -> None:
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [-0.02, 0.03, 0.05]])
    many = transition(pose[None], step[None], NOISE)
    mean, cov = carried(pose, root @ root.T, step, NOISE)
    by_pose = many.by_pose[0]
    expected = by_pose @ root @ root.T @ by_pose.T + many.process_cov[0]
    np.testing.assert_allclose(difference(mean, many.pose[0]), 0.0, atol=1e-13)
    np.testing.assert_allclose(cov, expected, atol=1e-12)
    assert (cov == cov.T).all()
    np.testing.assert_allclose(difference(move(pose, step), many.pose[0]), 0.0, atol=1e-13)
    after = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(step_between(pose, after), step_between(pose[None], after[None])[0], atol=1e-12)
