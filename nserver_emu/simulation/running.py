"""One simulated robot in time: its parts, and what a moment of time does to them. No socket, no clock, no wire units.

Two robots in one: the encoder robot is what the wheels were told and what State reports; the actual robot moves in the
map and drives the sensors. Time is cut at time-outs, flashes and changes of acceleration, so that no result depends on
the caller's steps (with noise: only which numbers are drawn, not their spread); in each piece first motion, then
contact, then sensors. Sonars fire inside a piece, from where the closed form says; only where motion draws chance or
a search for zero may end time is cut at firings too.
"""

from __future__ import annotations

from math import copysign

from nserver_emu.simulation.axis import TIME_TOLERANCE_S
from nserver_emu.simulation.chassis import Chassis
from nserver_emu.simulation.compass import Compass, last_reading_ps
from nserver_emu.simulation.contact import Ground
from nserver_emu.simulation.encoders import Encoders
from nserver_emu.simulation.individual import setup_of
from nserver_emu.simulation.infrared import InfraredRing
from nserver_emu.simulation.instants import NEVER_PS, PS_PER_S, to_s
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.noise import Identity, Purpose
from nserver_emu.simulation.passage import AT_REST, Moment, Passage
from nserver_emu.simulation.setup import IDEAL, RobotSetup
from nserver_emu.simulation.sighting import NOBODY, Eye, Lookout
from nserver_emu.simulation.sonar import DEFAULT_ORDER, DEFAULT_RATE, SonarRing
from nserver_emu.simulation.stretch import Stretch
from nserver_emu.simulation.track import Leg
from worlds.geometry import FloatArray
from worlds.world import StartPose


