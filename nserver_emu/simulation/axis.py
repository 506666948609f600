r"""One motor axis: the commanded motion, its velocity and its count. No robot, no pose, no noise, no clock.

A command is planned at once as phases of constant acceleration; time then advances through them by the closed form, so
the size of the time steps changes nothing. A unit is an inch or a radian; the axis does not distinguish them.

    without ramps | cruise |              the axis jumps to its speed (the original's note on `ac`)
    trapezoid     / cruise \              never beyond speed or acceleration, never past a relative target

The formulas are functions of plain numbers, which numba compiles for the batch simulation (batch_kernel.py).

The arm of a Nomad 200: a lift and a gripper that move independently. No wire format, no clock, no robot.

Each is an axis of the robot's kind between two ends. The limits are assumptions, for no source gives them:
the lift moves 0..48 in at up to 5 in/s, the gripper opens 0..5 in at up to 2 in/s, both ramped; they start at 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from math import copysign, inf, sqrt
from typing import Final, NamedTuple

TIME_TOLERANCE_S: Final = 1e-9
"""A phase that ends within this of now has ended: sums of dt differ from the closed form in the last bits (about
1e-13 s in an hour), and a robot at 20 in/s covers 2e-8 in meanwhile."""

MAX_RESTORED_SPEED: Final = 1000.0
"""Fastest top speed of a restored robot, units/s: bounds the work that a damaged snapshot can cause."""

MAX_PHASES: Final = 8
"""A planned motion has at most five phases: two ramps of up to two phases each, and cruise."""


class Mode(IntEnum):
    """The last command of an axis. HOLD is also the mode after a finished motion."""

    HOLD = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3


class Command(IntEnum):
    """The commands of an axis: the modes of mv."""

    LEAVE = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3
    ACCELERATION = 4
    SPEED = 5


AXIS_MOTIONS: Final = frozenset({Command.VELOCITY, Command.RELATIVE, Command.LIMP})
"""The commands that move an axis or release it; the others set its limits, or leave it as it is."""


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Limits of one axis of a model, in units and seconds.

    Attributes
    ----------
    top_speed, top_acceleration
        Values above are clamped silently; signs of speeds are dropped.
    min_acceleration
        Values below are clamped to it: an axis that could not brake would run for ever.
    speed, acceleration
        In force at power-on.
    resolution
        The smallest velocity that the encoders show while the axis moves.
    """

    top_speed: float
    top_acceleration: float
    min_acceleration: float
    speed: float
    acceleration: float
    resolution: float


class Phase(NamedTuple):
    """A time of constant acceleration; the velocity does not change its sign inside."""

    duration_s: float
    velocity: float
    acceleration: float


NO_PHASE: Final = Phase(0.0, 0.0, 0.0)
"""A phase that is not there: those that last 0 s never begin."""

AxisMotion = tuple[tuple[Phase, ...], float, float]
"""The motion of an axis until the next command: its phases, how long the first has lasted, and the axis's resolution.
A plain tuple, because one is recorded for every firing of a sonar."""


def shown_velocity_after(motion: AxisMotion, dt_s: float) -> float:
    """Return the encoder velocity dt_s >= 0 seconds later: never 0 while the axis moves, exactly 0 when it is still."""
    phases, elapsed_s, resolution = motion
    if dt_s:
        _, done, elapsed_s = advance_phases(phases, elapsed_s, dt_s)
        phases = phases[done:]
    if not phases:
        return 0.0
    _, velocity, acceleration = phases[0]
    velocity += acceleration * elapsed_s
    if -resolution < velocity < resolution:
        return copysign(resolution, velocity or acceleration)
    return velocity


class AxisState(NamedTuple):
    """The state of an axis in a snapshot; a phase without end has the duration None."""

    mode: Mode
    speed: float
    acceleration: float
    travelled: float
    phases: tuple[tuple[float | None, float, float], ...]
    elapsed_s: float


