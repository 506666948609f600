import numpy as np


def mahalanobis2(innovation, S):
    return innovation @ np.linalg.solve(S, innovation)


def nearest_reflector(reading_in, expected_in, variances, gate):
    distances = (reading_in - expected_in) ** 2 / variances
    best = int(np.argmin(distances))
    return best if distances[best] < gate else -1


def association_probabilities(innovations, variances, p_random):
    density = np.exp(-0.5 * innovations**2 / variances) / np.sqrt(2 * np.pi * variances)
    weights = np.append((1 - p_random) / len(innovations) * density, p_random / 255)
    return weights / weights.sum()
