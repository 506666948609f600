"""A robot's state in inches, metres and degrees, compared with values computed by hand from docs/protocol.md."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nclient.protocol.client_state import ClientState
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, N200, SCOUT, Model, Stamp
from nclient.state import Pose, RobotState, snapshot


def state(model: Model = N150, **slots: int) -> RobotState:
    """A state in which State[n] is given as s<n>."""
    raw = [0] * 45
    for name, value in slots.items():
        raw[int(name[1:])] = value
    return RobotState(model, tuple(raw))


def test_sonars_in_inches_and_metres() -> None:
    seen = state(s17=6, s18=100, s32=255)
    assert seen.sonars_in == (6, 100, *[0] * 13, 255)
    assert seen.sonars_m[0] == pytest.approx(0.1524)
    assert seen.sonars_m[1] == pytest.approx(2.54)
    assert seen.sonars_m[15] is None


def test_infrareds_are_slots_1_to_16() -> None:
    assert state(s1=3, s16=15).infrareds == (3, *[0] * 14, 15)


def test_the_pose_in_both_units() -> None:
    seen = state(s34=-1234, s35=5678, s36=900, s37=3599)
    assert (seen.x_in, seen.y_in) == (-123.4, 567.8)
    # 123.4 in x 0.0254 m/in = 3.13436 m.
    assert (seen.x_m, seen.y_m) == pytest.approx((-3.134360, 14.422120))
    assert (seen.steering_deg, seen.turret_deg) == (90.0, 359.9)
    assert (seen.steering_rad, seen.turret_rad) == pytest.approx((math.pi / 2, math.radians(359.9)))
    assert seen.pose == Pose(seen.x_in, seen.y_in, seen.steering_rad, seen.turret_rad)
    assert seen.pose.x_m == seen.x_m
    assert seen.pose.y_m == seen.y_m
    assert (seen.pose.steering_deg, seen.pose.turret_deg) == pytest.approx((90.0, 359.9))


def test_a_pose_from_metres_or_degrees() -> None:
    assert Pose.from_metres(0.254, -0.0254, 1, 2) == Pose(10, -1, 1, 2)
    assert Pose.from_degrees(1, 2, 180, -90) == Pose(1, 2, math.pi, -math.pi / 2)


def test_velocities_of_a_synchro_drive() -> None:
    seen = state(s38=200, s39=-450, s40=900)
    assert (seen.translation_in_s, seen.translation_m_s) == pytest.approx((20, 0.508))
    assert (seen.steering_deg_s, seen.turret_deg_s) == (-45, 90)
    assert (seen.steering_rad_s, seen.turret_rad_s) == pytest.approx((-math.pi / 4, math.pi / 2))
    # A synchro drive has no wheels of its own: both read the translation.
    assert seen.right_in_s == seen.left_in_s == 20
    assert (seen.right_m_s, seen.left_m_s) == pytest.approx((0.508, 0.508))


def test_velocities_of_a_scout_come_from_its_wheels() -> None:
    seen = state(SCOUT, s38=130, s39=70, s40=999)
    assert (seen.right_in_s, seen.left_in_s) == (13, 7)
    # The mean of 13 and 7 in/s, and their difference by the track of 13.590 in.
    assert seen.translation_in_s == 10
    track_in = 13.590
    assert seen.steering_rad_s == pytest.approx((13 - 7) / track_in, rel=1e-4)
    assert seen.turret_deg_s == seen.steering_deg_s == pytest.approx(math.degrees(6 / track_in), rel=1e-4)


@pytest.mark.parametrize(
    ("model", "bits", "moving"),
    [
        (N150, 0, (False, False, False, False)),
        (N150, 1, (True, True, False, False)),
        (N150, 2, (True, False, True, False)),
        (N150, 4, (True, False, False, True)),
        (N150, 8, (False, False, False, False)),
        (SCOUT, 1, (True, True, True, False)),
        (SCOUT, 2, (True, True, True, False)),
        # Battery, mains and emergency stop bits are no motion.
        (SCOUT, 0b1111100, (False, False, False, False)),
    ],
)
def test_motor_bits(model: Model, bits: int, moving: tuple[bool, ...]) -> None:
    seen = state(model, s41=bits)
    assert (seen.moving, seen.translation_moving, seen.steering_moving, seen.turret_moving) == moving


def test_power_bits_of_a_scout() -> None:
    for bit, flags in ((4, (True, False, False)), (5, (False, True, False)), (6, (False, False, True))):
        seen = state(SCOUT, s41=1 << bit)
        assert (seen.on_mains, seen.charging, seen.emergency_stop) == flags
        other = state(N200, s41=1 << bit)
        assert (other.on_mains, other.charging, other.emergency_stop) == (False, False, False)


@pytest.mark.parametrize("rest", [0, 0xF00000])
@given(bumpers=st.sets(st.integers(0, 19)))
def test_resting_bumper_bits_are_removed(rest: int, bumpers: set[int]) -> None:
    seen = state(N150, s33=rest | sum(1 << number for number in bumpers))
    assert seen.bumpers == tuple(sorted(bumpers))
    assert seen.touching == bool(bumpers)


def test_bumpers_of_a_scout_have_no_resting_bits() -> None:
    assert state(SCOUT, s33=0b100001).bumpers == (0, 5)


def test_compass_speed_and_error() -> None:
    seen = state(s0=25, s43=1800, s44=5)
    assert seen.compass_deg == 180
    assert seen.compass_rad == pytest.approx(math.pi)
    assert seen.speed_factor == 2.5
    assert seen.error == 5


def test_laser_readings_have_the_width_of_the_mode() -> None:
    assert RobotState(N200, (0,) * 45).laser_points_in == ()
    assert RobotState(N200, (0,) * 45, (2, 10, 20, 30, -40)).laser_points_in == ((1, 2), (3, -4))
    # In point modes the count is that of points; four numbers for a count of 1 are a line.
    assert RobotState(N200, (0,) * 45, (1, 10, 20, 30, 40)).laser_points_in == ((1, 2, 3, 4),)
    assert RobotState(N200, (0,) * 45, (3, 1, 2, 3)).laser_points_in == (), "rows of the camera"


def test_an_empty_state_reads_zero() -> None:
    seen = snapshot(ClientState(), N150)
    assert seen.raw == (0,) * 45
    assert seen.laser == (0,)
    assert (seen.clock_s, seen.battery) == (None, None)
    assert seen.stamps == {}


def test_a_snapshot_does_not_change() -> None:
    held = ClientState()
    stamp = Stamp(10, 20, 1800, 900, 50, -450, 450, 16400, 16464)
    held.apply_reply(Reply("state", {17: 8}, (1, 5, 6), {"sonar_0": stamp}, 16480, (255, 0)))
    seen = snapshot(held, N150)
    held.apply_reply(Reply("state", {17: 9}, (1, 7, 8), {"sonar_0": stamp._replace(x=0), "bumper": stamp}, 99, (0, 0)))
    assert seen.sonars_in[0] == 8
    assert seen.laser == (1, 5, 6)
    assert seen.clock_s == 16.48
    assert seen.battery is not None
    assert seen.battery.cpu_v == pytest.approx(12.0)
    # The raw byte 0 is 2/5 of the range.
    assert seen.battery.motor_v == pytest.approx(2 * 12.85 / 5)
    (taken,) = seen.stamps.values()
    assert taken.pose == Pose(1, 2, math.pi, math.pi / 2)
    assert taken[1:] == pytest.approx((5, -math.pi / 4, math.pi / 4, 16.4, 16.464))


def test_a_state_is_a_value() -> None:
    assert state(s17=4) == state(s17=4)
    with pytest.raises(dataclasses.FrozenInstanceError):
        state().raw = ()  # type: ignore[misc]
