"""A table of expected echoes from anywhere on the map, for localizing a robot whose pose is unknown.

    codes    [direction, place]: the most probable echo of a sonar that looks in that direction, its range in whole
             inches and its probability in one number, the robot on a grid over the free floor

With it the likelihood of a ring of echoes at a hundred thousand poses is a matter of look-ups. Ranges are those from
the middle of a cell; the caller widens the variance by the size of a cell. Cells are larger on large maps.

On a large map the table is coarse to fine: of four or more neighbouring places one stands for all, and only these have
echoes at first. A search compares them, and requires the others where good candidates are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from math import pi
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from localization.filters import compiled, sonar_cone
from localization.filters.belief import Floats
from localization.filters.compiled import ConeArrays, ConeSonarRow, ListedWalls, row_of
from localization.filters.sonar_cone import CLEARANCE_IN, REACH_IN, ConeSonar, Reflectors
from localization.filters.sonar_ray import RaySonar, SonarRing, ranges_from, wall_map
from nclient.protocol.types import MAX_SONAR_IN
from worlds.compiled import VARIABLE, compile_function, is_wanted, make_compilable, mark_path, write_mark
from worlds.geometry import nearest_points
from worlds.raycast_arrays import cast_rays
from worlds.rings import SonarMount

CELL_IN, LARGE_CELL_IN = 3.0, 6.0
"""Side of a cell of the grid: on a map of up to MAX_SMALL_PLACES, and on larger ones."""
MAX_SMALL_PLACES: Final = 5_000
"""29 m^2 in cells of 3 in: above it a table of these cells would take a minute or more to build."""
DIRECTIONS: Final = 120
"""Directions of 3 degrees: the 22.5 degrees between two sonars are 7.5, so a heading falls anywhere in a cell."""
OUTLIER_PROBABILITY: Final = 0.3
"""Of readings anywhere: more than for a filter that knows its pose, as people may stand around."""
MAX_READING_IN: Final = MAX_SONAR_IN
HEADING_STD_RAD: Final = 2.0 * np.pi / DIRECTIONS / np.sqrt(12.0)
"""Standard deviation of a direction within its cell."""
MIN_ENCLOSED: Final = 0.1
"""Fraction of all floor that must be enclosed by walls for the rest to be outside: less may be a hollow pillar."""
MAX_COARSE_PLACES: Final = 6_000
"""Coarse places of a large map: in cells of 12 in, 550 m^2."""
_BLOCK_CELLS: Final = 8
"""Cells along a side of the blocks that are built together."""
_PART_POSES: Final = 960
"""Poses of a block that are computed at once."""
_FAR_IN: Final = MAX_READING_IN + 45.0
"""Reflectors farther than this from the middle of a block return nothing to it: the range, and half a block."""
_SMOOTHING: Final = np.full(5, 0.2)
"""Smooths the histogram of ranges by the size of a cell."""


Expect = Callable[[npt.NDArray[np.intp], Callable[[float], None]], npt.NDArray[np.uint16]]
"""Computes codes at places; see `RangeTable`."""


@dataclass
class RangeTable:
    """The table, and the free floor.

    Attributes
    ----------
    origin_in
        (2,) the middle of cell [0, 0].
    cell_in
        Side of a cell.
    number
        (rows, columns): number of the place in each cell, -1 where the robot does not fit.
    codes
        (DIRECTIONS, places + 1), see `encoded`; the last is of no place.
    is_known
        (places + 1,) True for the places whose codes are computed.
    expect
        Computes the codes (n, DIRECTIONS) at the places of these numbers (n,); called with what reports the fraction
        that is done.
    """

    origin_in: Floats
    cell_in: float
    number: npt.NDArray[np.int32]
    codes: npt.NDArray[np.uint16]
    is_known: npt.NDArray[np.bool_]
    expect: Expect

    @cached_property
    def places_in(self) -> Floats:
        """The middles of all free cells (k, 2)."""
        rows, columns = np.nonzero(self.number >= 0)
        return self.origin_in + self.cell_in * np.stack((columns, rows), axis=-1)

    @property
    def coarse_cells(self) -> int:
        """Side of the squares of cells in which one place stands for all; 1 on a small map."""
        count = self.codes.shape[1] - 1
        return 1 if count <= MAX_SMALL_PLACES else max(2, int(np.ceil(np.sqrt(count / MAX_COARSE_PLACES))))

    @cached_property
    def representative(self) -> npt.NDArray[np.intp]:
        """(places + 1,) the number of the place that stands for each; the last is of no place."""
        cells, (rows, columns) = self.coarse_cells, np.nonzero(self.number >= 0)
        square = rows // cells * (self.number.shape[1] // cells + 1) + columns // cells
        _, first, inverse = np.unique(square, return_index=True, return_inverse=True)
        return np.append(first[inverse], len(rows)).astype(np.intp)

    @cached_property
    def coarse_places(self) -> npt.NDArray[np.intp]:
        """Numbers (k,) of the places that stand for others: all on a small map."""
        return np.unique(self.representative[:-1])

    def require(self, numbers: npt.NDArray[np.intp], progress: Callable[[float], None] = lambda _: None) -> bool:
        """Compute the codes of places that are not yet known; return True if there were any."""
        missing = np.unique(numbers[~self.is_known[numbers]])
        if len(missing):
            self.codes[:, missing] = self.expect(missing, progress).T
            self.is_known[missing] = True
        return bool(len(missing))

    def density(self, reading_in: float) -> float:
        """Return the probability of a whole-inch reading from an unknown pose: per inch, or of "nothing" (255)."""
        return float(self._densities[min(max(round(reading_in), 0), MAX_READING_IN)])

    def places_at(self, x_in: Floats, y_in: Floats) -> npt.NDArray[np.int32]:
        """Return the number of the place at each point (n,); -1 where the robot does not fit."""
        column = np.rint((x_in - self.origin_in[0]) / self.cell_in).astype(np.intp)
        row = np.rint((y_in - self.origin_in[1]) / self.cell_in).astype(np.intp)
        rows, columns = self.number.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        found: npt.NDArray[np.int32] = self.number[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, found, np.int32(-1))

    def beside(self, places: npt.NDArray[np.intp], x_in: Floats, y_in: Floats) -> npt.NDArray[np.intp]:
        """Return the places (n,) so far beside places (n,), displacements (n,) or (); no place is the last number."""
        columns = np.rint(np.asarray(x_in) / self.cell_in).astype(np.intp)
        rows = np.rint(np.asarray(y_in) / self.cell_in).astype(np.intp)
        padded, at = self._padded
        beside = padded.ravel()[at[places] + np.where(
            np.maximum(np.abs(columns), np.abs(rows)) <= MARGIN_CELLS, rows * padded.shape[1] + columns, -at[places]
        )]  # fmt: skip
        return beside.astype(np.intp)

    def codes_beside(self, x_in: float, y_in: float, direction: int) -> npt.NDArray[np.uint16]:
        """Return the codes (k,) of the coarse echoes in a direction, of a robot so far beside each coarse place."""
        columns, rows = round(x_in / self.cell_in), round(y_in / self.cell_in)
        if max(abs(columns), abs(rows)) > MARGIN_CELLS:
            return np.zeros(len(self.coarse_places), dtype=np.uint16)
        coarse, at = self._coarse
        beside: npt.NDArray[np.uint16] = self.codes[direction][coarse.ravel()[at + (rows * coarse.shape[1] + columns)]]
        return beside

    @cached_property
    def _padded(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.intp]]:
        """`number` with a margin, the number after the last for no place; and the index there of each place.

        The index 0, in the margin, is of no place.
        """
        padded = np.pad(self.number, MARGIN_CELLS, constant_values=-1)
        at = np.flatnonzero(padded >= 0)
        padded[padded < 0] = len(at)
        return padded, at

    @cached_property
    def _coarse(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.intp]]:
        """The same with the representative of each place, and the indices of the coarse places."""
        padded, at = self._padded
        return self.representative.astype(np.int32)[padded], at[self.coarse_places]

    @cached_property
    def _densities(self) -> Floats:
        return reading_densities(*decoded(self.codes[:, self.coarse_places].astype(np.intp)))

    def look_up(self, x_in: Floats, y_in: Floats, directions: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return ranges and probabilities (k, n) of sonars at places (k, n) that look in directions (n,); 0 off floor.

        On a large map they are those of the coarse places. `directions` are numbers of steps of 360 degrees /
        DIRECTIONS.
        """
        number = self.places_at(x_in, y_in)
        at = self.representative[np.where(number >= 0, number, self.codes.shape[1] - 1)]
        return decoded(self.codes[directions, at].astype(np.intp))


