"""Calls and replies to bytes and back, over TCP and on the robot's own serial line; frames of the TCP protocol.

    Call --encode_*_request--> bytes --framer--> frame --decode_*_request--> Call        likewise for replies

Over TCP all is big-endian words of 32 bits; a 64-bit client sends and reads eight bytes for each:

    int16 type | uint16 count | count x int32       request word  00 00 00 00 + value
                                                    reply word    value + four bytes that it ignores

`TcpFramer` returns the frames that are complete; it never waits and never raises. A count is checked against the limits
of its type before any payload is buffered; an invalid frame is skipped, counted and reported. Frames of the serial line
are in serial_framing.py.

Layouts come from the command table; nothing here depends on a particular command except where docs/protocol.md has
an exception. Both ends call `update_from_request` for each request sent or received, so that they agree on the mask and
on the laser layout.
"""

import contextlib
import struct
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from itertools import repeat
from typing import Any, Final, NamedTuple

from construct import ConstructError

from nclient.errors import WireError, suggest
from nclient.protocol import commands, layouts, serial_framing
from nclient.protocol import replies as shape
from nclient.protocol.replies import Reply, TcpLayout, summarize_error
from nclient.protocol.serial_framing import SerialFrame
from nclient.protocol.types import LINES, NO_STAMP, POINTS, STAMP_KEYS, TCP_LINE_MODES, Mask, Stamp, WireState

_HEADER = struct.Struct(">hH")
_WORD_SIZE = 4
MAX_UNKNOWN_WORDS = 1024
"""A message of unknown type or wrong count is skipped whole up to this count. With a larger count synchronisation is
lost: it is reported once, and the search continues byte by byte until a valid message is found."""
UNKNOWN_TYPE, WRONG_COUNT = 1, 2
# create, connect and disconnect: their first argument, the robot number, distinguishes 32-bit from 64-bit clients.
_CONNECT_TYPES = (101, 102, 103)
# A stamp over TCP: seven signed words of pose and velocities, two unsigned ones of times in ms.
_STAMP_CODE = "7i2I"
_UNSIGNED_WORD = 0xFFFFFFFF
Bounds = Callable[[int], tuple[int, int] | None]
"""Minimum and maximum number of words by message type: request_bounds or reply_bounds."""


class TcpFrame(NamedTuple):
    """A whole message; its words are big-endian 32-bit for 64-bit clients, too."""

    type: int
    payload: bytes


class InvalidFrame(NamedTuple):
    """A message that was rejected: code for the ERROR reply, and the reason."""

    code: int
    reason: str
    fatal: bool
    """True if synchronisation was lost, so that later bytes may be misread."""


# By type of the message; None for an unknown type.
_REQUEST_BOUNDS: Final = {number: row.tcp_words for number, row in commands.BY_TCP_TYPE.items()}
request_bounds: Final[Bounds] = _REQUEST_BOUNDS.get
reply_bounds: Final[Bounds] = {number: (1, most) for number, most in commands.MAX_REPLY_WORDS.items()}.get


@lru_cache
def limited_request_bounds(max_words: int) -> Bounds:
    """Return the bounds of requests with the maximum limited to `max_words`."""
    return {number: (least, min(most, max_words)) for number, (least, most) in _REQUEST_BOUNDS.items()}.get


def build_frame(frame_type: int, payload: bytes, *, wide: bool = False, reply: bool = False) -> bytes:
    """Return the bytes of a message.

    Parameters
    ----------
    frame_type
        Message type.
    payload
        Words as big-endian 32-bit bytes.
    wide
        True for or from a 64-bit client.
    reply
        True for a reply; with `wide` its padding differs from that of a request.

    Raises
    ------
    WireError
        If the payload is not whole words, or has more than 65535.
    """
    words = len(payload) // 4
    if len(payload) % 4 or words > 0xFFFF:
        raise WireError(f"a message is whole words, at most 65535; got {len(payload)} bytes")
    return _HEADER.pack(frame_type, words) + (_widen(payload, reply) if wide else payload)


