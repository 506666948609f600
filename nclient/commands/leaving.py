"""Signals that end a command which drives a robot: it is left in order, so that the robot stops.

Rules: SIGTERM, and SIGHUP where there is one (the terminal was closed), become SystemExit with the code of each in the
table of exit codes. Signals belong to the main thread, on which commands run.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

from nclient.exit_codes import ExitCode

_CODES = {"SIGTERM": ExitCode.TERMINATED, "SIGHUP": ExitCode.HUNG_UP}


@contextlib.contextmanager
def left_in_order() -> Iterator[None]:
    """Within this block the signals raise SystemExit."""
    numbers = [getattr(signal, name) for name in _CODES if hasattr(signal, name)]
    before = {number: signal.signal(number, _leave) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    del frame
    raise SystemExit(_CODES[signal.Signals(number).name])