# A range and its probability as one small number, so that a likelihood is one look-up: ranges in inches, probabilities
# in 63 steps.

PROBABILITY_STEPS: Final = 63
CODES: Final = (MAX_READING_IN + 1) * (PROBABILITY_STEPS + 1)
"""Number of codes; code 0 is of no echo."""
MARGIN_CELLS: Final = 80
"""Largest displacement between two echoes of a search, in cells: 20 ft of small cells."""


def encoded(ranges_in: npt.ArrayLike, probabilities: npt.ArrayLike) -> npt.NDArray[np.uint16]:
    """Return the codes of ranges and probabilities of any shape."""
    inches = np.clip(np.rint(ranges_in), 0, MAX_READING_IN)
    # What is beyond the limit reads "nothing".
    detected = np.where(inches < MAX_READING_IN, probabilities, 0.0)
    code: npt.NDArray[np.uint16] = (np.rint(detected * PROBABILITY_STEPS) * (MAX_READING_IN + 1)
                                    + inches).astype(np.uint16)  # fmt: skip
    return code


def decoded(codes: npt.NDArray[np.int_]) -> tuple[Floats, Floats]:
    """Return ranges and probabilities of codes."""
    steps, inches = np.divmod(codes, MAX_READING_IN + 1)
    return inches.astype(np.float64), steps.astype(np.float64) / PROBABILITY_STEPS


