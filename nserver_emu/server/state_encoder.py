"""The State vector and laser vector of a simulated robot in wire units: here inches and radians become tenths.

    State   0 speed | 1-16 infrared | 17-32 sonar | 33 bumper | 34-37 x y steering turret | 38-40 velocities
            41 motors | 42 laser mode | 43 compass | 44 error
    laser   count, then per reading 4 words (lines x1 y1 x2 y2), 2 words (points x y, robot's frame) or 1 word (the
            camera's row of each column)

Axes count in tenths of an inch if they roll and tenths of a degree if they turn; the model decides (the second axis of
an N150 steers, that of a Scout is its left wheel). Encoding reads the robot and changes only the connection's context.
A slot that the sensor mask excludes keeps the value last sent on that connection; on a robot's own line it is not sent.
Excluded sensors are not evaluated, which saves their ray casts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from nclient.protocol.client_state import STATE_SIZE
from nclient.protocol.replies import Reply
from nclient.protocol.types import (
    BUMPER_SLOT,
    COMPASS_SLOT,
    CPU_RANGE_V,
    EVERYTHING,
    INFRARED_KEYS,
    LASER_SLOT,
    MOTOR_RANGE_V,
    SONAR_KEYS,
    Mask,
    Position,
    Stamp,
    clamp_word,
    heading_tenths,
    rad_from_tenths,
    raw_volts,
    tenths,
)
from nclient.protocol.wire_state import LINES, POINTS
from nserver_emu.server.session import ConnectionContext
from nserver_emu.simulation import segments
from nserver_emu.simulation.laser import LineFit, lines, pixels, points
from nserver_emu.simulation.robot import SimulatedRobot, battery_v
from nserver_emu.simulation.segments import Pose, to_s


def axis_values(robot: SimulatedRobot, tenths: tuple[int, ...]) -> tuple[float, float, float]:
    """Return the three values of a command in inches or radians, as the model's axes count."""
    first, second, third = (
        number / 10 if rolls else rad_from_tenths(number)
        for number, rolls in zip(tenths, robot.model.in_inches, strict=True)
    )
    return first, second, third


def axis_tenths(robot: SimulatedRobot, values: tuple[float, float, float]) -> tuple[int, int, int]:
    """Return axis values (inches or radians) in tenths; a value other than zero never becomes zero."""
    first, second, third = (
        away_from_zero(value * 10 if rolls else math.degrees(value) * 10)
        for value, rolls in zip(values, robot.model.in_inches, strict=True)
    )
    return first, second, third


def away_from_zero(value: float) -> int:
    """Return the nearest integer, for a value other than zero the nearest except zero."""
    rounded = round(value)
    return rounded if rounded or not value else (1 if value > 0 else -1)


def is_on(mode: int) -> bool:
    """Return True if the laser is on in this mode (bit 0)."""
    return bool(mode & 1)


def laser_vector(robot: SimulatedRobot, context: ConnectionContext, width: int) -> tuple[int, ...]:
    """Return the laser vector with `width` words per reading and a connection's settings; (0,) if it is empty."""
    view = robot.scan_laser(context.laser_columns)
    if width not in (POINTS, LINES):
        rows = pixels(view)
        return (len(rows), *rows)
    found = points(view, robot.model.body)
    if width == LINES:
        found = lines(found, _line_fit(context))
    # Rounded as `tenths` does, but in an array: a scan has up to 964 numbers.
    values = np.floor(np.abs(found.ravel()) * 10 + 0.5)
    return (len(found), *np.where(found.ravel() < 0.0, -values, values).astype(int).tolist())


def _line_fit(context: ConnectionContext) -> LineFit:
    """Return the line extraction settings of a connection (conf_sg)."""
    if context.segments is None:
        return LineFit()
    threshold, min_points, gap = context.segments
    return LineFit(threshold / 10, min_points, gap / 10)


