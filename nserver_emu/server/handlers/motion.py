"""Commands that move a robot, or say how it is to move: a function a command, wire units in, a Reply out.

Rules: tenths become inches and radians here, and nowhere deeper. Values out of range are clamped by the robot, as old
clients do send them.
"""

from __future__ import annotations

import math

from nclient.protocol.replies import Reply
from nclient.protocol.types import rad_from_tenths
from nserver_emu.server.context import Stage
from nserver_emu.server.session import BAD_VALUES, Later, Visit, error_reply
from nserver_emu.server.state_encoder import axis_values

_MV_LEAVE, _MV_HIGHEST = 0, 5
_MV_MOTIONS = (1, 2, 3)
"""The modes of mv that move an axis or let it go; 4 and 5 only set its limits."""
_ROUNDING = 1e-9
"""Inches or radians: what a sum of ways strays by, and far less than a tenth of anything."""


def vm(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Velocities until another motion command or the time-out."""
    robot = stage.drive(visit)
    robot.set_velocities(*axis_values(robot, args))
    return stage.state(visit)


def pr(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Each axis its distance, all at once."""
    robot = stage.drive(visit)
    robot.move_relative(*axis_values(robot, args))
    return stage.state(visit)


def pa(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Each axis to a position, all at once, at the speeds of sp.

    Steering and turret to where the encoders read these angles, the short way; wheels to where they have rolled so
    far since power-on or the last zr.
    """
    robot = stage.drive(visit)
    angles = (0.0, robot.encoder.steering_rad, robot.encoder.turret_rad)
    first, second, third = (
        _way(target - count if rolls else math.remainder(target - angle, math.tau))
        for target, count, angle, rolls in zip(
            axis_values(robot, args), robot.counts, angles, robot.model.rolls, strict=True
        )
    )
    robot.move_relative(first, second, third)
    return stage.state(visit)


def mv(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Each axis in a mode of its own; a mode that clients refuse is refused here too, before anything moves."""
    modes = args[::2]
    if any(not _MV_LEAVE <= mode <= _MV_HIGHEST for mode in modes):
        return error_reply(BAD_VALUES)
    robot = stage.drive(visit, [axis for axis, mode in enumerate(modes) if mode in _MV_MOTIONS])
    values = axis_values(robot, args[1::2])
    for axis, (mode, value) in enumerate(zip(modes, values, strict=True)):
        robot.command_axis(axis, mode, value)
    return stage.state(visit)


def sp(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The speeds of pr."""
    robot = stage.robot_of(visit)
    robot.set_speeds(*axis_values(robot, args))
    return stage.state(visit)


def ac(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The accelerations; without effect in an ideal setup, as the original's documentation says."""
    robot = stage.robot_of(visit)
    robot.set_accelerations(*axis_values(robot, args))
    return stage.state(visit)


def st(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """Stop and hold, the arm as well."""
    stage.drive(visit).stop()
    assert visit.robot_id is not None
    stage.stop_arm(visit.robot_id)
    return stage.state(visit)


def lp(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """Let the motors go limp."""
    stage.drive(visit).limp()
    return stage.state(visit)


def ws(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Later:
    """The state, when the named axes are still or the timeout (simulated seconds) is over.

    Who waits feeds the time-out of conf_tm as who asks does: a waiting client cannot.
    """
    robot = stage.robot_of(visit)
    axes = [axis for axis, flag in enumerate(args[:3]) if flag]
    deadline_s = stage.simulation.time_s + max(0, args[3])

    def waited() -> Reply | None:
        stage.feed(visit)
        return stage.state(visit) if robot.still(axes) or stage.simulation.time_s >= deadline_s else None

    return waited


def zr(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Later:
    """Turn to the bumper's zero; the state, when that is done or another motion command took over."""
    robot = stage.drive(visit)
    robot.zero()
    return lambda: None if robot.zeroing else stage.state(visit)


def dp(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """What the encoders say of the position; what goes beyond a word later shows as the farthest that it holds."""
    robot = stage.robot_of(visit)
    robot.define_position(args[0] / 10, args[1] / 10)
    return stage.state(visit)


def da(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """What the encoders say of the angles."""
    stage.robot_of(visit).define_angles(rad_from_tenths(args[0]), rad_from_tenths(args[1]))
    return stage.state(visit)


def conf_tm(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Stop the motion when no command comes for so many simulated seconds; 0 never."""
    stage.robot_of(visit).set_timeout(max(0, args[0]))
    return stage.state(visit)


def _way(distance: float) -> float:
    """The way to go; none where only rounding is left."""
    return distance if abs(distance) > _ROUNDING else 0.0