def reading_densities(ranges_in: npt.ArrayLike, probabilities: npt.ArrayLike) -> Floats:
    """Return the densities (256,) of whole-inch readings from 0 to 255, from expected echoes at poses on a map."""
    # 1. The histogram of expected ranges.
    weights = np.where(np.rint(np.ravel(ranges_in)) < MAX_READING_IN, np.ravel(probabilities), 0.0)
    edges = np.arange(MAX_READING_IN + 2) - 0.5
    counts, _ = np.histogram(np.ravel(ranges_in), edges, weights=weights)
    smooth = np.convolve(counts, _SMOOTHING, mode="same")
    # 2. Outliers anywhere, and "nothing" where no echo is expected.
    detected = float(weights.mean()) if len(weights) else 0.0
    inlier = 1.0 - OUTLIER_PROBABILITY
    densities: Floats = OUTLIER_PROBABILITY / MAX_READING_IN + inlier * detected * smooth / max(
        float(smooth.sum()), 1e-9
    )
    densities[MAX_READING_IN] = 1.0 - inlier * detected
    return densities


def sampled_echoes(walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar | ConeSonar, clearance_in: float,
                   places: int) -> tuple[Floats, Floats]:
    """Return ranges and probabilities (k, DIRECTIONS) at up to k = `places` random places on the floor of a map.

    So few are computed in arrays, sooner than compiled code is loaded.
    """
    segments = wall_map(walls).segments
    low, high = segments.reshape(-1, 2).min(axis=0), segments.reshape(-1, 2).max(axis=0)
    around = sonar_cone.reflectors(segments)
    # Always the same places, so that a run can be repeated.
    drawn = np.random.default_rng(0).uniform(low, high, (20 * places, 2))
    chosen: list[tuple[Floats, Floats]] = []
    for place in drawn:
        if len(chosen) < places and nearest_points(place, segments)[1].min() >= clearance_in:
            chosen.append(_expected(place[None], place[None], segments, around, body, sonar, may_compile=False))
    if not chosen:
        return np.zeros((0, DIRECTIONS)), np.zeros((0, DIRECTIONS))
    ranges, probabilities = (np.concatenate(part) for part in zip(*chosen, strict=True))
    return ranges, probabilities


