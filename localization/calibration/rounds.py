"""As many laps as it takes: one each way, and again, until it is enough or there were too many.

Rules: values; what is enough is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from localization.calibration.square import Task


class Rounds:
    """The laps after the first. `lap`: once each way; `most`: with the first; `enough`: asked after each."""

    def __init__(self, lap: Sequence[Task], most: int, enough: Callable[[], bool]) -> None:
        self._lap, self._most, self._enough = lap, most, enough
        self.begun = 1

    def more(self) -> Sequence[Task]:
        """What is to be driven now that all before is done; nothing where it is enough."""
        if self.begun >= self._most or self._enough():
            return ()
        self.begun += 1
        return self._lap
