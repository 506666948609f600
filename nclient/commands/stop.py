"""Stop a robot, whatever it takes: st until it is answered and the robot stands still, over a noisy line, too.

    nomad stop nserver://lab:7019/2
    nomad stop "serial:///dev/ttyUSB0?model=n150" --patience 30

Says how often it was told, and where it stands. Exit code 0: it stands still; 1: it moves on, or nobody answered.

Rules: st and gs only; nothing is set, nothing is fed. Whatever goes wrong on the way is tried again until patience
ends, a connection that broke is made anew; only an address that makes no sense ends it at once.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable

from nclient.backends.backend import Backend
from nclient.commands.serving import tell
from nclient.errors import ConnectionLost, NomadError, ReplyTimeout, RobotRefused, WireError
from nclient.robot import Robot
from nclient.robot_state import RobotState
from nclient.schemes import Wanted, opening_of

PATIENCE_S = 10.0
PAUSE_S = 0.05
"""Between two looks at a robot that still rolls out, and before a connection is tried again."""
_LOOKS = 20
"""Looks at it before it is told again."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """An address, and how long to try."""
    parser.add_argument("address", help="such as nserver://localhost:7019/1 or serial:///dev/ttyUSB0")
    parser.add_argument("--patience", type=float, default=PATIENCE_S, metavar="S",
                        help=f"seconds to go on trying (default {PATIENCE_S:g})")


def run(options: argparse.Namespace) -> int:
    """Stop it; the exit code."""
    opening = opening_of(options.address, Wanted())
    return Stopping(opening.talk, time.monotonic, time.sleep).run(options.patience)


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
        return 0 if stands else 1

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
            tell(text)

    def _hang_up(self) -> None:
        if self._robot is not None:
            self._robot.disconnect()

    def _report(self, stands: bool) -> None:
        times = f"told {self._told} time{'' if self._told == 1 else 's'}"
        if self._troubles:
            times += f", {sum(self._troubles.values())} faults on the way"
        if stands and self._last is not None:
            print(f"stands still at x {self._last.x_in:.1f} in, y {self._last.y_in:.1f} in; {times}")
        elif self._last is not None:
            print(f"NOT STOPPED: last seen at {self._last.translation_in_s:.1f} in/s; {times}")
        else:
            print(f"NOT STOPPED: nobody answered; {times}")
