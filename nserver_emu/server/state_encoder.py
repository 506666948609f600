"""Tenths for the three axes of a robot: inches for an axis that rolls, radians for one that turns.

The wire counts all axes in tenths, of inches or of degrees; which of them, its model says: the second axis of an N150
steers, that of a Scout is its left wheel.

The laser vector of a reply: a count, and so many readings in tenths; what the laser saw just now.

    words a reading     4 lines x1 y1 x2 y2 | 2 points x y, robot's frame | 1 the camera's row of each column

The State vector of a simulated robot in wire units: the rim where inches and radians become tenths.

    0 speed | 1-16 infrared | 17-32 sonar | 33 bumper | 34-37 x y steer turret | 38-40 velocities
    41 motors | 42 laser mode | 43 compass | 44 error

Rules: reads a robot, changes nothing but what the connection keeps. A slot that the mask leaves out keeps the value
last sent on that connection; on the robot's own line it is not sent at all. It costs nothing: no ray is cast for a
reading that nobody is shown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final

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
    """Three numbers of a command, as its axes count."""
    first, second, third = (
        number / 10 if rolls else rad_from_tenths(number)
        for number, rolls in zip(tenths, robot.model.in_inches, strict=True)
    )
    return first, second, third


def axis_tenths(robot: SimulatedRobot, values: tuple[float, float, float]) -> tuple[int, int, int]:
    """What the axes say, in tenths; what is not zero never becomes zero."""
    first, second, third = (
        away_from_zero(value * 10 if rolls else math.degrees(value) * 10)
        for value, rolls in zip(values, robot.model.in_inches, strict=True)
    )
    return first, second, third


def away_from_zero(value: float) -> int:
    """The nearest whole number; for what is not zero, the nearest that is not."""
    rounded = round(value)
    return rounded if rounded or not value else (1 if value > 0 else -1)


def is_on(mode: int) -> bool:
    """Whether the laser gives anything in this mode: bit 0 tells."""
    return bool(mode & 1)


def laser_vector(robot: SimulatedRobot, context: ConnectionContext, width: int) -> tuple[int, ...]:
    """The vector with so many words a reading, on the terms of this connection; (0,) where nothing is seen."""
    seen = robot.scan_laser(context.laser_columns)
    if width not in (POINTS, LINES):
        rows = pixels(seen)
        return (len(rows), *rows)
    found = points(seen, robot.model.body)
    if width == LINES:
        found = lines(found, _line_fit(context))
    return (len(found), *[tenths(number) for number in found.ravel().tolist()])


def _line_fit(context: ConnectionContext) -> LineFit:
    """How this connection's laser points become lines."""
    if context.segments is None:
        return LineFit()
    threshold, min_points, gap = context.segments
    return LineFit(threshold / 10, min_points, gap / 10)


INFRARED_NOTHING = 15
CLOCK_WORD = 0xFFFFFFFF
"""After fifty days the clock begins anew, as a word of milliseconds does."""
_MOTORS_SLOT = 41
UNMASKED_SLOTS = (0, _MOTORS_SLOT, 44)


def clock_ms(time_s: float, step_s: float = 0.0) -> int:
    """A clock that shows whole milliseconds since power-on, and goes in steps: 0 every millisecond."""
    shown_s = math.floor(time_s / step_s + 1e-9) * step_s if step_s else time_s
    return math.floor(shown_s * 1000 + 1e-6) & CLOCK_WORD


def robot_clock_ms(robot: SimulatedRobot, time_s: float) -> int:
    """What the robot's own clock shows at a simulated time: 16.4 ms steps where the setup has them."""
    return clock_ms(time_s, robot.setup.clock_step_s)


@lru_cache(maxsize=1)  # many who ask between two steps ask the same
def volts_raw(time_s: float) -> tuple[int, int]:
    """The raw battery bytes, CPU and motors."""
    voltage = battery_v(time_s)
    return raw_volts(voltage, CPU_RANGE_V), raw_volts(voltage, MOTOR_RANGE_V)


def pose_tenths(robot: SimulatedRobot) -> tuple[int, int, int, int]:
    """x, y, steering and turret as the encoders have them, in State's form."""
    return _pose_tenths(robot.encoder)


def velocity_tenths(robot: SimulatedRobot) -> tuple[int, int, int]:
    """The three velocities; an axis that moves never shows zero, one at rest always does."""
    return axis_tenths(robot, robot.velocities)


