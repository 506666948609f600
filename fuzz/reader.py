"""A row of the table: a reader of outer input, what it may raise, what its input looks like.

Rules: `read` takes bytes and calls the real reader; it gives a value, or raises one of `errors`, which are the
documented ones. It keeps nothing from one input to the next, so that an input shows again what it showed once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from random import Random

Mutator = Callable[[bytes, Random], bytes]
"""Another input like this one; the same for the same chance."""
CORPUS = Path(__file__).parent / "corpus"


class Wordless(AssertionError):
    """A documented error that says nothing."""


@dataclass(frozen=True, slots=True)
class Reader:
    """See the head of this file.

    seeds     inputs as they should be, to begin with
    mutate    changes that fit this language
    longest   bytes of the longest input that is tried
    """

    name: str
    about: str
    read: Callable[[bytes], object]
    errors: tuple[type[Exception], ...]
    seeds: Callable[[], Iterable[bytes]]
    mutate: Mutator
    longest: int = 4096

    def take(self, data: bytes) -> bool:
        """Read one input; whether it was taken. Raises whatever is neither a value nor a documented error in words."""
        try:
            self.read(data)
        except self.errors as error:
            if not str(error).strip():
                raise Wordless(f"{type(error).__name__} without a word") from error
            return False
        return True

    def kept(self) -> list[bytes]:
        """The corpus, sorted by name."""
        return [path.read_bytes() for path in sorted((CORPUS / self.name).glob("*"))]
