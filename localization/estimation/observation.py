"""What beams say about a state, and why some of them say nothing: what passes between gate and filter.

Rules: values only. The gate (gating) makes observations, a filter (ekf) takes them; neither knows the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import Floats

Mask = npt.NDArray[np.bool_]
Codes = npt.NDArray[np.int8]


class Refusal(IntEnum):
    """Why a beam is left out. Where several hold, the first of this order is told."""

    NONE = 0
    LIMIT = 1
    """The reading is a limit, or no number at all: it says "no nearer" or "nothing", not how far."""
    NO_WALL = 2
    """The map has nothing where the beam points."""
    AMBIGUOUS_WALL = 3
    """From somewhere the robot may well be, the beam meets another wall."""
    GRAZING = 4
    """The beam strikes the wall at too flat an angle."""
    GATE = 5
    """The reading is farther from the expected one than chance explains."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What n beams say about a state of m coordinates, ready for a correction.

    `innovation` (..., n), reading less expectation, inches; `jacobian` (..., n, m), the derivative of the expectation
    by the state; `variance` (..., n) of the readings, in^2; `refusals` (..., n) int8, a `Refusal` each. A beam left
    out has innovation 0, a row of zeros and variance 1: it says nothing, and arrays keep their shape.
    """

    innovation: Floats
    jacobian: Floats
    variance: Floats
    refusals: Codes

    @property
    def used(self) -> Mask:
        """Which beams may correct, (..., n)."""
        accepted: Mask = self.refusals == Refusal.NONE.value
        return accepted

    def reasons(self) -> tuple[Refusal, ...]:
        """The refusals of a single robot's beams, as words."""
        return tuple(Refusal(int(code)) for code in self.refusals.reshape(-1))


SPAN_IN: Final = 249.0
"""Bad readings lie anywhere from 6 to 255 inches."""
MOSTLY_BAD: Final = 0.5
"""A reading that is bad with more than this probability is told of as refused by the gate; its NIS says nothing."""


class Judgement(NamedTuple):
    """What became of a reading: why it said nothing (NONE: it did), reading less expectation (0 where nothing was
    expected) with its normalised square, and how likely it was a bad one."""

    refusal: Refusal
    innovation_in: float
    nis: float
    bad_share: float


def told_as(bad_share: float) -> Refusal:
    """What became of a reading that was so likely a bad one: refused by the gate, or taken."""
    return Refusal.GATE if bad_share > MOSTLY_BAD else Refusal.NONE


TELLING: Final = frozenset({Refusal.NONE, Refusal.NO_WALL, Refusal.GATE})
"""What becomes of readings that tell whether the belief is right; others are left out whatever they say."""
