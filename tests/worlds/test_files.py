"""World files: shipped worlds, the format, and error messages."""

from __future__ import annotations

import os
from math import radians
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nclient.errors import WorldFileError
from worlds.geometry import lengths, nearest_points
from worlds.io import load_world, parse_world, world_names
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150
from worlds.world import Polygon, StartPose

ROOM = "[[room]]\ncorners_in = [[0, 0], [10, 0], [10, 10], [0, 10]]\n"
SHIPPED = ("arena", "centre_vertex", "corridor", "flat", "hall", "maze", "office", "several_walls", "thesis_room",
           "two_rooms")  # fmt: skip


def complaint(text: str) -> str:
    """Return the error of parse_world on a text, without the leading file name."""
    with pytest.raises(WorldFileError) as caught:
        parse_world(text, "there/room.toml", "room")
    message = str(caught.value)
    assert message.startswith("there/room.toml: ")
    return message.removeprefix("there/room.toml: ")


# The shipped worlds


def test_the_shipped_worlds_are_listed() -> None:
    assert world_names() == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_world_is_found_by_name_or_path(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    worlds = [
        load_world(spelling) for spelling in (name, f"{name}.toml", f"worlds/{name}.toml", f"./worlds/{name}.toml")
    ]
    for world in worlds:
        assert world.name == name
        assert world.title != name
        np.testing.assert_array_equal(world.walls, worlds[0].walls)


@pytest.mark.parametrize("name", SHIPPED)
def test_n150_fits_at_starts_and_along_paths(name: str) -> None:
    world = load_world(name)
    for start in world.starts:
        world.require_free(start.x_in, start.y_in, N150.radius_in)
    for path in world.paths.values():
        assert (path.start.x_in, path.start.y_in) == path.points_in[0]
        for first, second in zip(path.points_in, path.points_in[1:], strict=False):
            legs = np.linspace(first, second, 200)
            # 200 points on each leg of a path: none is nearer to a wall than the robot's radius.
            assert nearest_points(legs, world.walls)[1].min() > N150.radius_in


def test_thesis_room_is_290_cm_square_with_its_figures() -> None:
    room = load_world("thesis_room")
    assert room.fixed_walls.tolist() == room.walls.tolist()
    np.testing.assert_allclose(lengths(room.walls) * 2.54, 290.0, atol=0.01)
    # The origin, where the paths begin, is 12 in from two walls.
    assert float(room.walls.min()) == -12.0
    assert {figure: path.points_in for figure, path in room.paths.items()} == dict.fromkeys(
        ("5.2", "5.4", "5.6"), ((0.0, 0.0), (60.0, 40.0))
    )


def test_worlds_of_figures_5_8_and_5_9() -> None:
    several, vertex = load_world("several_walls"), load_world("centre_vertex")
    assert several.inner_walls.tolist() == [
        [-12, 40, 10, 40],
        [50, -12, 50, 35],
        [60, 102.17, 60, 75],
        [75, 20, 102.17, 20],
    ]
    assert list(several.paths["5.8"].points_in) == [(5, 5), (35, 55), (90, 55)]
    assert vertex.inner_walls.tolist() == [[33, -12, 45, 20], [45, 20, 57, -12]]
    assert list(vertex.paths["5.9"].points_in) == [(10, 10), (60, 60), (70, 20)]


# The format

EVERYTHING = """
name = "everything"
title = "All there is"
[[room]]
name = "hall"
corners_m = [[0, 0], [2.54, 0], [2.54, 2.54], [0, 2.54]]
[[wall]]
points_cm = [[0, 127], [25.4, 127], [25.4, 101.6]]
[[obstacle]]
corners_in = [[50, 50], [60, 50], [60, 60]]
[[obstacle]]
name = "crate"
corners_in = [[80, 80], [90, 80], [85, 90]]
[[start]]
x_cm = 25.4
y_m = 0.508
steering_deg = 90
turret_deg = -45.0
[[start]]
x_in = 30
y_in = 40.5
[[path]]
name = "there and back"
start = 0
points_in = [[10, 20], [20, 20], [10, 20]]
[[path]]
figure = "9.9"
points_cm = [[25.4, 25.4], [50.8, 25.4]]
"""


def test_all_keys_are_read_in_inches_and_radians() -> None:
    world = parse_world(EVERYTHING, "e.toml", "e")
    assert (world.name, world.title) == ("everything", "All there is")
    assert world.rooms[0].name == "hall"
    np.testing.assert_allclose(world.rooms[0].corners_in, [(0, 0), (100, 0), (100, 100), (0, 100)])
    np.testing.assert_allclose(world.inner_walls, [[0, 50, 10, 50], [10, 50, 10, 40]])
    assert world.obstacles == (
        Polygon(((50, 50), (60, 50), (60, 60))),
        Polygon(((80, 80), (90, 80), (85, 90)), "crate"),
    )
    first, second = world.starts
    np.testing.assert_allclose((first.x_in, first.y_in), (10.0, 20.0))
    assert (first.steering_rad, first.turret_rad) == (radians(90), radians(-45))
    assert second == StartPose(30.0, 40.5)
    assert list(world.paths) == ["there and back", "9.9"]
    assert world.paths["there and back"].start is first
    assert world.paths["9.9"].name == "9.9"
    assert world.paths["9.9"].start == StartPose(*world.paths["9.9"].points_in[0])
    np.testing.assert_allclose(world.paths["9.9"].points_in, [(10, 10), (20, 10)])


def test_missing_keys_have_defaults() -> None:
    world = parse_world(ROOM, "some/place.toml", "place")
    assert (world.name, world.title, world.starts, dict(world.paths)) == ("place", "place", (StartPose(0.0, 0.0),), {})
    assert world.obstacles == ()
    assert world.inner_walls.shape == (0, 4)


def test_walls_alone_or_obstacles_alone_are_a_world() -> None:
    assert len(parse_world("[[wall]]\npoints_in = [[0, 0], [1, 1]]", "w.toml", "w").walls) == 1
    assert len(parse_world("[[obstacle]]\ncorners_in = [[0, 0], [1, 1], [0, 1]]", "w.toml", "w").walls) == 3


@given(st.floats(0.1, 900.0), st.sampled_from([("in", 1.0), ("cm", 2.54), ("m", 0.0254)]))
def test_a_length_is_the_same_in_every_unit(inches: float, unit: tuple[str, float]) -> None:
    side = inches * unit[1]
    world = parse_world(f"[[room]]\ncorners_{unit[0]} = [[0, 0], [{side!r}, 0], [0, {side!r}]]", "r.toml", "r")
    # The second wall leads from (s, 0) to (0, s): the ray along the diagonal meets it at s / sqrt(2).
    diagonal, _ = cast_rays((0.0, 0.0), (2**-0.5, 2**-0.5), world.walls[1:2])
    assert float(diagonal) == pytest.approx(inches / 2**0.5)


# What is wrong, and how it is stated


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[[wals]]\n", ["wals: unknown key; expected one of name, title, room,", "; did you mean wall?"]),
        ("size = 3\n" + ROOM, ["size: unknown key; expected one of"]),
        (
            ROOM + "[[wall]]\npionts_in = [[0, 0], [1, 1]]",
            ["wall[0].pionts_in: unknown key; expected one of points_in, points_cm, points_m,", "mean points_in?"],
        ),
        (ROOM + "[[wall]]\npoints_mm = [[0, 0], [1, 1]]", ["wall[0].points_mm: unknown key", "did you mean points_m?"]),
        (ROOM + "[[start]]\nx_in = 1\ny_in = 1\nsteering = 3", ["start[0].steering: unknown", "mean steering_deg?"]),
        (
            ROOM + "[[wall]]\n",
            ["wall[0].points_in: expected exactly one of points_in, points_cm, points_m, found none of them"],
        ),
        (
            ROOM + "[[start]]\nx_in = 1\nx_cm = 2.54\ny_in = 1",
            ["start[0].x_cm: expected exactly one of x_in, x_cm, x_m, found x_in and x_cm"],
        ),
        (ROOM + "[[start]]\nx_in = 1", ["start[0].y_in: expected exactly one of y_in, y_cm, y_m, found none of them"]),
    ],
)
def test_keys_that_are_unknown_missing_or_given_twice(text: str, parts: list[str]) -> None:
    message = complaint(text)
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[room]]\ncorners_in = [[0, 0], [1, 0]]", "room[0].corners_in: expected at least 3 points, found 2"),
        (
            ROOM + ROOM.replace("[10, 0]", "[10]"),
            "room[1].corners_in[1]: expected a point [x, y], found the list [10]",
        ),
        (ROOM.replace("[10, 0]", "7"), "room[0].corners_in[1]: expected a point [x, y], found 7"),
        (
            ROOM.replace("[10, 0]", '["a", 0]'),
            "room[0].corners_in[1][0]: expected a length, a number, found the text 'a'",
        ),
        (ROOM.replace("[10, 0]", "[10, true]"), "room[0].corners_in[1][1]: expected a length, a number, found true"),
        (
            ROOM.replace("[10, 0]", "[nan, 0]"),
            "room[0].corners_in[1][0]: expected a length, a finite number, found nan",
        ),
        (
            ROOM.replace("[10, 0]", "[0, -inf]"),
            "room[0].corners_in[1][1]: expected a length, a finite number, found -inf",
        ),
        (
            ROOM.replace("[10, 0]", f"[1{400 * '0'}, 0]"),
            "room[0].corners_in[1][0]: expected a length, a finite number, found a number of more than 30 digits",
        ),
        (
            "[[room]]\ncorners_m = [[0, 0], [9000, 0], [0, 1]]",
            "room[0].corners_m[1][0]: expected -2540 to 2540, found 9000; is the unit right?",
        ),
        (
            "[[wall]]\npoints_in = 3",
            "wall[0].points_in: expected a list of points [[x, y], ...], found 3",
        ),
        ("[[wall]]\npoints_in = [[1, 2]]", "wall[0].points_in: expected at least 2 points, found 1"),
        (
            "[[wall]]\npoints_in = [[1, 2], [3, 4], [3, 4]]",
            "wall[0].points_in[2]: is the same point as the one before; expected walls with a length",
        ),
        (
            "[[obstacle]]\ncorners_cm = [[0, 0], [9, 0], [9, 9], [0, 0]]",
            "obstacle[0].corners_cm[3]: is the first corner again; outlines close by themselves: leave it out",
        ),
        (
            "[[room]]\ncorners_in = [[0, 0], [9, 0], [9, 0], [0, 9]]",
            "room[0].corners_in[2]: is the same point as the one before; expected walls with a length",
        ),
        (
            "[[room]]\ncorners_in = [[0, 0], [9, 9], [9, 0], [0, 9]]",
            "room[0].corners_in: expected the corners in their order around, found edges 0 and 2 that cross",
        ),
        (
            "[[room]]\ncorners_in = [[0, 0], [9, 9], [18, 18]]",
            "room[0].corners_in: expected an outline around some area, found corners on one line",
        ),
        (
            "[room]\ncorners_in = [[0, 0], [9, 0], [0, 9]]",
            "room: expected tables under [[room]], each with its double brackets, found a table",
        ),
        ("wall = [3]", "wall[0]: expected tables under [[wall]], each with its double brackets, found 3"),
        (
            ROOM + "[[start]]\nx_in = 1\ny_in = 1\nturret_deg = '90'",
            "start[0].turret_deg: expected an angle in degrees, a number, found the text '90'",
        ),
        ("name = 3\n" + ROOM, "name: expected a text, found 3"),
        ("title = ' '\n" + ROOM, "title: expected a text, found the text ' '"),
        ("", "expected at least one [[room]], [[wall]] or [[obstacle]], found none"),
        ("room = []", "expected at least one [[room]], [[wall]] or [[obstacle]], found none"),
    ],
)
def test_values_that_cannot_be_used(text: str, message: str) -> None:
    assert complaint(text) == message


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("points_in = [[0, 0], [5, 5]]", "path[0].name: expected a name or a figure, found neither"),
        ("name = 'a'\npoints_in = [[0, 0]]", "path[0].points_in: expected at least 2 points, found 1"),
        (
            "name = 'a'\npoints_in = [[0, 0], [0, 0]]",
            "path[0].points_in[1]: is the same point as the one before; expected walls with a length",
        ),
        (
            "figure = '1'\nstart = 1\npoints_in = [[0, 0], [5, 5]]",
            "path[0].start: expected a whole number from 0 to 0, found 1",
        ),
        (
            "figure = '1'\nstart = false\npoints_in = [[0, 0], [5, 5]]",
            "path[0].start: expected a whole number, 0 or more, found false",
        ),
        (
            "figure = '1'\nstart = 0\npoints_cm = [[2.54, 0], [5, 5]]",
            "path[0].points_cm[0]: expected the place of start[0], (0, 0) in, found (1, 0) in",
        ),
        ("figure = 5.4\npoints_in = [[0, 0], [5, 5]]", "path[0].figure: expected a text, found 5.4"),
    ],
)
def test_paths_that_cannot_be_used(path: str, message: str) -> None:
    assert complaint(f"{ROOM}[[path]]\n{path}") == message


