"""The unscented Kalman filter: the same steps as the extended one, by sigma points instead of derivatives.

    x_0 = mean     x_i = mean +- columns of sqrt((n + lambda) P)     lambda = alpha^2 (n + kappa) - n
    w_0 = lambda / (n + lambda)     w_0' = w_0 + 1 - alpha^2 + beta     w_i = w_i' = 1 / (2 (n + lambda))

The points go through a function as it is; mean and covariance of the result are taken with w and w'.

References: Julier, Uhlmann, A new extension of the Kalman filter to nonlinear systems (1997); Wan, van der Merwe, The
unscented Kalman filter for nonlinear estimation (2000); Probabilistic Robotics (2005), table 3.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Belief, Floats, add, difference
from localization.filters.odometry import OdometryNoise, move, step_variance
from localization.filters.update import Association, Correction, Covariance, State, readings_at


@dataclass(frozen=True, slots=True)
class Spread:
    """alpha, beta, kappa by their usual names. With these defaults no weight is negative, so no covariance is."""

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0


UNSCENTED: Final = Spread()


class Weights(NamedTuple):
    """Weights `mean` and `cov` (2 n + 1,) of the sigma points, and their distance in roots of the covariance."""

    mean: Floats
    cov: Floats
    reach: float


def weights(n: int, spread: Spread = UNSCENTED) -> Weights:
    """Return the weights for states of n coordinates.

    Raises
    ------
    ValueError
        n + lambda is not positive.
    """
    scale = spread.alpha**2 * (n + spread.kappa)
    if not scale > 0.0:
        raise ValueError(f"alpha^2 (n + kappa) must be positive, not {scale}")
    of_mean = np.full(2 * n + 1, 0.5 / scale)
    of_mean[0] = 1.0 - n / scale
    of_cov = of_mean.copy()
    of_cov[0] += 1.0 - spread.alpha**2 + spread.beta
    return Weights(of_mean, of_cov, float(np.sqrt(scale)))


def offsets(root: Floats, reach: float) -> Floats:
    """Return the 2 n + 1 sigma points less the mean, (2 n + 1, n), for a root (n, n) of the covariance."""
    size = len(root)
    away = np.zeros((2 * size + 1, size))
    away[1 : size + 1] = reach * root.T
    away[size + 1 :] = -away[1 : size + 1]
    return away


def root_of(cov: Floats) -> Floats:
    """Return a root (n, n), root root^T = cov: Cholesky's, or by eigenvalues where a coordinate is certain."""
    try:
        root = np.asarray(np.linalg.cholesky(cov), dtype=np.float64)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(cov)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def predict(belief: Belief, step: Floats, noise: OdometryNoise, constants: int = 0) -> Belief:
    """Return the belief after a step (2,): sigma points of state and step, n + 2 coordinates, each moved as it says."""
    n = len(belief.mean)
    # 1. A root of the joint covariance of state and step.
    root = np.zeros((n + 2, n + 2))
    root[:n, :n] = root_of(belief.cov)
    root[n:, n:] = np.diag(np.sqrt(step_variance(step, noise)))
    # 2. The sigma points through the motion model.
    weight = weights(n + 2)
    away = offsets(root, weight.reach)
    moved = move(add(belief.mean, away[:, :n]), step + away[:, n:], constants)
    # 3. Mean and covariance of the result; headings relative to the first point.
    residual = difference(moved, moved[0])
    mean = weight.mean @ residual
    residual -= mean
    cov = (residual * weight.cov[:, None]).T @ residual
    return Belief(add(moved[0], mean), 0.5 * (cov + cov.T))


def predict_state(x: State, P: Covariance, distance: float, turn: float, noise: OdometryNoise,
                  constants: int = 0) -> None:
    """Apply `predict` to x and P in place."""
    after = predict(Belief(np.array(x), np.array(P)), np.array((distance, turn)), noise, constants)
    x[:], P[:] = after.mean.tolist(), after.cov.tolist()


def unscented(x: State, P: Covariance, reading_in: float, association: Association,
              variances: Sequence[float]) -> list[Correction]:
    """Return the corrections of the unscented filter (see `update.Rule`)."""
    # 1. The sigma points through the range to each reflector.
    weight = weights(len(x))
    away = offsets(root_of(np.array(P)), weight.reach)
    readings = readings_at(association, (np.array(x) + away)[:, None])[0]
    # 2. Mean z, variance S, and covariance with the state.
    expected = weight.mean @ readings
    residual = readings - expected
    S = weight.cov @ (residual * residual) + np.array(variances)
    # 3. The gain.
    K = (residual * weight.cov[:, None]).T @ away / S[:, None]
    innovation = reading_in - expected
    parts = (K, S, innovation, innovation * innovation / S, K * innovation[:, None])
    return list(map(Correction, *(part.tolist() for part in parts)))
