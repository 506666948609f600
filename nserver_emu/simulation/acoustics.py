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
free one that is loud enough is the echo. The ping of another sonar of the ring that is still under way is detected like
one's own, and gives too short a range (cross-talk). Not modelled: side lobes, paths off three walls and more or off two
robots, later pings, pings of other robots, rough walls.

Positions are complex numbers x + iy in here, which halves the number of arrays. With the unit direction u of a wall and
a point a of it the image of p is a + u^2 conj(p - a).

References
----------
Kuc and Siegel, Physically based simulation model for acoustic sensor robot navigation, IEEE PAMI 9 (1987): walls as
mirrors, edges as scatterers, the beam's directivity.
"""

from __future__ import annotations

from cmath import phase, rect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from math import asin, atan2, cos, inf, log10, pi, radians, sin, tan
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from nserver_emu.simulation.segments import to_s, wrap_to_pi
from nserver_emu.simulation.settings import SONAR_NUMBERS, setting
from worlds.geometry import NO_DISCS, BoolArray, FloatArray
from worlds.raycast import cast_discs, cast_rays
from worlds.robots import SONARS, Body

ComplexArray = npt.NDArray[np.complex128]

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

BISECTIONS: Final = 48
"""Of the arc between the points that face two transducers: the rest is far below SMALL_IN."""


class ReflectorMap:
    """The walls as reflectors: (m, 4), rows x1 y1 x2 y2 in inches."""

    def __init__(self, walls: FloatArray) -> None:
        self.walls = walls

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
        directions: dict[tuple[float, float], list[float]] = {}
        for x1, y1, x2, y2 in self.walls.tolist():
            directions.setdefault((x1, y1), []).append(atan2(y2 - y1, x2 - x1))
            directions.setdefault((x2, y2), []).append(atan2(y1 - y2, x1 - x2))
        points = [point for point, out in directions.items() if not _is_straight(out)]
        return np.array(points).reshape(-1, 2).view(np.complex128)[:, 0]


def _is_straight(directions_rad: list[float]) -> bool:
    """Return True if exactly two walls meet in a point, one the continuation of the other."""
    return len(directions_rad) == 2 and abs(abs(wrap_to_pi(directions_rad[0] - directions_rad[1])) - pi) < STRAIGHT_RAD


class AcousticPath(NamedTuple):
    """A path of sound: its length, its loss, and the points between which nothing may stand."""

    length_in: float
    loss_db: float
    points: tuple[complex, ...]


class Attenuation(NamedTuple):
    """Losses on a path.

    In dB per inch of range, and in dB at each wall after the first, at an edge, and by scattering at a robot.
    """

    absorption_db_in: float
    bounce_loss_db: float
    edge_loss_db: float
    skin_loss_db: float


class Beam(NamedTuple):
    """The cone of a transducer: its apex, axis, half angle, and the one-way loss at its rim."""

    point: complex
    direction_rad: float
    half_rad: float
    one_way_cone_loss_db: float

    def in_frame(self, points: ComplexArray) -> ComplexArray:
        """Return points relative to the beam: along its axis (real) and to its left (imaginary)."""
        return (points - self.point) * rect(1.0, -self.direction_rad)

    def loss_db(self, points: ComplexArray) -> FloatArray:
        """Return the one-way loss towards points, which grows with the angle squared; inf outside the cone."""
        local = self.in_frame(points)
        off_axis = np.abs(np.arctan2(local.imag, local.real)) / self.half_rad
        return np.where(off_axis <= 1.0, self.one_way_cone_loss_db * off_axis * off_axis, inf)

    def may_meet(self, mirrors: ComplexArray) -> ComplexArray:
        """Return the rows of the mirrors (k, 3) that can reach into the cone: not beyond one of its two sides."""
        one, other = self.in_frame(mirrors[:, 0]), self.in_frame(mirrors[:, 0] + mirrors[:, 1])
        slope = tan(self.half_rad)
        rim, far_rim = slope * one.real, slope * other.real
        left, right = (one.imag > rim) & (other.imag > far_rim), (one.imag < -rim) & (other.imag < -far_rim)
        reached: ComplexArray = mirrors[~(left | right)]
        return reached

    def may_meet_discs(self, discs: FloatArray) -> FloatArray:
        """Return the rows of the discs (k, 3) that reach into the cone, or nearly: not beyond a side, not behind."""
        centres = self.in_frame(discs[:, 0] + 1j * discs[:, 1])
        beyond = np.abs(centres.imag) * cos(self.half_rad) - centres.real * sin(self.half_rad) > discs[:, 2]
        reached: FloatArray = discs[~(beyond | (centres.real < -discs[:, 2]))]
        return reached


def acoustic_paths(
    out: Beam, back: Beam, reflectors: ReflectorMap, discs: FloatArray, losses: Attenuation, *, same_sonar: bool
) -> Iterator[AcousticPath]:
    """Yield all paths between two transducers, regardless of obstructions.

    Parameters
    ----------
    out, back
        Beams of the transmitting and the receiving sonar.
    discs
        Other robots (k, 3), rows x y radius in inches.
    same_sonar
        True if they are one sonar; only then are paths back along themselves possible.
    """
    # 1. Edges, one wall, two walls, and over a slanted wall to another and back.
    first = out.may_meet(reflectors.mirrors)
    yield from _off_edges(out, back, reflectors.edges, losses)
    if len(first):
        yield from _off_one_wall(out, back, first, losses)
        if not same_sonar:
            yield from _off_two_walls(out, back, first, back.may_meet(reflectors.mirrors), losses)
        elif len(first) > 1:
            yield from _off_two_walls(out, back, first, first, losses)
    if same_sonar and len(first):
        yield from _over_wall_to_wall(out, first, reflectors.mirrors, losses)
    if not len(discs):
        return
    # 2. Each robot in both cones; and over a slanted wall to a robot and back.
    for x, y, radius in back.may_meet_discs(out.may_meet_discs(discs)).tolist():
        yield from _off_disc(out, back, complex(x, y), radius, losses)
        yield from _scattered_by_disc(out, back, complex(x, y), radius, losses)
    if same_sonar and len(first):
        yield from _over_wall_to_disc(out, first, discs, losses)


def _off_edges(out: Beam, back: Beam, edges: ComplexArray, losses: Attenuation) -> Iterator[AcousticPath]:
    lengths = np.abs(edges - out.point) + np.abs(edges - back.point)
    loss_db = _cone_losses(out, back, edges, edges) + losses.edge_loss_db + losses.absorption_db_in * lengths / 2.0
    yield from _paths(lengths, loss_db, out, back, edges)


def _off_one_wall(out: Beam, back: Beam, walls: ComplexArray, losses: Attenuation) -> Iterator[AcousticPath]:
    images = mirror_points(out.point, walls)
    points, is_met = crossings(images, back.point, walls)
    if not is_met.any():
        return
    images, points = images[is_met], points[is_met]
    lengths = np.abs(images - back.point)
    loss_db = _cone_losses(out, back, points, points) + losses.absorption_db_in * lengths / 2.0
    yield from _paths(lengths, loss_db, out, back, points)


def _off_two_walls(
    out: Beam, back: Beam, first: ComplexArray, last: ComplexArray, losses: Attenuation
) -> Iterator[AcousticPath]:
    # 1. Images in every first wall (rows), and of those in every last wall (columns).
    one = first[:, np.newaxis]
    images = mirror_points(out.point, one)
    twice = mirror_points(images, last)
    # 2. Backwards from the receiver: the point on the last wall, then the one on the first.
    points_2, is_met = crossings(twice, back.point, last)
    if not is_met.any():
        return
    points_1, is_met_1 = crossings(images, points_2, one)
    is_met &= is_met_1
    points_1, points_2 = points_1[is_met], points_2[is_met]
    # 3. Lengths and losses.
    lengths = np.abs(twice[is_met] - back.point)
    loss_db = (
        _cone_losses(out, back, points_1, points_2) + losses.bounce_loss_db + losses.absorption_db_in * lengths / 2.0
    )
    yield from _paths(lengths, loss_db, out, back, points_1, points_2)


def _over_wall_to_wall(
    out: Beam, first: ComplexArray, walls: ComplexArray, losses: Attenuation
) -> Iterator[AcousticPath]:
    """Yield the paths off a slanted wall, perpendicularly onto another, and back along themselves."""
    # 1. The foot of the perpendicular from each image onto each other wall.
    one = first[:, np.newaxis]
    images = mirror_points(out.point, one)
    start, along = walls[:, 0], walls[:, 1]
    fraction = ((images - start) / along).real
    is_met = (fraction >= 0.0) & (fraction <= 1.0)
    if not is_met.any():
        return
    feet = start + fraction * along
    # 2. The point on the slanted wall.
    points, is_met_1 = crossings(images, feet, one)
    is_met &= is_met_1
    points, feet = points[is_met], feet[is_met]
    # 3. Lengths and losses, there and back.
    lengths = 2.0 * np.abs(np.broadcast_to(images, is_met.shape)[is_met] - feet)
    loss_db = 2.0 * out.loss_db(points) + 2.0 * losses.bounce_loss_db + losses.absorption_db_in * lengths / 2.0
    yield from _paths(lengths, loss_db, out, None, points, feet)


def _off_disc(out: Beam, back: Beam, centre: complex, radius: float, losses: Attenuation) -> Iterator[AcousticPath]:
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
    yield from _paths(np.array([before + after]), loss_db, out, back, points)


def _scattered_by_disc(
    out: Beam, back: Beam, centre: complex, radius: float, losses: Attenuation
) -> Iterator[AcousticPath]:
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
    yield from _paths(lengths, loss_db, out, back, points)


def _over_wall_to_disc(
    out: Beam, mirrors: ComplexArray, discs: FloatArray, losses: Attenuation
) -> Iterator[AcousticPath]:
    """Yield the paths off a slanted wall, perpendicularly onto a disc, and back along themselves."""
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
    yield from _paths(2.0 * gaps, loss_db, out, None, points, feet)


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


def _cone_losses(out: Beam, back: Beam, first: ComplexArray, last: ComplexArray) -> FloatArray:
    """Return the losses off the axes of both cones."""
    outward = out.loss_db(first)
    return outward + (outward if back == out and last is first else back.loss_db(last))


def _paths(
    lengths: FloatArray, loss_db: FloatArray, out: Beam, back: Beam | None, *stops: ComplexArray
) -> Iterator[AcousticPath]:
    """Yield the paths whose loss is finite; back None: they return along themselves."""
    for at in zip(*np.nonzero(loss_db < inf), strict=True):
        on_walls = [complex(stop[at]) for stop in stops]
        points = [out.point, *on_walls, *([back.point] if back is not None else [])]
        yield AcousticPath(float(lengths[at]), float(loss_db[at]), tuple(points))


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


def is_free(points: Sequence[complex], walls: FloatArray, discs: FloatArray) -> bool:
    """Return True if nothing stands between one point and the next: no wall (m, 4) and no disc (k, 3)."""
    for one, other in pairwise(points):
        length = abs(other - one)
        if length <= 3.0 * SMALL_IN:
            continue
        direction = (other - one) / length
        start = one + SMALL_IN * direction
        ray = (start.real, start.imag), (direction.real, direction.imag)
        if float(cast_rays(*ray, walls)[0]) < length - 3.0 * SMALL_IN:
            return False
        if len(discs) and float(cast_discs(*ray, discs)) < length - 3.0 * SMALL_IN:
            return False
    return True


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
        Constant error of each of the 16 sonars, reading less range.
    turned_rad
        Angle of the ring against the turret.
    """

    range_std_relative: float = relative_std(0.0)
    range_std_floor_in: float = _std_floor(0.0)
    dead: tuple[int, ...] = setting((), 0, 15, SONAR_NUMBERS, "sonars that always read 0")
    offsets_in: tuple[float, ...] = setting(
        (0.0,) * SONARS, -24, 24, "in", "constant error of each of the 16 sonars: reading less range"
    )
    turned_rad: float = setting(0.0, -45, 45, "deg", "angle of the ring against the turret")

    def std_in(self, range_in: float) -> float:
        """Return the standard deviation of a range, inches."""
        return max(self.range_std_relative * range_in, self.range_std_floor_in)


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

    @property
    def audible_ps(self) -> int:
        """Time after which a ping is inaudible, even with a level of five standard deviations."""
        reach_in = (self.margin_db + 5.0 * self.margin_std_db) / self.absorption_db_in
        return int(2.0 * reach_in / self.sound_in_s * 1e12)

    def draw(self, rng: np.random.Generator) -> tuple[float, ...]:
        """Draw the noise of a ping: one number for the range and one for the level."""
        range_noise, level_noise = rng.standard_normal(2).tolist()
        return range_noise, level_noise

    def measured_range(
        self, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body, others: FloatArray = NO_DISCS
    ) -> float:
        """Return the measured range, inches from the ring; inf for no echo.

        Parameters
        ----------
        earlier
            Pings of the same ring in the last `audible_ps`.
        others
            Other robots (k, 3), rows x y radius in inches.
        """
        range_in = self.first_echo_in(ping, earlier, reflectors, body, others)
        return range_in if range_in == inf else range_in + ping.noise[0] * self.std_in(range_in)

    def first_echo_in(
        self, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body, others: FloatArray = NO_DISCS
    ) -> float:
        """Return the range of the first echo above the threshold, without noise; inf for none."""
        margin_db = self.margin_db + self.margin_std_db * ping.noise[1]
        losses = Attenuation(self.absorption_db_in, self.bounce_loss_db, self.edge_loss_db, self.skin_loss_db)
        found: list[tuple[float, AcousticPath]] = []
        back = self._beam(ping, body)
        for source in (ping, *earlier):
            # 1. The distance that an earlier ping has travelled already; it is inaudible if too weak by now.
            same_sonar = source is ping
            head_start_in = self.sound_in_s * to_s(ping.instant_ps - source.instant_ps)
            min_range_in = -inf if same_sonar else self.blanking_in
            if self.absorption_db_in * (min_range_in + head_start_in / 2.0) > margin_db:
                continue
            # 2. All paths that are loud enough.
            out = self._beam(source, body)
            for path in acoustic_paths(out, back, reflectors, others, losses, same_sonar=same_sonar):
                range_in = (path.length_in - head_start_in) / 2.0 - self.recess_in
                if path.loss_db <= margin_db and range_in >= min_range_in:
                    found.append((range_in, path))
        # 3. The shortest that is not obstructed: the costly test comes last.
        for range_in, path in sorted(found, key=lambda pair: pair[0]):
            if is_free(path.points, reflectors.walls, others):
                return range_in
        return inf

    def _beam(self, ping: Ping, body: Body) -> Beam:
        face_in = body.sonar_ring_radius_in - self.recess_in
        point = complex(ping.x_in, ping.y_in) + rect(face_in, ping.direction_rad)
        return Beam(point, ping.direction_rad, self.cone_rad / 2.0, self.cone_loss_db / 2.0)
