import math

import numpy as np


def predict_line(x, P, u, Q):
    return x - u, P + Q


def update_line(x, P, z, R):
    K = P / (P + R)
    return x + K * (z - x), (1 - K) * P


def is_consistent(innovations, variances):
    nis = innovations**2 / variances
    return abs(np.mean(nis) - 1) < 1.96 * math.sqrt(2 / len(nis))
