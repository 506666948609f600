"""How long a connection is put up with that says nothing, or stops in the middle. Pure; the clock is handed in.

    idle     nothing came for so long, and no answer is outstanding
    stuck    a request is begun, or replies are not taken, and nothing was answered for so long: a byte now and then
             does not count

Rules: looked at a few times within the shortest limit (`look_s`), so that nothing is counted at each request.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

_LOOKS: Final = 4
"""Looks within the shortest limit: a limit is kept to a quarter of it."""


@dataclass(slots=True)
class Patience:
    """Limits in seconds, 0 for none, and since when the connection is as it is."""

    idle_s: float
    stall_s: float
    now_s: float
    _stuck_s: float | None = None
    _answered: int = 0
    _heard_s: float = 0.0

    def __post_init__(self) -> None:
        self._heard_s = self.now_s

    @property
    def look_s(self) -> float | None:
        """How often to look; None: never."""
        return min((limit / _LOOKS for limit in (self.idle_s, self.stall_s) if limit), default=None)

    def heard(self, now_s: float) -> None:
        """Something came, or is being waited for."""
        self._heard_s = now_s

    def overdue(self, now_s: float, answered: int, stuck: bool) -> str:
        """Why the connection should end; empty for not yet. `answered`: requests so far; `stuck`: in the middle."""
        if not stuck or answered != self._answered or self._stuck_s is None:
            self._stuck_s, self._answered = now_s if stuck else None, answered
        elif self.stall_s and now_s - self._stuck_s >= self.stall_s:
            return f"stopped in the middle of a request, or took no replies, for {self.stall_s:g} s"
        if self.idle_s and now_s - self._heard_s >= self.idle_s:
            return f"said nothing for {self.idle_s:g} s"
        return ""
