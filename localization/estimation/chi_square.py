"""The chi-square distribution: how large a squared, normalised error may be before it says something is wrong.

Rules: scalars, standard library only (the filter must not need scipy).
chi_square_cdf(x, k) = P(k/2, x/2), the lower regularised incomplete gamma function, by its power series below
x = k + 2 and by the continued fraction above (Abramowitz and Stegun 6.5.29 and 6.5.31); the quantile by bisection.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

_SMALLEST_TERM: Final = 1e-16
"""Terms this small against the sum no longer change a double."""


def chi_square_cdf(value: float, dof: float) -> float:
    """The probability that a chi-square variable of `dof` > 0 degrees of freedom is at most `value`."""
    if dof <= 0:
        raise ValueError(f"degrees of freedom must be positive, not {dof}")
    if value <= 0:
        return 0.0
    shape, point = 0.5 * dof, 0.5 * value
    scale = math.exp(shape * math.log(point) - point - math.lgamma(shape))
    if point < shape + 1.0:
        return scale * _series(shape, point)
    return 1.0 - scale * _fraction(shape, point)


@lru_cache(maxsize=256)
def chi_square_quantile(probability: float, dof: float) -> float:
    """The value a chi-square variable of `dof` degrees of freedom stays below with `probability` in (0, 1)."""
    if not 0.0 < probability < 1.0:
        raise ValueError(f"a probability must lie between 0 and 1, not at {probability}")
    low, high = 0.0, max(1.0, dof)
    while chi_square_cdf(high, dof) < probability:
        low, high = high, 2.0 * high
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        if chi_square_cdf(middle, dof) < probability:
            low = middle
        else:
            high = middle


def _series(shape: float, point: float) -> float:
    """Sum of point^n / (shape (shape + 1) ... (shape + n)); converges fast for point < shape + 1."""
    term = total = 1.0 / shape
    divisor = shape
    while term > total * _SMALLEST_TERM:
        divisor += 1.0
        term *= point / divisor
        total += term
    return total


def _fraction(shape: float, point: float) -> float:
    """The continued fraction of the upper incomplete gamma function, evaluated from the front (Lentz)."""
    partial = point + 1.0 - shape
    ratio, growth = 1.0 / partial, math.inf
    total = ratio
    change, index = 0.0, 0
    while abs(change - 1.0) > _SMALLEST_TERM * 4:
        index += 1
        factor = index * (shape - index)
        partial += 2.0
        ratio = 1.0 / (factor * ratio + partial)
        growth = partial + factor / growth
        change = growth * ratio
        total *= change
    return total
