"""Find problems of a map: walls that nearly meet, doubled walls, short walls, starts without space, closed-off space.

    gap         an end of a wall that stops just before another wall: sonars measure through, robots do not fit
    doubled     two parallel walls that overlap at almost no distance
    crumb       a wall too short for any sonar to measure
    surface     measured spots that are not on their wall: it was moved without them
    start       a start where the robot does not fit
    closed off  space that the robot fits into and cannot reach from the starts; without rooms, less than the robot's
                area at the edge of the map is none, as between the faces of a wedge that was measured from one side

Space is searched on a grid: a passage wider than the robot by less than two grid steps may count as closed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import pi
from typing import Final, NamedTuple

import numpy as np

from worlds.geometry import (
    BoolArray,
    FloatArray,
    IndexArray,
    candidate_pairs,
    lengths,
    nearest_points_of_pairs,
    normals,
)
from worlds.world import AT_ORIGIN, World

TOUCHING_IN: Final = 1e-6
"""Ends within this distance of a wall touch it."""
MAX_CELLS: Final = 40_000
CELLS_PER_ROBOT: Final = 24.0
"""Finest grid: cells across a robot's diameter."""


@dataclass(frozen=True, slots=True)
class ValidationLimits:
    """Limits of `validate`.

    In inches: widest gap; distance and overlap of doubled walls; longest short segment; farthest measured spot of a
    surface from its wall. In square inches: smallest closed-off space.
    """

    gap_in: float = 4.0
    apart_in: float = 0.5
    overlap_in: float = 1.0
    short_segment_in: float = 0.5
    spot_in: float = 12.0
    space_in2: float = 16.0


class Finding(NamedTuple):
    """A problem: kind, position (x, y) in inches, description."""

    kind: str
    place_in: tuple[float, float]
    words: str


class FreeSpace(NamedTuple):
    """Grid of positions where a robot fits (n, k), and which of them can be reached from the starts.

    `xs` (n,) and `ys` (k,) are in inches, `step_in` apart.
    """

    xs: FloatArray
    ys: FloatArray
    step_in: float
    fits: BoolArray
    reached: BoolArray


def validate_world(world: World, radius_in: float, limits: ValidationLimits | None = None) -> list[Finding]:
    """Return all problems of a world for a robot of this radius."""
    limits = limits or ValidationLimits()
    return [
        # Obstacles stand where they stand: a cupboard at a wall is no mistake of the map.
        *_gaps(world.fixed_walls, limits),
        *_doubled(world, limits),
        *_short_segments(world.walls, limits),
        *_surfaces(world, limits),
        *_starts(world, radius_in),
        # Doors can be opened.
        *_closed_off(find_free_space(replace(world, doors=()), radius_in), limits, 0.0 if world.rooms else radius_in),
    ]


def find_free_space(world: World, radius_in: float, step_in: float = 0.0) -> FreeSpace:
    """Return where a robot fits and what it can reach.

    `step_in` is the grid step; 0 selects a twelfth of the robot's radius, coarser in a large world.
    """
    # 1. Grid.
    ends = world.walls.reshape(-1, 2)
    low, size = ends.min(axis=0), np.ptp(ends, axis=0)
    finest = max(2.0 * radius_in / CELLS_PER_ROBOT, float(np.sqrt(size.prod() / MAX_CELLS)))
    step = min(step_in or finest, radius_in)
    xs, ys = (np.arange(begin, begin + extent + step, step) for begin, extent in zip(low, size, strict=True))
    # 2. Where the robot fits.
    fits = world.clearances(np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1)) >= radius_in
    # 3. What is connected to a start.
    open_nodes = OpenNodes(fits)
    for start in world.starts:
        seed = _nearest_fit(fits, (start.x_in - low[0]) / step, (start.y_in - low[1]) / step)
        if seed is not None:
            open_nodes.flood(*seed)
    return FreeSpace(xs, ys, step, fits, fits & ~open_nodes.left)


def _nearest_fit(fits: BoolArray, column: float, row: float) -> tuple[int, int] | None:
    """Return the nearest of the four surrounding grid nodes where the robot fits; None if it fits at none."""
    # The nodes of the grid cell around the point; those outside of the grid are skipped.
    around = [(int(column) + i, int(row) + k) for i in (0, 1) for k in (0, 1)]
    there = [node for node in around if 0 <= node[0] < fits.shape[0] and 0 <= node[1] < fits.shape[1] and fits[node]]
    return min(there, key=lambda node: (node[0] - column) ** 2 + (node[1] - row) ** 2, default=None)


