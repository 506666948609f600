"""Kalman filters as methods: prediction by the encoders, one echo at a time through a hearing.

    extended    systematic.predict, updates.linear           iterated    systematic.predict, updates.iterated
    unscented   sigma_points.predict, updates.unscented

Rules: holds a belief and hands out new ones; all arithmetic is the prediction's and the hearing's. A watch looks on and
says DEGRADED where what is heard does not fit; LOST is said by a filter alone that looks at other places (finder).

The extended Kalman filter: the correction by many readings at once.

Rules: pure; no map, no sensor, no gate, no clock. Which beams may correct is settled before (observation.Observation).
Leading dimensions are independent filters.

    correct   K = P H' (H P H' + R)^-1, the gain   mean' = mean + K innovation
              P' = (I - K H) P (I - K H)' + K R K'   (Joseph: symmetric, never negative, whatever rounding does to K)

R is diagonal, so with A = H' R^-1 H the matrix inversion lemma gives K = M H' R^-1, M = (I + P A)^-1 P: one system as
large as the state instead of one as large as the ring. Then K H = M A and K R K' = M A M'.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from localization.filters.belief import Belief, Floats, add, difference
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import OdometryNoise, predict
from localization.filters.update import (
    INFORMATIVE,
    CorrelatedReadings,
    MeasurementUpdate,
    Observation,
    Refusal,
    UpdateResult,
)

Predict = Callable[[Belief, Floats, OdometryNoise], Belief]
"""The belief after a step (2,) that the encoders tell."""


class KalmanFilter:
    """A gaussian belief over poses, or longer states."""

    def __init__(
        self, belief: Belief, hearing: MeasurementUpdate, odometry: OdometryNoise, prediction: Predict = predict
    ) -> None:
        self.belief = belief
        self._hearing = hearing
        self._odometry = odometry
        self._predict = prediction
        self._watch = IntegrityMonitor()
        self._repeats = CorrelatedReadings()

    @property
    def health(self) -> FilterHealth:
        return self._watch.health(self.belief)

    def move(self, step: Floats) -> None:
        self.belief = self._predict(self.belief, step, self._odometry)
        self._repeats.move(step)

    def ahead(self, step: Floats) -> Belief:
        return self._predict(self.belief, step, self._odometry)

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        times = self._repeats.before(sonar, turret_offset_rad) + 1
        heard = self._hearing.hear(self.belief, sonar, turret_offset_rad, reading_in, times)
        self.belief = heard.belief
        if heard.judgement.refusal is Refusal.NONE:
            self._repeats.take(sonar, turret_offset_rad)
        if heard.judgement.refusal in INFORMATIVE:
            self._watch.look(heard.judgement)
        return heard.judgement


def correct(belief: Belief, observation: Observation) -> Belief:
    """The belief after an observation of n beams; any state of three coordinates or more."""
    weighted = (observation.jacobian / observation.variance[..., None]).swapaxes(-1, -2)
    gained = weighted @ observation.jacobian
    identity = _identity(belief.mean.shape[-1])
    spread = np.linalg.solve(identity + belief.cov @ gained, belief.cov)
    learned = spread @ gained
    cov = _around(identity - learned, belief.cov) + learned @ spread.swapaxes(-1, -2)
    change = spread @ (weighted @ observation.innovation[..., None])
    return Belief(add(belief.mean, change[..., 0]), _symmetric(cov))


def innovation_squared(before: Belief, after: Belief, observation: Observation) -> Floats:
    """NIS (...): innovation' S^-1 innovation of a correction from `before` to `after`.

    As many degrees of freedom as beams used. S^-1 innovation = R^-1 (innovation - H K innovation), and K innovation is
    what the correction added, so nothing is inverted.
    """
    change = difference(after.mean, before.mean)
    rest = observation.innovation - (observation.jacobian @ change[..., None])[..., 0]
    nis: Floats = (observation.innovation * rest / observation.variance).sum(axis=-1)
    return nis


def _around(factor: Floats, cov: Floats) -> Floats:
    product: Floats = factor @ cov @ factor.swapaxes(-1, -2)
    return product


def _symmetric(cov: Floats) -> Floats:
    """Rounding leaves the two halves of a covariance a few bits apart; their mean."""
    mean: Floats = 0.5 * (cov + cov.swapaxes(-1, -2))
    return mean


@lru_cache(maxsize=8)
def _identity(size: int) -> Floats:
    identity = np.eye(size)
    identity.setflags(write=False)
    return identity
