"""Sparse least squares of a map: block cyclic reduction for the poses, Schur complement for everything else.

    [ T   C ] [ dx ]   [ g ]        T   block tridiagonal: poses, coupled by the odometry to their neighbours only
    [ C'  D ] [ db ] = [ h ]        D   small and dense: walls, points and calibration parameters (the border)

    S  = D - C' T^-1 C              S db = h - C' T^-1 g,   dx = T^-1 g - T^-1 C db

S^-1 is the covariance of the border. Every second pose is eliminated in one array operation, so a trajectory of n poses
takes log2 n of them. Each elimination adds its part of C' T^-1 C, so a step applies T^-1 to one column, g - C db.

References
----------
Golub, Van Loan, Matrix Computations (2013), section 4.5.4 (block cyclic reduction). Triggs, McLauchlan, Hartley,
Fitzgibbon, Bundle Adjustment (2000), section 6.1 (Schur complement). Nocedal, Wright, Numerical Optimization (2006),
section 10.3 (Levenberg-Marquardt).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localization.filters.belief import Floats


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
        return poses.solve((self.pose_gradient - self.coupling @ border)[..., None])[..., 0], border

    def reduced(self) -> tuple[Floats, Floats]:
        """Return S (m, m) and its right-hand side (m,): the border with all poses eliminated."""
        _, reduced, right = self._eliminate(0.0)
        return reduced, right

    def border_covariance(self) -> Floats:
        """Return S^-1 (m, m), the covariance of walls, points, parameters and levels with all poses marginalized."""
        covariance = np.linalg.inv(self.reduced()[0])
        return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)

    def covariance(self) -> Covariance:
        """Return the blocks of the inverse of the whole matrix that residuals of one or two neighbouring poses need."""
        poses, reduced, _ = self._eliminate(0.0)
        border: Floats = np.asarray(np.linalg.inv(reduced), dtype=np.float64)
        W = poses.solve(self.coupling)
        diagonal, upper = invert_block_tridiagonal(self.diagonal, self.upper)
        coupling = -W @ border
        return Covariance(
            diagonal - coupling @ W.swapaxes(-1, -2), upper - coupling[:-1] @ W[1:].swapaxes(-1, -2), coupling, border
        )

    def _eliminate(self, damping: float) -> tuple[BlockTridiagonal, Floats, Floats]:
        """Return T, S and the right-hand side of the border."""
        diagonal, border = self.diagonal, self.border
        if damping:
            # The unit keeps unknowns that nothing measures from moving.
            diagonal = diagonal + damping * (diagonal + np.eye(3)) * np.eye(3)
            border = border + damping * np.diag(np.diag(border) + 1.0)
        poses = BlockTridiagonal(diagonal, self.upper)
        form = poses.inverse_form(np.concatenate((self.coupling, self.pose_gradient[..., None]), axis=-1))
        return poses, border - form[:-1, :-1], self.border_gradient - form[:-1, -1]


@dataclass(frozen=True, slots=True)
class Covariance:
    """Covariances of poses (n, 3, 3), of each with the next one (n - 1, 3, 3), with the border (n, 3, m), and of it."""

    poses: Floats
    neighbours: Floats
    coupling: Floats
    border: Floats


def invert_block_tridiagonal(diagonal: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Return the blocks of T^-1 on the diagonal (n, k, k) and to the right of it (n - 1, k, k) of a `BlockTridiagonal`.

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


@dataclass(frozen=True, slots=True)
class _Halving:
    """The odd ones of n unknowns of k numbers expressed by their neighbours.

    x_o = inverse right_o - by_left x_(o-1) - by_right x_(o+1). Of o odd ones e have a right neighbour: all, or all but
    the last if n is even.

    Attributes
    ----------
    inverse
        (o, k, k) of the blocks of the odd ones.
    to_left, to_right
        (o, k, k) blocks of T between the neighbours and them, (e, k, k) between them and their right neighbours.
    by_left, by_right
        (o, k, k) and (e, k, k).
    """

    inverse: Floats
    to_left: Floats
    to_right: Floats
    by_left: Floats
    by_right: Floats

    def insert(self, right: Floats) -> tuple[Floats, Floats]:
        """Return inverse right_o (o, k, m), and the right-hand sides (n - o, k, m) of the even unknowns alone."""
        odds, rights = len(self.inverse), len(self.to_right)
        solved, half = self.inverse @ right[1::2], right[0::2].copy()
        half[:odds] -= self.to_left @ solved
        half[1 : rights + 1] -= self.to_right.swapaxes(-1, -2) @ solved[:rights]
        return solved, half


class BlockTridiagonal:
    """A symmetric positive definite block tridiagonal matrix T, by cyclic reduction.

    Parameters
    ----------
    diagonal
        (n, k, k) blocks of the diagonal.
    upper
        (n - 1, k, k) blocks to the right of it.

    References
    ----------
    Golub, Van Loan, Matrix Computations (2013), section 4.5.4.
    """

    def __init__(self, diagonal: Floats, upper: Floats) -> None:
        self._halvings = list[_Halving]()
        while (count := len(diagonal)) > 1:
            odds = count // 2
            rights = odds if count % 2 else odds - 1
            # 1. The odd unknowns by their neighbours.
            inverse: Floats = np.asarray(np.linalg.inv(diagonal[1::2]), dtype=np.float64)
            to_left, to_right = upper[0::2], upper[1::2]
            by_left, by_right = inverse @ to_left.swapaxes(-1, -2), inverse[:rights] @ to_right
            self._halvings.append(_Halving(inverse, to_left, to_right, by_left, by_right))
            # 2. Inserted in the rows of the even ones, which form a system of the same kind, of half the size.
            diagonal = diagonal[0::2].copy()
            diagonal[:odds] -= to_left @ by_left
            diagonal[1 : rights + 1] -= to_right.swapaxes(-1, -2) @ by_right
            upper = -to_left[:rights] @ by_right
        self._last = np.linalg.inv(diagonal)

    def solve(self, right: Floats) -> Floats:
        """Return T^-1 right (n, k, m) for right-hand sides (n, k, m)."""
        solved = []
        for halving in self._halvings:
            of_odds, right = halving.insert(right)
            solved.append(of_odds)
        found: Floats = self._last @ right
        for halving, of_odds in zip(reversed(self._halvings), reversed(solved), strict=True):
            odds, rights, evens = len(of_odds), len(halving.by_right), found
            found = np.empty((odds + len(evens), *evens.shape[1:]))
            found[0::2], found[1::2] = evens, of_odds - halving.by_left @ evens[:odds]
            found[1::2][:rights] -= halving.by_right @ evens[1 : rights + 1]
        return found

    def inverse_form(self, right: Floats) -> Floats:
        """Return the sum (m, m) of right' T^-1 right over all unknowns, for (n, k, m).

        Products of flat matrices, though many columns of a pose are 0: BLAS is so much faster than leaving these out.
        """
        count = right.shape[-1]
        total: Floats = np.zeros((count, count))
        for halving in self._halvings:
            of_odds = right[1::2].reshape(-1, count)
            solved, right = halving.insert(right)
            total += of_odds.T @ solved.reshape(-1, count)
        total += right.reshape(-1, count).T @ (self._last @ right).reshape(-1, count)
        return total
