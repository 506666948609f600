"""The world a robot drives in: rooms, walls, obstacles, starts, and the paths of the figures. Values, never changed.

Lives here: what stands where, what is free, how much room a robot has. Lives elsewhere: files (files.py), rays
(raycast.py), arithmetic (geometry.py). Inches, radians; free space is inside a room (if there is any) and outside
every obstacle. Walls and rooms stay; obstacles are what clients may add, move and delete: `with_obstacles`.

    walls (m, 4)    = fixed_walls | obstacles        a fixed wall keeps its row whatever happens to the obstacles
    fixed_walls     = outlines of the rooms | inner_walls
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from nclient.errors import StartError
from worlds.geometry import FloatArray, inside, nearest_points, polygon_segments

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Polygon:
    """A closed outline: of a room (free inside) or of an obstacle (solid inside). Corners in inches, either way round."""

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
    inner_walls: FloatArray = field(default_factory=_no_walls)
    obstacles: tuple[Polygon, ...] = ()
    starts: tuple[StartPose, ...] = (StartPose(0.0, 0.0),)
    paths: Mapping[str, Path] = field(default_factory=dict)
    fixed_walls: FloatArray = field(init=False, repr=False)
    walls: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        inner = _frozen([np.asarray(self.inner_walls, dtype=np.float64).reshape(-1, 4)])
        fixed = _frozen([*(room.segments() for room in self.rooms), inner])
        object.__setattr__(self, "inner_walls", inner)
        object.__setattr__(self, "fixed_walls", fixed)
        object.__setattr__(self, "walls", _frozen([fixed, *(thing.segments() for thing in self.obstacles)]))
        object.__setattr__(self, "paths", MappingProxyType(dict(self.paths)))

    def with_obstacles(self, obstacles: Iterable[Polygon]) -> World:
        """This world with these obstacles instead of its own; fixed walls keep their rows."""
        return replace(self, obstacles=tuple(obstacles))

    def clearance(self, x_in: float, y_in: float) -> float:
        """Distance from a point to the nearest wall, inches; inf where there is none.

        Negative where the point is not free: outside every room, or inside an obstacle; then it is the distance to
        the nearest wall with its sign turned. A robot of radius r fits where clearance > r.
        """
        if not len(self.walls):
            return inf
        _, distances = nearest_points((x_in, y_in), self.walls)
        distance = float(distances.min())
        return distance if self._trouble(x_in, y_in) is None else -distance

    def require_free(self, x_in: float, y_in: float, radius_in: float) -> None:
        """Refuse a start where a robot of this radius does not fit.

        Raises StartError, which says what the robot touches or that it lies outside, and how to mend it.
        """
        trouble = self._trouble(x_in, y_in)
        if trouble is None and self.clearance(x_in, y_in) > radius_in:
            return
        raise StartError(f"the start ({x_in:g}, {y_in:g}) in is not free: {trouble or 'touches a wall'}")

    def _trouble(self, x_in: float, y_in: float) -> str | None:
        """Why a point is not free space, or None."""
        here = (x_in, y_in)
        if self.rooms and not any(inside(here, room.segments()) for room in self.rooms):
            return "it lies outside the world"
        for thing in self.obstacles:
            if inside(here, thing.segments()):
                return f"it lies inside the obstacle {thing.name}"
        return None


def _frozen(parts: Iterable[npt.NDArray[np.float64]]) -> FloatArray:
    """The parts one below the other, read-only."""
    whole = np.concatenate(list(parts))
    whole.setflags(write=False)
    return whole
