"""Bumper bits set by a contact."""

from __future__ import annotations

from math import radians

from hypothesis import given
from hypothesis import strategies as st

from nserver_emu.simulation.collision import pressed_bumpers
from worlds.robots import N150, SCOUT

RING = N150.bumper_angles_rad


def test_a_touch_sets_the_nearest_bumper() -> None:
    assert pressed_bumpers([], RING) == 0
    for number in range(20):
        for off in (-8.9, 0.0, 8.9):
            assert pressed_bumpers([radians(18.0 * number + off)], RING) == 1 << number


def test_midway_sets_both_neighbours_and_touches_add_up() -> None:
    assert pressed_bumpers([radians(9.0)], RING) == 0b11
    assert pressed_bumpers([radians(-9.0)], RING) == 1 | 1 << 19
    assert pressed_bumpers([0.0, radians(90.0)], RING) == 1 | 1 << 5
    assert pressed_bumpers([radians(29.9)], SCOUT.bumper_angles_rad) == 1
    assert pressed_bumpers([radians(30.0)], SCOUT.bumper_angles_rad) == 0b11


@given(st.floats(-20.0, 20.0))
def test_every_touch_sets_a_bumper(direction: float) -> None:
    assert 1 <= pressed_bumpers([direction], RING).bit_count() <= 2