NO_NODES: Final[IndexArray] = np.zeros((0, 2), dtype=np.intp)


class OpenNodes:
    """The nodes of a grid (n, k) that no flood fill has reached yet."""

    def __init__(self, is_open: BoolArray) -> None:
        # A border of closed nodes; bytes are read several times as fast as elements of arrays.
        bordered = np.pad(is_open, 1)
        self._open, self._width = bytearray(bordered.tobytes()), bordered.shape[1]

    @property
    def left(self) -> BoolArray:
        """Return the nodes (n, k) that are left, as True."""
        bordered = np.frombuffer(self._open, dtype=bool).reshape(-1, self._width)
        return bordered[1:-1, 1:-1].copy()

    def flood(self, i: int, k: int) -> IndexArray:
        """Remove all nodes connected to a node, and return them (m, 2) in order.

        Steps are no longer than the radius, so none leads through a wall.
        """
        is_open, width = self._open, self._width
        seed = (i + 1) * width + k + 1
        if not is_open[seed]:
            return NO_NODES
        is_open[seed] = 0
        nodes = [seed]
        for node in nodes:  # grows meanwhile
            for beside in (node - width, node + width, node - 1, node + 1):
                if is_open[beside]:
                    is_open[beside] = 0
                    nodes.append(beside)
        return np.stack(np.divmod(np.sort(np.array(nodes, dtype=np.intp)), width), axis=-1) - 1


def _gaps(walls: FloatArray, limits: ValidationLimits) -> Iterator[Finding]:
    """Yield ends of walls that stop just before another wall; short segments and doubled walls are excluded."""
    # 1. Each wall with each other one nearby. Short segments and doubled walls are reported separately.
    short = lengths(walls) < limits.short_segment_in
    doubled = {(one, other) for one, other, *_ in _overlaps(walls, limits)}
    near = [pair for pair in _near_pairs(walls, limits.gap_in) if pair not in doubled and not short[list(pair)].any()]
    one, other = np.array(near, dtype=np.intp).reshape(-1, 2).T
    # 2. Both ends of each wall with the other one: rows of the end and of the wall.
    ends = np.concatenate((2 * one, 2 * one + 1, 2 * other, 2 * other + 1))
    others = np.concatenate((other, other, one, one))
    points, far = nearest_points_of_pairs(walls.reshape(-1, 2)[ends], walls[others])
    # 3. The nearest other wall of each end; a gap is near, but not touching.
    order = np.lexsort((others, far, ends))
    _, first = np.unique(ends[order], return_index=True)
    for row in order[first].tolist():
        gap = far[row]
        if TOUCHING_IN < gap <= limits.gap_in:
            end, (at_x, at_y) = int(ends[row]), points[row]
            x, y = walls.reshape(-1, 2)[end]
            yield Finding("gap", (float(x), float(y)),
                          f"{_wall(walls, end // 2)} stops {gap:.3g} in short of ({at_x:g}, {at_y:g}) on "
                          f"{_wall(walls, int(others[row]))}")


def _near_pairs(walls: FloatArray, reach_in: float) -> list[tuple[int, int]]:
    """Return pairs of rows in order: at least all walls that come within a distance of each other."""
    blocks = [one * len(walls) + other for one, other in candidate_pairs(walls, reach_in)]
    return [divmod(pair, len(walls)) for pair in np.unique(np.concatenate(blocks)).tolist()] if blocks else []


def _doubled(world: World, limits: ValidationLimits) -> Iterator[Finding]:
    """Yield walls on top of each other, without the side of a closed outline that stands at a wall, as a cupboard."""
    # 1. Outlines of inner walls, and those of them that lie on other walls with some of their sides only.
    walls, first_inner = world.fixed_walls, len(world.fixed_walls) - len(world.inner_walls)
    pairs = list(_overlaps(walls, limits))
    doubled = {row for one, other, *_ in pairs for row in (one, other)}
    at_walls = {row for outline in _closed_outlines(walls, first_inner) if not doubled.issuperset(outline)
                for row in outline}  # fmt: skip
    # 2. All other pairs.
    for one, other, (x, y), overlap, apart in pairs:
        if one in at_walls or other in at_walls:
            continue
        yield Finding("doubled", (x, y),
                      f"{_wall(walls, one)} and {_wall(walls, other)} lie over one another for {overlap:.3g} in, "
                      f"{apart:.3g} in apart at most")


