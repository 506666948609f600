"""Ways of sound from a transducer to a transducer, exactly: by images of the source, as light's in mirrors. Pure.

    off one wall           source' -> receiver                 head-on, or to a neighbour that listens
    off two walls          source'' -> receiver                a square corner sends all back: its vertex is heard
    off one, back off two  source' -> foot on the second       by way of a slanted wall: too long a range
    off an edge            wall ends and vertices scatter      weak, from all sides

Each way leaves and comes in inside the cones; what is lost on it is told with it, and the points between which nothing
may stand. Ways off other robots are disc_ways.py's; what is loud enough, and heard, is polaroid.py's.

Places are complex numbers x + iy in here: half as many arrays. With the unit direction u of a wall and a point a of it
the image of p is a + u^2 conj(p - a).
"""

from __future__ import annotations

from cmath import rect
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from math import atan2, cos, inf, pi, sin, tan
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from nserver_emu.simulation.angles import short_way
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast import cast_discs, cast_rays

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
