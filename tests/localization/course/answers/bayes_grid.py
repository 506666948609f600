"""Answers to the tasks of notebook 04."""

from statistics import NormalDist

import numpy as np


def predict_grid__wrong_wraps(belief, kernel):
    # np.roll moves what leaves at the last cell to the first one.
    return sum(p * np.roll(belief, k) for k, p in enumerate(kernel))


def predict_grid__wrong_loses(belief, kernel):
    # What moves beyond the last cell is cut off instead of staying there.
    return np.convolve(belief, kernel)[: len(belief)]


def predict_grid__wrong_normalizes(belief, kernel):
    moved = np.convolve(belief, kernel)[: len(belief)]
    return moved / moved.sum()


def predict_grid__wrong_first_cell_forgotten(belief, kernel):
    # The kernel is mirrored: the robot moves least where it should move most.
    return np.convolve(belief, kernel[::-1])[: len(belief)]


def predict_grid__right_matrix(belief, kernel):
    n = len(belief)
    T = np.zeros((n, n))
    for i in range(n):
        for k, p in enumerate(kernel):
            # Column i holds the probabilities of moving from cell i; beyond the end the robot stays in the last cell.
            T[min(i + k, n - 1), i] += p
    return (T @ belief).tolist()


def update_grid__wrong_not_normalized(belief, likelihood):
    return belief * likelihood


def update_grid__wrong_without_prior(belief, likelihood):
    return likelihood / likelihood.sum()


def update_grid__wrong_zero(belief, likelihood):
    # A likelihood of 0 everywhere gives 0 / 0.
    return belief * likelihood / (belief * likelihood).sum()


def update_grid__right_in_place(belief, likelihood):
    if not any(likelihood):
        return belief
    belief *= likelihood
    belief /= sum(belief)
    return belief


def reading_likelihood__wrong_without_random(z, expected, std, p_random):
    return np.array([NormalDist(e, std).pdf(z) for e in expected])


def reading_likelihood__wrong_bell(z, expected, std, p_random):
    return (1 - p_random) * np.exp(-0.5 * ((z - expected) / std) ** 2) + p_random / 255


def reading_likelihood__wrong_uniform(z, expected, std, p_random):
    # The random readings have a density of p / 255 an inch, and not p.
    return np.array([(1 - p_random) * NormalDist(e, std).pdf(z) + p_random for e in expected])


def reading_likelihood__right_loop(z, expected, std, p_random):
    return [(1 - p_random) * NormalDist(e, std).pdf(z) + p_random / 255 for e in expected]
