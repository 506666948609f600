"""Simplified worlds: fewer walls within the tolerance on any map."""

from __future__ import annotations

from itertools import pairwise
from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from worlds.cells import hausdorff_distance_in, simplify_world
from worlds.io import load_world, world_names
from worlds.world import Polygon, World

OUTLINE = Polygon(((0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (0.0, 100.0)), "hall")
NUMBER = st.floats(0.0, 40.0).map(lambda value: round(value, 2))
Wall = tuple[float, float, float, float]
WALL = st.tuples(NUMBER, NUMBER, NUMBER, NUMBER).filter(lambda wall: abs(wall[2] - wall[0]) + wall[3] > wall[1] + 0.1)


def room(*walls: tuple[float, float, float, float]) -> World:
    return World("room", rooms=(OUTLINE,), inner_walls=np.array(walls).reshape(-1, 4))


def test_walls_on_one_line_become_one() -> None:
    # Three walls on y = 50 that overlap or nearly touch, one behind a gap of 10 in, one at right angles.
    world = room((50, 50, 70, 50), (100, 50, 60, 50), (100.1, 50, 120, 50), (130, 50, 140, 50), (60, 60, 60, 80))
    walls = simplify_world(world, 0.5).inner_walls.tolist()
    assert sorted(sorted((wall[:2], wall[2:])) for wall in walls) == [
        [[50.0, 50.0], [120.0, 50.0]],
        [[60.0, 60.0], [60.0, 80.0]],
        [[130.0, 50.0], [140.0, 50.0]],
    ]


def test_connected_line_loses_nearly_straight_corners() -> None:
    bent = [(50.0, 50.0), (60.0, 50.1), (70.0, 49.9), (80.0, 50.0), (80.0, 70.0), (79.9, 80.0)]
    walls = [(*one, *other) for one, other in pairwise(bent)]
    simpler = simplify_world(room(*walls), 0.5).inner_walls
    # Corners within 0.1 in of a line vanish; the right angle stays.
    assert len(simpler) == 2
    assert hausdorff_distance_in(np.array(walls), simpler) < 0.5


def test_walls_that_meet_in_threes_stay_apart() -> None:
    # Removing a corner where three walls meet would open a gap.
    walls = [(50, 50, 60, 50), (60, 50, 70, 60), (60, 50, 70, 40)]
    assert len(simplify_world(room(*walls), 0.5).inner_walls) == 3


def test_outline_loses_nearly_straight_corners() -> None:
    bent = [(0.0, 0.0), (50.0, 0.1), (100.0, 0.0), (100.0, 50.0), (100.1, 80.0), (100.0, 100.0), (0.0, 100.0)]
    ring = Polygon((*bent, (0.1, 50.0)), "ring")
    (simpler,) = simplify_world(World("ring", rooms=(ring,)), 0.3).rooms
    assert list(simpler.corners_in) == [(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)]
    assert simpler.name == "ring"


def test_outline_that_would_vanish_stays() -> None:
    # All corners lie within the tolerance of one line: without them no outline would remain.
    sliver = Polygon(((0.0, 0.0), (50.0, 0.1), (100.0, 0.0), (50.0, -0.1)))
    (saved,) = simplify_world(World("sliver", obstacles=(sliver,)), 1.0).obstacles
    assert saved is sliver


@pytest.mark.long
@pytest.mark.parametrize("name", world_names())
def test_minimal_map_is_unchanged(name: str) -> None:
    world = load_world(name)
    simpler = simplify_world(world, 0.5)
    assert len(simpler.walls) == len(world.walls)
    assert hausdorff_distance_in(world.walls, simpler.walls) < 1e-9
    assert (simpler.starts, simpler.rooms) == (world.starts, world.rooms)


@given(st.lists(WALL, min_size=1, max_size=8), st.sampled_from([0.2, 1.0, 5.0]))
@settings(max_examples=60)
def test_no_wall_moves_farther_than_the_tolerance(walls: list[Wall], far_in: float) -> None:
    world = World("walls", inner_walls=np.array(walls))
    simpler = simplify_world(world, far_in)
    assert len(simpler.walls) <= len(walls)
    assert hausdorff_distance_in(world.walls, simpler.walls) <= far_in + 1e-9


@given(st.lists(st.floats(5.0, 40.0), min_size=3, max_size=24), st.sampled_from([0.2, 2.0, 10.0]))
@settings(max_examples=60)
def test_nor_does_an_outline(radii: list[float], far_in: float) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, len(radii), endpoint=False)
    pairs = zip(radii, angles.tolist(), strict=True)
    corners = tuple((radius * cos(angle), radius * sin(angle)) for radius, angle in pairs)
    world = World("star", rooms=(Polygon(corners),))
    simpler = simplify_world(world, far_in)
    assert hausdorff_distance_in(world.walls, simpler.walls) <= far_in + 1e-9
    assert len(simpler.rooms[0].corners_in) >= 3


def test_how_far_walls_are_apart_is_measured_from_both_sides() -> None:
    # From the end at 10 to the end at 4: the distance of sets must not depend on their order.
    one, other = np.array([[0.0, 0.0, 10.0, 0.0]]), np.array([[0.0, 0.0, 4.0, 0.0]])
    assert hausdorff_distance_in(one, other) == hausdorff_distance_in(other, one) == pytest.approx(6.0)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan")])
def test_a_tolerance_is_above_nothing(tolerance: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        simplify_world(room(), tolerance)
