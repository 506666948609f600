"""Exploration: gaps that are entered, paths through them, and a room that a robot explores by itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from localization.filters.belief import Floats
from localization.mapping.association import MapEstimate
from localization.mapping.explore import (
    CELL_IN,
    MEASURING_PACE,
    Explorer,
    Grid,
    Place,
    _corner_places,
    _dense,
    _end_places,
    _Finished,
    _first_in_sight,
    _unexplained_hits,
    pushed,
    rests_of_corners,
)
from localization.mapping.live import LiveMapper, passed, walls_and_posts, with_openings
from localization.mapping.measurements import read_drive
from localization.mapping.problem import NO_FEATURE, MapProblem
from localization.mapping.survey import Geofence, Plan, Point
from localization.mapping.walls import Piece
from localization.navigation.path import wall_distances
from localization.navigation.roadmap import segment_clearances
from nclient.cli import main

BODY_IN = 9.72


def points_of(plan: Plan | None) -> list[Point]:
    """Return the points of a path."""
    assert plan is not None
    return plan.points


def wall_with_gap(width_in: float, at_in: float = 0.37) -> Floats:
    """Return the walls of a room of 160 by 80 in, with a wall across that has a gap off the cells' centres."""
    low, high = 40.0 + at_in - 0.5 * width_in, 40.0 + at_in + 0.5 * width_in
    room = [(0, 0, 160, 0), (160, 0, 160, 80), (160, 80, 0, 80), (0, 80, 0, 0)]
    return np.array([*room, (80.3, 0, 80.3, low), (80.3, high, 80.3, 80)], dtype=np.float64)


def grid_of(walls: Floats) -> Grid:
    """Return a grid of which all cells are free, with their exact distances from walls."""
    shape = int(164 / CELL_IN), int(84 / CELL_IN)
    nowhere = np.zeros(shape, dtype=np.bool_)
    grid = Grid(np.array((-2.0, -2.0)), ~nowhere, np.zeros(shape), walls, nowhere)
    cells = np.argwhere(grid.free)
    grid.space[cells[:, 0], cells[:, 1]] = wall_distances(grid.centres(cells), walls)
    return grid


@pytest.mark.parametrize(("width_in", "enters"), [(24.0, True), (30.0, True), (20.0, False)])
@pytest.mark.parametrize("at_in", [0.0, 0.37, 1.0])
def test_gaps_of_24_in_are_entered(width_in: float, enters: bool, at_in: float) -> None:
    walls = wall_with_gap(width_in, at_in)
    grid, explorer = grid_of(walls), Explorer(BODY_IN, 6.0, 300.0)
    explorer.find_reach(grid, np.array((40.0, 30.0, 0.0)))
    (goal,) = grid.cells(np.array([[120.0, 50.0]]))
    assert bool(grid.reached[goal[0], goal[1]]) is enters
    if enters:
        path = [(40.0, 30.0), *explorer.path(grid, np.array((40.0, 30.0, 0.0)), goal)]
        lines = np.array([[*one, *other] for one, other in pairwise(path)])
        assert segment_clearances(lines, walls).min() > BODY_IN + 0.8
        assert len(path) < 8


def test_band_is_pushed_to_the_middle_of_a_gap() -> None:
    points = np.column_stack((np.linspace(60.0, 100.0, 21), np.full(21, 38.0)))
    found = pushed(points, wall_with_gap(24.0), BODY_IN + 4.0)
    middle = found[np.abs(found[:, 0] - 80.0) < 4.0]
    np.testing.assert_allclose(middle[:, 1], 40.37, atol=1.2)
    np.testing.assert_allclose(found[[0, -1]], points[[0, -1]])


