"""Tenths for the three axes of a robot: inches for an axis that rolls, radians for one that turns.

The wire counts all axes in tenths, of inches or of degrees; which of them, its model says: the second axis of an N150
steers, that of a Scout is its left wheel.
"""

from __future__ import annotations

import math

from nclient.protocol.units import rad_from_tenths
from nserver_emu.simulation.robot import SimulatedRobot


def axis_values(robot: SimulatedRobot, tenths: tuple[int, ...]) -> tuple[float, float, float]:
    """Three numbers of a command, as its axes count."""
    first, second, third = (
        number / 10 if rolls else rad_from_tenths(number)
        for number, rolls in zip(tenths, robot.model.rolls, strict=True)
    )
    return first, second, third


def axis_tenths(robot: SimulatedRobot, values: tuple[float, float, float]) -> tuple[int, int, int]:
    """What the axes say, in tenths; what is not zero never becomes zero."""
    first, second, third = (
        away_from_zero(value * 10 if rolls else math.degrees(value) * 10)
        for value, rolls in zip(values, robot.model.rolls, strict=True)
    )
    return first, second, third


def away_from_zero(value: float) -> int:
    """The nearest whole number; for what is not zero, the nearest that is not."""
    rounded = round(value)
    return rounded if rounded or not value else (1 if value > 0 else -1)
