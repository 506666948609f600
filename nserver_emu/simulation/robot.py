"""A simulated robot: drive, chassis, encoders and sensors, and how they advance in time.

There are two poses: the encoder pose follows the commanded motion and is reported in State; the actual pose moves in
the map and determines what sensors measure. Time is divided at the time-out, at infrared flashes and at changes of
acceleration, so that no result depends on the caller's steps (with noise, only which numbers are drawn, not their
distribution). In each piece come motion, contact, sensors. Sonars fire inside a piece, at poses from the closed form;
only where the motion draws noise or a search for zero may end is time divided at firings too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import copysign, cos, sin
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation import segments, sensors
from nserver_emu.simulation.axis import AXIS_MOTIONS, TIME_TOLERANCE_S, Command
from nserver_emu.simulation.collision import PlacedSegment
from nserver_emu.simulation.drive import Chassis, ChassisState, DriveState, drive_state, set_drive_state
from nserver_emu.simulation.models import N150, RobotModel
from nserver_emu.simulation.multi_robot import STATIONARY, Disc, SweptBounds
from nserver_emu.simulation.noise import IDEAL, Purpose, RngFactory, RobotSetup, apply_model
from nserver_emu.simulation.odometry import Encoders, EncoderState
from nserver_emu.simulation.segments import PS_PER_S, TIME_MAX_PS, ConstantAccelerationSegment, SegmentTime, to_ps, to_s
from nserver_emu.simulation.sensors import Compass, CompassState, InfraredRing, InfraredState, last_reading_ps, ranges
from nserver_emu.simulation.sonar import SonarRing, SonarState
from nserver_emu.simulation.visibility import NO_OTHERS, PositionProvider, SensorPose
from worlds.geometry import FloatArray
from worlds.world import StartPose

FULL_V: Final = 12.0
EMPTY_V: Final = 10.8
LIFETIME_S: Final = 6 * 3600.0
"""The manual gives 12 V and about six hours; the linear decrease is an assumption."""

MIN_TIMEOUT_PS: Final = PS_PER_S // 1000
"""Shortest time-out of a restored robot: bounds the number of pieces that time is divided into."""


NOISE_SIGMAS: Final = 6.0
"""Standard deviations of motion noise that bounds of the motion allow for: one in 1e9 draws goes beyond."""


def battery_v(time_s: float) -> float:
    """Return the voltage of the batteries, so many seconds after they were full; driving costs nothing extra."""
    return max(EMPTY_V, FULL_V - (FULL_V - EMPTY_V) * time_s / LIFETIME_S)


class LaserScan(NamedTuple):
    """The last scan of the laser, which a robot that stands sends again and again, and what it depends on."""

    pose: SensorPose
    walls: FloatArray
    ranges_in: FloatArray


class RngState(NamedTuple):
    """The state of a random stream (numpy's PCG64)."""

    state: int
    inc: int
    has_uint32: int
    uinteger: int


def _rng_state(rng: np.random.Generator) -> RngState:
    state = rng.bit_generator.state
    return RngState(state["state"]["state"], state["state"]["inc"], state["has_uint32"], state["uinteger"])


def _set_rng_state(rng: np.random.Generator, state: RngState) -> None:
    rng.bit_generator.state = {
        "bit_generator": "PCG64", "state": {"state": state.state, "inc": state.inc},
        "has_uint32": state.has_uint32, "uinteger": state.uinteger,
    }  # fmt: skip


@dataclass(frozen=True, slots=True)
class RobotState:
    """The state of a robot in a snapshot; fields as those of `SimulatedRobot`."""

    model: RobotModel
    setup: RobotSetup
    initial_setup: RobotSetup
    timeout_ps: int
    deadline_ps: int
    timed_out_s: float | None
    zeroing: bool
    powered: bool
    drive: DriveState
    encoders: EncoderState
    chassis: ChassisState
    sonar: SonarState
    infrared: InfraredState | None
    compass: CompassState | None
    rngs: tuple[RngState, ...]


class SimulatedRobot:
    """A robot in a world.

    The three numbers of a command are for the axes in their order: translation, steering, turret (Scout: right wheel,
    left wheel, none), in inches where `model.in_inches`, otherwise in radians. Values out of range are clamped
    silently. Motion commands restart the time-out; for settings and queries servers call `feed`, if they come from the
    client that drives. A blocked motion has ended: the wheels wait for the next command.

    Attributes
    ----------
    rng_factory
        Number of the robot and seed of the run.
    setup, initial_setup
        Settings in force, and those at power-on.
    timed_out_s
        Simulated time of the last time-out; None before the first.
    sonar, infrared, compass
        Sensors; None where the model has none.
    powered
        True once the sensors are on.
    """

    def __init__(self, rng_factory: RngFactory, start: StartPose, walls: FloatArray, model: RobotModel = N150,
                 setup: RobotSetup = IDEAL, now_ps: int = 0, positions: PositionProvider = NO_OTHERS,
                 self_index: int = 0, *, powered: bool = True) -> None:
        self.rng_factory = rng_factory
        self.model = model
        self.setup = self.initial_setup = setup = apply_model(model, setup)
        self._walls = walls
        self._positions = positions
        self._self_index = self_index
        # Time and time-out.
        self._time_ps = now_ps
        self._timeout_ps = 0
        self._deadline_ps = TIME_MAX_PS
        self.timed_out_s: float | None = None
        # True from `zero` until it is done, or until another motion command replaces it.
        self.zeroing = False
        # Motion.
        self._drive = model.drive(setup.ramps)
        self._drive.set_angles(start.steering_rad, start.turret_rad)
        self._encoders = Encoders(start.x_in, start.y_in)
        self._chassis = Chassis(model.body, walls, start.x_in, start.y_in)
        self._has_exact_motion = setup.has_exact_motion
        # Pieces of the true path since `start_trajectory`: when each begins, and the seconds until the robot was
        # blocked; afterwards it stands.
        self._trajectory: list[tuple[int, PlacedSegment, float]] | None = None
        # Sensors, each with a random stream of its own.
        self._rngs = tuple(rng_factory.stream(purpose) for purpose in Purpose)
        self.sonar = SonarRing(model.body, setup.sonar, walls, self._rngs[Purpose.SONAR], rng_factory.seed)
        self.infrared: InfraredRing | None = None
        if model.has_light_sensors:
            self.infrared = InfraredRing(model.body, setup.infrared, walls, now_ps, self._rngs[Purpose.INFRARED])
        self.compass: Compass | None = None
        if model.has_compass:
            turret_rad = self._chassis.turret_direction(self._drive.turret_rad)
            self.compass = Compass(setup.compass, turret_rad, now_ps, self._rngs[Purpose.COMPASS])
        self._scan: LaserScan | None = None
        self.powered = False
        if powered:
            self.power_on()

    def power_on(self) -> None:
        """Switch the sensors on: all sonars get a reading, and the ring starts."""
        self.powered = True
        self.sonar.emit_all(self._sensor_pose(), self._segment_time(self._time_ps))
        self.feed()
        self.sonar.restart(self._time_ps)
        self._trigger_due()

    # State

    def to_state(self) -> RobotState:
        """Return all that changes, and model and setup."""
        return RobotState(
            self.model, self.setup, self.initial_setup, self._timeout_ps, self._deadline_ps, self.timed_out_s,
            self.zeroing, self.powered, drive_state(self._drive), self._encoders.to_state(), self._chassis.to_state(),
            self.sonar.to_state(), self.infrared.to_state() if self.infrared else None,
            self.compass.to_state() if self.compass else None, tuple(map(_rng_state, self._rngs)),
        )  # fmt: skip

    @classmethod
    def from_state(cls, state: RobotState, rng_factory: RngFactory, walls: FloatArray, now_ps: int) -> SimulatedRobot:
        """Return the robot of a state at an instant; raise ValueError if there can be none."""
        # 1. Values that a robot is built from.
        state.model.check()
        state.setup.check()
        state.initial_setup.check()
        robot = cls(rng_factory, StartPose(0.0, 0.0), walls, state.model, state.setup, now_ps, powered=False)
        # 2. Time-out: neither in the past nor so short that time stands still.
        if state.deadline_ps < now_ps or not (state.timeout_ps == 0 or state.timeout_ps >= MIN_TIMEOUT_PS):
            raise ValueError("a time-out that has no end")
        robot.set_noise_model(state.setup)
        robot.setup, robot.initial_setup = state.setup, state.initial_setup
        robot._timeout_ps, robot._deadline_ps = state.timeout_ps, state.deadline_ps
        robot.timed_out_s, robot.zeroing, robot.powered = state.timed_out_s, state.zeroing, state.powered
        # 3. Parts.
        set_drive_state(robot._drive, state.drive)
        robot._encoders.set_state(state.encoders)
        robot._chassis.set_state(state.chassis)
        robot.sonar.set_state(state.sonar, now_ps)
        if (robot.infrared is None, robot.compass is None) != (state.infrared is None, state.compass is None):
            raise ValueError("a robot with other sensors than its model")
        if robot.infrared is not None and state.infrared is not None:
            robot.infrared.set_state(state.infrared, now_ps)
        if robot.compass is not None and state.compass is not None:
            robot.compass.set_state(state.compass, now_ps)
        # 4. Random streams last, because the constructors above have drawn from them.
        for rng, rng_state in zip(robot._rngs, state.rngs, strict=True):
            _set_rng_state(rng, rng_state)
        return robot

    # Time

    @property
    def time_s(self) -> float:
        """Simulated time of the whole simulation."""
        return to_s(self._time_ps)

    def feed(self) -> None:
        """Restart the time-out."""
        self._deadline_ps = self._time_ps + self._timeout_ps if self._timeout_ps else TIME_MAX_PS

    def advance_to(self, end_ps: int) -> None:
        """Advance to an instant that is not before the current one."""
        while self._time_ps < end_ps:
            # 1. The next instant at which something other than motion happens.
            until = min(end_ps, self._deadline_ps)
            if self.zeroing or not self._has_exact_motion:
                until = min(until, self.sonar.due_ps)
            if self.infrared is not None:
                until = min(until, self.infrared.due_ps)
            # 2. Motion up to it, with the sensors that measure in between.
            if self.compass is not None and until >= self.compass.due_ps:
                self._read_compass(self.compass, until)
            self._move((until - self._time_ps) / PS_PER_S)
            self._time_ps = until
            # 3. The events at that instant.
            if self.zeroing:
                self._finish_zero()
            if until == self._deadline_ps:
                self._time_out()
            self._trigger_due()

    def _stop_axes(self) -> None:
        for axis in self._drive.axes:
            axis.stop()

    def _time_out(self) -> None:
        """Stop the motion, except for a search for zero."""
        if self.zeroing:
            self.feed()
            return
        self._deadline_ps = TIME_MAX_PS
        self.timed_out_s = self.time_s
        self._stop_axes()

    def _finish_zero(self) -> None:
        if not any(self.moving):
            self.zeroing = False
            before_rad = self._drive.turret_rad
            self._drive.finish_zero()
            self._on_turret_moved(before_rad)
            for axis in self._drive.axes:
                axis.count = 0.0
            self._chassis.finish_zero()
            self._encoders.define_position(0.0, 0.0)
            self._encoders.define_angles(-self._drive.steering_rad, -self._drive.turret_rad)

    # Sensors in time

    def _trigger_due(self) -> None:
        while self.sonar.due_ps <= self._time_ps:
            self.sonar.emit_due(self._sensor_pose(), self._segment_time(self.sonar.due_ps))
        while self.infrared is not None and self.infrared.due_ps <= self._time_ps:
            self.infrared.flash_due(self._sensor_pose(), self._segment_time(self._time_ps).stamp)

    def _read_compass(self, compass: Compass, until_ps: int) -> None:
        """Take the last reading up to an instant, if one is due, before anything moves.

        Time is not divided for it: the drive predicts the turn of the turret until then.
        """
        due_ps = last_reading_ps(until_ps)
        turret_rad = self._drive.turret_after((due_ps - self._time_ps) / PS_PER_S)
        compass.read(due_ps, self._chassis.turret_direction(turret_rad), turret_rad)

    def _on_turret_moved(self, before_rad: float) -> None:
        """Inform the compass that the turret's angle was set, not turned."""
        if self.compass is not None:
            self.compass.on_turret_moved(before_rad, self._drive.turret_rad)

    def _sensor_pose(self) -> SensorPose:
        chassis, positions = self._chassis, self._positions.at(self._time_ps)
        return SensorPose(*chassis.position, chassis.turret_direction(self._drive.turret_rad), positions,
                          self._self_index)

    def _segment_time(self, instant_ps: int) -> SegmentTime:
        """Return the time stamp of a reading at the current pose."""
        turret_rad = self._encoders.turret(self._drive.turret_rad)
        return SegmentTime(self._motion_segment(segments.AT_REST), 0.0, turret_rad, instant_ps / PS_PER_S)

    def _motion_segment(self, segment: ConstantAccelerationSegment) -> segments.MotionSegment:
        """Return a segment that starts now, as the encoders count it."""
        drive, encoders = self._drive, self._encoders
        first, second, third = drive.axes
        heading_rad = encoders.heading(drive.steering_rad)
        motions = first.motion, second.motion, third.motion
        return segments.MotionSegment(*encoders.position, heading_rad, segment, motions)

    def _emit_along(self, segment: ConstantAccelerationSegment, begin_s: float, taken_s: float) -> None:
        """Fire the sonars that are due within the first seconds of a segment, which is about to begin.

        Parameters
        ----------
        begin_s
            Seconds of this piece of time that are over.
        taken_s
            Seconds that the robot will follow the segment; a sonar that is due at the very end fires afterwards.
        """
        sonar, due_ps, before_s = self.sonar, self.sonar.due_ps, taken_s - TIME_TOLERANCE_S
        into_s = (due_ps - self._time_ps) / PS_PER_S - begin_s
        if into_s >= before_s:
            return
        drive, chassis, encoders, motion = self._drive, self._chassis, self._encoders, self._motion_segment(segment)
        (x, y), heading = chassis.position, chassis.heading(drive.steering_rad)
        while into_s < before_s:
            into_s = max(into_s, 0.0)
            turret_rad = drive.turret_after(into_s)
            dx, dy = segment.displacement(heading, into_s)
            direction_rad, positions = chassis.turret_direction(turret_rad), self._positions.at(due_ps)
            pose = SensorPose(x + dx, y + dy, direction_rad, positions, self._self_index)
            sonar.emit_due(pose, SegmentTime(motion, into_s, encoders.turret(turret_rad), due_ps / PS_PER_S))
            due_ps = sonar.due_ps
            into_s = (due_ps - self._time_ps) / PS_PER_S - begin_s

    # Motion in time

    def _move(self, span_s: float) -> None:
        """Advance all axes, dividing the path where they change their acceleration and where the robot is stopped."""
        left_s = span_s
        while left_s > 0.0:
            segment = self._drive.segment(left_s)
            if segment.at_rest:
                self._emit_along(segment, span_s - left_s, left_s)
                turned_rad = self._drive.advance(left_s)
                if not self._has_exact_motion:
                    self._turn_uncounted(0.0, turned_rad)
                return
            left_s -= self._follow(segment, span_s - left_s)

    def _follow(self, segment: ConstantAccelerationSegment, begin_s: float) -> float:
        """Follow a segment that begins `begin_s` after now to its end or to a contact; return the seconds it took.

        Only the commanded motion stops the wheels. Where noise, or a turn on the spot with odometry errors, pushes a
        robot into a wall, it is held there for the rest of the segment while the wheels turn.
        """
        drive, chassis, duration = self._drive, self._chassis, segment.duration_s
        steering_rad, commanded_in = drive.steering_rad, 0.0
        # 1. The true motion: systematic errors, then noise.
        systematic = actual = segment
        if not self._has_exact_motion:
            systematic = self.setup.odometry.true_segment(segment, drive)
            actual = self.setup.motion.disturbed(systematic, self._rngs[Purpose.MOTION])
        # 2. Contact on it, and whether the commanded motion presses on.
        heading = chassis.heading(steering_rad)
        contact = chassis.first_contact(actual, steering_rad)
        is_blocked = False
        free_s = duration
        if contact is not None:
            free_s, commanded_in = contact.time_s, segment.distance_at(duration)
            is_pressing = actual is systematic or contact.pressed_by(heading + actual.turn_at(free_s), commanded_in)
            is_blocked = commanded_in != 0.0 and is_pressing
        taken_s = free_s if is_blocked else duration
        if self._trajectory is not None:
            begin_ps = self._time_ps + round(begin_s * PS_PER_S)
            self._trajectory.append((begin_ps, PlacedSegment(*chassis.position, heading, actual), free_s))
        # 3. Sonars, then the chassis and the encoders. Without errors both move by the same numbers.
        self._emit_along(segment, begin_s, taken_s)
        displacement = chassis.follow(actual, free_s, steering_rad)
        if actual is segment and taken_s == free_s and self._encoders.heading(steering_rad) == heading:
            self._encoders.shift(*displacement)
        else:
            self._encoders.follow(segment, taken_s, steering_rad)
        # 4. The axes, and the turns that no encoder counts.
        turned_rad = drive.advance(taken_s)
        if not self._has_exact_motion:
            self._turn_uncounted(actual.turn_at(taken_s) - segment.turn_at(taken_s), turned_rad)
        # 5. A blocked robot slips, and its wheels stop.
        if is_blocked:
            self._encoders.slip(copysign(self.setup.odometry.slip_in, commanded_in), drive.steering_rad)
            drive.block()
        return taken_s

    def _turn_uncounted(self, body_rad: float, counted_rad: float) -> None:
        """Turn the body by an angle that no encoder counts, and the turret by the error of its gears."""
        self._chassis.turn(body_rad, (self.setup.odometry.scales[2] - 1.0) * counted_rad)

    # Observation

    @property
    def moving(self) -> tuple[bool, bool, bool]:
        """True for each axis that moves."""
        first, second, third = self._drive.axes
        return first.moving, second.moving, third.moving

    def is_still(self, axes: Iterable[int]) -> bool:
        """Return True if none of these axes (0, 1, 2) moves; True for none."""
        moving = self.moving
        return not any(moving[axis] for axis in axes)

    @property
    def encoder(self) -> segments.Pose:
        """The pose by the encoders: what State reports."""
        return self._encoders.pose(self._drive.steering_rad, self._drive.turret_rad)

    @property
    def actual(self) -> segments.Pose:
        """The true pose."""
        return self._chassis.pose(self._drive.steering_rad, self._drive.turret_rad)

    @property
    def disc(self) -> Disc:
        """The robot as an obstacle: x, y, radius in inches."""
        return (*self._chassis.position, self.model.body.radius_in)

    def disc_at(self, instant_ps: int) -> Disc:
        """Return the disc at an instant since `start_trajectory`."""
        # Before the first segment of a span the robot stands.
        if not self._trajectory:
            return self.disc
        for piece in reversed(self._trajectory):
            if piece[0] <= instant_ps:
                break
        begin_ps, placed, free_s = piece
        elapsed_s = (instant_ps - begin_ps) / PS_PER_S
        if elapsed_s <= 0.0:
            return placed.x_in, placed.y_in, self.model.body.radius_in
        return (*placed.position(elapsed_s if elapsed_s < free_s else free_s), self.model.body.radius_in)

    def max_travel_in(self, span_s: float) -> float:
        """Return an upper bound of the distance travelled within a time if no command comes, inches; 0 only at rest.

        Noise exceeds it with a probability of 1e-9.
        """
        drive, setup = self._drive, self.setup
        if self._has_exact_motion:
            return drive.max_speed * span_s
        span_s *= max(map(abs, setup.odometry.scales[:2]))
        commanded_in = drive.max_speed * span_s
        return commanded_in + NOISE_SIGMAS * setup.motion.distance_std_in(commanded_in, drive.max_turn_rate * span_s)

    def swept_bounds(self, span_s: float) -> SweptBounds:
        """Return the same bound by direction.

        A path of length s whose heading turns by at most an angle a stays within s a of the straight path, wherever on
        it the robot is stopped. Towards something in the direction n it therefore comes no nearer than by the straight
        path's component along n, if that is positive, and the deviation.
        """
        drive, farthest_in = self._drive, self.max_travel_in(span_s)
        if not farthest_in:
            return STATIONARY
        backward, forward = drive.velocity_bounds
        # 1. Largest turn of the heading, and what noise adds to the distance.
        turn_rad, deviation_in = drive.max_turn_rate * span_s, 0.0
        if not self._has_exact_motion:
            odometry, noise = self.setup.odometry, self.setup.motion
            span_s *= max(map(abs, odometry.scales[:2]))
            commanded_in, angle_rad = drive.max_speed * span_s, drive.max_turn_rate * span_s
            drift_rad = max(map(abs, odometry.drifts)) * (drive.axes[0].max_speed + drive.axes[1].max_speed) * span_s
            turn_rad = angle_rad + drift_rad + NOISE_SIGMAS * noise.turn_std_rad(commanded_in, angle_rad)
            deviation_in = farthest_in - commanded_in
        # 2. The straight paths, and the deviation that the turn causes.
        heading_rad = self._chassis.heading(drive.steering_rad)
        x, y = span_s * cos(heading_rad), span_s * sin(heading_rad)
        deviation_in += max(forward, -backward) * span_s * turn_rad
        return SweptBounds(forward * x, forward * y, backward * x, backward * y, deviation_in)

    @property
    def velocities(self) -> segments.Velocities:
        """Velocities that the encoders show, by axis; never 0 from the command to the end of a motion."""
        first, second, third = self._drive.axes
        return first.shown_velocity, second.shown_velocity, third.shown_velocity

    @property
    def accelerations(self) -> segments.Velocities:
        """Current accelerations by axis, per second squared; 0 where axes jump."""
        first, second, third = self._drive.axes
        return first.current_phase[2], second.current_phase[2], third.current_phase[2]

    @property
    def counts(self) -> tuple[float, float, float]:
        """Signed distance that each axis has travelled since power-on or the last `zero`."""
        first, second, third = self._drive.axes
        return first.count, second.count, third.count

    @property
    def bumpers(self) -> int:
        """Pressed bumpers as bits: bit i is set while bumper i touches something."""
        return self._chassis.bumpers(self._drive.bumper_frame_rad)

    @property
    def front_rad(self) -> float:
        """True direction of bumper 0 in the map: the body of a Scout turns with its wheels, and any body with noise."""
        return segments.wrap_to_2pi(self._chassis.heading(self._drive.bumper_frame_rad))

    # Motion commands

    def set_velocities(self, first: float, second: float, third: float) -> None:
        """Run at these velocities until the next motion command or the time-out. C: vm."""
        self._begin_command()
        for axis, velocity in zip(self._drive.axes, (first, second, third), strict=True):
            axis.move_at(velocity)

    def move_relative(self, first: float, second: float, third: float) -> None:
        """Move by these distances, each axis at its speed, all at once. C: pr."""
        self._begin_command()
        for axis, distance in zip(self._drive.axes, (first, second, third), strict=True):
            axis.move_by(distance)

    def command_axis(self, axis: int, command: int, value: float) -> None:
        """Command one axis. C: mv.

        Parameters
        ----------
        axis
            0, 1 or 2.
        command
            0 leave, 1 velocity, 2 relative, 3 limp, 4 set acceleration, 5 set speed.

        Raises
        ------
        ValueError
            For other commands.
        IndexError
            For other axes.
        """
        self._drive.axes[axis].command(Command(command), value)
        if command in AXIS_MOTIONS:
            self._begin_command()

    def stop_axis(self, axis: int) -> None:
        """Brake one axis whose driver is gone. This is no command: the time-out of other drivers does not restart."""
        self._drive.axes[axis].command(Command.VELOCITY, 0.0)
        self.zeroing = False

    def stop(self) -> None:
        """Brake and hold. C: st."""
        self._begin_command()
        self._stop_axes()

    def limp(self) -> None:
        """Release all axes. C: lp."""
        self._begin_command()
        for axis in self._drive.axes:
            axis.limp()

    def zero(self) -> None:
        """Turn steering and turret to the zero position of the bumpers; then the encoders read 0. C: zr.

        `zeroing` is True until then. The time-out waits for it, because the client waits as well.
        """
        self._begin_command()
        self._drive.seek_zero()
        self.zeroing = True
        self._finish_zero()

    def _begin_command(self) -> None:
        """Restart the time-out and end a search for zero."""
        self.feed()
        self.zeroing = False

    # Settings

    def set_speeds(self, first: float, second: float, third: float) -> None:
        """Set the speeds of relative motions, from the next one on. C: sp."""
        for axis, speed in zip(self._drive.axes, (first, second, third), strict=True):
            axis.set_speed(speed)

    def set_accelerations(self, first: float, second: float, third: float) -> None:
        """Set the accelerations, from the next motion on; no effect where axes jump. C: ac."""
        for axis, acceleration in zip(self._drive.axes, (first, second, third), strict=True):
            axis.set_acceleration(acceleration)

    def define_position(self, x_in: float, y_in: float) -> None:
        """Give the current position these encoder coordinates; the robot does not move. C: dp."""
        self._encoders.define_position(x_in, y_in)

    def define_angles(self, steering_rad: float, turret_rad: float) -> None:
        """Give the current directions these encoder angles; nothing turns. C: da."""
        steering, turret = self._drive.feasible_angles(steering_rad, turret_rad)
        self._encoders.define_angles(steering - self._drive.steering_rad, turret - self._drive.turret_rad)

    def place(self, x_in: float, y_in: float, steering_rad: float, turret_rad: float) -> None:
        """Set the robot down at a pose, its encoders as well, its body's yaw at 0 as at power-on. C: place_robot.

        Motions continue from there; a search for zero ends. Whether the position is free is for the caller to check: a
        robot set into a wall can only leave it.
        """
        self.zeroing = False
        # 1. Angles: the compass must not count them as a turn.
        before_rad = self._drive.turret_rad
        self._drive.set_angles(steering_rad, turret_rad)
        self._on_turret_moved(before_rad)
        # 2. True pose, readings, encoder pose.
        self._chassis.place(x_in, y_in)
        self.sonar.forget_pings()
        self._encoders = Encoders(x_in, y_in)

    def set_timeout(self, seconds: float) -> None:
        """Stop the motion after so long without a command; 0 or less: never. C: conf_tm."""
        before_ps, self._timeout_ps = self._timeout_ps, to_ps(max(seconds, 0.0))
        if before_ps and self._timeout_ps and self._deadline_ps < TIME_MAX_PS:
            # It counts from the last command, which need not be this one.
            self._deadline_ps = max(self._deadline_ps - before_ps + self._timeout_ps, self._time_ps)
        else:
            self.feed()

    def configure_sonars(self, rate: int, order: Sequence[int]) -> None:
        """Restart the ring at rate x 4 ms per sonar, one at a time; the first fires now. C: conf_sn."""
        self.sonar.configure(rate, order, self._time_ps)
        self._trigger_due()

    def restart_sonars(self) -> None:
        """Restart the ring with the order and the interval of its model. Its first sonars fire now."""
        self.sonar.restart(self._time_ps)
        self._trigger_due()

    def configure_infrareds(self, history: int, order: Sequence[int]) -> None:
        """Set history (tenths) and sensors of the infrared ring; it flashes now. C: conf_ir."""
        if self.infrared is not None:
            self.infrared.configure(history, order, self._time_ps)
            self._trigger_due()

    def configure_compass(self, mode: int) -> None:
        """Set the mode of the compass, if there is one; raise ValueError for an unknown mode. C: conf_cp."""
        if self.compass is not None:
            self.compass.configure(mode, self._drive.turret_rad)

    def set_noise_model(self, setup: RobotSetup) -> None:
        """Replace the errors of motion and sensors by those of a setup; earlier readings do not change.

        Its ramps and its clock are not taken over: they stay as at power-on.
        """
        # Ramps and clock belong to the drive and the server since power-on.
        self.setup = replace(setup, ramps=self.setup.ramps, clock_step_s=self.setup.clock_step_s)
        self._has_exact_motion = setup.has_exact_motion
        self.sonar.set_model(setup.sonar)
        if self.infrared is not None:
            self.infrared.set_noise(setup.infrared)
        if self.compass is not None:
            self.compass.noise = setup.compass

    def scan_laser(self, columns: int = 0) -> FloatArray:
        """Return the ranges of the laser's columns now (482,), inches from the front of the turret; inf for nothing.

        Parameters
        ----------
        columns
            Number of columns that measure, 0: all.
        """
        pose = self._sensor_pose()
        if self._scan is None or self._scan.pose != pose or self._scan.walls is not self._walls:
            self._scan = LaserScan(pose, self._walls, ranges(pose, self._walls, self.model.body))
        scan = self._scan
        # Other robots may be set down elsewhere at the same instant.
        if len(pose.robots.discs) > 1:
            self._scan = None
        return sensors.select_columns(scan.ranges_in, columns)

    # Surroundings

    def set_obstacles(self, discs: Sequence[Disc]) -> None:
        """Replace the other robots that can be touched, rows x y radius in inches."""
        self._chassis.set_obstacles(discs)

    def set_positions(self, positions: PositionProvider, self_index: int) -> None:
        """Set the source of the robots' positions for the sensors; row `self_index` is this robot."""
        self._positions = positions
        self._self_index = self_index

    def start_trajectory(self) -> None:
        """Start recording the true path, for `disc_at`."""
        self._trajectory = []

    def stand_alone(self) -> None:
        """Forget all others: none is left."""
        self.set_positions(NO_OTHERS, 0)
        self.set_obstacles(())
        self._trajectory = None

    def set_walls(self, walls: FloatArray) -> None:
        """Replace the walls (m, 4), rows x1 y1 x2 y2 in inches."""
        self._walls = walls
        self.sonar.set_walls(walls)
        if self.infrared is not None:
            self.infrared.set_walls(walls)
        self._chassis.set_walls(walls)
