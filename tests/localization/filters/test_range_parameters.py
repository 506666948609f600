"""Errors that all readings have in common: estimated besides the pose, by every Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest

from localization.experiments.live_trial import EXACT_RAYS
from localization.filters.base import LocalizationConfig
from localization.filters.belief import difference, independent, nees
from localization.filters.ekf import KalmanFilter
from localization.filters.odometry import OdometryNoise, move, predict, with_parameters
from localization.filters.registry import make
from localization.filters.smoother import FixedLagSmoother
from localization.filters.sonar_cone import ConeSonar, expected_echoes, reflectors
from localization.filters.sonar_ray import RaySonar, ranges_from, wall_map
from worlds.io import load_world
from worlds.rings import SonarMount
from worlds.robots import N150

WORLD = load_world("several_walls")
WALLS, AROUND = wall_map(WORLD.walls), reflectors(WORLD.walls)
QUIET = OdometryNoise(0.02, 0.02, 0.0005)
START = np.array([20.0, 20.0, 0.3])
STD = (0.2, 0.2, 0.01)


def reading(sonar: RaySonar | ConeSonar, pose: np.ndarray, number: int) -> float:
    """Return the range of a sonar from a pose, or 255: along its axis, or of the likeliest reflector in its cone."""
    angle_rad = N150.sonar_angles_rad[number]
    if isinstance(sonar, RaySonar):
        return float(ranges_from(pose, np.array([angle_rad]), N150, WALLS).range_in[0])
    mount = SonarMount(angle_rad, N150.sonar_ring_radius_in)
    echoes = expected_echoes(pose, np.array(0.01), mount, AROUND, sonar)
    best = int(echoes.probability.argmax())
    return float(echoes.ranges_in[best]) if echoes.probability[best] > 0.5 else 255.0


def driven(method: str, sonar: RaySonar | ConeSonar, offset_in: float, scale: float, seed: int) -> tuple[float, float]:
    """Turn once on the spot and drive two inches a ring; return the largest position error and the mean NEES."""
    rng, truth = np.random.default_rng(seed), START.copy()
    config = LocalizationConfig(WORLD.walls, N150, QUIET, sonar)
    guess = START + rng.standard_normal(3) * STD
    kalman = make(method, config, independent(guess, STD))
    errors, covs = [], []
    for k in range(320):
        step = np.array([0.0, 2.0 * np.pi / 160.0]) if k < 160 else np.array([0.125, 0.0])
        spread = np.sqrt([QUIET.translation_std**2 * step[0], QUIET.rotation_std**2 * step[1]])
        truth = move(truth, step + spread * rng.standard_normal(2))
        kalman.predict(*step.tolist())
        range_in = reading(sonar, truth, k % 16)
        if range_in < 255.0:
            range_in = float(np.rint((1.0 + scale) * range_in + offset_in))
        kalman.update(k % 16, 0.0, range_in)
        errors.append(difference(kalman.belief.mean[:3], truth))
        covs.append(kalman.belief.cov[:3, :3])
    late = np.array(errors[80:])
    return float(np.hypot(*late[:, :2].T).max()), float(nees(late, np.array(covs[80:])).mean())


@pytest.mark.long
@pytest.mark.parametrize(
    ("offset_in", "scale"), [(-1.0, 0.0), (0.5, 0.0), (0.0, 0.02), (0.0, -0.02)]
)
@pytest.mark.parametrize("sonar", [EXACT_RAYS, ConeSonar()])
def test_biased_readings_do_not_displace_the_robot(sonar: RaySonar | ConeSonar, offset_in: float, scale: float) -> None:
    worst_in, squared = driven("ekf", sonar, offset_in, scale, 1)
    assert worst_in < 0.6
    assert squared < 6.0


@pytest.mark.long
@pytest.mark.parametrize("method", ["iekf", "ukf", "smoother"])
def test_every_kalman_filter_estimates_the_bias(method: str) -> None:
    worst_in, squared = driven(method, EXACT_RAYS, 0.5, 0.0, 2)
    assert worst_in < 0.6
    assert squared < 6.0


def test_the_bias_is_in_the_state_but_not_in_the_belief() -> None:
    config = LocalizationConfig(WORLD.walls, N150, QUIET, EXACT_RAYS, range_stds=(0.5, 0.015))
    start = with_parameters(independent(START, STD), (0.05,))
    kalman = make("ekf", config, start)
    assert isinstance(kalman, KalmanFilter)
    assert kalman.belief.mean.shape == (4,)
    np.testing.assert_allclose(kalman.state.std, [*STD, 0.05, 0.5, 0.015])
    # A step changes pose and covariance as without the bias, and leaves the bias.
    np.testing.assert_allclose(
        kalman.predicted(2.0, 0.3).cov, predict(start, np.array([2.0, 0.3]), QUIET).cov, atol=1e-12
    )
    kalman.predict(2.0, 0.3)
    expected = predict(start, np.array([2.0, 0.3]), QUIET)
    np.testing.assert_allclose(kalman.belief.cov, expected.cov, atol=1e-12)
    np.testing.assert_allclose(kalman.belief.mean, expected.mean, atol=1e-12)
    np.testing.assert_allclose(kalman.state.std[4:], [0.5, 0.015])


def test_without_a_prior_the_bias_is_no_state() -> None:
    config = LocalizationConfig(WORLD.walls, N150, QUIET, EXACT_RAYS, range_stds=None)
    for method in ("ekf", "smoother"):
        kalman = make(method, config, independent(START, STD))
        assert isinstance(kalman, KalmanFilter)
        assert kalman.state.mean.shape == (3,)
    assert isinstance(kalman, FixedLagSmoother)
    assert kalman.smoothed().mean.shape == (3,)
