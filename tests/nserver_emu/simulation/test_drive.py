"""The drives: what their axes do to path and angles."""

from __future__ import annotations

from math import cos, degrees, hypot, inf, pi, radians, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nserver_emu.simulation.drive import DifferentialDrive, SynchroDrive
from nserver_emu.simulation.models import N150, SCOUT, SCOUT_TRACK_IN
from nserver_emu.simulation.segments import ConstantAccelerationSegment


def drive(ramps: bool = False) -> SynchroDrive:
    return SynchroDrive(N150.axes, ramps)


def test_segments_end_where_an_axis_changes_acceleration() -> None:
    wheels = drive()
    # At rest the segment lasts as long as requested.
    assert wheels.segment(5.0) == ConstantAccelerationSegment(5.0, 0.0, 0.0, 0.0, 0.0)
    # 10 in backwards at 20 in/s: half a second.
    wheels.translation.move_by(-10.0)
    wheels.steering.move_at(0.5)
    assert wheels.segment(5.0) == ConstantAccelerationSegment(0.5, -20.0, 0.0, 0.5, 0.0)
    assert wheels.segment(0.1).duration_s == 0.1
    ramped = drive(ramps=True)
    # 25 degrees per second at 50 degrees per second squared: half a second of ramp.
    ramped.steering.move_at(radians(25.0))
    assert ramped.segment(inf) == pytest.approx((0.5, 0.0, 0.0, 0.0, radians(50.0)))


def test_the_turret_does_not_cut_the_path() -> None:
    wheels = drive()
    wheels.turret.move_by(0.1)
    assert wheels.segment(5.0).duration_s == 5.0


def test_angles_follow_their_axes() -> None:
    wheels = drive()
    wheels.set_angles(1.0, -2.0)
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
def test_zero_is_sought_along_the_shorter_arc(steering: float) -> None:
    wheels = drive()
    wheels.set_angles(steering, -steering)
    # Slow steering, a turret without a speed of its own: it uses its top speed.
    wheels.steering.set_speed(0.3)
    wheels.turret.set_speed(0.0)
    wheels.translation.move_at(5.0)
    # Translation stops before the axes seek zero.
    wheels.seek_zero()
    assert not wheels.translation.moving
    assert abs(wheels.steering.velocity) == (0.3 if steering else 0.0)
    assert abs(wheels.turret.velocity) == (N150.axes[2].top_speed if steering else 0.0)
    # At most half a turn, at 0.3 rad/s.
    wheels.advance(pi / 0.3 + 1e-6)
    for angle in (wheels.steering_rad, wheels.turret_rad):
        assert angle % (2.0 * pi) == pytest.approx(0.0, abs=1e-9) or angle % (2.0 * pi) == pytest.approx(2.0 * pi)
    assert abs(wheels.steering_rad - steering) <= pi + 1e-9
    assert not any(axis.moving for axis in wheels.axes)
    # Afterwards both angles read zero.
    wheels.finish_zero()
    assert (wheels.steering_rad, wheels.turret_rad) == (0.0, 0.0)


def two_wheels(right: float, left: float, ramps: bool = False) -> DifferentialDrive:
    """Return a Scout's drive with these wheel speeds."""
    wheels = DifferentialDrive(SCOUT.axes, ramps, SCOUT_TRACK_IN)
    wheels.right.move_at(right)
    wheels.left.move_at(left)
    return wheels


def displacement_of(wheels: DifferentialDrive, span_s: float) -> tuple[float, float, float]:
    """(x, y, heading) after so long, by the stretches that the drive hands out."""
    x = y = 0.0
    # Follow the segments until the time is over.
    while span_s > 1e-12:
        segment = wheels.segment(span_s)
        dx, dy = segment.displacement(wheels.steering_rad, segment.duration_s)
        x, y = x + dx, y + dy
        assert wheels.steering_rad + segment.turn_at(segment.duration_s) == pytest.approx(
            advanced(wheels, segment.duration_s), abs=1e-9
        )
        span_s -= segment.duration_s
    return x, y, wheels.steering_rad


def advanced(wheels: DifferentialDrive, span_s: float) -> float:
    wheels.advance(span_s)
    return wheels.steering_rad


