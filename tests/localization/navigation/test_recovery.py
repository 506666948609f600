"""Driving without an estimate: a scan in place, then straight on while the sonars ahead are free."""

from __future__ import annotations

import math

import pytest

from localization.live.sensor_input import SensorData
from localization.navigation.control_law import FREE_S, MAX_DRIVE_IN_S, SCAN_RAD, TURN_RAD_S, RecoveryBehavior

PERIOD_S = 0.1


def ring(readings: tuple[int, ...], turret_rad: float = 1.0) -> SensorData:
    return SensorData(0.0, 0.0, 0.0, 1.0, turret_rad, readings)


def near(*sonars: int) -> tuple[int, ...]:
    return tuple(10 if sonar in sonars else 255 for sonar in range(16))


@pytest.mark.parametrize(("readings", "speed_in_s"), [
    (near(), MAX_DRIVE_IN_S), (near(0), 0.0), (near(15), 0.0), (near(8), MAX_DRIVE_IN_S),
])  # fmt: skip
def test_recovery_scans_then_drives_if_space_ahead_is_free(
    readings: tuple[int, ...], speed_in_s: float
) -> None:
    echo, one = ring(readings), RecoveryBehavior(PERIOD_S)
    # First a scan of all directions in place.
    turning = [one.command(echo) for _ in range(round(SCAN_RAD / TURN_RAD_S / PERIOD_S))]
    assert set(turning) == {(0.0, TURN_RAD_S)}
    # Then straight on, if the sonars ahead are free.
    one.command(echo)
    assert one.command(echo)[0] == speed_in_s
    # Reset: the scan begins again.
    one.reset()
    assert one.command(echo) == (0.0, TURN_RAD_S)


def test_space_ahead_follows_steering_not_turret() -> None:
    one = RecoveryBehavior(100.0)
    one.command(ring(near()))
    assert one.command(ring(near(8), 1.0 + 3.14159))[0] == 0.0
    assert one.command(ring(near(0), 1.0 + 3.14159))[0] == MAX_DRIVE_IN_S


def test_walls_beside_the_lane_do_not_slow_the_robot() -> None:
    """A corridor of 78 in: the sonars at 45 degrees measure 45 in, and 32 in to the side; those beside it less."""
    corridor = tuple({2: 45, 14: 45, 3: 33, 13: 33, 4: 30, 12: 30}.get(sonar, 255) for sonar in range(16))
    narrow = tuple({1: 40, 15: 40}.get(sonar, 255) for sonar in range(16))
    for readings, speed_in_s in ((corridor, MAX_DRIVE_IN_S), (narrow, 40.0 * math.cos(math.tau / 16) / FREE_S)):
        one = RecoveryBehavior(100.0)
        one.command(ring(readings))
        assert one.command(ring(readings))[0] == pytest.approx(speed_in_s)