@pytest.mark.parametrize("key", ["figure", "name"])
def test_two_paths_cannot_share_a_key(key: str) -> None:
    path = f"[[path]]\n{key} = '7.1'\npoints_in = [[0, 0], [5, 5]]\n"
    assert complaint(ROOM + path + path) == f"path[1].{key}: '7.1' is used by an earlier path; expected another"


def test_invalid_toml_is_reported_with_its_line() -> None:
    assert "is no TOML: " in complaint(ROOM + "[[wall\n")
    assert "line 3" in complaint(ROOM + "[[wall\n")
    # As deep as this the parser exceeds the recursion limit; a number of 5001 digits exceeds that of int().
    assert complaint("x = " + 5000 * "[") == "is no TOML: nested too deeply"
    assert "is no TOML: " in complaint("x = 1" + 5000 * "0")


def outcome(text: str) -> str:
    """Return the world of a text or its WorldFileError, as text; any other error fails the test."""
    try:
        return str(parse_world(text, "x.toml", "x"))
    except WorldFileError as error:
        return str(error)


@given(st.text(max_size=200))
# Any other exception fails the test: a file can only be a world or a WorldFileError.
def test_random_text_is_a_world_or_a_file_error(text: str) -> None:
    assert outcome(text).startswith(("x.toml: ", "World("))


