"""How fast to go along a stretch: as fast as the axes can, with room to turn into every arc and to stop at its end.

    v |c| <= w                              the steering's speed w, on an arc of curvature c
    v^4 |c|^3 / (24 a^2) <= SHIFT_IN        its acceleration a: a heading that ramps up to v c over v c / a seconds,
                                            half of them before the arc begins, runs beside it by this (the shift
                                            of a railway's easement, l^2 c / 24, with l = v^2 c / a)
    v dv/ds <= translation's acceleration   in both directions; 0 at the end

Rules: pure; a profile is made once for a stretch, and asked where the robot is.
"""

from __future__ import annotations

from itertools import pairwise
from math import ceil, sqrt
from typing import Final

import numpy as np

from localization.planning.course import Stretch
from localization.planning.limits import AxisLimits

SHIFT_IN: Final = 0.1
"""How far beside an arc the steering's ramp may lead."""
STEP_IN: Final = 0.25
BRAKING_SHARE: Final = 0.5
"""Of the translation's acceleration that is planned with: the rest is the controller's."""
APPROACH_HZ: Final = 2.0
"""Near the end no more than this share of the way that is left in a second: the estimate moves as well."""
CREEP_IN_S: Final = 0.5
"""The slowest that anything is driven at, so that it ends."""


def fastest_in_s(curvature: float, limits: AxisLimits) -> float:
    """The highest speed on an arc."""
    if not curvature:
        return limits.translation_in_s
    curved = abs(curvature)
    turning = limits.steering_rad_s / curved
    easing: float = (24.0 * limits.steering_rad_s2**2 * SHIFT_IN / curved**3) ** 0.25
    return min(limits.translation_in_s, turning, easing)


class Profile:
    """The speeds of a stretch; `duration_s` is what driving it takes."""

    def __init__(self, stretch: Stretch, limits: AxisLimits) -> None:
        count = max(3, ceil(stretch.length_in / STEP_IN) + 1)
        self._along = np.linspace(0.0, stretch.length_in, count)
        speeds = self._tops(stretch, limits)
        push = 2.0 * BRAKING_SHARE * limits.translation_in_s2 * float(self._along[1])
        speeds[0] = speeds[-1] = 0.0
        for way in (range(1, count), range(count - 2, -1, -1)):
            for k in way:
                near = speeds[k - 1] if way.step > 0 else speeds[k + 1]
                speeds[k] = min(speeds[k], sqrt(near * near + push))
        self._speeds = np.array(speeds)
        self._limits, self._end = limits, stretch.length_in
        steps = float(self._along[1])
        self.duration_s = sum(2.0 * steps / (one + other) for one, other in pairwise(speeds))

    def _tops(self, stretch: Stretch, limits: AxisLimits) -> list[float]:
        """The highest speed at each point, by the legs that meet there."""
        tops = np.full(len(self._along), limits.translation_in_s)
        for leg, start in zip(stretch.legs, stretch.starts_in, strict=False):
            there = (self._along >= start - STEP_IN) & (self._along <= start + leg.length_in + STEP_IN)
            tops[there] = np.minimum(tops[there], fastest_in_s(leg.curvature, limits))
        speeds: list[float] = tops.tolist()
        return speeds

    def speed_in_s(self, along_in: float) -> float:
        """The speed so far along; what stops it at the end, and no slower than CREEP_IN_S before.

        Where it sets off the next step's speed counts: at the very first it would be 0 for ever.
        """
        ahead = float(np.interp(min(along_in + STEP_IN, 0.5 * (along_in + self._end)), self._along, self._speeds))
        approach = CREEP_IN_S + APPROACH_HZ * (self._end - along_in)
        return max(CREEP_IN_S, min(self._limits.translation_in_s, ahead, approach))
