"""What a Polaroid transducer hears: the echo model of the setup `measured`. Pure: cries, walls and chance come in.

Smooth walls are mirrors for sound: of a wall comes back what meets it head-on, of a slanted one nothing. So ways of
sound are found exactly, as light's in mirrors, by images of the source:

    off one wall           source' -> receiver                 head-on, or to a neighbour that listens
    off two walls          source'' -> receiver                a square corner sends all back: its vertex is heard
    off one, back off two  source' -> foot on the second       by way of a slanted wall: too long a range
    off an edge            wall ends and vertices scatter      weak, from all sides

Of each way that is free and leaves and comes in inside the cone, a level is known; the first that is loud enough is
heard. A cry of another sonar that is still under way is heard like one's own, and as too short a range. Left out:
side lobes, ways off three walls and more, cries later than one's own, rough walls.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import atan2, cos, hypot, inf, pi, radians, sin, tan
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.angles import short_way
from nserver_emu.simulation.instants import to_s
from worlds.bodies import Body
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast import cast_rays

Point = tuple[float, float]

SMALL_IN: Final = 1e-6
"""How far off its wall a reflected leg starts, and how far short of its end it may be met: inches, a millionth of what
a reading tells."""

TINY: Final = 1e-9
"""Share of a wall or a way by which it counts as longer: a square corner's echo goes just through its vertex."""

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall, and have no edge there."""


class Cry(NamedTuple):
    """A sonar fired: the axis of its ring, its direction, when, and the standard normal numbers of its chance."""

    x_in: float
    y_in: float
    direction_rad: float
    instant_ps: int
    chances: tuple[float, ...]


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


@dataclass(frozen=True, slots=True)
class Polaroid:
    """The parameters of the model. Levels are against a wall met head-on close by, inches and decibels.

    cone_rad          whole angle of the cone inside which a transducer cries and hears
    std_share         standard deviation of a range as a share of it; never below least_std_in
    sound_in_s        speed of sound: 343 m/s, air at 20 degrees C
    margin_db         how much louder than just audible that wall is; in each cry a draw with margin_std_db about it
    cone_loss_db      lost at the rim of the cone, out and back together; with the square of the angle in between
    way_loss_db_in    lost an inch of range: absorption, and what the receiver's rising gain leaves of the spreading
    bounce_loss_db    lost at each wall after the first
    edge_loss_db      lost at an edge, against a wall
    blanking_in       echoes from nearer drown in the transducer's own ringing: an own one reads this, others nothing
    recess_in         the transducer's face lies so deep behind the ring
    dead              sonars that read 0
    """

    cone_rad: float = radians(25.0)
    std_share: float = 0.01
    least_std_in: float = 0.05
    sound_in_s: float = 13504.0
    margin_db: float = 30.0
    margin_std_db: float = 2.0
    cone_loss_db: float = 12.0
    way_loss_db_in: float = 0.1
    bounce_loss_db: float = 3.0
    edge_loss_db: float = 15.0
    blanking_in: float = 6.0
    recess_in: float = 0.5
    dead: tuple[int, ...] = ()

    @property
    def life_ps(self) -> int:
        """After this a cry can be heard no more, even when chance favours it by five standard deviations."""
        reach_in = (self.margin_db + 5.0 * self.margin_std_db) / self.way_loss_db_in
        return int(2.0 * reach_in / self.sound_in_s * 1e12)

    def draw(self, chance: np.random.Generator) -> tuple[float, ...]:
        """The chance of one cry: for the range, and for the level. Always two numbers."""
        range_chance, level_chance = chance.standard_normal(2).tolist()
        return range_chance, level_chance

    def heard_in(self, cry: Cry, earlier: Sequence[Cry], scene: Scene, body: Body) -> float:
        """The range that a sonar makes of what it hears, inches from the ring; inf for nothing.

        earlier    cries of the same ring before it, of the last `life_ps`
        """
        range_in = self.first_in(cry, earlier, scene, body)
        if range_in == inf:
            return inf
        return range_in + cry.chances[0] * max(self.std_share * range_in, self.least_std_in)

    def first_in(self, cry: Cry, earlier: Sequence[Cry], scene: Scene, body: Body) -> float:
        """The range of the first echo that is loud enough, before noise; inf for none."""
        here = self._face(cry, body)
        margin_db = self.margin_db + self.margin_std_db * cry.chances[1]
        found: list[tuple[float, Way]] = []
        for source in (cry, *earlier):
            own = source is cry
            head_start_in = self.sound_in_s * to_s(cry.instant_ps - source.instant_ps)
            nearest_in = -inf if own else self.blanking_in
            out, back = _Beam.of(self._face(source, body), source, self), _Beam.of(here, cry, self)
            for way in _ways(out, back, scene, self, own=own):
                range_in = (way.length_in - head_start_in) / 2.0 - self.recess_in
                if way.loss_db <= margin_db and range_in >= nearest_in:
                    found.append((range_in, way))
        for range_in, way in sorted(found, key=lambda pair: pair[0]):
            if _free(way.points, scene.walls):
                return range_in
        return inf

    def _face(self, cry: Cry, body: Body) -> Point:
        """Where the transducer is."""
        out = body.sonar_ring_radius_in - self.recess_in
        return cry.x_in + out * cos(cry.direction_rad), cry.y_in + out * sin(cry.direction_rad)


class _Beam(NamedTuple):
    """A transducer's cone: where its point is, where it looks, half its angle, and what is lost at its rim."""

    point: Point
    direction_rad: float
    half_rad: float
    rim_loss_db: float

    @classmethod
    def of(cls, point: Point, cry: Cry, model: Polaroid) -> _Beam:
        return cls(point, cry.direction_rad, model.cone_rad / 2.0, model.cone_loss_db / 2.0)

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


