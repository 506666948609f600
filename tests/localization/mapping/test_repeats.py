"""Weights of the ranges of a finished map: simulated rounding, a dense covariance, rays rotated by a small angle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate
from localization.mapping.learn import learn_map
from localization.mapping.problem import NO_FEATURE, sensors_at
from localization.mapping.repeats import rounding_covariance, weigh_ranges
from localization.mapping.walls import covariance_of
from tests.localization.mapping.drives import drive


@pytest.mark.parametrize("apart", [0.0, 0.2, 0.5, 1.3])
@pytest.mark.parametrize("std", [0.06, 0.1, 0.3])
def test_covariance_is_that_of_simulated_rounding(apart: float, std: float) -> None:
    rng = np.random.default_rng(1)
    ranges = rng.uniform(0.0, 1.0, 400_000) + np.array((10.0, 10.0 + apart))[:, None]
    noisy = ranges + std * rng.normal(size=ranges.shape)
    one, other = np.round(noisy) - noisy
    assert rounding_covariance(np.array(apart), np.array(std**2)) == pytest.approx((one * other).mean(), abs=0.0025)


def test_repeated_readings_count_like_their_mean(estimate: MapEstimate) -> None:
    estimate = estimate.copy()
    weigh_ranges(estimate)
    trajectory, feature = estimate.problem.trajectory, estimate.assignment.feature
    sensors, prediction = estimate.problem.predict(estimate.state, estimate.assignment, np.arange(len(feature)))
    wall = np.flatnonzero(feature == 0)
    # The row of each reading in the covariance of all readings of its wall, by loops.
    lowest = 1.0
    for i in wall[::7]:
        row = trajectory.std_in[i] ** 2
        for j in wall:
            noise = 0.5 * 0.0125**2 * (trajectory.readings_in[i] ** 2 + trajectory.readings_in[j] ** 2)
            offsets = [trajectory.readings_in[k] - sensors.range_in[k] for k in (i, j)]
            apart = prediction.range_in[i] + offsets[0] - prediction.range_in[j] - offsets[1]
            row += float(rounding_covariance(np.array(apart), np.array(noise))) if i != j else 0.0
        weight = min(trajectory.std_in[i] ** 2 / row, 1.0) if row > 0.0 else 1.0
        assert trajectory.weight[i] == pytest.approx(weight, rel=0.1)
        lowest = min(lowest, weight)
    assert lowest < 0.8
    # Noise of half an inch decides by itself what is read.
    assert (trajectory.weight[trajectory.readings_in > 40.0] == 1.0).all()
    assert (trajectory.weight[feature == NO_FEATURE] == 1.0).all()


def test_repeated_readings_make_walls_less_certain(estimate: MapEstimate) -> None:
    alone = estimate.copy()
    weights = np.ones(len(estimate.assignment.feature))
    alone.problem = alone.problem.with_trajectory(replace(alone.problem.trajectory, weight=weights))
    walls = slice(0, estimate.state.walls.size)
    assert (np.diag(covariance_of(estimate))[walls] > np.diag(covariance_of(alone))[walls]).all()


def test_slanted_rays_change_by_the_heading_as_rotated_ones() -> None:
    log = drive(rays=True)
    estimate = learn_map(log, OdometryNoise(0.05, 0.05, 0.002), ConeSonar(), rays=True)
    trajectory, feature = estimate.problem.trajectory, estimate.assignment.feature
    sensors = sensors_at(estimate.state.poses, estimate.state.parameters, trajectory, slice(None))
    slanted = 0
    for echo in np.flatnonzero((feature != NO_FEATURE) & (trajectory.heading_var_in2 > 0.01))[::5]:
        # The range along the axis, and along one that is rotated by 1e-6.
        angle, offset = estimate.state.walls[feature[echo]]
        normal = np.array((np.cos(angle), np.sin(angle)))
        axes = sensors.axis[echo] + np.array((0.0, 1e-6))
        one, other = (offset - sensors.face[echo] @ normal) / (np.cos(axes) * normal[0] + np.sin(axes) * normal[1])
        var_rad = trajectory.heading_var_in2[echo] / trajectory.readings_in[echo] ** 2
        expected = (other - one) ** 2 / 1e-12 * var_rad
        parts = trajectory.noise_var_in2[echo] + trajectory.other_var_in2[echo]
        assert trajectory.std_in[echo] ** 2 - parts == pytest.approx(expected, rel=0.25, abs=0.02)
        slanted += expected > 2.0 * trajectory.heading_var_in2[echo]
    assert slanted > 3
