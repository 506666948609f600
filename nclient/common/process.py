"""Process environment of the commands: exit codes, termination signals, standard streams, broken pipes, progress.

Exit codes above 128 are 128 plus the number of the signal that ended the command, as in shells; docs/exit-codes.md
describes them, and scripts rely on their values.

SIGTERM, and SIGHUP when the terminal is closed, raise `TerminatedBySignal` in the main thread, so that a command stops
its robot and writes its report as after Ctrl-C. The first signal counts, later ones are ignored (Ctrl-C is not). Python
ignores exceptions in finalizers and weak references' callbacks: a signal that arrives in one is sent again.
Signals that were ignored at the start, as SIGHUP under nohup, stay ignored.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from enum import IntEnum
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

from nclient.common.files import describe_write_error


class ExitCode(IntEnum):
    """Exit code of a command."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    NOT_REACHED = 3
    UNFIT = 4
    HUNG_UP = 129
    INTERRUPTED = 130
    READER_GONE = 141
    TERMINATED = 143


def in_short() -> str:
    """Return all codes in one line, for --help."""
    return ", ".join(f"{code.value} {code.name.lower().replace('_', ' ')}" for code in ExitCode)


_CODES = {"SIGTERM": ExitCode.TERMINATED, "SIGHUP": ExitCode.HUNG_UP}
RESEND_S: Final = 0.05
"""A signal whose exception was ignored is sent again after this time."""
_STANDARD_STREAMS = (0, 1, 2)
_OUTPUTS = (1, 2)

NOMAD: Final = (sys.executable, "-P", "-m", "nclient.cli")
"""The program `nomad` of this installation; -P: modules in the working folder are not imported."""


class TerminatedBySignal(SystemExit):
    """A signal ends the command.

    Attributes
    ----------
    signal_name
        SIGTERM or SIGHUP.
    exit_code
        Exit code for that signal.
    """

    def __init__(self, signal_name: str) -> None:
        self.signal_name = signal_name
        self.exit_code = _CODES[signal_name]
        super().__init__(int(self.exit_code))


@contextlib.contextmanager
def handle_termination_signals() -> Iterator[None]:
    """Raise TerminatedBySignal at SIGTERM and SIGHUP within this block; no effect outside of the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # 1. Find the signals that exist here (Windows has no SIGHUP) and are not ignored.
    present = [signal.Signals(getattr(signal, name)) for name in _CODES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in present}
    handled = [number for number in present if before[number] not in (signal.SIG_IGN, None)]
    terminals = [output for output in _OUTPUTS if os.isatty(output)]

    def terminate(number: int, _: FrameType | None) -> NoReturn:
        for other in handled:
            signal.signal(other, signal.SIG_IGN)
        _redirect_closed_terminals(terminals)
        raise TerminatedBySignal(signal.Signals(number).name)

    def install() -> None:
        for number in handled:
            signal.signal(number, terminate)

    timers: list[threading.Timer] = []

    def resend(unraisable: "sys.UnraisableHookArgs") -> None:
        if not isinstance(unraisable.exc_value, TerminatedBySignal):
            hook_before(unraisable)
            return
        install()
        number = getattr(signal, unraisable.exc_value.signal_name)
        # Not from here, where the exception would be ignored again.
        timers.append(threading.Timer(RESEND_S, os.kill, (os.getpid(), number)))
        timers[-1].daemon = True
        timers[-1].start()

    # 2. Install the handler for the duration of the block.
    hook_before, sys.unraisablehook = sys.unraisablehook, resend
    install()
    try:
        yield
    finally:
        sys.unraisablehook = hook_before
        for timer in timers:
            timer.cancel()
        for number in handled:
            signal.signal(number, before[number])


def _redirect_closed_terminals(terminals: list[int]) -> None:
    """Redirect output to a closed terminal to /dev/null: a write error would interrupt the cleanup."""
    for output in terminals:
        if not os.isatty(output):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, output)
            os.close(null)


def ensure_std_streams() -> None:
    """Open /dev/null as stdin, stdout and stderr where the command was started without them.

    Otherwise the next file or socket would get their number, and print would write to it.
    """
    for number in _STANDARD_STREAMS:
        try:
            os.fstat(number)
        except OSError:
            # Takes the lowest free number, which is this one.
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


def handle_broken_pipe(error: OSError, command: str) -> ExitCode:
    """Return the exit code for a write error on stdout, and report it on stderr.

    Parameters
    ----------
    error
        The error that ended the command.
    command
        Name of the command for the message.

    Raises
    ------
    OSError
        `error` again, if stdout can be written to and so is not the cause.
    """
    if isinstance(error, BrokenPipeError):
        _discard_stdout()
        return ExitCode.READER_GONE
    try:
        # The failed write was buffered; if stdout is the cause, another line fails as well.
        print(flush=True)
    except OSError as stdout_error:
        _discard_stdout()
        print(f"{command}: {describe_write_error(Path('stdout'), stdout_error)}", file=sys.stderr)
        return ExitCode.FAILED
    raise error


def _discard_stdout() -> None:
    """Redirect stdout to /dev/null, so that the interpreter's flush at exit does not fail again."""
    # Unless stdout is not a file of the operating system.
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


PROGRESS_S: Final = 1.0
"""Seconds between two reports of progress, and before the first."""


@contextlib.contextmanager
def show_seconds(title: str) -> Iterator[None]:
    """Show on stderr, if it is a terminal, how many seconds the body has taken so far."""
    if not sys.stderr.isatty():
        yield
        return
    done, passed_s = threading.Event(), count(PROGRESS_S, PROGRESS_S)

    def show() -> None:
        while not done.wait(PROGRESS_S):
            print(f"\r{title}: {next(passed_s):.0f} s", end="", file=sys.stderr, flush=True)

    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        if next(passed_s) > PROGRESS_S:
            print(file=sys.stderr)
