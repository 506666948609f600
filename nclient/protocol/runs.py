"""Runs of equal numbers on the robot's own line, low byte first, packed and unpacked in one go.

    BYTES, SHORTS, LONGS    unsigned, of 1, 2 and 4 octets
    SIGNED_SHORTS, SIGNED_LONGS    sign-magnitude: the top bit means minus; -0 reads as 0

Rules: numbers and bytes, nothing else; a number that does not fit is a ValueError. A state packet is made of runs, and
an element at a time costs ten times as much.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final


class Run:
    """Numbers of so many octets each, one after another. `code`: that of struct; `signed`: sign-magnitude."""

    def __init__(self, code: str, signed: bool = False) -> None:
        self.octets: Final = struct.calcsize(f"<{code}")
        self.sign: Final = 1 << (8 * self.octets - 1) if signed else 0
        self._code: Final = code

    def pack(self, numbers: Sequence[int]) -> bytes:
        """The bytes of these numbers. Raises ValueError where one does not fit."""
        if self.sign:
            numbers = [number if 0 <= number < self.sign else self._magnitude(number) for number in numbers]
        try:
            return struct.pack(f"<{len(numbers)}{self._code}", *numbers)
        except struct.error as error:
            raise ValueError(f"{list(numbers)} in {self.octets} bytes each: {error}") from None

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """The numbers that these bytes are, a whole count of them."""
        numbers = struct.unpack(f"<{len(data) // self.octets}{self._code}", data)
        if not self.sign:
            return numbers
        return tuple(number if number < self.sign else self.sign - number for number in numbers)

    def _magnitude(self, number: int) -> int:
        if abs(number) >= self.sign:
            raise ValueError(f"{number} does not fit sign-magnitude below {self.sign}")
        return self.sign - number


BYTES: Final = Run("B")
SHORTS: Final = Run("H")
LONGS: Final = Run("I")
SIGNED_SHORTS: Final = Run("H", signed=True)
SIGNED_LONGS: Final = Run("I", signed=True)
