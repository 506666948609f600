"""Exit codes of `nomad` and `nserver`: THE table. Commands return its members, docs/exit-codes.md is made from it.

    python -m nclient.common.exit_codes      the page, in Markdown

Rules: a new code is a new row, and scripts may rely on those there are. Above 128 a code is 128 and the number of the
signal that ended the command, as shells count.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum

_NOMAD, _NSERVER, _CTL = "nomad", "nserver", "nserver ctl"
_ALL = (_NOMAD, _NSERVER, _CTL)


class ExitCode(IntEnum):
    """What a command ended with. `meaning` says it in words, `commands` who ends so."""

    meaning: str
    commands: tuple[str, ...]

    def __new__(cls, value: int, meaning: str, commands: tuple[str, ...]) -> ExitCode:
        """A row: the number, what it means, whose it is."""
        code = int.__new__(cls, value)
        code._value_ = value
        code.meaning, code.commands = meaning, commands
        return code

    DONE = 0, "done; what serves until it is stopped was stopped as asked (SIGINT, SIGTERM, SIGHUP, quit_server)", _ALL
    FAILED = 1, "not done, or the answer is no: the reason is on stderr", _ALL
    USAGE = 2, "wrong usage, or an extra is missing: stderr says what would be right", _ALL
    NOT_REACHED = 3, "it ran, and what was asked for did not come to be (table below)", (_NOMAD,)
    UNFIT = 4, "`nomad calibrate`: readings do not fit what was told of the robot; nothing was written", (_NOMAD,)
    HUNG_UP = 129, "the terminal was closed (SIGHUP); a driven robot was stopped, its report written", (_NOMAD,)
    INTERRUPTED = 130, "Ctrl-C (SIGINT), of `nserver` until it serves; a driven robot stopped, its report written", _ALL
    READER_GONE = 141, "whoever read the output went away (SIGPIPE)", _ALL
    TERMINATED = 143, "SIGTERM; a driven robot was stopped, its report written", (_NOMAD,)


FAILURES = {
    "nserver": "could not start, or `--replay` met an answer that is not as recorded",
    "nserver ctl": "no daemon answers, or it refuses",
    "nomad doctor": "a finding is FAIL",
    "nomad dump": "the recording ends in the middle",
    "nomad play": "a visitor asked something else than was recorded",
    "nomad shell": "a line of a script failed, or the robot was lost",
    "nomad stop": "the robot was not seen to stand still",
    "nomad wire decode": "the bytes are no good frame",
}
"""What 1 means beside an error, by the command."""


UNDONE = {
    "nomad calibrate": "the time limit was over; nothing was written",
    "nomad go": "the robot is not there: blocked, lost or out of time, as the report says",
    "nomad localize": "a way-point was not reached",
    "nomad map check": "something was found",
    "nomad mission": "a step failed, as the report says",
}
"""What 3 means, by the command."""


def in_short() -> str:
    """All codes in a line, for --help."""
    return ", ".join(f"{code.value} {code.name.lower().replace('_', ' ')}" for code in ExitCode)


def page() -> Iterator[str]:
    """The lines of docs/exit-codes.md."""
    yield "# Exit codes"
    yield ""
    yield "Made from `nclient/common/exit_codes.py` by `scripts/exit-codes`."
    yield ""
    yield "| code | name | means | of |"
    yield "|---|---|---|---|"
    for code in ExitCode:
        yield f"| {code.value} | {code.name} | {code.meaning} | {', '.join(code.commands)} |"
    yield ""
    yield "All commands end with 1 where a robot, a daemon or a file lets them down, and"
    yield ""
    yield "| command | 1 also means |"
    yield "|---|---|"
    for command, meaning in FAILURES.items():
        yield f"| `{command}` | {meaning} |"
    yield ""
    yield "| command | 3 means |"
    yield "|---|---|"
    for command, meaning in UNDONE.items():
        yield f"| `{command}` | {meaning} |"
    yield ""
    yield "A program that was killed (SIGKILL, 137) says nothing; its robot stops by its own time-out."


if __name__ == "__main__":
    print("\n".join(page()))
