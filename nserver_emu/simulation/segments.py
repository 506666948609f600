"""Segments of motion, poses, time stamps and simulated time: the values that all parts of a robot exchange.

Every drive produces segments of constant acceleration, whatever its wheels; every disturbance of the motion turns one
segment into another. Scalar arithmetic, because it runs some thirty times per simulated second and robot.

    x(t) = integral of v(s) cos(heading(s)) ds     v(s) = speed + acceleration s
    y(t) = integral of v(s) sin(heading(s)) ds     heading(s) = heading + turn_rate s + turn_acceleration s^2 / 2

Simulated time is a whole number of picoseconds (`_ps`): sums of steps are exact, and two instants are equal or they are
not. Seconds (`_s`) are for formulas and users. No clock is read here.
"""

from math import ceil, cos, isfinite, pi, remainder, sin, tau
from typing import Final, NamedTuple

from nserver_emu.simulation.axis import AxisMotion, shown_velocity_after

MAX_PIECE_TURN_RAD: Final = 0.25
"""Largest turn in one piece of the quadrature: five Gauss points then err by less than 1e-13 of its length."""

GAUSS_POINTS: Final = (
    (0.046910077030668, 0.1184634425280945),
    (0.2307653449471584, 0.2393143352496832),
    (0.5, 0.2844444444444445),
    (0.7692346550528415, 0.2393143352496832),
    (0.9530899229693319, 0.1184634425280945),
)
"""Five-point Gauss-Legendre rule on [0, 1]: (abscissa, weight); Abramowitz and Stegun, table 25.4."""

PS_PER_S: Final = 10**12
"""Picoseconds per second: a float dt is rounded by at most 0.5e-12 s, which is 1e-11 in at top speed."""

TIME_MAX_PS: Final = 1 << 80
"""An instant that no simulation reaches: 38,000 years. A deadline at this instant never comes."""


def to_ps(seconds: float) -> int:
    """Return the nearest instant or span of time.

    Raises
    ------
    ValueError
        If the argument is negative or not finite.
    """
    if not isfinite(seconds) or seconds < 0.0:
        raise ValueError(f"expected a time of 0 s or more, got {seconds} s")
    return round(seconds * PS_PER_S)


def to_s(picoseconds: int) -> float:
    """Return seconds."""
    return picoseconds / PS_PER_S


def wrap_to_2pi(angle_rad: float) -> float:
    """Return the same direction in [0, 2 pi); an angle just below 0 becomes 0, not 2 pi."""
    wrapped = angle_rad % tau
    return wrapped if wrapped < tau else 0.0


def wrap_to_pi(angle_rad: float) -> float:
    """Return the same direction in (-pi, pi]."""
    wrapped = remainder(angle_rad, tau)
    return wrapped if wrapped > -pi else pi


