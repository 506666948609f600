"""The ring: order, instants, limits, noise, and that looking changes nothing."""

from __future__ import annotations

from math import cos, inf, radians, sin

import numpy as np
import pytest

from nclient.protocol.types import DEFAULT_SONAR_ORDER as DEFAULT_ORDER
from nserver_emu.simulation.acoustics import Ping
from nserver_emu.simulation.segments import TIME_MAX_PS, Pose, Stamp, to_ps
from nserver_emu.simulation.sonar import SonarNoise, SonarRing, ranges_from_axis
from nserver_emu.simulation.visibility import MAX_ROBOT_RANGE_IN, RobotPositions, SensorPose
from worlds.raycast_arrays import cast_discs
from worlds.robots import N150

OFF = 255
SQUARE = np.array(
    [
        [-100.0, -100.0, 100.0, -100.0],
        [100.0, -100.0, 100.0, 100.0],
        [100.0, 100.0, -100.0, 100.0],
        [-100.0, 100.0, -100.0, -100.0],
    ]
)
HERE = SensorPose(0.0, 0.0, 0.0)


def stamp(time_s: float = 0.0) -> Stamp:
    return Stamp(Pose(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), time_s, time_s)


def ring(noise: SonarNoise | None = None, walls: np.ndarray = SQUARE) -> SonarRing:
    return SonarRing(N150, noise or SonarNoise(), walls, np.random.default_rng(5))


def fire(sonars: SonarRing, until_s: float) -> list[tuple[int, int]]:
    """Let the ring fire until then; which sonar was stamped when, in milliseconds."""
    fired = []
    while sonars.due_ps <= to_ps(until_s):
        now = sonars.due_ps // 10**9
        sonars.emit_due(HERE, stamp(now / 1000.0))
        fired.append((next(i for i, s in enumerate(sonars.stamps) if s.sensor_time_s == now / 1000.0), now))
    return fired


def test_entry_k_fires_rate_times_4_ms_times_k_later() -> None:
    sonars = ring()
    sonars.configure(15, DEFAULT_ORDER, to_ps(0.5))
    fired = fire(sonars, 0.5 + 17 * 0.06)
    assert fired == [(DEFAULT_ORDER[k % 16], 500 + 60 * k) for k in range(18)]


@pytest.mark.parametrize(("rate", "interval_ms"), [(1, 4), (0, 4), (-3, 4), (255, 1020), (1000, 1020)])
def test_rates_are_clamped(rate: int, interval_ms: int) -> None:
    sonars = ring()
    sonars.configure(rate, (3, 4, OFF, 7), to_ps(1.0))
    assert fire(sonars, 1.0 + 2.5e-3 * interval_ms) == [(3, 1000), (4, 1000 + interval_ms), (3, 1000 + 2 * interval_ms)]


@pytest.mark.parametrize("order", [(), (255, 0, 1), (-1,), (16, 0)])
def test_an_empty_order_switches_the_ring_off(order: tuple[int, ...]) -> None:
    sonars = ring()
    sonars.emit_all(HERE, stamp())
    before = sonars.readings_in
    sonars.configure(15, order, 0)
    assert sonars.due_ps == TIME_MAX_PS
    assert sonars.readings_in == before != (255.0,) * 16


def test_readings_are_whole_inches_from_the_ring() -> None:
    sonars = ring()
    assert sonars.readings_in == (255.0,) * 16
    # Off the centre, the walls of the square are at 100 in.
    turret, x, y = radians(10.0), 20.0, -30.0
    sonars.emit_all(SensorPose(x, y, turret), stamp())
    for number, reading in enumerate(sonars.readings_in):
        along_ray = turret + radians(22.5) * number
        # Distance to the next wall in x and in y; the nearer one counts.
        to_x = (100.0 * np.sign(cos(along_ray)) - x) / cos(along_ray)
        to_y = (100.0 * np.sign(sin(along_ray)) - y) / sin(along_ray)
        assert reading == round(min(to_x, to_y) - 9.06)


@pytest.mark.parametrize(
    ("gap", "reading"), [(0.5, 6), (5.9, 6), (6.4, 6), (6.6, 7), (254.4, 254), (254.6, 255), (300.0, 255)]
)
def test_limits(gap: float, reading: int) -> None:
    x = 9.06 + gap
    sonars = ring(walls=np.array([[x, -1.0, x, 1.0]]))
    sonars.emit_all(HERE, stamp())
    assert sonars.readings_in == (reading, *[255] * 15)
    assert all(type(value) is int for value in sonars.readings_in)


@pytest.mark.long
def test_noise_has_its_standard_deviation() -> None:
    # 1 % of the range, 0.05 in at least.
    noise = SonarNoise(range_std_relative=0.01, range_std_floor_in=0.05)
    assert (noise.std_in(1.0), noise.std_in(200.0)) == (0.05, 2.0)
    sonars = ring(noise, walls=SQUARE * 2.0)
    readings = []
    # A wall at 200 in: std 1.91 in; the mean of 4000 is accurate to 0.03 in.
    for _ in range(4000):
        sonars.emit_all(HERE, stamp())
        readings.append(sonars.readings_in[0])
    assert np.mean(readings) == pytest.approx(200.0 - 9.06, abs=0.13)
    # Variance of the noise and of rounding to whole inches.
    assert np.var(readings) == pytest.approx(1.9094**2 + 1.0 / 12.0, rel=0.1)
    # No echo: no noise either.
    nothing = ring(noise, walls=np.empty((0, 4)))
    nothing.emit_all(HERE, stamp())
    assert nothing.readings_in == (255,) * 16


