"""Answers to the tasks of notebook 10."""

import numpy as np


def fit_scale__wrong_inverse(counted, measured):
    return np.mean(counted / measured)


def fit_scale__wrong_difference(counted, measured):
    return np.mean(measured - counted)


def fit_scale__wrong_error(counted, measured):
    return np.mean(measured / counted) - 1


def fit_scale__right_mean_ratio(counted, measured):
    return np.mean(measured / counted)


def fit_scale__right_sums(counted, measured):
    return sum(measured) / sum(counted)


def fit_turn_and_drift__wrong_order(distances, turns, true):
    return np.linalg.lstsq(np.column_stack((distances, turns)), true, rcond=None)[0]


def fit_turn_and_drift__wrong_no_drift(distances, turns, true):
    return true @ turns / (turns @ turns), 0


def fit_turn_and_drift__wrong_sign(distances, turns, true):
    scale, drift = np.linalg.lstsq(np.column_stack((turns, distances)), true, rcond=None)[0]
    return scale, -drift


def fit_turn_and_drift__right_normal_equations(distances, turns, true):
    # The normal equations, solved by Cramer's rule.
    a, b, c = turns @ turns, turns @ distances, distances @ distances
    p, q = turns @ true, distances @ true
    return [(c * p - b * q) / (a * c - b * b), (a * q - b * p) / (a * c - b * b)]


def _information(distances, turns):
    A = np.column_stack((turns, distances))
    return A.T @ A


def fit_std__wrong_variance(distances, turns, sigma):
    return sigma**2 * np.diag(np.linalg.inv(_information(distances, turns)))


def fit_std__wrong_not_inverted(distances, turns, sigma):
    return sigma * np.sqrt(np.diag(_information(distances, turns)))


def fit_std__wrong_without_noise(distances, turns, sigma):
    return np.sqrt(np.diag(np.linalg.inv(_information(distances, turns))))


def fit_std__right_svd(distances, turns, sigma):
    # The rows of V' divided by the singular values: their squares sum up to the inverse of A' A.
    _, s, Vt = np.linalg.svd(np.column_stack((turns, distances)), full_matrices=False)
    return (sigma * np.sqrt(((Vt.T / s) ** 2).sum(axis=1))).tolist()


def sonar_offset__wrong_mean(readings, ranges):
    return np.mean(readings - ranges)


def sonar_offset__wrong_sign(readings, ranges):
    return np.median(ranges - readings)


def sonar_offset__wrong_mean_without_255(readings, ranges):
    # Readings of 255 are left out, and other outliers still move a mean.
    return np.mean((readings - ranges)[readings < 255])


def sonar_offset__right_trimmed(readings, ranges):
    errors = np.sort(readings - ranges)
    # Values near the median alone: outliers have no effect.
    errors = errors[abs(errors - errors[len(errors) // 2]) < 4]
    return errors.mean()
