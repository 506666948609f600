"""Occupancy grids: straight walls out of cells, and cells out of walls.

    walls_of_cells    boundary between free cells and others ──> lines of edges ──> straight walls
    cells_of_world    walls ──> occupied cells; free is what can be reached from a start

A grid has its own frame: cell (i, k) covers x from i to i + 1 and y from k to k + 1 in units of the cell size, from the
grid's origin, y up.

References
----------
Straight pieces: Douglas, Peucker: Algorithms for the reduction of the number of points required to represent a
digitized line (1973). Lines: total least squares, the principal axis of the edges' middles.

Simplify a map: fewer walls, every point of the old ones within a tolerance of the new ones and vice versa.

    outlines       Douglas-Peucker all around, from two corners that are far apart and remain
    inner walls    walls on one line that touch or overlap become one; walls connected end to end become a polyline,
                   and Douglas-Peucker is applied to it

An outline whose simplified form would cross itself remains unchanged.

References
----------
Douglas, Peucker: Algorithms for the reduction of the number of points required to represent a digitized line (1973).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import pairwise
from math import ceil, floor
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from worlds import geometry
from worlds.geometry import BoolArray, FloatArray, area, crossing, lengths, nearest_points, polygon_segments
from worlds.world import Point, Polygon, World

MIN_CORNERS = 3
SAMPLE_IN = 0.25
"""Sampling distance for comparing two maps."""


def simplify_world(world: World, tolerance_in: float) -> World:
    """Return a world with the same or fewer walls, all within `tolerance_in` of the original ones.

    Raises
    ------
    ValueError
        If the tolerance is not positive.
    """
    if not tolerance_in > 0.0:
        raise ValueError(f"a tolerance is above 0 in, not {tolerance_in!r}")
    # Each of the two steps may move a wall by half the tolerance.
    half = tolerance_in / 2.0
    merged = _merge_collinear(world.inner_walls, half)
    walls = [geometry.polyline_segments(_select(line, half)) for line in _chain(merged)]
    return replace(
        world,
        rooms=tuple(_simplify_polygon(room, tolerance_in) for room in world.rooms),
        obstacles=tuple(_simplify_polygon(thing, tolerance_in) for thing in world.obstacles),
        inner_walls=np.concatenate([np.empty((0, 4)), *walls]),
        # Walls have been moved and joined.
        accuracies={},
        wall_names={},
    )


def hausdorff_distance_in(one: FloatArray, other: FloatArray) -> float:
    """Return the Hausdorff distance between walls (m, 4) and others (k, 4), sampled every 1/4 in."""
    return max(_directed_distance(one, other), _directed_distance(other, one))


def _directed_distance(walls: FloatArray, others: FloatArray) -> float:
    farthest = 0.0
    for x1, y1, x2, y2 in walls:
        count = 2 + int(np.hypot(x2 - x1, y2 - y1) / SAMPLE_IN)
        points = np.linspace((x1, y1), (x2, y2), count)
        farthest = max(farthest, float(nearest_points(points, others)[1].min(axis=-1).max()))
    return farthest


def _simplify_polygon(polygon: Polygon, tolerance_in: float) -> Polygon:
    """Return the outline with fewer corners, or the original one if the result is not a valid outline."""
    corners = list(polygon.corners_in)
    # Split the outline at two corners far apart, which remain.
    far = int(np.argmax(np.hypot(*(np.array(corners) - corners[0]).T)))
    one, other = (_select(corners[: far + 1], tolerance_in), _select([*corners[far:], corners[0]], tolerance_in))
    selected = [*one[:-1], *other[:-1]]
    edges = polygon_segments(selected)
    if len(selected) < MIN_CORNERS or crossing(edges) or not area(selected) * area(corners) > 0.0:
        return polygon
    return replace(polygon, corners_in=tuple(selected))


def _select(line: Sequence[Point], tolerance_in: float) -> list[Point]:
    """Return the points of a line that the Douglas-Peucker algorithm selects."""
    return [line[number] for number in douglas_peucker(np.array(line, dtype=np.float64), tolerance_in)]


def douglas_peucker(points: FloatArray, tolerance: float) -> list[int]:
    """Return the numbers of the points (n, 2) that the Douglas-Peucker algorithm selects, in order.

    It keeps the ends of each span and splits it at the point farthest from the chord if that is beyond the tolerance.
    """
    selected = [0, len(points) - 1]
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        chord = np.concatenate((points[first], points[last]))[None]
        off = nearest_points(points[first + 1 : last], chord)[1][:, 0]
        middle = first + 1 + int(off.argmax())
        if off.max() > tolerance:
            selected.append(middle)
            spans += [(first, middle), (middle, last)]
    return sorted(selected)


def _merge_collinear(walls: FloatArray, tolerance_in: float) -> FloatArray:
    """Merge walls on one line into one, along the longest of them."""
    left = sorted(walls.tolist(), key=lambda wall: -float(lengths(np.array(wall))))
    done: list[list[float]] = []
    while left:
        group = [left.pop(0)]
        while (joined := _find_joinable(group, left, tolerance_in)) is not None:
            group.append(joined)
            left.remove(joined)
        whole = _union(np.array(group), tolerance_in)
        done.append(group[0] if whole is None or len(group) == 1 else whole.tolist())
    return np.array(done, dtype=np.float64).reshape(-1, 4)


def _find_joinable(group: list[list[float]], others: list[list[float]], tolerance_in: float) -> list[float] | None:
    """Return the first other wall that forms one wall with the group; None if there is none."""
    return next((wall for wall in others if _union(np.array([*group, wall]), tolerance_in) is not None), None)


def _union(walls: FloatArray, tolerance_in: float) -> FloatArray | None:
    """Return the wall that covers all walls if they lie on the first one's line without a gap; else None."""
    origin, along = walls[0, :2], (walls[0, 2:] - walls[0, :2]) / lengths(walls[0])
    off = walls.reshape(-1, 2) - origin
    if np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]).max() > tolerance_in:
        return None
    # Intervals along the line, in order; a gap beyond the tolerance separates walls.
    spans = np.sort((off @ along).reshape(-1, 2), axis=1)
    spans = spans[spans[:, 0].argsort()]
    reach = np.maximum.accumulate(spans[:, 1])
    if (spans[1:, 0] > reach[:-1] + tolerance_in).any():
        return None
    return np.concatenate((origin + spans[0, 0] * along, origin + reach[-1] * along))


