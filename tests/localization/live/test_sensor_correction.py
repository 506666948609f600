"""States corrected by a calibration."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.sonar_ray import WIRE_SONAR
from localization.live.localizer import Localizer
from localization.live.sensor_input import FiringSchedule, SensorData, corrected, with_wheels
from worlds.io import load_world
from worlds.robots import IDEAL_CALIBRATION, N150, Calibration, Spread

SENSOR_DATA = SensorData(1.0, 2.0, 3.0, 0.5, 0.6, (6.0, 255.0, 0.0, 7.0, 254.0, *(50.0,) * 11))
ERRS = Calibration(1.02, 0.97, 0.001, (2.0,) * 4 + (-2.0,) * 12, radians(3.0), Spread(0.01, 0.02, 1e-4))


def test_readings_lose_their_offsets_but_limits_stay() -> None:
    state = corrected(SENSOR_DATA, ERRS)
    # 0, 6 and 255 are no ranges and stay; 7 - 2 and 254 + 2 would leave the range, and end just within it.
    assert state.sonars_in[:3] == (6.0, 255.0, 0.0)
    assert 6.0 < state.sonars_in[3] < 6.01
    assert 254.99 < state.sonars_in[4] < 255.0
    assert state.sonars_in[5:] == (52.0,) * 11
    assert state.turret_rad == pytest.approx(0.6 + radians(3.0))
    assert (state.clock_s, state.x_in, state.y_in, state.steering_rad) == (1.0, 2.0, 3.0, 0.5)


def test_a_faultless_robot_changes_nothing() -> None:
    assert corrected(SENSOR_DATA, IDEAL_CALIBRATION) is SENSOR_DATA
    pose = independent([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
    assert with_wheels(pose, IDEAL_CALIBRATION) is pose


def test_odometry_parameters_start_at_calibration() -> None:
    pose = independent([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    belief = with_wheels(pose, ERRS)
    np.testing.assert_allclose(belief.mean, [1.0, 2.0, 3.0, 0.02, -0.03, 0.001])
    np.testing.assert_allclose(belief.std, [0.1, 0.2, 0.3, 0.01, 0.02, 1e-4])


def test_localizer_uses_corrected_readings() -> None:
    walls = load_world("thesis_room").walls
    start = independent([2.0, 3.0, 0.5], [0.1, 0.1, 0.01])
    config = LocalizationConfig(walls, N150, sonar=WIRE_SONAR, calibration=ERRS)
    localizer = Localizer(config, start, FiringSchedule(1.0))
    localizer.update(SENSOR_DATA)
    estimate = localizer.update(SensorData(2.0, 2.0, 3.0, 0.5, 0.6, SENSOR_DATA.sonars_in))
    assert {echo.sonar: echo.reading_in for echo in estimate.echoes}[15] == 52.0
