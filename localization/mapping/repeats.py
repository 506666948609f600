"""How much the ranges of a finished map count: slanted rays, and rounding errors that repeat.

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
from localization.mapping.association import MapEstimate
from localization.mapping.problem import NO_FEATURE

HARMONICS: Final = np.arange(1, 6)
"""Terms of the sum: with the noise of a range of 6 in, 0.06 in and more, later ones are below 1 % of the variance."""
MAX_DITHER: Final = 0.4
"""Noise in steps from which rounding errors are independent: the first term is 4 % of the variance."""
MIN_STEP_IN: Final = 1e-6
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


def weigh_ranges(estimate: MapEstimate) -> None:
    """Set the standard deviations of the explained ranges by their incidence, and how much they count."""
    trajectory, feature = estimate.problem.trajectory, estimate.assignment.feature
    echoes = np.flatnonzero((feature != NO_FEATURE) & (trajectory.node < len(estimate.state.poses)))
    sensors, prediction = estimate.problem.predict(estimate.state, estimate.assignment, echoes)
    # 1. The heading's part of a ray's variance, which is that of 45 degrees where nothing explains it.
    squared_tangent = np.ones(len(feature))
    if estimate.problem.rays:
        slant = np.tan(sensors.axis - estimate.state.walls[feature[echoes], 0])
        squared_tangent[echoes] = np.square(np.clip(slant, -MAX_TANGENT, MAX_TANGENT))
    variance = trajectory.noise_var_in2 + trajectory.other_var_in2 + trajectory.heading_var_in2 * squared_tangent
    # 2. Rounding errors, by the readings that the map predicts. Those whose noise is large are independent.
    weight, step = np.ones(len(feature)), trajectory.step_in
    predicted = prediction.range_in + trajectory.readings_in[echoes] - sensors.range_in
    dither = trajectory.noise_var_in2[echoes] / max(step, MIN_STEP_IN) ** 2
    for number in range(estimate.state.features if step else 0):
        rows = np.flatnonzero((feature[echoes] == number) & (dither < MAX_DITHER**2))
        apart = (predicted[rows, None] - predicted[rows]) / step
        covariance = step**2 * rounding_covariance(apart, 0.5 * (dither[rows, None] + dither[rows]))
        np.fill_diagonal(covariance, 0.0)
        own = variance[echoes[rows]]
        weight[echoes[rows]] = own / (own + np.maximum(covariance.sum(axis=1), 0.0))
    estimate.problem = estimate.problem.with_trajectory(replace(trajectory, std_in=np.sqrt(variance), weight=weight))