def _chain(walls: FloatArray) -> list[list[Point]]:
    """Return polylines of walls that meet end to end; where more than two meet, lines end."""
    ends: dict[Point, list[int]] = {}
    pairs = [((x1, y1), (x2, y2)) for x1, y1, x2, y2 in walls.tolist()]
    for number, pair in enumerate(pairs):
        for end in pair:
            ends.setdefault(end, []).append(number)
    # Extend each line at both of its ends.
    left, lines = set(range(len(pairs))), []
    while left:
        number = min(left)
        left.discard(number)
        line: list[Point] = list(pairs[number])
        for _ in range(2):
            while (at := _next_wall(ends, line[-1], left)) is not None:
                left.discard(at)
                one, other = pairs[at]
                line.append(other if one == line[-1] else one)
            line.reverse()
        lines.append(line)
    return lines


def _next_wall(ends: dict[Point, list[int]], place: Point, left: set[int]) -> int | None:
    there = ends[place]
    return next((number for number in there if number in left), None) if len(there) == 2 else None


Corner = tuple[int, int]
MARGIN_IN: Final = 12.0
"""Unknown border of the grid of a world."""
MAX_CELLS: Final = 50_000_000
"""Largest grid that is read or written: a floor of 350 x 350 m in cells of 5 cm."""


# Unicode's Braille patterns: the dots of the left and right column from the top, as bits of the code.
_BRAILLE: Final = 0x2800
_BRAILLE_DOTS: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


class Cell(IntEnum):
    """Content of a cell."""

    FREE = 0
    OCCUPIED = 1
    UNKNOWN = 2


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """A grid of cells.

    Attributes
    ----------
    cells : (n, m) array of Cell
        Content, first index along x, second along y.
    size_in
        Side of a cell in inches.
    origin_in, turn_rad
        Corner of cell (0, 0) in the map's frame, and the direction of the grid's x axis there.
    """

    cells: npt.NDArray[np.uint8]
    size_in: float
    origin_in: Point = (0.0, 0.0)
    turn_rad: float = 0.0

    def to_map(self, corners: FloatArray) -> FloatArray:
        """Return points (..., 2), given in cells, in the map's frame in inches."""
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        rotation = np.array([[cos, sin], [-sin, cos]])
        placed: FloatArray = self.size_in * corners @ rotation + np.array(self.origin_in)
        return placed


