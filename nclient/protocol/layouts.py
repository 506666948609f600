"""Layouts of messages: the classes of construct that they are made of, and the arguments of each request.

Construct classes that messages on the serial line are made of (over TCP there are only words: codec.py).

    low byte first; signed numbers are sign-magnitude (top bit = minus): -50 is 32 80, -0 reads as 0

A class parses to one part of a Reply: State slots {number: value}, stamps {name: Stamp}, a laser vector (n, values...),
or plain values. Classes that depend on mask or model read them from the WireState in the context
(`wire_state=` of parse and build). Missing bytes raise construct's StreamError.

Numbers are packed as runs (class Run): one call of struct per run instead of one per number makes state packets ten
times as fast.

Layouts of request arguments: one flat tuple of arguments to words over TCP or bytes on the serial line, and back.

    arguments    integers in the order of the C call, arrays flattened; the text of tk is the only string
    over TCP     one word per argument, for a few commands other words (TcpArguments)
    Fields       the usual layout on the serial line: one field per argument, as constructs

Values out of range raise construct's errors or WireError. `parse` and `build` replace construct's own, which create a
context per call that refers to itself and stays in memory until the garbage collector runs; here all calls share two.
"""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Any, Final, Literal, Protocol

import construct
from construct import Adapter, Construct, ExprAdapter, FormatFieldError, GreedyBytes, Int16ul, Int32sl, Int32ul

from nclient.errors import WireError
from nclient.protocol.types import NO_STAMP, STAMP_KEYS, Mask, Position, Stamp, WireState, mask_from_line, mask_from_tcp

MAX_LASER_READINGS = 482
"""Number of columns of the laser, and so the maximum number of readings in a reply."""


class Masked(Construct):
    """A field that some masks exclude completely."""

    @abstractmethod
    def is_absent(self, mask: Mask) -> bool:
        """Return True if the mask excludes all of it."""


def wire_state_of(context: Any) -> WireState:
    """Return the WireState of a construct context."""
    wire_state: WireState = context._params.wire_state
    return wire_state


def take(stream: Any, count: int, path: str) -> bytes:
    """Read `count` bytes; StreamError if there are fewer."""
    data: bytes = stream.read(count)
    if len(data) != count:
        raise construct.StreamError(f"{count} bytes wanted, {len(data)} there", path=path)
    return data


def checked_readings(count: int, path: str) -> int:
    """Return a count of laser readings; StreamError if it is out of range."""
    if not 0 <= count <= MAX_LASER_READINGS:
        raise construct.StreamError(f"a laser sends 0..{MAX_LASER_READINGS} readings, not {count}", path=path)
    return count


def check_laser(laser: Sequence[int], width: int, path: str) -> None:
    """Raise FormatFieldError if a laser vector's length does not match its count."""
    if len(laser) != 1 + width * checked_readings(laser[0], path):
        raise FormatFieldError(f"a laser vector of {laser[0]} readings has {width * laser[0]} numbers after the count, "
                               f"not {len(laser) - 1}", path=path)


class Run:
    """Packing of consecutive numbers of the same size, low byte first.

    Parameters
    ----------
    code
        Format character of struct.
    signed
        True for sign-magnitude numbers.
    """

    def __init__(self, code: str, signed: bool = False) -> None:
        self.octets: Final = struct.calcsize(f"<{code}")
        # The top bit is the sign; 0 switches sign-magnitude off.
        self.sign: Final = 1 << (8 * self.octets - 1) if signed else 0
        self._code: Final = code

    def pack(self, numbers: Sequence[int]) -> bytes:
        """Return the bytes of these numbers. Raises ValueError if one does not fit."""
        if self.sign:
            numbers = [number if 0 <= number < self.sign else self._magnitude(number) for number in numbers]
        try:
            return struct.pack(f"<{len(numbers)}{self._code}", *numbers)
        except struct.error as error:
            raise ValueError(f"{list(numbers)} in {self.octets} bytes each: {error}") from None

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """Return the numbers in these bytes, whose length must be a multiple of the size."""
        numbers = struct.unpack(f"<{len(data) // self.octets}{self._code}", data)
        if not self.sign:
            return numbers
        # Top bit set: the rest is the magnitude. 0x8000 is -0 and reads as 0.
        return tuple(number if number < self.sign else self.sign - number for number in numbers)

    def _magnitude(self, number: int) -> int:
        # The magnitude has one bit less than the field.
        if abs(number) >= self.sign:
            raise ValueError(f"{number} does not fit sign-magnitude below {self.sign}")
        return self.sign - number