def parse_single_frame(data: bytes, bounds: Bounds, wide: bool) -> TcpFrame:
    """Parse bytes that must be exactly one message. Raises WireError otherwise."""
    framer = TcpFramer(bounds, wide)
    found = framer.receive(data)
    if not found:
        raise WireError(f"truncated: {len(data)} bytes are no whole message")
    first = found[0]
    if isinstance(first, InvalidFrame):
        raise WireError(first.reason)
    if len(found) > 1 or framer.pending or framer.skipped_bytes:
        size = _HEADER.size + len(first.payload) * (2 if wide else 1)
        raise WireError(f"{len(data) - size} bytes behind the message: {data[size:][:8].hex()}")
    return first


class TcpFramer:
    """Incremental parser of the requests or replies in a byte stream.

    Parameters
    ----------
    bounds
        request_bounds or reply_bounds.
    wide
        True for a 64-bit client, False for a 32-bit one, None to detect it from CONNECT: robot numbers are at least
        1, so that a first word of zero comes from a 64-bit client.
    drop_after_loss
        True to drop everything after synchronisation was lost instead of searching for the next message.
    """

    def __init__(self, bounds: Bounds, wide: bool | None = None, drop_after_loss: bool = False) -> None:
        self.wide = wide
        self.frames = 0
        self.skipped_bytes = 0
        self._replies = bounds is reply_bounds
        self._bounds = bounds
        self._buffer = b""
        # Bytes still to arrive of a rejected message.
        self.bytes_to_skip = 0
        self._lost = False
        self._drop_after_loss = drop_after_loss

    @property
    def pending(self) -> int:
        """Return the number of buffered bytes of an incomplete frame."""
        return len(self._buffer)

    @property
    def may_be_narrow(self) -> bool:
        """True if the buffer has the begin of a 64-bit CONNECT that is also a whole 32-bit CONNECT to robot 0."""
        if not self.wide or self.frames or len(self._buffer) < _HEADER.size:
            return False
        message_type, count = _HEADER.unpack_from(self._buffer)
        return message_type in _CONNECT_TYPES and len(self._buffer) == _HEADER.size + _WORD_SIZE * count

    def receive(self, data: bytes) -> list[TcpFrame | InvalidFrame]:
        """Add bytes, and return the frames and rejected frames that they complete, in order."""
        if self._lost and self._drop_after_loss:
            self.skipped_bytes += len(data)
            return []
        data = self._buffer + data
        found: list[TcpFrame | InvalidFrame] = []
        at, end = 0, len(data)
        while True:
            # 1. The rest of a rejected message.
            if self.bytes_to_skip:
                gone = min(self.bytes_to_skip, end - at)
                at += gone
                self.bytes_to_skip -= gone
                self.skipped_bytes += gone
            if end - at < _HEADER.size:
                break
            # 2. Check type and count before waiting for the payload.
            message_type, count = _HEADER.unpack_from(data, at)
            bounds = self._bounds(message_type)
            if bounds is None or not bounds[0] <= count <= bounds[1]:
                found += self._reject(message_type, count, bounds)
                if self._lost and self._drop_after_loss:
                    self.bytes_to_skip = end - at
                continue
            # 3. The first CONNECT shows the word size by its first word.
            start = at + _HEADER.size
            if self.wide is None and message_type in _CONNECT_TYPES:
                if end < start + _WORD_SIZE:
                    break
                self.wide = not any(data[start : start + _WORD_SIZE])
            # 4. Wait until the whole message is there.
            stop = start + (2 * _WORD_SIZE if self.wide else _WORD_SIZE) * count
            if stop > end:
                break
            payload = data[start:stop]
            found.append(TcpFrame(message_type, _narrow(payload, self._replies) if self.wide else payload))
            self.frames += 1
            self._lost = False
            at = stop
        self._buffer = data[at:]
        return found

    def _reject(self, message_type: int, count: int, bounds: tuple[int, int] | None) -> list[InvalidFrame]:
        """Skip a message, and return it unless synchronisation was lost before."""
        was_lost = self._lost
        fatal = self._lost = was_lost or count > MAX_UNKNOWN_WORDS
        # Without synchronisation only one byte is skipped: a message may begin at the next one.
        self.bytes_to_skip = 1 if fatal else _HEADER.size + (2 * _WORD_SIZE if self.wide else _WORD_SIZE) * count
        if was_lost:
            return []
        if bounds is None:
            return [InvalidFrame(UNKNOWN_TYPE, f"unknown message type {message_type}", fatal)]
        wanted = f"{bounds[0]}" if bounds[0] == bounds[1] else f"{bounds[0]} to {bounds[1]}"
        return [InvalidFrame(WRONG_COUNT, f"type {message_type} takes {wanted} words, not {count}", fatal)]


