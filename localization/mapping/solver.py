"""Sparse least squares of a map: block cyclic reduction for the poses, Schur complement for everything else.

    [ T   C ] [ dx ]   [ g ]        T   block tridiagonal: poses, coupled by the odometry to their neighbours only
    [ C'  D ] [ db ] = [ h ]        D   small and dense: walls, points and calibration parameters (the border)

    S  = D - C' T^-1 C              S db = h - C' T^-1 g,   dx = T^-1 g - T^-1 C db

S^-1 is the covariance of the border. T is solved for all columns of C and g at once; every second pose is eliminated
in one array operation, so a trajectory of n poses takes log2 n of them.

References
----------
Golub, Van Loan, Matrix Computations (2013), section 4.5.4 (block cyclic reduction). Triggs, McLauchlan, Hartley,
Fitzgibbon, Bundle Adjustment (2000), section 6.1 (Schur complement). Nocedal, Wright, Numerical Optimization (2006),
section 10.3 (Levenberg-Marquardt).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from localization.filters.belief import Floats

STRETCH: Final = 32
"""Poses of which C' T^-1 C is added at once: 16 s of driving, in which a robot is in one room or two."""


@dataclass(slots=True)
class NormalEquations:
    """J' J and -J' r of a problem of n poses and a border of m unknowns.

    Attributes
    ----------
    diagonal, upper
        (n, 3, 3) and (n - 1, 3, 3) blocks of T, the second ones to the right of the diagonal.
    coupling
        (n, 3, m), the matrix C.
    border
        (m, m), the matrix D.
    pose_gradient, border_gradient
        (n, 3) and (m,), the right-hand sides g and h.
    """

    diagonal: Floats
    upper: Floats
    coupling: Floats
    border: Floats
    pose_gradient: Floats
    border_gradient: Floats

    def solve(self, damping: float = 0.0) -> tuple[Floats, Floats]:
        """Return the step of the poses (n, 3) and of the border (m,).

        Parameters
        ----------
        damping
            Fraction by which the diagonal is increased: Levenberg-Marquardt; 0 is Gauss-Newton.
        """
        poses, reduced, right = self._eliminate(damping)
        border: Floats = np.asarray(np.linalg.solve(reduced, right), dtype=np.float64)
        return poses[..., -1] - poses[..., :-1] @ border, border

    def reduced(self) -> tuple[Floats, Floats]:
        """Return S (m, m) and its right-hand side (m,): the border with all poses eliminated."""
        _, reduced, right = self._eliminate(0.0)
        return reduced, right

    def border_covariance(self) -> Floats:
        """Return S^-1 (m, m), the covariance of walls, points and parameters with all poses marginalized."""
        covariance = np.linalg.inv(self.reduced()[0])
        return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)

    def covariance(self) -> Covariance:
        """Return the blocks of the inverse of the whole matrix that residuals of one or two neighbouring poses need."""
        columns, reduced, _ = self._eliminate(0.0)
        border: Floats = np.asarray(np.linalg.inv(reduced), dtype=np.float64)
        W = columns[..., :-1]
        diagonal, upper = invert_block_tridiagonal(self.diagonal, self.upper)
        coupling = -W @ border
        return Covariance(
            diagonal - coupling @ W.swapaxes(-1, -2), upper - coupling[:-1] @ W[1:].swapaxes(-1, -2), coupling, border
        )

    def _eliminate(self, damping: float) -> tuple[Floats, Floats, Floats]:
        """Return T^-1 [C g], S and the right-hand side of the border."""
        diagonal, border = self.diagonal, self.border
        if damping:
            # The unit keeps unknowns that nothing measures from moving.
            diagonal = diagonal + damping * (diagonal + np.eye(3)) * np.eye(3)
            border = border + damping * np.diag(np.diag(border) + 1.0)
        columns = np.concatenate((self.coupling, self.pose_gradient[..., None]), axis=-1)
        poses = solve_block_tridiagonal(diagonal, self.upper, columns)
        # The walls and points of one room are not measured from another: most columns of a stretch are 0.
        reduced = np.zeros((self.coupling.shape[-1], columns.shape[-1]))
        for start in range(0, len(poses), STRETCH):
            coupling = self.coupling[start : start + STRETCH]
            used = np.flatnonzero(coupling.any(axis=(0, 1)))
            # No BLAS: its threads cost more than they save here, and their number would change the rounding.
            reduced[used] += np.einsum("npi,npj->ij", coupling[..., used], poses[start : start + STRETCH])
        return poses, border - reduced[:, :-1], self.border_gradient - reduced[:, -1]


