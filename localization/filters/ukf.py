"""Gaussians as a handful of points: the scaled unscented transform (Julier and Uhlmann 1997; Wan, van der Merwe 2000).

    x_0 = mean     x_i = mean +- columns of sqrt((n + lambda) P)     lambda = alpha^2 (n + kappa) - n
    w_0 = lambda / (n + lambda)     w_0' = w_0 + 1 - alpha^2 + beta     w_i = w_i' = 1 / (2 (n + lambda))

The points go through a function as it is; mean and covariance of what comes out are taken with w and w'. No derivative
is needed, and what curves the function within the spread of the belief is seen. Rules: pure; one belief, no batches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Belief, Floats, add, difference
from localization.filters.odometry import OdometryNoise, move_states, step_variance


@dataclass(frozen=True, slots=True)
class Spread:
    """alpha, beta, kappa by their usual names. With these no weight is negative, so no covariance can become so."""

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0


UNSCENTED: Final = Spread()


class Weights(NamedTuple):
    """Of 2 n + 1 points: `mean` and `cov` (2 n + 1,), and how many roots of the covariance the points are away."""

    mean: Floats
    cov: Floats
    reach: float


def weights(size: int, spread: Spread = UNSCENTED) -> Weights:
    """The weights for states of `size` coordinates. Raises ValueError where n + lambda is not positive."""
    scale = spread.alpha**2 * (size + spread.kappa)
    if not scale > 0.0:
        raise ValueError(f"alpha^2 (n + kappa) must be positive, not {scale}")
    of_mean = np.full(2 * size + 1, 0.5 / scale)
    of_mean[0] = 1.0 - size / scale
    of_cov = of_mean.copy()
    of_cov[0] += 1.0 - spread.alpha**2 + spread.beta
    return Weights(of_mean, of_cov, float(np.sqrt(scale)))


def offsets(root: Floats, reach: float) -> Floats:
    """How far the 2 n + 1 points lie from the mean, (2 n + 1, n), of a root (n, n) of the covariance."""
    size = len(root)
    away = np.zeros((2 * size + 1, size))
    away[1 : size + 1] = reach * root.T
    away[size + 1 :] = -away[1 : size + 1]
    return away


def root_of(cov: Floats) -> Floats:
    """A root (n, n) with root root' = cov: Cholesky's, and where a coordinate is certain, by eigenvalues."""
    try:
        root = np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(cov)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def predict(belief: Belief, step: Floats, noise: OdometryNoise) -> Belief:
    """The belief over states (n,) after a step (2,) that the encoders tell: the points of state and step noise together
    (n + 2 coordinates), each moved as it says."""
    size = len(belief.mean)
    root = np.zeros((size + 2, size + 2))
    root[:size, :size] = root_of(belief.cov)
    root[size:, size:] = np.diag(np.sqrt(step_variance(step, noise)))
    weight = weights(size + 2)
    away = offsets(root, weight.reach)
    moved = move_states(add(belief.mean, away[:, :size]), step + away[:, size:])
    off = difference(moved, moved[0])
    middle = weight.mean @ off
    off -= middle
    cov = (off * weight.cov[:, None]).T @ off
    return Belief(add(moved[0], middle), 0.5 * (cov + cov.T))
