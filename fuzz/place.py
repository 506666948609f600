"""Where an input stands as a file, for readers that take a path: in memory where the system has such a place.

Rules: one file an ending, written over each time; gone when the process that made it ends as it should.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

_IN_MEMORY = Path("/dev/shm")


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="nomad-fuzz-", dir=_IN_MEMORY if _IN_MEMORY.is_dir() else None)


def file_of(data: bytes, ending: str) -> Path:
    """A file that holds these bytes."""
    path = Path(_folder().name) / f"input{ending}"
    path.write_bytes(data)
    return path
