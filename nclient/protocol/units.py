"""The wire's units and ours. Tenths of an inch and of a degree live on the wire only; this is where they turn.

Rules: pure numbers, no state. Rounding is to the nearest, ties away from zero, as a robot's own display does.
"""

from __future__ import annotations

import math

M_PER_IN = 0.0254
"""Metres in an inch, exactly."""

FULL_TURN_TENTHS = 3600
SCOUT_WHEEL_IN_PER_DEG = 0.118597
"""Inches that a Scout's wheel travels for each degree of turn (half its track of 13.590 in, times pi / 180)."""
WORD_LIMIT = 2**31
CPU_RANGE_V = 12.0
MOTOR_RANGE_V = 12.85


def tenths(value: float) -> int:
    """Inches or degrees to the wire's tenths, rounded to the nearest."""
    return math.floor(value * 10 + 0.5) if value >= 0 else -math.floor(-value * 10 + 0.5)


def tenths_from_rad(angle_rad: float) -> int:
    """Radians (or radians per second) to tenths of a degree, signed."""
    return tenths(math.degrees(angle_rad))


def heading_tenths(angle_rad: float) -> int:
    """A direction in radians to 0..3599 tenths of a degree, the form of State[36] and State[37]."""
    return tenths_from_rad(angle_rad) % FULL_TURN_TENTHS


def clamped_word(value: int) -> int:
    """The nearest number that a 32-bit word of the wire can hold."""
    return max(-WORD_LIMIT, min(WORD_LIMIT - 1, value))


def wrapped_word(value: int) -> int:
    """A count that never ends, as a 32-bit word holds it: modulo 2^32, the upper half negative."""
    return (value + WORD_LIMIT) % (2 * WORD_LIMIT) - WORD_LIMIT


def unwrapped_word(word: int) -> int:
    """A signed word read as a count: 0 to 2^32 - 1."""
    return word % (2 * WORD_LIMIT)


def rad_from_tenths(angle_tenths: float) -> float:
    """Tenths of a degree to radians."""
    return math.radians(angle_tenths / 10)


def volts(raw: int, full_range_v: float) -> float:
    """Battery volts of a raw byte r: (2 + 3 r / 255) x range / 5 (PROTOCOL.md, section 3)."""
    return (2 + 3 * raw / 255) * full_range_v / 5


def raw_volts(voltage_v: float, full_range_v: float) -> int:
    """The raw byte 0..255 nearest to a battery voltage; the inverse of `volts`, clamped."""
    return min(255, max(0, round((voltage_v * 5 / full_range_v - 2) * 255 / 3)))
