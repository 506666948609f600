"""The synchro drive: what its axes do to path and angles."""

from __future__ import annotations

from math import inf, pi, radians

import pytest

from nserver_emu.simulation.drive import SynchroDrive
from nserver_emu.simulation.models import N150
from nserver_emu.simulation.stretch import Stretch


def drive(ramps: bool = False) -> SynchroDrive:
    return SynchroDrive(N150.axes, ramps)


def test_a_stretch_ends_where_a_wheel_changes_its_acceleration() -> None:
    wheels = drive()
    assert wheels.stretch(5.0) == Stretch(5.0, 0.0, 0.0, 0.0, 0.0)
    wheels.translation.move_by(-10.0)
    wheels.steering.move_at(0.5)
    assert wheels.stretch(5.0) == Stretch(0.5, -20.0, 0.0, 0.5, 0.0)
    assert wheels.stretch(0.1).duration_s == 0.1
    ramped = drive(ramps=True)
    ramped.steering.move_at(radians(25.0))
    assert ramped.stretch(inf) == pytest.approx((0.5, 0.0, 0.0, 0.0, radians(50.0)))


def test_the_turret_does_not_cut_the_path() -> None:
    wheels = drive()
    wheels.turret.move_by(0.1)
    assert wheels.stretch(5.0).duration_s == 5.0


def test_angles_follow_their_axes() -> None:
    wheels = drive()
    wheels.put(1.0, -2.0)
    wheels.steering.move_at(0.5)
    wheels.turret.move_by(0.25)
    wheels.advance(2.0)
    assert (wheels.steering_rad, wheels.turret_rad) == pytest.approx((2.0, -1.75))
    assert wheels.bumper_frame_rad == 0.0


def test_a_blocked_drive_still_steers() -> None:
    wheels = drive()
    for axis in wheels.axes:
        axis.move_at(0.5)
    wheels.block()
    assert [axis.moving for axis in wheels.axes] == [False, True, True]


@pytest.mark.parametrize("steering", [0.0, 0.4, -0.4, pi + 0.1, 9.0 * pi])
def test_zero_is_sought_the_short_way(steering: float) -> None:
    wheels = drive()
    wheels.put(steering, -steering)
    wheels.steering.set_speed(0.3)
    wheels.turret.set_speed(0.0)
    wheels.translation.move_at(5.0)
    wheels.seek_zero()
    assert not wheels.translation.moving
    assert abs(wheels.steering.velocity) == (0.3 if steering else 0.0)
    assert abs(wheels.turret.velocity) == (N150.axes[2].top_speed if steering else 0.0)
    wheels.advance(pi / 0.3 + 1e-6)
    for angle in (wheels.steering_rad, wheels.turret_rad):
        assert angle % (2.0 * pi) == pytest.approx(0.0, abs=1e-9) or angle % (2.0 * pi) == pytest.approx(2.0 * pi)
    assert abs(wheels.steering_rad - steering) <= pi + 1e-9
    assert not any(axis.moving for axis in wheels.axes)
    wheels.found_zero()
    assert (wheels.steering_rad, wheels.turret_rad) == (0.0, 0.0)
