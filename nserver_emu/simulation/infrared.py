"""The infrared ring of the N200: nearness in sixteen steps. Rays are the world's; poses and time are handed in.

    reading = whole inches from the body, 0..15; 15 is nothing, and nothing is farther than 24 in in any case
    history h = 0..9: a reading is h tenths the one before it and the rest the new one; more counts as 9

The whole ring flashes at once, every 60 ms (decisions of ours, as is the history's arithmetic: no source gives them).
As with the sonars a flash notes where it happened; rays are cast when somebody looks, and looking changes no reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, inf
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.segments import NEVER_PS, PS_PER_S, Stamp
from nserver_emu.simulation.sonar import UNFIRED
from nserver_emu.simulation.visibility import Eye
from worlds.geometry import FloatArray, normals
from worlds.raycast import cast_discs, cast_rays
from worlds.robots import Body

INFRAREDS: Final = 16
NOTHING: Final = 15
"""What a sensor reads that sees nothing."""
REACH_IN: Final = 24.0
"""Nothing is seen beyond, whatever the calibration makes of it."""
TENTHS: Final = 10
MOST_HISTORY: Final = 9
"""With ten tenths of what was before, nothing new would ever be seen."""
INTERVAL_PS: Final = 60 * PS_PER_S // 1000
MOST_UNSEEN: Final = 64
"""Flashes that are kept while nobody looks, where the history needs them all."""


@dataclass(frozen=True, slots=True)
class InfraredNoise:
    """How light comes back: gaussian noise of std_share of the range; slanted: what is seen at a slant looks
    farther.

    A dull wall, or robot, sends back cos(incidence) / range^2, from which the sensor takes the range: it comes out as
    range / sqrt(cos(incidence)).
    """

    std_share: float = 0.0
    slanted: bool = False


CLEAR_SIGHT: Final = InfraredNoise()
"""Every range as it is."""


class Flash(NamedTuple):
    """A flash nobody has looked at: the robot's axis and turret, and a standard normal number a sensor."""

    eye: Eye
    chances: FloatArray | None


class InfraredRing:
    """Sixteen sensors that look outwards where the sonars do; see the head of this file."""

    def __init__(
        self, body: Body, noise: InfraredNoise, walls: FloatArray, now_ps: int, chance: np.random.Generator
    ) -> None:
        self.body = body
        self.noise = noise
        self._walls = walls
        self._chance = chance
        self._levels = [float(NOTHING)] * INFRAREDS
        self._stamps = [UNFIRED] * INFRAREDS
        self._unseen: list[Flash] = []
        self._history = 0
        self._order: tuple[int, ...] = tuple(range(INFRAREDS))
        self.due_ps = now_ps
        """When the ring flashes next; NEVER_PS if it is off."""

    @property
    def readings(self) -> tuple[int, ...]:
        """The last reading of each sensor, 16 numbers 0..15."""
        self._look()
        return tuple(floor(level + 0.5) for level in self._levels)

    @property
    def stamps(self) -> tuple[Stamp, ...]:
        """The moment of each of those readings."""
        return tuple(self._stamps)

    def configure(self, history: int, order: Sequence[int], now_ps: int) -> None:
        """Take a new history (clamped to 0..9) and new sensors, those before the first number that is none.

        The others keep their readings; no sensor at all: the ring is off. It flashes now, and every 60 ms.
        """
        self._look()
        end = next((at for at, number in enumerate(order) if not 0 <= number < INFRAREDS), len(order))
        self._order = tuple(order[:end])
        self._history = min(max(history, 0), MOST_HISTORY)
        self.due_ps = now_ps if self._order else NEVER_PS

    def flash_due(self, eye: Eye, stamp: Stamp) -> None:
        """The ring flashes here and now."""
        self.due_ps += INTERVAL_PS
        if not self._history:
            self._unseen.clear()
        elif len(self._unseen) >= MOST_UNSEEN:
            self._look()
        self._unseen.append(Flash(eye, self._chance.standard_normal(INFRAREDS) if self.noise.std_share else None))
        for number in self._order:
            self._stamps[number] = stamp

    def surround(self, walls: FloatArray) -> None:
        """From now on these are the walls (m, 4); what flashed before still met the old ones."""
        self._look()
        self._walls = walls

    def see_as(self, noise: InfraredNoise) -> None:
        """From now on light comes back like this; what flashed before came back as before."""
        self._look()
        self.noise = noise

    def _look(self) -> None:
        kept = self._history / TENTHS
        for flash in self._unseen:
            ranges = self._ranges(flash)
            for number in self._order:
                seen = min(float(ranges[number]), NOTHING) if ranges[number] <= REACH_IN else float(NOTHING)
                seen = float(floor(max(seen, 0.0) + 0.5))
                self._levels[number] = kept * self._levels[number] + (1.0 - kept) * seen
        self._unseen.clear()

    def _ranges(self, flash: Flash) -> FloatArray:
        """What the sensors make of a flash: ranges (16,) from the body, inches, inf where nothing is met."""
        directions = flash.eye.turret_rad + np.array(self.body.sonar_angles_rad)
        ways = np.stack((np.cos(directions), np.sin(directions)), axis=1)
        here, others = (flash.eye.x_in, flash.eye.y_in), flash.eye.others
        from_axis, rows = cast_rays(here, ways, self._walls)
        to_robots = cast_discs(here, ways, others)
        robots = to_robots < from_axis
        ranges: FloatArray = np.minimum(from_axis, to_robots) - self.body.radius_in
        met = ranges < inf
        if self.noise.slanted and met.any():
            facing = np.zeros_like(ways)
            of_walls = met & ~robots
            facing[of_walls] = normals(self._walls[rows[of_walls]])
            if robots.any():
                facing[robots] = _disc_normals(np.array(here) + to_robots[robots, np.newaxis] * ways[robots], others)
            head_on = np.abs((facing[met] * ways[met]).sum(axis=1))
            ranges[met] /= np.sqrt(np.maximum(head_on, 1e-6))
        if flash.chances is not None:
            ranges[met] *= 1.0 + self.noise.std_share * flash.chances[met]
        return ranges


def _disc_normals(points: FloatArray, discs: FloatArray) -> FloatArray:
    """Unit normals (k, 2) at points (k, 2), each on the rim of one of the discs (n, 3), which do not overlap."""
    offsets = points[:, np.newaxis] - discs[:, :2]
    off_rim = np.abs(np.hypot(offsets[..., 0], offsets[..., 1]) - discs[:, 2])
    nearest = off_rim.argmin(axis=1)
    normal: FloatArray = offsets[np.arange(len(points)), nearest] / discs[nearest, 2:]
    return normal