def test_walls_end_where_the_robot_has_passed_them() -> None:
    walls = np.array([(0.0, 0.0, 100.0, 0.0), (0.0, 50.0, 100.0, 40.0), (20.0, -30.0, 20.0, -9.0)])
    path = np.array([(50.0, -4.0), (52.0, 3.0), (98.0, 0.0), (30.0, 41.0), (300.0, 0.0)])
    found = passed(walls, path, 8.0)
    # Against points along the walls: near the path nothing is left, and everywhere else all of it.
    for wall in walls:
        points = np.linspace(wall[:2], wall[2:], 400)
        away = np.hypot(*(points[:, None] - path).transpose(2, 0, 1)).min(axis=1)
        clear = np.abs(away - 8.0) > 0.3
        is_left = wall_distances(points, found) < 1e-6
        np.testing.assert_array_equal(is_left[clear], (away > 8.0)[clear])


def test_path_is_filled_up_to_points_a_cell_apart() -> None:
    path = np.array([(0.0, 0.0), (0.0, 7.0), (3.0, 7.0)])
    found = _dense(path)
    assert np.hypot(*np.diff(found, axis=0).T).max() <= CELL_IN
    assert wall_distances(path, np.concatenate((found[:-1], found[1:]), axis=1)).max() < 1e-9


def test_line_that_goes_on_beyond_a_door_leaves_it_open(estimate: MapEstimate) -> None:
    parted = estimate.copy()
    low, high = parted.extents[0]
    middle = 0.5 * (low + high)
    others = parted.runs[parted.runs[:, 0] != 0]
    parted.runs = np.concatenate((others, [(0, low, middle - 15.0), (0, middle + 15.0, high)]))
    angle, offset = parted.state.walls[0]
    door = offset * np.array((np.cos(angle), np.sin(angle))) + middle * np.array((-np.sin(angle), np.cos(angle)))
    assert wall_distances(door[None], walls_and_posts(estimate))[0] < 0.01
    assert wall_distances(door[None], walls_and_posts(parted))[0] == pytest.approx(15.0)


@pytest.mark.parametrize(
    ("pieces", "parts"),
    [
        # Coordinates from the middle of a wall that its echoes show from -50 to 50: spots, ends, and whether closed.
        ([], [(-50.0, 50.0)]),
        ([((-50.0, 50.0), (-45.0, 40.0), (True, True))], [(-50.0, 50.0)]),
        ([((-50.0, -20.0), (-52.0, -18.0), (True, True)), ((20.0, 45.0), (19.0, 48.0), (True, True))],
         [(-50.0, -18.0), (19.0, 50.0)]),
        ([((-50.0, -20.0), (-52.0, -20.0), (True, False)), ((20.0, 45.0), (19.0, 48.0), (True, False))],
         [(-50.0, 50.0)]),
        # The whole run lies in an opening: the wall is still there.
        ([((-80.0, -60.0), (-80.0, -55.0), (True, True)), ((60.0, 80.0), (55.0, 80.0), (True, True))],
         [(-50.0, 50.0)]),
    ],
)  # fmt: skip
def test_walls_are_open_between_ends_that_face_each_other(
    estimate: MapEstimate,
    pieces: list[tuple[tuple[float, float], tuple[float, float], tuple[bool, bool]]],
    parts: list[tuple[float, float]],
) -> None:
    made = estimate.copy()
    angle, offset = made.state.walls[0]
    normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    middle = float(made.extents[0].mean())
    made.runs = np.concatenate((made.runs[made.runs[:, 0] != 0], [(0, middle - 50.0, middle + 50.0)]))
    own = list[Piece]()
    for (low, high), at, closed in reversed(pieces):
        ends = offset * normal + (middle + np.array(at))[:, None] * along
        own.append(Piece(0, middle + low, middle + high, ends, [*closed], 9))
    before = made.runs.copy()
    found = with_openings(made, own)
    np.testing.assert_array_equal(made.runs, before)
    np.testing.assert_array_equal(found.runs[found.runs[:, 0] != 0], before[before[:, 0] != 0])
    np.testing.assert_allclose(found.runs[found.runs[:, 0] == 0, 1:] - middle, parts, atol=1e-9)


