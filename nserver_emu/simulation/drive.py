"""Drives and the chassis: the motion of the robot that its axes cause, and its true position among walls.

    SynchroDrive         translation, steering, turret: three wheels steer and roll together, the body never turns
    DifferentialDrive    right wheel, left wheel: the body turns with the heading, and the sensors with the body

Both drives have the same interface: `segment` for the path, `advance` to let time pass, three mechanical angles against
the body's yaw; `axis_rates` and `path_segment` convert between path and axes, for odometry errors. A drive knows
mechanical angles, no positions and no encoders. `Chassis` is the true robot: a disc that moves in the map and stops
where it touches. It knows no commands and no encoders.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2
from typing import Final, NamedTuple

from nserver_emu.simulation import collision
from nserver_emu.simulation.axis import TIME_TOLERANCE_S, Axis, AxisLimits, AxisState
from nserver_emu.simulation.segments import ConstantAccelerationSegment, Pose, wrap_to_2pi, wrap_to_pi
from worlds.geometry import FloatArray
from worlds.robots import Body

NO_AXIS: Final = AxisLimits(top_speed=0.0, top_acceleration=1.0, min_acceleration=1.0, speed=0.0, acceleration=1.0,
                            resolution=0.0)
"""The limits of an axis that does not exist: it accepts every command and never moves."""

SURVEY_IN: Final = 12.0
"""Walls this much farther than needed are collected at once: a compromise between searching all walls about once per
second of driving, and examining few walls per segment."""


class AxisRate(NamedTuple):
    """Velocity and acceleration of an axis."""

    velocity: float
    acceleration: float

    def times(self, scale: float) -> AxisRate:
        """Return the rate multiplied by a scale."""
        return AxisRate(self.velocity * scale, self.acceleration * scale)


NO_TRACK: Final = 0.0
"""The track of a synchro drive, whose axes are translation and steering."""


def axis_rates(segment: ConstantAccelerationSegment, track_in: float) -> tuple[AxisRate, AxisRate]:
    """Return the rates of both axes of a drive on a segment: the wheels, or translation and steering."""
    _, speed, acceleration, turn_rate, turn_acceleration = segment
    if track_in == NO_TRACK:
        return AxisRate(speed, acceleration), AxisRate(turn_rate, turn_acceleration)
    half = 0.5 * track_in
    faster, gaining = half * turn_rate, half * turn_acceleration
    return AxisRate(speed + faster, acceleration + gaining), AxisRate(speed - faster, acceleration - gaining)


def path_segment(duration_s: float, first: AxisRate, second: AxisRate, track_in: float) -> ConstantAccelerationSegment:
    """Return the segment that both axes of a drive cause; the inverse of `axis_rates`."""
    velocity_1, acceleration_1 = first
    velocity_2, acceleration_2 = second
    if track_in == NO_TRACK:
        return ConstantAccelerationSegment(duration_s, velocity_1, acceleration_1, velocity_2, acceleration_2)
    return ConstantAccelerationSegment(
        duration_s, 0.5 * (velocity_1 + velocity_2), 0.5 * (acceleration_1 + acceleration_2),
        (velocity_1 - velocity_2) / track_in, (acceleration_1 - acceleration_2) / track_in,
    )  # fmt: skip


def until_reversal(segment: ConstantAccelerationSegment) -> ConstantAccelerationSegment:
    """Return the segment up to where the robot reverses, unless that is within the tolerance of now."""
    duration_s, speed, acceleration, turn_rate, turn_acceleration = segment
    if speed * acceleration < 0.0:
        reverses_s = -speed / acceleration
        if TIME_TOLERANCE_S < reverses_s < duration_s:
            return ConstantAccelerationSegment(reverses_s, speed, acceleration, turn_rate, turn_acceleration)
    return segment


class DriveState(NamedTuple):
    """The state of a drive in a snapshot: mechanical angles in radians, and the axes in their order."""

    steering_rad: float
    turret_rad: float
    axes: tuple[AxisState, AxisState, AxisState]


class SynchroDrive:
    """The drive of the N150 and N200.

    Attributes
    ----------
    steering_rad, turret_rad
        Mechanical angles against the body, unwrapped; 0 is the zero position of the bumpers.
    bumper_frame_rad
        Angle of the bumpers against the body's yaw: 0, because the body does not turn.
    in_inches
        True for each axis that counts inches; the others count radians.
    track_in
        NO_TRACK: the axes are not wheels side by side.
    """

    bumper_frame_rad = 0.0
    in_inches = (True, False, False)
    track_in = NO_TRACK

    def __init__(self, limits: tuple[AxisLimits, ...], ramps: bool) -> None:
        self.translation, self.steering, self.turret = (Axis(limit, ramps) for limit in limits)
        self.steering_rad = 0.0
        self.turret_rad = 0.0

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """In the order of the commands: translation, steering, turret."""
        return self.translation, self.steering, self.turret

    def segment(self, max_s: float) -> ConstantAccelerationSegment:
        """Return the path of the next `max_s` seconds, or of fewer if an axis changes its acceleration sooner."""
        # The turret does not shape the path, so its phases do not end a segment.
        rolling_s, speed, acceleration = self.translation.current_phase
        steering_s, turn_rate, turn_acceleration = self.steering.current_phase
        duration_s = min(max_s, rolling_s, steering_s)
        return ConstantAccelerationSegment(duration_s, speed, acceleration, turn_rate, turn_acceleration)

    @property
    def max_speed(self) -> float:
        """Upper bound of the robot's speed until the next command, in/s."""
        return self.translation.max_speed

    @property
    def max_turn_rate(self) -> float:
        """Upper bound of the heading's turn rate until the next command, rad/s."""
        return self.steering.max_speed

    @property
    def velocity_bounds(self) -> tuple[float, float]:
        """Bounds of the velocity until the next command, lower <= 0 <= upper, in/s."""
        return self.translation.velocity_bounds

    def advance(self, dt_s: float) -> float:
        """Advance all axes by dt_s seconds and return the turn of the turret, radians."""
        self.translation.advance(dt_s)
        self.steering_rad += self.steering.advance(dt_s)
        turned = self.turret.advance(dt_s)
        self.turret_rad += turned
        return turned

    def turret_after(self, dt_s: float) -> float:
        """Return `turret_rad` dt_s >= 0 seconds from now; a wall stops no turret."""
        return self.turret_rad + self.turret.displacement_after(dt_s)

    def block(self) -> None:
        """Stop the wheels, because something is in front of the robot; steering and turret continue."""
        self.translation.halt()

    def feasible_angles(self, steering_rad: float, turret_rad: float) -> tuple[float, float]:
        """Return the angles themselves: steering and turret can have any two."""
        return steering_rad, turret_rad

    def set_angles(self, steering_rad: float, turret_rad: float) -> None:
        """Set the mechanical angles, as by hand; current motions continue from there."""
        self.steering_rad = steering_rad
        self.turret_rad = turret_rad

    def seek_zero(self) -> None:
        """Turn steering and turret to zero along the shorter arc, at the speeds set; the wheels stop.

        An axis whose speed was set to 0 turns at its top speed, because otherwise the search would never end.
        """
        self.translation.stop()
        # The shorter arc, from the mechanical angle to 0.
        for axis, angle in ((self.steering, self.steering_rad), (self.turret, self.turret_rad)):
            axis.move_by(-wrap_to_pi(angle), axis.speed or axis.limits.top_speed)

    def finish_zero(self) -> None:
        """End the search for zero: the rest of both angles is rounding and whole turns."""
        self.set_angles(0.0, 0.0)


