"""Ground truth of a simulated robot, compared with the estimate."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from localization.live.run import GroundTruth


class Robot:
    """Robot that moves 2 in per second along x and counts its truth requests."""

    def __init__(self) -> None:
        self.requests = 0

    def truth(self) -> Any:
        self.requests += 1
        time_s = float(self.requests)
        return SimpleNamespace(robot_id=3, time_s=time_s, x_in=2.0 * time_s, y_in=5.0, steering_rad=0.0)


def test_truth_is_requested_once_per_call() -> None:
    robot: Any = Robot()
    ground_truth = GroundTruth(robot, True)
    assert (ground_truth.robot_id, ground_truth.first) == (3, (2.0, 5.0, 0.0))
    assert ground_truth.at(1.5) == pytest.approx((3.0, 5.0, 0.0))
    assert ground_truth.at(3.0) == pytest.approx((6.0, 5.0, 0.0))
    assert robot.requests == 3


def test_real_robot_has_no_truth_request() -> None:
    robot: Any = Robot()
    ground_truth = GroundTruth(robot, False)
    assert (ground_truth.robot_id, ground_truth.first, ground_truth.at(1.0), robot.requests) == (1, None, None, 0)
