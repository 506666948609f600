"""The live localizer on made-up states: a robot that moves exactly as its encoders report, sonars in whole inches."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import Belief, independent
from localization.filters.update import Refusal
from localization.live.localizer import Localizer
from localization.live.sensor_input import FiringSchedule, SensorData
from nclient.protocol.types import DEFAULT_SONAR_ORDER
from worlds.io import load_world
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150

ROOM = load_world("thesis_room").walls


class Robot:
    """Drives straight at `speed_in_s`, turret at its own angle; the encoders err by a fixed offset."""

    def __init__(self, speed_in_s: float, heading_rad: float = 0.5, turret_rad: float = 0.0) -> None:
        self.speed, self.heading, self.turret = speed_in_s, heading_rad, turret_rad
        self.sonars = [255] * 16
        self.fired = 0

    def pose(self, time_s: float) -> tuple[float, float]:
        distance = self.speed * time_s
        return 20 + distance * math.cos(self.heading), 30 + distance * math.sin(self.heading)

    def report(self, time_s: float) -> SensorData:
        # A firing every 60 ms, as the default ring has; each reading stays until the sonar fires again.
        while self.fired * 0.06 <= time_s + 1e-9:
            self.fire(DEFAULT_SONAR_ORDER[self.fired % 16], self.fired * 0.06)
            self.fired += 1
        x, y = self.pose(time_s)
        return SensorData(time_s, x, y, self.heading % math.tau, self.turret % math.tau, tuple(self.sonars))

    def fire(self, sonar: int, time_s: float) -> None:
        angle = self.turret + N150.sonar_angles_rad[sonar]
        direction = np.array([math.cos(angle), math.sin(angle)])
        reach, _ = cast_rays(np.array(self.pose(time_s)), direction, ROOM)
        # Whole inches from 6 to 255, measured from the ring and not from the centre.
        self.sonars[sonar] = int(min(255, max(6, round(float(reach) - N150.sonar_ring_radius_in))))


def localizer(belief: Belief | None = None) -> Localizer:
    start = belief or independent([20, 30, 0.5], [0.2, 0.2, 0.01])
    return Localizer(LocalizationConfig(ROOM, N150), start, FiringSchedule(0.0))


@pytest.mark.long
@pytest.mark.parametrize("turret_rad", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("speed_in_s", [0.0, 5.0])
def test_wrong_start_is_corrected_while_driving(speed_in_s: float, turret_rad: float) -> None:
    robot = Robot(speed_in_s, turret_rad=turret_rad)
    filtered = localizer(independent([20.6, 29.4, 0.53], [0.6, 0.6, 0.03]))
    for k in range(101):
        estimate = filtered.update(robot.report(0.1 * k))
    error = estimate.pose[:2] - robot.pose(10.0)
    assert np.hypot(*error) < 0.35
    assert abs(estimate.pose[2] - 0.5) < 0.02
    assert (np.abs(estimate.pose - [*robot.pose(10.0), 0.5]) < 4 * estimate.belief.std).all()


def test_each_echo_is_reported_once_with_its_result() -> None:
    robot, filtered = Robot(2.0), localizer()
    echoes = [echo for k in range(60) for echo in filtered.update(robot.report(0.1 * k)).echoes]
    instants = [echo.instant_s for echo in echoes]
    assert instants == sorted(set(instants))
    assert instants[-1] > 5.8
    # The first firing is at the start, before there is an interval of motion to place it in.
    assert [echo.sonar for echo in echoes[:16]] == [*DEFAULT_SONAR_ORDER[1:], 0]
    assert {echo.refusal for echo in echoes} >= {Refusal.NONE}
    assert all(echo.innovation_in == 0 for echo in echoes if echo.refusal is not Refusal.NONE)


def test_limits_are_never_ranges() -> None:
    robot, filtered = Robot(0.0), localizer()
    filtered.update(robot.report(0.0))
    for k in range(1, 20):
        # 6 and 255 mean "nearer" and "no echo", and are no ranges.
        limits = tuple(6 if sonar % 2 else 255 for sonar in range(16))
        estimate = filtered.update(replace(robot.report(0.1 * k), sonars_in=limits))
        assert {echo.refusal for echo in estimate.echoes} <= {Refusal.LIMIT}
    assert estimate.pose == pytest.approx([20, 30, 0.5])


def test_a_reading_off_by_a_foot_is_refused_by_the_gate() -> None:
    robot, filtered = Robot(0.0), localizer()
    filtered.update(robot.report(0.0))
    wrong = tuple(reading + 12 for reading in robot.report(0.5).sonars_in)
    estimate = filtered.update(replace(robot.report(0.5), sonars_in=wrong))
    assert Refusal.GATE in {echo.refusal for echo in estimate.echoes}
    assert Refusal.NONE not in {echo.refusal for echo in estimate.echoes}


def test_a_repeated_or_older_state_changes_nothing() -> None:
    robot, filtered = Robot(3.0), localizer()
    for k in range(20):
        estimate = filtered.update(robot.report(0.1 * k))
    again = filtered.update(robot.report(1.9))
    assert (again.pose == estimate.pose).all()
    assert again.echoes == ()
    older = filtered.update(replace(robot.report(1.9), clock_s=0.3, x_in=0.0))
    assert (older.pose == estimate.pose).all()


def test_a_state_without_a_clock_is_reported_apart() -> None:
    with pytest.raises(ValueError, match="refresh"):
        localizer().update(replace(Robot(0.0).report(0.0), clock_s=None))


def test_odometry_predicts_to_the_clock_of_the_state() -> None:
    robot, filtered = Robot(10.0), localizer(independent([20, 30, 0.5], [1e-6, 1e-6, 1e-6]))
    for k in range(30):
        estimate = filtered.update(robot.report(0.1 * k))
        assert estimate.clock_s == pytest.approx(0.1 * k)
        assert estimate.pose[:2] == pytest.approx(robot.pose(0.1 * k), abs=0.4)


@pytest.mark.long
def test_a_smoothing_method_reports_a_past_belief() -> None:
    robot = Robot(5.0)
    belief = independent([20.4, 29.7, 0.52], [0.5, 0.5, 0.03])
    # The same belief with and without a smoother.
    looking_back = Localizer(LocalizationConfig(ROOM, N150), belief, FiringSchedule(0.0), "smoother")
    plain = localizer(belief)
    looks = []
    for k in range(101):
        estimate = looking_back.update(robot.report(0.1 * k))
        # The smoother changes no live estimate.
        np.testing.assert_array_equal(estimate.pose, plain.update(robot.report(0.1 * k)).pose)
        looks.append(estimate.smoothed)
    first, last = looks[5], looks[-1]
    assert first is not None
    assert last is not None
    assert first.clock_s == 0.0
    # The last smoothed pose is 32 firings (two rounds) behind the newest readable echo.
    assert last.clock_s == pytest.approx(0.06 * (math.floor((10.0 - 0.0164) / 0.06) - 32))
    assert np.hypot(*(last.belief.mean[:2] - robot.pose(last.clock_s))) < 0.3
    assert plain.update(robot.report(10.2)).smoothed is None
