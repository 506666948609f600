"""Who stands where when a sensor looks: an eye, and the sighting it has of all robots. Geometry alone, no sensor.

A sighting is one for all who look at that instant; where the robots stood may become known later than that it is asked
for, but before anybody looks.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Final, NamedTuple, Protocol

import numpy as np

from nserver_emu.simulation.acoustics import NO_ROBOTS
from worlds.geometry import FloatArray
from worlds.raycast import FAR_IN

FARTHEST_IN: Final = 500.0
"""No sensor notices a robot from farther away: readings end at 255 in, second echoes at some 400."""

GRAZING_IN: Final = 1e-6
"""So much farther from a line than its rim a robot still counts as met, until its range is worked out: rounding."""

NOBODY_NEAR: Final[FloatArray] = np.zeros((0, 4))
"""No rows x y radius row."""


class Sighting:
    """Where all robots stood at one moment: discs (n, 3), rows x y radius in inches; none until that is known."""

    def __init__(self, discs: FloatArray = NO_ROBOTS) -> None:
        self.discs = discs

    def at(self, instant_ps: int) -> Sighting:
        """Whatever the instant: nobody moves."""
        del instant_ps
        return self

    def near(self, x_in: float) -> FloatArray:
        """The robots (k, 4) whose x is no farther than FARTHEST_IN from this one: rows x y radius row, sorted by x."""
        return self._between(x_in - FARTHEST_IN, x_in + FARTHEST_IN)

    def ahead(self, x_in: float, way_x_in: float) -> FloatArray:
        """Those of `near` that a ray from this x can meet before it has gone so far along x, and perhaps some more."""
        if len(self.discs) < 2:
            return NOBODY_NEAR
        beside = self.widest_in
        low, high = x_in + min(way_x_in, 0.0) - beside, x_in + max(way_x_in, 0.0) + beside
        return self._between(max(low, x_in - FARTHEST_IN), min(high, x_in + FARTHEST_IN))

    def _between(self, low_in: float, high_in: float) -> FloatArray:
        if len(self.discs) < 2:
            return NOBODY_NEAR
        xs = self._xs
        return self.sorted[bisect_left(xs, low_in) : bisect_right(xs, high_in)]

    @cached_property
    def widest_in(self) -> float:
        """No less than any robot's radius, and a little more."""
        return float(self.discs[:, 2].max()) + GRAZING_IN

    @cached_property
    def sorted(self) -> FloatArray:
        """The robots (n, 4), rows x y radius row, sorted by x."""
        order = self.discs[:, 0].argsort(kind="stable")
        return np.column_stack((self.discs[order], order))

    @cached_property
    def _xs(self) -> list[float]:
        xs: list[float] = self.sorted[:, 0].tolist()
        return xs


class Lookout(Protocol):
    """Who tells where the robots stood at an instant."""

    def at(self, instant_ps: int) -> Sighting: ...


NOBODY: Final = Sighting()
"""What a robot sees that is alone."""


class Eye(NamedTuple):
    """From where the ring looks, and whom it may see.

    x_in, y_in, turret_rad    the robot's true place in inches and its turret's true direction in radians
    seen, own                 all robots; row `own` is this one
    """

    x_in: float
    y_in: float
    turret_rad: float
    seen: Sighting = NOBODY
    own: int = 0

    @property
    def others(self) -> FloatArray:
        """The robots (k, 3) without this one and without those beyond FARTHEST_IN."""
        near = self.seen.near(self.x_in)
        rows = np.sort(near[:, 3]).astype(np.intp)
        discs = self.seen.discs.take(rows[rows != self.own], axis=0)
        others: FloatArray = discs[np.abs(discs[:, 1] - self.y_in) <= FARTHEST_IN]
        return others


def on_lines(
    eyes: Sequence[Eye], ways: Sequence[complex], ranges: Sequence[float]
) -> Iterator[tuple[int, list[float]]]:
    """The other robots that rays can meet, and perhaps some they graze: number of the ray, and x y radius in inches.

    eyes, ways    from where each ray goes, and its direction, a unit vector dx + i dy
    ranges        how far each goes until it meets a wall, inches

    All rays at once: a centre is the complex number x + iy; times the conjugate of the direction it is ahead + i side.
    """
    if all(len(eye.seen.discs) < 2 for eye in eyes):
        return
    to_wall = [min(far, FAR_IN) for far in ranges]
    near = [eye.seen.ahead(eye.x_in, far * way.real) for eye, way, far in zip(eyes, ways, to_wall, strict=True)]
    counts = [len(robots) for robots in near]
    robots = np.concatenate(near)
    origins = np.array([complex(eye.x_in, eye.y_in) for eye in eyes])
    turned = robots.view(np.complex128)[:, 0] - origins.repeat(counts)
    turned *= np.array(ways).conj().repeat(counts)
    reach = robots[:, 2] + GRAZING_IN
    met = (np.abs(turned.imag) <= reach).nonzero()[0]
    rays = np.searchsorted(np.cumsum(counts), met, side="right")
    ahead = turned.real.take(met).tolist()
    for ray, far, (x, y, radius, row) in zip(rays.tolist(), ahead, robots.take(met, axis=0).tolist(), strict=True):
        beside = radius + GRAZING_IN
        if row != eyes[ray].own and -beside <= far <= to_wall[ray] + beside:
            yield ray, [x, y, radius]
