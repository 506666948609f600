"""Did you mean ...? The end of a message about a word that is unknown: the known one that looks most like it.

Rules: pure, and on the ground floor, so that every command line and every reader of files says it the same way.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

LIKENESS = 0.6
"""How like it has to be, 0 to 1 (difflib's ratio), to be worth a question."""


def nearest(word: str, known: Iterable[str], likeness: float = LIKENESS) -> str:
    """The known word that looks most like this one; "" where none does."""
    return next(iter(get_close_matches(word, list(known), n=1, cutoff=likeness)), "")


def did_you_mean(
    word: str, known: Iterable[str], before: str = "; ", after: str = "?", likeness: float = LIKENESS
) -> str:
    """`; did you mean WORD?` with the nearest known word; "" where none is near."""
    near = nearest(word, known, likeness)
    return f"{before}did you mean {near}{after}" if near else ""
