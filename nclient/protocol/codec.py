"""Calls and replies to bytes and back, over TCP and on the robot's own serial line.

    Call --encode_*_request--> bytes --framer--> frame --decode_*_request--> Call        likewise for replies

Layouts come from the command table; nothing here depends on a particular command except where docs/protocol.md names
an exception. Both ends call `update_from_request` for each request sent or received, so that they agree on the mask
and on the laser layout. The first functions check or clamp arguments to the ranges of the serial line's fields.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from construct import ConstructError

from nclient.common.hints import suggest
from nclient.errors import WireError
from nclient.protocol import replies as shape
from nclient.protocol import requests, serial_framing, tcp_framing
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
from nclient.protocol.replies import Reply, summarize_error
from nclient.protocol.requests import HISTORY_BYTE, LASER_MODE_BYTE, Fields
from nclient.protocol.serial_framing import SerialFrame
from nclient.protocol.tcp_framing import TcpFrame
from nclient.protocol.types import Mask
from nclient.protocol.wire_state import LINES, POINTS, TCP_LINE_MODES, WireState

MAX_BYTE = 255
# Serial numbers are sign-magnitude, so that a signed one ends at -0x7FFF.
_SIGNED, _UNSIGNED, _BYTE = (-0x7FFF, 0x7FFF), (0, 0xFFFF), (0, MAX_BYTE)
_RANGES = (
    (LINE_SIGNED, _SIGNED), (LINE_UNSIGNED, _UNSIGNED),
    (LINE_BYTE, _BYTE), (HISTORY_BYTE, _BYTE), (LASER_MODE_BYTE, _BYTE),
)  # fmt: skip
# Range of an argument that has another form on the serial line, such as the flags of ws.
_FREE = (-(1 << 31), (1 << 31) - 1)
_NOT_NEGATIVE = (0, _FREE[1])


@lru_cache
def serial_argument_bounds(name: str) -> tuple[tuple[str, int, int], ...]:
    """Return (argument, minimum, maximum) for each argument of a command on the serial line.

    Empty for unknown commands, packets and commands of variable length.
    """
    row = BY_NAME.get(name)
    if row is None or row.packet_type is not None or row.any_length or not isinstance(row.line_request, Fields):
        return ()
    bounds = []
    for argument in row.arguments:
        span = next((span for field, span in _RANGES if argument.line is field), _FREE)
        # A longer ws is sent as several of at most 255 s each.
        is_split = (name, argument.name) == ("ws", "timeout_s")
        bounds.append((argument.name, *(_NOT_NEGATIVE if is_split else span)))
    return tuple(bounds)


def clamp_to_serial(call: Call) -> Call:
    """Return the call with each argument clamped to its range on the serial line.

    For the C interface and the gateway, which clamp without an error (docs/protocol.md, State vector).
    """
    bounds = serial_argument_bounds(call.name)
    if len(bounds) != len(call.args) or not bounds:
        return call
    return Call(call.name, tuple(
        min(max(value, least), most) for value, (_, least, most) in zip(call.args, bounds, strict=True)
    ))


def describe_serial_overflow(call: Call) -> str:
    """Return an error text for the first argument out of its serial range; "" if all are in range."""
    for value, (name, least, most) in zip(call.args, serial_argument_bounds(call.name), strict=False):
        if isinstance(value, int) and not least <= value <= most:
            return (
                f"{call.name}: {name} is {value}, and a robot's own line carries {least} to {most} "
                "(lengths in 1/10 inch, angles in 1/10 degree); stay within that, in several steps if need be"
            )
    return ""


# Place of the packet type in a special_request: low byte of the fourth word over TCP, fourth byte on the serial line.
_SPECIAL_TYPE_WORD, _SPECIAL_TYPE_BYTE = 15, 3


def find_command(name: str) -> Command:
    """Return the command of a C name. Raises WireError, with a suggestion, if there is none."""
    try:
        return BY_NAME[name]
    except KeyError:
        raise WireError(describe_unknown_command(name)) from None


def describe_unknown_command(name: str, alternatives: Iterable[str] = ()) -> str:
    """Return an error text for an unknown command, with a suggestion out of all commands and `alternatives`."""
    return f"no command {name!r}{suggest(name, (*BY_NAME, *alternatives))}"


def update_from_request(call: Call, wire_state: WireState) -> None:
    """Update the connection's state for a request that was sent or received, before its reply is read or written."""
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
    """Return the bytes of a call over TCP.

    Raises
    ------
    WireError
        If the command does not exist over TCP, or its arguments do not fit.
    """
    row = find_command(call.name)
    if row.tcp_type is None:
        raise WireError(f"{call.name} does not exist over TCP")
    return tcp_framing.build_frame(row.tcp_type, _build(row, row.tcp_request, call.args), wide=wide)


