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
from localization.mapping.walls import covariance_of
from localization.mapping.weights import rounding_covariance, weigh_ranges
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
    weigh_ranges(estimate, ConeSonar())
    trajectory, feature = estimate.problem.trajectory, estimate.assignment.feature
    sensors, prediction = estimate.problem.predict(estimate.state, estimate.assignment, np.arange(len(feature)))
    wall = np.flatnonzero(feature == 0)
    # The row of each reading in the covariance of all readings of its wall, by loops.
    lowest = 1.0
    for i in wall[::7]:
        row = trajectory.std_in[i] ** 2
        for j in wall:
            offsets = [trajectory.readings_in[k] - sensors.range_in[k] for k in (i, j)]
            expected = prediction.range_in[i] + offsets[0], prediction.range_in[j] + offsets[1]
            noise, apart = 0.5 * 0.0125**2 * (expected[0] ** 2 + expected[1] ** 2), expected[0] - expected[1]
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
        parts = (0.0125 * one) ** 2 + trajectory.other_var_in2[echo]
        assert trajectory.std_in[echo] ** 2 - parts == pytest.approx(expected, rel=0.25, abs=0.02)
        slanted += expected > 2.0 * trajectory.heading_var_in2[echo]
    assert slanted > 3


def test_too_short_ranges_count_no_more_than_too_long_ones(estimate: MapEstimate) -> None:
    rng, sonar = np.random.default_rng(2), ConeSonar(range_std_relative=0.05)
    trajectory = estimate.problem.trajectory
    echoes = estimate.echoes()
    echoes = echoes[(estimate.assignment.feature[echoes] != NO_FEATURE) & (trajectory.readings_in[echoes] > 30.0)]
    sensors, prediction = estimate.problem.predict(estimate.state, estimate.assignment, echoes)
    expected = prediction.range_in + trajectory.readings_in[echoes] - sensors.range_in
    # Ranges as the map expects them, with noise of 5 %, many times.
    sums = np.zeros((2, 2))
    for _ in range(100):
        noise = 0.05 * expected * rng.normal(size=len(expected))
        readings = trajectory.readings_in.copy()
        readings[echoes] = expected + noise
        trial = estimate.copy()
        trial.problem = trial.problem.with_trajectory(replace(trajectory, readings_in=readings))
        weigh_ranges(trial, sonar)
        found = trial.problem.trajectory
        by_map = found.weight[echoes] / found.std_in[echoes] ** 2
        by_reading = 1.0 / (sonar.variance(readings[echoes]) + trajectory.other_var_in2[echoes])
        sums += [((weight * noise).sum(), weight.sum()) for weight in (by_map, by_reading)]
    bias_by_map, bias_by_reading = sums[:, 0] / sums[:, 1]
    assert abs(bias_by_map) < 0.03
    # Twice the variance over the range, 2 * 0.05^2 * 45 in.
    assert bias_by_reading == pytest.approx(-0.2, abs=0.1)


def test_ranges_expected_at_the_lower_limit_do_not_count(estimate: MapEstimate) -> None:
    estimate, sonar = estimate.copy(), ConeSonar(lowest_in=30.0)
    weigh_ranges(estimate, sonar)
    trajectory = estimate.problem.trajectory
    echoes = np.flatnonzero(estimate.assignment.feature != NO_FEATURE)
    sensors, prediction = estimate.problem.predict(estimate.state, estimate.assignment, echoes)
    expected = prediction.range_in + trajectory.readings_in[echoes] - sensors.range_in
    counts = trajectory.weight[echoes] > 0.0
    assert 0.1 < counts.mean() < 0.9
    # Readings that are above the limit, of ranges that count and of others: noise, then whole inches.
    rng = np.random.default_rng(3)
    lowest, highest = float(expected[counts].min()), float(expected[~counts].max())
    assert highest < 31.6 < lowest + 0.3
    bias = {}
    for true_in in (30.2, lowest):
        readings = np.round(true_in * (1.0 + 0.0125 * rng.normal(size=100_000)))
        bias[true_in] = readings[readings > 30.0].mean() - true_in
    assert bias[30.2] > 0.5
    assert abs(bias[lowest]) < 0.02
