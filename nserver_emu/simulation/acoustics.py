"""Ways of sound from a transducer to a transducer, exactly: by images of the source, as light's in mirrors. Pure.

    off one wall           source' -> receiver                 head-on, or to a neighbour that listens
    off two walls          source'' -> receiver                a square corner sends all back: its vertex is heard
    off one, back off two  source' -> foot on the second       by way of a slanted wall: too long a range
    off an edge            wall ends and vertices scatter      weak, from all sides

Each way leaves and comes in inside the cones; what is lost on it is told with it, and the points between which nothing
may stand. Ways off other robots are disc_ways.py's; what is loud enough, and heard, is polaroid.py's.

Places are complex numbers x + iy in here: half as many arrays. With the unit direction u of a wall and a point a of it
the image of p is a + u^2 conj(p - a).

Ways of sound off other robots, which are discs: as echo_ways.py's off walls. Pure.

    off the round      a disc is a curved mirror: wherever it stands, one point sends head-on back; being curved it
                       spreads the sound, by (r + d)/r over a wall at the same distance d
    off the skin       bumpers, sonars and edges scatter, weakly and from all sides: a robot that only reaches into the
                       cone is heard from its nearest point in there that is loud enough
    off a wall, back off the round     by way of a slanted wall

The spreading is that of a bundle of rays in the plane, dB = 10 log10(1 + 2 a b / ((a + b) r cos(incidence))) with ways
a and b before and after; a = b = d, incidence 0 is the line above. Left out: ways off two robots, and on from one.

What a Polaroid transducer hears: the echo model of the setup `measured`. Pure: cries, walls and chance come in.

Smooth walls are mirrors for sound: of a wall comes back what meets it head-on, of a slanted one nothing but what it
mirrors. The ways of sound are found exactly, off walls and edges in echo_ways.py, off other robots in disc_ways.py.

Of each way that is free and leaves and comes in inside the cone, a level is known; the first that is loud enough is
heard. A cry of another sonar of the ring that is still under way is heard like one's own, and as too short a range.
Left out: side lobes, ways off three walls and more, cries later than one's own, cries of other robots, rough walls.
"""

from __future__ import annotations

from cmath import phase, rect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import asin, atan2, cos, inf, log10, pi, radians, sin, tan
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from nserver_emu.simulation.segments import short_way, to_s
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast import cast_discs, cast_rays
from worlds.robots import SONARS, Body

ComplexArray = npt.NDArray[np.complex128]

SMALL_IN: Final = 1e-6
"""How far off its wall a reflected leg starts, and how far short of its end it may be met: inches, a millionth of what
a reading tells."""