def _widen(payload: bytes, reply: bool) -> bytes:
    layout = "4s4x" if reply else "4x4s"
    words = [payload[k : k + 4] for k in range(0, len(payload), 4)]
    return struct.pack(">" + layout * len(words), *words)


def _narrow(payload: bytes, reply: bool) -> bytes:
    start = 0 if reply else 4
    return b"".join(payload[k : k + 4] for k in range(start, len(payload), 8))


MAX_BYTE = 255
# Serial numbers are sign-magnitude, so that a signed one ends at -0x7FFF.
_SIGNED, _UNSIGNED, _BYTE = (-0x7FFF, 0x7FFF), (0, 0xFFFF), (0, MAX_BYTE)
_RANGES = ((layouts.LINE_SIGNED, _SIGNED), (layouts.LINE_UNSIGNED, _UNSIGNED), (layouts.LINE_BYTE, _BYTE),
           (layouts.HISTORY_BYTE, _BYTE), (layouts.LASER_MODE_BYTE, _BYTE))
# Range of an argument that has another form on the serial line, such as the flags of ws.
_FREE = (-(1 << 31), (1 << 31) - 1)
_NOT_NEGATIVE = (0, _FREE[1])


@lru_cache
def serial_argument_bounds(name: str) -> tuple[tuple[str, int, int], ...]:
    """Return (argument, minimum, maximum) for each argument of a command on the serial line.

    Empty for unknown commands, packets and commands of variable length.
    """
    row = commands.BY_NAME.get(name)
    if row is None or row.packet_type is not None or row.any_length or not isinstance(row.line_request, layouts.Fields):
        return ()
    bounds = []
    for argument in row.arguments:
        span = next((span for field, span in _RANGES if argument.line is field), _FREE)
        # A longer ws is sent as several of at most 255 s each.
        is_split = (name, argument.name) == ("ws", "timeout_s")
        bounds.append((argument.name, *(_NOT_NEGATIVE if is_split else span)))
    return tuple(bounds)


def clamp_to_serial(call: commands.Call) -> commands.Call:
    """Return the call with each argument clamped to its range on the serial line.

    For the C interface and the gateway, which clamp without an error (docs/protocol.md, State vector).
    """
    bounds = serial_argument_bounds(call.name)
    if len(bounds) != len(call.args) or not bounds:
        return call
    return commands.Call(call.name, tuple(min(max(value, least), most)
                                          for value, (_, least, most) in zip(call.args, bounds, strict=True)))


def describe_serial_overflow(call: commands.Call) -> str:
    """Return an error text for the first argument out of its serial range; "" if all are in range."""
    for value, (name, least, most) in zip(call.args, serial_argument_bounds(call.name), strict=False):
        if isinstance(value, int) and not least <= value <= most:
            return (f"{call.name}: {name} is {value}, and a robot's own line carries {least} to {most} (lengths in "
                    "1/10 inch, angles in 1/10 degree); stay within that, in several steps if need be")
    return ""


