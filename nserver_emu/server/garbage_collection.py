"""Python's garbage collection while a simulation runs: between steps, and not among the objects of the start.

    rare_collection()            around a run: no collection within a step
    GarbageCollector.run()       between steps: a collection at long intervals

A step of a thousand robots creates tens of thousands of objects, nearly all of which are freed by reference counting.
With Python's default threshold of 700 new objects, collections cost a fifth of the time and cause pauses. But asyncio
and aiohttp leave some thirty objects in reference cycles per connection, so a long-running daemon must collect.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

GC_THRESHOLD: Final = 100_000
"""New objects after which Python collects within a step: some tens of megabytes."""
MIN_INTERVAL_S: Final = 10.0
"""Shortest interval between two collections between steps."""
MIN_INTERVAL_RATIO: Final = 100.0
"""Shortest interval as a multiple of the last collection's duration: some ms, over 100 ms with a thousand robots."""
MIN_OBJECTS: Final = 100
"""With fewer new objects no connection was closed, and a collection is not worth its time."""


@contextmanager
def rare_collection() -> Iterator[None]:
    """Exempt all present objects from garbage collection, and raise its threshold, within the block."""
    threshold = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(GC_THRESHOLD)
    try:
        yield
    finally:
        gc.set_threshold(*threshold)
        gc.unfreeze()


class GarbageCollector:
    """Collects garbage between steps of the simulation; `clock` returns seconds, monotonic."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._due_s = clock() + MIN_INTERVAL_S

    def run(self) -> None:
        """Collect if the interval has passed and there are new objects; call it between two steps."""
        now_s = self._clock()
        if now_s < self._due_s or gc.get_count()[0] < MIN_OBJECTS:
            return
        gc.collect()
        done_s = self._clock()
        self._due_s = done_s + max(MIN_INTERVAL_S, MIN_INTERVAL_RATIO * (done_s - now_s))
