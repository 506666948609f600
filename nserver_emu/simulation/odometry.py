"""Odometry that errs the same way every time: what the wheels really do, against what the encoders count of them.

Systematic errors alone; the random ones (alpha1 to alpha4) are noise.py's. All of them move the actual robot, never the
encoders: those believe what the wheels were told, but for the slip, which only they see.

    first, second = what two axes were told        the axes of the drive: translation and steering; right and left wheel
    path of (scale_1 first, scale_2 second)        what they really do
    + drift_1 first + drift_2 second               turns the whole body besides

The encoder robot: where the robot believes it is, from what its wheels were told. Knows nothing of the true one.

Its place is dead reckoning along its own steering; its angles are the mechanical ones plus an offset, which is what
dp, da and zr change. Inches, radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Final

from nserver_emu.simulation.drive import Drive
from nserver_emu.simulation.segments import Pose, Stretch, once_round


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


class Encoders:
    """Place and angle offsets; the mechanical angles are handed in by whoever owns the drive."""

    def __init__(self, x_in: float, y_in: float) -> None:
        self._x_in = x_in
        self._y_in = y_in
        self._steering_offset_rad = 0.0
        self._turret_offset_rad = 0.0

    def pose(self, steering_rad: float, turret_rad: float) -> Pose:
        """What the encoders say at these mechanical angles."""
        return Pose(
            self._x_in,
            self._y_in,
            once_round(steering_rad + self._steering_offset_rad),
            once_round(turret_rad + self._turret_offset_rad),
        )

    def follow(self, stretch: Stretch, time_s: float, steering_rad: float) -> None:
        """Reckon `time_s` seconds of a stretch that starts at this mechanical steering angle."""
        self.shift(*stretch.displacement(self.heading(steering_rad), time_s))

    def heading(self, steering_rad: float) -> float:
        """What they take for the heading at this mechanical steering angle, unwrapped."""
        return steering_rad + self._steering_offset_rad

    def turret(self, turret_rad: float) -> float:
        """What they take for the turret's direction at this mechanical angle, unwrapped."""
        return turret_rad + self._turret_offset_rad

    @property
    def place(self) -> tuple[float, float]:
        """(x, y) in inches, as they reckon."""
        return self._x_in, self._y_in

    def shift(self, dx_in: float, dy_in: float) -> None:
        """Reckon a way of (dx, dy)."""
        self._x_in += dx_in
        self._y_in += dy_in

    def slip(self, way_in: float, steering_rad: float) -> None:
        """Count a way straight along this mechanical steering angle that only the wheels went."""
        heading = steering_rad + self._steering_offset_rad
        self._x_in += way_in * cos(heading)
        self._y_in += way_in * sin(heading)

    def define_position(self, x_in: float, y_in: float) -> None:
        """From now on this place has these coordinates."""
        self._x_in = x_in
        self._y_in = y_in

    def define_angles(self, offset_steering_rad: float, offset_turret_rad: float) -> None:
        """From now on the encoders say the mechanical angles plus these offsets."""
        self._steering_offset_rad = offset_steering_rad
        self._turret_offset_rad = offset_turret_rad