def build_range_table(walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar | ConeSonar, clearance_in: float,
                      progress: Callable[[float], None] = lambda _: None) -> RangeTable:  # fmt: skip
    """Return the table of a map of wall segments (m, 4) for this ring, its axis `clearance_in` from any wall.

    On a large map the coarse places are computed. `progress` is called with the fraction that is done.
    """
    # 1. The grid, and its free cells; large cells if there are too many small ones.
    segments = wall_map(walls).segments
    cell_in = LARGE_CELL_IN
    origin, free = floor_grid(segments, clearance_in, cell_in)
    if np.count_nonzero(free) <= MAX_SMALL_PLACES:
        fine_origin, fine = floor_grid(segments, clearance_in, CELL_IN)
        if np.count_nonzero(fine) <= MAX_SMALL_PLACES:
            cell_in, origin, free = CELL_IN, fine_origin, fine
    number = np.full(free.shape, -1, dtype=np.int32)
    count = np.count_nonzero(free)
    number[free] = np.arange(count)
    # 2. The most probable echo in every direction, at first of the coarse places.
    codes, is_known = np.zeros((DIRECTIONS, count + 1), dtype=np.uint16), np.append(np.zeros(count, np.bool_), True)
    expect = expectation(origin, cell_in, number, segments, body, sonar)
    table = RangeTable(origin, cell_in, number, codes, is_known, expect)
    table.require(table.coarse_places, progress)
    return table


def expectation(origin_in: Floats, cell_in: float, number: npt.NDArray[np.int32], walls: npt.ArrayLike, body: SonarRing,
                sonar: RaySonar | ConeSonar) -> Expect:  # fmt: skip
    """Return what computes the echoes at places of a grid: block by block of neighbouring cells."""
    segments = wall_map(walls).segments
    around = sonar_cone.reflectors(segments)
    rows, columns = np.nonzero(number >= 0)
    places = origin_in + cell_in * np.stack((columns, rows), axis=-1)
    block_of = rows // _BLOCK_CELLS * (number.shape[1] // _BLOCK_CELLS + 1) + columns // _BLOCK_CELLS

    def expect(numbers: npt.NDArray[np.intp], progress: Callable[[float], None]) -> npt.NDArray[np.uint16]:
        codes, done = np.zeros((len(numbers), DIRECTIONS), dtype=np.uint16), 0
        for block in np.unique(block_of[numbers]):
            at = np.flatnonzero(block_of[numbers] == block)
            # All places of the block decide what is in sight, so that the echoes of one do not depend on the others.
            block_places = places[block_of == block]
            codes[at] = encoded(*_expected(places[numbers[at]], block_places, segments, around, body, sonar))
            done += len(at)
            progress(done / len(numbers))
        return codes

    return expect


