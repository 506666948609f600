"""Acoustics of the Polaroid sonars: the paths of sound from transducer to transducer, and the first audible echo.

Smooth walls reflect sound like mirrors, so all paths off them follow from images of the source:

    off one wall           source' -> receiver                 perpendicular, or to a neighbour that listens
    off two walls          source'' -> receiver                a square corner sends everything back: its vertex
    off one, back off two  source' -> foot on the second       over a slanted wall: too long a range
    off an edge            wall ends and vertices scatter      weakly, in all directions

Other robots are discs:

    specular reflection    one point of the disc reflects from source to receiver; the curvature spreads the sound
    scattering             bumpers, sonars and edges scatter weakly in all directions: a robot that only reaches into
                           the cone is detected at its nearest point there that is loud enough
    off a wall, back off the disc      over a slanted wall

Each path leaves and arrives inside the cones; it has a level, and the points between which it must be free. The first
free one that is loud enough is the echo. The ping of another sonar of the ring that is still in flight is detected like
one's own, and gives too short a range (cross-talk). Not modelled: side lobes, paths off three walls and more or off two
robots, later pings, pings of other robots. The surface of a wall may have levels and posts (surfaces.py).

Positions are complex numbers x + iy in here, which halves the number of arrays. With the unit direction u of a wall and
a point a of it the image of p is a + u^2 conj(p - a).

References
----------
Kuc and Siegel, Physically based simulation model for acoustic sensor robot navigation, IEEE PAMI 9 (1987): walls as
mirrors, edges as scatterers, the beam's directivity.
"""

from __future__ import annotations

from cmath import phase, rect
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import asin, cos, inf, log10, nan, pi, radians, sin, tan
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from nserver_emu.simulation.segments import PS_PER_S, wrap_to_pi
from nserver_emu.simulation.settings import SONAR_NUMBERS, setting
from nserver_emu.simulation.surfaces import Surfaces, WallSurface
from worlds.geometry import NO_DISCS, BoolArray, FloatArray, nearest_points
from worlds.raycast import cast_discs, cast_rays, near_walls
from worlds.rings import MAX_SONARS
from worlds.robots import SONARS, Body

ComplexArray = npt.NDArray[np.complex128]
IndexArray = npt.NDArray[np.intp]

SMALL_IN: Final = 1e-6
"""Offset of the start of a reflected leg from its wall, and tolerance at its end: inches, a millionth of the resolution
of a reading."""

TINY: Final = 1e-9
"""Fraction by which a wall or a path counts as longer: the echo of a square corner passes exactly through its vertex.
"""

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall, and have no edge there."""

SCATTERERS: Final = 33
"""Scattering points of a robot, evenly over its visible part: at most 0.8 degrees apart, a third of an inch of range at
60 in, where a hundredth of the range is noise."""

NOISE_SIGMAS: Final = 6.0
"""Standard deviations of noise that are allowed for where distant walls are left out: one draw in 1e9 goes beyond."""

MIN_FACTOR: Final = 1e-3
"""Smallest factor of a range by noise that is allowed for then."""

MAX_POINTS: Final = 4
"""Points on a path: transducer, two walls, transducer."""

MAX_COMBINATIONS: Final = 3000
"""Combinations of two walls that are computed at once: some 0.3 ms."""

FEW_COMBINATIONS: Final = 3000
"""Combinations of two walls that are all computed: fewer take less time than to find out which are needed."""

PATHS_PER_TEST: Final = 3
"""Paths of each ping that are tested at once for obstructions; most pings need no more."""

MAX_UNSELECTED_WALLS: Final = 100
"""With more walls, those in reach are selected first."""

BISECTIONS: Final = 48
"""Of the arc between the points that face two transducers: the rest is far below SMALL_IN."""

Result = TypeVar("Result")
Steps = Generator[None, None, Result]
"""A computation in steps of a few array operations: `next` does one. Between two steps anything else may run."""


def completed(steps: Steps[Result]) -> Result:
    """Return the result of a computation, all steps of it at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: Result = end.value
            return result


def collected(paths: Iterable[Paths]) -> Steps[Paths]:
    """Join paths, one part in each step."""
    parts = list[Paths]()
    for part in paths:
        parts.append(part)
        yield
    return Paths.joined(parts)


