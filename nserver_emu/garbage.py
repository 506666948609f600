"""When Python looks for garbage while a simulation runs: between steps, and not among what was there from the start.

A step of a thousand robots makes tens of thousands of objects, nearly all of which go by their counts of references.
With its usual 700 Python would look through the young ones every few robots, and through all of them now and then: a
fifth of the time, and pauses. Between two steps there is only what is kept, and what visitors left: asyncio and aiohttp
make of each connection some thirty objects that hold one another. There a look is worth its time once they are many.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

NEW_OBJECTS: Final = 100_000
"""So many more of them are made than go before Python looks in the middle of a step: some tens of megabytes."""
LEFT_OBJECTS: Final = 10_000
"""So many more are there between two steps than after the last look before it is looked again: some three hundred
visitors, a few megabytes."""


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


def look_between_steps() -> None:
    """Free what visitors left, if that may be much. Costs some milliseconds then, and nothing else."""
    if gc.get_count()[0] > LEFT_OBJECTS:
        gc.collect()
