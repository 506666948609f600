"""The comparison of learned maps with true ones, on maps whose errors are known, and one trial end to end."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label

from localization.experiments import mapping
from localization.experiments.mapping import (
    Drive,
    Score,
    Trial,
    closing_error,
    corners_of,
    distance_to_corner,
    disturbed,
    fit_error,
    lines_beside,
    map_fit,
    read_scores,
    score,
    surface_fit,
    table,
    visible_samples,
)
from localization.filters.base import THESIS_ODOMETRY
from localization.filters.belief import Floats, rigid_fit, rotate, wrap_angle
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.consistency import Part
from localization.mapping.learn import learn_map
from localization.mapping.output import LearnedMap, Quality, describe, draw_learned
from localization.mapping.walls import Outline, Piece
from tests.localization.mapping.drives import drive
from worlds.geometry import lengths, nearest_points
from worlds.io import load_world
from worlds.robots import IDEAL_CALIBRATION, N150

TRIAL = Trial("thesis_room", "measured", 1)
PATH = np.stack((np.linspace(0.0, 80.0, 50), np.linspace(10.0, 60.0, 50) + 5.0 * np.sin(np.linspace(0.0, 6.0, 50))), -1)
QUALITY = Quality(1.0, (Part("drive", np.zeros(2), 100.0, 100.0, 150.0),))


def learned(walls: Floats, turn: float, shift: Floats) -> LearnedMap:
    """Return a map of walls (m, 4) in a frame of its own."""
    back = rotate(walls.reshape(-1, 2) - shift, np.full(2 * len(walls), -turn)).reshape(-1, 2, 2)
    pieces = [Piece(0, 0.0, 10.0, ends, [True, True], 9, 0.1, 0.01) for ends in back]
    path = np.column_stack((rotate(PATH - shift, np.full(len(PATH), -turn)), np.zeros(len(PATH))))
    return LearnedMap(tuple(pieces), np.empty((0, 2)), path, IDEAL_CALIBRATION, QUALITY, 0.0)


def scored(walls: Floats) -> dict[str, object]:
    times = np.arange(len(PATH), dtype=np.float64)
    driven = Drive(drive(), np.column_stack((times, PATH, np.zeros(len(PATH)))))
    return score(TRIAL, driven, learned(walls, 0.7, np.array((30.0, -20.0))), times, PATH + 0.5)


def test_rigid_fit_finds_turn_and_shift() -> None:
    turn, shift = rigid_fit(PATH, rotate(PATH, np.full(len(PATH), 0.4)) + np.array((3.0, 4.0)))
    assert turn == pytest.approx(0.4)
    np.testing.assert_allclose(shift, (3.0, 4.0))
    assert fit_error(PATH, rotate(PATH, np.full(len(PATH), -2.0)) + 9.0) == pytest.approx(0.0, abs=1e-9)
    assert fit_error(PATH, 2.0 * PATH) > 1.0


def test_closing_error_is_the_last_position_from_the_first_pose() -> None:
    path = np.array([[0.0, 0.0, 0.5], [9.0, 9.0, 1.0], [30.0, 40.0, 2.0]])
    moved = np.column_stack((rotate(path[:, :2], np.full(3, 0.8)) + 7.0, path[:, 2] + 0.8))
    assert closing_error(moved, path) == pytest.approx(0.0, abs=1e-9)
    assert closing_error(moved + np.array([[0.0] * 3, [5.0] * 3, [3.0, 4.0, 0.0]]), path) == pytest.approx(5.0)
    # A first heading that is off by a small angle moves the end by the distance times it.
    turned = path + np.array([[0.0, 0.0, 0.01], [0.0] * 3, [0.0] * 3])
    assert closing_error(turned, path) == pytest.approx(0.5, rel=1e-3)


def test_walls_are_compared_after_their_own_fit() -> None:
    # The path is off, the walls are not.
    room = load_world("several_walls").walls
    turn, shift = 0.03, np.array((1.2, -0.7))
    ends = rotate(room.reshape(-1, 2) - shift, np.full(2 * len(room), -turn)).reshape(-1, 2, 2)
    found_turn, found_shift = map_fit(ends, room, 0.0, np.zeros(2))
    assert found_turn == pytest.approx(turn)
    np.testing.assert_allclose(found_shift, shift, atol=1e-6)
    # Parallel walls alone do not determine the shift along them.
    found_turn, found_shift = map_fit(ends[[0, 2]], room[[0, 2]], turn, np.array((9.0, shift[1])))
    np.testing.assert_allclose(found_shift, (9.0, shift[1]), atol=0.3)


def test_true_map_has_no_errors() -> None:
    found = scored(load_world("thesis_room").walls)
    assert (found["walls"], found["found"], found["false"], found["missing"]) == (4, 4, 0, [])
    assert found["precision"] == pytest.approx(1.0)
    np.testing.assert_allclose(np.array(found["offsets_in"]), 0.0, atol=1e-9)
    assert found["path_in"] == pytest.approx(0.0, abs=1e-9)


def test_missing_false_and_shifted_walls_are_counted() -> None:
    walls = load_world("thesis_room").walls.copy()
    walls[0, 1::2] += 0.4
    walls[1] = (40.0, 20.0, 40.0, 80.0)
    found = scored(walls)
    assert (found["found"], found["false"], len(np.array(found["missing"]))) == (3, 1, 1)
    # Of two opposite walls one is off by 0.4 in: each by half of it.
    np.testing.assert_allclose(sorted(np.array(found["offsets_in"])), (0.0, 0.2, 0.2), atol=1e-9)


def test_walls_behind_others_are_not_visible() -> None:
    walls = np.array([[0.0, 0.0, 40.0, 0.0], [0.0, 20.0, 40.0, 20.0], [0.0, 30.0, 40.0, 30.0]])
    samples = visible_samples(walls, np.array([[20.0, 10.0]]))
    assert len(samples[0]) == len(samples[1]) == 40
    assert len(samples[2]) < 20


def test_sonars_wheels_and_readings_are_disturbed() -> None:
    log = drive()
    assert np.array_equal(disturbed(log, "", 3).encoders, log.encoders)
    # 1. Each sonar by a constant, within the rounding; readings at the limits stay there.
    error = disturbed(log, "offsets", 3).readings_in - log.readings_in
    inside = (log.readings_in > 10.0) & (log.readings_in < 250.0)
    of_each = [error[inside & (log.sonars == sonar)] for sonar in range(16)]
    assert max(np.ptp(part) for part in of_each) <= 1.0
    assert 0.5 < np.std([part.mean() for part in of_each]) < 1.6
    # 2. Distances 3 %, turns 2 % too large.
    worn = disturbed(log, "wheels", 3).encoders
    sizes = [np.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum() for rows in (worn, log.encoders)]
    assert sizes[0] / sizes[1] == pytest.approx(1.03, abs=1e-6)
    turns = [np.abs(wrap_angle(np.diff(rows[:, 3]))).sum() for rows in (worn, log.encoders)]
    assert turns[0] / turns[1] == pytest.approx(1.02, abs=1e-6)
    np.testing.assert_allclose(wrap_angle(worn[:, 4] - worn[:, 3]), 0.0, atol=1e-9)
    # 3. A fifth of the readings.
    changed = disturbed(log, "readings", 3).readings_in != log.readings_in
    assert changed.mean() == pytest.approx(0.2, abs=0.03)


def a_score(trial: Trial, **values: Any) -> Score:
    sound = {
        "duration_s": 200.0, "walls": 4, "found": 4, "false": 0, "missing": [], "precision": 1.0, "offsets_in": [0.1],
        "angles_deg": [0.1], "ends_in": [0.1], "z": [1.0], "seen": 1.0, "path_in": 0.2, "odometry_in": 9.0,
        "refused": "", "seconds": 5.0, "true_map_in": 0.3, "own_map_in": 0.32,
    }  # fmt: skip
    return Score(trial, **{**sound, **values})


def test_table_has_a_column_for_each_setup() -> None:
    scores = [a_score(TRIAL), a_score(TRIAL._replace(setup="worn"), path_in=4.0, found=3)]
    rows = {row[0]: row[1:] for row in table(scores)}
    assert rows["requirement"] == ["required", "measured", "worn"]
    assert rows["thesis_room, centre_vertex: runs with all walls"] == ["99 %", "1 of 1", "0 of 1"]
    assert rows["runs with a path RMSE above 3 in"] == ["0", "0", "1"]


def test_table_counts_closed_loops_and_wrong_maps() -> None:
    there_and_back = Trial("corridor", "measured", 1)
    scores = [
        a_score(there_and_back, closing_in=0.5, odometry_closing_in=90.0),
        a_score(there_and_back, closing_in=7.0, odometry_closing_in=30.0),
        a_score(there_and_back, closing_in=40.0, odometry_closing_in=60.0, refused="the path crosses a wall"),
        a_score(Trial("hall", "measured", 1), closing_in=1.5, odometry_closing_in=60.0),
    ]
    rows = {row[0]: row[2] for row in table(scores)}
    assert rows["loops of 40 m there and back closed"] == "1 of 3"
    assert rows["loops of 34 m around four pillars closed"] == "1 of 1"
    assert rows["corridor: the others written"] == "1"
    assert rows["corridor: closing error, median, worst (in)"] == "7.00, 40.00"
    assert rows["corridor: that of the odometry (in)"] == "60.00, 90.00"


def test_worlds_without_waypoints_are_explored_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        mapping.main(["--worlds", "thesis_room", "flat", "empty_flat", "--out", str(tmp_path)])
    assert "flat and empty_flat have no waypoints: add --explore" in capsys.readouterr().err


def test_rooms_of_the_empty_flat_are_connected_by_doors() -> None:
    world = mapping.world_of("empty_flat")
    cells = np.ones((118, 88), dtype=np.bool_)
    centres = 4.0 * np.argwhere(cells) + 2.0
    cells.flat[:] = nearest_points(centres, world.walls)[1].min(axis=1) > N150.radius_in
    rooms, _ = label(cells)
    # The start, the room on the loop, the corridor, and both rooms beyond it; with the doors closed they are not.
    places = np.array([(63, 79), (350, 70), (240, 177), (100, 300), (370, 300)]) // 4
    assert len(set(rooms[tuple(places.T)].tolist()) - {0}) == 1
    doors = np.array([(157, 148, 195, 148), (315, 148, 352, 148), (79, 205, 116, 205), (374, 205, 411, 205),
                      (234, 47, 234, 85)])  # fmt: skip
    assert lengths(doors).tolist() == [38.0, 37.0, 37.0, 37.0, 38.0]
    closed = np.concatenate((world.walls, doors))
    cells.flat[:] = nearest_points(centres, closed)[1].min(axis=1) > N150.radius_in
    assert len(set(label(cells)[0][tuple(places.T)].tolist())) == 5


def test_results_of_earlier_runs_are_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    score = a_score(TRIAL, missing=[[1.0, 2.0]])
    (tmp_path / "earlier.json").write_text(json.dumps([asdict(score)]), encoding="utf-8")
    assert read_scores(tmp_path / "earlier.json") == [score]
    # The only trial was run already.
    mapping.main(["--worlds", "thesis_room", "--seeds", "1", "--first", "1", "--add", str(tmp_path / "earlier.json"),
                  "--out", str(tmp_path)])  # fmt: skip
    assert "1 of 1" in capsys.readouterr().out


@pytest.mark.long
def test_trial_finds_the_room(monkeypatch: pytest.MonkeyPatch) -> None:
    # Along all four walls once, and half of the second drive.
    monkeypatch.setitem(mapping.TOURS, "thesis_room", mapping.TOURS["thesis_room"][:7])
    monkeypatch.setitem(mapping.FRESH_TOURS, "thesis_room", mapping.FRESH_TOURS["thesis_room"][:2])
    _, found = mapping.run(Trial("thesis_room", "measured", 100))
    assert (found.found, found.walls, found.false) == (4, 4, 0)
    assert found.path_in < 0.5
    assert found.own_map_in - found.true_map_in < 0.3
    rows = mapping.summarize([found])
    assert ["thesis_room, centre_vertex: runs with all walls", "99 %", "1 of 1"] in rows


def test_true_wall_of_a_surface_is_its_best_straight_line() -> None:
    trial = Trial("thesis_room", "building", 3)
    walls, surfaces = load_world("thesis_room").walls, trial.surfaces
    assert surfaces is not None
    assert lines_beside(walls, None, np.zeros((2, 2))) is walls
    # Beside a part of the wall at the bottom, from x = 20 to 80: the mean of its surface there, 10 places to an inch.
    lines = lines_beside(walls, surfaces, np.array([[80.0, -9.0], [20.0, -9.0]]))
    low = int(np.argmin(walls[:, 1] + walls[:, 3]))
    x1, y1, x2, y2 = walls[low]
    x = np.arange(20.05, 80.0, 0.1)
    level = float(surfaces.of(walls[low]).level_in(np.abs(x - x1)).mean()) * np.sign(x2 - x1)  # to the left of the wall
    np.testing.assert_allclose(lines[low], (x1, y1 + level, x2, y2 + level), atol=0.1)
    # The plane is no such line.
    assert np.abs(lines[low] - walls[low]).max() > 0.2


def test_ends_of_shifted_walls_are_where_they_meet() -> None:
    # Two corners, a wall that ends in the middle of another one, and its free end.
    walls = np.array([(0.0, 0.0, 10.0, 0.0), (10.0, 0.0, 10.0, 8.0), (4.0, 0.0, 4.0, 5.0), (10.0, 8.0, 6.0, 8.0)])
    lines = walls + np.array([(0.0, 1.0) * 2, (-0.5, 0.0) * 2, (0.25, 0.0) * 2, (0.0, 0.0) * 2])
    found = corners_of(walls, lines)
    assert {tuple(place) for place in found.tolist()} == {
        (0.0, 1.0), (9.5, 1.0), (9.5, 8.0), (4.25, 1.0), (4.25, 5.0), (6.0, 8.0),
    }  # fmt: skip
    # Walls that are not shifted end where they did.
    assert {tuple(place) for place in corners_of(walls, walls).tolist()} == {
        tuple(place) for place in walls.reshape(-1, 2).tolist()
    }


def test_parts_of_a_wall_end_where_their_own_lines_do() -> None:
    """A wall of 10 in stands out by 3 in in its left half, and was learned as two; the right one is longer."""
    walls = np.array([(0.0, 0.0, 10.0, 0.0), (10.0, 0.0, 10.0, 8.0), (10.0, 8.0, 0.0, 8.0), (0.0, 8.0, 0.0, 0.0)])
    right, left = walls[0], walls[0] + (0.0, 3.0, 0.0, 3.0)
    placed = [
        (0, right, np.array([(4.0, 0.0), (10.0, 0.0)])), (0, left, np.array([(0.0, 3.0), (4.0, 3.0)])),
        (3, walls[3], np.array([(0.0, 8.0), (0.0, 3.0)])),
    ]  # fmt: skip
    ends = {(0.0, 3.0): (left, 0), (10.0, 0.0): (right, 0), (0.0, 2.5): (walls[3], 3)}
    off = [
        distance_to_corner(walls, walls, placed, number, line, np.array(end)) for end, (line, number) in ends.items()
    ]
    assert off == [0.0, 0.0, 0.5]
    # A corner of a part that was not learned is that of the straight walls.
    assert distance_to_corner(walls, walls, [], 2, walls[2], np.array((0.0, 9.0))) == 1.0
    # A wall that ends in the middle of a part ends at its line, however near the ends of another part are.
    inner = np.vstack((walls, (3.5, 0.0, 3.5, 4.0)))
    parts = [
        (0, right, np.array([(3.0, 0.0), (10.0, 0.0)])), (0, left, np.array([(0.0, 3.0), (3.0, 3.0)])),
    ]  # fmt: skip
    assert distance_to_corner(inner, inner, parts, 4, inner[4], np.array((3.5, 0.25))) == 0.25


def test_learned_spots_are_fitted_to_the_surfaces() -> None:
    """Oracle: spots of the true surfaces, in a frame turned and shifted by known numbers; one of six is of no wall."""
    walls, surfaces = load_world("several_walls").walls, Trial("several_walls", "building", 3).surfaces
    assert surfaces is not None
    spots = []
    for wall in walls:
        along = (wall[2:] - wall[:2]) / lengths(wall)
        at = np.arange(2.0, float(lengths(wall)) - 2.0, 4.0)
        level = surfaces.of(wall).level_in(at)
        level[::6] += 4.0
        spots.append(wall[:2] + at[:, None] * along + level[:, None] * np.array((-along[1], along[0])))
    placed, turn, shift = np.concatenate(spots), 0.3, np.array((5.0, -3.0))
    of_map = rotate(placed - shift, np.full(len(placed), -turn))
    found_turn, found_shift = surface_fit(of_map, walls, surfaces, turn + 0.01, shift + 0.7)
    assert found_turn == pytest.approx(turn, abs=1e-3)
    np.testing.assert_allclose(found_shift, shift, atol=0.05)


@pytest.mark.long
def test_walls_with_surfaces_are_mapped_as_they_are_measured(tmp_path: Path) -> None:
    trial = Trial("thesis_room", "building", 3, 150.0)
    driven = mapping.drive(trial, mapping.TOURS["thesis_room"], tmp_path)
    estimate = learn_map(driven.log, THESIS_ODOMETRY, trial.sonar)
    found, trajectory = describe(estimate), estimate.problem.trajectory
    numbers = score(trial, driven, found, trajectory.instants_s, trajectory.odometry[:, :2])
    assert found.reason_to_refuse() == ""
    assert (numbers["found"], numbers["false"]) == (4, 0)
    assert max(numbers["offsets_in"]) < 0.5
    assert np.abs(numbers["z"]).max() < 3.0
    assert numbers["path_in"] < 0.3
    # Levels, where the walls have them: the spots are on the true surface, but for cells that have two levels.
    walls, surfaces = load_world("thesis_room").walls, trial.surfaces
    assert surfaces is not None
    true_path = driven.truth_at(trajectory.instants_s)[:, :2]
    spots = np.concatenate([wall.surface[:, :2] for wall in found.walls])
    turn, shift = surface_fit(spots, walls, surfaces, *rigid_fit(found.path[:, :2], true_path))
    off = rotate(spots, np.full(len(spots), turn)) + shift - walls[:, None, :2]
    along = (walls[:, 2:] - walls[:, :2]) / lengths(walls)[:, None]
    at, beside = (off * along[:, None]).sum(axis=-1), along[:, :1] * off[..., 1] - along[:, 1:] * off[..., 0]
    levels = np.stack([
        surfaces.of(wall).level_in(np.clip(of_wall, 0.0, lengths(wall)))
        for wall, of_wall in zip(walls, at, strict=True)
    ])  # fmt: skip
    errors_in = np.abs(beside - levels).min(axis=0)
    assert np.median(errors_in) < 0.2
    assert (errors_in < 0.5).mean() > 0.85
    assert np.std(estimate.state.levels.value_in) > 0.8


def test_outline_counts_as_closed_where_its_box_is() -> None:
    times = np.arange(len(PATH), dtype=np.float64)
    driven = Drive(drive(), np.column_stack((times, PATH, np.zeros(len(PATH)))))
    turn, shift = 0.7, np.array((30.0, -20.0))
    room = learned(mapping.BOX_ROOM.walls, turn, shift)
    numbers = []
    for off in (0.0, 0.9, 3.0):
        corners = np.array(mapping.BOX_ROOM.obstacles[1].corners_in)[::-1] + np.array((off, 0.0))
        back = rotate(corners - shift, np.full(4, -turn))
        found = replace(room, outlines=(Outline(back, ()),))
        result = score(TRIAL._replace(world="boxes"), driven, found, times, PATH)
        numbers.append((result["boxes"], result["closed"], result["false_outlines"]))
    assert numbers == [(2, 1, 0), (2, 1, 0), (2, 0, 1)]


@pytest.mark.long
def test_boxes_that_a_robot_passes_have_closed_outlines(tmp_path: Path) -> None:
    around = ((60, 26), (70, 24), (122, 22), (122, 70), (78, 76), (72, 96), (22, 92), (22, 50), (66, 44), (68, 70))
    driven = mapping.drive(Trial("boxes", "measured", 3), around, tmp_path)
    estimate = learn_map(driven.log, THESIS_ODOMETRY, ConeSonar())
    found, trajectory = describe(estimate), estimate.problem.trajectory
    numbers = score(
        TRIAL._replace(world="boxes"), driven, found, trajectory.instants_s, trajectory.odometry[:, :2]
    )  # fmt: skip
    assert (numbers["closed"], numbers["false_outlines"], numbers["false"]) == (2, 0, 0)
    # A picture has them as well.
    draw_learned(tmp_path / "boxes.png", found, estimate)
    assert (tmp_path / "boxes.png").stat().st_size > 10_000
