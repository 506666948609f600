"""One simulated robot as others have it: what can be seen of it, its commands, its surroundings.

What a moment of time does to it is in running.py. No socket, no clock, no wire units.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from nserver_emu.simulation.axis import Command
from nserver_emu.simulation.contact import Ground
from nserver_emu.simulation.encoders import Encoders
from nserver_emu.simulation.instants import PS_PER_S, to_ps
from nserver_emu.simulation.laser import ranges, thinned
from nserver_emu.simulation.poses import Pose, Velocities
from nserver_emu.simulation.reach import Reach, reach, way_in
from nserver_emu.simulation.running import RunningRobot
from nserver_emu.simulation.setup import RobotSetup
from nserver_emu.simulation.sighting import Lookout
from nserver_emu.simulation.standing import Disc
from worlds.geometry import FloatArray


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
