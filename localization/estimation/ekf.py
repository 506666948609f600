"""The extended Kalman filter: the correction by many readings at once.

Rules: pure; no map, no sensor, no gate, no clock. Which beams may correct is settled before (observation.Observation).
Leading dimensions are independent filters.

    correct   K = P H' (H P H' + R)^-1, the gain   mean' = mean + K innovation
              P' = (I - K H) P (I - K H)' + K R K'   (Joseph: symmetric, never negative, whatever rounding does to K)

R is diagonal, so with A = H' R^-1 H the matrix inversion lemma gives K = M H' R^-1, M = (I + P A)^-1 P: one system as
large as the state instead of one as large as the ring. Then K H = M A and K R K' = M A M'.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from localization.estimation.belief import Belief, Floats, add, difference
from localization.estimation.observation import Observation


def correct(belief: Belief, observation: Observation) -> Belief:
    """The belief after an observation of n beams; any state of three coordinates or more."""
    weighted = (observation.jacobian / observation.variance[..., None]).swapaxes(-1, -2)
    gained = weighted @ observation.jacobian
    identity = _identity(belief.mean.shape[-1])
    spread = np.linalg.solve(identity + belief.cov @ gained, belief.cov)
    learned = spread @ gained
    cov = _around(identity - learned, belief.cov) + learned @ spread.swapaxes(-1, -2)
    change = spread @ (weighted @ observation.innovation[..., None])
    return Belief(add(belief.mean, change[..., 0]), _symmetric(cov))


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
