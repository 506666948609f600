"""Answers to the tasks of notebook 09."""

import numpy as np


def effective_number__wrong_inverse(weights):
    return sum(weights**2)


def effective_number__wrong_largest(weights):
    return 1 / max(weights)


def effective_number__wrong_count(weights):
    return len(weights)


def effective_number__right_norm(weights):
    return np.linalg.norm(weights) ** -2


def random_fraction__wrong_negative(slow, fast, likelihood):
    slow, fast = 0.95 * slow + 0.05 * likelihood, 0.5 * fast + 0.5 * likelihood
    return slow, fast, 1 - fast / slow


def random_fraction__wrong_old_averages(slow, fast, likelihood):
    # The ratio is taken of the averages before this reading.
    return 0.95 * slow + 0.05 * likelihood, 0.5 * fast + 0.5 * likelihood, max(0, 1 - fast / slow)


def random_fraction__wrong_rates(slow, fast, likelihood):
    slow, fast = 0.05 * slow + 0.95 * likelihood, 0.5 * fast + 0.5 * likelihood
    return slow, fast, max(0, 1 - fast / slow)


def random_fraction__right_array(slow, fast, likelihood):
    rates = np.array([0.05, 0.5])
    averages = (1 - rates) * [slow, fast] + rates * likelihood
    return np.append(averages, np.clip(1 - averages[1] / averages[0], 0, 1))


def is_found__wrong_unweighted(particles, weights, within):
    mean = particles[:, :2].mean(axis=0)
    return np.mean(np.linalg.norm(particles[:, :2] - mean, axis=1) <= within) >= 0.95


def is_found__wrong_spread(particles, weights, within):
    # The spread in single coordinates ignores the weights.
    return particles[:, :2].std(axis=0).max() < within


def is_found__wrong_half(particles, weights, within):
    mean = weights @ particles[:, :2]
    return weights[np.linalg.norm(particles[:, :2] - mean, axis=1) <= 3 * within].sum() >= 0.5


def is_found__right_loop(particles, weights, within):
    x, y, _ = weights @ particles
    return (
        sum(w for (a, b, _), w in zip(particles, weights, strict=True) if (a - x) ** 2 + (b - y) ** 2 < within**2)
        > 0.95
    )