class ReflectorMap:
    """The walls as reflectors: (m, 4), rows x1 y1 x2 y2 in inches, and their surfaces; None: as the map has them."""

    def __init__(self, walls: FloatArray, surfaces: Surfaces | None = None) -> None:
        self.walls = walls
        self.surfaces = surfaces

    def within(self, points: ComplexArray, reach_in: float) -> ReflectorMap:
        """Return the walls that sound from any of these points reaches."""
        if len(self.walls) <= MAX_UNSELECTED_WALLS:
            return self
        low, high = complex(points.real.min(), points.imag.min()), complex(points.real.max(), points.imag.max())
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        near = near_walls(middle.real, middle.imag, reach_in + max(half.real, half.imag), self.walls)
        return ReflectorMap(near, self.surfaces)

    @cached_property
    def mirrors(self) -> ComplexArray:
        """The walls that have a length (k, 3): first end, vector to the second, and its unit direction squared."""
        first, along = self.walls[:, :2], self.walls[:, 2:] - self.walls[:, :2]
        long = (along != 0.0).any(axis=1)
        first, along = first[long], along[long]
        direction = (along[:, 0] + 1j * along[:, 1]) / np.hypot(along[:, 0], along[:, 1])
        twist = direction * direction
        return np.column_stack((first, along, twist.real, twist.imag)).view(np.complex128)

    @cached_property
    def edges(self) -> ComplexArray:
        """Ends and vertices of the walls (k,), except where a wall continues straight."""
        # 1. All ends, equal ones next to each other, and the direction of the wall at each.
        ends = self.walls.reshape(-1, 2).view(np.complex128)[:, 0]
        along = ends[1::2] - ends[::2]
        directions = np.angle(np.column_stack((along, -along)).ravel())
        order = np.lexsort((ends.imag, ends.real))
        ends, directions = ends[order], directions[order]
        # 2. Points where exactly two walls meet, one the continuation of the other.
        first = np.flatnonzero(np.append(True, ends[1:] != ends[:-1])) if len(ends) else np.empty(0, dtype=np.intp)
        pairs = first[np.diff(np.append(first, len(ends))) == 2]
        turns = np.remainder(directions[pairs + 1] - directions[pairs], 2.0 * pi)
        is_edge = np.zeros(len(ends), dtype=np.bool_)
        is_edge[first] = True
        is_edge[pairs[np.abs(turns - pi) < STRAIGHT_RAD]] = False
        edges: ComplexArray = ends[is_edge]
        return edges

    @cached_property
    def posts(self) -> tuple[ComplexArray, ComplexArray]:
        """The posts: points on the walls (p,), and how the surface displaces them (p,)."""
        found = [np.empty((2, 0), dtype=np.complex128)]
        for start, along, _ in self.mirrors if self.surfaces else ():
            surface, unit = self._surface(start, along), along / abs(along)
            levels_in = surface.level_in(surface.posts_in)
            found.append(np.array([start + unit * surface.posts_in, 1j * unit * levels_in]))
        points, displaced = np.concatenate(found, axis=1)
        return points, displaced

    def levels_in(self, mirrors: IndexArray, points: ComplexArray, seen_from: ComplexArray) -> FloatArray:
        """Return how far the surfaces of mirrors stand out, at points on them, to the side of other points (n,)."""
        levels_in = np.zeros(len(mirrors))
        if self.surfaces:
            for mirror in np.unique(mirrors):
                start, along, _ = self.mirrors[mirror]
                rows = np.flatnonzero(mirrors == mirror)
                side = np.sign((np.conj(along) * (seen_from[rows] - start)).imag)
                levels_in[rows] = side * self._surface(start, along).level_in(np.abs(points[rows] - start))
        return levels_in

    def _surface(self, start: complex, along: complex) -> WallSurface:
        assert self.surfaces is not None
        end = start + along
        return self.surfaces.of(np.array([start.real, start.imag, end.real, end.imag]))


class Attenuation(NamedTuple):
    """Losses on a path.

    In dB per inch of range, and in dB at each wall after the first, at an edge, by scattering at a robot, at a post.
    """

    absorption_db_in: float
    bounce_loss_db: float
    edge_loss_db: float
    skin_loss_db: float
    post_loss_db: float = inf


class Beam(NamedTuple):
    """The cones of transducers: apex, axis as a unit vector and its direction, half angle, one-way loss at the rim.

    Numbers for one cone, arrays for several: then the methods pair them with their arguments as arrays do.
    """

    point: Any
    axis: Any
    direction_rad: Any
    half_rad: float
    rim_loss_db: float

    def take(self, rows: Any) -> Beam:
        """Return some of several beams, in this order."""
        return Beam(self.point[rows], self.axis[rows], self.direction_rad[rows], self.half_rad, self.rim_loss_db)

    def in_frame(self, points: Any) -> Any:
        """Return points relative to the beam: along its axis (real) and to its left (imaginary)."""
        return (points - self.point) * self.axis.conjugate()

    def loss_db(self, points: Any) -> Any:
        """Return the one-way loss towards points, which grows with the angle squared; inf outside the cone."""
        local = self.in_frame(points)
        off_axis = np.abs(np.arctan2(local.imag, local.real)) / self.half_rad
        return np.where(off_axis <= 1.0, self.rim_loss_db * off_axis * off_axis, inf)

    def may_meet(self, mirrors: ComplexArray) -> BoolArray:
        """Return True for the mirrors (k, 3) that can reach into the cone: not beyond one of its two sides."""
        one, other = self.in_frame(mirrors[:, 0]), self.in_frame(mirrors[:, 0] + mirrors[:, 1])
        slope = tan(self.half_rad)
        rim, far_rim = slope * one.real, slope * other.real
        left, right = (one.imag > rim) & (other.imag > far_rim), (one.imag < -rim) & (other.imag < -far_rim)
        reached: BoolArray = ~(left | right)
        return reached

    def may_meet_points(self, points: ComplexArray) -> BoolArray:
        """Return True for the points (k,) in the cone, or just outside."""
        local = self.in_frame(points)
        reached: BoolArray = np.abs(local.imag) <= (1.0 + TINY) * tan(self.half_rad) * local.real + SMALL_IN
        return reached

    def may_meet_discs(self, discs: FloatArray) -> BoolArray:
        """Return True for the discs (k, 3) that reach into the cone, or nearly: not beyond a side, not behind."""
        centres = self.in_frame(discs[:, 0] + 1j * discs[:, 1])
        beyond = np.abs(centres.imag) * cos(self.half_rad) - centres.real * sin(self.half_rad) > discs[:, 2]
        reached: BoolArray = ~(beyond | (centres.real < -discs[:, 2]))
        return reached


