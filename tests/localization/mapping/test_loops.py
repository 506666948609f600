"""Long drives: walls that belong together far from where the path bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate
from localization.mapping.learn import learn_map, merge
from localization.mapping.measurements import rotate
from localization.mapping.problem import MapProblem
from tests.localization.mapping.drives import drive

CORRIDOR = ((0.0, 0.0), (400.0, 0.0), (400.0, 80.0), (0.0, 80.0))
THERE = ((30.0, 40.0), (370.0, 40.0))
BEND_RAD = 0.12


@pytest.fixture(scope="module")
def corridor() -> MapEstimate:
    return learn_map(drive(3, outlines=(CORRIDOR,), points=THERE), OdometryNoise(0.05, 0.05, 0.005), ConeSonar())


def bent(estimate: MapEstimate) -> MapEstimate:
    """Return the map, without points, with odometry that bends in the middle, and walls of its own behind it."""
    found = estimate.copy()
    for number in reversed(range(len(estimate.state.walls), estimate.state.features)):
        found.remove(number)
    state, trajectory = found.state, estimate.problem.trajectory
    walls, middle = len(state.walls), len(state.poses) // 2
    # 1. Ten steps of odometry turn; the path follows it.
    steps = trajectory.steps.copy()
    steps[middle - 5 : middle + 5, 2] += BEND_RAD / 10.0
    turns = np.clip((np.arange(len(state.poses)) - (middle - 5)) / 10.0, 0.0, 1.0) * BEND_RAD
    moves = rotate(np.diff(state.poses[:, :2], axis=0), turns[:-1])
    places = state.poses[0, :2] + np.concatenate((np.zeros((1, 2)), np.cumsum(moves, axis=0)))
    poses = np.concatenate((places, state.poses[:, 2:] + turns[:, None]), axis=1)
    # 2. Turned walls, n . p = offset about the middle; their echoes are those behind it.
    normals = np.stack((np.cos(state.walls[:, 0]), np.sin(state.walls[:, 0])), axis=-1)
    offsets = state.walls[:, 1] - normals @ state.poses[middle, :2]
    lines = np.stack((state.walls[:, 0] + BEND_RAD, offsets), axis=-1)
    lines[:, 1] += rotate(normals, np.full(walls, BEND_RAD)) @ poses[middle, :2]
    feature = found.assignment.feature
    is_behind = (feature >= 0) & (trajectory.node >= middle)
    found.problem = MapProblem(replace(trajectory, steps=steps), 16)
    found.state = replace(state, poses=poses, walls=np.concatenate((state.walls, lines)))
    found.assignment = replace(found.assignment, feature=np.where(is_behind, feature + walls, feature))
    found.extents = np.concatenate((estimate.extents, estimate.extents))
    found.measure_extents()
    return found


def heading_change(estimate: MapEstimate) -> float:
    """Return the turn of the path between its quarters, which is straight."""
    poses = estimate.state.poses[:, :2]
    quarters = [poses[k] for k in np.linspace(2, len(poses) - 3, 5).astype(int)]
    first, last = quarters[1] - quarters[0], quarters[4] - quarters[3]
    return float(np.arctan2(last[1], last[0]) - np.arctan2(first[1], first[0]))


def test_bent_corridor_becomes_straight(corridor: MapEstimate) -> None:
    broken = bent(corridor)
    broken.optimize()
    assert abs(heading_change(broken) - heading_change(corridor)) > 0.6 * BEND_RAD
    assert merge(broken) >= 2
    assert abs(heading_change(broken) - heading_change(corridor)) < 0.01
