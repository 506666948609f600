"""Maps from drives: of a room by the tests' own simulation, and of the emulator's recordings end to end."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar, cast

import numpy as np
import pytest

from localization.filters.belief import Floats
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar, building_sonar
from localization.mapping import walls
from localization.mapping.association import MapEstimate
from localization.mapping.features import FRONT, FreeEchoes, _decide, _fit
from localization.mapping.headings import track
from localization.mapping.learn import MapLearner, _cost_by_readings, learn_map
from localization.mapping.measurements import DriveLog
from localization.mapping.merging import _may_be_faces, _merged, _thickness, merge, open_faces, split
from localization.mapping.output import LearnedMap, describe
from localization.mapping.problem import NO_FEATURE, MapProblem, Sensors
from localization.mapping.reflectors import is_blocked, residual_matrix, segments_of
from localization.mapping.revision import drop_hidden, drop_unmeasured
from localization.mapping.walls import end_derivative, extract_walls
from nclient.cli import main
from tests.localization.mapping.drives import ROOM, drive
from worlds.io import format_world, load_world, parse_world
from worlds.robots import N150, load_calibration
from worlds.validate import validate_world

NOISE = OdometryNoise(0.05, 0.05, 0.002)


def learn(log: DriveLog) -> LearnedMap:
    return describe(learn_map(log, NOISE, ConeSonar()))


def distances(found: LearnedMap) -> tuple[float, float]:
    """Return the distances between opposite walls of a rectangular room, along the drive's first leg and across."""
    ends = np.array([wall.ends for wall in found.walls]).mean(axis=1)
    return float(np.ptp(ends[:, 0])), float(np.ptp(ends[:, 1]))


@pytest.fixture(scope="module")
def room(estimate: MapEstimate) -> LearnedMap:
    return describe(estimate)


@pytest.mark.long
def test_room_has_its_four_walls_and_size(room: LearnedMap) -> None:
    assert len(room.walls) == 4
    np.testing.assert_allclose(distances(room), (120.0, 100.0), atol=0.8)
    assert room.reason_to_refuse() == ""
    assert room.quality.explained > 0.95


@pytest.mark.parametrize(("count", "is_point"), [(20, True), (10, False)])
def test_what_may_be_a_wall_or_a_point_is_a_point_at_the_end(count: int, is_point: bool) -> None:
    # From 80 to 60 in before it, within 10 in: a wall and a point differ by 0.2 in at most, a third of the noise.
    rng = np.random.default_rng(3)
    face = np.stack((rng.uniform(-20.0, 0.0, count), np.linspace(-5.0, 5.0, count)), axis=-1)
    target = np.array((60.0, 0.0))
    range_in = np.hypot(*(target - face).T) + 0.6 * rng.standard_normal(count)
    free = FreeEchoes(Sensors(face, np.zeros_like(face), np.zeros(count), range_in), np.full(count, 0.7), rays=False)
    assert _decide(free, target, False)[0] is None
    fit, is_wall, _ = _decide(free, target, False, with_doubtful=True)
    assert not is_wall
    assert (fit is not None) is is_point
    if fit is not None:
        # Across the view a base of 10 in tells little.
        assert (np.abs(fit.feature - target) < (0.5, 10.0)).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_rays_make_the_same_room_however_slanted(seed: int) -> None:
    found = describe(learn_map(drive(seed, rays=True), NOISE, ConeSonar(), rays=True))
    np.testing.assert_allclose([wall.length_in for wall in found.walls], [120.0, 120.0, 100.0, 100.0], atol=0.5)
    # 7 % of the rays meet their wall at more than 60 degrees off its normal.
    assert found.quality.explained > 0.98
    assert not found.reason_to_refuse()


