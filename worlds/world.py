"""The world a robot drives in: rooms, walls, obstacles, starts, and the paths of the figures. Values, never changed.

Lives here: what stands where, what is free, how much room a robot has. Lives elsewhere: files (files.py), rays
(raycast.py), arithmetic (geometry.py). Inches, radians; free space is inside a room (if there is any) and outside
every obstacle. Walls and rooms stay; obstacles are what clients may add, move and delete: `with_obstacles`.

    walls (m, 4)    = fixed_walls | obstacles        a fixed wall keeps its row whatever happens to the obstacles
    fixed_walls     = outlines of the rooms | inner_walls
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from types import MappingProxyType
from typing import Final

import numpy as np

from nclient.errors import StartError
from worlds.geometry import FloatArray, inside, nearest_points, normals, polygon_segments
from worlds.raycast import ON_WALL_IN

Point = tuple[float, float]

MARGIN_IN: Final = 0.1
"""How far from a wall a place is that a refusal proposes, beyond the radius, inches: a tenth, to be seen."""


@dataclass(frozen=True, slots=True)
class Polygon:
    """A closed outline of a room (free inside) or an obstacle (solid inside); corners in inches, either way round."""

    corners_in: tuple[Point, ...]
    name: str = ""

    def segments(self) -> FloatArray:
        """The edges (n, 4), inches, in the order of the corners, the closing one last."""
        return polygon_segments(self.corners_in)

    def moved(self, dx_in: float, dy_in: float) -> Polygon:
        """The same polygon, shifted."""
        return replace(self, corners_in=tuple((x + dx_in, y + dy_in) for x, y in self.corners_in))


@dataclass(frozen=True, slots=True)
class StartPose:
    """Where a robot is put at the beginning; angles counter-clockwise from the x axis."""

    x_in: float
    y_in: float
    steering_rad: float = 0.0
    turret_rad: float = 0.0


AT_ORIGIN: Final = (StartPose(0.0, 0.0),)
"""The starts of a world that names none."""


@dataclass(frozen=True, slots=True)
class Path:
    """The way-points of a figure. The first of `points_in` is where the robot stands at the beginning."""

    name: str
    figure: str
    start: StartPose
    points_in: tuple[Point, ...]

    @property
    def goals_in(self) -> tuple[Point, ...]:
        """The way-points to drive to, in order: all but the first point."""
        return self.points_in[1:]


def _no_walls() -> FloatArray:
    return np.empty((0, 4))


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """All that stands in a world; see the head of this file. Arrays are read-only, rows x1 y1 x2 y2 in inches."""

    name: str
    title: str = ""
    rooms: tuple[Polygon, ...] = ()
    inner_walls: FloatArray = field(default_factory=_no_walls, repr=False)
    obstacles: tuple[Polygon, ...] = ()
    starts: tuple[StartPose, ...] = AT_ORIGIN
    paths: Mapping[str, Path] = field(default_factory=dict)
    fixed_walls: FloatArray = field(init=False, repr=False)
    walls: FloatArray = field(init=False, repr=False)
    _edges: FloatArray = field(init=False, repr=False)
    _firsts: tuple[int, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rooms = [room.segments() for room in self.rooms]
        solids = [thing.segments() for thing in self.obstacles]
        inner = _stacked([np.asarray(self.inner_walls, dtype=np.float64)])
        fixed = _stacked([*rooms, inner])
        derived = {
            "inner_walls": inner,
            "fixed_walls": fixed,
            "walls": _stacked([fixed, *solids]),
            "paths": MappingProxyType(dict(self.paths)),
            "_edges": _stacked([*rooms, *solids]),
            "_firsts": _first_rows([*rooms, *solids]),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def with_obstacles(self, obstacles: Iterable[Polygon]) -> World:
        """This world with these obstacles in place of its own; fixed walls keep their rows."""
        return replace(self, obstacles=tuple(obstacles))

    def clearance(self, x_in: float, y_in: float) -> float:
        """Distance from a point to the nearest wall, inches; inf where there are no walls.

        Negative where the point is not free: outside every room, or inside an obstacle; then it is the distance to
        the nearest wall with its sign turned. A robot of radius r fits where clearance > r.
        """
        return self._nearest(x_in, y_in)[0]

    def clearances(self, points_in: FloatArray) -> FloatArray:
        """The same of many points (..., 2) at once, (...,)."""
        far: FloatArray = nearest_points(points_in, self.walls)[1].min(axis=-1, initial=inf)
        if self._firsts:
            within, rooms = inside(points_in, self._edges, self._firsts), len(self.rooms)
            outside = ~within[..., :rooms].any(axis=-1) if rooms else np.zeros(far.shape, dtype=bool)
            far[outside | within[..., rooms:].any(axis=-1)] *= -1.0
        return far

    def require_free(self, x_in: float, y_in: float, radius_in: float) -> None:
        """Refuse a start where a robot of this radius does not fit.

        Raises StartError, which says what the robot touches or that it lies outside, and where it would fit.
        """
        place = f"the start ({x_in:g}, {y_in:g}) in"
        if not (isfinite(x_in) and isfinite(y_in)):
            raise StartError(f"{place} is no place: expected two finite numbers")
        clearance, row, _ = self._nearest(x_in, y_in)
        if clearance > radius_in:
            return
        trouble = self._solid_around(x_in, y_in)
        if not trouble or abs(clearance) <= ON_WALL_IN:
            trouble = (
                f"touches {self._called(row)}: {abs(clearance):.2f} in away, the robot's radius is {radius_in:g} in"
            )
        raise StartError(f"{place} {trouble}; {self._proposal(x_in, y_in, radius_in)}")

    def _nearest(self, x_in: float, y_in: float) -> tuple[float, int, Point]:
        """Clearance of a point, the row of its nearest wall (-1: none) and the nearest point on it."""
        if not len(self.walls):
            return inf, -1, (x_in, y_in)
        points, distances = nearest_points((x_in, y_in), self.walls)
        row = int(distances.argmin())
        distance = float(distances[row])
        nearest = (float(points[row, 0]), float(points[row, 1]))
        return (-distance if self._solid_around(x_in, y_in) else distance), row, nearest

    def _solid_around(self, x_in: float, y_in: float) -> str:
        """Why a point is not free space, as the end of a sentence; "" where it is."""
        if not self._firsts:
            return ""
        within = inside((x_in, y_in), self._edges, self._firsts).tolist()
        rooms = len(self.rooms)
        if rooms and not any(within[:rooms]):
            low, high = self._edges.reshape(-1, 2).min(axis=0), self._edges.reshape(-1, 2).max(axis=0)
            return (
                f"lies outside the world {self.name}, which spans x from {low[0]:g} to {high[0]:g} "
                f"and y from {low[1]:g} to {high[1]:g} in"
            )
        solids = [thing for thing, holds in zip(self.obstacles, within[rooms:], strict=True) if holds]
        return f"lies inside {_titled(solids[0], 'an obstacle')}" if solids else ""

    def _called(self, row: int) -> str:
        """What the wall in this row is to a person."""
        kinds = [_titled(room, "the outline of a room") for room in self.rooms for _ in room.corners_in]
        kinds += ["a wall"] * len(self.inner_walls)
        kinds += [_titled(thing, "an obstacle") for thing in self.obstacles for _ in thing.corners_in]
        x1, y1, x2, y2 = self.walls[row]
        return f"{kinds[row]} ({x1:g}, {y1:g})-({x2:g}, {y2:g})"

    def _proposal(self, x_in: float, y_in: float, radius_in: float) -> str:
        """A place near by, or a start of this world, where the robot fits; as the end of a sentence."""
        candidates = [self._pushed_free(x_in, y_in, radius_in), *((start.x_in, start.y_in) for start in self.starts)]
        for x, y in candidates:
            if self.clearance(x, y) > radius_in:
                return f"it fits at ({x:g}, {y:g}) in"
        return "no place near by is wide enough: start elsewhere or take a smaller robot"

    def _pushed_free(self, x_in: float, y_in: float, radius_in: float) -> Point:
        """The point after it was pushed off its nearest wall, again and again; it need not end up free."""
        x, y = x_in, y_in
        for _ in range(20):
            clearance, row, (near_x, near_y) = self._nearest(x, y)
            lack = radius_in + MARGIN_IN - clearance
            if lack <= 0.0:
                break
            if clearance == 0.0:
                off_x, off_y = normals(self.walls[row : row + 1])[0].tolist()
            else:
                off_x, off_y = (x - near_x) / clearance, (y - near_y) / clearance
            x, y = x + off_x * lack, y + off_y * lack
        return round(x, 2) + 0.0, round(y, 2) + 0.0


def _titled(polygon: Polygon, kind: str) -> str:
    return f"{kind.replace('an ', 'the ')} {polygon.name!r}" if polygon.name else kind


def _stacked(parts: Sequence[FloatArray]) -> FloatArray:
    """Segments one below the other (m, 4), a read-only copy."""
    whole = np.concatenate([_no_walls(), *parts])
    whole.setflags(write=False)
    return whole


def _first_rows(parts: Sequence[FloatArray]) -> tuple[int, ...]:
    """The row at which each part begins when they lie one below the other."""
    return tuple(sum(len(before) for before in parts[:number]) for number in range(len(parts)))
