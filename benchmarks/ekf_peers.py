"""Other people's filters on the benchmark's one step: sixteen scalar updates, given all that is dear.

Rules: each is handed F, Q, the mean moved and sixteen linear readings with their H, and gives a belief back. What can
be made beforehand is made beforehand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import GaussianStatePrediction
from stonesoup.updater.kalman import KalmanUpdater

from localization.filters.belief import Belief, Floats


class Linear(NamedTuple):
    """A step that is linear already: the belief before it, where it leads, F, Q, and n readings (n,) of variance (n,)
    by H (n, 3)."""

    before: Belief
    moved: Floats
    by_pose: Floats
    process_cov: Floats
    readings: Floats
    variance: Floats
    jacobian: Floats


class FilterPy:
    """filterpy's Kalman filter."""

    def __init__(self, given: Linear) -> None:
        self._filter, self._given = KalmanFilter(dim_x=3, dim_z=1), given
        self._updates = list(zip(given.readings, given.variance, given.jacobian[:, None, :], strict=True))

    def step(self) -> Belief:
        """Predict and correct."""
        kalman, given = self._filter, self._given
        kalman.x, kalman.P = given.before.mean, given.before.cov
        kalman.predict(F=given.by_pose, Q=given.process_cov)
        kalman.x = given.moved
        for reading, variance, row in self._updates:
            kalman.update(reading, R=variance, H=row)
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
        for reading, variance, row in zip(given.readings, given.variance, given.jacobian, strict=True):
            model = Row(ndim_state=3, mapping=(0,), noise_covar=np.array([[variance]]))
            model.by_state = row[None]
            self._detections.append(Detection(np.array([[reading]]), measurement_model=model))

    def step(self) -> Belief:
        """Predict and correct."""
        given = self._given
        cov = given.by_pose @ given.before.cov @ given.by_pose.T + given.process_cov
        state = GaussianStatePrediction(given.moved[:, None], cov)
        for detection in self._detections:
            after = self._updater.update(SingleHypothesis(state, detection))
            state = GaussianStatePrediction(after.state_vector, after.covar)
        return Belief(np.array(state.state_vector, dtype=np.float64)[:, 0], np.array(state.covar, dtype=np.float64))
