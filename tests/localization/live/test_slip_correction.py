"""A robot that presses against an obstacle rolls on the spot."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.ekf import KalmanFilter
from localization.filters.odometry import PRESSED_NOISE, process_covariance, step_jacobians
from localization.filters.registry import make
from localization.live.sensor_input import SensorData, SlipCorrection
from worlds.io import load_world
from worlds.robots import N150


def state(clock_s: float, x_in: float, touching: bool) -> SensorData:
    return SensorData(clock_s, x_in, 3.0, 0.0, 0.0, (255.0,) * 16, touching)


def test_only_what_is_rolled_on_the_spot_is_left_out() -> None:
    slip = SlipCorrection()
    # Free at 5 in/s; then pressed, the wheels creep by 0.1 in each; then away at 5 in/s with the bumper still closed.
    states = [state(0.0, 0.0, False), state(0.1, 0.5, False), state(0.2, 1.0, True), state(0.3, 1.1, True)]
    states += [state(0.4, 1.2, True), state(0.5, 0.7, True), state(0.6, 0.2, False)]
    positions, rolled = [], []
    for one in states:
        positions.append(round(slip.position_of(one)[0], 6))
        rolled.append(round(slip.rolled_in, 6))
    assert positions == [0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0]
    assert rolled == [0.0, 0.0, 0.0, 0.1, 0.1, 0.0, 0.0]
    assert slip.position_of(state(0.7, 0.2, False))[1] == 3.0


def test_rolling_on_the_spot_widens_as_driving_farther_does() -> None:
    config, belief = LocalizationConfig(load_world("thesis_room").walls, N150), independent([40, 45, 0.4], [0.2] * 3)
    held, free = make("ekf", config, belief), make("ekf", config, belief)
    assert isinstance(held, KalmanFilter)
    held.roll_on_spot(2.0)
    assert (held.belief.mean == belief.mean).all()
    # Q of a step of 2 in, by G at its beginning; a step of no length would add nothing.
    step, noise = np.array([2.0, 0.0]), config.odometry
    _, G = step_jacobians(belief.mean, np.zeros(2))
    Q = process_covariance(G, step, noise)
    np.testing.assert_allclose(held.belief.cov - belief.cov, PRESSED_NOISE * Q, atol=1e-12)
    free.predict(2.0 * PRESSED_NOISE, 0.0)
    assert held.belief.cov[2, 2] == pytest.approx(free.belief.cov[2, 2])
