"""Turn calls into bytes and bytes into calls and replies, as JSON.

    nomad wire encode vm 100 -50 0 --line serial      01 08 00 05 ... as hex, a frame a line
    nomad wire decode 000f0000                        {"to": "robot", "call": "gs", "args": []}
    nomad wire decode --to host --call get_rc HEX     what the client holds after that reply
    nomad wire dump --line serial --model n200        reads `> hex` and `< hex` lines, prints an object for each

Rules: arguments and printing only; what bytes mean is nclient.protocol's. On stdout is what was asked for: a frame that
is none has its reason on stderr, but in a dump, where each line has its object.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from textwrap import fill
from typing import Any

from nclient.common.exit_codes import ExitCode
from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call, Command
from nclient.protocol.decode import WIRES, WireDecoder
from nclient.protocol.types import EVERYTHING, MODELS, Mask, get_model
from nclient.protocol.wire_state import serial_wire_state

_DEFAULTS = {"line": "tcp", "model": "n150"}
_ENCODE = """Print the bytes of a call as hex, a frame a line.

Arguments are integers in the order of the C call, lists laid open: tenths of an inch and of a degree;
motion_check in thousandths; the text of tk in quotes. Options go before the call or after its last argument.

    nomad wire encode vm 100 -50 0
    nomad wire encode vm 100 -50 0 --line serial --model n150
    nomad wire encode connect_robot 1 --pid 4711 --line tcp64
    nomad wire encode ct --mask 2,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,0,0,0
    nomad wire encode special_request 1 2 3 --packet-type 200
    nomad wire encode tk "Where am I?" --line serial --model n200

On a robot's own line place_robot is two frames, dp and da.

The calls:

""" + fill(" ".join(BY_NAME), 100, initial_indent="    ", subsequent_indent="    ")
_LIST = "nomad wire encode --help lists them all"
_DECODE = """Print one frame as a JSON object; exit code 1 and nothing on stdout when it is no good frame.

    nomad wire decode 000c000300000064ffffffce00000000
    nomad wire decode --line serial 0108000564003280 0000245c
    nomad wire decode --to host --call get_rc 00580004fffffd0efffffc5300001dc800002036

Over TCP a reply does not name its command: without --call it is read by its type. --mask and --laser-mode say
what the two ends had agreed before; at the start all is on and the mode is 51."""
_DUMP = """Read lines `> hex` (to the robot) and `< hex` (from it), print one JSON object for each line.

    {"to": "robot", "call": "vm", "args": [100, -50, 0]}
    {"to": "host", "reply": "state", "State": [45 numbers], "Laser": [...], "positions": {...}, "clock": ...,
     "volt_cpu": ..., "volt_motor": ...}      what the client holds after the reply, null for what it never had
    {"error": "..."}                          a line that is no good frame, an empty one included

