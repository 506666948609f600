"""Safety limits of the hardware tests: options of the address, and a check of the distance driven.

They apply to every address, also to simulated robots, so that the tests do the same with and without a robot.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from nclient import Robot, connect
from nclient.state import Pose, RobotState
from nclient.url import split_address

# Far below the maximum of 20 in/s and 45 deg/s; the robot stops 2 s after the last request.
SPEED_IN_S, TURN_DEG_S, TIMEOUT_S = 5, 30, 2
LIMITS = {"max_speed_in_s": SPEED_IN_S, "max_turn_deg_s": TURN_DEG_S, "tm_s": TIMEOUT_S, "bumper_stop": 1, "feed": 1}
# 30 cm in inches.
REACH_IN = 30 / 2.54
HOME_IN = 1.0
"""Maximum distance from the start pose at the end of a test."""


@dataclass
class Bench:
    """A robot with the safety limits. `faster`: its seconds per real second."""

    address: str
    faster: float = 1.0

    def connect(self) -> Robot:
        """Connect to it, with the limits."""
        return connect(self.address)

    def sleep(self, robots_s: float) -> None:
        """Send nothing for this many seconds of the robot's time."""
        time.sleep(robots_s / self.faster)


@dataclass
class Walk:
    """A robot that must stay near its start pose."""

    robot: Robot
    start: Pose

    def distance_in(self, state: RobotState) -> float:
        """Return the distance from the start pose by the encoders."""
        return math.dist((state.x_in, state.y_in), (self.start.x_in, self.start.y_in))

    def watch(self, wait_until: Callable[[RobotState], bool], most_s: float = 20.0) -> list[RobotState]:
        """Return the states until a condition is true. Stop the robot and fail if it drives too far."""
        states = [self.robot.refresh()]
        start_s = states[0].clock_s or 0.0
        while not wait_until(states[-1]):
            states.append(self.robot.refresh())
            # Beyond the limit, or too late by the robot's own clock: stop first, then fail.
            if self.distance_in(states[-1]) > REACH_IN or (states[-1].clock_s or 0.0) > start_s + most_s:
                self.robot.stop()
                pytest.fail(f"stopped {self.distance_in(states[-1]):.1f} in from the start: {states[-1]}")
        return states

    def until_still(self) -> RobotState:
        """Wait until it stands still and return the state."""
        return self.watch(lambda state: not state.moving)[-1]

    def until_later(self, seconds: float) -> list[RobotState]:
        """Return the states of this many seconds of its clock."""
        end_s = (self.robot.refresh().clock_s or 0.0) + seconds
        return self.watch(lambda state: (state.clock_s or 0.0) >= end_s)

    def back(self) -> RobotState:
        """Drive back to the start along a straight line."""
        state = self.robot.refresh()
        x, y = state.x_in - self.start.x_in, state.y_in - self.start.y_in
        # The distance along the heading: negative if the robot has driven backward.
        along = x * math.cos(state.steering_rad) + y * math.sin(state.steering_rad)
        self.robot.move(translation_in=-along)
        return self.until_still()


def limited(address: str) -> str:
    """Return the address with the limits, which replace its own options."""
    text = split_address(address).without(LIMITS)
    limits = "&".join(f"{name}={value}" for name, value in LIMITS.items())
    return f"{text}{'&' if '?' in text else '?'}{limits}"