class GridWalls(NamedTuple):
    """Walls found in a grid.

    Attributes
    ----------
    walls : list of (k, 2) array
        Polylines in inches; a closed one ends at its first point.
    apart_in
        Largest distance between the walls and the edges of the cells they stand for.
    open_in
        Total length of the boundary between free and unknown cells, which is no wall.
    """

    walls: list[FloatArray]
    apart_in: float
    open_in: float


def walls_of_cells(grid: OccupancyGrid, tolerance_in: float, *, min_cells: int = 4,
                   close_open_ends: bool = False) -> GridWalls:
    """Return straight walls along the boundary of the free cells.

    Parameters
    ----------
    grid : OccupancyGrid
    tolerance_in : float
        Largest distance between a wall and the corners of the edges it replaces, before lines are fitted.
    min_cells : int
        Free or occupied regions with fewer cells are noise and belong to what surrounds them.
    close_open_ends : bool
        Also return the boundary to unknown cells as walls.
    """
    from scipy import ndimage

    # 1. Free space without specks; anything else is behind its boundary.
    free = _without_specks(grid.cells == Cell.FREE, min_cells)
    # Cells beside an occupied one are solid, too: borders of walls are often half-known.
    solid = ndimage.binary_dilation(grid.cells == Cell.OCCUPIED, np.ones((3, 3)))
    # 2. The boundary as closed loops of cell corners, and which of their edges are walls.
    walls, apart, open_cells = [], 0.0, 0
    for loop in _loops(free):
        is_wall = np.ones(len(loop), dtype=bool) if close_open_ends else _faces_solid(loop, solid)
        open_cells += int((~is_wall).sum())
        for corners in _runs(loop, is_wall):
            # 3. Straight pieces, then the line of each.
            line = _straighten(corners, tolerance_in / grid.size_in)
            segments = np.concatenate((line[:-1], line[1:]), axis=1)
            apart = max(apart, float(nearest_points(corners, segments)[1].min(axis=1).max()))
            walls.append(grid.to_map(line))
    return GridWalls(walls, apart * grid.size_in, open_cells * grid.size_in)


def _without_specks(free: BoolArray, min_cells: int) -> BoolArray:
    """Return free space with small regions, of free cells and of others, given to their surroundings."""
    from scipy import ndimage

    cleaned = np.array(free)
    # Cells that meet at a corner only are one region of occupied cells, and two of free ones.
    for value, neighbours in ((False, np.ones((3, 3))), (True, None)):
        labels, _ = ndimage.label(cleaned == value, neighbours)
        small = np.bincount(labels.ravel()) < min_cells
        small[0] = False
        cleaned[small[labels]] = not value
    return cleaned


def _loops(free: BoolArray) -> Iterator[npt.NDArray[np.intp]]:
    """Yield the boundary of free cells as closed loops of corners (n, 2), free space on the left.

    Where two free cells meet at a corner only, the loop turns left there: the corner is closed.
    """
    wide = np.pad(free, 1).astype(np.int8)
    after: dict[Corner, list[Corner]] = {}
    # 1. Directed edges by their first corner. An edge along y is where free changes along x; it points to +y where
    # free space ends. An edge along x is where free changes along y; it points to +x where free space begins.
    for axis, upwards in ((0, -1), (1, 1)):
        for i, k in np.argwhere(np.diff(wide, axis=axis)).tolist():
            # Corners without the padding.
            edge = ((i, k - 1), (i, k)) if axis == 0 else ((i - 1, k), (i, k))
            change = int(wide[i + (axis == 0), k + (axis == 1)] - wide[i, k])
            first, second = edge if change == upwards else edge[::-1]
            after.setdefault(first, []).append(second)
    # 2. Walk along them until the first corner returns.
    while after:
        start = next(iter(after))
        loop, here, before = [start], start, None
        while True:
            choices = after[here]
            onward = choices[0] if before is None or len(choices) == 1 else _leftmost(before, here, choices)
            choices.remove(onward)
            if not choices:
                del after[here]
            before, here = here, onward
            if here == start:
                break
            loop.append(here)
        yield np.array(loop)


def _leftmost(before: Corner, here: Corner, choices: Sequence[Corner]) -> Corner:
    """Return the choice that turns most to the left."""
    dx, dy = here[0] - before[0], here[1] - before[1]
    return max(choices, key=lambda there: dx * (there[1] - here[1]) - dy * (there[0] - here[0]))


