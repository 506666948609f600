import math

import numpy as np


def motion_jacobians(heading, distance, turn):
    c, s = math.cos(heading + turn / 2), math.sin(heading + turn / 2)
    F = np.array([[1, 0, -distance * s], [0, 1, distance * c], [0, 0, 1]])
    G = np.array([[c, -distance / 2 * s], [s, distance / 2 * c], [0, 1]])
    return F, G


def range_and_jacobian(pose, bearing, n, rho):
    angle = pose[2] + bearing
    u, du = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    h = (rho - n @ pose[:2]) / (n @ u)
    return h, np.array([-n[0] / (n @ u), -n[1] / (n @ u), -h * (n @ du) / (n @ u)])


def update_pose(x, P, innovation, H, R):
    S = H @ P @ H + R
    K = P @ H / S
    return x + K * innovation, P - np.outer(K, H @ P)
