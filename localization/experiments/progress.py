"""A progress bar on stderr, where tqdm (extra `plot`) is there to draw it.

Rules: nothing is worked out here; who works tells how much is done so far.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Tally = Callable[[int], None]
"""Told how much is done so far."""


@contextmanager
def progress(total: int, title: str, unit: str) -> Iterator[Tally]:
    """A bar from nothing to `total`; nothing where tqdm is missing."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda _: None
        return
    with tqdm(total=total, desc=title, unit=f" {unit}", unit_scale=True, file=sys.stderr) as bar:

        def advance(done: int) -> None:
            bar.update(min(done, total) - bar.n)

        yield advance
