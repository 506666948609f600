"""The commands on one robot: show its state, stop it."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import count

from nclient.backends.base import Backend
from nclient.backends.direct import QUICK_S, send_emergency_stop
from nclient.cli import state_text
from nclient.cli.serving import print_message
from nclient.common.arguments import add_address, add_flag, add_value, seconds, whole_number
from nclient.common.process import ExitCode
from nclient.connector import Connector, address_or_default
from nclient.errors import AddressError, ConnectionLost, NomadError, ReplyTimeout, RobotRefused, ShellError, WireError
from nclient.protocol.decode import model_mismatch_hint
from nclient.protocol.types import Model
from nclient.recording.recorder import TCP
from nclient.robot import Robot
from nclient.state import RobotState
from nclient.transports.stream import ByteStream, on_error
from nclient.url import available_schemes, is_port_name, parse_address

EVERY_S = 1.0
_HOME_AND_CLEAR = "\x1b[H\x1b[J"


class StateCommand:
    """Show a robot's state with units, once or repeatedly.

        nomad state nserver://localhost:7019/1           the whole state
        nomad state sim:thesis_room sonar pose           parts: pose velocity motors sonar infrared bumpers compass ...
        nomad state --every 0.5                          twice a second, until Ctrl-C
        nomad state --count 3 clock                      three times, at intervals of a second
        nomad state --watch --json | jq .x_in              one JSON object per line

    Rules: sends gs only, and on sim: what lets its time pass. No motion timeout is set and no keep-alive sent, so
    that a robot driven by another program continues.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        parser.add_argument(
            "words", nargs="*", metavar="ADDRESS | PART",
            help=f"address of the robot (default: $NOMAD_ROBOT, or a local Nserver), and parts of the state: "
            f"{', '.join(state_text.PARTS)} (default: all)",
        )  # fmt: skip
        add_flag(parser, "--watch", "repeat until Ctrl-C; implied by --every and --count")
        add_value(parser, "--every", "S", seconds, f"repeat at intervals of S seconds (default: {EVERY_S:g})")
        add_value(parser, "--count", "N", whole_number("the number of times", 1), "repeat N times")
        add_flag(parser, "--json", "print one JSON object per line, with all parts")

    @staticmethod
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


def watch(robot: Robot, parts: list[str], looks: int | None, every_s: float, *, as_json: bool,
          sleep: Callable[[float], None]) -> None:
    """Show the state `looks` times, forever if None; on a terminal each time in the same place."""
    in_place = sys.stdout.isatty() and looks != 1 and not as_json
    for look in count() if looks is None else range(looks):
        if look:
            sleep(every_s)
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


# Time limit without --patience, seconds: enough for several reconnects.
DEFAULT_PATIENCE_S = 10.0
PAUSE_S = 0.05
"""Interval between two queries while the robot slows down, and between two connection attempts."""
_QUERIES = 20
"""Number of queries before st is sent again."""


class StopCommand:
    """Stop a robot and wait until it stands still, also over a noisy line.

        nomad stop nserver://lab:7019/2
        nomad stop "serial:///dev/ttyUSB0?model=n150" --patience 30

    Prints how often st was sent, and the robot's position. Exit code 0: the robot was seen to stand still; 1: it
    still moves, does not reply, or replies to st and cannot be understood, usually because the address has the wrong
    model.

    Rules: only st and gs are sent; no setting is changed except a N200's mask. On a serial line st is sent first,
    handshake and mask follow its reply. Errors are retried and lost connections reopened until the time is over; only
    an invalid address ends the command at once.
    """

    @staticmethod
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""
        add_address(parser)
        add_value(parser, "--patience", "S", seconds,
                  f"try for S seconds (default: {DEFAULT_PATIENCE_S:g})", DEFAULT_PATIENCE_S)

    @staticmethod
    def run(options: argparse.Namespace) -> int:
        """Stop the robot, and return the exit code."""
        connector = Connector(parse_address(address_or_default(options.address)))
        if options.address is None:
            print_message(f"stopping {connector.address.text}")
        connect = connector.open_session
        if connector.wire != TCP:
            timeout_s = QUICK_S if connector.timeout_s is None else connector.timeout_s
            start_session = partial(connector.start_session, hello=False)
            connect = StopFirstConnector(connector.open_stream, start_session, connector.model, timeout_s)
        return RobotStopper(connect, time.monotonic, time.sleep).run(options.patience)