def _expected(places: Floats, block: Floats, segments: Floats, around: Reflectors, body: SonarRing,
              sonar: RaySonar | ConeSonar, *, may_compile: bool = True) -> tuple[Floats, Floats]:  # fmt: skip
    """Return ranges and probabilities (n, DIRECTIONS) of the most probable echo at places (n, 2) of a block (m, 2)."""
    directions: Floats = np.arange(DIRECTIONS, dtype=np.float64) * (2.0 * np.pi / DIRECTIONS)
    if isinstance(sonar, ConeSonar):
        near, ring_in = _within_range(block, around), body.sonar_ring_radius_in
        found = compiled_echoes(places, DIRECTIONS, near, ring_in, HEADING_STD_RAD, sonar) if may_compile else None
        return found or _most_probable(places, directions, *around_block(block, near, ring_in), body, sonar)
    range_in = ranges_from(_poses(places, directions), np.zeros(1), body, wall_map(segments)).range_in[..., 0]
    has_wall = np.isfinite(range_in)
    return np.where(has_wall, range_in, 0.0), has_wall.astype(np.float64)


def floor_grid(segments: Floats, clearance_in: float, cell_in: float) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the middle of cell [0, 0] of a grid over the map, and (rows, columns) True where the robot fits.

    Outside of walls that enclose some floor it does not.
    """
    # 1. The grid, with a border that lies outside of all walls.
    low = segments.reshape(-1, 2).min(axis=0) + clearance_in
    high = segments.reshape(-1, 2).max(axis=0) - clearance_in
    columns, rows = np.maximum(np.floor((high - low) / cell_in).astype(int) + 1, 1)
    origin = low + 0.5 * (high - low - cell_in * np.array([columns - 1, rows - 1]))
    border = int(np.ceil(2.0 * clearance_in / cell_in)) + 1
    free = _fits(segments, clearance_in, cell_in, origin - border * cell_in, (rows + 2 * border, columns + 2 * border))
    # 2. What is connected to the border lies outside.
    inner = slice(border, border + rows), slice(border, border + columns)
    is_border = np.ones_like(free)
    is_border[1:-1, 1:-1] = False
    outside = connected(free, zip(*(part.tolist() for part in np.nonzero(is_border)), strict=True))
    enclosed = (free & ~outside)[inner]
    free = free[inner]
    return origin, enclosed if enclosed.sum() >= MIN_ENCLOSED * free.sum() else free


def connected(free: npt.NDArray[np.bool_], cells: Iterable[tuple[int, int]]) -> npt.NDArray[np.bool_]:
    """Return True for the free cells (rows, columns) that are connected to some of these cells (row, column)."""
    # 1. A border of cells that are not free, so that each cell has four neighbours.
    open_ = np.pad(free, 1).ravel()
    width = free.shape[1] + 2
    given = np.array(list(cells), dtype=np.intp).reshape(-1, 2)
    given = given[((given >= 0) & (given < free.shape)).all(axis=1)]
    front = np.unique((given[:, 0] + 1) * width + given[:, 1] + 1)
    front = front[open_[front]]
    # 2. From all cells of the front to their neighbours, while there are any not yet reached.
    left = open_.copy()
    left[front] = False
    while len(front):
        beside = (front[:, None] + np.array((-width, -1, 1, width))).ravel()
        front = np.unique(beside[left[beside]])
        left[front] = False
    return (open_ & ~left).reshape(-1, width)[1:-1, 1:-1]


def _fits(segments: Floats, clearance_in: float, cell_in: float, origin: Floats,
          shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Return (rows, columns) True for the cells of a grid where the robot fits."""
    rows, columns = shape
    free = np.empty((rows, columns), dtype=np.bool_)
    # Row by row: an array of all cells and all walls would be large on a large map.
    for row in range(rows):
        points = origin + cell_in * np.stack((np.arange(columns), np.full(columns, row)), axis=-1)
        near = np.abs(0.5 * (segments[:, 1] + segments[:, 3]) - points[0, 1]) <= (
            0.5 * np.abs(segments[:, 3] - segments[:, 1]) + clearance_in)  # fmt: skip
        free[row] = nearest_points(points, segments[near])[1].min(axis=-1, initial=np.inf) >= clearance_in
    return free