def test_robot_comes_back_through_a_door_mapped_too_narrow() -> None:
    walls, pose = wall_with_gap(18.0), np.array((40.0, 30.0, 0.0))
    grid, explorer = grid_of(walls), Explorer(BODY_IN, 6.0, 300.0)
    (goal,) = grid.cells(np.array([[120.0, 50.0]]))
    explorer.find_reach(grid, pose)
    assert not grid.reached[goal[0], goal[1]]
    driven = grid.cells(_dense(np.array([(50.0, 40.0), (110.0, 41.0)])))
    grid.driven = np.zeros(grid.free.shape, dtype=np.bool_)
    grid.driven[driven[:, 0], driven[:, 1]] = True
    explorer.find_reach(grid, pose)
    assert grid.reached[goal[0], goal[1]]


def test_first_cell_in_sight_is_that_of_all_cells() -> None:
    walls, place = wall_with_gap(24.0), np.array((120.0, 50.0))
    centres = np.random.default_rng(2).uniform((5.0, 5.0), (75.0, 75.0), (300, 2))
    # Seen through the gap of the wall at x = 80.3.
    at = place[1] + (80.3 - place[0]) / (centres[:, 0] - place[0]) * (centres[:, 1] - place[1])
    seen = np.flatnonzero(np.abs(at - 40.37) < 12.0)
    hidden = np.setdiff1d(np.arange(300), seen)
    rows = np.concatenate((hidden, seen))
    assert _first_in_sight(centres, rows, place, walls) == seen[0]
    assert _first_in_sight(centres, hidden, place, walls) is None


def test_frontier_before_a_room_is_worth_more_than_a_niche() -> None:
    unknown = np.zeros((80, 80), dtype=np.bool_)
    unknown[:10, :] = True
    unknown[40:43, 40:45] = True
    explorer = Explorer(BODY_IN, 6.0, 300.0)
    assert explorer._behind(unknown, np.array((41, 42))) == 15
    # Half a disc is cut by the edge of the grid: cells of 10 rows within 22 cells.
    rows, columns = np.mgrid[:10, :80]
    inside = np.hypot(rows - 9, columns - 40) <= 22.0
    assert explorer._behind(unknown, np.array((9, 40))) == inside.sum()


def test_frontier_counts_as_tried_where_it_was_looked_at_from() -> None:
    explorer = Explorer(BODY_IN, 6.0, 300.0)
    explorer._place = Place("frontier", 10.0, 0.0, 1.0, (0.0, 0.0))
    explorer.end_leg(np.zeros(3), "")
    near = Place("frontier", 14.0, 0.0, 1.0, (1.0, 1.0))
    assert (explorer._tries(near), explorer._tries(near, 5.0)) == (1, 1)
    # From further into the door it is another look.
    near.seen_from_in = 7.0, 0.0
    assert (explorer._tries(near), explorer._tries(near, 5.0)) == (1, 0)
    explorer._place = near
    explorer.end_leg(np.zeros(3), "blocked")
    assert (explorer._tries(near), explorer._tries(near, 5.0)) == (3, 2)


def test_frontier_is_tried_again_later_but_not_for_ever() -> None:
    explorer = Explorer(BODY_IN, 6.0, 900.0)
    place = Place("frontier", 10.0, 0.0, 1.0, (0.0, 0.0))
    for clock_s, tries in ((10.0, 2), (50.0, 4), (120.0, 4), (400.0, 2), (800.0, 2)):
        explorer._clock_s, explorer._place = clock_s, replace(place)
        explorer.end_leg(np.zeros(3), "blocked")
        assert explorer._tries(place) == tries
    for _ in range(3):
        explorer._place = replace(place)
        explorer.end_leg(np.zeros(3), "blocked")
    explorer._clock_s = 5000.0
    assert explorer._tries(place) == 16
    # Other places are not.
    explorer._place = Place("end", 10.0, 0.0)
    explorer.end_leg(np.zeros(3), "")
    explorer._clock_s = 9000.0
    assert explorer._tries(Place("end", 10.0, 0.0)) == 1


