"""The pose smoother: its step response, and odometry that passes unfiltered."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.navigation.control_law import PoseSmoother

HERE = np.array([0.0, 0.0, 0.0])


def test_zero_time_constant_returns_the_estimate() -> None:
    smoother = PoseSmoother(0.0)
    for clock, x in ((0.0, 1.0), (0.1, 5.0), (0.2, -3.0)):
        pose = smoother.update(clock, np.array([x, 0.0, 0.5]), HERE)
        np.testing.assert_array_equal(pose, [x, 0.0, 0.5])


def test_step_response_is_exponential_for_any_update_rate() -> None:
    for step in (0.05, 0.1, 0.25):
        smoother = PoseSmoother(0.5)
        smoother.update(0.0, HERE, HERE)
        jumped = np.array([2.0, 0.0, 0.0])
        for index in range(1, round(1.0 / step) + 1):
            pose = smoother.update(index * step, jumped, HERE)
        assert pose[0] == pytest.approx(2.0 * (1.0 - math.exp(-1.0 / 0.5)))


def test_the_odometrys_path_is_gone_at_once() -> None:
    smoother = PoseSmoother(1.0)
    smoother.update(0.0, np.array([10.0, 0.0, math.pi / 2]), HERE)
    pose = smoother.update(0.1, np.array([10.0, 0.5, math.pi / 2]), np.array([0.5, 0.0, 0.0]))
    np.testing.assert_allclose(pose, [10.0, 0.5, math.pi / 2], atol=1e-12)


def test_the_heading_is_followed_the_short_path_round() -> None:
    smoother = PoseSmoother(1.0)
    smoother.update(0.0, np.array([0.0, 0.0, math.pi - 0.1]), HERE)
    pose = smoother.update(1.0, np.array([0.0, 0.0, -math.pi + 0.1]), HERE)
    assert abs(pose[2]) > math.pi - 0.11


def test_a_negative_time_is_refused() -> None:
    with pytest.raises(ValueError, match="0 s or more"):
        PoseSmoother(-1.0)


def test_after_reset_next_estimate_is_taken_unfiltered() -> None:
    smoother = PoseSmoother(5.0)
    here, there = np.array([0.0, 0.0, 0.0]), np.array([40.0, 30.0, 2.0])
    smoother.update(0.0, here, here)
    assert not np.allclose(smoother.update(0.1, there, here), there)
    smoother.reset()
    assert np.allclose(smoother.update(0.2, there, here), there)
