import numpy as np


def update_cell(log_odds, p):
    return log_odds + np.log(p / (1 - p))


def inverse_sensor(distances_in, angles_rad, reading_in):
    p = np.full(np.shape(distances_in), 0.5)
    if reading_in == 255:
        return p
    in_cone = np.abs(angles_rad) < np.radians(12.5)
    p[in_cone & (distances_in < reading_in - 2)] = 0.35
    p[in_cone & (np.abs(distances_in - reading_in) <= 2)] = 0.7
    return p


def fit_wall(points):
    centre = points.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov(points.T))
    normal = vectors[:, 0]
    return np.arctan2(normal[1], normal[0]), normal @ centre
