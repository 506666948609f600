"""Answers to the tasks of notebook 08."""

import numpy as np


def _move(particles, d, a):
    x, y, h = particles.T
    return np.column_stack((x + d * np.cos(h + a / 2), y + d * np.sin(h + a / 2), h + a))


def _var(d, a):
    return 0.01 * abs(d), 0.01 * abs(a) + 0.000025 * abs(d)


def move_particles__wrong_one_noise(particles, d, a, rng):
    e, f = _var(d, a)
    # One random number moves all particles alike: they do not spread.
    return _move(particles, d + rng.normal(0, np.sqrt(e)), a + rng.normal(0, np.sqrt(f)))


def move_particles__wrong_variance_for_std(particles, d, a, rng):
    e, f = _var(d, a)
    n = len(particles)
    # normal() takes a standard deviation, and these are variances.
    return _move(particles, d + rng.normal(0, e, n), a + rng.normal(0, f, n))


def move_particles__wrong_no_noise(particles, d, a, rng):
    return _move(particles, d, a)


def move_particles__wrong_end_heading(particles, d, a, rng):
    e, f = _var(d, a)
    n = len(particles)
    d, a = d + rng.normal(0, np.sqrt(e), n), a + rng.normal(0, np.sqrt(f), n)
    x, y, h = particles.T
    return np.column_stack((x + d * np.cos(h + a), y + d * np.sin(h + a), h + a))


def move_particles__right_loop(particles, d, a, rng):
    e, f = _var(d, a)
    moved = []
    for x, y, h in particles.tolist():
        way, turn = d + e**0.5 * rng.standard_normal(), a + f**0.5 * rng.standard_normal()
        moved.append((x + way * np.cos(h + turn / 2), y + way * np.sin(h + turn / 2), (h + turn) % (2 * np.pi)))
    return moved


def weigh_particles__wrong_underflow(weights, z, expected, std):
    # The product of many small densities underflows to 0.
    new = weights * np.exp(-0.5 * ((z - expected) / std) ** 2).prod(axis=1)
    return new / new.sum()


def weigh_particles__wrong_without_weights(weights, z, expected, std):
    logs = -0.5 * (((z - expected) / std) ** 2).sum(axis=1)
    new = np.exp(logs - logs.max())
    return new / new.sum()


def weigh_particles__wrong_sum(weights, z, expected, std):
    new = weights * np.exp(-0.5 * ((z - expected) / std) ** 2).sum(axis=1)
    return new / new.sum()


def weigh_particles__wrong_not_normalized(weights, z, expected, std):
    return weights * np.exp(-0.5 * ((z - expected) / std) ** 2).prod(axis=1)


def weigh_particles__right_one_by_one(weights, z, expected, std):
    logs = np.log(weights)
    for k in range(len(z)):
        logs += -0.5 * ((z[k] - expected[:, k]) / std) ** 2
    # Each weight relative to all others, which needs no normalization.
    return 1 / np.exp(logs[None, :] - logs[:, None]).sum(axis=1)


def resample__wrong_best(weights, rng):
    # All particles become copies of the best one.
    return np.full(len(weights), np.argmax(weights))


def resample__wrong_uniform(weights, rng):
    return rng.integers(0, len(weights), len(weights))


def resample__wrong_sorted(weights, rng):
    return np.argsort(weights)


def resample__wrong_weights(weights, rng):
    return rng.choice(weights, len(weights), p=weights)


def resample__right_choice(weights, rng):
    return rng.choice(len(weights), len(weights), p=weights).tolist()


def resample__right_wheel(weights, rng):
    # The wheel of Thrun's course.
    n, index, beta, chosen = len(weights), int(rng.integers(len(weights))), 0.0, []
    for _ in range(n):
        beta += rng.uniform() * 2 * max(weights)
        while weights[index] < beta:
            beta -= weights[index]
            index = (index + 1) % n
        chosen.append(index)
    return chosen


def mean_pose__wrong_arithmetic(particles, weights):
    # The mean of 179 and -179 degrees is 0 here.
    return weights @ particles


def mean_pose__wrong_unweighted(particles, weights):
    x, y, h = particles.T
    return x.mean(), y.mean(), np.arctan2(np.sin(h).mean(), np.cos(h).mean())


def mean_pose__wrong_best(particles, weights):
    return particles[np.argmax(weights)]


def mean_pose__right_complex(particles, weights):
    return [*(weights @ particles[:, :2]), np.angle(weights @ np.exp(1j * particles[:, 2])) + 2 * np.pi]
