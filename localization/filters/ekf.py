"""The Kalman filter that `nomad localize` runs: extended, iterated or unscented, one sonar reading at a time.

    predict(step)      x, P by the encoders        odometry.predict_state, or ukf.predict_state
    update(reading)    x, P by a reading           update.MeasurementUpdate: Kalman gain in update.kalman_gain

`update_ring` applies the same Kalman update to whole rings of many robots at once, for the experiments.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from localization.filters.belief import HEADING, Belief, Floats, pack, unpack, wrap_angle
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import OdometryNoise, predict_state
from localization.filters.sonar_ray import Observation
from localization.filters.update import (
    INFORMATIVE,
    CorrelatedReadings,
    Covariance,
    MeasurementUpdate,
    Refusal,
    State,
    UpdateResult,
    kalman_update,
)

Prediction = Callable[[State, Covariance, float, float, OdometryNoise], None]
"""Predicts x and P after a step (distance, turn), in place."""


class KalmanFilter:
    """Gaussian filter over poses, or states with odometry parameters.

    Parameters
    ----------
    belief
        Belief before the first step, over states (n,), 3 <= n <= 6.
    measurement
        The measurement model and the rule of correction.
    odometry
        Noise of the encoders.
    prediction
        The prediction step: extended by default.
    """

    def __init__(
        self,
        belief: Belief,
        measurement: MeasurementUpdate,
        odometry: OdometryNoise,
        prediction: Prediction = predict_state,
    ) -> None:
        self._x, self._P = unpack(belief)
        self._measurement = measurement
        self._odometry = odometry
        self._predict = prediction
        self._monitor = IntegrityMonitor()
        self._correlated = CorrelatedReadings()

    @property
    def belief(self) -> Belief:
        """The present belief, mean (n,) and covariance (n, n)."""
        return pack(self._x, self._P)

    @property
    def health(self) -> FilterHealth:
        """Health of the estimate; a filter that considers one pose only never reports LOST."""
        return self._monitor.health(self.belief)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the belief after a step that the encoders report."""
        self._predict(self._x, self._P, distance_in, turn_rad, self._odometry)
        self._correlated.move(distance_in, turn_rad)

    def predicted(self, distance_in: float, turn_rad: float) -> Belief:
        """Return the belief after such a step, without taking it."""
        x, P = self._x.copy(), [row.copy() for row in self._P]
        self._predict(x, P, distance_in, turn_rad, self._odometry)
        return pack(x, P)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the belief by a reading of a sonar that fired at this very pose."""
        count = self._correlated.count(sonar, turret_offset_rad) + 1
        result = self._measurement.apply(self._x, self._P, sonar, turret_offset_rad, reading_in, count).result
        if result.refusal is Refusal.NONE:
            self._correlated.record(sonar, turret_offset_rad)
        if result.refusal in INFORMATIVE:
            self._monitor.add(result)
        return result


def update_ring(belief: Belief, observation: Observation) -> tuple[Belief, Floats]:
    """Correct beliefs (..., 3) by the n independent readings of a ring taken at one instant.

    The readings are linearised at the mean before all of them and applied one after another, which is the update by the
    whole vector, without the inverse of an (n, n) matrix.

    Returns
    -------
    tuple
        The beliefs, and the NIS (...) of the whole vector, with as many degrees of freedom as readings used.

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sequential processing
    of measurements.
    """
    x, P = unpack(Belief(np.zeros_like(belief.mean), belief.cov))  # x: the change of the mean
    nis: Floats = np.zeros(belief.mean.shape[:-1])
    for beam in range(observation.innovation.shape[-1]):
        H = [observation.H[..., beam, index] for index in range(observation.H.shape[-1])]
        # The innovation of this reading after those before it, in the linear model.
        innovation = observation.innovation[..., beam] - sum(h * change for h, change in zip(H, x, strict=True))
        nis = nis + kalman_update(x, P, H, observation.R[..., beam], innovation)
    updated = pack([before + change for before, change in zip(np.moveaxis(belief.mean, -1, 0), x, strict=True)], P)
    updated.mean[..., HEADING] = wrap_angle(updated.mean[..., HEADING])
    return updated, nis