class DifferentialDrive:
    """The drive of the Scout: two wheels side by side with speeds v_r and v_l, `track_in` inches apart.

        speed = (v_r + v_l) / 2        turn rate = (v_r - v_l) / track

    Attributes
    ----------
    steering_rad, turret_rad, bumper_frame_rad
        One angle, the mechanical heading, unwrapped: there is no turret, and the bumpers turn with the body.
    in_inches
        True for each axis that counts inches; the third axis does not exist.
    """

    in_inches = (True, True, False)

    def __init__(self, limits: tuple[AxisLimits, ...], ramps: bool, track_in: float) -> None:
        self.right, self.left, self._none = (Axis(limit, ramps) for limit in limits)
        self.track_in = track_in
        self.steering_rad = 0.0

    @property
    def turret_rad(self) -> float:
        """The heading."""
        return self.steering_rad

    bumper_frame_rad = turret_rad

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """In the order of the commands: right wheel, left wheel, and one that never moves."""
        return self.right, self.left, self._none

    def segment(self, max_s: float) -> ConstantAccelerationSegment:
        """Return the path of the next `max_s` seconds, or of fewer if something changes sooner.

        A segment also ends where the robot reverses, since its speed must not change sign.
        """
        # 1. The path until a wheel changes its acceleration.
        right_s, *right = self.right.current_phase
        left_s, *left = self.left.current_phase
        segment = path_segment(min(max_s, right_s, left_s), AxisRate(*right), AxisRate(*left), self.track_in)
        # 2. Until the robot reverses.
        return until_reversal(segment)

    @property
    def max_speed(self) -> float:
        """Upper bound of the robot's speed until the next command, in/s."""
        return max(self.right.max_speed, self.left.max_speed)

    @property
    def max_turn_rate(self) -> float:
        """Upper bound of the heading's turn rate until the next command, rad/s."""
        return (self.right.max_speed + self.left.max_speed) / self.track_in

    @property
    def velocity_bounds(self) -> tuple[float, float]:
        """Bounds of the velocity until the next command, lower <= 0 <= upper, in/s."""
        (right_lower, right_upper), (left_lower, left_upper) = self.right.velocity_bounds, self.left.velocity_bounds
        return 0.5 * (right_lower + left_lower), 0.5 * (right_upper + left_upper)

    def advance(self, dt_s: float) -> float:
        """Advance both wheels by dt_s seconds and return the turn of the turret: 0, there is none."""
        self.steering_rad += (self.right.advance(dt_s) - self.left.advance(dt_s)) / self.track_in
        return 0.0

    def turret_after(self, dt_s: float) -> float:
        """Return the heading dt_s >= 0 seconds from now, if no wall stops the robot."""
        apart_in = self.right.displacement_after(dt_s) - self.left.displacement_after(dt_s)
        return self.steering_rad + apart_in / self.track_in

    def block(self) -> None:
        """Stop both wheels, because something is in front of the robot."""
        self.right.halt()
        self.left.halt()

    def feasible_angles(self, steering_rad: float, turret_rad: float) -> tuple[float, float]:
        """Return the steering angle twice: steering and turret are one angle."""
        del turret_rad
        return steering_rad, steering_rad

    def set_angles(self, steering_rad: float, turret_rad: float) -> None:
        """Set the heading, as by hand; current motions continue from there."""
        del turret_rad
        self.steering_rad = steering_rad

    def seek_zero(self) -> None:
        """Stop the wheels: nothing can turn to a zero position."""
        self.right.stop()
        self.left.stop()

    def finish_zero(self) -> None:
        """Leave the heading unchanged."""


