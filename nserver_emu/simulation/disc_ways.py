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

from cmath import phase, rect
from collections.abc import Iterator
from math import asin, inf, log10
from typing import Final

import numpy as np

from nserver_emu.simulation.angles import short_way
from nserver_emu.simulation.echo_ways import Beam, ComplexArray, Losses, Way, crossings, mirrored, told
from worlds.geometry import FloatArray

SCATTERERS: Final = 33
"""Points of a skin that scatter, evenly over what the cone sees of it: at most 0.8 degrees apart, a third of an inch of
range at 60 in, where a hundredth of the range is noise."""

HALVINGS: Final = 48
"""Of the arc between the points that face two transducers: what is left of it is far below SMALL_IN."""


def ways(out: Beam, back: Beam, discs: FloatArray, mirrors: ComplexArray, lost: Losses, *, own: bool) -> Iterator[Way]:
    """All ways by one of these discs (k, 3) from a transducer to another, or to itself, but for what stands between.

    mirrors   (m, 3) walls that the first cone may meet
    """
    for x, y, radius in back.may_meet_discs(out.may_meet_discs(discs)).tolist():
        yield from _off_the_round(out, back, complex(x, y), radius, lost)
        yield from _off_the_skin(out, back, complex(x, y), radius, lost)
    if own and len(discs) and len(mirrors):
        yield from _there_and_back(out, mirrors, discs, lost)


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


def _there_and_back(out: Beam, mirrors: ComplexArray, discs: FloatArray, lost: Losses) -> Iterator[Way]:
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
