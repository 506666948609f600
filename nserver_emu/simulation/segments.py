"""A stretch of path: constant acceleration along it, constant angular acceleration of its heading. Pure kinematics.

Every drive, whatever its wheels, hands out stretches; every disturbance of the motion makes one stretch of another.
Nothing here knows axes, walls or noise. Scalar arithmetic: it runs some thirty times a simulated second and robot.

    x(t) = integral of v(s) cos(heading(s)) ds     v(s) = speed + acceleration s
    y(t) = integral of v(s) sin(heading(s)) ds     heading(s) = heading + turn_rate s + turn_acceleration s^2 / 2

Where a robot came along: the pieces of its way, each a stretch from an instant and a place on. Pure.

Simulated time as whole picoseconds, so that sums of steps are exact and two instants are equal or they are not.

Seconds are for people and formulas; instants are for what happens when. No clock is read here.

Angles on the circle, in the one place where physics wraps them. Radians.

The words in which a simulated robot tells where it is. Values only.

A piece of motion while it lasts, and the moments in it: what the encoders say at any instant, by the closed form.

A robot's wheels move once for a whole piece; what happens inside it, a sonar firing, notes the piece and how far into
it that was. The stamp is worked out when somebody asks for it. Values only: a moment tells the same whenever asked.
"""

from __future__ import annotations

from math import ceil, cos, isfinite, pi, remainder, sin, tau
from typing import Final, NamedTuple

from nserver_emu.simulation.axis import Run, shown_in

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


class Leg(NamedTuple):
    """A piece of a robot's track: from this instant and place along this stretch, for so long; then it stood."""

    begin_ps: int
    x_in: float
    y_in: float
    heading_rad: float
    stretch: Stretch
    free_s: float

    def place(self, time_s: float) -> tuple[float, float]:
        """(x, y) in inches, so long after its beginning; before that, where it begins."""
        _, x, y, heading, stretch, free_s = self
        if time_s <= 0.0:
            return x, y
        dx, dy = stretch.displacement(heading, time_s if time_s < free_s else free_s)
        return x + dx, y + dy


PS_PER_S: Final = 10**12
"""Picoseconds in a second: a float dt is rounded by 0.5e-12 s at most, 1e-11 in at top speed."""

NEVER_PS: Final = 1 << 80
"""An instant no simulation reaches: 38,000 years."""


def to_ps(seconds: float) -> int:
    """The nearest instant or span of time; raises ValueError for what is negative or not finite."""
    if not isfinite(seconds) or seconds < 0.0:
        raise ValueError(f"expected a time of 0 s or more, got {seconds} s")
    return round(seconds * PS_PER_S)


def to_s(picoseconds: int) -> float:
    """Seconds."""
    return picoseconds / PS_PER_S


def once_round(angle_rad: float) -> float:
    """The same direction in [0, 2 pi): a turn just below 0 is 0, not 2 pi."""
    wrapped = angle_rad % tau
    return wrapped if wrapped < tau else 0.0


def short_way(angle_rad: float) -> float:
    """The same direction in (-pi, pi]: how far it is from 0, the short way round."""
    wrapped = remainder(angle_rad, tau)
    return wrapped if wrapped > -pi else pi


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


AT_REST: Final = Stretch(0.0, 0.0, 0.0, 0.0, 0.0)
"""The stretch of a passage of which only the beginning is asked for."""


class Passage(NamedTuple):
    """The encoders at the beginning of a stretch, and how they go on.

    x_in, y_in, heading_rad     what they say, the heading unwrapped
    stretch                     what the wheels were told
    runs                        of the axes in their order
    """

    x_in: float
    y_in: float
    heading_rad: float
    stretch: Stretch
    runs: tuple[Run, Run, Run]


class Moment(NamedTuple):
    """So many seconds into a passage; `turret_rad` is what the encoder of the turret says there, unwrapped.

    instant_s    simulated time
    """

    passage: Passage
    time_s: float
    turret_rad: float
    instant_s: float

    @property
    def stamp(self) -> Stamp:
        """What a reading of this moment is stamped with."""
        (x, y, heading, stretch, (first, second, third)), time_s, turret, instant_s = self
        dx, dy = stretch.displacement(heading, time_s)
        pose = Pose(x + dx, y + dy, once_round(heading + stretch.turn_at(time_s)), once_round(turret))
        velocities = shown_in(first, time_s), shown_in(second, time_s), shown_in(third, time_s)
        return Stamp(pose, velocities, instant_s, instant_s)
