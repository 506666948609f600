"""The compass on the turret: ten readings a second, a deviation of its own, and the turn that takes it away.

A reading is the direction of the turret in the world, counter-clockwise as all angles here, 0 along the x axis
(decision of ours: worlds have no north). Time and directions are handed in; what is noise is in CompassNoise.

    mode 0 off: the last reading stays    1 on    2 calibrating: after a full turn of the turret it is done, mode 1
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import radians, sin, tau
from typing import Final

import numpy as np

from nserver_emu.simulation.angles import once_round
from nserver_emu.simulation.instants import PS_PER_S

INTERVAL_PS: Final = PS_PER_S // 10
"""Ten readings a second."""


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


class Compass:
    """See the head of this file. `direction_rad` [0, 2 pi) is the last reading, taken at `taken_ps`."""

    def __init__(self, noise: CompassNoise, direction_rad: float, now_ps: int, chance: np.random.Generator) -> None:
        self.noise = noise
        self.mode = CompassMode.ON
        self.calibrated = False
        self._chance = chance
        self._turned_rad = 0.0
        self._angle_rad = 0.0
        self._count = now_ps // INTERVAL_PS
        self.taken_ps = self._count * INTERVAL_PS
        self.direction_rad = once_round(direction_rad + self._error(direction_rad, 1))

    def configure(self, mode: int) -> None:
        """Switch it; raises ValueError for no mode. Calibrating starts its turn anew."""
        self.mode = CompassMode(mode)
        self._turned_rad = 0.0

    def due(self, until_ps: int) -> int | None:
        """The instant of the last reading up to then, if it is yet to be taken."""
        if until_ps < self.taken_ps + INTERVAL_PS:
            return None
        return until_ps // INTERVAL_PS * INTERVAL_PS

    def take(self, instant_ps: int, direction_rad: float, angle_rad: float) -> None:
        """Read at a due instant; the readings skipped before it only spend their chance.

        direction_rad   where the turret points
        angle_rad       how far it has turned, unwrapped
        """
        count, self._count = instant_ps // INTERVAL_PS - self._count, instant_ps // INTERVAL_PS
        self.taken_ps = instant_ps
        error = self._error(direction_rad, count)
        if self.mode is CompassMode.OFF:
            return
        if self.mode is CompassMode.CALIBRATING:
            self._turned_rad += abs(angle_rad - self._angle_rad)
            if self._turned_rad >= tau:
                self.calibrated, self.mode = True, CompassMode.ON
        self._angle_rad = angle_rad
        self.direction_rad = once_round(direction_rad + error)

    def _error(self, direction_rad: float, count: int) -> float:
        """What a reading is off, the last of `count` draws: each reading has its own, looked at or not."""
        drawn = self.noise.std_rad * float(self._chance.standard_normal(count)[-1]) if self.noise.std_rad else 0.0
        iron = 0.0 if self.calibrated else self.noise.deviation_rad * sin(direction_rad + self.noise.phase_rad)
        return drawn + iron