def _faces_solid(loop: npt.NDArray[np.intp], solid: BoolArray) -> BoolArray:
    """Return for each edge of a loop, from its corner to the next, if the cell on its right is solid."""
    along = np.roll(loop, -1, axis=0) - loop
    # The cell to the right of an edge: its middle, half a cell to the right (dy, -dx).
    middle = loop + 0.5 * along + 0.5 * np.stack((along[:, 1], -along[:, 0]), axis=-1)
    cells = np.floor(middle).astype(int)
    within = ((cells >= 0) & (cells < solid.shape)).all(axis=1)
    faces: BoolArray = np.zeros(len(loop), dtype=bool)
    faces[within] = solid[tuple(cells[within].T)]
    return faces


def _runs(loop: npt.NDArray[np.intp], is_wall: BoolArray) -> Iterator[FloatArray]:
    """Yield the corners of each run of wall edges; of a loop of walls only, all corners and the first again."""
    if is_wall.all():
        # Begin at a corner of the shape: the one farthest from any other is one.
        corners = np.roll(loop, -int(np.hypot(*(loop - loop[0]).T).argmax()), axis=0)
        yield np.concatenate((corners, corners[:1])).astype(np.float64)
        return
    # Begin after an edge that is no wall, so that no run crosses the end of the array.
    begin = int(np.flatnonzero(~is_wall)[0]) + 1
    corners, walls = np.roll(loop, -begin, axis=0), np.roll(is_wall, -begin)
    borders = np.flatnonzero(np.diff(np.concatenate(([False], walls, [False])).astype(np.int8)))
    for first, last in borders.reshape(-1, 2):
        yield corners[np.arange(first, last + 1) % len(corners)].astype(np.float64)


def _straighten(corners: FloatArray, tolerance: float) -> FloatArray:
    """Return the polyline (k, 2) of straight lines that replaces the corners (n, 2) of a run of edges, in cells.

    Lines are fitted to the middles of the edges: the corners of a slanted wall's steps are all on one side of it.
    """
    # 1. Split into straight pieces; a closed run is split at its two corners farthest apart first.
    ends = _split(corners, tolerance)
    if len(ends) < 3:
        return corners[ends]
    # 2. Fit a line to each piece: centre and direction.
    fitted = [_fit(corners[one : other + 1]) for one, other in pairwise(ends)]
    # 3. Corners where neighbouring lines meet, or the old corner where they meet far away from it.
    is_closed = bool((corners[0] == corners[-1]).all())
    points = [_meeting(before, after, corners[end], tolerance)
              for (before, after), end in zip(pairwise(fitted), ends[1:-1], strict=True)]
    first = _meeting(fitted[-1], fitted[0], corners[0], tolerance) if is_closed else _foot(fitted[0], corners[0])
    last = first if is_closed else _foot(fitted[-1], corners[-1])
    return np.stack([first, *points, last])


def _split(corners: FloatArray, tolerance: float) -> list[int]:
    """Return the numbers of the corners between straight pieces, the first and the last included."""
    if not (corners[0] == corners[-1]).all():
        return douglas_peucker(corners, tolerance)
    far = int(np.hypot(*(corners - corners[0]).T).argmax())
    one, other = douglas_peucker(corners[: far + 1], tolerance), douglas_peucker(corners[far:], tolerance)
    ends = [*one[:-1], *(far + number for number in other)]
    # A closed line encloses something: a post of one cell needs a smaller tolerance.
    return ends if len(ends) > 3 else _split(corners, 0.5 * tolerance)


