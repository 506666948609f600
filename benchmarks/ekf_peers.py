"""The same sixteen scalar updates by filterpy and Stone-Soup, given everything that is expensive.

Each is handed F, Q, the predicted mean and sixteen linear readings with their H, and returns a belief. What can be made
beforehand is made beforehand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from filterpy.kalman import KalmanFilter
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import GaussianStatePrediction
from stonesoup.updater.kalman import KalmanUpdater

from localization.filters.belief import Belief, Floats

if TYPE_CHECKING:
    from ekf import Linear


class FilterPy:
    """filterpy's Kalman filter."""

    def __init__(self, given: Linear) -> None:
        self._filter, self._given = KalmanFilter(dim_x=3, dim_z=1), given
        self._updates = list(zip(given.z, given.R, given.H[:, None, :], strict=True))

    def step(self) -> Belief:
        """Predict, and update sixteen times."""
        kalman, given = self._filter, self._given
        # The state is set again in each call, so that all calls do the same work.
        kalman.x, kalman.P = given.before.mean, given.before.cov
        kalman.predict(F=given.F, Q=given.Q)
        # The nonlinear prediction is given: filterpy would compute F x.
        kalman.x = given.predicted
        for z, R, H in self._updates:
            kalman.update(z, R=R, H=H)
        return Belief(kalman.x, kalman.P)


class Row(LinearGaussian):  # type: ignore[misc]  # Stone-Soup has no types
    """A scalar reading by any H."""

    by_state: Floats

    def matrix(self, **_: object) -> Floats:
        return self.by_state


class StoneSoup:
    """Stone-Soup's Kalman updater."""

    def __init__(self, given: Linear) -> None:
        self._given, self._updater = given, KalmanUpdater(None)
        self._detections = []
        for z, R, H in zip(given.z, given.R, given.H, strict=True):
            model = Row(ndim_state=3, mapping=(0,), noise_covar=np.array([[R]]))
            # H as a matrix of one row: the model needs no Jacobian.
            model.by_state = H[None]
            self._detections.append(Detection(np.array([[z]]), measurement_model=model))

    def step(self) -> Belief:
        """Predict, and update sixteen times."""
        given = self._given
        cov = given.F @ given.before.cov @ given.F.T + given.Q
        state = GaussianStatePrediction(given.predicted[:, None], cov)
        for detection in self._detections:
            after = self._updater.update(SingleHypothesis(state, detection))
            # Each posterior becomes the prior of the next reading.
            state = GaussianStatePrediction(after.state_vector, after.covar)
        return Belief(np.array(state.state_vector, dtype=np.float64)[:, 0], np.array(state.covar, dtype=np.float64))
