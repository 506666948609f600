"""Monte Carlo localization against the Kalman filter where both are right, and the resampler by its definition."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats, independent, pack, unpack
from localization.filters.health import HealthStatus
from localization.filters.odometry import OdometryNoise, move, predict
from localization.filters.particles import (
    Likelihood,
    Likelihoods,
    ParticleFilter,
    RayLikelihood,
    draw_particles,
    moments,
    resample_low_variance,
    weighted_innovation,
)
from localization.filters.sonar_ray import WIRE_SONAR
from localization.filters.update import Refusal, kalman_update
from worlds.io import load_world
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150

BELIEF = independent([40.0, 45.0, 0.3], [0.8, 0.5, 0.03])
ROOM = load_world("thesis_room").walls


class Ruler(Likelihood):
    """A sensor that reads x, with a standard deviation of 0.5 in: linear, so that the Kalman filter is exact."""

    def __init__(self) -> None:
        """Have no ring."""

    def is_range(self, reading_in: float) -> bool:
        return reading_in >= 0.0

    def information(self, reading_in: float, count: int) -> float:
        del reading_in, count
        return 1.0

    def at(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Likelihoods:
        del sonar, turret_offset_rad
        likelihood = np.exp(-0.5 * ((reading_in - poses[:, 0]) / 0.5) ** 2)
        return Likelihoods(likelihood, np.zeros(len(poses)), poses[:, 0], np.full(len(poses), 0.25))


def filter_of(count: int, seed: int = 1, **more: object) -> ParticleFilter:
    rng = np.random.default_rng(seed)
    return ParticleFilter(draw_particles(BELIEF, count, rng), Ruler(), OdometryNoise(), rng, **more)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_linear_problem_agrees_with_the_kalman_filter() -> None:
    # 200,000 particles: the mean is accurate to std / 450.
    particles, gaussian = filter_of(200_000), BELIEF
    step = np.array([1.0, 0.05])
    for reading in (41.3, 42.0, 43.4):
        particles.predict(*step)
        gaussian = predict(gaussian, step, OdometryNoise())
        particles.update(0, 0.0, reading)
        x, P = unpack(gaussian)
        # The wall is straight ahead: H = (1, 0, 0) and R = 0.25.
        kalman_update(x, P, [1.0, 0.0, 0.0], 0.25, reading - x[0])
        gaussian = pack(x, P)
    np.testing.assert_allclose(particles.belief.mean, gaussian.mean, atol=0.02)
    np.testing.assert_allclose(particles.belief.std, gaussian.std, rtol=0.04)


def test_predicted_belief_equals_belief_after_predict() -> None:
    particles, step = filter_of(100_000), np.array([3.0, 0.4])
    ahead = particles.predicted(*step)
    particles.predict(*step)
    np.testing.assert_allclose(particles.belief.mean, ahead.mean, atol=0.01)
    np.testing.assert_allclose(particles.belief.std, ahead.std, rtol=0.02)


def test_readings_at_limits_leave_weights_unchanged() -> None:
    particles = filter_of(100)
    assert particles.update(0, 0.0, -1.0).refusal is Refusal.LIMIT
    assert (particles.weights == 0.01).all()


@pytest.mark.parametrize("start", [0.0, 0.37, 0.999])
def test_resampling_is_proportional_to_the_weights(start: float) -> None:
    weights = np.random.default_rng(2).dirichlet(np.ones(50))
    counts = np.bincount(resample_low_variance(weights, start), minlength=50)
    assert counts.sum() == 50
    assert (np.abs(counts - 50 * weights) < 1.0).all()


def test_moments_across_the_cut_of_the_heading() -> None:
    states = np.array([[0.0, 0.0, np.pi - 0.1], [2.0, 4.0, -np.pi + 0.1]])
    found = moments(states, np.array([0.5, 0.5]))
    assert abs(found.mean[2]) == pytest.approx(np.pi)
    np.testing.assert_allclose(np.diag(found.cov), [1.0, 4.0, 0.01])


def test_the_same_seed_gives_the_same_particles() -> None:
    runs = []
    for _ in range(2):
        particles = filter_of(500, seed=7)
        for reading in (41.0, 41.5):
            particles.predict(0.5, 0.0)
            particles.update(0, 0.0, reading)
        runs.append(particles.states)
    np.testing.assert_array_equal(runs[0], runs[1])


def test_drawn_particles_have_the_moments_of_the_belief() -> None:
    root = np.array([[0.5, 0, 0], [0.2, 0.4, 0], [0.01, 0.0, 0.02]])
    belief = Belief(np.array([1.0, 2.0, 3.1]), root @ root.T)
    states = draw_particles(belief, 100_000, np.random.default_rng(3))
    found = moments(states, np.full(100_000, 1e-5))
    np.testing.assert_allclose(found.mean[:2], belief.mean[:2], atol=0.01)
    np.testing.assert_allclose(found.cov, belief.cov, atol=0.004)


def test_the_outlier_probability_is_bayes_over_all_particles() -> None:
    rng = np.random.default_rng(5)
    likelihood = RayLikelihood(ROOM, N150, WIRE_SONAR)
    particles = ParticleFilter(draw_particles(BELIEF, 50, rng), likelihood, OdometryNoise(), rng)
    reading = _reading(BELIEF.mean, 2)
    whole, bad = np.sum([likelihood.at(state[None, :], 2, 0.0, reading)[:2] for state in particles.states], axis=0)
    assert particles.update(2, 0.0, reading).outlier_probability == pytest.approx(float(bad[0] / whole[0]))


def test_nis_of_particles_is_that_of_the_kalman_filter() -> None:
    """A linear sensor of x: S is the variance of x and of the reading, also of particles that are weighted."""
    rng = np.random.default_rng(6)
    particles = ParticleFilter(draw_particles(BELIEF, 200_000, rng), Ruler(), OdometryNoise(), rng)
    mean, variance = 40.0, 0.8**2
    for reading in (41.5, 39.0):
        result = particles.update(0, 0.0, reading)
        innovation, S = reading - mean, variance + 0.25
        assert result.innovation_in == pytest.approx(innovation, abs=0.02)
        assert result.nis == pytest.approx(innovation**2 / S, rel=0.03)
        mean, variance = mean + variance / S * innovation, variance - variance**2 / S


def test_nis_leaves_out_particles_without_an_echo() -> None:
    expected, variance = np.array([30.0, np.nan, 32.0]), np.array([1.0, np.nan, 2.0])
    at = Likelihoods(np.ones(3), np.ones(3), expected, variance)
    # Weights 1/4 and 3/4 of the two: mean 31.5, spread 0.75, mean variance 1.75.
    assert weighted_innovation(np.array([0.1, 0.6, 0.3]), 34.0, at) == pytest.approx((2.5, 2.5**2 / 2.5))
    assert weighted_innovation(np.array([0.0, 1.0, 0.0]), 34.0, at) == (0.0, 0.0)


def test_particles_too_close_together_degrade() -> None:
    """A cloud that is 1 in off in x and y and far too sure: its readings are explained, but the NIS is too large."""
    rng = np.random.default_rng(8)
    sure = independent(BELIEF.mean + np.array([1.0, -1.0, 0.0]), [0.01, 0.01, 0.001])
    cloud = ParticleFilter(draw_particles(sure, 100, rng), RayLikelihood(ROOM, N150, WIRE_SONAR), OdometryNoise(), rng)
    for sonar in [*range(16)] * 6:
        cloud.update(sonar, 0.0, _reading(BELIEF.mean, sonar))
    assert cloud.health.status is HealthStatus.DEGRADED
    assert "squared innovations" in cloud.health.reason


@pytest.mark.long
def test_a_cloud_away_from_the_robot_degrades() -> None:
    for off_in, status in ((0.0, HealthStatus.OK), (12.0, HealthStatus.DEGRADED)):
        rng, truth = np.random.default_rng(8), BELIEF.mean + np.array([off_in, -off_in, 0.0])
        likelihood = RayLikelihood(ROOM, N150, WIRE_SONAR)
        cloud = ParticleFilter(draw_particles(BELIEF, 500, rng), likelihood, OdometryNoise(0.0, 0.0, 0.0), rng)
        refused = 0
        # Four rounds of the ring; refusals are counted.
        for sonar in [*range(16)] * 4:
            refused += cloud.update(sonar, 0.0, _reading(truth, sonar)).refusal is Refusal.GATE
            # Held where it is believed to be.
            cloud.states = draw_particles(BELIEF, 500, rng)
        assert cloud.health.status is status
        # Off by 17 in, more than half of the 64 readings are refused.
        assert (refused > 32) is (off_in > 0.0)


def test_wide_particle_cloud_is_degraded() -> None:
    rng = np.random.default_rng(9)
    states = draw_particles(independent([0.0, 0.0, 0.0], [0.2, 4.0, 0.01]), 20_000, rng)
    wide = ParticleFilter(states, Ruler(), OdometryNoise(), rng)
    assert wide.health == (HealthStatus.DEGRADED, "the position is known to 4.0 in only")


@pytest.mark.long
def test_readings_of_the_room_bring_a_spread_cloud_together() -> None:
    rng, truth = np.random.default_rng(4), np.array([42.0, 44.0, 0.28])
    # A cloud of 3 in and 0.1 rad around a mean that is 2 in off.
    wide = independent(BELIEF.mean, [3.0, 3.0, 0.1])
    likelihood = RayLikelihood(ROOM, N150, WIRE_SONAR)
    cloud = ParticleFilter(draw_particles(wide, 2000, rng), likelihood, OdometryNoise(), rng)
    # Four rounds while the robot creeps: a robot at rest would repeat its rounding errors.
    for _ in range(4):
        for sonar in range(16):
            cloud.predict(0.02, 0.0)
            truth = move(truth, np.array([0.02, 0.0]))
            cloud.update(sonar, 0.0, _reading(truth, sonar))
    assert np.hypot(*(cloud.belief.mean - truth)[:2]) < 0.5
    assert cloud.belief.std[:2].max() < 1.0


@pytest.mark.long
def test_a_robot_that_stands_keeps_its_cloud() -> None:
    """Readings of whole inches, the same again and again: taken for news, they leave a handful of particles."""
    rng, truth = np.random.default_rng(6), np.array([40.5, 45.2, 0.31])
    likelihood = RayLikelihood(ROOM, N150, WIRE_SONAR)
    cloud = ParticleFilter(draw_particles(BELIEF, 1000, rng), likelihood, OdometryNoise(), rng)
    after = []
    # Forty rounds without motion.
    for _ in range(40):
        for sonar in range(16):
            cloud.update(sonar, 0.0, _reading(truth, sonar))
        after.append(cloud.belief.std)
    # Resampling of repeated readings would have left copies of a few particles.
    assert len(np.unique(cloud.states, axis=0)) > 100
    np.testing.assert_allclose(after[-1], after[20], rtol=0.2)
    # After a motion a reading has weight again.
    cloud.predict(1.0, 0.0)
    cloud.update(0, 0.0, _reading(move(truth, np.array([1.0, 0.0])), 0))
    assert not np.allclose(cloud.weights, cloud.weights[0])


def _reading(pose: Floats, sonar: int) -> float:
    angle = pose[2] + N150.sonar_angles_rad[sonar]
    ranges, _ = cast_rays(pose[:2], (np.cos(angle), np.sin(angle)), ROOM)
    return float(round(float(ranges) - N150.sonar_ring_radius_in))


# Errors that all readings have in common.

RANGE_STDS = (0.35, 0.01)


@pytest.mark.parametrize(("offset_in", "scale"), [(0.5, 0.0), (-0.3, 0.01), (0.2, -0.015)])
def test_common_errors_are_those_of_a_regression(offset_in: float, scale: float) -> None:
    """Readings of a robot whose pose is certain: Bayesian linear regression of reading less range on (1, range)."""
    x, y, heading = 20.0, 25.0, 0.7
    angles = heading + np.array(N150.sonar_angles_rad)
    along = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ranges = cast_rays(np.tile([x, y], (16, 1)), along, ROOM)[0] - N150.sonar_ring_radius_in
    readings = (1.0 + scale) * ranges + offset_in
    particles = ParticleFilter(
        np.tile([x, y, heading], (20, 1)), RayLikelihood(ROOM, N150, WIRE_SONAR), OdometryNoise(),
        np.random.default_rng(0), range_stds=RANGE_STDS,
    )  # fmt: skip
    for sonar, reading in enumerate(readings.tolist()):
        assert particles.update(sonar, 0.0, reading).nis < 9.0
    design = np.column_stack([np.ones(16), ranges])
    information = design.T @ (design / WIRE_SONAR.variance(ranges)[:, None]) + np.diag(1.0 / np.square(RANGE_STDS))
    expected = np.linalg.solve(information, design.T @ ((readings - ranges) / WIRE_SONAR.variance(ranges)))
    # The linear problem but for the correction by the errors so far: 0.002 in, and 0.02 %.
    assert particles.range_errors[0] == pytest.approx(expected[0], rel=0.05, abs=2e-3)
    assert particles.range_errors[1] == pytest.approx(expected[1], rel=0.05, abs=2e-4)
    # The scale may be the map's: what is reported is widened by it, about the middle.
    away = np.array([x, y]) * particles.range_errors[1]
    np.testing.assert_allclose(particles.predicted(0.0, 0.0).cov[:2, :2], np.outer(away, away), atol=1e-9)


def test_without_a_prior_readings_are_taken_as_they_are() -> None:
    particles = ParticleFilter(
        np.tile([20.0, 25.0, 0.7], (20, 1)), RayLikelihood(ROOM, N150, WIRE_SONAR), OdometryNoise(),
        np.random.default_rng(0),
    )  # fmt: skip
    particles.update(0, 0.0, 45.0)
    assert particles.range_errors.tolist() == [0.0, 0.0]
