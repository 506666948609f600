"""Drives: what the axes of a model do to the robot. Mechanical angles live here; places and encoders do not.

    SynchroDrive         translation, steering, turret: three wheels steer and roll together, the body never turns
    DifferentialDrive    right wheel, left wheel: the body turns with the heading, and what sits on it

A drive answers the robot in the same words whatever its wheels: `stretch` for the path, `advance` to let time pass,
three mechanical angles against the body's yaw; `wheels` and `path` translate between path and axes, for whoever makes
the wheels err. No noise, no contact, no clock.

The actual robot: a disc that moves in the map and stops where it touches. Knows no commands and no encoders.

x, y, yaw     true place of the axis and true turn of the body; noise turns the body, so the yaw drifts
lag           how far the turret is off its mechanical angle, where its gears err
room          no less than the way to the nearest thing: while a stretch is shorter, nothing is looked at
near          the walls within SURVEY_IN when the robot last looked around, the only ones looked at for as long as it
              has not gone that far; then it looks around among all
"""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2
from typing import Final, NamedTuple

from nserver_emu.simulation.axis import TIME_TOLERANCE_S, Axis, AxisLimits
from nserver_emu.simulation.collision import TOUCH_IN, Contact, Course, Ground, Thing, first_contact, pressed
from nserver_emu.simulation.segments import Pose, Stretch, once_round, short_way
from worlds.robots import Body

NO_AXIS: Final = AxisLimits(
    top_speed=0.0,
    top_acceleration=1.0,
    least_acceleration=1.0,
    speed=0.0,
    acceleration=1.0,
    resolution=0.0,
)
"""The limits of an axis that is not there: it takes every command and never moves."""


class Rate(NamedTuple):
    """Velocity and acceleration of an axis."""

    velocity: float
    acceleration: float

    def times(self, scale: float) -> Rate:
        """So many times as fast."""
        return Rate(self.velocity * scale, self.acceleration * scale)


class SynchroDrive:
    """The drive of the N150 and N200.

    steering_rad, turret_rad    mechanical angles against the body, unwrapped; 0 is the bumpers' zero
    bumper_frame_rad            angle of the bumpers against the body's yaw: the body does not turn
    rolls                       which axes count inches; the others count radians
    """

    bumper_frame_rad = 0.0
    rolls = (True, False, False)

    def __init__(self, limits: tuple[AxisLimits, ...], ramps: bool) -> None:
        self.translation, self.steering, self.turret = (Axis(limit, ramps) for limit in limits)
        self.steering_rad = 0.0
        self.turret_rad = 0.0

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """In the order of the commands: translation, steering, turret."""
        return self.translation, self.steering, self.turret

    def stretch(self, longest_s: float) -> Stretch:
        """The path of the next `longest_s` seconds, or of less where the wheels change their acceleration sooner."""
        rolling_s, speed, acceleration = self.translation.pace
        steering_s, turn_rate, turn_acceleration = self.steering.pace
        return Stretch(min(longest_s, rolling_s, steering_s), speed, acceleration, turn_rate, turn_acceleration)

    @property
    def fastest(self) -> float:
        """No less than the robot's speed at any time until the next command, in/s."""
        return self.translation.fastest

    @property
    def fastest_turn(self) -> float:
        """No less than the heading's turn rate at any time until the next command, rad/s."""
        return self.steering.fastest

    @property
    def extremes(self) -> tuple[float, float]:
        """No more than the least and no less than the greatest speed until the next command, nor than 0, in/s."""
        return self.translation.extremes

    def wheels(self, stretch: Stretch) -> tuple[Rate, Rate]:
        """What translation and steering do on a stretch."""
        return Rate(stretch.speed, stretch.acceleration), Rate(stretch.turn_rate, stretch.turn_acceleration)

    def path(self, duration_s: float, first: Rate, second: Rate) -> Stretch:
        """The stretch that translation and steering make; the inverse of `wheels`."""
        return Stretch(duration_s, *first, *second)

    def advance(self, dt_s: float) -> float:
        """Let dt_s seconds pass in all axes; returns how far the turret turned, radians."""
        self.translation.advance(dt_s)
        self.steering_rad += self.steering.advance(dt_s)
        turned = self.turret.advance(dt_s)
        self.turret_rad += turned
        return turned

    def turret_in(self, dt_s: float) -> float:
        """`turret_rad` as it will be dt_s >= 0 seconds from now; a wall stops no turret."""
        return self.turret_rad + self.turret.way_in(dt_s)

    def block(self) -> None:
        """Something is in the way: the wheels no longer roll; steering and turret go on."""
        self.translation.halt()

    def possible(self, steering_rad: float, turret_rad: float) -> tuple[float, float]:
        """Steering and turret can stand at any two angles."""
        return steering_rad, turret_rad

    def put(self, steering_rad: float, turret_rad: float) -> None:
        """Set the mechanical angles, as hands would; motions under way go on from there."""
        self.steering_rad = steering_rad
        self.turret_rad = turret_rad

    def seek_zero(self) -> None:
        """Turn steering and turret to the bumpers' zero, the short way, at the speeds set; the wheels stop.

        An axis whose speed was set to 0 turns at its top speed: a robot that never finds its zero helps nobody.
        """
        self.translation.stop()
        for axis, angle in ((self.steering, self.steering_rad), (self.turret, self.turret_rad)):
            axis.move_by(-short_way(angle), axis.speed or axis.limits.top_speed)

    def found_zero(self) -> None:
        """The search is over: what is left of both angles is rounding and whole turns."""
        self.put(0.0, 0.0)