def test_rays_to_another_wall_do_not_lengthen_one_in_its_line() -> None:
    found = learn_map(drive(0, rays=True), NOISE, ConeSonar(), rays=True)
    # 1. A wall that ends 10 in before the wall at x = 95, at the height where most rays fit both.
    number, extent = len(found.state.walls), np.array((-85.0, -70.0))
    trials = []
    for height in range(-15, 66):
        trial = found.copy()
        trial.add_wall(np.array((np.pi / 2.0, float(height))), extent)
        residual, _, spots = residual_matrix(trial.problem, trial.state, trial.extents, trial.echoes())
        at_east = (np.abs(spots[:, number, 0] - 95.0) < 3.0) & (np.abs(residual[:, :number]) < 2.0).any(axis=1)
        trials.append((trial, np.flatnonzero(at_east & (np.abs(residual[:, number]) < 2.0))))
    found, both = max(trials, key=lambda each: len(each[1]))
    assert len(both) > 3
    # 2. These rays are assigned to it.
    feature = found.assignment.feature.copy()
    feature[both] = number
    found.assignment = replace(found.assignment, feature=feature)
    found.measure_extents()
    np.testing.assert_array_equal(found.extents[number], extent)


def test_paths_pass_a_line_where_no_spot_was_measured(estimate: MapEstimate) -> None:
    found = estimate.copy()
    wall = int((found.extents[:, 1] - found.extents[:, 0]).argmax())
    low, high = found.extents[wall]
    # 1. A wall of more than 90 in, without the echoes of its middle 30 in.
    angle, offset = found.state.walls[wall]
    normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    echoes = found.echoes_of(wall)
    _, _, spots = residual_matrix(found.problem, found.state, found.extents, echoes)
    middle = np.abs(spots[:, wall] @ along - 0.5 * (low + high)) < 15.0
    feature = found.assignment.feature.copy()
    feature[echoes[middle]] = NO_FEATURE
    found.assignment = replace(found.assignment, feature=feature)
    found.measure_extents()
    np.testing.assert_allclose(found.extents[wall], (low, high), atol=0.01)
    # 2. Paths across it at its middle, and at both halves.
    places = np.array((0.5, 0.2, 0.8)) * (high - low) + low
    spots = normal * offset + places[:, None] * along
    starts, ends = spots - 10.0 * normal, spots + 10.0 * normal
    assert is_blocked(starts, ends, found.blocking).tolist() == [False, True, True]
    assert is_blocked(starts, ends, estimate.blocking).all()


def test_wall_far_from_the_origin_is_fitted_from_its_peak() -> None:
    # Rays from 20 in before the wall x = 60, to its spots at y = 75 to 100, exactly.
    spots = np.linspace(75.0, 100.0, 30)
    faces = np.stack((np.full(30, 40.0), 0.8 * spots + 15.0), axis=-1)
    off = np.stack((np.full(30, 60.0), spots), axis=-1) - faces
    sensors = Sensors(faces, np.zeros((30, 2)), np.arctan2(off[:, 1], off[:, 0]), np.hypot(off[:, 0], off[:, 1]))
    for degrees_off in (-1.0, 1.0):
        # The line of a cell, 1 degree off, passes the middle of the spots.
        angle = np.radians(degrees_off)
        start = np.array((angle, 60.0 * np.cos(angle) + 87.5 * np.sin(angle)))
        fit = _fit(FreeEchoes(sensors, np.full(30, 0.5), rays=True), start, True)
        np.testing.assert_allclose(fit.feature, (0.0, 60.0), atol=1e-3)
        assert fit.supports.all()


