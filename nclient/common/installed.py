"""Entry points of installed packages."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


def entry_points(group: str) -> EntryPoints:
    """Return the entry points of a group."""
    return _all_entry_points().select(group=group)


@functools.cache
def _all_entry_points() -> EntryPoints:
    """Return all entry points. Cached, because 250 packages take 20 ms."""
    from importlib import metadata  # here: its import is a twentieth of the start of nserver

    return metadata.entry_points()
