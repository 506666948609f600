"""Show a robot's state in words, once or again and again; moves nothing, sets nothing.

    nomad state nserver://localhost:7019/1               all that it tells, with units
    nomad state sim:thesis_room sonar pose               parts: pose velocity motors sonar infrared bumpers compass ...
    nomad state --every 0.5                              anew twice a second, until Ctrl-C
    nomad state --count 3 clock                          three times, a second between two
    nomad state --watch --json | jq .x_in                an object a line, for programs

Rules: options and printing only; what a state looks like is nclient.cli.state_text's. Asks gs; the link is not dressed:
no time-out of motion is set, nobody is fed, and a robot that somebody else drives goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

from nclient.cli import state_text
from nclient.common.arguments import seconds
from nclient.common.exit_codes import ExitCode
from nclient.connect import Connector, address_or_default
from nclient.errors import AddressError, ShellError
from nclient.robot import Robot
from nclient.url import available_schemes, parse_address

EVERY_S = 1.0
_HOME_AND_CLEAR = "\x1b[H\x1b[J"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """An address, parts of the state, and how often."""
    parser.add_argument("words", nargs="*", metavar="ADDRESS | PART",
                        help=f"an address (default: $NOMAD_ROBOT, or this machine's Nserver), and parts of the state: "
                        f"{', '.join(state_text.PARTS)} (default: all)")
    parser.add_argument("--watch", action="store_true",
                        help="look again and again, until Ctrl-C; --every or --count alone means it, too")
    parser.add_argument("--every", type=seconds, metavar="S",
                        help=f"watch, with so many seconds between two looks (default {EVERY_S:g})")
    parser.add_argument("--count", type=_count, metavar="N", help="watch, and end after so many looks")
    parser.add_argument("--json", action="store_true", help="print an object a line, of all parts")


def run(options: argparse.Namespace) -> int:
    """Look and tell; the exit code."""
    address, parts = _sorted_words(options.words)
    robot = Robot(Connector(parse_address(address_or_default(address))).open_session())
    watching = options.watch or options.every is not None or options.count is not None
    every_s = EVERY_S if options.every is None else options.every
    try:
        watch(robot, parts, options.count if watching else 1, every_s, as_json=options.json, sleep=time.sleep)
    except KeyboardInterrupt:
        return ExitCode.DONE  # which is how one ends it
    finally:
        robot.disconnect()
    return ExitCode.DONE


def watch(
    robot: Robot, parts: list[str], looks: int | None, every_s: float, *, as_json: bool, sleep: Callable[[float], None]
) -> None:
    """Show the state so often, for ever where `looks` is None; on a terminal each time in the same place."""
    in_place = sys.stdout.isatty() and looks != 1 and not as_json
    looked = 0
    while looks is None or looked < looks:
        if looked:
            sleep(every_s)
        looked += 1
        state = robot.refresh()
        if as_json:
            print(json.dumps(state_text.as_object(state)), flush=True)
        else:
            print(_HOME_AND_CLEAR * in_place + "\n".join(state_text.lines(state, parts)), flush=True)


def _sorted_words(words: list[str]) -> tuple[str | None, list[str]]:
    """The address among the words, which has a colon, and the parts. Raises AddressError for what is neither."""
    addresses = [word for word in words if ":" in word]
    parts = [word for word in words if ":" not in word]
    if len(addresses) > 1:
        raise AddressError(f"one robot at a time, not {' and '.join(addresses)}")
    try:
        state_text.check(parts)
    except ShellError as error:
        schemes = ", ".join(f"{scheme}:" for scheme in available_schemes())
        raise AddressError(f"{error}; an address begins with one of {schemes}") from None
    return (addresses[0] if addresses else None), parts


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or not int(text):
        raise argparse.ArgumentTypeError(f"a whole number above 0, not {text}")
    return int(text)