def decode_tcp_request(frame: TcpFrame) -> Call:
    """Return the call of a request frame. Raises WireError if its type is unknown or its values are not valid."""
    row = BY_TCP_TYPE.get(frame.type)
    if row is None:
        raise WireError(f"unknown message type {frame.type}")
    special = row.name == "special_request" and len(frame.payload) > _SPECIAL_TYPE_WORD
    return _parse_call(row, frame.payload[_SPECIAL_TYPE_WORD] if special else None, frame.payload, line=False)


def encode_tcp_reply(row: Command, reply: Reply, wire_state: WireState) -> bytes:
    """Return the bytes of a reply over TCP; an error reply has its own layout and type."""
    layout = shape.ERROR if reply.kind == "error" else row.tcp_reply
    payload = layout.build(reply, wire_state)
    return tcp_framing.build_frame(REPLY_TYPES[layout], payload, wide=wire_state.wide, reply=True)


def decode_tcp_reply(row: Command, frame: TcpFrame, wire_state: WireState) -> Reply:
    """Parse the reply to a command. Like old clients it looks at the frame's type only for an error."""
    layout = shape.ERROR if frame.type == ERROR_TYPE else row.tcp_reply
    return layout.parse(frame.payload, wire_state)


def encode_serial_request(call: Call, wire_state: WireState) -> bytes:
    """Return the bytes of a call on the serial line.

    Raises
    ------
    WireError
        If this model does not have the command, an argument is out of range or the frame is too long.
    """
    row = find_command(call.name)
    if row.line_type is None or not exists_on_serial(row, wire_state.model):
        raise WireError(f"{call.name} does not exist on the line of a {wire_state.model.name}")
    if error := describe_serial_overflow(call):
        raise WireError(error)
    frame = serial_framing.build_frame(row.line_type, _build(row, row.line_request, call.args))
    if len(frame) > serial_framing.HOST_LIMIT:
        raise WireError(f"{call.name}: a host's frame has at most {serial_framing.HOST_LIMIT} bytes, not {len(frame)}")
    return frame


def decode_serial_request(frame: SerialFrame, wire_state: WireState) -> Call:
    """Return the call of a host's frame. Raises WireError if this model does not have the command or the data."""
    row = BY_LINE_TYPE.get(frame.type)
    if row is None or not exists_on_serial(row, wire_state.model):
        raise WireError(f"type {frame.type} does not exist on the line of a {wire_state.model.name}")
    special = row.name == "special_request" and len(frame.data) > _SPECIAL_TYPE_BYTE
    return _parse_call(row, frame.data[_SPECIAL_TYPE_BYTE] if special else None, frame.data, line=True)


def encode_serial_reply(row: Command, reply: Reply, wire_state: WireState) -> bytes:
    """Return the bytes of a robot's reply on the serial line; a NAK has its own type."""
    if reply.kind == "nak":
        return serial_framing.build_frame(NAK_TYPE)
    if row.line_type is None:
        raise WireError(f"{row.name} does not exist on a robot's own line")
    return serial_framing.build_frame(row.line_type, row.line_reply.build(reply, wire_state))


def decode_serial_reply(frame: SerialFrame, wire_state: WireState) -> Reply:
    """Parse a robot's reply; the frame's type is that of the command. Raises WireError if it fits no layout."""
    if frame.type == NAK_TYPE:
        return shape.LINE_NAK.parse(frame.data, wire_state)
    row = BY_LINE_TYPE.get(frame.type)
    if row is None or not exists_on_serial(row, wire_state.model):
        raise WireError(f"no answer of type {frame.type} comes from a {wire_state.model.name}")
    return row.line_reply.parse(frame.data, wire_state)


def _build(row: Command, layout: Any, args: tuple[Any, ...]) -> bytes:
    # The number of arguments is checked here, for an error that names them; values by the layout.
    if not row.any_length and len(row.arguments) != len(args):
        names = ", ".join(argument.name for argument in row.arguments) or "nothing"
        raise WireError(f"{row.name} takes {len(row.arguments)} numbers ({names}), got {len(args)}")
    try:
        return requests.build(layout, args)
    except (ConstructError, TypeError, OverflowError, ValueError) as error:
        raise WireError(f"{row.name}{args}: {summarize_error(error)}") from None


def _parse_call(row: Command, packet_type: int | None, data: bytes, *, line: bool) -> Call:
    # Packets of the arm are special requests whose type is in their bytes.
    if packet_type in BY_PACKET_TYPE:
        try:
            return _parse_arguments(BY_PACKET_TYPE[packet_type], data, line)
        except WireError:
            # Not a packet of the arm after all, but a user packet of the same number.
            pass
    return _parse_arguments(row, data, line)


def _parse_arguments(row: Command, data: bytes, line: bool) -> Call:
    # Most queries have neither data nor arguments.
    if not data and not row.arguments:
        return Call(row.name)
    try:
        return Call(row.name, tuple(requests.parse(row.line_request if line else row.tcp_request, data)))
    except (ConstructError, WireError) as error:
        raise WireError(f"{row.name}: {summarize_error(error)}") from None
