"""The envelope of the hardware tests: limits on the address, and a watch on how far the robot has gone.

Rules: they are put on every address, the emulated robots' too, so that what is tried without a robot is what a robot
gets.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from nclient import Robot, connect
from nclient.address import parsed
from nclient.state import Pose, RobotState

SPEED_IN_S, TURN_DEG_S, TIMEOUT_S = 5, 30, 2
LIMITS = {"max_speed_in_s": SPEED_IN_S, "max_turn_deg_s": TURN_DEG_S, "tm_s": TIMEOUT_S, "bumper_stop": 1, "feed": 1}
REACH_IN = 30 / 2.54
HOME_IN = 1.0
"""How far from where it was met a test may leave the robot."""


@dataclass
class Bench:
    """A robot within the envelope. `faster`: its seconds a real one."""

    address: str
    faster: float = 1.0

    def connect(self) -> Robot:
        """A connection to it, limited."""
        return connect(self.address)

    def sleep(self, robots_s: float) -> None:
        """Say nothing for so many of the robot's seconds."""
        time.sleep(robots_s / self.faster)


@dataclass
class Walk:
    """A robot that stays within reach of where it was met."""

    robot: Robot
    start: Pose

    def distance_in(self, state: RobotState) -> float:
        """How far from there its encoders have it."""
        return math.dist((state.x_in, state.y_in), (self.start.x_in, self.start.y_in))

    def watch(self, until: Callable[[RobotState], bool], most_s: float = 20.0) -> list[RobotState]:
        """States until one is as wanted. The robot is stopped, and the test fails, where it goes out of reach."""
        states = [self.robot.refresh()]
        start_s = states[0].clock_s or 0.0
        while not until(states[-1]):
            states.append(self.robot.refresh())
            if self.distance_in(states[-1]) > REACH_IN or (states[-1].clock_s or 0.0) > start_s + most_s:
                self.robot.stop()
                pytest.fail(f"stopped {self.distance_in(states[-1]):.1f} in from the start: {states[-1]}")
        return states

    def until_still(self) -> RobotState:
        """The state in which it has come to rest."""
        return self.watch(lambda state: not state.moving)[-1]

    def until_later(self, seconds: float) -> list[RobotState]:
        """States for so long on its clock."""
        end_s = (self.robot.refresh().clock_s or 0.0) + seconds
        return self.watch(lambda state: (state.clock_s or 0.0) >= end_s)

    def back(self) -> RobotState:
        """Home along the way that it came, straight ahead or back."""
        state = self.robot.refresh()
        x, y = state.x_in - self.start.x_in, state.y_in - self.start.y_in
        along = x * math.cos(state.steering_rad) + y * math.sin(state.steering_rad)
        self.robot.move(translation_in=-along)
        return self.until_still()


def limited(address: str) -> str:
    """The address with the envelope; what it says itself of the same things is left out."""
    text = parsed(address).without(LIMITS)
    limits = "&".join(f"{name}={value}" for name, value in LIMITS.items())
    return f"{text}{'&' if '?' in text else '?'}{limits}"
