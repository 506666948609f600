"""clib/src/commands.inc: THE table for the C library, a row a command.

    python -m nclient.protocol.c_table > clib/src/commands.inc          (scripts/clib-table does that)

    ROW(ID, name, TCP type, line type, TCP arguments, line arguments, TCP reply, line reply, models, s, packet, data)

Rules: no row is written by hand; what a row cannot say is a KeyError here, and not a guess in C. What the letters of
arguments mean is said in clib/src/table.h.
"""

from __future__ import annotations

from typing import Any, Final

from construct import Construct, Int32ul

from nclient.protocol import replies as shape
from nclient.protocol.commands import COMMANDS, Command
from nclient.protocol.fields import WORD
from nclient.protocol.line_fields import LINE_BYTE, LINE_SIGNED, LINE_UNSIGNED
from nclient.protocol.models import MODELS
from nclient.protocol.replies import ReplyShape
from nclient.protocol.requests import (
    ARM_NUMBER,
    FLAG_BYTE,
    FLAG_WORD,
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

_LETTERS: Final[dict[int, str]] = {
    id(field): letter
    for field, letter in (
        (WORD, "w"), (FLAG_WORD, "f"), (LINE_SIGNED, "s"), (LINE_UNSIGNED, "u"), (LINE_BYTE, "b"), (FLAG_BYTE, "f"),
        (HISTORY_BYTE, "h"), (LASER_MODE_BYTE, "m"), (Int32ul, "L"), (ARM_NUMBER, "L"),
    )
}  # fmt: skip
_WHOLE: Final[tuple[tuple[type[Construct], str], ...]] = (
    (TcpMask, "M"), (LineMask, "M"), (TextWords, "T"), (LineText, "T"), (ByteWords, "P"), (ArmPacket, "P"),
    (UserPacket, "P"), (ObstacleWords, "*"), (MotionWords, "*"),
)  # fmt: skip
_SHAPES: Final[dict[ReplyShape, str]] = {
    shape.STATE: "STATE", shape.PREDICTION: "PREDICTION", shape.SIMPLE: "SIMPLE", shape.SIMPLE_LIST: "LIST",
    shape.COLLISION: "COLLISION", shape.INFRARED: "INFRARED", shape.SONAR: "SONAR", shape.LASER: "LASER",
    shape.SEGMENTS: "SEGMENTS", shape.COMPASS: "COMPASS", shape.BUMPER: "BUMPER", shape.CONFIGURATION: "POSE",
    shape.CLICKED_CONFIGURATION: "CLICKED", shape.VELOCITY: "VELOCITY", shape.SPECIAL: "SPECIAL", shape.TRUTH: "TRUTH",
    shape.CONTROL: "CONTROL", shape.LINE_STATE: "STATE", shape.LINE_INFRARED: "INFRARED", shape.LINE_SONAR: "SONAR",
    shape.LINE_BUMPER: "BUMPER", shape.LINE_COMPASS: "COMPASS", shape.LINE_LASER: "LASER",
    shape.LINE_SEGMENTS: "SEGMENTS", shape.LINE_CONFIGURATION: "POSE", shape.LINE_VELOCITY: "VELOCITY",
    shape.LINE_NOTHING: "NOTHING", shape.LINE_CALIBRATION: "CALIBRATION", shape.LINE_SPECIAL: "SPECIAL",
}  # fmt: skip
_HEAD: Final = """\
/* Every command once. Made by scripts/clib-table from nclient/protocol/commands.py: change that, never this.
 *
 * ROW(id, name, TCP type, line type, TCP arguments, line arguments, TCP reply, line reply, models, seconds,
 *     packet type, packet data)        a type of -1: does not exist there; what the letters mean: table.h */
"""


def written() -> str:
    """The whole file."""
    return _HEAD + "".join(f"{_row(row)}\n" for row in COMMANDS)


def _row(row: Command) -> str:
    models = sum(1 << model.number for model in MODELS.values() if model.name in row.line_models)
    on_line = row.line_type is not None
    columns = [
        row.name.upper(), _text(row.name), _number(row.tcp_type), _number(row.line_type),
        _text(_letters(row.tcp_request, [a.tcp for a in row.arguments]) if row.tcp_type is not None else ""),
        _text(_letters(row.line_request, [a.line for a in row.arguments]) if on_line else ""),
        _SHAPES[row.tcp_reply] if row.has_tcp_reply else "NOTHING", _SHAPES[row.line_reply],
        str(models if on_line else 0), f"{row.line_timeout_s:g}", _number(row.packet_type), _text(_packet(row)),
    ]  # fmt: skip
    return f"ROW({', '.join(columns)})"


def _letters(layout: Any, fields: list[Construct]) -> str:
    for kind, letter in _WHOLE:
        if isinstance(layout, kind):
            return letter
    return "".join(_LETTERS[id(field)] for field in fields)


def _packet(row: Command) -> str:
    """The data behind the head of the arm's packets; "" for what has none of its own."""
    if not isinstance(row.line_request, ArmPacket):
        return ""
    elements = row.line_request.subcon.subcon.subcons[3:-1]  # head before, end behind
    return "".join(_LETTERS[id(field)] for field in elements)


def _number(value: int | None) -> str:
    return str(-1 if value is None else value)


def _text(value: str) -> str:
    return f'"{value}"'


if __name__ == "__main__":
    print(written(), end="")
