"""The actual robot: contact with cached room against contact without, bumpers in the frame of the body."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest

from nserver_emu.simulation.drive import Chassis
from nserver_emu.simulation.segments import ConstantAccelerationSegment
from worlds.robots import N150

WALLS = np.array(
    [[50.0, -40.0, 50.0, 40.0], [50.0, 40.0, -50.0, 40.0], [-50.0, 40.0, -50.0, -40.0], [-50.0, -40.0, 50.0, -40.0]]
)


def chassis(x: float, y: float) -> Chassis:
    return Chassis(N150, WALLS, x, y)


def test_cached_clearance_changes_no_contact() -> None:
    rng = np.random.default_rng(2)
    cached = chassis(0.0, 0.0)
    contacts = 0
    for _ in range(400):
        steering = rng.uniform(-pi, pi)
        # Random motions of up to 0.6 s with up to 20 in/s and 0.7 rad/s.
        segment = ConstantAccelerationSegment(
            rng.uniform(0.01, 0.6), rng.uniform(-20.0, 20.0), 0.0, rng.uniform(-0.7, 0.7), 0.0
        )
        # The same place without anything cached.
        fresh = chassis(*cached.pose(0.0, 0.0)[:2])
        found = cached.first_contact(segment, steering)
        assert found == fresh.first_contact(segment, steering)
        contacts += found is not None
        cached.follow(segment, segment.duration_s if found is None else found.time_s, steering)
        assert cached.bumpers(0.0) == chassis(*cached.pose(0.0, 0.0)[:2]).bumpers(0.0)
    # Contacts must have occurred.
    assert contacts > 10


def test_standing_in_a_wall_and_only_steering_is_no_contact() -> None:
    assert chassis(45.0, 0.0).first_contact(ConstantAccelerationSegment(1.0, 0.0, 0.0, 0.5, 0.0), 0.0) is None


def test_bumpers_turn_with_the_body_and_touch_both_walls() -> None:
    robot = chassis(50.0 - N150.radius_in, 40.0 - N150.radius_in)
    assert robot.bumpers(0.0) == 1 << 0 | 1 << 5
    robot.turn(radians(18.0))
    assert robot.bumpers(0.0) == 1 << 19 | 1 << 4
    assert robot.bumpers(radians(-18.0)) == 1 << 0 | 1 << 5
    robot.place(0.0, 0.0)
    assert robot.bumpers(0.0) == 0
    assert robot.pose(0.5, -0.5) == pytest.approx((0.0, 0.0, 0.5, 2.0 * pi - 0.5))


def test_touching_is_a_thousandth_of_an_inch() -> None:
    assert chassis(50.0 - N150.radius_in - 0.9e-3, 0.0).bumpers(0.0) == 1
    assert chassis(50.0 - N150.radius_in - 1.1e-3, 0.0).bumpers(0.0) == 0


def test_new_walls_and_robots_count_at_once() -> None:
    # A second at 5 in/s: nothing is in the way.
    robot = chassis(0.0, 0.0)
    ahead = ConstantAccelerationSegment(1.0, 5.0, 0.0, 0.0, 0.0)
    assert robot.first_contact(ahead, 0.0) is None
    # A robot of 8 in appears 20 in ahead: contact when the rims touch.
    robot.set_obstacles([(20.0, 0.0, 8.0)])
    contact = robot.first_contact(ahead, 0.0)
    assert contact is not None
    assert contact.time_s == pytest.approx((20.0 - 8.0 - N150.radius_in) / 5.0)
    robot.set_obstacles(())
    assert robot.to_state().others == ()
    assert robot.first_contact(ahead, 0.0) is None
    # Walls at a quarter of their distance are in the way.
    robot.set_walls(WALLS * 0.25)
    assert robot.first_contact(ahead, 0.0) is not None
