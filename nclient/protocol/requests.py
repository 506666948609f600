"""Layouts of request arguments: one flat tuple of arguments to words over TCP or bytes on the serial line, and back.

    arguments    integers in the order of the C call, arrays flattened; the text of tk is the only string
    over TCP     one word per argument, for a few commands other words (TcpArguments)
    Fields       the usual layout on the serial line: one field per argument, as constructs

Values out of range raise construct's errors or WireError. `parse` and `build` replace construct's own, which create a
context per call that refers to itself and stays in memory until the garbage collector runs; here all calls share two.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence as Arguments
from io import BytesIO
from typing import Any, Final, Protocol

from construct import (
    Adapter,
    Const,
    Construct,
    Default,
    ExprAdapter,
    FormatFieldError,
    GreedyBytes,
    Int16ul,
    Int32sl,
    Int32ul,
    NullTerminated,
    Rebuild,
    Sequence,
    Struct,
    Terminated,
    len_,
    this,
)

from nclient.errors import WireError
from nclient.protocol.fields import LINE_BYTE, LINE_UNSIGNED
from nclient.protocol.types import Mask, mask_from_line, mask_from_tcp


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
        super().__init__(Sequence(*fields, Terminated))

    def _decode(self, obj: Arguments[Any], context: Any, path: str) -> tuple[Any, ...]:
        return tuple(obj[:-1])

    def _encode(self, obj: Arguments[Any], context: Any, path: str) -> list[Any]:
        return [*obj, None]


class TcpArguments(Protocol):
    """Arguments of a command that are not sent as one word each over TCP. Both methods may raise WireError."""

    def decode(self, words: Arguments[int]) -> tuple[Any, ...]:
        """Return the arguments in these words."""

    def encode(self, args: Arguments[Any]) -> Arguments[int]:
        """Return the words of these arguments."""


class FlagWords:
    """Request data of ws over TCP: flags are 0 or 1, other words any number."""

    def __init__(self, are_flags: Arguments[bool]) -> None:
        self._are_flags = are_flags

    def decode(self, words: Arguments[int]) -> tuple[int, ...]:
        """Return the arguments in these words."""
        return tuple(int(bool(word)) if flag else word for word, flag in zip(words, self._are_flags, strict=True))

    encode = decode


class TcpMask:
    """Request data of ct over TCP: the 44 numbers of Smask as seven bytes, one per word."""

    def decode(self, words: Arguments[int]) -> tuple[int, ...]:
        """Return the 44 numbers."""
        return mask_from_tcp(words).smask

    def encode(self, args: Arguments[int]) -> tuple[int, ...]:
        """Return the seven words."""
        return Mask(tuple(args)).tcp_bytes()


class LineMask(Adapter):
    """Request data of ct on the serial line: the 44 numbers of Smask as seven bytes."""

    def __init__(self) -> None:
        super().__init__(Fields(*[LINE_BYTE] * 7))

    def _decode(self, obj: Arguments[int], context: Any, path: str) -> tuple[int, ...]:
        return mask_from_line(obj).smask

    def _encode(self, obj: Arguments[int], context: Any, path: str) -> list[int]:
        return list(Mask(tuple(obj)).line_bytes())


class TextWords:
    """Request data of tk over TCP: the C string laid into little-endian words, each then sent big-endian.

    Every group of four characters arrives reversed; bytes after the NUL are undefined. "hello" is
    `6c 6c 65 68 | .. .. 00 6f`.
    """

    def decode(self, words: Arguments[int]) -> tuple[str]:
        """Return the text."""
        text, _, _ = struct.pack(f"<{len(words)}i", *words).partition(b"\0")
        return (text.decode("latin-1"),)

    def encode(self, args: Arguments[str]) -> tuple[int, ...]:
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
        super().__init__(NullTerminated(GreedyBytes))

    def _decode(self, obj: bytes, context: Any, path: str) -> tuple[str]:
        return (obj.decode("latin-1"),)

    def _encode(self, obj: tuple[str], context: Any, path: str) -> bytes:
        return _encode_latin1(obj[0])


class ObstacleWords:
    """Obstacle over TCP: n, x1, y1 .. xn, yn, and `tail` numbers more (the shift of move_obstacle)."""

    def __init__(self, tail: int = 0) -> None:
        self.tail = tail

    def decode(self, words: Arguments[int]) -> tuple[int, ...]:
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

    def decode(self, words: Arguments[int]) -> tuple[float, ...]:
        """Return type and numbers of the C call."""
        kind = self._kind(words)
        if len(words) != 1 + max(self._COUNTS):
            raise WireError(f"motion_check takes {1 + max(self._COUNTS)} words, not {len(words)}")
        numbers = enumerate(words[1 : 1 + self._COUNTS[kind]])
        return (kind, *(_whole_if_exact(word / 1000) if k in self._ANGLES[kind] else 10 * word for k, word in numbers))

    def encode(self, args: Arguments[float]) -> tuple[int, ...]:
        """Return the eight words."""
        kind = self._kind(args)
        count = self._COUNTS[kind]
        if len(args) != 1 + count:
            raise WireError(f"motion_check {kind} takes {count} numbers after the type")
        words = [
            int(round(v * 1000, _ROUNDING_DIGITS)) if k in self._ANGLES[kind] else int(v / 10)
            for k, v in enumerate(args[1:])
        ]
        return (kind, *words, *[0] * (7 - count))

    @staticmethod
    def _kind(numbers: Arguments[float]) -> int:
        if not numbers or numbers[0] not in (MOTION_LINE, MOTION_ARC):
            raise WireError("motion_check takes type 0 (line) or 1 (arc) first")
        return int(numbers[0])


class UserPacket(Adapter):
    """User packet of special_request: uint16 length (its own four bytes included), serial 0, packet type, bytes.

    The arguments are (packet type, bytes...).
    """

    def __init__(self) -> None:
        super().__init__(
            Struct(
                "length" / Rebuild(Int16ul, len_(this.data) + 4),
                "serial" / Default(LINE_BYTE, 0),
                "packet_type" / LINE_BYTE,
                "data" / GreedyBytes,
            )
        )

    def _decode(self, obj: Any, context: Any, path: str) -> tuple[int, ...]:
        if obj.length != len(obj.data) + 4:
            raise FormatFieldError(f"a packet of {len(obj.data) + 4} bytes says it has {obj.length}", path=path)
        return (obj.packet_type, *obj.data)

    def _encode(self, obj: Arguments[int], context: Any, path: str) -> dict[str, Any]:
        if not obj or len(obj) > 1 + MAX_PACKET_DATA or not all(0 <= byte <= 255 for byte in obj):
            raise FormatFieldError(
                f"a special packet is its type and at most {MAX_PACKET_DATA} bytes 0..255", path=path)
        return {"packet_type": obj[0], "data": bytes(obj[1:])}


class ArmPacket(Adapter):
    """Packet of an arm command: the header of UserPacket with a fixed type, then the fields."""

    def __init__(self, packet_type: int, *elements: Construct) -> None:
        size = 4 + sum(element.sizeof() for element in elements)
        head = (Const(size, Int16ul), LINE_BYTE, Const(packet_type, LINE_BYTE))
        super().__init__(Fields(*head, *elements))
        self.octets = size
        self.elements = elements

    def _decode(self, obj: Arguments[int], context: Any, path: str) -> tuple[int, ...]:
        return tuple(obj[3:])

    def _encode(self, obj: Arguments[int], context: Any, path: str) -> list[int | None]:
        return [None, 0, None, *obj]


class ByteWords:
    """A packet over TCP: one byte per word."""

    def __init__(self, packet: Construct) -> None:
        self.packet = packet

    def decode(self, words: Arguments[int]) -> tuple[int, ...]:
        """Return the arguments in the packet."""
        return tuple(parse(self.packet, bytes(word & 255 for word in words)))

    def encode(self, args: Arguments[int]) -> tuple[int, ...]:
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
