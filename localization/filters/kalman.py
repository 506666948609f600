"""The extended Kalman filter as a method: prediction by the encoders, one echo at a time through a hearing.

Rules: holds a belief and hands out new ones; all arithmetic is systematic's and the hearing's.
"""

from __future__ import annotations

from localization.belief import Belief, Floats
from localization.filters.hearing import Hearing
from localization.filters.method import Judgement
from localization.motion import OdometryNoise
from localization.systematic import predict
from localization.watch import ALL_WELL, Verdict


class KalmanFilter:
    """A gaussian belief over poses, or longer states."""

    def __init__(self, belief: Belief, hearing: Hearing, odometry: OdometryNoise) -> None:
        self.belief = belief
        self._hearing = hearing
        self._odometry = odometry

    @property
    def verdict(self) -> Verdict:
        return ALL_WELL

    def move(self, step: Floats) -> None:
        self.belief = predict(self.belief, step, self._odometry)

    def ahead(self, step: Floats) -> Belief:
        return predict(self.belief, step, self._odometry)

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> Judgement:
        heard = self._hearing.hear(self.belief, sonar, turret_offset_rad, reading_in)
        self.belief = heard.belief
        return heard.judgement
