"""Handlers of motions, sensor queries and their settings: one function per command, with the command's name.

Tenths become inches and radians here. Values out of range are clamped by the robot: old clients send them. Queries
change nothing. A sensor that the model lacks is ERROR 4 (the N150 has only the compass, the Scout none of infrared,
compass and laser); a setting that no robot has is ERROR 2.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import takewhile

from nclient.protocol.replies import Reply, text_values
from nclient.protocol.types import LINES, Position, clamp_word, rad_from_tenths, wrap_word
from nserver_emu.server import server_state
from nserver_emu.server.server_state import ServerState, axis_values, is_on, laser_vector, robot_clock_ms, stamp_now
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, ConnectionContext, DeferredReply, error_reply
from nserver_emu.simulation.axis import AXIS_MOTIONS, Command
from nserver_emu.simulation.sensors import INFRAREDS, CompassMode, LineFit

# Inches or radians: rounding error of a sum of distances, far below a tenth of an inch or degree.
_ROUNDING = 1e-9


def vm(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Move at velocities until another motion command or the timeout."""
    robot = server.claim_axes(context)
    robot.set_velocities(*axis_values(robot, args))


def pr(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Move each axis by a distance, all at once."""
    robot = server.claim_axes(context)
    robot.move_relative(*axis_values(robot, args))


def pa(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Move each axis to a position, all at once, at the speeds of sp.

    Steering and turret turn the shorter direction to the encoder angle. Wheels roll to a total distance since power-on
    or the last zr.
    """
    # Rolling axes count a distance, turning ones have an absolute angle.
    robot = server.claim_axes(context)
    angles = (0.0, robot.encoder.steering_rad, robot.encoder.turret_rad)
    axes = zip(axis_values(robot, args), robot.counts, angles, robot.model.in_inches, strict=True)
    first, second, third = (_without_rounding(target - count if rolls else math.remainder(target - angle, math.tau))
                            for target, count, angle, rolls in axes)
    robot.move_relative(first, second, third)


def mv(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Command each axis in its own mode; an unknown mode is refused before anything moves."""
    # Arguments are three pairs of mode and value.
    modes = args[::2]
    if any(mode not in tuple(Command) for mode in modes):
        return error_reply(BAD_VALUES)
    robot = server.claim_axes(context, [axis for axis, mode in enumerate(modes) if mode in AXIS_MOTIONS])
    values = axis_values(robot, args[1::2])
    for axis, (mode, value) in enumerate(zip(modes, values, strict=True)):
        robot.command_axis(axis, mode, value)
    return None


def sp(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the speeds of pr and pa."""
    robot = server.robot_of(context)
    robot.set_speeds(*axis_values(robot, args))


def ac(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the accelerations; without effect in an ideal setup, as the original's documentation says."""
    robot = server.robot_of(context)
    robot.set_accelerations(*axis_values(robot, args))


def st(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> None:
    """Stop all axes and the arm."""
    server.claim_axes(context).stop()
    server.stop_arm(context.robot)


def lp(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> None:
    """Switch the motors off."""
    server.claim_axes(context).limp()


def ws(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> DeferredReply:
    """Reply when the selected axes are still or the timeout (simulated seconds) is over.

    A waiting client cannot send other commands, so waiting restarts the timeout of conf_tm.
    """
    robot = server.robot_of(context)
    axes = [axis for axis, flag in enumerate(args[:3]) if flag]
    deadline_s = server.simulation.time_s + max(0, args[3])

    def poll() -> Reply | None:
        server.feed_watchdog(context)
        is_done = robot.is_still(axes) or server.simulation.time_s >= deadline_s
        return server.state_reply(context) if is_done else None

    return poll


def zr(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> DeferredReply:
    """Turn to the bumper's zero; reply when done, or when another motion command takes over."""
    robot = server.claim_axes(context)
    robot.zero()
    return lambda: None if robot.zeroing else server.state_reply(context)


def dp(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the encoders' position; beyond the range of a word it is later sent clamped."""
    robot = server.robot_of(context)
    robot.define_position(args[0] / 10, args[1] / 10)


def da(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the encoders' angles."""
    server.robot_of(context).define_angles(rad_from_tenths(args[0]), rad_from_tenths(args[1]))


def conf_tm(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the command timeout in simulated seconds after which motion stops; 0 is never."""
    server.robot_of(context).set_timeout(max(0, args[0]))


def _without_rounding(distance: float) -> float:
    """Return the distance, 0 if it is a rounding error."""
    return distance if abs(distance) > _ROUNDING else 0.0


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
    pose = server_state.pose_tenths(server.robot_of(context))
    return Reply("configuration", dict(zip(server_state.POSE_SLOTS, pose, strict=True)))


def get_rv(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the three velocities."""
    velocities = server_state.velocity_tenths(server.robot_of(context))
    return Reply("velocity", dict(zip(server_state.VELOCITY_SLOTS, velocities, strict=True)))


def get_ra(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the three accelerations in the slots of the velocities; 0 where speeds change at once."""
    robot = server.robot_of(context)
    accelerations = server_state.axis_tenths(robot, robot.accelerations)
    return Reply("velocity", dict(zip(server_state.VELOCITY_SLOTS, accelerations, strict=True)))


def held_by(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return which person holds the robot, as a text; an empty one if none does."""
    hold = server.estop.get(context.robot_id)
    return Reply("simple", values=text_values("" if hold is None else hold.by))


def sim_truth(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return the actual pose of the robot in thousandths; for evaluation only, the filter does not use it."""
    pose = server.robot_of(context).actual
    values = (1, wrap_word(server.clock_ms), clamp_word(round(pose.x_in * 1000)), clamp_word(round(pose.y_in * 1000)),
              round(math.degrees(pose.steering_rad) * 1000), round(math.degrees(pose.turret_rad) * 1000),
              server.simulation.seed & _INT32_MAX, context.robot_id or 0)
    return Reply("truth", values=values)


# Bumpers and sonars.


def _reading(server: ServerState, context: ConnectionContext, _args: tuple[int, ...],
             sensor: server_state.StateSensor) -> Reply:
    """Return all readings of a sensor regardless of the mask, which selects the stamps only."""
    robot, now_s = server.robot_of(context), server.simulation.time_s
    values = sensor.values(robot)
    if values is None:
        return error_reply(NOT_AVAILABLE)
    stamps = sensor.stamps(robot, now_s) if context.wire_state.mask.position & sensor.position else {}
    slots = dict(zip(sensor.slots, values, strict=True))
    return Reply(sensor.kind, slots, stamps=stamps, clock=robot_clock_ms(robot, now_s))


get_bp = partial(_reading, sensor=server_state.BUMPER)
"""Return the bumpers."""


def conf_sn(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> None:
    """Set the sonars' firing rate (clamped) and order, which ends at the first number that is no sonar."""
    rate, *order = args
    server.robot_of(context).configure_sonars(rate, tuple(order))


get_sn = partial(_reading, sensor=server_state.SONAR)
"""Return all 16 sonars regardless of the mask."""


def conf_ser(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> None:
    """Accept the speed of the robot's other serial port; nothing is connected there."""


# Infrared sensors.


def conf_ir(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Set the infrareds' history (tenths, at most 9) and which of them measure."""
    robot, (history, *order) = server.robot_of(context), args
    if robot.infrared is None:
        return error_reply(NOT_AVAILABLE)
    sensors = list(takewhile(_END_OF_ORDER.__ne__, order))
    if history < 0 or not all(0 <= number < INFRAREDS for number in sensors):
        return error_reply(BAD_VALUES)
    robot.configure_infrareds(history, sensors)
    return None


get_ir = partial(_reading, sensor=server_state.INFRARED)
"""Return all 16 infrareds regardless of the mask."""


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


get_cp = partial(_reading, sensor=server_state.COMPASS)
"""Return the turret's direction of the last compass reading."""


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
    context.line_fit = LineFit(threshold / 10, min_points, gap / 10)
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