class Axis:
    """One axis with its limits; without `ramps` it jumps to its speed.

    Commands take effect at once from the velocity in force; a speed or acceleration set during a motion applies from
    the next command on.
    """

    def __init__(self, limits: AxisLimits, ramps: bool) -> None:
        self.limits = limits
        self.ramps = ramps
        self.mode = Mode.HOLD
        self.speed = limits.speed
        self.acceleration = limits.acceleration
        self.count = 0.0
        """Signed distance travelled in total, units: the origin of absolute positions."""
        self._phases: tuple[Phase, ...] = ()
        self._elapsed_s = 0.0

    def to_state(self) -> AxisState:
        """Return all that changes."""
        phases = tuple((None if duration_s == inf else duration_s, velocity, acceleration)
                       for duration_s, velocity, acceleration in self._phases)
        return AxisState(self.mode, self.speed, self.acceleration, self.count, phases, self._elapsed_s)

    def set_state(self, state: AxisState) -> None:
        """Continue from a state; raise ValueError if an axis with these limits cannot be in it."""
        top = self.limits.top_speed
        if len(state.phases) > MAX_PHASES or not 0.0 <= state.speed <= top <= MAX_RESTORED_SPEED:
            raise ValueError("an axis beyond its limits")
        phases = tuple(Phase(inf if duration is None else duration, *rest) for duration, *rest in state.phases)
        for duration_s, velocity, acceleration in phases:
            # Velocities at the start and at the end of the phase; a phase without end has none.
            end = velocity + acceleration * duration_s if acceleration else velocity
            if duration_s <= 0.0 or not max(abs(velocity), abs(end)) <= 1.001 * top + 1e-6:
                raise ValueError("an axis faster than its top speed")
        if not 0.0 <= state.elapsed_s <= (phases[0].duration_s if phases else 0.0):
            raise ValueError("an axis outside its phase")
        if not 0.0 < state.acceleration <= max(self.limits.top_acceleration, self.limits.acceleration):
            raise ValueError("an axis without acceleration")
        self.mode, self.speed, self.acceleration = state.mode, state.speed, state.acceleration
        self.count, self._phases, self._elapsed_s = state.travelled, phases, state.elapsed_s

    @property
    def moving(self) -> bool:
        """True from the command that starts a motion until it is done."""
        return bool(self._phases)

    @property
    def velocity(self) -> float:
        """Units per second now; exactly 0 when still, and at the very start of a ramp."""
        if not self._phases:
            return 0.0
        phase = self._phases[0]
        return phase.velocity + phase.acceleration * self._elapsed_s

    @property
    def max_speed(self) -> float:
        """Upper bound of the speed until the next command, units per second: phases end at rest or at cruise."""
        phases = self._phases
        if len(phases) == 1:
            return abs(phases[0].velocity)
        return max((abs(phase.velocity) for phase in phases), default=0.0)

    @property
    def velocity_bounds(self) -> tuple[float, float]:
        """Bounds of the velocity until the next command, lower <= 0 <= upper."""
        lower = upper = 0.0
        for _, velocity, _ in self._phases:
            if velocity < lower:
                lower = velocity
            elif velocity > upper:
                upper = velocity
        return lower, upper

    @property
    def current_phase(self) -> tuple[float, float, float]:
        """Seconds for which the acceleration stays the same (inf when nothing ends), velocity, and acceleration."""
        if not self._phases:
            return inf, 0.0, 0.0
        return phase_now(self._phases[0], self._elapsed_s)

    @property
    def shown_velocity(self) -> float:
        """The velocity that the encoders show: never 0 while the axis moves, exactly 0 when it is still."""
        return shown_velocity_after(self.motion, 0.0)

    @property
    def motion(self) -> AxisMotion:
        """The motion until the next command, from now on."""
        return self._phases, self._elapsed_s, self.limits.resolution

    def command(self, command: Command, value: float) -> None:
        """Execute one of the commands of mv, with its value."""
        match command:
            case Command.LEAVE:
                pass
            case Command.VELOCITY:
                self.move_at(value)
            case Command.RELATIVE:
                self.move_by(value)
            case Command.LIMP:
                self.limp()
            case Command.ACCELERATION:
                self.set_acceleration(value)
            case Command.SPEED:
                self.set_speed(value)

    def set_speed(self, speed: float) -> None:
        """Set the speed of relative motions: the magnitude counts, clamped to the top speed. 0: they do not move."""
        self.speed = min(abs(speed), self.limits.top_speed)

    def set_acceleration(self, acceleration: float) -> None:
        """Set the acceleration of all ramps: the magnitude counts, clamped to the limits of the axis."""
        wanted = max(abs(acceleration), self.limits.min_acceleration)
        self.acceleration = min(wanted, self.limits.top_acceleration)

    def move_at(self, velocity: float) -> None:
        """Run at a velocity (units/s, clamped to the top speed) until the next command; 0 brakes and holds."""
        top = self.limits.top_speed
        wanted = min(max(velocity, -top), top)
        self.mode = Mode.VELOCITY if wanted else Mode.HOLD
        # An axis that stands goes on standing: the turret, in most commands.
        is_motion = wanted or self._phases
        self._start(plan_velocity(self.velocity, wanted, self.acceleration, self.ramps) if is_motion else ())

    def move_by(self, distance: float, speed: float | None = None) -> None:
        """Move by a distance (units, from here) and hold there.

        The acceleration is a limit of the motor: a target nearer than the braking distance of the motion in force is
        passed and approached again from the other side.

        Parameters
        ----------
        speed
            Units/s; None: the speed set.
        """
        # At speed 0 the target is never reached: hold instead.
        top = self.speed if speed is None else min(abs(speed), self.limits.top_speed)
        if top == 0.0:
            self.stop()
            return
        self.mode = Mode.RELATIVE
        self._start(plan_distance(self.velocity, distance, top, self.acceleration, self.ramps))

    def stop(self) -> None:
        """Brake and hold."""
        self.move_at(0.0)

    def limp(self) -> None:
        """Release the motor: the axis runs down; friction is assumed to brake as hard as the acceleration set."""
        self.move_at(0.0)
        self.mode = Mode.LIMP

    def halt(self) -> None:
        """Stand still at once, whatever the acceleration: the robot is blocked."""
        self.mode = Mode.HOLD
        self._start(())

    def advance(self, dt_s: float) -> float:
        """Advance by dt_s >= 0 seconds and return the displacement in units."""
        if not self._phases:
            return 0.0
        duration_s, velocity, acceleration = self._phases[0]
        elapsed_s = self._elapsed_s
        # Most steps end inside the first phase: the same formulas as in advance_phases, without the loop.
        if dt_s < duration_s - elapsed_s - TIME_TOLERANCE_S:
            velocity += acceleration * elapsed_s
            travelled = (velocity + 0.5 * acceleration * dt_s) * dt_s
            self._elapsed_s = elapsed_s + dt_s
        else:
            travelled, done, self._elapsed_s = advance_phases(self._phases, elapsed_s, dt_s)
            self._phases = self._phases[done:]
            self._hold_when_done()
        self.count += travelled
        return travelled

    def displacement_after(self, dt_s: float) -> float:
        """Return the displacement of the next dt_s >= 0 seconds, units, without advancing."""
        return advance_phases(self._phases, self._elapsed_s, dt_s)[0] if self._phases else 0.0

    def _start(self, phases: tuple[Phase, ...]) -> None:
        """Begin the phases that have a duration; a finished motion holds."""
        self._phases = tuple([phase for phase in phases if phase.duration_s > 0.0])
        self._elapsed_s = 0.0
        self._hold_when_done()

    def _hold_when_done(self) -> None:
        if not self._phases and self.mode != Mode.LIMP:
            self.mode = Mode.HOLD


