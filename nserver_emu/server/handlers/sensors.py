"""Infrareds, compass and laser: their questions and settings, a function a command. The N150 has but the compass,
the Scout none of them.

Rules: as in questions.py; bytes of a setting are taken as the line carries them, and what no robot has is ERROR 2.

Questions about a robot and its sensors, and the sensors' settings: a function a command, wire units out.

Rules: a question changes nothing; a sensor that the model lacks is ERROR 4, never a made-up reading.
"""

from __future__ import annotations

import math

from nclient.protocol.replies import Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, Position, clamp_word, heading_tenths, wrap_word
from nclient.protocol.wire_state import LINES
from nserver_emu.server.context import ServerState
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, ConnectionContext, error_reply
from nserver_emu.server.state_encoder import (
    axis_tenths,
    compass_stamps,
    infrared_stamps,
    is_on,
    laser_vector,
    pose_tenths,
    robot_clock_ms,
    sonar_stamps,
    stamp_now,
    velocity_tenths,
)
from nserver_emu.simulation.compass import CompassMode
from nserver_emu.simulation.infrared import INFRAREDS

_END_OF_ORDER = 255
_HIGHEST_BYTE = 255
CALIBRATED, NOT_CALIBRATED = (9, 9, 1), (0, 0, 0)
"""Calibration scores."""


def conf_ir(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """The infrareds' history in tenths, more than 9 taken as 9, and which of them look."""
    robot, (history, *order) = server.robot_of(context), args
    if robot.infrared is None:
        return error_reply(NOT_AVAILABLE)
    end = order.index(_END_OF_ORDER) if _END_OF_ORDER in order else len(order)
    if history < 0 or not all(0 <= number < INFRAREDS for number in order[:end]):
        return error_reply(BAD_VALUES)
    robot.configure_infrareds(history, order[:end])
    return server.state(context)


def get_ir(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """All sixteen infrareds, mask or not."""
    robot = server.robot_of(context)
    if robot.infrared is None:
        return error_reply(NOT_AVAILABLE)
    stamps = infrared_stamps(robot) if context.wire_state.mask.position & Position.INFRARED else {}
    slots = dict(enumerate(robot.infrared.readings, start=1))
    return Reply("infrared", slots, stamps=stamps, clock=robot_clock_ms(robot, server.simulation.time_s))


def conf_cp(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """The compass off, on, or calibrating, which a full turn of the turret completes.

    On the robot's own line the answer is the three scores of the calibration (decision of ours, for no source says
    what they mean: quality and surroundings 0..9, and how many there were, 0 or 1).
    """
    robot = server.robot_of(context)
    if robot.compass is None:
        return error_reply(NOT_AVAILABLE)
    if args[0] not in list(CompassMode):
        return error_reply(BAD_VALUES)
    robot.configure_compass(args[0])
    if context.wire_state.line:
        return Reply("compass", values=CALIBRATED if robot.compass.calibrated else NOT_CALIBRATED)
    return server.state(context)


def get_cp(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The direction of the turret as the compass last told it."""
    robot, now_s = server.robot_of(context), server.simulation.time_s
    if robot.compass is None:
        return error_reply(NOT_AVAILABLE)
    stamps = compass_stamps(robot, now_s) if context.wire_state.mask.position & Position.COMPASS else {}
    slots = {COMPASS_SLOT: heading_tenths(robot.compass.direction_rad)}
    return Reply("compass", slots, stamps=stamps, clock=robot_clock_ms(robot, now_s))


def conf_ls(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """How many columns of the laser count (0: all) on this connection; the session has noted the mode.

    Threshold, width and processing tell a camera's picture from its noise; there is no picture here, and no source
    that tells their units: they have no effect.
    """
    if not server.robot_of(context).model.has_light_sensors:
        return error_reply(NOT_AVAILABLE)
    context.laser_columns = max(0, args[3])
    return server.state(context)


def get_ls(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """What the laser sees, in the shape of its mode."""
    return _laser(server, context, context.wire_state.get_laser_width)


def conf_sg(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """How laser points become lines on this connection: threshold and gap in tenths of an inch, fewest points."""
    if not server.robot_of(context).model.has_light_sensors:
        return error_reply(NOT_AVAILABLE)
    if not all(0 <= number <= _HIGHEST_BYTE for number in args):
        return error_reply(BAD_VALUES)
    threshold, min_points, gap = args
    context.segments = (threshold, min_points, gap)
    return server.state(context)


def get_sg(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The lines that the laser sees."""
    return _laser(server, context, LINES)


def _laser(server: ServerState, context: ConnectionContext, width: int) -> Reply:
    robot, now_s = server.robot_of(context), server.simulation.time_s
    if not robot.model.has_light_sensors:
        return error_reply(NOT_AVAILABLE)
    seen = laser_vector(robot, context, width) if is_on(context.wire_state.laser_mode) else (0,)
    stamps = {"laser": stamp_now(robot, now_s)} if context.wire_state.mask.position & Position.LASER else {}
    return Reply("laser", laser=seen, stamps=stamps, clock=robot_clock_ms(robot, now_s))


_INT32_MAX = 0x7FFFFFFF


def conf_sn(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """The sonars' firing rate, clamped, and order, which ends at the first that is no sonar; the ring starts anew."""
    rate, *order = args
    server.robot_of(context).configure_sonars(rate, tuple(order))
    return server.state(context)


def conf_ser(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The speed of another serial port of the robot: nothing is plugged in there, so nothing changes."""
    return server.state(context)


def ct(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The session has noted the mask; the reply shows it at work."""
    return server.state(context)


def gs(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The state."""
    return server.state(context)


def get_sn(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """All sixteen sonars, mask or not."""
    robot = server.robot_of(context)
    slots = dict(enumerate(robot.sonar.readings_in, start=17))
    stamps = sonar_stamps(robot) if context.wire_state.mask.position & Position.SONAR else {}
    return Reply("sonar", slots, stamps=stamps, clock=robot_clock_ms(robot, server.simulation.time_s))


def get_rc(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Position and angles."""
    return Reply("configuration", dict(enumerate(pose_tenths(server.robot_of(context)), start=34)))


def get_rv(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The three velocities."""
    return Reply("velocity", dict(enumerate(velocity_tenths(server.robot_of(context)), start=38)))


def get_ra(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The three accelerations, in the places of the velocities; 0 where axes jump to their speed."""
    robot = server.robot_of(context)
    return Reply("velocity", dict(enumerate(axis_tenths(robot, robot.accelerations), start=38)))


def get_bp(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The bumpers."""
    robot = server.robot_of(context)
    asked = context.wire_state.mask.position & Position.BUMPER
    now_s = server.simulation.time_s
    stamps = {"bumper": stamp_now(robot, now_s)} if asked else {}
    return Reply("bumper", {BUMPER_SLOT: robot.bumpers}, stamps=stamps, clock=robot_clock_ms(robot, now_s))


def sim_truth(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Where the actual robot is; the filter never sees it."""
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