def _poses(places: Floats, directions: Floats) -> Floats:
    poses = np.empty((len(places), len(directions), 3))
    poses[..., :2] = places[:, None, :]
    poses[..., 2] = directions
    return poses


def _most_probable(places: Floats, directions: Floats, seen: Reflectors, blocking: Floats, body: SonarRing,
                   sonar: ConeSonar) -> tuple[Floats, Floats]:
    """Return ranges and probabilities (n, d) of the most probable echo at neighbouring places (n, 2), by direction.

    `seen` are the reflectors in sight, `blocking` (m, 4) the walls that may block the view.
    """
    poses = _poses(places, directions).reshape(-1, 3)
    mount, std = SonarMount(0.0, body.sonar_ring_radius_in), np.full(len(poses), HEADING_STD_RAD)
    shape = len(places), len(directions)
    range_in, likeliest = np.zeros(len(poses)), np.zeros(len(poses))
    # In parts: an array of all poses and all reflectors takes 40 MB.
    for first in range(0, len(poses), _PART_POSES):
        part = slice(first, first + _PART_POSES)
        ranges_in, probability = sonar_cone.echo_probabilities(poses[part], std[part], mount, seen, sonar, blocking)
        if probability.shape[1]:
            best = probability.argmax(axis=-1)[:, None]
            range_in[part], likeliest[part] = (
                np.take_along_axis(each, best, axis=-1)[:, 0] for each in (ranges_in, probability)
            )
    return range_in.reshape(shape), likeliest.reshape(shape)


def _within_range(places: Floats, around: Reflectors) -> Reflectors:
    """Return the reflectors from which neighbouring places (n, 2) may receive an echo."""
    middle = places.mean(axis=0)
    return around.some(nearest_points(middle, around.walls)[1] <= _FAR_IN,
                       np.hypot(*(around.vertices - middle).T) <= _FAR_IN)


def around_block(places: Floats, around: Reflectors, ring_in: float) -> tuple[Reflectors, Floats]:
    """Return the reflectors in sight of neighbouring places (n, 2), and the walls (m, 4) that may block the view.

    In sight is what can be seen from a place, or from a sonar's distance `ring_in` beside an outer one.
    """
    around = _within_range(places, around)
    # 1. The places at the block's border, moved outwards by the ring: faces of sonars are there. Of the others a third.
    low, high = places.min(axis=0), places.max(axis=0)
    outer = places[((places == low) | (places == high)).any(axis=1)]
    points = np.concatenate((places[::3], outer + ring_in * np.sign(outer - 0.5 * (low + high))))
    # 2. Perpendiculars to walls, and lines to vertices.
    nearest, _ = nearest_points(points, around.walls)
    targets = np.concatenate((nearest, np.broadcast_to(around.vertices, (len(points), *around.vertices.shape))), axis=1)
    offset = targets - points[:, None]
    far = np.hypot(offset[..., 0], offset[..., 1])
    direction = offset / np.maximum(far, 1e-9)[..., None]
    faces = np.broadcast_to(points[:, None], targets.shape)
    free_in, rows = cast_rays(faces.reshape(-1, 2), direction.reshape(-1, 2), around.walls)
    in_sight = (free_in.reshape(far.shape) >= far - CLEARANCE_IN).any(axis=0)
    count = len(around.walls)
    blocking = in_sight[:count].copy()
    blocking[rows[rows >= 0]] = True
    return around.some(in_sight[:count], in_sight[count:]), around.walls[blocking]


# Compiled: among the 1,285 walls of an office floor a place takes 7 ms in arrays and 1 ms so.