@dataclass(frozen=True, slots=True)
class Covariance:
    """Covariances of poses (n, 3, 3), of each with the next one (n - 1, 3, 3), with the border (n, 3, m), and of it."""

    poses: Floats
    neighbours: Floats
    coupling: Floats
    border: Floats


def invert_block_tridiagonal(diagonal: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Return the blocks of T^-1 on the diagonal (n, k, k) and to the right of it (n - 1, k, k), for T as below.

    References
    ----------
    Rauch, Tung, Striebel, Maximum Likelihood Estimates of Linear Dynamic Systems (1965): the backward recursion.
    """
    # 1. Forward: the information of each unknown without what follows it.
    filtered = np.empty_like(diagonal)
    filtered[0] = np.linalg.inv(diagonal[0])
    for k in range(len(upper)):
        filtered[k + 1] = np.linalg.inv(diagonal[k + 1] - upper[k].T @ filtered[k] @ upper[k])
    # 2. Backward: with it.
    on, off = filtered.copy(), np.empty_like(upper)
    for k in range(len(upper) - 1, -1, -1):
        gain = filtered[k] @ upper[k]
        off[k] = -gain @ on[k + 1]
        on[k] -= off[k] @ gain.T
    return on, off


def solve_block_tridiagonal(diagonal: Floats, upper: Floats, right: Floats) -> Floats:
    """Return T^-1 right (n, k, m) for a symmetric positive definite block tridiagonal T.

    Parameters
    ----------
    diagonal
        (n, k, k) blocks of the diagonal.
    upper
        (n - 1, k, k) blocks to the right of it.
    right
        (n, k, m) right-hand sides.

    References
    ----------
    Golub, Van Loan, Matrix Computations (2013), section 4.5.4.
    """
    count = len(diagonal)
    if count == 1:
        return np.asarray(np.linalg.solve(diagonal, right), dtype=np.float64)
    # 1. The odd unknowns by their neighbours: x_o = inverse (right_o - upper_(o-1)' x_(o-1) - upper_o x_(o+1)).
    odds = count // 2
    inverse = np.linalg.inv(diagonal[1::2])
    to_left = upper[0::2]
    to_right = upper[1::2]
    rights = odds if count % 2 else odds - 1
    solved = inverse @ right[1::2]
    by_left = inverse @ to_left.swapaxes(-1, -2)
    by_right = inverse[:rights] @ to_right
    # 2. They are inserted in the rows of the even unknowns, which form a system of the same kind, of half the size.
    half_diagonal, half_right = diagonal[0::2].copy(), right[0::2].copy()
    half_diagonal[:odds] -= to_left @ by_left
    half_right[:odds] -= to_left @ solved
    half_diagonal[1 : rights + 1] -= to_right.swapaxes(-1, -2) @ by_right
    half_right[1 : rights + 1] -= to_right.swapaxes(-1, -2) @ solved[:rights]
    half_upper = -to_left[:rights] @ by_right
    evens = solve_block_tridiagonal(half_diagonal, half_upper, half_right)
    # 3. Back substitution.
    solution = np.empty_like(right)
    solution[0::2] = evens
    solved -= by_left @ evens[:odds]
    solved[:rights] -= by_right @ evens[1 : rights + 1]
    solution[1::2] = solved
    return solution