keys = st.sampled_from(["name", "corners_in", "points_cm", "x_in", "y_m", "start", "turret_deg", "figure", "points_in"])
values = st.recursive(
    st.one_of(
        st.integers(), st.floats().map(repr), st.booleans().map(lambda flag: str(flag).lower()), st.just("'text'")
    ),
    lambda inner: st.lists(inner, max_size=4).map(lambda rows: f"[{', '.join(map(str, rows))}]"),
    max_leaves=12,
)


KINDS = ["room", "wall", "obstacle", "door", "walker", "start", "path"]


@given(st.sampled_from(KINDS), st.dictionaries(keys, values, max_size=4))
def test_random_table_is_a_world_or_a_file_error(kind: str, table: dict[str, object]) -> None:
    rows = "\n".join(f"{key} = {value}" for key, value in table.items())
    assert outcome(f"{ROOM}[[{kind}]]\n{rows}").startswith(("x.toml: ", "World("))


# Files


def test_a_file_anywhere_is_read_by_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "attic.toml"
    # With a byte order mark and the line ends of Windows.
    file.write_text("\ufeff" + ROOM.replace("\n", "\r\n"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for spelling in (file, str(file), "attic.toml", "./attic.toml"):
        assert load_world(spelling).name == "attic"


def test_existing_path_is_read_and_bare_name_is_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "worlds").mkdir()
    # A file and a folder in the current folder with names of shipped worlds.
    (tmp_path / "worlds" / "thesis_room.toml").write_text("name = 'mine'\n" + ROOM)
    (tmp_path / "thesis_room").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_world("worlds/thesis_room.toml").name == "mine"
    assert load_world("thesis_room").name == "thesis_room"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("thesis_rom", "; did you mean thesis_room?"),
        ("worlds/thesisroom.toml", "; did you mean thesis_room?"),
        ("elsewhere/thesis_room.toml", "; did you mean thesis_room?"),
        ("zzz", "expected a path or one of arena, centre_vertex"),
        ("", "'': no such file"),
        ("a\0b", "no such file"),
    ],
)
def test_a_world_that_is_nowhere_is_reported_which_there_are(name: str, says: str) -> None:
    with pytest.raises(WorldFileError) as caught:
        load_world(name)
    assert says in str(caught.value)
    assert str(caught.value).startswith(name)
    assert ", ".join(SHIPPED) in str(caught.value)


