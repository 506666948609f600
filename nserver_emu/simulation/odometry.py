"""Errors of the wheels: random and systematic errors of the true motion, and the encoders' dead reckoning.

    MotionNoise   random: alpha1 to alpha4, a random walk
    Odometry      systematic: scales of the wheels, drift of the body, slip at contacts
    Encoders      what the robot counts

Both kinds of errors change the true motion; the encoders count the commanded one. Slip is the opposite: the encoders
count it, and the robot does not move. `SimulatedRobot._follow` (robot.py) applies both.

    first, second = commanded motion of two axes   translation and steering; right and left wheel
    path_segment(scale_1 first, scale_2 second)    the true motion of the wheels
    + drift_1 first + drift_2 second               an additional turn of the whole body
    MotionNoise.disturbed                          longer or shorter, and turned, at random
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.drive import Drive, axis_rates, path_segment
from nserver_emu.simulation.segments import ConstantAccelerationSegment, Pose, wrap_to_2pi
from nserver_emu.simulation.settings import setting


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """Random errors of the motion: a random walk.

    A segment of length |d| inches that turns by |a| radians really goes d + e and turns the whole body by f, with

        var(f) = alpha1 |a| + alpha2 |d|      alpha1  rad        turn, from turning
                                              alpha2  rad^2/in   turn, from driving
        var(e) = alpha3 |d| + alpha4 |a|      alpha3  in         distance, from driving
                                              alpha4  in^2/rad   distance, from turning

    The variances of the book grow with the squares d^2 and a^2, so that they depend on how a path is divided; here the
    variances of the pieces add up. For a localizer that updates every D inches and A radians the book's parameters of
    one update are alpha1 / A, alpha3 / D, and alpha2 / D, alpha4 / A.

    References
    ----------
    Thrun, Burgard and Fox, Probabilistic Robotics (2005), section 5.4.
    """

    alpha1: float = setting(0.0, 0, 10, "rad", "variance of the turn per radian turned")
    alpha2: float = setting(0.0, 0, 10, "rad^2/in", "variance of the turn per inch driven")
    alpha3: float = setting(0.0, 0, 10, "in", "variance of the distance per inch driven")
    alpha4: float = setting(0.0, 0, 10, "in^2/rad", "variance of the distance per radian turned")

    @classmethod
    def walk(cls, along: float = 0.0, turn: float = 0.0, drift: float = 0.0) -> MotionNoise:
        """Return the noise for the square roots that the settings of the experiments use.

        Parameters
        ----------
        along
            sqrt(inch): alpha3 = along^2.
        turn
            sqrt(radian): alpha1 = turn^2.
        drift
            radian/sqrt(inch): alpha2 = drift^2.
        """
        return cls(alpha1=turn**2, alpha2=drift**2, alpha3=along**2)

    def distance_std_in(self, distance_in: float, angle_rad: float) -> float:
        """Return the standard deviation of a distance on which the robot turns by an angle, inches."""
        return _walk_std(self.alpha3, distance_in, self.alpha4, angle_rad)

    def turn_std_rad(self, distance_in: float, angle_rad: float) -> float:
        """Return the standard deviation of the body's turn on that distance."""
        return _walk_std(self.alpha1, angle_rad, self.alpha2, distance_in)

    def disturbed(self, segment: ConstantAccelerationSegment, rng: np.random.Generator) -> ConstantAccelerationSegment:
        """Return the true motion for a commanded one: the same duration, another length, and a turn of the body.

        Draws twice if anything moves and there is noise; otherwise returns the same object without drawing.
        """
        alphas, duration = (self.alpha1, self.alpha2, self.alpha3, self.alpha4), segment.duration_s
        if not any(alphas) or (segment.distance_at(duration) == 0.0 and segment.turn_at(duration) == 0.0):
            return segment
        # Both numbers are drawn, even if one variance is 0: the stream must not depend on the parameters.
        return disturbed_segment(segment, alphas, rng.standard_normal(), rng.standard_normal())


def _walk_std(first_alpha: float, first: float, second_alpha: float, second: float) -> float:
    return sqrt(first_alpha * abs(first) + second_alpha * abs(second))


def disturbed_segment(segment: ConstantAccelerationSegment, alphas: Sequence[float], along_normal: float,
                      turn_normal: float) -> ConstantAccelerationSegment:
    """Return a segment that moves with noise: the same duration, another length, and a turn of the body.

    Parameters
    ----------
    alphas
        alpha1 to alpha4 of `MotionNoise`.
    along_normal, turn_normal
        Standard normal numbers, of the length and of the turn.
    """
    duration, speed, acceleration, turn_rate, turn_acceleration = segment
    distance, angle = segment.distance_at(duration), segment.turn_at(duration)
    longer = _walk_std(alphas[2], distance, alphas[3], angle) * along_normal
    turned = _walk_std(alphas[0], angle, alphas[1], distance) * turn_normal
    # Scaling keeps the duration and the shape of the speed profile.
    scale = 1.0 + longer / distance if distance else 1.0
    return ConstantAccelerationSegment(duration, speed * scale if distance else longer / duration, acceleration * scale,
                                       turn_rate + turned / duration, turn_acceleration)


