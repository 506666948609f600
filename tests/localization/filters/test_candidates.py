"""Candidates: derivatives by longer states."""

from __future__ import annotations

import numpy as np

from localization.filters.update import widened


def test_the_derivative_by_what_is_not_the_pose_is_nothing() -> None:
    jacobian = np.arange(6.0).reshape(2, 3)
    wide = widened(jacobian, 5)
    np.testing.assert_array_equal(wide[:, :3], jacobian)
    np.testing.assert_array_equal(wide[:, 3:], np.zeros((2, 2)))
