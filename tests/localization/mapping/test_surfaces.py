"""Where the surface of a wall changes to another level."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from localization.filters.belief import Floats
from localization.mapping import revision
from localization.mapping.association import MapEstimate
from localization.mapping.problem import (
    LEVEL_CELL_IN,
    NO_FEATURE,
    NO_LEVEL,
    Levels,
    MapProblem,
    MapState,
    Reflection,
    sensors_at,
)
from localization.mapping.reflectors import is_blocked, residual_matrix, surface_segments
from localization.mapping.revision import trim_surfaces
from localization.mapping.surfaces import divided, gate_variances, stretches
from localization.mapping.walls import extract_walls

STD_IN, LENGTH_IN = 1.6, 24.0
CHANGES = 1.0 - float(np.exp(-LEVEL_CELL_IN / LENGTH_IN))


def negative_log_evidence(values: Floats, variances: Floats, begins: tuple[bool, ...]) -> float:
    """Return twice the negative logarithm of the density of readings of all cells, and of how the levels change."""
    starts = [0, *(k for k, new in enumerate(begins, start=1) if new), len(values)]
    total = -2.0 * sum(np.log(CHANGES if new else 1.0 - CHANGES) for new in begins)
    for first, end in pairwise(starts):
        own = np.flatnonzero(np.isfinite(variances[first:end])) + first
        if len(own):
            covariance = np.diag(variances[own]) + STD_IN**2
            total -= 2.0 * multivariate_normal.logpdf(values[own], np.zeros(len(own)), covariance)
    return float(total)


@pytest.mark.parametrize("seed", range(12))
def test_stretches_are_the_most_probable_ones_of_all(seed: int) -> None:
    """Oracle: scipy's normal densities of all 128 divisions of eight cells, some of which have no echo."""
    rng = np.random.default_rng(seed)
    truth = STD_IN * np.repeat(rng.normal(size=3), (3, 2, 3))
    variances = rng.uniform(0.02, 0.3, 8)
    variances[rng.random(8) < 0.3] = np.inf
    values = truth + rng.normal(size=8) * np.sqrt(np.where(np.isfinite(variances), variances, 0.0))
    begins, levels, cost = stretches(np.where(np.isfinite(variances), values, 0.0), 1.0 / variances, STD_IN, CHANGES)
    costs = {way: negative_log_evidence(values, variances, way) for way in product((False, True), repeat=7)}
    assert not begins[0]
    assert costs[tuple(begins[1:].tolist())] == pytest.approx(min(costs.values()))
    # Its cost is less than that by what all divisions have in common.
    other = stretches(np.where(np.isfinite(variances), -values, 0.0), 1.0 / variances, STD_IN, CHANGES)
    assert other.cost == pytest.approx(cost)
    flat = np.isfinite(variances)
    common = 2.0 * 7 * np.log(1.0 - CHANGES) - np.log(2.0 * np.pi * variances[flat]).sum()
    assert cost == pytest.approx(min(costs.values()) + common)
    # Each level is the mean of its stretch, drawn towards 0 by the prior.
    starts = [0, *np.flatnonzero(begins).tolist(), 8]
    for first, end in pairwise(starts):
        w = 1.0 / variances[first:end]
        np.testing.assert_allclose(levels[first:end], (w @ np.nan_to_num(values[first:end])) / (w.sum() + STD_IN**-2))


def test_one_level_is_no_change() -> None:
    begins, levels, _ = stretches(np.full(6, 0.8), np.full(6, 10.0), STD_IN, CHANGES)
    assert not begins.any()
    np.testing.assert_allclose(levels, 0.8 * 60.0 / (60.0 + STD_IN**-2))


