"""Chance: a stream of it for each robot and purpose, and how the true motion strays from the commanded one.

No global generator: whoever draws is handed a stream. Odometry errors of other kinds (scale, drift, slip) belong here
too: each turns one stretch into another.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import sqrt
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.stretch import Stretch


class Purpose(IntEnum):
    """What a stream is for. Numbers are kept for ever: they are part of what a seed means."""

    MOTION = 0
    SONAR = 1


class Identity(NamedTuple):
    """Which robot of which run: the key of all its chance. Both numbers are 0 or more."""

    robot_id: int
    seed: int

    def stream(self, purpose: Purpose) -> np.random.Generator:
        """The stream of this robot for one purpose: independent of all others, always the same for the same key."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.robot_id, purpose)))


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """A random walk that grows with the way, from the table of settings in the project's ROBOTS sheet.

    A stretch of length |d| inches that turns the wheels by |a| radians goes d + e instead and turns the whole body by
    f, with var(e) = along^2 |d| and var(f) = turn^2 |a| + drift^2 |d|. Variances of pieces add up, so that the
    spread does not depend on how a way is cut.

    along   sqrt(inch)          a_t of the settings
    turn    sqrt(radian)        a_r
    drift   radian/sqrt(inch)   a_d
    """

    along: float = 0.0
    turn: float = 0.0
    drift: float = 0.0

    def disturbed(self, stretch: Stretch, chance: np.random.Generator) -> Stretch:
        """The stretch that is really driven: the same seconds, another length, and a turn that carries the body along.

        Its turn less that of the commanded stretch is the body's. Draws twice if anything moves and there
        is noise, else never; then the very same stretch comes back.
        """
        duration = stretch.duration_s
        way, angle = stretch.distance_at(duration), stretch.turn_at(duration)
        if self == NO_NOISE or (way == 0.0 and angle == 0.0):
            return stretch
        longer = self.along * sqrt(abs(way)) * chance.standard_normal()
        turned = sqrt(self.turn**2 * abs(angle) + self.drift**2 * abs(way)) * chance.standard_normal()
        scale = 1.0 + longer / way if way else 1.0
        return Stretch(
            duration,
            stretch.speed * scale,
            stretch.acceleration * scale,
            stretch.turn_rate + turned / duration,
            stretch.turn_acceleration,
        )


NO_NOISE: Final = MotionNoise()
"""Every motion as commanded."""
