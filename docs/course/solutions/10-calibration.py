import numpy as np


def fit_scale(counted_in, measured_in):
    return counted_in @ measured_in / (counted_in @ counted_in)


def fit_turn_and_drift(distances_in, turns_rad, true_turns_rad):
    A = np.column_stack((turns_rad, distances_in))
    return np.linalg.lstsq(A, true_turns_rad, rcond=None)[0]


def fit_std(distances_in, turns_rad, sigma_rad):
    A = np.column_stack((turns_rad, distances_in))
    return sigma_rad * np.sqrt(np.diag(np.linalg.inv(A.T @ A)))


def sonar_offset(readings_in, ranges_in):
    return np.median(readings_in - ranges_in)
