"""Keeps what goes wrong for one viewer from the others: logged with where it came from, and all goes on.

Rules: this is the page's outermost edge, the only place where any exception is taken. The same kind of fault at the
same place is logged once, and then counted: twenty pictures a second would fill a disk.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)


class Guard:
    """See the head of this file."""

    def __init__(self) -> None:
        self.faults: Counter[tuple[str, type[Exception]]] = Counter()

    @contextmanager
    def over(self, what: str, who: str = "", then: Callable[[Exception], None] = lambda _: None) -> Iterator[None]:
        """Whatever goes wrong in here ends only what is in here, and `then` is told.

        what    the place        who    for whom, in the log
        """
        try:
            yield
        except Exception as error:
            kind = what, type(error)
            self.faults[kind] += 1
            if self.faults[kind] == 1:
                whose = f" of {who}" if who else ""
                log.exception("page: %s%s: a fault of ours, all else goes on (logged once)", what, whose)
            then(error)
