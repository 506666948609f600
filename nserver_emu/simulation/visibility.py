"""Other robots and walls as sensors see them: the robots in range, the nearest on a ray, the walls within a cone.

The positions of robots at an instant are shared by all sensors that look at that instant. They may be computed later
than they are requested, but before any sensor uses them.

The walls that are visible in the cone of a transducer are computed in plain numbers, as in echo_paths.py. They stand in
blocks that have a box in common. A cone looks at the blocks between its sides, the nearest first, with a depth buffer:
behind a wall that covers a whole sector of the cone nothing is visible. Among a thousand obstacles that leaves some
twenty walls of 4,000.
"""

from __future__ import annotations

import sys
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import cached_property
from math import ceil, floor, inf, sqrt
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

import worlds.raycast
from worlds.compiled import CompiledFunction, is_compiled_for
from worlds.geometry import NO_DISCS, FloatArray
from worlds.raycast import nearest_wall, ray_to_disc, sort_by_range

MAX_ROBOT_RANGE_IN: Final = 500.0
"""No sensor notices a robot from farther away: readings end at 255 in, second echoes at about 400."""

GRAZING_IN: Final = 1e-6
"""Robots this much farther along x than their radius are looked at, too: rounding."""


class RobotPositions:
    """Positions of all robots at one instant: discs (n, 3), rows x y radius in inches; empty until computed."""

    def __init__(self, discs: FloatArray = NO_DISCS) -> None:
        self.discs = discs

    def at(self, instant_ps: int) -> RobotPositions:
        """Return these positions, whatever the instant: nothing moves (a `PositionProvider`)."""
        del instant_ps
        return self

    def near(self, x_in: float) -> FloatArray:
        """Return the robots (k, 4) whose x is within MAX_ROBOT_RANGE_IN: rows x y radius row, sorted by x."""
        first = bisect_left(self.rows, [x_in - MAX_ROBOT_RANGE_IN])
        return self.sorted[first : bisect_right(self.rows, [x_in + MAX_ROBOT_RANGE_IN, inf])]

    @cached_property
    def max_radius_in(self) -> float:
        """The largest radius, and GRAZING_IN more."""
        return float(self.discs[:, 2].max(initial=0.0)) + GRAZING_IN

    @cached_property
    def sorted(self) -> FloatArray:
        """The robots (n, 4), rows x y radius row, sorted by x."""
        order = self.discs[:, 0].argsort(kind="stable")
        return np.column_stack((self.discs[order], order))

    @cached_property
    def rows(self) -> list[list[float]]:
        """The same in lists, for plain Python."""
        rows: list[list[float]] = self.sorted.tolist()
        return rows


class PositionProvider(Protocol):
    """Provides the positions of the robots at an instant."""

    def at(self, instant_ps: int) -> RobotPositions:
        """Return the positions at an instant in picoseconds."""


NO_OTHERS: Final = RobotPositions()
"""The positions for a robot that is alone."""


class SensorPose(NamedTuple):
    """The true pose of the sensors, and the robots that they may detect.

    Attributes
    ----------
    x_in, y_in, turret_rad
        True position in inches and true direction of the turret in radians.
    robots
        Positions of all robots.
    self_index
        Row of this robot in them, which is not detected.
    """

    x_in: float
    y_in: float
    turret_rad: float
    robots: RobotPositions = NO_OTHERS
    self_index: int = 0

    @property
    def others(self) -> FloatArray:
        """The robots (k, 3) without this one and without those beyond MAX_ROBOT_RANGE_IN."""
        if len(self.robots.discs) < 2:
            return NO_DISCS
        # In the order of the rows, so that results do not depend on the sorting by x.
        near = self.robots.near(self.x_in)
        rows = np.sort(near[:, 3]).astype(np.intp)
        discs = self.robots.discs.take(rows[rows != self.self_index], axis=0)
        others: FloatArray = discs[np.abs(discs[:, 1] - self.y_in) <= MAX_ROBOT_RANGE_IN]
        return others


# The nearest robot on a ray.

FAR_IN: Final = 1e6
"""Farther than any wall."""


