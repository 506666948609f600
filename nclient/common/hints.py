"""Did you mean ...? The end of a message about a word that is unknown: the known one that looks most like it.

Rules: pure, and on the ground floor, so that every command line and every reader of files says it the same way. How
like a word has to be is decided here alone: nobody who asks can have it otherwise.

What this is called where it is installed, and of which version.

Which extra of this distribution brings a module: for the one error where a module is missing.

Rules: read off the installed distribution's own metadata, so that pyproject.toml is the only list of extras.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import metadata
from importlib.metadata import PackageNotFoundError, requires
from typing import Final

LIKENESS = 0.6
"""How like it has to be, 0 to 1 (difflib's ratio), to be worth a question."""
_LIKENESS_OF_TWO = 0.5
"""The same of words of two letters, as many of C's names are: one right letter is half of such a one."""
_LEAST_OF_A_BEGINNING = 3
"""Letters with which the only known word that begins so is meant, however much longer it is."""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that looks most like this one, or the only one that begins with it; "" where none does."""
    words = list(known)
    alike = get_close_matches(word, words, n=1, cutoff=_LIKENESS_OF_TWO if len(word) == 2 else LIKENESS)
    if alike:
        return alike[0]
    longer = [known_word for known_word in words if known_word.startswith(word)]
    return longer[0] if len(word) >= _LEAST_OF_A_BEGINNING and len(longer) == 1 else ""


def suggest(word: str, known: Iterable[str], before: str = "; ", after: str = "?") -> str:
    """`; did you mean WORD?` with the nearest known word; "" where none is near."""
    near = nearest(word, known)
    return f"{before}did you mean {near}{after}" if near else ""


DISTRIBUTION: Final = "nomad-nserver"


@functools.cache
def version() -> str:
    """As its metadata have it, which are read once: they hold the whole README."""
    return metadata.version(DISTRIBUTION)


_GROUPS = frozenset({"all", "dev", "bench"})
"""Extras that bring others, or nothing that the commands want."""
_REQUIREMENT = re.compile(r"""(?P<name>[\w.-]+).*extra == ["'](?P<extra>[\w-]+)["']""")


def remedy(module: str) -> str:
    """What installs the module: `pip install 'nomad-nserver[EXTRA]'`."""
    return f"pip install '{DISTRIBUTION}[{extra_of(module) or 'all'}]'"


def extra_of(module: str) -> str:
    """The extra that brings a module; "" where none does, or where this was not installed as a distribution."""
    wanted = _plain(module.partition(".")[0])
    try:
        texts = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        return ""
    found = filter(None, map(_REQUIREMENT.match, texts))
    return next((one["extra"] for one in found if _plain(one["name"]) == wanted and one["extra"] not in _GROUPS), "")


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
