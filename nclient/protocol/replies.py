"""Replies: their values, and the layout of each kind of reply over TCP and on the serial line.

    Reply       the values: State slots, laser vector, stamps, clock, battery bytes, or plain numbers
    ReplyShape  one layout: named constructs that parse bytes to a Reply and build them from it

A member's name gives the part of the Reply that it holds: slots*, stamps*, laser, clock, volts, values.
Mask and laser mode of the connection come in as WireState.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Final, NamedTuple

from construct import Construct, ConstructError, GreedyRange, Int8ub

from nclient.errors import WireError
from nclient.protocol.fields import (
    BYTES,
    LINE_CLOCK,
    SHORTS,
    SIGNED_SHORTS,
    UNSIGNED_WORD,
    BumperBytes,
    LineLaser,
    LineNibbles,
    LineRun,
    LineSlots,
    LineStamps,
    Masked,
    WordLaser,
    Words,
    WordSlots,
    WordStamps,
)
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, LASER_SLOT, Mask, Position, Stamp
from nclient.protocol.wire_state import LINES, PIXELS, WireState, line_laser_width

MOTOR_SLOT = 41
LAST_TCP_SLOT = 44


@dataclass(frozen=True, slots=True)
class Reply:
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
    slots: Mapping[int, int] = field(default_factory=dict)
    laser: tuple[int, ...] | None = None
    stamps: Mapping[str, Stamp] = field(default_factory=dict)
    clock: int | None = None
    volts: tuple[int, int] | None = None
    values: tuple[int, ...] = ()


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
    is_absent = subcon.is_absent if isinstance(subcon, Masked) else None
    return _Member(name, name.partition("_")[0], subcon._parse, subcon._build, is_absent)


class ReplyShape:
    """Layout of a reply: its kind, and named constructs in the order of their bytes.

    Replaces a construct Struct, which takes three times as long: every reply of the server passes through here.
    Members that the mask excludes (`Masked.absent`) are skipped.
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
            "slots": reply.slots,
            "stamps": reply.stamps,
            "laser": reply.laser,
            "clock": reply.clock or 0,
            "values": reply.values,
            "volts": reply.volts or (0, 0),
        }
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


def _words(kind: str, count: int | None) -> ReplyShape:
    return ReplyShape(kind, values=Words(count))


# Layouts over TCP (docs/protocol.md, Over TCP). A state reply is the State vector of 45 words, the laser block, stamps
# for the bits in Smask[0], clock in ms, CPU and motor voltage bytes.
STATE = ReplyShape(
    "state",
    slots=WordSlots(0, LAST_TCP_SLOT),
    laser=WordLaser(lambda wire_state: wire_state.laser_width),
    stamps=WordStamps(),
    clock=UNSIGNED_WORD,
    volts=Words(2),
)
# get_ir, get_sn: 16 values, stamps, clock. get_bp, get_cp: one value, stamp, clock.
INFRARED = ReplyShape(
    "infrared", slots=WordSlots(1, 16), stamps=WordStamps(Position.INFRARED), clock=UNSIGNED_WORD
)
SONAR = ReplyShape("sonar", slots=WordSlots(17, 32), stamps=WordStamps(Position.SONAR), clock=UNSIGNED_WORD)
BUMPER = ReplyShape(
    "bumper",
    slots=WordSlots(BUMPER_SLOT, BUMPER_SLOT),
    stamps=WordStamps(Position.BUMPER),
    clock=UNSIGNED_WORD,
)
COMPASS = ReplyShape(
    "compass",
    slots=WordSlots(COMPASS_SLOT, COMPASS_SLOT),
    stamps=WordStamps(Position.COMPASS),
    clock=UNSIGNED_WORD,
)
# get_ls and get_sg: laser block, stamp, clock.
LASER = ReplyShape(
    "laser",
    laser=WordLaser(lambda wire_state: wire_state.get_laser_width),
    stamps=WordStamps(Position.LASER),
    clock=UNSIGNED_WORD,
)
SEGMENTS = ReplyShape(
    "laser", laser=WordLaser(lambda _: LINES), stamps=WordStamps(Position.LASER), clock=UNSIGNED_WORD
)
# get_rc: x y steering turret; get_rv, get_ra: three values; predict_sensors: words 0..43 and a laser block.
CONFIGURATION = ReplyShape("configuration", slots=WordSlots(34, 37))
CLICKED_CONFIGURATION = _words("configuration", 4)
VELOCITY = ReplyShape("velocity", slots=WordSlots(38, 40))
PREDICTION = ReplyShape("prediction", values=Words(44), laser=WordLaser(lambda wire_state: wire_state.laser_width))
SIMPLE = _words("simple", 1)
SIMPLE_LIST = _words("simple", None)
COLLISION = _words("simple", 4)
SPECIAL = _words("special", None)
TRUTH = _words("truth", 8)
CONTROL = _words("control", 4)
ERROR = _words("error", 1)

