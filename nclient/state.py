"""RobotState: the 45 numbers of State and what came with them, as an immutable value in everyday units.

    x_in  x_m   inches, metres            steering_rad  steering_deg   radians, degrees        clock_s  seconds

Properties compute on access, so that a state is cheap to create. Angles lie in [0, 2 pi) or [0, 360), counter-clockwise
positive. Numbers that were never received read 0, as in the C library; clock and battery read None.

Quantities of programs, with the unit in the keyword, converted to the tenths of the wire.

    tenths_of(translation_in_s=2.5)  25        tenths_of(steering_rad=math.pi)  1800
    tenths_of(x_in=None, x_m=0.3)    118       two units of one quantity are a TypeError

Values are rounded to the nearest tenth; nan and inf are a ValueError.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, NamedTuple, cast

from nclient.protocol import types
from nclient.protocol.client_state import ClientState
from nclient.protocol.types import CPU_RANGE_V, M_PER_IN, MAX_SONAR_IN, Model, Stamp, rad_from_tenths, tenths, volts

_UNIT_OF = {
    "in": 1.0, "in_s": 1.0, "in_s2": 1.0,
    "m": 1 / M_PER_IN, "m_s": 1 / M_PER_IN, "m_s2": 1 / M_PER_IN,
    "deg": 1.0, "deg_s": 1.0, "deg_s2": 1.0,
    "rad": math.degrees(1), "rad_s": math.degrees(1), "rad_s2": math.degrees(1),
}  # fmt: skip
"""Inches or degrees per unit, by the ending of a keyword."""

Points = Sequence[tuple[float, float]]
"""Points (x, y) of a line or a polygon."""


def tenths_of(*, default: int = 0, **quantity: float | None) -> int:
    """Return one quantity in tenths of an inch or degree.

    Parameters
    ----------
    default
        The result if no value is given.
    **quantity
        The same quantity in several units, at most one of them not None; the ending of a keyword is its unit.

    Raises
    ------
    TypeError
        If more than one value is given.
    ValueError
        If the value is not finite.
    """
    # At most one unit: two would contradict each other.
    values = [(name, value) for name, value in quantity.items() if value is not None]
    if not values:
        return default
    if len(values) > 1:
        raise TypeError(f"one of {', '.join(quantity)}, not {' and '.join(name for name, _ in values)}")
    # The part of the keyword behind its first underscore is the unit.
    ((name, value),) = values
    if not math.isfinite(value):
        raise ValueError(f"{name} is a finite number, not {value}")
    return tenths(value * _UNIT_OF[name.partition("_")[2]])


def points_tenths(points_in: Points | None, points_m: Points | None) -> tuple[int, ...]:
    """Return x1, y1, x2, y2 ... in tenths of an inch. Raises TypeError unless exactly one argument is not None."""
    if (points_in is None) == (points_m is None):
        raise TypeError("points in inches (..._in) or in metres (..._m): one of them")
    if points_in is not None:
        return tuple(tenths_of(each_in=value) for point in points_in for value in point)
    return tuple(tenths_of(each_m=value) for point in points_m or () for value in point)


def firing_order(order: Iterable[int]) -> tuple[int, ...]:
    """Return a firing order in wire format: sixteen numbers, filled up with 255.

    Parameters
    ----------
    order
        At most 16 sensors, 0..15.

    Raises
    ------
    ValueError
        If the order is longer or has other numbers.
    """
    numbers = tuple(order)
    if len(numbers) > _RING or any(number not in range(_RING) for number in numbers):
        raise ValueError(f"an order is at most {_RING} sensors 0..{_RING - 1}, not {numbers}")
    return numbers + (_END,) * (_RING - len(numbers))


# Number of sensors of a ring, and the end mark of a firing order.
_RING, _END = types.SONAR_SLOTS, 255


class AxisMode(IntEnum):
    """Mode of an axis in mv."""

    LEAVE = 0
    VELOCITY = 1
    RELATIVE = 2
    LIMP = 3
    ACCELERATION = 4
    SPEED = 5


class AxisCommand(NamedTuple):
    """Command of one axis for `Robot.drive_axes`; without arguments the axis is left alone."""

    mode: AxisMode = AxisMode.LEAVE
    value: int = 0
    """Tenths of an inch or degree, per second for velocities and speeds, per second squared for accelerations."""

    @classmethod
    def velocity(cls, *, in_s: float | None = None, m_s: float | None = None,
                 deg_s: float | None = None, rad_s: float | None = None) -> AxisCommand:
        """Return the command to keep this velocity until the next one."""
        return cls(AxisMode.VELOCITY, tenths_of(at_in_s=in_s, at_m_s=m_s, at_deg_s=deg_s, at_rad_s=rad_s))

    @classmethod
    def relative(cls, *, by_in: float | None = None, by_m: float | None = None,
                 by_deg: float | None = None, by_rad: float | None = None) -> AxisCommand:
        """Return the command to move by this distance or angle."""
        return cls(AxisMode.RELATIVE, tenths_of(by_in=by_in, by_m=by_m, by_deg=by_deg, by_rad=by_rad))

    @classmethod
    def limp(cls) -> AxisCommand:
        """Return the command to switch the motor off."""
        return cls(AxisMode.LIMP)

    @classmethod
    def acceleration(cls, *, in_s2: float | None = None, m_s2: float | None = None,
                     deg_s2: float | None = None, rad_s2: float | None = None) -> AxisCommand:
        """Return the command to set the acceleration."""
        return cls(AxisMode.ACCELERATION, tenths_of(to_in_s2=in_s2, to_m_s2=m_s2, to_deg_s2=deg_s2, to_rad_s2=rad_s2))

    @classmethod
    def speed(cls, *, in_s: float | None = None, m_s: float | None = None,
              deg_s: float | None = None, rad_s: float | None = None) -> AxisCommand:
        """Return the command to set the speed of relative motions."""
        return cls(AxisMode.SPEED, tenths_of(at_in_s=in_s, at_m_s=m_s, at_deg_s=deg_s, at_rad_s=rad_s))


NO_ECHO_IN: Final = MAX_SONAR_IN
"""The reading of a sonar without echo."""
WHEEL_IN_PER_DEG = types.SCOUT_WHEEL_IN_PER_DEG


@dataclass(frozen=True, slots=True)
class Pose:
    """A position in inches and two directions in radians; the turret of a Scout is its body."""

    x_in: float
    y_in: float
    steering_rad: float = 0.0
    turret_rad: float = 0.0

    @classmethod
    def from_metres(cls, x_m: float, y_m: float, steering_rad: float = 0.0, turret_rad: float = 0.0) -> Pose:
        """Return the pose at a position in metres."""
        return cls(x_m / M_PER_IN, y_m / M_PER_IN, steering_rad, turret_rad)

    @classmethod
    def from_degrees(cls, x_in: float, y_in: float, steering_deg: float = 0.0, turret_deg: float = 0.0) -> Pose:
        """Return the pose with directions in degrees."""
        return cls(x_in, y_in, math.radians(steering_deg), math.radians(turret_deg))

    @property
    def x_m(self) -> float:
        """Return x in metres."""
        return self.x_in * M_PER_IN

    @property
    def y_m(self) -> float:
        """Return y in metres."""
        return self.y_in * M_PER_IN

    @property
    def steering_deg(self) -> float:
        """Direction of the steering in degrees."""
        return math.degrees(self.steering_rad)

    @property
    def turret_deg(self) -> float:
        """Direction of the turret in degrees."""
        return math.degrees(self.turret_rad)


@dataclass(frozen=True, slots=True)
class Truth(Pose):
    """Ground truth of a simulated robot, as opposed to its encoders; simulated time in seconds."""

    time_s: float = 0.0
    seed: int = 0
    robot_id: int = 0


class Battery(NamedTuple):
    """Voltages of the two batteries."""

    cpu_v: float
    motor_v: float


class PositionStamp(NamedTuple):
    """Encoder pose and velocities at the time of a sensor's reading; times of the robot's clock."""

    pose: Pose
    translation_in_s: float
    steering_rad_s: float
    turret_rad_s: float
    pose_time_s: float
    sensor_time_s: float


@dataclass(frozen=True, slots=True)
class RobotState:
    """State of a robot at one moment, from its last replies."""

    model: Model
    raw: tuple[int, ...]
    """State[0] to State[44] in wire units."""
    laser: tuple[int, ...] = (0,)
    """The laser vector: number of readings, then their coordinates in 1/10 inch, in the robot's frame."""
    raw_stamps: Mapping[str, Stamp] = field(default_factory=dict)
    """Position stamps by sensor (ir_0, sonar_15, bumper, laser, compass), in wire units."""
    clock_ms: int | None = None
    raw_volts: tuple[int, int] | None = None
    is_held: bool = False
    """True while a person holds the robot (Stop); `Robot.held_by` returns who. Over TCP only."""
    ring_in: tuple[float, ...] | None = None
    """All readings of the ring of a model file, inches, after `Robot.watch_ring`; `sonars_in` has 16 at most."""

    def _repr_html_(self) -> str:

        return state_html(self)

    @property
    def speed_factor(self) -> float:
        """Speed of the other end's time, 1.0 real time; 0 if it is paused or advances only with each exchange."""
        return self.raw[0] / 10

    # -- sensors ------------------------------------------------------------------------------------------------------

    @property
    def infrareds(self) -> tuple[int, ...]:
        """Sixteen infrared readings 0..15, lower is nearer, 15 no reflection; number i at 22.5 deg x i."""
        return self.raw[1:17]

    @property
    def sonars_in(self) -> tuple[int, ...]:
        """Sixteen sonar readings in whole inches from the ring, 255 no echo; number i at 22.5 deg x i."""
        return self.raw[17:33]

    @property
    def sonars_m(self) -> tuple[float | None, ...]:
        """Sixteen sonar readings in metres from the ring; None without echo."""
        return tuple(None if reading >= NO_ECHO_IN else reading * M_PER_IN for reading in self.raw[17:33])

    @property
    def bumpers(self) -> tuple[int, ...]:
        """Numbers of the closed bumpers, without the bits that a robot on a serial line sets at rest."""
        # One bit per bumper; some models send bits that are set at rest.
        bits = self.raw[33] & ~self.model.bumper_rest
        return tuple(number for number in range(bits.bit_length()) if bits >> number & 1)

    @property
    def touching(self) -> bool:
        """True if any bumper is closed."""
        return bool(self.raw[33] & ~self.model.bumper_rest)

    @property
    def compass_deg(self) -> float:
        """Direction of the compass in degrees."""
        return self.raw[43] / 10

    @property
    def compass_rad(self) -> float:
        """Direction of the compass in radians."""
        return rad_from_tenths(self.raw[43])

    @property
    def laser_points_in(self) -> tuple[tuple[float, ...], ...]:
        """Laser readings in inches, in the robot's frame: (x, y) points, or (x1, y1, x2, y2) lines.

        Empty in modes whose readings are camera rows; `laser` has those.
        """
        # Readings of a mode have one width: 2 of points, 4 of lines, 1 of camera rows.
        count, values = self.laser[0], self.laser[1:]
        width = len(values) // count if count else 0
        if width <= 1:
            return ()
        return tuple(tuple(v / 10 for v in values[k : k + width]) for k in range(0, len(values), width))

    # -- pose of the encoders -----------------------------------------------------------------------------------------

    @property
    def pose(self) -> Pose:
        """Pose of the encoders."""
        return Pose(self.x_in, self.y_in, self.steering_rad, self.turret_rad)

    @property
    def x_in(self) -> float:
        """Return x in inches."""
        return self.raw[34] / 10

    @property
    def y_in(self) -> float:
        """Return y in inches."""
        return self.raw[35] / 10

    @property
    def x_m(self) -> float:
        """Return x in metres."""
        return self.raw[34] / 10 * M_PER_IN

    @property
    def y_m(self) -> float:
        """Return y in metres."""
        return self.raw[35] / 10 * M_PER_IN

    @property
    def steering_rad(self) -> float:
        """Direction of the steering in radians."""
        return rad_from_tenths(self.raw[36])

    @property
    def steering_deg(self) -> float:
        """Direction of the steering in degrees."""
        return self.raw[36] / 10

    @property
    def turret_rad(self) -> float:
        """Direction of the turret in radians."""
        return rad_from_tenths(self.raw[37])

    @property
    def turret_deg(self) -> float:
        """Direction of the turret in degrees."""
        return self.raw[37] / 10

    # -- velocities ---------------------------------------------------------------------------------------------------

    @property
    def translation_in_s(self) -> float:
        """Forward speed in inches per second; of a Scout the mean of its wheels."""
        return (self.right_in_s + self.left_in_s) / 2

    @property
    def translation_m_s(self) -> float:
        """Forward speed in metres per second."""
        return self.translation_in_s * M_PER_IN

    @property
    def steering_deg_s(self) -> float:
        """Turn rate of the steering in degrees per second; of a Scout that of its body, from its wheels."""
        if self.model.has_turret:
            return self.raw[39] / 10
        # Half the difference of the wheels' speeds, divided by the path of a wheel per degree.
        return (self.right_in_s - self.left_in_s) / 2 / WHEEL_IN_PER_DEG

    @property
    def steering_rad_s(self) -> float:
        """Turn rate of the steering in radians per second."""
        return math.radians(self.steering_deg_s)

    @property
    def turret_deg_s(self) -> float:
        """Turn rate of the turret in degrees per second; of a Scout that of its body."""
        return self.raw[40] / 10 if self.model.has_turret else self.steering_deg_s

    @property
    def turret_rad_s(self) -> float:
        """Turn rate of the turret in radians per second."""
        return math.radians(self.turret_deg_s)

    @property
    def right_in_s(self) -> float:
        """Speed of a Scout's right wheel in inches per second; of other models that of all wheels."""
        return self.raw[38] / 10

    @property
    def left_in_s(self) -> float:
        """Speed of a Scout's left wheel in inches per second; of other models that of all wheels."""
        return self.raw[38 if self.model.has_turret else 39] / 10

    @property
    def right_m_s(self) -> float:
        """Speed of a Scout's right wheel in metres per second."""
        return self.right_in_s * M_PER_IN

    @property
    def left_m_s(self) -> float:
        """Speed of a Scout's left wheel in metres per second."""
        return self.left_in_s * M_PER_IN

    # -- motors -------------------------------------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """True if any motor runs."""
        # State[41] has a bit per axis; bits above 1 of a Scout are battery and emergency stop.
        return bool(self.raw[41] & (7 if self.model.has_turret else 3))

    @property
    def translation_moving(self) -> bool:
        """True if the robot rolls; of a Scout if any wheel turns."""
        return bool(self.raw[41] & (1 if self.model.has_turret else 3))

    @property
    def steering_moving(self) -> bool:
        """True if the steering turns; of a Scout if any wheel does."""
        return bool(self.raw[41] & (2 if self.model.has_turret else 3))

    @property
    def turret_moving(self) -> bool:
        """True if the turret turns; a Scout has none."""
        return self.model.has_turret and bool(self.raw[41] & 4)

    @property
    def on_mains(self) -> bool:
        """True if a Scout is connected to mains; other models do not report it."""
        return self._scout_bit(4)

    @property
    def charging(self) -> bool:
        """True if a Scout is charging."""
        return self._scout_bit(5)

    @property
    def emergency_stop(self) -> bool:
        """True if the emergency stop of a Scout is pressed."""
        return self._scout_bit(6)

    def _scout_bit(self, bit: int) -> bool:
        return not self.model.has_turret and bool(self.raw[41] >> bit & 1)

    # -- battery, clock, stamps, errors -------------------------------------------------------------------------------

    @property
    def battery(self) -> Battery | None:
        """Voltages of computer and motors; None until received."""
        if self.raw_volts is None:
            return None
        return Battery(volts(self.raw_volts[0], CPU_RANGE_V), volts(self.raw_volts[1], types.MOTOR_RANGE_V))

    @property
    def clock_s(self) -> float | None:
        """The robot's clock as last received: seconds since power-on; None until received."""
        return None if self.clock_ms is None else self.clock_ms / 1000

    @property
    def stamps(self) -> dict[str, PositionStamp]:
        """The last position stamp of each sensor selected with `Robot.position_data`."""
        return {name: _stamp(raw) for name, raw in self.raw_stamps.items()}

    @property
    def error(self) -> int:
        """State[44]: the code of the last refusal; 0 after a complete state."""
        return self.raw[44]


