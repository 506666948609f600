"""What is known of a robot after an exchange, as a value: the 45 numbers of State, read in the units people use.

    x_in  x_m   inches, metres            steering_rad  steering_deg   radians, degrees        clock_s  seconds

Rules: nothing is computed before it is asked for, so that a state costs little; nothing here talks. Angles lie in
[0, 2 pi) or [0, 360), counter-clockwise positive. What never came reads 0, as in the C library; clock and battery None.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from nclient.protocol.client_state import ClientState
from nclient.protocol.types import (
    CPU_RANGE_V,
    M_PER_IN,
    MOTOR_RANGE_V,
    SCOUT_WHEEL_IN_PER_DEG,
    Model,
    Stamp,
    rad_from_tenths,
    volts,
)

NOTHING_IN = 255
"""A sonar that heard nothing."""
WHEEL_IN_PER_DEG = SCOUT_WHEEL_IN_PER_DEG


@dataclass(frozen=True, slots=True)
class Pose:
    """A place and two directions: inches, radians, counter-clockwise positive. A Scout's turret is its body."""

    x_in: float
    y_in: float
    steering_rad: float = 0.0
    turret_rad: float = 0.0

    @classmethod
    def from_metres(cls, x_m: float, y_m: float, steering_rad: float = 0.0, turret_rad: float = 0.0) -> Pose:
        """The pose at so many metres."""
        return cls(x_m / M_PER_IN, y_m / M_PER_IN, steering_rad, turret_rad)

    @classmethod
    def from_degrees(cls, x_in: float, y_in: float, steering_deg: float = 0.0, turret_deg: float = 0.0) -> Pose:
        """The pose with directions in degrees."""
        return cls(x_in, y_in, math.radians(steering_deg), math.radians(turret_deg))

    @property
    def x_m(self) -> float:
        """x in metres."""
        return self.x_in * M_PER_IN

    @property
    def y_m(self) -> float:
        """y in metres."""
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
    """Where the actual robot is, as only its simulation knows; the encoders say something else. Time is simulated."""

    time_s: float = 0.0
    seed: int = 0
    robot_id: int = 0


class Battery(NamedTuple):
    """Volts of the two batteries."""

    cpu_v: float
    motor_v: float


class PositionStamp(NamedTuple):
    """Where the robot was by its encoders, and how fast, when a sensor took its reading; times of the robot's clock."""

    pose: Pose
    translation_in_s: float
    steering_rad_s: float
    turret_rad_s: float
    pose_time_s: float
    sensor_time_s: float


