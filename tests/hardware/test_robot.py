"""Tests for a real robot:  pytest --robot serial:///dev/ttyUSB0?model=n150

The robot stays within 30 cm of its start pose, at most 5 in/s and 30 deg/s: leave 50 cm free around it, and keep a hand
at the emergency switch. The limits are added to the address (envelope.py) and replace its own: speeds are capped, and
the robot stops at a bumper hit and 2 s after the program ends. Tests drive at most 4 in, one at a time, and return; a
robot that is farther than 30 cm from its start is stopped. Positions are those of its encoders, times those of its
clock.
Without `--robot` the tests run on a simulated robot of each model, on a pseudo-terminal.
"""

from __future__ import annotations

import math

import pytest

from nclient import RobotRefused
from nclient.protocol.types import N200
from tests.hardware.envelope import SPEED_IN_S, Bench, Walk

pytestmark = pytest.mark.long

DISTANCE_IN = 4.0
SLOW_IN_S = 2.0
ENCODER_IN, ENCODER_DEG = 0.3, 2.0
"""Accuracy of a motion."""
CLOCK_S = 3.0
"""Time over which clocks are compared: a tenth of it is longer than a busy machine stalls."""
LINE = 200
"""Number of exchanges to measure the quality of a line."""


def test_every_sensor_of_the_model_replies(walk: Walk) -> None:
    robot = walk.robot
    robot.read_sonars()
    robot.read_bumpers()
    state = robot.read_velocities()
    # 0 is a sonar without reading; 6 to 255 in are the range.
    assert all(reading == 0 or 6 <= reading <= 255 for reading in state.sonars_in)
    assert state.bumpers == ()
    assert (state.translation_in_s, state.moving) == (0, False)
    assert state.battery is not None
    assert 5 < state.battery.cpu_v < 16
    robot.read_accelerations()


def test_unavailable_commands_are_not_sent(walk: Walk) -> None:
    robot = walk.robot
    assert robot.link is not None
    for question in (robot.read_infrareds, robot.read_compass, robot.read_laser):
        if robot.model is N200:
            assert question() == robot.state
            continue
        before = robot.link.exchanges
        with pytest.raises(RobotRefused, match=robot.model.name):
            question()
        assert robot.link.exchanges - before <= 1  # of the keep-alive


def test_line_has_no_errors(walk: Walk) -> None:
    link = walk.robot.link
    assert link is not None
    answers, exchanges = link.answers, link.exchanges
    for _ in range(LINE):
        walk.robot.refresh()
    # Two of a hundred replies may be lost on a serial line, and one exchange be unfinished.
    assert link.answers - answers >= 0.98 * (link.exchanges - exchanges) - 1
    assert link.exchanges - exchanges >= LINE
    assert link.latency_s(0.5) < 0.1


def test_clock_runs_at_real_time(bench: Bench, walk: Walk) -> None:
    before = walk.robot.refresh()
    bench.sleep(CLOCK_S)
    after = walk.robot.refresh()
    assert before.clock_s is not None
    assert after.clock_s is not None
    assert 0.9 * CLOCK_S < after.clock_s - before.clock_s < CLOCK_S + 2.0
    assert after.pose == before.pose


def test_encoders_are_set_and_read_back(walk: Walk) -> None:
    robot, start = walk.robot, walk.start
    state = robot.set_position(x_in=12.3, y_in=-45.6)
    assert (state.x_in, state.y_in) == (12.3, -45.6)
    robot.read_pose()
    assert (robot.state.x_in, robot.state.y_in) == (12.3, -45.6)
    robot.set_position(x_in=start.x_in, y_in=start.y_in)
    angle = robot.set_angles(steering_deg=10, turret_deg=20)
    assert angle.steering_deg == pytest.approx(10, abs=0.11)
    robot.set_angles(steering_deg=start.steering_deg, turret_deg=start.turret_deg)


