"""Commands that draw into the window or have it redrawn: a function a command. What they leave is in graphics.py.

Speech, and the user packets of special_request, among them the arm's three: a function a command.

    answer      length low, length high (its own four bytes included), serial 0, packet type, bytes; one byte a word
    arm         bytes: int32 result, low byte first; after arm_ws the uint32 rest of the time-out too

Decisions of ours, for no source tells them: modes are those of mv; values 1/100 inch (per second, per second squared);
result 1 done, 0 not (arm_ws: the time-out came first); the time-out in ms, 0 asks at once. arm_mv answers at once,
arm_zr when both axes are at 0, whatever its override says. A user packet of another type has no program that would
answer it: ERROR 4.
"""

from __future__ import annotations

from collections.abc import Callable

from nclient.protocol.replies import Reply
from nserver_emu.server.context import ServerState, Utterance
from nserver_emu.server.graphics import Figure, Layer
from nserver_emu.server.handlers.world import done
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, ConnectionContext, DeferredReply, error_reply
from nserver_emu.simulation.arm import Arm
from nserver_emu.simulation.axis import Command

_SENSORS = (Layer.BUMPER, Layer.INFRARED, Layer.SONAR, Layer.LASER)
_REDRAWN = {
    "refresh_all": tuple(Layer),
    "refresh_all_traces": (Layer.ACTUAL_TRACE, Layer.ENCODER_TRACE),
    "refresh_actual_trace": (Layer.ACTUAL_TRACE,),
    "refresh_encoder_trace": (Layer.ENCODER_TRACE,),
    "refresh_all_sensors": _SENSORS,
    "refresh_bumper_sensor": (Layer.BUMPER,),
    "refresh_infrared_sensor": (Layer.INFRARED,),
    "refresh_sonar_sensor": (Layer.SONAR,),
    "refresh_laser_sensor": (Layer.LASER,),
    "refresh_client_graphics": (Layer.CLIENT,),
}


def draw_robot(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Draw a robot with its steering and turret."""
    return _draw(server, Figure.ROBOT, args)


def draw_line(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Draw a line between two points."""
    return _draw(server, Figure.LINE, args)


def draw_arc(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Draw part of the ellipse in a box."""
    return _draw(server, Figure.ARC, args)


def refresher(layers: tuple[Layer, ...]) -> Callable[[ServerState, ConnectionContext, tuple[int, ...]], Reply]:
    """The command that has these layers redrawn."""

    def refresh(server: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
        server.graphics.redraw(*layers)
        return done()

    return refresh


REFRESHERS = {name: refresher(layers) for name, layers in _REDRAWN.items()}
"""The ten refresh commands by their names."""


def _draw(server: ServerState, figure: Figure, args: tuple[int, ...]) -> Reply:
    *numbers, mode = args
    server.graphics.draw(figure, tuple(numbers), mode, server.allowed.graphics)
    return done()


ARM_MODELS = frozenset({"n200"})
ZERO_PACKET, WAIT_PACKET, MOVE_PACKET = 40, 41, 42
_MOTIONS = frozenset({Command.VELOCITY, Command.RELATIVE, Command.LIMP})
_UNITS_AN_INCH = 100.0
_FAILED, _SUCCEEDED = 0, 1


def tk(server: ServerState, context: ConnectionContext, args: tuple[str, ...]) -> Reply:
    """Say a text: it is kept in the transcript. On the robot's own line the answer is the state."""
    server.transcript.add(Utterance(server.simulation.time_s, context.robot_id or 0, args[0]))
    return server.state(context) if context.wire_state.line else done()


def special_request(_stage: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """A user packet: none but the arm's is known to this robot."""
    return error_reply(NOT_AVAILABLE)


def arm_mv(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Lift and grip each in a mode of its own."""
    if not _has_arm(server, context):
        return error_reply(NOT_AVAILABLE)
    modes = args[::2]
    if any(mode not in tuple(Command) for mode in modes):
        return error_reply(BAD_VALUES)
    arm = server.arm_of(context)
    for slide, mode, value in zip((arm.lift, arm.grip), modes, args[1::2], strict=True):
        slide.command(Command(mode), value / _UNITS_AN_INCH)
    assert context.robot_id is not None
    if not _MOTIONS.isdisjoint(modes):
        server.axis_ownership.claim_arm(context, context.robot_id)
    return _packet(MOVE_PACKET, _SUCCEEDED)


def arm_zr(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply | DeferredReply:
    """Send the arm to its zero; the answer comes when it is there."""
    if not _has_arm(server, context):
        return error_reply(NOT_AVAILABLE)
    server.arm_of(context).zero()
    assert context.robot_id is not None
    server.axis_ownership.claim_arm(context, context.robot_id)
    return lambda: _packet(ZERO_PACKET, _SUCCEEDED) if _waited_arm(server, context).is_still() else None


def arm_ws(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply | DeferredReply:
    """The answer comes when lift and grip, as named, are still, or when the time-out (ms) is over."""
    if not _has_arm(server, context):
        return error_reply(NOT_AVAILABLE)
    lift, grip, timeout_ms = args
    end_s = server.simulation.time_s + timeout_ms / 1000

    def waited() -> Reply | None:
        left_ms = round(1000 * (end_s - server.simulation.time_s))
        if _waited_arm(server, context).is_still(bool(lift), bool(grip)):
            return _packet(WAIT_PACKET, _SUCCEEDED, max(left_ms, 0))
        return None if left_ms > 0 else _packet(WAIT_PACKET, _FAILED, 0)

    return waited


def _has_arm(server: ServerState, context: ConnectionContext) -> bool:
    return server.robot_of(context).model.family in ARM_MODELS


def _waited_arm(server: ServerState, context: ConnectionContext) -> Arm:
    """The arm as it is now; who waits for it feeds the time-out, as with the robot's own motion."""
    server.feed(context)
    return server.arm_of(context)


def _packet(packet_type: int, *numbers: int) -> Reply:
    data = b"".join(number.to_bytes(4, "little", signed=False) for number in numbers)
    length = len(data) + 4
    return Reply("special", values=(length & 255, length >> 8, 0, packet_type, *data))
