"""Rules of correction against filterpy, Stone-Soup, a general minimiser, and the posterior on a grid."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats
from localization.filters.ukf import unscented
from localization.filters.update import Association, Correction, Refusal, Rule, iterated, linear

VERTEX = np.array([3.0, 4.0])
VARIANCE = 0.1
COV = np.array([[1.0, 0.2, 0.02], [0.2, 0.5, -0.01], [0.02, -0.01, 0.01]])
BELIEF = Belief(np.array([0.0, 0.0, 0.3]), COV)
READING_IN = 5.6


def to_vertex(poses: Floats) -> tuple[Floats, Floats]:
    """Range to the vertex and its derivative: it curves with the distance."""
    offset = poses[..., :2] - VERTEX
    ranges = np.hypot(offset[..., 0], offset[..., 1])
    return ranges, np.concatenate((offset / ranges[..., None], np.zeros((*ranges.shape, 1))), axis=-1)


def associated(belief: Belief) -> Association:
    ranges, H = to_vertex(belief.mean[None, :3])
    return Association(Refusal.NONE, 1.0, ranges.tolist(), H.tolist(), [VARIANCE], [0.0], [1.0], to_vertex)


def corrected(rule: Rule, belief: Belief, reading: float, association: Association | None = None) -> Correction:
    found = association or associated(belief)
    (correction,) = rule(belief.mean.tolist(), belief.cov.tolist(), reading, found, found.R)
    return correction


def posterior(belief: Belief, correction: Correction) -> Belief:
    K = np.array(correction.K)
    return Belief(belief.mean + correction.dx, belief.cov - correction.S * np.outer(K, K))


def range_of(state: Floats) -> Floats:
    return np.array([np.hypot(*(state[:2] - VERTEX))])


def test_the_linear_rule_is_filterpys_extended_filter() -> None:
    from filterpy.kalman import ExtendedKalmanFilter

    peer = ExtendedKalmanFilter(3, 1)
    peer.x, peer.P, peer.R = BELIEF.mean.copy(), BELIEF.cov.copy(), np.array([[VARIANCE]])
    peer.update(np.array([READING_IN]), lambda x: to_vertex(x)[1][None], range_of)
    taken = corrected(linear, BELIEF, READING_IN)
    after = posterior(BELIEF, taken)
    np.testing.assert_allclose(after.mean, peer.x, atol=1e-12)
    np.testing.assert_allclose(after.cov, peer.P, atol=1e-12)
    assert taken.nis == pytest.approx((READING_IN - 5.0) ** 2 / taken.S)


def test_the_unscented_rule_is_filterpys_unscented_filter() -> None:
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    # alpha, beta and kappa as in the module; the range is the measurement function.
    points = MerweScaledSigmaPoints(3, 1.0, 2.0, 0.0)
    peer = UnscentedKalmanFilter(3, 1, 1.0, range_of, lambda x, _: x, points)
    # No process noise: predict only draws the points.
    peer.x, peer.P, peer.R = BELIEF.mean.copy(), BELIEF.cov.copy(), np.array([[VARIANCE]])
    peer.Q = np.zeros((3, 3))
    peer.predict()
    peer.update(np.array([READING_IN]))
    taken = corrected(unscented, BELIEF, READING_IN)
    after = posterior(BELIEF, taken)
    np.testing.assert_allclose(after.mean, peer.x, atol=1e-12)
    np.testing.assert_allclose(after.cov, peer.P, atol=1e-12)
    assert pytest.approx(float(peer.S[0, 0])) == taken.S
    assert taken.innovation == pytest.approx(float(peer.y[0]))


def by_stone_soup(updater: str, **options: float) -> Belief:
    """Return the belief after the same reading by a class of `stonesoup.updater.kalman`."""
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.types.state import State
    from stonesoup.updater import kalman

    class RangeToVertex(NonLinearGaussianMeasurement):  # type: ignore[misc]  # Stone-Soup has no types
        @property
        def ndim_meas(self) -> int:
            return 1

        def function(self, state: State, noise: bool = False, **_: object) -> object:
            assert not noise
            vector = state.state_vector
            return type(vector)(np.hypot(vector[0] - VERTEX[0], vector[1] - VERTEX[1]).reshape(1, -1))

    model = RangeToVertex(ndim_state=3, mapping=(0, 1), noise_covar=np.array([[VARIANCE]]))
    prediction = GaussianStatePrediction(BELIEF.mean[:, None], BELIEF.cov)
    reading = Detection(np.array([[READING_IN]]), measurement_model=model)
    state = getattr(kalman, updater)(model, **options).update(SingleHypothesis(prediction, reading))
    return Belief(np.array(state.state_vector, dtype=np.float64)[:, 0], np.array(state.covar, dtype=np.float64))


@pytest.mark.parametrize(
    ("rule", "updater", "options", "within"),
    [
        (linear, "ExtendedKalmanUpdater", {}, 1e-6),
        (unscented, "UnscentedKalmanUpdater", {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}, 1e-9),
        (iterated, "IteratedKalmanUpdater", {"tolerance": 1e-9, "max_iterations": 50}, 1e-5),
    ],
)
def test_each_rule_agrees_with_stone_soup(rule: Rule, updater: str, options: dict[str, float], within: float) -> None:
    """Its derivatives are finite differences, which is what the wider bounds are for."""
    theirs = by_stone_soup(updater, **options)
    mine = posterior(BELIEF, corrected(rule, BELIEF, READING_IN))
    np.testing.assert_allclose(mine.mean, theirs.mean, atol=within)
    np.testing.assert_allclose(mine.cov, theirs.cov, atol=within)


@pytest.mark.parametrize("reading", [4.0, 5.0, 5.6, 7.0])
def test_the_iterated_rule_finds_the_most_likely_state(reading: float) -> None:
    from scipy.optimize import minimize

    # The cost that the iterated update minimizes: innovation and change, each by its variance.
    inverse = np.linalg.inv(BELIEF.cov)

    def cost(state: Floats) -> float:
        off = state - BELIEF.mean
        return float((reading - range_of(state)[0]) ** 2 / VARIANCE + off @ inverse @ off)

    # A minimizer without derivatives as the oracle.
    found = minimize(cost, BELIEF.mean, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 5000})
    taken = corrected(iterated, BELIEF, reading)
    np.testing.assert_allclose(BELIEF.mean + taken.dx, found.x, atol=1e-4)
    assert taken.nis == pytest.approx(found.fun, rel=1e-6, abs=1e-9)
    after = posterior(BELIEF, taken)
    # The covariance is that of the linearization at the result, not at the prior.
    slope = to_vertex(after.mean)[1]
    np.testing.assert_allclose(after.cov, np.linalg.inv(inverse + np.outer(slope, slope) / VARIANCE), atol=1e-4)


def test_a_step_that_leads_astray_is_not_taken() -> None:
    """From close by the vertex the straight line through the mean leads to the far side, where nothing fits."""
    # 3 in right of and 0.1 in below the vertex, with a standard deviation of 2 in across.
    near = Belief(np.array([3.0, 3.9, 0.0]), np.diag([4.0, 1e-4, 1e-4]))
    taken = corrected(iterated, near, 0.2)

    def cost(move: Floats) -> float:
        off = 0.2 - range_of(near.mean + move)[0]
        return float(off * off / VARIANCE + (move**2 / np.diag(near.cov)).sum())

    assert cost(np.array(taken.dx)) <= cost(np.zeros(3))
    assert taken.nis == pytest.approx(cost(np.array(taken.dx)))


@pytest.mark.parametrize("rule", [linear, iterated, unscented])
def test_all_rules_agree_for_linear_range(rule: Rule) -> None:
    slope = np.array([[-0.8, 0.6, 2.0]])

    def straight(poses: Floats) -> tuple[Floats, Floats]:
        return 40.0 + (poses * slope).sum(axis=-1), np.broadcast_to(slope, (*poses.shape[:-1], 3))

    ranges, jacobian = straight(BELIEF.mean[None, :])
    found = Association(Refusal.NONE, 1.0, ranges.tolist(), jacobian.tolist(), [0.3], [0.0], [1.0], straight)
    taken, plain = (corrected(each, BELIEF, 41.5, found) for each in (rule, linear))
    for mine, theirs in zip(taken, plain, strict=True):
        np.testing.assert_allclose(np.array(mine), np.array(theirs), atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("reading", [4.5, 5.6])
def test_the_density_of_a_reading_is_that_of_drawn_states(reading: float) -> None:
    """Against draws from the belief: each rule's density is within a tenth of what they average to."""
    rng = np.random.default_rng(3)
    states = rng.multivariate_normal(BELIEF.mean, BELIEF.cov, 400_000)
    off = reading - np.hypot(*(states[:, :2] - VERTEX).T)
    drawn = float((np.exp(-0.5 * off * off / VARIANCE) / np.sqrt(2 * np.pi * VARIANCE)).mean())
    for rule in (linear, iterated, unscented):
        taken = corrected(rule, BELIEF, reading)
        density = np.exp(-0.5 * taken.nis) / np.sqrt(2 * np.pi * taken.S)
        assert density == pytest.approx(drawn, rel=0.1)


