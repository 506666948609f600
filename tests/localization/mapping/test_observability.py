"""The bound over free space: its information by differences, its limit in closed form, a filter in comparison."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from localization.experiments.live_trial import EXACT_RAYS
from localization.filters.base import LocalizationConfig, measurement_model
from localization.filters.belief import Floats, difference, independent, unpack
from localization.filters.odometry import OdometryNoise, move, process_covariance, step_jacobians, step_variance
from localization.filters.registry import make
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import range_variance
from localization.filters.update import Refusal
from localization.mapping.observability import (
    CYCLE_S,
    CYCLES,
    DIRECTIONS,
    HEADINGS,
    START_STD,
    _bound_after_cycles,
    compute_observability,
)
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150, SONARS

ROOM = np.array([[0, 0, 120, 0], [120, 0, 120, 100], [120, 100, 0, 100], [0, 100, 0, 0]], dtype=np.float64)
CORRIDOR = np.array([[-900.0, 0.0, 900.0, 0.0], [-900.0, 60.0, 900.0, 60.0]])
QUIET = OdometryNoise(0.05, 0.05, 0.002)
PLACES = np.array([[41.3, 30.9], [61.7, 52.4], [97.1, 82.6]])


def directions(pose: Floats) -> Floats:
    angles = pose[2] + np.array(N150.sonar_angles_rad)
    return np.stack((np.cos(angles), np.sin(angles)), axis=-1)


def ranges(pose: Floats) -> Floats:
    """Of all sixteen sonars, by the ray caster."""
    return cast_rays(pose[:2], directions(pose), ROOM)[0] - N150.sonar_ring_radius_in


def test_the_end_of_the_recursion_solves_riccatis_equation() -> None:
    """P^-1 = (F P F' + Q)^-1 + J on some path, with J, F and Q by central differences."""
    bound = compute_observability(LocalizationConfig(ROOM, N150, QUIET, EXACT_RAYS), PLACES, 5.0)
    # Odometry noise of the quiet setup for one cycle of 4.8 in.
    rng = np.diag([0.05**2 * 4.8, 0.002**2 * 4.8])
    for place, cov in zip(PLACES, bound.cov, strict=True):
        # Information of one ring of echoes, averaged over the headings.
        information = np.zeros((3, 3))
        for turn in np.arange(HEADINGS) * 2 * np.pi / SONARS / HEADINGS:
            pose = np.append(place, turn)
            # Central differences of the ranges by the pose.
            slope = np.array([(ranges(pose + offset) - ranges(pose - offset)) / 2e-5 for offset in 1e-5 * np.eye(3)]).T
            aimed = directions(pose)
            _, walls = cast_rays(np.tile(place, (SONARS, 1)), aimed, ROOM)
            # Flat angles of incidence give no echo; even walls are horizontal.
            steep = np.where(walls % 2 == 0, np.abs(aimed[:, 1]), np.abs(aimed[:, 0])) >= 0.3
            information += (slope[steep].T / EXACT_RAYS.variance(ranges(pose)[steep])) @ slope[steep] / HEADINGS
        # Prediction along straight steps in all directions.
        off = []
        for heading in np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS:
            pose, step = np.array([0.0, 0.0, heading]), np.array([4.8, 0.0])
            # F and G by central differences of the motion model.
            moved = np.array([(move(pose + by, step) - move(pose - by, step)) / 2e-5 for by in 1e-5 * np.eye(3)]).T
            strays = np.array([(move(pose, step + by) - move(pose, step - by)) / 2e-5 for by in 1e-5 * np.eye(2)]).T
            lost = strays @ rng @ strays.T
            # The residual of Riccati's equation for this direction.
            off.append(np.linalg.inv(moved @ cov @ moved.T + lost) + information - np.linalg.inv(cov))
        # The bound is that of the worst direction: for one of them the residual vanishes.
        least = min(off, key=lambda matrix: float(np.abs(matrix).max()))
        np.testing.assert_allclose(least, 0.0, atol=2e-4 * np.abs(np.linalg.inv(cov)).max())


@pytest.mark.parametrize("sonar", [EXACT_RAYS, ConeSonar()])
def test_position_along_corridor_is_unobservable(sonar: ConeSonar) -> None:
    """Driving along it costs what the odometry strays; the best path is across, and costs less."""
    bound = compute_observability(LocalizationConfig(CORRIDOR, N150, QUIET, sonar), np.array([[0.0, 30.0]]), 5.0)
    along = sqrt(START_STD[0] ** 2 + CYCLES * 0.05**2 * 5.0 * CYCLE_S)
    assert START_STD[0] < bound.worst_in[0] <= along
    assert sqrt(bound.cov[0, 1, 1]) < 0.2
    assert bound.heading_rad[0] < 0.1


@pytest.mark.long
def test_filter_error_approaches_the_bound() -> None:
    """A robot that goes in circles about a place, its sixteen sonars measured at once, by a filter that is no part of
    this."""
    config = LocalizationConfig(ROOM, N150, QUIET, EXACT_RAYS)
    rng = np.random.default_rng(8)
    # A cycle is one round of the ring at 5 in/s.
    distance = 5.0 * CYCLE_S
    squares, headings = [], []
    for _ in range(12):
        true = np.array([55.0, 45.0, rng.uniform(-3.0, 3.0)])
        method = make("ekf", config, independent(true, [0.3, 0.3, 0.02]))
        # 60 rounds: 20 to settle, 40 to measure.
        for round_ in range(60):
            step = np.array([distance, 0.35])
            true = move(true, step + np.sqrt(step_variance(step, QUIET)) * rng.standard_normal(2))
            # The filter is driven with the noise that it assumes.
            method.predict(*step.tolist())
            for sonar, far in enumerate(ranges(true)):
                method.update(sonar, 0.0, float(np.floor(far + 0.5)))
            if round_ > 20:
                error = difference(method.belief.mean, true)
                # Mean of the squared errors in x and y.
                squares.append(0.5 * (error[0] ** 2 + error[1] ** 2))
                headings.append(error[2] ** 2)
    bound = compute_observability(config, np.array([[55.0, 45.0]]), 5.0)
    # The error is not below the bound, and not far above it.
    assert 0.9 * bound.worst_in[0] < sqrt(np.mean(squares)) < 1.6 * bound.worst_in[0]
    assert 0.9 * bound.heading_rad[0] < sqrt(np.mean(headings))


@pytest.mark.long
def test_heading_error_approaches_the_bound_down_a_hall() -> None:
    """Down a long hall, where the path driven reports the heading far better than the ranges of a moment."""
    hall = np.array([[0, 0, 500, 0], [500, 0, 500, 100], [500, 100, 0, 100], [0, 100, 0, 0]], dtype=np.float64)
    config = LocalizationConfig(hall, N150, QUIET, ConeSonar())
    rng = np.random.default_rng(3)
    squares, stds = [], []
    # 16 runs of 80 rounds down a hall of 500 in x 100 in.
    for _ in range(16):
        true = np.array([40.0, 50.0, 0.0])
        method = make("ekf", config, independent(true, [0.3, 0.3, 0.02]))
        model = measurement_model(hall, N150, ConeSonar())
        for round_ in range(80):
            # A controller holds the robot in the middle of the hall.
            step = np.array([5.0 * CYCLE_S, -0.2 * true[2]])
            true = move(true, step + np.sqrt(step_variance(step, QUIET)) * rng.standard_normal(2))
            method.predict(*step.tolist())
            for sonar in range(SONARS):
                # The echoes of the true pose, drawn from the cone model itself.
                x, P = unpack(independent(true, [1e-3] * 3))
                found = model.associate(x, P, sonar, 0.0, 50.0)
                if found.refusal is not Refusal.NONE or rng.random() > sum(found.probability):
                    continue
                probability = np.array(found.probability)
                range_in = float(rng.choice(found.ranges_in, p=probability / probability.sum()))
                # Rounding is added by floor, so its variance is not drawn.
                range_in += sqrt(range_variance(ConeSonar(), range_in) - 1.0 / 12.0) * rng.standard_normal()
                bad = rng.random() < ConeSonar().outlier_probability
                method.update(sonar, 0.0, float(np.floor((rng.uniform(7.0, 254.0) if bad else range_in) + 0.5)))
            if round_ > 30:
                squares.append(difference(method.belief.mean, true)[2] ** 2)
                stds.append(sqrt(method.belief.cov[2, 2]))
    # The bound in the middle of the hall; standard deviations of the filter approach it from above.
    (bound,) = compute_observability(config, np.array([[250.0, 50.0]]), 5.0).heading_rad
    assert bound < np.mean(stds) < 1.6 * bound
    assert 0.9 * bound < sqrt(np.mean(squares)) < 2.0 * bound


def test_the_faster_the_weaker_and_cones_weaker_than_rays() -> None:
    exact, noisy = LocalizationConfig(ROOM, N150, QUIET, EXACT_RAYS), LocalizationConfig(ROOM, N150, QUIET, ConeSonar())
    slow, fast, real = (
        compute_observability(exact, PLACES, 1.0),
        compute_observability(exact, PLACES, 10.0),
        compute_observability(noisy, PLACES, 1.0),
    )
    assert (slow.worst_in < fast.worst_in).all()
    assert (slow.worst_in < real.worst_in).all()


def test_squared_cycles_equal_one_cycle_after_the_other() -> None:
    rng = np.random.default_rng(4)
    information = np.array([(part := rng.standard_normal((3, 3))) @ part.T for _ in range(5)])
    F, G = step_jacobians(np.array([0.0, 0.0, 0.7]), np.array([4.8, 0.0]))
    Q = process_covariance(G, np.array([4.8, 0.0]), QUIET)
    P = np.tile(np.diag(np.square(START_STD)), (5, 1, 1))
    for _ in range(CYCLES):
        P = np.linalg.inv(np.linalg.inv(F @ P @ F.T + Q) + information)
    found = _bound_after_cycles(QUIET, information, 4.8, 0.7)
    np.testing.assert_allclose(found, P, rtol=1e-7, atol=1e-12)