class ConstantAccelerationSegment(NamedTuple):
    """Motion of the point between the wheels for `duration_s` seconds.

    Attributes
    ----------
    speed, acceleration
        Along the heading, in/s and in/s^2; the speed does not change its sign inside.
    turn_rate, turn_acceleration
        Of the heading, rad/s and rad/s^2.
    """

    duration_s: float
    speed: float
    acceleration: float
    turn_rate: float
    turn_acceleration: float

    @property
    def at_rest(self) -> bool:
        """True if neither position nor heading changes."""
        return not (self.speed or self.turn_rate or self.acceleration or self.turn_acceleration)

    def velocity_at(self, time_s: float) -> float:
        """Return the speed along the heading `time_s` into the segment, in/s."""
        return self.speed + self.acceleration * time_s

    def distance_at(self, time_s: float) -> float:
        """Return the signed distance along the path, inches."""
        return (self.speed + 0.5 * self.acceleration * time_s) * time_s

    def turn_at(self, time_s: float) -> float:
        """Return the change of the heading, radians."""
        return (self.turn_rate + 0.5 * self.turn_acceleration * time_s) * time_s

    def displacement(self, heading_rad: float, time_s: float) -> tuple[float, float]:
        """Return (dx, dy) in inches, `time_s` into the segment, when it starts at this heading.

        Exact for constant velocities; otherwise by Gauss quadrature, accurate to 1e-12 in for distances of some inches.
        """
        _, speed, acceleration, turn_rate, turn_acceleration = self
        # 1. Constant velocities: an arc, with the chord 2 R sin(turn / 2) in the direction heading + turn / 2.
        if acceleration == turn_acceleration == 0.0:
            half = 0.5 * turn_rate * time_s
            chord = speed * time_s
            if half:
                chord *= _sinc(half)
            return chord * cos(heading_rad + half), chord * sin(heading_rad + half)
        # 2. No turn: a straight line.
        if turn_rate == 0.0 and turn_acceleration == 0.0:
            distance = self.distance_at(time_s)
            return distance * cos(heading_rad), distance * sin(heading_rad)
        # 3. A turn with acceleration has no closed form in elementary functions.
        return self._quadrature(heading_rad, time_s)

    def turn_bound(self, time_s: float) -> float:
        """Return an upper bound of how far the heading turns to and fro within `time_s`, radians."""
        return max(abs(self.turn_rate), abs(self.turn_rate + self.turn_acceleration * time_s)) * time_s

    def length_bound(self, time_s: float) -> float:
        """Return an upper bound of the length of the path within `time_s`, inches; exact on an arc."""
        _, speed, acceleration, _, _ = self
        return (max(abs(speed), abs(speed + acceleration * time_s)) if acceleration else abs(speed)) * time_s

    def _quadrature(self, heading_rad: float, time_s: float) -> tuple[float, float]:
        # `velocity_at` and `turn_at` written out: they are calculated ten times in most steps of a simulation.
        _, speed, acceleration, turn_rate, turn_acceleration = self
        half_acceleration = 0.5 * turn_acceleration
        pieces = max(1, ceil(self.turn_bound(time_s) / MAX_PIECE_TURN_RAD))
        width = time_s / pieces
        dx = dy = 0.0
        for piece in range(pieces):
            for abscissa, weight in GAUSS_POINTS:
                at = (piece + abscissa) * width
                length = weight * width * (speed + acceleration * at)
                heading = heading_rad + (turn_rate + half_acceleration * at) * at
                dx += length * cos(heading)
                dy += length * sin(heading)
        return dx, dy


def _sinc(angle: float) -> float:
    """Return sin(angle) / angle; near 0 by its series, whose next term is below 1e-18."""
    return sin(angle) / angle if abs(angle) > 1e-4 else 1.0 - angle * angle / 6.0


AT_REST: Final = ConstantAccelerationSegment(0.0, 0.0, 0.0, 0.0, 0.0)
"""The segment of a `MotionSegment` of which only the start is used."""


Velocities = tuple[float, float, float]
"""Velocities as the encoders show them, in the order of the axes: translation in/s, steering rad/s, turret rad/s; of a
differential drive right wheel in/s, left wheel in/s, 0."""


class Pose(NamedTuple):
    """A true or an estimated pose: inches, and directions in [0, 2 pi), counter-clockwise."""

    x_in: float
    y_in: float
    steering_rad: float
    turret_rad: float


class Stamp(NamedTuple):
    """The time stamp of a reading: encoder pose and velocities, and when they and the sensor were read, seconds."""

    pose: Pose
    velocities: Velocities
    pose_time_s: float
    sensor_time_s: float


NO_STAMP: Final = Stamp(Pose(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
"""The stamp of a sensor that has never measured."""


class MotionSegment(NamedTuple):
    """The encoders at the start of a segment, and how they continue.

    Attributes
    ----------
    x_in, y_in, heading_rad
        Encoder pose at the start, the heading unwrapped.
    segment
        The commanded motion.
    axes
        Motions of the axes in their order.
    """

    x_in: float
    y_in: float
    heading_rad: float
    segment: ConstantAccelerationSegment
    axes: tuple[AxisMotion, AxisMotion, AxisMotion]


class SegmentTime(NamedTuple):
    """An instant within a motion segment, from which the stamp of a reading is computed only when it is used.

    The wheels move once for a whole segment; a sonar that fires inside it records the segment and how far into it that
    was.

    Attributes
    ----------
    time_s
        Seconds into the segment.
    turret_rad
        Turret encoder at that instant, unwrapped.
    sim_time_s
        Simulated time.
    """

    motion: MotionSegment
    time_s: float
    turret_rad: float
    sim_time_s: float

    @property
    def stamp(self) -> Stamp:
        """The stamp of a reading at this instant."""
        (x, y, heading, segment, (first, second, third)), time_s, turret, sim_time_s = self
        dx, dy = segment.displacement(heading, time_s)
        pose = Pose(x + dx, y + dy, wrap_to_2pi(heading + segment.turn_at(time_s)), wrap_to_2pi(turret))
        velocities = (shown_velocity_after(first, time_s), shown_velocity_after(second, time_s),
                      shown_velocity_after(third, time_s))
        return Stamp(pose, velocities, sim_time_s, sim_time_s)
