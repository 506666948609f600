"""What a program asks for, in the unit that stands in the keyword, turned into the wire's tenths.

    tenths_of(translation_in_s=2.5)  25        tenths_of(steering_rad=math.pi)  1800
    tenths_of(x_in=None, x_m=0.3)    118       two units of one quantity at once are a TypeError

Rules: a keyword's ending is its unit; pure numbers, no robot. The nearest tenth is taken; a number that is none (nan,
inf) is a ValueError.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import NamedTuple

from nclient.protocol.types import M_PER_IN, tenths

_UNIT_OF = {
    "in": 1.0, "in_s": 1.0, "in_s2": 1.0,
    "m": 1 / M_PER_IN, "m_s": 1 / M_PER_IN, "m_s2": 1 / M_PER_IN,
    "deg": 1.0, "deg_s": 1.0, "deg_s2": 1.0,
    "rad": math.degrees(1), "rad_s": math.degrees(1), "rad_s2": math.degrees(1),
}  # fmt: skip
"""Inches or degrees in one of each."""

Points = Sequence[tuple[float, float]]
"""Corners (x, y) of a line or a polygon."""


def tenths_of(*, default: int = 0, **quantity: float | None) -> int:
    """Tenths of the one quantity that is given (not None); `default` when none is.

    Raises TypeError when more than one is given, ValueError when it is no finite number.
    """
    given = [(name, value) for name, value in quantity.items() if value is not None]
    if not given:
        return default
    if len(given) > 1:
        raise TypeError(f"one of {', '.join(quantity)}, not {' and '.join(name for name, _ in given)}")
    ((name, value),) = given
    if not math.isfinite(value):
        raise ValueError(f"{name} is a finite number, not {value}")
    return tenths(value * _UNIT_OF[name.partition("_")[2]])


def points_tenths(points_in: Points | None, points_m: Points | None) -> tuple[int, ...]:
    """x1, y1, x2, y2 ... in tenths of an inch. Raises TypeError unless exactly one of the two is given."""
    if (points_in is None) == (points_m is None):
        raise TypeError("points in inches (..._in) or in metres (..._m): one of them")
    if points_in is not None:
        return tuple(tenths_of(each_in=value) for point in points_in for value in point)
    return tuple(tenths_of(each_m=value) for point in points_m or () for value in point)


def firing_order(order: Iterable[int]) -> tuple[int, ...]:
    """A firing order as the wire has it: sixteen numbers, 255 after the last sensor that fires.

    Raises ValueError for more than sixteen, or for a sensor that is not 0..15.
    """
    numbers = tuple(order)
    if len(numbers) > _RING or any(number not in range(_RING) for number in numbers):
        raise ValueError(f"an order is at most {_RING} sensors 0..{_RING - 1}, not {numbers}")
    return numbers + (_END,) * (_RING - len(numbers))


_RING, _END = 16, 255


class AxisMode(IntEnum):
    """What mv does with an axis."""

    LEAVE = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3
    ACCELERATION = 4
    SPEED = 5


class AxisCommand(NamedTuple):
    """One axis' part of Robot.drive_axes: leave it, velocity, relative, limp, acceleration or speed."""

    mode: AxisMode = AxisMode.LEAVE
    value: int = 0
    """Tenths of an inch or a degree, a second or a second squared where the mode says so."""

    @classmethod
    def velocity(
        cls,
        *,
        in_s: float | None = None,
        m_s: float | None = None,
        deg_s: float | None = None,
        rad_s: float | None = None,
    ) -> AxisCommand:
        """Go at this velocity until told otherwise."""
        return cls(AxisMode.VELOCITY, tenths_of(at_in_s=in_s, at_m_s=m_s, at_deg_s=deg_s, at_rad_s=rad_s))

    @classmethod
    def relative(
        cls,
        *,
        by_in: float | None = None,
        by_m: float | None = None,
        by_deg: float | None = None,
        by_rad: float | None = None,
    ) -> AxisCommand:
        """Go this far."""
        return cls(AxisMode.RELATIVE, tenths_of(by_in=by_in, by_m=by_m, by_deg=by_deg, by_rad=by_rad))

    @classmethod
    def limp(cls) -> AxisCommand:
        """Let the motor go."""
        return cls(AxisMode.LIMP)

    @classmethod
    def acceleration(
        cls,
        *,
        in_s2: float | None = None,
        m_s2: float | None = None,
        deg_s2: float | None = None,
        rad_s2: float | None = None,
    ) -> AxisCommand:
        """Set how fast the axis gains speed."""
        return cls(AxisMode.ACCELERATION, tenths_of(to_in_s2=in_s2, to_m_s2=m_s2, to_deg_s2=deg_s2, to_rad_s2=rad_s2))

    @classmethod
    def speed(
        cls,
        *,
        in_s: float | None = None,
        m_s: float | None = None,
        deg_s: float | None = None,
        rad_s: float | None = None,
    ) -> AxisCommand:
        """Set the speed that relative motions of the axis go at."""
        return cls(AxisMode.SPEED, tenths_of(at_in_s=in_s, at_m_s=m_s, at_deg_s=deg_s, at_rad_s=rad_s))
