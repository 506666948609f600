"""The guided run on a robot: drive the tasks on the estimate, hear, until all is done.

Rules: speaks to a robot through nclient's names only; waiting is handed in. The turret, where there is one, turns with
the steering, so that every sonar sees every wall.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import NamedTuple

from localization.calibration.square import Driver
from localization.driving.navigation import COMMAND_TIMEOUT_S, PERIOD_S, SHORTEST_WAIT_S, Command, standing_after
from localization.filters.base import Filter, LocalizationConfig
from localization.live.localizer import Estimate, Localizer
from localization.live.sensor_input import FiringSchedule
from nclient.protocol.models import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE
from nclient.robot import Robot
from nclient.robot_state import RobotState


class Progress(NamedTuple):
    """A period of the run."""

    estimate: Estimate
    state: RobotState
    done: int


def run(
    robot: Robot, known: LocalizationConfig, method: Filter, driver: Driver, wait: Callable[[float], None]
) -> Generator[Progress, None, None]:
    """Drive until the driver is done, and tell of each period; the robot stands at the end, however it ends."""
    state = robot.configure_sonars(rate=DEFAULT_SONAR_RATE, order=DEFAULT_SONAR_ORDER)
    assert state.clock_s is not None
    localizer = Localizer(known, method.belief, FiringSchedule(state.clock_s), method)
    robot.set_timeout(COMMAND_TIMEOUT_S)
    with standing_after(robot):
        while True:
            estimate = localizer.update(state)
            command = driver.command(estimate.pose)
            yield Progress(estimate, state, driver.done)
            if command is None:
                return
            after = _drive(robot, command)
            left_s = PERIOD_S - ((after.clock_s or 0.0) - (state.clock_s or 0.0))
            if left_s >= SHORTEST_WAIT_S:
                wait(left_s / (after.speed_factor or 1.0))
            state = robot.refresh()


def _drive(robot: Robot, command: Command) -> RobotState:
    rolled, turned = command
    if not robot.model.has_turret:
        return robot.drive(translation_in_s=rolled, steering_rad_s=turned)
    return robot.drive(translation_in_s=rolled, steering_rad_s=turned, turret_rad_s=turned)
