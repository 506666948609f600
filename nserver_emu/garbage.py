"""How often Python looks for garbage while a simulation runs: seldom, and not among what was there from the start.

A step of a thousand robots makes tens of thousands of objects, nearly all of which go by their counts of references.
With its usual 700 Python would look through the young ones every few robots, and through all of them now and then: a
fifth of the time, and pauses.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

NEW_OBJECTS: Final = 100_000
"""So many more of them are made than go before Python looks: some tens of megabytes at worst."""


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
