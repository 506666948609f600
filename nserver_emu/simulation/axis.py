"""One motor axis: what it was told, how fast it turns, how far it came. No robot, no pose, no noise, no clock.

A command is laid out at once as phases of constant acceleration; time then walks through them by the closed form, so
the way dt is cut changes nothing. A unit is an inch or a radian; the axis does not know which.

    instant       | cruise |              the axis jumps to its speed (the original's note on `ac`)
    trapezoid     / cruise \\              never beyond speed or acceleration, never past a relative target
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import copysign, inf, sqrt
from typing import Final, NamedTuple

TIME_TOLERANCE_S: Final = 1e-9
"""A phase that ends within this of now has ended: sums of dt differ from the closed form in the last bits (some
1e-13 s in an hour), and a robot at 20 in/s covers 2e-8 in meanwhile."""


class Mode(IntEnum):
    """What the axis was last told. HOLD is also where a finished motion ends."""

    HOLD = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3


class Command(IntEnum):
    """What an axis can be told: the modes of mv."""

    LEAVE = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3
    ACCELERATION = 4
    SPEED = 5


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """What one axis of a model can do, in units and seconds.

    top_speed, top_acceleration   values above are clamped silently, signs of speeds are dropped
    least_acceleration            values below are clamped to it: an axis that could not brake would run for ever
    speed, acceleration           in force at power-on
    resolution                    the least velocity that the encoders show while the axis moves
    """

    top_speed: float
    top_acceleration: float
    least_acceleration: float
    speed: float
    acceleration: float
    resolution: float


class Phase(NamedTuple):
    """A time of constant acceleration; the velocity never changes its sign inside it."""

    duration_s: float
    velocity: float
    acceleration: float


Run = tuple[tuple[Phase, ...], float, float]
"""What an axis will do until the next command: its phases, how long the first has lasted, and its resolution. A plain
tuple, for it is noted for every firing of a sonar."""


def shown_in(run: Run, dt_s: float) -> float:
    """What the encoders show dt_s >= 0 seconds into a run: never 0 while the axis moves, exactly 0 when it does not."""
    phases, elapsed_s, resolution = run
    if dt_s:
        _, phases, elapsed_s = _walk(phases, elapsed_s, dt_s)
    if not phases:
        return 0.0
    _, velocity, acceleration = phases[0]
    velocity += acceleration * elapsed_s
    if -resolution < velocity < resolution:
        return copysign(resolution, velocity or acceleration)
    return velocity


class Axis:
    """One axis with its limits; `ramps` False makes it jump to its speed.

    Commands take effect at once from the velocity in force; a speed or acceleration set during a motion counts from
    the next command on.
    """

    def __init__(self, limits: AxisLimits, ramps: bool) -> None:
        self.limits = limits
        self.ramps = ramps
        self.mode = Mode.HOLD
        self.speed = limits.speed
        self.acceleration = limits.acceleration
        self.count = 0.0
        """How far it went in all, units, the ways back taken off: what absolute positions are counted from."""
        self._phases: tuple[Phase, ...] = ()
        self._elapsed_s = 0.0

    @property
    def moving(self) -> bool:
        """True from the command that starts a motion until it is done."""
        return bool(self._phases)

    @property
    def velocity(self) -> float:
        """Units per second now; exactly 0 when still, and at the very first instant of a ramp."""
        if not self._phases:
            return 0.0
        phase = self._phases[0]
        return phase.velocity + phase.acceleration * self._elapsed_s

    @property
    def phase_acceleration(self) -> float:
        """Units per second squared until the phase ends."""
        return self._phases[0].acceleration if self._phases else 0.0

    @property
    def phase_left_s(self) -> float:
        """Seconds for which the acceleration stays what it is; inf when nothing ends."""
        return self._phases[0].duration_s - self._elapsed_s if self._phases else inf

    @property
    def fastest(self) -> float:
        """No less than its speed at any time until the next command, units per second: phases end at rest or cruise."""
        phases = self._phases
        if len(phases) == 1:
            return abs(phases[0].velocity)
        return max((abs(phase.velocity) for phase in phases), default=0.0)

    @property
    def extremes(self) -> tuple[float, float]:
        """No more than its least and no less than its greatest velocity until the next command, nor than 0."""
        least = most = 0.0
        for _, velocity, _ in self._phases:
            if velocity < least:
                least = velocity
            elif velocity > most:
                most = velocity
        return least, most

    @property
    def pace(self) -> tuple[float, float, float]:
        """`phase_left_s`, `velocity` and `phase_acceleration` at once, which is quicker."""
        if not self._phases:
            return inf, 0.0, 0.0
        duration_s, velocity, acceleration = self._phases[0]
        return duration_s - self._elapsed_s, velocity + acceleration * self._elapsed_s, acceleration

    @property
    def shown_velocity(self) -> float:
        """What the encoders show: never 0 while the axis moves, exactly 0 when it does not."""
        return shown_in(self.run, 0.0)

    @property
    def run(self) -> Run:
        """What it will do, as a value: what is commanded later changes nothing in it."""
        return self._phases, self._elapsed_s, self.limits.resolution

    def command(self, command: Command, value: float) -> None:
        """Do what one axis of mv says; LEAVE and LIMP need no value."""
        match command:
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
        """The speed of relative motions; the magnitude counts, clamped to the top speed. 0: they do not move."""
        self.speed = min(abs(speed), self.limits.top_speed)

    def set_acceleration(self, acceleration: float) -> None:
        """The acceleration of all ramps; the magnitude counts, clamped to what the axis can do."""
        wanted = max(abs(acceleration), self.limits.least_acceleration)
        self.acceleration = min(wanted, self.limits.top_acceleration)

    def move_at(self, velocity: float) -> None:
        """Run at a velocity (units/s, clamped to the top speed) until the next command; 0 brakes and holds."""
        top = self.limits.top_speed
        wanted = min(max(velocity, -top), top)
        self.mode = Mode.VELOCITY if wanted else Mode.HOLD
        ramp = self._ramp(self.velocity, wanted) if self.ramps else ()
        self._start((*ramp, Phase(inf, wanted, 0.0)) if wanted else ramp)

    def move_by(self, distance: float, speed: float | None = None) -> None:
        """Go a distance (units, from here) at `speed`, the speed set where None is given, and hold there.

        A target nearer than the braking distance of the motion in force is passed, for the acceleration is a
        limit of the motor, and approached again from the other side.
        """
        top = self.speed if speed is None else min(abs(speed), self.limits.top_speed)
        if top == 0.0:
            self.stop()
            return
        self.mode = Mode.RELATIVE
        if self.ramps:
            self._start(self._trapezoid(distance, top))
        else:
            self._start((Phase(abs(distance) / top, copysign(top, distance), 0.0),))

    def stop(self) -> None:
        """Brake and hold."""
        self.move_at(0.0)

    def limp(self) -> None:
        """Let go: the axis runs out, by friction taken to brake as hard as the acceleration set."""
        self.move_at(0.0)
        self.mode = Mode.LIMP

    def halt(self) -> None:
        """Stand still at once, whatever the acceleration: something is in the way."""
        self.mode = Mode.HOLD
        self._start(())

    def advance(self, dt_s: float) -> float:
        """Let dt_s >= 0 seconds pass; returns the displacement in units."""
        if not self._phases:
            return 0.0
        duration_s, velocity, acceleration = self._phases[0]
        elapsed_s = self._elapsed_s
        if dt_s < duration_s - elapsed_s - TIME_TOLERANCE_S:
            velocity += acceleration * elapsed_s
            travelled = (velocity + 0.5 * acceleration * dt_s) * dt_s
            self._elapsed_s = elapsed_s + dt_s
        else:
            travelled, self._phases, self._elapsed_s = _walk(self._phases, elapsed_s, dt_s)
            self._hold_when_done()
        self.count += travelled
        return travelled

    def way_in(self, dt_s: float) -> float:
        """How far dt_s >= 0 seconds will take it, units; nothing changes by asking."""
        return _walk(self._phases, self._elapsed_s, dt_s)[0] if self._phases else 0.0

    def _start(self, phases: tuple[Phase, ...]) -> None:
        """Take up the phases that have a duration; a finished motion holds."""
        self._phases = tuple(phase for phase in phases if phase.duration_s > 0.0)
        self._elapsed_s = 0.0
        self._hold_when_done()

    def _hold_when_done(self) -> None:
        if not self._phases and self.mode != Mode.LIMP:
            self.mode = Mode.HOLD

    def _ramp(self, start: float, end: float) -> tuple[Phase, ...]:
        """From one velocity to another at the acceleration in force; in two phases where the sign changes."""
        if start * end < 0.0:
            return (*self._ramp(start, 0.0), *self._ramp(0.0, end))
        return (Phase(abs(end - start) / self.acceleration, start, copysign(self.acceleration, end - start)),)

    def _trapezoid(self, distance: float, top: float) -> tuple[Phase, ...]:
        """From the velocity in force to standing still `distance` ahead, at most `top` fast once ramped to it.

        All in the direction `way` in which the point of standstill has to be moved. With start velocity u, peak p
        and acceleration A the two ramps cover (p^2 - u^2) / 2A + p^2 / 2A; what is left is cruise.
        """
        start, rate = self.velocity, self.acceleration
        way = copysign(1.0, distance - start * abs(start) / (2.0 * rate))
        forward, ahead = way * start, way * distance
        peak = sqrt(max(rate * ahead + 0.5 * forward * forward, 0.0))
        cruise_s = 0.0
        if peak > top:
            ramped = top * top - forward * forward
            ramps = (abs(ramped) if forward > top else ramped) + top * top
            peak = top
            cruise_s = max(ahead - ramps / (2.0 * rate), 0.0) / top
        up = self._ramp(start, way * peak)
        return (*up, Phase(cruise_s, way * peak, 0.0), *self._ramp(way * peak, 0.0))


def _walk(phases: tuple[Phase, ...], elapsed_s: float, dt_s: float) -> tuple[float, tuple[Phase, ...], float]:
    """The way that dt_s seconds take, the phases that are left then, and how long the first of them has lasted."""
    travelled = 0.0
    while phases:
        duration_s, velocity, acceleration = phases[0]
        left_s = duration_s - elapsed_s
        velocity += acceleration * elapsed_s
        if dt_s < left_s - TIME_TOLERANCE_S:
            return travelled + (velocity + 0.5 * acceleration * dt_s) * dt_s, phases, elapsed_s + dt_s
        travelled += (velocity + 0.5 * acceleration * left_s) * left_s
        dt_s = max(dt_s - left_s, 0.0)
        phases, elapsed_s = phases[1:], 0.0
    return travelled, phases, 0.0