TINY: Final = 1e-9
"""Share of a wall or a way by which it counts as longer: a square corner's echo goes just through its vertex."""

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall, and have no edge there."""


class Scene:
    """What sound meets: walls (m, 4), rows x1 y1 x2 y2 in inches. All it keeps is real, for snapshots are."""

    def __init__(self, walls: FloatArray) -> None:
        self.walls = walls

    @property
    def mirrors(self) -> ComplexArray:
        """The walls that have a length (k, 3): first end, way to the second, and its direction squared."""
        return self._mirrors.view(np.complex128)

    @property
    def edges(self) -> ComplexArray:
        """Ends and vertices of the walls (k,), but for those where a wall goes straight on."""
        return self._edges.view(np.complex128)[:, 0]

    @cached_property
    def _mirrors(self) -> FloatArray:
        first, along = self.walls[:, :2], self.walls[:, 2:] - self.walls[:, :2]
        long = (along != 0.0).any(axis=1)
        first, along = first[long], along[long]
        direction = (along[:, 0] + 1j * along[:, 1]) / np.hypot(along[:, 0], along[:, 1])
        twist = direction * direction
        return np.column_stack((first, along, twist.real, twist.imag))

    @cached_property
    def _edges(self) -> FloatArray:
        ways: dict[tuple[float, float], list[float]] = {}
        for x1, y1, x2, y2 in self.walls.tolist():
            ways.setdefault((x1, y1), []).append(atan2(y2 - y1, x2 - x1))
            ways.setdefault((x2, y2), []).append(atan2(y1 - y2, x1 - x2))
        return np.array([point for point, out in ways.items() if not _straight(out)]).reshape(-1, 2)


class Way(NamedTuple):
    """A way of sound: its length, what it loses on it, and the points between which nothing may stand."""

    length_in: float
    loss_db: float
    points: tuple[complex, ...]


class Losses(NamedTuple):
    """What sound loses on its way: dB an inch of range, and dB at each wall after the first, at an edge, and at the
    broken skin of a robot."""

    way_db_in: float
    bounce_db: float
    edge_db: float
    skin_db: float


class Beam(NamedTuple):
    """A transducer's cone: its point, where it looks, half its angle, and what one passage loses at its rim."""

    point: complex
    direction_rad: float
    half_rad: float
    rim_loss_db: float

    def seen(self, points: ComplexArray) -> ComplexArray:
        """Points as they lie along the axis (real) and to its left (imaginary)."""
        return (points - self.point) * rect(1.0, -self.direction_rad)

    def loss_db(self, points: ComplexArray) -> FloatArray:
        """What one passage towards points costs: inf outside the cone."""
        seen = self.seen(points)
        share = np.abs(np.arctan2(seen.imag, seen.real)) / self.half_rad
        return np.where(share <= 1.0, self.rim_loss_db * share * share, inf)

    def may_meet(self, mirrors: ComplexArray) -> ComplexArray:
        """Rows of the mirrors (k, 3) that can reach into the cone: all that are not beyond one of its two sides."""
        one, other = self.seen(mirrors[:, 0]), self.seen(mirrors[:, 0] + mirrors[:, 1])
        slope = tan(self.half_rad)
        rim, far_rim = slope * one.real, slope * other.real
        left, right = (one.imag > rim) & (other.imag > far_rim), (one.imag < -rim) & (other.imag < -far_rim)
        reached: ComplexArray = mirrors[~(left | right)]
        return reached

    def may_meet_discs(self, discs: FloatArray) -> FloatArray:
        """Rows of the discs (k, 3) that reach into the cone, or nearly: not beyond a side, nor behind the point."""
        middles = self.seen(discs[:, 0] + 1j * discs[:, 1])
        beyond = np.abs(middles.imag) * cos(self.half_rad) - middles.real * sin(self.half_rad) > discs[:, 2]
        reached: FloatArray = discs[~(beyond | (middles.real < -discs[:, 2]))]
        return reached


def ways(out: Beam, back: Beam, scene: Scene, lost: Losses, *, own: bool) -> Iterator[Way]:
    """All ways from one transducer to another, or to itself, but for what stands between."""
    first = out.may_meet(scene.mirrors)
    yield from _off_edges(out, back, scene.edges, lost)
    if len(first):
        yield from _off_one(out, back, first, lost)
        if not own:
            yield from _off_two(out, back, first, back.may_meet(scene.mirrors), lost)
        elif len(first) > 1:
            yield from _off_two(out, back, first, first, lost)
    if own and len(first):
        yield from _there_and_back(out, first, scene.mirrors, lost)


def _off_edges(out: Beam, back: Beam, edges: ComplexArray, lost: Losses) -> Iterator[Way]:
    lengths = np.abs(edges - out.point) + np.abs(edges - back.point)
    losses = _there(out, back, edges, edges) + lost.edge_db + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, back, edges)


def _off_one(out: Beam, back: Beam, walls: ComplexArray, lost: Losses) -> Iterator[Way]:
    images = mirrored(out.point, walls)
    points, met = crossings(images, back.point, walls)
    if not met.any():
        return
    images, points = images[met], points[met]
    lengths = np.abs(images - back.point)
    losses = _there(out, back, points, points) + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, back, points)


def _off_two(out: Beam, back: Beam, first: ComplexArray, last: ComplexArray, lost: Losses) -> Iterator[Way]:
    one = first[:, np.newaxis]
    images = mirrored(out.point, one)
    twice = mirrored(images, last)
    points_2, met = crossings(twice, back.point, last)
    if not met.any():
        return
    points_1, met_1 = crossings(images, points_2, one)
    met &= met_1
    points_1, points_2 = points_1[met], points_2[met]
    lengths = np.abs(twice[met] - back.point)
    losses = _there(out, back, points_1, points_2) + lost.bounce_db + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, back, points_1, points_2)