Drive = SynchroDrive | DifferentialDrive


def drive_state(drive: Drive) -> DriveState:
    """Return all of a drive that changes."""
    first, second, third = drive.axes
    return DriveState(drive.steering_rad, drive.turret_rad, (first.to_state(), second.to_state(), third.to_state()))


def set_drive_state(drive: Drive, state: DriveState) -> None:
    """Continue from a state; raise ValueError if it is beyond the limits of the axes."""
    drive.set_angles(state.steering_rad, state.turret_rad)
    for axis, axis_state in zip(drive.axes, state.axes, strict=True):
        axis.set_state(axis_state)


class ChassisState(NamedTuple):
    """The state of a chassis in a snapshot, inches and radians; `others`: rows x y radius of robots it can touch."""

    x_in: float
    y_in: float
    yaw_rad: float
    turret_lag_rad: float
    others: tuple[tuple[float, float, float], ...]


class Chassis:
    """The true position of one robot among walls. The drive's mechanical angles are passed in.

    x, y, yaw     true position of the axis and true turn of the body; noise turns the body, so the yaw drifts
    turret lag    the turret's turn beyond its mechanical angle, where its gears are inexact
    clearance     lower bound of the distance to the nearest obstacle: a shorter segment needs no contact test
    near          walls within SURVEY_IN at the last survey: the only ones examined until the robot has moved `surveyed`
                  inches; then all walls are searched again
    """

    def __init__(self, body: Body, walls: FloatArray, x_in: float, y_in: float) -> None:
        self.body = body
        self._walls = walls
        self._others: tuple[collision.Capsule, ...] = ()
        self.place(x_in, y_in)

    def place(self, x_in: float, y_in: float) -> None:
        """Set the robot down here with its body's yaw at 0; the position is not checked."""
        self._x_in = x_in
        self._y_in = y_in
        self._yaw_rad = 0.0
        self._lag_rad = 0.0
        self._forget_survey()

    def set_walls(self, walls: FloatArray) -> None:
        """Replace the walls (m, 4), rows x1 y1 x2 y2 in inches."""
        self._walls = walls
        self._forget_survey()

    def set_obstacles(self, discs: Sequence[tuple[float, float, float]]) -> None:
        """Replace the other robots that can be touched: rows x y radius in inches."""
        if discs or self._others:
            self._others = tuple(collision.Capsule.disc(*disc) for disc in discs)
            self._clearance_in = 0.0

    def _forget_survey(self) -> None:
        self._near: tuple[collision.Capsule, ...] = ()
        self._surveyed_in = 0.0
        self._clearance_in = 0.0

    def to_state(self) -> ChassisState:
        """Return all that changes, except for the survey, which can be repeated."""
        others = tuple((capsule.x1, capsule.y1, capsule.radius) for capsule in self._others)
        return ChassisState(self._x_in, self._y_in, self._yaw_rad, self._lag_rad, others)

    def set_state(self, state: ChassisState) -> None:
        """Continue from a state."""
        self._x_in, self._y_in = state.x_in, state.y_in
        self._yaw_rad, self._lag_rad = state.yaw_rad, state.turret_lag_rad
        self._forget_survey()
        self.set_obstacles(state.others)

    @property
    def position(self) -> tuple[float, float]:
        """(x, y) of the axis, inches."""
        return self._x_in, self._y_in

    def pose(self, steering_rad: float, turret_rad: float) -> Pose:
        """Return the true pose at these mechanical angles."""
        heading = wrap_to_2pi(self.heading(steering_rad))
        return Pose(self._x_in, self._y_in, heading, self.turret_direction(turret_rad))

    def turret_direction(self, turret_rad: float) -> float:
        """Return the true direction of the turret at this mechanical angle, [0, 2 pi)."""
        return wrap_to_2pi(turret_rad + self._lag_rad + self._yaw_rad)

    def heading(self, steering_rad: float) -> float:
        """Return the true direction of this mechanical angle against the body, such as the steering, unwrapped."""
        return steering_rad + self._yaw_rad

    def first_contact(self, segment: ConstantAccelerationSegment, steering_rad: float) -> collision.Contact | None:
        """Return the first contact on a segment that starts here at this mechanical steering angle, or None."""
        # Most segments are shorter than the clearance: nothing needs to be examined.
        distance = segment.length_bound(segment.duration_s)
        if distance == 0.0 or distance < self._clearance_in:
            return None
        capsules = self._within(distance)
        if not capsules:
            return None
        placed = collision.PlacedSegment(self._x_in, self._y_in, self.heading(steering_rad), segment)
        return collision.first_contact(placed, self.body.radius_in, capsules)

    def follow(self, segment: ConstantAccelerationSegment, time_s: float, steering_rad: float) -> tuple[float, float]:
        """Move `time_s` seconds along a segment that starts here; return (dx, dy) in inches."""
        # Moving reduces both bounds by at most the length of the path.
        dx, dy = segment.displacement(steering_rad + self._yaw_rad, time_s)
        self._x_in += dx
        self._y_in += dy
        distance = segment.length_bound(time_s)
        self._clearance_in -= distance
        self._surveyed_in -= distance
        return dx, dy

    def turn(self, body_rad: float, turret_rad: float = 0.0) -> None:
        """Turn the whole body, and the turret in addition to what its encoder counts."""
        self._yaw_rad += body_rad
        self._lag_rad += turret_rad

    def finish_zero(self) -> None:
        """Set the turret's lag to 0: its sensor has found the zero position."""
        self._lag_rad = 0.0

    def bumpers(self, frame_rad: float) -> int:
        """Return the pressed bumpers as bits; frame_rad is the angle of the bumpers against the yaw."""
        # Nothing can be that near.
        if self._clearance_in > collision.TOUCH_IN:
            return 0
        front = self.heading(frame_rad)
        vectors = (capsule.gap_to(0.0, self._x_in, self._y_in)[1:] for capsule in self._within(collision.TOUCH_IN))
        return collision.pressed_bumpers((atan2(-y, -x) - front for x, y in vectors), self.body.bumper_angles_rad)

    def _within(self, distance_in: float) -> list[collision.Capsule]:
        """Return the obstacles within a distance, and update the clearance."""
        x, y, radius = self._x_in, self._y_in, self.body.radius_in
        # 1. Search all walls again when an unsurveyed one might be that near.
        if self._surveyed_in <= distance_in:
            reach_in = radius + distance_in + SURVEY_IN
            self._near, nearest_other_in = collision.walls_within(x, y, reach_in, self._walls)
            self._surveyed_in = nearest_other_in - radius
        # 2. Of the surveyed walls and the other robots those within the distance.
        found, clearance = [], self._surveyed_in
        for capsule in (*self._near, *self._others):
            gap, _, _ = capsule.gap_to(radius, x, y)
            clearance = min(clearance, gap)
            if gap <= distance_in:
                found.append(capsule)
        self._clearance_in = clearance
        return found
