"""The weights of the ranges of a finished map: these count by what the map expects, not by what was read.

    noise          a fraction of the range: by the reading, one that is too short would count for more than one too long
    limit          where half of the readings are the lower limit, the others are too long
    slanted rays   r tan(a) a radian of the heading, of a ray r that meets its wall at the angle a off the normal
    rounding       a robot that drives along a wall measures the same whole inches again and again: one error, not many

The errors of two readings in steps of q, of ranges m apart with noise of std each, have the covariance

    q^2 sum_k cos(2 pi k m / q) exp(-4 pi^2 k^2 std^2 / q^2) / (2 pi^2 k^2)

A reading of variance R that has the covariances c_j with others of its feature counts for R / (R + sum c_j) of one: the
mean of n such readings then has the variance of the mean of correlated ones.

References
----------
Widrow, Kollar, Quantization Noise (2008), chapters 5 and 19: characteristic functions of quantized noise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from localization.filters.sonar_ray import RangeNoise
from localization.mapping.association import MapEstimate
from localization.mapping.problem import NO_FEATURE

HARMONICS: Final = np.arange(1, 6)
"""Terms of the sum: with the noise of a range of 6 in, 0.06 in and more, later ones are below 1 % of the variance."""
MAX_DITHER: Final = 0.4
"""Noise in steps from which rounding errors are independent: the first term is 4 % of the variance."""
POINT_WEIGHT: Final = 0.2
"""Of the ranges of points where walls have surfaces: posts are none, and their ranges err alike from nearby places."""
MIN_STEP_IN: Final = 1e-6
LIMIT_STDS: Final = 2.5
"""Expected ranges this much of the noise above the lower limit have readings on both sides of them."""
MAX_TANGENT: Final = 5.0
"""Of 79 degrees: rays that are more slanted belong to no wall."""


def rounding_covariance(apart: Floats, variance: Floats) -> Floats:
    """Return the covariance of the rounding errors of two readings, in steps squared.

    Parameters
    ----------
    apart
        (...) difference of their ranges before the noise, in steps.
    variance
        (...) mean of the variances of their noise, in steps squared.
    """
    total: Floats = sum(
        (
            np.cos(2.0 * np.pi * k * apart) * np.exp(-4.0 * np.pi**2 * k * k * variance) / (2.0 * np.pi**2 * k * k)
            for k in HARMONICS.tolist()
        ),
        start=np.zeros(np.broadcast_shapes(np.shape(apart), np.shape(variance))),
    )
    return total


def weigh_ranges(estimate: MapEstimate, sonar: RangeNoise) -> None:
    """Set the standard deviations of the explained ranges, and how much they count, by the map."""
    trajectory, feature = estimate.problem.trajectory, estimate.assignment.feature
    echoes = np.flatnonzero((feature != NO_FEATURE) & (trajectory.node < len(estimate.state.poses)))
    sensors, prediction = estimate.problem.predict(estimate.state, estimate.assignment, echoes)
    readings, step = trajectory.readings_in[echoes], trajectory.step_in
    predicted = prediction.range_in + readings - sensors.range_in
    # 1. Noise at the range that the map predicts.
    noise_var = trajectory.noise_var_in2.copy()
    noise_var[echoes] = sonar.variance(predicted) - sonar.place_var_in2 - sonar.rounding_var_in2
    # 2. The heading's part of a ray's variance, which is that of 45 degrees where nothing explains it.
    heading_var = trajectory.heading_var_in2.copy()
    if estimate.problem.rays:
        slant = np.tan(sensors.axis - estimate.state.walls[feature[echoes], 0])
        heading_var[echoes] *= np.square(np.clip(slant, -MAX_TANGENT, MAX_TANGENT) * predicted / readings)
    variance = noise_var + trajectory.other_var_in2 + heading_var
    # 3. Rounding errors, by the readings that the map predicts. Those whose noise is large are independent.
    weight = np.ones(len(feature))
    dither = noise_var[echoes] / max(step, MIN_STEP_IN) ** 2
    for number in range(estimate.state.features if step else 0):
        rows = np.flatnonzero((feature[echoes] == number) & (dither < MAX_DITHER**2))
        apart = (predicted[rows, None] - predicted[rows]) / step
        covariance = step**2 * rounding_covariance(apart, 0.5 * (dither[rows, None] + dither[rows]))
        np.fill_diagonal(covariance, 0.0)
        own = variance[echoes[rows]]
        weight[echoes[rows]] = own / (own + np.maximum(covariance.sum(axis=1), 0.0))
    if estimate.problem.reflection.surface_std_in:
        weight[echoes[feature[echoes] >= len(estimate.state.walls)]] *= POINT_WEIGHT
    # 4. What is expected near the lower limit.
    lowest_in = sonar.lowest_in + 0.5 * step + LIMIT_STDS * np.sqrt(noise_var[echoes])
    weight[echoes[predicted < lowest_in]] = 0.0
    estimate.problem = estimate.problem.with_trajectory(replace(trajectory, std_in=np.sqrt(variance), weight=weight))