# The infrared reading without an obstacle in range.
INFRARED_NOTHING = 15
# The clock is a 32-bit word of milliseconds: it wraps around after 50 days.
CLOCK_WORD = 0xFFFFFFFF
_MOTORS_SLOT = 41
# Slots that no mask excludes: speed, motors, error.
UNMASKED_SLOTS = (0, _MOTORS_SLOT, 44)


def clock_ms(time_s: float, step_s: float = 0.0) -> int:
    """Return a time as a clock of whole milliseconds that advances in steps of `step_s` (0: every millisecond)."""
    shown_s = math.floor(time_s / step_s + 1e-9) * step_s if step_s else time_s
    return math.floor(shown_s * 1000 + 1e-6) & CLOCK_WORD


def robot_clock_ms(robot: SimulatedRobot, time_s: float) -> int:
    """Return the robot's own clock at a simulated time, in steps of 16.4 ms if the noise model has them."""
    return clock_ms(time_s, robot.setup.clock_step_s)


@lru_cache(maxsize=1)  # all requests between two steps have the same time
def volts_raw(time_s: float) -> tuple[int, int]:
    """Return the raw battery bytes of CPU and motors."""
    voltage = battery_v(time_s)
    return raw_volts(voltage, CPU_RANGE_V), raw_volts(voltage, MOTOR_RANGE_V)


def pose_tenths(robot: SimulatedRobot) -> tuple[int, int, int, int]:
    """Return x, y, steering and turret of the encoders as in State, tenths."""
    return _pose_tenths(robot.encoder)


def velocity_tenths(robot: SimulatedRobot) -> tuple[int, int, int]:
    """Return the three velocities in tenths; a moving axis is never 0, one at rest always."""
    return axis_tenths(robot, robot.velocities)


def _infrareds(robot: SimulatedRobot) -> Sequence[int]:
    return robot.infrared.readings if robot.infrared is not None else (INFRARED_NOTHING,) * 16


# The parts of State that a mask can exclude.
_PARTS: Final[tuple[tuple[int, int, Callable[[SimulatedRobot], Sequence[int]]], ...]] = (
    # First slot, end slot, values.
    (1, 17, _infrareds),
    (17, 33, lambda robot: robot.sonar.readings_in),
    (BUMPER_SLOT, 34, lambda robot: (robot.bumpers,)),
    (34, 38, pose_tenths),
    (38, 41, velocity_tenths),
    (COMPASS_SLOT, 44, lambda robot: (heading_tenths(robot.compass.direction_rad) if robot.compass else 0,)),
)


class StateSnapshot:
    """The State vector of a robot at one moment, shared by all connections.

    Each part is computed when the first connection needs it, and once. `speed` is State[0].
    """

    def __init__(self, robot: SimulatedRobot, speed: int) -> None:
        self._robot = robot
        moving = robot.moving
        self._slots = [0] * STATE_SIZE
        self._slots[0], self._slots[_MOTORS_SLOT] = speed, moving[0] | moving[1] << 1 | moving[2] << 2
        self._missing = list(_PARTS)

    def slots(self, mask: Mask = EVERYTHING) -> list[int]:
        """Return State[0..44], valid in the slots that the mask includes; callers must not change the list."""
        if self._missing:
            needed = [part for part in self._missing if mask.whole or any(mask.smask[part[0] : part[1]])]
            for first, end, values in needed:
                self._slots[first:end] = values(self._robot)
            self._missing = [part for part in self._missing if part not in needed]
        return self._slots


def state_slots(robot: SimulatedRobot, speed: int) -> list[int]:
    """Return State[0..44] of now with all sensors."""
    return StateSnapshot(robot, speed).slots()


def build_state_reply(
    robot: SimulatedRobot, context: ConnectionContext, time_s: float, snapshot: StateSnapshot
) -> Reply:
    """Return the state reply to a connection, from a snapshot of now."""
    # 1. State and laser in the form that the connection has chosen.
    mask = context.wire_state.mask
    slots, laser = add_laser(robot, context, snapshot.slots(mask), wanted=mask.has(LASER_SLOT))
    # 2. Excluded slots keep the value last sent.
    slots = apply_mask(context, slots)
    # 3. Positions and times of the readings, if requested.
    stamps = all_stamps(robot, mask.position, time_s) if mask.position else {}
    return Reply("state", dict(enumerate(slots)), laser, stamps, robot_clock_ms(robot, time_s), volts_raw(time_s))


