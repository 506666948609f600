"""The words that the shell has besides the C names: a table.

Rules: pure; what they do is session.py's.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class OwnWord(NamedTuple):
    """A row: its name, how it is used, what it does."""

    name: str
    usage: str
    summary: str


OWN: Final = {word.name: word for word in (
    OwnWord("help", "help [NAME]", "list all commands, or say all about one"),
    OwnWord("state", "state [PART ...]", "ask gs and show all that is known, or parts of it, in words"),
    OwnWord("wait", "wait [SECONDS]", "wait until the robot stands still, 60 s at most; an error if it does not"),
    OwnWord("sleep", "sleep SECONDS", "let so much of the robot's time pass, simulated or real"),
    OwnWord("quit", "quit", "stop the robot and leave; so do exit and Ctrl-D"),
    OwnWord("exit", "exit", "the same as quit"),
)}  # fmt: skip
ARRAYS_HELP: Final = {
    "State[34]": "a number as C has it, from the last answer; State shows all 45, Laser the laser's",
    "Smask[17] = 0": "a number of the mask that ct sends; Smask shows all 44",
}