@pytest.mark.parametrize(("before_in", "aside_in", "cut_in"), [
    ((5.0,), 0.0, 5.0),
    ((5.0, 2.0), 0.0, 2.0),  # the outermost one
    ((10.0,), 0.0, 0.0),  # too far from the end: another wall meets this one there
    ((5.0,), 3.0, 0.0),  # not on the line
])  # fmt: skip
def test_wall_ends_at_a_point_near_its_end(
    estimate: MapEstimate, before_in: tuple[float, ...], aside_in: float, cut_in: float
) -> None:
    found = estimate.copy()
    found.state = replace(found.state, points=np.zeros((0, 2)))
    found.measure_extents()
    wall = int((found.extents[:, 1] - found.extents[:, 0]).argmax())
    low, high = found.extents[wall]
    angle, offset = found.state.walls[wall]
    normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    for distance in before_in:
        found.add_point((offset + aside_in) * normal + (high - distance) * along)
    found.measure_extents()
    np.testing.assert_allclose(found.extents[wall], (low, high - cut_in), atol=1e-6)
    # What is measured past its end is not hidden.
    path = (high - 3.0) * along + offset * normal
    assert is_blocked((path - 10.0 * normal)[None], (path + 10.0 * normal)[None], found.blocking)[0] == (cut_in == 0.0)


def test_wall_behind_another_one_is_removed(estimate: MapEstimate) -> None:
    # Sound that came late, as if from 15 in beyond a wall, and sound of a wall 15 in before it.
    for beyond_in, dropped in ((15.0, 1), (-15.0, 0)):
        found = estimate.copy()
        angle, offset = found.state.walls[0]
        walls, echoes = len(found.state.walls), found.echoes_of(0)
        found.add_wall(np.array((angle, offset + beyond_in)), found.extents[0])
        feature = found.assignment.feature.copy()
        feature[echoes[::3]] = walls
        found.assignment = replace(found.assignment, feature=feature)
        assert drop_hidden(found) == dropped
        assert len(found.state.walls) == walls + 1 - dropped
    np.testing.assert_array_equal(found.state.walls[:walls], estimate.state.walls)
    assert drop_hidden(estimate.copy()) == 0


@pytest.mark.parametrize(("beyond_in", "dropped"), [(30.0, 1), (9.0, 0), (-15.0, 0)])
def test_point_far_behind_a_wall_is_removed(estimate: MapEstimate, beyond_in: float, dropped: int) -> None:
    """Sound that came late, as if from a point behind the middle of a wall; a niche is less deep."""
    found = estimate.copy()
    (angle, offset), (low, high) = found.state.walls[0], found.extents[0]
    normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    outward = np.sign(offset)
    echoes = found.echoes_of(0)
    found.add_point(normal * (offset + outward * beyond_in) + along * 0.5 * (low + high))
    feature = found.assignment.feature.copy()
    feature[echoes[::3]] = found.state.features - 1
    found.assignment = replace(found.assignment, feature=feature)
    points = len(found.state.points)
    assert drop_hidden(found) == dropped
    assert len(found.state.points) == points - dropped
    assert len(found.state.walls) == len(estimate.state.walls)


@pytest.mark.long
def test_line_along_parts_of_two_walls_becomes_both() -> None:
    # Boxes against the lower wall, 8 and 12 in deep: the wall at y = -25 in the frame of the start is behind them.
    sides = tuple(((x, 0.0), (x + 30.0, 0.0), (x + 30.0, y), (x, y)) for x, y in ((15.0, 8.0), (75.0, 12.0)))
    right = learn_map(drive(0, outlines=(ROOM, *sides), rays=True), NOISE, ConeSonar(), rays=True)
    heights = right.state.walls[:, 1] * np.sin(right.state.walls[:, 0])
    fronts = np.flatnonzero((heights > -18.5) & (heights < -11.0)).tolist()
    np.testing.assert_allclose(np.sort(right.state.walls[fronts, 1]), (13.0, 17.0), atol=0.5)
    # Their corners reflect no ray.
    assert not len(right.state.points)
    # 1. One line along both is 4 in off over 60 in.
    wrong = _merged(right, fronts[0], fronts[1])
    assert abs(np.degrees(wrong.state.walls[fronts[0], 0]) + 90.0) > 2.0
    # 2. Split, they are as before, once both maps have converged.
    assert split(wrong) == 1
    for found in (wrong, right, wrong, right):
        found.associate()
        found.optimize(10)
    np.testing.assert_allclose(np.sort(wrong.state.walls[:, 1]), np.sort(right.state.walls[:, 1]), atol=0.05)
    assert split(right) == 0


