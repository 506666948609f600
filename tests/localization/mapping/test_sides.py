"""Faces of walls, inner corners, right angles, and doors that the robot has passed."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from localization.filters.belief import Floats, rotate
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping import association
from localization.mapping.association import MapEstimate, _hidden_points, _inner_feet, _runs, assign
from localization.mapping.consistency import compare_returns, late_scores
from localization.mapping.live import LiveMapper, walls_and_posts
from localization.mapping.measurements import DriveCollector
from localization.mapping.problem import (
    NO_FEATURE,
    NO_LEVEL,
    PARAMETER_STDS,
    RIGHT_ANGLE_STD_RAD,
    ROBUST_LIMIT,
    Assignment,
    Levels,
    MapProblem,
    Reflection,
    Sensors,
    robust_cost,
    robust_weight,
    sensors_at,
)
from localization.mapping.reflectors import Mask, ends_of_parts, growth_of, parts_of, sides_of
from localization.mapping.revision import part_late_points, part_points
from localization.mapping.surfaces import divided


def test_walls_of_a_room_are_measured_from_inside(estimate: MapEstimate) -> None:
    # By the first pose, which is inside as all others are.
    normals = np.stack((np.cos(estimate.state.walls[:, 0]), np.sin(estimate.state.walls[:, 0])), axis=-1)
    inside = np.sign(normals @ estimate.state.poses[0, :2] - estimate.state.walls[:, 1])
    np.testing.assert_array_equal(estimate.sides, inside)


def test_nothing_is_assigned_to_a_face_from_its_back(estimate: MapEstimate) -> None:
    turned, echoes = estimate.copy(), estimate.echoes()
    walls = len(estimate.state.walls)
    assert (assign(estimate, echoes)[0] < walls).sum() > 200
    turned.sides = -estimate.sides
    feature, cost = assign(turned, echoes)
    assert not ((feature != NO_FEATURE) & (feature < walls)).any()
    np.testing.assert_array_equal(cost[feature == NO_FEATURE], ROBUST_LIMIT**2)
    # Of a wall that was measured from both sides both count.
    turned.sides = 0.0 * estimate.sides
    np.testing.assert_array_equal(assign(turned, echoes)[0], assign(estimate, echoes)[0])


def test_walls_that_face_a_place_were_measured_from_its_side(estimate: MapEstimate) -> None:
    # The room has four walls; beyond the first one there is only its back.
    inside = estimate.state.poses[0, :2]
    np.testing.assert_array_equal(walls_and_posts(estimate, inside), walls_and_posts(estimate))
    angle, offset = estimate.state.walls[0]
    normal = np.array((np.cos(angle), np.sin(angle)))
    beyond = inside + 2.0 * (offset - normal @ inside) * normal
    found, everything = walls_and_posts(estimate, beyond), walls_and_posts(estimate)
    of_first = int((estimate.runs[:, 0] == 0).sum())
    assert len(found) == len(everything) - of_first
    assert of_first == 1
    noise = OdometryNoise(0.05, 0.05, 0.002)
    mapper = LiveMapper(DriveCollector("n150"), noise, ConeSonar(), rays=False, roughness_in=0.0)
    assert not len(mapper.walls_facing(inside))
    mapper.estimate = estimate
    np.testing.assert_array_equal(mapper.walls_facing(beyond), found)
    # Unless it was measured from both sides, or is not known in part.
    both = estimate.copy()
    both.sides = 0.0 * estimate.sides
    np.testing.assert_array_equal(walls_and_posts(both, beyond), everything)
    whole = estimate.copy()
    whole.runs = estimate.runs[:0]
    assert len(walls_and_posts(whole, beyond)) == len(walls_and_posts(whole, inside)) - 1


def hidden_from(place: tuple[float, float], made: MapEstimate, turn: float = 0.0) -> set[tuple[int, int]]:
    """Return the pairs of a point and a face that hides it from a place, which is turned, in a made-up map."""
    places = rotate(np.array([place]), np.array([turn]))
    hidden = _hidden_points(made)
    is_back = sides_of(places, made.state.walls) * made.sides < 0.0
    hides = hidden.hides(places, is_back, made.state.walls)[0]
    return set(zip(hidden.points[hides].tolist(), hidden.faces[hides].tolist(), strict=True))


def made_map(like: MapEstimate, walls: Floats, extents: Floats, sides: Floats, points: Floats) -> MapEstimate:
    """Return a map of walls (w, 2), measured along all of their extents, and points."""
    made = like.copy()
    made.state = replace(like.state, walls=walls, points=points)
    made.extents, made.sides = extents, sides
    made.runs = np.column_stack((np.arange(len(walls)), extents))
    return made


@pytest.mark.parametrize(("other", "hides"), [
    ((0.0, 50.0), False),  # behind the face: the corner of a table, seen from beside it
    ((-50.0, 0.0), True),  # in front of it: the corner of a room
    ((-50.0, 50.0), True),  # on both sides: the corners of two rooms, on one wall
    ((-50.0, -20.0), False),  # another wall, which ends before it
])  # fmt: skip
@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_corner_of_a_room_is_hidden_by_its_walls(
    estimate: MapEstimate, other: tuple[float, float], hides: bool, turn: float
) -> None:
    # The face x = 0 from y = 0 upwards, measured from x < 0, and a wall along y = 0; all turned.
    walls = np.array([(turn, 0.0), (turn - 0.5 * np.pi, 0.0)])
    extents = np.array([(0.0, 40.0), other])
    made = made_map(estimate, walls, extents, np.array([-1.0, 0.0]), np.zeros((1, 2)))
    assert ((0, 0) in hidden_from((10.0, -20.0), made, turn)) is hides
    # Beside the wall as beyond it: it may be too thin to have two edges. Never from in front of it.
    assert ((0, 0) in hidden_from((10.0, 20.0), made, turn)) is hides
    assert (0, 0) not in hidden_from((-10.0, 20.0), made, turn)
    # Not where no face is known.
    made.sides = np.zeros(2)
    assert not hidden_from((10.0, -20.0), made, turn) | hidden_from((10.0, 20.0), made, turn)


@pytest.mark.parametrize(("others", "hidden"), [
    ([], set()),  # the end of a face alone: the corner of a box, seen from beside it
    ([130.0], {100.0, 130.0}),  # both edges of a door
    ([50.0], {50.0}),  # on the face
    ([-30.0], {-30.0}),  # in its plane, across a door from where it begins, which is no point
    ([150.0], set()),  # too far away
])  # fmt: skip
@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_edges_in_the_plane_of_a_face_are_hidden_by_it(
    estimate: MapEstimate, others: list[float], hidden: set[float], turn: float
) -> None:
    # A face of 100 in, which may go on by 40 in, and points along it from its begin at the foot of the origin.
    at = [100.0, *others]
    # One 4.5 in behind it is another edge.
    points = rotate(np.array([*((5.0, t) for t in at), (9.5, 50.0)]), np.full(len(at) + 1, turn))
    made = made_map(estimate, np.array([(turn, 5.0)]), np.array([(0.0, 100.0)]), np.array([-1.0]), points)
    if 50.0 in at:
        points[-1] = 2.0 * points[0]  # not behind this one
        made.state = replace(made.state, points=points)
    for place in ((30.0, 115.0), (30.0, -15.0), (30.0, 60.0)):
        assert {at[point] for point, _ in hidden_from(place, made, turn)} == hidden
    assert not hidden_from((-30.0, 115.0), made, turn)
    # A wall that was measured from both sides hides nothing.
    made.sides = np.zeros(1)
    assert not hidden_from((30.0, 115.0), made, turn)


@pytest.mark.parametrize("turn", [0.0, 2.5])
def test_edge_of_a_door_is_seen_past_the_other_edge_of_its_wall(estimate: MapEstimate, turn: float) -> None:
    # A wall from x = 0 to 5 that ends at y = 100, of which the face x = 0 was measured, and the other post of the door.
    points = rotate(np.array([(0.0, 100.0), (0.0, 136.0)]), np.full(2, turn))
    walls, extents = np.array([(turn, 0.0)]), np.array([(0.0, 100.0)])
    made = made_map(estimate, walls, extents, np.array([-1.0]), points)
    # 1. While nothing else is known, what is measured from behind may be the other edge, 5 in nearer.
    assert hidden_from((30.0, 118.0), made, turn) == {(0, 0), (1, 0)}
    # 2. With the other edges both posts are seen from behind the door.
    others = rotate(np.array([(5.0, 100.0), (5.0, 136.0)]), np.full(2, turn))
    made.state = replace(made.state, points=np.concatenate((points, others)))
    assert not hidden_from((30.0, 118.0), made, turn)
    # 3. Each is hidden by its own wall.
    assert hidden_from((30.0, 80.0), made, turn) == {(0, 0)}
    assert hidden_from((30.0, 150.0), made, turn) == {(1, 0)}
    # 4. All the same where the face was measured on both sides of the door.
    made.extents, made.runs = np.array([(0.0, 236.0)]), np.array([(0.0, 0.0, 100.0), (0.0, 136.0, 236.0)])
    assert not hidden_from((30.0, 118.0), made, turn)
    assert hidden_from((30.0, 80.0), made, turn) == {(0, 0)}
    # There the robot has come to the door along the wall, and needs its edges to pass it.
    made.state = replace(made.state, points=points)
    assert not hidden_from((30.0, 118.0), made, turn)


@pytest.mark.parametrize("turn", [0.0, 1.3])
def test_the_first_echo_is_that_of_the_wall_not_of_the_corner_behind(estimate: MapEstimate, turn: float) -> None:
    # Beside a wall at 60 in, 11 in before its end: the end is at 61 in, 10.4 degrees off the axis.
    points = rotate(np.array([(60.0, 41.0)]), np.array([turn]))
    made = made_map(estimate, np.array([(turn, 60.0)]), np.array([(-40.0, 40.0)]), np.zeros(1), points)
    made.expects_first_echoes = True
    std_in = float(estimate.problem.trajectory.std_in[0])

    def features(readings: Floats) -> list[int]:
        places = rotate(np.tile((0.0, 30.0), (len(readings), 1)), np.full(len(readings), turn))
        sonars = Sensors(places, np.zeros_like(places), np.full(len(readings), turn), readings)
        found: list[int] = assign(made, np.zeros(len(readings), dtype=np.intp), sonars)[0].tolist()
        return found

    # 1. An echo nearer to the range of the end is the wall's all the same, until it is far off.
    far_in = 60.0 + 2.6 * std_in
    assert features(np.array((60.0, 60.0 + 0.9 * std_in, far_in))) == [0, 0, 1]
    # 2. So the echoes of the wall keep their mean, within 4 standard deviations of it.
    readings = 60.0 + std_in * np.random.default_rng(1).standard_normal(4000)
    of_wall = readings[np.array(features(readings)) == 0]
    assert abs(of_wall.mean() - 60.0) < 4.0 * std_in / 4000**0.5
    # 3. Where the wall was not measured it need not have returned one, nor while the map grows.
    made.runs = np.array([(0.0, -40.0, 37.0)])
    assert features(np.array((60.0, 60.0 + 0.9 * std_in))) == [0, 1]
    made.runs, made.expects_first_echoes = np.array([(0.0, -40.0, 40.0)]), False
    assert features(np.array((60.0, 60.0 + 0.9 * std_in))) == [0, 1]


def test_ends_of_parts_are_where_walls_begin_and_end() -> None:
    # A wall with a gap from 40 to 80, one without runs, and points along both.
    runs, extents = np.array([(0.0, 0.0, 40.0), (0.0, 80.0, 120.0)]), np.array([(0.0, 120.0), (10.0, 15.0)])
    along = np.array((-30.0, -5.0, 3.0, 20.0, 38.0, 45.0, 60.0, 79.0, 100.0, 119.0))
    parts = parts_of(runs, extents)
    found = ends_of_parts(parts, np.stack((along, along), axis=-1))
    np.testing.assert_array_equal(found.side[:, 0], (0, 1, 1, 0, -1, -1, 0, 1, 0, -1))
    np.testing.assert_array_equal(np.flatnonzero(found.is_within[:, 0]), (3, 8))
    # In a gap of 25 in each point belongs to the nearer part, wherever this stands in the list.
    narrow = np.array([(0.0, 0.0, 100.0), (0.0, 125.0, 200.0)])
    for both in (narrow, narrow[::-1]):
        sides = ends_of_parts(both, np.array([[106.0], [107.0], [120.0]])).side[:, 0]
        np.testing.assert_array_equal(sides, (-1, -1, 1))
    # Of a short one each half belongs to its nearer end.
    near = np.array((9.0, 12.0, 13.0, 16.0))
    np.testing.assert_array_equal(ends_of_parts(parts, np.stack((near, near), axis=-1)).side[:, 1], (1, 1, -1, -1))


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_an_edge_between_two_faces_is_on_the_nearer_one(estimate: MapEstimate, turn: float) -> None:
    # The faces x = 0, measured from x < 0, and x = 3.7, from x > 0, and points at x = 0.8 and 2.9 between both.
    walls, extents = np.array([(turn, 0.0), (turn, 3.7)]), np.array([(0.0, 100.0), (0.0, 100.0)])
    points = rotate(np.array([(0.8, 50.0), (2.9, 50.0)]), np.full(2, turn))
    behind = {place: made_map(estimate, walls, extents, np.array([-1.0, 1.0]), points) for place in (-30.0, 30.0)}
    found = set().union(*(hidden_from((x, 50.0), made, turn) for x, made in behind.items()))
    assert found == {(0, 0), (1, 1)}
    # Two faces that are measured from the same side hide both.
    same = made_map(estimate, walls, extents, np.array([-1.0, -1.0]), points)
    assert hidden_from((30.0, 50.0), same, turn) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    # Turned by half a turn it is the same line, with the other side.
    turned = walls * (1.0, -1.0) + np.array([(np.pi, 0.0), (np.pi, 0.0)])
    back = np.array([(-100.0, 0.0), (-100.0, 0.0)])
    made = made_map(estimate, turned, back, np.array([1.0, -1.0]), points)
    assert hidden_from((-30.0, 50.0), made, turn) | hidden_from((30.0, 50.0), made, turn) == {(0, 0), (1, 1)}


def every(feet: Floats) -> Mask:
    """Return that all spots are of the wall alone."""
    return np.ones(len(feet), dtype=np.bool_)


def test_echoes_of_a_wall_that_may_be_of_a_point_are_told(estimate: MapEstimate) -> None:
    made, echoes = estimate.copy(), estimate.echoes_of(0)
    feet, _, is_alone = made._feet_and_sides(0, echoes)
    assert is_alone.all()
    # A point on the line: where the first of them was reflected.
    angle, offset = estimate.state.walls[0]
    c, s = np.cos(angle), np.sin(angle)
    point = np.array((c * offset - s * feet[0], s * offset + c * feet[0]))
    made.add_point(point)
    _, _, is_alone = made._feet_and_sides(0, echoes)
    assert not is_alone[0]
    # Oracle: the distance of each sonar from it.
    sensors = sensors_at(estimate.state.poses, estimate.state.parameters, estimate.problem.trajectory, echoes)
    off = np.abs(np.hypot(*(point - sensors.face).T) - sensors.range_in) / estimate.problem.trajectory.std_in[echoes]
    np.testing.assert_array_equal(is_alone, off >= 1.5)


def test_path_opens_the_wall_that_it_crosses() -> None:
    feet = np.linspace(0.0, 100.0, 101)
    found = _runs(3, feet, every(feet), np.zeros(0), np.array([50.0]), 9.0)
    np.testing.assert_allclose(found, [(3, 0.0, 40.0), (3, 60.0, 100.0)])
    np.testing.assert_allclose(_runs(3, feet, every(feet), np.zeros(0), np.zeros(0), 9.0), [(3, 0.0, 100.0)])
    # Also where the nearest spots are farther from it than the robot is wide.
    apart = np.concatenate((np.linspace(0.0, 40.0, 9), np.linspace(58.0, 100.0, 9)))
    assert len(_runs(3, apart, every(apart), np.zeros(0), np.array([50.0]), 5.0)) == 2
    assert len(_runs(3, apart, every(apart), np.zeros(0), np.zeros(0), 5.0)) == 1


@pytest.mark.parametrize(("middle", "is_open"), [
    ([], True),
    ([50.0, 51.0], True),  # two mistaken spots
    ([45.0, 50.0, 55.0], False),
])  # fmt: skip
def test_spots_beside_the_posts_of_a_door_do_not_close_it(middle: list[float], is_open: bool) -> None:
    # A door from 30 to 67 in; echoes of its posts were taken for the wall up to 8 in inside of it, 21 in apart.
    feet = np.sort(np.concatenate((np.linspace(0.0, 38.0, 20), np.linspace(59.0, 100.0, 20), middle)))
    nowhere = np.zeros(0)
    found = _runs(3, feet, every(feet), np.array([30.0, 67.0]), nowhere, 9.0)
    assert (len(found) == 2) is is_open
    # Nor do any whose ranges fit the posts as well.
    of_wall = (feet < 40.0) | (feet > 57.0)
    assert len(_runs(3, feet, of_wall, np.array([30.0, 67.0]), nowhere, 9.0)) == 2
    if is_open:
        assert found[0, 2] <= 30.0
        assert found[1, 1] >= 67.0
    # Nor a pier of 21 in between two doors, whose spots are 3 in apart.
    pier = np.arange(60.0, 82.0, 3.0)
    np.testing.assert_allclose(_runs(3, pier, every(pier), np.array([60.0, 81.0]), nowhere, 9.0), [(3, 60.0, 81.0)])
    # Posts farther apart than those of a door, or nearer than the robot is wide, open nothing.
    narrow = np.sort(np.concatenate((np.linspace(0.0, 38.0, 20), np.linspace(48.0, 100.0, 20))))
    assert len(_runs(3, narrow, every(narrow), np.array([35.0, 50.0]), nowhere, 9.0)) == 1
    assert len(_runs(3, narrow, every(narrow), np.array([0.0, 100.0]), nowhere, 9.0)) == 1


@pytest.mark.parametrize(("feet", "points", "left"), [
    ([51.0, 52.0, 69.0, 70.0, 75.0, 80.0, 84.0], [69.6], [69.0, 70.0, 75.0, 80.0, 84.0]),
    ([69.0, 70.0, 75.0, 80.0, 99.0], [84.0, 120.0], [69.0, 70.0, 75.0, 80.0]),
    ([51.0, 69.0, 70.0, 75.0, 80.0, 99.0], [69.0, 81.0], [69.0, 70.0, 75.0, 80.0]),
    ([51.0, 52.0, 69.0, 70.0, 75.0, 80.0], [30.0], None),  # no post between them
    ([51.0, 62.0, 69.0, 70.0, 75.0, 80.0], [69.6], None),  # no gap
    ([51.0, 52.0, 53.0, 69.0, 70.0, 75.0, 80.0], [69.6], None),  # more than two
    ([51.0, 69.0, 70.0, 75.0], [69.6], None),  # too few would be left
    ([51.0, 69.0, 70.0, 75.0, 99.0], [69.6, 81.0], None),
])  # fmt: skip
def test_feet_alone_beyond_a_post_are_left_out(
    feet: list[float], points: list[float], left: list[float] | None
) -> None:
    found = _inner_feet(np.array(feet), np.array(points))
    assert feet[found] == (left or feet)


def test_posts_measured_from_both_sides_make_a_wall_thin(estimate: MapEstimate) -> None:
    reflection = Reflection(half_cone_rad=radians(25.0), surface_std_in=1.75, surface_length_in=24.0)
    sensors = sensors_at(estimate.state.poses, estimate.state.parameters, estimate.problem.trajectory, slice(None))
    left, right = (np.flatnonzero(side)[:4] for side in (sensors.face[:, 0] < 20.0, sensors.face[:, 0] > 50.0))
    for y, count, is_thin in ((25.0, 4, True), (25.0, 3, False), (-20.0, 4, False)):
        # A wall through the middle of the room, with a post on it, or near its end.
        made = estimate.copy()
        made.problem = MapProblem(made.problem.trajectory, 16, parameter_stds=PARAMETER_STDS, reflection=reflection)
        wall = len(made.state.walls)
        made.add_wall(np.array((0.0, 35.0)), np.array((-25.0, 75.0)))
        made.add_point(np.array((36.0, y)))
        feature = made.assignment.feature.copy()
        feature[np.concatenate((left, right[:count]))] = made.state.features - 1
        made.assignment = replace(made.assignment, feature=feature)
        assert made._is_thin(wall, -np.ones(6)) is is_thin
        # Echoes of the wall itself count as well.
        assert made._is_thin(wall, np.array((-1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0)))
        # The edge of a door in a face is the end of a part of it.
        made.runs = np.concatenate((made.runs[made.runs[:, 0] != wall], [(wall, -25.0, y + 1.0), (wall, 52.0, 75.0)]))
        assert not made._is_thin(wall, -np.ones(6))


def test_removal_leaves_the_levels_of_other_walls_to_their_echoes(estimate: MapEstimate) -> None:
    found = estimate.copy()
    reflection = Reflection(half_cone_rad=radians(12.5), surface_std_in=1.75)
    found.problem = MapProblem(found.problem.trajectory, 16, parameter_stds=PARAMETER_STDS, reflection=reflection)
    found.associate()

    def cells(made: MapEstimate) -> list[tuple[float, int] | None]:
        """Angle of the wall and cell of the level of each echo."""
        levels = made.state.levels
        return [
            None if row == NO_LEVEL else (float(made.state.walls[levels.wall[row], 0]), int(levels.cell[row]))
            for row in made.assignment.level.tolist()
        ]  # fmt: skip

    before = cells(found)
    for number in range(found.state.features):
        without = found.copy()
        without.remove(number)
        expected = [None if feature == number else cell
                    for feature, cell in zip(found.assignment.feature.tolist(), before, strict=True)]  # fmt: skip
        assert cells(without) == expected


def test_levels_are_measured_anew_where_something_has_changed(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, calls = estimate.copy(), list[int]()
    reflection = Reflection(half_cone_rad=radians(12.5), surface_std_in=1.75)
    found.problem = MapProblem(found.problem.trajectory, 16, parameter_stds=PARAMETER_STDS, reflection=reflection)
    found.associate()

    def counted(problem: MapProblem, *given: Any) -> Levels:
        calls.append(1)
        return divided(problem, *given)

    monkeypatch.setattr(association, "divided", counted)
    found.measure_levels()
    found.assignment = replace(found.assignment, ties=found.assignment.ties.copy())
    found.copy().measure_levels()
    assert not calls
    for name, value in (
        ("state", replace(found.state, poses=found.state.poses + 0.1)),
        ("assignment", replace(found.assignment, feature=found.assignment.feature.copy())),
        ("problem", found.problem.with_trajectory(found.problem.trajectory)),
    ):
        calls.clear()
        setattr(found, name, value)
        found.measure_levels()
        assert calls == [1]


def test_crossings_of_the_path_are_where_it_meets_the_line(estimate: MapEstimate) -> None:
    made = estimate.copy()
    poses = np.array([(0.0, 0.0, 0.0), (10.0, 4.0, 0.0), (20.0, 4.0, 0.0), (30.0, -6.0, 0.0)])
    made.state = replace(estimate.state, poses=poses, walls=np.array([(0.5 * np.pi, 2.0), (0.0, 100.0)]))
    # The line y = 2 runs towards -x: met at x = 5 and 22; nothing meets x = 100.
    crossed, none = made._passed_at()
    np.testing.assert_allclose(sorted(crossed), [-22.0, -5.0])
    assert not len(none)


def angle_cost(problem: MapProblem, estimate: MapEstimate, angles: Floats) -> float:
    state = replace(estimate.state, walls=np.column_stack((angles, np.full(len(angles), 50.0))))
    return float(robust_cost(problem.angle_residuals(state, Assignment(np.zeros(9, dtype=np.intp)))[0]).sum())


def test_right_angles_have_the_standard_deviation_of_the_problem(estimate: MapEstimate) -> None:
    """Oracle: the robust cost by hand, of walls whose axes are those of the first four."""
    narrow = estimate.problem.with_right_angles(radians(0.1))
    off_deg = np.array((-0.05, 0.05, -0.05, 0.05, 13.0))
    axes_deg = np.array((0.0, 90.0, 0.0, -90.0, 0.0))
    angles = np.radians(off_deg + axes_deg)
    state = replace(estimate.state, walls=np.column_stack((angles, np.full(5, 50.0))), points=estimate.state.points[:0])
    explained = Assignment(np.full(len(estimate.assignment.feature), NO_FEATURE))
    r2 = np.square(off_deg / 0.1)
    expected = float((6.25 * r2 / (6.25 + r2)).sum())
    assert angle_cost(narrow, estimate, angles) == pytest.approx(expected, rel=1e-3)
    # As in the cost of the map, without the angles.
    straight = replace(state, walls=np.column_stack((np.zeros(5), np.full(5, 50.0))))
    change = narrow.cost(state, explained) - narrow.cost(straight, explained)
    assert change == pytest.approx(expected, rel=1e-3)
    # It stays when the measurements change.
    for like in (narrow.plain, narrow.with_trajectory(estimate.problem.trajectory)):
        assert like.right_angle_std_rad == radians(0.1)
        assert like.reflection is estimate.problem.reflection


@pytest.mark.parametrize("seed", range(5))
def test_axes_of_a_building_are_those_that_cost_least(estimate: MapEstimate, seed: int) -> None:
    rng, quarter = np.random.default_rng(seed), 0.5 * np.pi
    angles = 0.3 + quarter * rng.integers(-2, 3, 7) + RIGHT_ANGLE_STD_RAD * rng.normal(size=7)
    angles[5] += 0.6  # a slanted wall

    def cost_by(axis: float) -> float:
        off = (angles - axis + 0.5 * quarter) % quarter - 0.5 * quarter
        return float(robust_cost(off / RIGHT_ANGLE_STD_RAD).sum())

    axis = minimize_scalar(cost_by, bounds=(0.25, 0.35), method="bounded", options={"xatol": 1e-9}).x
    found = angle_cost(estimate.problem, estimate, angles)
    assert found == pytest.approx(cost_by(axis), abs=1e-4)
    # The slanted one costs what an outlier does, and pulls nothing.
    state = replace(estimate.state, walls=np.column_stack((angles, np.full(7, 50.0))))
    r, J = estimate.problem.angle_residuals(state, Assignment(np.zeros(9, dtype=np.intp)))
    assert robust_weight(r)[5] < 1e-5
    # Derivatives of the cost, the axes following, against difference quotients.
    gradient = 2.0 * J.T @ (robust_weight(r) * r)
    steps = 1e-6 * np.eye(7)
    ahead, behind = (
        np.array([angle_cost(estimate.problem, estimate, angles + sign * step) for step in steps])
        for sign in (1.0, -1.0)
    )
    quotients = (ahead - behind) / 2e-6
    np.testing.assert_allclose(gradient, quotients, rtol=1e-3, atol=0.05 * np.abs(gradient).max())


def test_right_angles_count_only_with_priors_and_two_walls(estimate: MapEstimate) -> None:
    assert not len(estimate.problem.plain.angle_residuals(estimate.state, estimate.assignment)[0])
    alone = replace(estimate.state, walls=estimate.state.walls[:1])
    assert not len(estimate.problem.angle_residuals(alone, Assignment(np.zeros(9, dtype=np.intp)))[0])


def test_point_that_two_rooms_share_becomes_two(estimate: MapEstimate) -> None:
    # Half of the echoes of a point are of another one, 1.9 in from it: within the gate of the association.
    walls, trajectory = len(estimate.state.walls), estimate.problem.trajectory
    number = max(range(len(estimate.state.points)), key=lambda point: len(estimate.echoes_of(walls + point)))
    point, echoes = estimate.state.points[number], estimate.echoes_of(walls + number)
    sensors = sensors_at(estimate.state.poses, estimate.state.parameters, trajectory, echoes)
    off = sensors.face - point
    bearing = np.arctan2(*(off @ np.array(((0.0, 1.0), (1.0, 0.0)))).T)
    is_left = bearing > np.median(bearing)
    towards = off[is_left].mean(axis=0)
    moved = point + 1.9 * towards / np.hypot(*towards)
    readings = trajectory.readings_in.copy()
    readings[echoes[is_left]] += np.hypot(*(sensors.face - moved).T)[is_left] - np.hypot(*off.T)[is_left]
    made = estimate.copy()
    made.problem = estimate.problem.with_trajectory(replace(trajectory, readings_in=readings))
    made.assignment = Assignment(estimate.assignment.feature)
    # As if both were one.
    assert part_points(estimate.copy()) == 0
    before, count = made.cost, len(made.state.points)
    assert part_points(made) == 1
    assert made.cost < before
    assert len(made.state.points) == count + 1
    # One is nearer to where these were measured from by as much, but for what the path takes of it.
    both = made.state.points[np.hypot(*(made.state.points - point).T) < 4.0]
    assert len(both) == 2
    assert abs(float(np.diff(both @ towards)[0]) / np.hypot(*towards)) == pytest.approx(1.9, abs=0.8)


@pytest.mark.parametrize("moved_in", [0.0, 3.0, 5.0])
def test_a_point_that_is_elsewhere_since_a_return_becomes_two(estimate: MapEstimate, moved_in: float) -> None:
    trajectory, walls = estimate.problem.trajectory, len(estimate.state.walls)
    # 1. The point with most echoes, left in the middle of the drive; since then another one is measured beside it.
    sizes = [len(estimate.echoes_of(walls + number)) for number in range(len(estimate.state.points))]
    feature = np.where(abs(trajectory.node - 58) < 25, NO_FEATURE, estimate.assignment.feature)
    number = int(np.argmax(sizes))
    late = np.flatnonzero((feature == walls + number) & (trajectory.node > 58))
    assert len(late) > 8
    point = estimate.state.points[number]
    sensors = sensors_at(estimate.state.poses, estimate.state.parameters, trajectory, late)
    towards = (sensors.face - point).mean(axis=0)
    moved = point + moved_in * towards / np.hypot(*towards)
    readings = trajectory.readings_in.copy()
    readings[late] += np.hypot(*(sensors.face - moved).T) - np.hypot(*(sensors.face - point).T)
    made = estimate.copy()
    made.problem = estimate.problem.with_trajectory(replace(trajectory, readings_in=readings))
    made.assignment = Assignment(feature)
    made.optimize(10)
    # 2. The score is by how much the sum of squares falls if the late echoes have a point of their own.
    plain = made.copy()
    plain.problem = made.problem.plain
    plain.optimize(20)
    before = plain.problem.cost(plain.state, plain.assignment)
    score = {at: score for at, score, _ in late_scores(plain)}[walls + number]
    plain.add_point(point)
    feature = feature.copy()
    feature[late] = plain.state.features - 1
    plain.assignment = Assignment(feature)
    plain.optimize(20)
    fall = before - plain.problem.cost(plain.state, plain.assignment)
    assert score == pytest.approx(fall, rel=0.25, abs=0.5)
    # 3. The second one is where it was measured.
    assert part_late_points(made) == (moved_in > 0.0)
    near = made.state.points[np.hypot(*(made.state.points - moved).T) < 2.0]
    assert len(near) == 1


def test_late_ranges_that_do_not_count_contradict_nothing(estimate: MapEstimate) -> None:
    # Wall 0 is left for a while; what is measured of it then is at the lower limit.
    trajectory, feature = estimate.problem.trajectory, estimate.assignment.feature
    made = estimate.copy()
    made.assignment = replace(
        estimate.assignment, feature=np.where((feature == 0) & (abs(trajectory.node - 58) < 25), NO_FEATURE, feature)
    )
    tested = len(compare_returns(made))
    weight = np.where((feature == 0) & (trajectory.node > 58), 0.0, trajectory.weight)
    made.problem = estimate.problem.with_trajectory(replace(trajectory, weight=weight))
    assert len(compare_returns(made)) < tested


@pytest.mark.parametrize(("meets", "expected"), [
    ([(60.0, 0.0, 60.0, 40.0)], (40.0, 20.0)),  # at its end
    ([(75.0, -20.0, 75.0, 20.0)], (40.0, 35.0)),  # 15 in beyond it
    ([(60.0, 30.0, 60.0, 60.0)], (40.0, 40.0)),  # one whose line alone crosses it there
    ([(0.0, 0.0, 0.0, 40.0)], (40.0, 40.0)),  # in its middle
    ([(-40.0, 0.0, -60.0, 30.0), (75.0, -20.0, 75.0, 20.0)], (20.0, 35.0)),
    ([(60.0, 0.0, 90.0, 2.0)], (40.0, 40.0)),  # the same wall, nearly
])  # fmt: skip
@pytest.mark.parametrize("turn", [0.0, 1.1, -2.9])
def test_a_wall_goes_on_less_beyond_one_that_it_meets(
    meets: list[tuple[float, ...]], expected: tuple[float, float], turn: float
) -> None:
    segments = np.array([(-40.0, 0.0, 60.0, 0.0), *meets]).reshape(-1, 2, 2)
    shift = np.array((31.0, -17.0))
    ends = rotate(segments.reshape(-1, 2), np.full(2 * len(segments), turn)).reshape(-1, 2, 2) + shift
    along = ends[:, 1] - ends[:, 0]
    angle = np.arctan2(-along[:, 0], along[:, 1])
    normal = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    walls = np.stack((angle, (normal * ends[:, 0]).sum(axis=1)), axis=-1)
    extents = np.sort((ends * np.stack((-normal[:, 1], normal[:, 0]), axis=-1)[:, None]).sum(axis=2), axis=1)
    found = growth_of(walls, extents)[0]
    # The normal turned left is against the direction in which the ends are given.
    np.testing.assert_allclose(np.sort(found), np.sort(expected), atol=1e-9)
    first_is_low = (ends[0, 0] @ np.array((-normal[0, 1], normal[0, 0]))) < extents[0].mean()
    np.testing.assert_allclose(found if first_is_low else found[::-1], expected, atol=1e-9)
