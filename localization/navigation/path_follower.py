"""Follow a planned path on an estimate: turn in place where a section begins, then drive it at its profile's speeds.

On a section, at the lateral error e (left positive), the heading error p and the speed v:

    steering = v (c - e / L^2 - 2 p / L)

which is critically damped over the distance L at any speed; c is the curvature a little ahead, because the steering
needs time to accelerate.
"""

from collections.abc import Sequence
from math import copysign, cos, hypot, inf, sin, sqrt
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from localization.navigation.limits import STAND, AxisLimits, VelocityCommand
from localization.navigation.path import PLANNED_ACCELERATION, PathPoint, PathSection, SpeedProfile, angle_difference

DAMPING_IN: Final = 6.0
"""L, the distance within which errors decay."""
DELAY_S: Final = 0.1
"""One control period: a command takes effect that much later."""
LOOKAHEAD_S: Final = 0.5
TURNED_RAD: Final = 0.04
"""A turn in place ends within this heading error."""
MAX_HEADING_ERROR_RAD: Final = 0.7
"""With a larger heading error the robot stops and turns in place."""
SEARCH_BACK_IN, SEARCH_AHEAD_IN = 2.0, 8.0
"""Range around the last position on the path in which the next one is searched."""
END_TOLERANCE_IN: Final = 0.25
_MIN_TURN_RAD_S: Final = 0.05


class PathFollower:
    """Controller for a path of sections; `command` is called once per period."""

    def __init__(self, path: Sequence[PathSection], limits: AxisLimits) -> None:
        self._path, self._limits = tuple(path), limits
        self._profiles = [SpeedProfile(section, limits) for section in self._path]
        self._number, self._along_in, self._is_turning = 0, 0.0, True
        self.lateral_error_in = 0.0
        """Distance of the robot from its path at the last command, left positive."""

    @property
    def finished(self) -> bool:
        """True once the end of the path is reached."""
        return self._number == len(self._path)

    def command(self, pose: Floats, fraction: float = 1.0) -> VelocityCommand:
        """Return the velocities at a pose (3,), scaled by `fraction` (0 to 1); STAND at the end of the path."""
        while not self.finished:
            section = self._path[self._number]
            # 1. Find the position on the path near the previous one.
            self._along_in = section.nearest(
                float(pose[0]),
                float(pose[1]),
                max(0.0, self._along_in - SEARCH_BACK_IN),
                self._along_in + SEARCH_AHEAD_IN,
            )
            point = section.at(self._along_in)
            heading_error = angle_difference(point.heading_rad, float(pose[2]))
            # 2. At the end of a section go on with the next one.
            if section.length_in - self._along_in <= END_TOLERANCE_IN:
                self._number, self._along_in, self._is_turning = self._number + 1, 0.0, True
                continue
            # 3. Turn in place or drive; the two thresholds form a hysteresis.
            self._is_turning = abs(heading_error) > (TURNED_RAD if self._is_turning else MAX_HEADING_ERROR_RAD)
            if self._is_turning:
                return turn_command(-heading_error, self._limits)
            return self._drive(section, point, pose, heading_error, fraction)
        return STAND

    def ahead(self, distance_in: float) -> Floats | None:
        """Return the point (2,) this far ahead on the section; None during a turn in place and at the end."""
        if self.finished or self._is_turning:
            return None
        return np.array(self._path[self._number].at(self._along_in + distance_in)[:2])

    def remaining_points(self, step_in: float = 1.0, distance_in: float = inf) -> Floats:
        """Return points (n, 2) of the remaining path, `step_in` apart, as far as `distance_in`."""
        parts = [
            section.points(step_in, min(self._along_in, section.length_in) if k == 0 else 0.0)
            for k, section in enumerate(self._path[self._number :])
        ]
        points: Floats = np.concatenate(parts) if parts else np.zeros((0, 2))
        return points if distance_in == inf else points[: max(1, int(distance_in / step_in))]

    def _drive(
        self, section: PathSection, point: PathPoint, pose: Floats, heading_error: float, fraction: float
    ) -> VelocityCommand:
        # 1. Lateral error; before the start and beyond the end of the section the full distance counts.
        dx, dy = float(pose[0]) - point.x_in, float(pose[1]) - point.y_in
        self.lateral_error_in = dy * cos(point.heading_rad) - dx * sin(point.heading_rad)
        distance_to_end_in = hypot(dx, dy) if self._along_in in (0.0, section.length_in) else 0.0
        self.lateral_error_in = copysign(max(abs(self.lateral_error_in), distance_to_end_in), self.lateral_error_in)
        # 2. Speed of the profile, reduced while the heading is off.
        speed = fraction * self._profiles[self._number].speed_in_s(self._along_in) * max(0.0, cos(heading_error))
        # 3. Steering law.
        curvature = section.at(self._along_in + self._lead_s(section, point, speed) * speed).curvature
        steering = speed * (curvature - self.lateral_error_in / DAMPING_IN**2 - 2.0 * heading_error / DAMPING_IN)
        limit = self._limits.steering_rad_s
        return VelocityCommand(speed, min(limit, max(-limit, steering)))

    def _lead_s(self, section: PathSection, point: PathPoint, speed: float) -> float:
        """Return how far ahead (s) to steer for: one period plus half of the steering's ramp into or out of an arc."""
        ahead = section.at(self._along_in + LOOKAHEAD_S * speed).curvature
        return DELAY_S + 0.5 * speed * max(abs(point.curvature), abs(ahead)) / self._limits.steering_rad_s2


def turn_command(angle_rad: float, limits: AxisLimits) -> VelocityCommand:
    """Return the velocities of a turn in place with this angle left, braking in time."""
    braking = sqrt(2.0 * PLANNED_ACCELERATION * limits.steering_rad_s2 * abs(angle_rad))
    return VelocityCommand(0.0, copysign(max(_MIN_TURN_RAD_S, min(limits.steering_rad_s, braking)), angle_rad))


class TurnProgress:
    """A turn in place by an angle, counter-clockwise positive, possibly of several revolutions.

    Headings passed one after another must differ by less than half a revolution. The progress survives retries, and a
    robot that was lost meanwhile still ends at the same heading.
    """

    def __init__(self, heading_rad: float, by_rad: float) -> None:
        self._heading_rad, self._remaining_rad = heading_rad, by_rad

    def remaining_rad(self, heading_rad: float) -> float:
        """Return the rest of the turn at this heading."""
        self._remaining_rad -= angle_difference(self._heading_rad, heading_rad)
        self._heading_rad = heading_rad
        return self._remaining_rad
