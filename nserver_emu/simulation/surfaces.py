"""The surfaces of real walls: levels beside the plane that the map has, and posts that scatter sound.

Measured along a corridor, the residuals of a wall are not white: a door stands back by some centimetres over its whole
width, a pillar or a skirting stands out. So a wall's surface is a level that stays for an exponentially distributed
length and is then drawn anew, independent of the last one. Two points d apart are on the same level with probability
exp(-d / length), which is then also the correlation of their errors:

    level        normal, standard deviation `std_in`; towards the left side of the wall
    stretches    exponential, mean `length_in`
    posts        a Poisson process along the wall, mean distance `post_spacing_in`

A surface depends on the seed of the run and on the wall alone: it is the same for all robots, at all times.

References
----------
Papoulis, Probability, Random Variables, and Stochastic Processes (1991), section 10.1: the random telegraph signal, and
its exponential correlation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple
from zlib import crc32

import numpy as np

from worlds.geometry import FloatArray

SURFACE_STREAM: Final = 4
"""Key of the random streams of surfaces; those of robots begin with the number of the robot and have two numbers."""


class WallSurface(NamedTuple):
    """The surface of one wall.

    Attributes
    ----------
    breaks_in
        Distances from the wall's first end at which a level begins (k,), the first 0.
    levels_in
        Inches by which it stands out to the left of the wall (k,).
    posts_in
        Distances of the posts from the first end (p,).
    post_levels_in
        The levels at the posts (p,).
    """

    breaks_in: FloatArray
    levels_in: FloatArray
    posts_in: FloatArray
    post_levels_in: FloatArray

    def level_in(self, along_in: FloatArray) -> FloatArray:
        """Return the levels at distances from the first end, inches."""
        return _level_in(self.breaks_in, self.levels_in, along_in)


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of all walls of a run: of a wall when it is first needed.

    Attributes
    ----------
    seed
        Seed of the run.
    std_in, length_in, post_spacing_in
        See the module; a spacing of 0 means no posts.
    """

    seed: int
    std_in: float
    length_in: float
    post_spacing_in: float
    _found: dict[bytes, WallSurface] = field(default_factory=dict, compare=False, repr=False)

    def of(self, wall: FloatArray) -> WallSurface:
        """Return the surface of a wall x1 y1 x2 y2."""
        key = wall.tobytes()
        if key not in self._found:
            self._found[key] = self._draw(float(np.hypot(*(wall[2:] - wall[:2]))), crc32(key))
        return self._found[key]

    def of_all(self, walls: FloatArray) -> list[WallSurface]:
        """Return the surfaces of walls (m, 4), and forget those of others: obstacles come and go without end."""
        surfaces = {wall.tobytes(): self.of(wall) for wall in walls}
        self._found.clear()
        self._found.update(surfaces)
        return [surfaces[wall.tobytes()] for wall in walls]

    def _draw(self, length_in: float, wall: int) -> WallSurface:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(SURFACE_STREAM, wall, 0)))
        breaks_in = np.append(0.0, _poisson_points(length_in, self.length_in, rng))
        levels_in = self.std_in * rng.standard_normal(len(breaks_in))
        posts_in = _poisson_points(length_in, self.post_spacing_in, rng) if self.post_spacing_in else np.empty(0)
        return WallSurface(breaks_in, levels_in, posts_in, _level_in(breaks_in, levels_in, posts_in))


def _level_in(breaks_in: FloatArray, levels_in: FloatArray, along_in: FloatArray) -> FloatArray:
    levels: FloatArray = levels_in[np.searchsorted(breaks_in, along_in, side="right") - 1]
    return levels


def _poisson_points(length_in: float, spacing_in: float, rng: np.random.Generator) -> FloatArray:
    """Return points of a Poisson process on a line, in order: their number is Poisson, their places uniform."""
    return np.sort(length_in * rng.random(rng.poisson(length_in / spacing_in)))
