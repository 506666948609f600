"""The encoder robot: where the robot believes it is, from what its wheels were told. Knows nothing of the true one.

Its place is dead reckoning along its own steering; its angles are the mechanical ones plus an offset, which is what
dp, da and zr change. Inches, radians.
"""

from __future__ import annotations

from math import cos, sin

from nserver_emu.simulation.angles import once_round
from nserver_emu.simulation.poses import Pose
from nserver_emu.simulation.stretch import Stretch


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
