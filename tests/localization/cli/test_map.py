"""`nomad map`, complete runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from localization.cli.map import _note, _thinned
from localization.mapping.aliases import Alias
from nclient.cli import main
from worlds.io import load_world
from worlds.validate import FreeSpace

# A room with a corner that is not one, two walls that overlap from 55 to 60, and a gap of 3 in to the outline.
ROOM = """
[[room]]
corners_in = [[0, 0], [200, 0], [200, 50.1], [200, 100], [0, 100]]
[[wall]]
points_in = [[100, 0], [100, 60]]
[[wall]]
points_in = [[100, 55], [100, 97]]
[[start]]
x_in = 30
y_in = 50
"""


@pytest.fixture
def room(tmp_path: Path) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(ROOM)
    return str(path)


@pytest.mark.long
def test_check_reports_problems_and_places(room: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["map", "check", room]) == 3
    lines = capsys.readouterr().out.splitlines()
    problems = [line for line in lines if not line.startswith(("alike", "note"))]
    # The gap at (100, 97), the overlap, and the half that no robot reaches without a door.
    assert [line.split("(")[0].strip() for line in problems] == ["gap", "doubled", "closed off"]
    assert main.main(["map", "check", room, "--gap", "1", "--json"]) == 3
    found = [finding for finding in json.loads(capsys.readouterr().out) if finding["kind"] != "alike"]
    # A gap of 3 in is wider than --gap 1: it is no mistake of drawing any more.
    assert [finding["kind"] for finding in found] == ["doubled", "closed off"]
    assert found[0]["place_in"] == [100.0, 57.5]


@pytest.mark.long
def test_check_of_valid_map_reports_no_problems(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["map", "check", "several_walls"]) == 0
    assert capsys.readouterr().out == "several_walls: 8 walls, no problems\n"


def test_check_notes_places_that_look_alike(capsys: pytest.CaptureFixture[str]) -> None:
    """A square room looks the same from four places; that is no problem of the map."""
    assert main.main(["map", "check", "thesis_room", "--at", "20,35", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["kind"] == "alike"
    # The corners of the room are at -15 and 105.17: quarter turns about its middle.
    middle = 45.085
    assert {tuple(round(value) for value in pose) for pose in found["poses"]} == {
        (round(middle + x), round(middle + y), heading)
        for x, y, heading in [(-25.1, -10.1, 0), (10.1, -25.1, 90), (25.1, 10.1, 180), (-10.1, 25.1, 270)]
    }
    assert main.main(["map", "check", "thesis_room"]) == 0
    assert "note: " in capsys.readouterr().out.splitlines()[-1]
    assert main.main(["map", "check", "several_walls", "--at", "30,60"]) == 0
    assert "no other place" in capsys.readouterr().out


def test_headings_of_alike_places_are_below_360() -> None:
    # 6.28 rad and -1.5 rad are shown as 0 and 274 degrees.
    alias = Alias(np.array([1.0, 2.0, -0.001]), (np.array([3.0, 4.0, 6.28]), np.array([5.0, 6.0, -1.5])))
    assert _note(alias).words == "at 0 deg looks like (3, 4) at 0 deg, (5, 6) at 274 deg"


def test_show_takes_a_coarser_grid_of_a_large_floor(capsys: pytest.CaptureFixture[str]) -> None:
    """The number of positions bounds the time: a flat takes 2 s with a thousand."""
    assert main.main(["map", "show", "flat", "--sonars", "rays", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert 500 < shown["places"] <= 1000
    assert 8.0 < shown["cell_in"] < 12.0


def test_a_floor_beyond_the_grid_of_the_radius_is_thinned() -> None:
    """Steps of a flood are no longer than the radius; places shown are farther apart."""
    space = FreeSpace(np.arange(5.0), np.arange(7.0), 1.0, np.ones((5, 7), bool), np.eye(5, 7, dtype=bool))
    thin = _thinned(space, 2)
    assert (thin.xs.tolist(), thin.ys.tolist(), thin.step_in) == ([0, 2, 4], [0, 2, 4, 6], 2.0)
    assert thin.fits.shape == (3, 4)
    assert (thin.reached == np.eye(3, 4, dtype=bool)).all()


def test_simplify_writes_a_world_with_fewer_walls(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "simple.toml"
    assert main.main(["map", "simplify", room, "--tolerance", "0.2", "--out", str(out)]) == 0
    # The nearly straight corner of the outline, and one of the two walls that overlap.
    assert "7 walls became 5" in capsys.readouterr().out
    assert len(load_world(out).walls) == 5
    assert main.main(["map", "simplify", room, "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["walls"] == 5
    assert main.main(["map", "simplify", room, "--out", str(out / "x.toml")]) == 1
    assert "cannot be written" in capsys.readouterr().err
    assert main.main(["map", "simplify", room, "--out", str(tmp_path / "made" / "x.toml")]) == 0


@pytest.mark.long
def test_show_reports_the_bound_and_draws_it(room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "deep" / "map.png"
    assert main.main(["map", "show", room, "--out", str(picture), "--cell", "6"]) == 0
    out = capsys.readouterr().out
    assert "position   best 0." in out
    assert "weak       0.0%" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main.main(["map", "show", "thesis_room", "--cell", "9", "--sonars", "rays", "--json"]) == 0
    rays = json.loads(capsys.readouterr().out)
    assert rays["places"] > 50
    assert 0.0 < rays["best_in"] <= rays["median_in"] <= rays["worst_in"] < 0.5
    assert main.main(["map", "show", "thesis_room", "--cell", "9", "--weak", "0.1", "--json"]) == 0
    cones = json.loads(capsys.readouterr().out)
    # Cones carry less information than rays.
    assert cones["median_in"] > rays["median_in"]
    assert cones["weak_share"] > 0.9


def test_show_needs_a_start_that_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    narrow = tmp_path / "narrow.toml"
    narrow.write_text("[[room]]\ncorners_in = [[0, 0], [50, 0], [50, 15], [0, 15]]\n[[start]]\nx_in = 9\ny_in = 9\n")
    assert main.main(["map", "show", str(narrow)]) == 1
    assert "nomad map check" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["map"], ["map", "shew", "x"], ["map", "simplify", "x"], ["map", "check"]])
def test_wrong_usage_exits_2(words: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main.main(words)
    assert stop.value.code == 2


LEARNED = """
[[wall]]
points_in = [[0, 0], [100, 0]]
offset_std_in = 0.05
[[wall]]
points_in = [[100, 0], [100, 80], [0, 80]]
offset_std_in = 0.1
angle_std_deg = 0.1
[[wall]]
points_in = [[0, 80], [0, 0]]
offset_std_in = 0.1
[[start]]
x_in = 30
y_in = 30
"""


def test_edit_adjusts_a_map_to_taped_lengths(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = tmp_path / "room.toml", tmp_path / "better.toml"
    before.write_text(LEARNED)
    words = ["map", "edit", str(before), "--out", str(after), "--length", " 0.5,-1", "100,0", "100.4"]
    assert main.main([*words, "--length", "0,0", "0,80", "80"]) == 0
    assert "80 in: 80.00 in the map now" in capsys.readouterr().out
    world = load_world(after)
    # 100.4 in measured, with a certain tape, against 100 in the map with its own deviations: a weighted mean.
    assert world.inner_walls[0, 2] - world.inner_walls[0, 0] == pytest.approx(100.285, abs=0.005)
    assert world.accuracies[1].offset_std_in < 0.1
    assert main.main([*words, "--json", "--tape-std", "0.01"]) == 0
    assert json.loads(capsys.readouterr().out)["moved_in"] == pytest.approx(0.238, abs=0.002)


def test_edit_names_walls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = tmp_path / "before.toml", tmp_path / "after.toml"
    before.write_text(LEARNED)
    assert main.main(["map", "edit", str(before), "--out", str(after), "--label", "50,2", 'the "north" side']) == 0
    world = load_world(after)
    assert world.wall_names == {0: 'the "north" side'}
    assert world.accuracies == load_world(before).accuracies
    assert main.main(["map", "edit", str(after), "--out", str(before), "--label", "50,2", ""]) == 0
    assert load_world(before).wall_names == {}
    assert main.main(["map", "edit", str(after), "--out", str(before), "--label", "50,40", "far"]) == 1
    assert "no inner wall" in capsys.readouterr().err
    # Nothing to be edited is wrong usage.
    with pytest.raises(SystemExit):
        main.main(["map", "edit", str(after), "--out", str(before)])


@pytest.mark.parametrize(
    ("length", "code", "words"),
    # The tape says 200 in where the map has 100 with a deviation of a tenth.
    [(("0,0", "100,0", "200"), 1, "contradicts"), (("0,0", "100,0", "-1"), 2, "--length 0,0"),
     (("0", "100,0", "100"), 2, "--length 0 "), (("50,50", "100,0", "70"), 1, "no wall ends")],
)  # fmt: skip
def test_edit_refuses_wrong_lengths(
    length: tuple[str, ...], code: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = tmp_path / "room.toml"
    before.write_text(LEARNED)
    ended = 0
    try:
        ended = main.main(["map", "edit", str(before), "--out", str(tmp_path / "x.toml"), "--length", *length])
    except SystemExit as error:
        ended = int(error.code or 0)
    assert ended == code
    assert words in capsys.readouterr().err
