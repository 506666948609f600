"""What a filter holds to be true: a mean and how far it may be off.

Rules: values only, never changed in place; no motion, no measurement, no gain.
States are arrays (..., n), n >= 3: x_in, y_in, heading_rad, then whatever a filter adds (a bias, a scale).
Leading dimensions are seeds, hypotheses or particles. The heading wraps here (`wrap_angle`, `wrapped`) and nowhere
else: states are added and subtracted by `add` and `difference` only.

The chi-square distribution: how large a squared, normalised error may be before it says something is wrong.

Rules: scalars, standard library only (the filter must not need scipy).
chi_square_cdf(x, k) = P(k/2, x/2), the lower regularised incomplete gamma function, by its power series below
x = k + 2 and by the continued fraction above (Abramowitz and Stegun 6.5.29 and 6.5.31); the quantile by bisection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

HEADING: Final = 2
"""Where in a state the heading stands."""

_TURN: Final = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class Belief:
    """A gaussian over states: `mean` (..., n) and covariance `cov` (..., n, n), inches and radians."""

    mean: Floats
    cov: Floats

    @property
    def std(self) -> Floats:
        """The standard deviation of each coordinate, (..., n)."""
        std: Floats = np.sqrt(np.diagonal(self.cov, axis1=-2, axis2=-1))
        return std


def independent(mean: npt.ArrayLike, std: npt.ArrayLike) -> Belief:
    """A belief whose coordinates err independently.

    `mean` (..., n) and `std` (n,) or (..., n), inches and radians. Raises ValueError if a std is negative.
    """
    center = np.array(mean, dtype=np.float64)
    spread = np.broadcast_to(np.asarray(std, dtype=np.float64), center.shape)
    if (spread < 0).any():
        raise ValueError(f"a standard deviation cannot be negative: {std!r}")
    return Belief(add(center, np.zeros_like(center)), spread[..., None] ** 2 * np.eye(center.shape[-1]))


def part(states: Floats, index: int) -> Floats:
    """Coordinate `index` of states (..., n), of shape (...).

    For a single state that is a numpy scalar, not an array without dimensions: arithmetic takes a fifth of the time.
    """
    values: Floats = states[..., index][()]
    return values


def wrap_angle(angle_rad: Floats) -> Floats:
    """The same direction within [-pi, pi]; angles already there are returned to the bit. Any shape."""
    wrapped: Floats = angle_rad - _TURN * np.rint(angle_rad / _TURN)
    return wrapped


def wrapped(angle_rad: float) -> float:
    """`wrap_angle` of a single number, to the bit."""
    return angle_rad - _TURN * round(angle_rad / _TURN)


def add(state: Floats, change: Floats) -> Floats:
    """`state` (..., n) moved by `change` (..., n), its heading wrapped."""
    total: Floats = state + change
    if total.ndim == 1:
        total[HEADING] = wrapped(total.item(HEADING))
    else:
        total[..., HEADING] = wrap_angle(total[..., HEADING])
    return total


def difference(state: Floats, origin: Floats) -> Floats:
    """What must be added to `origin` (..., n) to come to `state` (..., n): the heading the short way round."""
    return add(state, -origin)


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
