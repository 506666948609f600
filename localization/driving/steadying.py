"""A steadier pose for whoever steers by an estimate: corrections come in bit by bit instead of at a stroke.

    shown  = shown moved by the odometry's step, then brought towards the estimate by the share 1 - exp(-dt / time_s)

A correction of the filter says that the robot was elsewhere all along, not that it jumped. Shown at a stroke it makes
the steering twitch; spread over `time_s` it lags by as much and twitches less. Rules: pure; the filter never sees it.
"""

from __future__ import annotations

import math

import numpy as np

from localization.filters.belief import Floats, add, difference
from localization.filters.odometry import move, step_between


class SteadyPose:
    """A pose that follows estimates with a time constant of `time_s` >= 0 seconds; 0 follows at once.

    Raises ValueError for a negative time.
    """

    def __init__(self, time_s: float) -> None:
        if not time_s >= 0.0:
            raise ValueError(f"a time constant is 0 s or more, not {time_s}")
        self._time_s = time_s
        self._shown: Floats | None = None
        self._odometry: Floats | None = None
        self._clock_s = 0.0

    def forget(self) -> None:
        """Nothing is believed any more: the next estimate is followed at once."""
        self._shown = None

    def update(self, clock_s: float, estimate: Floats, odometry: Floats) -> Floats:
        """What to steer by at this clock: estimate and encoder pose (3,) of that instant in, a pose (3,) out."""
        if self._shown is None or self._odometry is None or not self._time_s:
            self._shown = np.array(estimate)
        else:
            carried = move(self._shown, step_between(self._odometry, odometry))
            share = 1.0 - math.exp(-(clock_s - self._clock_s) / self._time_s)
            self._shown = add(carried, share * difference(estimate, carried))
        self._odometry, self._clock_s = np.array(odometry), clock_s
        return self._shown
