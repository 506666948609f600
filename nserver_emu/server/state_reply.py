"""The State vector of a simulated robot in wire units: the rim where inches and radians become tenths.

    0 speed | 1-16 infrared | 17-32 sonar | 33 bumper | 34-37 x y steer turret | 38-40 velocities
    41 motors | 42 laser mode | 43 compass | 44 error

Rules: reads a robot, changes nothing but what the connection keeps. A slot that the mask leaves out keeps the value
last sent on that connection.
"""

from __future__ import annotations

import math

from nclient.protocol.mask import Position
from nclient.protocol.replies import Reply
from nclient.protocol.stamps import SONAR_KEYS, Stamp
from nclient.protocol.units import (
    CPU_RANGE_V,
    MOTOR_RANGE_V,
    heading_tenths,
    raw_volts,
    tenths,
)
from nserver_emu.server.axis_units import axis_tenths
from nserver_emu.server.session import Visit
from nserver_emu.simulation.robot import SimulatedRobot

INFRARED_NOTHING = 15
UNMASKED_SLOTS = (0, 41, 44)
FULL_BATTERY_V = 12.0
_FULL = (raw_volts(FULL_BATTERY_V, CPU_RANGE_V), raw_volts(FULL_BATTERY_V, MOTOR_RANGE_V))


def clock_ms(time_s: float) -> int:
    """The robot's clock: milliseconds since power-on."""
    return math.floor(time_s * 1000 + 1e-6)


def pose_tenths(robot: SimulatedRobot) -> tuple[int, int, int, int]:
    """x, y, steering and turret as the encoders have them, in State's form."""
    pose = robot.encoder
    return (
        tenths(pose.x_in),
        tenths(pose.y_in),
        heading_tenths(pose.steering_rad),
        heading_tenths(pose.turret_rad),
    )


def velocity_tenths(robot: SimulatedRobot) -> tuple[int, int, int]:
    """The three velocities; an axis that moves never shows zero, one at rest always does."""
    return axis_tenths(robot, robot.velocities)


def state_slots(robot: SimulatedRobot, speed: int) -> list[int]:
    """State[0..44] as it is now, all sensors in."""
    moving = robot.moving
    return [
        speed,
        *[INFRARED_NOTHING] * 16,
        *robot.sonar.readings_in,
        robot.bumpers,
        *pose_tenths(robot),
        *velocity_tenths(robot),
        moving[0] | moving[1] << 1 | moving[2] << 2,
        0,
        0,
        0,
    ]


def state_reply(robot: SimulatedRobot, visit: Visit, time_s: float, slots: list[int]) -> Reply:
    """The whole state of a robot, `slots` as of now, on the terms of this connection."""
    mask = visit.terms.mask
    if not mask.whole:
        kept = visit.kept
        slots = [
            value if slot in UNMASKED_SLOTS or mask.has(slot) else kept[slot] for slot, value in enumerate(slots)
        ]
    visit.kept = slots
    stamps = all_stamps(robot, mask.position, time_s) if mask.position else {}
    return Reply("state", dict(enumerate(slots)), None, stamps, clock_ms(time_s), _FULL)


def all_stamps(robot: SimulatedRobot, position: int, time_s: float) -> dict[str, Stamp]:
    """The stamps that these position-data bits ask for, of the sensors this robot has."""
    stamps = sonar_stamps(robot) if position & Position.SONAR else {}
    if position & Position.BUMPER:
        stamps["bumper"] = bumper_stamp(robot, time_s)
    return stamps


def sonar_stamps(robot: SimulatedRobot) -> dict[str, Stamp]:
    """Where the encoders were when each sonar took its last reading."""
    return {
        key: Stamp(
            tenths(at.pose.x_in),
            tenths(at.pose.y_in),
            heading_tenths(at.pose.steering_rad),
            heading_tenths(at.pose.turret_rad),
            *axis_tenths(robot, at.velocities),
            clock_ms(at.pose_time_s),
            clock_ms(at.sensor_time_s),
        )
        for key, at in zip(SONAR_KEYS, robot.sonar.stamps, strict=True)
    }


def bumper_stamp(robot: SimulatedRobot, time_s: float) -> Stamp:
    """The bumpers are read when they are asked for: a stamp of now."""
    return Stamp(*pose_tenths(robot), *velocity_tenths(robot), clock_ms(time_s), clock_ms(time_s))
