"""Simulated time as whole picoseconds, so that sums of steps are exact and two instants are equal or they are not.

Seconds are for people and formulas; instants are for what happens when. No clock is read here.
"""

from __future__ import annotations

from math import isfinite
from typing import Final

PS_PER_S: Final = 10**12
"""Picoseconds in a second: a float dt is rounded by 0.5e-12 s at most, 1e-11 in at top speed."""

NEVER_PS: Final = 1 << 80
"""An instant no simulation reaches: 38,000 years."""


def to_ps(seconds: float) -> int:
    """The nearest instant or span of time; raises ValueError for what is negative or not finite."""
    if not isfinite(seconds) or seconds < 0.0:
        raise ValueError(f"expected a time of 0 s or more, got {seconds} s")
    return round(seconds * PS_PER_S)


def to_s(picoseconds: int) -> float:
    """Seconds."""
    return picoseconds / PS_PER_S
