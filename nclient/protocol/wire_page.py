"""docs/protocol.md: the bytes of every command in both languages, read off THE table.

    python -m nclient.protocol.wire_page > docs/protocol.md          (scripts/protocol-page does that)

Rules: no row is written by hand. A layout that has no words here is a KeyError, and not a guess.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import Any, Final

from construct import Construct, GreedyRange, Int32ul

from nclient.protocol.commands import ALL, COMMANDS, REPLY_TYPES, Argument, Command
from nclient.protocol.fields import (
    LINE_BYTE,
    LINE_SIGNED,
    LINE_UNSIGNED,
    BumperBytes,
    LineLaser,
    LineNibbles,
    LineRun,
    LineSlots,
    LineStamps,
    WordLaser,
    Words,
    WordSlots,
    WordStamps,
)
from nclient.protocol.replies import LINE_STATE, STATE, ReplyShape
from nclient.protocol.requests import (
    ARM_NUMBER,
    FLAG_BYTE,
    HISTORY_BYTE,
    LASER_MODE_BYTE,
    ArmPacket,
    ByteWords,
    LineMask,
    LineText,
    MotionWords,
    ObstacleWords,
    TcpMask,
    TextWords,
    UserPacket,
)

_SIZES: Final[dict[int, str]] = {
    id(field): name
    for field, name in (
        (LINE_SIGNED, "s16"), (LINE_UNSIGNED, "u16"), (LINE_BYTE, "u8"), (FLAG_BYTE, "u8"), (HISTORY_BYTE, "u8"),
        (LASER_MODE_BYTE, "u8"), (Int32ul, "u32"), (ARM_NUMBER, "u32"),
    )
}  # fmt: skip
_PACKET: Final = "length (low, high), serial, type"
_WHOLE: Final[tuple[tuple[type[Construct], str], ...]] = (
    (TcpMask, "7 bytes of the mask, one a word"), (LineMask, "7 bytes of the mask"),
    (TextWords, "text, four characters a word, the first lowest; NUL"), (LineText, "text, NUL"),
    (MotionWords, "type; a line: x1 y1 x2 y2, 3 unused; an arc: x1 y1 angle1 angle2 radius xc yc "
                  "(lengths x 100, angles in rad x 10^6)"),
    (UserPacket, f"{_PACKET}, bytes"),
)  # fmt: skip
_READERS: Final[dict[type[Construct], Callable[[Any], str]]] = {
    WordSlots: lambda field: _slots(field.slots),
    WordStamps: lambda _: "[stamps]",
    WordLaser: lambda _: "laser",
    Words: lambda field: "words" if field.count is None else _times(field.count, "word"),
    LineSlots: lambda field: f"{_slots(field.slots)}: {_times(len(field.slots), _run(field.run))}",
    LineNibbles: lambda field: f"{_slots(field.slots)}: 4 bits each",
    BumperBytes: lambda field: f"{_slots(field.slots)}: 3 bytes",
    LineStamps: lambda _: "[stamps]",
    LineLaser: lambda _: "laser",
    LineRun: lambda field: _times(field.count, _run(field.run)),
    GreedyRange: lambda _: "bytes",
}
_NAMED: Final = {"clock": "clock", "volts": "volts (CPU, motors)"}
_HEAD: Final = """\
# Protocol

What goes over the wire for each command, in both languages. Made by `scripts/protocol-page` from the one table,
`nclient/protocol/commands.py`, which client, emulator and C library read too. What a command does, and on which model:
[Commands](commands.md). Lengths are in 1/10 inch, angles in 1/10 degree, counter-clockwise positive, rates per second.

## Frames

| | an Nserver, over TCP (port 7019) | a robot's own line (serial 38400 8N1, or TCP port 65001) |
|---|---|---|
| a frame | type, count (16 bits each), words; high byte first | 01, length (low, high), type, data, checksum, 5C |
| a number | a word: 32 bits, two's complement | u8, u16, u32, s16, s32: low byte first, top bit of s is the sign |
| length | in words | of type, data and checksum |
| checksum | none | the sum of all bytes before it, the 01 included, modulo 256 |
| an answer | the next frame of the connection | a frame of the command's own type; type 8, NAK, is a refusal |
| an error | type 91, one word: the code | NAK, or silence |

