"""How much slower a robot is driven whose states come far apart, as over a slow line or on a busy machine.

    share = min(1, LONGEST_GAP_S / longest gap between the last few states)

So it goes and turns no farther between two states than it would at full speed in LONGEST_GAP_S. Driven faster its way
between them is no single arc any more, as odometry takes it to be, and what is commanded is done long after it was
right. Rules: pure; clocks of states in, a share of the speed out, 1 to the bit where states come often enough.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Final

from localization.live.sensor_input import LONGEST_GAP_S

REMEMBERED: Final = 6
"""States that are looked at: a busy machine is late again and again."""


class Pace:
    """Looks on a state at a time."""

    def __init__(self) -> None:
        self._clocks: deque[float] = deque(maxlen=REMEMBERED)

    def share(self, clock_s: float) -> float:
        """The share of its speed, above 0 and at most 1, that may be driven at after a state of this clock."""
        self._clocks.append(clock_s)
        longest_s = max((after - before for before, after in pairwise(self._clocks)), default=0.0)
        return 1.0 if longest_s <= LONGEST_GAP_S else LONGEST_GAP_S / longest_s
