"""Encode calls to bytes, and decode bytes to calls and replies as JSON.

    nomad wire encode vm 100 -50 0 --line serial      01 08 00 05 ... as hex, one frame per line
    nomad wire decode 000f0000                        {"to": "robot", "call": "gs", "args": []}
    nomad wire decode --to host --call get_rc HEX     the client's state after that reply
    nomad wire dump --line serial --model n200        reads `> hex` and `< hex` lines, prints an object for each
    nomad wire dissector >nomad.lua                   a dissector for Wireshark and tshark

Results go to stdout. The reason why a frame is invalid goes to stderr, except in a dump, which has an object per line.

Calls have the names and arguments of the C interface, Nclient.h. Four of them need a word here:

    ct               select what a state reply contains, by a mask of 44 numbers: mask[i] is 1 if State[i] is sent,
                     otherwise 0, for i from 1 to 43; the bits of mask[0], 0 to 31, select position data
    tk               say a text (Nomad 200)
    place_robot      set the pose; the serial line has two commands for it, dp (position) and da (angles)
    special_request  send a packet of any type
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import resources
from inspect import getdoc
from textwrap import fill
from typing import Any, Final

from nclient.common.process import ExitCode
from nclient.errors import WireError
from nclient.protocol import codec, commands, layouts, types
from nclient.protocol import decode as wire
from nclient.protocol import replies as shape
from nclient.protocol.commands import BY_NAME, Call, Command
from nclient.protocol.decode import WIRES, WireDecoder
from nclient.protocol.replies import LineLayout, TcpLayout
from nclient.protocol.serial_framing import HOST_LIMIT, ROBOT_LIMIT
from nclient.protocol.types import CPU_RANGE_V, EVERYTHING, MODELS, MOTOR_RANGE_V, Mask, get_model, serial_wire_state


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add encode, decode, dump and dissector; --line and --model may stand before or after them."""
    verbs = parser.add_subparsers(dest="verb", metavar="encode|decode|dump|dissector", required=True)
    _add_encode(verbs)
    _add_decode(verbs)
    _add_verb(verbs, "dump", _dump)
    _add_verb(verbs, "dissector", _dissector)
    _add_protocol(parser)
    parser.set_defaults(line="tcp", model="n150")


def _add_encode(verbs: Any) -> None:
    calls = fill(" ".join(BY_NAME), 100, initial_indent="    ", subsequent_indent="    ")
    encode = _add_verb(verbs, "encode", _encode, f"\n\nCalls:\n\n{calls}")
    encode.add_argument("call", metavar="CALL", help="C name, such as vm, get_sn, special_request")
    encode.add_argument("args", nargs="*", metavar="ARG", help="arguments of the call")
    encode.add_argument("--pid", type=int, default=1, help="process id that connect_robot sends (default: 1)")
    encode.add_argument("--packet-type", type=int, metavar="N", help="packet type of special_request")
    encode.add_argument("--mask", type=_mask, default=EVERYTHING, help="44 numbers that ct sends (default: all on)")


def _add_decode(verbs: Any) -> None:
    decode = _add_verb(verbs, "decode", _decode)
    decode.add_argument("hex", nargs="+", metavar="HEX", action=_JoinHex, help="bytes of one frame")
    decode.add_argument("--to", choices=("robot", "host"), default="robot",
                        help="direction of the frame (default: robot)")  # fmt: skip
    decode.add_argument("--call", metavar="CALL", help="decode as the reply to this call")
    decode.add_argument("--mask", type=_mask, default=EVERYTHING,
                        help="44 numbers of the mask in force (default: all on)")  # fmt: skip
    decode.add_argument("--laser-mode", type=int, metavar="N", help="laser mode in force (default: 51)")


def _add_verb(verbs: Any, name: str, execute: Callable[[argparse.Namespace], int],
              more: str = "") -> argparse.ArgumentParser:
    """Add the parser of a verb, with the first line of its function's description as its help."""
    description = f"{getdoc(execute)}{more}"
    about = description.partition("\n")[0].removesuffix(".")
    raw = argparse.RawDescriptionHelpFormatter
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=about, description=description, formatter_class=raw)
    parser.set_defaults(execute=execute)
    _add_protocol(parser)
    return parser