def test_drive_there_and_back(walk: Walk) -> None:
    robot = walk.robot
    moving = robot.move(translation_in=DISTANCE_IN)
    assert moving.moving
    there = walk.until_still()
    # By the encoders: a real robot has no ground truth.
    assert walk.distance_in(there) == pytest.approx(DISTANCE_IN, abs=ENCODER_IN)
    assert there.translation_in_s == 0
    robot.move(translation_in=-DISTANCE_IN)
    assert walk.distance_in(walk.until_still()) < ENCODER_IN


def test_ws_replies_when_the_robot_stands(walk: Walk) -> None:
    robot = walk.robot
    robot.move(translation_in=DISTANCE_IN)
    there = robot.wait_until_still(10)
    assert not there.moving
    assert walk.distance_in(there) == pytest.approx(DISTANCE_IN, abs=ENCODER_IN)
    robot.move(translation_in=-DISTANCE_IN)
    robot.wait_until_still(10)


def test_velocity_is_reported_until_st(walk: Walk) -> None:
    robot = walk.robot
    assert robot.drive(translation_in_s=SLOW_IN_S).translation_in_s > 0
    states = walk.watch(lambda state: walk.distance_in(state) > 1.0)
    assert states[-1].translation_in_s == pytest.approx(SLOW_IN_S, abs=0.3)
    robot.stop()
    still = walk.until_still()
    assert still.translation_in_s == 0
    assert walk.distance_in(still) < DISTANCE_IN
    walk.back()


def test_speed_is_limited(walk: Walk) -> None:
    # 6 in/s are above the limit of the address.
    walk.robot.drive(translation_in_s=6)
    states = walk.watch(lambda state: walk.distance_in(state) > 1.5)
    assert SLOW_IN_S < max(state.translation_in_s for state in states) <= SPEED_IN_S + 0.2
    walk.robot.stop()
    walk.until_still()
    walk.back()


def test_axes_turn_and_return(walk: Walk) -> None:
    robot = walk.robot
    for axis in ("steering", "turret") if robot.model.has_turret else ("steering",):
        before = getattr(walk.until_still(), f"{axis}_deg")
        robot.set_speeds(translation_in_s=SLOW_IN_S, **_turning(robot.model.has_turret))
        robot.move(**{f"{axis}_deg": 30})
        turned = getattr(walk.until_still(), f"{axis}_deg") - before
        assert math.remainder(turned - 30, 360) == pytest.approx(0, abs=ENCODER_DEG)
        robot.move(**{f"{axis}_deg": -30})
        walk.until_still()


def _turning(turret: bool) -> dict[str, float]:
    return {"steering_deg_s": 20, "turret_deg_s": 20} if turret else {}


def test_robot_stops_without_requests(bench: Bench, walk: Walk) -> None:
    """After the program sends conf_tm itself, there is no keep-alive."""
    walk.robot.set_timeout(1)
    walk.robot.drive(translation_in_s=SLOW_IN_S / 2)
    bench.sleep(4.0)
    state = walk.robot.refresh()
    assert (state.translation_in_s, state.moving) == (0, False)
    # It has moved for some of these 4 s, and stopped 1 s after the last request.
    assert 0.3 < walk.distance_in(state) < DISTANCE_IN
    walk.back()


def test_robot_moves_while_program_sleeps(bench: Bench, walk: Walk) -> None:
    walk.robot.drive(translation_in_s=SLOW_IN_S / 2)
    bench.sleep(3.0)
    state = walk.robot.refresh()
    assert state.moving
    assert walk.distance_in(state) > 2.0
    walk.robot.stop()
    walk.until_still()
    walk.back()


def test_exit_stops_the_robot(bench: Bench, walk: Walk) -> None:
    with walk.robot as robot:
        robot.drive(translation_in_s=SLOW_IN_S)
        walk.watch(lambda state: walk.distance_in(state) > 0.5)
    walk.robot = bench.connect()
    assert walk.distance_in(walk.until_still()) < DISTANCE_IN
    walk.back()
