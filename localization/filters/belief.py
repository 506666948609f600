"""Gaussian beliefs over states, and the chi-square distribution of their squared errors.

A state x (..., n), n >= 3, is x_in, y_in, heading_rad, then what a filter adds (a scale, an offset). Leading dimensions
are seeds, hypotheses or particles. States are added and subtracted by `add` and `difference`, which wrap the heading;
the filter's two steps wrap it in `odometry.predict_state` and `update.shift`.

The formulas of the filter (odometry, update, sonar_ray) are written once, element by element, on `Number`: a float for
one live robot, an array for many robots at once. `unit_vector`, `sqrt`, `exp`, `hypot`, `atan2`, `clip`, `wrap_angle`
and `choose` accept either. numba compiles the same source for floats (`compiled`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Number = TypeVar("Number", float, Floats)
"""One value: a float, or an array of any shape with a value for each robot."""

HEADING: Final = 2
"""Index of the heading in a state."""
POSE: Final = 3
"""Coordinates of the pose, with which every state begins."""

_TURN, _HALF_TURN = 2.0 * math.pi, math.pi


def unit_vector(angle_rad: Number) -> tuple[Number, Number]:
    """Return the cosine and the sine of an angle."""
    if isinstance(angle_rad, float):
        return math.cos(angle_rad), math.sin(angle_rad)
    return np.cos(angle_rad), np.sin(angle_rad)


def sqrt(value: Number) -> Number:
    """Return the square root."""
    return math.sqrt(value) if isinstance(value, float) else np.sqrt(value)


def exp(value: Number) -> Number:
    """Return the exponential."""
    return math.exp(value) if isinstance(value, float) else np.exp(value)


def hypot(x: Number, y: Number) -> Number:
    """Return sqrt(x^2 + y^2)."""
    return math.hypot(x, y) if isinstance(x, float) else np.hypot(x, y)


def atan2(y: Number, x: Number) -> Number:
    """Return the direction of (x, y) in [-pi, pi]."""
    return math.atan2(y, x) if isinstance(x, float) else np.arctan2(y, x)


def clip(value: Number, low: float, high: float) -> Number:
    """Return the value, or the limit that it exceeds."""
    return min(max(value, low), high) if isinstance(value, float) else np.clip(value, low, high)


def wrap_angle(angle_rad: Number) -> Number:
    """Return the same direction within [-pi, pi]; angles already there are returned to the bit."""
    if isinstance(angle_rad, float):
        return angle_rad if -_HALF_TURN <= angle_rad <= _HALF_TURN else angle_rad - _TURN * round(angle_rad / _TURN)
    return angle_rad - _TURN * np.rint(angle_rad / _TURN)


def choose(condition: Any, value: Any, other: Any) -> Any:
    """Return `value` where the condition holds, else `other`: bool and numbers, or arrays."""
    if isinstance(condition, bool):
        return value if condition else other
    return np.where(condition, value, other)


@dataclass(frozen=True, slots=True)
class Belief:
    """Gaussian over states: `mean` x (..., n) and covariance `cov` P (..., n, n), inches and radians.

    Arrays are never changed in place.
    """

    mean: Floats
    cov: Floats

    @property
    def std(self) -> Floats:
        """Standard deviation of each coordinate, (..., n)."""
        return np.sqrt(np.diagonal(self.cov, axis1=-2, axis2=-1))

    @property
    def pose(self) -> Belief:
        """The marginal belief over the pose, (..., 3)."""
        return marginal(self, POSE)


def marginal(belief: Belief, size: int) -> Belief:
    """Return the belief over the first `size` coordinates."""
    return Belief(belief.mean[..., :size], belief.cov[..., :size, :size])


def with_constants(belief: Belief, stds: Sequence[float]) -> Belief:
    """Return a belief (..., n) extended by coordinates of mean 0 and these standard deviations, independent of it."""
    size = belief.mean.shape[-1]
    count = size + len(stds)
    mean = np.zeros((*belief.mean.shape[:-1], count))
    mean[..., :size] = belief.mean
    cov = np.zeros((*mean.shape, count))
    cov[..., :size, :size] = belief.cov
    rest = np.arange(size, count)
    cov[..., rest, rest] = np.square(stds)
    return Belief(mean, cov)


def unpack(belief: Belief) -> tuple[list[Any], list[list[Any]]]:
    """Return x and P of a belief element by element, as the formulas of the filter take them.

    Returns
    -------
    tuple of lists
        x, n elements, and P, n rows of n: floats for a single belief (n,), (n, n), arrays (...) for many (..., n).
    """
    if belief.mean.ndim == 1:
        return belief.mean.tolist(), belief.cov.tolist()
    return list(np.moveaxis(belief.mean, -1, 0)), [list(row) for row in np.moveaxis(belief.cov, (-2, -1), (0, 1))]


def pack(x: Sequence[Any], P: Sequence[Sequence[Any]]) -> Belief:
    """Return the belief with the elements x and P: the inverse of `unpack`."""
    if isinstance(x[0], float):
        return Belief(np.array(x), np.array(P))
    n = len(x)
    elements = np.stack(np.broadcast_arrays(*x, *(element for row in P for element in row)), axis=-1)
    return Belief(elements[..., :n], elements[..., n:].reshape(*elements.shape[:-1], n, n))


def add_outer(P: list[list[Number]], weight: Number, v: Sequence[Number]) -> None:
    """Add weight v v^T to P, in place."""
    a, b, c = v[0], v[1], v[2]
    of_x, of_y, of_heading = P[0], P[1], P[2]
    scaled_a, scaled_b = weight * a, weight * b
    of_x[0] = of_x[0] + scaled_a * a
    of_y[0] = of_x[1] = of_x[1] + scaled_a * b
    of_heading[0] = of_x[2] = of_x[2] + scaled_a * c
    of_y[1] = of_y[1] + scaled_b * b
    of_heading[1] = of_y[2] = of_y[2] + scaled_b * c
    of_heading[2] = of_heading[2] + weight * c * c
    for i in range(POSE, len(v)):
        row, scaled = P[i], weight * v[i]
        row[0] = of_x[i] = row[0] + scaled * a
        row[1] = of_y[i] = row[1] + scaled * b
        row[2] = of_heading[i] = row[2] + scaled * c
        for j in range(POSE, i + 1):
            row[j] = P[j][i] = row[j] + scaled * v[j]


def independent(mean: npt.ArrayLike, std: npt.ArrayLike) -> Belief:
    """Return a belief whose coordinates have independent errors.

    Parameters
    ----------
    mean
        (..., n), inches and radians.
    std
        (n,) or (..., n), inches and radians.

    Raises
    ------
    ValueError
        A standard deviation is negative.
    """
    center = np.array(mean, dtype=np.float64)
    spread = np.broadcast_to(np.asarray(std, dtype=np.float64), center.shape)
    if (spread < 0).any():
        raise ValueError(f"a standard deviation cannot be negative: {std!r}")
    return Belief(add(center, np.zeros_like(center)), spread[..., None] ** 2 * np.eye(center.shape[-1]))


def component(states: Floats, index: int) -> Floats:
    """Return coordinate `index` of states (..., n), of shape (...).

    Of a single state that is a numpy scalar, not an array without dimensions: arithmetic takes a fifth of the time.
    """
    return states[..., index][()]


def add(state: Floats, change: Floats) -> Floats:
    """Return `state` (..., n) plus `change` (..., n), its heading wrapped."""
    total: Floats = state + change
    if total.ndim == 1:
        total[HEADING] = wrap_angle(total.item(HEADING))
    else:
        total[..., HEADING] = wrap_angle(total[..., HEADING])
    return total


def difference(state: Floats, origin: Floats) -> Floats:
    """Return what must be added to `origin` (..., n) to give `state` (..., n): the heading by the shorter turn."""
    return add(state, -origin)


def rotate(vectors: Floats, angles_rad: Floats) -> Floats:
    """Return vectors (..., 2) turned counter-clockwise by angles (...)."""
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack((c * x - s * y, s * x + c * y), axis=-1)


def compose(poses: Floats, steps: Floats) -> Floats:
    """Return poses (..., 3) followed by steps (..., 3) in their frames."""
    return np.concatenate(
        (poses[..., :2] + rotate(steps[..., :2], poses[..., 2]), poses[..., 2:] + steps[..., 2:]), axis=-1
    )


def relative_pose(origin: Floats, pose: Floats) -> Floats:
    """Return poses (..., 3) in the frame of others: the inverse of `compose`."""
    step: Floats = pose[..., :POSE] - origin[..., :POSE]
    step[..., :2] = rotate(step[..., :2], -origin[..., HEADING])
    return step


def rigid_fit(points: Floats, targets: Floats) -> tuple[float, Floats]:
    """Return the turn and the shift (2,) that bring points (n, 2) nearest to targets (n, 2).

    References
    ----------
    Umeyama, Least-Squares Estimation of Transformation Parameters Between Two Point Patterns (1991), without scale.
    """
    a, b = points - points.mean(axis=0), targets - targets.mean(axis=0)
    turn = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    return turn, targets.mean(axis=0) - rotate(points.mean(axis=0), np.array(turn))


# The chi-square distribution, with the standard library only: the filter must not need scipy.

_MIN_TERM: Final = 1e-16
"""Terms this small against the sum no longer change a double."""


def chi_square_cdf(value: float, dof: float) -> float:
    """Return the probability that a chi-square variable of `dof` > 0 degrees of freedom is at most `value`.

    Notes
    -----
    P(dof / 2, value / 2), the lower regularised incomplete gamma function: the power series 6.5.29 below
    value = dof + 2, the continued fraction 6.5.31 above.

    References
    ----------
    Abramowitz and Stegun, Handbook of Mathematical Functions, 6.5.
    """
    if dof <= 0:
        raise ValueError(f"degrees of freedom must be positive, not {dof}")
    if value <= 0:
        return 0.0
    shape, point = 0.5 * dof, 0.5 * value
    scale = math.exp(shape * math.log(point) - point - math.lgamma(shape))
    if point < shape + 1.0:
        return scale * _gamma_series(shape, point)
    return 1.0 - scale * _gamma_fraction(shape, point)


@lru_cache(maxsize=256)
def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value that a chi-square variable of `dof` degrees of freedom stays below with `probability`.

    Raises
    ------
    ValueError
        The probability is not in (0, 1).
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"a probability must lie between 0 and 1, not at {probability}")
    # 1. An interval that contains the quantile.
    low, high = 0.0, max(1.0, dof)
    while chi_square_cdf(high, dof) < probability:
        low, high = high, 2.0 * high
    # 2. Bisection down to neighbouring doubles.
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        if chi_square_cdf(middle, dof) < probability:
            low = middle
        else:
            high = middle


def _gamma_series(shape: float, point: float) -> float:
    """Return the sum of point^n / (shape (shape + 1) ... (shape + n)); converges fast for point < shape + 1."""
    term = total = 1.0 / shape
    divisor = shape
    while term > total * _MIN_TERM:
        divisor += 1.0
        term *= point / divisor
        total += term
    return total


def _gamma_fraction(shape: float, point: float) -> float:
    """Return the continued fraction of the upper incomplete gamma function, evaluated from the front (Lentz)."""
    partial = point + 1.0 - shape
    ratio, growth = 1.0 / partial, math.inf
    total = ratio
    change, index = 0.0, 0
    while abs(change - 1.0) > _MIN_TERM * 4:
        index += 1
        factor = index * (shape - index)
        partial += 2.0
        ratio = 1.0 / (factor * ratio + partial)
        growth = partial + factor / growth
        change = growth * ratio
        total *= change
    return total


def nees(error: Floats, cov: Floats) -> Floats:
    """Return the normalised estimation error squared (...), e^T P^-1 e.

    For a consistent filter it is chi-square distributed with n degrees of freedom, so n on average.

    Parameters
    ----------
    error : (..., n) array
    cov : (..., n, n) array

    Raises
    ------
    LinAlgError
        If a covariance is singular.

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
    """
    value: Floats = (error * np.linalg.solve(cov, error[..., None])[..., 0]).sum(axis=-1)
    return value


def normal_density(residual: Floats, variance: Floats) -> Floats:
    """Return the density (...) of residuals that are normally distributed about 0, each with its variance."""
    density: Floats = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    return density
