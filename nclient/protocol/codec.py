"""How far the numbers of a call may go on a robot's own line, where they have two bytes or one, and a sign or none.

Rules: read off the table's rows. Old programs send what they like, so the C mirror and the gateway bring it within
(PROTOCOL.md, section 3: out of range is clamped silently); everybody else is told which number, and how far it may go.
A call without such fields is left as it is; so is the time of ws, which goes in pieces.

The two languages whole: calls and replies to bytes and back, over TCP and on the robot's own line.

    call --request--> bytes --framer--> frame --read_call--> call        reply, the same way back

Rules: the table says what each command looks like; nothing here knows one command from another but by its row.
Both ends call `note` for each request they sent or took, so that mask and laser shape go the same way.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from construct import ConstructError

from nclient.common.hints import suggest
from nclient.errors import WireError
from nclient.protocol import replies as shape
from nclient.protocol import (
    requests,
    serial_framing,
    tcp_framing,
)
from nclient.protocol.commands import (
    BY_LINE_TYPE,
    BY_NAME,
    BY_PACKET_TYPE,
    BY_TCP_TYPE,
    ERROR_TYPE,
    NAK_TYPE,
    REPLY_TYPES,
    Call,
    Command,
    exists_on_serial,
)
from nclient.protocol.fields import LINE_BYTE, LINE_SIGNED, LINE_UNSIGNED
from nclient.protocol.replies import Reply, one_line
from nclient.protocol.requests import HISTORY_BYTE, LASER_MODE_BYTE, Fields
from nclient.protocol.serial_framing import SerialFrame
from nclient.protocol.tcp_framing import TcpFrame
from nclient.protocol.types import Mask
from nclient.protocol.wire_state import LINES, POINTS, TCP_LINE_MODES, WireState

BYTE_HIGHEST = 255
_SIGNED, _UNSIGNED, _BYTE = (-0x7FFF, 0x7FFF), (0, 0xFFFF), (0, BYTE_HIGHEST)
_RANGES = (
    (LINE_SIGNED, _SIGNED), (LINE_UNSIGNED, _UNSIGNED),
    (LINE_BYTE, _BYTE), (HISTORY_BYTE, _BYTE), (LASER_MODE_BYTE, _BYTE),
)  # fmt: skip
_FREE = (-(1 << 31), (1 << 31) - 1)
_NOT_NEGATIVE = (0, _FREE[1])


@lru_cache
def serial_argument_bounds(name: str) -> tuple[tuple[str, int, int], ...]:
    """Name, least and greatest of each number of a command, in order; () where it has no such numbers."""
    row = BY_NAME.get(name)
    if row is None or row.packet_type is not None or row.any_length or not isinstance(row.line_request, Fields):
        return ()
    bounds = []
    for argument in row.arguments:
        span = next((span for field, span in _RANGES if argument.line is field), _FREE)
        piecewise = (name, argument.name) == ("ws", "timeout_s")
        bounds.append((argument.name, *(_NOT_NEGATIVE if piecewise else span)))
    return tuple(bounds)


def clamp_to_serial(call: Call) -> Call:
    """The call with each number brought to the nearest that the line can carry."""
    bounds = serial_argument_bounds(call.name)
    if len(bounds) != len(call.args) or not bounds:
        return call
    return Call(call.name, tuple(
        min(max(value, least), most) for value, (_, least, most) in zip(call.args, bounds, strict=True)
    ))


def describe_serial_overflow(call: Call) -> str:
    """Which number of a call the line cannot carry, how far it may go, and what to do; "" where all fit."""
    for value, (name, least, most) in zip(call.args, serial_argument_bounds(call.name), strict=False):
        if isinstance(value, int) and not least <= value <= most:
            return (
                f"{call.name}: {name} is {value}, and a robot's own line carries {least} to {most} "
                "(lengths in 1/10 inch, angles in 1/10 degree); stay within that, in several steps if need be"
            )
    return ""


_SPECIAL_TYPE_WORD, _SPECIAL_TYPE_BYTE = 15, 3


def find_command(name: str) -> Command:
    """The row of a C name. Raises WireError for a name that is none."""
    try:
        return BY_NAME[name]
    except KeyError:
        raise WireError(no_command(name)) from None


def no_command(name: str, beside: Iterable[str] = ()) -> str:
    """That there is no such command, and which was probably meant; `beside`: what else may have been."""
    return f"no command {name!r}{suggest(name, (*BY_NAME, *beside))}"


def update_from_request(call: Call, wire_state: WireState) -> None:
    """What a request changes for the replies that follow it, its own included where PROTOCOL.md says so."""
    match call.name:
        case "ct":
            wire_state.set_mask(Mask(call.args))
        case "conf_ls":
            wire_state.set_laser_mode(call.args[0])
        case "get_sg" if not wire_state.line:
            wire_state.laser_width = LINES
        case "get_ls" if not wire_state.line and wire_state.laser_mode in TCP_LINE_MODES:
            wire_state.laser_width = POINTS
        case _:
            pass


def encode_tcp_request(call: Call, *, wide: bool = False) -> bytes:
    """The bytes of a call over TCP. Raises WireError when its arguments cannot be sent."""
    row = find_command(call.name)
    if row.tcp_type is None:
        raise WireError(f"{call.name} does not exist over TCP")
    return tcp_framing.build_frame(row.tcp_type, _build(row, row.tcp_request, call.args), wide=wide)


def decode_tcp_request(frame: TcpFrame) -> Call:
    """The call that a request frame is. Raises WireError when the numbers are none it can have."""
    row = BY_TCP_TYPE.get(frame.type)
    if row is None:
        raise WireError(f"unknown message type {frame.type}")
    special = row.name == "special_request" and len(frame.payload) > _SPECIAL_TYPE_WORD
    return _call(row, frame.payload[_SPECIAL_TYPE_WORD] if special else None, frame.payload, line=False)


def encode_tcp_reply(row: Command, reply: Reply, wire_state: WireState) -> bytes:
    """The bytes of the answer to a command over TCP; an error reply goes by its own layout."""
    layout = shape.ERROR if reply.kind == "error" else row.tcp_reply
    payload = layout.build(reply, wire_state)
    return tcp_framing.build_frame(REPLY_TYPES[layout], payload, wide=wire_state.wide, reply=True)


def decode_tcp_reply(row: Command, frame: TcpFrame, wire_state: WireState) -> Reply:
    """The answer to a command, out of its frame. Only the type of an error is looked at, as old clients do."""
    layout = shape.ERROR if frame.type == ERROR_TYPE else row.tcp_reply
    return layout.parse(frame.payload, wire_state)


def encode_serial_request(call: Call, wire_state: WireState) -> bytes:
    """The bytes of a call on the robot's own line. Raises WireError when this model's line does not have it."""
    row = find_command(call.name)
    if row.line_type is None or not exists_on_serial(row, wire_state.model):
        raise WireError(f"{call.name} does not exist on the line of a {wire_state.model.name}")
    beyond = describe_serial_overflow(call)
    if beyond:
        raise WireError(beyond)
    frame = serial_framing.build_frame(row.line_type, _build(row, row.line_request, call.args))
    if len(frame) > serial_framing.HOST_LIMIT:
        raise WireError(f"{call.name}: a host's frame has at most {serial_framing.HOST_LIMIT} bytes, not {len(frame)}")
    return frame


def decode_serial_request(frame: SerialFrame, wire_state: WireState) -> Call:
    """The call that a frame from a host is. Raises WireError for a type or data that this model does not have."""
    row = BY_LINE_TYPE.get(frame.type)
    if row is None or not exists_on_serial(row, wire_state.model):
        raise WireError(f"type {frame.type} does not exist on the line of a {wire_state.model.name}")
    special = row.name == "special_request" and len(frame.data) > _SPECIAL_TYPE_BYTE
    return _call(row, frame.data[_SPECIAL_TYPE_BYTE] if special else None, frame.data, line=True)


def encode_serial_reply(row: Command, reply: Reply, wire_state: WireState) -> bytes:
    """The bytes of a robot's answer on its own line; a nak goes by its own type."""
    if reply.kind == "nak":
        return serial_framing.build_frame(NAK_TYPE)
    if row.line_type is None:
        raise WireError(f"{row.name} does not exist on a robot's own line")
    return serial_framing.build_frame(row.line_type, row.line_reply.build(reply, wire_state))


