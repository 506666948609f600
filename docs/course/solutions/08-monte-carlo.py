import numpy as np


def move_particles(particles, distance_in, turn_rad, rng):
    n = len(particles)
    distance = distance_in + rng.normal(0, np.sqrt(0.01 * abs(distance_in)), n)
    turn = turn_rad + rng.normal(0, np.sqrt(0.01 * abs(turn_rad) + 0.000025 * abs(distance_in)), n)
    x, y, heading = particles.T
    middle = heading + turn / 2
    return np.column_stack((x + distance * np.cos(middle), y + distance * np.sin(middle), heading + turn))


def weigh_particles(weights, readings_in, expected_in, std_in):
    logs = -0.5 * np.sum(((readings_in - expected_in) / std_in) ** 2, axis=1)
    with np.errstate(divide="ignore"):
        logs = logs + np.log(weights)
    new = np.exp(logs - logs.max())
    return new / new.sum()


def resample(weights, rng):
    n = len(weights)
    places = (rng.uniform() + np.arange(n)) / n
    return np.minimum(np.searchsorted(np.cumsum(weights), places), n - 1)


def mean_pose(particles, weights):
    x, y, heading = particles.T
    return weights @ x, weights @ y, np.arctan2(weights @ np.sin(heading), weights @ np.cos(heading))
