"""The words in which a simulated robot tells where it is. Values only."""

from __future__ import annotations

from typing import NamedTuple

Velocities = tuple[float, float, float]
"""As the encoders show them, in the order of the axes: translation in/s, steering rad/s, turret rad/s; of a
differential drive right wheel in/s, left wheel in/s, 0."""


class Pose(NamedTuple):
    """Where a robot is, or believes it is: inches, and directions in [0, 2 pi) counter-clockwise."""

    x_in: float
    y_in: float
    steering_rad: float
    turret_rad: float


class Stamp(NamedTuple):
    """The moment of a reading: encoder pose and velocities, and when they and the sensor were read, seconds."""

    pose: Pose
    velocities: Velocities
    pose_time_s: float
    sensor_time_s: float
