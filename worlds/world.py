"""The map a robot drives in: rooms, walls, obstacles, starts, and the paths of the figures. Immutable values.

Inches and radians. Free space is inside a room (if there are rooms) and outside of all obstacles. Walls and rooms are
fixed; obstacles may be added, moved and deleted by clients (`with_obstacles`).

    walls (m, 4)    = fixed_walls | obstacles | closed doors     a fixed wall keeps its row when the others change
    fixed_walls     = outlines of the rooms | inner_walls

Walkers are no walls: they move, so each simulation of the world has their positions.

A world as an SVG picture: what a notebook shows of a `World`, and the gallery of docs/worlds.md.

y points up as in the world; lengths in the picture are inches, stroke widths pixels.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from html import escape
from itertools import compress, count
from math import inf, isfinite
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from nclient.errors import StartError
from worlds.geometry import FloatArray, IndexArray, inside, nearest_distances, nearest_points, normals, polygon_segments
from worlds.raycast import ON_WALL_IN
from worlds.schema import MAX_COORDINATE_IN

Point = tuple[float, float]

MAX_CORNERS, MAX_STARTS, MAX_PATH_POINTS = 50_000, 1_000, 2_000
"""Size of a world: corners and points of its rooms, walls and obstacles; starts; points of its paths. The file of a
larger world is rejected: a simulated sonar compares each wall with each ray."""

MAX_DOORS, MAX_WALKERS, MAX_ROUTE_POINTS = 200, 50, 200
"""Doors and walkers of a world, and points of a walker's route."""

MAX_OUTLINE_CORNERS: Final = 1_000_000
"""Corners of rooms and obstacles in a restored world; clients may add more obstacles than a file may have."""

MARGIN_IN: Final = 0.1
"""Extra distance from walls of the alternative position in an error message, inches."""


@dataclass(frozen=True, slots=True)
class Polygon:
    """A closed outline of a room (free inside) or an obstacle (solid inside); corners in inches, any orientation."""

    corners_in: tuple[Point, ...]
    name: str = ""

    def segments(self) -> FloatArray:
        """Return the edges (n, 4) in inches, in the order of the corners, the closing one last."""
        return polygon_segments(self.corners_in)

    def moved(self, dx_in: float, dy_in: float) -> Polygon:
        """Return the polygon shifted by (dx_in, dy_in)."""
        return replace(self, corners_in=tuple((x + dx_in, y + dy_in) for x, y in self.corners_in))


@dataclass(frozen=True, slots=True)
class StartPose:
    """Initial pose of a robot; angles counter-clockwise from the x axis."""

    x_in: float
    y_in: float
    steering_rad: float = 0.0
    turret_rad: float = 0.0


AT_ORIGIN: Final = (StartPose(0.0, 0.0),)
"""Starts of a world that defines none."""


class SurfaceSpot(NamedTuple):
    """A measured spot of a wall's surface, which is beside the line of the wall by a level.

    Attributes
    ----------
    x_in, y_in
        Where it is; the level is its distance from the wall, and holds for SPOT_REACH_IN along it to either side.
    std_in
        Standard deviation of the level.
    """

    x_in: float
    y_in: float
    std_in: float


SPOT_REACH_IN: Final = 2.0
"""Distance along a wall over which the level of a spot holds, to either side."""


class WallAccuracy(NamedTuple):
    """Accuracy of a measured wall, and its surface.

    Attributes
    ----------
    offset_std_in
        Standard deviation of its position across its direction, at the middle of what was measured.
    angle_std_rad
        Standard deviation of its direction.
    measured_in
        Length over which it was measured; the rest joins it to its neighbours.
    surface
        Measured spots; none of a wall that is a plane.
    """

    offset_std_in: float
    angle_std_rad: float
    measured_in: float
    surface: tuple[SurfaceSpot, ...] = ()


def is_valid_accuracy(accuracy: WallAccuracy) -> bool:
    """Return True if no standard deviation or length is below 0, and all numbers are within the largest coordinate."""
    coordinates = [number for x_in, y_in, _ in accuracy.surface for number in (x_in, y_in)]
    deviations = [accuracy.offset_std_in, accuracy.angle_std_rad, accuracy.measured_in]
    deviations += [spot.std_in for spot in accuracy.surface]
    return all(0.0 <= number <= MAX_COORDINATE_IN for number in deviations) and all(
        abs(number) <= MAX_COORDINATE_IN for number in coordinates
    )


