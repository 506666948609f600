"""The explorer: along a roadmap while the estimate is valid, by the sonars while it is lost."""

from __future__ import annotations

from math import pi

import numpy as np

from localization.experiments.lost import RandomExplorer
from localization.live.sensor_input import SensorData
from localization.navigation.control_law import STAND, TURN_RAD_S, VelocityCommand
from localization.navigation.roadmap import Roadmap
from localization.navigation.waypoints import Speeds
from worlds.geometry import polygon_segments

ROOM = polygon_segments([(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)])
GOAL = np.array([[80.0, 20.0]])


def explorer(places: np.typing.NDArray[np.float64] = GOAL) -> RandomExplorer:
    return RandomExplorer(Roadmap(ROOM, 12.0), places, Speeds(translation_in_s=5.0), np.random.default_rng(0))


def test_explorer_plans_turns_drives_and_replans() -> None:
    one = explorer()
    assert one.command(np.array([20.0, 20.0, pi])) == STAND
    # Facing away from the goal, at pi, the robot turns before it drives.
    assert one.command(np.array([20.0, 20.0, pi])).translation_in_s == 0.0
    assert one.command(np.array([20.0, 20.0, -2.0])) == VelocityCommand(0.0, TURN_RAD_S)
    assert one.command(np.array([20.0, 20.0, 2.0])) == VelocityCommand(0.0, -TURN_RAD_S)
    assert one.command(np.array([20.0, 20.0, 0.0])) == VelocityCommand(5.0, 0.0)
    assert one.command(np.array([79.5, 20.0, 0.0])) == STAND


def test_explorer_stands_and_tries_next_goal_without_path() -> None:
    one = explorer(np.array([[2.0, 2.0]]))
    assert one.command(np.array([20.0, 20.0, 0.0])) == STAND
    assert one.command(np.array([20.0, 20.0, 0.0])) == STAND


def test_lost_explorer_recovers_then_replans() -> None:
    one = explorer()
    one.command(np.array([20.0, 20.0, 0.0]))
    assert one.command(np.array([20.0, 20.0, 0.0])) == VelocityCommand(5.0, 0.0)
    assert one.recover(SensorData(0.0, 0.0, 0.0, 1.0, 1.0, (255,) * 16)) == VelocityCommand(0.0, TURN_RAD_S)
    assert one.command(np.array([20.0, 20.0, 0.0])) == STAND
