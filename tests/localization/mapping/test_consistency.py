"""Chi-square tests of a finished map: dense leverages, scipy's distribution, maps that contradict their readings."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import chdtri

from localization.filters.belief import Floats
from localization.mapping.association import MapEstimate
from localization.mapping.consistency import RISK, check_parts, is_consistent, least_explained, leverages
from localization.mapping.learn import find_undecided
from localization.mapping.output import describe
from localization.mapping.problem import NO_FEATURE, MapProblem
from tests.localization.mapping.test_problem import dense, difference_jacobian, perturbed, trajectory

__all__ = ["trajectory"]


def with_residuals(estimate: MapEstimate, residuals: Floats) -> MapEstimate:
    """Return an estimate whose ranges have residuals (e,) of all its echoes, but for what the unknowns take up."""
    problem, trajectory = estimate.problem, estimate.problem.trajectory
    _, present, _ = problem.range_residuals(estimate.state, estimate.assignment)
    echoes = np.flatnonzero(estimate.assignment.feature != NO_FEATURE)
    readings = trajectory.readings_in.copy()
    left = np.sqrt(1.0 - leverages(problem, estimate.state, estimate.assignment)[0])
    readings[echoes] += (residuals[echoes] * left - present[:, 0]) * trajectory.std_in[echoes]
    changed = MapProblem(replace(trajectory, readings_in=readings), len(estimate.state.parameters) - 4)
    return replace(estimate, problem=changed)


def test_leverages_are_those_of_the_dense_hat_matrix(trajectory) -> None:  # type: ignore[no-untyped-def]
    problem = MapProblem(trajectory, 16, robust=False)
    state, assignment = perturbed(trajectory, 5)
    J = difference_jacobian(problem, state, assignment)
    H, _ = dense(problem.normal_equations(state, assignment))
    H[:3, :3] += 1e8 * np.eye(3)
    hat = np.einsum("ri,ij,rj->r", J, np.linalg.inv(H), J)
    ranges, steps = leverages(problem, state, assignment)
    count = 3 * len(steps)
    np.testing.assert_allclose(steps, hat[:count].reshape(-1, 3).sum(axis=1), atol=1e-5)
    np.testing.assert_allclose(ranges, hat[count : count + 2 * len(ranges) : 2], atol=1e-5)
    # All unknowns but the fixed first pose are taken up by residuals.
    assert hat.sum() == pytest.approx(len(H) - 3, abs=0.01)


def test_quantile_of_the_whole_is_that_of_scipy(estimate: MapEstimate) -> None:
    rng = np.random.default_rng(2)
    whole = check_parts(with_residuals(estimate, rng.normal(size=len(estimate.assignment.feature))))[0]
    # Independent residuals: their correlation of about 0.04 leaves 99.7 % of the degrees of freedom.
    assert whole.limit == pytest.approx(chdtri(whole.freedom, RISK), rel=0.002)
    assert 0.9 < whole.total / whole.freedom < 1.1
    assert whole.excess < 1.0


def test_correlated_neighbours_count_for_less(estimate: MapEstimate) -> None:
    rng = np.random.default_rng(3)
    noise = rng.normal(size=len(estimate.assignment.feature))
    correlated = noise.copy()
    for feature in range(estimate.state.features):
        echoes = estimate.echoes_of(feature)
        for before, after in pairwise(echoes):
            correlated[after] = 0.4 * correlated[before] + (1.0 - 0.4**2) ** 0.5 * noise[after]
    independent, dependent = (check_parts(with_residuals(estimate, r))[0] for r in (noise, correlated))
    assert independent.limit < dependent.limit < chdtri(independent.freedom * 0.6, RISK) / 0.6


def test_part_that_contradicts_refuses_the_map(estimate: MapEstimate) -> None:
    rng = np.random.default_rng(4)
    noise = 0.8 * rng.normal(size=len(estimate.assignment.feature))
    sound = describe(with_residuals(estimate, noise))
    assert sound.reason_to_refuse() == ""
    # One wall of eight features, whose echoes are twice as far off: the whole drive does not show it.
    noise[estimate.echoes_of(0)] *= 2.0
    bad = describe(with_residuals(estimate, noise))
    assert bad.quality.parts[0].excess < 1.0
    assert bad.quality.worst.kind == "wall"
    assert "of the wall at" in bad.reason_to_refuse()


def test_map_that_contradicts_is_not_relied_on_whatever_it_costs(estimate: MapEstimate) -> None:
    rng = np.random.default_rng(4)
    noise = 0.8 * rng.normal(size=len(estimate.assignment.feature))
    assert is_consistent(with_residuals(estimate, noise))
    noise[estimate.echoes_of(0)] *= 2.0
    assert not is_consistent(with_residuals(estimate, noise))


def test_map_that_explains_too_little_is_not_relied_on(estimate: MapEstimate) -> None:
    assert is_consistent(estimate)
    fewer = estimate.copy()
    while fewer.state.features > 1:
        fewer.remove(0)
    assert not is_consistent(fewer)


def test_loop_that_strains_the_odometry_is_found(estimate: MapEstimate) -> None:
    # A corner is out of sight for 30 s. Then it is where it was, for a robot that slipped by 3 in meanwhile.
    state, node, feature = estimate.state, estimate.problem.trajectory.node, estimate.assignment.feature
    feature = np.where((feature == estimate.state.features - 1) & (abs(node - 58) < 30), NO_FEATURE, feature)
    estimate = replace(estimate, assignment=replace(estimate.assignment, feature=feature))
    (loop,) = (part for part in check_parts(estimate) if part.kind == "loop")
    assert loop.excess < 1.0
    poses = state.poses.copy()
    poses[58:, 0] += 3.0
    (loop,) = (p for p in check_parts(replace(estimate, state=replace(state, poses=poses))) if p.kind == "loop")
    assert loop.excess > 1.0


def test_wall_that_may_be_two_is_undecided(estimate: MapEstimate) -> None:
    assert find_undecided(estimate) == []
    # Every second echo of a wall is taken for one of another wall, 0.1 in beside it.
    double = estimate.copy()
    double.add_wall(estimate.state.walls[0] + (0.0, 0.1), estimate.extents[0])
    feature = double.assignment.feature.copy()
    feature[estimate.echoes_of(0)[::2]] = len(estimate.state.walls)
    double.assignment = replace(double.assignment, feature=feature)
    assert [set(pair) for pair in find_undecided(double)] == [{0, len(estimate.state.walls)}]
    assert "one wall or two" in describe(double).reason_to_refuse()


def test_stretch_that_nothing_explains_refuses_the_map(estimate: MapEstimate) -> None:
    node = estimate.problem.trajectory.node
    feature = estimate.assignment.feature.copy()
    # Of the ranges of 20 s only every second one is explained; the whole drive has more.
    feature[(node >= 40) & (node < 80) & (np.arange(len(node)) % 2 == 0)] = NO_FEATURE
    worse = replace(estimate, assignment=replace(estimate.assignment, feature=feature))
    least, found = least_explained(worse), describe(worse)
    assert least is not None
    assert 0.4 < least.explained < 0.55
    in_stretch = (node >= 40) & (node < 80)
    assert least.explained == pytest.approx(float((feature[in_stretch] != NO_FEATURE).mean()))
    count = int(in_stretch.sum())
    np.testing.assert_allclose(least.place, estimate.state.poses[40:80, :2].mean(axis=0))
    # Two standard deviations of a mean.
    std = float(np.std(feature[in_stretch] != NO_FEATURE)) / count**0.5
    assert least.at_most - least.explained == pytest.approx(2.0 * std)
    assert found.quality.explained > 0.7
    assert "of the ranges of 20 s" in found.reason_to_refuse()