def decode_serial_reply(frame: SerialFrame, wire_state: WireState) -> Reply:
    """A robot's answer out of its frame, which names the command. Raises WireError for one that fits none."""
    if frame.type == NAK_TYPE:
        return shape.LINE_NAK.parse(frame.data, wire_state)
    row = BY_LINE_TYPE.get(frame.type)
    if row is None or not exists_on_serial(row, wire_state.model):
        raise WireError(f"no answer of type {frame.type} comes from a {wire_state.model.name}")
    return row.line_reply.parse(frame.data, wire_state)


def _build(row: Command, layout: Any, args: tuple[Any, ...]) -> bytes:
    if not row.any_length and len(row.arguments) != len(args):
        names = ", ".join(argument.name for argument in row.arguments) or "nothing"
        raise WireError(f"{row.name} takes {len(row.arguments)} numbers ({names}), got {len(args)}")
    try:
        return requests.build(layout, args)
    except (ConstructError, TypeError, OverflowError, ValueError) as error:
        raise WireError(f"{row.name}{args}: {one_line(error)}") from None


def _call(row: Command, packet_type: int | None, data: bytes, *, line: bool) -> Call:
    if packet_type in BY_PACKET_TYPE:
        try:
            return _parsed(BY_PACKET_TYPE[packet_type], data, line)
        except WireError:
            pass  # not the arm's packet after all: a user's own of the same number
    return _parsed(row, data, line)


def _parsed(row: Command, data: bytes, line: bool) -> Call:
    if not data and not row.arguments:
        return Call(row.name)
    try:
        return Call(row.name, tuple(requests.parse(row.line_request if line else row.tcp_request, data)))
    except (ConstructError, WireError) as error:
        raise WireError(f"{row.name}: {one_line(error)}") from None
