"""Answers to the tasks of notebook 06."""

import math

import numpy as np


def _move(pose, step):
    angle = pose[2] + step[1] / 2
    return pose + np.array([step[0] * math.cos(angle), step[0] * math.sin(angle), step[1]])


def _jacobians(heading, d, a):
    c, s = math.cos(heading + a / 2), math.sin(heading + a / 2)
    F = np.array([[1, 0, -d * s], [0, 1, d * c], [0, 0, 1]])
    return F, np.array([[c, -d / 2 * s], [s, d / 2 * c], [0, 1]])


def motion_jacobians__wrong_transposed(heading, d, a):
    F, G = _jacobians(heading, d, a)
    return F.T, G


def motion_jacobians__wrong_without_identity(heading, d, a):
    F, G = _jacobians(heading, d, a)
    return F - np.eye(3), G


def motion_jacobians__wrong_chain_rule(heading, d, a):
    F, G = _jacobians(heading, d, a)
    # Without the factor 1/2 that the heading in the middle of the step has by the chain rule.
    return F, G * [[1, 2], [1, 2], [1, 1]]


def motion_jacobians__wrong_signs(heading, d, a):
    F, G = _jacobians(heading, d, a)
    return 2 * np.eye(3) - F, G


def motion_jacobians__right_differences(heading, d, a):
    pose, step, e = np.array([0.0, 0.0, heading]), np.array([d, a]), 1e-6
    # Numerical differences approximate the derivatives to about 1e-6, which the check must accept.
    F = [(_move(pose + e * row, step) - _move(pose, step)) / e for row in np.eye(3)]
    G = [(_move(pose, step + e * row) - _move(pose, step)) / e for row in np.eye(2)]
    return np.transpose(F), np.transpose(G).tolist()


def _range(pose, bearing, n, rho):
    angle = pose[2] + bearing
    return (rho - n[0] * pose[0] - n[1] * pose[1]) / (n[0] * math.cos(angle) + n[1] * math.sin(angle))


def range_and_jacobian__right_differences(pose, bearing, n, rho):
    h = _range(pose, bearing, n, rho)
    return h, [(_range(pose + e, bearing, n, rho) - _range(pose - e, bearing, n, rho)) / 2e-6 for e in 1e-6 * np.eye(3)]


def range_and_jacobian__wrong_signs(pose, bearing, n, rho):
    h, H = range_and_jacobian__right_differences(pose, bearing, n, rho)
    return h, -np.array(H)


def range_and_jacobian__wrong_heading_forgotten(pose, bearing, n, rho):
    h, H = range_and_jacobian__right_differences(pose, bearing, n, rho)
    return h, [*H[:2], 0]


def range_and_jacobian__wrong_perpendicular(pose, bearing, n, rho):
    _, H = range_and_jacobian__right_differences(pose, bearing, n, rho)
    # The distance to the wall's line, and not along the beam.
    return rho - n @ pose[:2], H


def range_and_jacobian__wrong_not_slanted(pose, bearing, n, rho):
    h, H = range_and_jacobian__right_differences(pose, bearing, n, rho)
    return h, [-n[0], -n[1], H[2]]


def update_pose__wrong_innovation(x, P, innovation, H, R):
    K = P @ H / (H @ P @ H + R)
    return x - K * innovation, P - np.outer(K, H @ P)


def update_pose__wrong_without_noise(x, P, innovation, H, R):
    # S without the noise of the reading: the gain is too large.
    K = P @ H / (H @ P @ H)
    return x + K * innovation, P - np.outer(K, H @ P)


def update_pose__wrong_same_covariance(x, P, innovation, H, R):
    return x + P @ H / (H @ P @ H + R) * innovation, P


def update_pose__wrong_dot(x, P, innovation, H, R):
    K = P @ H / (H @ P @ H + R)
    # H P is a row vector: `K @ H` is a number, where the matrix K H is meant.
    return x + K * innovation, P - (K @ H) * P


def update_pose__right_joseph(x, P, innovation, H, R):
    H = H.reshape(1, 3)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(3) - K @ H
    # The form of Joseph, with columns instead of plain vectors.
    return (x.reshape(3, 1) + K * innovation), A @ P @ A.T + R * K @ K.T


def update_pose__right_information(x, P, innovation, H, R):
    # The same update in terms of information matrices.
    P = np.linalg.inv(np.linalg.inv(P) + np.outer(H, H) / R)
    return x + P @ H * innovation / R, P