# Place of the packet type in a special_request: low byte of the fourth word over TCP, fourth byte on the serial line.
_SPECIAL_TYPE_WORD, _SPECIAL_TYPE_BYTE = 15, 3


def find_command(name: str) -> commands.Command:
    """Return the command of a C name. Raises WireError, with a suggestion, if there is none."""
    try:
        return commands.BY_NAME[name]
    except KeyError:
        raise WireError(describe_unknown_command(name)) from None


def describe_unknown_command(name: str, alternatives: Iterable[str] = ()) -> str:
    """Return an error text for an unknown command, with a suggestion out of all commands and `alternatives`."""
    return f"no command {name!r}{suggest(name, (*commands.BY_NAME, *alternatives))}"


def update_from_request(call: commands.Call, wire_state: WireState) -> None:
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


def encode_tcp_request(call: commands.Call, *, wide: bool = False) -> bytes:
    """Return the bytes of a call over TCP.

    Raises
    ------
    WireError
        If the command does not exist over TCP, or its arguments do not fit.
    """
    row = find_command(call.name)
    if row.tcp_type is None:
        raise WireError(f"{call.name} does not exist over TCP")
    _check_argument_count(row, call.args)
    try:
        words = call.args if row.tcp_request is None else row.tcp_request.encode(call.args)
        payload = _pack_words(f"{len(words)}i", words)
    except (WireError, ConstructError, TypeError, OverflowError, ValueError) as error:
        raise WireError(f"{row.name}{call.args}: {summarize_error(error)}") from None
    return build_frame(row.tcp_type, payload, wide=wide)


def decode_tcp_request(frame: TcpFrame) -> commands.Call:
    """Return the call of a request frame. Raises WireError if its type is unknown or its values are not valid."""
    row, payload = commands.BY_TCP_TYPE.get(frame.type), frame.payload
    if row is None:
        raise WireError(f"unknown message type {frame.type}")
    # Most queries have neither words nor arguments.
    if not payload and not row.arguments:
        return commands.Call(row.name)
    # 1. Packets of the arm are special requests whose type is in their bytes.
    if row.name == "special_request" and len(payload) > _SPECIAL_TYPE_WORD:
        packet = commands.BY_PACKET_TYPE.get(payload[_SPECIAL_TYPE_WORD])
        if packet is not None:
            # A user packet may have the same number as one of the arm.
            with contextlib.suppress(WireError):
                return commands.Call(packet.name, _parse_words(packet, payload))
    # 2. Any other command.
    return commands.Call(row.name, _parse_words(row, payload))


def _parse_words(row: commands.Command, payload: bytes) -> tuple[Any, ...]:
    """Return the arguments in the words of a request."""
    least, most = row.tcp_words
    count = len(payload) // _WORD_SIZE
    if len(payload) % _WORD_SIZE or not (row.any_length or least <= count <= most):
        raise WireError(f"{row.name} takes {least} to {most} words, not {len(payload)} bytes")
    words = struct.unpack(f">{count}i", payload)
    if row.tcp_request is None:
        return words
    try:
        return row.tcp_request.decode(words)
    except (WireError, ConstructError) as error:
        raise WireError(f"{row.name}: {summarize_error(error)}") from None


def encode_tcp_reply(row: commands.Command, reply: Reply, wire_state: WireState) -> bytes:
    """Return the bytes of a reply over TCP; an error reply has its own layout and type."""
    layout = shape.ERROR if reply.kind == "error" else row.tcp_reply
    payload = build_tcp_payload(layout, reply, wire_state)
    return build_frame(commands.REPLY_TYPES[layout], payload, wide=wire_state.wide, reply=True)


def decode_tcp_reply(row: commands.Command, frame: TcpFrame, wire_state: WireState) -> Reply:
    """Parse the reply to a command. Like old clients it looks at the frame's type only for an error."""
    layout = shape.ERROR if frame.type == commands.ERROR_TYPE else row.tcp_reply
    return parse_tcp_payload(layout, frame.payload, wire_state)