def likeliest_echoes(places: Any, ring_in: float, heading_std_rad: float, sonar: Any, walls: Any, faces: Any,
                     vertices: Any, ranges_in: Any, probabilities: Any) -> None:  # fmt: skip
    """Store the most probable first echo at places (n, 2), in directions that divide a turn.

    Parameters
    ----------
    sonar
        `ConeSonarRow`.
    walls
        (m, 4) segments that may block the path.
    faces, vertices
        (m, 5) and (v, 3), as of `sonar_cone.ConeModel`.
    ranges_in, probabilities
        (n, directions) arrays for the result; 0 where no echo is.
    """
    mount, directions = SonarMount(0.0, ring_in, 0.0), ranges_in.shape[1]
    # The middle and the lines are for rays alone.
    listed: Any = ListedWalls(walls, walls, (0.0, 0.0, 0.0), [(row[0], row[1], row[2], row[3]) for row in walls])
    all_vertices: Any = [(row[0], row[1], row[2]) for row in vertices]
    for place in range(len(places)):
        x, y = places[place, 0], places[place, 1]
        # 1. The walls that the robot can have in front, and the vertices.
        in_front: Any = [
            (row[0], row[1], row[2], row[3], row[4]) for row in faces if is_in_front(x, y, row, ring_in + REACH_IN)
        ]
        model: Any = ConeArrays(sonar, listed, in_front, all_vertices, walls, 0)
        # 2. The most probable echo in each direction.
        for direction in range(directions):
            heading = direction * (2.0 * pi / directions)
            for echo in sonar_cone.first_echoes(x, y, heading, heading_std_rad, mount, model):
                if echo.probability > probabilities[place, direction]:
                    ranges_in[place, direction] = echo.range_in
                    probabilities[place, direction] = echo.probability


def is_in_front(x: float, y: float, row: Any, reach_in: float) -> bool:
    """Return True if the foot of the perpendicular from near (x, y) may lie on a wall, a row of five numbers."""
    _, _, _, foot = sonar_cone.to_wall(x, y, row[0], row[1], row[2], row[3])
    return bool(-reach_in < foot < row[4] + reach_in)


@cache
def _compile(sources: int) -> Callable[..., None]:
    """Return `likeliest_echoes` compiled, with plain tuples as arguments, or loaded from the cache."""

    def entry(places: Any, ring_in: Any, std: Any, sonar: Any, walls: Any, faces: Any, vertices: Any, ranges: Any,
              probabilities: Any) -> None:  # fmt: skip
        assert sources >= 0
        likeliest_echoes(places, ring_in, std, ConeSonarRow(*sonar), walls, faces, vertices, ranges, probabilities)

    make_compilable([likeliest_echoes, is_in_front])
    run = compile_function(entry)
    run(np.zeros((0, 2)), 0.0, 0.0, _row(ConeSonar()), *(np.zeros((0, width)) for width in (4, 5, 3, 1, 1)))
    write_mark(mark_path(likeliest_echoes.__name__, sources))
    return run


@cache
def _is_used(sources: int, _word: str) -> bool:
    """Return True if compiled code is wanted and possible; decided once for each value of NOMAD_COMPILED."""
    return is_wanted(likeliest_echoes.__name__, sources) and compiled.load()


def _row(sonar: ConeSonar) -> tuple[float, ...]:
    return tuple(row_of(ConeSonarRow, sonar))


def compiled_echoes(places: Floats, directions: int, around: Reflectors, ring_in: float, heading_std_rad: float,
                    sonar: ConeSonar) -> tuple[Floats, Floats] | None:
    """Return ranges and probabilities (n, directions) of the most probable echo at places (n, 2).

    None if compiled code is not to be used.
    """
    sources = compiled.source_checksum(likeliest_echoes)
    if not _is_used(sources, os.environ.get(VARIABLE, "")):
        return None
    run = _compile(sources)
    ranges, probabilities = np.zeros((len(places), directions)), np.zeros((len(places), directions))
    faces, vertices = sonar_cone.rows_of(around, sonar)
    run(np.ascontiguousarray(places, dtype=np.float64), ring_in, heading_std_rad, _row(sonar),
        np.ascontiguousarray(around.walls), faces, vertices, ranges, probabilities)  # fmt: skip
    return ranges, probabilities