class DifferentialDrive:
    """The drive of the Scout: two wheels side by side, their speeds v_r and v_l, `track_in` inches apart.

        speed = (v_r + v_l) / 2        turn rate = (v_r - v_l) / track

    heading_rad     mechanical heading, unwrapped; steering, turret and the frame of the bumpers are this one angle
    rolls           which axes count inches; the third is not there
    """

    rolls = (True, True, False)

    def __init__(self, limits: tuple[AxisLimits, ...], ramps: bool, track_in: float) -> None:
        self.right, self.left, self._none = (Axis(limit, ramps) for limit in limits)
        self.track_in = track_in
        self.heading_rad = 0.0

    @property
    def steering_rad(self) -> float:
        """The heading."""
        return self.heading_rad

    @property
    def turret_rad(self) -> float:
        """The heading: there is no turret."""
        return self.heading_rad

    @property
    def bumper_frame_rad(self) -> float:
        """The heading: bumpers turn with the body."""
        return self.heading_rad

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """In the order of the commands: right wheel, left wheel, and one that never moves."""
        return self.right, self.left, self._none

    def stretch(self, longest_s: float) -> Stretch:
        """The path of the next `longest_s` seconds, or of less where a wheel changes its acceleration or the robot its
        direction sooner."""
        right_s, *right = self.right.pace
        left_s, *left = self.left.pace
        stretch = self.path(min(longest_s, right_s, left_s), Rate(*right), Rate(*left))
        if stretch.speed * stretch.acceleration < 0.0:
            turns_back_s = -stretch.speed / stretch.acceleration
            if TIME_TOLERANCE_S < turns_back_s < stretch.duration_s:
                return stretch._replace(duration_s=turns_back_s)
        return stretch

    @property
    def fastest(self) -> float:
        """No less than the robot's speed at any time until the next command, in/s."""
        return max(self.right.fastest, self.left.fastest)

    @property
    def fastest_turn(self) -> float:
        """No less than the heading's turn rate at any time until the next command, rad/s."""
        return (self.right.fastest + self.left.fastest) / self.track_in

    @property
    def extremes(self) -> tuple[float, float]:
        """No more than the least and no less than the greatest speed until the next command, nor than 0, in/s."""
        (least, most), (left_least, left_most) = self.right.extremes, self.left.extremes
        return 0.5 * (least + left_least), 0.5 * (most + left_most)

    def wheels(self, stretch: Stretch) -> tuple[Rate, Rate]:
        """What the right and the left wheel do on a stretch."""
        half = 0.5 * self.track_in
        faster, gaining = half * stretch.turn_rate, half * stretch.turn_acceleration
        return (
            Rate(stretch.speed + faster, stretch.acceleration + gaining),
            Rate(stretch.speed - faster, stretch.acceleration - gaining),
        )

    def path(self, duration_s: float, first: Rate, second: Rate) -> Stretch:
        """The stretch that the right and the left wheel make; the inverse of `wheels`."""
        return Stretch(
            duration_s,
            0.5 * (first.velocity + second.velocity),
            0.5 * (first.acceleration + second.acceleration),
            (first.velocity - second.velocity) / self.track_in,
            (first.acceleration - second.acceleration) / self.track_in,
        )

    def advance(self, dt_s: float) -> float:
        """Let dt_s seconds pass in both wheels; returns how far a turret turned: there is none, 0."""
        self.heading_rad += (self.right.advance(dt_s) - self.left.advance(dt_s)) / self.track_in
        return 0.0

    def turret_in(self, dt_s: float) -> float:
        """The heading as it will be dt_s >= 0 seconds from now, if no wall stops it."""
        return self.heading_rad + (self.right.way_in(dt_s) - self.left.way_in(dt_s)) / self.track_in

    def block(self) -> None:
        """Something is in the way: no wheel rolls any more."""
        self.right.halt()
        self.left.halt()

    def possible(self, steering_rad: float, turret_rad: float) -> tuple[float, float]:
        """Steering and turret are one angle, that of the steering."""
        del turret_rad
        return steering_rad, steering_rad

    def put(self, steering_rad: float, turret_rad: float) -> None:
        """Set the heading, as hands would; motions under way go on from there."""
        del turret_rad
        self.heading_rad = steering_rad

    def seek_zero(self) -> None:
        """There is nothing that could turn to a zero: the wheels stop."""
        self.right.stop()
        self.left.stop()

    def found_zero(self) -> None:
        """The heading stays what it is."""


Drive = SynchroDrive | DifferentialDrive
"""Any of them."""


