"""What beams say about a state, and why some of them say nothing: what passes between gate and filter.

Rules: values only. The gate (gating) makes observations, a filter (ekf) takes them; neither knows the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

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
