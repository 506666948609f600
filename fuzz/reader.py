"""A row of the table: a reader of outer input, its documented errors, and what valid input looks like."""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Final

Mutator = Callable[[bytes, Random], bytes]
"""Return a mutated input; the same for the same state of the random generator."""
SEEDS: Final = Path(__file__).parent / "seeds"
_SHARED_MEMORY: Final = Path("/dev/shm")


class EmptyMessage(AssertionError):
    """A documented error without a message."""


@dataclass(frozen=True, slots=True)
class Reader:
    """A reader of outer input.

    Parameters
    ----------
    read
        Calls the real reader. It keeps no state between inputs, so that a finding can be reproduced.
    errors
        The documented exceptions.
    valid_inputs
        Returns valid inputs, from which mutation starts.
    mutate
        Mutates an input so that it remains mostly valid.
    max_size
        Size of the longest input in bytes.
    """

    name: str
    description: str
    read: Callable[[bytes], object]
    errors: tuple[type[Exception], ...]
    valid_inputs: Callable[[], Iterable[bytes]]
    mutate: Mutator
    max_size: int = 4096

    def accepts(self, data: bytes) -> bool:
        """Read one input. Return True if it is accepted, False if it is rejected with a documented error.

        Raises
        ------
        Exception
            Any other error of the reader.
        EmptyMessage
            If a documented error has no message.
        """
        try:
            self.read(data)
        except self.errors as error:
            if not str(error).strip():
                raise EmptyMessage(f"{type(error).__name__} has no message") from error
            return False
        return True

    def seeds(self) -> dict[str, bytes]:
        """Return the named seeds in fuzz/seeds."""
        return {path.name: path.read_bytes() for path in sorted((SEEDS / self.name).glob("*"))}


@functools.cache
def input_folder() -> Path:
    """Return a temporary folder for input files, in memory if possible; call it before forking, to share it."""
    path = tempfile.mkdtemp(prefix="nomad-fuzz-", dir=_SHARED_MEMORY if _SHARED_MEMORY.is_dir() else None)
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return Path(path)


def input_file(data: bytes, suffix: str) -> Path:
    """Write an input to a file, for readers that take a path; each process overwrites its own file."""
    path = input_folder() / f"{os.getpid()}{suffix}"
    with path.open("wb", buffering=0) as file:
        file.write(data)
    return path
