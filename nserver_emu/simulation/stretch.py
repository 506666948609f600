"""A stretch of path: constant acceleration along it, constant angular acceleration of its heading. Pure kinematics.

Every drive, whatever its wheels, hands out stretches; every disturbance of the motion makes one stretch of another.
Nothing here knows axes, walls or noise. Scalar arithmetic: it runs some thirty times a simulated second and robot.

    x(t) = integral of v(s) cos(heading(s)) ds     v(s) = speed + acceleration s
    y(t) = integral of v(s) sin(heading(s)) ds     heading(s) = heading + turn_rate s + turn_acceleration s^2 / 2
"""

from __future__ import annotations

from math import ceil, cos, sin
from typing import Final, NamedTuple

TURN_A_PIECE_RAD: Final = 0.25
"""Most turn in one piece of quadrature: five Gauss points then err by less than 1e-13 of its length."""

GAUSS_POINTS: Final = (
    (0.046910077030668, 0.1184634425280945),
    (0.2307653449471584, 0.2393143352496832),
    (0.5, 0.2844444444444445),
    (0.7692346550528415, 0.2393143352496832),
    (0.9530899229693319, 0.1184634425280945),
)
"""Five-point Gauss-Legendre rule on [0, 1]: (abscissa, weight); Abramowitz and Stegun, table 25.4."""


class Stretch(NamedTuple):
    """`duration_s` seconds of motion of the point between the wheels.

    speed, acceleration             along the heading, in/s and in/s^2; the speed never changes its sign inside
    turn_rate, turn_acceleration    of the heading, rad/s and rad/s^2
    """

    duration_s: float
    speed: float
    acceleration: float
    turn_rate: float
    turn_acceleration: float

    @property
    def at_rest(self) -> bool:
        """Whether neither place nor heading changes."""
        return not (self.speed or self.turn_rate or self.acceleration or self.turn_acceleration)

    def velocity_at(self, time_s: float) -> float:
        """Speed along the heading `time_s` into the stretch, in/s."""
        return self.speed + self.acceleration * time_s

    def distance_at(self, time_s: float) -> float:
        """Signed way along the path, inches."""
        return (self.speed + 0.5 * self.acceleration * time_s) * time_s

    def turn_at(self, time_s: float) -> float:
        """Change of the heading, radians."""
        return (self.turn_rate + 0.5 * self.turn_acceleration * time_s) * time_s

    def displacement(self, heading_rad: float, time_s: float) -> tuple[float, float]:
        """(dx, dy) in inches, `time_s` into the stretch, when it starts at this heading.

        Exact for constant velocities, where the path is an arc with the chord 2 R sin(turn / 2) in the direction
        heading + turn / 2; else by Gauss quadrature, good to 1e-12 in for ways of some inches.
        """
        _, speed, acceleration, turn_rate, turn_acceleration = self
        if acceleration == turn_acceleration == 0.0:
            half = 0.5 * turn_rate * time_s
            chord = speed * time_s
            if half:
                chord *= _sinc(half)
            return chord * cos(heading_rad + half), chord * sin(heading_rad + half)
        if turn_rate == 0.0 and turn_acceleration == 0.0:
            way = self.distance_at(time_s)
            return way * cos(heading_rad), way * sin(heading_rad)
        return self._quadrature(heading_rad, time_s)

    def turn_bound(self, time_s: float) -> float:
        """No less than the heading turns back and forth within `time_s`, radians."""
        return max(abs(self.turn_rate), abs(self.turn_rate + self.turn_acceleration * time_s)) * time_s

    def length_bound(self, time_s: float) -> float:
        """No less than the length of the path within `time_s`, inches; on an arc just that."""
        _, speed, acceleration, _, _ = self
        return (max(abs(speed), abs(speed + acceleration * time_s)) if acceleration else abs(speed)) * time_s

    def _quadrature(self, heading_rad: float, time_s: float) -> tuple[float, float]:
        pieces = max(1, ceil(self.turn_bound(time_s) / TURN_A_PIECE_RAD))
        width = time_s / pieces
        dx = dy = 0.0
        for piece in range(pieces):
            for abscissa, weight in GAUSS_POINTS:
                at = (piece + abscissa) * width
                way = weight * width * self.velocity_at(at)
                heading = heading_rad + self.turn_at(at)
                dx += way * cos(heading)
                dy += way * sin(heading)
        return dx, dy


def _sinc(angle: float) -> float:
    """sin(angle) / angle; by its series near 0, where the next term is below 1e-18."""
    return sin(angle) / angle if abs(angle) > 1e-4 else 1.0 - angle * angle / 6.0
