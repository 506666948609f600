"""Encoder poses between two polls."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.odometry import pose_at
from localization.live.sensor_input import HISTORY_S, EncoderPose, PoseHistory


def pose(clock_s: float, x: float, heading: float = 0.0, turret: float = 0.0) -> EncoderPose:
    return EncoderPose.of(clock_s, np.array([x, 2 * x, heading]), turret)


def encoders_at(history: PoseHistory, instant_s: float) -> EncoderPose:
    return EncoderPose(instant_s, *pose_at(history.since(instant_s), instant_s))


def test_between_two_polls_the_robot_went_evenly() -> None:
    history = PoseHistory()
    for at in (pose(1.0, 0.0), pose(1.5, 5.0, 0.2, 0.4), pose(2.0, 6.0, 0.2, 0.4)):
        history.add(at)
    # A fifth of the first interval; half of the second one.
    assert encoders_at(history, 1.1).pose == pytest.approx([1.0, 2.0, 0.04])
    assert encoders_at(history, 1.1).turret_rad == pytest.approx(0.08)
    assert encoders_at(history, 1.75).pose == pytest.approx([5.5, 11.0, 0.2])
    assert encoders_at(history, 1.5).pose == pytest.approx(history.latest.pose - [1.0, 2.0, 0.0])


def test_angles_go_the_short_path_round() -> None:
    history = PoseHistory()
    history.add(pose(0.0, 0.0, 2 * math.pi - 0.1, 0.1))
    history.add(pose(1.0, 0.0, 0.1, 2 * math.pi - 0.1))
    middle = encoders_at(history, 0.5)
    assert middle.pose[2] % (2 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert middle.turret_rad % (2 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert (middle.turret_rad - middle.heading_rad) % (2 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_nearest_pose_outside_of_polled_interval() -> None:
    history = PoseHistory()
    history.add(pose(1.0, 3.0))
    history.add(pose(2.0, 4.0))
    assert encoders_at(history, 0.5).clock_s == 0.5
    assert encoders_at(history, 0.5).pose[0] == 3.0
    assert encoders_at(history, 9.0).pose[0] == 4.0


def test_the_oldest_poses_are_dropped_but_not_the_last_two() -> None:
    history = PoseHistory()
    for k in range(1000):
        history.add(pose(0.1 * k, float(k)))
    assert encoders_at(history, 0.0).pose[0] >= 1000 - 10 * HISTORY_S - 3
    history.add(pose(1e6, 5.0))
    assert encoders_at(history, 99.9).pose[0] == pytest.approx(999.0)