Mask and laser mode are followed as the two ends do. With --line serial --model n200 the eleven bytes that the
robot sends first over TCP may be the first line from it.

    printf '> 000f0000\\n' | nomad wire dump"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """encode, decode, dump; --line and --model before or after them."""
    _add_line(parser)
    verbs = parser.add_subparsers(dest="verb", metavar="encode|decode|dump", required=True)
    encode = _add_verb(verbs, "encode", _ENCODE)
    encode.add_argument("call", help="the C name, such as vm, get_sn, special_request")
    encode.add_argument("args", nargs="*", help="its arguments")
    encode.add_argument("--pid", type=int, default=1, help="the client's process id for connect_robot (default: 1)")
    encode.add_argument("--packet-type", type=int, help="the packet type of special_request")
    encode.add_argument("--mask", type=_mask, default=EVERYTHING, help="ct's 44 numbers (default: all on)")
    decode = _add_verb(verbs, "decode", _DECODE)
    decode.add_argument("hex", nargs="+", action=_Hex, help="the bytes of one frame")
    decode.add_argument("--to", choices=("robot", "host"), default="robot", help="where it went (default: robot)")
    decode.add_argument("--call", help="the call that the reply answers")
    decode.add_argument("--mask", type=_mask, help="the 44 numbers of Smask in force")
    decode.add_argument("--laser-mode", type=int, help="the mode that conf_ls set last")
    _add_verb(verbs, "dump", _DUMP)
    parser.set_defaults(**_DEFAULTS)


def _add_verb(verbs: Any, name: str, description: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        name, help=description.partition("\n")[0], description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_line(parser)
    return parser


def _add_line(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--line", choices=WIRES, default=argparse.SUPPRESS,
        help="an Nserver's clients of 32 or 64 bits, or a robot's own line (default: tcp)",
    )
    parser.add_argument(
        "--model", choices=tuple(MODELS), default=argparse.SUPPRESS,
        help="whose own line it is; of no account over TCP (default: n150)",
    )


def run(options: argparse.Namespace) -> int:
    """Do what the options say; the exit code."""
    match options.verb:
        case "encode":
            return _encode(options)
        case "decode":
            return _decode(options)
        case _:
            return _dump(options)


def _encode(options: argparse.Namespace) -> int:
    model = get_model(options.model)
    for call in _calls(options):
        if options.line == "serial":
            print(codec.encode_serial_request(call, serial_wire_state(model)).hex())
        else:
            print(codec.encode_tcp_request(call, wide=options.line == "tcp64").hex())
    return ExitCode.DONE


def _calls(options: argparse.Namespace) -> Iterator[Call]:
    """The calls as the table has them, out of the arguments of the C call."""
    row = _row(options.call)
    if row.name == "tk":
        yield Call(row.name, (" ".join(options.args),))
        return
    args = tuple(_number(word) for word in options.args)
    if row.name == "place_robot" and options.line == "serial" and len(args) == 4:
        yield from (Call("dp", args[:2]), Call("da", args[2:]))
        return
    yield Call(row.name, _with_beside(row.extra_arguments[0], args, options) if row.extra_arguments else args)


def _with_beside(name: str, args: tuple[float, ...], options: argparse.Namespace) -> tuple[float, ...]:
    if name == "pid":
        return (*args, options.pid)
    if name == "mask":
        if args:
            raise WireError("ct takes no arguments; give the mask with --mask")
        mask: Mask = options.mask
        return mask.smask
    if options.packet_type is None:
        raise WireError("special_request needs its --packet-type")
    return (options.packet_type, *args)


def _decode(options: argparse.Namespace) -> int:
    transcript = WireDecoder(options.line, get_model(options.model))
    if options.mask:
        transcript.wire_state.set_mask(options.mask)
    if options.laser_mode is not None:
        transcript.wire_state.set_laser_mode(options.laser_mode)
    if options.call:
        transcript.expect(_row(options.call).name)
    found = transcript.request(options.hex) if options.to == "robot" else transcript.reply(options.hex)
    if "error" in found:
        raise WireError(found["error"])
    print(json.dumps(found))
    return ExitCode.DONE


def _dump(options: argparse.Namespace) -> int:
    transcript = WireDecoder(options.line, get_model(options.model))
    for line in sys.stdin.buffer:
        print(json.dumps(transcript.read(line.decode("utf-8", "replace"))), flush=True)
    return ExitCode.DONE


def _row(name: str) -> Command:
    if name not in BY_NAME:
        raise WireError(f"{codec.describe_unknown_command(name)}; {_LIST}")
    return BY_NAME[name]


class _Hex(argparse.Action):
    """Words of hex, which may be cut anywhere, as the bytes that they are together."""

    def __call__(self, parser: object, namespace: Any, values: Any, option_string: object = None) -> None:
        del parser, option_string
        try:
            setattr(namespace, self.dest, bytes.fromhex("".join(values)))
        except ValueError:
            raise argparse.ArgumentError(self, f"no hex, two digits a byte: {' '.join(values):.60}") from None


def _number(word: str) -> float:
    try:
        return int(word)
    except ValueError:
        pass
    try:
        return float(word)
    except ValueError:
        raise WireError(f"a number is wanted, not {word!r}") from None


def _mask(text: str) -> Mask:
    try:
        return Mask(tuple(int(word) for word in text.replace(",", " ").split()))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
