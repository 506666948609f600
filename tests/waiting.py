"""Wait for conditions, for tests of running programs."""

from __future__ import annotations

import time
from collections.abc import Callable

CLOSE_NOTICED_S = 0.3
"""Real time after which a server has noticed that the other end of its pseudo-terminal was closed."""


def wait_until(condition: Callable[[], bool], timeout_s: float = 30.0, pause_s: float = 0.02) -> None:
    """Wait until a condition is true; fail the test after `timeout_s`."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, f"not true within {timeout_s:g} s"
        time.sleep(pause_s)