def test_vertex_is_looked_at_from_where_the_robot_was_not(estimate: MapEstimate) -> None:
    made = estimate.copy()
    made.state = replace(
        estimate.state, points=np.array([(0.0, 0.0)]),
        poses=np.array([(20.0, 0.0, 0.0), (20.0, 20.0, 0.0), (0.0, 40.0, 0.0), (-15.0, -15.0, 0.0)]),
    )  # fmt: skip
    places = {(round(place.x_in), round(place.y_in)) for place in _end_places(made, [])}
    # Eight directions 17 in off, less those of three poses: (0, 40) is too far away.
    assert places == {(0, 17), (-12, 12), (-17, 0), (0, -17), (12, -12)}


class NoMap:
    """A mapper before its first solution."""

    rounds, poses, rays = 0, np.zeros((0, 3)), False


def test_what_exact_rays_hit_twice_is_an_obstacle(estimate: MapEstimate) -> None:
    # 1. All echoes are explained; without a wall those of it are not.
    without = estimate.copy()
    wall, echoes = without.state.walls[0], without.echoes_of(0)
    without.remove(0)
    without.assignment.feature[:] = np.where(np.isin(np.arange(len(without.assignment.feature)), echoes), NO_FEATURE, 0)
    assert len(_unexplained_hits(without)) == 0, "cones do not tell where something is"
    # 2. As rays they end where the wall is, but for how far off their axis the drive's cones have measured it.
    trajectory, old = without.problem.trajectory, without.problem
    without.problem = MapProblem(trajectory, 16, rays=True, reflection=old.reflection)
    hits = _unexplained_hits(without)
    across = np.abs(hits @ (np.cos(wall[0]), np.sin(wall[0])) - wall[1])
    assert len(hits) > 5
    assert np.median(across) < 2.0
    # 3. One alone may be a bad reading.
    without.assignment.feature[:] = 0
    without.assignment.feature[echoes[:1]] = NO_FEATURE
    assert len(_unexplained_hits(without)) == 0


def test_what_blocks_a_leg_lies_ahead_of_the_body() -> None:
    explorer, pose = Explorer(BODY_IN, 6.0, 300.0), np.array((10.0, 20.0, 0.0))
    explorer.leg(1.0, pose, cast("LiveMapper", NoMap()), lambda way: 30.0 if abs(way) < 0.1 else 5.0)
    explorer.end_leg(pose, "blocked", np.pi / 2.0)
    np.testing.assert_allclose(list(explorer.blocked), [(10.0, 20.0 + BODY_IN + 3.0)], atol=1e-9)


def test_robot_drives_away_from_what_blocks_the_next_leg(monkeypatch: pytest.MonkeyPatch) -> None:
    explorer, pose = Explorer(BODY_IN, 6.0, 300.0), np.array((10.0, 20.0, 0.0))
    monkeypatch.setattr(explorer, "_chosen_leg", lambda *_: [(30.0, 20.0)])

    def free_in(way: float) -> float:
        return 40.0 if np.cos(way - 2.75) > 0.99 else 0.0

    mapper = cast("LiveMapper", NoMap())
    assert points_of(explorer.leg(1.0, pose, mapper, free_in)) == [(30.0, 20.0)]
    explorer.end_leg(pose, "blocked", 0.0)
    ((x, y),) = points_of(explorer.leg(1.0, pose, mapper, free_in))
    np.testing.assert_allclose((x - 10.0, y - 20.0), 8.0 * np.array((np.cos(2.75), np.sin(2.75))), atol=0.1)
    # Once: whatever blocks then is the map's.
    explorer.end_leg(pose, "", 0.0)
    assert points_of(explorer.leg(1.0, pose, mapper, free_in)) == [(30.0, 20.0)]


