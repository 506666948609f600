"""Worlds: free places, clearance, refused starts, and changing obstacles."""

from __future__ import annotations

import re
from dataclasses import FrozenInstanceError
from math import hypot, inf, nan

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from nclient.errors import StartError
from worlds.geometry import FloatArray
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150
from worlds.world import MARGIN_IN, Path, Polygon, StartPose, World

ROOM = Polygon(((0.0, 0.0), (100.0, 0.0), (100.0, 80.0), (0.0, 80.0)), "hall")
CRATE = Polygon(((40.0, 30.0), (60.0, 30.0), (60.0, 50.0), (40.0, 50.0)), "crate")
WALL = np.array([[20.0, 0.0, 20.0, 10.0]])
WORLD = World("test", rooms=(ROOM,), inner_walls=WALL, obstacles=(CRATE,), starts=(StartPose(80.0, 60.0),))

FITS = re.compile(r"it fits at \((\S+), (\S+)\) in$")


def refusal(world: World, x: float, y: float, radius: float) -> str:
    with pytest.raises(StartError) as caught:
        world.require_free(x, y, radius)
    return str(caught.value)


def test_wall_order_is_fixed_and_arrays_are_read_only() -> None:
    assert WORLD.fixed_walls.tolist() == [*ROOM.segments().tolist(), *WALL.tolist()]
    assert WORLD.walls.tolist() == [*WORLD.fixed_walls.tolist(), *CRATE.segments().tolist()]
    for array in (WORLD.walls, WORLD.fixed_walls, WORLD.inner_walls):
        assert not array.flags.writeable
    with pytest.raises(FrozenInstanceError):
        WORLD.name = "other"  # type: ignore[misc]


def test_world_copies_its_arguments() -> None:
    walls = np.array([[0.0, 0.0, 1.0, 0.0]])
    paths = {"1": Path("a", "1", StartPose(0.0, 0.0), ((0.0, 0.0), (1.0, 1.0)))}
    world = World("copy", inner_walls=walls, paths=paths)
    walls[0, 0] = 9.0
    paths.clear()
    assert world.walls.tolist() == [[0.0, 0.0, 1.0, 0.0]]
    assert world.paths["1"].goals_in == ((1.0, 1.0),)


def test_obstacles_change_and_fixed_walls_keep_their_rows() -> None:
    empty = WORLD.with_obstacles([])
    assert empty.walls.tolist() == WORLD.fixed_walls.tolist()
    fuller = WORLD.with_obstacles([*WORLD.obstacles, CRATE.moved(0.0, -25.0)])
    # Five rows of the room and the inner wall, and four for each crate.
    assert len(fuller.walls) == 5 + 8
    assert fuller.walls[:9].tolist() == WORLD.walls.tolist()
    assert (fuller.name, fuller.starts, fuller.rooms) == (WORLD.name, WORLD.starts, WORLD.rooms)
    assert len(WORLD.walls) == 5 + 4


def test_a_moved_polygon_retains_its_shape_and_name() -> None:
    moved = CRATE.moved(1.0, -2.0)
    assert moved.corners_in[0] == (41.0, 28.0)
    assert moved.name == "crate"
    np.testing.assert_allclose(moved.segments() - CRATE.segments(), np.tile([1.0, -2.0], (4, 2)))


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        (10.0, 40.0, 10.0),
        (30.0, 40.0, 10.0),
        (17.0, 5.0, 3.0),
        (20.0, 13.0, 3.0),
        (-5.0, 40.0, -5.0),
        # Outside the clearance is negative: 3 in to the right and 4 in above a corner are 5 in away.
        (103.0, 84.0, -5.0),
        (50.0, 32.0, -2.0),
        (0.0, 40.0, 0.0),
    ],
    ids=["hall", "crate", "wall", "wall end", "outside", "beyond a corner", "in the crate", "on the outline"],
)
def test_clearance_is_distance_to_wall_negative_outside(
    x: float, y: float, expected: float
) -> None:
    assert WORLD.clearance(x, y) == pytest.approx(expected)


def test_without_walls_there_is_room_without_end() -> None:
    open_plain = World("plain")
    assert open_plain.clearance(1e4, 1e4) == inf
    open_plain.require_free(1e4, 1e4, 1e3)
    assert open_plain.walls.shape == (0, 4)


def test_walls_alone_enclose_nothing() -> None:
    lone = World("lone", inner_walls=WALL)
    assert lone.clearance(-100.0, 5.0) == pytest.approx(120.0)


