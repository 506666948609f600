"""An extended Kalman filter of your own, in thirty lines; docs/own-filter.md explains them.

    nomad localize "sim:thesis_room?noisy=1&seed=3" --waypoints 0,0 60,40 --method examples/own_filter.py:MyFilter
"""

import numpy as np

from worlds.raycast import cast_ray


class MyFilter:
    def __init__(self, config, belief):
        self.x, self.P = belief.mean, belief.cov  # x_in, y_in, heading in rad; covariance
        self.walls = np.asarray(config.walls)

    def predict(self, distance_in, turn_rad):
        x, y, heading = self.x
        c, s = np.cos(heading + turn_rad / 2), np.sin(heading + turn_rad / 2)
        self.x = np.array([x + distance_in * c, y + distance_in * s, heading + turn_rad])
        F = np.array([[1, 0, -distance_in * s], [0, 1, distance_in * c], [0, 0, 1]])
        G = np.array([[c, -distance_in / 2 * s], [s, distance_in / 2 * c], [0, 1]])
        Q = np.diag([0.01 * abs(distance_in), 0.005**2 * abs(distance_in) + 0.01 * abs(turn_rad)])
        self.P = F @ self.P @ F.T + G @ Q @ G.T

    def expected_range(self, x, echo):
        angle = x[2] + echo.direction_rad
        return cast_ray(x[0], x[1], np.cos(angle), np.sin(angle), self.walls)[0] - echo.ring_in

    def update(self, echo):
        h = self.expected_range(self.x, echo)
        steps = 1e-4 * np.eye(3)
        H = np.array([self.expected_range(self.x + step, echo) - h for step in steps]) / 1e-4
        innovation, S = echo.range_in - h, H @ self.P @ H + 1 / 12 + (0.01 * h) ** 2
        if not innovation**2 < 9 * S:  # 3 standard deviations, or no wall at all
            return None
        K = self.P @ H / S
        self.x, self.P = self.x + K * innovation, self.P - np.outer(K, K) * S
        return innovation, S
