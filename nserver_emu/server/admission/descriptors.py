"""How many files and sockets the process may have open: as many as the limits on connections let in, and some.

Rules: said at the start, not when the last one is gone; where there is no such limit (Windows), nothing is done.
"""

from __future__ import annotations

import contextlib
import logging
from typing import Final

log = logging.getLogger(__name__)

OWN: Final = 64
"""Descriptors of the daemon's own: ports, logs, recordings, lines, the loop."""


def make_room(connections: int) -> None:
    """Raise the process's own limit as far as it may be; say so where that is not enough for so many connections."""
    try:
        import resource
    except ImportError:
        return
    wanted = connections + OWN
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return
    may = wanted if hard == resource.RLIM_INFINITY else min(hard, wanted)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (may, hard))
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < wanted:
        log.warning("this process may have %d files open, and --limit-connections and --limit-viewers let in %d: raise "
                    "the one (ulimit -n, LimitNOFILE=) or lower the others", soft, connections)  # fmt: skip
