"""Missions of kidnapped robots: detection, recovery and continuation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import hypot, pi

import pytest

from localization.filters.health import FilterHealth, HealthStatus
from localization.navigation.control_law import (
    BACK_OFF_IN_S,
    DRIVE_IN_S,
    MAX_DRIVE_IN_S,
    SCAN_RAD,
    TURN_RAD_S,
    RecoveryBehavior,
    VelocityCommand,
)
from localization.navigation.mission import Mission, MissionOver, _search_commands
from localization.navigation.pilot import Observation, OnLost, RobotController, Settings
from localization.navigation.waypoints import PERIOD_S
from nclient.state import Pose

pytestmark = pytest.mark.long

MakeController = Callable[..., RobotController]


class Kidnapper:
    """Displaces the robot at a given time without changing its encoders.

    It stops the robot first: else the wheels would turn on meanwhile, and the ring stand otherwise on the body.
    """

    def __init__(self, controller: RobotController, pose: Pose, at_s: float = 2.0) -> None:
        self._controller, self._pose, self._at_s, self.done = controller, pose, at_s, False
        self.lost_s = 0.0
        controller.observers.append(self)

    def __call__(self, sight: Observation) -> None:
        if not self.done and sight.estimate.clock_s > self._at_s:
            self.done = True
            self._controller.robot.stop()
            output = self._controller.robot.wait_until_still(timeout_s=5)
            # The turret keeps its angle relative to the steering.
            front = self._pose.steering_rad + output.turret_rad - output.steering_rad
            self._controller.robot.place(replace(self._pose, turret_rad=front))
            # Encoders are set back: the robot cannot notice the displacement.
            self._controller.robot.set_position(x_in=output.x_in, y_in=output.y_in)
            self._controller.robot.set_angles(steering_rad=output.steering_rad, turret_rad=output.turret_rad)
        if sight.estimate.health.status is HealthStatus.LOST:
            self.lost_s = self.lost_s or sight.estimate.clock_s


def kidnapped(controller_at: MakeController, settings: Settings) -> tuple[Mission, Kidnapper]:
    controller = controller_at("several_walls", "5,5,0,0", method="finder", setup="noisy")
    kidnapper = Kidnapper(controller, Pose(85.0, 85.0, pi))
    return Mission(controller, settings), kidnapper


def test_given_up_the_mission_ends_at_once(controller_at: MakeController) -> None:
    mission, kidnapper = kidnapped(controller_at, Settings(on_lost=OnLost.GIVE_UP))
    with pytest.raises(MissionOver) as over:
        mission.go_to(35, 55)
    assert over.value.ending == "lost"
    assert kidnapper.done
    assert mission.seen.trust == "LOST"
    assert mission.report.steps[0].notes[0][1].startswith("lost: ")


def test_found_again_by_a_search_the_mission_goes_on(controller_at: MakeController) -> None:
    mission, kidnapper = kidnapped(controller_at, Settings(on_lost=OnLost.SEARCH))
    mission.go_to(35, 55)
    assert kidnapper.lost_s > 0.0
    truth = mission._controller.robot.truth()
    assert hypot(truth.x_in - 35, truth.y_in - 55) < 1.5
    assert any(words.startswith("localized again after") for _, words in mission.report.steps[0].notes)


def test_search_in_symmetric_room_ends_at_time_limit(controller_at: MakeController) -> None:
    """The square room has four equivalent poses for every position."""
    controller = controller_at("thesis_room", "45,45,0,0", method="finder")
    Kidnapper(controller, Pose(20.0, 70.0, 1.0))
    mission = Mission(controller, Settings(on_lost=OnLost.SEARCH, lost_s=15.0))
    with pytest.raises(MissionOver, match=r"localized.* 15 s"):
        mission.patrol([(80, 80), (10, 10)], rounds=3)
    assert not any(step.touches for step in mission.report.steps)


def test_turn_continues_after_lost_robot_is_found(controller_at: MakeController) -> None:
    controller = controller_at("several_walls", "35,55,0,0", method="finder", setup="noisy")
    Kidnapper(controller, Pose(85.0, 85.0, pi), 0.5)
    mission = Mission(controller, Settings(on_lost=OnLost.STOP))
    for heading in (120, 240, 0):
        mission.turn(heading)
    truth = controller.robot.truth()
    assert abs((truth.steering_rad + pi) % (2 * pi) - pi) < 0.15


def test_a_search_gropes_and_is_set_back_by_a_touch(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room", "45,45,0,0")
    groping, commands = RecoveryBehavior(PERIOD_S), _search_commands(controller)
    # The scan in place, then a straight drive.
    for _ in range(round(SCAN_RAD / TURN_RAD_S / PERIOD_S) + 5):
        command = next(commands)
        assert tuple(command) == groping.command(controller.last.state)
        controller.period(command)
    # The space ahead is free.
    assert DRIVE_IN_S < command.translation_in_s <= MAX_DRIVE_IN_S
    free = controller.last
    # The bumper bit of the state is set by hand.
    controller.last = free._replace(state=replace(free.state, raw=(*free.state.raw[:33], 1, *free.state.raw[34:])))
    assert controller.last.state.touching
    back = [next(commands)]
    controller.last = free
    # 2 s backwards, then a turn.
    back += [next(commands) for _ in range(19)]
    assert back == [VelocityCommand(-BACK_OFF_IN_S, 0.0)] * 20
    assert next(commands) == VelocityCommand(0.0, TURN_RAD_S)


def test_estimate_lost_before_dock_repeats_approach(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room", "5,5,0,0")
    mission = Mission(controller, Settings(on_lost=OnLost.STOP))
    lost: list[Observation] = []

    def on_the_last_foot(sight: Observation) -> None:
        """Report a lost estimate for two seconds near the dock."""
        if sight.estimate.pose[0] > 41.0 and len(lost) < 20:
            lost.append(sight)
            nowhere = sight.estimate._replace(health=FilterHealth(HealthStatus.LOST, "nothing fits"))
            controller.last = sight._replace(estimate=nowhere)

    # 20 periods with a lost estimate, in the last part of the approach.
    controller.observers.insert(0, on_the_last_foot)
    mission.dock(50, 5, 0)
    assert len(lost) == 20
    # It stands after the first second.
    assert {sight.state.translation_in_s for sight in lost[10:]} == {0.0}
    # The dock is reached all the same.
    truth = controller.robot.truth()
    assert hypot(truth.x_in - 50, truth.y_in - 5) < 1.0
    words = [words for _, words in mission.report.steps[0].notes]
    assert words[0] == "lost: nothing fits"
    assert words[1].startswith("localized again after")