def test_two_lines_that_share_the_noise_of_one_wall_become_one() -> None:
    found = learn_map(drive(0, rays=True), NOISE, ConeSonar(), rays=True)
    wall = int((found.extents[:, 1] - found.extents[:, 0]).argmax())
    angle, offset = found.state.walls[wall]
    # 1. A second line that crosses the wall at its middle at 1 degree, and takes a third of its echoes.
    along = np.array((-np.sin(angle), np.cos(angle)))
    middle = np.array((np.cos(angle), np.sin(angle))) * offset + along * found.extents[wall].mean()
    other = angle + np.radians(1.0)
    double = found.copy()
    double.add_wall(np.array((other, middle @ (np.cos(other), np.sin(other)))), found.extents[wall])
    for _ in range(3):
        double.associate()
        double.optimize(5)
    # 2. Both together cost less than the wall, as each echo takes the line that its noise suits.
    assert len(double.echoes_of(len(double.state.walls) - 1)) > 50
    assert double.cost < found.cost
    assert merge(double) == 1
    np.testing.assert_allclose(np.sort(double.state.walls[:, 1]), np.sort(found.state.walls[:, 1]), atol=0.05)


def test_corners_of_a_closed_room_are_closed(room: LearnedMap) -> None:
    assert room.open_ends == []
    corners = {tuple(np.round(end, 6)) for wall in room.walls for end in wall.ends}
    assert len(corners) == 4


def test_corners_are_tied_to_both_walls(estimate: MapEstimate) -> None:
    walls, points = estimate.state.walls, estimate.state.points
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    on_line = np.abs(points @ normals.T - walls[:, 1]) < 1.0
    assert on_line.sum() >= 6
    assert sorted(estimate.assignment.ties.tolist()) == np.argwhere(on_line).tolist()


def test_stated_accuracy_covers_the_error(room: LearnedMap) -> None:
    width = sum(wall.std_in**2 for wall in room.walls[:2]) ** 0.5
    assert abs(distances(room)[1] - 100.0) < 4.0 * width
    assert all(0.01 < wall.std_in < 0.5 for wall in room.walls)


def test_corners_state_their_accuracy(room: LearnedMap) -> None:
    for wall in room.walls:
        one, other = wall.end_stds_in
        assert one is not None
        assert other is not None
        error = min(abs(wall.length_in - 120.0), abs(wall.length_in - 100.0))
        assert error < 3.0 * (one + other)
        assert 0.01 < one < 0.6


def test_derivative_of_an_end_agrees_with_differences() -> None:
    walls = np.array([[0.3, 20.0], [1.7, 35.0]])
    points = np.array([[60.0, 80.0]])

    def corner(walls: Floats) -> Floats:
        normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
        place: Floats = np.linalg.solve(normals, walls[:, 1])
        return place

    along = np.array((-np.sin(0.3), np.cos(0.3)))
    derivative = end_derivative(walls, points, 0, corner(walls))
    assert derivative is not None
    for number in range(4):
        step = np.zeros(4)
        step[number] = 1e-6
        change = corner(walls + step.reshape(2, 2)) - corner(walls - step.reshape(2, 2))
        assert derivative[number] == pytest.approx(float(change @ along) / 2e-6, abs=1e-5)
    # An end at a point moves with it, and a free one with nothing.
    at_point = end_derivative(walls, points, 0, points[0])
    assert at_point is not None
    np.testing.assert_allclose(at_point, (0.0, 0.0, 0.0, 0.0, *along))
    assert end_derivative(walls, points, 0, np.array((500.0, 500.0))) is None