# Layouts on the serial line (docs/protocol.md, On a serial line). A state packet holds only what the mask selects;
# motor status, clock and voltages are always there.
LINE_STATE = ReplyShape(
    "state",
    slots_infrared=LineNibbles(1, 16),
    stamps_infrared=LineStamps(Position.INFRARED, range(1, 17)),
    slots_sonar=LineSlots(17, 32, BYTES),
    stamps_sonar=LineStamps(Position.SONAR, range(17, 33)),
    slots_bumper=BumperBytes(BUMPER_SLOT),
    stamps_bumper=LineStamps(Position.BUMPER, (BUMPER_SLOT,)),
    slots_pose=LineSlots(34, 40, SIGNED_SHORTS),
    slots_compass=LineSlots(COMPASS_SLOT, COMPASS_SLOT, SIGNED_SHORTS),
    stamps_compass=LineStamps(Position.COMPASS, (COMPASS_SLOT,)),
    laser=LineLaser(lambda wire_state: line_laser_width(wire_state.laser_mode), masked_by=LASER_SLOT),
    stamps_laser=LineStamps(Position.LASER, (LASER_SLOT,)),
    slots_motors=LineSlots(MOTOR_SLOT, MOTOR_SLOT, BYTES, masked=False),
    clock=LINE_CLOCK,
    volts=LineRun(2, BYTES),
)
# Replies to get_* commands carry all their values, whatever the mask.
LINE_INFRARED = ReplyShape(
    "infrared",
    slots=LineNibbles(1, 16, masked=False),
    stamps=LineStamps(Position.INFRARED),
    clock=LINE_CLOCK,
)
LINE_SONAR = ReplyShape(
    "sonar",
    slots=LineSlots(17, 32, BYTES, masked=False),
    stamps=LineStamps(Position.SONAR),
    clock=LINE_CLOCK,
)
LINE_BUMPER = ReplyShape(
    "bumper",
    slots=BumperBytes(BUMPER_SLOT, masked=False),
    stamps=LineStamps(Position.BUMPER),
    clock=LINE_CLOCK,
)
LINE_COMPASS = ReplyShape(
    "compass",
    slots=LineSlots(COMPASS_SLOT, COMPASS_SLOT, SHORTS, masked=False),
    stamps=LineStamps(Position.COMPASS),
    clock=LINE_CLOCK,
)
LINE_LASER = ReplyShape(
    "laser", laser=LineLaser(lambda _: PIXELS), stamps=LineStamps(Position.LASER), clock=LINE_CLOCK
)
LINE_SEGMENTS = ReplyShape(
    "laser", laser=LineLaser(lambda _: LINES), stamps=LineStamps(Position.LASER), clock=LINE_CLOCK
)
LINE_CONFIGURATION = ReplyShape("configuration", slots=LineSlots(34, 37, SIGNED_SHORTS, masked=False))
LINE_VELOCITY = ReplyShape("velocity", slots=LineSlots(38, 40, SIGNED_SHORTS, masked=False))
LINE_NOTHING = ReplyShape("velocity")
LINE_CALIBRATION = ReplyShape("compass", values=LineRun(3, BYTES))
LINE_SPECIAL = ReplyShape("special", values=GreedyRange(Int8ub))
LINE_NAK = ReplyShape("nak")