def test_sigma_points_are_best_where_the_range_curves() -> None:
    """Close by a vertex: the mean of the posterior on a grid."""
    belief = Belief(np.array([2.0, 4.0, 0.0]), np.diag([0.16, 0.16, 1e-6]))
    x, y = np.meshgrid(np.linspace(0, 4, 801), np.linspace(2, 6, 801))
    weight = np.exp(-0.5 * ((x - 2) ** 2 + (y - 4) ** 2) / 0.16 - 0.5 * (1.1 - np.hypot(x - 3, y - 4)) ** 2 / VARIANCE)
    mean_x = (weight * x).sum() / weight.sum()
    off = {rule: abs(2.0 + corrected(rule, belief, 1.1).dx[0] - mean_x) for rule in (linear, unscented)}
    assert off[unscented] < 0.5 * off[linear]


def test_longer_states_are_corrected_by_correlation() -> None:
    cov = np.diag([1.0, 0.5, 0.01, 0.0025])
    cov[0, 3] = cov[3, 0] = 0.04
    belief = Belief(np.array([0.0, 0.0, 0.3, 0.0]), cov)
    for rule in (linear, iterated, unscented):
        dx = corrected(rule, belief, READING_IN).dx
        assert dx[3] == pytest.approx(0.04 * dx[0], rel=1e-9)