BYTES: Final = Run("B")
SHORTS: Final = Run("H")
LONGS: Final = Run("I")
SIGNED_SHORTS: Final = Run("H", signed=True)
SIGNED_LONGS: Final = Run("I", signed=True)


# Single fields of the serial line, low byte first; clocks are unsigned ms.
LINE_BYTE = construct.Int8ub
LINE_UNSIGNED = Int16ul
LINE_CLOCK = Int32ul


class Number(Construct):
    """A single number, packed as a run of one."""

    def __init__(self, run: Run) -> None:
        super().__init__()
        self.run = run

    def _parse(self, stream: Any, context: Any, path: str) -> int:
        return self.run.unpack(take(stream, self.run.octets, path))[0]

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        stream.write(_packed(self.run, (obj,), path))
        return obj


LINE_SIGNED = Number(SIGNED_SHORTS)
LINE_LONG = Number(SIGNED_LONGS)


class _MaskedSlots(Masked):
    """State slots on the robot's own line; only those in the mask where `masked`."""

    def __init__(self, first: int, last: int, masked: bool = True) -> None:
        super().__init__()
        self.slots: Sequence[int] = range(first, last + 1)
        self.masked = masked
        self._chosen: tuple[Mask | None, Sequence[int]] = (None, ())

    def is_absent(self, mask: Mask) -> bool:
        return self.masked and not any(map(mask.has, self.slots))

    def _selected(self, context: Any) -> Sequence[int]:
        """Return the selected slots, cached for the last mask since masks rarely change."""
        if not self.masked:
            return self.slots
        # Compared by identity: a changed mask is a new object.
        mask, slots = wire_state_of(context).mask, self.slots
        chosen = self._chosen
        if chosen[0] is not mask:
            chosen = self._chosen = (mask, [slot for slot in slots if mask.has(slot)])
        return chosen[1]


class LineSlots(_MaskedSlots):
    """State slots on the serial line as a run of numbers; with `masked` only those that the mask selects."""

    def __init__(self, first: int, last: int, run: Run, masked: bool = True) -> None:
        super().__init__(first, last, masked)
        self.run = run

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        slots = self._selected(context)
        return dict(zip(slots, self.run.unpack(take(stream, self.run.octets * len(slots), path)), strict=True))

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        stream.write(_packed(self.run, [obj.get(slot, 0) for slot in self._selected(context)], path))
        return obj


