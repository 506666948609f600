"""The infrared ring: steps, reach, history, instants, and that looking changes nothing."""

from __future__ import annotations

from math import cos, radians, sqrt

import numpy as np
import pytest

from nserver_emu.simulation.segments import TIME_MAX_PS, Pose, Stamp
from nserver_emu.simulation.sensors import (
    INFRARED_INTERVAL_PS,
    MANY_WALLS,
    MAX_PENDING,
    NO_INFRARED_NOISE,
    Flash,
    InfraredNoise,
    InfraredRing,
)
from nserver_emu.simulation.visibility import RobotPositions, SensorPose
from worlds.geometry import FloatArray
from worlds.robots import N200

pytestmark = pytest.mark.long

HERE = SensorPose(0.0, 0.0, 0.0)
ALL = tuple(range(16))


def stamp(time_s: float = 0.0) -> Stamp:
    return Stamp(Pose(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), time_s, time_s)


def wall(gap: float, slant_rad: float = 0.0) -> np.ndarray:
    """Before sensor 0, a wall whose point on the axis is that far from the body."""
    middle, direction = np.array([N200.radius_in + gap, 0.0]), np.array([-np.sin(slant_rad), np.cos(slant_rad)])
    return np.array([[*(middle - direction), *(middle + direction)]])


def ring(walls: np.ndarray, noise: InfraredNoise = NO_INFRARED_NOISE) -> InfraredRing:
    return InfraredRing(N200, noise, walls, 0, np.random.default_rng(5))


@pytest.mark.parametrize(("gap", "reading"), [(0.0, 0), (0.4, 0), (7.6, 8), (14.4, 14), (14.6, 15), (24.5, 15)])
def test_readings_are_whole_inches_and_15_is_nothing(gap: float, reading: int) -> None:
    sensors = ring(wall(gap))
    assert sensors.readings == (15,) * 16
    sensors.flash_due(HERE, stamp())
    assert sensors.readings == (reading, *[15] * 15)


def test_the_ring_flashes_every_60_ms_and_is_off_without_sensors() -> None:
    sensors = ring(wall(5.0))
    # Instants in picoseconds, from 7.
    sensors.configure(0, ALL, 7)
    for number in range(3):
        assert sensors.due_ps == 7 + number * INFRARED_INTERVAL_PS
        sensors.flash_due(HERE, stamp(number))
    assert sensors.stamps == (stamp(2),) * 16
    # 255 as the first entry switches the ring off; readings stay.
    sensors.configure(0, (255, 0), 9)
    assert sensors.due_ps == TIME_MAX_PS
    assert sensors.readings[0] == 5


def test_sensors_that_are_not_in_the_order_keep_their_readings() -> None:
    sensors = ring(wall(5.0))
    sensors.configure(0, (1, 2, 255, 0), 0)
    sensors.flash_due(HERE, stamp(3.0))
    assert sensors.readings[0] == 15
    assert [sensors.stamps[number].sensor_time_s for number in (0, 1, 2, 3)] == [0.0, 3.0, 3.0, 0.0]


@pytest.mark.parametrize("history", [0, 3, 9, 10, 12])
def test_history_is_the_weight_of_the_previous_reading(history: int) -> None:
    sensors = ring(wall(5.0))
    sensors.configure(history, ALL, 0)
    share = min(history, 9) / 10
    for flashes in range(1, 8):
        sensors.flash_due(HERE, stamp())
        level = 5.0 + (15.0 - 5.0) * share**flashes
        assert sensors.readings[0] == pytest.approx(level, abs=0.5 + 1e-9)


def test_reading_often_or_late_gives_the_same_values() -> None:
    # A corner of two walls at 20 in, noise of 10 %.
    walls = np.array([[-20.0, -20.0, 20.0, -20.0], [20.0, -20.0, 20.0, 20.0]])
    often, late = ring(walls, InfraredNoise(0.1)), ring(walls, InfraredNoise(0.1))
    for sensors in (often, late):
        sensors.configure(8, ALL, 0)
    # 150 flashes while the robot drives and turns; only one ring is read each time.
    for number in range(150):
        for sensors in (often, late):
            sensors.flash_due(SensorPose(0.01 * number, 0.0, 0.1 * number), stamp())
        seen = often.readings
    assert late.readings == seen