def nearest_disc(x: float, y: float, dx: float, dy: float, wall_in: float,
                 discs: Sequence[Sequence[float]] | FloatArray, own: int, max_radius_in: float) -> float:
    """Return the range from (x, y) along the unit vector (dx, dy) to the nearest robot, or to a nearer wall, inches.

    Parameters
    ----------
    wall_in
        Range to the nearest wall, inches; inf for none.
    discs
        Rows x y radius row, sorted by x: `RobotPositions.rows` or `sorted`. Row `own` is not met, nor are those whose x
        is farther than MAX_ROBOT_RANGE_IN.
    max_radius_in
        No less than any radius.
    """
    # 1. The interval of x in which a disc can be nearer than the wall.
    reach_x = min(wall_in, FAR_IN) * dx
    low = max(x + min(reach_x, 0.0) - max_radius_in, x - MAX_ROBOT_RANGE_IN)
    high = min(x + max(reach_x, 0.0) + max_radius_in, x + MAX_ROBOT_RANGE_IN)
    # 2. The nearest of the discs in it.
    nearest = wall_in
    for index in range(_first_from(discs, low), len(discs)):
        disc = discs[index]
        if disc[0] > high:
            break
        if disc[3] != own:
            nearest = min(nearest, ray_to_disc(x, y, dx, dy, disc))
    return nearest


def _first_from(discs: Sequence[Sequence[float]] | FloatArray, low: float) -> int:
    """Return the index of the first disc whose x is at least `low`: bisect_left, which numba does not have."""
    begin, end = 0, len(discs)
    while begin < end:
        middle = (begin + end) // 2
        if discs[middle][0] < low:
            begin = middle + 1
        else:
            end = middle
    return begin


def nearest_obstacle(x: float, y: float, dx: float, dy: float, walls: FloatArray, discs: FloatArray, own: int,
                     max_radius_in: float) -> float:
    """Return the range along a ray to the nearest wall (m, 4) or robot: `nearest_wall`, then `nearest_disc`."""
    rows = zip(walls[:, 0], walls[:, 1], walls[:, 2], walls[:, 3])  # noqa: B905  for numba
    wall_in = nearest_wall(x, y, dx, dy, rows)[0]
    return nearest_disc(x, y, dx, dy, wall_in, discs, own, max_radius_in)


def _example() -> tuple[Any, ...]:
    walls = np.zeros((1, 4))
    walls.setflags(write=False)
    return 0.0, 0.0, 1.0, 0.0, walls, np.zeros((0, 4)), 0, 1.0


NEAREST_OBSTACLE: Final = CompiledFunction(nearest_obstacle, lambda: (worlds.raycast, sys.modules[__name__]), _example)
"""`nearest_obstacle`, for read-only walls, where it is compiled; plain, `cast_each` and `nearest_disc` are faster."""


def load_compiled(robots: int) -> None:
    """Compile `NEAREST_OBSTACLE`, or load it, if NOMAD_COMPILED asks for it with so many robots."""
    if not NEAREST_OBSTACLE.is_compiled and is_compiled_for(robots):
        NEAREST_OBSTACLE.load()


TINY: Final = 1e-9
"""Fraction by which a wall or a path counts as longer: the echo of a square corner passes exactly through its vertex.
"""

BLOCK: Final = 8
"""Walls of a block, which have a box in common: walls of blocks beyond a cone are not looked at."""

FEW_BLOCKS: Final = 12
"""With more blocks in a cone, those that are hidden are left out, and its sectors are narrow."""

SECTORS: Final = 16
SECTORS_OF_CROWD: Final = 128
"""Sectors of a cone, evenly over the tangent of the angle: 1.6 degrees, and 0.2: a quarter of an inch at 6 feet."""

HIDDEN_IN: Final = 1e-5
"""A wall is hidden if it lies farther than this behind another: beyond the tolerance of an obstruction."""

APEX_IN: Final = 1e-3
"""A wall that reaches nearer to the plane of the transducer is always visible, and hides nothing there."""


class Reflectors(NamedTuple):
    """The walls, as columns x1, y1, x2, y2, and their surfaces.

    Attributes
    ----------
    boxes
        Columns x, y, half width, half height of a box around each BLOCK walls that follow one another, the rest in the
        last.
    begins, breaks_in, levels_in
        The levels of wall k stand from begins[k] on: distances from its first end, and inches to its left. All empty
        for planes.
    posts
        Columns x, y of points on the walls, and how the surface displaces them.
    """

    walls: Any
    boxes: Any
    begins: Any
    breaks_in: Any
    levels_in: Any
    posts: Any


