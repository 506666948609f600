"""Answers to the tasks of notebook 07."""

import math
from statistics import NormalDist

import numpy as np


def mahalanobis2__wrong_root(innovation, S):
    return math.sqrt(innovation @ np.linalg.inv(S) @ innovation)


def mahalanobis2__wrong_not_inverted(innovation, S):
    return innovation @ S @ innovation


def mahalanobis2__wrong_diagonal(innovation, S):
    # The sum over single variances ignores the covariances.
    return sum(innovation**2 / np.diag(S))


def mahalanobis2__right_cholesky(innovation, S):
    # S = L L', so that the squared norm of L^-1 v is v' S^-1 v; a 1 x 1 matrix is accepted as a number.
    white = np.linalg.solve(np.linalg.cholesky(S), innovation)
    return [[white @ white]]


def nearest_reflector__wrong_inches(z, expected, variances, gate):
    # The nearest in inches is not the nearest in standard deviations.
    k = int(np.argmin(abs(z - expected)))
    return k if (z - expected[k]) ** 2 / variances[k] < gate else -1


def nearest_reflector__wrong_no_gate(z, expected, variances, gate):
    return int(np.argmin((z - expected) ** 2 / variances))


def nearest_reflector__wrong_gate_of_root(z, expected, variances, gate):
    # The gate is for the squared distance, and is compared with its root.
    distances = abs(z - expected) / np.sqrt(variances)
    return int(np.argmin(distances)) if distances.min() < gate else -1


def nearest_reflector__right_loop(z, expected, variances, gate):
    best, index = gate, -1
    for k, (e, s) in enumerate(zip(expected, variances, strict=True)):
        if (z - e) ** 2 / s < best:
            best, index = (z - e) ** 2 / s, k
    return float(index)


def association_probabilities__wrong_not_normalized(innovations, variances, p_random):
    density = np.exp(-0.5 * innovations**2 / variances) / np.sqrt(2 * np.pi * variances)
    return np.append((1 - p_random) / len(innovations) * density, p_random / 255)


def association_probabilities__wrong_bell(innovations, variances, p_random):
    # Without 1 / sqrt(2 pi variance): a wide reflector gets too much weight.
    w = np.append((1 - p_random) / len(innovations) * np.exp(-0.5 * innovations**2 / variances), p_random / 255)
    return w / w.sum()


def association_probabilities__wrong_prior(innovations, variances, p_random):
    density = np.exp(-0.5 * innovations**2 / variances) / np.sqrt(2 * np.pi * variances)
    # The prior is not divided among the reflectors.
    w = np.append((1 - p_random) * density, p_random / 255)
    return w / w.sum()


def association_probabilities__right_list(innovations, variances, p_random):
    m = len(innovations)
    w = [(1 - p_random) / m * NormalDist(0, math.sqrt(v)).pdf(e) for e, v in zip(innovations, variances, strict=True)]
    total = sum(w) + p_random / 255
    return [*(each / total for each in w), p_random / 255 / total]
