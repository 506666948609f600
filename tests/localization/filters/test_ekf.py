"""`update_ring` against the linear Kalman filter in closed form, filterpy, and the properties of a covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localization.filters.belief import Belief, Floats, difference, independent
from localization.filters.ekf import update_ring
from localization.filters.odometry import OdometryNoise, move, predict, process_covariance, step_jacobians
from localization.filters.sonar_ray import Observation

NOISE = OdometryNoise()


def some_belief(rng: np.random.Generator, size: int = 3) -> Belief:
    root = 0.1 * rng.normal(size=(size, size))
    return Belief(rng.normal(size=size), root @ root.T + 1e-4 * np.eye(size))


def some_observation(rng: np.random.Generator, beams: int = 16, size: int = 3) -> Observation:
    return Observation(
        0.05 * rng.normal(size=beams),
        rng.normal(size=(beams, size)),
        rng.uniform(0.01, 1.0, beams),
        np.zeros(beams, dtype=np.int8),
    )


def textbook(belief: Belief, seen: Observation) -> tuple[Floats, Floats, float]:
    """Mean, covariance and NIS with the innovation covariance inverted as it stands in the books."""
    innovation_cov = seen.H @ belief.cov @ seen.H.T + np.diag(seen.R)
    gain = belief.cov @ seen.H.T @ np.linalg.inv(innovation_cov)
    nis = float(seen.innovation @ np.linalg.inv(innovation_cov) @ seen.innovation)
    return belief.mean + gain @ seen.innovation, belief.cov - gain @ innovation_cov @ gain.T, nis


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("size", [3, 5])
def test_a_correction_is_that_of_the_linear_kalman_filter(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    belief, seen = some_belief(rng, size), some_observation(rng, size=size)
    mean, cov, nis = textbook(belief, seen)
    updated, found = update_ring(belief, seen)
    assert updated.mean == pytest.approx(mean, abs=1e-12)
    assert updated.cov == pytest.approx(cov, abs=1e-12)
    assert found == pytest.approx(nis)


@pytest.mark.long
def test_a_whole_run_is_that_of_filterpy() -> None:
    """Predictions with filterpy's own product, corrections as sixteen scalar updates one after another."""
    from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(11)
    belief = independent((1.0, 2.0, 0.3), (0.1, 0.1, 0.01))
    peer = KalmanFilter(dim_x=3, dim_z=1)
    # filterpy has its own predict and update; only the motion model is given to it.
    peer.P = belief.cov
    for _ in range(50):
        step = rng.normal(scale=(0.3, 0.02))
        mean, (F, G) = move(belief.mean, step), step_jacobians(belief.mean, step)
        peer.predict(F=F, Q=process_covariance(G, step, NOISE))
        # The mean moves by the nonlinear model, which filterpy's predict does not have.
        peer.x = mean
        seen = some_observation(rng)
        belief, _ = update_ring(predict(belief, step, NOISE), seen)
        # filterpy takes measurements, the observation has innovations: add what is expected.
        for reading, row, variance in zip(seen.innovation + seen.H @ mean, seen.H, seen.R, strict=True):
            peer.update(reading, R=variance, H=row[None])
        assert belief.mean == pytest.approx(peer.x, abs=1e-10)
        assert belief.cov == pytest.approx(peer.P, abs=1e-12)


def test_a_prediction_is_f_p_f_and_q() -> None:
    belief = some_belief(np.random.default_rng(12))
    step = np.array([0.5, 0.1])
    mean, (F, G) = move(belief.mean, step), step_jacobians(belief.mean, step)
    predicted = predict(belief, step, NOISE)
    assert predicted.mean == pytest.approx(mean)
    assert predicted.cov == pytest.approx(F @ belief.cov @ F.T + process_covariance(G, step, NOISE))


def test_a_step_of_nothing_changes_nothing() -> None:
    belief = some_belief(np.random.default_rng(13))
    still = predict(belief, np.zeros(2), NOISE)
    assert still.mean.tolist() == belief.mean.tolist()
    assert still.cov == pytest.approx(belief.cov, abs=1e-18)


@pytest.mark.long
def test_the_spread_of_drawn_robots_is_the_one_predicted() -> None:
    rng = np.random.default_rng(14)
    noise = OdometryNoise(0.02, 0.02, 0.001)
    start = independent((0.0, 0.0, 0.3), (0.05, 0.05, 0.005))
    belief = start
    # 50,000 robots: their sample covariance is within 1 % of the true one.
    robots = start.mean + start.std * rng.standard_normal((50_000, 3))
    for _ in range(20):
        step = np.array([1.0, 0.05])
        # Variances of the thesis: proportional to distance and turn, and a drift per distance.
        std = np.sqrt(np.array([0.02**2 * 1.0, 0.02**2 * 0.05 + 0.001**2 * 1.0]))
        robots = move(robots, step + std * rng.standard_normal((50_000, 2)))
        belief = predict(belief, step, noise)
    assert np.cov(robots.T) == pytest.approx(belief.cov, rel=0.05, abs=2e-5)


