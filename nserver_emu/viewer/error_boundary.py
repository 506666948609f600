"""Isolation of viewers: an exception that concerns one viewer is logged, and all others continue.

This is the outermost edge of the page's server, and the only place that catches every exception. Repeated errors of one
kind in one place are logged once and then counted, since twenty pictures a second would fill a disk.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType

log = logging.getLogger(__name__)

OnError = Callable[[Exception], None]


@dataclass(slots=True)
class ErrorBoundary:
    """Catches, logs and counts exceptions of a server; `counts` by place and exception type."""

    server: str = "page"
    counts: Counter[tuple[str, type[Exception]]] = field(default_factory=Counter)

    def guard(self, place: str, viewer: str = "", on_error: OnError = lambda _: None) -> GuardedBlock:
        """Return a context manager that catches the exceptions of its block and passes them to `on_error`.

        Parameters
        ----------
        place : what the block does, for the log.
        viewer : name of the viewer that it concerns, for the log.
        on_error : called with the exception.
        """
        return GuardedBlock(self, place, viewer, on_error)

    def record(self, place: str, viewer: str, error: Exception) -> None:
        """Count an exception; log it if it is the first of its kind in this place."""
        kind = place, type(error)
        self.counts[kind] += 1
        if self.counts[kind] == 1:
            suffix = f" of {viewer}" if viewer else ""
            log.error(
                "%s: %s%s: internal error, all else goes on (logged once)", self.server, place, suffix, exc_info=error
            )


@dataclass(slots=True)
class GuardedBlock:
    """Context manager of ErrorBoundary.guard; a generator would be slow, twenty times a second per page."""

    boundary: ErrorBoundary
    place: str
    viewer: str
    on_error: OnError

    def __enter__(self) -> None:
        pass

    def __exit__(self, _kind: object, error: BaseException | None, _trace: TracebackType | None) -> bool:
        if not isinstance(error, Exception):
            return False
        self.boundary.record(self.place, self.viewer, error)
        self.on_error(error)
        return True
