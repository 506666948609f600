"""Occupancy grids: walls out of cells, cells out of walls."""

from __future__ import annotations

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from worlds import cells as cells_module
from worlds.cells import (
    Cell,
    GridWalls,
    OccupancyGrid,
    braille_picture,
    cells_of_world,
    hausdorff_distance_in,
    roomiest_place,
    walls_of_cells,
)
from worlds.geometry import area, nearest_points, polyline_segments
from worlds.io import load_world
from worlds.world import Polygon, StartPose, World


def grid(*rows: str, size_in: float = 2.0) -> OccupancyGrid:
    """Return a grid from rows, the top one first: '.' free, '#' occupied, '?' unknown."""
    codes = {".": Cell.FREE, "#": Cell.OCCUPIED, "?": Cell.UNKNOWN}
    # Row 0 of the array is the lowest one, and its first index is x.
    return OccupancyGrid(np.array([[codes[c] for c in row] for row in rows[::-1]], dtype=np.uint8).T, size_in)


def segments(found: GridWalls) -> np.typing.NDArray[np.float64]:
    return np.concatenate([polyline_segments(line) for line in found.walls])


@pytest.mark.long
def test_room_of_cells_becomes_its_four_walls() -> None:
    found = walls_of_cells(grid("#####", "#...#", "#...#", "#####"), 1.8, min_cells=1)
    (line,) = found.walls
    assert (line[0] == line[-1]).all()
    # The border between free and occupied cells of 2 in: from 2 to 8 and from 2 to 6.
    assert {tuple(corner) for corner in line.tolist()} == {(2.0, 2.0), (8.0, 2.0), (8.0, 6.0), (2.0, 6.0)}
    # Free space is on the left: counter-clockwise.
    assert area(line[:-1]) == pytest.approx(24.0)
    assert found.apart_in < 1e-12
    assert found.open_in == 0.0


def test_pillar_becomes_a_clockwise_outline() -> None:
    room = ["#########", *["#.......#"] * 3, "#...#...#", *["#.......#"] * 3, "#########"]
    outer, pillar = sorted(walls_of_cells(grid(*room), 1.8, min_cells=1).walls, key=lambda line: -area(line[:-1]))
    # 7 x 7 free cells around one occupied cell, 4 square inches each; the outline of a hole is clockwise, with a
    # negative area.
    assert area(outer[:-1]) == pytest.approx(49 * 4.0)
    assert area(pillar[:-1]) == pytest.approx(-4.0)


def test_border_to_unknown_cells_is_open() -> None:
    room = grid("#######", "#......", "#....??", "#....??", "#######")
    found = walls_of_cells(room, 1.8, min_cells=1)
    assert all((line[0] != line[-1]).any() for line in found.walls)
    # Three edges at the top right beside the grid's border and the unknown cells, less those next to occupied cells.
    assert found.open_in > 0.0
    closed = walls_of_cells(room, 1.8, min_cells=1, close_open_ends=True)
    assert closed.open_in == 0.0
    assert all((line[0] == line[-1]).all() for line in closed.walls)


def test_small_spots_are_ignored() -> None:
    room = ["##########", *["#........#"] * 3, "#...#....#", *["#........#"] * 3, "##########"]
    # One occupied cell is a spot below two cells, and a pillar from one cell on.
    assert len(walls_of_cells(grid(*room), 1.8, min_cells=2).walls) == 1
    assert len(walls_of_cells(grid(*room), 1.8, min_cells=1).walls) == 2
    # Free spots outside of the room likewise.
    spots = walls_of_cells(grid("#########", "#...#.###", "#...#####", "#########"), 1.8, min_cells=2)
    assert len(spots.walls) == 1


def test_cells_that_touch_at_a_corner_are_separate_loops() -> None:
    found = walls_of_cells(grid("####", "#.##", "##.#", "####"), 1.8, min_cells=1)
    # Two free cells that have only a corner in common: the walls must not lead from one to the other.
    assert sorted(area(line[:-1]) for line in found.walls) == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize("degrees", [7.0, 17.0, 30.0, 38.0, 71.0])
