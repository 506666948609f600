"""Signals that end a command: it is left in order, as by Ctrl-C, so that its robot stops and its report is written.

Rules: SIGTERM, and SIGHUP where there is one (the terminal was closed), become `Left`, a SystemExit with the code of
each in the table of exit codes; the first counts, and no further one disturbs the leaving (Ctrl-C does). What was
ignored from the start, as SIGHUP under nohup, stays ignored. Signals belong to the main thread, on which commands run.

stdout and stderr as a command finds them: closed, on a full disk, or read by somebody who has gone.

Rules: a command that is started without one of them has /dev/null there, for the first file or socket to be opened
would else take its number, and be written to by whatever prints. What could not be printed is told in a line, as of any
file that cannot be written.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import NoReturn

from nclient.common.exit_codes import ExitCode
from nclient.common.files import describe_write_error

_CODES = {"SIGTERM": ExitCode.TERMINATED, "SIGHUP": ExitCode.HUNG_UP}
_OUTPUTS = (1, 2)


class TerminatedBySignal(SystemExit):
    """A signal ends the command. `signal_name`: which."""

    def __init__(self, signal_name: str) -> None:
        self.signal_name = signal_name
        self.exit_code = _CODES[signal_name]
        super().__init__(int(self.exit_code))


@contextlib.contextmanager
def handle_termination_signals() -> Iterator[None]:
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
        raise TerminatedBySignal(signal.Signals(number).name)

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


_STANDARD = (0, 1, 2)


def ensure_std_streams() -> None:
    """Put /dev/null where stdin, stdout or stderr were closed when the command was started."""
    for number in _STANDARD:
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this one
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


def handle_broken_pipe(error: OSError, command: str) -> ExitCode:
    """What a command ends with whose stdout gave it this error, which is told. Raises another's error again."""
    if isinstance(error, BrokenPipeError):
        _let_go_outputs()
        return ExitCode.READER_GONE
    try:
        print(flush=True)  # what was written last may be lost already; one more line is refused as well
    except OSError as again:
        _let_go_outputs()
        print(f"{command}: {describe_write_error(Path('stdout'), again)}", file=sys.stderr)
        return ExitCode.FAILED
    raise error


def _let_go_outputs() -> None:
    """Keep the interpreter from flushing what is left once more as it ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # stdout is no file of the system
        return
