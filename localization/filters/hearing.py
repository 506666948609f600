"""How a filter takes one reading in: which echo it is taken for, and the belief it leaves. A class a kind of sonar.

    RayHearing    one exact ray a sonar: gate, then correct or leave out           setups `ideal` and `noisy`
    ConeHearing   the nearest thing in a cone: a mixture of all it may be          setup `measured`, a real ring

Rules: pure; a belief in, a belief out, and the reason where a reading said nothing. Whoever hands them over has brought
the belief to the instant at which the sonar fired. States may be longer than a pose (see systematic).
"""

from __future__ import annotations

from math import exp, pi, sqrt
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.belief import Belief
from localization.cone import ConeModel, Ear, cone_returns
from localization.ekf import correct
from localization.filters.method import Judgement
from localization.gating import STRICT, Gate, observe
from localization.measurement import SonarModel, SonarRing, pick, ring, wall_map
from localization.mixture import absorb
from localization.observation import Observation, Refusal
from localization.reflectors import reflectors
from localization.systematic import POSE

BAD_RAYS, SPAN_IN = 0.05, 249.0
"""What is taken for bad of exact rays' readings, anywhere from 6 to 255 in: for likelihoods alone, the gate decides."""
MOSTLY_BAD = 0.5
"""A reading that is bad with more than this probability is told as refused by the gate."""


class Heard(NamedTuple):
    """What a reading left: the belief, what became of it, and how well the belief before it explains it: a density per
    inch for a range, a chance for a limit; the same kind for the same reading, whatever the belief."""

    belief: Belief
    judgement: Judgement
    likelihood: float


class Hearing(Protocol):
    """A kind of sonar, in a map, on a body."""

    def hear(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Heard:
        """Take in what sonar number `sonar` reads, the turret being turned by so much against the heading."""
        ...


class RayHearing:
    """Each reading is the range along one ray, or it is refused."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, sonar: SonarModel, gate: Gate = STRICT) -> None:
        self._walls, self._body, self._sonar, self._gate = wall_map(walls), body, sonar, gate

    def hear(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Heard:
        beam = pick(ring(self._body, turret_offset_rad), sonar)
        seen = observe(pose_of(belief), beam, np.array([reading_in]), self._walls, self._sonar, self._gate)
        refusal, innovation = seen.reasons()[0], float(seen.innovation[0])
        if refusal is not Refusal.NONE:
            return Heard(belief, Judgement(refusal, innovation, 0.0, 1.0), _unexplained(refusal))
        jacobian = np.zeros((1, belief.mean.shape[-1]))
        jacobian[:, :POSE] = seen.jacobian
        spread = float((jacobian @ belief.cov @ jacobian.T)[0, 0] + seen.variance[0])
        corrected = correct(belief, Observation(seen.innovation, jacobian, seen.variance, seen.refusals))
        nis = innovation * innovation / spread
        hit = exp(-0.5 * nis) / sqrt(2.0 * pi * spread)
        return Heard(corrected, Judgement(refusal, innovation, nis, 0.0), (1.0 - BAD_RAYS) * hit + BAD_RAYS / SPAN_IN)


class ConeHearing:
    """Each reading is the first echo out of a cone, or a bad one, with probabilities."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, model: ConeModel) -> None:
        self._around, self._body, self._model = reflectors(wall_map(walls).segments), body, model

    def hear(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Heard:
        model = self._model
        if reading_in <= model.lowest_in:
            return Heard(belief, Judgement(Refusal.LIMIT, 0.0, 0.0, 1.0), 1.0)
        ear = Ear(turret_offset_rad + self._body.sonar_angles_rad[sonar], self._body.sonar_ring_radius_in)
        pose = pose_of(belief)
        returns = cone_returns(pose.mean, pose.std[..., 2], ear, self._around, model)
        if reading_in >= model.highest_in:
            nothing = 1.0 - (1.0 - model.bad_share) * float(returns.probability.sum())
            return Heard(belief, Judgement(Refusal.LIMIT, 0.0, 0.0, 1.0), nothing)
        if not returns.probability.any():
            return Heard(belief, Judgement(Refusal.NO_WALL, 0.0, 0.0, 1.0), model.bad_density)
        taken = absorb(belief, reading_in, returns, model)
        refusal = Refusal.GATE if taken.bad_share > MOSTLY_BAD else Refusal.NONE
        judgement = Judgement(refusal, taken.innovation_in, taken.nis, taken.bad_share)
        return Heard(taken.belief, judgement, taken.likelihood)


def _unexplained(refusal: Refusal) -> float:
    """The likelihood of a reading that a ray refused: that of a bad one where it was not met, else of any."""
    return 1.0 if refusal is Refusal.LIMIT else BAD_RAYS / SPAN_IN if refusal is Refusal.GATE else 1.0 / SPAN_IN


def hearing_of(walls: npt.ArrayLike, body: SonarRing, sonar: SonarModel | ConeModel, gate: Gate = STRICT) -> Hearing:
    """How sonars of this model are taken in."""
    if isinstance(sonar, ConeModel):
        return ConeHearing(walls, body, sonar)
    return RayHearing(walls, body, sonar, gate)


def pose_of(belief: Belief) -> Belief:
    """The part of a belief (..., n) that is about the pose."""
    return Belief(belief.mean[..., :POSE], belief.cov[..., :POSE, :POSE])
