"""Axes against the closed form of trapezoids, against sums of fine steps, and in steps of any size."""

from __future__ import annotations

from math import inf, sqrt

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nserver_emu.simulation.axis import TIME_TOLERANCE_S, Axis, AxisLimits, Mode

LIMITS = AxisLimits(
    top_speed=20.0, top_acceleration=60.0, min_acceleration=0.1, speed=20.0, acceleration=30.0, resolution=0.1
)


def instant() -> Axis:
    return Axis(LIMITS, ramps=False)


def ramped(speed: float = 20.0, acceleration: float = 30.0, velocity: float = 0.0) -> Axis:
    """An axis with ramps that already runs at `velocity`."""
    axis = Axis(LIMITS, ramps=True)
    axis.set_speed(speed)
    axis.set_acceleration(acceleration)
    axis.move_at(velocity)
    axis.advance(1e4 if velocity else 0.0)
    return axis


def test_instant_velocity_lasts_until_the_next_command() -> None:
    axis = instant()
    axis.move_at(-12.5)
    assert (axis.moving, axis.velocity, axis.shown_velocity) == (True, -12.5, -12.5)
    assert axis.advance(100.0) == pytest.approx(-1250.0)
    axis.stop()
    assert (axis.moving, axis.velocity, axis.shown_velocity) == (False, 0.0, 0.0)
    assert axis.advance(1.0) == 0.0


def test_instant_relative_ends_exactly_on_its_target() -> None:
    axis = instant()
    axis.set_speed(8.0)
    axis.move_by(-10.0)
    assert (axis.mode, axis.shown_velocity) == (Mode.RELATIVE, -8.0)
    # 10 in at 8 in/s take 1.25 s: 8 in in the first second, 2 in after it.
    assert axis.current_phase[0] == pytest.approx(1.25)
    assert axis.advance(1.0) == pytest.approx(-8.0)
    assert axis.moving
    assert axis.advance(1.0) == pytest.approx(-2.0)
    assert (axis.moving, axis.mode, axis.shown_velocity) == (False, Mode.HOLD, 0.0)


@pytest.mark.parametrize(("distance", "speed"), [(60.0, 20.0), (-60.0, 15.0), (3.0, 20.0), (-0.01, 20.0)])
def test_trapezoid_takes_the_time_of_the_closed_form(distance: float, speed: float) -> None:
    rate = 30.0
    axis = ramped(speed, rate)
    axis.move_by(distance)
    # The distance of accelerating and braking at full speed: v^2 / a.
    full = speed * speed / rate
    # Trapezoid: d / v + v / a; triangle without a phase of constant speed: 2 sqrt(d / a).
    expected = abs(distance) / speed + speed / rate if abs(distance) > full else 2.0 * sqrt(abs(distance) / rate)
    # A microsecond before the end it still moves, a microsecond after it does not.
    assert axis.advance(expected - 1e-6) == pytest.approx(distance, abs=1e-9)
    assert axis.moving
    axis.advance(2e-6)
    assert not axis.moving


def test_velocity_ramp_is_half_a_t_squared() -> None:
    axis = ramped(acceleration=30.0)
    axis.move_at(15.0)
    # s = a t^2 / 2 until the speed of 15 in/s at 0.5 s.
    assert axis.advance(0.25) == pytest.approx(0.5 * 30.0 * 0.25**2)
    assert axis.velocity == pytest.approx(7.5)
    assert axis.current_phase[2] == 30.0
    # The rest of the ramp, and one second at constant speed.
    assert axis.advance(1.25) == pytest.approx(0.5 * 30.0 * (0.5**2 - 0.25**2) + 15.0)
    assert axis.current_phase[2] == 0.0
    axis.stop()
    assert axis.moving
    # Braking distance: v^2 / (2 a).
    assert axis.advance(10.0) == pytest.approx(15.0**2 / 60.0)


motions = st.tuples(st.floats(-20.0, 20.0), st.floats(-40.0, 40.0), st.floats(2.0, 20.0), st.floats(1.0, 60.0))


@settings(max_examples=60)
@given(motions)
@example((0.0, 2.00001, 2.0, 2.00001))  # its last phase ends within the tolerance
def test_ramps_keep_speed_and_acceleration_and_reach_the_target(motion: tuple[float, float, float, float]) -> None:
    start, distance, speed, rate = motion
    axis = ramped(speed, rate, velocity=start)
    axis.move_by(distance)
    dt, here, farthest, before = 1e-2, 0.0, 0.0, axis.velocity
    # Each step of 10 ms keeps the limits, whatever the motion.
    while axis.moving:
        moved = axis.advance(dt)
        now = axis.velocity
        # No more than the acceleration allows.
        assert abs(now - before) <= rate * (dt + TIME_TOLERANCE_S) + 1e-12
        assert abs(now) <= max(speed, abs(start)) + 1e-9
        # The distance is that of the mean speed.
        assert abs(moved - 0.5 * (before + now) * dt) <= rate * dt * dt
        assert axis.moving == (axis.shown_velocity != 0.0)
        here += moved
        farthest = max(farthest, (here - distance) * (1.0 if distance > 0.0 else -1.0))
        before = now
    assert here == pytest.approx(distance, abs=1e-9)
    # Unless it starts too fast to stop in time, it never passes the target.
    if abs(distance) > start * start / (2.0 * rate) or start * distance < 0.0:
        assert farthest <= 1e-9


