"""Show a robot's state with units, once or repeatedly.

    nomad state nserver://localhost:7019/1               the whole state
    nomad state sim:thesis_room sonar pose               parts: pose velocity motors sonar infrared bumpers compass ...
    nomad state --every 0.5                              twice a second, until Ctrl-C
    nomad state --count 3 clock                          three times, at intervals of a second
    nomad state --watch --json | jq .x_in                one JSON object per line

Rules: sends gs only, and on sim: what lets its time pass. No motion timeout is set and no keep-alive sent, so that a
robot driven by another program continues.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable

from nclient.cli import state_text
from nclient.common.arguments import add_flag, add_value, seconds, whole_number
from nclient.common.process import ExitCode
from nclient.connector import Connector, address_or_default
from nclient.errors import AddressError, ShellError
from nclient.robot import Robot
from nclient.url import available_schemes, is_port_name, parse_address

EVERY_S = 1.0
_HOME_AND_CLEAR = "\x1b[H\x1b[J"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "words",
        nargs="*",
        metavar="ADDRESS | PART",
        help=f"address of the robot (default: $NOMAD_ROBOT, or a local Nserver), and parts of the state: "
        f"{', '.join(state_text.PARTS)} (default: all)",
    )
    add_flag(parser, "--watch", "repeat until Ctrl-C; implied by --every and --count")
    add_value(parser, "--every", "S", seconds, f"repeat at intervals of S seconds (default: {EVERY_S:g})")
    add_value(parser, "--count", "N", whole_number("the number of times", 1), "repeat N times")
    add_flag(parser, "--json", "print one JSON object per line, with all parts")


def run(options: argparse.Namespace) -> int:
    """Show the state, and return the exit code."""
    address, parts = _sorted_words(options.words)
    connector = Connector(parse_address(address_or_default(address)))
    is_in_process = connector.address.in_process
    robot = Robot(connector.open_session(), lockstep=is_in_process)
    watching = options.watch or options.every is not None or options.count is not None
    every_s = EVERY_S if options.every is None else options.every

    def sleep(seconds: float) -> None:
        # A simulation in this process has no time of its own.
        if is_in_process:
            robot.sleep(seconds)
        time.sleep(seconds)

    try:
        watch(robot, parts, options.count if watching else 1, every_s, as_json=options.json, sleep=sleep)
    except KeyboardInterrupt:
        # The usual end of --watch.
        return ExitCode.DONE
    finally:
        robot.disconnect()
    return ExitCode.DONE


def watch(
    robot: Robot, parts: list[str], looks: int | None, every_s: float, *, as_json: bool, sleep: Callable[[float], None]
) -> None:
    """Show the state `looks` times, forever if None; on a terminal each time in the same place."""
    in_place = sys.stdout.isatty() and looks != 1 and not as_json
    looked = 0
    while looks is None or looked < looks:
        if looked:
            sleep(every_s)
        looked += 1
        state = robot.refresh()
        if as_json:
            print(json.dumps(state_text.as_json(state)), flush=True)
        else:
            print(_HOME_AND_CLEAR * in_place + "\n".join(state_text.format_parts(state, parts)), flush=True)


def _sorted_words(words: list[str]) -> tuple[str | None, list[str]]:
    """Separate the address, which has a colon, from the parts. Raises AddressError for any other word."""
    addresses = [word for word in words if ":" in word or is_port_name(word)]
    parts = [word for word in words if word not in addresses]
    if len(addresses) > 1:
        raise AddressError(f"one robot at a time, not {' and '.join(addresses)}")
    try:
        state_text.check_parts(parts)
    except ShellError as error:
        schemes = ", ".join(f"{scheme}:" for scheme in available_schemes())
        raise AddressError(f"{error}; an address begins with one of {schemes}") from None
    return (addresses[0] if addresses else None), parts
