"""The verbs, on a simulated robot: their effects, their failures, and the endings of a mission."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from math import degrees, hypot, inf
from typing import Any

import pytest

from localization.navigation.mission import Mission, MissionOver, StepFailed, run_mission
from localization.navigation.path import angle_difference
from localization.navigation.pilot import RobotController, Settings
from nclient.common.process import TerminatedBySignal
from nclient.errors import ConnectionLost, NomadError, RobotHeld

pytestmark = pytest.mark.long

MakeController = Callable[..., RobotController]
BOX = [(36.0, -6.0), (44.0, -6.0), (44.0, 6.0), (36.0, 6.0)]


def place(mission: Mission) -> tuple[float, float]:
    return mission.seen.x_in, mission.seen.y_in


def endings(mission: Mission) -> list[tuple[str, str]]:
    return [(step.name, step.ending) for step in mission.report.steps]


def test_go_to_arrives_in_truth_and_is_reported(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room", setup="noisy")
    mission = Mission(controller)
    seen = mission.go_to(30, 20, heading_deg=90)
    # Truth and estimate agree with the goal.
    truth = controller.robot.truth()
    assert hypot(truth.x_in - 30, truth.y_in - 20) < 1.0
    assert degrees(truth.steering_rad) == pytest.approx(90, abs=6)
    assert seen.heading_deg == pytest.approx(90, abs=3)
    assert (seen.trust, seen.touching, seen.bumpers, seen.finds) == ("OK", False, (), 0)
    # One step, with one plan and one try.
    (step,) = mission.report.steps
    assert (step.name, step.arguments, step.ending, step.tries, step.plans) == (
        "go_to",
        "(30, 20) 90 deg",
        "done",
        1,
        1,
    )
    # The straight line is the shortest path.
    assert step.driven_in == pytest.approx(hypot(30, 20), rel=0.05)
    assert step.planned_in == pytest.approx(hypot(30, 20), rel=0.05)
    assert not controller.robot.refresh().moving


def test_unmapped_obstacle_is_avoided(controller_at: MakeController) -> None:
    # A box in the way that the map does not have.
    controller = controller_at("thesis_room", setup="noisy")
    controller.robot.add_obstacle(corners_in=BOX)
    touched = []
    controller.observers.append(lambda sight: touched.append(sight.state.touching))
    mission = Mission(controller)
    mission.go_to(80, 0)
    assert not any(touched)
    # At least one new plan, and a path longer than the straight 80 in.
    assert mission.report.steps[0].plans > 1
    assert mission.report.steps[0].driven_in > 82.0


def test_follow_patrol_turn_look_and_note(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))
    # Through two points.
    mission.follow([(10, 0), (10, 10)])
    assert place(mission) == pytest.approx((10, 10), abs=1.2)
    # There and back, twice.
    mission.patrol([(14, 10), (10, 10)], rounds=2)
    assert place(mission) == pytest.approx((10, 10), abs=1.2)
    # To a heading, and by an angle.
    mission.turn(-90)
    assert mission.seen.heading_deg == pytest.approx(-90, abs=3)
    mission.turn(by_deg=90)
    assert mission.seen.heading_deg == pytest.approx(0, abs=4)
    before = mission.seen.clock_s
    # Half a second, to a period of the controller.
    mission.look(0.5)
    assert mission.seen.clock_s == pytest.approx(before + 0.5, abs=0.11)
    mission.note("well")
    # A patrol is a step for each point.
    assert [verb for verb, _ in endings(mission)] == ["follow", *["patrol"] * 4, "turn", "turn", "look", "note"]
    assert {ending for _, ending in endings(mission)} == {"done"}
    assert mission.report.steps[0].arguments == "(10, 0) (10, 10)"


def test_waiting_ends_by_the_condition_or_by_its_limit(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))
    seen = mission.wait_for(lambda seen: seen.clock_s > 0.5, 5.0)
    assert 0.5 < seen.clock_s < 0.7
    with pytest.raises(StepFailed, match=r"not fulfilled.* 1 s") as failed:
        mission.wait_for(lambda seen: seen.touching, 1.0, "obstacle")
    assert failed.value.ending == "condition"
    assert endings(mission) == [("wait_for", "done"), ("wait_for", "condition")]


def test_dock_is_entered_straight_and_contact_fails(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room", setup="noisy")
    mission = Mission(controller)
    # The dock is 1.5 in behind the origin, at 180 degrees.
    mission.dock(-1.5, 20, 180)
    truth = controller.robot.truth()
    assert (truth.x_in, truth.y_in) == pytest.approx((-1.5, 20), abs=0.8)
    assert degrees(truth.steering_rad) == pytest.approx(180, abs=6)
    # A box 6 in before the dock.
    blocked = controller_at("thesis_room", "40,60,180,0")
    blocked.robot.add_obstacle(corners_in=[(8.0, 55.0), (12.0, 55.0), (12.0, 65.0), (8.0, 65.0)])
    with pytest.raises(StepFailed, match="before the dock"):
        Mission(blocked).dock(14, 60, 180)


def test_failed_step_is_retried(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))
    with pytest.raises(StepFailed, match=r"no space.*\(0, -11\)"):
        mission.go_to(0, -11, retries=2)
    (step,) = mission.report.steps
    assert (step.tries, step.ending) == (3, "blocked")
    assert [words for _, words in step.notes] == [f"{step.reason}; trying again"] * 2
    mission.go_to(3, 0)
    assert mission.report.steps[-1].done


def test_time_limits_of_step_and_mission(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"), Settings(time_limit_s=6.0))
    with pytest.raises(StepFailed, match="of the step") as failed:
        mission.go_to(60, 0, limit_s=2.0)
    assert failed.value.ending == "timeout"
    assert not isinstance(failed.value, MissionOver)
    with pytest.raises(MissionOver, match=r"mission.* 6 s"):
        mission.look(60.0)
    assert mission.seen.clock_s == pytest.approx(6.1, abs=0.15)


def test_held_robot_is_reported_and_goes_on_once_released(
    controller_at: MakeController, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = controller_at("thesis_room")
    # Held for 12 s from now.
    mission, until_s = Mission(controller, Settings(time_limit_s=40.0)), controller.clock_s + 12.0
    drive = controller.robot.drive

    def held(**velocities: float) -> Any:
        """Refuse motions, as the server of a held robot does (nserver_emu.server.estop)."""
        if controller.clock_s < until_s:
            raise RobotHeld("vm", 1, "viewer 1")
        return drive(**velocities)

    monkeypatch.setattr(controller.robot, "drive", held)
    # The step goes on after the release.
    mission.go_to(20, 0)
    (step,) = mission.report.steps
    output = [words for _, words in step.notes if "is it held (see nserver ctl status), or its emerg" in words]
    assert len(output) == 1
    assert output[0].startswith("the robot has not moved for 5 s although commanded to: ")
    # Held for good: the limits of step and mission end it, and say why.
    until_s = inf
    with pytest.raises(StepFailed, match=r"step exceeded.* 1[01] s.*held"):
        mission.go_to(40, 0, limit_s=11.0)
    with pytest.raises(MissionOver, match=r"mission exceeded: 40 s.*held"):
        mission.go_to(40, 0)


def test_look_stands_still_without_notes(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))
    mission.look(8.0)
    assert mission.report.steps[0].notes == []


def test_a_fence_is_planned_within_and_left_by_nothing(controller_at: MakeController) -> None:
    # The fence excludes the parts of the room beyond x = 70 in and y = 40 in.
    fence = ((-11.0, -11.0), (70.0, -11.0), (70.0, 40.0), (-11.0, 40.0))
    controller = controller_at("thesis_room", setup="noisy")
    mission = Mission(controller, Settings(fence_in=fence))
    # A goal outside of the fence has no path.
    with pytest.raises(StepFailed, match=r"no space.*\(40, 60\)|no path") as failed:
        mission.go_to(40, 60)
    assert failed.value.ending == "blocked"
    # One inside is reached.
    mission.go_to(50, 20)
    controller.robot.set_position(x_in=50, y_in=20)
    # A robot that is outside ends the mission.
    jumped = controller_at("thesis_room", start="60,60,0,0")
    outside = Mission(jumped, Settings(fence_in=fence))
    with pytest.raises(MissionOver, match=r"outside.* fence") as over:
        outside.look(1.0)
    assert over.value.ending == "fence"


@pytest.mark.parametrize("swallowed", [StepFailed, NomadError, Exception, BaseException])
def test_program_cannot_suppress_end_of_mission(
    controller_at: MakeController, swallowed: type[BaseException]
) -> None:
    mission = Mission(controller_at("thesis_room"), Settings(time_limit_s=2.0))
    clocks: list[float] = []

    def program(robot: Mission) -> None:
        for goal in (40, 60):
            with contextlib.suppress(swallowed):
                robot.go_to(goal, 0)
            clocks.append(robot.seen.clock_s)

    run_mission(mission, program)
    report = mission.report
    assert (report.ending, report.reason) == ("timeout", "time limit of the mission exceeded: 2 s")
    assert [step.ending for step in report.steps] == ["timeout"], "the second step was never begun"
    assert len(set(clocks)) <= 1, "nothing was driven after the end"
    with pytest.raises(MissionOver):
        mission.look()


def test_after_the_fence_every_verb_refuses(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room", start="60,60,0,0")
    robot = Mission(controller, Settings(fence_in=((-11.0, -11.0), (40.0, -11.0), (40.0, 40.0), (-11.0, 40.0))))
    verbs: list[Callable[[], object]] = [
        robot.look, lambda: robot.go_to(60, 50), lambda: robot.follow([(60, 50)]), lambda: robot.turn(90),
        lambda: robot.wait_for(bool, 1.0), lambda: robot.patrol([(60, 50)]), lambda: robot.dock(60, 50, 0),
    ]  # fmt: skip
    for verb in verbs:
        with pytest.raises(MissionOver, match=r"outside.* fence"):
            verb()
    robot.note("left the fence")
    assert [step.name for step in robot.report.steps] == ["look", "note"]


def test_suppressed_interrupt_still_ends_mission(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))

    def interrupt(_: object) -> bool:
        raise KeyboardInterrupt

    def program(robot: Mission) -> None:
        with contextlib.suppress(BaseException):
            robot.wait_for(interrupt, 3.0)

    with pytest.raises(KeyboardInterrupt):
        run_mission(mission, program)
    assert mission.report.ending == "interrupted"


def test_nested_steps_are_refused(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))

    def meddle(_: object) -> bool:
        mission.look()
        return True

    with pytest.raises(StepFailed, match=r"wait_for.*one step"):
        mission.wait_for(meddle, 3.0)


def test_robot_error_is_reported_and_raised(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room")
    mission = Mission(controller)

    def lose(_: object) -> None:
        raise ConnectionLost("the cable is out")

    controller.observers.append(lose)
    with pytest.raises(ConnectionLost):
        mission.go_to(30, 0)
    (step,) = mission.report.steps
    assert (step.ending, step.reason) == ("error", "the cable is out")

    def break_off(_: object) -> None:
        raise KeyboardInterrupt

    controller.observers[-1] = break_off
    with pytest.raises(KeyboardInterrupt):
        mission.turn(90)
    assert (mission.report.steps[-1].ending, mission.report.steps[-1].reason) == ("interrupted", "Ctrl-C")


@pytest.mark.parametrize("by_deg", [-270, 360, 540])
def test_relative_turn_agrees_with_ground_truth(controller_at: MakeController, by_deg: int) -> None:
    controller = controller_at("thesis_room")
    turned, before = 0.0, controller.robot.truth().steering_rad

    def add_up(_: object) -> None:
        nonlocal turned, before
        now = controller.robot.truth().steering_rad
        turned, before = turned + angle_difference(before, now), now

    controller.observers.append(add_up)
    mission = Mission(controller)
    mission.turn(by_deg=by_deg)
    assert degrees(turned) == pytest.approx(by_deg, abs=4)


def test_retried_turn_continues_from_its_progress(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))
    mission.turn(by_deg=180, limit_s=3.5, retries=5)
    (step,) = mission.report.steps
    assert step.tries > 1
    assert abs(mission.seen.heading_deg) == pytest.approx(180, abs=4)


def test_a_signal_ends_a_step_by_its_name(controller_at: MakeController) -> None:
    controller = controller_at("thesis_room")

    def leave(_: object) -> None:
        raise TerminatedBySignal("SIGTERM")

    controller.observers.append(leave)
    mission = Mission(controller)
    with pytest.raises(TerminatedBySignal):
        run_mission(mission, lambda robot: robot.patrol([(20, 0)]))
    (step,) = mission.report.steps
    assert (step.ending, step.reason) == ("interrupted", "SIGTERM")
    assert "s  interrupted  patrol (20, 0), round 1 of 1" in step.line()
    assert step.line().endswith(": SIGTERM")
    assert (mission.report.ending, mission.report.reason) == ("interrupted", "SIGTERM")


def test_suppressed_exit_in_condition_does_not_end_mission(controller_at: MakeController) -> None:
    mission = Mission(controller_at("thesis_room"))

    def program(robot: Mission) -> None:
        with contextlib.suppress(SystemExit):
            robot.wait_for(lambda _: sys.exit(0), 3.0)
        robot.look(0.2)

    run_mission(mission, program)
    assert endings(mission) == [("wait_for", "error"), ("look", "done")]


def test_touches_are_counted(controller_at: MakeController) -> None:
    """A thing too low for the sonars: they are switched off, the bumpers are not."""
    controller = controller_at("thesis_room")
    controller.robot.add_obstacle(corners_in=BOX)
    spare: Any = lambda *_: None  # noqa: E731
    controller.obstacles.add_reading = spare  # type: ignore[method-assign]
    mission = Mission(controller)
    mission.go_to(80, 0)
    (step,) = mission.report.steps
    assert step.touches >= 1
    assert any("touched something" in words for _, words in step.notes)