@pytest.mark.parametrize("history", [0, 3])
@pytest.mark.parametrize("walls", [1, MANY_WALLS + 1])
def test_flashes_are_computed_one_at_a_time(history: int, walls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    computed = 0
    honest = InfraredRing._ranges

    def counted(ring: InfraredRing, flash: Flash) -> FloatArray:
        nonlocal computed
        computed += 1
        return honest(ring, flash)

    monkeypatch.setattr(InfraredRing, "_ranges", counted)
    each, unread = (ring(np.repeat(wall(5.0), walls, axis=0), InfraredNoise(0.1)) for _ in range(2))
    for sensors in (each, unread):
        sensors.configure(history, ALL, 0)
    for number in range(40):
        pose, computed = SensorPose(0.1 * number, 0.0, 0.0), 0
        unread.flash_due(pose, stamp())
        assert computed <= 1, "an unread ring causes no long step"
        each.flash_due(pose, stamp())
        assert len(each.readings) == 16
        # The other ring in parts, now and then.
        before = computed
        if number % 7 == 0:
            parts = 0
            while not unread.compute_some():
                parts += 1
            assert computed == before + parts <= before + MAX_PENDING
            assert unread.readings == each.readings
    assert unread.readings == each.readings


def test_a_flash_meets_the_walls_of_its_instant_and_other_robots() -> None:
    sensors = ring(wall(5.0))
    sensors.flash_due(HERE, stamp())
    sensors.set_walls(np.empty((0, 4)))
    assert sensors.readings[0] == 5
    others = np.array([[0.0, 0.0, 9.0], [26.0, 0.0, 9.0]])
    sensors.flash_due(SensorPose(0.0, 0.0, 0.0, RobotPositions(others), 0), stamp())
    assert sensors.readings[0] == 8


def test_slanted_walls_appear_farther_and_ranges_are_noisy() -> None:
    # At a slant the reflected light decreases with the cosine; range is measured by its square root.
    slant = radians(50.0)
    sensors = ring(wall(8.0, slant), InfraredNoise(slanted=True))
    sensors.flash_due(HERE, stamp())
    assert sensors.readings[0] == round(8.0 / sqrt(cos(slant)))
    noisy = ring(wall(8.0), InfraredNoise(range_std_relative=0.1))
    readings = []
    for _ in range(2000):
        noisy.flash_due(HERE, stamp())
        readings.append(noisy.readings[0])
    # Mean and variance of 2000 readings: noise of 0.8 in and rounding to whole numbers.
    assert np.mean(readings) == pytest.approx(8.0, abs=0.08)
    assert np.var(readings) == pytest.approx(0.8**2 + 1.0 / 12.0, rel=0.15)


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_of_walls_and_robots_counts_at_its_own_slant(seed: int) -> None:
    """Against every ray by itself: a quadratic for each robot, Cramer's rule for each wall."""
    rng = np.random.default_rng(seed)
    # Five robots around the sensor, about 72 degrees apart.
    angles, aways = 0.4 * np.pi * np.arange(5) + rng.uniform(-0.3, 0.3, 5), rng.uniform(22.0, 34.0, 5)
    others = np.stack((aways * np.cos(angles), aways * np.sin(angles), rng.uniform(6.0, 9.5, 5)), axis=1)
    # The robot itself is the third disc and must be left out.
    discs = np.insert(others, 2, (0.0, 0.0, N200.radius_in), axis=0)
    walls = np.array([[-30.0, -25.0, 30.0, -28.0], [30.0, -28.0, 25.0, 30.0], [-20.0, 33.0, -28.0, -25.0]])
    sensors = ring(walls, InfraredNoise(slanted=True))
    turret = rng.uniform(-3.0, 3.0)
    sensors.flash_due(SensorPose(0.0, 0.0, turret, RobotPositions(discs), 2), stamp())
    for number, reading in enumerate(sensors.readings):
        direction = np.array([cos(turret + number * radians(22.5)), np.sin(turret + number * radians(22.5))])
        met = [(float("inf"), 1.0)]
        # Each robot by the quadratic formula.
        for x, y, radius in others:
            ahead = float(direction @ (x, y))
            root = ahead**2 - x * x - y * y + radius**2
            if root >= 0.0 < ahead:
                met.append((ahead - sqrt(root), sqrt(root) / radius))
        # Each wall by Cramer's rule, with its cosine of incidence.
        for x1, y1, x2, y2 in walls:
            far, share = np.linalg.solve([[direction[0], x1 - x2], [direction[1], y1 - y2]], [x1, y1])
            if far > 0.0 and 0.0 <= share <= 1.0:
                met.append((far, abs(float(direction @ (y1 - y2, x2 - x1))) / float(np.hypot(x2 - x1, y2 - y1))))
        far, cosine = min(met)
        # Slanted surfaces seem farther; beyond 24 in there is no reflection.
        seen = (far - N200.radius_in) / sqrt(cosine)
        assert reading == (round(min(seen, 15.0)) if seen <= 24.0 else 15)
