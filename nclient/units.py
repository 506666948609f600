"""Quantities of programs, with the unit in the keyword, converted to the tenths of the wire.

    tenths_of(translation_in_s=2.5)  25        tenths_of(steering_rad=math.pi)  1800
    tenths_of(x_in=None, x_m=0.3)    118       two units of one quantity are a TypeError

Values are rounded to the nearest tenth; nan and inf are a ValueError.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import NamedTuple

from nclient.protocol.types import M_PER_IN, SONAR_SLOTS, tenths

_UNIT_OF = {
    "in": 1.0, "in_s": 1.0, "in_s2": 1.0,
    "m": 1 / M_PER_IN, "m_s": 1 / M_PER_IN, "m_s2": 1 / M_PER_IN,
    "deg": 1.0, "deg_s": 1.0, "deg_s2": 1.0,
    "rad": math.degrees(1), "rad_s": math.degrees(1), "rad_s2": math.degrees(1),
}  # fmt: skip
"""Inches or degrees per unit, by the ending of a keyword."""

Points = Sequence[tuple[float, float]]
"""Points (x, y) of a line or a polygon."""


def tenths_of(*, default: int = 0, **quantity: float | None) -> int:
    """Return one quantity in tenths of an inch or degree.

    Parameters
    ----------
    default
        The result if no value is given.
    **quantity
        The same quantity in several units, at most one of them not None; the ending of a keyword is its unit.

    Raises
    ------
    TypeError
        If more than one value is given.
    ValueError
        If the value is not finite.
    """
    # At most one unit: two would contradict each other.
    values = [(name, value) for name, value in quantity.items() if value is not None]
    if not values:
        return default
    if len(values) > 1:
        raise TypeError(f"one of {', '.join(quantity)}, not {' and '.join(name for name, _ in values)}")
    # The part of the keyword behind its first underscore is the unit.
    ((name, value),) = values
    if not math.isfinite(value):
        raise ValueError(f"{name} is a finite number, not {value}")
    return tenths(value * _UNIT_OF[name.partition("_")[2]])


def points_tenths(points_in: Points | None, points_m: Points | None) -> tuple[int, ...]:
    """Return x1, y1, x2, y2 ... in tenths of an inch. Raises TypeError unless exactly one argument is not None."""
    if (points_in is None) == (points_m is None):
        raise TypeError("points in inches (..._in) or in metres (..._m): one of them")
    if points_in is not None:
        return tuple(tenths_of(each_in=value) for point in points_in for value in point)
    return tuple(tenths_of(each_m=value) for point in points_m or () for value in point)


def firing_order(order: Iterable[int]) -> tuple[int, ...]:
    """Return a firing order in wire format: sixteen numbers, filled up with 255.

    Parameters
    ----------
    order
        At most 16 sensors, 0..15.

    Raises
    ------
    ValueError
        If the order is longer or has other numbers.
    """
    numbers = tuple(order)
    if len(numbers) > _RING or any(number not in range(_RING) for number in numbers):
        raise ValueError(f"an order is at most {_RING} sensors 0..{_RING - 1}, not {numbers}")
    return numbers + (_END,) * (_RING - len(numbers))


# Number of sensors of a ring, and the end mark of a firing order.
_RING, _END = SONAR_SLOTS, 255


class AxisMode(IntEnum):
    """Mode of an axis in mv."""

    LEAVE = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3
    ACCELERATION = 4
    SPEED = 5


class AxisCommand(NamedTuple):
    """Command of one axis for `Robot.drive_axes`; without arguments the axis is left alone."""

    mode: AxisMode = AxisMode.LEAVE
    value: int = 0
    """Tenths of an inch or degree, per second for velocities and speeds, per second squared for accelerations."""

    @classmethod
    def velocity(
        cls, *,
        in_s: float | None = None, m_s: float | None = None,
        deg_s: float | None = None, rad_s: float | None = None,
    ) -> AxisCommand:  # fmt: skip
        """Return the command to keep this velocity until the next one."""
        return cls(AxisMode.VELOCITY, tenths_of(at_in_s=in_s, at_m_s=m_s, at_deg_s=deg_s, at_rad_s=rad_s))

    @classmethod
    def relative(
        cls, *,
        by_in: float | None = None, by_m: float | None = None,
        by_deg: float | None = None, by_rad: float | None = None,
    ) -> AxisCommand:  # fmt: skip
        """Return the command to move by this distance or angle."""
        return cls(AxisMode.RELATIVE, tenths_of(by_in=by_in, by_m=by_m, by_deg=by_deg, by_rad=by_rad))

    @classmethod
    def limp(cls) -> AxisCommand:
        """Return the command to switch the motor off."""
        return cls(AxisMode.LIMP)

    @classmethod
    def acceleration(
        cls, *,
        in_s2: float | None = None, m_s2: float | None = None,
        deg_s2: float | None = None, rad_s2: float | None = None,
    ) -> AxisCommand:  # fmt: skip
        """Return the command to set the acceleration."""
        return cls(AxisMode.ACCELERATION, tenths_of(to_in_s2=in_s2, to_m_s2=m_s2, to_deg_s2=deg_s2, to_rad_s2=rad_s2))

    @classmethod
    def speed(
        cls, *,
        in_s: float | None = None, m_s: float | None = None,
        deg_s: float | None = None, rad_s: float | None = None,
    ) -> AxisCommand:  # fmt: skip
        """Return the command to set the speed of relative motions."""
        return cls(AxisMode.SPEED, tenths_of(at_in_s=in_s, at_m_s=m_s, at_deg_s=deg_s, at_rad_s=rad_s))
