"""The arm as a device: it moves between its ends, at its speeds, by the closed form of a trapezoid."""

from __future__ import annotations

import pytest

from nserver_emu.simulation.axis import GRIP_TRAVEL_IN, LIFT_TRAVEL_IN, Arm, Command


def test_a_lift_moves_in_the_time_of_a_trapezoid() -> None:
    arm = Arm()
    arm.lift.command(Command.RELATIVE, 20.0)
    seconds = 20.0 / 5.0 + 5.0 / 10.0
    arm.advance_to(seconds - 0.01)
    assert not arm.is_still()
    assert arm.is_still(lift=False)
    arm.advance_to(seconds + 0.01)
    assert arm.is_still()
    assert arm.lift.position_in == pytest.approx(20.0)


@pytest.mark.parametrize(("distance_in", "end_in"), [(999.0, LIFT_TRAVEL_IN), (-5.0, 0.0)])
def test_a_relative_target_stays_between_the_ends(distance_in: float, end_in: float) -> None:
    arm = Arm()
    arm.lift.command(Command.RELATIVE, distance_in)
    arm.advance_to(60.0)
    assert arm.is_still()
    assert arm.lift.position_in == pytest.approx(end_in)


def test_a_velocity_ends_at_the_end() -> None:
    arm = Arm()
    arm.grip.command(Command.VELOCITY, 1.0)
    arm.advance_to(2.0)
    assert 0.0 < arm.grip.position_in < GRIP_TRAVEL_IN
    for second in range(3, 10):
        arm.advance_to(float(second))
    assert arm.grip.position_in == GRIP_TRAVEL_IN
    assert arm.is_still()


def test_zero_brings_both_home_even_at_speed_0() -> None:
    arm = Arm()
    for slide in (arm.lift, arm.grip):
        slide.command(Command.RELATIVE, 3.0)
    arm.advance_to(10.0)
    arm.lift.command(Command.SPEED, 0.0)
    arm.zero()
    arm.advance_to(20.0)
    assert arm.is_still()
    assert (arm.lift.position_in, arm.grip.position_in) == pytest.approx((0.0, 0.0), abs=1e-9)
