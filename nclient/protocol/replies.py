"""Replies: their values, and the layout of each kind of reply over TCP and on the serial line.

    Reply       the values: State slots, laser vector, stamps, clock, battery bytes, or plain numbers
    TcpLayout   a layout over TCP: which parts of the Reply are sent, as 32-bit words (codec.py reads and writes them)
    LineLayout  a layout on the serial line: named constructs that parse bytes to a Reply and build them from it

A member of a LineLayout is named after the part of the Reply that it holds: slots*, stamps*, laser, clock, volts,
values. Mask and laser mode of the connection come in as WireState.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from construct import Construct, ConstructError, GreedyRange, Int8ub

from nclient.errors import WireError
from nclient.protocol import layouts, types
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, LINES, Mask, Position, Stamp, WireState, line_laser_width

MOTOR_SLOT = 41
LAST_TCP_SLOT = 44
MAX_TEXT_BYTES: Final = 200


_NOTHING: Final[Mapping[Any, Any]] = MappingProxyType({})


class Reply(NamedTuple):
    """Values of one reply, in wire units.

    Attributes
    ----------
    kind
        state, sonar, simple, error, nak, ...
    slots
        State slots that the reply carries, by number.
    laser
        Laser vector (n, values...).
    stamps
        Position stamps by name: ir_0 to ir_15, sonar_0 to sonar_15, bumper, laser, compass.
    clock
        Robot's clock in milliseconds.
    volts
        Raw battery bytes (CPU, motors).
    values
        Numbers of every other kind of reply.
    """

    kind: str
    slots: Mapping[int, int] = _NOTHING
    laser: tuple[int, ...] | None = None
    stamps: Mapping[str, Stamp] = _NOTHING
    clock: int | None = None
    volts: tuple[int, int] | None = None
    values: tuple[int, ...] = ()


def text_values(text: str) -> tuple[int, ...]:
    """Return a text as the values of a reply: the number of its bytes in UTF-8, then the bytes."""
    coded = text.encode()[:MAX_TEXT_BYTES]
    return (len(coded), *coded)


def text_of(values: Sequence[int]) -> str:
    """Return the text of such values; what is no text is left out."""
    return bytes(value & 0xFF for value in values[1:]).decode(errors="ignore")


@dataclass(frozen=True, slots=True, eq=False)
class TcpLayout:
    """Layout of a reply over TCP: these parts of a Reply, in this order, as big-endian words of 32 bits.

    Attributes
    ----------
    kind
        Of the Reply.
    values
        Number of plain words, None for any number.
    slots
        State slots, one word each.
    laser_width
        Words per laser reading behind the count of readings; None: no laser block.
    stamps
        Sensors whose stamps of nine words are sent, if their bit is set in Smask[0].
    has_clock, has_volts
        True if the clock (unsigned) and the two battery bytes follow.
    """

    kind: str
    values: int | None = 0
    slots: Sequence[int] = ()
    laser_width: Callable[[WireState], int] | None = None
    stamps: tuple[Position, ...] = ()
    has_clock: bool = False
    has_volts: bool = False


class _Context:
    """Construct context of a reply's members: holds the WireState where a Struct would have its parameters."""

    def __init__(self, wire_state: WireState) -> None:
        self.wire_state = wire_state

    @property
    def _params(self) -> _Context:
        # A property, because an attribute that refers to its own object would need the garbage collector.
        return self


class _Member(NamedTuple):
    """A named part of a reply with its parse and build functions."""

    name: str
    part: str
    parse: Callable[..., Any]
    build: Callable[..., Any]
    is_absent: Callable[[Mask], bool] | None


def _member(name: str, subcon: Construct) -> _Member:
    is_absent = subcon.is_absent if isinstance(subcon, layouts.Masked) else None
    return _Member(name, name.partition("_")[0], subcon._parse, subcon._build, is_absent)


