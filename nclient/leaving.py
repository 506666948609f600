"""Signals that end a command: it is left in order, as by Ctrl-C, so that its robot stops and its report is written.

Rules: SIGTERM, and SIGHUP where there is one (the terminal was closed), become `Left`, a SystemExit with the code of
each in the table of exit codes; the first counts, and no further one disturbs the leaving (Ctrl-C does). What was
ignored from the start, as SIGHUP under nohup, stays ignored. Signals belong to the main thread, on which commands run.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

from nclient.exit_codes import ExitCode

_CODES = {"SIGTERM": ExitCode.TERMINATED, "SIGHUP": ExitCode.HUNG_UP}
_OUTPUTS = (1, 2)


class Left(SystemExit):
    """A signal ends the command. `signal_name`: which."""

    def __init__(self, signal_name: str) -> None:
        self.signal_name = signal_name
        self.exit_code = _CODES[signal_name]
        super().__init__(int(self.exit_code))


@contextlib.contextmanager
def left_in_order() -> Iterator[None]:
    """Within this block the signals raise Left; on another thread than the main one nothing is changed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    present = [signal.Signals(getattr(signal, name)) for name in _CODES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in present}
    ours = [number for number in present if before[number] not in (signal.SIG_IGN, None)]
    terminals = [output for output in _OUTPUTS if os.isatty(output)]

    def leave(number: int, frame: FrameType | None) -> NoReturn:
        del frame
        for other in ours:
            signal.signal(other, signal.SIG_IGN)
        _let_go(terminals)
        raise Left(signal.Signals(number).name)

    for number in ours:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, before[number])


def _let_go(terminals: list[int]) -> None:
    """Let nothing be written to a terminal that was closed: the error would stand in the way of the leaving."""
    for output in terminals:
        if not os.isatty(output):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, output)
            os.close(nowhere)
