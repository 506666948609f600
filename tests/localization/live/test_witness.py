"""What is reported of the truth beside an estimate."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from localization.live.run import GroundTruth


class Robot:
    """Knows its own truth: 2 in a second along x."""

    def __init__(self) -> None:
        self.asked = 0

    def truth(self) -> Any:
        self.asked += 1
        return SimpleNamespace(robot_id=3, time_s=float(self.asked), x_in=2.0 * self.asked, y_in=5.0, steering_rad=0.0)


def test_the_truth_is_that_of_the_instant_and_asked_once_a_call() -> None:
    robot: Any = Robot()
    witness = GroundTruth(robot, True)
    assert witness.robot_id == 3
    assert witness.at(1.5) == pytest.approx((3.0, 5.0, 0.0))
    assert witness.at(3.0) == pytest.approx((6.0, 5.0, 0.0))
    assert robot.asked == 3


def test_of_a_real_robot_nothing_is_known_and_nothing_asked() -> None:
    robot: Any = Robot()
    witness = GroundTruth(robot, False)
    assert (witness.robot_id, witness.at(1.0), robot.asked) == (1, None, 0)
