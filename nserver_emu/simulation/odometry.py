"""Odometry that errs the same way every time: what the wheels really do, against what the encoders count of them.

Systematic errors alone; the random ones (alpha1 to alpha4) are noise.py's. All of them move the actual robot, never the
encoders: those believe what the wheels were told, but for the slip, which only they see.

    first, second = what two axes were told        the axes of the drive: translation and steering; right and left wheel
    path of (scale_1 first, scale_2 second)        what they really do
    + drift_1 first + drift_2 second               turns the whole body besides
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from nserver_emu.simulation.drive import Drive
from nserver_emu.simulation.stretch import Stretch


@dataclass(frozen=True, slots=True)
class Odometry:
    """Systematic errors of a robot's wheels, by axis in the order of the commands.

    scales     true travel per counted travel: a wheel of 1 % more diameter has 1.01; the third is the turret's
    drifts     turn of the whole body per counted travel of the first two axes, rad/in or rad/rad: a synchro drive whose
               wheels are not parallel runs in circles, (rad/in, 0); a differential drive of track b whose wheels
               really roll a share E of b apart has (k, -k) with k = (1/E - 1)/b
    slip_in    way that the wheels roll on the spot at every contact, inches, before they stand

    UMBmark's wheel diameter ratio Ed is scales[0] / scales[1] of a Scout, its wheelbase ratio Eb is that E.
    """

    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    drifts: tuple[float, float] = (0.0, 0.0)
    slip_in: float = 0.0

    @property
    def turns_as_told(self) -> bool:
        """Whether no axis errs; there may be slip."""
        return self.scales == (1.0, 1.0, 1.0) and self.drifts == (0.0, 0.0)

    def driven(self, stretch: Stretch, drive: Drive) -> Stretch:
        """What becomes of a stretch that this drive was told; the very same if nothing errs."""
        if self.scales[:2] == (1.0, 1.0) and self.drifts == (0.0, 0.0):
            return stretch
        first, second = drive.wheels(stretch)
        path = drive.path(stretch.duration_s, first.times(self.scales[0]), second.times(self.scales[1]))
        (rate_1, acceleration_1), (rate_2, acceleration_2) = first, second
        drift_1, drift_2 = self.drifts
        return path._replace(
            turn_rate=path.turn_rate + drift_1 * rate_1 + drift_2 * rate_2,
            turn_acceleration=path.turn_acceleration + drift_1 * acceleration_1 + drift_2 * acceleration_2,
        )


EXACT: Final = Odometry()
"""Wheels that do what they were told, and stand where they touch."""