def _there_and_back(out: Beam, first: ComplexArray, walls: ComplexArray, lost: Losses) -> Iterator[Way]:
    """Off a slanted wall, head-on against another, and back the same way."""
    one = first[:, np.newaxis]
    images = mirrored(out.point, one)
    start, along = walls[:, 0], walls[:, 1]
    share = ((images - start) / along).real
    met = (share >= 0.0) & (share <= 1.0)
    if not met.any():
        return
    feet = start + share * along
    points, met_1 = crossings(images, feet, one)
    met &= met_1
    points, feet = points[met], feet[met]
    lengths = 2.0 * np.abs(np.broadcast_to(images, met.shape)[met] - feet)
    losses = 2.0 * out.loss_db(points) + 2.0 * lost.bounce_db + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, None, points, feet)


def _there(out: Beam, back: Beam, first: ComplexArray, last: ComplexArray) -> FloatArray:
    """What both passages lose at the rims of their cones."""
    there = out.loss_db(first)
    return there + (there if back == out and last is first else back.loss_db(last))


def told(lengths: FloatArray, losses: FloatArray, out: Beam, back: Beam | None, *stops: ComplexArray) -> Iterator[Way]:
    """The ways that get anywhere, one by one; back None: they return as they came."""
    for at in zip(*np.nonzero(losses < inf), strict=True):
        on_walls = [complex(stop[at]) for stop in stops]
        points = [out.point, *on_walls, *([back.point] if back is not None else [])]
        yield Way(float(lengths[at]), float(losses[at]), tuple(points))


def mirrored(points: ComplexArray | complex, mirrors: ComplexArray) -> ComplexArray:
    """Images of points (...) in the lines of mirrors (..., 3); shapes broadcast."""
    start = mirrors[..., 0]
    image: ComplexArray = start + mirrors[..., 2] * np.conj(points - start)
    return image


def crossings(
    origins: ComplexArray, ends: ComplexArray | complex, mirrors: ComplexArray
) -> tuple[ComplexArray, BoolArray]:
    """Where the lines from origins to ends (...) cross the mirrors (..., 3), and whether they do on the way."""
    way, along, offset = ends - origins, mirrors[..., 1], np.conj(mirrors[..., 0] - origins)
    turned = (np.conj(way) * along).imag
    some = np.where(turned == 0.0, 1.0, turned)
    on_way, on_wall = (offset * along).imag / some, (offset * way).imag / some
    met = (turned != 0.0) & (on_way > 0.0) & (on_way <= 1.0 + TINY) & (on_wall >= -TINY) & (on_wall <= 1.0 + TINY)
    points: ComplexArray = origins + on_way * way
    return points, met


def free(points: Sequence[complex], walls: FloatArray, discs: FloatArray) -> bool:
    """Whether nothing stands between one point and the next, all along: no wall (m, 4) and no disc (k, 3)."""
    for one, other in pairwise(points):
        length = abs(other - one)
        if length <= 3.0 * SMALL_IN:
            continue
        way = (other - one) / length
        start = one + SMALL_IN * way
        ray = (start.real, start.imag), (way.real, way.imag)
        if float(cast_rays(*ray, walls)[0]) < length - 3.0 * SMALL_IN:
            return False
        if len(discs) and float(cast_discs(*ray, discs)) < length - 3.0 * SMALL_IN:
            return False
    return True


def _straight(directions_rad: list[float]) -> bool:
    """Whether just two walls meet in a point, one the other's continuation."""
    return len(directions_rad) == 2 and abs(abs(short_way(directions_rad[0] - directions_rad[1])) - pi) < STRAIGHT_RAD


SCATTERERS: Final = 33
"""Points of a skin that scatter, evenly over what the cone sees of it: at most 0.8 degrees apart, a third of an inch of
range at 60 in, where a hundredth of the range is noise."""

HALVINGS: Final = 48
"""Of the arc between the points that face two transducers: what is left of it is far below SMALL_IN."""


