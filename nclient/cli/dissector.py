"""The Wireshark dissector: dissector.lua with the tables of commands and replies written into it.

The program in Lua reads messages by tables only; `build_dissector` writes them from the command table, so that a new
command appears in Wireshark without a change there.
"""

from collections.abc import Iterator, Mapping
from importlib import resources
from typing import Any, Final

from nclient.protocol import codec, commands, fields, requests, wire_state
from nclient.protocol import decode as wire
from nclient.protocol import replies as shape
from nclient.protocol.commands import Command
from nclient.protocol.replies import LineLayout, TcpLayout
from nclient.protocol.serial_framing import HOST_LIMIT, ROBOT_LIMIT
from nclient.protocol.types import (
    CPU_RANGE_V,
    EVERYTHING,
    INFRARED_KEYS,
    MOTOR_RANGE_V,
    NO_MASK_MODELS,
    SONAR_KEYS,
    STAMP_KEYS,
)

_TABLE_MARK: Final = "--@TABLE@\n"
# Names of the 45 State slots in Wireshark's filters: nomad.speed, nomad.ir_0, ...
_SLOTS: Final = (
    "speed", *INFRARED_KEYS, *SONAR_KEYS, "bumper", "x", "y", "steer", "turret", "v_trans", "v_steer", "v_turret",
    "motors", "laser_mode", "compass", "state_error",
)
_UNITS: Final = {
    "x": "1/10 in", "y": "1/10 in", "steer": "1/10 deg", "turret": "1/10 deg", "v_trans": "1/10 in/s",
    "v_steer": "1/10 deg/s", "v_turret": "1/10 deg/s", "compass": "1/10 deg", "clock": "ms", "pose_time": "ms",
    "sensor_time": "ms", **dict.fromkeys(SONAR_KEYS, "in"),
}
_STAMP_PARTS: Final = (
    "x", "y", "steer", "turret", "v_trans", "v_steer", "v_turret", "pose_time", "sensor_time",
)
_INTEGERS: Final = {
    "type": "Type", "count": "Words", "word_bits": "Bits of a word", "length": "Length", "checksum": "Checksum",
    "smask": "Smask", "packet_type": "Packet type", "number": "Number", "value": "Value", "code": "Error code",
    "laser_count": "Laser readings", "laser_value": "Laser", "clock": "Clock (ms)", "cpu_raw": "CPU voltage, raw",
    "motor_raw": "Motor voltage, raw", "arm": "Result of the arm", "remain": "Remaining time",
}
_REALS: Final = {"real": "Number", "volt_cpu": "CPU (V)", "volt_motor": "Motors (V)", "collide": "Collision"}
_TEXTS: Final = {
    "to": "To", "call": "Call", "reply": "Reply", "reply_to": "Reply to", "error": "Error", "position": "Position of",
}
_LASER_WIDTHS: Final = {shape.STATE: "state", shape.PREDICTION: "state", shape.LASER: "get", shape.SEGMENTS: "lines"}
_LINE_FORMS: Final = {
    id(fields.LINE_SIGNED): "signed", id(fields.LINE_UNSIGNED): "unsigned", id(fields.LINE_BYTE): "byte",
    id(requests.HISTORY_BYTE): "byte", id(requests.FLAG_BYTE): "flag", id(requests.LASER_MODE_BYTE): "laser_mode",
}


def build_dissector() -> str:
    """Return the Lua source of the dissector for the Nserver protocol and the serial line over TCP."""
    source = resources.files("nclient.cli").joinpath("dissector.lua").read_text(encoding="utf-8")
    tables = "".join(f"local {name} = {_lua(value)}\n" for name, value in _tables().items())
    before, mark, after = source.partition(_TABLE_MARK)
    # All commands are in one table; the others refer to its rows by index.
    rows = "".join(f"ROWS[{_lua(row.name)}] = {_lua(_row(row))}\n" for row in commands.COMMANDS)
    assert mark
    return f"{before}{tables}local ROWS = {{}}\n{rows}{_indexes()}{after}"


def _tables() -> dict[str, Any]:
    """Return the constants and field lists of the Lua program by name."""
    arguments = {
        _argument_field(row, argument.name): f"{argument.name.replace('_', ' ')} ({row.name})"
        for row in commands.COMMANDS for argument in row.arguments if row.name not in ("ct", "tk")
    }
    slots = {name: _label(name) for name in _SLOTS}
    stamps = {f"position.{name}": _label(name) for name in _STAMP_PARTS}
    return {
        "INTEGER_FIELDS": list(map(list, (_INTEGERS | slots | stamps | arguments).items())),
        "REAL_FIELDS": list(map(list, _REALS.items())),
        "TEXT_FIELDS": list(map(list, (_TEXTS | {"tk.text": "text (tk)"}).items())),
        "SLOTS": list(_SLOTS),
        "STAMP_KEYS": {int(bit): list(keys) for bit, keys in STAMP_KEYS.items()},
        "EVERYTHING": list(EVERYTHING.smask),
        "NO_MASK_MODELS": list(NO_MASK_MODELS.smask),
        "TCP_LINE_MODES": sorted(wire_state.TCP_LINE_MODES),
        "POINT_MODES": sorted(wire_state.POINT_MODES),
        "MAX_LASER_READINGS": fields.MAX_LASER_READINGS,
        "MAX_OBSTACLE_VERTICES": requests.MAX_OBSTACLE_VERTICES,
        "MAX_UNKNOWN_WORDS": codec.MAX_UNKNOWN_WORDS,
        "MAX_REPLY_WORDS": commands.MAX_REPLY_WORDS,
        "HOST_LIMIT": HOST_LIMIT,
        "ROBOT_LIMIT": ROBOT_LIMIT,
        "CPU_RANGE_V": CPU_RANGE_V,
        "MOTOR_RANGE_V": MOTOR_RANGE_V,
        "NAK_TYPE": commands.NAK_TYPE,
        "ERROR_TYPE": commands.ERROR_TYPE,
        "ERROR_LAYOUT": _tcp_layout(shape.ERROR),
        "SAME_SHAPE": wire.SAME_SHAPE,
        "BY_REPLY_TYPE": {number: [_tcp_layout(one) for one in found] for number, found in wire.BY_REPLY_TYPE.items()},
    }


