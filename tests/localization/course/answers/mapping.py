"""Answers to the tasks of notebook 11."""

import math

import numpy as np


def update_cell__wrong_adds_p(log_odds, p):
    return log_odds + p


def update_cell__wrong_log_p(log_odds, p):
    return log_odds + np.log(p)


def update_cell__wrong_probability(log_odds, p):
    return 1 / (1 + np.exp(-(log_odds + np.log(p / (1 - p)))))


def update_cell__right_probabilities(log_odds, p):
    odds = np.exp(log_odds) * p / (1 - p)
    return np.log(odds)


def update_cell__wrong_one_cell(log_odds, p):
    # math.log takes a single number, where a whole row of cells is updated.
    return log_odds + math.log(p / (1 - p))


def _sensor(d, a, z, behind=0.5, cone=0.218, nothing=0.5):
    # Nearer than the reading: free; at it: occupied; behind it and outside of the cone: no information.
    p = np.where(d < z - 2, 0.35, np.where(d <= z + 2, 0.7, behind))
    p = np.where(abs(a) < cone, p, 0.5)
    return np.full_like(p, nothing) if z == 255 else p


def inverse_sensor__wrong_behind(d, a, z):
    return _sensor(d, a, z, behind=0.7)


def inverse_sensor__wrong_cone(d, a, z):
    return _sensor(d, a, z, cone=np.radians(25))


def inverse_sensor__wrong_no_echo(d, a, z):
    return np.where(abs(a) < np.radians(12.5), 0.35, 0.5) if z == 255 else _sensor(d, a, z)


def inverse_sensor__right_loop(d, a, z):
    cells = []
    for distance, angle in zip(d, a, strict=True):
        p = 0.5
        if z < 255 and abs(math.degrees(angle)) < 12.5 and distance < z + 2:
            p = 0.35 if distance < z - 2 else 0.7
        cells.append(p)
    return cells


def fit_wall__wrong_polyfit(points):
    # A regression of y on x fails for walls along y.
    m, b = np.polyfit(points[:, 0], points[:, 1], 1)
    alpha = math.atan2(1, -m)
    return alpha, b * math.sin(alpha)


def fit_wall__wrong_direction(points):
    _, vectors = np.linalg.eigh(np.cov(points.T))
    along = vectors[:, 1]
    # The direction of the wall instead of that of its normal.
    return math.atan2(along[1], along[0]), along @ points.mean(axis=0)


def fit_wall__wrong_rho(points):
    _, vectors = np.linalg.eigh(np.cov(points.T))
    return math.atan2(vectors[1, 0], vectors[0, 0]), np.linalg.norm(points.mean(axis=0))


def fit_wall__right_closed_form(points):
    x, y = (points - points.mean(axis=0)).T
    # The angle of the principal axis in closed form, turned by a right angle to the normal.
    alpha = 0.5 * math.atan2(2 * (x @ y), x @ x - y @ y) + math.pi / 2
    return np.array([alpha, points.mean(axis=0) @ (math.cos(alpha), math.sin(alpha))])
