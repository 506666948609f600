"""A fixed-lag smoother: the extended Kalman filter, and the pose of a while ago by all readings since.

For maps, surveys and ground truth; control needs the present pose, of which a smoother knows no more than a filter.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import ClassVar, Final, NamedTuple

import numpy as np

from localization.filters.belief import Belief, Floats, add, difference, marginal
from localization.filters.ekf import KalmanFilter
from localization.filters.health import HealthLimits
from localization.filters.odometry import OdometryNoise, step_jacobians
from localization.filters.update import MeasurementUpdate

LAG: Final = 32
"""Steps that the smoother looks back, one for each reading: two rings of sixteen, about two seconds."""


class Step(NamedTuple):
    """One prediction: the filtered belief before it, the predicted belief, and the smoother gain between them."""

    filtered: Belief
    predicted: Belief
    gain: Floats


class FixedLagSmoother(KalmanFilter):
    """The extended Kalman filter, which also smooths: it records each prediction.

    Parameters
    ----------
    lag
        Number of predictions to look back.

    Raises
    ------
    ValueError
        A lag below 1.
    """

    TAKES_RINGS: ClassVar[bool] = False

    def __init__(self, belief: Belief, measurement: MeasurementUpdate, odometry: OdometryNoise, lag: int = LAG,
                 range_stds: Sequence[float] = (), middle_in: tuple[float, float] = (0.0, 0.0),
                 limits: HealthLimits | None = None) -> None:  # fmt: skip
        super().__init__(belief, measurement, odometry, range_stds=range_stds, middle_in=middle_in, limits=limits)
        if lag < 1:
            raise ValueError(f"the lag of a smoother must be at least 1 step, not {lag}")
        self._steps: deque[Step] = deque(maxlen=lag)
        self.lag = lag

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict, and store what smoothing needs.

        C = P_k F^T P_k+1|k^-1, with the pseudo-inverse: a coordinate that is certain stays so.
        """
        filtered = self.state
        super().predict(distance_in, turn_rad)
        predicted = self.state
        F, _ = step_jacobians(filtered.mean, np.array((distance_in, turn_rad)), self._constants)
        gain = filtered.cov @ F.T @ np.linalg.pinv(predicted.cov, hermitian=True)
        self._steps.append(Step(filtered, predicted, gain))

    def smoothed(self) -> Belief:
        """Return the belief over the state `lag` predictions ago (the first, where there were fewer), smoothed."""
        belief = self.state
        for step in reversed(self._steps):
            belief = smooth(step, belief)
        return marginal(belief, self._size)


def smooth(step: Step, later: Belief) -> Belief:
    """Return the smoothed belief before a prediction from the smoothed belief `later`, after it.

    x_k^s = x_k + C (x_k+1^s - x_k+1|k)        P_k^s = P_k + C (P_k+1^s - P_k+1|k) C^T

    References
    ----------
    Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems (1965).
    """
    C = step.gain
    mean = add(step.filtered.mean, C @ difference(later.mean, step.predicted.mean))
    cov = step.filtered.cov + C @ (later.cov - step.predicted.cov) @ C.T
    return Belief(mean, 0.5 * (cov + cov.T))
