import numpy as np


def effective_number(weights):
    return 1 / np.sum(weights**2)


def random_fraction(slow, fast, likelihood):
    slow += 0.05 * (likelihood - slow)
    fast += 0.5 * (likelihood - fast)
    return slow, fast, max(0.0, 1 - fast / slow)


def is_found(particles, weights, within_in):
    mean = weights @ particles[:, :2]
    distances = np.hypot(*(particles[:, :2] - mean).T)
    return weights[distances <= within_in].sum() >= 0.95