def test_levels_are_divided_where_the_echoes_of_a_wall_step(estimate: MapEstimate) -> None:
    """A part of one wall of a room that stands out by 3 in: its echoes are as much shorter."""
    problem = estimate.problem
    reflection = Reflection(problem.reflection.half_cone_rad, STD_IN, LENGTH_IN)
    made = replace(estimate, problem=MapProblem(problem.trajectory, 16, reflection=reflection))
    made.associate()
    levels, own = made.state.levels, made.state.levels.of(0)
    assert not levels.is_new.any()
    assert np.abs(levels.value_in).max() < 1.0
    # A new wall has the levels that its echoes say.
    assert np.abs(levels.value_in[own]).min() > 0.0
    # 1. The readings of the first third of its cells.
    cells = np.arange(own.start, own.start + (own.stop - own.start) // 3)
    stands_out = np.isin(made.assignment.level, cells)
    trajectory = problem.trajectory
    shorter = replace(trajectory, readings_in=trajectory.readings_in - 3.0 * stands_out)
    stepped = replace(made, problem=made.problem.with_trajectory(shorter))
    found = divided(stepped.problem, stepped.state, stepped.assignment, np.ones(len(levels), dtype=np.bool_))
    assert np.flatnonzero(found.is_new).tolist() == [cells[-1] + 1]
    step = np.median(found.value_in[cells]) - np.median(found.value_in[cells[-1] + 1 : own.stop])
    # Towards the normal, which points away from the room or into it.
    assert abs(step) == pytest.approx(3.0, abs=0.4)
    assert np.sign(step) == estimate.sides[0]
    # 2. Other walls keep their levels, and a wall that is divided as before keeps its own.
    np.testing.assert_array_equal(found.value_in[own.stop :], levels.value_in[own.stop :])
    moved = replace(found, value_in=found.value_in + 0.1)
    kept = divided(stepped.problem, replace(stepped.state, levels=moved), stepped.assignment,
                   np.ones(len(levels), dtype=np.bool_))  # fmt: skip
    np.testing.assert_array_equal(kept.value_in, moved.value_in)
    # Unless a part of it was not known before.
    unknown = divided(stepped.problem, replace(stepped.state, levels=moved), stepped.assignment,
                      np.arange(len(levels)) != own.start)  # fmt: skip
    np.testing.assert_allclose(unknown.value_in[own], found.value_in[own], atol=0.01)


def test_surface_of_a_part_has_the_levels_of_its_stretches_and_the_steps_between_them() -> None:
    # A wall at x = 10 whose direction is +y, with cells from y = -4 to 20 and steps at 4 and 12; another one has none.
    levels = Levels(
        np.zeros(6, dtype=np.intp), np.arange(-1, 5), np.array((1.0, 1.0, -6.0, -6.0, 0.5, 0.5)), np.zeros(6),
        np.array((False, False, True, False, True, False)),
    )  # fmt: skip
    walls = np.array(((0.0, 10.0), (0.5 * np.pi, 7.0)))
    state = MapState(np.zeros((1, 3)), walls, np.empty((0, 2)), np.zeros(4), levels)
    found = surface_segments(state, np.array(((1, -3.0, 5.0), (0, -10.0, 8.0), (0, 9.0, 10.0))))
    expected = {
        # The wall at y = 7 runs to -x.
        (3.0, 7.0, -5.0, 7.0),
        # Beyond its cells a wall goes on at the last level; a step is a segment across it.
        (11.0, -10.0, 11.0, 4.0), (11.0, 4.0, 4.0, 4.0), (4.0, 4.0, 4.0, 8.0),
        # A part within one level.
        (4.0, 9.0, 4.0, 10.0),
    }  # fmt: skip
    assert {tuple(row) for row in found.round(9).tolist()} == expected
    assert surface_segments(state, np.empty((0, 3))).shape == (0, 4)


def test_a_post_on_a_stretch_that_stands_back_is_seen(estimate: MapEstimate) -> None:
    """A line between levels 7 in apart would hide what is on the one that is farther off."""
    made = replace(estimate, problem=MapProblem(estimate.problem.trajectory, 16, reflection=Reflection(0.2, 1.75)))
    made.associate()
    wall, side = 0, estimate.sides[0]
    own = made.state.levels.of(wall)
    angle, offset = made.state.walls[wall]
    normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    at = made.extents[wall].mean()
    post = at * along + (offset - 7.0 * side) * normal
    face = at * along + (offset + 30.0 * side) * normal
    # 1. Behind the surface.
    assert is_blocked(face[None], post[None], made.blocking, made.blocked_in)[0]
    # 2. On it, where the surface stands back by as much.
    cell = made.state.levels.cell[own]
    back = np.abs(LEVEL_CELL_IN * (cell + 0.5) - at) < 12.0
    values, is_new = made.state.levels.value_in.copy(), made.state.levels.is_new.copy()
    values[own] -= 7.0 * side * back
    is_new[own] = np.diff(back, prepend=back[0])
    made.state = replace(made.state, levels=replace(made.state.levels, value_in=values, is_new=is_new))
    assert not is_blocked(face[None], post[None], made.blocking, made.blocked_in)[0]


@pytest.mark.parametrize(("level_in", "is_of_it"), [(6.0, True), (-6.0, True), (6.3, False), (-6.3, False)])
def test_a_level_far_from_its_wall_is_of_something_else(
    estimate: MapEstimate, level_in: float, is_of_it: bool
) -> None:
    """The limit is 3.5 standard deviations of 1.75 in; the ranges are those of the level."""
    made = replace(estimate, problem=MapProblem(estimate.problem.trajectory, 16, reflection=Reflection(0.2, 1.75)))
    made.associate()
    echoes, own = made.echoes_of(0), made.state.levels.of(0)
    level = np.full(own.stop - own.start, level_in)
    values = made.state.levels.value_in.copy()
    trajectory = made.problem.trajectory
    closer = made.sides[0] * (level[0] - values[made.assignment.level[echoes]])
    values[own] = level
    readings = trajectory.readings_in.copy()
    readings[echoes] -= closer
    made.problem = made.problem.with_trajectory(replace(trajectory, readings_in=readings))
    made.state = replace(made.state, levels=replace(made.state.levels, value_in=values))
    residual, _, _ = residual_matrix(made.problem, made.state, made.extents, echoes)
    assert np.isfinite(residual[:, 0]).mean() == pytest.approx(float(is_of_it), abs=0.02)


def test_gate_is_as_wide_as_a_level_may_have_changed(estimate: MapEstimate) -> None:
    """Oracle: the conditional variance of a normal pair of correlation exp(-d / length)."""
    problem = MapProblem(estimate.problem.trajectory, 16, reflection=Reflection(0.4, STD_IN, LENGTH_IN))
    levels = Levels(np.array([0, 0]), np.array([0, 1]), np.zeros(2), np.zeros(2), np.zeros(2, dtype=np.bool_))
    level = np.full(len(estimate.assignment.feature), NO_LEVEL)
    C = STD_IN**2 * np.array(((1.0, 1.0 - CHANGES), (1.0 - CHANGES, 1.0)))
    given = C[1, 1] - C[1, 0] ** 2 / C[0, 0]
    found = gate_variances(problem, levels, replace(estimate.assignment, level=level))
    np.testing.assert_allclose(found, (STD_IN**2, given))
    level[:3] = 1
    R = np.square(problem.trajectory.std_in[:3])
    found = gate_variances(problem, levels, replace(estimate.assignment, level=level))
    np.testing.assert_allclose(found, (STD_IN**2, 1.0 / (1.0 / given + (1.0 / R).sum())))


def test_echoes_from_where_a_line_has_no_wall_are_left_out(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the feet of the perpendiculars from the sonars to the line of a wall of which half is none."""
    problem = estimate.problem
    assert trim_surfaces(estimate.copy()) == 0
    reflection = Reflection(problem.reflection.half_cone_rad, STD_IN, LENGTH_IN)
    made = replace(estimate, problem=MapProblem(problem.trajectory, 16, reflection=reflection))
    made.associate()
    pieces = extract_walls(made, with_accuracy=False)
    (piece,) = (piece for piece in pieces if piece.wall == 0)
    half = replace(piece, high=0.5 * (piece.low + piece.high))
    monkeypatch.setattr(revision, "extract_walls", lambda *_, **__: [half])
    echoes, angle = made.echoes_of(0), made.state.walls[0, 0]
    sensors = sensors_at(made.state.poses, made.state.parameters, problem.trajectory, echoes)
    feet = sensors.face @ (-np.sin(angle), np.cos(angle))
    is_left_out = (feet < half.low - 0.5 * LEVEL_CELL_IN) | (feet > half.high + 0.5 * LEVEL_CELL_IN)
    before = made.assignment.feature.copy()
    assert trim_surfaces(made) == is_left_out.sum() > 20
    after = made.assignment.feature
    np.testing.assert_array_equal(after[echoes] == NO_FEATURE, is_left_out)
    # Walls of which there is no piece at all stay as they are, and cells beyond the wall have no levels.
    others = np.setdiff1d(np.arange(len(after)), echoes)
    np.testing.assert_array_equal(after[others], before[others])
    cells = made.state.levels.cell[made.state.levels.of(0)]
    assert LEVEL_CELL_IN * cells.max() <= half.high + 0.5 * LEVEL_CELL_IN
