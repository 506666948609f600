"""The helm: a period at a time, touches that others stop, a robot that stands at the end."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from localization.missions.controller import RobotController
from localization.navigation.limits import VelocityCommand
from nclient.errors import BumperHit, ConnectionLost

MakeHelm = Callable[..., RobotController]


def test_a_period_drives_and_is_watched(helm_at: MakeHelm) -> None:
    controller, clocks = helm_at("thesis_room"), []
    controller.observers.append(lambda sight: clocks.append(sight.estimate.clock_s))
    start = controller.clock_s
    for _ in range(10):
        sight = controller.period(VelocityCommand(5.0, 0.0))
    assert sight.state.x_in == pytest.approx(5.0, abs=0.6)
    assert clocks == pytest.approx([start + 0.1 * (k + 1) for k in range(10)])
    with controller:
        controller.period(VelocityCommand(5.0, 0.0))
    assert controller.robot.refresh().translation_in_s == 0.0


def test_where_states_come_far_apart_it_goes_no_farther_between_two_than_in_half_a_second(helm_at: MakeHelm) -> None:
    controller = helm_at("thesis_room", step_s=0.55)
    ways = [controller.period(VelocityCommand(5.0, 0.0)).state.x_in for _ in range(6)]
    assert ways[-1] - ways[-2] == pytest.approx(2.5, abs=0.2)


def test_a_cause_is_reported_and_not_that_the_robot_could_not_be_stopped(
    helm_at: MakeHelm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> None:
        raise ConnectionLost("not back yet")

    controller = helm_at("thesis_room")
    with monkeypatch.context() as patched:
        patched.setattr(controller.robot, "stop", gone)
        with pytest.raises(ConnectionLost, match="the cause"), controller:
            raise ConnectionLost("the cause")
        with pytest.raises(ConnectionLost, match="not back"), controller:
            pass


def test_a_touch_that_others_stop_is_seen_by_the_next_question(
    helm_at: MakeHelm, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = helm_at("thesis_room")

    def hit(**_: float) -> None:
        raise BumperHit("vm", (0,))

    monkeypatch.setattr(controller.robot, "drive", hit)
    before = controller.clock_s
    assert controller.period(VelocityCommand(5.0, 0.0)).estimate.clock_s > before


def test_a_fence_is_a_wall_to_the_planner(helm_at: MakeHelm) -> None:
    controller = helm_at("thesis_room")
    walls = len(controller.planner.walls)
    controller.add_fence(controller.planner.walls[:2] + 5.0)
    assert len(controller.planner.walls) == walls + 2