class Pairs(NamedTuple):
    """Pairs of a transmitting and a receiving beam, and which of their echoes count.

    Attributes
    ----------
    beams
        All beams.
    source, receiver
        Rows of the beams of each pair (k,), the same row where a sonar receives its own ping.
    head_start_in
        Distance that an earlier ping has travelled when the receiver starts to measure (k,).
    min_range_in, margin_db
        Shortest range and largest loss of an echo that is detected (k,).
    """

    beams: Beam
    source: IndexArray
    receiver: IndexArray
    head_start_in: FloatArray
    min_range_in: FloatArray
    margin_db: FloatArray

    @property
    def each(self) -> Beam:
        """All beams as a column, to pair each with all of something."""
        return self.beams.take(np.arange(len(self.beams.point))[:, np.newaxis])

    @property
    def is_own(self) -> BoolArray:
        """True for the pairs of a sonar with itself."""
        own: BoolArray = self.source == self.receiver
        return own


class Paths(NamedTuple):
    """Paths of sound: the row of the pair, length, loss, and the points along them, nan after the last (n, 4).

    Nothing may stand between one point and the next.
    """

    pair: IndexArray
    length_in: FloatArray
    loss_db: FloatArray
    points: ComplexArray

    @classmethod
    def between(
        cls, pairs: Pairs, pair: IndexArray, lengths: FloatArray, loss_db: FloatArray, *stops: ComplexArray,
        returns: bool = False,
    ) -> Paths:  # fmt: skip
        """Return the paths with a finite loss from the source over `stops`, back to the receiver unless it returns."""
        detected = loss_db < inf
        pair = pair[detected]
        columns = [pairs.beams.point[pairs.source[pair]], *(stop[detected] for stop in stops)]
        if not returns:
            columns.append(pairs.beams.point[pairs.receiver[pair]])
        points = np.full((len(pair), MAX_POINTS), complex(nan, nan))
        for number, column in enumerate(columns):
            points[:, number] = column
        return cls(pair, lengths[detected], loss_db[detected], points)

    @classmethod
    def joined(cls, parts: Sequence[Paths]) -> Paths:
        """Return all paths of several parts."""
        if not parts:
            none = np.empty(0)
            return cls(none.astype(np.intp), none, none, np.empty((0, MAX_POINTS), dtype=np.complex128))
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def take(self, rows: Any) -> Paths:
        """Return some of the paths."""
        return Paths(*(column[rows] for column in self))


def single_paths(
    pairs: Pairs, may_meet: BoolArray, reflectors: ReflectorMap, discs: Sequence[FloatArray], losses: Attenuation
) -> Iterator[Paths]:
    """Yield all paths off one edge, one wall or one robot, and over a wall to a robot, regardless of obstructions.

    Parameters
    ----------
    may_meet
        True where a beam (rows) may meet a wall.
    discs
        For each beam, the other robots (k, 3), rows x y radius in inches.
    """
    mirrors, edges = reflectors.mirrors, reflectors.edges
    yield _off_edges(pairs, pairs.each.may_meet_points(edges), edges, losses)
    yield _off_one_wall(pairs, may_meet, reflectors, losses)
    if reflectors.surfaces:
        posts, displaced = reflectors.posts
        scattered = losses._replace(edge_loss_db=losses.post_loss_db)
        yield _off_edges(pairs, pairs.each.may_meet_points(posts), posts, scattered, displaced)
    if any(map(len, discs)):
        yield from _off_discs(pairs, may_meet, mirrors, discs, losses)


def double_paths(
    pairs: Pairs, may_meet: BoolArray, reflectors: ReflectorMap, losses: Attenuation
) -> Iterator[Paths]:
    """Yield the paths off two walls, and over a slanted wall to another and back, regardless of obstructions."""
    own, mirrors = np.flatnonzero(pairs.is_own), reflectors.mirrors
    first, every = may_meet[pairs.source], np.ones((len(own), len(mirrors)), dtype=np.bool_)
    yield from _off_two_walls(pairs, first, may_meet[pairs.receiver], mirrors, losses)
    yield from _over_wall_to_wall(pairs, own, first[own], every, reflectors, losses)


def short_double_paths(
    pairs: Pairs, may_meet: BoolArray, reflectors: ReflectorMap, max_range_in: FloatArray, losses: Attenuation
) -> Iterator[Paths]:
    """Yield those of `double_paths` that are no longer than a range (k,) of each pair, and some more."""
    beams, mirrors = pairs.beams, reflectors.mirrors
    # A path over a wall is at least as long as twice the distance of that wall less that between the transducers.
    apart_in = np.abs(beams.point[pairs.source] - beams.point[pairs.receiver])
    far_in = (max_range_in + (pairs.head_start_in + apart_in) / 2.0)[:, np.newaxis]
    walls = np.column_stack((mirrors[:, 0], mirrors[:, 0] + mirrors[:, 1])).view(np.float64)
    _, distances = nearest_points(np.column_stack((beams.point.real, beams.point.imag)), walls)
    is_near_source = distances[pairs.source] <= far_in
    first = may_meet[pairs.source] & is_near_source
    last = may_meet[pairs.receiver] & (distances[pairs.receiver] <= far_in)
    own = np.flatnonzero(pairs.is_own)
    yield from _off_two_walls(pairs, first, last, mirrors, losses)
    yield from _over_wall_to_wall(pairs, own, first[own], is_near_source[own], reflectors, losses)