def apply_mask(context: ConnectionContext, slots: list[int]) -> list[int]:
    """Return State[0..44] as sent to a connection, and record it as last sent."""
    mask, last_sent = context.wire_state.mask, context.last_sent
    if not mask.whole and not context.wire_state.line:
        slots = [
            value if slot in UNMASKED_SLOTS or mask.has(slot) else last_sent[slot] for slot, value in enumerate(slots)
        ]
    context.last_sent = slots
    return slots


def add_laser(
    robot: SimulatedRobot, context: ConnectionContext, slots: list[int], *, wanted: bool = True
) -> tuple[list[int], tuple[int, ...] | None]:
    """Return the slots with the laser mode of a connection, and its laser vector (None if off or excluded)."""
    if not robot.model.has_light_sensors:
        return slots, None
    wire_state = context.wire_state
    with_mode = [*slots[:LASER_SLOT], wire_state.laser_mode, *slots[LASER_SLOT + 1 :]]
    return with_mode, laser_vector(robot, context, wire_state.laser_width) if wanted and is_on(
        wire_state.laser_mode
    ) else None


def all_stamps(robot: SimulatedRobot, position: int, time_s: float) -> dict[str, Stamp]:
    """Return the stamps requested by the position-data bits of a mask, for the sensors that the robot has."""
    stamps = sonar_stamps(robot) if position & Position.SONAR else {}
    if position & Position.INFRARED:
        stamps |= infrared_stamps(robot)
    if position & Position.BUMPER:
        stamps["bumper"] = stamp_now(robot, time_s)
    if position & Position.LASER and robot.model.has_light_sensors:
        stamps["laser"] = stamp_now(robot, time_s)
    if position & Position.COMPASS:
        stamps |= compass_stamps(robot, time_s)
    return stamps


def sonar_stamps(robot: SimulatedRobot) -> dict[str, Stamp]:
    """Return pose and time of the last reading of each sonar."""
    return {key: _stamp(robot, at) for key, at in zip(SONAR_KEYS, robot.sonar.stamps, strict=True)}


def infrared_stamps(robot: SimulatedRobot) -> dict[str, Stamp]:
    """Return pose and time of the last reading of each infrared sensor; empty if the robot has none."""
    if robot.infrared is None:
        return {}
    return {key: _stamp(robot, at) for key, at in zip(INFRARED_KEYS, robot.infrared.stamps, strict=True)}


def _pose_tenths(pose: Pose) -> tuple[int, int, int, int]:
    return (
        clamp_word(tenths(pose.x_in)),
        clamp_word(tenths(pose.y_in)),
        heading_tenths(pose.steering_rad),
        heading_tenths(pose.turret_rad),
    )


def stamp_now(robot: SimulatedRobot, time_s: float) -> Stamp:
    """Return a stamp of now: bumpers and laser are read when they are requested."""
    now_ms = robot_clock_ms(robot, time_s)
    return Stamp(*pose_tenths(robot), *velocity_tenths(robot), now_ms, now_ms)


def compass_stamps(robot: SimulatedRobot, time_s: float) -> dict[str, Stamp]:
    """Return the pose of now with the time of the last compass reading, up to 0.1 s ago; empty without a compass."""
    if robot.compass is None:
        return {}
    taken_ms = robot_clock_ms(robot, to_s(robot.compass.read_ps))
    return {"compass": stamp_now(robot, time_s)._replace(sensor_time=taken_ms)}


def _stamp(robot: SimulatedRobot, at: segments.Stamp) -> Stamp:
    return Stamp(
        *_pose_tenths(at.pose),
        *axis_tenths(robot, at.velocities),
        robot_clock_ms(robot, at.pose_time_s),
        robot_clock_ms(robot, at.sensor_time_s),
    )