def test_slanted_wall_is_found_without_bias(degrees: float) -> None:
    """A half plane whose border has a known direction: the fitted line lies within a tenth of a cell of it.

    Its direction is within two cells over its length.
    """
    turn = degrees * pi / 180.0
    x, y = np.meshgrid(np.arange(120) + 0.5, np.arange(120) + 0.5, indexing="ij")
    # Distance of the cells' middles from a line through the centre of the grid.
    off = -(x - 60.0) * sin(turn) + (y - 60.0) * cos(turn)
    half = OccupancyGrid(np.where(off > 0.0, Cell.FREE, Cell.OCCUPIED).astype(np.uint8), 1.0)
    # The border of the grid gives short walls: the long one is the slanted border.
    longest = max(segments(walls_of_cells(half, 0.9)), key=lambda wall: hypot(wall[2] - wall[0], wall[3] - wall[1]))
    middle = 0.5 * (longest[:2] + longest[2:]) - 60.0
    assert abs(-middle[0] * sin(turn) + middle[1] * cos(turn)) < 0.1
    found = np.arctan2(longest[3] - longest[1], longest[2] - longest[0]) % pi
    assert min(abs(found - turn), pi - abs(found - turn)) < 2.0 / hypot(*(longest[2:] - longest[:2]))


def test_grid_is_placed_by_origin_and_turn() -> None:
    turned = OccupancyGrid(np.zeros((1, 1), dtype=np.uint8), 2.0, (10.0, 20.0), 0.5 * pi)
    # A quarter turn maps the x axis of the grid to the y axis of the map, before the origin is added.
    assert turned.to_map(np.array([[1.0, 0.0], [0.0, 1.0]])) == pytest.approx(np.array([[10.0, 22.0], [8.0, 20.0]]))


@settings(max_examples=40)
@given(st.integers(0, 2**16), st.floats(0.9, 3.0))
def test_walls_stay_near_the_cells_they_replace(seed: int, tolerance: float) -> None:
    """Random blobs: all walls lie within the reported distance of the boundary, which is that of the corners."""
    from scipy import ndimage

    rng = np.random.default_rng(seed)
    # Averages over 5 x 5 random cells: connected regions with irregular borders.
    free = ndimage.uniform_filter(rng.random((24, 24)), 5, mode="wrap") > 0.5
    found = walls_of_cells(OccupancyGrid(np.where(free, Cell.FREE, Cell.OCCUPIED).astype(np.uint8), 1.0), tolerance)
    # Each corner of a wall moves by at most a cell or the tolerance from a corner of the cells.
    assert found.apart_in <= 2.0 * max(1.0, tolerance) + 1e-9


@pytest.mark.parametrize("name", ["thesis_room", "several_walls", "flat", "hall"])
def test_cells_of_a_world_give_its_walls_back(name: str) -> None:
    world, size_in = load_world(name), 1.0
    found = walls_of_cells(cells_of_world(world, size_in), 0.9 * size_in)
    # The face of an occupied cell, and the wall somewhere in it. Walls behind furniture are not found.
    corners = segments(found).reshape(-1, 2)
    assert nearest_points(corners, world.walls)[1].min(axis=1).max() <= 1.5 * size_in
    assert found.open_in == 0.0
    # Walls inside of obstacles are not visible in the cells, so that the other direction holds without obstacles
    # only.
    if not world.obstacles:
        assert hausdorff_distance_in(segments(found), np.asarray(world.walls)) <= 1.5 * size_in


def test_cells_outside_of_the_room_are_unknown() -> None:
    room = cells_of_world(load_world("thesis_room"), 2.0)
    assert room.cells[0, 0] == Cell.UNKNOWN
    # 290 cm = 114.17 in; a cell of 2 in has 4 square inches.
    assert (room.cells == Cell.FREE).sum() * 4.0 == pytest.approx(114.17**2, rel=0.05)
    start = World("room", inner_walls=np.array([[0.0, 0.0, 9.0, 0.0]]), starts=(StartPose(500.0, 0.0),))
    assert not (cells_of_world(start, 2.0).cells == Cell.FREE).any()


def test_a_grid_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells_module, "MAX_CELLS", 1000)
    with pytest.raises(ValueError, match="too large"):
        cells_of_world(load_world("thesis_room"), 1.0)


def test_roomiest_place_is_the_middle_of_the_room() -> None:
    assert roomiest_place(grid("#####", "#...#", "#...#", "#...#", "#####")) == (5.0, 5.0)
    # Without free cells: what is enclosed.
    box = grid("???????", "?#####?", *["?#???#?"] * 3, "?#####?", "???????")
    assert roomiest_place(box) == (7.0, 7.0)
    x, y = roomiest_place(grid("????", "????", "?###"))
    assert (x, y) != (0.0, 0.0)


def test_braille_picture_shows_a_box() -> None:
    box = World("box", rooms=(Polygon(((0.0, 0.0), (9.0, 0.0), (9.0, 7.0), (0.0, 7.0))),))
    # A Braille character has 2 x 4 dots: 5 x 2 characters are 10 x 8 dots.
    assert braille_picture(box, 5, 9).splitlines() == ["⡏⠉⠉⠉⢹", "⣇⣀⣀⣀⣸"]
    assert len(braille_picture(box, 40, 3).splitlines()) <= 3