def test_a_point_that_is_hardly_known_leaves_the_walls_known(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of some echoes from the same direction, which tell its distance and not where it is across.
    made, echoes = estimate.copy(), estimate.echoes_of(0)[:6]
    spots = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)[2][:, 0]
    made.add_point(spots.mean(axis=0))
    feature = made.assignment.feature.copy()
    feature[echoes] = made.state.features - 1
    made.assignment = replace(made.assignment, feature=feature)
    covariance = made.problem.normal_equations(made.state, made.assignment).border_covariance()
    row = 2 * (made.state.features - 1)
    assert np.sqrt(np.trace(covariance[row : row + 2, row : row + 2])) > 3.0
    known, now = extract_walls(estimate), extract_walls(made)
    np.testing.assert_allclose([wall.std_in for wall in now], [wall.std_in for wall in known], rtol=0.15)
    np.testing.assert_allclose([wall.std_rad for wall in now], [wall.std_rad for wall in known], rtol=0.15)
    # In a fit in which all displacements weigh the same it moves them.
    monkeypatch.setattr(walls, "GAUGE_STEPS", 1)
    assert extract_walls(made)[0].std_rad > 2.0 * known[0].std_rad


def test_the_only_wall_of_a_map_can_be_written(room: LearnedMap) -> None:
    # The best rigid fit leaves nothing of its error.
    alone = replace(room, walls=(replace(room.walls[0], std_in=0.0),))
    written = parse_world(format_world(alone.world("room")), "room.toml", "room")
    (accuracy,) = written.accuracies.values()
    assert 0.0 < accuracy.offset_std_in < 0.001


@pytest.mark.long
def test_same_drive_gives_the_same_file_to_the_bit(room: LearnedMap) -> None:
    again = learn(drive(1))
    assert format_world(again.world("room")) == format_world(room.world("room"))
    assert again.as_json() == room.as_json()


@pytest.mark.long
def test_map_does_not_depend_on_the_encoders_frame(room: LearnedMap) -> None:
    log = drive(1)
    c, s = np.cos(1.1), np.sin(1.1)
    rows = log.encoders.copy()
    rows[:, 1], rows[:, 2] = (
        c * log.encoders[:, 1] - s * log.encoders[:, 2] + 400.0,
        (s * log.encoders[:, 1] + c * log.encoders[:, 2] - 90.0),
    )
    rows[:, 3:] += 1.1
    moved = learn(replace(log, encoders=rows))
    for wall, other in zip(room.walls, moved.walls, strict=True):
        np.testing.assert_allclose(wall.ends, other.ends, atol=0.02)


@pytest.mark.long
def test_offsets_of_the_sonars_are_found(room: LearnedMap) -> None:
    offsets: Floats = np.random.default_rng(7).normal(0.0, 1.0, 16)
    offsets = (offsets - offsets.mean()) / offsets.std()
    found = learn(drive(1, offsets_in=offsets))
    assert len(found.walls) == 4
    np.testing.assert_allclose(distances(found), (120.0, 100.0), atol=1.5)
    # Only differences between sonars: all walls may grow with the mean.
    error = np.array(found.calibration.offsets_in) - offsets
    assert np.std(error - error.mean()) < 0.4
    assert np.std(room.calibration.offsets_in) < 0.35


@pytest.mark.long
def test_faces_of_a_thick_wall_stay_apart() -> None:
    wall = ((36.0, 47.5), (84.0, 47.5), (84.0, 52.5), (36.0, 52.5))
    found = learn(drive(2, outlines=(ROOM, wall)))
    # In the frame of the first pose, (25, 25).
    own = [wall for wall in found.walls if np.abs(wall.ends[:, 1] - 25.0).max() < 8.0]
    faces = sorted(float(wall.ends[:, 1].mean()) for wall in own if wall.length_in > 10.0)
    np.testing.assert_allclose(faces, (22.5, 27.5), atol=0.8)
    # One end, whose corners are both known, closes it at right angles.
    (end,) = (wall for wall in own if wall.length_in <= 10.0)
    np.testing.assert_allclose(end.ends[:, 0], (59.0, 59.0), atol=0.8)
    assert found.reason_to_refuse() == ""