def test_leg_that_was_blocked_is_not_tried_again_from_there() -> None:
    # Beside a wall that is too near to measure the guard stops a leg, however far it is free ahead.
    explorer, pose = Explorer(BODY_IN, 6.0, 300.0), np.array((8.0, 3.0, 0.0))

    def direction() -> float:
        ((x, y),) = explorer._free_leg(at, lambda angle_rad: 50.0 if abs(angle_rad) < 0.1 else 20.0, 30.0)
        return float(np.arctan2(y - at[1], x - at[0]))

    at = pose
    assert direction() == pytest.approx(0.0)
    explorer.end_leg(pose, "blocked", 0.0)
    assert abs(direction()) > 0.3
    # From farther away, or later, it is.
    at = np.array((17.0, 3.0, 0.0))
    assert direction() == pytest.approx(0.0)
    at, explorer._clock_s = pose, 61.0
    assert direction() == pytest.approx(0.0)


def test_leg_back_that_is_blocked_is_not_tried_twice_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    explorer, pose = Explorer(BODY_IN, 6.0, 300.0), np.array((10.0, 20.0, 0.0))
    monkeypatch.setattr(explorer, "_chosen_leg", lambda *_: [(30.0, 20.0)])
    driven = NoMap()
    driven.poses = np.array([(0.0, 20.0, 0.0), (10.0, 20.0, 0.0)])
    mapper = cast("LiveMapper", driven)
    # Both ahead and back something is too near; only to the left there is space.
    found = []
    for _ in range(4):
        plan = explorer.leg(1.0, pose, mapper, lambda way: 40.0 if np.cos(way - np.pi / 2.0) > 0.99 else 0.0)
        found.append(points_of(plan))
        explorer.end_leg(pose, "blocked", 0.0)
    first, back, aside, again = found
    assert (first, back, again) == ([(30.0, 20.0)], [(0.0, 20.0)], [(0.0, 20.0)])
    np.testing.assert_allclose(np.array(aside), np.array([(10.0, 28.0)]), atol=1e-9)


def test_leg_back_is_where_the_robot_was() -> None:
    explorer = Explorer(BODY_IN, 6.0, 300.0)
    poses = np.array([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (14.0, 0.0, 0.0), (14.0, 5.0, 1.5)])
    assert explorer._leg_back(np.array((14.0, 7.0, 1.5)), poses) == [(10.0, 0.0)]
    assert explorer._leg_back(np.array((14.0, 7.0, 1.5)), poses[2:]) == []


def wall(one: Point, other: Point, *, closed: tuple[bool, bool] = (False, False)) -> Piece:
    """Return a wall from one end to the other."""
    return Piece(0, 0.0, 0.0, np.array((one, other)), list(closed), 0)


def test_walls_probably_go_on_to_a_corner_that_is_near() -> None:
    # Both walls of a corner at (80, 0) end before it, by 20 in.
    lower, right = wall((0, 0), (60, 0), closed=(True, False)), wall((80, 20), (80, 90), closed=(False, True))
    np.testing.assert_allclose(rests_of_corners([lower, right]), [(60, 0, 80, 0), (80, 20, 80, 0)], atol=0.02)
    # At a wall that is there the other one ends.
    there = wall((80, -9), (80, 90), closed=(True, True))
    np.testing.assert_allclose(rests_of_corners([lower, there]), [(60, 0, 80, 0)], atol=0.02)
    # Neither farther ends, nor those that are known, nor two parts of one line, between which a door may be.
    assert not len(rests_of_corners([lower, wall((97, -9), (97, 90), closed=(True, True))]))
    assert not len(rests_of_corners([wall((0, 0), (60, 0), closed=(True, True)), there]))
    assert not len(rests_of_corners([lower, wall((90, 0), (150, 0), closed=(False, True))]))
    assert not len(rests_of_corners([]))


