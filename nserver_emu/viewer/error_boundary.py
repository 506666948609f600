"""Keeps what goes wrong for one viewer from the others: logged with where it came from, and all goes on.

Rules: this is the page's outermost edge, the only place where any exception is taken. The same kind of fault at the
same place is logged once, and then counted: twenty pictures a second would fill a disk.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType

log = logging.getLogger(__name__)

Then = Callable[[Exception], None]


@dataclass(slots=True)
class Guard:
    """See the head of this file."""

    faults: Counter[tuple[str, type[Exception]]] = field(default_factory=Counter)

    def over(self, what: str, who: str = "", then: Then = lambda _: None) -> Guarded:
        """Whatever goes wrong in here ends only what is in here, and `then` is told.

        what    the place        who    for whom, in the log
        """
        return Guarded(self, what, who, then)

    def note(self, what: str, who: str, error: Exception) -> None:
        """This went wrong there."""
        kind = what, type(error)
        self.faults[kind] += 1
        if self.faults[kind] == 1:
            whose = f" of {who}" if who else ""
            log.error("page: %s%s: a fault of ours, all else goes on (logged once)", what, whose, exc_info=error)


@dataclass(slots=True)
class Guarded:
    """What `over` gives to a `with`: no generator, since every page passes here twenty times a second."""

    guard: Guard
    what: str
    who: str
    then: Then

    def __enter__(self) -> None:
        pass

    def __exit__(self, _kind: object, error: BaseException | None, _trace: TracebackType | None) -> bool:
        if not isinstance(error, Exception):
            return False
        self.guard.note(self.what, self.who, error)
        self.then(error)
        return True