@given(st.integers(0, 1000), st.floats(-12, 0), st.floats(-12, 3))
def test_a_covariance_stays_symmetric_and_never_negative(seed: int, log_noise: float, log_spread: float) -> None:
    """Also where readings are a trillion times better than the belief, or worse."""
    rng = np.random.default_rng(seed)
    # Both spread and noise vary over many powers of ten.
    belief = Belief(np.zeros(3), 10**log_spread * some_belief(rng).cov)
    seen = some_observation(rng)
    seen = Observation(seen.innovation, seen.H, 10**log_noise * seen.R, seen.refusals)
    cov = update_ring(belief, seen)[0].cov
    assert (cov == cov.T).all()
    values = np.linalg.eigvalsh(cov)
    # Rounding may leave eigenvalues below zero only by machine precision.
    assert values.min() >= -1e-12 * values.max()
    # A measurement never increases uncertainty.
    assert values.max() <= np.linalg.eigvalsh(belief.cov).max() * (1 + 1e-9)


def test_beams_left_out_change_nothing() -> None:
    rng = np.random.default_rng(15)
    belief, seen = some_belief(rng), some_observation(rng, beams=4)
    # One beam more, with a refusal: its innovation and row must not matter.
    padded = Observation(
        np.append(seen.innovation, 0.0),
        np.vstack([seen.H, np.zeros(3)]),
        np.append(seen.R, 1.0),
        np.append(seen.refusals, np.int8(5)),
    )
    (few, few_nis), (more, more_nis) = update_ring(belief, seen), update_ring(belief, padded)
    assert few.mean == pytest.approx(more.mean, abs=1e-15)
    assert few.cov == pytest.approx(more.cov, abs=1e-15)
    assert few_nis == pytest.approx(more_nis)


def test_beams_one_after_another_are_beams_together() -> None:
    rng = np.random.default_rng(16)
    belief, seen = some_belief(rng), some_observation(rng, beams=5)
    # Sequential updates: the innovation of each is taken at the estimate after the one before.
    one_by_one = belief
    for number in range(5):
        row = seen.H[number : number + 1]
        moved_on = row @ difference(one_by_one.mean, belief.mean)
        single = Observation(
            seen.innovation[number : number + 1] - moved_on, row, seen.R[number : number + 1], seen.refusals[:1]
        )
        one_by_one, _ = update_ring(one_by_one, single)
    together, _ = update_ring(belief, seen)
    assert one_by_one.mean == pytest.approx(together.mean)
    assert one_by_one.cov == pytest.approx(together.cov)


def test_a_belief_without_doubt_is_not_moved() -> None:
    belief = independent((1.0, 2.0, 0.5), (0.0, 0.0, 0.0))
    corrected, _ = update_ring(belief, some_observation(np.random.default_rng(17)))
    assert corrected.mean.tolist() == belief.mean.tolist()
    assert (corrected.cov == 0).all()


def test_a_heading_corrected_across_the_turn_wraps() -> None:
    belief = independent((0.0, 0.0, 3.1), (0.1, 0.1, 1.0))
    seen = Observation(np.array([0.1]), np.array([[0.0, 0.0, 1.0]]), np.array([1e-8]), np.zeros(1, dtype=np.int8))
    corrected, nis = update_ring(belief, seen)
    assert corrected.mean[2] == pytest.approx(3.2 - 2 * math.pi, abs=1e-6)
    assert nis == pytest.approx(0.01, rel=1e-5)


def test_a_batch_is_filtered_as_each_alone() -> None:
    # Seven filters with different beliefs, steps and observations.
    rng = np.random.default_rng(18)
    alone = [(some_belief(rng), some_observation(rng)) for _ in range(7)]
    steps = rng.normal(scale=0.1, size=(7, 2))
    beliefs = Belief(np.stack([b.mean for b, _ in alone]), np.stack([b.cov for b, _ in alone]))
    seen = Observation(*(np.stack([getattr(o, name) for _, o in alone]) for name in Observation.__slots__))
    together, _ = update_ring(predict(beliefs, steps, NOISE), seen)
    for row, (belief, observation) in enumerate(alone):
        single, _ = update_ring(predict(belief, steps[row], NOISE), observation)
        assert together.mean[row] == pytest.approx(single.mean, abs=1e-13)
        assert together.cov[row] == pytest.approx(single.cov, abs=1e-13)
