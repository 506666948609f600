"""Contacts and stalls: bumpers that close, pressing, standing wheels, and motion that is no stall."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from localization.navigation.control_law import STALL_S, ContactDetector, StallDetector

GOAL = np.array([20.0, 0.0])


def state(x_in: float, *bumpers: int, heading: float = 0.0) -> Any:
    return SimpleNamespace(x_in=x_in, y_in=0.0, steering_rad=heading, touching=bool(bumpers), bumpers=bumpers)


def reasons_of(
    obstruction: StallDetector, seconds: float, at: Any, speed_in_s: float = 0.0, goal: Any = GOAL
) -> list[str]:
    """Return the reason at each period; the estimate moves with `speed_in_s`, the state is `at(second)`."""
    return [
        obstruction.reason(second, at(second), np.array([speed_in_s * second, 0.0, 0.0]), goal)
        for second in np.arange(0.0, seconds, 0.5).tolist()
    ]


def test_pressing_is_reported_although_wheels_slip() -> None:
    reasons = reasons_of(StallDetector(5.0), 6.0, lambda second: state(5.0 * second, 0, 1))
    assert reasons[:10] == [""] * 10
    assert reasons[10] == "the robot presses against something for 5 s, 20.0 in before (20, 0): bumpers 0, 1 touch"


def test_standing_wheels_are_reported_without_contact() -> None:
    reasons = reasons_of(StallDetector(5.0), 6.0, lambda _: state(3.0))
    assert reasons[9:11] == [
        "", "the robot does not move for 5 s, 20.0 in before (20, 0), although commanded to: is it held "
        "(see nserver ctl status), or its emergency button pressed?",
    ]  # fmt: skip


@pytest.mark.parametrize("at", [
    lambda second: state(0.1 * second), lambda second: state(0.0, heading=-0.05 * second),
    lambda second: state(0.0, heading=3.1 + 0.05 * second),
])  # fmt: skip
def test_slow_rolling_or_turning_is_progress(at: Any) -> None:
    assert not any(reasons_of(StallDetector(5.0), 30.0, at))


def test_sliding_along_wall_is_progress_while_approaching() -> None:
    assert not any(reasons_of(StallDetector(5.0), 30.0, lambda _: state(0.0, 3), speed_in_s=0.2))
    assert any(reasons_of(StallDetector(5.0), 30.0, lambda _: state(0.0, 3), speed_in_s=0.05))


def test_new_path_point_or_none_restarts_detection() -> None:
    obstruction = StallDetector(5.0)
    assert not any(reasons_of(obstruction, 5.0, lambda _: state(0.0)))
    assert not any(reasons_of(obstruction, 20.0, lambda _: state(0.0), goal=None))
    assert obstruction.reason(4.9, state(0.0), np.zeros(3), GOAL) == ""
    assert obstruction.reason(9.8, state(0.0), np.zeros(3), np.array([0.0, 9.0])) == ""
    assert obstruction.reason(14.0, state(0.0), np.zeros(3), np.array([0.0, 9.0])) == ""
    assert obstruction.reason(14.8, state(0.0), np.zeros(3), np.array([0.0, 9.0]))


@pytest.mark.parametrize(("speed_in_s", "limit_s"), [(5.0, STALL_S), (0.01, 40.0)])
def test_time_limit_grows_at_low_speed(speed_in_s: float, limit_s: float) -> None:
    assert StallDetector(speed_in_s).limit_s == pytest.approx(limit_s)


def test_only_bumpers_that_close_while_driving_are_contacts() -> None:
    detector, pose = ContactDetector(), np.array([1.0, 2.0, 0.0])
    # Closed from the beginning: a robot may leave a wall.
    assert not detector.reason(state(0.0, 3), pose)
    assert not detector.reason(state(0.0, 3), pose)
    assert detector.reason(state(0.0, 3, 4), pose).startswith("contact of bumpers 4 at the estimate (1.0, 2.0)")
    assert not detector.reason(state(0.0), pose)
    assert detector.reason(state(0.0, 3, 5), pose).startswith("contact of bumpers 3, 5 ")


def test_a_recovery_leaves_contacts_by_itself() -> None:
    detector, pose = ContactDetector(), np.zeros(3)
    assert not detector.reason(state(0.0), pose)
    assert not detector.reason(state(0.0, 3), pose, backs_off=True)
    assert not detector.reason(state(0.0, 3), pose), "closed before the estimate was found"
