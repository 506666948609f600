"""Chi-square tests of a finished map: dense leverages, scipy's distribution, maps that contradict their readings."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import chdtri

from localization.filters.belief import Floats
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate
from localization.mapping.consistency import (
    LATE_STD_IN,
    RETURN_RISK,
    RISK,
    _score,
    check_parts,
    common_errors,
    compare_returns,
    is_consistent,
    late_information,
    least_explained,
    leverages,
    repeated_ranges,
)
from localization.mapping.learn import learn_map
from localization.mapping.measurements import Indices, build_trajectory
from localization.mapping.merging import find_undecided
from localization.mapping.output import describe, quality_of
from localization.mapping.problem import NO_FEATURE, MapProblem, Reflection
from localization.mapping.walls import extract_walls
from localization.mapping.weights import POINT_WEIGHT
from tests.localization.mapping.drives import drive
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


def test_points_count_for_less_where_walls_have_levels(estimate: MapEstimate) -> None:
    """A corner is where the levels of both walls meet: its ranges have five times the variance."""
    rng = np.random.default_rng(4)
    planes = with_residuals(estimate, rng.normal(size=len(estimate.assignment.feature)))
    sonars = len(estimate.state.parameters) - 4
    surfaces = Reflection(surface_std_in=1.75)
    levels = replace(planes, problem=MapProblem(planes.problem.trajectory, sonars, reflection=surfaces))
    for before, after in zip(check_parts(planes)[1:], check_parts(levels)[1:], strict=True):
        assert after.kind == before.kind
        assert after.freedom == pytest.approx(before.freedom)
        factor = POINT_WEIGHT if after.kind == "point" else 1.0
        assert after.total == pytest.approx(factor * before.total)


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


@pytest.mark.parametrize(("aside_in", "is_refused"), [(0.55, True), (0.1, False)])
def test_wall_that_may_be_two_is_undecided(estimate: MapEstimate, aside_in: float, is_refused: bool) -> None:
    assert find_undecided(estimate) == []
    # Every second echo of a wall is taken for one of another wall beside it.
    double, count = estimate.copy(), len(estimate.state.walls)
    double.add_wall(estimate.state.walls[0] + (0.0, aside_in), estimate.extents[0])
    feature = double.assignment.feature.copy()
    feature[estimate.echoes_of(0)[::2]] = count
    double.assignment = replace(double.assignment, feature=feature)
    assert [set(pair) for pair in find_undecided(double)] == [{0, count}]
    # Less than 0.5 in apart they are written as one.
    assert (describe(double).reason_to_refuse() != "") == is_refused
    if is_refused:
        assert "one wall or two" in describe(double).reason_to_refuse()
        # One after the other they are the same wall, however many they are.
        pieces = [piece for piece in extract_walls(double) if piece.wall in {0, count}]
        parts = np.array([[[0.0], [0.5]], [[0.5], [1.0]]])
        in_line = [
            replace(piece, ends=piece.ends[0] + part * (piece.ends[1] - piece.ends[0]))
            for piece, part in zip(pieces, parts, strict=True)
        ]
        assert len(quality_of(double, pieces).undecided) == 1
        assert len(quality_of(double, in_line).undecided) == 0


def test_stretch_that_nothing_explains_refuses_the_map(estimate: MapEstimate) -> None:
    node = estimate.problem.trajectory.node
    feature = estimate.assignment.feature.copy()
    # Of the ranges of 20 s only every second one is explained; the whole drive has more.
    feature[(node >= 40) & (node < 80) & (np.arange(len(node)) % 2 == 0)] = NO_FEATURE
    worse = replace(estimate, assignment=replace(estimate.assignment, feature=feature))
    least, found = least_explained(worse), describe(worse)
    assert least is not None
    assert 0.4 < least.explained < 0.55
    in_stretch = (node >= 40) & (node < 80) & repeated_ranges(worse.problem.trajectory, rays=False)
    assert least.explained == pytest.approx(float((feature[in_stretch] != NO_FEATURE).mean()))
    count = int(in_stretch.sum())
    np.testing.assert_allclose(least.place, estimate.state.poses[40:80, :2].mean(axis=0))
    # Two standard deviations of a mean.
    std = float(np.std(feature[in_stretch] != NO_FEATURE)) / count**0.5
    assert least.at_most - least.explained == pytest.approx(2.0 * std)
    assert found.quality.explained > 0.7
    assert "of the ranges of 20 s" in found.reason_to_refuse()


# What was measured late, and early.


def late_rows(estimate: MapEstimate, feature: int, node: int) -> Indices:
    """Return the rows of a feature's echoes since a node, among the explained ones."""
    explained = np.flatnonzero(estimate.assignment.feature != NO_FEATURE)
    nodes = estimate.problem.trajectory.node[explained]
    return np.flatnonzero((estimate.assignment.feature[explained] == feature) & (nodes >= node))