def ways_disc_ways(
    out: Beam, back: Beam, discs: FloatArray, mirrors: ComplexArray, lost: Losses, *, own: bool
) -> Iterator[Way]:
    """All ways by one of these discs (k, 3) from a transducer to another, or to itself, but for what stands between.

    mirrors   (m, 3) walls that the first cone may meet
    """
    for x, y, radius in back.may_meet_discs(out.may_meet_discs(discs)).tolist():
        yield from _off_the_round(out, back, complex(x, y), radius, lost)
        yield from _off_the_skin(out, back, complex(x, y), radius, lost)
    if own and len(discs) and len(mirrors):
        yield from _there_and_back_disc_ways(out, mirrors, discs, lost)


def _off_the_round(out: Beam, back: Beam, middle: complex, radius: float, lost: Losses) -> Iterator[Way]:
    normal = _facing_both(out.point, back.point, middle, radius)
    if normal is None:
        return
    point = middle + radius * normal
    there, here = abs(out.point - point), abs(back.point - point)
    head_on = ((out.point - point) / normal).real / there
    spread_db = 10.0 * log10(1.0 + 2.0 * there * here / ((there + here) * radius * head_on))
    points = np.array([point])
    losses = out.loss_db(points) + back.loss_db(points) + lost.way_db_in * (there + here) / 2.0 + spread_db
    yield from told(np.array([there + here]), losses, out, back, points)


def _off_the_skin(out: Beam, back: Beam, middle: complex, radius: float, lost: Losses) -> Iterator[Way]:
    """Off the points that evenly spread rays of the first cone meet, from one end of what they see to the other."""
    away = abs(middle - out.point)
    if away <= radius or lost.skin_db == inf:
        return
    bearing, half = short_way(phase(middle - out.point) - out.direction_rad), asin(radius / away)
    right, left = max(bearing - half, -out.half_rad), min(bearing + half, out.half_rad)
    if right > left:
        return
    turned = np.linspace(right, left, SCATTERERS)
    to_side = away * np.sin(turned - bearing)
    reach = away * np.cos(turned - bearing) - np.sqrt(np.maximum(radius * radius - to_side * to_side, 0.0))
    points = out.point + reach * np.exp(1j * (out.direction_rad + turned))
    lengths = reach + np.abs(points - back.point)
    losses = out.loss_db(points) + back.loss_db(points) + lost.skin_db + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, back, points)


def _there_and_back_disc_ways(out: Beam, mirrors: ComplexArray, discs: FloatArray, lost: Losses) -> Iterator[Way]:
    """Off a slanted wall, head-on against a disc, and back the same way."""
    one, radii = mirrors[:, np.newaxis], discs[:, 2]
    images = mirrored(out.point, one)
    to_middle = discs[:, 0] + 1j * discs[:, 1] - images
    away = np.abs(to_middle)
    outside = away > radii
    share = np.where(outside, 1.0 - radii / np.where(outside, away, 1.0), 0.0)
    feet = images + share * to_middle
    points, met = crossings(images, feet, one)
    gaps = share * away
    losses = 2.0 * out.loss_db(points) + 2.0 * lost.bounce_db + lost.way_db_in * gaps
    losses = np.where(met & outside, losses + 10.0 * np.log10(1.0 + gaps / radii), inf)
    yield from told(2.0 * gaps, losses, out, None, points, feet)


def _facing_both(start: complex, end: complex, middle: complex, radius: float) -> complex | None:
    """The unit normal of a disc where it mirrors one point to another; None from inside.

    It lies between the directions to both; there the angles of incidence and of reflection change places in size, so
    the arc is halved until they are one.
    """
    if min(abs(start - middle), abs(end - middle)) <= radius:
        return None
    first = phase(start - middle)
    arc = phase((end - middle) / (start - middle))
    low, high = 0.0, 1.0
    for _ in range(HALVINGS if arc else 0):
        half = 0.5 * (low + high)
        normal = rect(1.0, first + arc * half)
        incidence, reflection = (abs(phase((other - middle) / normal - radius)) for other in (start, end))
        low, high = (half, high) if incidence < reflection else (low, half)
    normal = rect(1.0, first + arc * low)
    return normal if ((start - middle) / normal).real > radius else None


