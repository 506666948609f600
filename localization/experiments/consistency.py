"""Whether a filter is as good as it says: NEES, the band it must keep, and the bound no filter can beat.

Rules: pure functions on arrays; knows errors, covariances and Jacobians, not the runs they come from.
NIS needs no truth and is the filter's own: ekf.innovation_squared.
"""

from __future__ import annotations

import numpy as np

from localization.filters.belief import Floats, chi_square_quantile


def nees(error: Floats, cov: Floats) -> Floats:
    """Normalised estimation error squared (...): error' cov^-1 error of errors (..., n) and covariances (..., n, n).

    Chi-square of n degrees of freedom where the covariance is honest, so n on average. Raises LinAlgError where a
    covariance is singular.
    """
    value: Floats = (error * np.linalg.solve(cov, error[..., None])[..., 0]).sum(axis=-1)
    return value


def mean_band(dof: int, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Where the mean of `runs` independent chi-squares of `dof` lies with that probability, symmetric in its tails."""
    tail = 0.5 * (1.0 - probability)
    low, high = (chi_square_quantile(p, dof * runs) / runs for p in (tail, 1.0 - tail))
    return low, high


def information(jacobian: Floats, variance: Floats) -> Floats:
    """What n readings of `variance` (..., n) tell of m coordinates: H' R^-1 H, (..., m, m), of H (..., n, m)."""
    by_state: Floats = np.swapaxes(jacobian / variance[..., None], -1, -2) @ jacobian
    return by_state


def bound_step(cov: Floats, by_state: Floats, process_cov: Floats, gained: Floats) -> Floats:
    """One step of the posterior Cramer-Rao bound (Tichavsky, Muravchik, Nehorai 1998), all arrays (..., n, n).

    Their recursion of the information J, J' = D22 - D21 (J + D11)^-1 D12, needs Q^-1; here Q has rank 2. With the
    matrix inversion lemma it is the same as, for C = J^-1,

        C- = F C F' + Q        C' = (C-^-1 + gained)^-1 = (I + C- gained)^-1 C-

    which needs no inverse of Q. F, Q and `gained` (see `information`) are taken along the true path.
    """
    prior = by_state @ cov @ np.swapaxes(by_state, -1, -2) + process_cov
    bound = np.asarray(np.linalg.solve(np.eye(cov.shape[-1]) + prior @ gained, prior), dtype=np.float64)
    halves: Floats = 0.5 * (bound + np.swapaxes(bound, -1, -2))
    return halves
