"""How far a range that a sonar tells strays from the range there is, and which of them are ranges.

    std = max(relative_std * range, floor_std_in),    variance = std^2 + rounding_var_in2

Rules: pure. What a sonar hears, a ray or a cone, is measurement's and cone's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localization.belief import Floats


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

    def variance_at(self, range_in: float) -> float:
        """`variance` of a single range."""
        std = max(self.relative_std * range_in, self.floor_std_in)
        return std * std + self.rounding_var_in2
