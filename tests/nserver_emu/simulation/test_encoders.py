"""The encoder pose: dead reckoning along its own steering, for any defined angles."""

from __future__ import annotations

from math import pi

import pytest

from nserver_emu.simulation.odometry import Encoders
from nserver_emu.simulation.segments import ConstantAccelerationSegment

AHEAD = ConstantAccelerationSegment(2.0, 5.0, 0.0, 0.0, 0.0)


def test_dead_reckoning_follows_the_encoder_heading() -> None:
    encoders = Encoders(1.0, 2.0)
    encoders.follow(AHEAD, 2.0, 0.0)
    assert encoders.pose(0.0, 0.5) == pytest.approx((11.0, 2.0, 0.0, 0.5))
    encoders.define_angles(pi / 2, -0.5)
    encoders.follow(AHEAD, 1.0, 0.0)
    assert encoders.pose(0.0, 0.25) == pytest.approx((11.0, 7.0, pi / 2, 2.0 * pi - 0.25))


def test_a_place_can_be_renamed() -> None:
    encoders = Encoders(1.0, 2.0)
    encoders.define_position(-4.0, 0.5)
    assert encoders.pose(7.0, -7.0) == pytest.approx((-4.0, 0.5, 7.0 - 2.0 * pi, 4.0 * pi - 7.0))
