"""How fast one connection may be answered: a token bucket. Pure; the clock is handed in.

    spend(n, now)      so many answers were given        wait_s(now)      how long until the next may be

Rules: an idle client saves up a tenth of a second's worth, or one turn's; a turn that began is finished, and what it
took too much is waited for before the next.
"""

from __future__ import annotations

from typing import Final

SAVED_S: Final = 0.1


class Allowance:
    """`rate`: answers a second, more than 0; `turn`: the most that are given at once."""

    def __init__(self, rate: float, turn: int, now_s: float) -> None:
        self._rate = rate
        self._most = max(rate * SAVED_S, turn)
        self._left = self._most
        self._at_s = now_s

    def spend(self, count: int, now_s: float) -> None:
        """So many were given."""
        self._left = min(self._most, self._left + self._rate * (now_s - self._at_s)) - count
        self._at_s = now_s

    def wait_s(self, now_s: float) -> float:
        """Seconds until one more may be given; 0 for now."""
        return max(0.0, -self._left / self._rate - (now_s - self._at_s))