def test_late_displacement_is_that_of_a_map_with_two_walls(estimate: MapEstimate) -> None:
    plain = estimate.copy()
    plain.problem = estimate.problem.plain
    wall = 1
    rows = late_rows(plain, wall, 60)
    E, e = late_information(plain, [rows])
    # The same wall twice, the second one for the late echoes: its step less that of the first one.
    double = plain.copy()
    double.add_wall(plain.state.walls[wall], plain.extents[wall])
    walls = len(plain.state.walls)
    feature = double.assignment.feature.copy()
    feature[np.flatnonzero(plain.assignment.feature != NO_FEATURE)[rows]] = walls
    ties = plain.assignment.ties
    double.assignment = replace(double.assignment, feature=feature, ties=ties)
    equations = plain.problem.normal_equations(double.state, double.assignment)
    _, step = equations.solve()
    both = np.zeros((2, len(step)))
    both[:, 2 * walls : 2 * walls + 2], both[:, 2 * wall : 2 * wall + 2] = np.eye(2), -np.eye(2)
    covariance = both @ equations.border_covariance() @ both.T
    np.testing.assert_allclose(np.linalg.inv(E), covariance, rtol=1e-4)
    np.testing.assert_allclose(np.linalg.solve(E, e), both @ step, rtol=1e-3, atol=1e-6)


def left_for_a_while(estimate: MapEstimate, shift_in: float) -> MapEstimate:
    """Return a map without the echoes of wall 0 in the middle of the drive, its late ranges longer by a shift."""
    node, feature = estimate.problem.trajectory.node, estimate.assignment.feature
    feature = np.where((feature == 0) & (abs(node - 58) < 25), NO_FEATURE, feature)
    changed = replace(estimate, assignment=replace(estimate.assignment, feature=feature))
    trajectory = estimate.problem.trajectory
    readings = trajectory.readings_in + np.where((feature == 0) & (node > 58), shift_in, 0.0)
    changed.problem = changed.problem.with_trajectory(replace(trajectory, readings_in=readings))
    changed.optimize(20)
    return changed


def test_wall_that_is_elsewhere_later_contradicts(estimate: MapEstimate) -> None:
    parts = compare_returns(left_for_a_while(estimate, 0.0))
    assert [part.kind for part in parts] == ["late map", "late wall"]
    assert max(part.excess for part in parts) < 1.0
    shifted = left_for_a_while(estimate, 1.5)
    late, wall = compare_returns(shifted)
    assert (wall.freedom, late.freedom) == (2.0, 2.0)
    assert wall.excess > 1.0
    assert "what was measured late contradicts" in describe(shifted).reason_to_refuse()
    # The quantile for ranges that vary, and neighbours that correlate, as these do.
    echoes = np.flatnonzero(shifted.assignment.feature != NO_FEATURE)
    r = shifted.problem.range_residuals(shifted.state, shifted.assignment)[1][:, 0]
    feature = shifted.assignment.feature[echoes]
    products = sum(one * other for f in set(feature.tolist()) for one, other in pairwise(r[feature == f]))
    rho = max(products / (r @ r), 0.0)
    variance = r @ r / (len(r) - leverages(shifted.problem, shifted.state, shifted.assignment)[0].sum())
    assert 0.3 < variance < 1.0
    assert wall.limit == pytest.approx(chdtri(2.0, RETURN_RISK) * variance * (1.0 + rho) / (1.0 - rho))


