"""Hints in error messages: the most similar word, the extra of a missing module; the version, and entry points."""

from __future__ import annotations

import functools
import re
import shlex
import shutil
import sys
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

SIMILARITY = 0.6
"""Minimum similarity of a suggestion, 0 to 1 (difflib's ratio)."""
_SIMILARITY_OF_TWO = 0.5
"""Minimum for words of two letters, as many C names have: one equal letter is half of the word."""
_MIN_PREFIX = 3
"""Letters of an abbreviation from which on it suggests the only word that begins with it."""


def closest_match(word: str, candidates: Iterable[str]) -> str:
    """Return the candidate most similar to a word, or the only one that begins with it; "" if there is none."""
    words = list(candidates)
    similar = get_close_matches(word, words, n=1, cutoff=_SIMILARITY_OF_TWO if len(word) == 2 else SIMILARITY)
    if similar:
        return similar[0]
    longer = [candidate for candidate in words if candidate.startswith(word)]
    return longer[0] if len(word) >= _MIN_PREFIX and len(longer) == 1 else ""


def suggest(word: str, candidates: Iterable[str], before: str = "; ", after: str = "?") -> str:
    """Return `; did you mean CANDIDATE?` with the most similar candidate; "" if there is none."""
    match = closest_match(word, candidates)
    return f"{before}did you mean {match}{after}" if match else ""


DISTRIBUTION: Final = "nomad-nserver"


@functools.cache
def version() -> str:
    """Return the installed version. Cached, because reading the metadata reads the whole README."""
    from importlib import metadata  # here: its import is a twentieth of the start of nserver

    return metadata.version(DISTRIBUTION)


def entry_points(group: str) -> EntryPoints:
    """Return the entry points of a group."""
    found: EntryPoints = _all_entry_points().select(group=group)
    return found


@functools.cache
def _all_entry_points() -> Any:
    """Return the entry points of all groups. Cached: reading them takes 20 ms where 250 packages are installed."""
    from importlib import metadata

    return metadata.entry_points()


_GROUPS = frozenset({"all", "dev", "bench"})
"""Extras that consist of others, or have nothing that a command needs."""
_REQUIREMENT = re.compile(r"""(?P<name>[\w.-]+).*extra == ["'](?P<extra>[\w-]+)["']""")


_CLONE: Final = Path(__file__).parents[2]
"""The folder with pyproject.toml, if this is an editable installation of a clone."""


def install_hint(module: str) -> str:
    """Return the command that installs the extra with a module, as `install_command` does."""
    return install_command(find_extra(module) or "all")


def install_command(extra: str) -> str:
    """Return a command that installs an extra from the clone: `pip install -e '.[EXTRA]'`.

    The package is in no registry. Outside of the clone the command has its path, and where another `pip` comes first in
    PATH it has the path of this Python.
    """
    pip = shutil.which("pip")
    is_ours = pip is not None and Path(pip).parent == Path(sys.executable).parent
    is_clone = (_CLONE / "pyproject.toml").is_file()
    folder = str(_CLONE) if is_clone and Path.cwd() != _CLONE else "."
    program = "pip" if is_ours or not is_clone else f"{shlex.quote(sys.executable)} -m pip"
    command = f"{program} install -e {shlex.quote(f'{folder}[{extra}]')}"
    return command if is_clone else f"{command} in the folder of {DISTRIBUTION}"


def find_extra(module: str) -> str:
    """Return the extra that installs a module; "" if there is none, or the package is not installed.

    Extras are read from the installed metadata, so that pyproject.toml is the only list of them.
    """
    from importlib import metadata

    wanted = _normalize(module.partition(".")[0])
    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return ""
    matches = filter(None, map(_REQUIREMENT.match, requirements))
    return next(
        (one["extra"] for one in matches if _normalize(one["name"]) == wanted and one["extra"] not in _GROUPS), ""
    )


def _normalize(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