`nomad wire encode` and `nomad wire decode` make and read frames of both:

```sh
nomad wire encode vm 100 -50 0
nomad wire encode vm 100 -50 0 --line serial --model n150
```

State[a..b] are the numbers of the state vector: 1..16 infrareds, 17..32 sonars, 33 bumpers, 34..37 x, y, steering,
turret, 38..40 velocities, 41 motors, 42 laser mode, 43 compass. On a robot's own line a state holds what the mask
allows, and signed numbers are sign and magnitude: -50 is 32 80. [stamps] are there where position data are asked for:
nine numbers a sensor, x, y, steering, turret, three velocities, time of the pose, time of the sensor. *laser* is a
count n and n readings of 1, 2 or 4 numbers, by the laser's mode.
"""


def markdown() -> str:
    """The whole page."""
    return "\n".join((_HEAD, *_over_tcp(), "", *_on_the_line(), "")).rstrip() + "\n"


def _over_tcp() -> Iterator[str]:
    yield from ("## Over TCP", "", f"A *state* is {_layout(STATE)}.", "")
    yield from ("| command | type | request, in words | answer | its type |", "|---|---|---|---|---|")
    for row in COMMANDS:
        if row.tcp_type is not None:
            answer, number = ("none", "—")
            if row.has_tcp_reply:
                answer, number = _reply(row.tcp_reply), str(REPLY_TYPES[row.tcp_reply])
            yield f"| `{row.name}` | {row.tcp_type} | {_request(row, tcp=True)} | {answer} | {number} |"


def _on_the_line() -> Iterator[str]:
    yield from ("## On a robot's own line", "", f"A *state* is {_layout(LINE_STATE)}.", "")
    yield "| command | type | of | request | answer | wait, s |"
    yield "|---|---|---|---|---|---|"
    for row in COMMANDS:
        if row.line_type is not None:
            models = "all" if row.line_models == ALL else ", ".join(sorted(name.title() for name in row.line_models))
            cells = (f"`{row.name}`", row.line_type, models, _request(row, tcp=False), _reply(row.line_reply))
            yield f"| {' | '.join(map(str, cells))} | {row.line_timeout_s:g} |"


def _request(row: Command, *, tcp: bool) -> str:
    layout = row.tcp_request if tcp else row.line_request
    if isinstance(layout, ByteWords):
        layout, one = row.line_request, "; one byte a word"
    else:
        one = ""
    if isinstance(layout, ArmPacket):
        fields = [_SIZES[id(field)] for field in layout.subcon.subcon.subcons[3:-1]]  # head before, end behind
        data = ", ".join(f"{a.name} {size}" for a, size in zip(row.arguments, fields, strict=True))
        return f"{_PACKET} {row.packet_type}, {data}{one}"
    if isinstance(layout, ObstacleWords):
        return "n, x1, y1 .. xn, yn" + (", dx, dy" if layout.tail else "")
    for kind, words in _WHOLE:
        if isinstance(layout, kind):
            return words + one
    return ", ".join(_arguments(row.arguments, tcp)) or "—"


def _arguments(arguments: tuple[Argument, ...], tcp: bool) -> Iterator[str]:
    """order_0 to order_15 are one, order[16]; on a line each with its size."""
    for name, same in groupby(arguments, key=lambda argument: re.sub(r"_\d+$", "", argument.name)):
        each = list(same)
        size = "" if tcp else f" {_SIZES[id(each[0].line)]}"
        yield f"{name}[{len(each)}]{size}" if len(each) > 1 else f"{name}{size}"


def _reply(shape: ReplyShape) -> str:
    if shape in (STATE, LINE_STATE):
        return "a *state*"
    return _layout(shape) or "nothing"


def _layout(shape: ReplyShape) -> str:
    return ", ".join(_NAMED.get(name) or _READERS[type(field)](field) for name, field in shape.layout.items())


def _slots(slots: range) -> str:
    return f"State[{slots[0]}]" if len(slots) == 1 else f"State[{slots[0]}..{slots[-1]}]"


def _run(run: Any) -> str:
    return f"{'s' if run.sign else 'u'}{8 * run.octets}"


def _times(count: int, what: str) -> str:
    return what if count == 1 else f"{count} x {what}" if what != "word" else f"{count} words"


if __name__ == "__main__":
    print(markdown(), end="")
