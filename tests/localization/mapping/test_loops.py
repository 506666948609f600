"""Long drives: walls that belong together far from where the path bends, and places that were not recognized."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.belief import relative_pose, rotate
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate
from localization.mapping.features import _errors, _matched, close_loops
from localization.mapping.learn import learn_map
from localization.mapping.merging import merge
from localization.mapping.problem import MapProblem
from tests.localization.mapping.drives import LAP, drive

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
    found.sides = np.tile(estimate.sides, 2)
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


TURNED_RAD, MOVED = 0.1, np.array((9.0, -7.0))


@pytest.fixture(scope="module")
def two_laps() -> MapEstimate:
    return learn_map(drive(4, points=LAP + LAP[1:]), OdometryNoise(0.8, 0.1, 0.02), ConeSonar())


def with_unrecognized_lap(estimate: MapEstimate) -> MapEstimate:
    """Return the map with odometry that strays in its middle, and with features of its own for the second lap."""
    found, state = estimate.copy(), estimate.state
    trajectory, walls = estimate.problem.trajectory, len(state.walls)
    middle = len(state.poses) // 2
    # 1. The second lap is moved; the odometry between agrees, over the 10 steps before it.
    poses = state.poses.copy()
    for number in range(middle - 9, len(poses)):
        fraction = min((number - (middle - 10)) / 10.0, 1.0)
        poses[number, :2] = rotate(state.poses[number, :2], np.array(fraction * TURNED_RAD)) + fraction * MOVED
        poses[number, 2] += fraction * TURNED_RAD
    between = slice(middle - 10, middle)
    steps = trajectory.steps.copy()
    steps[between] = relative_pose(poses[:-1], poses[1:])[between]
    # 2. Its features are moved as well.
    angles = state.walls[:, 0] + TURNED_RAD
    offsets = state.walls[:, 1] + np.stack((np.cos(angles), np.sin(angles)), axis=-1) @ MOVED
    extents = estimate.extents + (np.stack((-np.sin(angles), np.cos(angles)), axis=-1) @ MOVED)[:, None]
    points = rotate(state.points, np.full(len(state.points), TURNED_RAD)) + MOVED
    feature = estimate.assignment.feature
    is_second = (feature >= 0) & (trajectory.node >= middle)
    numbers = np.where(feature < walls, feature, feature + walls)  # points come after both sets of walls
    moved = np.where(feature < walls, walls, len(state.points))
    found.problem = MapProblem(replace(trajectory, steps=steps), 16, rays=estimate.problem.rays)
    found.state = replace(
        state, poses=poses, walls=np.concatenate((state.walls, np.stack((angles, offsets), axis=-1))),
        points=np.concatenate((state.points, points)),
    )  # fmt: skip
    found.extents, found.sides = np.concatenate((estimate.extents, extents)), np.tile(estimate.sides, 2)
    found.runs = np.array([(number, *extent) for number, extent in enumerate(found.extents)])
    numbers = np.where(feature < 0, feature, numbers + np.where(is_second, moved, 0))
    found.assignment = replace(estimate.assignment, feature=numbers, ties=np.empty((0, 2), dtype=np.intp))
    return found


def test_a_lap_that_was_not_recognized_is_joined_with_the_first(two_laps: MapEstimate) -> None:
    stray = with_unrecognized_lap(two_laps)
    assert np.hypot(*(stray.state.poses - two_laps.state.poses)[-1, :2]) > 8.0
    before = stray.cost
    assert close_loops(stray) >= 4
    assert stray.cost < before - 100.0
    # Both laps are where they were, but for what the odometry strays by between them.
    off = np.hypot(*(stray.state.poses - two_laps.state.poses)[:, :2].T)
    middle = len(off) // 2
    assert max(off[: middle - 30].max(), off[middle + 12 :].max()) < 0.6
    assert len(stray.state.walls) == len(two_laps.state.walls)
    # What blocks paths is of the walls that are left.
    runs = stray.runs
    stray.measure_extents()
    np.testing.assert_allclose(runs, stray.runs, atol=1.0)


def test_recognized_laps_stay_as_they_are(two_laps: MapEstimate) -> None:
    same = two_laps.copy()
    assert close_loops(same) == 0
    assert same.cost == two_laps.cost


def test_two_places_that_odometry_tells_apart_stay_two(two_laps: MapEstimate) -> None:
    stray = with_unrecognized_lap(two_laps)
    # Encoders that are right to a hundredth: the second lap was at another place that looks alike.
    trajectory = stray.problem.trajectory
    stray.problem = MapProblem(replace(trajectory, step_info=100.0 * trajectory.step_info), 16)
    assert close_loops(stray) == 0


SINCE_RETURN = 60
"""Nodes of the second lap that are known, 30 s: a local map."""


@pytest.fixture(scope="module")
def two_laps_of_rays() -> MapEstimate:
    log = drive(4, points=LAP + LAP[1:], rays=True)
    return learn_map(log, OdometryNoise(0.8, 0.1, 0.02), ConeSonar(), rays=True)


def beginning_of_second_lap(estimate: MapEstimate) -> MapEstimate:
    """Return the map soon after the robot came back, when only the last nodes are not recognized."""
    stray = with_unrecognized_lap(estimate)
    count = len(estimate.state.poses) // 2 + SINCE_RETURN
    inside = stray.problem.trajectory.node < count
    stray.state = replace(stray.state, poses=stray.state.poses[:count])
    stray.assignment = replace(stray.assignment, feature=np.where(inside, stray.assignment.feature, -1))
    return stray


def test_walls_alone_join_a_lap_of_exact_rays(two_laps_of_rays: MapEstimate) -> None:
    stray = beginning_of_second_lap(two_laps_of_rays)
    count = len(stray.state.poses)
    assert len(stray.state.points) == 0
    assert np.hypot(*(stray.state.poses - two_laps_of_rays.state.poses[:count])[-SINCE_RETURN, :2]) > 8.0
    before = stray.cost
    assert close_loops(stray) >= 2
    assert stray.cost < before - 50.0
    off = np.hypot(*(stray.state.poses - two_laps_of_rays.state.poses[:count])[:, :2].T)
    assert max(off[: count - SINCE_RETURN - 30].max(), off[-30:].max()) < 0.6


def test_rays_that_were_recognized_move_nothing(two_laps_of_rays: MapEstimate) -> None:
    same = two_laps_of_rays.copy()
    close_loops(same)
    off = np.hypot(*(same.state.poses - two_laps_of_rays.state.poses)[:, :2].T)
    assert off.max() < 0.2


def test_rays_of_a_place_that_odometry_tells_apart_stay_there(two_laps_of_rays: MapEstimate) -> None:
    stray = beginning_of_second_lap(two_laps_of_rays)
    trajectory = stray.problem.trajectory
    stray.problem = MapProblem(replace(trajectory, step_info=100.0 * trajectory.step_info), 16, rays=True)
    last = stray.state.poses[-1].copy()
    close_loops(stray)
    assert np.hypot(*(stray.state.poses[-1] - last)[:2]) < 2.0


def test_motions_leave_apart_what_their_displacements_say(corridor: MapEstimate) -> None:
    walls, rng = len(corridor.state.walls), np.random.default_rng(4)
    pairs = walls + np.array([[0, 1], [1, 0], [0, 0], [1, 1]])
    middles = rng.uniform(-20.0, 20.0, (corridor.state.features, 2))
    turns, shifts = np.array([0.0, 0.2, -0.3]), np.array([[0.0, 0.0], [3.0, -2.0], [90.0, 0.0]])
    errors = _errors(corridor, pairs, middles, np.zeros((walls, 2, 2)), turns, shifts)
    for row, (turn, shift) in enumerate(zip(turns, shifts, strict=True)):
        R = np.array(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))))
        for column, (old, new) in enumerate(pairs):
            moved = R @ middles[new] + shift
            expected = np.hypot(*(moved - middles[old])) if np.hypot(*(moved - middles[new])) < 60.0 else np.inf
            assert errors[row, column] == pytest.approx(expected)


def test_each_feature_is_matched_once_and_nearest_first() -> None:
    pairs = np.array([[0, 5], [0, 6], [1, 5], [2, 7]])
    found, error = _matched(pairs, np.array([1.0, 0.5, 2.0, 4.5]))
    assert found.tolist() == [[0, 6], [1, 5]]
    assert error == pytest.approx(2.5)
