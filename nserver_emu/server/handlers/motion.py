"""Handlers of motion commands and their limits: one function per command, with the command's name.

Tenths become inches and radians here. Values out of range are clamped by the robot: old clients send them.
"""

from __future__ import annotations

import math

from nclient.protocol.replies import Reply
from nclient.protocol.types import rad_from_tenths
from nserver_emu.server.server_state import ServerState, axis_values
from nserver_emu.server.session import BAD_VALUES, ConnectionContext, DeferredReply, error_reply

# Modes of mv: 0 leaves an axis as it is, 1 to 3 move or release it, 4 and 5 set its limits.
_MV_LEAVE, _MV_MAX = 0, 5
_MV_MOTIONS = (1, 2, 3)
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
    first, second, third = (
        _without_rounding(target - count if rolls else math.remainder(target - angle, math.tau))
        for target, count, angle, rolls in zip(
            axis_values(robot, args), robot.counts, angles, robot.model.in_inches, strict=True
        )
    )
    robot.move_relative(first, second, third)


def mv(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | None:
    """Command each axis in its own mode; an unknown mode is refused before anything moves."""
    # Arguments are three pairs of mode and value.
    modes = args[::2]
    if any(not _MV_LEAVE <= mode <= _MV_MAX for mode in modes):
        return error_reply(BAD_VALUES)
    robot = server.claim_axes(context, [axis for axis, mode in enumerate(modes) if mode in _MV_MOTIONS])
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
    assert context.robot_id is not None
    server.stop_arm(context.robot_id)


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