def build_tcp_payload(layout: TcpLayout, reply: Reply, wire_state: WireState) -> bytes:
    """Return the words of a reply; slots and stamps that it lacks are 0. Raises WireError if its values do not fit."""
    words: list[int] = [*reply.values] if layout.values != 0 else []
    try:
        # 1. Signed words.
        if layout.values not in (None, len(words)):
            raise WireError(f"{layout.values} words wanted, {len(words)} given")
        words += map(reply.slots.get, layout.slots, repeat(0))
        if layout.laser_width is not None:
            if reply.laser is None:
                words.append(0)
            else:
                layouts.check_laser(reply.laser, layout.laser_width(wire_state), "laser")
                words += reply.laser
        code = f"{len(words)}i"
        # 2. Stamps and clock, whose times are unsigned.
        for key in _stamp_keys(layout, wire_state):
            words += reply.stamps.get(key, NO_STAMP)
            code += _STAMP_CODE
        if layout.has_clock:
            words.append(reply.clock or 0)
            code += "I"
        # 3. Battery.
        if layout.has_volts:
            words += reply.volts or (0, 0)
            code += "2i"
        return _pack_words(code, words)
    except (WireError, ConstructError) as error:
        raise WireError(f"a {layout.kind} reply cannot carry this: {summarize_error(error)}") from None


def parse_tcp_payload(layout: TcpLayout, payload: bytes, wire_state: WireState) -> Reply:
    """Parse the words of a reply. Raises WireError if they do not have this layout."""
    count = len(payload) // _WORD_SIZE
    words = struct.unpack_from(f">{count}i", payload)
    stamps: dict[str, Stamp] = {}
    laser, clock, volts = None, None, None
    try:
        # 1. Signed words: plain ones, State slots, readings of the laser behind their number.
        at = count if layout.values is None else layout.values
        values = words[:at]
        slots = dict(zip(layout.slots, words[at:], strict=False))
        at += len(layout.slots)
        if layout.laser_width is not None:
            size = 1
            if words[at]:
                # The number is checked before it is multiplied: a corrupt one must not allocate memory.
                size += layouts.checked_readings(words[at], "laser") * layout.laser_width(wire_state)
            laser = words[at : at + size]
            at += size
        # 2. Stamps and clock, whose times are unsigned.
        for key in _stamp_keys(layout, wire_state):
            *pose, pose_time, sensor_time = words[at : at + len(NO_STAMP)]
            stamps[key] = Stamp._make((*pose, pose_time & _UNSIGNED_WORD, sensor_time & _UNSIGNED_WORD))
            at += len(NO_STAMP)
        if layout.has_clock:
            clock = words[at] & _UNSIGNED_WORD
            at += 1
        # 3. Battery.
        if layout.has_volts:
            volts = (words[at], words[at + 1])
            at += 2
    except ConstructError as error:
        raise WireError(f"no {layout.kind} reply of this shape: {summarize_error(error)}") from None
    except (IndexError, TypeError, ValueError):
        at = count + 1
    if at > count or len(payload) != at * _WORD_SIZE:
        raise WireError(f"no {layout.kind} reply of this shape: it has {len(payload)} bytes")
    return Reply(layout.kind, slots, laser, stamps, clock, volts, values)


def _stamp_keys(layout: TcpLayout, wire_state: WireState) -> Iterable[str]:
    """Return the names of the stamps in a reply: Smask[0] alone selects them, over TCP."""
    position = wire_state.mask.smask[0]
    return [key for bit in layout.stamps if position & bit for key in STAMP_KEYS[bit]] if position else ()


def _pack_words(code: str, words: Sequence[int]) -> bytes:
    try:
        return struct.pack(f">{code}", *words)
    except struct.error:
        # struct does not name the value that does not fit.
        wrong = [word for word in words if not isinstance(word, int) or not -(2**31) <= word < 2**31]
        raise WireError(f"a word is a whole number, -2^31 to 2^31 - 1, not {(wrong or [min(words)])[0]!r}") from None


