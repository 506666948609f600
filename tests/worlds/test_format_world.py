"""Worlds written to files: they read back equal; starts and paths without space are left out with a note."""

from __future__ import annotations

import numpy as np
import pytest

from nclient.errors import WorldFileError
from worlds.io import format_world, load_world, parse_world, world_names
from worlds.world import (
    Path,
    Polygon,
    StartPose,
    SurfaceSpot,
    WallAccuracy,
    World,
    WorldState,
    moved_surface,
    spots_beside,
)


def same(one: World, other: World) -> None:
    assert (one.name, one.title, one.rooms, one.obstacles) == (other.name, other.title, other.rooms, other.obstacles)
    assert np.array_equal(one.walls, other.walls)
    assert np.array_equal(one.inner_walls, other.inner_walls)
    for mine, theirs in zip(one.starts, other.starts, strict=True):
        assert mine.x_in == theirs.x_in
        assert mine.y_in == theirs.y_in
        assert mine.steering_rad == pytest.approx(theirs.steering_rad)
        assert mine.turret_rad == pytest.approx(theirs.turret_rad)
    assert list(one.paths) == list(other.paths)
    for path, another in zip(one.paths.values(), other.paths.values(), strict=True):
        assert (path.name, path.figure, path.points_in) == (another.name, another.figure, another.points_in)
        assert path.start.steering_rad == pytest.approx(another.start.steering_rad)


@pytest.mark.parametrize("name", world_names())
def test_every_world_that_is_shipped_comes_back(name: str) -> None:
    world = load_world(name)
    same(parse_world(format_world(world), "again.toml", "again"), world)


def test_unicode_names_and_exact_numbers_round_trip() -> None:
    name = 'a "room" \\ of\n\ttwo \x7f lines ü 🤖'
    # Numbers without a short decimal form must come back exactly.
    room = Polygon(((0.1, -7.0), (1 / 3 + 90, -7.0), (90.0, 1e2), (0.0, 100.0)), name)
    world = World("w", "Über 🤖", (room,), np.array([[10.0, 10.0, 20.0, 1 / 7]]), starts=(StartPose(0.0, 0.0),))
    again = parse_world(format_world(world), "again.toml", "again")
    same(again, world)
    assert "[[start]]" not in format_world(world)


def test_a_world_without_a_title_is_called_by_its_name() -> None:
    world = World("w", "", (Polygon(((0.0, 0.0), (9.0, 0.0), (9.0, 9.0))),))
    assert parse_world(format_world(world), "", "").title == "w"


def test_blocked_starts_and_paths_are_left_out_of_file() -> None:
    room = Polygon(((0.0, 0.0), (90.0, 0.0), (90.0, 90.0), (0.0, 90.0)))
    starts = (StartPose(10.0, 10.0), StartPose(50.0, 50.0, 0.7))
    paths = {
        "short": Path("short", "", starts[0], ((10.0, 10.0), (20.0, 10.0))),
        "5.1": Path("long", "5.1", starts[1], ((50.0, 50.0), (60.0, 60.0))),
    }
    # The obstacle stands on the first start, and on the path that begins there.
    thing = Polygon(((9.0, 9.0), (11.0, 9.0), (11.0, 11.0)))
    text = format_world(World("w", "", (room,), obstacles=(thing,), starts=starts, paths=paths))
    again = parse_world(text, "again.toml", "again")
    (start,) = again.starts
    assert start.x_in == 50.0
    assert start.steering_rad == pytest.approx(0.7)
    assert list(again.paths) == ["5.1"]
    assert again.paths["5.1"].start.steering_rad == pytest.approx(0.7)
    assert "# omitted because an obstacle stands there: a start at 10.0, 10.0" in text
    assert '# omitted because an obstacle stands on it: the path "short"' in text


def test_joined_walls_are_one_line_below_comment() -> None:
    walls = np.array([[1, 50, 5, 50], [5, 50, 5, 60], [7, 70, 9, 70]], dtype=np.float64)
    world = World("w", "", (Polygon(((0.0, 0.0), (90.0, 0.0), (90.0, 90.0), (0.0, 90.0))),), walls,
                  starts=(StartPose(30.0, 30.0),))  # fmt: skip
    text = format_world(world, "of mine\ntwice")
    assert text.startswith("# of mine\n# twice\nname = ")
    assert "points_in = [[1.0, 50.0], [5.0, 50.0], [5.0, 60.0]]" in text
    assert "points_in = [[7.0, 70.0], [9.0, 70.0]]" in text
    same(parse_world(text, "again.toml", "again"), parse_world(format_world(world), "", ""))


def test_measured_walls_keep_their_accuracy() -> None:
    walls = np.array([[0, 0, 50, 0], [50, 0, 50, 60], [5, 90, 9, 90]], dtype=np.float64)
    accuracies = {0: WallAccuracy(0.25, 0.01, 40.0), 1: WallAccuracy(0.5, 0.02, 0.0)}
    world = World("w", "", inner_walls=walls, starts=(StartPose(20.0, 30.0),), accuracies=accuracies)
    again = parse_world(format_world(world), "again.toml", "again")
    # Walls without one come first.
    np.testing.assert_allclose(again.inner_walls, walls[[2, 0, 1]])
    assert sorted(again.accuracies) == [1, 2]
    for row, accuracy in accuracies.items():
        assert again.accuracies[row + 1][:3] == pytest.approx(accuracy[:3])
    # 2.54 cm = 1 in.
    in_cm = "[[wall]]\npoints_in = [[0, 0], [9, 0], [9, 9]]\noffset_std_cm = 2.54\n[[start]]\nx_in = 5\ny_in = 5\n"
    for without in ("angle_std_deg = 1", "measured_m = 2"):
        with pytest.raises(WorldFileError, match=r"wall\[0\]\.offset_std_in"):
            parse_world(in_cm.replace("offset_std_cm = 2.54", without), "", "w")
    again = parse_world(in_cm, "", "w")
    assert [again.accuracies[row].offset_std_in for row in (0, 1)] == pytest.approx([1.0, 1.0])


