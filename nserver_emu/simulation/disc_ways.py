"""Ways of sound off other robots, which are discs: as echo_ways.py's off walls. Pure.

    off the round      a disc is a curved mirror: wherever it stands, one point sends head-on back; being curved it
                       spreads the sound, by (r + d)/r over a wall at the same distance d
    off the skin       bumpers, sonars and edges scatter, weakly and from all sides: a robot that only reaches into the
                       cone is heard from its nearest point in there that is loud enough
    off a wall, back off the round     by way of a slanted wall

The spreading is that of a bundle of rays in the plane, dB = 10 log10(1 + 2 a b / ((a + b) r cos(incidence))) with ways
a and b before and after; a = b = d, incidence 0 is the line above. Left out: ways off two robots, and on from one.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import asin, atan2, cos, hypot, inf, log10, pi, sin
from typing import Final

import numpy as np

from nserver_emu.simulation.angles import short_way
from nserver_emu.simulation.echo_ways import Beam, Losses, Point, Way, crossings, mirrored, told
from worlds.geometry import FloatArray

SCATTERERS: Final = 33
"""Points of a skin that scatter, evenly over what the cone sees of it: at most 0.8 degrees apart, a third of an inch of
range at 60 in, where a hundredth of the range is noise."""

HALVINGS: Final = 48
"""Of the arc between the points that face two transducers: what is left of it is far below SMALL_IN."""


def ways(out: Beam, back: Beam, discs: FloatArray, mirrors: FloatArray, lost: Losses, *, own: bool) -> Iterator[Way]:
    """All ways by one of these discs (k, 3) from a transducer to another, or to itself, but for what stands between.

    mirrors   (m, 4) walls that the first cone may meet
    """
    for disc in back.may_meet_discs(out.may_meet_discs(discs)).tolist():
        yield from _off_the_round(out, back, disc, lost)
        yield from _off_the_skin(out, back, disc, lost)
    if own and len(discs) and len(mirrors):
        yield from _there_and_back(out, mirrors, discs, lost)


def _off_the_round(out: Beam, back: Beam, disc: list[float], lost: Losses) -> Iterator[Way]:
    x, y, radius = disc
    normal = _facing_both(out.point, back.point, disc)
    if normal is None:
        return
    point = x + radius * cos(normal), y + radius * sin(normal)
    there, here = _apart(out.point, point), _apart(back.point, point)
    head_on = ((out.point[0] - point[0]) * cos(normal) + (out.point[1] - point[1]) * sin(normal)) / there
    spread_db = 10.0 * log10(1.0 + 2.0 * there * here / ((there + here) * radius * head_on))
    points = np.array([point])
    losses = out.loss_db(points) + back.loss_db(points) + lost.way_db_in * (there + here) / 2.0 + spread_db
    yield from told(np.array([there + here]), losses, out, back, points)


def _off_the_skin(out: Beam, back: Beam, disc: list[float], lost: Losses) -> Iterator[Way]:
    """Off the points that evenly spread rays of the first cone meet, from one end of what they see to the other."""
    x, y, radius = disc
    away = _apart(out.point, (x, y))
    if away <= radius or lost.skin_db == inf:
        return
    middle, half = short_way(atan2(y - out.point[1], x - out.point[0]) - out.direction_rad), asin(radius / away)
    right, left = max(middle - half, -out.half_rad), min(middle + half, out.half_rad)
    if right > left:
        return
    turned = np.linspace(right, left, SCATTERERS)
    to_side = away * np.sin(turned - middle)
    reach = away * np.cos(turned - middle) - np.sqrt(np.maximum(radius * radius - to_side * to_side, 0.0))
    directions = out.direction_rad + turned
    points = np.array(out.point) + reach[:, np.newaxis] * np.stack((np.cos(directions), np.sin(directions)), axis=1)
    lengths = reach + np.hypot(points[:, 0] - back.point[0], points[:, 1] - back.point[1])
    losses = out.loss_db(points) + back.loss_db(points) + lost.skin_db + lost.way_db_in * lengths / 2.0
    yield from told(lengths, losses, out, back, points)


def _there_and_back(out: Beam, mirrors: FloatArray, discs: FloatArray, lost: Losses) -> Iterator[Way]:
    """Off a slanted wall, head-on against a disc, and back the same way."""
    one = mirrors[:, np.newaxis]
    images = mirrored(np.array(out.point), one)
    to_middle = discs[:, :2] - images
    away = np.hypot(to_middle[..., 0], to_middle[..., 1])
    outside = away > discs[:, 2]
    share = np.where(outside, 1.0 - discs[:, 2] / np.where(outside, away, 1.0), 0.0)
    feet = images + share[..., np.newaxis] * to_middle
    points, met = crossings(images, feet, one)
    gaps = share * away
    losses = 2.0 * out.loss_db(points) + 2.0 * lost.bounce_db + lost.way_db_in * gaps
    losses = np.where(met & outside, losses + 10.0 * np.log10(1.0 + gaps / discs[:, 2]), inf)
    yield from told(2.0 * gaps, losses, out, None, points, feet)


def _facing_both(start: Point, end: Point, disc: list[float]) -> float | None:
    """The direction from the middle of a disc to where it mirrors one point to another; None from inside.

    It lies between the directions to both; there the angles of incidence and of reflection change places in size, so
    the arc is halved until they are one.
    """
    x, y, radius = disc
    if min(_apart(start, (x, y)), _apart(end, (x, y))) <= radius:
        return None
    first, last = (atan2(point[1] - y, point[0] - x) for point in (start, end))
    way = short_way(last - first)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS if way else 0):
        normal = first + way * 0.5 * (low + high)
        point = x + radius * cos(normal), y + radius * sin(normal)
        incidence, reflection = (abs(_off(normal, point, other)) for other in (start, end))
        low, high = (0.5 * (low + high), high) if incidence < reflection else (low, 0.5 * (low + high))
    normal = first + way * low
    point = x + radius * cos(normal), y + radius * sin(normal)
    return normal if abs(_off(normal, point, start)) < 0.5 * pi else None


def _off(normal_rad: float, point: Point, other: Point) -> float:
    """The angle at a point between its normal and the way to another."""
    return short_way(atan2(other[1] - point[1], other[0] - point[0]) - normal_rad)


def _apart(one: Point, other: Point) -> float:
    return hypot(one[0] - other[0], one[1] - other[1])