def test_common_errors_change_the_ranges_by_their_deviation() -> None:
    rng = np.random.default_rng(3)
    roots = rng.uniform(0.2, 2.0, 30)
    # A wall of which 20 in are seen: (angle, offset) change the range at the foot f by offset - f angle.
    by_feature = np.stack((-rng.uniform(100.0, 120.0, 30), np.ones(30)), axis=-1)
    D = common_errors(by_feature * roots[:, None], roots)
    changes = by_feature @ np.linalg.cholesky(D) @ rng.standard_normal((2, 20_000))
    mean_square = np.average(np.square(changes).mean(axis=1), weights=roots**2)
    # One deviation for what all have in common, and one for what grows along the wall.
    assert mean_square == pytest.approx(2.0 * LATE_STD_IN**2, rel=0.03)


def test_score_is_that_of_displacements_with_common_errors() -> None:
    rng = np.random.default_rng(4)
    A, B = rng.standard_normal((2, 4, 4))
    E, D = A @ A.T + np.eye(4), B @ B.T
    # Estimates of no displacement: errors of the ranges, whose covariance is E^-1, and common ones.
    covariance = np.linalg.inv(E) + D
    d = np.linalg.cholesky(covariance) @ rng.standard_normal((4, 20_000))
    squares = np.array([_score(E, E @ each, D) for each in d.T])
    np.testing.assert_allclose(squares, np.einsum("in,ij,jn->n", d, np.linalg.inv(covariance), d), rtol=1e-6)
    # One in twenty is above the quantile: a standard error of 0.0015.
    assert np.mean(squares > chdtri(4.0, 0.05)) == pytest.approx(0.05, abs=0.006)


def test_features_in_sight_all_the_time_are_not_compared(estimate: MapEstimate) -> None:
    assert compare_returns(estimate) == []


@pytest.mark.parametrize("rays", [False, True])
def test_random_readings_do_not_repeat(rays: bool) -> None:
    log = drive(2, rays=rays)
    rng = np.random.default_rng(5)
    is_random = rng.random(len(log.readings_in)) < 0.2
    readings = np.where(is_random, rng.uniform(7.0, 254.0, len(is_random)).round(), log.readings_in)
    sound, mixed = (
        build_trajectory(each, OdometryNoise(0.05, 0.05, 0.002), ConeSonar(), 0.15, rays=rays)
        for each in (log, replace(log, readings_in=readings))
    )
    assert repeated_ranges(sound, rays=rays).mean() > 0.9
    # The echoes of the trajectory are the firings of its groups that are ranges.
    firings = np.concatenate([np.arange(8 * group, 8 * group + 8) for group in mixed.group])
    firings = firings[(readings[firings] > 6.0) & (readings[firings] < 255.0)]
    repeats = repeated_ranges(mixed, rays=rays)
    assert repeats[~is_random[firings]].mean() > 0.85
    assert repeats[is_random[firings]].mean() < 0.3


def test_map_of_a_drive_with_random_readings_is_sound() -> None:
    log = drive(2)
    rng = np.random.default_rng(5)
    is_random = rng.random(len(log.readings_in)) < 0.3
    readings = np.where(is_random, rng.uniform(7.0, 254.0, len(is_random)).round(), log.readings_in)
    found = describe(learn_map(replace(log, readings_in=readings), OdometryNoise(0.05, 0.05, 0.002), ConeSonar()))
    assert found.quality.explained < 0.7
    assert found.quality.repeated > 0.8
    assert found.reason_to_refuse() == ""
