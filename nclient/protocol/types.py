"""What the wire knows of a robot's model: its number, its fixed mask, its bumper bytes. Geometry is worlds.robots'.

    N150 and Scout never send a mask: their packets always hold the sonars, bumpers, pose, velocities and compass.

The mask: which sensors and numbers a state reply carries, and for which sensors their position stamps.

    Smask[0]      position-data bits: 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass
    Smask[1..43]  0 or 1 for the State slot of that number ([41] is on TCP only and means nothing)

    byte   b0    b1     b2      b3      b4      b5                                b6
    TCP    1..8  9..16  17..24  25..32  33..40  any position | [41] [42] [43]     Smask[0]
    line   1..8  9..16  17..24  25..32  33..40  laser                             compass + 2 x Smask[0]

The wire's units and ours. Tenths of an inch and of a degree live on the wire only; this is where they turn.

Rules: pure numbers, no state. Rounding is to the nearest, ties away from zero, as a robot's own display does.

Position stamps: where the robot was, by its encoders, when a sensor took its reading.

    x y steer turret | v_trans v_steer v_turret | pose time ms | sensor time ms      nine numbers, wire units

The order of the stamps in a reply: 16 infrared, 16 sonar, bumper, laser, compass.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from typing import NamedTuple

from nclient.errors import AddressError, WireError


@dataclass(frozen=True, slots=True)
class Model:
    """A row of the model table as the wire sees it."""

    name: str
    number: int
    """The number the C libraries use."""
    sends_mask: bool
    """Whether the robot's own line has a mask (ct), position data, infrared, compass question and laser."""
    bumpers_low_first: bool
    """Order of the three bumper bytes: Scout b0 + 256 b1 + 65536 b2, the others b2 + 256 b1 + 65536 b0."""
    bumper_rest: int
    """What State[33] reads over the robot's own line when nothing touches."""
    has_infrared: bool
    has_laser: bool
    has_turret: bool


N200 = Model("n200", 0, True, False, 0xF00000, has_infrared=True, has_laser=True, has_turret=True)
N150 = Model("n150", 1, False, False, 0xF00000, has_infrared=False, has_laser=False, has_turret=True)
SCOUT = Model("scout", 2, False, True, 0, has_infrared=False, has_laser=False, has_turret=False)

MODELS = {model.name: model for model in (N150, N200, SCOUT)}
"""Every model by its lower-case name."""


def get_model(name: str) -> Model:
    """The model of that name. Raises AddressError, naming the models there are."""
    try:
        return MODELS[name.lower()]
    except KeyError:
        raise AddressError(f"no robot model {name!r}; there are {', '.join(MODELS)}") from None


DEFAULT_SONAR_ORDER = (0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8)
"""The ring's firing order before any conf_sn (PROTOCOL.md, section 3)."""
DEFAULT_SONAR_RATE = 15
"""Its rate: 60 ms from one sonar to the next."""
SONAR_RATE_STEP_S = 0.004
"""The unit of conf_sn's rate."""


SLOTS = 44
"""Length of Smask."""
LASER_SLOT = 42
COMPASS_SLOT = 43
BUMPER_SLOT = 33


class Position(IntFlag):
    """The position-data bits of Smask[0]: whose stamps a reply carries."""

    INFRARED = 1
    SONAR = 2
    BUMPER = 4
    LASER = 8
    COMPASS = 16


