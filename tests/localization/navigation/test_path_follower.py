"""Path following: a simulated drive whose axes ramp, with periods of a tenth of a second."""

from __future__ import annotations

from math import cos, hypot, pi, sin

import numpy as np
import pytest

from localization.filters.belief import Floats
from localization.navigation.control_law import MODEL_LIMITS, STAND
from localization.navigation.path import (
    PathElement,
    PathFollower,
    PathSection,
    line_between,
    split_into_sections,
    turn_command,
)
from localization.navigation.roadmap import Planner
from worlds.io import load_world
from worlds.robots import N150

AXES = MODEL_LIMITS["n150"].capped(8.0)


def drive(follower: PathFollower, pose: Floats, periods: int = 2000, share: float = 1.0) -> Floats:
    """Poses (n, 3) until the end; axes ramp at their accelerations in steps of 10 ms."""
    speed = rate = 0.0
    poses = [pose.copy()]
    for _ in range(periods):
        if follower.finished:
            break
        command = follower.command(poses[-1], share)
        x, y, heading = poses[-1]
        # Ten steps of 10 ms per period; 0.3 in/s is a step at 30 in/s^2.
        for _ in range(10):
            speed += np.clip(command.translation_in_s - speed, -0.3, 0.3)
            rate += np.clip(command.steering_rad_s - rate, -0.01 * AXES.steering_rad_s2, 0.01 * AXES.steering_rad_s2)
            heading += 0.01 * rate
            x, y = x + 0.01 * speed * cos(heading), y + 0.01 * speed * sin(heading)
        poses.append(np.array([x, y, heading]))
    return np.array(poses)


@pytest.mark.long
@pytest.mark.parametrize("goal", [(90.0, 55.0), (90.0, 0.0), (40.0, 90.0)])
def test_follower_keeps_to_plan_and_stops_at_its_end(goal: tuple[float, float]) -> None:
    planner = Planner(np.array(load_world("several_walls").walls), N150.radius_in)
    plan = planner.plan((5.0, 5.0), goal)
    poses = drive(PathFollower(plan.sections, AXES), np.array([5.0, 5.0, -2.0]))
    assert hypot(poses[-1][0] - goal[0], poses[-1][1] - goal[1]) < 0.6
    on_course = np.concatenate([section.points(0.1) for section in plan.sections])
    far = np.hypot(*(poses[:, None, :2] - on_course[None]).transpose(2, 0, 1)).min(axis=1)
    assert far.max() < 0.5
    assert load_world("several_walls").clearance(*map(float, poses[-1][:2])) > N150.radius_in


def test_follower_returns_to_path_without_overshoot() -> None:
    follower = PathFollower([PathSection((line_between((0, 0), (100, 0)),))], AXES)
    follower.command(np.array([0.0, 0.0, 0.0]))
    poses = drive(follower, np.array([0.0, 2.5, 0.0]))
    assert poses[:, 1].min() > -0.4
    assert abs(poses[-1][1]) < 0.1


def test_follower_turns_in_place_at_start_and_at_corner() -> None:
    corner = split_into_sections([line_between((0, 0), (30, 0)), line_between((30, 0), (30, 30))])
    follower = PathFollower(corner, AXES)
    # Heading 3 rad: it first turns in place towards the path.
    first = follower.command(np.array([0.0, 0.0, 3.0]))
    assert first.translation_in_s == 0.0
    assert first.steering_rad_s < 0.0
    assert follower.ahead(2.0) is None
    # It reaches the corner, turns there, and reaches the end.
    poses = drive(follower, np.array([0.0, 0.0, 3.0]))
    assert np.hypot(*(poses[:, :2] - [30.0, 0.0]).T).min() < 0.5
    assert hypot(poses[-1][0] - 30.0, poses[-1][1] - 30.0) < 0.5
    # At the end it stands, and nothing remains.
    assert follower.command(poses[-1]) == STAND
    assert follower.remaining_points().shape == (0, 2)
    assert follower.ahead(2.0) is None


def test_rotated_robot_stops_and_turns_back() -> None:
    follower = PathFollower([PathSection((line_between((0, 0), (100, 0)),))], AXES)
    assert follower.command(np.array([0.0, 0.0, 0.0])).translation_in_s > 0.0
    assert follower.command(np.array([0.0, 0.0, 1.0])) == pytest.approx((0.0, -AXES.steering_rad_s))
    assert follower.command(np.array([0.0, 0.0, 0.2])).translation_in_s == 0.0


def test_turn_that_ends_early_leads_aside_as_the_law_says() -> None:
    # e'' + 2 e' / L + e / L^2 = 0 with e = 0 and slope a at the start: e = a s exp(-s / L), at most a L / e at s = L.
    path = [PathSection((line_between((0, 0), (100, 0)),))]
    start = np.array([0.0, 0.0, 0.1])
    assert PathFollower(path, AXES).command(start).translation_in_s == 0.0
    poses = drive(PathFollower(path, AXES, 0.12), start)
    assert poses[:, 1].max() == pytest.approx(0.1 * 6.0 / np.e, rel=0.25)
    assert abs(poses[-1, 1]) < 0.02


def test_speed_fraction_and_remaining_length() -> None:
    follower = PathFollower(
        [PathSection((line_between((0, 0), (100, 0)), PathElement(100.0, 0.0, 0.0, 0.1, 5.0 * pi)))], AXES
    )
    # The speed ramps up with the distance driven.
    for along in (6.0, 13.0, 20.0):
        full = follower.command(np.array([along, 0.0, 0.0]))
    # Half of the allowed fraction is half of the speed.
    half = follower.command(np.array([20.0, 0.0, 0.0]), 0.5)
    assert half.translation_in_s == pytest.approx(0.5 * full.translation_in_s)
    assert follower.command(np.array([20.0, 0.0, 0.0]), 0.0).translation_in_s == 0.0
    assert follower.remaining_points(1.0)[0] == pytest.approx((20.0, 0.0))
    # The arc ends at a quarter circle of radius 10 in.
    assert follower.remaining_points(1.0)[-1] == pytest.approx((110.0, 10.0))
    assert len(follower.remaining_points(1.0, 5.0)) == 5
    ahead = follower.ahead(3.0)
    assert ahead is not None
    assert ahead == pytest.approx((23.0, 0.0))
    # Behind and beside the path.
    follower.command(np.array([-4.0, -3.0, 0.0]))
    assert abs(follower.lateral_error_in) >= 3.0


def test_a_turn_in_place_brakes_before_its_end() -> None:
    assert turn_command(3.0, AXES).steering_rad_s == AXES.steering_rad_s
    assert turn_command(-0.1, AXES).steering_rad_s == pytest.approx(-np.sqrt(AXES.steering_rad_s2 * 0.1))
    assert 0.0 < turn_command(0.001, AXES).steering_rad_s < 0.06
