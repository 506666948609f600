"""Which echo is new: State shows the last reading of each sonar and says of none when it was taken.

    conf_sn restarts the ring at the clock of its answer; entry k of the order fires k intervals later, and round again

So order and clock tell which sonar fired when, on every line, stamps or not. Rules: pure; no robot, no filter. An echo
is handed out once, and only while its sonar cannot have fired again. `CLOCK_STEP_S`: a robot's clock goes in steps,
so an instant is taken as past only a step later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from nclient.protocol.models import DEFAULT_SONAR_ORDER, DEFAULT_SONAR_RATE, SONAR_RATE_STEP_S

CLOCK_STEP_S = 0.0164
_TINY = 1e-9


class FiringTime(NamedTuple):
    """A sonar that fired, and when by the robot's clock."""

    sonar: int
    instant_s: float


@dataclass(frozen=True, slots=True)
class FiringSchedule:
    """A ring restarted at `start_s` of the robot's clock. `order`: sonar numbers, each at most once."""

    start_s: float
    rate: int = DEFAULT_SONAR_RATE
    order: tuple[int, ...] = DEFAULT_SONAR_ORDER

    @property
    def interval_s(self) -> float:
        """Seconds from one sonar to the next."""
        return self.rate * SONAR_RATE_STEP_S

    @property
    def round_s(self) -> float:
        """Seconds until the same sonar fires again."""
        return self.interval_s * len(self.order)

    def readable(self, after_s: float, now_s: float) -> list[FiringTime]:
        """Firings later than `after_s` whose echoes a state of clock `now_s` shows for certain, in order of time."""
        since_start = (after_s - self.start_s) / self.interval_s
        first = max(0, math.floor(since_start + _TINY) + 1) if after_s >= self.start_s else 0
        overwritten_s = now_s + CLOCK_STEP_S - self.round_s
        first = max(first, math.floor((overwritten_s - self.start_s) / self.interval_s + _TINY) + 1)
        last = math.floor((now_s - CLOCK_STEP_S - self.start_s) / self.interval_s + _TINY)
        return [
            FiringTime(self.order[k % len(self.order)], self.start_s + k * self.interval_s)
            for k in range(first, last + 1)
        ]