class Beam(NamedTuple):
    """The cone of a transducer: its apex, and its axis as a unit vector."""

    x: float
    y: float
    dx: float
    dy: float


Wall = tuple[float, float, float, float]
"""A wall x1, y1, x2, y2."""


def distance(x1: float, y1: float, x2: float, y2: float) -> float:
    """Return the distance of two points."""
    return sqrt((x2 - x1) * (x2 - x1) + (y2 - y1) * (y2 - y1))


def in_frame(beam: Beam, x: float, y: float) -> tuple[float, float]:
    """Return a point relative to a beam: along its axis, and to its left."""
    to_x, to_y = x - beam.x, y - beam.y
    return to_x * beam.dx + to_y * beam.dy, beam.dx * to_y - beam.dy * to_x


def blocks_between(x: float, y: float, right_x: float, right_y: float, left_x: float, left_y: float, reach_in: float,
                   boxes: Any) -> list[tuple[float, int]]:
    """Return the blocks of walls that may reach between two directions from a point: distance of the box, and number.

    The left direction is at most half a turn to the left of the right one; `reach_in` counts along x and along y.
    """
    found = [(0.0, 0) for _ in range(0)]
    columns = zip(boxes[0], boxes[1], boxes[2], boxes[3])  # noqa: B905  for numba
    for block, (middle_x, middle_y, half_x, half_y) in enumerate(columns):
        to_x, to_y = middle_x - x, middle_y - y
        if (
            abs(to_x) <= reach_in + half_x
            and abs(to_y) <= reach_in + half_y
            and right_x * to_y - right_y * to_x >= -(abs(right_x) * half_y + abs(right_y) * half_x)
            and left_x * to_y - left_y * to_x <= abs(left_x) * half_y + abs(left_y) * half_x
        ):
            away_in = distance(0.0, 0.0, max(abs(to_x) - half_x, 0.0), max(abs(to_y) - half_y, 0.0))
            found.append((away_in, block))
    return found


def walls_of(blocks: list[tuple[float, int]], walls: Any) -> list[tuple[int, Wall]]:
    """Return the walls of blocks, with their numbers."""
    found = [(0, (0.0, 0.0, 0.0, 0.0)) for _ in range(0)]
    x1, y1, x2, y2 = walls
    for _, block in blocks:
        row, end = BLOCK * block, BLOCK * block + BLOCK
        for wall in zip(x1[row:end], y1[row:end], x2[row:end], y2[row:end]):  # noqa: B905  for numba
            found.append((row, wall))
            row += 1
    return found


