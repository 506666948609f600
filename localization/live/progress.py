"""Progress of work in this process that cannot report its own."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from threading import Event, Thread
from typing import Final

PERIOD_S: Final = 1.0
"""Seconds between two reports, and before the first."""


@contextmanager
def show_seconds(title: str) -> Iterator[None]:
    """Show on stderr, if it is a terminal, how many seconds the body has taken so far."""
    if not sys.stderr.isatty():
        yield
        return
    done, passed_s = Event(), count(PERIOD_S, PERIOD_S)

    def show() -> None:
        while not done.wait(PERIOD_S):
            print(f"\r{title}: {next(passed_s):.0f} s", end="", file=sys.stderr, flush=True)

    thread = Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        if next(passed_s) > PERIOD_S:
            print(file=sys.stderr)