@dataclass
class StopFirstConnector:
    """Connects to a serial line with st as the first bytes of every connection.

    Parameters
    ----------
    open_stream
        Opens the line.
    start_session
        Starts the protocol after the reply to st.
    model
        Model of the robot.
    timeout_s
        Maximum time for the reply to st.
    clock
        Returns seconds.
    """

    open_stream: Callable[[], ByteStream]
    start_session: Callable[[ByteStream], Backend]
    model: Model
    timeout_s: float = QUICK_S
    clock: Callable[[], float] = time.monotonic
    stops_sent: int = field(default=0, init=False)
    replies: list[bytes] = field(default_factory=list, init=False)
    """The data of the replies to st."""

    def __call__(self) -> Backend:
        """Connect to a robot, which has replied to st. Raises as send_emergency_stop and `start_session` do."""
        # Any exception closes the line, so that the next attempt can open it again.
        stream = self.open_stream()
        with on_error(stream.close):
            self.replies.append(send_emergency_stop(stream, self.timeout_s, self.clock, self._count_stop).data)
            return self.start_session(stream)

    def describe_unreadable(self) -> str:
        """Return a message for a robot that replied to st, but to nothing else that could be read."""
        hint = model_mismatch_hint(self.model, self.replies[-1])
        return f"st was answered, and nothing showed that it stands still{'; ' if hint else ''}{hint}"

    def _count_stop(self) -> None:
        self.stops_sent += 1


class RobotStopper:
    """Sends st to one robot until it stands still.

    Parameters
    ----------
    connect
        Opens a new connection.
    clock
        Returns seconds.
    sleep
        Waits a number of seconds.
    """

    def __init__(self, connect: Callable[[], Backend], clock: Callable[[], float],
                 sleep: Callable[[float], None]) -> None:
        self._connect = connect
        self._clock, self._sleep = clock, sleep
        self._robot: Robot | None = None
        self._errors: Counter[str] = Counter()
        self._last_state: RobotState | None = None
        self._stops_sent = 0

    def run(self, patience_s: float) -> int:
        """Try for `patience_s` at most, print the result, and return the exit code."""
        # At least one attempt, also with a patience of 0.
        deadline_s = self._clock() + patience_s
        try:
            is_still = self._try_once()
            while not is_still and self._clock() < deadline_s:
                is_still = self._try_once()
        finally:
            if self._robot is not None:
                self._robot.disconnect()
        self._report(is_still)
        return ExitCode.DONE if is_still else ExitCode.FAILED

    def _try_once(self) -> bool:
        """Send st once; return True if the robot replied and was seen to stand still."""
        try:
            robot = self._connected_robot()
            self._stops_sent += 1
            self._last_state = robot.stop()
            for _ in range(_QUERIES):
                self._last_state = robot.refresh()
                # Still: no axis reports motion, and all three velocities are 0.
                if not (self._last_state.moving or any(self._last_state.raw[38:41])):
                    return True
                self._sleep(PAUSE_S)
        except (ConnectionLost, ReplyTimeout, RobotRefused, WireError) as error:
            self._count_error(error)
            self._sleep(PAUSE_S)
        return False

    def _connected_robot(self) -> Robot:
        if self._robot is None or self._robot.closed:
            self._robot = Robot(self._connect())
        return self._robot

    def _count_error(self, error: NomadError) -> None:
        # Each message is printed once.
        text = str(error)
        self._errors[text] += 1
        if self._errors[text] == 1:
            print_message(text)

    def _report(self, is_still: bool) -> None:
        # Stops sent on connecting are counted by the connector, later ones here.
        first = self._connect if isinstance(self._connect, StopFirstConnector) else None
        count = self._stops_sent + (first.stops_sent if first else 0)
        attempts = f"st sent {count} time{'' if count == 1 else 's'}"
        if self._errors:
            attempts += f", {sum(self._errors.values())} errors"
        if is_still and self._last_state is not None:
            print(f"stands still at x {self._last_state.x_in:.1f} in, y {self._last_state.y_in:.1f} in; {attempts}")
        elif self._last_state is not None:
            print(f"NOT STOPPED: last seen at {self._last_state.translation_in_s:.1f} in/s; {attempts}")
        elif first and first.replies:
            print(f"NOT SEEN TO STOP: {first.describe_unreadable()}; {attempts}")
        else:
            print(f"NOT STOPPED: no reply; {attempts}")
