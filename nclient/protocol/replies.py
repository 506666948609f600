"""What a reply means, apart from how it is laid on the wire, and every layout there is, declared once.

    Reply       the value: State slots, laser vector, stamps, clock, battery bytes, or plain numbers
    ReplyShape  one layout: named constructs that parse bytes to a Reply and build them from it

A member's name says which part of the Reply it is: slots*, stamps*, laser, clock, volts, values.
Rules: shapes know no socket and no history; what a conversation has agreed comes in as Terms.
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
    """What one reply says, in wire units. `kind` is a name such as state, sonar, simple, error, nak.

    `slots` holds the State slots it carries, `laser` the laser vector (n, values...), `stamps` the position
    stamps by name (ir_0, sonar_15, bumper, laser, compass), `clock` milliseconds, `volts` the two raw battery
    bytes (CPU, motors), `values` the numbers of every other kind.
    """

    kind: str
    slots: Mapping[int, int] = field(default_factory=dict)
    laser: tuple[int, ...] | None = None
    stamps: Mapping[str, Stamp] = field(default_factory=dict)
    clock: int | None = None
    volts: tuple[int, int] | None = None
    values: tuple[int, ...] = ()


class _Agreed:
    """What construct hands to each member as its context: the terms, where a Struct would have them."""

    def __init__(self, wire_state: WireState) -> None:
        self.wire_state = wire_state

    @property
    def _params(self) -> _Agreed:
        """Itself, as in construct; kept, it would be garbage after each reply."""
        return self


class _Member(NamedTuple):
    """A part of a reply, by name, and what reads and writes it."""

    name: str
    part: str
    parse: Callable[..., Any]
    build: Callable[..., Any]
    absent: Callable[[Mask], bool] | None


def _member(name: str, subcon: Construct) -> _Member:
    absent = subcon.absent if isinstance(subcon, Masked) else None
    return _Member(name, name.partition("_")[0], subcon._parse, subcon._build, absent)


class ReplyShape:
    """A layout of a reply: `kind`, and the named constructs that make its bytes, in order.

    It stands for a construct Struct, and runs the members itself: every answer of the daemon goes through here,
    and a Struct costs three times as much. A member that a mask leaves out (its `absent` says so) is not run at all.
    """

    def __init__(self, kind: str, **members: Any) -> None:
        self.kind = kind
        self.layout: Mapping[str, Any] = members
        """The members' constructs by name, in order."""
        self._members = [_member(name, subcon) for name, subcon in members.items()]
        self._masked = any(member.absent is not None for member in self._members)
        self._present: tuple[Mask | None, list[_Member]] = (None, [])

    def _under(self, mask: Mask) -> list[_Member]:
        """The members there are; a mask seldom changes, so what the last one left is kept."""
        if not self._masked:
            return self._members
        present = self._present
        if present[0] is not mask:
            members = [member for member in self._members if member.absent is None or not member.absent(mask)]
            present = self._present = (mask, members)
        return present[1]

    def parse(self, data: bytes, wire_state: WireState) -> Reply:
        """The reply that these bytes are. Raises WireError when they are none of this shape."""
        slots: dict[int, int] = {}
        stamps: dict[str, Stamp] = {}
        found: dict[str, Any] = {"slots": slots, "stamps": stamps}
        stream, context = BytesIO(data), _Agreed(wire_state)
        try:
            for name, part, parse, _, _ in self._under(wire_state.mask):
                value = parse(stream, context, name)
                if part in ("slots", "stamps"):
                    found[part].update(value)
                else:
                    found[name] = value
        except ConstructError as error:
            raise WireError(f"no {self.kind} reply of this shape: {one_line(error)}") from None
        if stream.tell() != len(data):
            raise WireError(f"no {self.kind} reply of this shape: it ends after {stream.tell()} of {len(data)} bytes")
        volts = tuple(found["volts"]) if "volts" in found else None
        values = tuple(found.get("values", ()))
        return Reply(self.kind, slots, found.get("laser"), stamps, found.get("clock"), volts, values)

    def build(self, reply: Reply, wire_state: WireState) -> bytes:
        """The bytes of a reply. Raises WireError when it holds what this shape cannot carry."""
        parts = {
            "slots": reply.slots,
            "stamps": reply.stamps,
            "laser": reply.laser,
            "clock": reply.clock or 0,
            "values": reply.values,
            "volts": reply.volts or (0, 0),
        }
        stream, context = BytesIO(), _Agreed(wire_state)
        try:
            for name, part, _, build, _ in self._under(wire_state.mask):
                build(parts[part], stream, context, name)
        except ConstructError as error:
            raise WireError(f"a {self.kind} reply cannot carry this: {one_line(error)}") from None
        return stream.getvalue()


_WAY: Final = re.compile(r"Error in path ([^\n]*)\n")


def one_line(error: Exception) -> str:
    """What construct says, on one line, and of the way to the place that it means the names alone."""
    text = _WAY.sub(lambda way: ": ".join([*way[1].split(" -> ")[1:], ""]), str(error))
    return " ".join(text.split())


def _words(kind: str, count: int | None) -> ReplyShape:
    return ReplyShape(kind, values=Words(count))


# Over TCP (PROTOCOL.md, section 1).
STATE = ReplyShape(
    "state",
    slots=WordSlots(0, LAST_TCP_SLOT),
    laser=WordLaser(lambda wire_state: wire_state.laser_width),
    stamps=WordStamps(),
    clock=UNSIGNED_WORD,
    volts=Words(2),
)
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
LASER = ReplyShape(
    "laser",
    laser=WordLaser(lambda wire_state: wire_state.get_laser_width),
    stamps=WordStamps(Position.LASER),
    clock=UNSIGNED_WORD,
)
SEGMENTS = ReplyShape(
    "laser", laser=WordLaser(lambda _: LINES), stamps=WordStamps(Position.LASER), clock=UNSIGNED_WORD
)
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

# On the robot's own line (PROTOCOL.md, section 2).
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
