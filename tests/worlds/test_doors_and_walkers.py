"""Doors and walkers in world files: units, defaults, what is refused, and that they are written and drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nclient.errors import StartError, WorldFileError
from worlds.io import format_world, load_world, parse_world
from worlds.raycast import cast_ray
from worlds.validate import validate_world
from worlds.world import MAX_DOORS, MAX_ROUTE_POINTS, MAX_WALKERS, Door, Polygon, Walker, World, world_svg

HALVES = """
[[room]]
corners_in = [[0, 0], [200, 0], [200, 100], [0, 100]]
[[wall]]
points_in = [[100, 0], [100, 30]]
[[wall]]
points_in = [[100, 70], [100, 100]]
[[start]]
x_in = 30
y_in = 50
"""
DOOR = '[[door]]\nname = "gate"\npoints_in = [[100, 30], [100, 70]]\n'
WALKER = "[[walker]]\npoints_cm = [[50.8, 127], [355.6, 127]]\n"


def halves(text: str = "") -> World:
    """Return a hall that a wall with a gap divides, with more tables."""
    return parse_world(HALVES + text, "halves.toml", "halves")


def test_doors_and_walkers_have_units_and_defaults() -> None:
    world = halves(DOOR + WALKER + 'speed_m = 0.762\nradius_cm = 12.7\nclosed = true\nname = "Ada"\n' + WALKER)
    assert world.doors == (Door("gate", ((100.0, 30.0), (100.0, 70.0))),)
    first, second = world.walkers
    # 50.8 cm = 20 in, 355.6 cm = 140 in, 127 cm = 50 in.
    np.testing.assert_allclose(first.points_in, [(20, 50), (140, 50)])
    assert (first.speed_in_s, first.radius_in) == pytest.approx((30.0, 5.0))
    assert (first.name, first.is_closed) == ("Ada", True)
    assert second == Walker(first.points_in)


def test_closed_doors_are_walls_and_open_ones_nothing() -> None:
    closed = halves(DOOR)
    opened = halves(DOOR + "open = true\n")
    # From x = 30 to the door at 100, or through it to the wall at 200.
    for world, range_in in ((closed, 70.0), (opened, 170.0)):
        assert cast_ray(30.0, 50.0, 1.0, 0.0, world.walls)[0] == pytest.approx(range_in)
    assert len(closed.fixed_walls) == len(opened.fixed_walls) == len(opened.walls)
    with pytest.raises(StartError, match="gate"):
        closed.require_free(95.0, 50.0, 9.0)
    # Rows of obstacles do not depend on doors.
    thing = Polygon(((10.0, 10.0), (20.0, 10.0), (20.0, 20.0)))
    for world in (closed.with_obstacles([thing]), replace(closed, obstacles=(thing,))):
        # Nine rows of walls and obstacles come first; the row of the closed door is the last one.
        np.testing.assert_array_equal(world.walls[:9], replace(opened, obstacles=(thing,)).walls)
        np.testing.assert_array_equal(world.walls[9], [100, 30, 100, 70])
        np.testing.assert_array_equal(world.with_obstacles(()).walls, closed.walls)


@pytest.mark.parametrize("name", ["two_rooms"])
def test_written_world_is_the_same(name: str) -> None:
    world = load_world(name)
    again = parse_world(format_world(world), "again.toml", name)
    assert (again.doors, again.walkers) == (world.doors, world.walkers)
    picture = world_svg(world)
    assert picture.count("dasharray") == 2
    assert validate_world(world, 9.0) == []


@pytest.mark.long
def test_space_behind_a_closed_door_is_not_closed_off() -> None:
    assert validate_world(halves(DOOR), 9.0) == []
    # The same line as a fixed wall closes off the half without a start.
    assert validate_world(halves(DOOR.replace('[[door]]\nname = "gate"', "[[wall]]")), 9.0) != []


def test_blocked_routes_are_written_as_comments() -> None:
    world = halves(WALKER).with_obstacles([Polygon(((60.0, 40.0), (70.0, 40.0), (70.0, 60.0)))])
    text = format_world(world)
    assert "# omitted because something stands on the route" in text
    assert parse_world(text, "again.toml", "again").walkers == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DOOR.replace("[100, 70]]", "[100, 70], [120, 70]]"), "door.0..points_in: expected the two ends"),
        (DOOR.replace("[100, 70]", "[100, 30]"), "the same point"),
        (DOOR + DOOR, "used by an earlier door"), (DOOR.replace('"gate"', '""'), "door.0..name"),
        # The route is 20 in from the nearest wall, less than a radius of 31 in; 609.6 cm are 240 in, outside the
        # room.
        (WALKER + "speed_m = 0", "more than 0"), (WALKER + "radius_in = 31", "clear of walls"),
        (WALKER.replace("355.6, 127", "355.6, 50"), "clear of walls"),
        (WALKER.replace("355.6", "609.6"), "clear of walls"),
        (f"[[walker]]\npoints_in = {[[20 + k % 2, 50] for k in range(MAX_ROUTE_POINTS + 1)]}", "points"),
        (WALKER + "radius_cm = 0.01\n", "shorter route"),
        (DOOR * (MAX_DOORS + 1), "door: expected at most"), (WALKER * (MAX_WALKERS + 1), "walker: expected at most"),
    ],
)  # fmt: skip
def test_wrong_doors_and_walkers_are_refused(text: str, words: str) -> None:
    with pytest.raises(WorldFileError, match=words):
        halves(text)
