"""A sonar as a cone: all that it may hear, each with its chance, and bad readings."""

from __future__ import annotations

from functools import partial
from math import sqrt

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import HEADING, Belief
from localization.estimation.candidates import Candidates
from localization.estimation.hearing import Sensed
from localization.estimation.observation import Refusal
from localization.estimation.systematic import POSE
from localization.sonar.cone import ConeModel, Ear, expected
from localization.sonar.measurement import SonarRing, wall_map
from localization.sonar.reflectors import reflectors
from localization.sonar.single_cone import Listener


class ConeSense:
    """Each reading is the first echo out of a cone, or a bad one, with probabilities."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, model: ConeModel) -> None:
        self._around, self._body, self._model = reflectors(wall_map(walls).segments), body, model
        self._listener = Listener(self._around, model)

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Sensed:
        model = self._model
        if reading_in <= model.lowest_in:
            return Sensed(Refusal.LIMIT, 1.0)
        ear = Ear(turret_offset_rad + self._body.sonar_angles_rad[sonar], self._body.sonar_ring_radius_in)
        x, y, heading = belief.mean[:POSE].tolist()
        returns = self._listener.hear((x, y, heading), sqrt(belief.cov[HEADING, HEADING]), ear)
        if reading_in >= model.highest_in:
            heard = sum([found.probability for found in returns])
            return Sensed(Refusal.LIMIT, 1.0 - (1.0 - model.bad_share) * heard)
        if not returns:
            return Sensed(Refusal.NO_WALL, model.bad_density)
        which, ranges, jacobian, probability = zip(*returns, strict=True)
        candidates = Candidates(
            np.array(ranges),
            np.array(jacobian),
            np.array([model.variance_at(range_in) for range_in in ranges]),
            np.array([model.constant_at(range_in) for range_in in ranges]),
            np.array(probability),
            partial(expected, ear=ear, around=self._around, which=np.array(which)),
            model.bad_share,
            model.bad_density,
        )
        return Sensed(Refusal.NONE, 1.0, candidates)
