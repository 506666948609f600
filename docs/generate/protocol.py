"""Generate docs/protocol.md: the bytes of every command in both protocols, from the command table.

A message layout without a description here raises a KeyError.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import Any, Final

from construct import Construct, GreedyRange, Int32ul

from nclient.protocol.commands import ALL, COMMANDS, REPLY_TYPES, Argument, Command
from nclient.protocol.layouts import (
    ARM_NUMBER,
    FLAG_BYTE,
    HISTORY_BYTE,
    LASER_MODE_BYTE,
    LINE_BYTE,
    LINE_SIGNED,
    LINE_UNSIGNED,
    ArmPacket,
    BumperBytes,
    ByteWords,
    LineLaser,
    LineMask,
    LineNibbles,
    LineRun,
    LineSlots,
    LineStamps,
    LineText,
    MotionWords,
    ObstacleWords,
    TcpMask,
    TextWords,
    UserPacket,
)
from nclient.protocol.replies import LINE_STATE, STATE, LineLayout, TcpLayout

_SIZES: Final[dict[int, str]] = {
    id(field): name
    for field, name in (
        (LINE_SIGNED, "s16"), (LINE_UNSIGNED, "u16"), (LINE_BYTE, "u8"), (FLAG_BYTE, "u8"), (HISTORY_BYTE, "u8"),
        (LASER_MODE_BYTE, "u8"), (Int32ul, "u32"), (ARM_NUMBER, "u32"),
    )
}  # fmt: skip
_PACKET: Final = "length (low, high), serial, type"
_WHOLE: Final[tuple[tuple[type, str], ...]] = (
    (TcpMask, "7 bytes of the mask, one per word"), (LineMask, "7 bytes of the mask"),
    (TextWords, "text, four characters per word, the first lowest; NUL"), (LineText, "text, NUL"),
    (MotionWords, "type; a line: x1 y1 x2 y2, 3 unused; an arc: x1 y1 angle1 angle2 radius xc yc "
                  "(lengths x 100, angles in rad x 10^6)"),
    (UserPacket, f"{_PACKET}, bytes"),
)  # fmt: skip
_READERS: Final[dict[type[Construct], Callable[[Any], str]]] = {
    LineSlots: lambda field: f"{_slots(field.slots)}: {_times(len(field.slots), _run(field.run))}",
    LineNibbles: lambda field: f"{_slots(field.slots)}: 4 bits each",
    BumperBytes: lambda field: f"{_slots(field.slots)}: 3 bytes",
    LineStamps: lambda _: "[stamps]",
    LineLaser: lambda _: "laser",
    LineRun: lambda field: _times(field.count, _run(field.run)),
    GreedyRange: lambda _: "bytes",
}
_NAMED: Final = {"clock": "clock", "volts": "volts (CPU, motors)"}
def blocks() -> dict[str, Iterator[str]]:
    """Return the tables of the page."""
    return {"tcp": _over_tcp(), "serial": _on_serial_line()}


def _over_tcp() -> Iterator[str]:
    yield from (f"A *state* is {_layout(STATE)}.", "")
    yield from ("| command | type | request, in words | reply | its type |", "|---|---|---|---|---|")
    for row in COMMANDS:
        if row.tcp_type is not None:
            reply, number = ("none", "—")
            if row.has_tcp_reply:
                reply, number = _reply(row.tcp_reply), str(REPLY_TYPES[row.tcp_reply])
            yield f"| `{row.name}` | {row.tcp_type} | {_request(row, tcp=True)} | {reply} | {number} |"


def _on_serial_line() -> Iterator[str]:
    yield from (f"A *state* is {_layout(LINE_STATE)}.", "")
    yield "| command | type | models | request | reply | timeout, s |"
    yield "|---|---|---|---|---|---|"
    for row in COMMANDS:
        if row.line_type is not None:
            models = "all" if row.line_models == ALL else ", ".join(sorted(name.title() for name in row.line_models))
            cells = (f"`{row.name}`", row.line_type, models, _request(row, tcp=False), _reply(row.line_reply))
            yield f"| {' | '.join(map(str, cells))} | {row.line_timeout_s:g} |"


def _request(row: Command, *, tcp: bool) -> str:
    layout = row.tcp_request if tcp else row.line_request
    if isinstance(layout, ByteWords):
        layout, suffix = row.line_request, "; one byte per word"
    else:
        suffix = ""
    if isinstance(layout, ArmPacket):
        fields = [_SIZES[id(field)] for field in layout.subcon.subcon.subcons[3:-1]]  # head before, end behind
        data = ", ".join(f"{a.name} {size}" for a, size in zip(row.arguments, fields, strict=True))
        return f"{_PACKET} {row.packet_type}, {data}{suffix}"
    if isinstance(layout, ObstacleWords):
        return "n, x1, y1 .. xn, yn" + (", dx, dy" if layout.tail else "")
    for kind, words in _WHOLE:
        if isinstance(layout, kind):
            return words + suffix
    return ", ".join(_arguments(row.arguments, tcp)) or "—"


def _arguments(arguments: tuple[Argument, ...], tcp: bool) -> Iterator[str]:
    """Yield the argument names; order_0 to order_15 become order[16]. On a serial line the size is appended."""
    for name, same in groupby(arguments, key=lambda argument: re.sub(r"_\d+$", "", argument.name)):
        each = list(same)
        size = "" if tcp else f" {_SIZES[id(each[0].line)]}"
        yield f"{name}[{len(each)}]{size}" if len(each) > 1 else f"{name}{size}"


def _reply(layout: TcpLayout | LineLayout) -> str:
    if layout in (STATE, LINE_STATE):
        return "a *state*"
    return _layout(layout) or "nothing"


def _layout(layout: TcpLayout | LineLayout) -> str:
    if isinstance(layout, LineLayout):
        return ", ".join(_NAMED.get(name) or _READERS[type(field)](field) for name, field in layout.layout.items())
    parts = {
        "words" if layout.values is None else _times(layout.values, "word"): layout.values != 0,
        _slots(layout.slots or (0,)): layout.slots,
        "laser": layout.laser_width,
        "[stamps]": layout.stamps,
        _NAMED["clock"]: layout.has_clock,
        _NAMED["volts"]: layout.has_volts,
    }
    return ", ".join(text for text, is_there in parts.items() if is_there)


def _slots(slots: Sequence[int]) -> str:
    return f"State[{slots[0]}]" if len(slots) == 1 else f"State[{slots[0]}..{slots[-1]}]"


def _run(run: Any) -> str:
    return f"{'s' if run.sign else 'u'}{8 * run.octets}"


def _times(count: int, what: str) -> str:
    return what if count == 1 else f"{count} x {what}" if what != "word" else f"{count} words"