def _fit(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centre and direction of the line of total least squares through the middles of edges (n corners, 2)."""
    middles = 0.5 * (corners[:-1] + corners[1:])
    centre = middles.mean(axis=0)
    # The right singular vector of the largest singular value is the direction of the largest spread; a single edge has
    # its own direction.
    spread = middles - centre if len(middles) > 1 else corners - centre
    return centre, np.linalg.svd(spread, full_matrices=False)[2][0]


def _foot(line: tuple[FloatArray, FloatArray], point: FloatArray) -> FloatArray:
    """Return the point of a line nearest to a point."""
    centre, direction = line
    return centre + (point - centre) @ direction * direction


def _meeting(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray], corner: FloatArray,
             tolerance: float) -> FloatArray:
    """Return where two lines meet; if that is farther than the tolerance from the corner, the mean of its feet."""
    (centre, direction), (other_centre, other_direction) = one, other
    cross = direction[0] * other_direction[1] - direction[1] * other_direction[0]
    if abs(cross) > 1e-9:
        offset = other_centre - centre
        along = (offset[0] * other_direction[1] - offset[1] * other_direction[0]) / cross
        meeting: FloatArray = centre + along * direction
        if np.hypot(*(meeting - corner)) <= max(1.0, tolerance):
            return meeting
    return 0.5 * (_foot(one, corner) + _foot(other, corner))


def cells_of_world(world: World, size_in: float) -> OccupancyGrid:
    """Return the occupancy grid of a world.

    Cells that a wall crosses are occupied, cells connected with a start are free, all others unknown.

    Raises
    ------
    ValueError
        If the grid would have more than MAX_CELLS.
    """
    from scipy import ndimage

    # 1. Grid around all walls, its origin on a multiple of the cell size.
    ends = world.walls.reshape(-1, 2)
    low = np.floor((ends.min(axis=0) - MARGIN_IN) / size_in) * size_in
    shape = tuple(ceil(extent / size_in) for extent in ends.max(axis=0) + MARGIN_IN - low)
    if shape[0] * shape[1] > MAX_CELLS:
        raise ValueError(f"a grid of {shape[0]} x {shape[1]} cells is too large: use cells larger than {size_in:g} in")
    cells = np.full(shape, Cell.UNKNOWN, dtype=np.uint8)
    for wall in (world.walls.reshape(-1, 2, 2) - low) / size_in:
        for i, k in _crossed_cells(*wall):
            cells[i, k] = Cell.OCCUPIED
    # 2. Flood the space around each start. Obstacles and the outside of rooms stay unknown.
    labels, _ = ndimage.label(cells != Cell.OCCUPIED)
    for start in world.starts:
        i, k = (floor((value - edge) / size_in) for value, edge in zip((start.x_in, start.y_in), low, strict=True))
        if 0 <= i < shape[0] and 0 <= k < shape[1] and labels[i, k]:
            cells[labels == labels[i, k]] = Cell.FREE
    return OccupancyGrid(cells, size_in, (float(low[0]), float(low[1])))


def _crossed_cells(one: FloatArray, other: FloatArray) -> set[Corner]:
    """Return the cells that a segment crosses, ends given in cells."""
    # All crossings with grid lines divide the segment into pieces of one cell each.
    fractions = [np.array([0.0, 1.0])]
    for a, b in zip(one, other, strict=True):
        lines = np.arange(ceil(min(a, b)), floor(max(a, b)) + 1)
        fractions.append((lines - a) / (b - a) if a != b else np.zeros(0))
    ordered = np.unique(np.clip(np.concatenate(fractions), 0.0, 1.0))
    middles = 0.5 * (ordered[:-1] + ordered[1:])
    cells = np.floor(one + middles[:, None] * (other - one)).astype(int)
    return {(i, k) for i, k in cells.tolist()}


def roomiest_place(grid: OccupancyGrid) -> Point:
    """Return the place in inches that is farthest from anything that is not free.

    If the grid has no free cells, space that does not reach the grid's border counts as free, or else all of it.
    """
    from scipy import ndimage

    free = grid.cells == Cell.FREE
    if not free.any():
        labels, _ = ndimage.label(grid.cells != Cell.OCCUPIED)
        border = np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))
        free = (labels > 0) & ~np.isin(labels, border)
        free = free if free.any() else labels > 0
    distance = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    i, k = np.unravel_index(int(distance.argmax()), distance.shape)
    x, y = grid.to_map(np.array([i + 0.5, k + 0.5]))
    return float(x), float(y)


def braille_picture(world: World, columns: int, lines: int) -> str:
    """Return the walls of a world as lines of Braille characters, 2 x 4 dots each, at most columns x lines of them."""
    ends = world.walls.reshape(-1, 2)
    low, size = ends.min(axis=0), np.ptp(ends, axis=0)
    dot_in = max(*(size / (2 * columns - 1, 4 * lines - 1)).tolist(), 1e-6)
    rows = floor(float(size[1]) / dot_in + 1e-9) // 4 + 1
    codes = np.zeros((columns, rows), dtype=int)
    for wall in (world.walls.reshape(-1, 2, 2) - low) / dot_in:
        for i, k in _crossed_cells(*(wall + 1e-9)):
            # Rows of characters run from the top downwards, and so do the dots within each.
            row, dot = divmod(4 * rows - 1 - k, 4)
            codes[i // 2, row] |= _BRAILLE_DOTS[i % 2][dot]
    return "\n".join("".join(chr(_BRAILLE + code) for code in line).rstrip(chr(_BRAILLE)) for line in codes.T)
