"""Acoustics of the Polaroid sonars: the model of a ring, its settings, and the walls as reflectors.

The paths of sound are in echo_paths.py, the walls that they meet first in visibility.py.

The surfaces of real walls: levels beside the plane that the map has, and posts that scatter sound.

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

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import ceil, cos, inf, radians, sin, sqrt
from typing import Any, Final, NamedTuple
from zlib import crc32

import numpy as np

from nserver_emu.simulation import echo_paths, visibility
from nserver_emu.simulation.echo_paths import Attenuation
from nserver_emu.simulation.segments import PS_PER_S
from nserver_emu.simulation.settings import SONAR_NUMBERS, setting
from nserver_emu.simulation.visibility import BLOCK, Reflectors
from worlds import raycast
from worlds.compiled import CompiledFunction
from worlds.geometry import NO_DISCS, FloatArray
from worlds.rings import MAX_SONARS
from worlds.robots import SONARS, Body

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
    return levels_in[np.searchsorted(breaks_in, along_in, side="right") - 1]


def _poisson_points(length_in: float, spacing_in: float, rng: np.random.Generator) -> FloatArray:
    """Return points of a Poisson process on a line, in order: their number is Poisson, their places uniform."""
    return np.sort(length_in * rng.random(rng.poisson(length_in / spacing_in)))


NOISE_SIGMAS: Final = 6.0
"""Standard deviations of noise that are allowed for where distant walls are left out: one draw in 1e9 goes beyond."""

MIN_FACTOR: Final = 1e-3
"""Smallest factor of a range by noise that is allowed for then."""


BOX_MARGIN_IN: Final = 1e-3
"""Boxes are so much larger than their walls: beyond all tolerances of reflections."""


class ReflectorMap:
    """The walls as reflectors: (m, 4), rows x1 y1 x2 y2 in inches, and their surfaces; None: as the map has them."""

    def __init__(self, walls: FloatArray, surfaces: Surfaces | None = None) -> None:
        self.walls = walls
        self.surfaces = surfaces

    @cached_property
    def arrays(self) -> Reflectors:
        """The walls and their surfaces in arrays, for compiled code."""
        # A copy: compiled code is made for arrays that can be written.
        walls = _in_blocks(self.walls)
        columns, none = np.array(walls.T, order="C"), np.empty(0)
        boxes = _boxes(columns)
        if self.surfaces is None:
            return Reflectors(columns, boxes, np.empty(0, dtype=np.int64), none, none, np.empty((4, 0)))
        # Surfaces are found by the bits of a wall: the second end by its vector from the first.
        first, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
        surfaces = self.surfaces.of_all(np.hstack([first, first + along]))
        begins = np.cumsum([0, *(len(surface.breaks_in) for surface in surfaces)])
        breaks = np.concatenate([none, *(surface.breaks_in for surface in surfaces)])
        levels = np.concatenate([none, *(surface.levels_in for surface in surfaces)])
        # Posts stand on their level, which is to the left of the wall.
        wall = np.repeat(np.arange(len(walls)), [len(surface.posts_in) for surface in surfaces])
        places = np.concatenate([none, *(surface.posts_in for surface in surfaces)])
        shifts = np.concatenate([none, *(surface.post_levels_in for surface in surfaces)])
        unit = along / np.maximum(np.hypot(*along.T), np.finfo(float).tiny)[:, None]
        x, y, unit_x, unit_y = first[wall, 0], first[wall, 1], unit[wall, 0], unit[wall, 1]
        posts = np.stack([x + unit_x * places, y + unit_y * places, -unit_y * shifts, unit_x * shifts])
        return Reflectors(columns, boxes, begins, breaks, levels, posts)

    @cached_property
    def lists(self) -> Reflectors:
        """The same in lists, for plain Python."""
        return Reflectors(*(array.tolist() for array in self.arrays))


def _in_blocks(walls: FloatArray) -> FloatArray:
    """Return walls (m, 4) in an order in which BLOCK that follow one another are near one another.

    References
    ----------
    Leutenegger, Lopez and Edgington, STR: a simple and efficient algorithm for R-tree packing, ICDE (1997): strips of
    neighbours along x, as many as each has blocks, each sorted by y.
    """
    if len(walls) <= BLOCK:
        return walls
    x, y = walls[:, 0] + walls[:, 2], walls[:, 1] + walls[:, 3]
    strip = BLOCK * ceil(sqrt(len(walls) / BLOCK))
    rank = np.empty(len(walls), dtype=np.intp)
    rank[np.argsort(x, kind="stable")] = np.arange(len(walls))
    return walls[np.lexsort((y, rank // strip))]


def _boxes(columns: FloatArray) -> FloatArray:
    """Return centre and half size (4, b) of the box around each block of walls, columns x1 y1 x2 y2 (4, m)."""
    if not columns.size:
        return np.empty((4, 0))
    begins = np.arange(0, columns.shape[1], BLOCK)
    low = np.minimum.reduceat(np.minimum(columns[:2], columns[2:]), begins, axis=1)
    high = np.maximum.reduceat(np.maximum(columns[:2], columns[2:]), begins, axis=1)
    return np.vstack(((low + high) / 2.0, (high - low) / 2.0 + BOX_MARGIN_IN))


def _example() -> tuple[Any, ...]:
    walls = ReflectorMap(np.array([[1.0, -1.0, 1.0, 1.0]])).arrays
    losses = Attenuation(*(1.0 for _ in Attenuation._fields))
    return np.zeros((1, 4)), 1.0, 0.0, 0.0, losses, walls, np.zeros((3, 0)), 1.0


FIRST_ECHO: Final = CompiledFunction(echo_paths.first_echo, lambda: (echo_paths, visibility, raycast), _example)
"""The first echo of a ping, plain or compiled."""


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


relative_std: Any = partial(setting, low=0, high=1, unit="", meaning="standard deviation of a range relative to it",
                            former="std_share")
"""The setting `range_std_relative` of every sensor that measures ranges."""

_std_floor: Any = partial(setting, low=0, high=10, unit="in", meaning="lower bound of that", former="least_std_in")
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
        The surfaces of walls (`Surfaces`), and the loss at a post. A standard deviation and a spacing of 0: planes.
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

    def measured_range(self, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body,
                       others: FloatArray = NO_DISCS, max_range_in: float = inf) -> float:
        """Return the measured range of a ping, inches from the ring; inf for no echo.

        Parameters
        ----------
        earlier
            The pings of the same ring in the last `audible_ps`.
        others
            The other robots (k, 3), rows x y radius in inches.
        max_range_in
            An echo from farther away may count as none.
        """
        range_in = self.first_echo_in(ping, earlier, reflectors, body, others, max_range_in)
        return range_in if range_in == inf else range_in + ping.noise[0] * self.std_in(range_in)

    def first_echo_in(self, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body,
                      others: FloatArray = NO_DISCS, max_range_in: float = inf) -> float:
        """Return the range of the first echo above the threshold, without noise; inf for none."""
        margin_db = self.margin_db + self.margin_std_db * ping.noise[1]
        # 1. The transducer, and those of earlier pings that are not too weak by now.
        face_in = body.sonar_ring_radius_in - self.recess_in
        sources = [_source(ping, face_in, 0.0)]
        for other in earlier:
            head_start_in = self.sound_in_s * ((ping.instant_ps - other.instant_ps) / PS_PER_S)
            if self.absorption_db_in * (self.blanking_in + head_start_in / 2.0) <= margin_db:
                sources.append(_source(other, face_in, head_start_in))
        # 2. Lists in plain Python, arrays in compiled code.
        losses = Attenuation(self.cone_rad / 2.0, self.cone_loss_db / 2.0, float(self.absorption_db_in),
                             float(self.bounce_loss_db), float(self.edge_loss_db), float(self.skin_loss_db),
                             float(self.post_loss_db))
        settings = float(margin_db), float(self.blanking_in), float(self.recess_in), losses
        FIRST_ECHO.count_calls()
        if FIRST_ECHO.is_compiled:
            discs = np.array(others.T, order="C")
            found = FIRST_ECHO.run(np.array(sources), *settings, reflectors.arrays, discs, float(max_range_in))
        else:
            found = FIRST_ECHO.run(sources, *settings, reflectors.lists, others.T.tolist(), max_range_in)
        return float(found)


def _source(ping: Ping, face_in: float, head_start_in: float) -> tuple[float, float, float, float]:
    """Return position and direction of a transducer, and how far its ping has travelled."""
    direction = ping.direction_rad
    return ping.x_in + face_in * cos(direction), ping.y_in + face_in * sin(direction), direction, head_start_in