def test_place_in_any_room_is_free() -> None:
    twin = Polygon(((100.0, 0.0), (200.0, 0.0), (200.0, 80.0), (100.0, 80.0)))
    both = World("both", rooms=(ROOM, twin))
    assert both.clearance(150.0, 40.0) == pytest.approx(40.0)
    assert both.clearance(250.0, 40.0) == pytest.approx(-50.0)


@given(st.floats(0.5, 99.5), st.floats(0.5, 79.5))
def test_clearance_agrees_with_sampled_walls_and_rays(x: float, y: float) -> None:
    clearance = abs(WORLD.clearance(x, y))
    # At most 0.1 in apart.
    dots = np.linspace(WORLD.walls[:, :2], WORLD.walls[:, 2:], 1001)
    nearest = float(np.hypot(dots[..., 0] - x, dots[..., 1] - y).min())
    # Dots 0.1 in apart: the nearest one is at most 0.05 in beside the nearest point.
    assert clearance - 1e-9 <= nearest <= hypot(clearance, 0.05) + 1e-9
    turns = np.linspace(0.0, 2.0 * np.pi, 90)
    ranges, _ = cast_rays((x, y), np.stack((np.cos(turns), np.sin(turns)), axis=-1), WORLD.walls)
    # No ray is shorter than the clearance.
    assert clearance <= ranges.min() + 1e-9


def test_start_that_just_touches_is_refused() -> None:
    WORLD.require_free(10.0, 40.0, 9.99)
    assert "touches" in refusal(WORLD, 10.0, 40.0, 10.0)


@pytest.mark.parametrize(
    ("x", "y", "says"),
    [
        (
            5.0,
            40.0,
            "the start (5, 40) in touches the outline of a room 'hall' (0, 80)-(0, 0): 5.00 in away, the robot's",
        ),
        (37.0, 40.0, "touches the obstacle 'crate' (40, 50)-(40, 30): 3.00 in away, the robot's radius is 9.72 in;"),
        (20.0, 12.0, "touches a wall (20, 0)-(20, 10): 2.00 in away"),
        (50.0, 40.0, "lies inside the obstacle 'crate';"),
        (-1.0, 40.0, "lies outside the world test, which spans x from 0 to 100 and y from 0 to 80 in;"),
        (0.0, 40.0, "(0, 80)-(0, 0): 0.00 in away"),
    ],
)
def test_refused_start_names_contact_and_free_place(x: float, y: float, says: str) -> None:
    message = refusal(WORLD, x, y, N150.radius_in)
    assert says in message
    fits = FITS.search(message)
    assert fits is not None
    WORLD.require_free(float(fits[1]), float(fits[2]), N150.radius_in)


@given(st.floats(-30.0, 130.0), st.floats(-30.0, 110.0), st.floats(1.0, 12.0))
def test_proposed_place_is_free(x: float, y: float, radius: float) -> None:
    assume(WORLD.clearance(x, y) <= radius)
    fits = FITS.search(refusal(WORLD, x, y, radius))
    assert fits is not None
    assert WORLD.clearance(float(fits[1]), float(fits[2])) > radius


@pytest.mark.parametrize(
    ("x", "y", "near_x", "near_y"),
    # The robot's radius and a margin away from the wall.
    [(5.0, 60.0, 9.72 + MARGIN_IN, 60.0), (9.5, 60.0, 9.72 + MARGIN_IN, 60.0), (2.0, 79.0, 9.82, 80.0 - 9.82)],
    ids=["off a wall", "off it by little", "out of a corner"],
)
def test_the_proposal_is_near_by_where_that_is_easy(x: float, y: float, near_x: float, near_y: float) -> None:
    fits = FITS.search(refusal(WORLD, x, y, 9.72))
    assert fits is not None
    assert float(fits[1]) == pytest.approx(near_x)
    assert float(fits[2]) == pytest.approx(near_y)


def test_start_of_world_is_proposed_in_cramped_cell() -> None:
    cell = Polygon(((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)))
    far = World("far", rooms=(cell, ROOM.moved(500.0, 0.0)), starts=(StartPose(10.0, 10.0), StartPose(550.0, 40.0)))
    assert "it fits at (550, 40) in" in refusal(far, 10.0, 10.0, 15.0)


def test_nothing_is_proposed_where_nothing_fits() -> None:
    assert "use a smaller robot" in refusal(WORLD, 50.0, 70.0, 60.0)


