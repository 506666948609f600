"""Exit codes of `nomad` and `nserver`; docs/exit-codes.md describes them.

Codes above 128 are 128 plus the number of the signal that ended the command, as in shells. Scripts rely on these
values.
"""

from enum import IntEnum


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