@dataclass(frozen=True, slots=True)
class Mask:
    """Smask as a value: 44 numbers, [0] the position-data bits 0..31, the others 0 or 1.

    Raises WireError when the numbers are none that a mask can hold.
    """

    smask: tuple[int, ...]
    whole: bool = field(init=False, compare=False, repr=False)
    """Whether every sensor and number is let through."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "whole", all(self.smask[1:41]) and all(self.smask[LASER_SLOT:]))
        if len(self.smask) != SLOTS:
            raise WireError(f"a mask has {SLOTS} numbers, Smask[0] to Smask[{SLOTS - 1}]; got {len(self.smask)}")
        if not 0 <= self.smask[0] <= 31 or any(bit not in (0, 1) for bit in self.smask[1:]):
            raise WireError("a mask is position-data bits 0..31 followed by zeros and ones")

    @property
    def position(self) -> int:
        """The position-data bits."""
        return self.smask[0]

    def has(self, slot: int) -> bool:
        """Whether the mask lets State[slot] through (slot 1..43)."""
        return bool(self.smask[slot])

    def with_position(self, bits: int) -> Mask:
        """The same mask, asking for other position data."""
        return Mask((bits, *self.smask[1:]))

    def tcp_bytes(self) -> tuple[int, ...]:
        """The seven bytes of a ct request over TCP."""
        last = bool(self.position) | self.smask[41] << 1 | self.smask[42] << 2 | self.smask[43] << 3
        return (*self._common_bytes(), last, self.position)

    def line_bytes(self) -> tuple[int, ...]:
        """The seven bytes of a ct request on the robot's own line."""
        return (*self._common_bytes(), self.smask[LASER_SLOT], self.smask[COMPASS_SLOT] | self.position << 1)

    def _common_bytes(self) -> list[int]:
        bits = self.smask
        return [sum(bits[1 + 8 * byte + k] << k for k in range(8)) for byte in range(5)]


def mask_from_tcp(data: Sequence[int]) -> Mask:
    """The mask of a ct request over TCP (seven bytes, one a word; only the low eight bits count)."""
    tail = [data[5] >> 1 & 1, data[5] >> 2 & 1, data[5] >> 3 & 1]
    return Mask((data[6] & 31, *_bits(data[:5]), *tail))


def mask_from_line(data: Sequence[int]) -> Mask:
    """The mask of a ct request on the robot's own line, which does not carry Smask[41]: it reads 1, as at the start."""
    return Mask((data[6] >> 1 & 31, *_bits(data[:5]), 1, data[5] & 1, data[6] & 1))


def _bits(data: Sequence[int]) -> list[int]:
    return [byte >> k & 1 for byte in data for k in range(8)]


EVERYTHING = Mask((0,) + (1,) * (SLOTS - 1))
"""What a client sends right after connecting: all masks on, position data off."""
NO_MASK_MODELS = Mask((0,) + (0,) * 16 + (1,) * 24 + (0, 0, 1))
"""The fixed packet of N150 and Scout: no infrared, no laser, all the rest."""


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


def clamp_word(value: int) -> int:
    """The nearest number that a 32-bit word of the wire can hold."""
    return max(-WORD_LIMIT, min(WORD_LIMIT - 1, value))


def wrap_word(value: int) -> int:
    """A count that never ends, as a 32-bit word holds it: modulo 2^32, the upper half negative."""
    return (value + WORD_LIMIT) % (2 * WORD_LIMIT) - WORD_LIMIT


def unwrap_word(word: int) -> int:
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


class Stamp(NamedTuple):
    """One position stamp in wire units (tenths of inches and degrees, milliseconds)."""

    x: int
    y: int
    steer: int
    turret: int
    v_trans: int
    v_steer: int
    v_turret: int
    pose_time: int
    sensor_time: int


NO_STAMP = Stamp(0, 0, 0, 0, 0, 0, 0, 0, 0)
"""What a sensor carries that has not read yet."""

INFRARED_KEYS = tuple(f"ir_{i}" for i in range(16))
SONAR_KEYS = tuple(f"sonar_{i}" for i in range(16))

STAMP_KEYS: dict[Position, tuple[str, ...]] = {
    Position.INFRARED: INFRARED_KEYS,
    Position.SONAR: SONAR_KEYS,
    Position.BUMPER: ("bumper",),
    Position.LASER: ("laser",),
    Position.COMPASS: ("compass",),
}
"""The names of the stamps that each position-data bit asks for, in the order of the wire."""
