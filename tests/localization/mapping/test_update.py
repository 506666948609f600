"""Differences between a map and a drive: one drive of the tests' own simulation, and maps that differ from its room."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from localization.filters.belief import Floats
from localization.mapping import update
from localization.mapping.association import MapEstimate
from localization.mapping.output import MapRefused
from localization.mapping.update import Change, MapDifference, compare
from localization.mapping.walls import Piece, extract_walls
from nclient.cli import main
from tests.localization.mapping.drives import LAP, ROOM
from worlds.io import format_world, load_world
from worlds.validate import validate_world
from worlds.world import StartPose, SurfaceSpot, WallAccuracy, World

WALLS: Floats = np.array([[*one, *other] for one, other in zip(ROOM, ROOM[1:] + ROOM[:1], strict=True)])
START: Floats = np.array((*LAP[0], 0.0))


def world_of(walls: Floats) -> World:
    return World("room", inner_walls=walls, starts=(StartPose(*LAP[0]),))


def differences(walls: Floats, estimate: MapEstimate, start: Floats = START) -> MapDifference:
    return compare(world_of(walls), estimate, start, np.zeros(3))


def test_drive_confirms_the_map(estimate: MapEstimate) -> None:
    found = differences(WALLS, estimate, START + (1.0, -1.0, 0.03))  # noqa: RUF005
    assert found.is_empty
    assert found.unchanged == (0, 1, 2, 3)
    np.testing.assert_allclose(found.world.walls, WALLS, atol=1e-3)
    # The lap ends near where it began.
    np.testing.assert_allclose(found.pose[:2], LAP[-1], atol=3.0)


@pytest.mark.parametrize(("echoes", "changes"), [(0, []), (9, ["new"])])
def test_walls_without_echoes_are_no_change(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch, echoes: int, changes: list[str]
) -> None:
    # Such as the end of a thick wall: here 5 in on the line of a wall, 200 in beyond it.
    pieces = extract_walls(estimate)
    along = (pieces[0].ends[1] - pieces[0].ends[0]) / pieces[0].length_in
    start = pieces[0].high + 200.0
    ends = pieces[0].ends[1] + np.outer((200.0, 205.0), along)
    end = replace(pieces[0], low=start, high=start + 5.0, ends=ends, echoes=echoes)
    monkeypatch.setattr(update, "extract_walls", lambda _: [*pieces, end])
    assert [change.kind for change in differences(WALLS, estimate).changes] == changes


def test_wall_has_moved_with_its_corners(estimate: MapEstimate) -> None:
    # In the map the wall on the right is 8 in nearer than in the room.
    before = np.where(WALLS == 120.0, 112.0, WALLS)
    found = differences(before, estimate)
    (change,) = found.changes
    assert (change.kind, change.row, found.scale) == ("moved", 1, 1.0)
    assert abs(change.by_in) == pytest.approx(8.0, abs=0.8)
    np.testing.assert_allclose(found.world.walls, WALLS, atol=1.0)
    assert validate_world(found.world, 9.7) == []


SURFACE = (SurfaceSpot(61.2, -1.0, 0.2), SurfaceSpot(10.2, -1.0, 0.2))


def with_surfaces(walls: Floats) -> World:
    """Return a world with a spot 1 in behind the middle of its first wall, and elsewhere of its second one."""
    return replace(world_of(walls), accuracies={row: WallAccuracy(0.1, 0.0, 90.0, SURFACE) for row in (0, 1)})


def test_surfaces_stay_on_walls_that_become_shorter(estimate: MapEstimate) -> None:
    # In the map all is 2 % too large.
    found = compare(with_surfaces(1.02 * WALLS), estimate, START, np.zeros(3))
    assert found.scale == pytest.approx(1.0 / 1.02, abs=2e-3)
    middle, near_the_end = found.world.accuracies[0].surface
    assert middle == pytest.approx((60.0, -1.0, 0.2), abs=0.1)
    assert near_the_end == pytest.approx((10.0, -1.0, 0.2), abs=0.1)


def test_walls_that_moved_have_the_surface_of_the_drive(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    # In the map the wall on the right is 8 in nearer; on the drive a spot is 1.5 in beside the middle of each wall.
    before = np.where(WALLS == 120.0, 112.0, WALLS)

    def with_spot(piece: Piece) -> Piece:
        along = (piece.ends[1] - piece.ends[0]) / piece.length_in
        middle = piece.ends.mean(axis=0) + 1.5 * np.array((-along[1], along[0]))
        return replace(piece, surface=np.array([[*middle, 0.3]]))

    pieces = [with_spot(piece) for piece in extract_walls(estimate)]
    monkeypatch.setattr(update, "extract_walls", lambda _: pieces)
    found = compare(with_surfaces(before), estimate, START, np.zeros(3))
    assert [(change.kind, change.row) for change in found.changes] == [("moved", 1)]
    kept, moved = (found.world.accuracies[row].surface[0] for row in (0, 1))
    assert kept == pytest.approx(SURFACE[0])
    off = abs(moved.x_in - found.world.walls[1, 0])
    assert (off, moved.std_in) == pytest.approx((1.5, 0.3), abs=0.1)


def test_wall_that_paths_cross_is_missing(estimate: MapEstimate) -> None:
    found = differences(np.concatenate((WALLS, [(60.0, 0.0, 60.0, 60.0)])), estimate)
    (change,) = found.changes
    assert (change.kind, change.row, change.after) == ("missing", 4, None)
    np.testing.assert_allclose(found.world.walls, WALLS, atol=1e-3)


def test_surface_of_a_missing_part_is_gone() -> None:
    # From 50 to 70 in the drive has passed through the wall.
    spots = tuple(SurfaceSpot(x, -1.0, 0.2) for x in (10.0, 30.0, 60.0, 90.0, 110.0))
    world = replace(world_of(WALLS), accuracies={0: WallAccuracy(0.1, 0.0, 90.0, spots)})
    change = Change("missing", 0, np.array([50.0, 0.0, 70.0, 0.0]), None)
    after, accuracies, _ = update._changed(world, WALLS.copy(), [change], {0: [(50.0, 70.0)]})
    surfaces = [accuracies[row].surface for row in (0, 1)]
    assert [[spot.x_in for spot in surface] for surface in surfaces] == [[10.0, 30.0], [90.0, 110.0]]
    assert after[:2].tolist() == [[0.0, 0.0, 50.0, 0.0], [70.0, 0.0, 120.0, 0.0]]


def test_walls_keep_their_names(estimate: MapEstimate) -> None:
    # The wall in the middle is missing, so that the rows of those after it change; its name goes with it.
    walls = np.concatenate(([(60.0, 0.0, 60.0, 60.0)], WALLS))
    named = replace(world_of(walls), wall_names={0: "screen", 2: "window side", 4: "door side"})
    found = compare(named, estimate, START, np.zeros(3))
    assert [change.kind for change in found.changes] == ["missing"]
    assert found.world.wall_names == {1: "window side", 3: "door side"}


def test_wall_beyond_the_map_is_new(estimate: MapEstimate) -> None:
    found = differences(WALLS[:3], estimate)
    (change,) = found.changes
    assert (change.kind, change.row, change.before) == ("new", -1, None)
    np.testing.assert_allclose(np.sort(found.world.walls[3]), np.sort(WALLS[3]), atol=1.0)
    assert found.world.accuracies[3].offset_std_in > 0.0


def test_rest_of_a_missing_wall_is_not_seen(estimate: MapEstimate) -> None:
    # It goes on behind the wall of the room, where nothing can be measured.
    found = differences(np.concatenate((WALLS, [(60.0, 0.0, 60.0, 200.0)])), estimate)
    assert {(change.kind, change.row) for change in found.changes} == {("missing", 4)}
    assert (found.unchanged, found.unseen) == ((0, 1, 2, 3), (4,))


def test_hidden_wall_is_not_seen(estimate: MapEstimate) -> None:
    found = differences(np.concatenate((WALLS, [(130.0, 0.0, 130.0, 60.0)])), estimate)
    assert (found.changes, found.unseen) == ((), (4,))


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_scale_error_is_found_and_mended(estimate: MapEstimate, factor: float) -> None:
    found = differences(factor * WALLS, estimate, factor * START)
    assert found.changes == ()
    assert found.scale == pytest.approx(1.0 / factor, abs=0.008)
    np.testing.assert_allclose(found.world.walls, WALLS, atol=1.0)
    assert "scale" in "".join(found.lines())


def test_wrong_start_is_refused(estimate: MapEstimate) -> None:
    with pytest.raises(MapRefused, match="start"):
        differences(WALLS, estimate, START + (300.0, 0.0, 0.8))  # noqa: RUF005


def test_command_proposes_and_applies_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # 1. A map of the room with a wall too much; the drive begins at the start of both.
    room = load_world("thesis_room")
    more = World("old", inner_walls=np.concatenate((room.walls, [(30.0, -8.0, 30.0, 20.0)])), starts=room.starts)
    old, new, picture = tmp_path / "old.toml", tmp_path / "new.toml", tmp_path / "changes.png"
    old.write_text(format_world(more))
    start = room.starts[0]
    drive_there = ["--waypoints", "60,0", "60,60", "0,60", "--time-limit", "50"]
    address = f"sim:thesis_room?setup=measured&seed=5&start={start.x_in:g},{start.y_in:g}"
    assert main.main(["map", "update", str(old), address, *drive_there, "--out", str(new), "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert [change["kind"] for change in found["changes"]] == ["missing"]
    # 2. The recording of this drive with the map that it has made.
    arguments = ["map", "update", str(new), "--from", str(tmp_path / "new.log"), "--picture", str(picture)]
    again = [*arguments, "--start", f"{start.x_in:g},{start.y_in:g},0"]
    assert main.main(again) == 0
    assert "0 changes" in capsys.readouterr().out
    assert picture.stat().st_size > 10_000
    assert main.main([*arguments, "--start", "500,500,45"]) == 4