def test_an_obstacle_without_a_name_is_an_obstacle() -> None:
    nameless = WORLD.with_obstacles([Polygon(CRATE.corners_in)])
    assert "lies inside an obstacle;" in refusal(nameless, 50.0, 40.0, 1.0)
    assert "touches an obstacle (" in refusal(nameless, 39.5, 40.0, 1.0)


@pytest.mark.parametrize(("x", "y"), [(nan, 0.0), (0.0, inf)])
def test_a_start_that_is_no_number_is_no_place(x: float, y: float) -> None:
    assert "expected two finite numbers" in refusal(WORLD, x, y, 1.0)


def test_a_path_begins_at_its_start() -> None:
    path = Path("there", "5.4", StartPose(0.0, 0.0), ((0.0, 0.0), (60.0, 40.0), (1.0, 2.0)))
    assert path.goals_in == ((60.0, 40.0), (1.0, 2.0))


def test_clearances_of_many_points_are_those_of_each() -> None:
    block = Polygon(((30.0, 30.0), (40.0, 30.0), (40.0, 40.0), (30.0, 40.0)))
    outline = Polygon(((0.0, 0.0), (100.0, 0.0), (100.0, 80.0), (0.0, 80.0)))
    points = np.random.default_rng(2).uniform(-20.0, 120.0, (6, 50, 2))
    for world in (
        World("both", rooms=(outline,), obstacles=(block,)),
        World("block", obstacles=(block,)),
        World("walls", inner_walls=np.array([[0.0, 0.0, 50.0, 10.0]])),
    ):
        each = [[world.clearance(float(x), float(y)) for x, y in row] for row in points]
        np.testing.assert_allclose(world.clearances(points), each, atol=1e-12)
    assert World("nothing").clearances(points[0]).tolist() == [np.inf] * 50


def _square(number: int) -> Polygon:
    x = 20.0 * number
    return Polygon(((x, 0.0), (x + 10.0, 0.0), (x + 10.0, 10.0), (x, 10.0))[: 3 + number % 2], f"{number}")


@given(st.lists(st.integers(0, 9), max_size=8, unique=True), st.lists(st.integers(0, 9), max_size=8, unique=True))
def test_changed_obstacles_equal_a_world_built_anew(before: list[int], after: list[int]) -> None:
    squares = [_square(number) for number in range(10)]
    room = Polygon(((-50.0, -50.0), (500.0, -50.0), (500.0, 500.0), (-50.0, 500.0)))
    inner = np.array([(0.0, 100.0, 50.0, 100.0)])
    for rooms in ((room,), ()):
        world = World("test", "", rooms, inner, tuple(squares[number] for number in before))
        changed = world.with_obstacles(squares[number] for number in after)
        anew = World("test", "", rooms, inner, tuple(squares[number] for number in after))
        assert changed.obstacles == anew.obstacles
        assert not changed.walls.flags.writeable
        # The internal arrays, too: queries use them.
        for name in ("walls", "fixed_walls", "_edges", "_firsts"):
            np.testing.assert_array_equal(getattr(changed, name), getattr(anew, name))
        assert world.obstacles == tuple(squares[number] for number in before)


def test_an_added_obstacle_is_the_only_one_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    computed: list[str] = []
    segments = Polygon.segments

    def counted(polygon: Polygon) -> FloatArray:
        computed.append(polygon.name)
        return segments(polygon)

    # A thousand obstacles: a change must not compute all of them again.
    world = World("test", obstacles=tuple(_square(number) for number in range(1000)))
    monkeypatch.setattr(Polygon, "segments", counted)
    world = world.with_obstacles((*world.obstacles, _square(1000)))
    assert computed == ["1000"]
    world = world.with_obstacles(world.obstacles[1:])
    assert computed == ["1000"]
    world.with_obstacles((*world.obstacles[:500], _square(2000), *world.obstacles[501:]))
    assert computed == ["1000", "2000"]


def test_obstacles_are_found_by_a_corner() -> None:
    world = World("test", obstacles=tuple(_square(number) for number in range(10)))
    assert world.obstacles_with_corner(20.05, 0.0, 0.1) == [1]
    assert world.obstacles_with_corner(25.0, 0.0, 5.0) == [1]
    assert world.obstacles_with_corner(25.0, 5.0, 0.1) == []
    assert World("test").obstacles_with_corner(0.0, 0.0, 0.1) == []
