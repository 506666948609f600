"""The constant part of a reading's error: rounding, against its covariance by quadrature."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RangeNoise, constant_variance, range_variance


def covariance_of_rounding(std: float, step: float) -> float:
    """Of two readings of one range, which may be any: the mean over ranges of the squared mean error."""
    ranges = np.linspace(0.0, step, 401)[:-1]
    steps = step * np.arange(-60, 61)
    below = [[0.5 * math.erfc((there - at) / (std * math.sqrt(2.0))) for there in steps] for at in ranges]
    read = np.array(below) @ np.full(len(steps), step) + steps[0] - 0.5 * step
    error = read - ranges
    return float(((error - error.mean()) ** 2).mean())


@pytest.mark.parametrize("step", [1.0, 0.1])
@pytest.mark.parametrize("std", [0.01, 0.05, 0.1, 0.2, 0.3])
def test_rounding_error_is_constant_until_noise_dithers_it(std: float, step: float) -> None:
    noise = RangeNoise(range_std_relative=0.0, range_std_floor_in=std * step, rounding_var_in2=step * step / 12.0)
    there, constant = covariance_of_rounding(std * step, step), constant_variance(noise, 30.0)
    assert there - 1e-3 * step * step <= constant <= 1.7 * there + 1e-9 * step * step
    assert constant <= range_variance(noise, 30.0)


def test_without_noise_all_of_the_rounding_is_constant() -> None:
    assert constant_variance(RangeNoise(0.0, 1e-6, 1 / 12), 50.0) == pytest.approx(1 / 12)
    assert constant_variance(RangeNoise(), 50.0) == 0.0


@pytest.mark.parametrize("noise", [WIRE_SONAR, ConeSonar()])
def test_constant_rounding_vanishes_at_long_range(noise: RangeNoise) -> None:
    assert constant_variance(noise, 10.0) > 0.5 * noise.rounding_var_in2 + noise.place_var_in2
    # What remains is of the place itself.
    assert constant_variance(noise, 100.0) - noise.place_var_in2 < 1e-9
    assert constant_variance(replace(noise, rounding_var_in2=0.0), 100.0) == noise.place_var_in2
    assert range_variance(noise, 100.0) == pytest.approx(float(noise.variance(np.array(100.0))))
