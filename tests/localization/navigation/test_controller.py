"""The robot controller: single periods, contacts, the stop at the end, fences."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from localization.navigation.control_law import VelocityCommand
from localization.navigation.pilot import RobotController
from nclient.errors import BumperHit, ConnectionLost

MakeController = Callable[..., RobotController]


@pytest.mark.long
def test_period_drives_and_notifies_observers(controller_at: MakeController) -> None:
    controller, clocks = controller_at("thesis_room"), []
    controller.observers.append(lambda sight: clocks.append(sight.estimate.clock_s))
    start = controller.clock_s
    # Ten periods of 0.1 s at 5 in/s, less the ramp.
    for _ in range(10):
        sight = controller.period(VelocityCommand(5.0, 0.0))
    assert sight.state.x_in == pytest.approx(5.0, abs=0.6)
    # Observers get each period.
    assert clocks == pytest.approx([start + 0.1 * (k + 1) for k in range(10)])
    # Leaving the block stops the robot.
    with controller:
        controller.period(VelocityCommand(5.0, 0.0))
    assert controller.robot.refresh().translation_in_s == 0.0


@pytest.mark.long
def test_rare_states_limit_distance_between_two_states(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room", step_s=0.55)
    distances_in = [controller.period(VelocityCommand(5.0, 0.0)).state.x_in for _ in range(6)]
    assert distances_in[-1] - distances_in[-2] == pytest.approx(2.5, abs=0.2)


def test_failed_stop_does_not_hide_the_cause(
    controller_at: MakeController, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> None:
        raise ConnectionLost("not back yet")

    controller = controller_at("thesis_room")
    with monkeypatch.context() as patched:
        patched.setattr(controller.robot, "stop", gone)
        # The error of the body is raised.
        with pytest.raises(ConnectionLost, match="the cause"), controller:
            raise ConnectionLost("the cause")
        # Without one, that of the stop is.
        with pytest.raises(ConnectionLost, match="not back"), controller:
            pass


def test_bumper_stop_is_seen_in_next_state(
    controller_at: MakeController, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = controller_at("thesis_room")

    def hit(**_: float) -> None:
        raise BumperHit("vm", (0,))

    monkeypatch.setattr(controller.robot, "drive", hit)
    # The period ends with the next state all the same.
    before = controller.clock_s
    assert controller.period(VelocityCommand(5.0, 0.0)).estimate.clock_s > before


def test_a_fence_is_a_wall_to_the_planner(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room")
    walls = len(controller.planner.walls)
    controller.add_fence(controller.planner.walls[:2] + 5.0)
    assert len(controller.planner.walls) == walls + 2
