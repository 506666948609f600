"""The extended Kalman filter: two functions and a value (belief.Belief).

Rules: pure; no map, no sensor, no gate, no clock. Which beams may correct is settled before (observation.Observation).
Leading dimensions are independent filters.

    predict   mean' = move(mean, step)             P' = F P F' + Q
    correct   K = P H' (H P H' + R)^-1, the gain   mean' = mean + K innovation
              P' = (I - K H) P (I - K H)' + K R K'   (Joseph: symmetric, never negative, whatever rounding does to K)

R is diagonal, so with A = H' R^-1 H the matrix inversion lemma gives K = M H' R^-1, M = (I + P A)^-1 P: one system as
large as the state instead of one as large as the ring. Then K H = M A and K R K' = M A M'.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from localization.estimation.belief import Belief, Floats, add, difference
from localization.estimation.motion import OdometryNoise, carried, transition
from localization.estimation.observation import Observation

Row = tuple[float, float, float]
Rows = list[Row]


def predict(belief: Belief, step: Floats, noise: OdometryNoise) -> Belief:
    """The belief after steps (..., 2) of drho_in and dtheta_rad that the encoders report; state x, y, heading."""
    if belief.mean.ndim == step.ndim == 1:
        return Belief(*carried(belief.mean, belief.cov, step, noise))
    mean, by_pose, process_cov = transition(belief.mean, step, noise)
    return Belief(mean, _symmetric(_around(by_pose, belief.cov) + process_cov))


def correct(belief: Belief, observation: Observation) -> Belief:
    """The belief after an observation of n beams; any state of three coordinates or more."""
    weighted = (observation.jacobian / observation.variance[..., None]).swapaxes(-1, -2)
    gained = weighted @ observation.jacobian
    if belief.mean.shape == (3,):
        return _correct_pose(belief, gained, weighted @ observation.innovation)
    identity = _identity(belief.mean.shape[-1])
    spread = np.linalg.solve(identity + belief.cov @ gained, belief.cov)
    learned = spread @ gained
    cov = _around(identity - learned, belief.cov) + learned @ spread.swapaxes(-1, -2)
    change = spread @ (weighted @ observation.innovation[..., None])
    return Belief(add(belief.mean, change[..., 0]), _symmetric(cov))


def _correct_pose(belief: Belief, gained: Floats, told: Floats) -> Belief:
    """`correct` of a single pose by A = H' R^-1 H (3, 3) and H' R^-1 innovation (3,), in numbers.

    (I + P A)^-1 by Cramer's rule: its determinant is 1 or more.
    """
    prior, by_state = belief.cov.tolist(), gained.tolist()
    (a, b, c), (d, e, f), (g, h, i) = _product(prior, by_state)
    a, e, i = a + 1.0, e + 1.0, i + 1.0
    cofactors = [
        (e * i - f * h, c * h - b * i, b * f - c * e),
        (f * g - d * i, a * i - c * g, c * d - a * f),
        (d * h - e * g, b * g - a * h, a * e - b * d),
    ]
    scale = 1.0 / (a * cofactors[0][0] + b * cofactors[1][0] + c * cofactors[2][0])
    spread = [(x * scale, y * scale, z * scale) for x, y, z in _product(cofactors, prior)]
    learned = _product(spread, by_state)
    (a, b, c), (d, e, f), (g, h, i) = learned
    rest = [(1.0 - a, -b, -c), (-d, 1.0 - e, -f), (-g, -h, 1.0 - i)]
    left = _product(rest, prior)
    xx, xy, xt, yy, yt, tt = (
        _dot(left[row], rest[at]) + _dot(learned[row], spread[at])
        for row, at in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    by_x, by_y, by_heading = told.tolist()
    change = np.array([x * by_x + y * by_y + z * by_heading for x, y, z in spread])
    return Belief(add(belief.mean, change), np.array(((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))))


def _product(one: Rows, other: Rows) -> Rows:
    """Two matrices (3, 3) multiplied."""
    (a, b, c), (d, e, f), (g, h, i) = other
    return [(x * a + y * d + z * g, x * b + y * e + z * h, x * c + y * f + z * i) for x, y, z in one]


def _dot(one: Row, other: Row) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def innovation_squared(before: Belief, after: Belief, observation: Observation) -> Floats:
    """NIS (...): innovation' S^-1 innovation of a correction from `before` to `after`.

    As many degrees of freedom as beams used. S^-1 innovation = R^-1 (innovation - H K innovation), and K innovation is
    what the correction added, so nothing is inverted.
    """
    change = difference(after.mean, before.mean)
    rest = observation.innovation - (observation.jacobian @ change[..., None])[..., 0]
    nis: Floats = (observation.innovation * rest / observation.variance).sum(axis=-1)
    return nis


def _around(factor: Floats, cov: Floats) -> Floats:
    product: Floats = factor @ cov @ factor.swapaxes(-1, -2)
    return product


def _symmetric(cov: Floats) -> Floats:
    """Rounding leaves the two halves of a covariance a few bits apart; their mean."""
    mean: Floats = 0.5 * (cov + cov.swapaxes(-1, -2))
    return mean


@lru_cache(maxsize=8)
def _identity(size: int) -> Floats:
    identity = np.eye(size)
    identity.setflags(write=False)
    return identity