def test_reading_often_or_late_gives_the_same_values() -> None:
    noise = SonarNoise(range_std_relative=0.05)
    often, late = ring(noise), ring(noise)
    # A full ring takes 16 x 60 ms.
    for sonars in (often, late):
        sonars.configure(15, DEFAULT_ORDER, 0)
    # One ring is read each time, the other at the end only.
    for number in range(40):
        for sonars in (often, late):
            sonars.emit_due(SensorPose(number, -number, 0.1 * number), stamp(number))
        seen = often.readings_in
    assert late.readings_in == seen
    assert late.stamps == often.stamps


def test_an_echo_meets_the_walls_of_its_instant() -> None:
    sonars = ring()
    sonars.emit_all(HERE, stamp())
    sonars.set_walls(np.empty((0, 4)))
    assert sonars.readings_in[0] == 91
    sonars.emit_all(HERE, stamp())
    assert sonars.readings_in[0] == 255


def test_sensors_detect_robots_in_range_and_on_rays() -> None:
    rng = np.random.default_rng(3)
    # 80 robots in 1800 in x 1800 in; the sensor belongs to number 7.
    discs = np.column_stack((rng.uniform(-900.0, 900.0, (80, 2)), rng.uniform(5.0, 60.0, 80)))
    sensor_pose = SensorPose(float(discs[7, 0]), float(discs[7, 1]) + 0.2, 0.0, RobotPositions(discs), 7)
    # A robot alone sees no other.
    assert len(SensorPose(0.0, 0.0, 0.0, RobotPositions(discs[:1]), 0).others) == 0
    # Robots beyond the range are left out, the own one too.
    far = np.abs(discs[:, :2] - (sensor_pose.x_in, sensor_pose.y_in)).max(axis=1) > MAX_ROBOT_RANGE_IN
    np.testing.assert_array_equal(
        sensor_pose.others, [disc for row, disc in enumerate(discs) if row != 7 and not far[row]]
    )
    assert far.any()
    # 13 rays around meet the first robot, or the wall in front of it.
    here = sensor_pose.x_in, sensor_pose.y_in
    for angle in np.linspace(0.0, 6.0, 13).tolist():
        ray = Ping(*here, angle, 0, (0.0,))
        direction = cos(angle), sin(angle)
        to_robot = float(cast_discs(here, direction, np.delete(discs, 7, axis=0)))
        for wall_in in (0.0, 90.0, 300.0, inf):
            wall = [] if wall_in == inf else [wall_across(here, direction, wall_in)]
            [found] = ranges_from_axis([ray], [sensor_pose], np.array(wall).reshape(-1, 4))
            assert found == pytest.approx(min(wall_in, to_robot)) or to_robot > MAX_ROBOT_RANGE_IN - 60.0
        alone = SensorPose(*here, 0.0, RobotPositions(), 0)
        assert ranges_from_axis([ray], [alone], np.empty((0, 4))) == [inf]


def wall_across(
    here: tuple[float, float], direction: tuple[float, float], range_in: float
) -> tuple[float, float, float, float]:
    """Return a wall of 2 in at right angles to a ray."""
    (x, y), (dx, dy) = here, direction
    return (x + range_in * dx - dy, y + range_in * dy + dx, x + range_in * dx + dy, y + range_in * dy - dx)



def test_pings_are_forgotten_when_a_robot_is_placed() -> None:
    sonars = ring()
    before = sonars.pings
    assert before == (None,) * 16
    # Sonars 3 and 4 in turn, fired at three places.
    sonars.configure(15, (3, 4, OFF), 0)
    for x, turret in ((0.0, 0.0), (7.0, 0.5), (9.0, 0.75)):
        sonars.emit_due(SensorPose(x, -x, turret), stamp())
    step = radians(22.5)
    poses = {k: (ping.x_in, ping.y_in, ping.direction_rad) for k, ping in enumerate(sonars.pings) if ping}
    # Each ping has the pose at which it was fired last.
    assert poses == {3: (9.0, -9.0, 0.75 + 3 * step), 4: (7.0, -7.0, 0.5 + 4 * step)}
    for k, (x, y, along_ray) in poses.items():
        to_x = (100.0 * np.sign(cos(along_ray)) - x) / cos(along_ray)
        to_y = (100.0 * np.sign(sin(along_ray)) - y) / sin(along_ray)
        assert sonars.readings_in[k] == round(min(to_x, to_y) - 9.06)
    # Placing forgets pings, not readings.
    readings = sonars.readings_in
    sonars.forget_pings()
    assert (sonars.pings, sonars.readings_in) == ((None,) * 16, readings)
    # The next firing is that of sonar 4.
    sonars.emit_due(HERE, stamp())
    assert [k for k, ping in enumerate(sonars.pings) if ping] == [4]