def plan_velocity(start: float, wanted: float, rate: float, ramps: bool) -> tuple[Phase, Phase, Phase]:
    """Plan the motion from a velocity to another one, which lasts until the next command unless it is 0.

    Parameters
    ----------
    start, wanted
        Velocities, units/s.
    rate
        Acceleration > 0, units/s^2.

    Returns
    -------
    tuple of Phase
        Phases, some of which may last 0 s.
    """
    up, down = _ramp(start, wanted, rate) if ramps else (NO_PHASE, NO_PHASE)
    return up, down, Phase(inf if wanted else 0.0, wanted, 0.0)


def plan_distance(start: float, distance: float, top: float, rate: float,
                  ramps: bool) -> tuple[Phase, Phase, Phase, Phase, Phase]:
    """Plan the motion from the velocity in force to standing still `distance` ahead, at most `top` > 0 fast.

    With start velocity u, peak p and acceleration A the two ramps cover (p^2 - u^2) / 2A + p^2 / 2A; the rest of
    the distance is cruise. The result is that of `plan_velocity`.
    """
    if not ramps:
        cruise = Phase(abs(distance) / top, copysign(top, distance), 0.0)
        return NO_PHASE, NO_PHASE, cruise, NO_PHASE, NO_PHASE
    # 1. The direction in which the point of standstill has to move; all quantities along it.
    direction = copysign(1.0, distance - start * abs(start) / (2.0 * rate))
    forward, ahead = direction * start, direction * distance
    # 2. The peak of a motion without cruise.
    peak = sqrt(max(rate * ahead + 0.5 * forward * forward, 0.0))
    cruise_s = 0.0
    # 3. Beyond the permitted speed: cruise at that speed.
    if peak > top:
        ramped = top * top - forward * forward
        ramps_in = (abs(ramped) if forward > top else ramped) + top * top
        peak = top
        cruise_s = max(ahead - ramps_in / (2.0 * rate), 0.0) / top
    first, second = _ramp(start, direction * peak, rate)
    third, fourth = _ramp(direction * peak, 0.0, rate)
    return first, second, Phase(cruise_s, direction * peak, 0.0), third, fourth


def _ramp(start: float, end: float, rate: float) -> tuple[Phase, Phase]:
    """Return the ramp between two velocities; both phases last longer than 0 s only where the sign changes."""
    # No phase may change the sign of the velocity.
    middle = 0.0 if start * end < 0.0 else end
    return _ramp_phase(start, middle, rate), _ramp_phase(middle, end, rate)


def _ramp_phase(start: float, end: float, rate: float) -> Phase:
    return Phase(abs(end - start) / rate, start, copysign(rate, end - start))


