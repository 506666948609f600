"""Answers to the tasks of notebook 05."""

import numpy as np


def predict_line__wrong_away(x, P, u, Q):
    # The robot drives towards the wall: its distance becomes smaller.
    return x + u, P + Q


def predict_line__wrong_same_variance(x, P, u, Q):
    return x - u, P


def predict_line__wrong_smaller_variance(x, P, u, Q):
    return x - u, P - Q


def predict_line__right_matrices(x, P, u, Q):
    F, B = np.eye(1), -np.eye(1)
    return np.concatenate(((F @ [x] + B @ [u]), (F * P @ F.T + Q).ravel()))


def update_line__wrong_gain(x, P, z, R):
    K = R / (P + R)
    return x + K * (z - x), (1 - K) * P


def update_line__wrong_same_variance(x, P, z, R):
    return x + P / (P + R) * (z - x), P


def update_line__wrong_mean(x, P, z, R):
    # The plain mean is right only if both variances are equal.
    return (x + z) / 2, P / 2


def update_line__wrong_innovation(x, P, z, R):
    return x + P / (P + R) * (x - z), P * R / (P + R)


def update_line__right_information(x, P, z, R):
    information = 1 / P + 1 / R
    return (x / P + z / R) / information, 1 / information


def update_line__right_joseph(x, P, z, R):
    K = P / (P + R)
    return [(1 - K) * x + K * z, (1 - K) ** 2 * P + K**2 * R]


def is_consistent__wrong_one_sided(innovations, variances):
    # A filter that is too cautious has a small mean, and must fail, too.
    return np.mean(innovations**2 / variances) < 1 + 2 * np.sqrt(2 / len(innovations))


def is_consistent__wrong_mean_innovation(innovations, variances):
    return abs(np.mean(innovations)) < 2 * np.sqrt(np.mean(variances))


def is_consistent__wrong_std_for_variance(innovations, variances):
    return abs(np.mean((innovations / variances) ** 2) - 1) < 2 * np.sqrt(2 / len(innovations))


def is_consistent__right_wilson_hilferty(innovations, variances):
    n = len(innovations)
    # Quantiles of chi-square by Wilson and Hilferty's approximation, at 95 percent.
    low, high = (n * (1 - 2 / (9 * n) + z * np.sqrt(2 / (9 * n))) ** 3 for z in (-1.96, 1.96))
    return low < sum(e * e / s for e, s in zip(innovations, variances, strict=True)) < high


def is_consistent__right_fraction_of_gate(innovations, variances):
    # Half of the values of a normal distribution lie within 0.6745 standard deviations.
    inside = np.mean(np.abs(innovations) < 0.6745 * np.sqrt(variances))
    return 0.35 < inside < 0.65
