"""The actual robot: a disc that moves in the map and stops where it touches. Knows no commands and no encoders.

x, y, yaw     true place of the axis and true turn of the body; noise turns the body, so the yaw drifts
lag           how far the turret is off its mechanical angle, where its gears err
room          no less than the way to the nearest thing: while a stretch is shorter, nothing is looked at
near          the walls within SURVEY_IN when the robot last looked around, the only ones looked at for as long as it
              has not gone that far; then it looks around among all
"""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2
from typing import Final

from nserver_emu.simulation.angles import once_round
from nserver_emu.simulation.bumpers import pressed
from nserver_emu.simulation.contact import TOUCH_IN, Contact, Course, Ground, Thing, first_contact
from nserver_emu.simulation.poses import Pose
from nserver_emu.simulation.stretch import Stretch
from worlds.bodies import Body

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
