"""Block cyclic reduction and the Schur complement against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localization.filters.belief import Floats
from localization.mapping.solver import BlockTridiagonal, NormalEquations, invert_block_tridiagonal


def random_equations(poses: int, border: int, seed: int) -> tuple[NormalEquations, Floats, Floats]:
    """Return equations of a random Jacobian, and the same as a dense matrix and right-hand side."""
    rng = np.random.default_rng(seed)
    size = 3 * poses + border
    J = np.zeros((6 * poses + 2 * border + 6, size))
    for k in range(poses):
        J[6 * k : 6 * k + 6, 3 * k : 3 * k + 6 if k < poses - 1 else 3 * k + 3] = rng.normal(
            size=(6, 6 if k < poses - 1 else 3)
        )
    J[:, 3 * poses :] = rng.normal(size=(len(J), border))
    r = rng.normal(size=len(J))
    H, g = J.T @ J + 0.1 * np.eye(size), -J.T @ r
    pose = slice(0, 3 * poses)
    blocks = H[pose, pose].reshape(poses, 3, poses, 3)
    diagonal = np.array([blocks[k, :, k] for k in range(poses)])
    upper = np.array([blocks[k, :, k + 1] for k in range(poses - 1)]).reshape(-1, 3, 3)
    coupling = H[pose, 3 * poses :].reshape(poses, 3, border)
    equations = NormalEquations(
        diagonal, upper, coupling, H[3 * poses :, 3 * poses :], g[pose].reshape(poses, 3), g[3 * poses :]
    )
    return equations, H, g


@given(st.integers(1, 40), st.integers(1, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_cyclic_reduction_solves_the_dense_system(count: int, columns: int, seed: int) -> None:
    equations, H, _ = random_equations(count, 1, seed)
    right = np.random.default_rng(seed).normal(size=(count, 3, columns))
    found = BlockTridiagonal(equations.diagonal, equations.upper).solve(right)
    dense = np.linalg.solve(H[: 3 * count, : 3 * count], right.reshape(3 * count, columns))
    np.testing.assert_allclose(found.reshape(3 * count, columns), dense, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("poses", [1, 2, 7, 64])
@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_step_is_that_of_the_dense_equations(poses: int, damping: float) -> None:
    equations, H, g = random_equations(poses, 5, poses)
    pose_step, border_step = equations.solve(damping)
    H = H + damping * np.diag(np.diag(H) + 1.0)
    np.testing.assert_allclose(np.concatenate((pose_step.reshape(-1), border_step)), np.linalg.solve(H, g), rtol=1e-8)


def test_border_covariance_is_a_block_of_the_dense_inverse() -> None:
    equations, H, _ = random_equations(9, 6, 3)
    np.testing.assert_allclose(equations.border_covariance(), np.linalg.inv(H)[27:, 27:], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("poses", [1, 2, 9])
def test_covariance_is_made_of_blocks_of_the_dense_inverse(poses: int) -> None:
    equations, H, _ = random_equations(poses, 6, 4)
    found, P, split = equations.covariance(), np.linalg.inv(H), 3 * poses
    blocks = P[:split, :split].reshape(poses, 3, poses, 3)
    on, off = [blocks[k, :, k] for k in range(poses)], [blocks[k, :, k + 1] for k in range(poses - 1)]
    np.testing.assert_allclose(found.poses, on, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.neighbours, np.reshape(off, (-1, 3, 3)), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.coupling.reshape(split, 6), P[:split, split:], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.border, P[split:, split:], rtol=1e-8, atol=1e-12)
    # Without a border.
    T = np.linalg.inv(H[:split, :split]).reshape(poses, 3, poses, 3)
    diagonal, _ = invert_block_tridiagonal(equations.diagonal, equations.upper)
    np.testing.assert_allclose(diagonal, [T[k, :, k] for k in range(poses)], rtol=1e-8, atol=1e-12)


def test_border_unknowns_of_few_poses_are_eliminated_like_all() -> None:
    equations, H, g = random_equations(80, 6, 5)
    equations.coupling[:40, :, :2] = equations.coupling[40:, :, 2:4] = 0.0
    C = equations.coupling.reshape(240, 6)
    T_inverse = np.linalg.inv(H[:240, :240])
    S, h = equations.reduced()
    np.testing.assert_allclose(S, H[240:, 240:] - C.T @ T_inverse @ C, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(h, g[240:] - C.T @ T_inverse @ g[:240], rtol=1e-8, atol=1e-9)