@dataclass(frozen=True, slots=True)
class RobotState:
    """One moment of a robot, as its last answers tell it."""

    model: Model
    raw: tuple[int, ...]
    """State[0] to State[44], wire units."""
    laser: tuple[int, ...] = (0,)
    """The laser vector: how many readings, then their numbers, 1/10 inch in the robot's frame."""
    raw_stamps: Mapping[str, Stamp] = field(default_factory=dict)
    """Position stamps by sensor (ir_0, sonar_15, bumper, laser, compass), wire units."""
    clock_ms: int | None = None
    raw_volts: tuple[int, int] | None = None

    @property
    def speed_factor(self) -> float:
        """How fast the other end's time runs, 1.0 real time; 0 when it is paused or moves only with each exchange."""
        return self.raw[0] / 10

    # sensors

    @property
    def infrareds(self) -> tuple[int, ...]:
        """Sixteen infrared readings 0..15, lower is nearer, 15 nothing; number i at 22.5 deg x i."""
        return self.raw[1:17]

    @property
    def sonars_in(self) -> tuple[int, ...]:
        """Sixteen sonar readings, whole inches from the ring, 255 nothing; number i at 22.5 deg x i."""
        return self.raw[17:33]

    @property
    def sonars_m(self) -> tuple[float | None, ...]:
        """Sixteen sonar readings in metres from the ring; None where nothing was heard."""
        return tuple(None if reading >= NOTHING_IN else reading * M_PER_IN for reading in self.raw[17:33])

    @property
    def bumpers(self) -> tuple[int, ...]:
        """Numbers of the bumpers that touch; the bits that a robot at rest shows on its own line are left out."""
        bits = self.raw[33] & ~self.model.bumper_rest
        return tuple(number for number in range(bits.bit_length()) if bits >> number & 1)

    @property
    def touching(self) -> bool:
        """Whether any bumper touches."""
        return bool(self.raw[33] & ~self.model.bumper_rest)

    @property
    def compass_deg(self) -> float:
        """Direction by the compass in degrees."""
        return self.raw[43] / 10

    @property
    def compass_rad(self) -> float:
        """Direction by the compass in radians."""
        return rad_from_tenths(self.raw[43])

    @property
    def laser_points_in(self) -> tuple[tuple[float, ...], ...]:
        """The laser's readings in the robot's frame, inches: (x, y) points, or (x1, y1, x2, y2) lines. A mode whose
        readings are rows of the camera has none: those are `laser`."""
        count, values = self.laser[0], self.laser[1:]
        width = len(values) // count if count else 0
        if width <= 1:
            return ()
        return tuple(tuple(v / 10 for v in values[k : k + width]) for k in range(0, len(values), width))

    # pose, by the encoders

    @property
    def pose(self) -> Pose:
        """Where the encoders say the robot is."""
        return Pose(self.x_in, self.y_in, self.steering_rad, self.turret_rad)

    @property
    def x_in(self) -> float:
        """x in inches."""
        return self.raw[34] / 10

    @property
    def y_in(self) -> float:
        """y in inches."""
        return self.raw[35] / 10

    @property
    def x_m(self) -> float:
        """x in metres."""
        return self.raw[34] / 10 * M_PER_IN

    @property
    def y_m(self) -> float:
        """y in metres."""
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

    # velocities

    @property
    def translation_in_s(self) -> float:
        """Speed forward in inches a second; a Scout's is the mean of its wheels."""
        return (self.right_in_s + self.left_in_s) / 2

    @property
    def translation_m_s(self) -> float:
        """Speed forward in metres a second."""
        return self.translation_in_s * M_PER_IN

    @property
    def steering_deg_s(self) -> float:
        """Rate of the steering in degrees a second; a Scout's is the rate of its body, from its wheels."""
        if self.model.has_turret:
            return self.raw[39] / 10
        return (self.right_in_s - self.left_in_s) / 2 / WHEEL_IN_PER_DEG

    @property
    def steering_rad_s(self) -> float:
        """Rate of the steering in radians a second."""
        return math.radians(self.steering_deg_s)

    @property
    def turret_deg_s(self) -> float:
        """Rate of the turret in degrees a second; a Scout's turns with its body."""
        return self.raw[40] / 10 if self.model.has_turret else self.steering_deg_s

    @property
    def turret_rad_s(self) -> float:
        """Rate of the turret in radians a second."""
        return math.radians(self.turret_deg_s)

    @property
    def right_in_s(self) -> float:
        """Speed of a Scout's right wheel in inches a second; the wheels of the others all roll at the same speed."""
        return self.raw[38] / 10

    @property
    def left_in_s(self) -> float:
        """Speed of a Scout's left wheel in inches a second; the wheels of the others all roll at the same speed."""
        return self.raw[38 if self.model.has_turret else 39] / 10

    @property
    def right_m_s(self) -> float:
        """Speed of a Scout's right wheel in metres a second."""
        return self.right_in_s * M_PER_IN

    @property
    def left_m_s(self) -> float:
        """Speed of a Scout's left wheel in metres a second."""
        return self.left_in_s * M_PER_IN

    # motors

    @property
    def moving(self) -> bool:
        """Whether any motor turns."""
        return bool(self.raw[41] & (7 if self.model.has_turret else 3))

    @property
    def translation_moving(self) -> bool:
        """Whether the robot rolls: a Scout when any wheel turns."""
        return bool(self.raw[41] & (1 if self.model.has_turret else 3))

    @property
    def steering_moving(self) -> bool:
        """Whether the steering turns: a Scout when any wheel does."""
        return bool(self.raw[41] & (2 if self.model.has_turret else 3))

    @property
    def turret_moving(self) -> bool:
        """Whether the turret turns; a Scout has none."""
        return self.model.has_turret and bool(self.raw[41] & 4)

    @property
    def on_mains(self) -> bool:
        """Whether a Scout says that it is plugged in; the others do not tell."""
        return self._scout_bit(4)

    @property
    def charging(self) -> bool:
        """Whether a Scout says that it charges."""
        return self._scout_bit(5)

    @property
    def emergency_stop(self) -> bool:
        """Whether a Scout's emergency stop is pressed."""
        return self._scout_bit(6)

    def _scout_bit(self, bit: int) -> bool:
        return not self.model.has_turret and bool(self.raw[41] >> bit & 1)

    # the rest

    @property
    def battery(self) -> Battery | None:
        """Volts of computer and motors; None before the robot told them."""
        if self.raw_volts is None:
            return None
        return Battery(volts(self.raw_volts[0], CPU_RANGE_V), volts(self.raw_volts[1], MOTOR_RANGE_V))

    @property
    def clock_s(self) -> float | None:
        """The robot's clock when it last told it: seconds since power-on; None before."""
        return None if self.clock_ms is None else self.clock_ms / 1000

    @property
    def stamps(self) -> dict[str, PositionStamp]:
        """Position stamps by sensor, of those asked for with Robot.position_data; the last of each that came."""
        return {name: _stamp(raw) for name, raw in self.raw_stamps.items()}

    @property
    def error(self) -> int:
        """State[44]: the code of the last refusal; 0 after a whole state came."""
        return self.raw[44]


def snapshot(client_state: ClientState, model: Model) -> RobotState:
    """What is held now, as a value that does not change."""
    raw = tuple([value or 0 for value in client_state.slots])
    stamps = dict(client_state.stamps) if client_state.stamps else {}
    return RobotState(model, raw, client_state.laser or (0,), stamps, client_state.clock, client_state.volts)


def _stamp(raw: Stamp) -> PositionStamp:
    return PositionStamp(
        Pose(raw.x / 10, raw.y / 10, rad_from_tenths(raw.steer), rad_from_tenths(raw.turret)),
        raw.v_trans / 10,
        rad_from_tenths(raw.v_steer),
        rad_from_tenths(raw.v_turret),
        raw.pose_time / 1000,
        raw.sensor_time / 1000,
    )
