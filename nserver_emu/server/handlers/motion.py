"""Commands that move a robot, or say how it is to move: a function a command, wire units in, a Reply out.

Rules: tenths become inches and radians here, and nowhere deeper. Values out of range are clamped by the robot, as old
clients do send them.
"""

from __future__ import annotations

import math

from nclient.protocol.replies import Reply
from nclient.protocol.types import rad_from_tenths
from nserver_emu.server.context import ServerState
from nserver_emu.server.session import BAD_VALUES, ConnectionContext, DeferredReply, error_reply
from nserver_emu.server.state_encoder import axis_values

_MV_LEAVE, _MV_HIGHEST = 0, 5
_MV_MOTIONS = (1, 2, 3)
"""The modes of mv that move an axis or let it go; 4 and 5 only set its limits."""
_ROUNDING = 1e-9
"""Inches or radians: what a sum of ways strays by, and far less than a tenth of anything."""


def vm(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Velocities until another motion command or the time-out."""
    robot = server.drive(context)
    robot.set_velocities(*axis_values(robot, args))
    return server.state(context)


def pr(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Each axis its distance, all at once."""
    robot = server.drive(context)
    robot.move_relative(*axis_values(robot, args))
    return server.state(context)


def pa(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Each axis to a position, all at once, at the speeds of sp.

    Steering and turret to where the encoders read these angles, the short way; wheels to where they have rolled so
    far since power-on or the last zr.
    """
    robot = server.drive(context)
    angles = (0.0, robot.encoder.steering_rad, robot.encoder.turret_rad)
    first, second, third = (
        _way(target - count if rolls else math.remainder(target - angle, math.tau))
        for target, count, angle, rolls in zip(
            axis_values(robot, args), robot.counts, angles, robot.model.in_inches, strict=True
        )
    )
    robot.move_relative(first, second, third)
    return server.state(context)


def mv(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Each axis in a mode of its own; a mode that clients refuse is refused here too, before anything moves."""
    modes = args[::2]
    if any(not _MV_LEAVE <= mode <= _MV_HIGHEST for mode in modes):
        return error_reply(BAD_VALUES)
    robot = server.drive(context, [axis for axis, mode in enumerate(modes) if mode in _MV_MOTIONS])
    values = axis_values(robot, args[1::2])
    for axis, (mode, value) in enumerate(zip(modes, values, strict=True)):
        robot.command_axis(axis, mode, value)
    return server.state(context)


def sp(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """The speeds of pr."""
    robot = server.robot_of(context)
    robot.set_speeds(*axis_values(robot, args))
    return server.state(context)


def ac(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """The accelerations; without effect in an ideal setup, as the original's documentation says."""
    robot = server.robot_of(context)
    robot.set_accelerations(*axis_values(robot, args))
    return server.state(context)


def st(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Stop and hold, the arm as well."""
    server.drive(context).stop()
    assert context.robot_id is not None
    server.stop_arm(context.robot_id)
    return server.state(context)


def lp(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Let the motors go limp."""
    server.drive(context).limp()
    return server.state(context)


def ws(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> DeferredReply:
    """The state, when the named axes are still or the timeout (simulated seconds) is over.

    Who waits feeds the time-out of conf_tm as who asks does: a waiting client cannot.
    """
    robot = server.robot_of(context)
    axes = [axis for axis, flag in enumerate(args[:3]) if flag]
    deadline_s = server.simulation.time_s + max(0, args[3])

    def waited() -> Reply | None:
        server.feed(context)
        return server.state(context) if robot.is_still(axes) or server.simulation.time_s >= deadline_s else None

    return waited


def zr(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> DeferredReply:
    """Turn to the bumper's zero; the state, when that is done or another motion command took over."""
    robot = server.drive(context)
    robot.zero()
    return lambda: None if robot.zeroing else server.state(context)


def dp(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """What the encoders say of the position; what goes beyond a word later shows as the farthest that it holds."""
    robot = server.robot_of(context)
    robot.define_position(args[0] / 10, args[1] / 10)
    return server.state(context)


def da(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """What the encoders say of the angles."""
    server.robot_of(context).define_angles(rad_from_tenths(args[0]), rad_from_tenths(args[1]))
    return server.state(context)


def conf_tm(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Stop the motion when no command comes for so many simulated seconds; 0 never."""
    server.robot_of(context).set_timeout(max(0, args[0]))
    return server.state(context)


def _way(distance: float) -> float:
    """The way to go; none where only rounding is left."""
    return distance if abs(distance) > _ROUNDING else 0.0