def _indexes() -> str:
    """Return the Lua tables that find a row by its type over TCP, on the line, and of its packet."""
    found = []
    for name, index in (("BY_TCP_TYPE", commands.BY_TCP_TYPE), ("BY_LINE_TYPE", commands.BY_LINE_TYPE),
                        ("BY_PACKET_TYPE", commands.BY_PACKET_TYPE)):
        entries = ", ".join(f"[{number}] = ROWS[{_lua(row.name)}]" for number, row in index.items())
        found.append(f"local {name} = {{{entries}}}\n")
    return "".join(found)


def _argument_field(row: Command, argument: str) -> str:
    return f"{row.name}.{argument}"


def _label(name: str) -> str:
    return name.replace("_", " ") + (f" ({_UNITS[name]})" if name in _UNITS else "")


def _row(row: Command) -> dict[str, Any]:
    """Return a row of the command table as the Lua program needs it."""
    entry: dict[str, Any] = {
        "name": row.name,
        "arguments": [_argument_field(row, argument.name) for argument in row.arguments],
        "any_length": row.any_length,
        "words": list(row.tcp_words),
        "has_reply": row.has_tcp_reply and row.tcp_type is not None,
        "reply": _tcp_layout(row.tcp_reply),
        "reply_type": commands.REPLY_TYPES[row.tcp_reply],
        "line_type": row.line_type,
        "line_kind": row.line_reply.kind,
        "line_reply": list(_line_parts(row.line_reply)),
        "models": dict.fromkeys(sorted(row.line_models), True),
        "only_n200": row.line_models == commands.N200,
        "flags": [argument.is_flag for argument in row.arguments],
    }
    # Arguments that are not one word or one field each.
    match row.tcp_request:
        case requests.TcpMask():
            entry["tcp_form"] = "mask"
        case requests.TextWords():
            entry["tcp_form"] = "text"
        case requests.ByteWords():
            entry["tcp_form"] = "packet"
        case requests.MotionWords():
            entry["tcp_form"] = "motion"
        case requests.ObstacleWords(tail=tail):
            entry |= {"tcp_form": "obstacle", "tail": tail}
        case _:
            pass
    match row.line_request:
        case requests.LineMask():
            entry["line_form"] = "mask"
        case requests.LineText():
            entry["line_form"] = "text"
        case requests.UserPacket():
            entry["line_form"] = "packet"
        case requests.ArmPacket(elements=elements):
            # Sizes in bytes of the packet's fields, negative for signed ones.
            sizes = [-element.sizeof() if element is requests.ARM_NUMBER else element.sizeof() for element in elements]
            entry |= {"line_form": "packet", "packet": sizes}
        case _:
            entry["line"] = [_LINE_FORMS[id(argument.line)] for argument in row.arguments]
    return entry


def _tcp_layout(layout: TcpLayout) -> dict[str, Any]:
    found: dict[str, Any] = {
        "kind": layout.kind, "values": layout.values, "clock": layout.has_clock, "volts": layout.has_volts,
        "stamps": [int(bit) for bit in layout.stamps], "laser": _LASER_WIDTHS.get(layout),
    }
    if layout.slots:
        found |= {"first": layout.slots[0], "last": layout.slots[-1]}
    return found


def _line_parts(layout: LineLayout) -> Iterator[dict[str, Any]]:
    """Yield the parts of a reply on the serial line in the order of their bytes."""
    for name, part in layout.layout.items():
        match part:
            case fields.LineNibbles() | fields.BumperBytes():
                op = "bumper" if isinstance(part, fields.BumperBytes) else "nibbles"
                yield {"op": op, "first": part.slots[0], "last": part.slots[-1], "masked": part.masked}
            case fields.LineSlots():
                yield {"op": "slots", "first": part.slots[0], "last": part.slots[-1], "masked": part.masked,
                       "size": part.run.octets, "signed": bool(part.run.sign)}
            case fields.LineStamps():
                yield {"op": "stamps", "bit": part.wanted, "first": part.slots[0] if part.slots else None}
            case fields.LineLaser():
                # A state packet has the width of the laser mode, written as 0; the others have their own.
                width = 0 if part.masked_by else wire_state.LINES if layout is shape.LINE_SEGMENTS else 1
                yield {"op": "laser", "width": width, "masked_by": part.masked_by}
            case _ if name == "clock":
                yield {"op": "clock", "size": 4}
            case _ if name == "volts":
                yield from ({"op": "cpu_raw", "size": 1}, {"op": "motor_raw", "size": 1})
            case fields.LineRun():
                yield {"op": "bytes", "count": part.count}
            case _:
                yield {"op": "bytes"}


def _lua(value: Any) -> str:
    """Return a value as a Lua expression; None members of tables are left out."""
    match value:
        case None:
            return "nil"
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case str():
            return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
        case Mapping():
            pairs = (f"[{_lua(key)}] = {_lua(one)}" for key, one in value.items() if one is not None)
            return "{" + ", ".join(pairs) + "}"
        case _:
            return "{" + ", ".join(map(_lua, value)) + "}"
