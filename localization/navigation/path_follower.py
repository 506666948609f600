"""Following a course on an estimate: turn in place where a stretch begins, then keep to it at its profile's speeds.

    on a stretch, e inches to its left and turned by p against it, at the speed v:
        steering = v (c - e / L^2 - 2 p / L)        critically damped over the distance L, whatever the speed;
                                                    c, the curvature, a little ahead, for steering takes time

Rules: pure; a pose in, velocities out. It looks for its place on the course only about where it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, cos, hypot, inf, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.path import BRAKING_SHARE, Place, SpeedProfile, Stretch, angle_difference
from localization.navigation.speed import AxisLimits

DAMPING_IN: Final = 6.0
DELAY_S: Final = 0.1
LOOK_S: Final = 0.5
TURNED_RAD: Final = 0.04
ASTRAY_RAD: Final = 0.7
"""Turned away farther than this from its stretch, the robot stops and turns back."""
BACK_IN, ON_IN = 2.0, 8.0
"""Where the next place on the course is looked for, from the last."""
THERE_IN: Final = 0.25
_LEAST_TURN_RAD_S: Final = 0.05


class Velocities(NamedTuple):
    """What to tell the robot's axes."""

    translation_in_s: float
    steering_rad_s: float


STAND: Final = Velocities(0.0, 0.0)


class Follower:
    """On its way along a course."""

    def __init__(self, course: Sequence[Stretch], limits: AxisLimits) -> None:
        self._course, self._limits = tuple(course), limits
        self._profiles = [SpeedProfile(stretch, limits) for stretch in self._course]
        self._number, self._along_in, self._turning = 0, 0.0, True
        self.aside_in = 0.0
        """How far beside its course the robot was last."""

    @property
    def finished(self) -> bool:
        """Whether the end was reached."""
        return self._number == len(self._course)

    def command(self, pose: Floats, share: float = 1.0) -> Velocities:
        """What to do at a pose (3,), at a share 0 to 1 of the speed; STAND at the end."""
        while not self.finished:
            stretch = self._course[self._number]
            self._along_in = stretch.nearest(
                float(pose[0]), float(pose[1]), max(0.0, self._along_in - BACK_IN), self._along_in + ON_IN
            )
            place = stretch.at(self._along_in)
            astray = angle_difference(place.heading_rad, float(pose[2]))
            if stretch.length_in - self._along_in <= THERE_IN:
                self._number, self._along_in, self._turning = self._number + 1, 0.0, True
                continue
            self._turning = abs(astray) > (TURNED_RAD if self._turning else ASTRAY_RAD)
            if self._turning:
                return turn(-astray, self._limits)
            return self._go(stretch, place, pose, astray, share)
        return STAND

    def ahead(self, reach_in: float) -> Floats | None:
        """The place (2,) so far ahead on this stretch; None where it turns in place, or is at the end."""
        if self.finished or self._turning:
            return None
        return np.array(self._course[self._number].at(self._along_in + reach_in)[:2])

    def left(self, step_in: float = 1.0, reach_in: float = inf) -> Floats:
        """Points (n, 2) of what is left of the course, as far as `reach_in`."""
        parts = [
            stretch.points(step_in, min(self._along_in, stretch.length_in) if k == 0 else 0.0)
            for k, stretch in enumerate(self._course[self._number :])
        ]
        points: Floats = np.concatenate(parts) if parts else np.zeros((0, 2))
        return points if reach_in == inf else points[: max(1, int(reach_in / step_in))]

    def _go(self, stretch: Stretch, place: Place, pose: Floats, astray: float, share: float) -> Velocities:
        dx, dy = float(pose[0]) - place.x_in, float(pose[1]) - place.y_in
        self.aside_in = dy * cos(place.heading_rad) - dx * sin(place.heading_rad)
        ended_in = hypot(dx, dy) if self._along_in in (0.0, stretch.length_in) else 0.0
        self.aside_in = copysign(max(abs(self.aside_in), ended_in), self.aside_in)
        speed = share * self._profiles[self._number].speed_in_s(self._along_in) * max(0.0, cos(astray))
        curvature = stretch.at(self._along_in + self._lead_s(stretch, place, speed) * speed).curvature
        steering = speed * (curvature - self.aside_in / DAMPING_IN**2 - 2.0 * astray / DAMPING_IN)
        most = self._limits.steering_rad_s
        return Velocities(speed, min(most, max(-most, steering)))

    def _lead_s(self, stretch: Stretch, place: Place, speed: float) -> float:
        """How far ahead to steer for: half of what the ramp of the steering takes, into an arc or out, and a period."""
        ahead = stretch.at(self._along_in + LOOK_S * speed).curvature
        return DELAY_S + 0.5 * speed * max(abs(place.curvature), abs(ahead)) / self._limits.steering_rad_s2


def turn(by_rad: float, limits: AxisLimits) -> Velocities:
    """How fast to turn in place when so much is left of it."""
    braking = sqrt(2.0 * BRAKING_SHARE * limits.steering_rad_s2 * abs(by_rad))
    return Velocities(0.0, copysign(max(_LEAST_TURN_RAD_S, min(limits.steering_rad_s, braking)), by_rad))