def _off_edges(
    pairs: Pairs, may_meet: BoolArray, edges: ComplexArray, losses: Attenuation, displaced: ComplexArray | None = None
) -> Paths:
    pair, edge = np.nonzero(may_meet[pairs.source] & may_meet[pairs.receiver])
    out, back, points = *_beams(pairs, pair), edges[edge]
    # A displaced edge counts as on its wall for what obstructs it, but not for the length.
    at = points if displaced is None else points + displaced[edge]
    lengths = np.abs(at - out.point) + np.abs(at - back.point)
    loss_db = out.loss_db(points) + back.loss_db(points) + losses.edge_loss_db + losses.absorption_db_in * lengths / 2.0
    return Paths.between(pairs, pair, lengths, loss_db, points)


def _off_one_wall(pairs: Pairs, may_meet: BoolArray, reflectors: ReflectorMap, losses: Attenuation) -> Paths:
    mirrors = reflectors.mirrors
    # The point of reflection lies in both cones, so the wall reaches into both.
    pair, wall = np.nonzero(may_meet[pairs.source] & may_meet[pairs.receiver])
    out, back = _beams(pairs, pair)
    images = mirror_points(out.point, mirrors[wall])
    points, is_met = crossings(images, back.point, mirrors[wall])
    pair, wall, images, points = pair[is_met], wall[is_met], images[is_met], points[is_met]
    out, back = _beams(pairs, pair)
    lengths = np.abs(images - back.point)
    if reflectors.surfaces:
        lengths = np.maximum(lengths - 2.0 * reflectors.levels_in(wall, points, back.point), 0.0)
    loss_db = out.loss_db(points) + back.loss_db(points) + losses.absorption_db_in * lengths / 2.0
    return Paths.between(pairs, pair, lengths, loss_db, points)


def _off_two_walls(
    pairs: Pairs, first: BoolArray, last: BoolArray, mirrors: ComplexArray, losses: Attenuation
) -> Iterator[Paths]:
    for pair, one, two in _products(first, last):
        # 1. The image in the first wall, and its image in the last.
        out, back = _beams(pairs, pair)
        images = mirror_points(out.point, mirrors[one])
        twice = mirror_points(images, mirrors[two])
        # 2. Backwards from the receiver: the point on the last wall, then the one on the first.
        points_2, is_met = crossings(twice, back.point, mirrors[two])
        met = np.flatnonzero(is_met)
        if not len(met):
            continue
        points_1, is_met = crossings(images[met], points_2[met], mirrors[one[met]])
        met, points_1 = met[is_met], points_1[is_met]
        # 3. Lengths and losses.
        out, back = out.take(met), back.take(met)
        lengths = np.abs(twice[met] - back.point)
        loss_db = out.loss_db(points_1) + back.loss_db(points_2[met]) + losses.bounce_loss_db
        loss_db += losses.absorption_db_in * lengths / 2.0
        yield Paths.between(pairs, pair[met], lengths, loss_db, points_1, points_2[met])


def _over_wall_to_wall(
    pairs: Pairs, own: IndexArray, slanted: BoolArray, second: BoolArray, reflectors: ReflectorMap,
    losses: Attenuation,
) -> Iterator[Paths]:  # fmt: skip
    """Yield the paths off a slanted wall, perpendicularly onto another, and back along themselves."""
    mirrors = reflectors.mirrors
    for row, one, two in _products(slanted, second):
        out, _ = _beams(pairs, own[row])
        first, start, along = mirrors[one], mirrors[two, 0], mirrors[two, 1]
        # 1. The foot of the perpendicular from each image onto each other wall.
        images = mirror_points(out.point, first)
        fraction = ((images - start) / along).real
        is_foot = (fraction >= 0.0) & (fraction <= 1.0)
        if reflectors.surfaces:
            is_foot &= one != two  # the path off one wall, without the level of its surface
        met = np.flatnonzero(is_foot)
        if not len(met):
            continue
        feet = start[met] + fraction[met] * along[met]
        # 2. The point on the slanted wall.
        points, is_met = crossings(images[met], feet, first[met])
        met, points, feet = met[is_met], points[is_met], feet[is_met]
        # 3. Lengths and losses, there and back.
        lengths = 2.0 * np.abs(images[met] - feet)
        loss_db = 2.0 * out.take(met).loss_db(points) + 2.0 * losses.bounce_loss_db
        loss_db += losses.absorption_db_in * lengths / 2.0
        yield Paths.between(pairs, own[row[met]], lengths, loss_db, points, feet, returns=True)


def _beams(pairs: Pairs, pair: IndexArray) -> tuple[Beam, Beam]:
    """Return the transmitting and the receiving beams of pairs."""
    return pairs.beams.take(pairs.source[pair]), pairs.beams.take(pairs.receiver[pair])


def _products(
    first: BoolArray, second: BoolArray
) -> Iterator[tuple[IndexArray, IndexArray, IndexArray]]:
    """Yield row, column of `first` and column of `second` for all combinations that are True, a block at a time."""
    first_counts, second_counts = first.sum(axis=1), second.sum(axis=1)
    counts = first_counts * second_counts
    first_columns, second_columns = np.nonzero(first)[1], np.nonzero(second)[1]
    first_begin, second_begin = np.cumsum(first_counts) - first_counts, np.cumsum(second_counts) - second_counts
    if not counts.any():
        return
    blocks = np.cumsum(counts) // MAX_COMBINATIONS
    for block in range(blocks[-1] + 1):
        rows = np.flatnonzero((blocks == block) & (counts > 0))
        row = np.repeat(rows, counts[rows])
        number = np.arange(len(row)) - np.repeat(np.cumsum(counts[rows]) - counts[rows], counts[rows])
        one, two = np.divmod(number, second_counts[row])
        yield row, first_columns[first_begin[row] + one], second_columns[second_begin[row] + two]