def _closed_outlines(walls: FloatArray, first: int) -> Iterator[range]:
    """Yield the rows of each closed outline of three or more walls in sequence, from a row on."""
    begin = first
    for row in range(first, len(walls)):
        if row > begin and np.hypot(*(walls[row, :2] - walls[row - 1, 2:])) > TOUCHING_IN:
            begin = row
        if row >= begin + 2 and np.hypot(*(walls[row, 2:] - walls[begin, :2])) <= TOUCHING_IN:
            yield range(begin, row + 1)
            begin = row + 1


def _overlaps(walls: FloatArray,
              limits: ValidationLimits) -> Iterator[tuple[int, int, tuple[float, float], float, float]]:
    """Yield pairs of doubled walls: rows, middle of the overlap, its length, and their distance."""
    for number, other in _near_pairs(walls, limits.apart_in):
        # 1. Ends of the other wall in the frame of this one: along its direction and across it.
        wall = walls[number]
        length = float(np.hypot(*(wall[2:] - wall[:2])))
        along = (wall[2:] - wall[:2]) / length
        off = walls[other].reshape(2, 2) - wall[:2]
        # 2. Distance: the farther end across. Overlap: the common part of both spans along.
        apart = np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]).max()
        begin, end = sorted((off @ along).tolist())
        overlap = min(end, length) - max(begin, 0.0)
        if apart <= limits.apart_in and overlap >= limits.overlap_in:
            x, y = wall[:2] + along * 0.5 * (min(end, length) + max(begin, 0.0))
            yield number, other, (float(x), float(y)), overlap, float(apart)


def _short_segments(walls: FloatArray, limits: ValidationLimits) -> Iterator[Finding]:
    for number in np.flatnonzero(lengths(walls) < limits.short_segment_in):
        x, y = walls[number, :2]
        words = f"{_wall(walls, int(number))} is {float(lengths(walls[number])):.3g} in long"
        yield Finding("crumb", (float(x), float(y)), words)


def _surfaces(world: World, limits: ValidationLimits) -> Iterator[Finding]:
    for row, accuracy in sorted(world.accuracies.items()):
        if not accuracy.surface:
            continue
        wall = world.inner_walls[row : row + 1]
        off = np.array([spot[:2] for spot in accuracy.surface]) - wall[0, :2]
        away = np.abs(off @ normals(wall)[0])
        if (far := int((away > limits.spot_in).sum())) > 0:
            words = f"{far} of {len(away)} measured spots are up to {away.max():.1f} in from their wall"
            place = accuracy.surface[int(away.argmax())][:2]
            yield Finding("surface", place, f"{words}: if it was moved, remove its surface_in from the file")


def _starts(world: World, radius_in: float) -> Iterator[Finding]:
    for number, start in enumerate(world.starts):
        clearance = world.clearance(start.x_in, start.y_in)
        if clearance < radius_in:
            name = f"start {number}" if world.starts is not AT_ORIGIN else "no [[start]] is given, and (0, 0)"
            room = f"has {clearance:.3g} in of room" if clearance > 0 else "lies outside of all rooms or in a wall"
            words = f"{name} {room}; the robot's radius is {radius_in:g} in"
            yield Finding("start", (start.x_in, start.y_in), words)


def _closed_off(found: FreeSpace, limits: ValidationLimits, outside_in: float) -> Iterator[Finding]:
    """Yield each closed-off space, the largest first, without those at the edge of less area than a disc."""
    # 1. Connected regions that no start reaches, by flood fill; those above the minimum area.
    open_nodes, last = OpenNodes(found.fits & ~found.reached), np.array(found.fits.shape) - 1
    regions = [open_nodes.flood(i, k) for i, k in np.argwhere(open_nodes.left).tolist()]
    spaces = []
    for region in regions:
        is_at_edge = bool(((region == 0) | (region == last)).any())
        area_in2 = len(region) * found.step_in**2
        if area_in2 >= (max(limits.space_in2, pi * outside_in**2) if is_at_edge else limits.space_in2):
            spaces.append(region)
    # 2. The position is the node nearest to the region's mean.
    for nodes in sorted(spaces, key=len, reverse=True):
        area = len(nodes) * found.step_in**2
        middle = nodes[np.square(nodes - nodes.mean(axis=0)).sum(axis=1).argmin()]
        x, y = float(found.xs[middle[0]]), float(found.ys[middle[1]])
        words = f"{area:.0f} in^2 for the robot's axis around ({x:.0f}, {y:.0f}) cannot be reached from a start"
        yield Finding("closed off", (x, y), words)


def _wall(walls: FloatArray, number: int) -> str:
    x1, y1, x2, y2 = walls[number]
    return f"the wall ({x1:g}, {y1:g})-({x2:g}, {y2:g})"