SURVEY_IN: Final = 12.0
"""A second's way between two looks around, and few walls near: both cost."""


class Chassis:
    """The true place of one robot on its ground. Mechanical angles are handed in by whoever owns the drive."""

    def __init__(self, body: Body, ground: Ground, x_in: float, y_in: float) -> None:
        self.body = body
        self._ground = ground
        self._beside: tuple[Thing, ...] = ()
        self.put(x_in, y_in)

    def put(self, x_in: float, y_in: float) -> None:
        """Lift the robot and set it down here, its body's yaw at 0. Nothing says that the place is free."""
        self._x_in = x_in
        self._y_in = y_in
        self._yaw_rad = 0.0
        self._lag_rad = 0.0
        self._look_anew()

    def enter(self, ground: Ground) -> None:
        """From now on these are the walls."""
        self._ground = ground
        self._look_anew()

    def stand_beside(self, discs: Iterable[tuple[float, float, float]]) -> None:
        """From now on these discs, x y radius in inches, can be touched, and no others."""
        self._beside = tuple(Thing.disc(*disc) for disc in discs)
        self._room_in = 0.0

    @property
    def alone(self) -> bool:
        """Whether no disc can be touched."""
        return not self._beside

    def _look_anew(self) -> None:
        self._near: tuple[Thing, ...] = ()
        self._rest_in = 0.0
        self._room_in = 0.0

    @property
    def place(self) -> tuple[float, float]:
        """(x, y) of the axis, inches."""
        return self._x_in, self._y_in

    def pose(self, steering_rad: float, turret_rad: float) -> Pose:
        """The true pose at these mechanical angles."""
        yaw = self._yaw_rad
        turret = turret_rad + self._lag_rad + yaw
        return Pose(self._x_in, self._y_in, once_round(steering_rad + yaw), once_round(turret))

    def outlook(self, turret_rad: float) -> tuple[float, float, float]:
        """From where and where to the turret looks at this mechanical angle: x, y in inches, direction [0, 2 pi)."""
        return self._x_in, self._y_in, once_round(turret_rad + self._lag_rad + self._yaw_rad)

    def turret_direction(self, turret_rad: float) -> float:
        """Where the turret truly points at this mechanical angle, [0, 2 pi)."""
        return once_round(turret_rad + self._lag_rad + self._yaw_rad)

    def heading(self, steering_rad: float) -> float:
        """The true heading at this mechanical steering angle, unwrapped."""
        return steering_rad + self._yaw_rad

    def first_contact(self, stretch: Stretch, steering_rad: float) -> Contact | None:
        """Where this stretch, begun here at this mechanical steering angle, first touches something; None: nowhere."""
        way = stretch.length_bound(stretch.duration_s)
        if way == 0.0 or way < self._room_in:
            return None
        things = self._within(way)
        if not things:
            return None
        course = Course(self._x_in, self._y_in, self.heading(steering_rad), stretch)
        return first_contact(course, self.body.radius_in, things)

    def follow(self, stretch: Stretch, time_s: float, steering_rad: float) -> tuple[float, float]:
        """Move `time_s` seconds along a stretch begun at this mechanical steering angle; returns (dx, dy), inches."""
        dx, dy = stretch.displacement(steering_rad + self._yaw_rad, time_s)
        self._x_in += dx
        self._y_in += dy
        way = stretch.length_bound(time_s)
        self._room_in -= way
        self._rest_in -= way
        return dx, dy

    def turn(self, angle_rad: float) -> None:
        """Turn the whole body."""
        self._yaw_rad += angle_rad

    def turn_turret(self, angle_rad: float) -> None:
        """Turn the turret besides what its encoder counts."""
        self._lag_rad += angle_rad

    def found_zero(self) -> None:
        """The turret stands at its zero, as the sensor there says."""
        self._lag_rad = 0.0

    def front(self, frame_rad: float) -> float:
        """The direction of bumper 0 in the map, radians; frame_rad as in `bumpers`."""
        return once_round(frame_rad + self._yaw_rad)

    def bumpers(self, frame_rad: float) -> int:
        """Bit i is set while bumper i is touched; frame_rad is the angle of the bumpers against the yaw."""
        if self._room_in > TOUCH_IN:
            return 0
        ahead = frame_rad + self._yaw_rad
        vectors = (thing.away(0.0, self._x_in, self._y_in)[1:] for thing in self._within(TOUCH_IN))
        return pressed((atan2(-y, -x) - ahead for x, y in vectors), self.body.bumper_angles_rad)

    def _within(self, way_in: float) -> list[Thing]:
        """What is no farther away than that; notes how much room there is."""
        x, y, radius = self._x_in, self._y_in, self.body.radius_in
        if self._rest_in <= way_in:
            self._near, rest_in = self._ground.near(x, y, radius + way_in + SURVEY_IN)
            self._rest_in = rest_in - radius
        things, room = [], self._rest_in
        for thing in (*self._near, *self._beside):
            gap, _, _ = thing.away(radius, x, y)
            room = min(room, gap)
            if gap <= way_in:
                things.append(thing)
        self._room_in = room
        return things