def _infrareds(robot: SimulatedRobot) -> Sequence[int]:
    return robot.infrared.readings if robot.infrared is not None else (INFRARED_NOTHING,) * 16


_PARTS: Final[tuple[tuple[int, int, Callable[[SimulatedRobot], Sequence[int]]], ...]] = (
    (1, 17, _infrareds),
    (17, 33, lambda robot: robot.sonar.readings_in),
    (BUMPER_SLOT, 34, lambda robot: (robot.bumpers,)),
    (34, 38, pose_tenths),
    (38, 41, velocity_tenths),
    (COMPASS_SLOT, 44, lambda robot: (heading_tenths(robot.compass.direction_rad) if robot.compass else 0,)),
)
"""The parts of State that a mask can leave out: first slot, the one after the last, what they show."""


class StateSnapshot:
    """What State shows of a robot at one moment, however many ask: each part is worked out when the first one is
    shown it, and once. `speed` is State[0]."""

    def __init__(self, robot: SimulatedRobot, speed: int) -> None:
        self._robot = robot
        moving = robot.moving
        self._slots = [0] * STATE_SIZE
        self._slots[0], self._slots[_MOTORS_SLOT] = speed, moving[0] | moving[1] << 1 | moving[2] << 2
        self._missing = list(_PARTS)

    def slots(self, mask: Mask = EVERYTHING) -> list[int]:
        """State[0..44], right where the mask lets through; the caller leaves the list as it is."""
        if self._missing:
            shown = [part for part in self._missing if mask.whole or any(mask.smask[part[0] : part[1]])]
            for first, end, values in shown:
                self._slots[first:end] = values(self._robot)
            self._missing = [part for part in self._missing if part not in shown]
        return self._slots


def state_slots(robot: SimulatedRobot, speed: int) -> list[int]:
    """State[0..44] as it is now, all sensors in."""
    return StateSnapshot(robot, speed).slots()


def state_reply(robot: SimulatedRobot, context: ConnectionContext, time_s: float, look: StateSnapshot) -> Reply:
    """The whole state of a robot, `look` as of now, on the terms of this connection."""
    mask = context.wire_state.mask
    slots, laser = with_laser(robot, context, look.slots(mask), wanted=mask.has(LASER_SLOT))
    slots = as_sent(context, slots)
    stamps = all_stamps(robot, mask.position, time_s) if mask.position else {}
    return Reply("state", dict(enumerate(slots)), laser, stamps, robot_clock_ms(robot, time_s), volts_raw(time_s))


def as_sent(context: ConnectionContext, slots: list[int]) -> list[int]:
    """State[0..44] as this connection gets it; from now on that is what it was sent last."""
    mask, kept = context.wire_state.mask, context.kept
    if not mask.whole and not context.wire_state.line:
        slots = [value if slot in UNMASKED_SLOTS or mask.has(slot) else kept[slot] for slot, value in enumerate(slots)]
    context.kept = slots
    return slots


def with_laser(
    robot: SimulatedRobot, context: ConnectionContext, slots: list[int], *, wanted: bool = True
) -> tuple[list[int], tuple[int, ...] | None]:
    """The slots with the laser mode of this connection, and what the laser sees in the shape it reads now."""
    if not robot.model.has_light_sensors:
        return slots, None
    wire_state = context.wire_state
    told = [*slots[:LASER_SLOT], wire_state.laser_mode, *slots[LASER_SLOT + 1 :]]
    return told, laser_vector(robot, context, wire_state.laser_width) if wanted and is_on(
        wire_state.laser_mode
    ) else None


def all_stamps(robot: SimulatedRobot, position: int, time_s: float) -> dict[str, Stamp]:
    """The stamps that these position-data bits ask for, of the sensors this robot has."""
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
    """Where the encoders were when each sonar took its last reading."""
    return {key: _stamp(robot, at) for key, at in zip(SONAR_KEYS, robot.sonar.stamps, strict=True)}


def infrared_stamps(robot: SimulatedRobot) -> dict[str, Stamp]:
    """Where they were when each infrared did; none for a robot without."""
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
    """Bumpers and laser are read when they are asked for: a stamp of now."""
    now_ms = robot_clock_ms(robot, time_s)
    return Stamp(*pose_tenths(robot), *velocity_tenths(robot), now_ms, now_ms)


def compass_stamps(robot: SimulatedRobot, time_s: float) -> dict[str, Stamp]:
    """The pose of now, and when the compass was read: up to a tenth of a second ago; none for a robot without."""
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