def test_a_directory_and_a_pipe_are_no_world_files(tmp_path: Path) -> None:
    with pytest.raises(WorldFileError, match="found a directory"):
        load_world(tmp_path)
    # Reading a FIFO without a writer would wait without end.
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(WorldFileError, match=r"pipe\.toml: .*regular file"):
        load_world(tmp_path / "pipe.toml")


def test_bytes_that_are_no_utf_8_are_reported_where(tmp_path: Path) -> None:
    file = tmp_path / "latin.toml"
    file.write_bytes(b"name = 'caf\xe9'\n")
    with pytest.raises(WorldFileError, match=r"latin\.toml: .*UTF-8.* 11: "):
        load_world(file)


def test_unreadable_file_is_reported_with_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> bytes:
        raise PermissionError(13, "Permission denied")

    file = tmp_path / "locked.toml"
    file.write_text(ROOM)
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(WorldFileError, match=r"locked\.toml: .*Permission denied"):
        load_world(file)


def test_too_long_file_name_is_a_world_file_error() -> None:
    with pytest.raises(WorldFileError):
        load_world("x" * 5000)


@pytest.mark.parametrize(
    ("lines", "place"),
    [
        ("[[start]]\nx_in = 1\ny_in = 1\n[[start]]\nx_in = 50\ny_in = 5\n", r"start\[1\]: .*found \(50, 5\) in"),
        ('[[path]]\nname = "p"\npoints_in = [[0, 0], [90, 90]]\n', r"path\[0\]: .*found \(90, 90\) in"),
    ],
)
def test_start_or_path_point_outside_is_a_file_error(lines: str, place: str) -> None:
    room = "[[room]]\ncorners_in = [[-20, -20], [40, -20], [40, 40], [-20, 40]]\n"
    with pytest.raises(WorldFileError, match=place):
        parse_world(room + lines, "hall.toml", "hall")
