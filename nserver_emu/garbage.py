"""When Python looks for garbage while a simulation runs: between steps, and not among what was there from the start.

    seldom_sought()              around a run: no look in the middle of a step
    Tidying.tidy()               between steps: a look now and then
    give_back()                  what is free goes back to the system

A step of a thousand robots makes tens of thousands of objects, nearly all of which go by their counts of references.
With its usual 700 Python would look through the young ones every few robots, and through all of them now and then: a
fifth of the time, and pauses. But asyncio and aiohttp leave of each visitor some thirty objects that hold one another,
and whoever serves for days keeps them until somebody looks.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

NEW_OBJECTS: Final = 100_000
"""So many more of them are made than go before Python looks in the middle of a step: some tens of megabytes."""
TIDY_S: Final = 10.0
"""From one look between steps to the next, at least."""
SHARE: Final = 100.0
"""And so many times as long as the last one took: some milliseconds, a hundred and more with a thousand robots."""
FEW_OBJECTS: Final = 100
"""So few new ones are not worth a look: nobody was here."""


@contextmanager
def seldom_sought() -> Iterator[None]:
    """What is there now is no garbage, and what comes is looked through seldom, until the end."""
    usual = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(NEW_OBJECTS)
    try:
        yield
    finally:
        gc.set_threshold(*usual)
        gc.unfreeze()


class Tidying:
    """Frees what visitors left. `clock`: seconds that only grow."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._due_s = clock() + TIDY_S

    def tidy(self) -> None:
        """Now is between two steps."""
        now_s = self._clock()
        if now_s < self._due_s or gc.get_count()[0] < FEW_OBJECTS:
            return
        gc.collect()
        give_back()
        done_s = self._clock()
        self._due_s = done_s + max(TIDY_S, SHARE * (done_s - now_s))


def give_back() -> None:
    """Free pages anywhere in the heap are the system's again, where there is glibc; for whoever had much for a moment.
    Takes a tenth of a millisecond."""
    if _trim is not None:
        _trim(0)


def _malloc_trim() -> Callable[[int], object] | None:
    return getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None


_trim: Final = _malloc_trim()