def marched(right: float, left: float, span_s: float, ramp: float, steps: int = 20000) -> tuple[float, float, float]:
    """The same by the midpoint rule in tiny steps, from wheels that ramp up each on its own: slow and plain."""
    x = y = heading = 0.0
    dt = span_s / steps
    for step in range(steps):
        # The velocity of each wheel ramps up to its command.
        time = (step + 0.5) * dt
        v_right = min(abs(right), ramp * time) * (1.0 if right > 0.0 else -1.0)
        v_left = min(abs(left), ramp * time) * (1.0 if left > 0.0 else -1.0)
        # 13.5902 in is the track of a Scout.
        turn = (v_right - v_left) / 13.5902 * dt
        distance = 0.5 * (v_right + v_left) * dt
        # Midpoint rule: the direction in the middle of the step.
        x += distance * cos(heading + 0.5 * turn)
        y += distance * sin(heading + 0.5 * turn)
        heading += turn
    return x, y, heading


def test_a_degree_on_the_spot_is_the_rate_constant_of_a_wheel() -> None:
    wheels = DifferentialDrive(SCOUT.axes, False, SCOUT_TRACK_IN)
    wheels.right.move_by(90.0 * 0.118597)
    wheels.left.move_by(-90.0 * 0.118597)
    assert displacement_of(wheels, 5.0) == pytest.approx((0.0, 0.0, radians(90.0)), abs=1e-9)


@pytest.mark.parametrize(("right", "left"), [(10.0, 6.0), (-10.0, 6.0), (3.0, -8.0), (0.0, 5.0), (7.0, 7.0)])
def test_constant_wheel_speeds_draw_the_arc(right: float, left: float) -> None:
    x, y, heading = displacement_of(two_wheels(right, left), 1.5)
    assert heading == pytest.approx((right - left) / SCOUT_TRACK_IN * 1.5)
    if right == left:
        assert (x, y) == (10.5, 0.0)
        return
    radius = 0.5 * SCOUT_TRACK_IN * (right + left) / (right - left)
    assert (x, y) == pytest.approx((radius * sin(heading), radius * (1.0 - cos(heading))), abs=1e-12)
    assert hypot(x, y - radius) == pytest.approx(abs(radius))


@settings(max_examples=12)
@given(st.floats(1.0, 39.0), st.floats(1.0, 39.0), st.booleans(), st.booleans(), st.floats(0.2, 2.5))
def test_ramps_follow_a_slow_march(right: float, left: float, back_r: bool, back_l: bool, span: float) -> None:
    right, left = (-right if back_r else right), (-left if back_l else left)
    expected = marched(right, left, span, ramp=30.0)
    assert displacement_of(two_wheels(right, left, ramps=True), span) == pytest.approx(expected, abs=2e-3)


def test_segments_end_where_the_robot_reverses() -> None:
    wheels = two_wheels(20.0, 4.0, ramps=True)
    # After 2 s both wheels have their speed: 20 and 4 in/s, mean 12.
    wheels.advance(2.0)
    # The right wheel reverses at 30 in/s^2: the mean decelerates with 15.
    wheels.right.move_at(-20.0)
    segment = wheels.segment(5.0)
    assert segment.velocity_at(segment.duration_s) >= 0.0
    # After 20/30 s the right wheel stands.
    assert (segment.duration_s, segment.speed, segment.acceleration) == pytest.approx((20.0 / 30.0, 12.0, -15.0))
    wheels.advance(segment.duration_s)
    # Then the mean passes zero, when the right wheel has -4 in/s.
    assert wheels.segment(5.0).duration_s == pytest.approx(4.0 / 30.0, abs=1e-9)
    wheels.advance(4.0 / 30.0)
    # The rest of the ramp, to -20 in/s.
    assert wheels.segment(5.0).duration_s == pytest.approx(16.0 / 30.0, abs=1e-9)


def test_steering_turret_and_bumpers_are_the_heading() -> None:
    wheels = two_wheels(5.0, 0.0)
    wheels.set_angles(0.5, 2.0)
    assert wheels.feasible_angles(0.5, 2.0) == (0.5, 0.5)
    assert wheels.steering_rad == wheels.turret_rad == wheels.bumper_frame_rad == 0.5


def test_a_blocked_scout_stops_both_wheels() -> None:
    wheels = two_wheels(5.0, -3.0)
    wheels.axes[2].move_at(10.0)
    wheels.axes[2].move_by(10.0)
    assert [axis.moving for axis in wheels.axes] == [True, True, False]
    wheels.block()
    assert [axis.moving for axis in wheels.axes] == [False, False, False]


def test_a_scout_has_no_zero_to_seek() -> None:
    wheels = two_wheels(5.0, 4.0)
    wheels.set_angles(radians(30.0), 0.0)
    wheels.seek_zero()
    wheels.finish_zero()
    assert not any(axis.moving for axis in wheels.axes)
    assert degrees(wheels.steering_rad) == pytest.approx(30.0)
