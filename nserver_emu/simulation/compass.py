"""The compass on the turret: ten readings a second, a magnetic deviation, and the calibration turn that removes it.

A reading is the direction of the turret in the world, counter-clockwise, 0 along the x axis (an assumption: worlds have
no north). Time and directions are passed in.

    mode 0 off: the last reading remains    1 on    2 calibrating: done after a full turn of the turret, then mode 1

A full turn is one by the motor from the angle where calibration began, in either direction; turning to and fro is none.
"""

from dataclasses import dataclass
from enum import IntEnum
from math import radians, sin, tau
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.segments import PS_PER_S, wrap_to_2pi
from nserver_emu.simulation.settings import setting

INTERVAL_PS: Final = PS_PER_S // 10
"""Ten readings a second."""

_FULL_TURN_RAD: Final = tau - 1e-9
"""A turn of 360 degrees whose sums are rounded."""


class CompassMode(IntEnum):
    """The modes of conf_cp."""

    OFF = 0
    ON = 1
    CALIBRATING = 2


@dataclass(frozen=True, slots=True)
class CompassNoise:
    """Errors of the compass.

    Attributes
    ----------
    std_rad
        Standard deviation of a reading.
    deviation_rad, phase_rad
        The robot's iron adds deviation_rad sin(direction + phase_rad) until the compass is calibrated.
    """

    std_rad: float = setting(0.0, 0, 90, "deg", "standard deviation of a reading")
    deviation_rad: float = setting(
        0.0, 0, 90, "deg", "deviation by the robot's iron, until calibrated: d sin(heading + phase)"
    )
    phase_rad: float = setting(radians(40.0), -360, 360, "deg", "the phase in that")


NO_COMPASS_NOISE: Final = CompassNoise()
"""Exact readings."""


def last_reading_ps(until_ps: int) -> int:
    """Return the instant of the last reading up to an instant."""
    return until_ps // INTERVAL_PS * INTERVAL_PS


class CompassState(NamedTuple):
    """The state of a compass in a snapshot; fields as those of `Compass`."""

    mode: CompassMode
    calibrated: bool
    direction_rad: float
    read_ps: int
    swept_rad: tuple[float, float]


class Compass:
    """The compass; angles that are passed in are the turret's, unwrapped.

    Attributes
    ----------
    direction_rad
        The last reading, [0, 2 pi).
    read_ps, due_ps
        The instants of the last and of the next reading.
    """

    def __init__(self, noise: CompassNoise, direction_rad: float, now_ps: int, rng: np.random.Generator) -> None:
        self.noise = noise
        self.mode = CompassMode.ON
        self.calibrated = False
        self._rng = rng
        self._min_rad = self._max_rad = 0.0
        self.read_ps = last_reading_ps(now_ps)
        self.due_ps = self.read_ps + INTERVAL_PS
        self.direction_rad = wrap_to_2pi(direction_rad + self._error(direction_rad, 1))

    def to_state(self) -> CompassState:
        """Return all that changes."""
        swept_rad = self._min_rad, self._max_rad
        return CompassState(self.mode, self.calibrated, self.direction_rad, self.read_ps, swept_rad)

    def set_state(self, state: CompassState, now_ps: int) -> None:
        """Continue from a state; raise ValueError if its last reading lies in the future."""
        # The next reading follows from the time, so its number of draws is bounded.
        if not 0 <= state.read_ps <= now_ps:
            raise ValueError("a compass reading of another time")
        self.mode, self.calibrated = state.mode, state.calibrated
        self.direction_rad, self.read_ps = state.direction_rad, state.read_ps
        self._min_rad, self._max_rad = state.swept_rad
        self.due_ps = last_reading_ps(now_ps) + INTERVAL_PS

    def configure(self, mode: int, angle_rad: float) -> None:
        """Set the mode; raise ValueError for an unknown one. Calibration restarts its turn at this turret angle."""
        self.mode = CompassMode(mode)
        self._min_rad = self._max_rad = angle_rad

    def on_turret_moved(self, before_rad: float, after_rad: float) -> None:
        """Exclude a change of the turret's angle that is not by the motor from the calibration turn."""
        self._extend_turn(before_rad)
        self._min_rad += after_rad - before_rad
        self._max_rad += after_rad - before_rad

    def read(self, instant_ps: int, direction_rad: float, angle_rad: float) -> None:
        """Read at `due_ps` or some whole intervals later; readings skipped before it only draw their noise.

        Parameters
        ----------
        direction_rad
            True direction of the turret.
        angle_rad
            Its mechanical angle.
        """
        # 1. Every interval draws noise, so that the size of the steps changes no reading.
        skipped = (instant_ps - self.due_ps) // INTERVAL_PS
        self.due_ps = instant_ps + INTERVAL_PS
        error = self._error(direction_rad, skipped + 1)
        # 2. A switched-off compass keeps its reading.
        if self.mode is CompassMode.OFF:
            return
        # 3. Calibration ends after a full turn.
        self._extend_turn(angle_rad)
        if self.mode is CompassMode.CALIBRATING and self._max_rad - self._min_rad >= _FULL_TURN_RAD:
            self.calibrated, self.mode = True, CompassMode.ON
        # 4. The reading.
        self.read_ps = instant_ps
        self.direction_rad = wrap_to_2pi(direction_rad + error)

    def _extend_turn(self, angle_rad: float) -> None:
        if angle_rad < self._min_rad:
            self._min_rad = angle_rad
        elif angle_rad > self._max_rad:
            self._max_rad = angle_rad

    def _error(self, direction_rad: float, count: int) -> float:
        """Return the error of a reading, with the last of `count` draws: each reading has its own, used or not."""
        noise, error = self.noise, 0.0
        # Draw only with noise: an exact compass leaves its stream untouched.
        if noise.std_rad:
            error = noise.std_rad * float(self._rng.standard_normal(count)[-1])
        if noise.deviation_rad and not self.calibrated:
            error += noise.deviation_rad * sin(direction_rad + noise.phase_rad)
        return error
