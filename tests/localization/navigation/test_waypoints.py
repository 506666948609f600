"""Driving on the estimate, against the emulator in this process: no clock, no socket."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import difference, independent
from localization.filters.health import HealthStatus
from localization.filters.sonar_cone import ConeSonar
from localization.navigation.waypoints import (
    PERIOD_S,
    NavigationStep,
    Navigator,
    Speeds,
    follow_waypoints,
    start_localizer,
)
from nclient import Robot, connect
from nclient.backends.nserver import NserverBackend
from nclient.transports.stream import MemoryStream
from nserver_emu.server.inprocess import open_address
from worlds.io import load_world
from worlds.robots import N150


def never(seconds: float) -> None:
    raise AssertionError(f"asked to wait {seconds} s where simulated time passes by itself")


def drive(address: str, world: str, waypoints: list[tuple[float, float]]) -> list[NavigationStep]:
    with connect(address) as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        localizer = start_localizer(robot, LocalizationConfig(load_world(world).walls, N150), belief)
        # Drive to the end, then compare with the ground truth.
        progress = list(follow_waypoints(robot, localizer, Navigator(waypoints), never))
        truth = robot.truth()
        last = progress[-1].estimate
        assert not robot.wait_until_still(1).moving
        # Within four standard deviations.
        assert math.hypot(last.pose[0] - truth.x_in, last.pose[1] - truth.y_in) < 4 * max(last.belief.std[:2])
    return progress


@pytest.mark.long
def test_the_noisy_robot_reaches_its_goal_on_the_estimate() -> None:
    progress = drive("sim:thesis_room?noisy=1&seed=1&step_s=0.1", "thesis_room", [(0, 0), (60, 40)])
    assert progress[-1].passed == 2
    assert np.hypot(*(progress[-1].estimate.pose[:2] - [60, 40])) <= 1.0
    assert {p.passed for p in progress} == {1, 2}


@pytest.mark.long
@pytest.mark.parametrize(("world", "path"), [("several_walls", "5.8"), ("centre_vertex", "5.9")])
def test_the_guided_paths_of_the_thesis(world: str, path: str) -> None:
    points = list(load_world(world).paths[path].points_in)
    x, y = points[0]
    progress = drive(f"sim:{world}?noisy=1&seed=4&start={x},{y}&step_s=0.1", world, points)
    assert progress[-1].passed == len(points)


def test_held_robot_is_localized_and_goes_on_once_released() -> None:
    server = open_address("sim:thesis_room?step_s=0.1")
    with Robot(NserverBackend(MemoryStream(server), robot_id=1)) as robot:
        belief = independent([0.0, 0.0, 0.0], [0.1, 0.1, 0.01])
        localizer = start_localizer(robot, LocalizationConfig(load_world("thesis_room").walls, N150), belief)
        steps = follow_waypoints(robot, localizer, Navigator([(20, 0)]), never)
        server.emulator.hold(1, "viewer 1")
        held = list(islice(steps, 20))
        assert {step.state.x_in for step in held} == {0.0}
        assert held[-1].estimate.clock_s > 2.0
        server.emulator.release(1)
        *_, last = steps
        assert last.passed == 1
        assert last.state.x_in > 15


def test_navigator_slows_and_turns_towards_goal() -> None:
    navigator = Navigator([(10.0, 0.0), (10.0, 30.0)], Speeds(translation_in_s=4.0, steering_rad_s=0.3))
    # Straight ahead at the given speed.
    straight = navigator.command(np.array([0.0, 0.0, 0.0]))
    assert straight is not None
    assert straight == pytest.approx((4.0, 0.0))
    # 2 in before a waypoint: half of the speed.
    near = navigator.command(np.array([8.0, 0.0, 0.0]))
    assert near is not None
    assert near.translation_in_s == pytest.approx(2.0)
    # Within the tolerance the next waypoint counts, 89 degrees to the left: the robot turns before it drives there.
    turning = navigator.command(np.array([9.5, 0.0, 0.0]))
    assert navigator.passed == 1
    assert turning == pytest.approx((4.0 * 0.5 / math.hypot(0.5, 30.0), 0.3))
    assert navigator.command(np.array([10.0, 29.5, 0.0])) is None
    assert navigator.finished


@pytest.mark.long
def test_period_waits_for_rest_of_robot_clock() -> None:
    waited: list[float] = []
    # Each request takes 20 ms of simulated time.
    with connect("sim:thesis_room?step_s=0.02") as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        localizer = start_localizer(robot, LocalizationConfig(load_world("thesis_room").walls, N150), belief)
        run = follow_waypoints(robot, localizer, Navigator([(3.0, 0.0)]), waited.append)
        for _ in range(5):
            next(run)
        run.close()
        assert not robot.refresh().moving
    # The rest of the period is waited for.
    assert waited == pytest.approx([PERIOD_S - 0.02] * 4)


@pytest.mark.long
def test_robot_that_stays_can_be_driven_by_others() -> None:
    with connect("sim:thesis_room?step_s=0.05") as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        localizer = start_localizer(robot, LocalizationConfig(load_world("thesis_room").walls, N150), belief)
        navigator = Navigator([], stays=True)
        run = follow_waypoints(robot, localizer, navigator, lambda _: None)
        next(run)
        # Velocities of another client of this robot last.
        robot.drive(translation_in_s=5.0)
        for _ in range(20):
            progress = next(run)
        assert progress.state.moving
        # A waypoint is driven to; then the robot is stopped.
        x, y = progress.estimate.pose[:2]
        navigator.set_waypoints([(x + 10.0, y)])
        while not navigator.finished:
            next(run)
        for _ in range(20):
            progress = next(run)
        assert not progress.state.moving


GAP_S = 1.1
RARELY = f"sim:thesis_room?noisy=1&step_s={GAP_S / 2}&seed="
"""Two exchanges a period: states come GAP_S apart."""
ROUND = [(0.0, 0.0), (60.0, 40.0), (30.0, 60.0), (15.0, 10.0)]


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rare_states_reduce_speed_and_estimate_is_consistent(seed: int) -> None:
    """At full speed it circles a path-point for ever, half a foot between two states: it is farther than its radius."""
    errors, nees = [], []
    with connect(f"{RARELY}{seed}") as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        localizer = start_localizer(robot, LocalizationConfig(load_world("thesis_room").walls, N150), belief)
        # Two minutes at most.
        for progress in follow_waypoints(robot, localizer, Navigator(ROUND), never):
            truth, estimate = robot.truth(), progress.estimate
            assert truth.time_s == pytest.approx(estimate.clock_s, abs=0.05)
            error = difference(estimate.pose, np.array([truth.x_in, truth.y_in, truth.steering_rad]))
            errors.append(math.hypot(error[0], error[1]))
            nees.append(error @ np.linalg.inv(estimate.belief.cov[:3, :3]) @ error)
            if estimate.clock_s > 120.0:
                break
    # All waypoints are passed, with a consistent estimate (NEES of 3 on average is exact).
    assert progress.passed == len(ROUND)
    assert max(errors) < 1.0
    assert np.mean(nees) < 6.0


@pytest.mark.long
def test_frequent_states_leave_commands_unchanged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    navigator, driven = Navigator(ROUND), []
    with connect("sim:thesis_room?noisy=1&seed=1&step_s=0.1") as robot:
        drive_it = robot.drive

        # Record the commands that the robot gets.
        def noted(*, translation_in_s: float, steering_rad_s: float) -> object:
            driven.append((translation_in_s, steering_rad_s))
            return drive_it(translation_in_s=translation_in_s, steering_rad_s=steering_rad_s)

        monkeypatch.setattr(robot, "drive", noted)
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        localizer = start_localizer(robot, LocalizationConfig(load_world("thesis_room").walls, N150), belief)
        poses = [progress.estimate.pose for progress in follow_waypoints(robot, localizer, Navigator(ROUND), never)]
    assert len(driven) > 100
    # They are those of the navigator, unchanged.
    assert driven == [navigator.command(pose) for pose in poses[:-1]]


@pytest.mark.long
def test_misfit_is_reported_with_rare_states() -> None:
    """Exact rays taken for a real ring's cones: two thirds of the echoes are no reflector's."""
    text = []
    with connect(f"{RARELY}1") as robot:
        state = robot.refresh()
        belief = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        config = LocalizationConfig(load_world("thesis_room").walls, N150, sonar=ConeSonar())
        # The simulation has rays, the filter assumes cones.
        for progress in follow_waypoints(robot, start_localizer(robot, config, belief), Navigator(ROUND), never):
            text.append(progress.estimate.health)
            if progress.estimate.clock_s > 15.0:
                break
    assert text[0].status is HealthStatus.OK
    assert text[-1].status is HealthStatus.DEGRADED
    assert "echoes are explained" in text[-1].reason