def _off_discs(
    pairs: Pairs, may_meet: BoolArray, mirrors: ComplexArray, discs: Sequence[FloatArray], losses: Attenuation
) -> Iterator[Paths]:
    """Yield the paths off other robots."""
    for receiver in np.unique(pairs.receiver).tolist():
        robots = discs[receiver]
        if not len(robots):
            continue
        # 1. The robots in both cones of each pair; pairs that share one are few.
        back, own = _beam(pairs, receiver), np.flatnonzero(pairs.receiver == receiver)
        outs = pairs.beams.take(pairs.source[own][:, np.newaxis])
        shared = outs.may_meet_discs(robots) & back.may_meet_discs(robots)
        for number, robot in np.argwhere(shared).tolist():
            x, y, radius = robots[robot].tolist()
            out = _beam(pairs, int(pairs.source[own[number]]))
            for lengths, loss_db, points in (
                *_off_disc(out, back, complex(x, y), radius, losses),
                *_scattered_by_disc(out, back, complex(x, y), radius, losses),
            ):
                yield Paths.between(pairs, own[number].repeat(len(lengths)), lengths, loss_db, points)
        # 2. Over a wall, for the sonar's own ping.
        for pair in own[pairs.source[own] == receiver]:
            lengths, loss_db, points, feet = _over_wall_to_disc(back, mirrors[may_meet[receiver]], robots, losses)
            yield Paths.between(pairs, pair.repeat(len(lengths)), lengths, loss_db, points, feet, returns=True)


def _beam(pairs: Pairs, row: int) -> Beam:
    """Return one of the beams."""
    beams = pairs.beams
    return beams._replace(
        point=complex(beams.point[row]), axis=complex(beams.axis[row]), direction_rad=float(beams.direction_rad[row])
    )


Echoes = tuple[FloatArray, FloatArray, ComplexArray]
"""Lengths, losses, and the points on a robot."""


def _off_disc(out: Beam, back: Beam, centre: complex, radius: float, losses: Attenuation) -> Iterator[Echoes]:
    """Yield the specular path off a disc.

    A bundle of rays in the plane that a disc of radius r reflects is spread by 1 + 2 a b / ((a + b) r cos(incidence)),
    with the distances a and b before and after; from the same place (a = b = d) by (r + d) / r.
    """
    normal = _specular_normal(out.point, back.point, centre, radius)
    if normal is None:
        return
    point = centre + radius * normal
    before, after = abs(out.point - point), abs(back.point - point)
    cos_incidence = ((out.point - point) / normal).real / before
    spread_db = 10.0 * log10(1.0 + 2.0 * before * after / ((before + after) * radius * cos_incidence))
    points = np.array([point])
    absorbed_db = losses.absorption_db_in * (before + after) / 2.0
    loss_db = out.loss_db(points) + back.loss_db(points) + absorbed_db + spread_db
    yield np.array([before + after]), loss_db, points


def _scattered_by_disc(
    out: Beam, back: Beam, centre: complex, radius: float, losses: Attenuation
) -> Iterator[Echoes]:
    """Yield paths off points that evenly spread rays of the first cone meet, across the visible part of a disc."""
    away = abs(centre - out.point)
    if away <= radius or losses.skin_loss_db == inf:
        return
    # 1. The interval of directions in which the disc is visible inside the cone.
    bearing, half = wrap_to_pi(phase(centre - out.point) - out.direction_rad), asin(radius / away)
    right, left = max(bearing - half, -out.half_rad), min(bearing + half, out.half_rad)
    if right > left:
        return
    # 2. Ranges to the rim along evenly spread rays.
    turned = np.linspace(right, left, SCATTERERS)
    to_side = away * np.sin(turned - bearing)
    ranges = away * np.cos(turned - bearing) - np.sqrt(np.maximum(radius * radius - to_side * to_side, 0.0))
    points = out.point + ranges * np.exp(1j * (out.direction_rad + turned))
    # 3. Lengths and losses.
    lengths = ranges + np.abs(points - back.point)
    absorbed_db = losses.absorption_db_in * lengths / 2.0
    loss_db = out.loss_db(points) + back.loss_db(points) + losses.skin_loss_db + absorbed_db
    yield lengths, loss_db, points


def _over_wall_to_disc(
    out: Beam, mirrors: ComplexArray, discs: FloatArray, losses: Attenuation
) -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
    """Return the paths off a slanted wall, perpendicularly onto a disc, and back along themselves.

    Lengths, losses, points on the wall and on the disc, for each wall and disc; a loss of inf where there is no path.
    """
    # 1. The point of each disc that faces each image.
    one, radii = mirrors[:, np.newaxis], discs[:, 2]
    images = mirror_points(out.point, one)
    to_centre = discs[:, 0] + 1j * discs[:, 1] - images
    away = np.abs(to_centre)
    is_outside = away > radii
    fraction = np.where(is_outside, 1.0 - radii / np.where(is_outside, away, 1.0), 0.0)
    feet = images + fraction * to_centre
    # 2. The point on the wall; losses there and back, and the spread by the curvature.
    points, is_met = crossings(images, feet, one)
    gaps = fraction * away
    loss_db = 2.0 * out.loss_db(points) + 2.0 * losses.bounce_loss_db + losses.absorption_db_in * gaps
    loss_db = np.where(is_met & is_outside, loss_db + 10.0 * np.log10(1.0 + gaps / radii), inf)
    return 2.0 * gaps.ravel(), loss_db.ravel(), points.ravel(), feet.ravel()