def _with_levels(estimate: MapEstimate) -> MapEstimate:
    """Return the map of the same drive with walls that have levels."""
    reflection = estimate.problem.reflection._replace(surface_std_in=1.75)
    found = replace(estimate, problem=MapProblem(estimate.problem.trajectory, 16, reflection=reflection))
    found.associate()
    found.optimize()
    found.associate()
    return found


def _check_opened(estimate: MapEstimate, number: int) -> None:
    """Check a thin wall with levels as if it had been measured from one side first, and posts behind it were lost."""

    def face_of(whole: MapEstimate) -> MapEstimate:
        face = whole.copy()
        face.sides = np.where(np.arange(len(face.sides)) == number, FRONT, face.sides)
        face.associate()
        assert face.sides[number] == FRONT
        return face

    # Of planes both faces are found.
    assert open_faces(face_of(estimate)) == 0
    whole = _with_levels(estimate)
    face = face_of(whole)
    assert face.cost > whole.cost + 20.0
    assert open_faces(face) == 1
    assert not face.sides[number]
    assert face.cost < whole.cost + 5.0


@pytest.mark.long
@pytest.mark.parametrize(("thickness_in", "lines"), [(1.0, 1), (5.0, 2)])
def test_faces_become_one_wall_where_their_distance_is_known(thickness_in: float, lines: int) -> None:
    low, high = 50.0 - 0.5 * thickness_in, 50.0 + 0.5 * thickness_in
    wall = ((36.0, low), (84.0, low), (84.0, high), (36.0, high))
    estimate = learn_map(drive(2, outlines=(ROOM, wall)), OdometryNoise(0.05, 0.05, 0.002), ConeSonar())
    middles = segments_of(estimate.state.walls, estimate.extents).reshape(-1, 2, 2).mean(axis=1)
    inside = np.flatnonzero(np.abs(middles - (35.0, 25.0)).max(axis=1) < 10.0)
    assert len(inside) == lines
    if lines == 1:
        assert not estimate.sides[inside].any()
        _check_opened(estimate, int(inside[0]))
        return
    assert open_faces(_with_levels(estimate)) == 0
    # The thickness and its deviation: differences of the offsets, and the covariance of all unknowns.
    one, other = inside.tolist()
    information, _ = estimate.problem.normal_equations(estimate.state, estimate.assignment).reduced()
    assert _may_be_faces(estimate, one, other, information)
    assert _may_be_faces(estimate, one, other, None)
    thickness, std_in = _thickness(estimate, one, other, information)
    assert thickness == pytest.approx(thickness_in, abs=0.8)

    def apart(x: Floats) -> float:
        place = middles[inside].mean(axis=0)
        away = [x[2 * k + 1] - place @ (np.cos(x[2 * k]), np.sin(x[2 * k])) for k in (one, other)]
        return float(abs(away[0] - np.sign(np.cos(x[2 * one] - x[2 * other])) * away[1]))

    unknowns = np.concatenate((estimate.state.walls.reshape(-1), np.zeros(len(information) - 2 * len(middles))))
    steps = 1e-6 * np.eye(len(information))
    gradient = np.array([(apart(unknowns + step) - apart(unknowns - step)) / 2e-6 for step in steps])
    assert std_in == pytest.approx(float(gradient @ np.linalg.inv(information) @ gradient) ** 0.5, rel=1e-3)
    # Walls of the room are measured from inside alone.
    assert not any(
        _may_be_faces(estimate, a, b, information)
        for a in range(len(middles)) for b in range(a) if {a, b} != {one, other}
    )  # fmt: skip


def test_stretch_is_tracked_in_a_map_that_stays(estimate: MapEstimate) -> None:
    state, trajectory = estimate.state, estimate.problem.trajectory
    part = trajectory.part(20, 60)
    np.testing.assert_array_equal(part.readings_in, trajectory.readings_in[np.isin(trajectory.node, range(20, 60))])
    found = track(estimate, part, state.poses[20:23], OdometryNoise(0.05, 0.05, 0.002)).state
    assert found.poses.shape == (40, 3)
    np.testing.assert_allclose(found.poses[0], state.poses[20], atol=1e-6)
    np.testing.assert_array_equal(found.walls, state.walls)
    # By the odometry alone it would end several inches off.
    assert np.hypot(*(found.poses - state.poses[20:60])[:, :2].T).max() < 0.5


