"""The compass on the turret: ten readings a second, a deviation of its own, and the turn that takes it away.

A reading is the direction of the turret in the world, counter-clockwise as all angles here, 0 along the x axis
(decision of ours: worlds have no north). Time and directions are handed in; what is noise is in CompassNoise.

    mode 0 off: the last reading stays    1 on    2 calibrating: after a full turn of the turret it is done, mode 1

A full turn is one that the motor makes from where calibrating began, one way or the other; wiggling is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import radians, sin, tau
from typing import Final

import numpy as np

from nserver_emu.simulation.segments import PS_PER_S, once_round

INTERVAL_PS: Final = PS_PER_S // 10
"""Ten readings a second."""

_FULL_TURN_RAD: Final = tau - 1e-9
"""What a turn of 360 degrees is at least, its sums rounded."""


class CompassMode(IntEnum):
    """What conf_cp asks for."""

    OFF = 0
    ON = 1
    CALIBRATING = 2


@dataclass(frozen=True, slots=True)
class CompassNoise:
    """std_rad: noise of a reading; deviation_rad sin(direction + phase_rad): the robot's iron, until calibrated."""

    std_rad: float = 0.0
    deviation_rad: float = 0.0
    phase_rad: float = radians(40.0)


TRUE_NEEDLE: Final = CompassNoise()
"""Every reading as it is."""


def last_reading_ps(until_ps: int) -> int:
    """The instant of the last reading up to then."""
    return until_ps // INTERVAL_PS * INTERVAL_PS


class Compass:
    """See the head of this file. `direction_rad` [0, 2 pi) is the last reading, taken at `taken_ps`.

    Angles that are handed in are the turret's, unwrapped.
    """

    def __init__(self, noise: CompassNoise, direction_rad: float, now_ps: int, chance: np.random.Generator) -> None:
        self.noise = noise
        self.mode = CompassMode.ON
        self.calibrated = False
        self._chance = chance
        self._least_rad = self._most_rad = 0.0
        self.taken_ps = last_reading_ps(now_ps)
        self.due_ps = self.taken_ps + INTERVAL_PS
        """When the next reading is due."""
        self.direction_rad = once_round(direction_rad + self._error(direction_rad, 1))

    def configure(self, mode: int, angle_rad: float) -> None:
        """Switch it; raises ValueError for no mode. Calibrating starts its turn anew, at this angle of the turret."""
        self.mode = CompassMode(mode)
        self._least_rad = self._most_rad = angle_rad

    def carried(self, before_rad: float, after_rad: float) -> None:
        """Hands, not the motor, turned the turret from one angle to another: no part of a turn."""
        self._turn_to(before_rad)
        self._least_rad += after_rad - before_rad
        self._most_rad += after_rad - before_rad

    def take(self, instant_ps: int, direction_rad: float, angle_rad: float) -> None:
        """Read at `due_ps` or some whole readings later; those skipped before it only spend their chance.

        direction_rad   where the turret points
        angle_rad       its angle
        """
        skipped = (instant_ps - self.due_ps) // INTERVAL_PS
        self.due_ps = instant_ps + INTERVAL_PS
        error = self._error(direction_rad, skipped + 1)
        if self.mode is CompassMode.OFF:
            return
        self._turn_to(angle_rad)
        if self.mode is CompassMode.CALIBRATING and self._most_rad - self._least_rad >= _FULL_TURN_RAD:
            self.calibrated, self.mode = True, CompassMode.ON
        self.taken_ps = instant_ps
        self.direction_rad = once_round(direction_rad + error)

    def _turn_to(self, angle_rad: float) -> None:
        if angle_rad < self._least_rad:
            self._least_rad = angle_rad
        elif angle_rad > self._most_rad:
            self._most_rad = angle_rad

    def _error(self, direction_rad: float, count: int) -> float:
        """What a reading is off, the last of `count` draws: each reading has its own, looked at or not."""
        noise, error = self.noise, 0.0
        if noise.std_rad:
            error = noise.std_rad * float(self._chance.standard_normal(count)[-1])
        if noise.deviation_rad and not self.calibrated:
            error += noise.deviation_rad * sin(direction_rad + noise.phase_rad)
        return error