def frontier_grid(*others: tuple[float, ...]) -> tuple[Grid, Explorer]:
    """Return a grid that is known below y = 40, where a wall has a door at x = 80, and unknown above."""
    walls = np.array([(0.0, 40.0, 61.5, 40.0), (98.5, 40.0, 160.0, 40.0), *others])
    grid, explorer = grid_of(walls), Explorer(BODY_IN, 6.0, 300.0)
    grid.free[:, int(42 / CELL_IN) :] = False
    return grid, explorer


def test_what_is_behind_a_frontier_is_what_the_robot_can_get_to() -> None:
    grid, explorer = frontier_grid()
    ((x, y, open_size),) = explorer._frontiers(grid).tolist()
    assert (x, y) == pytest.approx((80.0, 43.0), abs=2.0)
    assert open_size > 0.9
    # Not through a gap of 16 in, nor, if walls go on to their corner, through that corner.
    narrow = (0.0, 60.0, 72.0, 60.0), (88.0, 60.0, 160.0, 60.0)
    ((*_, size),) = frontier_grid(*narrow)[1]._frontiers(frontier_grid(*narrow)[0]).tolist()
    assert size < 0.5 * open_size
    niche = [wall((61.5, 40.0), (61.5, 80.0), closed=(True, True)), wall((61.5, 80.0), (70.0, 80.0)),
             wall((98.5, 40.0), (98.5, 62.0))]  # fmt: skip
    grid, explorer = frontier_grid(*(tuple(piece.ends.ravel().tolist()) for piece in niche))
    ((*_, with_corner),) = explorer._frontiers(grid).tolist()
    explorer._solution.pieces = niche
    ((*_, size),) = explorer._frontiers(grid).tolist()
    # 37 by 38 in without 9.7 in beside both walls, up to the line of the third.
    assert size == pytest.approx(17.5 * 38.0 / 4.0 / 400.0, abs=0.04)
    assert with_corner > size + 0.15
    # Also where the widest cells of the frontier are on such a line.
    grid, explorer = frontier_grid()
    explorer._solution.pieces = [wall((80.0, 75.0), (80.0, 62.0), closed=(True, False)),
                                 wall((61.5, 40.0), (98.5, 40.0), closed=(True, True))]  # fmt: skip
    ((*_, size),) = explorer._frontiers(grid).tolist()
    assert size <= open_size


@pytest.mark.parametrize(("size", "chosen"), [(1.6, "frontier"), (0.5, "coverage")])
@pytest.mark.parametrize("rays", [False, True])
def test_cells_wait_while_there_may_be_a_room_to_enter(
    monkeypatch: pytest.MonkeyPatch, size: float, chosen: str, rays: bool
) -> None:
    grid, explorer = frontier_grid()
    pose, mapper = np.array((20.0, 15.0, 0.0)), NoMap()
    mapper.poses, mapper.rays = pose[None], rays
    explorer.find_reach(grid, pose)
    grid.echo_in = np.full(grid.free.shape, np.inf)
    places = [(Place("frontier", 80.0, 42.0, size), 44.0), (Place("coverage", 30.0, 15.0), 6.0)]
    monkeypatch.setattr(explorer, "_candidates", lambda *_: places)
    path = explorer._next_path(grid, cast("LiveMapper", mapper), pose)
    assert explorer._place is not None
    assert explorer._place.kind == chosen
    assert explorer._pace == (1.0 if chosen == "frontier" else MEASURING_PACE)
    # Cones go on through the frontier; exact rays leave gaps in what is not known yet.
    assert path is not None
    assert (path[-1][1] > 42.0) is (chosen == "frontier" and not rays)
    assert (explorer._optional_in > 0.0) is (chosen == "frontier" and not rays)


