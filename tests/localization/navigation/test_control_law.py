"""The control law: its limits, its signs, and convergence to the goal."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localization.filters.odometry import move
from localization.navigation.control_law import (
    ControlGains,
    bearing_error,
    distance_to,
    is_reached,
    next_step,
    slow_for_turn,
)

GAINS = ControlGains(drho_max_in=0.05, dtheta_max_rad=0.05, alpha_rho=0.1, alpha_theta=0.1)


def test_far_from_the_goal_the_step_is_as_long_as_allowed() -> None:
    assert next_step(np.zeros(3), np.array([60.0, 0.0]), GAINS).tolist() == [0.05, 0.0]


def test_step_near_goal_is_a_fraction_of_the_distance() -> None:
    assert next_step(np.zeros(3), np.array([0.3, 0.0]), GAINS) == pytest.approx([0.03, 0.0])


@pytest.mark.parametrize(("bearing", "turn"), [(0.2, 0.02), (-0.2, -0.02), (2.0, 0.05), (-2.0, -0.05)])
def test_turn_has_sign_of_bearing_error_and_is_limited(bearing: float, turn: float) -> None:
    goal = 60.0 * np.array([math.cos(bearing), math.sin(bearing)])
    assert next_step(np.zeros(3), goal, GAINS)[1] == pytest.approx(turn)


def test_the_bearing_error_goes_the_short_path_round() -> None:
    pose, goal = np.array([0.0, 0.0, 3.0]), 10.0 * np.array([math.cos(-3.0), math.sin(-3.0)])
    assert bearing_error(pose, goal) == pytest.approx(2 * math.pi - 6.0)


@given(
    st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, 9)), st.tuples(st.floats(-99, 99), st.floats(-99, 99))
)
def test_no_step_is_beyond_its_limits(pose: tuple[float, ...], goal: tuple[float, ...]) -> None:
    drho, dtheta = next_step(np.array(pose), np.array(goal), GAINS)
    assert 0 <= drho <= GAINS.drho_max_in
    assert abs(dtheta) <= GAINS.dtheta_max_rad


@pytest.mark.long
def test_without_noise_the_law_arrives_from_any_side() -> None:
    angles = np.linspace(-math.pi, math.pi, 9)
    goals = 20.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    poses = np.zeros((9, 3))
    for _ in range(700):
        poses = move(poses, next_step(poses, goals, GAINS))
    assert is_reached(poses, goals, 0.25).all()


@pytest.mark.long
@pytest.mark.parametrize("distance", [1.5, 5.0, 20.0])
def test_slowed_robot_stays_near_the_straight_leg(distance: float) -> None:
    """From any direction the robot arrives, and leaves the leg by no more than the circle that touches it."""
    gains = ControlGains(drho_max_in=0.5, dtheta_max_rad=0.05)
    angles = np.linspace(-math.pi, math.pi, 25)
    goals, poses = np.tile([distance, 0.0], (25, 1)), np.zeros((25, 3))
    poses[:, 2] = angles
    beside = np.zeros(25)
    for _ in range(400):
        steps = next_step(poses, goals, gains)
        x, y, heading = poses.T
        steps[:, 0] = slow_for_turn(steps[:, 0], x, y, heading, goals[:, 0], goals[:, 1], gains)
        poses = move(poses, steps)
        beside = np.maximum(beside, np.abs(poses[:, 1]))
    assert is_reached(poses, goals, 0.5).all()
    # A half circle through the goal, or one of the smallest radius, 10 in.
    assert beside.max() < min(distance / 2.0, 10.0) + 0.5


def test_a_step_is_shortened_aside_and_inside_the_turning_circle() -> None:
    gains, bearings = ControlGains(drho_max_in=0.5, dtheta_max_rad=0.05), np.array([0.0, 0.3, 1.0, 1.5])
    # The circles of 10 in to both sides touch the origin: a goal at this distance is on them.
    on_circle = 20.0 * np.sin(bearings)
    # Far away the component of the step towards the goal counts; half as far as the circle, half of its radius.
    for factor, expected in ((100.0, 0.5 * np.cos(bearings[1:])), (0.5, np.minimum(0.25, 0.5 * np.cos(bearings[1:])))):
        distance = factor * on_circle[1:]
        goal_x, goal_y, zeros = distance * np.cos(bearings[1:]), distance * np.sin(bearings[1:]), np.zeros(3)
        assert slow_for_turn(np.full(3, 0.5), zeros, zeros, zeros, goal_x, goal_y, gains) == pytest.approx(expected)
        # One robot is computed in floats.
        for goal, length in zip(zip(goal_x.tolist(), goal_y.tolist(), strict=True), expected, strict=True):
            assert slow_for_turn(0.5, 0.0, 0.0, 0.0, *goal, gains) == pytest.approx(length)
    assert slow_for_turn(0.5, 0.0, 0.0, 0.0, 5.0, 0.0, gains) == 0.5
    assert slow_for_turn(0.5, 0.0, 0.0, 0.0, -50.0, 1.0, gains) == 0.0


def test_reached_means_within_the_radius() -> None:
    goal = np.array([3.0, 4.0])
    assert distance_to(np.zeros(3), goal) == 5.0
    assert is_reached(np.zeros(3), goal, 5.0)
    assert not is_reached(np.zeros(3), goal, 4.99)
