"""Handlers of client graphics, speech, and user packets (the arm): one function per command, with the command's name.

A user packet is a special_request; its reply is a list of bytes, one per word:

    length low, length high (including these four bytes), serial 0, packet type, data
    arm      data: int32 result, low byte first; after arm_ws also the uint32 rest of the timeout

No source defines the arm's packets. Decisions of this project: modes are those of mv; values are 1/100 inch (per
second, per second squared); result 1 is done, 0 not done (arm_ws: timeout); the timeout is in ms, 0 returns at once.
arm_mv replies at once, arm_zr when both axes are at 0 regardless of its override. Any other packet type is ERROR 4.
"""

from __future__ import annotations

from functools import partial

from nclient.protocol.client_state import READ, RESTART, RING_PACKET, pack_ring
from nclient.protocol.commands import BY_NAME
from nclient.protocol.replies import Reply
from nserver_emu.server.graphics import Figure, Utterance
from nserver_emu.server.server_state import ARM, ServerState, robot_clock_ms
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, ConnectionContext, DeferredReply, done, error_reply
from nserver_emu.simulation.axis import AXIS_MOTIONS, Arm, Command


def refresh(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Acknowledge a request to redraw: the page shows what has changed without one."""
    return done()


# The ten refresh commands by name.
REFRESHERS = {name: refresh for name in BY_NAME if name.startswith("refresh_")}


def _draw(server: ServerState, _context: ConnectionContext, args: tuple[int, ...], figure: Figure) -> Reply:
    *numbers, mode = args
    server.graphics.draw(figure, tuple(numbers), mode, server.allowed.graphics)
    return done()


draw_robot = partial(_draw, figure=Figure.ROBOT)
"""Draw a robot with its steering and turret."""
draw_line = partial(_draw, figure=Figure.LINE)
"""Draw a line between two points."""
draw_arc = partial(_draw, figure=Figure.ARC)
"""Draw part of the ellipse in a box."""


# Speech and user packets.

ARM_MODELS = frozenset({"n200"})
# Packet types of arm_zr, arm_ws and arm_mv.
ZERO_PACKET, WAIT_PACKET, MOVE_PACKET = 40, 41, 42
_UNITS_PER_INCH = 100.0
_FAILED, _SUCCEEDED = 0, 1


def tk(server: ServerState, context: ConnectionContext, args: tuple[str, ...]) -> Reply:
    """Speak a text, which is appended to the speech log; on the robot's own line the reply is the state."""
    server.transcript.append(Utterance(server.simulation.time_s, context.robot_id or 0, args[0]))
    return server.state_reply(context) if context.wire_state.line else done()


def special_request(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Answer the ring packet; refuse user packets other than that and the arm's."""
    packet_type, *data = args
    if packet_type != RING_PACKET:
        return error_reply(NOT_AVAILABLE)
    if data not in ([READ], [RESTART]):
        return error_reply(BAD_VALUES)
    robot = server.robot_of(context)
    if data == [RESTART]:
        robot.restart_sonars()
    clock_ms = robot_clock_ms(robot, server.simulation.time_s)
    return _bytes_packet(RING_PACKET, pack_ring(clock_ms, robot.sonar.readings_in))


def arm_mv(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Command lift and grip, each in its own mode."""
    if not _has_arm(server, context):
        return error_reply(NOT_AVAILABLE)
    modes = args[::2]
    if any(mode not in tuple(Command) for mode in modes):
        return error_reply(BAD_VALUES)
    arm = server.arm_of(context)
    for slide, mode, value in zip((arm.lift, arm.grip), modes, args[1::2], strict=True):
        slide.command(Command(mode), value / _UNITS_PER_INCH)
    if not AXIS_MOTIONS.isdisjoint(modes):
        server.axis_ownership.claim(context, context.robot, [ARM])
    return _packet(MOVE_PACKET, _SUCCEEDED)


def arm_zr(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply | DeferredReply:
    """Move the arm to its zero; reply when it is there."""
    if not _has_arm(server, context):
        return error_reply(NOT_AVAILABLE)
    server.arm_of(context).zero()
    server.axis_ownership.claim(context, context.robot, [ARM])
    return lambda: _packet(ZERO_PACKET, _SUCCEEDED) if _awaited_arm(server, context).is_still() else None


def arm_ws(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | DeferredReply:
    """Reply when the selected axes (lift, grip) are still or the timeout (ms) is over."""
    if not _has_arm(server, context):
        return error_reply(NOT_AVAILABLE)
    lift, grip, timeout_ms = args
    end_s = server.simulation.time_s + timeout_ms / 1000

    def poll() -> Reply | None:
        left_ms = round(1000 * (end_s - server.simulation.time_s))
        if _awaited_arm(server, context).is_still(bool(lift), bool(grip)):
            return _packet(WAIT_PACKET, _SUCCEEDED, max(left_ms, 0))
        return None if left_ms > 0 else _packet(WAIT_PACKET, _FAILED, 0)

    return poll


def _has_arm(server: ServerState, context: ConnectionContext) -> bool:
    return server.robot_of(context).model.family in ARM_MODELS


def _awaited_arm(server: ServerState, context: ConnectionContext) -> Arm:
    """Return the arm as of now; waiting for it restarts the command timeout, as for the robot's own motion."""
    server.feed_watchdog(context)
    return server.arm_of(context)


def _packet(packet_type: int, *numbers: int) -> Reply:
    # A packet is its length and type, then int32 numbers, one byte per word.
    return _bytes_packet(packet_type, b"".join(number.to_bytes(4, "little", signed=False) for number in numbers))


def _bytes_packet(packet_type: int, data: bytes) -> Reply:
    length = len(data) + 4
    return Reply("special", values=(length & 255, length >> 8, 0, packet_type, *data))
