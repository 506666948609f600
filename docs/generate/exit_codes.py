"""Generate the tables of docs/exit-codes.md."""

from __future__ import annotations

from collections.abc import Iterator

from nclient.common.process import ExitCode

NOMAD, NSERVER, CTL, EXPERIMENTS = "nomad", "nserver", "nserver ctl", "localization.experiments"
ALL = (NOMAD, NSERVER, CTL)
ALL_AND_EXPERIMENTS = (*ALL, EXPERIMENTS)
MEANINGS = {
    ExitCode.DONE: (
        "success; a server was stopped as requested (SIGINT, SIGTERM, SIGHUP, quit_server)", ALL_AND_EXPERIMENTS),
    ExitCode.FAILED: ("failure; the reason is on stderr", ALL_AND_EXPERIMENTS),
    ExitCode.USAGE: ("wrong usage, or a missing extra; stderr says what is expected", ALL_AND_EXPERIMENTS),
    ExitCode.NOT_REACHED: ("the command ran and did not achieve its goal (table below)", (NOMAD,)),
    ExitCode.UNFIT: (
        "`calibrate`, `map learn`, `map update`: readings do not fit the model; nothing was written", (NOMAD,)
    ),
    ExitCode.HUNG_UP: ("the terminal was closed (SIGHUP); the robot was stopped, the report written", (NOMAD,)),
    ExitCode.INTERRUPTED: (
        "Ctrl-C (SIGINT), of `nserver` only until it serves; the robot was stopped, the report written",
        ALL_AND_EXPERIMENTS),
    ExitCode.READER_GONE: ("the reader of stdout closed it (SIGPIPE)", ALL),
    ExitCode.TERMINATED: ("SIGTERM; the robot was stopped, the report written", (NOMAD,)),
}  # fmt: skip
FAILURES = {
    "nserver": "the server could not start, or `--replay` got a reply that differs from the recording",
    "nserver ctl": "no daemon answers, or it refuses the command",
    "nomad doctor": "a check reports FAIL",
    "nomad dump": "the recording is truncated",
    "nomad play": "a client sent a request that differs from the recording",
    "nomad shell": "a line of a script failed, or the robot was lost",
    "nomad stop": "the robot was not confirmed to stand still",
    "nomad wire decode": "the bytes are not a valid frame",
}
"""Meaning of exit code 1 by command."""
NOT_REACHED = {
    "nomad calibrate": "the time limit expired; nothing was written",
    "nomad go": "the robot is not at the goal: blocked, lost or out of time, as reported",
    "nomad localize": "a waypoint was not reached",
    "nomad map check": "the map has defects",
    "nomad map learn": "a waypoint was left out; the map is written",
    "nomad map update": "the drive shows changes of the map",
    "nomad mission": "a step failed, as reported",
}
"""Meaning of exit code 3 by command."""


def blocks() -> dict[str, Iterator[str]]:
    """Return the tables of the page."""
    return {"codes": _codes(), "1": _meanings(1, FAILURES), "3": _meanings(3, NOT_REACHED)}


def _codes() -> Iterator[str]:
    yield from ("| code | name | meaning | commands |", "|---|---|---|---|")
    for code in ExitCode:
        meaning, commands = MEANINGS[code]
        yield f"| {code.value} | {code.name} | {meaning} | {', '.join(commands)} |"


def _meanings(code: int, meanings: dict[str, str]) -> Iterator[str]:
    yield from (f"| command | {code} means |", "|---|---|")
    yield from (f"| `{command}` | {meaning} |" for command, meaning in meanings.items())