def test_post_is_a_closed_outline_of_the_file(room: LearnedMap) -> None:
    beside_wall = room.walls[0].ends.mean(axis=0) + 1.0
    driven_over = room.path[len(room.path) // 3, :2] + 3.0
    found = replace(room, points=np.concatenate((room.points, [(30.0, 20.0), (33.0, 20.0), beside_wall, driven_over])))
    (post,) = found.world("room").obstacles
    assert post.corners_in == ((29.5, 19.5), (30.5, 19.5), (30.5, 20.5), (29.5, 20.5))
    assert validate_world(found.world("room"), 9.7) == []


def test_map_that_the_path_crosses_is_refused(room: LearnedMap) -> None:
    (x, y), (x2, y2) = room.path[len(room.path) // 8, :2], room.path[len(room.path) // 8 + 1, :2]
    across = np.array((y - y2, x2 - x)) / np.hypot(x2 - x, y2 - y)
    middle = np.array((0.5 * (x + x2), 0.5 * (y + y2)))
    double = replace(room.walls[0], ends=np.array((middle - 9.0 * across, middle + 9.0 * across)))
    assert "crosses" in replace(room, walls=(*room.walls, double)).reason_to_refuse()
    # A path past its end does not.
    beside = replace(double, ends=np.array((middle - 1.0 * across, middle + 9.0 * across)))
    assert replace(room, walls=(*room.walls, beside)).reason_to_refuse() == ""


@pytest.mark.long
def test_random_readings_make_no_map() -> None:
    log = drive(1)
    rng = np.random.default_rng(3)
    found = learn(replace(log, readings_in=rng.uniform(8.0, 120.0, len(log.readings_in))))
    assert found.reason_to_refuse() != ""


# Recordings of the emulator.


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.log"
    address = f"sim:thesis_room?setup=measured&seed=104&record={path}"
    waypoints = ["60,40", "80,80", "10,80", "10,10", "80,10", "80,40"]
    assert main.main(["localize", address, "--map", "thesis_room", "--waypoints", *waypoints, "--json"]) == 0
    return path


@pytest.mark.long
def test_recorded_drive_becomes_a_map_that_localizes(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, calibration, picture = tmp_path / "room.toml", tmp_path / "calibration.toml", tmp_path / "room.png"
    capsys.readouterr()
    arguments = ["map", "learn", "--from", str(recording), "--out", str(out), "--json"]
    assert main.main([*arguments, "--calibration-out", str(calibration), "--picture", str(picture)]) == 0
    result = json.loads(capsys.readouterr().out)
    # 1. The room of 114.17 in, its start where the robot is now.
    assert [wall["closed"] for wall in result["walls"]] == [[True, True]] * 4
    world = load_world(out)
    np.testing.assert_allclose(np.ptp(world.walls.reshape(-1, 2), axis=0), 114.17, atol=1.5)
    assert world.starts[0].x_in == pytest.approx(result["pose"][0], abs=0.01)
    assert world.accuracies[0].measured_in > 60.0
    assert main.main(["map", "check", str(out)]) == 0
    # 2. The calibration is one that --calibration reads.
    assert load_calibration(calibration, "n150").distance_scale == pytest.approx(1.0, abs=0.03)
    assert picture.stat().st_size > 10_000


@pytest.mark.long
def test_refused_map_is_not_written(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Readings of a cone taken for rays, and odometry declared perfect: walls that explain 53 % of the ranges.
    out = tmp_path / "room.toml"
    arguments = ["--sonars", "rays", "--odometry-noise", "0.0001,0.0001,0.00001"]
    assert main.main(["map", "learn", "--from", str(recording), "--out", str(out), *arguments]) == 4
    assert re.search(r"no map written: its walls explain \d\d% of the ranges", capsys.readouterr().err)
    assert not out.exists()


def test_features_that_nothing_determines_are_dropped(estimate: MapEstimate) -> None:
    found = estimate.copy()
    assert drop_unmeasured(found) == 0
    found.add_wall(np.array((0.3, 400.0)), np.array((-5.0, 5.0)))
    found.add_point(np.array((500.0, 500.0)))
    # Anywhere: no wall is known well enough any more.
    assert not describe(found).walls
    assert drop_unmeasured(found) == 2
    np.testing.assert_array_equal(found.state.walls, estimate.state.walls)
    np.testing.assert_array_equal(found.state.points, estimate.state.points)


class Learner:
    """A learner whose map costs less the more nodes it takes at once, and misfits as stated."""

    made: ClassVar[list[int]] = []
    adopted: ClassVar[list[tuple[float, float]]] = []
    misfit: ClassVar[float] = 0.5
    is_complete = False

    def __init__(self, *_: object, nodes_per_round: int, **__: object) -> None:
        self.estimate = SimpleNamespace(cost=1000.0 / nodes_per_round, misfit=self.misfit)
        self.made.append(nodes_per_round)

    def advance(self) -> None:
        self.is_complete = True

    def finish(self) -> None:
        assert self.is_complete

    def adopt(self, other: Learner) -> None:
        self.adopted.append((self.estimate.cost, other.estimate.cost))


@pytest.mark.parametrize(("sonar", "roughness_in", "misfit", "made", "best"), [
    (ConeSonar(), None, 0.5, [16], 16),
    (ConeSonar(), None, 0.7, [16, 12], 16),  # a poor map
    (building_sonar(N150.ring), None, 0.5, [16, 24], 24),  # walls with levels
    (building_sonar(N150.ring), 0.8, 0.5, [16], 16),  # planes in a building
    (building_sonar(N150.ring), 0.8, 0.9, [16], 16),  # rough ones fit worse, right or not
])  # fmt: skip
def test_a_drive_is_learned_again_where_the_map_is_poor_or_walls_have_levels(
    monkeypatch: pytest.MonkeyPatch, sonar: ConeSonar, roughness_in: float | None, misfit: float, made: list[int],
    best: int,
) -> None:  # fmt: skip
    monkeypatch.setattr("localization.mapping.learn.MapLearner", Learner)
    monkeypatch.setattr("localization.mapping.learn._cost_by_readings", lambda learner: learner.estimate.cost)
    monkeypatch.setattr(Learner, "misfit", misfit)
    squared: list[float] = []
    monkeypatch.setattr("localization.mapping.learn.square_together", lambda estimate: squared.append(estimate.cost))
    Learner.made.clear()
    Learner.adopted.clear()
    assert learn_map(drive(0), NOISE, sonar, roughness_in=roughness_in).cost == 1000.0 / best
    assert Learner.made == made
    # Of two maps the chosen one alone. It takes walls of the other one if it is of walls with levels.
    assert squared == [1000.0 / best] * (len(made) - 1)
    assert Learner.adopted == ([(1000.0 / 24, 1000.0 / 16)] if made == [16, 24] else [])


def test_maps_are_compared_with_the_weights_of_readings_alone(estimate: MapEstimate) -> None:
    made = estimate.copy()
    trajectory = made.problem.trajectory
    made.problem = made.problem.with_trajectory(replace(trajectory, weight=np.ones(len(trajectory.weight))))
    learner = SimpleNamespace(estimate=made, trajectory=made.problem.trajectory)
    before = made.cost
    made.problem = made.problem.with_trajectory(replace(trajectory, weight=np.full(len(trajectory.weight), 0.2)))
    assert made.cost < 0.9 * before
    assert _cost_by_readings(cast("MapLearner", learner)) == before