class LineLayout:
    """Layout of a reply on the serial line: its kind, and named constructs in the order of their bytes.

    Replaces a construct Struct, which takes three times as long: every reply of a robot's line passes through here.
    Members that the mask excludes (`Masked.is_absent`) are skipped.
    """

    def __init__(self, kind: str, **members: Any) -> None:
        self.kind = kind
        self.layout: Mapping[str, Any] = members
        """Constructs of the members by name, in order."""
        self._members = [_member(name, subcon) for name, subcon in members.items()]
        self._masked = any(member.is_absent is not None for member in self._members)
        self._present: tuple[Mask | None, list[_Member]] = (None, [])

    def _present_members(self, mask: Mask) -> list[_Member]:
        """Return the members that the mask includes, cached for the last mask since masks rarely change."""
        if not self._masked:
            return self._members
        present = self._present
        if present[0] is not mask:
            members = [member for member in self._members if member.is_absent is None or not member.is_absent(mask)]
            present = self._present = (mask, members)
        return present[1]

    def parse(self, data: bytes, wire_state: WireState) -> Reply:
        """Parse a reply. Raises WireError if the bytes do not have this layout."""
        slots: dict[int, int] = {}
        stamps: dict[str, Stamp] = {}
        found: dict[str, Any] = {"slots": slots, "stamps": stamps}
        stream, context = BytesIO(data), _Context(wire_state)
        try:
            for name, part, parse, _, _ in self._present_members(wire_state.mask):
                value = parse(stream, context, name)
                if part in ("slots", "stamps"):
                    found[part].update(value)
                else:
                    found[name] = value
        except ConstructError as error:
            raise WireError(f"no {self.kind} reply of this shape: {summarize_error(error)}") from None
        if stream.tell() != len(data):
            raise WireError(f"no {self.kind} reply of this shape: it ends after {stream.tell()} of {len(data)} bytes")
        volts = tuple(found["volts"]) if "volts" in found else None
        values = tuple(found.get("values", ()))
        return Reply(self.kind, slots, found.get("laser"), stamps, found.get("clock"), volts, values)

    def build(self, reply: Reply, wire_state: WireState) -> bytes:
        """Return the bytes of a reply. Raises WireError if its values do not fit this layout."""
        parts = {
            "slots": reply.slots, "stamps": reply.stamps, "laser": reply.laser, "clock": reply.clock or 0,
            "values": reply.values, "volts": reply.volts or (0, 0),
        }  # fmt: skip
        stream, context = BytesIO(), _Context(wire_state)
        try:
            for name, part, _, build, _ in self._present_members(wire_state.mask):
                build(parts[part], stream, context, name)
        except ConstructError as error:
            raise WireError(f"a {self.kind} reply cannot carry this: {summarize_error(error)}") from None
        return stream.getvalue()


_ERROR_PATH: Final = re.compile(r"Error in path ([^\n]*)\n")


def summarize_error(error: Exception) -> str:
    """Return construct's error text on one line, its path shortened to the names of the fields."""
    text = _ERROR_PATH.sub(lambda path: ": ".join([*path[1].split(" -> ")[1:], ""]), str(error))
    return " ".join(text.split())


# Layouts over TCP (docs/protocol.md). A state reply is the State vector of 45 words, the laser block, stamps for
# the bits in Smask[0], clock in ms, CPU and motor voltage bytes.
STATE = TcpLayout("state", slots=range(LAST_TCP_SLOT + 1), laser_width=attrgetter("laser_width"),
                  stamps=tuple(Position), has_clock=True, has_volts=True)
# get_ir, get_sn: 16 values, stamps, clock. get_bp, get_cp: one value, stamp, clock.
INFRARED = TcpLayout("infrared", slots=range(1, 17), stamps=(Position.INFRARED,), has_clock=True)
SONAR = TcpLayout("sonar", slots=range(17, 33), stamps=(Position.SONAR,), has_clock=True)
BUMPER = TcpLayout("bumper", slots=(BUMPER_SLOT,), stamps=(Position.BUMPER,), has_clock=True)
COMPASS = TcpLayout("compass", slots=(COMPASS_SLOT,), stamps=(Position.COMPASS,), has_clock=True)
# get_ls and get_sg: laser block, stamp, clock.
LASER = TcpLayout("laser", laser_width=attrgetter("get_laser_width"), stamps=(Position.LASER,), has_clock=True)
SEGMENTS = TcpLayout("laser", laser_width=lambda _: LINES, stamps=(Position.LASER,), has_clock=True)
# get_rc: x y steering turret; get_rv, get_ra: three values; predict_sensors: words 0..43 and a laser block.
CONFIGURATION = TcpLayout("configuration", slots=range(34, 38))
CLICKED_CONFIGURATION = TcpLayout("configuration", values=4)
VELOCITY = TcpLayout("velocity", slots=range(38, 41))
PREDICTION = TcpLayout("prediction", values=44, laser_width=attrgetter("laser_width"))
SIMPLE = TcpLayout("simple", values=1)
SIMPLE_LIST = TcpLayout("simple", values=None)
COLLISION = TcpLayout("simple", values=4)
SPECIAL = TcpLayout("special", values=None)
TRUTH = TcpLayout("truth", values=8)
CONTROL = TcpLayout("control", values=4)
ERROR = TcpLayout("error", values=1)

