"""Where an input stands as a file, for readers that take a path: in memory where the system has such a place.

Rules: one file an ending and a process, written over each time, in one folder of whoever forked these processes, and
gone with it.
"""

from __future__ import annotations

import functools
import os
import tempfile
from pathlib import Path

_IN_MEMORY = Path("/dev/shm")


@functools.cache
def folder() -> tempfile.TemporaryDirectory[str]:
    """The folder; whoever forks asks for it first, and cleans it up."""
    return tempfile.TemporaryDirectory(prefix="nomad-fuzz-", dir=_IN_MEMORY if _IN_MEMORY.is_dir() else None)


def file_of(data: bytes, ending: str) -> Path:
    """A file that holds these bytes."""
    path = _path(folder().name, os.getpid(), ending)
    with path.open("wb", buffering=0) as file:
        file.write(data)
    return path


@functools.cache
def _path(place: str, process: int, ending: str) -> Path:
    return Path(place, f"{process}{ending}")
