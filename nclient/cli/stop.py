"""Stop a robot, whatever it takes: st until it is answered and the robot stands still, over a noisy line, too.

    nomad stop nserver://lab:7019/2
    nomad stop "serial:///dev/ttyUSB0?model=n150" --patience 30

Says how often it was told, and where it stands. Exit code 0: it was seen to stand still; 1: it moves on, nobody
answered, or it answered st and could not be understood, most often since the address names another model.

Rules: st and gs only; nothing is set but a N200's mask, nothing is fed. On a robot's own line the first bytes of every
conversation are st, and hello and mask come once that was answered. Whatever goes wrong on the way is tried again
until patience ends, a connection that broke is made anew; only an address that makes no sense ends it at once.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable

from nclient.backends.base import Backend
from nclient.backends.direct import QUICK_S, send_emergency_stop
from nclient.cli.serving import print_message
from nclient.common.arguments import seconds
from nclient.common.exit_codes import ExitCode
from nclient.connect import Connector, address_or_default
from nclient.errors import ConnectionLost, NomadError, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.decode import model_mismatch_hint
from nclient.protocol.types import Model
from nclient.recording.recorder import TCP
from nclient.robot import Robot
from nclient.state import RobotState
from nclient.transports.stream import ByteStream
from nclient.url import parse_address

PATIENCE_S = 10.0
PAUSE_S = 0.05
"""Between two looks at a robot that still rolls out, and before a connection is tried again."""
_LOOKS = 20
"""Looks at it before it is told again."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """An address, and how long to try."""
    parser.add_argument("address", nargs="?", metavar="ADDRESS",
                        help="such as nserver://localhost:7019/1 or serial:///dev/ttyUSB0 (default: NOMAD_ROBOT, or a "
                             "local nserver's robot 1)")
    parser.add_argument("--patience", type=seconds, default=PATIENCE_S, metavar="S",
                        help=f"seconds to go on trying (default {PATIENCE_S:g})")


def run(options: argparse.Namespace) -> int:
    """Stop it; the exit code."""
    connector = Connector(parse_address(address_or_default(options.address)))
    if options.address is None:
        print_message(f"stopping {connector.address.text}")
    opens = connector.open_session if connector.wire == TCP else _on_line(connector)
    return Stopping(opens, time.monotonic, time.sleep).run(options.patience)


def _on_line(connector: Connector) -> StopFirst:
    patience_s = QUICK_S if connector.timeout_s is None else connector.timeout_s
    return StopFirst(
        connector.open_stream,
        lambda stream: connector.start_session(stream, hello=False),
        connector.model,
        patience_s,
    )


class StopFirst:
    """Opens conversations on a robot's own line whose first bytes are st. `opens` the line, `talks` what comes then."""

    def __init__(
        self,
        opens: Callable[[], ByteStream],
        talks: Callable[[ByteStream], Backend],
        model: Model,
        patience_s: float = QUICK_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._opens, self._talks = opens, talks
        self._model, self._patience_s, self._clock = model, patience_s, clock
        self.told = 0
        self.answers: list[bytes] = []

    def __call__(self) -> Backend:
        """A conversation with a robot that has answered st. Raises as say_stop and `talks`."""
        stream = self._opens()
        try:
            self.answers.append(send_emergency_stop(stream, self._patience_s, self._clock, self._tell).data)
            return self._talks(stream)
        except BaseException:
            stream.close()
            raise

    def remedy(self) -> str:
        """What is left to say where st was answered, and nothing after it could be read."""
        hint = model_mismatch_hint(self._model, self.answers[-1])
        return f"st was answered, and nothing showed that it stands still{'; ' if hint else ''}{hint}"

    def _tell(self) -> None:
        self.told += 1


class Stopping:
    """One robot on its way to a standstill. `opens`: a new conversation; `clock` gives seconds, `sleep` passes them."""

    def __init__(
        self, opens: Callable[[], Backend], clock: Callable[[], float], sleep: Callable[[float], None]
    ) -> None:
        self._opens = opens
        self._clock, self._sleep = clock, sleep
        self._robot: Robot | None = None
        self._troubles: Counter[str] = Counter()
        self._last: RobotState | None = None
        self._told = 0

    def run(self, patience_s: float) -> int:
        """Try until it stands still or patience ends; says what came of it; the exit code."""
        deadline_s = self._clock() + patience_s
        try:
            stands = self._try()
            while not stands and self._clock() < deadline_s:
                stands = self._try()
        finally:
            self._hang_up()
        self._report(stands)
        return ExitCode.DONE if stands else ExitCode.FAILED

    def _try(self) -> bool:
        """Tell it once more; whether it answered that, and was seen to stand still."""
        try:
            robot = self._connected()
            self._told += 1
            self._last = robot.stop()
            for _ in range(_LOOKS):
                self._last = robot.refresh()
                if not (self._last.moving or any(self._last.raw[38:41])):
                    return True
                self._sleep(PAUSE_S)
        except (ConnectionLost, ReplyTimeout, RobotRefused, WireError) as error:
            self._note(error)
            self._sleep(PAUSE_S)
        return False

    def _connected(self) -> Robot:
        if self._robot is None or self._robot.closed:
            self._robot = Robot(self._opens())
        return self._robot

    def _note(self, error: NomadError) -> None:
        text = str(error)
        self._troubles[text] += 1
        if self._troubles[text] == 1:
            print_message(text)

    def _hang_up(self) -> None:
        if self._robot is not None:
            self._robot.disconnect()

    def _report(self, stands: bool) -> None:
        first = self._opens if isinstance(self._opens, StopFirst) else None
        told = self._told + (first.told if first else 0)
        times = f"told {told} time{'' if told == 1 else 's'}"
        if self._troubles:
            times += f", {sum(self._troubles.values())} faults on the way"
        if stands and self._last is not None:
            print(f"stands still at x {self._last.x_in:.1f} in, y {self._last.y_in:.1f} in; {times}")
        elif self._last is not None:
            print(f"NOT STOPPED: last seen at {self._last.translation_in_s:.1f} in/s; {times}")
        elif first and first.answers:
            print(f"NOT SEEN TO STOP: {first.remedy()}; {times}")
        else:
            print(f"NOT STOPPED: nobody answered; {times}")