def walls_in_cone(beam: Beam, slope: float, reach_in: float, reflectors: Reflectors) -> tuple[list[int], list[Wall]]:
    """Return the walls that can reach into a cone: not beyond a side, not behind, not too far; few of those hidden."""
    found, walls = [0 for _ in range(0)], [(0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    left_x, left_y, boxes = -slope * beam.dy, slope * beam.dx, reflectors.boxes
    blocks = blocks_between(beam.x, beam.y, beam.dx - left_x, beam.dy - left_y, beam.dx + left_x, beam.dy + left_y,
                            reach_in, boxes)
    # Where there are several, the nearest first, and no wall that is hidden behind those before it.
    is_crowded = len(blocks) > 1
    hidden_in = [inf for _ in range(SECTORS_OF_CROWD if len(blocks) > FEW_BLOCKS else SECTORS)]
    if is_crowded:
        sort_by_range(blocks)
    for entry in blocks:
        if len(blocks) > FEW_BLOCKS and is_box_hidden(beam, slope, entry[1], boxes, hidden_in):
            continue
        for row, wall in walls_of([entry], reflectors.walls):
            ahead_1, left_1 = in_frame(beam, wall[0], wall[1])
            ahead_2, left_2 = in_frame(beam, wall[2], wall[3])
            rim_1, rim_2 = slope * ahead_1, slope * ahead_2
            if not (
                (left_1 > rim_1 and left_2 > rim_2)
                or (left_1 < -rim_1 and left_2 < -rim_2)
                or (ahead_1 < 0.0 and ahead_2 < 0.0)
                or (ahead_1 > reach_in and ahead_2 > reach_in)
                or (is_crowded and is_hidden_or_hides(beam, slope, wall, hidden_in))
            ):
                found.append(row)
                walls.append(wall)
    return found, walls


# Depth buffer of a cone: of each of its sectors, from right to left, the depth behind which nothing is visible


def is_hidden_or_hides(beam: Beam, slope: float, wall: Wall, hidden_in: list[float]) -> bool:
    """Return True if a wall is hidden; otherwise enter it into the depth buffer."""
    ahead_1, left_1, ahead_2, left_2 = ends_ahead(beam, wall)
    low, high, nearest_in = span_of(ahead_1, left_1, ahead_2, left_2, slope, len(hidden_in))
    if is_hidden(low, high, nearest_in, hidden_in):
        return True
    # How far ahead it is at the rims of the sectors that it covers.
    cross, along, to_left = ahead_1 * left_2 - ahead_2 * left_1, ahead_2 - ahead_1, left_2 - left_1
    first, last = max(ceil(low + TINY), 0), min(floor(high - TINY), len(hidden_in))
    right_in = inf
    for rim in range(first, last + 1):
        left_in = cross / (to_left - slope * (2.0 * rim / len(hidden_in) - 1.0) * along)
        if rim > first:
            hidden_in[rim - 1] = min(hidden_in[rim - 1], max(right_in, left_in) + HIDDEN_IN)
        right_in = left_in
    return False


def is_box_hidden(beam: Beam, slope: float, block: int, boxes: Any, hidden_in: list[float]) -> bool:
    """Return True if all of a block's box is hidden: its diagonals span it."""
    x, y, half_x, half_y = boxes[0][block], boxes[1][block], boxes[2][block], boxes[3][block]
    one, two = (x - half_x, y - half_y, x + half_x, y + half_y), (x - half_x, y + half_y, x + half_x, y - half_y)
    ahead_1, left_1, ahead_2, left_2 = ends_ahead(beam, one)
    low_1, high_1, nearest_1_in = span_of(ahead_1, left_1, ahead_2, left_2, slope, len(hidden_in))
    ahead_1, left_1, ahead_2, left_2 = ends_ahead(beam, two)
    low_2, high_2, nearest_2_in = span_of(ahead_1, left_1, ahead_2, left_2, slope, len(hidden_in))
    return is_hidden(min(low_1, low_2), max(high_1, high_2), min(nearest_1_in, nearest_2_in), hidden_in)


def is_hidden(low: float, high: float, nearest_in: float, hidden_in: list[float]) -> bool:
    """Return True if what lies between two places in the sectors, not nearer than this, is hidden in all of them."""
    if nearest_in <= APEX_IN:
        return False
    for sector in range(max(floor(low - TINY), 0), min(floor(high + TINY) + 1, len(hidden_in))):
        if nearest_in <= hidden_in[sector]:
            return False
    return True


def span_of(ahead_1: float, left_1: float, ahead_2: float, left_2: float, slope: float,
            sectors: int) -> tuple[float, float, float]:
    """Return between which places in the sectors a wall lies, and how far ahead it begins."""
    place_1, place_2 = left_1 / (ahead_1 * slope), left_2 / (ahead_2 * slope)
    low, high = 0.5 * sectors * (min(place_1, place_2) + 1.0), 0.5 * sectors * (max(place_1, place_2) + 1.0)
    return low, high, min(ahead_1, ahead_2)


def ends_ahead(beam: Beam, wall: Wall) -> tuple[float, float, float, float]:
    """Return the ends of a wall relative to a beam, without the part that is not APEX_IN ahead of the apex."""
    ahead_1, left_1 = in_frame(beam, wall[0], wall[1])
    ahead_2, left_2 = in_frame(beam, wall[2], wall[3])
    if ahead_1 < APEX_IN < ahead_2:
        left_1 += (APEX_IN - ahead_1) / (ahead_2 - ahead_1) * (left_2 - left_1)
        ahead_1 = APEX_IN
    elif ahead_2 < APEX_IN < ahead_1:
        left_2 += (APEX_IN - ahead_2) / (ahead_1 - ahead_2) * (left_1 - left_2)
        ahead_2 = APEX_IN
    return max(ahead_1, APEX_IN), left_1, max(ahead_2, APEX_IN), left_2