SURFACE = (SurfaceSpot(8.0, -1.25, 0.2), SurfaceSpot(12.0, 0.5, 0.3))


def test_measured_surface_of_a_wall_is_kept() -> None:
    walls = np.array([[0, 0, 50, 0], [50, 0, 50, 60]], dtype=np.float64)
    accuracies = {0: WallAccuracy(0.25, 0.01, 40.0, SURFACE), 1: WallAccuracy(0.5, 0.02, 0.0)}
    world = World("w", "", inner_walls=walls, starts=(StartPose(20.0, 30.0),), accuracies=accuracies)
    text = format_world(world)
    assert "surface_in = [[8.0, -1.25, 0.2], [12.0, 0.5, 0.3]]" in text
    again = parse_world(text, "again.toml", "again")
    assert [again.accuracies[row].surface for row in (0, 1)] == [SURFACE, ()]
    # Each number has the unit of the key.
    in_cm = text.replace("surface_in = [[8.0, -1.25, 0.2], [12.0, 0.5, 0.3]]", "surface_cm = [[2.54, -5.08, 0.254]]")
    (spot,) = parse_world(in_cm, "again.toml", "again").accuracies[0].surface
    assert spot == pytest.approx((1.0, -2.0, 0.1))


@pytest.mark.parametrize(
    ("text", "words"),
    [("points_in = [[0, 0], [9, 0]]\nsurface_in = [[1, 0, 0.1]]", r"wall\[0\]\.offset_std_in: expected it beside"),
     ("points_in = [[0, 0], [9, 0], [9, 9]]\noffset_std_in = 1\nsurface_in = [[1, 0, 0.1]]",
      r"wall\[0\]\.surface_in: expected it of a wall between two points, found one of 3 points"),
     ("points_in = [[0, 0], [9, 0]]\noffset_std_in = 1\nsurface_m = [[0, 0, 1], [0, 0, -1]]",
      r"wall\[0\]\.surface_m: expected standard deviations of 0 or more, that of spot 1 is below"),
     ("points_in = [[0, 0], [9, 0]]\noffset_std_in = 1\nsurface_in = [[1, 0]]", r"a spot \[x, y, standard deviation\]"),
     ("points_in = [[0, 0], [9, 0]]\noffset_std_in = 1\nsurface_in = []", "spot")],
)  # fmt: skip
def test_wrong_surfaces_are_refused(text: str, words: str) -> None:
    with pytest.raises(WorldFileError, match=words):
        parse_world(f"[[wall]]\n{text}\n[[start]]\nx_in = 5\ny_in = 5\n", "", "w")


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.5])
def test_surface_moves_with_its_wall(angle: float) -> None:
    """Oracle: fractions of the length of both walls, and distances from them."""
    begin, length = np.array([7.0, 9.0]), 52.0
    along, left = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    surface = (*SURFACE, SurfaceSpot(1.0, 2.0, 0.1), SurfaceSpot(49.0, -3.0, 0.1))
    found = moved_surface(surface, [0.0, 0.0, 50.0, 0.0], [*begin, *(begin + length * along)])
    for (x, y, std_in), spot in zip(surface, found, strict=True):
        off = np.array(spot[:2]) - begin
        assert (off @ along / length, off @ left, spot.std_in) == pytest.approx((x / 50.0, y, std_in))
    assert moved_surface((), [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]) == ()


def test_spots_beside_a_wall_are_those_between_its_ends() -> None:
    places = (-0.5, 30.0), (0.5, 31.0), (32.0, 26.0), (43.5, 30.0), (45.0, 30.0)
    spots = [SurfaceSpot(x, y, 0.1) for x, y in places]
    assert spots_beside(spots, (2.0, 30.0, 42.0, 30.0)) == tuple(spots[1:4])
    assert spots_beside(spots, (42.0, 30.0, 2.0, 30.0)) == tuple(spots[1:4])


def test_impossible_surfaces_of_a_state_are_refused() -> None:
    walls = np.array([[0, 0, 50, 0]], dtype=np.float64)
    good = World("w", inner_walls=walls, accuracies={0: WallAccuracy(0.1, 0.0, 0.0, SURFACE)})
    assert WorldState.of(good).world().accuracies == good.accuracies
    for wrong in (SurfaceSpot(8.0, 0.0, -0.1), SurfaceSpot(1e6, 0.0, 0.1), SurfaceSpot(8.0, float("nan"), 0.1)):
        state = WorldState.of(World("w", inner_walls=walls, accuracies={0: WallAccuracy(0.1, 0.0, 0.0, (wrong,))}))
        with pytest.raises(ValueError, match="accuracy"):
            state.world()
