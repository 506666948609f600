"""Handlers of sensor queries and sensor settings: one function per command, with the command's name.

Queries change nothing. A sensor that the model lacks is ERROR 4 (the N150 has only the compass, the Scout none of
infrared, compass and laser); a setting that no robot has is ERROR 2.
"""

from __future__ import annotations

import math

from nclient.protocol.replies import Reply, text_values
from nclient.protocol.types import LINES, Position, clamp_word, wrap_word
from nserver_emu.server.server_state import (
    BUMPER,
    COMPASS,
    INFRARED,
    SONAR,
    ServerState,
    StateSensor,
    axis_tenths,
    is_on,
    laser_vector,
    pose_tenths,
    robot_clock_ms,
    stamp_now,
    velocity_tenths,
)
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, ConnectionContext, error_reply
from nserver_emu.simulation.sensors import INFRAREDS, CompassMode

# First State slots of pose and velocities.
_POSE_SLOT, _VELOCITY_SLOT = 34, 38
# In an order of sensors: no more follow.
_END_OF_ORDER = 255
_MAX_BYTE = 255
_INT32_MAX = 0x7FFFFFFF
# Scores of the compass calibration on a robot's own line: quality, surroundings (0 to 9), number of calibrations.
CALIBRATED, NOT_CALIBRATED = (9, 9, 1), (0, 0, 0)


# State and encoders.


def gs(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> None:
    """Return the state."""


def ct(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> None:
    """Return the state with the new sensor mask, which the session has already set."""


def get_rc(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return position and angles."""
    return Reply("configuration", dict(enumerate(pose_tenths(server.robot_of(context)), start=_POSE_SLOT)))


def get_rv(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the three velocities."""
    return Reply("velocity", dict(enumerate(velocity_tenths(server.robot_of(context)), start=_VELOCITY_SLOT)))


def get_ra(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the three accelerations in the slots of the velocities; 0 where speeds change at once."""
    robot = server.robot_of(context)
    return Reply("velocity", dict(enumerate(axis_tenths(robot, robot.accelerations), start=_VELOCITY_SLOT)))


def held_by(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return which person holds the robot, as a text; an empty one if none does."""
    hold = server.estop.get(context.robot_id)
    return Reply("simple", values=text_values("" if hold is None else hold.by))


def sim_truth(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the actual pose of the robot in thousandths; for evaluation only, the filter does not use it."""
    pose = server.robot_of(context).actual
    values = (
        1,
        wrap_word(server.clock_ms),
        clamp_word(round(pose.x_in * 1000)),
        clamp_word(round(pose.y_in * 1000)),
        round(math.degrees(pose.steering_rad) * 1000),
        round(math.degrees(pose.turret_rad) * 1000),
        server.simulation.seed & _INT32_MAX,
        context.robot_id or 0,
    )
    return Reply("truth", values=values)


# Bumpers and sonars.


def _reading(server: ServerState, context: ConnectionContext, sensor: StateSensor) -> Reply:
    """Return all readings of a sensor regardless of the mask, which selects the stamps only."""
    robot, now_s = server.robot_of(context), server.simulation.time_s
    values = sensor.values(robot)
    if values is None:
        return error_reply(NOT_AVAILABLE)
    stamps = sensor.stamps(robot, now_s) if context.wire_state.mask.position & sensor.position else {}
    slots = dict(zip(sensor.slots, values, strict=True))
    return Reply(sensor.kind, slots, stamps=stamps, clock=robot_clock_ms(robot, now_s))


def get_bp(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the bumpers."""
    return _reading(server, context, BUMPER)


def conf_sn(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the sonars' firing rate (clamped) and order, which ends at the first number that is no sonar."""
    rate, *order = args
    server.robot_of(context).configure_sonars(rate, tuple(order))


def get_sn(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return all 16 sonars regardless of the mask."""
    return _reading(server, context, SONAR)


def conf_ser(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> None:
    """Accept the speed of the robot's other serial port; nothing is connected there."""


# Infrared sensors.


def conf_ir(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Set the infrareds' history (tenths, at most 9) and which of them measure."""
    robot, (history, *order) = server.robot_of(context), args
    if robot.infrared is None:
        return error_reply(NOT_AVAILABLE)
    end = order.index(_END_OF_ORDER) if _END_OF_ORDER in order else len(order)
    if history < 0 or not all(0 <= number < INFRAREDS for number in order[:end]):
        return error_reply(BAD_VALUES)
    robot.configure_infrareds(history, order[:end])
    return None


def get_ir(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return all 16 infrareds regardless of the mask."""
    return _reading(server, context, INFRARED)


# Compass.


def conf_cp(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Switch the compass off, on, or to calibration, which a full turn of the turret completes.

    On the robot's own line the reply has the three scores of the calibration. No source says what they mean; quality
    and surroundings 0 to 9 and the number of calibrations are a decision of this project.
    """
    robot = server.robot_of(context)
    if robot.compass is None:
        return error_reply(NOT_AVAILABLE)
    if args[0] not in list(CompassMode):
        return error_reply(BAD_VALUES)
    robot.configure_compass(args[0])
    if context.wire_state.line:
        return Reply("compass", values=CALIBRATED if robot.compass.calibrated else NOT_CALIBRATED)
    return None


def get_cp(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the turret's direction of the last compass reading."""
    return _reading(server, context, COMPASS)


# Laser.


def conf_ls(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Set the number of laser columns in use on this connection (0: all); the session has set the mode.

    Threshold, width and processing separate signal from noise in a camera picture. There is no picture here, and no
    source gives their units: they have no effect.
    """
    if not server.robot_of(context).model.has_light_sensors:
        return error_reply(NOT_AVAILABLE)
    context.laser_columns = max(0, args[3])
    return None


def get_ls(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the laser readings in the form of the laser mode."""
    return _laser_reply(server, context, context.wire_state.get_laser_width)


def conf_sg(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Set the line extraction of this connection: threshold and gap in tenths of an inch, minimum number of points."""
    if not server.robot_of(context).model.has_light_sensors:
        return error_reply(NOT_AVAILABLE)
    if not all(0 <= number <= _MAX_BYTE for number in args):
        return error_reply(BAD_VALUES)
    threshold, min_points, gap = args
    context.segments = (threshold, min_points, gap)
    return None


def get_sg(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the laser readings as lines."""
    return _laser_reply(server, context, LINES)


def _laser_reply(server: ServerState, context: ConnectionContext, width: int) -> Reply:
    """Return the laser readings with `width` words each, none if the laser is off."""
    robot, now_s = server.robot_of(context), server.simulation.time_s
    if not robot.model.has_light_sensors:
        return error_reply(NOT_AVAILABLE)
    readings = laser_vector(robot, context, width) if is_on(context.wire_state.laser_mode) else (0,)
    stamps = {"laser": stamp_now(robot, now_s)} if context.wire_state.mask.position & Position.LASER else {}
    return Reply("laser", laser=readings, stamps=stamps, clock=robot_clock_ms(robot, now_s))