NO_NOISE: Final = MotionNoise()
"""Every motion as commanded."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Systematic odometry errors, by axis in the order of the commands.

    Attributes
    ----------
    scales
        True distance per counted distance: a wheel of 1 % more diameter has 1.01; the third is the turret's.
    drifts
        Turn of the whole body per counted distance of the first two axes, rad/in or rad/rad. A synchro drive whose
        wheels are not parallel drives in circles, (rad/in, 0); a differential drive of track b whose wheels are really
        E b apart has (k, -k) with k = (1/E - 1)/b.
    slip_in
        Distance that the wheels roll on the spot at every contact before they stop, inches.

    References
    ----------
    Borenstein and Feng, UMBmark (1995): the wheel diameter ratio Ed is scales[0] / scales[1] of a Scout, the wheelbase
    ratio Eb is E.
    """

    scales: tuple[float, float, float] = setting(
        (1.0, 1.0, 1.0), 0.5, 2, "",
        "true travel per counted travel: translation, steering, turret (Scout: right, left wheel, nothing)",
    )  # fmt: skip
    drifts: tuple[float, float] = setting(
        (0.0, 0.0), -0.1, 0.1, "rad/in, rad/rad",
        "turn of the body per counted travel of the first two axes (Scout: rad/in both)",
    )  # fmt: skip
    slip_in: float = setting(0.0, 0, 10, "in", "distance that the wheels roll on the spot at every contact")

    @property
    def is_exact(self) -> bool:
        """True if no axis has an error; there may be slip."""
        return self.scales == (1.0, 1.0, 1.0) and self.drifts == (0.0, 0.0)

    def true_segment(self, segment: ConstantAccelerationSegment, drive: Drive) -> ConstantAccelerationSegment:
        """Return the true motion for a commanded one; the same object if there is no error."""
        if self.scales[:2] == (1.0, 1.0) and self.drifts == (0.0, 0.0):
            return segment
        return erroneous_segment(segment, drive.track_in, self.scales, self.drifts)


def erroneous_segment(segment: ConstantAccelerationSegment, track_in: float, scales: Sequence[float],
                      drifts: Sequence[float]) -> ConstantAccelerationSegment:
    """Return the true motion of a drive of this track for a commanded one; errors as those of `Odometry`."""
    # 1. Scale errors of both axes.
    first, second = axis_rates(segment, track_in)
    path = path_segment(segment.duration_s, first.times(scales[0]), second.times(scales[1]), track_in)
    # 2. Drift of the body.
    return ConstantAccelerationSegment(
        path.duration_s, path.speed, path.acceleration,
        path.turn_rate + drifts[0] * first.velocity + drifts[1] * second.velocity,
        path.turn_acceleration + drifts[0] * first.acceleration + drifts[1] * second.acceleration,
    )  # fmt: skip


EXACT: Final = Odometry()
"""Wheels without systematic errors and without slip."""


class EncoderState(NamedTuple):
    """The state of the encoders: position in inches, offsets in radians."""

    x_in: float
    y_in: float
    steering_offset_rad: float
    turret_offset_rad: float


class Encoders:
    """The pose that the robot reports: dead reckoning of the commanded motion along its own steering.

    Its angles are the mechanical ones, which are passed in, plus an offset, which dp, da and zr change. The encoders do
    not know the true pose.
    """

    def __init__(self, x_in: float, y_in: float) -> None:
        self._x_in = x_in
        self._y_in = y_in
        self._steering_offset_rad = 0.0
        self._turret_offset_rad = 0.0

    def to_state(self) -> EncoderState:
        """Return all that changes."""
        return EncoderState(self._x_in, self._y_in, self._steering_offset_rad, self._turret_offset_rad)

    def set_state(self, state: EncoderState) -> None:
        """Continue from a state."""
        self._x_in, self._y_in, self._steering_offset_rad, self._turret_offset_rad = state

    def pose(self, steering_rad: float, turret_rad: float) -> Pose:
        """Return the encoder pose at these mechanical angles."""
        return Pose(self._x_in, self._y_in, wrap_to_2pi(steering_rad + self._steering_offset_rad),
                    wrap_to_2pi(turret_rad + self._turret_offset_rad))

    def follow(self, segment: ConstantAccelerationSegment, time_s: float, steering_rad: float) -> None:
        """Integrate `time_s` seconds of a segment that starts at this mechanical steering angle."""
        self.shift(*segment.displacement(self.heading(steering_rad), time_s))

    def heading(self, steering_rad: float) -> float:
        """Return the encoder heading at this mechanical steering angle, unwrapped."""
        return steering_rad + self._steering_offset_rad

    def turret(self, turret_rad: float) -> float:
        """Return the encoder direction of the turret at this mechanical angle, unwrapped."""
        return turret_rad + self._turret_offset_rad

    @property
    def position(self) -> tuple[float, float]:
        """(x, y) in inches, by dead reckoning."""
        return self._x_in, self._y_in

    def shift(self, dx_in: float, dy_in: float) -> None:
        """Add a displacement."""
        self._x_in += dx_in
        self._y_in += dy_in

    def slip(self, distance_in: float, steering_rad: float) -> None:
        """Count a straight distance along this mechanical steering angle that only the wheels rolled."""
        # The wheels roll on the spot, and the encoders take it for a straight motion.
        heading = self.heading(steering_rad)
        self.shift(distance_in * cos(heading), distance_in * sin(heading))

    def define_position(self, x_in: float, y_in: float) -> None:
        """Give the current position these coordinates."""
        self._x_in = x_in
        self._y_in = y_in

    def define_angles(self, offset_steering_rad: float, offset_turret_rad: float) -> None:
        """Set the offsets between mechanical and reported angles."""
        self._steering_offset_rad = offset_steering_rad
        self._turret_offset_rad = offset_turret_rad