@pytest.mark.parametrize("is_closed", [False, True])
def test_robot_at_a_frontier_goes_on_or_needs_another_map(
    monkeypatch: pytest.MonkeyPatch, is_closed: bool
) -> None:
    # Something stands just before the robot, or nothing does.
    grid, explorer = frontier_grid(*([(70.0, 35.0, 90.0, 35.0)] if is_closed else []))
    pose, mapper = np.array((81.0, 21.0, 0.0)), NoMap()
    mapper.poses = pose[None]
    explorer.find_reach(grid, pose)
    grid.echo_in = np.full(grid.free.shape, np.inf)
    monkeypatch.setattr(explorer, "_candidates", lambda *_: [(Place("frontier", 81.0, 43.0, 1.6), 44.0)])
    monkeypatch.setattr(
        explorer, "_cell_for", lambda _place, _radius, cells, _grid: np.hypot(*(cells.centres - pose[:2]).T).argmin()
    )
    path = explorer._next_path(grid, cast("LiveMapper", mapper), pose)
    assert explorer._is_undecided is is_closed
    if is_closed:
        assert path is None
    else:
        # It does not first go to the middle of the cell that it stands in.
        assert path is not None
        assert len(path) == 1
        assert path[0][1] > 60.0


def test_path_goes_on_through_a_frontier_as_far_as_there_is_space() -> None:
    grid, explorer = frontier_grid()
    explorer.find_reach(grid, np.array((80.0, 10.0, 0.0)))
    door = Place("frontier", 80.0, 42.0)
    # From 22 in before the door to 24 in behind; the end of it is not known to be free.
    ((x, y),), unknown_in = explorer._onward(grid, (80.0, 20.0), door)
    assert x == pytest.approx(80.0)
    assert 64.0 <= y <= 66.0
    assert 66.0 - 40.0 < unknown_in < 66.0 - 26.0
    # Not past a post, out of the fence, or where it would be no step.
    ((x, y),), _ = explorer._onward(grid, (80.0, 20.0), Place("frontier", 99.0, 42.0))
    assert np.hypot(x - 98.5, y - 40.0) > BODY_IN
    fenced = Explorer(BODY_IN, 6.0, 300.0, Geofence((0.0, 0.0), (160.0, 50.0)))
    ((_, y),), _ = fenced._onward(grid, (80.0, 20.0), door)
    assert 48.0 <= y <= 50.0
    assert fenced._onward(grid, (80.0, 48.0), Place("frontier", 80.0, 52.0)) == ([], 0.0)


@pytest.mark.parametrize(("start", "along", "end_x"), [
    ((20.0, 20.0), (1.0, 0.0), 94.0),  # 48 in along the wall
    ((130.0, 20.0), (1.0, 0.0), None),  # it comes from there
    ((20.0, 20.0), (0.0, 1.0), None),  # what is not known to be free
    ((20.0, 20.0), (-1.0, 0.0), None),
])  # fmt: skip
def test_path_to_an_open_end_goes_on_along_the_wall(
    monkeypatch: pytest.MonkeyPatch, start: Point, along: Point, end_x: float | None
) -> None:
    grid, explorer = frontier_grid()
    pose, mapper = np.array((*start, 0.0)), NoMap()
    mapper.poses = pose[None]
    explorer.find_reach(grid, pose)
    grid.echo_in = np.full(grid.free.shape, np.inf)
    place = Place("end", 47.0, 25.0, along=along)
    monkeypatch.setattr(explorer, "_candidates", lambda *_: [(place, 6.0)])
    path = explorer._next_path(grid, cast("LiveMapper", mapper), pose)
    assert path is not None
    goal = [(47.0, 25.0)] if end_x is None else [(47.0, 25.0), (end_x, 25.0)]
    np.testing.assert_allclose(path[-len(goal):], goal, atol=2.0)
    assert explorer._optional_in == 0.0


