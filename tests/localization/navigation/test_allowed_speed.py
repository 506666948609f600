"""Allowed speed of an uncertain robot: by hand against one wall, and by drawing places at random."""

from __future__ import annotations

import numpy as np
import pytest

from localization.navigation.control_law import FULL_SPEED_RATIO, allowed_speed_fraction

WALL = np.array([[10.0, -100.0, 10.0, 100.0]])


def share(x: float, ahead: float, std: float, heading_std: float = 0.0) -> float:
    cov = np.diag([std**2, std**2, heading_std**2])
    return allowed_speed_fraction(np.array([x, 0.0, 0.0]), np.array([ahead, 0.0]), cov, WALL, 5.0)


def test_speed_fraction_is_proportional_to_free_distance() -> None:
    assert share(0.0, 1.0, 0.1) == 1.0
    assert share(0.0, 2.0, 1.0) == 0.0
    halfway = 3.0 / (3.0 * 0.5 * (1.0 + FULL_SPEED_RATIO))
    assert share(0.0, 2.0, halfway) == pytest.approx(0.5)


def test_a_wall_that_is_left_behind_does_not_hold() -> None:
    assert share(5.5, 3.0, 1.0) == 1.0
    assert share(5.5, 6.0, 1.0) == 0.0


def test_no_walls_no_caution() -> None:
    assert allowed_speed_fraction(np.zeros(3), np.ones(2), np.eye(3), np.zeros((0, 4)), 5.0) == 1.0


def test_an_uncertain_heading_counts_across_the_path_ahead() -> None:
    along = np.array([[-100.0, 6.0, 100.0, 6.0]])
    cov = np.diag([1e-6, 1e-6, 0.1**2])
    near = allowed_speed_fraction(np.zeros(3), np.array([1.0, 0.0]), cov, along, 5.0)
    far = allowed_speed_fraction(np.zeros(3), np.array([4.0, 0.0]), cov, along, 5.0)
    assert near == 1.0
    assert far == 0.0


def test_the_spread_is_that_of_places_drawn_at_random() -> None:
    """Three sigma of the distance to the wall after the path ahead, by a hundred thousand draws."""
    rng = np.random.default_rng(4)
    # A covariance with correlations, by its root.
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.01, 0.02, 0.03]])
    cov = root @ root.T
    poses = rng.standard_normal((100_000, 3)) @ root.T
    displacement = np.array([4.0, 3.0])
    # The end of the path in x, for each drawn pose.
    ends = poses[:, 0] + displacement[0] * np.cos(poses[:, 2]) - displacement[1] * np.sin(poses[:, 2])
    sigma = float(ends.std())
    # A wall at the distance at which half of the speed is allowed.
    room = 3.0 * sigma * 0.5 * (1.0 + FULL_SPEED_RATIO)
    wall = np.array([[4.0 + 5.0 + room, -100.0, 4.0 + 5.0 + room, 100.0]])
    assert allowed_speed_fraction(np.zeros(3), displacement, cov, wall, 5.0) == pytest.approx(0.5, abs=0.03)
