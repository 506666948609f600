"""What may come next on a line that is being typed: names, each with what it is for; and a hint to the arguments.

Rules: pure. Only commands that there are with this robot are offered.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from nclient.protocol.commands import BY_NAME, COMMANDS
from nclient.protocol.terms import Terms
from nclient.shell import glance
from nclient.shell.language import ARRAYS
from nclient.shell.own_words import OWN
from nclient.shell.reference import available, usage


class Candidate(NamedTuple):
    """A word that may stand here, and what it is for."""

    word: str
    about: str


def candidates(text: str, terms: Terms) -> Iterator[Candidate]:
    """Words that the last one of `text` (up to the cursor; "" after a blank) may become."""
    before, last = _split(text)
    if not before:
        known = dict(_names(terms))
    elif before == ["help"]:
        known = {name: about for name, about in _names(terms) if name not in ARRAYS}
    elif before[0] == "state":
        known = {part: "part of the state" for part in glance.PARTS if part not in before}
    else:
        known = {}
    return (Candidate(word, about) for word, about in known.items() if word.startswith(last))


def hint(text: str) -> str:
    """How the command that is being typed is used; "" where there is none yet."""
    before, last = _split(text)
    name = before[0] if before else last
    if name in BY_NAME:
        return usage(BY_NAME[name])
    return OWN[name].usage if name in OWN else ""


def _split(text: str) -> tuple[list[str], str]:
    """The words of the last statement that are whole, and the one that is not yet."""
    statement = text.rpartition(";")[2].lstrip()
    *before, last = re.split(r"[\s,(]+", statement)
    return before, last


def _names(terms: Terms) -> Iterator[tuple[str, str]]:
    for word in OWN.values():
        yield word.name, word.summary
    for row in COMMANDS:
        if available(row, terms):
            yield row.name, row.summary
    for array in ARRAYS:
        yield array, "the C library's array"
