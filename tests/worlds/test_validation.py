"""Validation of maps: gaps, doubled walls, crumbs, free space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from worlds.io import load_world, parse_world, world_names
from worlds.validate import ValidationLimits, find_free_space, validate_world
from worlds.world import Polygon, StartPose, SurfaceSpot, WallAccuracy, World

pytestmark = pytest.mark.long

RADIUS_IN = 9.0
OUTLINE = Polygon(((0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (0.0, 100.0)))


def room(*walls: tuple[float, float, float, float], starts: tuple[StartPose, ...] = (StartPose(30.0, 50.0),)) -> World:
    return World("room", rooms=(OUTLINE,), inner_walls=np.array(walls).reshape(-1, 4), starts=starts)


def kinds(world: World) -> list[str]:
    return [finding.kind for finding in validate_world(world, RADIUS_IN)]


@pytest.mark.parametrize("name", world_names())
def test_shipped_worlds_are_well(name: str) -> None:
    assert validate_world(load_world(name), 9.72) == []


def test_wall_end_short_of_wall_is_a_gap() -> None:
    (found,) = validate_world(room((100.0, 0.0, 100.0, 97.5)), RADIUS_IN, ValidationLimits(space_in2=1e9))
    assert found.kind == "gap"
    assert found.place_in == (100.0, 97.5)
    assert "stops 2.5 in short of (100, 100)" in found.words
    # 40 in are a door, and walls that meet have no gap.
    assert kinds(room((100.0, 0.0, 100.0, 60.0))) == []
    assert kinds(room((100.0, 0.0, 100.0, 60.0), (100.0, 60.0, 120.0, 60.0))) == []


def test_gap_closes_off_space_behind_it() -> None:
    gap, behind = validate_world(room((100.0, 0.0, 100.0, 97.5)), RADIUS_IN)
    assert (gap.kind, behind.kind) == ("gap", "closed off")
    area = float(behind.words.split()[0])
    # Places of the robot's centre: 9 in away from each wall, on both sides.
    assert area == pytest.approx((200 - 100 - 18) * (100 - 18), rel=0.05)
    assert behind.place_in[0] == pytest.approx(150.0, abs=2.0)


def test_a_door_as_wide_as_the_robot_is_a_path() -> None:
    # 22 in are wider than the robot's 18 in, 17 in are not.
    assert kinds(room((100.0, 0.0, 100.0, 78.0))) == []
    assert kinds(room((100.0, 0.0, 100.0, 83.0))) == ["closed off"]


@pytest.mark.parametrize(("depth_in", "has_room", "expected"), [
    (24.0, False, []), (24.0, True, ["closed off"]), (40.0, False, ["closed off"]),
])  # fmt: skip
def test_less_than_the_area_of_the_robot_at_the_edge_of_a_map_without_rooms_is_outside(
    depth_in: float, has_room: bool, expected: list[str]
) -> None:
    """Three walls stand at an outer wall, 30 in apart; it was measured beside them only, unless it is that of a room.

    The axis of the robot has 12 in between them, and their length less 9 in: 180 and 372 in^2; a disc has 254 in^2.
    """
    inner = [(85.0, 0.0, 85.0, depth_in), (85.0, depth_in, 115.0, depth_in), (115.0, depth_in, 115.0, 0.0)]
    _, *others = OUTLINE.segments().tolist()
    beside = [] if has_room else [(0.0, 0.0, 85.0, 0.0), (115.0, 0.0, 200.0, 0.0), *others]
    world = World(
        "own", rooms=(OUTLINE,) if has_room else (), inner_walls=np.array([*inner, *beside]),
        starts=(StartPose(30.0, 50.0),),
    )  # fmt: skip
    assert kinds(world) == expected


def test_closed_off_spaces_are_sorted_by_area() -> None:
    found = validate_world(room((70.0, 0.0, 70.0, 100.0), (160.0, 0.0, 160.0, 100.0)), RADIUS_IN)
    assert [finding.kind for finding in found] == ["closed off"] * 2
    assert found[0].place_in[0] == pytest.approx(115.0, abs=2.0)
    assert found[1].place_in[0] == pytest.approx(180.0, abs=2.0)


def test_ends_of_crumbs_and_doubled_walls_are_no_gaps() -> None:
    doubled = room((50.0, 50.0, 90.0, 50.0), (120.0, 50.2, 80.0, 50.2))
    assert [found.kind for found in validate_world(doubled, RADIUS_IN)] == ["doubled"]
    crumb = room((50.0, 50.0, 50.3, 50.0), (52.0, 50.0, 90.0, 50.0))
    assert [found.kind for found in validate_world(crumb, RADIUS_IN)] == ["crumb"]
    beside = room((50.0, 50.0, 90.0, 50.0), (120.0, 50.2, 80.0, 50.2), (70.0, 52.0, 70.0, 80.0))
    assert [found.kind for found in validate_world(beside, RADIUS_IN)] == ["gap", "doubled"]


def test_walls_over_one_another_are_doubled() -> None:
    (found,) = validate_world(
        room((50.0, 50.0, 90.0, 50.0), (120.0, 50.2, 80.0, 50.2)), RADIUS_IN, ValidationLimits(gap_in=0.1)
    )
    assert found.kind == "doubled"
    # The walls overlap from x = 80 to 90.
    assert found.place_in == (85.0, 50.0)
    assert "for 10 in, 0.2 in apart" in found.words
    # Walls end to end, walls 1 in apart, and walls at right angles are not doubled.
    limits = ValidationLimits(gap_in=0.1)
    assert validate_world(room((50.0, 50.0, 90.0, 50.0), (90.0, 50.0, 130.0, 50.0)), RADIUS_IN, limits) == []
    assert validate_world(room((50.0, 50.0, 90.0, 50.0), (60.0, 51.0, 80.0, 51.0)), RADIUS_IN, limits) == []
    assert validate_world(room((50.0, 50.0, 90.0, 50.0), (70.0, 50.0, 70.0, 30.0)), RADIUS_IN, limits) == []


def cupboard(x: float, y: float, width: float, depth: float) -> tuple[tuple[float, float, float, float], ...]:
    corners = ((x, y), (x + width, y), (x + width, y + depth), (x, y + depth))
    return tuple((*one, *other) for one, other in zip(corners, (*corners[1:], corners[0]), strict=True))


def test_cupboard_at_a_wall_is_no_doubled_wall() -> None:
    limits = ValidationLimits(space_in2=1e9)
    # A box at a wall shares one side with it: furniture, and no wall that was drawn twice.
    assert validate_world(room(*cupboard(120.0, 0.0, 40.0, 20.0)), RADIUS_IN, limits) == []
    assert validate_world(room(*cupboard(120.0, 80.0, 80.0, 20.0)), RADIUS_IN, limits) == [], "in a corner"
    drawn_twice = room(*cupboard(120.0, 40.0, 40.0, 20.0), *cupboard(120.0, 40.0, 40.0, 20.0))
    assert {found.kind for found in validate_world(drawn_twice, RADIUS_IN, limits)} == {"doubled"}
    room_twice = room(*cupboard(0.0, 0.0, 200.0, 100.0))
    assert {found.kind for found in validate_world(room_twice, RADIUS_IN, limits)} == {"doubled"}
    line = room((120.0, 0.0, 160.0, 0.0), (160.0, 0.0, 160.0, 20.0))
    assert [found.kind for found in validate_world(line, RADIUS_IN, limits)] == ["doubled"]


def test_crumbs_and_starts_without_room() -> None:
    world = room((50.0, 50.0, 50.2, 50.0), starts=(StartPose(30.0, 50.0), StartPose(195.0, 50.0)))
    found = validate_world(world, RADIUS_IN)
    assert [finding.kind for finding in found] == ["crumb", "start"]
    assert "0.2 in long" in found[0].words
    # 195 is 5 in from the wall at 200, and the radius is 9 in.
    assert "start 1 has 5 in of room" in found[1].words


def test_without_a_start_that_fits_all_is_closed_off() -> None:
    assert kinds(room(starts=(StartPose(1.0, 1.0),))) == ["start", "closed off"]


def test_wide_world_uses_coarser_grid_up_to_radius() -> None:
    hall = Polygon(((0.0, 0.0), (9000.0, 0.0), (9000.0, 6000.0), (0.0, 6000.0)))
    found = find_free_space(World("hall", rooms=(hall,), starts=(StartPose(30.0, 50.0),)), RADIUS_IN)
    # A finer grid would have too many cells; a coarser one than the radius would miss gaps.
    assert found.step_in == RADIUS_IN
    assert found.reached.sum() == found.fits.sum() > 100_000
    assert find_free_space(room(), RADIUS_IN, 50.0).step_in == RADIUS_IN


def test_obstacles_and_the_outside_are_no_space() -> None:
    block = Polygon(((80.0, 20.0), (120.0, 20.0), (120.0, 80.0), (80.0, 80.0)))
    world = World("block", rooms=(OUTLINE,), obstacles=(block,), starts=(StartPose(30.0, 50.0),))
    found = find_free_space(world, RADIUS_IN)
    # Every 37th cell, against the clearance of the world.
    for i, k in np.argwhere(found.fits).tolist()[::37]:
        assert world.clearance(float(found.xs[i]), float(found.ys[k])) >= RADIUS_IN
    for i, k in np.argwhere(~found.fits).tolist()[::37]:
        assert world.clearance(float(found.xs[i]), float(found.ys[k])) < RADIUS_IN


def test_missing_start_is_reported() -> None:
    far = parse_world("[[room]]\ncorners_in = [[100, 100], [200, 100], [200, 200], [100, 200]]\n", "far.toml", "far")
    output = [finding.words for finding in validate_world(far, 9.0) if finding.kind == "start"]
    assert output == [
        "no [[start]] is given, and (0, 0) lies outside of all rooms or in a wall; the robot's radius is 9 in"
    ]


def test_spots_of_a_surface_that_are_not_on_their_wall_are_found() -> None:
    """A wall moved by hand by 20 in, whose measured spots were left where they were."""
    walls = np.array([[20.0, 30.0, 80.0, 30.0], [20.0, 70.0, 80.0, 70.0]])
    surfaces = [tuple(SurfaceSpot(x, y, 0.1) for x in (30.0, 34.0, 38.0)) for y in (50.5, 71.5)]
    accuracies = {row: WallAccuracy(0.1, 0.0, 40.0, surface) for row, surface in enumerate(surfaces)}
    (found,) = validate_world(replace(room(), inner_walls=walls, accuracies=accuracies), RADIUS_IN)
    assert (found.kind, found.place_in) == ("surface", (30.0, 50.5))
    assert "3 of 3 measured spots are up to 20.5 in" in found.words
    # One that became shorter still leads through them.
    walls = np.array([[60.0, 50.0, 80.0, 50.0], [20.0, 70.0, 80.0, 70.0]])
    assert validate_world(replace(room(), inner_walls=walls, accuracies=accuracies), RADIUS_IN) == []