def _add_protocol(parser: argparse.ArgumentParser) -> None:
    """Add --line and --model.

    Both may stand before or after the verb, so the parser of `nomad wire` and that of each verb have them. The defaults
    are set by `add_arguments`, once: the parser of the verb comes last, and must not replace what the first one read.
    """
    parser.add_argument("--line", choices=WIRES, default=argparse.SUPPRESS,
                        help="protocol: Nserver's for 32-bit or 64-bit clients, or the serial line's (default: tcp)")
    parser.add_argument("--model", choices=tuple(MODELS), default=argparse.SUPPRESS,
                        help="model of the robot on the serial line (default: n150)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Run encode, decode, dump or dissector, and return the exit code."""
    code: int = options.execute(options)
    return code


def _encode(options: argparse.Namespace) -> int:
    """Print the bytes of a call as hex, one frame per line.

    Arguments are integers in the order of the C call, arrays flattened: tenths of an inch and of a degree;
    motion_check in thousandths; the text of tk in quotes. Options go before the call or after its last argument.

        nomad wire encode vm 100 -50 0
        nomad wire encode vm 100 -50 0 --line serial --model n150
        nomad wire encode connect_robot 1 --pid 4711 --line tcp64
        nomad wire encode ct --mask 2,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,0,0,0
        nomad wire encode special_request 1 2 3 --packet-type 200
        nomad wire encode tk "Where am I?" --line serial --model n200

    On the serial line place_robot is two frames, dp and da.
    """  # noqa: E501   the 44 numbers of a mask in one line, to be copied
    model = get_model(options.model)
    for call in _calls(options):
        if options.line == "serial":
            print(codec.encode_serial_request(call, serial_wire_state(model)).hex())
        else:
            print(codec.encode_tcp_request(call, wide=options.line == "tcp64").hex())
    return ExitCode.DONE


def _calls(options: argparse.Namespace) -> Iterator[Call]:
    """Yield the calls to encode: one, or two for place_robot on the serial line."""
    command = _find_command(options.call)
    # 1. The only call with a text.
    if command.name == "tk":
        yield Call("tk", (" ".join(options.args),))
        return
    # 2. Position and angles, if there are four numbers; if not, the encoder's error says so.
    args = tuple(_number(word) for word in options.args)
    if command.name == "place_robot" and options.line == "serial" and len(args) == 4:
        x, y, steering, turret = args
        yield Call("dp", (x, y))
        yield Call("da", (steering, turret))
        return
    # 3. All others, with the one argument that some frames have and the C call has not.
    if command.extra_arguments is not None:
        name, _ = command.extra_arguments
        args = _with_extra_argument(name, args, options)
    yield Call(command.name, args)


def _with_extra_argument(name: str, args: tuple[float, ...], options: argparse.Namespace) -> tuple[float, ...]:
    """Return the arguments of a frame, in its order.

    Parameters
    ----------
    name
        The argument that comes from an option: "pid", last in its frames; "mask", the only one of its frame;
        "packet_type", first in its frame.
    args
        Those of the C call.
    """
    match name:
        case "pid":
            return (*args, options.pid)
        case "mask":
            if args:
                raise WireError("ct takes no arguments; give the mask with --mask")
            mask: Mask = options.mask
            return mask.smask
        case _:
            if options.packet_type is None:
                raise WireError("special_request needs its --packet-type")
            return (options.packet_type, *args)


def _decode(options: argparse.Namespace) -> int:
    """Print one frame as a JSON object; exit code 1 and nothing on stdout if the frame is invalid.

        nomad wire decode 000c000300000064ffffffce00000000
        nomad wire decode --line serial 0108000564003280 0000245c
        nomad wire decode --to host --call get_rc 00580004fffffd0efffffc5300001dc800002036

    Over TCP a reply does not name its command: without --call it is read by its type. --mask and --laser-mode set
    the state of the connection; by default all sensors are on and the laser mode is 51.
    """
    decoder = WireDecoder(options.line, get_model(options.model))
    # 1. State of the connection: it decides the layout of state replies.
    decoder.wire_state.set_mask(options.mask)
    if options.laser_mode is not None:
        decoder.wire_state.set_laser_mode(options.laser_mode)
    # 2. The command that a reply belongs to, if it was named.
    if options.call:
        decoder.expect(_find_command(options.call).name)
    # 3. One frame in the stated direction.
    decoded = decoder.request(options.hex) if options.to == "robot" else decoder.reply(options.hex)
    if "error" in decoded:
        raise WireError(decoded["error"])
    print(json.dumps(decoded))
    return ExitCode.DONE


def _dump(options: argparse.Namespace) -> int:
    r"""Read lines `> hex` (to the robot) and `< hex` (from it), print one JSON object for each line.

        {"to": "robot", "call": "vm", "args": [100, -50, 0]}
        {"to": "host", "reply": "state", "State": [45 numbers], "Laser": [...], "positions": {...}, "clock": ...,
         "volt_cpu": ..., "volt_motor": ...}      the client's state after the reply, null for values it never got
        {"error": "..."}                          a line that is no valid frame, an empty one included

    Requests that change mask or laser mode apply to later lines. With --line serial --model n200 the first line from
    the robot may be the eleven bytes that it sends first over TCP.

        printf '> 000f0000\n' | nomad wire dump
    """
    decoder = WireDecoder(options.line, get_model(options.model))
    # Bytes that are no UTF-8 become replacement characters, and an error object like any other invalid line.
    for line in sys.stdin.buffer:
        print(json.dumps(decoder.read(line.decode("utf-8", "replace"))), flush=True)
    return ExitCode.DONE


def _dissector(_options: argparse.Namespace) -> int:
    """Print a dissector for Wireshark and tshark in Lua, generated from the command table.

    It shows the Nserver protocol, of 32-bit and 64-bit clients, and the serial protocol over TCP: on the ports 7019
    and 65001, on those of the preferences, and on any other where the start of a connection is in the capture.

        nomad wire dissector >nomad.lua
        tshark -X lua_script:nomad.lua -r capture.pcap -Y nomad
    """
    print(build_dissector(), end="")
    return ExitCode.DONE


def _find_command(name: str) -> Command:
    if name not in BY_NAME:
        raise WireError(f"{codec.describe_unknown_command(name)}; nomad wire encode --help lists them all")
    return BY_NAME[name]


class _JoinHex(argparse.Action):
    """Converts hex digits, which may be split over several words at any place, to bytes."""

    def __call__(self, _: object, namespace: Any, values: Any, _option: object = None) -> None:
        try:
            setattr(namespace, self.dest, bytes.fromhex("".join(values)))
        except ValueError:
            raise argparse.ArgumentError(self, f"no hex, two digits a byte: {' '.join(values):.60}") from None


def _number(word: str) -> float:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(word)
    raise WireError(f"expected a number, not {word!r}")


def _mask(text: str) -> Mask:
    try:
        return Mask(tuple(int(word) for word in text.replace(",", " ").split()))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


# The Wireshark dissector: dissector.lua with the tables of commands and replies written into it.
#
# The program in Lua reads messages by tables only; `build_dissector` writes them from the command table, so that a new
# command appears in Wireshark without a change there.

_TABLE_MARK: Final = "--@TABLE@\n"
# Names of the 45 State slots in Wireshark's filters: nomad.speed, nomad.ir_0, ...
_SLOTS: Final = (
    "speed", *types.INFRARED_KEYS, *types.SONAR_KEYS, "bumper", "x", "y", "steer", "turret", "v_trans", "v_steer",
    "v_turret", "motors", "laser_mode", "compass", "state_error",
)
_UNITS: Final = {
    "x": "1/10 in", "y": "1/10 in", "steer": "1/10 deg", "turret": "1/10 deg", "v_trans": "1/10 in/s",
    "v_steer": "1/10 deg/s", "v_turret": "1/10 deg/s", "compass": "1/10 deg", "clock": "ms", "pose_time": "ms",
    "sensor_time": "ms", **dict.fromkeys(types.SONAR_KEYS, "in"),
}
_STAMP_PARTS: Final = ("x", "y", "steer", "turret", "v_trans", "v_steer", "v_turret", "pose_time", "sensor_time")
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
_FORMS: Final[dict[type, str]] = {
    layouts.TcpMask: "mask", layouts.LineMask: "mask", layouts.TextWords: "text", layouts.LineText: "text",
    layouts.ByteWords: "packet", layouts.UserPacket: "packet", layouts.ArmPacket: "packet",
    layouts.MotionWords: "motion", layouts.ObstacleWords: "obstacle",
}
_FIELDS: Final = {
    id(layouts.LINE_SIGNED): "signed", id(layouts.LINE_UNSIGNED): "unsigned", id(layouts.LINE_BYTE): "byte",
    id(layouts.HISTORY_BYTE): "byte", id(layouts.FLAG_BYTE): "flag", id(layouts.LASER_MODE_BYTE): "laser_mode",
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
    arguments = {_argument_field(row, argument.name): f"{argument.name.replace('_', ' ')} ({row.name})"
                 for row in commands.COMMANDS for argument in row.arguments if row.name not in ("ct", "tk")}
    slots = {name: _label(name) for name in _SLOTS}
    stamps = {f"position.{name}": _label(name) for name in _STAMP_PARTS}
    return {
        "INTEGER_FIELDS": list(map(list, (_INTEGERS | slots | stamps | arguments).items())),
        "REAL_FIELDS": list(map(list, _REALS.items())),
        "TEXT_FIELDS": list(map(list, (_TEXTS | {"tk.text": "text (tk)"}).items())), "SLOTS": list(_SLOTS),
        "STAMP_KEYS": {int(bit): list(keys) for bit, keys in types.STAMP_KEYS.items()},
        "EVERYTHING": list(EVERYTHING.smask), "NO_MASK_MODELS": list(types.NO_MASK_MODELS.smask),
        "TCP_LINE_MODES": sorted(types.TCP_LINE_MODES), "POINT_MODES": sorted(types.POINT_MODES),
        "MAX_LASER_READINGS": layouts.MAX_LASER_READINGS,
        "MAX_OBSTACLE_VERTICES": layouts.MAX_OBSTACLE_VERTICES, "MAX_UNKNOWN_WORDS": codec.MAX_UNKNOWN_WORDS,
        "MAX_REPLY_WORDS": commands.MAX_REPLY_WORDS, "HOST_LIMIT": HOST_LIMIT, "ROBOT_LIMIT": ROBOT_LIMIT,
        "CPU_RANGE_V": CPU_RANGE_V, "MOTOR_RANGE_V": MOTOR_RANGE_V, "NAK_TYPE": commands.NAK_TYPE,
        "ERROR_TYPE": commands.ERROR_TYPE, "ERROR_LAYOUT": _tcp_layout(shape.ERROR), "SAME_SHAPE": wire.SAME_SHAPE,
        "BY_REPLY_TYPE": {number: [_tcp_layout(one) for one in found] for number, found in wire.BY_REPLY_TYPE.items()},
    }  # fmt: skip


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
        "name": row.name, "arguments": [_argument_field(row, argument.name) for argument in row.arguments],
        "any_length": row.any_length, "words": list(row.tcp_words),
        "has_reply": row.has_tcp_reply and row.tcp_type is not None, "reply": _tcp_layout(row.tcp_reply),
        "reply_type": commands.REPLY_TYPES[row.tcp_reply], "line_type": row.line_type, "line_kind": row.line_reply.kind,
        "line_reply": list(_line_parts(row.line_reply)), "models": dict.fromkeys(sorted(row.line_models), True),
        "only_n200": row.line_models == commands.N200, "flags": [argument.is_flag for argument in row.arguments],
    }  # fmt: skip
    # Arguments that are not one word or one field each.
    entry |= {"tcp_form": _FORMS.get(type(row.tcp_request)), "line_form": _FORMS.get(type(row.line_request))}
    if isinstance(row.tcp_request, layouts.ObstacleWords):
        entry["tail"] = row.tcp_request.tail
    if isinstance(row.line_request, layouts.ArmPacket):
        # Sizes in bytes of the packet's fields, negative for signed ones.
        entry["packet"] = [-element.sizeof() if element is layouts.ARM_NUMBER else element.sizeof()
                           for element in row.line_request.elements]
    elif not entry["line_form"]:
        entry["line"] = [_FIELDS[id(argument.line)] for argument in row.arguments]
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
            case layouts.LineNibbles() | layouts.BumperBytes():
                op = "bumper" if isinstance(part, layouts.BumperBytes) else "nibbles"
                yield {"op": op, "first": part.slots[0], "last": part.slots[-1], "masked": part.masked}
            case layouts.LineSlots():
                yield {"op": "slots", "first": part.slots[0], "last": part.slots[-1], "masked": part.masked,
                       "size": part.run.octets, "signed": bool(part.run.sign)}
            case layouts.LineStamps():
                yield {"op": "stamps", "bit": part.wanted, "first": part.slots[0] if part.slots else None}
            case layouts.LineLaser():
                # A state packet has the width of the laser mode, written as 0; the others have their own.
                width = 0 if part.masked_by else types.LINES if layout is shape.LINE_SEGMENTS else 1
                yield {"op": "laser", "width": width, "masked_by": part.masked_by}
            case _ if name == "clock":
                yield {"op": "clock", "size": 4}
            case _ if name == "volts":
                yield from ({"op": "cpu_raw", "size": 1}, {"op": "motor_raw", "size": 1})
            case layouts.LineRun():
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