def snapshot(client_state: ClientState, model: Model) -> RobotState:
    """Return the current client state as an immutable value."""
    slots = client_state.slots
    # Slots without a value yet read 0; after the first whole state there are none.
    raw = tuple([value or 0 for value in slots]) if None in slots else cast("tuple[int, ...]", tuple(slots))
    stamps = dict(client_state.stamps) if client_state.stamps else {}
    return RobotState(model, raw, client_state.laser or (0,), stamps, client_state.clock, client_state.volts,
                      client_state.is_held)


def _stamp(raw: Stamp) -> PositionStamp:
    return PositionStamp(Pose(raw.x / 10, raw.y / 10, rad_from_tenths(raw.steer), rad_from_tenths(raw.turret)),
                         raw.v_trans / 10, rad_from_tenths(raw.v_steer), rad_from_tenths(raw.v_turret),
                         raw.pose_time / 1000, raw.sensor_time / 1000)


# -- picture in a notebook: pose, motion, sensors, and the sonars from above -----------------------------------------

BODY_IN: Final = 9.0
SIZE_PX: Final = 200
REACH_IN: Final = 130.0
"""Half the width of the picture; longer ranges are cut off."""


def state_html(state: RobotState, note: str = "") -> str:
    """Return a table of the state beside a picture of its sonars, as HTML."""
    from html import escape  # only notebooks need it

    rows = "".join(f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>"
                   f"{escape(text)}</td></tr>" for name, text in _rows(state, note))  # fmt: skip
    return f"<div style='display:flex;gap:1em;align-items:center'>{sonars_svg(state)}<table>{rows}</table></div>"