def _specular_normal(start: complex, end: complex, centre: complex, radius: float) -> complex | None:
    """Return the unit normal of a disc where it reflects from one point to another; None from inside.

    It lies between the directions to both points. There the angles of incidence and of reflection change places in
    size, so the arc is bisected until they are equal.
    """
    if min(abs(start - centre), abs(end - centre)) <= radius:
        return None
    first = phase(start - centre)
    arc = phase((end - centre) / (start - centre))
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS if arc else 0):
        half = 0.5 * (low + high)
        normal = rect(1.0, first + arc * half)
        incidence, reflection = (abs(phase((other - centre) / normal - radius)) for other in (start, end))
        low, high = (half, high) if incidence < reflection else (low, half)
    normal = rect(1.0, first + arc * low)
    return normal if ((start - centre) / normal).real > radius else None


def mirror_points(points: ComplexArray | complex, mirrors: ComplexArray) -> ComplexArray:
    """Return the images of points (...) in the lines of mirrors (..., 3); shapes broadcast."""
    start = mirrors[..., 0]
    image: ComplexArray = start + mirrors[..., 2] * np.conj(points - start)
    return image


def crossings(
    origins: ComplexArray, ends: ComplexArray | complex, mirrors: ComplexArray
) -> tuple[ComplexArray, BoolArray]:
    """Return where the lines from origins to ends (...) cross the mirrors (..., 3), and where they really do."""
    line, along, offset = ends - origins, mirrors[..., 1], np.conj(mirrors[..., 0] - origins)
    turned = (np.conj(line) * along).imag
    divisor = np.where(turned == 0.0, 1.0, turned)  # parallel lines do not cross
    on_line, on_wall = (offset * along).imag / divisor, (offset * line).imag / divisor
    is_on_line = (on_line > 0.0) & (on_line <= 1.0 + TINY)
    is_met = (turned != 0.0) & is_on_line & (on_wall >= -TINY) & (on_wall <= 1.0 + TINY)
    points: ComplexArray = origins + on_line * line
    return points, is_met


def is_free(paths: Paths, walls: FloatArray, discs: FloatArray) -> BoolArray:
    """Return True for the paths (n,) on which nothing stands between one point and the next: no wall, no disc."""
    # 1. The legs of all paths, without those that are too short to be obstructed.
    one, other = paths.points[:, :-1], paths.points[:, 1:]
    length = np.abs(other - one)
    row, leg = np.nonzero(length > 3.0 * SMALL_IN)
    one, length = one[row, leg], length[row, leg]
    direction = (other[row, leg] - one) / length
    # 2. Rays along them.
    start = one + SMALL_IN * direction
    rays = np.column_stack((start.real, start.imag)), np.column_stack((direction.real, direction.imag))
    met = cast_rays(*rays, walls)[0]
    if len(discs):
        met = np.minimum(met, cast_discs(*rays, discs))
    free = np.ones(len(paths.pair), dtype=np.bool_)
    free[row[met < length - 3.0 * SMALL_IN]] = False
    return free


class Ping(NamedTuple):
    """The firing of a sonar.

    Attributes
    ----------
    x_in, y_in, direction_rad
        True position of the ring's axis, and direction of the sonar.
    instant_ps
        Simulated time.
    noise
        Standard normal numbers drawn for it.
    """

    x_in: float
    y_in: float
    direction_rad: float
    instant_ps: int
    noise: tuple[float, ...]


relative_std: Any = partial(
    setting, low=0, high=1, unit="", meaning="standard deviation of a range relative to it", former="std_share"
)
"""The setting `range_std_relative` of every sensor that measures ranges."""

_std_floor: Any = partial(
    setting, low=0, high=10, unit="in", meaning="lower bound of that", former="least_std_in"
)
_decibels: Any = partial(setting, unit="dB")


@dataclass(frozen=True, slots=True)
class SonarErrors:
    """Settings of both sonar models.

    Attributes
    ----------
    range_std_relative, range_std_floor_in
        Standard deviation of a range: relative to the range, and at least so many inches.
    dead
        Sonars that read 0.
    offsets_in
        Constant error of each sonar, reading less range; 0 of sonars beyond the list.
    turned_rad
        Angle of the ring against the turret.
    """

    range_std_relative: float = relative_std(0.0)
    range_std_floor_in: float = _std_floor(0.0)
    dead: tuple[int, ...] = setting((), 0, MAX_SONARS - 1, SONAR_NUMBERS, "sonars that always read 0")
    offsets_in: tuple[float, ...] = setting(
        (0.0,) * SONARS, -24, 24, "in", "constant error of each sonar: reading less range", max_length=MAX_SONARS
    )
    turned_rad: float = setting(0.0, -45, 45, "deg", "angle of the ring against the turret")

    def offset_in(self, sonar: int) -> float:
        """Return the constant error of a sonar."""
        return self.offsets_in[sonar] if sonar < len(self.offsets_in) else 0.0

    def reach_in(self, max_range_in: float) -> float:
        """Return the range beyond which a ring of this maximum range has no echo, but for one draw in a billion."""
        farthest_in = max_range_in + max(map(abs, self.offsets_in)) + NOISE_SIGMAS * self.range_std_floor_in
        return farthest_in / max(1.0 - NOISE_SIGMAS * self.range_std_relative, MIN_FACTOR)

    def std_in(self, range_in: float) -> float:
        """Return the standard deviation of a range, inches."""
        return range_std_in(range_in, self.range_std_relative, self.range_std_floor_in)