def phase_now(phase: Sequence[float], elapsed_s: float) -> tuple[float, float, float]:
    """Return the seconds left of a phase that has lasted `elapsed_s`, its velocity now, and its acceleration."""
    return phase[0] - elapsed_s, phase[1] + phase[2] * elapsed_s, phase[2]


def advance_phases(phases: Sequence[Sequence[float]], elapsed_s: float, dt_s: float) -> tuple[float, int, float]:
    """Return the displacement of dt_s seconds, how many phases end in it, and how long the next one has lasted then."""
    travelled = 0.0
    for done in range(len(phases)):
        left_s, velocity, acceleration = phase_now(phases[done], elapsed_s)
        if dt_s < left_s - TIME_TOLERANCE_S:
            return travelled + (velocity + 0.5 * acceleration * dt_s) * dt_s, done, elapsed_s + dt_s
        travelled += (velocity + 0.5 * acceleration * left_s) * left_s
        dt_s = max(dt_s - left_s, 0.0)
        elapsed_s = 0.0
    return travelled, len(phases), 0.0


LIFT: Final = AxisLimits(top_speed=5.0, top_acceleration=20.0, min_acceleration=0.1, speed=5.0, acceleration=10.0,
                         resolution=0.1)
GRIP: Final = replace(LIFT, top_speed=2.0, speed=2.0)
LIFT_TRAVEL_IN: Final = 48.0
GRIP_TRAVEL_IN: Final = 5.0


class SlideState(NamedTuple):
    """The state of a slide in a snapshot."""

    position_in: float
    axis: AxisState


class Slide:
    """One axis between its ends: position 0 to `travel_in` inches."""

    def __init__(self, limits: AxisLimits, travel_in: float) -> None:
        self.travel_in = travel_in
        self.position_in = 0.0
        self._axis = Axis(limits, ramps=True)

    def to_state(self) -> SlideState:
        """Return all that changes."""
        return SlideState(self.position_in, self._axis.to_state())

    def set_state(self, state: SlideState) -> None:
        """Continue from a state; raise ValueError if it lies beyond the ends."""
        if not 0.0 <= state.position_in <= self.travel_in:
            raise ValueError("an arm beyond its end")
        self.position_in = state.position_in
        self._axis.set_state(state.axis)

    @property
    def moving(self) -> bool:
        """True from the command that starts a motion until it is done."""
        return self._axis.moving

    def command(self, command: Command, value_in: float) -> None:
        """Execute a command of arm_mv for one axis, in inches and seconds; relative targets are clamped to the ends."""
        # A target beyond an end would leave the axis moving against it.
        if command is Command.RELATIVE:
            value_in = min(max(value_in, -self.position_in), self.travel_in - self.position_in)
        self._axis.command(command, value_in)

    def seek_zero(self) -> None:
        """Move to 0 at the speed set, or at the top speed where that is 0."""
        self._axis.move_by(-self.position_in, self._axis.speed or self._axis.limits.top_speed)

    def stop(self) -> None:
        """Brake and hold."""
        self._axis.stop()

    def advance(self, dt_s: float) -> None:
        """Advance by dt_s seconds; the motion ends at an end of the travel."""
        # The axis itself has no ends: clamp, and stop it there.
        reached = self.position_in + self._axis.advance(dt_s)
        self.position_in = min(max(reached, 0.0), self.travel_in)
        if reached != self.position_in:
            self._axis.halt()


class ArmState(NamedTuple):
    """The state of an arm in a snapshot."""

    lift: SlideState
    grip: SlideState
    time_s: float


class Arm:
    """Lift and gripper."""

    def __init__(self) -> None:
        self.lift = Slide(LIFT, LIFT_TRAVEL_IN)
        self.grip = Slide(GRIP, GRIP_TRAVEL_IN)
        self.time_s = 0.0

    def to_state(self) -> ArmState:
        """Return all that changes."""
        return ArmState(self.lift.to_state(), self.grip.to_state(), self.time_s)

    @classmethod
    def from_state(cls, state: ArmState) -> Arm:
        """Return the arm of a state; raise ValueError if there is none."""
        arm = cls()
        arm.lift.set_state(state.lift)
        arm.grip.set_state(state.grip)
        arm.time_s = state.time_s
        return arm

    def advance_to(self, time_s: float) -> None:
        """Advance to an instant that is not before the current one."""
        for slide in (self.lift, self.grip):
            slide.advance(time_s - self.time_s)
        self.time_s = time_s

    def stop(self) -> None:
        """Brake and hold both axes."""
        self.lift.stop()
        self.grip.stop()

    def zero(self) -> None:
        """Move both axes to 0."""
        self.lift.seek_zero()
        self.grip.seek_zero()

    def is_still(self, lift: bool = True, grip: bool = True) -> bool:
        """Return True if none of the selected axes moves."""
        return not (lift and self.lift.moving) and not (grip and self.grip.moving)