# Layouts on the serial line (docs/protocol.md). A state packet holds only what the mask selects; motor status,
# clock and voltages are always there.
LINE_STATE = LineLayout(
    "state",
    slots_infrared=layouts.LineNibbles(1, 16),
    stamps_infrared=layouts.LineStamps(Position.INFRARED, range(1, 17)),
    slots_sonar=layouts.LineSlots(17, 32, layouts.BYTES),
    stamps_sonar=layouts.LineStamps(Position.SONAR, range(17, 33)),
    slots_bumper=layouts.BumperBytes(BUMPER_SLOT),
    stamps_bumper=layouts.LineStamps(Position.BUMPER, (BUMPER_SLOT,)),
    slots_pose=layouts.LineSlots(34, 40, layouts.SIGNED_SHORTS),
    slots_compass=layouts.LineSlots(COMPASS_SLOT, COMPASS_SLOT, layouts.SIGNED_SHORTS),
    stamps_compass=layouts.LineStamps(Position.COMPASS, (COMPASS_SLOT,)),
    laser=layouts.LineLaser(lambda wire_state: line_laser_width(wire_state.laser_mode), masked_by=types.LASER_SLOT),
    stamps_laser=layouts.LineStamps(Position.LASER, (types.LASER_SLOT,)),
    slots_motors=layouts.LineSlots(MOTOR_SLOT, MOTOR_SLOT, layouts.BYTES, masked=False),
    clock=layouts.LINE_CLOCK,
    volts=layouts.LineRun(2, layouts.BYTES),
)


def _line_query(kind: str, position: Position, **readings: Construct) -> LineLayout:
    """Return the layout of the reply to a get_* command: all its readings, whatever the mask, stamps and clock."""
    return LineLayout(kind, **readings, stamps=layouts.LineStamps(position), clock=layouts.LINE_CLOCK)


LINE_INFRARED = _line_query("infrared", Position.INFRARED, slots=layouts.LineNibbles(1, 16, masked=False))
LINE_SONAR = _line_query("sonar", Position.SONAR, slots=layouts.LineSlots(17, 32, layouts.BYTES, masked=False))
LINE_BUMPER = _line_query("bumper", Position.BUMPER, slots=layouts.BumperBytes(BUMPER_SLOT, masked=False))
LINE_COMPASS = _line_query("compass", Position.COMPASS,
                           slots=layouts.LineSlots(COMPASS_SLOT, COMPASS_SLOT, layouts.SHORTS, masked=False))
LINE_LASER = _line_query("laser", Position.LASER, laser=layouts.LineLaser(lambda _: types.PIXELS))
LINE_SEGMENTS = _line_query("laser", Position.LASER, laser=layouts.LineLaser(lambda _: LINES))
LINE_CONFIGURATION = LineLayout("configuration", slots=layouts.LineSlots(34, 37, layouts.SIGNED_SHORTS, masked=False))
LINE_VELOCITY = LineLayout("velocity", slots=layouts.LineSlots(38, 40, layouts.SIGNED_SHORTS, masked=False))
LINE_NOTHING = LineLayout("velocity")
LINE_CALIBRATION = LineLayout("compass", values=layouts.LineRun(3, layouts.BYTES))
LINE_SPECIAL = LineLayout("special", values=GreedyRange(Int8ub))
LINE_NAK = LineLayout("nak")