def _rows(state: RobotState, note: str) -> Iterator[tuple[str, str]]:
    yield "model", state.model.name + note
    yield "encoders", f"x {state.x_in:.1f} in, y {state.y_in:.1f} in, heading {math.degrees(state.steering_rad):.1f}°"
    yield "moving", "yes" if state.moving else "no"
    yield "bumpers", ", ".join(map(str, state.bumpers)) or "free"
    nearest = min(state.sonars_in)
    yield "nearest sonar", f"{nearest} in" if nearest < NO_ECHO_IN else "no echo"
    if state.clock_s is not None:
        yield "clock", f"{state.clock_s:.2f} s"


def sonars_svg(state: RobotState) -> str:
    """Return the robot from above, its heading up, and a line to each sonar's range."""
    turn = state.turret_rad - state.steering_rad
    lines = []
    for number, reading in enumerate(state.sonars_in):
        angle = turn + 2.0 * math.pi * number / len(state.sonars_in)
        # Ahead is up: x of the picture is to the right of the robot.
        ahead, left = math.cos(angle), math.sin(angle)
        far = min(BODY_IN + reading, REACH_IN)
        color = "#d1495b" if reading < NO_ECHO_IN else "#ccd5dc"
        lines.append(f'<path d="M{-BODY_IN * left:.1f} {-BODY_IN * ahead:.1f}L{-far * left:.1f} {-far * ahead:.1f}" '
                     f'stroke="{color}" stroke-width="2"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE_PX}" height="{SIZE_PX}" role="img" '
        f'viewBox="{-REACH_IN:g} {-REACH_IN:g} {2 * REACH_IN:g} {2 * REACH_IN:g}"><title>sonars, heading up</title>'
        f'<rect x="{-REACH_IN:g}" y="{-REACH_IN:g}" width="{2 * REACH_IN:g}" height="{2 * REACH_IN:g}" fill="#fff"/>'
        f'{"".join(lines)}<circle r="{BODY_IN:g}" fill="#fff" stroke="#1b1b1b" stroke-width="2"/>'
        f'<path d="M0 0V{-BODY_IN:g}" stroke="#1b1b1b" stroke-width="2"/></svg>'
    )