def test_exploration_goes_on_with_a_revised_map_before_it_ends(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Mapper(_Finished):
        rounds, revisions = 9, 0

        def revise(self) -> None:
            self.revisions += 1

    explorer, mapper = Explorer(BODY_IN, 6.0, 300.0), Mapper(estimate)
    pose = mapper.poses[-1]
    found: list[list[tuple[float, float]] | None] = [None, [(5.0, 5.0)], None, None]
    monkeypatch.setattr(explorer, "_next_path", lambda *_: found.pop(0))
    explorer.end_leg(pose, "blocked", 0.0)
    tried = [Place("frontier", 1.0, 2.0, 1.6), Place("frontier", 3.0, 4.0, 0.5), Place("end", 5.0, 6.0)]
    explorer._tried = tried.copy()
    assert points_of(explorer.leg(100.0, pose, cast("LiveMapper", mapper), lambda _: 9.0)) == [(5.0, 5.0)]
    # What has blocked legs, and the tries of frontiers before rooms, are forgotten.
    assert (mapper.revisions, explorer.blocked, explorer._tried) == (1, {}, tried[1:])
    # The second time there is nothing left: the last leg, and the end.
    assert explorer.leg(110.0, pose, cast("LiveMapper", mapper), lambda _: 9.0) is not None
    assert (mapper.revisions, found) == (2, [])
    assert explorer.leg(120.0, pose, cast("LiveMapper", mapper), lambda _: 9.0) is None


def test_what_blocked_a_leg_is_gone_where_the_robot_has_been(estimate: MapEstimate) -> None:
    explorer, finished = Explorer(BODY_IN, 6.0, 300.0), _Finished(estimate)
    x, y = finished.poses[len(finished.poses) // 2, :2].tolist()
    explorer.blocked = {(x + 1.0, y): 0.0, (300.0, 300.0): 0.0}
    explorer.unexplored(estimate)
    assert explorer.blocked == {(300.0, 300.0): 0.0}


def test_corners_are_measured_from_between_their_walls() -> None:
    def piece(*ends: tuple[float, float], closed: bool = True) -> Piece:
        return Piece(0, 0.0, 0.0, np.array(ends), [closed, closed], 0)

    walls = [piece((0.0, 0.0), (100.0, 0.0)), piece((0.0, 80.0), (0.0, 0.0))]
    (place,) = _corner_places([*walls, piece((100.0, 0.0), (100.0, 80.0), closed=False)], 15.0)
    assert place.kind == "corner"
    assert (place.x_in, place.y_in) == pytest.approx((15.0, 15.0))
    # At another angle as far from both walls.
    slanted = piece((0.0, 0.0), (60.0, 80.0))
    (place,) = _corner_places([walls[0], slanted], 15.0)
    distances = wall_distances(np.array([[place.x_in, place.y_in]]), walls[0].ends.reshape(1, 4))
    assert distances[0] == pytest.approx(15.0)
    assert wall_distances(np.array([[place.x_in, place.y_in]]), slanted.ends.reshape(1, 4))[0] == pytest.approx(15.0)


@pytest.mark.long
def test_robot_explores_a_room_without_contact(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "room.toml"
    address = "sim:thesis_room?setup=measured&seed=1"
    assert main.main(["map", "learn", address, "--out", str(out), "--time-limit", "40"]) in (0, 4)
    text = capsys.readouterr().out
    assert "contact" not in text
    assert "done" in text
    assert read_drive(tmp_path / "room.log").encoders[-1, 0] < 45.0


def test_places_are_not_where_sonars_measure_nothing(estimate: MapEstimate) -> None:
    explorer, finished = Explorer(BODY_IN, 6.0, 300.0), _Finished(estimate)
    grid = explorer._grid(finished, finished.poses[-1])
    reached = np.argwhere(grid.reached)
    space = grid.space[reached[:, 0], reached[:, 1]]
    # Cells beside the walls are reached, and none of them is a place to cover, far as it may be from the path.
    assert space.min() < BODY_IN + 3.0
    mapper = cast("LiveMapper", finished)
    # As if the robot had been outside alone.
    grid.driven[:] = False
    grid.driven[0, 0] = True
    candidates = explorer._candidates(grid, mapper, reached)
    places = np.array([(place.x_in, place.y_in) for place, _ in candidates if place.kind == "coverage"])
    assert len(places) > 4
    assert wall_distances(places, finished.walls).min() > BODY_IN + 3.0