def range_std_in(range_in: float, relative: float, floor_in: float) -> float:
    """Return the standard deviation of a range, inches."""
    return max(relative * range_in, floor_in)


@dataclass(frozen=True, slots=True)
class Polaroid(SonarErrors):
    """A ring of Polaroid transducers. Levels are relative to a wall met perpendicularly at close range.

    Attributes
    ----------
    cone_rad
        Full angle of the cone in which a transducer transmits and receives.
    sound_in_s
        Speed of sound: 343 m/s, air at 20 degrees C.
    margin_db, margin_std_db
        Level of that wall above the detection threshold; each ping draws one with this standard deviation.
    cone_loss_db
        Two-way loss at the rim of the cone; proportional to the angle squared inside.
    absorption_db_in
        Loss per inch of range: absorption, and the spreading that the receiver's rising gain leaves.
    bounce_loss_db, edge_loss_db, skin_loss_db
        Loss at each wall after the first, at an edge, and by scattering at another robot.
    blanking_in
        Range below which the transducer still rings: its own echo reads this, echoes of others are lost.
    recess_in
        Depth of the transducer's face behind the ring.
    surface_std_in, surface_length_in, post_spacing_in, post_loss_db
        The surfaces of walls (surfaces.py), and the loss at a post. A standard deviation and a spacing of 0: planes.
    """

    range_std_relative: float = relative_std(0.01)
    range_std_floor_in: float = _std_floor(0.05)
    cone_rad: float = setting(radians(25.0), 1, 90, "deg", "full angle of the cone in which a sonar sends and receives")
    sound_in_s: float = setting(13504.0, 1000, 100000, "in/s", "speed of sound")
    margin_db: float = _decibels(30.0, 0, 200, meaning="level of a near wall, met perpendicularly, above the threshold")
    margin_std_db: float = _decibels(2.0, 0, 20, meaning="standard deviation of that from ping to ping")
    cone_loss_db: float = _decibels(12.0, 0, 200, meaning="two-way loss at the rim of the cone")
    absorption_db_in: float = setting(0.1, 0.02, 100, "dB/in", "loss per inch of range", former="way_loss_db_in")
    bounce_loss_db: float = _decibels(3.0, 0, 200, meaning="loss at each wall after the first")
    edge_loss_db: float = _decibels(15.0, 0, 200, meaning="loss at an edge, relative to a wall")
    skin_loss_db: float = _decibels(15.0, 0, 200, meaning="loss by scattering at a robot that does not face the sonar")
    blanking_in: float = setting(6.0, 0, 24, "in", "echoes of neighbours from nearer are not detected")
    recess_in: float = setting(0.5, 0, 4, "in", "depth of the transducers behind the ring")
    surface_std_in: float = setting(0.0, 0, 12, "in", "standard deviation of the level of a wall's surface; 0: plane")
    surface_length_in: float = setting(24.0, 1, 1000, "in", "mean length of a level; correlation length of the surface")
    post_spacing_in: float = setting(0.0, 0, 1000, "in", "mean distance of posts along a wall, at least 1; 0: none")
    post_loss_db: float = _decibels(10.0, 0, 200, meaning="loss at a post, relative to a wall")

    @property
    def audible_ps(self) -> int:
        """Time after which a ping is inaudible, even with a level of five standard deviations."""
        reach_in = (self.margin_db + 5.0 * self.margin_std_db) / self.absorption_db_in
        return int(2.0 * reach_in / self.sound_in_s * 1e12)

    def surfaces(self, seed: int) -> Surfaces | None:
        """Return the surfaces of the walls in a run of this seed; None if they are planes without posts."""
        if not (self.surface_std_in or self.post_spacing_in):
            return None
        spacing_in = self.post_spacing_in and max(self.post_spacing_in, 1.0)
        return Surfaces(seed, self.surface_std_in, self.surface_length_in, spacing_in)

    def draw(self, rng: np.random.Generator) -> tuple[float, ...]:
        """Draw the noise of a ping: one number for the range and one for the level."""
        range_noise, level_noise = rng.standard_normal(2).tolist()
        return range_noise, level_noise

    def range_steps(
        self, pings: Sequence[Ping], earlier: Sequence[Sequence[Ping]], reflectors: ReflectorMap, body: Body,
        others: Sequence[FloatArray], max_range_in: float = inf,
    ) -> Steps[list[float]]:  # fmt: skip
        """Compute the measured ranges of pings, inches from the ring; inf for no echo.

        The number of pings in a call changes no bit of the result.

        Parameters
        ----------
        earlier
            For each ping, the pings of the same ring in the last `audible_ps`.
        others
            For each ping, the other robots (k, 3), rows x y radius in inches.
        max_range_in
            An echo from farther away may count as none.
        """
        ranges_in = yield from self.first_echo_steps(pings, earlier, reflectors, body, others, max_range_in)
        return [
            range_in if range_in == inf else range_in + ping.noise[0] * self.std_in(range_in)
            for ping, range_in in zip(pings, ranges_in, strict=True)
        ]

    def first_echo_steps(
        self, pings: Sequence[Ping], earlier: Sequence[Sequence[Ping]], reflectors: ReflectorMap, body: Body,
        others: Sequence[FloatArray], max_range_in: float = inf,
    ) -> Steps[list[float]]:  # fmt: skip
        """Compute the ranges of the first echoes above the threshold, without noise; inf for none."""
        pairs = self._pairs(pings, earlier, body)
        yield
        # 1. Reflectors that sound can reach and return from before it is too weak.
        margin_db = float(pairs.margin_db.max(initial=0.0))
        reach_in = margin_db / self.absorption_db_in if self.absorption_db_in else inf
        near = reflectors.within(pairs.beams.point, reach_in)
        may_meet = pairs.each.may_meet(near.mirrors)
        losses = Attenuation(
            self.absorption_db_in, self.bounce_loss_db, self.edge_loss_db, self.skin_loss_db, self.post_loss_db
        )
        discs = [*others, *[NO_DISCS] * (len(pairs.beams.point) - len(pings))]
        ranges_in = np.full(len(pings), inf)
        yield
        paths = yield from collected(single_paths(pairs, may_meet, near, discs, losses))
        counts = may_meet.sum(axis=1)
        if int((counts[pairs.source] * counts[pairs.receiver]).sum()) <= FEW_COMBINATIONS:
            # 2. The first free path of all ...
            double = yield from collected(double_paths(pairs, may_meet, near, losses))
            yield from self._find_free(pairs, Paths.joined([paths, double]), near.walls, discs, ranges_in)
        else:
            # ... or, among many walls, off one reflector, then of those off two that are shorter.
            yield from self._find_free(pairs, paths, near.walls, discs, ranges_in)
            nearest_in = np.minimum(ranges_in, min(reach_in, max_range_in))[pairs.receiver] + self.recess_in + SMALL_IN
            double = yield from collected(short_double_paths(pairs, may_meet, near, nearest_in, losses))
            yield from self._find_free(pairs, double, near.walls, discs, ranges_in)
        found: list[float] = ranges_in.tolist()
        return found

    def _find_free(
        self, pairs: Pairs, paths: Paths, walls: FloatArray, discs: Sequence[FloatArray], ranges_in: FloatArray
    ) -> Steps[None]:
        """Replace the range of each ping by that of the shortest path that is audible and free, if it is shorter."""
        if not len(paths.pair):
            return
        # 1. Paths that are loud enough, by ping and range.
        range_in = (paths.length_in - pairs.head_start_in[paths.pair]) / 2.0 - self.recess_in
        detected = (paths.loss_db <= pairs.margin_db[paths.pair]) & (range_in >= pairs.min_range_in[paths.pair])
        detected &= range_in < ranges_in[pairs.receiver[paths.pair]]
        paths, range_in = paths.take(detected), range_in[detected]
        ping = pairs.receiver[paths.pair]
        order = np.lexsort((range_in, ping))
        # 2. Whether they are obstructed: the costly test comes last, for a few paths of each ping at a time.
        while len(order):
            number = np.arange(len(order)) - np.searchsorted(ping[order], ping[order])
            tested, order = order[number < PATHS_PER_TEST], order[number >= PATHS_PER_TEST]
            for group in _by_discs(ping[tested], discs):
                yield
                rows = tested[group]
                free = rows[is_free(paths.take(rows), walls, discs[ping[rows[0]]])]
                np.minimum.at(ranges_in, ping[free], range_in[free])
            order = order[range_in[order] < ranges_in[ping[order]]]

    def _pairs(self, pings: Sequence[Ping], earlier: Sequence[Sequence[Ping]], body: Body) -> Pairs:
        """Return the pairs of each ping with itself and with those before it that are still audible."""
        # 1. A beam for each ping: first those that are measured, then the others.
        rows = {id(ping): row for row, ping in enumerate(pings)}
        beams = list(pings)
        source, receiver = list(range(len(pings))), list(range(len(pings)))
        for number, before in enumerate(earlier):
            for ping in before:
                row = rows.setdefault(id(ping), len(beams))
                if row == len(beams):
                    beams.append(ping)
                source.append(row)
                receiver.append(number)
        x, y, directions, instants_ps, noise = (np.array(column) for column in zip(*(
            (ping.x_in, ping.y_in, ping.direction_rad, ping.instant_ps, ping.noise[1]) for ping in beams
        ), strict=True))
        face_in = body.sonar_ring_radius_in - self.recess_in
        axes = np.cos(directions) + 1j * np.sin(directions)
        points = x + 1j * y + face_in * axes
        # 2. The distance that an earlier ping has travelled already.
        sources, receivers = np.array(source), np.array(receiver)
        head_start_in = self.sound_in_s * ((instants_ps[receivers] - instants_ps[sources]) / PS_PER_S)
        min_range_in = np.where(sources == receivers, -inf, self.blanking_in)
        margin_db = self.margin_db + self.margin_std_db * noise[receivers]
        # 3. It is inaudible if too weak by now.
        quiet_db = self.absorption_db_in * (self.blanking_in + head_start_in / 2.0)
        detected = (sources == receivers) | (quiet_db <= margin_db)
        beam = Beam(points, axes, directions, self.cone_rad / 2.0, self.cone_loss_db / 2.0)
        return Pairs(
            beam, sources[detected], receivers[detected], head_start_in[detected], min_range_in[detected],
            margin_db[detected],
        )  # fmt: skip


def _by_discs(pings: IndexArray, discs: Sequence[FloatArray]) -> list[IndexArray]:
    """Return groups of rows whose pings have the same other robots: all of them where there are none."""
    if not any(map(len, discs)):
        return [np.arange(len(pings))]
    groups: dict[int, list[int]] = {}
    for row, ping in enumerate(pings.tolist()):
        groups.setdefault(ping if len(discs[ping]) else -1, []).append(row)
    return [np.array(rows) for rows in groups.values()]