def _ways(out: _Beam, back: _Beam, scene: Scene, model: Polaroid, *, own: bool) -> Iterator[Way]:
    """All ways from one transducer to another, or to itself, but for what stands between."""
    first = out.may_meet(scene.mirrors)
    yield from _off_edges(out, back, scene.edges, model)
    if len(first):
        yield from _off_one(out, back, first, model)
        yield from _off_two(out, back, first, back.may_meet(scene.mirrors), model)
    if own and len(first):
        yield from _there_and_back(out, first, scene.mirrors, model)


def _off_edges(out: _Beam, back: _Beam, edges: FloatArray, model: Polaroid) -> Iterator[Way]:
    lengths = _distance(edges, out.point) + _distance(edges, back.point)
    losses = out.loss_db(edges) + back.loss_db(edges) + model.edge_loss_db + model.way_loss_db_in * lengths / 2.0
    yield from _told(lengths, losses, out, back, edges)


def _off_one(out: _Beam, back: _Beam, walls: FloatArray, model: Polaroid) -> Iterator[Way]:
    images = _mirrored(np.array(out.point), walls)
    points, met = _crossings(images, np.array(back.point), walls)
    lengths = _distance(images, back.point)
    losses = out.loss_db(points) + back.loss_db(points) + model.way_loss_db_in * lengths / 2.0
    yield from _told(lengths, np.where(met, losses, inf), out, back, points)


def _off_two(out: _Beam, back: _Beam, first: FloatArray, last: FloatArray, model: Polaroid) -> Iterator[Way]:
    one = first[:, np.newaxis]
    images = _mirrored(np.array(out.point), one)
    twice = _mirrored(images, last)
    points_2, met_2 = _crossings(twice, np.array(back.point), last)
    points_1, met_1 = _crossings(images, points_2, one)
    lengths = _distance(twice, back.point)
    losses = out.loss_db(points_1) + back.loss_db(points_2) + model.bounce_loss_db
    losses = np.where(met_1 & met_2, losses + model.way_loss_db_in * lengths / 2.0, inf)
    yield from _told(lengths, losses, out, back, points_1, points_2)


def _there_and_back(out: _Beam, first: FloatArray, walls: FloatArray, model: Polaroid) -> Iterator[Way]:
    """Off a slanted wall, head-on against another, and back the same way."""
    one = first[:, np.newaxis]
    images = _mirrored(np.array(out.point), one)
    along = walls[:, 2:] - walls[:, :2]
    share = ((images - walls[:, :2]) * along).sum(axis=-1) / (along * along).sum(axis=-1)
    feet = walls[:, :2] + share[..., np.newaxis] * along
    points, met = _crossings(images, feet, one)
    lengths = 2.0 * np.hypot(*np.moveaxis(images - feet, -1, 0))
    losses = 2.0 * out.loss_db(points) + 2.0 * model.bounce_loss_db + model.way_loss_db_in * lengths / 2.0
    losses = np.where(met & (share >= 0.0) & (share <= 1.0), losses, inf)
    yield from _told(lengths, losses, out, None, points, feet)


def _told(lengths: FloatArray, losses: FloatArray, out: _Beam, back: _Beam | None, *stops: FloatArray) -> Iterator[Way]:
    """The ways that get anywhere, one by one; back None: they return as they came."""
    for at in zip(*np.nonzero(losses < inf), strict=True):
        on_walls = [(float(stop[at][0]), float(stop[at][1])) for stop in stops]
        points = [out.point, *on_walls, *([back.point] if back is not None else [])]
        yield Way(float(lengths[at]), float(losses[at]), tuple(points))


def _mirrored(points: FloatArray, walls: FloatArray) -> FloatArray:
    """Images of points (..., 2) in the lines of walls (..., 4); shapes broadcast."""
    x1, y1, x2, y2 = np.moveaxis(walls, -1, 0)
    across = np.stack((y1 - y2, x2 - x1), axis=-1)
    off = ((points - walls[..., :2]) * across).sum(axis=-1) / (across * across).sum(axis=-1)
    image: FloatArray = points - 2.0 * off[..., np.newaxis] * across
    return image


def _crossings(origins: FloatArray, ends: FloatArray, walls: FloatArray) -> tuple[FloatArray, BoolArray]:
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


def _free(points: Sequence[Point], walls: FloatArray) -> bool:
    """Whether nothing stands between one point and the next, all along."""
    for (x1, y1), (x2, y2) in pairwise(points):
        length = hypot(x2 - x1, y2 - y1)
        if length <= 3.0 * SMALL_IN:
            continue
        way = (x2 - x1) / length, (y2 - y1) / length
        start = x1 + SMALL_IN * way[0], y1 + SMALL_IN * way[1]
        if float(cast_rays(start, way, walls)[0]) < length - 3.0 * SMALL_IN:
            return False
    return True


def _straight(directions_rad: list[float]) -> bool:
    """Whether just two walls meet in a point, one the other's continuation."""
    return len(directions_rad) == 2 and abs(abs(short_way(directions_rad[0] - directions_rad[1])) - pi) < STRAIGHT_RAD