def moved_surface(surface: Iterable[SurfaceSpot], before: Sequence[float],
                  after: Sequence[float]) -> tuple[SurfaceSpot, ...]:  # fmt: skip
    """Return the spots of a wall that was x1 y1 x2 y2 before: at the same fraction of its length, as far beside it."""
    spots = tuple(surface)
    if not spots:
        return ()
    begins, spans = zip(*((complex(*ends[:2]), complex(*ends[2:]) - complex(*ends[:2])) for ends in (before, after)),
                        strict=True)  # fmt: skip
    found = []
    for x, y, std_in in spots:
        # The fraction, and the distance to the left.
        place = (complex(x, y) - begins[0]) / spans[0]
        moved = begins[1] + spans[1] * complex(place.real, place.imag * abs(spans[0]) / abs(spans[1]))
        found.append(SurfaceSpot(moved.real, moved.imag, std_in))
    return tuple(found)


def spots_beside(surface: Iterable[SurfaceSpot], wall: Sequence[float]) -> tuple[SurfaceSpot, ...]:
    """Return the spots that are beside a wall x1 y1 x2 y2, not beyond its ends."""
    begin, end = complex(*wall[:2]), complex(*wall[2:])
    along = (end - begin) / abs(end - begin)
    return tuple(
        spot for spot in surface
        if -SPOT_REACH_IN <= ((complex(spot.x_in, spot.y_in) - begin) * along.conjugate()).real
        <= abs(end - begin) + SPOT_REACH_IN
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Path:
    """Waypoints of a figure of the thesis; the first of `points_in` is the start."""

    name: str
    figure: str
    start: StartPose
    points_in: tuple[Point, ...]

    @property
    def goals_in(self) -> tuple[Point, ...]:
        """Waypoints to drive to, in order: all but the first point."""
        return self.points_in[1:]


@dataclass(frozen=True, slots=True)
class Door:
    """A wall that can be opened: while it is open, there is nothing. `name` identifies it in its world."""

    name: str
    ends_in: tuple[Point, Point]
    is_open: bool = False


@dataclass(frozen=True, slots=True)
class Walker:
    """A person who walks along a route again and again, simulated as a disc.

    Attributes
    ----------
    points_in
        The route, two points or more.
    speed_in_s
        Walking speed.
    radius_in
        Radius of the disc.
    is_closed
        True: from the last point on to the first. False: back along the same route.
    """

    points_in: tuple[Point, ...]
    speed_in_s: float = 20.0
    radius_in: float = 7.0
    is_closed: bool = False
    name: str = ""


def _no_walls() -> FloatArray:
    return np.empty((0, 4))


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A map, immutable. Arrays are read-only; rows are x1 y1 x2 y2 in inches.

    `accuracies` are of measured inner walls, `wall_names` of labelled ones, by their rows in `inner_walls`.
    """

    name: str
    title: str = ""
    rooms: tuple[Polygon, ...] = ()
    inner_walls: FloatArray = field(default_factory=_no_walls, repr=False)
    obstacles: tuple[Polygon, ...] = ()
    starts: tuple[StartPose, ...] = AT_ORIGIN
    paths: Mapping[str, Path] = field(default_factory=dict)
    accuracies: Mapping[int, WallAccuracy] = field(default_factory=dict)
    doors: tuple[Door, ...] = ()
    walkers: tuple[Walker, ...] = ()
    wall_names: Mapping[int, str] = field(default_factory=dict)
    fixed_walls: FloatArray = field(init=False, repr=False)
    walls: FloatArray = field(init=False, repr=False)
    _edges: FloatArray = field(init=False, repr=False)
    _firsts: IndexArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # 1. Segments by origin: outlines, inner walls, obstacles. Fixed walls come first, so that obstacles do not
        # change their rows.
        rooms = [room.segments() for room in self.rooms]
        solids = [thing.segments() for thing in self.obstacles]
        inner = _stacked([np.asarray(self.inner_walls, dtype=np.float64)])
        fixed = _stacked([*rooms, inner])
        doors = np.array([np.ravel(door.ends_in) for door in self.closed_doors]).reshape(-1, 4)
        # 2. Derived arrays; edges of closed outlines are separate, for the test of points inside.
        derived = {
            "inner_walls": inner,
            "fixed_walls": fixed,
            "walls": _stacked([fixed, *solids, doors]),
            "paths": MappingProxyType(dict(self.paths)),
            "accuracies": MappingProxyType(dict(self.accuracies)),
            "wall_names": MappingProxyType(dict(self.wall_names)),
            "_edges": _stacked([*rooms, *solids]),
            "_firsts": _first_rows([*rooms, *solids]),
        }
        # 3. The dataclass is frozen, so the fields are set past its __setattr__.
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def _repr_html_(self) -> str:

        return world_svg(self)

    @property
    def closed_doors(self) -> list[Door]:
        """The doors that are walls now."""
        return [door for door in self.doors if not door.is_open]

    def with_obstacles(self, obstacles: Iterable[Polygon]) -> World:
        """Return this world with other obstacles; fixed walls keep their rows.

        Rows of obstacles that remain at the beginning and at the end are copied, not computed.
        """
        # 1. The obstacles that are the same at both ends.
        before, after = self.obstacles, tuple(obstacles)
        head = _equal_items(before, after)
        tail = min(_equal_items(before[::-1], after[::-1]), min(len(before), len(after)) - head)
        # 2. Their rows, with the new ones in between.
        new = [polygon.segments() for polygon in after[head : len(after) - tail]]
        firsts, rooms = np.append(self._firsts, len(self._edges)), len(self.rooms)
        begin, end = int(firsts[rooms + head]), int(firsts[rooms + len(before) - tail])
        inner = len(self.inner_walls)
        added = sum(map(len, new)) - (end - begin)
        derived = {
            "obstacles": after,
            "walls": _stacked([self.walls[: begin + inner], *new, self.walls[end + inner :]]),
            "_edges": _stacked([self._edges[:begin], *new, self._edges[end:]]),
            "_firsts": np.concatenate((
                firsts[: rooms + head], begin + _first_rows(new), firsts[rooms + len(before) - tail : -1] + added
            )),
        }  # fmt: skip
        # 3. A copy with those values, set as in __post_init__.
        world = copy(self)
        for name, value in derived.items():
            object.__setattr__(world, name, value)
        return world

    def with_inner_wall(self, row: int, *walls: Sequence[float]) -> World:
        """Return this world with walls (x1 y1 x2 y2) in place of one row of `inner_walls`.

        A row past the last adds them. What was measured of the replaced wall is forgotten; one wall in its place
        keeps its name.
        """
        new = np.reshape(np.asarray(walls, dtype=np.float64), (-1, 4))
        inner = np.concatenate((self.inner_walls[:row], new, self.inner_walls[row + 1 :]))
        # Rows behind it move by the number of walls that were added.
        added = len(new) - 1
        accuracies = {k + added if k > row else k: value for k, value in self.accuracies.items() if k != row}
        names = {k + added if k > row else k: name for k, name in self.wall_names.items() if k != row or len(new) == 1}
        return replace(self, inner_walls=inner, accuracies=accuracies, wall_names=names)

    def obstacles_with_corner(self, x_in: float, y_in: float, within_in: float) -> list[int]:
        """Return the numbers of obstacles with a corner within a distance in x and y of a point, increasing."""
        first = self._firsts[len(self.rooms)] if self.obstacles else 0
        corners = self._edges[first:, :2]
        rows = np.flatnonzero((np.abs(corners - (x_in, y_in)) <= within_in).all(axis=1)) + first
        numbers = np.searchsorted(self._firsts[len(self.rooms) :], rows, side="right") - 1
        return sorted(set(numbers.tolist()))

    def clearance(self, x_in: float, y_in: float) -> float:
        """Return the distance from a point to the nearest wall, inches; inf if there are no walls.

        It is negative outside of all rooms and inside obstacles. A robot of radius r fits where clearance > r.
        """
        return self._nearest(x_in, y_in)[0]

    def clearances(self, points_in: FloatArray) -> FloatArray:
        """Return the clearance (...) of points (..., 2)."""
        far = nearest_distances(points_in, self.walls)
        if len(self._firsts):
            # Negative where a point is in no room (if there are rooms) or inside an obstacle.
            within, rooms = inside(points_in, self._edges, self._firsts), len(self.rooms)
            outside = ~within[..., :rooms].any(axis=-1) if rooms else np.zeros(far.shape, dtype=bool)
            far[outside | within[..., rooms:].any(axis=-1)] *= -1.0
        return far

    def require_free(self, x_in: float, y_in: float, radius_in: float) -> None:
        """Raise StartError if a robot of this radius does not fit at a start.

        The message states what the robot touches, or that the start lies outside, and where it would fit.
        """
        place = f"the start ({x_in:g}, {y_in:g}) in"
        if not (isfinite(x_in) and isfinite(y_in)):
            raise StartError(f"{place} is not a position: expected two finite numbers")
        # 1. It fits.
        clearance, row, _ = self._nearest(x_in, y_in)
        if clearance > radius_in:
            return
        # 2. Outside, inside an obstacle, or too near to a wall.
        problem = self._solid_around(x_in, y_in)
        if not problem or abs(clearance) <= ON_WALL_IN:
            wall = self._describe_wall(row)
            problem = f"touches {wall}: {abs(clearance):.2f} in away, the robot's radius is {radius_in:g} in"
        raise StartError(f"{place} {problem}; {self._proposal(x_in, y_in, radius_in)}")

    def _nearest(self, x_in: float, y_in: float) -> tuple[float, int, Point]:
        """Return the clearance of a point, the row of its nearest wall (-1: none) and the nearest point on it."""
        if not len(self.walls):
            return inf, -1, (x_in, y_in)
        points, distances = nearest_points((x_in, y_in), self.walls)
        row = int(distances.argmin())
        distance = float(distances[row])
        nearest = (float(points[row, 0]), float(points[row, 1]))
        return (-distance if self._solid_around(x_in, y_in) else distance), row, nearest

    def _solid_around(self, x_in: float, y_in: float) -> str:
        """Return why a point is not in free space, as the end of a sentence; "" if it is."""
        if not len(self._firsts):
            return ""
        within = inside((x_in, y_in), self._edges, self._firsts).tolist()
        rooms = len(self.rooms)
        if rooms and not any(within[:rooms]):
            low, high = self._edges.reshape(-1, 2).min(axis=0), self._edges.reshape(-1, 2).max(axis=0)
            return (f"lies outside the world {self.name}, which spans x from {low[0]:g} to {high[0]:g} and y from "
                    f"{low[1]:g} to {high[1]:g} in")
        solids = [thing for thing, holds in zip(self.obstacles, within[rooms:], strict=True) if holds]
        return f"lies inside {_titled(solids[0], 'an obstacle')}" if solids else ""

    def _describe_wall(self, row: int) -> str:
        """Return a description of the wall in this row."""
        # In the order of the rows of `walls`: room outlines, inner walls, obstacles.
        kinds = [_titled(room, "the outline of a room") for room in self.rooms for _ in room.corners_in]
        kinds += ["a wall"] * len(self.inner_walls)
        kinds += [_titled(thing, "an obstacle") for thing in self.obstacles for _ in thing.corners_in]
        kinds += [f"the door {door.name!r}" for door in self.closed_doors]
        x1, y1, x2, y2 = self.walls[row]
        return f"{kinds[row]} ({x1:g}, {y1:g})-({x2:g}, {y2:g})"

    def _proposal(self, x_in: float, y_in: float, radius_in: float) -> str:
        """Return a nearby position or a start of this world where the robot fits, as the end of a sentence."""
        candidates = [self._pushed_free(x_in, y_in, radius_in), *((start.x_in, start.y_in) for start in self.starts)]
        for x, y in candidates:
            if self.clearance(x, y) > radius_in:
                return f"it fits at ({x:g}, {y:g}) in"
        return "there is no free position nearby: start elsewhere or use a smaller robot"

    def _pushed_free(self, x_in: float, y_in: float, radius_in: float) -> Point:
        """Return the point after moving it repeatedly away from its nearest wall; it may still not be free."""
        x, y = x_in, y_in
        # A corner needs several moves; 20 moves are enough where there is space.
        for _ in range(20):
            clearance, row, (near_x, near_y) = self._nearest(x, y)
            # Move by the missing distance, away from the nearest wall.
            lack = radius_in + MARGIN_IN - clearance
            if lack <= 0.0:
                break
            # On a wall there is no direction away from it: use the wall's normal.
            if clearance == 0.0:
                off_x, off_y = normals(self.walls[row : row + 1])[0].tolist()
            else:
                off_x, off_y = (x - near_x) / clearance, (y - near_y) / clearance
            x, y = x + off_x * lack, y + off_y * lack
        # Adding 0.0 turns -0.0 into 0.0.
        return round(x, 2) + 0.0, round(y, 2) + 0.0


def _titled(polygon: Polygon, kind: str) -> str:
    return f"{kind.replace('an ', 'the ')} {polygon.name!r}" if polygon.name else kind


def _stacked(parts: Sequence[FloatArray]) -> FloatArray:
    """Return segments concatenated (m, 4), as a read-only copy."""
    whole = np.concatenate([_no_walls(), *parts])
    whole.setflags(write=False)
    return whole


def _first_rows(parts: Sequence[FloatArray]) -> IndexArray:
    """Return the row (n,) at which each part begins after concatenation."""
    lengths = np.array([len(part) for part in parts], dtype=np.intp)
    return np.cumsum(lengths) - lengths


def _equal_items(one: Sequence[object], other: Sequence[object]) -> int:
    """Return the number of first items that are the same objects."""
    shorter = min(len(one), len(other))
    return next(compress(count(), map(operator.is_not, one, other)), shorter)


@dataclass(frozen=True, slots=True)
class WorldState:
    """The values that a world is built from. Rooms and obstacles are outlines; only inner walls are segments."""

    name: str
    title: str
    rooms: tuple[Polygon, ...]
    inner_walls: tuple[tuple[float, float, float, float], ...]
    obstacles: tuple[Polygon, ...]
    starts: tuple[StartPose, ...]
    paths: tuple[Path, ...]
    doors: tuple[Door, ...] | None = None
    walkers: tuple[Walker, ...] | None = None
    accuracies: dict[int, WallAccuracy] | None = None
    wall_names: dict[int, str] | None = None

    @classmethod
    def of(cls, world: World) -> WorldState:
        """Return the state of a world."""
        return cls(name=world.name, title=world.title, rooms=world.rooms,
                   inner_walls=tuple((x1, y1, x2, y2) for x1, y1, x2, y2 in world.inner_walls.tolist()),
                   obstacles=world.obstacles, starts=world.starts, paths=tuple(world.paths.values()),
                   doors=world.doors or None, walkers=world.walkers or None, accuracies=dict(world.accuracies) or None,
                   wall_names=dict(world.wall_names) or None)

    def world(self) -> World:
        """Return the world; raise ValueError if a value is impossible."""
        self._check_sizes()
        self._check_values()
        return World(self.name, self.title, self.rooms, np.array(self.inner_walls).reshape(-1, 4), self.obstacles,
                     self.starts, {path.name: path for path in self.paths}, accuracies=self.accuracies or {},
                     doors=self.doors or (), walkers=self.walkers or (), wall_names=self.wall_names or {})

    def _check_sizes(self) -> None:
        """Raise ValueError if there is too little or too much of something."""
        outlines = (*self.rooms, *self.obstacles)
        if not self.starts or not all(len(outline.corners_in) > 2 for outline in outlines):
            raise ValueError("a world without starts, or an outline with fewer than three corners")
        corners = sum(len(outline.corners_in) for outline in outlines)
        walls = len(self.inner_walls) + sum(len(room.corners_in) for room in self.rooms)
        if walls > 2 * MAX_CORNERS or corners > MAX_OUTLINE_CORNERS or len(self.starts) > MAX_STARTS:
            raise ValueError("too many walls, corners or starts")
        doors, walkers = self.doors or (), self.walkers or ()
        route_points = sum(len(walker.points_in) for walker in walkers)
        if len(doors) > MAX_DOORS or len(walkers) > MAX_WALKERS or route_points > MAX_WALKERS * MAX_ROUTE_POINTS:
            raise ValueError("too many doors, walkers or points of routes")

    def _check_values(self) -> None:
        """Raise ValueError if a value is impossible; every comparison is one that fails for nan."""
        doors, walkers, accuracies = self.doors or (), self.walkers or (), self.accuracies or {}
        for walker in walkers:
            if not (len(walker.points_in) > 1 and walker.speed_in_s > 0.0 and walker.radius_in > 0.0):
                raise ValueError("a walker needs two points, a speed and a radius above 0")
        rows = range(len(self.inner_walls))
        if not all(row in rows and is_valid_accuracy(accuracy) for row, accuracy in accuracies.items()):
            raise ValueError("the accuracy of a wall that does not exist, or below 0")
        if not all(row in rows for row in self.wall_names or {}):
            raise ValueError("the name of a wall that does not exist")
        corners = [corner for outline in (*self.rooms, *self.obstacles) for corner in outline.corners_in]
        routes = [point for walker in walkers for point in walker.points_in]
        door_ends = [end for door in doors for end in door.ends_in]
        for point in (*corners, *self.inner_walls, *routes, *door_ends):
            if not all(abs(coordinate) <= MAX_COORDINATE_IN for coordinate in point):
                raise ValueError(f"a coordinate beyond {MAX_COORDINATE_IN:g} in")


MARGIN: Final = 0.06
"""Border around the walls, as a fraction of the larger side."""
SCALE_BARS_M: Final = (0.5, 1, 2, 5, 10, 20)
"""Lengths of the scale bar; the longest one within a third of the width is drawn."""
IN_PER_M: Final = 1.0 / 0.0254
_MAX_DRAWN_STARTS: Final = 40
"""Starts that are drawn."""


def world_svg(world: World, width_px: int = 420) -> str:
    """Return the picture of a world: floor, walls, obstacles, starts with their headings, and a scale in metres."""
    # 1. The box around all walls, with a margin and a strip for the scale below.
    ends = world.walls.reshape(-1, 2)
    (x, y), (to_x, to_y) = ends.min(axis=0).tolist(), ends.max(axis=0).tolist()
    larger = max(to_x - x, to_y - y, 1.0)
    border = MARGIN * larger
    width, height = to_x - x + 2 * border, to_y - y + 3 * border
    height_px = round(width_px * height / width)
    # 2. Everything in inches, y up; strokes keep their width in pixels.
    shapes = "".join(_shapes(world, larger))
    line = width / width_px
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" height="{height_px}" role="img" '
        f'viewBox="{x - border:.1f} {-to_y - border:.1f} {width:.1f} {height:.1f}">'
        f"<title>{escape(world.title or world.name)}</title>"
        f'<rect x="{x - border:.1f}" y="{-to_y - border:.1f}" width="{width:.1f}" height="{height:.1f}" fill="#fff"/>'
        f'<g stroke-width="{2 * line:.2f}" stroke-linecap="round" stroke-linejoin="round">{shapes}</g>'
        f"{_scale(x, border - y, to_x - x, border, line)}</svg>\n"
    )


def _shapes(world: World, larger: float) -> Iterator[str]:
    for room in world.rooms:
        yield f'<polygon points="{_points(room.corners_in)}" fill="#f4f6f8" stroke="#52616b"/>'
    for x1, y1, x2, y2 in world.inner_walls.tolist():
        yield f'<path d="M{x1:.1f} {0.0 - y1:.1f}L{x2:.1f} {0.0 - y2:.1f}" stroke="#52616b"/>'
    for obstacle in world.obstacles:
        yield f'<polygon points="{_points(obstacle.corners_in)}" fill="#c8d1d8" stroke="#52616b"/>'
    for door in world.doors:
        dash = ' stroke-dasharray="4 3"' if door.is_open else ""
        yield f'<polyline points="{_points(door.ends_in)}" fill="none" stroke="#b0410e"{dash}/>'
    for walker in world.walkers:
        outline = "polygon" if walker.is_closed else "polyline"
        yield f'<{outline} points="{_points(walker.points_in)}" fill="none" stroke="#8a94a6" stroke-dasharray="1 4"/>'
        x, y = walker.points_in[0]
        yield f'<circle cx="{x:.1f}" cy="{0.0 - y:.1f}" r="{walker.radius_in:.1f}" fill="#8a94a6"/>'
    # A start is a disc with a line along its heading.
    size = min(9.0, 0.04 * larger)
    for start in world.starts[:_MAX_DRAWN_STARTS]:
        x, y = start.x_in, 0.0 - start.y_in
        nose_x, nose_y = x + 2 * size * math.cos(start.steering_rad), y - 2 * size * math.sin(start.steering_rad)
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}" fill="#2e8b57"/>'
        yield f'<path d="M{x:.1f} {y:.1f}L{nose_x:.1f} {nose_y:.1f}" stroke="#2e8b57"/>'


def _points(corners: Sequence[Point]) -> str:
    return " ".join(f"{x:.1f},{0.0 - y:.1f}" for x, y in corners)


def _scale(x: float, y: float, width: float, border: float, line: float) -> str:
    """Return a bar of a round number of metres below the picture."""
    metres = max((bar for bar in SCALE_BARS_M if bar * IN_PER_M <= width / 3), default=SCALE_BARS_M[0])
    return (
        f'<path d="M{x:.1f} {y:.1f}h{metres * IN_PER_M:.1f}" stroke="#1b1b1b" stroke-width="{2 * line:.2f}"/>'
        f'<text x="{x + metres * IN_PER_M + 0.3 * border:.1f}" y="{y + 0.25 * border:.1f}" '
        f'font-size="{0.75 * border:.1f}" font-family="sans-serif" fill="#1b1b1b">{metres:g} m</text>'
    )
