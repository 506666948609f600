"""stdout and stderr as a command finds them: closed, on a full disk, or read by somebody who has gone.

Rules: a command that is started without one of them has /dev/null there, for the first file or socket to be opened
would else take its number, and be written to by whatever prints. What could not be printed is told in a line, as of any
file that cannot be written.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from nclient.exit_codes import ExitCode
from nclient.unwritable import unwritable

_STANDARD = (0, 1, 2)


def fill_in() -> None:
    """Put /dev/null where stdin, stdout or stderr were closed when the command was started."""
    for number in _STANDARD:
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this one
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


def ended_by(error: OSError, command: str) -> ExitCode:
    """What a command ends with whose stdout gave it this error, which is told. Raises another's error again."""
    if isinstance(error, BrokenPipeError):
        _let_go()
        return ExitCode.READER_GONE
    try:
        print(flush=True)  # what was written last may be lost already; one more line is refused as well
    except OSError as again:
        _let_go()
        print(f"{command}: {unwritable(Path('stdout'), again)}", file=sys.stderr)
        return ExitCode.FAILED
    raise error


def _let_go() -> None:
    """Keep the interpreter from flushing what is left once more as it ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # stdout is no file of the system
        return