class RunningRobot:
    """A robot's parts as time passes. What it is told and what can be seen of it: SimulatedRobot (robot.py)."""

    def __init__(
        self,
        identity: Identity,
        start: StartPose,
        walls: FloatArray,
        model: RobotModel = N150,
        setup: RobotSetup = IDEAL,
        now_ps: int = 0,
        lookout: Lookout = NOBODY,
        own: int = 0,
        *,
        awake: bool = True,
    ) -> None:
        self.identity = identity
        self.model = model
        self.setup = self.began_as = setup = setup_of(model, setup)
        self._time_ps = now_ps
        self._timeout_ps = 0
        self._deadline_ps = NEVER_PS
        self.timed_out_s: float | None = None
        """When the time-out last struck, simulated time."""
        self._zeroing = False
        self._walls = walls
        self._track: list[Leg] | None = None
        self._lookout = lookout
        self._own = own
        self._drive = model.drive(setup.ramps)
        self._drive.put(start.steering_rad, start.turret_rad)
        self._encoders = Encoders(start.x_in, start.y_in)
        self._chassis = Chassis(model.body, Ground(walls), start.x_in, start.y_in)
        self._chance = identity.stream(Purpose.MOTION)
        self._exact = setup.moves_as_told
        self.sonar = SonarRing(model.body, setup.sonar, walls, identity.stream(Purpose.SONAR))
        self.infrared: InfraredRing | None = None
        if model.sees:
            light = identity.stream(Purpose.INFRARED)
            self.infrared = InfraredRing(model.body, setup.infrared, walls, now_ps, light)
        self.compass: Compass | None = None
        if model.compass:
            needle = identity.stream(Purpose.COMPASS)
            turret_rad = self._chassis.turret_direction(self._drive.turret_rad)
            self.compass = Compass(setup.compass, turret_rad, now_ps, needle)
        self.awake = False
        if awake:
            self.wake()

    def wake(self) -> None:
        """Power on what looks around, once: all sonars have a reading, and the ring runs."""
        self.awake = True
        self.sonar.fire_all(self._eye(), self._moment(self._time_ps))
        self.feed()
        self.sonar.configure(DEFAULT_RATE, DEFAULT_ORDER, self._time_ps)
        self._fire_due()

    @property
    def time_s(self) -> float:
        """Simulated time of the whole simulation."""
        return to_s(self._time_ps)

    @property
    def moving(self) -> tuple[bool, bool, bool]:
        """Which axes move."""
        first, second, third = self._drive.axes
        return first.moving, second.moving, third.moving

    def feed(self) -> None:
        """A command came: the time-out starts anew."""
        self._deadline_ps = self._time_ps + self._timeout_ps if self._timeout_ps else NEVER_PS

    def advance_to(self, end_ps: int) -> None:
        """Let time pass until an instant that is not before now."""
        while self._time_ps < end_ps:
            until = min(end_ps, self._deadline_ps)
            if self._zeroing or not self._exact:
                until = min(until, self.sonar.due_ps)
            if self.infrared is not None:
                until = min(until, self.infrared.due_ps)
            if self.compass is not None and until >= self.compass.due_ps:
                self._read_compass(self.compass, until)
            self._move((until - self._time_ps) / PS_PER_S)
            self._time_ps = until
            if self._zeroing:
                self._end_zero()
            if until == self._deadline_ps:
                self._expire()
            self._fire_due()

    def _stop_axes(self) -> None:
        for axis in self._drive.axes:
            axis.stop()

    def _expire(self) -> None:
        """The time-out: motion stops, but for a search for zero."""
        if self._zeroing:
            self.feed()
            return
        self._deadline_ps = NEVER_PS
        self.timed_out_s = self.time_s
        self._stop_axes()

    def _end_zero(self) -> None:
        if not any(self.moving):
            self._zeroing = False
            before_rad = self._drive.turret_rad
            self._drive.found_zero()
            self._carry_compass(before_rad)
            for axis in self._drive.axes:
                axis.count = 0.0
            self._chassis.found_zero()
            self._encoders.define_position(0.0, 0.0)
            self._encoders.define_angles(-self._drive.steering_rad, -self._drive.turret_rad)

    def _fire_due(self) -> None:
        while self.sonar.due_ps <= self._time_ps:
            self.sonar.fire_due(self._eye(), self._moment(self.sonar.due_ps))
        while self.infrared is not None and self.infrared.due_ps <= self._time_ps:
            self.infrared.flash_due(self._eye(), self._moment(self._time_ps).stamp)

    def _read_compass(self, compass: Compass, until_ps: int) -> None:
        """Its last reading up to an instant that this piece of time reaches, if one is due, before anything moves.

        Time is not cut for it: the drive tells how far the turret will have turned by then.
        """
        due_ps = last_reading_ps(until_ps)
        turret_rad = self._drive.turret_in((due_ps - self._time_ps) / PS_PER_S)
        compass.take(due_ps, self._chassis.turret_direction(turret_rad), turret_rad)

    def _carry_compass(self, before_rad: float) -> None:
        """The turret's angle was set, and not by turning."""
        if self.compass is not None:
            self.compass.carried(before_rad, self._drive.turret_rad)

    def _eye(self) -> Eye:
        return Eye(*self._chassis.outlook(self._drive.turret_rad), self._lookout.at(self._time_ps), self._own)

    def _moment(self, instant_ps: int) -> Moment:
        """The moment of what is read here and now."""
        turret_rad = self._encoders.turret(self._drive.turret_rad)
        return Moment(self._passage(AT_REST), 0.0, turret_rad, instant_ps / PS_PER_S)

    def _passage(self, stretch: Stretch) -> Passage:
        """A stretch that begins here and now, as the encoders know it."""
        drive, encoders = self._drive, self._encoders
        first, second, third = drive.axes
        heading_rad = encoders.heading(drive.steering_rad)
        return Passage(*encoders.place, heading_rad, stretch, (first.run, second.run, third.run))

    def _fire_along(self, stretch: Stretch, begin_s: float, taken_s: float) -> None:
        """Let the sonars fire that are due in the first seconds of a stretch, which is about to begin; `begin_s` of
        this piece of time are over. Who is due at its very end fires from what comes after."""
        sonar, due_ps, before_s = self.sonar, self.sonar.due_ps, taken_s - TIME_TOLERANCE_S
        into_s = (due_ps - self._time_ps) / PS_PER_S - begin_s
        if into_s >= before_s:
            return
        drive, chassis, encoders, passage = self._drive, self._chassis, self._encoders, self._passage(stretch)
        (x, y), heading = chassis.place, chassis.heading(drive.steering_rad)
        while into_s < before_s:
            into_s = max(into_s, 0.0)
            turret_rad = drive.turret_in(into_s)
            dx, dy = stretch.displacement(heading, into_s)
            eye = Eye(x + dx, y + dy, chassis.turret_direction(turret_rad), self._lookout.at(due_ps), self._own)
            sonar.fire_due(eye, Moment(passage, into_s, encoders.turret(turret_rad), due_ps / PS_PER_S))
            due_ps = sonar.due_ps
            into_s = (due_ps - self._time_ps) / PS_PER_S - begin_s

    def _move(self, span_s: float) -> None:
        """Let all axes run; the path is cut where they change their acceleration and where the robot is stopped."""
        left_s = span_s
        while left_s > 0.0:
            stretch = self._drive.stretch(left_s)
            if stretch.at_rest:
                self._fire_along(stretch, span_s - left_s, left_s)
                turned_rad = self._drive.advance(left_s)
                if not self._exact:
                    self._drift(0.0, turned_rad)
                return
            left_s -= self._glide(stretch, span_s - left_s)

    def _glide(self, stretch: Stretch, begin_s: float) -> float:
        """Follow a stretch that begins so long after now to its end or to where the robot is stopped; returns the
        seconds that took.

        Only the commanded motion stops the wheels. Where noise or a turn on the spot that goes astray pushes a robot
        into a wall it is held there for the stretch, wheels turning.
        """
        drive, chassis, duration = self._drive, self._chassis, stretch.duration_s
        steering_rad, told_in = drive.steering_rad, 0.0
        steady = driven = stretch
        if not self._exact:
            steady = self.setup.odometry.driven(stretch, drive)
            driven = self.setup.motion.disturbed(steady, self._chance)
        heading = chassis.heading(steering_rad)
        contact = chassis.first_contact(driven, steering_rad)
        blocked = False
        free_s = duration
        if contact is not None:
            free_s, told_in = contact.time_s, stretch.distance_at(duration)
            pressing = driven is steady or contact.pressed_by(heading + driven.turn_at(free_s), told_in)
            blocked = told_in != 0.0 and pressing
        taken_s = free_s if blocked else duration
        if self._track is not None:
            begin_ps = self._time_ps + round(begin_s * PS_PER_S)
            self._track.append(Leg(begin_ps, *chassis.place, heading, driven, free_s))
        self._fire_along(stretch, begin_s, taken_s)
        way = chassis.follow(driven, free_s, steering_rad)
        if driven is stretch and taken_s == free_s and self._encoders.heading(steering_rad) == heading:
            self._encoders.shift(*way)
        else:
            self._encoders.follow(stretch, taken_s, steering_rad)
        turned_rad = drive.advance(taken_s)
        if not self._exact:
            self._drift(driven.turn_at(taken_s) - stretch.turn_at(taken_s), turned_rad)
        if blocked:
            self._encoders.slip(copysign(self.setup.odometry.slip_in, told_in), drive.steering_rad)
            drive.block()
        return taken_s

    def _drift(self, body_rad: float, counted_rad: float) -> None:
        """What no encoder counts: a turn of the body, and of the turret where its gears err."""
        self._chassis.turn(body_rad)
        self._chassis.turn_turret((self.setup.odometry.scales[2] - 1.0) * counted_rad)
