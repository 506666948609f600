"""Ways of sound from a transducer to a transducer, exactly: by images of the source, as light's in mirrors. Pure.

    off one wall           source' -> receiver                 head-on, or to a neighbour that listens
    off two walls          source'' -> receiver                a square corner sends all back: its vertex is heard
    off one, back off two  source' -> foot on the second       by way of a slanted wall: too long a range
    off an edge            wall ends and vertices scatter      weak, from all sides

Each way leaves and comes in inside the cones; what is lost on it is told with it, and the points between which nothing
may stand. Ways off other robots are disc_ways.py's; what is loud enough, and heard, is polaroid.py's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from math import atan2, cos, hypot, inf, pi, sin, tan
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.angles import short_way
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast import cast_discs, cast_rays

Point = tuple[float, float]

SMALL_IN: Final = 1e-6
"""How far off its wall a reflected leg starts, and how far short of its end it may be met: inches, a millionth of what
a reading tells."""

TINY: Final = 1e-9
"""Share of a wall or a way by which it counts as longer: a square corner's echo goes just through its vertex."""

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall, and have no edge there."""


class Scene:
    """What sound meets: walls (m, 4), rows x1 y1 x2 y2 in inches."""

    def __init__(self, walls: FloatArray) -> None:
        self.walls = walls

    @cached_property
    def mirrors(self) -> FloatArray:
        """The walls that have a length, and so a normal (k, 4)."""
        long: FloatArray = self.walls[(self.walls[:, :2] != self.walls[:, 2:]).any(axis=1)]
        return long

    @cached_property
    def edges(self) -> FloatArray:
        """Ends and vertices of the walls (k, 2), but for those where a wall goes straight on."""
        ways: dict[Point, list[float]] = {}
        for x1, y1, x2, y2 in self.walls.tolist():
            ways.setdefault((x1, y1), []).append(atan2(y2 - y1, x2 - x1))
            ways.setdefault((x2, y2), []).append(atan2(y1 - y2, x1 - x2))
        return np.array([point for point, out in ways.items() if not _straight(out)]).reshape(-1, 2)


class Way(NamedTuple):
    """A way of sound: its length, what it loses on it, and the points between which nothing may stand."""

    length_in: float
    loss_db: float
    points: tuple[Point, ...]


class Losses(NamedTuple):
    """What sound loses on its way: dB an inch of range, and dB at each wall after the first, at an edge, and at the
    broken skin of a robot."""

    way_db_in: float
    bounce_db: float
    edge_db: float
    skin_db: float


class Beam(NamedTuple):
    """A transducer's cone: its point, where it looks, half its angle, and what one passage loses at its rim."""

    point: Point
    direction_rad: float
    half_rad: float
    rim_loss_db: float

    def seen(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of points (..., 2): how far along the axis, and how far to its left."""
        x, y = points[..., 0] - self.point[0], points[..., 1] - self.point[1]
        along, up = cos(self.direction_rad), sin(self.direction_rad)
        return x * along + y * up, y * along - x * up

    def loss_db(self, points: FloatArray) -> FloatArray:
        """What one passage towards points (..., 2) costs, (...): inf outside the cone."""
        ahead, side = self.seen(points)
        share = np.abs(np.arctan2(side, ahead)) / self.half_rad
        return np.where(share <= 1.0, self.rim_loss_db * share * share, inf)

    def may_meet(self, walls: FloatArray) -> FloatArray:
        """Rows of the walls (m, 4) that can reach into the cone: all that are not beyond one of its two sides."""
        ahead, side = self.seen(walls.reshape(-1, 2, 2))
        rim = ahead * tan(self.half_rad)
        beyond = np.logical_or((side > rim).all(axis=-1), (side < -rim).all(axis=-1))
        reached: FloatArray = walls[~beyond]
        return reached

    def may_meet_discs(self, discs: FloatArray) -> FloatArray:
        """Rows of the discs (k, 3) that reach into the cone, or nearly: not beyond a side, nor behind the point."""
        ahead, side = self.seen(discs[:, :2])
        beyond = np.abs(side) * cos(self.half_rad) - ahead * sin(self.half_rad) > discs[:, 2]
        reached: FloatArray = discs[~(beyond | (ahead < -discs[:, 2]))]
        return reached


def ways(out: Beam, back: Beam, scene: Scene, lost: Losses, *, own: bool) -> Iterator[Way]:
    """All ways from one transducer to another, or to itself, but for what stands between."""
    first = out.may_meet(scene.mirrors)
    yield from _off_edges(out, back, scene.edges, lost)
    if len(first):
        yield from _off_one(out, back, first, lost)
        yield from _off_two(out, back, first, back.may_meet(scene.mirrors), lost)
    if own and len(first):
        yield from _there_and_back(out, first, scene.mirrors, lost)


def _off_edges(out: Beam, back: Beam, edges: FloatArray, lost: Losses) -> Iterator[Way]:
    lengths = _distance(edges, out.point) + _distance(edges, back.point)
    losses = out.loss_db(edges) + back.loss_db(edges) + lost.edge_db + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, back, edges)


def _off_one(out: Beam, back: Beam, walls: FloatArray, lost: Losses) -> Iterator[Way]:
    images = mirrored(np.array(out.point), walls)
    points, met = crossings(images, np.array(back.point), walls)
    lengths = _distance(images, back.point)
    losses = out.loss_db(points) + back.loss_db(points) + lost.way_db_in * lengths / 2.0
    yield from told(lengths, np.where(met, losses, inf), out, back, points)


def _off_two(out: Beam, back: Beam, first: FloatArray, last: FloatArray, lost: Losses) -> Iterator[Way]:
    one = first[:, np.newaxis]
    images = mirrored(np.array(out.point), one)
    twice = mirrored(images, last)
    points_2, met_2 = crossings(twice, np.array(back.point), last)
    points_1, met_1 = crossings(images, points_2, one)
    lengths = _distance(twice, back.point)
    losses = out.loss_db(points_1) + back.loss_db(points_2) + lost.bounce_db
    losses = np.where(met_1 & met_2, losses + lost.way_db_in * lengths / 2.0, inf)
    yield from told(lengths, losses, out, back, points_1, points_2)


def _there_and_back(out: Beam, first: FloatArray, walls: FloatArray, lost: Losses) -> Iterator[Way]:
    """Off a slanted wall, head-on against another, and back the same way."""
    one = first[:, np.newaxis]
    images = mirrored(np.array(out.point), one)
    along = walls[:, 2:] - walls[:, :2]
    share = ((images - walls[:, :2]) * along).sum(axis=-1) / (along * along).sum(axis=-1)
    feet = walls[:, :2] + share[..., np.newaxis] * along
    points, met = crossings(images, feet, one)
    lengths = 2.0 * np.hypot(*np.moveaxis(images - feet, -1, 0))
    losses = 2.0 * out.loss_db(points) + 2.0 * lost.bounce_db + lost.way_db_in * lengths / 2.0
    losses = np.where(met & (share >= 0.0) & (share <= 1.0), losses, inf)
    yield from told(lengths, losses, out, None, points, feet)


def told(lengths: FloatArray, losses: FloatArray, out: Beam, back: Beam | None, *stops: FloatArray) -> Iterator[Way]:
    """The ways that get anywhere, one by one; back None: they return as they came."""
    for at in zip(*np.nonzero(losses < inf), strict=True):
        on_walls = [(float(stop[at][0]), float(stop[at][1])) for stop in stops]
        points = [out.point, *on_walls, *([back.point] if back is not None else [])]
        yield Way(float(lengths[at]), float(losses[at]), tuple(points))


def mirrored(points: FloatArray, walls: FloatArray) -> FloatArray:
    """Images of points (..., 2) in the lines of walls (..., 4); shapes broadcast."""
    x1, y1, x2, y2 = np.moveaxis(walls, -1, 0)
    across = np.stack((y1 - y2, x2 - x1), axis=-1)
    off = ((points - walls[..., :2]) * across).sum(axis=-1) / (across * across).sum(axis=-1)
    image: FloatArray = points - 2.0 * off[..., np.newaxis] * across
    return image


def crossings(origins: FloatArray, ends: FloatArray, walls: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Where the lines from origins to ends (..., 2) cross the walls (..., 4), and whether they do on the way."""
    way, wall, offset = ends - origins, walls[..., 2:] - walls[..., :2], walls[..., :2] - origins
    turned = _cross(way, wall)
    some = np.where(turned == 0.0, 1.0, turned)
    on_way, on_wall = _cross(offset, wall) / some, _cross(offset, way) / some
    met = (turned != 0.0) & (on_way > 0.0) & (on_way <= 1.0 + TINY) & (on_wall >= -TINY) & (on_wall <= 1.0 + TINY)
    points: FloatArray = origins + on_way[..., np.newaxis] * way
    return points, met


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    product: FloatArray = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return product


def _distance(points: FloatArray, from_point: Point) -> FloatArray:
    far: FloatArray = np.hypot(points[..., 0] - from_point[0], points[..., 1] - from_point[1])
    return far


def free(points: Sequence[Point], walls: FloatArray, discs: FloatArray) -> bool:
    """Whether nothing stands between one point and the next, all along: no wall (m, 4) and no disc (k, 3)."""
    for (x1, y1), (x2, y2) in pairwise(points):
        length = hypot(x2 - x1, y2 - y1)
        if length <= 3.0 * SMALL_IN:
            continue
        way = (x2 - x1) / length, (y2 - y1) / length
        start = x1 + SMALL_IN * way[0], y1 + SMALL_IN * way[1]
        if float(cast_rays(start, way, walls)[0]) < length - 3.0 * SMALL_IN:
            return False
        if len(discs) and float(cast_discs(start, way, discs)) < length - 3.0 * SMALL_IN:
            return False
    return True


def _straight(directions_rad: list[float]) -> bool:
    """Whether just two walls meet in a point, one the other's continuation."""
    return len(directions_rad) == 2 and abs(abs(short_way(directions_rad[0] - directions_rad[1])) - pi) < STRAIGHT_RAD
