"""How far a range that a sonar tells strays from the range there is, and which of them are ranges.

    std = max(relative_std * range, floor_std_in),    variance = std^2 + rounding_var_in2

Rounding errs the same way each time a range is read that stays the same, unless noise shakes it from one step to the
next. Of two readings of one range, with noise of std each, in steps of q, the errors of rounding have the covariance

    q^2 sum_k exp(-4 pi^2 k^2 std^2 / q^2) / (2 pi^2 k^2)  <=  q^2 / 12 exp(-4 pi^2 std^2 / q^2)

(Widrow, Kollar 2008, appendix on dither; the bound is met without noise.)

Rules: pure. What a sonar hears, a ray or a cone, is measurement's and cone's.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi

import numpy as np

from localization.estimation.belief import Floats


@dataclass(frozen=True, slots=True)
class RangeNoise:
    """Standard deviation `relative_std` of the range, at least `floor_std_in`; `rounding_var_in2` besides where
    readings are rounded. Readings at or beyond `lowest_in` and `highest_in` say "no nearer" and "nothing"."""

    relative_std: float = 0.01
    floor_std_in: float = 0.05
    rounding_var_in2: float = 0.0
    lowest_in: float = -np.inf
    highest_in: float = np.inf

    def variance(self, ranges_in: Floats) -> Floats:
        """Variance in in^2 of readings of `ranges_in`, any shape."""
        std = np.maximum(self.relative_std * ranges_in, self.floor_std_in)
        variance: Floats = std * std + self.rounding_var_in2
        return variance

    def constant_at(self, range_in: float) -> float:
        """Of the variance of readings of a range that stays the same, the part that is one error for all of them."""
        if not self.rounding_var_in2:
            return 0.0
        std = max(self.relative_std * range_in, self.floor_std_in)
        return self.rounding_var_in2 * exp(-(pi * std) ** 2 / (3.0 * self.rounding_var_in2))

    def variance_at(self, range_in: float) -> float:
        """`variance` of a single range."""
        std = max(self.relative_std * range_in, self.floor_std_in)
        return std * std + self.rounding_var_in2
