"""Chance: a stream of it for each robot and purpose, and how the true motion strays from the commanded one.

No global generator: whoever draws is handed a stream. Errors that are the same every time are odometry.py's.
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
    INFRARED = 2
    COMPASS = 3


class Identity(NamedTuple):
    """Which robot of which run: the key of all its chance. Both numbers are 0 or more."""

    robot_id: int
    seed: int

    def stream(self, purpose: Purpose) -> np.random.Generator:
        """The stream of this robot for one purpose: independent of all others, always the same for the same key."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.robot_id, purpose)))


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """A random walk that grows with the way, in the names of Probabilistic Robotics' odometry model (section 5.4).

    A stretch of length |d| inches that turns by |a| radians goes d + e instead and turns the whole body by f, with

        var(f) = alpha1 |a| + alpha2 |d|      alpha1  rad        turn, from turning
                                              alpha2  rad^2/in   turn, from driving
        var(e) = alpha3 |d| + alpha4 |a|      alpha3  in         way, from driving
                                              alpha4  in^2/rad   way, from turning

    The book's variances grow with the squares d^2 and a^2, so that the spread of a way depends on how it is cut; here
    variances of pieces add up. Of a localizer that updates every D inches and A radians, the numbers for one update
    are alpha1 / A, alpha3 / D, and alpha2 / D, alpha4 / A.
    """

    alpha1: float = 0.0
    alpha2: float = 0.0
    alpha3: float = 0.0
    alpha4: float = 0.0

    @classmethod
    def walk(cls, along: float = 0.0, turn: float = 0.0, drift: float = 0.0) -> MotionNoise:
        """By the roots that the experiments' table of settings gives.

        along   sqrt(inch)          alpha3 = along^2
        turn    sqrt(radian)        alpha1 = turn^2
        drift   radian/sqrt(inch)   alpha2 = drift^2
        """
        return cls(alpha1=turn**2, alpha2=drift**2, alpha3=along**2)

    def way_std_in(self, way_in: float, angle_rad: float) -> float:
        """Standard deviation of the length of a way on which the robot turns by an angle, inches."""
        return sqrt(self.alpha3 * abs(way_in) + self.alpha4 * abs(angle_rad))

    def turn_std_rad(self, way_in: float, angle_rad: float) -> float:
        """Standard deviation of the turn of the body on the same way."""
        return sqrt(self.alpha1 * abs(angle_rad) + self.alpha2 * abs(way_in))

    def disturbed(self, stretch: Stretch, chance: np.random.Generator) -> Stretch:
        """The stretch that is really driven: the same seconds, another length, and a turn that carries the body along.

        Its turn less that of the commanded stretch is the body's. Draws twice if anything moves and there
        is noise, else never; then the very same stretch comes back.
        """
        duration = stretch.duration_s
        way, angle = stretch.distance_at(duration), stretch.turn_at(duration)
        if self == NO_NOISE or (way == 0.0 and angle == 0.0):
            return stretch
        longer = self.way_std_in(way, angle) * chance.standard_normal()
        turned = self.turn_std_rad(way, angle) * chance.standard_normal()
        scale = 1.0 + longer / way if way else 1.0
        return Stretch(
            duration,
            stretch.speed * scale if way else longer / duration,
            stretch.acceleration * scale,
            stretch.turn_rate + turned / duration,
            stretch.turn_acceleration,
        )


NO_NOISE: Final = MotionNoise()
"""Every motion as commanded."""