class LineNibbles(_MaskedSlots):
    """Infrared readings on the serial line: four bits each, low half first, padded with 0 to a byte."""

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        slots = self._selected(context)
        # Two readings per byte, the first in the low half.
        data = take(stream, (len(slots) + 1) // 2, path)
        return {slot: data[k // 2] >> 4 * (k % 2) & 15 for k, slot in enumerate(slots)}

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        values = [obj.get(slot, 0) & 15 for slot in self._selected(context)]
        values += [0] * (len(values) % 2)
        stream.write(bytes(low | high << 4 for low, high in zip(values[::2], values[1::2], strict=True)))
        return obj


class BumperBytes(_MaskedSlots):
    """Three bumper bytes on the serial line as one number, in the model's byte order."""

    def __init__(self, slot: int, masked: bool = True) -> None:
        super().__init__(slot, slot, masked)

    def _parse(self, stream: Any, context: Any, path: str) -> dict[int, int]:
        order = _bumper_order(context)
        return {slot: int.from_bytes(take(stream, 3, path), order) for slot in self._selected(context)}

    def _build(self, obj: Mapping[int, int], stream: Any, context: Any, path: str) -> Mapping[int, int]:
        for slot in self._selected(context):
            stream.write((obj.get(slot, 0) & 0xFFFFFF).to_bytes(3, _bumper_order(context)))
        return obj


class LineStamps(Masked):
    """Stamps on the serial line of one kind of sensor, if its bit is set in Smask[0]: 7 int32 and 2 uint32 each.

    In a state packet only the sensors that the mask selects have stamps (`slots`: their State slots); the reply to a
    get_ command has all of them.
    """

    def __init__(self, wanted: Position, slots: Sequence[int] = ()) -> None:
        super().__init__()
        self.keys = STAMP_KEYS[wanted]
        self.wanted = int(wanted)
        self.slots = slots

    def is_absent(self, mask: Mask) -> bool:
        """Return True if the mask selects no stamped sensor."""
        return not self._selected(mask)

    def _selected(self, mask: Mask) -> list[str]:
        # Two conditions: the kind has stamps, and the sensor is in the mask.
        if not mask.position & self.wanted:
            return []
        if not self.slots:
            return list(self.keys)
        return [key for key, slot in zip(self.keys, self.slots, strict=True) if mask.has(slot)]

    def _parse(self, stream: Any, context: Any, path: str) -> dict[str, Stamp]:
        return {
            key: Stamp._make(
                # 7 x 4 bytes of pose and velocities, 2 x 4 bytes of times in ms.
                SIGNED_LONGS.unpack(take(stream, 28, path)) + LONGS.unpack(take(stream, 8, path))
            )
            for key in self._selected(wire_state_of(context).mask)
        }

    def _build(self, obj: Mapping[str, Stamp], stream: Any, context: Any, path: str) -> Mapping[str, Stamp]:
        for key in self._selected(wire_state_of(context).mask):
            stamp = obj.get(key, NO_STAMP)
            stream.write(_packed(SIGNED_LONGS, stamp[:7], path) + _packed(LONGS, stamp[7:], path))
        return obj


class LineLaser(Masked):
    """Laser block on the serial line: count, then `width` signed numbers or one pixel per reading.

    `masked_by` is the State slot whose mask bit includes the block; None: always included.
    """

    def __init__(self, width: Callable[[WireState], int], masked_by: int | None = None) -> None:
        super().__init__()
        self.width = width
        self.masked_by = masked_by

    def is_absent(self, mask: Mask) -> bool:
        """Return True if the field is masked and the mask switches it off."""
        return self.masked_by is not None and not mask.has(self.masked_by)

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...] | None:
        wire_state = wire_state_of(context)
        if self.is_absent(wire_state.mask):
            return None
        count = checked_readings(SHORTS.unpack(take(stream, 2, path))[0], path)
        width = self.width(wire_state)
        run = SHORTS if width == 1 else SIGNED_SHORTS
        return (count, *run.unpack(take(stream, 2 * count * width, path)))

    def _build(self, obj: Sequence[int] | None, stream: Any, context: Any, path: str) -> Any:
        wire_state = wire_state_of(context)
        if self.is_absent(wire_state.mask):
            return obj
        laser = obj or (0,)
        width = self.width(wire_state)
        check_laser(laser, width, path)
        run = SHORTS if width == 1 else SIGNED_SHORTS
        stream.write(_packed(SHORTS, laser[:1], path) + _packed(run, laser[1:], path))
        return obj


class LineRun(Construct):
    """A fixed number of numbers on the serial line."""

    def __init__(self, count: int, run: Run) -> None:
        super().__init__()
        self.count = count
        self.run = run

    def _parse(self, stream: Any, context: Any, path: str) -> tuple[int, ...]:
        return self.run.unpack(take(stream, self.count * self.run.octets, path))

    def _build(self, obj: Sequence[int], stream: Any, context: Any, path: str) -> Sequence[int]:
        if len(obj) != self.count:
            raise FormatFieldError(f"{self.count} numbers wanted, {len(obj)} given", path=path)
        stream.write(_packed(self.run, obj, path))
        return obj


def _packed(run: Run, numbers: Sequence[int], path: str) -> bytes:
    try:
        return run.pack(numbers)
    except (ValueError, TypeError) as error:
        raise FormatFieldError(str(error), path=path) from None


def _bumper_order(context: Any) -> Literal["little", "big"]:
    return "little" if wire_state_of(context).model.bumpers_low_first else "big"


class _Context:
    """Immutable construct context: the direction, and itself as root and parameters."""

    __slots__ = ("_building", "_parsing")
    _sizing = False

    def __init__(self, *, parsing: bool) -> None:
        self._parsing = parsing
        self._building = not parsing

    @property
    def _params(self) -> _Context:
        return self

    def get(self, name: str, default: object = None) -> object:
        """Return the value of a key; the context holds only `_root`."""
        return self if name == "_root" else default


_PARSING: Final = _Context(parsing=True)
_BUILDING: Final = _Context(parsing=False)


def parse(layout: Construct, data: bytes) -> Any:
    """Parse bytes with a layout. Raises ConstructError."""
    return layout._parse(BytesIO(data), _PARSING, "(parsing)")


def build(layout: Construct, value: Any) -> bytes:
    """Return the bytes of a value in a layout. Raises ConstructError."""
    stream = BytesIO()
    layout._build(value, stream, _BUILDING, "(building)")
    return stream.getvalue()


MAX_OBSTACLE_VERTICES = 10
MAX_TEXT_WORDS = 64
MAX_PACKET_DATA = 250
"""Maximum bytes of user data in a special packet: a host's serial frame has less than 256 bytes."""
MOTION_LINE, MOTION_ARC = 0, 1
# Laser mode 51 (points) is sent as 35 on the serial line, a history above 10 as 10 (docs/protocol.md, Laser).
_POINT_LASER, _SERIAL_POINT_LASER = 51, 35
_MAX_HISTORY = 10
_ROUNDING_DIGITS = 6
"""Digits to round to before truncation: 1.001 x 1000 is 1000.9999999999999 in doubles, and means 1001."""

FLAG_BYTE = ExprAdapter(LINE_BYTE, lambda obj, _: int(bool(obj)), lambda obj, _: int(bool(obj)))
HISTORY_BYTE = ExprAdapter(LINE_BYTE, lambda obj, _: obj, lambda obj, _: min(obj, _MAX_HISTORY))
LASER_MODE_BYTE = ExprAdapter(
    LINE_BYTE,
    lambda obj, _: _POINT_LASER if obj == _SERIAL_POINT_LASER else obj,
    lambda obj, _: _SERIAL_POINT_LASER if obj == _POINT_LASER else obj,
)
"""Laser mode on the serial line."""


class Fields(Adapter):
    """Fields one after another, and nothing behind them."""

    def __init__(self, *fields: Construct) -> None:
        super().__init__(construct.Sequence(*fields, construct.Terminated))

    def _decode(self, obj: Sequence[Any], context: Any, path: str) -> tuple[Any, ...]:
        return tuple(obj[:-1])

    def _encode(self, obj: Sequence[Any], context: Any, path: str) -> list[Any]:
        return [*obj, None]


class TcpArguments(Protocol):
    """Arguments of a command that are not sent as one word each over TCP. Both methods may raise WireError."""

    def decode(self, words: Sequence[int]) -> tuple[Any, ...]:
        """Return the arguments in these words."""

    def encode(self, args: Sequence[Any]) -> Sequence[int]:
        """Return the words of these arguments."""


class FlagWords:
    """Request data of ws over TCP: flags are 0 or 1, other words any number."""

    def __init__(self, are_flags: Sequence[bool]) -> None:
        self._are_flags = are_flags

    def decode(self, words: Sequence[int]) -> tuple[int, ...]:
        """Return the arguments in these words."""
        return tuple(int(bool(word)) if flag else word for word, flag in zip(words, self._are_flags, strict=True))

    encode = decode


class TcpMask:
    """Request data of ct over TCP: the 44 numbers of Smask as seven bytes, one per word."""

    def decode(self, words: Sequence[int]) -> tuple[int, ...]:
        """Return the 44 numbers."""
        return mask_from_tcp(words).smask

    def encode(self, args: Sequence[int]) -> tuple[int, ...]:
        """Return the seven words."""
        return Mask(tuple(args)).tcp_bytes()


class LineMask(Adapter):
    """Request data of ct on the serial line: the 44 numbers of Smask as seven bytes."""

    def __init__(self) -> None:
        super().__init__(Fields(*[LINE_BYTE] * 7))

    def _decode(self, obj: Sequence[int], context: Any, path: str) -> tuple[int, ...]:
        return mask_from_line(obj).smask

    def _encode(self, obj: Sequence[int], context: Any, path: str) -> list[int]:
        return list(Mask(tuple(obj)).line_bytes())


class TextWords:
    """Request data of tk over TCP: the C string laid into little-endian words, each then sent big-endian.

    Every group of four characters arrives reversed; bytes after the NUL are undefined. "hello" is
    `6c 6c 65 68 | .. .. 00 6f`.
    """

    def decode(self, words: Sequence[int]) -> tuple[str]:
        """Return the text."""
        text, _, _ = struct.pack(f"<{len(words)}i", *words).partition(b"\0")
        return (text.decode("latin-1"),)

    def encode(self, args: Sequence[str]) -> tuple[int, ...]:
        """Return the words of the text and its NUL."""
        text = _encode_latin1(args[0])
        # Room for the NUL: (length + 4) / 4 words, as the C client counts.
        count = (len(text) + 4) // 4
        if count > MAX_TEXT_WORDS:
            raise WireError(f"a text has at most {4 * MAX_TEXT_WORDS - 1} characters")
        return struct.unpack(f"<{count}i", text.ljust(4 * count, b"\0"))


class LineText(Adapter):
    """Request data of tk on the serial line: the characters and a NUL."""

    def __init__(self) -> None:
        super().__init__(construct.NullTerminated(GreedyBytes))

    def _decode(self, obj: bytes, context: Any, path: str) -> tuple[str]:
        return (obj.decode("latin-1"),)

    def _encode(self, obj: tuple[str], context: Any, path: str) -> bytes:
        return _encode_latin1(obj[0])


class ObstacleWords:
    """Obstacle over TCP: n, x1, y1 .. xn, yn, and `tail` numbers more (the shift of move_obstacle)."""

    def __init__(self, tail: int = 0) -> None:
        self.tail = tail

    def decode(self, words: Sequence[int]) -> tuple[int, ...]:
        """Return the same numbers after checking their count."""
        if not words or not 1 <= words[0] <= MAX_OBSTACLE_VERTICES or len(words) != 1 + 2 * words[0] + self.tail:
            raise WireError(
                f"an obstacle is n = 1..{MAX_OBSTACLE_VERTICES}, then n vertices x, y"
                + (", then the shift dx, dy" if self.tail else "")
            )
        return tuple(words)

    encode = decode


class MotionWords:
    """Request data of motion_check over TCP: eight words. Arguments are the C call's doubles in thousandths.

    Lengths are sent as hundredths and angles as millionths of a radian, truncated toward zero; the three words
    that a line does not use are sent as 0 and ignored.
    """

    # Numbers after the type, and the places of angles among them, by type: line, arc.
    _COUNTS = (4, 7)
    _ANGLES = (frozenset[int](), frozenset({2, 3}))

    def decode(self, words: Sequence[int]) -> tuple[float, ...]:
        """Return type and numbers of the C call."""
        kind = self._kind(words)
        if len(words) != 1 + max(self._COUNTS):
            raise WireError(f"motion_check takes {1 + max(self._COUNTS)} words, not {len(words)}")
        numbers = enumerate(words[1 : 1 + self._COUNTS[kind]])
        return (kind, *(_whole_if_exact(word / 1000) if k in self._ANGLES[kind] else 10 * word for k, word in numbers))

    def encode(self, args: Sequence[float]) -> tuple[int, ...]:
        """Return the eight words."""
        kind = self._kind(args)
        count = self._COUNTS[kind]
        if len(args) != 1 + count:
            raise WireError(f"motion_check {kind} takes {count} numbers after the type")
        words = [int(round(v * 1000, _ROUNDING_DIGITS)) if k in self._ANGLES[kind] else int(v / 10)
                 for k, v in enumerate(args[1:])]
        return (kind, *words, *[0] * (7 - count))

    @staticmethod
    def _kind(numbers: Sequence[float]) -> int:
        if not numbers or numbers[0] not in (MOTION_LINE, MOTION_ARC):
            raise WireError("motion_check takes type 0 (line) or 1 (arc) first")
        return int(numbers[0])


class UserPacket(Adapter):
    """User packet of special_request: uint16 length (its own four bytes included), serial 0, packet type, bytes.

    The arguments are (packet type, bytes...).
    """

    def __init__(self) -> None:
        super().__init__(
            construct.Struct(
                "length" / construct.Rebuild(Int16ul, construct.len_(construct.this.data) + 4),
                "serial" / construct.Default(LINE_BYTE, 0),
                "packet_type" / LINE_BYTE,
                "data" / GreedyBytes,
            )
        )

    def _decode(self, obj: Any, context: Any, path: str) -> tuple[int, ...]:
        if obj.length != len(obj.data) + 4:
            raise FormatFieldError(f"a packet of {len(obj.data) + 4} bytes says it has {obj.length}", path=path)
        return (obj.packet_type, *obj.data)

    def _encode(self, obj: Sequence[int], context: Any, path: str) -> dict[str, Any]:
        if not obj or len(obj) > 1 + MAX_PACKET_DATA or not all(0 <= byte <= 255 for byte in obj):
            raise FormatFieldError(
                f"a special packet is its type and at most {MAX_PACKET_DATA} bytes 0..255", path=path)
        return {"packet_type": obj[0], "data": bytes(obj[1:])}


class ArmPacket(Adapter):
    """Packet of an arm command: the header of UserPacket with a fixed type, then the fields."""

    def __init__(self, packet_type: int, *elements: Construct) -> None:
        size = 4 + sum(element.sizeof() for element in elements)
        head = (construct.Const(size, Int16ul), LINE_BYTE, construct.Const(packet_type, LINE_BYTE))
        super().__init__(Fields(*head, *elements))
        self.elements = elements
        self.octets = size

    def _decode(self, obj: Sequence[int], context: Any, path: str) -> tuple[int, ...]:
        return tuple(obj[3:])

    def _encode(self, obj: Sequence[int], context: Any, path: str) -> list[int | None]:
        return [None, 0, None, *obj]


class ByteWords:
    """A packet over TCP: one byte per word."""

    def __init__(self, packet: Construct) -> None:
        self.packet = packet

    def decode(self, words: Sequence[int]) -> tuple[int, ...]:
        """Return the arguments in the packet."""
        return tuple(parse(self.packet, bytes(word & 255 for word in words)))

    def encode(self, args: Sequence[int]) -> tuple[int, ...]:
        """Return the bytes of the packet."""
        return tuple(build(self.packet, args))


# The arm's packets: 40 zero [uint16 override], 41 wait [uint16 lift, uint16 grip, uint32 timeout],
# 42 move [4 x uint32: lift mode, value, grip mode, value].
ARM_ZERO = ArmPacket(40, LINE_UNSIGNED)
ARM_WAIT = ArmPacket(41, LINE_UNSIGNED, LINE_UNSIGNED, Int32ul)
ARM_NUMBER = ExprAdapter(Int32sl, lambda obj, _: obj, lambda obj, _: obj - 2**32 if 2**31 <= obj < 2**32 else obj)
"""A uint32 that old programs pass as a signed number: both forms can be written, the signed one is read."""
ARM_MOVE = ArmPacket(42, *[ARM_NUMBER] * 4)


def _encode_latin1(text: Any) -> bytes:
    if not isinstance(text, str):
        raise WireError(f"a text is wanted, not {text!r}")
    try:
        return text.encode("latin-1").split(b"\0")[0]
    except UnicodeEncodeError:
        raise WireError(f"the robot's texts are Latin-1; {text!r} is not") from None


def _whole_if_exact(value: float) -> float:
    return int(value) if value == int(value) else value
