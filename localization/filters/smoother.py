"""A fixed-lag smoother: the extended Kalman filter, and where the robot was a while ago by all that was heard since.

    belief        the filter's, of now: a smoother knows no more of the present than a filter does
    smoothed()    of the state `lag` moves ago; with an echo a move, as the localizer has it, `lag` echoes ago

Backwards over the last moves (Rauch, Tung, Striebel 1965), from the present belief, k filtered, k+1- predicted:

    G = P_k F' P_k+1-^-1     mean_k^s = mean_k + G (mean_k+1^s - mean_k+1-)     P_k^s = P_k + G (P_k+1^s - P_k+1-) G'

(with the pseudo-inverse: a coordinate that is certain stays so.)

For maps, surveys and ground truth of what has been driven; whoever steers needs the present. Rules: as KalmanFilter's.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Belief, Floats, add, difference
from localization.filters.ekf import KalmanFilter
from localization.filters.odometry import OdometryNoise, step_jacobians
from localization.filters.update import MeasurementUpdate

LAG: Final = 32
"""Two rings of sixteen: some two seconds."""


class Knot(NamedTuple):
    """A move: the belief it began with, what it was predicted to become, and G, how one answers to the other."""

    filtered: Belief
    predicted: Belief
    gain: Floats


class FixedLagSmoother(KalmanFilter):
    """See the head of this file. Raises ValueError for a lag below 1."""

    def __init__(self, belief: Belief, hearing: MeasurementUpdate, odometry: OdometryNoise, lag: int = LAG) -> None:
        super().__init__(belief, hearing, odometry)
        if lag < 1:
            raise ValueError(f"a smoother looks back 1 move or more, not {lag}")
        self._knots: deque[Knot] = deque(maxlen=lag)
        self.lag = lag

    def move(self, step: Floats) -> None:
        before = self.belief
        super().move(step)
        by_state, _ = step_jacobians(before.mean, step)
        gain = before.cov @ by_state.T @ np.linalg.pinv(self.belief.cov, hermitian=True)
        self._knots.append(Knot(before, self.belief, gain))

    def smoothed(self) -> Belief:
        """The belief over the state `lag` moves ago (at the first, where there were fewer), its readings included."""
        later = self.belief
        for knot in reversed(self._knots):
            later = _smoothed(knot, later)
        return later


def _smoothed(knot: Knot, later: Belief) -> Belief:
    """The belief before a move, the one after it being known as `later`."""
    mean = add(knot.filtered.mean, knot.gain @ difference(later.mean, knot.predicted.mean))
    cov = knot.filtered.cov + knot.gain @ (later.cov - knot.predicted.cov) @ knot.gain.T
    return Belief(mean, 0.5 * (cov + cov.T))
