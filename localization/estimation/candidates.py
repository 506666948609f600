"""What one reading may be of: so many things in the map, each with its range as a function of the pose.

Rules: values only. A sense (filters.sense) finds them, a rule of correction (updates) asks for their ranges elsewhere
than at the mean, the mixture weighs them; none knows the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from localization.estimation.belief import Floats

Expect = Callable[[Floats], tuple[Floats, Floats]]
"""Of poses (..., k, 3), a pose a candidate, or (..., 1, 3), one for all: the ranges (..., k) in inches, and their
derivative by the pose (..., k, 3)."""


class Candidates(NamedTuple):
    """k things that a reading may be of, and how likely it is of none.

    ranges_in, jacobian   (k,) and (k, 3) at the mean of the belief       variance   (k,) of readings of them, in^2
    constant              (k,) the part of it that is one error for all readings from one place (repeats)
    probability           (k,) that it is heard of this one, were no reading bad
    expect                ranges and derivatives anywhere else
    bad_share             of the readings that are of none of them whatever they are
    bad_density           of a bad reading, per inch
    """

    ranges_in: Floats
    jacobian: Floats
    variance: Floats
    constant: Floats
    probability: Floats
    expect: Expect
    bad_share: float
    bad_density: float

    def by_state(self, size: int) -> Floats:
        """The derivative (k, size) by a state that begins with the pose: 0 by the rest."""
        return widened(self.jacobian, size)


def widened(jacobian: Floats, size: int) -> Floats:
    """Derivatives (..., 3) by the pose as derivatives (..., size) by a longer state."""
    if jacobian.shape[-1] == size:
        return jacobian
    wide = np.zeros((*jacobian.shape[:-1], size))
    wide[..., : jacobian.shape[-1]] = jacobian
    return wide