def encode_serial_request(call: commands.Call, wire_state: WireState) -> bytes:
    """Return the bytes of a call on the serial line.

    Raises
    ------
    WireError
        If this model does not have the command, an argument is out of range or the frame is too long.
    """
    row = find_command(call.name)
    if row.line_type is None or not commands.exists_on_serial(row, wire_state.model):
        raise WireError(f"{call.name} does not exist on the line of a {wire_state.model.name}")
    if overflow := describe_serial_overflow(call):
        raise WireError(overflow)
    _check_argument_count(row, call.args)
    try:
        data = layouts.build(row.line_request, call.args)
    except (WireError, ConstructError, TypeError, OverflowError, ValueError) as error:
        raise WireError(f"{row.name}{call.args}: {summarize_error(error)}") from None
    frame = serial_framing.build_frame(row.line_type, data)
    if len(frame) > serial_framing.HOST_LIMIT:
        raise WireError(f"{call.name}: a host's frame has at most {serial_framing.HOST_LIMIT} bytes, not {len(frame)}")
    return frame


def decode_serial_request(frame: SerialFrame, wire_state: WireState) -> commands.Call:
    """Return the call of a host's frame. Raises WireError if this model does not have the command or the data."""
    row = commands.BY_LINE_TYPE.get(frame.type)
    if row is None or not commands.exists_on_serial(row, wire_state.model):
        raise WireError(f"type {frame.type} does not exist on the line of a {wire_state.model.name}")
    # Packets of the arm as over TCP.
    if row.name == "special_request" and len(frame.data) > _SPECIAL_TYPE_BYTE:
        packet = commands.BY_PACKET_TYPE.get(frame.data[_SPECIAL_TYPE_BYTE])
        if packet is not None:
            with contextlib.suppress(WireError):
                return _parse_line_data(packet, frame.data)
    return _parse_line_data(row, frame.data)


def _parse_line_data(row: commands.Command, data: bytes) -> commands.Call:
    # Most queries have neither data nor arguments.
    if not data and not row.arguments:
        return commands.Call(row.name)
    try:
        return commands.Call(row.name, tuple(layouts.parse(row.line_request, data)))
    except (ConstructError, WireError) as error:
        raise WireError(f"{row.name}: {summarize_error(error)}") from None


def encode_serial_reply(row: commands.Command, reply: Reply, wire_state: WireState) -> bytes:
    """Return the bytes of a robot's reply on the serial line; a NAK has its own type."""
    if reply.kind == "nak":
        return serial_framing.build_frame(commands.NAK_TYPE)
    if row.line_type is None:
        raise WireError(f"{row.name} does not exist on a robot's own line")
    return serial_framing.build_frame(row.line_type, row.line_reply.build(reply, wire_state))


def decode_serial_reply(frame: SerialFrame, wire_state: WireState) -> Reply:
    """Parse a robot's reply; the frame's type is that of the command. Raises WireError if it fits no layout."""
    if frame.type == commands.NAK_TYPE:
        return shape.LINE_NAK.parse(frame.data, wire_state)
    row = commands.BY_LINE_TYPE.get(frame.type)
    if row is None or not commands.exists_on_serial(row, wire_state.model):
        raise WireError(f"no answer of type {frame.type} comes from a {wire_state.model.name}")
    return row.line_reply.parse(frame.data, wire_state)


def _check_argument_count(row: commands.Command, args: tuple[Any, ...]) -> None:
    # Checked here, for an error that names them; values by the layout.
    if not row.any_length and len(row.arguments) != len(args):
        names = ", ".join(argument.name for argument in row.arguments) or "nothing"
        raise WireError(f"{row.name} takes {len(row.arguments)} numbers ({names}), got {len(args)}")
