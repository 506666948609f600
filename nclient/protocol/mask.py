"""The mask: which sensors and numbers a state reply carries, and for which sensors their position stamps.

    Smask[0]      position-data bits: 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass
    Smask[1..43]  0 or 1 for the State slot of that number ([41] is on TCP only and means nothing)

    byte   b0    b1     b2      b3      b4      b5                                b6
    TCP    1..8  9..16  17..24  25..32  33..40  any position | [41] [42] [43]     Smask[0]
    line   1..8  9..16  17..24  25..32  33..40  laser                             compass + 2 x Smask[0]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag

from nclient.errors import WireError

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
