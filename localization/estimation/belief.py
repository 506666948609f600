"""What a filter holds to be true: a mean and how far it may be off.

Rules: values only, never changed in place; no motion, no measurement, no gain.
States are arrays (..., n), n >= 3: x_in, y_in, heading_rad, then whatever a filter adds (a bias, a scale).
Leading dimensions are seeds, hypotheses or particles. The heading wraps here (`wrap_angle`, `wrapped`) and nowhere
else: states are added and subtracted by `add` and `difference` only.
"""

from __future__ import annotations

from dataclasses import dataclass
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
