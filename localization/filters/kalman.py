"""Kalman filters as methods: prediction by the encoders, one echo at a time through a hearing.

    extended    systematic.predict, updates.linear           iterated    systematic.predict, updates.iterated
    unscented   sigma_points.predict, updates.unscented

Rules: holds a belief and hands out new ones; all arithmetic is the prediction's and the hearing's. A watch looks on and
says DEGRADED where what is heard does not fit; LOST is said by a filter alone that looks at other places (finder).
"""

from __future__ import annotations

from collections.abc import Callable

from localization.estimation.belief import Belief, Floats
from localization.estimation.hearing import Hearing
from localization.estimation.motion import OdometryNoise
from localization.estimation.observation import TELLING, Judgement, Refusal
from localization.estimation.repeats import Repeats
from localization.estimation.systematic import predict
from localization.filters.watch import Verdict, Watch

Predict = Callable[[Belief, Floats, OdometryNoise], Belief]
"""The belief after a step (2,) that the encoders tell."""


class KalmanFilter:
    """A gaussian belief over poses, or longer states."""

    def __init__(
        self, belief: Belief, hearing: Hearing, odometry: OdometryNoise, prediction: Predict = predict
    ) -> None:
        self.belief = belief
        self._hearing = hearing
        self._odometry = odometry
        self._predict = prediction
        self._watch = Watch()
        self._repeats = Repeats()

    @property
    def verdict(self) -> Verdict:
        return self._watch.verdict(self.belief)

    def move(self, step: Floats) -> None:
        self.belief = self._predict(self.belief, step, self._odometry)
        self._repeats.move(step)

    def ahead(self, step: Floats) -> Belief:
        return self._predict(self.belief, step, self._odometry)

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> Judgement:
        times = self._repeats.before(sonar, turret_offset_rad) + 1
        heard = self._hearing.hear(self.belief, sonar, turret_offset_rad, reading_in, times)
        self.belief = heard.belief
        if heard.judgement.refusal is Refusal.NONE:
            self._repeats.take(sonar, turret_offset_rad)
        if heard.judgement.refusal in TELLING:
            self._watch.look(heard.judgement)
        return heard.judgement