@settings(max_examples=60)
@given(motions, st.lists(st.floats(0.0, 1.0), max_size=30), st.booleans())
def test_step_size_changes_nothing(
    motion: tuple[float, float, float, float], cuts: list[float], ramps: bool
) -> None:
    start, distance, speed, rate = motion
    whole, cut = (ramped(speed, rate, velocity=start) for _ in range(2))
    # The same motion in one step and in pieces.
    for axis in (whole, cut):
        axis.ramps = ramps
        axis.move_by(distance)
    pieces = sum(cut.advance(dt) for dt in cuts)
    assert whole.advance(sum(cuts)) == pytest.approx(pieces, abs=1e-9)
    if whole.moving and cut.moving:
        assert whole.velocity == pytest.approx(cut.velocity, abs=1e-6)


def test_a_target_inside_the_braking_distance_is_overshot() -> None:
    axis = ramped(20.0, 10.0, velocity=20.0)
    axis.move_by(5.0)
    brake = axis.advance(2.0)
    assert brake == pytest.approx(20.0)
    assert axis.velocity == pytest.approx(0.0, abs=1e-9)
    assert axis.advance(100.0) == pytest.approx(-15.0)


def test_a_lower_speed_is_ramped_down_to() -> None:
    axis = ramped(5.0, 10.0, velocity=20.0)
    axis.move_by(100.0)
    axis.advance(1.5)
    assert axis.velocity == pytest.approx(5.0)
    assert axis.advance(100.0) == pytest.approx(100.0 - (20.0**2 - 5.0**2) / 20.0)


def test_first_velocity_shown_is_not_zero_and_the_last_is() -> None:
    axis = ramped()
    axis.move_by(-10.0)
    # Programs loop until the velocity is zero: at the start it shows the least velocity of the wire.
    assert axis.velocity == 0.0
    assert axis.shown_velocity == -0.1
    axis.move_at(10.0)
    assert axis.shown_velocity == 0.1
    axis.advance(0.1)
    assert axis.shown_velocity == pytest.approx(3.0)
    axis.stop()
    # Ten microseconds before the end of the ramp.
    axis.advance(0.1 - 1e-5)
    assert axis.shown_velocity == 0.1
    axis.advance(2e-5)
    assert axis.shown_velocity == 0.0


def test_a_reversal_never_shows_a_still_axis() -> None:
    axis = ramped(velocity=10.0)
    # A reversal from 10 to -10 in/s at 30 in/s^2 passes zero within 0.67 s.
    axis.move_at(-10.0)
    shown = []
    for _ in range(400):
        axis.advance(2e-3)
        shown.append(axis.shown_velocity)
    # Never 0 while it reverses, and monotonous.
    assert min(abs(velocity) for velocity in shown) == 0.1
    assert shown == sorted(shown, reverse=True)
    assert shown[-1] == -10.0


def test_values_out_of_range_are_clamped_silently() -> None:
    axis = instant()
    axis.move_at(1e6)
    assert axis.velocity == 20.0
    axis.move_at(-1e6)
    assert axis.velocity == -20.0
    axis.set_speed(1e6)
    assert axis.speed == 20.0
    axis.set_speed(-7.0)
    assert axis.speed == 7.0
    for asked, got in ((0.0, 0.1), (-30.0, 30.0), (1e6, 60.0)):
        axis.set_acceleration(asked)
        assert axis.acceleration == got


def test_no_speed_no_motion() -> None:
    axis = instant()
    axis.set_speed(0.0)
    axis.move_by(5.0)
    assert not axis.moving
    axis.move_by(5.0, speed=500.0)
    assert axis.velocity == 20.0
    axis.move_by(0.0, speed=5.0)
    assert (axis.moving, axis.mode) == (False, Mode.HOLD)


def test_halt_stands_at_once_where_stop_needs_a_ramp() -> None:
    axis = ramped(velocity=10.0)
    axis.halt()
    assert (axis.moving, axis.velocity, axis.current_phase[0], axis.current_phase[2]) == (False, 0.0, inf, 0.0)
    assert axis.mode is Mode.HOLD


def test_limp_runs_down_and_stays_limp() -> None:
    axis = ramped(acceleration=10.0, velocity=10.0)
    axis.limp()
    assert (axis.moving, axis.mode) == (True, Mode.LIMP)
    assert axis.advance(5.0) == pytest.approx(5.0)
    assert (axis.moving, axis.mode) == (False, Mode.LIMP)
    axis.stop()
    assert axis.mode is Mode.HOLD


def test_speed_set_during_a_motion_applies_to_the_next() -> None:
    axis = instant()
    axis.move_by(10.0)
    axis.set_speed(1.0)
    assert axis.velocity == 20.0
    axis.move_by(10.0)
    assert axis.velocity == 1.0
