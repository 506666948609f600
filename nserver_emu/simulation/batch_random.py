"""numpy's random streams as functions of an array, for compiled code: PCG64 and its standard normal numbers.

A stream is a row of four 64-bit words: both halves of the 128-bit state, and of the increment. Its numbers are those of
`numpy.random.Generator(PCG64)`, whose streams `RngFactory` makes, in the same order.

References
----------
O'Neill, PCG: a family of simple fast space-efficient statistically good algorithms (2014): the generator XSL RR 128/64.
Marsaglia and Tsang, The ziggurat method for generating random variables (2000), as numpy implements it.
"""

from __future__ import annotations

from math import exp, log1p
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba.np.random import _constants

from nserver_emu.simulation.noise import Purpose, RngFactory

Words = npt.NDArray[np.uint64]

_MULTIPLIER_HIGH: Final = np.uint64(2549297995355413924)
_MULTIPLIER_LOW: Final = np.uint64(4865540595714422341)
_WORD: Final = 1 << 64
_HALF: Final = np.uint64(32)
_LOW_HALF: Final = np.uint64(0xFFFFFFFF)

# The layers of the ziggurat are numpy's; numba carries them for its own generators.
_WIDTHS: Final[npt.NDArray[np.float64]] = np.array(_constants.wi_double)
_LIMITS: Final[Words] = np.array(_constants.ki_double)
_HEIGHTS: Final[npt.NDArray[np.float64]] = np.array(_constants.fi_double)
_TAIL: Final = float(_constants.ziggurat_nor_r)
_TAIL_INVERSE: Final = float(_constants.ziggurat_nor_inv_r)


def stream_words(factory: RngFactory, purpose: Purpose) -> list[int]:
    """Return the words of a robot's stream, before its first number."""
    state: Any = factory.stream(purpose).bit_generator.state
    found = state["state"]
    return [word for number in (found["state"], found["inc"]) for word in divmod(number, _WORD)]


def standard_normal(words: Words) -> float:
    """Draw the next standard normal number of a stream (4,), which advances."""
    while True:
        # 1. A layer of the ziggurat, a sign and a place in the layer from one word.
        word = next_word(words)
        layer = word & np.uint64(0xFF)
        place = (word >> np.uint64(9)) & np.uint64(0x000FFFFFFFFFFFFF)
        x: float = float(place) * _WIDTHS[layer]
        if (word >> np.uint64(8)) & np.uint64(1):
            x = -x
        # 2. 99 of 100 lie in the part of the layer that is wholly below the density.
        if place < _LIMITS[layer]:
            return x
        # 3. The tail, or the part of a layer that the density crosses.
        if layer == 0:
            return _tail(words, (place >> np.uint64(8)) & np.uint64(1) != 0)
        if (_HEIGHTS[layer - np.uint64(1)] - _HEIGHTS[layer]) * _uniform(words) + _HEIGHTS[layer] < exp(-0.5 * x * x):
            return x


def _tail(words: Words, is_negative: bool) -> float:
    while True:
        beyond = -_TAIL_INVERSE * log1p(-_uniform(words))
        height = -log1p(-_uniform(words))
        if height + height > beyond * beyond:
            return -(_TAIL + beyond) if is_negative else _TAIL + beyond


def _uniform(words: Words) -> float:
    """Draw a number from [0, 1) with 53 bits."""
    return float(next_word(words) >> np.uint64(11)) / 9007199254740992.0


def next_word(words: Words) -> Any:
    """Draw 64 bits of a stream (4,), which advances."""
    high, low, add_high, add_low = words[0], words[1], words[2], words[3]
    # 1. state = state x multiplier + increment, modulo 2^128.
    product = low * _MULTIPLIER_LOW
    new_low = product + add_low
    new_high = _high_word(low, _MULTIPLIER_LOW) + high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH + add_high
    if new_low < product:
        new_high += np.uint64(1)
    words[0], words[1] = new_high, new_low
    # 2. Both halves combined, rotated by the top six bits.
    combined, turn = new_high ^ new_low, new_high >> np.uint64(58)
    return (combined >> turn) | (combined << ((np.uint64(64) - turn) & np.uint64(63)))


def _high_word(a: Any, b: Any) -> Any:
    """Return the upper 64 bits of a product."""
    a_high, a_low, b_high, b_low = a >> _HALF, a & _LOW_HALF, b >> _HALF, b & _LOW_HALF
    # Products of halves; `middle` collects what carries into the upper word.
    middle = a_high * b_low + ((a_low * b_low) >> _HALF)
    carried = a_low * b_high + (middle & _LOW_HALF)
    return a_high * b_high + (middle >> _HALF) + (carried >> _HALF)