NO_ROBOTS: Final[FloatArray] = np.zeros((0, 3))


class Cry(NamedTuple):
    """A sonar fired: the axis of its ring, its direction, when, and the standard normal numbers of its chance."""

    x_in: float
    y_in: float
    direction_rad: float
    instant_ps: int
    chances: tuple[float, ...]


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
    skin_loss_db      lost at the broken skin of another robot, against a wall, where it does not face the transducer
    blanking_in       echoes from nearer drown in the transducer's own ringing: an own one reads this, others nothing
    recess_in         the transducer's face lies so deep behind the ring
    dead              sonars that read 0
    offsets_in        what each sonar reads more than that, always
    turned_rad        the ring stands turned by this against the turret
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
    skin_loss_db: float = 15.0
    blanking_in: float = 6.0
    recess_in: float = 0.5
    dead: tuple[int, ...] = ()
    offsets_in: tuple[float, ...] = (0.0,) * SONARS
    turned_rad: float = 0.0

    @property
    def life_ps(self) -> int:
        """After this a cry can be heard no more, even when chance favours it by five standard deviations."""
        reach_in = (self.margin_db + 5.0 * self.margin_std_db) / self.way_loss_db_in
        return int(2.0 * reach_in / self.sound_in_s * 1e12)

    def draw(self, chance: np.random.Generator) -> tuple[float, ...]:
        """The chance of one cry: for the range, and for the level. Always two numbers."""
        range_chance, level_chance = chance.standard_normal(2).tolist()
        return range_chance, level_chance

    def heard_in(
        self, cry: Cry, earlier: Sequence[Cry], scene: Scene, body: Body, others: FloatArray = NO_ROBOTS
    ) -> float:
        """The range that a sonar makes of what it hears, inches from the ring; inf for nothing.

        earlier    cries of the same ring before it, of the last `life_ps`
        others     where other robots stand (k, 3), rows x y radius in inches
        """
        range_in = self.first_in(cry, earlier, scene, body, others)
        if range_in == inf:
            return inf
        return range_in + cry.chances[0] * max(self.std_share * range_in, self.least_std_in)

    def first_in(
        self, cry: Cry, earlier: Sequence[Cry], scene: Scene, body: Body, others: FloatArray = NO_ROBOTS
    ) -> float:
        """The range of the first echo that is loud enough, before noise; inf for none."""
        margin_db = self.margin_db + self.margin_std_db * cry.chances[1]
        found: list[tuple[float, Way]] = []
        back = self._beam(cry, body)
        for source in (cry, *earlier):
            own = source is cry
            head_start_in = self.sound_in_s * to_s(cry.instant_ps - source.instant_ps)
            nearest_in = -inf if own else self.blanking_in
            if self.way_loss_db_in * (nearest_in + head_start_in / 2.0) > margin_db:
                continue
            for way in self._ways(self._beam(source, body), back, scene, others, own=own):
                range_in = (way.length_in - head_start_in) / 2.0 - self.recess_in
                if way.loss_db <= margin_db and range_in >= nearest_in:
                    found.append((range_in, way))
        for range_in, way in sorted(found, key=lambda pair: pair[0]):
            if free(way.points, scene.walls, others):
                return range_in
        return inf

    def _ways(self, out: Beam, back: Beam, scene: Scene, others: FloatArray, *, own: bool) -> Iterator[Way]:
        lost = Losses(self.way_loss_db_in, self.bounce_loss_db, self.edge_loss_db, self.skin_loss_db)
        yield from ways(out, back, scene, lost, own=own)
        if len(others):
            yield from ways_disc_ways(out, back, others, out.may_meet(scene.mirrors), lost, own=own)

    def _beam(self, cry: Cry, body: Body) -> Beam:
        return Beam(self._face(cry, body), cry.direction_rad, self.cone_rad / 2.0, self.cone_loss_db / 2.0)

    def _face(self, cry: Cry, body: Body) -> complex:
        """Where the transducer is."""
        return complex(cry.x_in, cry.y_in) + rect(body.sonar_ring_radius_in - self.recess_in, cry.direction_rad)
