"""Walls of another map of the same drive are taken where the map costs less with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.belief import rotate
from localization.mapping import learn
from localization.mapping.alternatives import _moved, adopt_walls
from localization.mapping.association import MapEstimate
from localization.mapping.learn import MapLearner

TURN_RAD, SHIFT_IN = 0.02, np.array((1.5, -2.0))


def moved_by(estimate: MapEstimate) -> MapEstimate:
    """Return a map as a whole turned by TURN_RAD about the origin and shifted by SHIFT_IN."""
    state = estimate.state
    walls = state.walls + np.array((TURN_RAD, 0.0))
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    along = np.stack((-normals[:, 1], normals[:, 0]), axis=-1)
    walls[:, 1] += normals @ SHIFT_IN
    xy, points = (
        rotate(places, np.full(len(places), TURN_RAD)) + SHIFT_IN for places in (state.poses[:, :2], state.points)
    )
    poses = np.column_stack((xy, state.poses[:, 2] + TURN_RAD))
    by_in = along @ SHIFT_IN
    runs = estimate.runs.copy()
    runs[:, 1:] += by_in[runs[:, 0].astype(np.intp), None]
    return replace(
        estimate, state=replace(state, poses=poses, walls=walls, points=points),
        extents=estimate.extents + by_in[:, None], runs=runs,
    )  # fmt: skip


@pytest.fixture
def other(estimate: MapEstimate) -> MapEstimate:
    """Return the same map in another frame."""
    return moved_by(estimate)


def test_a_wall_is_moved_as_the_poses_of_its_echoes(estimate: MapEstimate, other: MapEstimate) -> None:
    for wall in range(len(estimate.state.walls)):
        line, extent = _moved(estimate, other, wall, estimate.echoes_of(wall))
        np.testing.assert_allclose(line, estimate.state.walls[wall], atol=1e-9)
        np.testing.assert_allclose(extent, estimate.extents[wall], atol=1e-9)


@pytest.mark.parametrize("wall", [0, 1])
def test_a_wall_that_is_missing_is_taken_from_the_other_map(
    estimate: MapEstimate, other: MapEstimate, wall: int
) -> None:
    found = estimate.copy()
    found.remove(wall)
    found.associate()
    found.optimize()
    found.associate()
    without = found.cost
    assert without > estimate.cost + 100.0
    assert adopt_walls(found, other) == 1
    assert found.cost == pytest.approx(estimate.cost, abs=10.0)
    assert len(found.state.walls) == len(estimate.state.walls)
    # Within 0.6 degrees and 0.2 in: the fitted map is optimized no further than to its last step.
    assert (np.abs(found.state.walls[-1] - estimate.state.walls[wall]) < (0.01, 0.2)).all()
    np.testing.assert_allclose(found.extents[-1], estimate.extents[wall], atol=2.0)


def test_a_wall_in_a_worse_direction_is_replaced_by_that_of_the_other_map(
    estimate: MapEstimate, other: MapEstimate
) -> None:
    found = estimate.copy()
    walls = found.state.walls.copy()
    middle = found.extents[0].mean()
    # Turned by 5 degrees about its middle, with the same echoes: their foot moves along the wall.
    walls[0] = walls[0, 0] + 0.09, walls[0, 1] * np.cos(0.09) + middle * np.sin(0.09)
    found.state = replace(found.state, walls=walls)
    assert found.cost > estimate.cost + 100.0
    assert adopt_walls(found, other) >= 1
    assert found.cost == pytest.approx(estimate.cost, abs=10.0)
    assert np.abs(found.state.walls - estimate.state.walls[0]).sum(axis=1).min() < 0.05


def test_nothing_is_taken_from_a_map_that_is_no_better(estimate: MapEstimate, other: MapEstimate) -> None:
    found = estimate.copy()
    assert adopt_walls(found, other) == 0
    assert found.state is estimate.state
    # Nor a wall of a few echoes.
    poor = other.copy()
    feature = poor.assignment.feature.copy()
    feature[poor.echoes_of(0)[9:]] = -1
    poor.assignment = replace(poor.assignment, feature=feature)
    found.remove(0)
    found.associate()
    assert adopt_walls(found, poor) == 0


def test_a_learner_takes_walls_and_completes_its_map(estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    completed: list[MapEstimate] = []
    monkeypatch.setattr(learn, "trim_surfaces", completed.append)
    best, other = (MapLearner.__new__(MapLearner) for _ in range(2))
    best.estimate, other.estimate = estimate.copy(), estimate.copy()
    best.estimate.remove(1)
    best.adopt(other)
    assert completed == [best.estimate]
    assert len(best.estimate.state.walls) == len(estimate.state.walls)
    # Points are tied to the wall again.
    assert (best.estimate.assignment.ties[:, 1] == len(estimate.state.walls) - 1).any()
    # Of two equal maps none is changed but for the echoes that trimming had left out.
    same = MapLearner.__new__(MapLearner)
    same.estimate = other.estimate.copy()
    before = same.estimate.state.walls
    same.adopt(other)
    assert same.estimate.state.walls is before
    assert len(completed) == 2


def test_a_wall_that_is_one_with_another_is_merged_with_it(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    def doubled(taken: MapEstimate, _: MapEstimate) -> int:
        # Every second echo of a wall is of one beside it.
        feature = taken.assignment.feature.copy()
        feature[taken.echoes_of(0)[::2]] = len(taken.state.walls)
        feature[taken.assignment.feature >= len(taken.state.walls)] += 1
        taken.add_wall(taken.state.walls[0] + (0.0, 0.4), taken.extents[0])
        taken.assignment = replace(taken.assignment, feature=feature)
        return 1

    monkeypatch.setattr(learn, "adopt_walls", doubled)
    best, other = (MapLearner.__new__(MapLearner) for _ in range(2))
    best.estimate, other.estimate = estimate.copy(), estimate.copy()
    best.adopt(other)
    assert len(best.estimate.state.walls) == len(estimate.state.walls)
    assert best.estimate.cost == pytest.approx(estimate.cost, abs=10.0)
