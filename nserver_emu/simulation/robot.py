"""One simulated robot in time: its parts, and what a moment of time does to them. No socket, no clock, no wire units.

Two robots in one: the encoder robot is what the wheels were told and what State reports; the actual robot moves in the
map and drives the sensors. Time is cut at time-outs, flashes and changes of acceleration, so that no result depends on
the caller's steps (with noise: only which numbers are drawn, not their spread); in each piece first motion, then
contact, then sensors. Sonars fire inside a piece, from where the closed form says; only where motion draws chance or
a search for zero may end time is cut at firings too.

One simulated robot as others have it: what can be seen of it, its commands, its surroundings.

What a moment of time does to it is in running.py. No socket, no clock, no wire units.

The batteries: 12 V that last about six hours. Pure: time in, volts out; both batteries drain alike.

Decision of ours, for no source gives the curve: from 12.0 V down to 10.8 V in six hours on a straight line, and no
lower; driving costs nothing extra.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import copysign
from typing import Final

from nserver_emu.simulation.axis import TIME_TOLERANCE_S, Command
from nserver_emu.simulation.collision import Ground
from nserver_emu.simulation.compass import Compass, last_reading_ps
from nserver_emu.simulation.drive import Chassis
from nserver_emu.simulation.infrared import InfraredRing
from nserver_emu.simulation.laser import ranges, thinned
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.noise import IDEAL, Identity, Purpose, RobotSetup, setup_of
from nserver_emu.simulation.odometry import Encoders
from nserver_emu.simulation.segments import (
    AT_REST,
    NEVER_PS,
    PS_PER_S,
    Leg,
    Moment,
    Passage,
    Pose,
    Stretch,
    Velocities,
    to_ps,
    to_s,
)
from nserver_emu.simulation.sonar import DEFAULT_ORDER, DEFAULT_RATE, SonarRing
from nserver_emu.simulation.spatial_hash import Disc, Reach, reach, way_in
from nserver_emu.simulation.visibility import NOBODY, Eye, Lookout
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


class SimulatedRobot(RunningRobot):
    """A robot in a world. Three numbers of a command go to the axes in their order: translation, steering, turret
    (Scout: right wheel, left wheel, none), in inches where `model.rolls`, else in radians.

    Every command feeds the time-out; whoever serves questions calls `feed` for them. Values out of range are clamped
    silently. A motion that is blocked is over: the wheels wait for the next command.
    """

    # What can be seen

    @property
    def encoder(self) -> Pose:
        """Where the robot believes it is: what State reports."""
        return self._encoders.pose(self._drive.steering_rad, self._drive.turret_rad)

    @property
    def actual(self) -> Pose:
        """Where the robot is."""
        return self._chassis.pose(self._drive.steering_rad, self._drive.turret_rad)

    @property
    def disc(self) -> Disc:
        """What the robot is to others: x, y, radius in inches."""
        return (*self._chassis.place, self.model.body.radius_in)

    def disc_at(self, instant_ps: int) -> Disc:
        """The disc at an instant since `begin_track`."""
        if not self._track:
            return self.disc
        for leg in reversed(self._track):
            if leg.begin_ps <= instant_ps:
                break
        x, y = leg.place((instant_ps - leg.begin_ps) / PS_PER_S)
        return x, y, self.model.body.radius_in

    def reach_in(self, span_s: float) -> float:
        """No less than it goes within some seconds if no command comes, inches; 0 only where it stays. Noise may take
        it farther, but not once in a thousand million times."""
        return way_in(self._drive, None if self._exact else self.setup, span_s)

    def reach(self, span_s: float) -> Reach:
        """The same by directions."""
        drive = self._drive
        return reach(drive, None if self._exact else self.setup, self._chassis.heading(drive.steering_rad), span_s)

    @property
    def velocities(self) -> Velocities:
        """As the encoders show them, by axis; from the command to the end of a motion never 0."""
        first, second, third = self._drive.axes
        return first.shown_velocity, second.shown_velocity, third.shown_velocity

    @property
    def accelerations(self) -> Velocities:
        """How the axes change their velocities now, by axis and per second; 0 where they jump."""
        first, second, third = self._drive.axes
        return first.phase_acceleration, second.phase_acceleration, third.phase_acceleration

    @property
    def counts(self) -> tuple[float, float, float]:
        """How far each axis went since power-on or the last `zero`, the ways back taken off."""
        first, second, third = self._drive.axes
        return first.count, second.count, third.count

    @property
    def bumpers(self) -> int:
        """Bit i is set while bumper i touches something."""
        return self._chassis.bumpers(self._drive.bumper_frame_rad)

    @property
    def front_rad(self) -> float:
        """Where bumper 0 really points in the map: the body turns with the wheels of a Scout, and astray with noise."""
        return self._chassis.front(self._drive.bumper_frame_rad)

    @property
    def zeroing(self) -> bool:
        """True from `zero` until it is done, or until another motion command took its place."""
        return self._zeroing

    def still(self, axes: Iterable[int]) -> bool:
        """Whether none of these axes (0, 1, 2) moves; True for none at all."""
        moving = self.moving
        return not any(moving[axis] for axis in axes)

    # Commands: motion

    def set_velocities(self, first: float, second: float, third: float) -> None:
        """Run at these velocities until the next motion command or the time-out. C: vm."""
        self._take_over()
        for axis, velocity in zip(self._drive.axes, (first, second, third), strict=True):
            axis.move_at(velocity)

    def move_relative(self, first: float, second: float, third: float) -> None:
        """Go these ways, each axis at its speed, all at once. C: pr."""
        self._take_over()
        for axis, way in zip(self._drive.axes, (first, second, third), strict=True):
            axis.move_by(way)

    def command_axis(self, axis: int, command: int, value: float) -> None:
        """One axis of mv: 0 leave, 1 velocity, 2 relative, 3 limp, 4 set acceleration, 5 set speed.

        Raises ValueError for other commands and IndexError for other axes than 0, 1, 2.
        """
        self._drive.axes[axis].command(Command(command), value)
        self.feed()
        if command in (Command.VELOCITY, Command.RELATIVE, Command.LIMP):
            self._zeroing = False

    def stop(self) -> None:
        """Brake and hold. C: st."""
        self._take_over()
        self._stop_axes()

    def limp(self) -> None:
        """Let go of all axes. C: lp."""
        self._take_over()
        for axis in self._drive.axes:
            axis.limp()

    def zero(self) -> None:
        """Turn steering and turret to the bumpers' zero; then the encoders read 0. `zeroing` tells when. C: zr.

        The time-out waits until it is done, for the client waits as well.
        """
        self._take_over()
        self._drive.seek_zero()
        self._zeroing = True
        self._end_zero()

    # Commands: settings

    def set_speeds(self, first: float, second: float, third: float) -> None:
        """Speeds of relative motions from the next one on. C: sp."""
        self.feed()
        for axis, speed in zip(self._drive.axes, (first, second, third), strict=True):
            axis.set_speed(speed)

    def set_accelerations(self, first: float, second: float, third: float) -> None:
        """Accelerations from the next motion on; no effect where axes jump. C: ac."""
        self.feed()
        for axis, acceleration in zip(self._drive.axes, (first, second, third), strict=True):
            axis.set_acceleration(acceleration)

    def define_position(self, x_in: float, y_in: float) -> None:
        """The encoders call this place (x, y); the robot stays where it is. C: dp."""
        self.feed()
        self._encoders.define_position(x_in, y_in)

    def define_angles(self, steering_rad: float, turret_rad: float) -> None:
        """The encoders call these directions of steering and turret so; nothing turns. C: da."""
        self.feed()
        steering, turret = self._drive.possible(steering_rad, turret_rad)
        self._encoders.define_angles(steering - self._drive.steering_rad, turret - self._drive.turret_rad)

    def place(self, x_in: float, y_in: float, steering_rad: float, turret_rad: float) -> None:
        """Set the robot down here, encoders and all, its body as at power-on: yaw 0. C: place_robot.

        Motions go on from there; a search for zero under way is given up. Whether the place is free is the caller's
        to ask: a robot set into a wall can only leave it.
        """
        self.feed()
        self._zeroing = False
        before_rad = self._drive.turret_rad
        self._drive.put(steering_rad, turret_rad)
        self._carry_compass(before_rad)
        self._chassis.put(x_in, y_in)
        self.sonar.carried()
        self._encoders = Encoders(x_in, y_in)

    def set_timeout(self, seconds: float) -> None:
        """No command for more than this stops the motion; 0 or less: never. C: conf_tm."""
        self._timeout_ps = to_ps(max(seconds, 0.0))
        self.feed()

    def configure_sonars(self, rate: int, order: Sequence[int]) -> None:
        """Restart the ring at rate x 4 ms a sonar; order ends at 255. Its first sonar fires now. C: conf_sn."""
        self.feed()
        self.sonar.configure(rate, order, self._time_ps)
        self._fire_due()

    def configure_infrareds(self, history: int, order: Sequence[int]) -> None:
        """Take history (tenths) and sensors of the infrared ring; it flashes now. C: conf_ir."""
        self.feed()
        if self.infrared is not None:
            self.infrared.configure(history, order, self._time_ps)
            self._fire_due()

    def configure_compass(self, mode: int) -> None:
        """Switch the compass, where there is one; raises ValueError for no mode. C: conf_cp."""
        self.feed()
        if self.compass is not None:
            self.compass.configure(mode, self._drive.turret_rad)

    def err_as(self, setup: RobotSetup) -> None:
        """From now on motion strays and sensors err as this setup says; what was sensed before was sensed before.

        Its ramps and its clock are not taken up: axes move, and time is told, as since power-on.
        """
        self.setup = replace(setup, ramps=self.setup.ramps, clock_step_s=self.setup.clock_step_s)
        self._exact = setup.moves_as_told
        self.sonar.hear_as(setup.sonar)
        if self.infrared is not None:
            self.infrared.see_as(setup.infrared)
        if self.compass is not None:
            self.compass.noise = setup.compass

    def look_with_laser(self, columns: int = 0) -> FloatArray:
        """What the columns of the laser see now (482,), inches from the front of the turret; inf for nothing.

        columns    how many of them count, 0: all
        """
        return thinned(ranges(self._eye(), self._walls, self.model.body), columns)

    # Surroundings

    def stand_beside(self, discs: Sequence[Disc]) -> None:
        """From now on these discs, x y radius in inches, can be touched, and no others."""
        if discs or not self._chassis.alone:
            self._chassis.stand_beside(discs)

    def join(self, lookout: Lookout, own: int) -> None:
        """From now on sensors see the robots that this lookout tells of, but for row `own`: that is this one."""
        self._lookout = lookout
        self._own = own

    def begin_track(self) -> None:
        """From now on the robot keeps where it comes along, for `disc_at`."""
        self._track = []

    def enter(self, walls: FloatArray) -> None:
        """From now on these are the walls (m, 4), rows x1 y1 x2 y2 in inches."""
        self._walls = walls
        self.sonar.surround(walls)
        if self.infrared is not None:
            self.infrared.surround(walls)
        self._chassis.enter(Ground(walls))

    def _take_over(self) -> None:
        """A motion command came: it ends what was under way."""
        self.feed()
        self._zeroing = False


FULL_V: Final = 12.0
EMPTY_V: Final = 10.8
LASTS_S: Final = 6 * 3600.0


def battery_v(time_s: float) -> float:
    """Volts, so many seconds after the batteries were full."""
    return max(EMPTY_V, FULL_V - (FULL_V - EMPTY_V) * time_s / LASTS_S)
