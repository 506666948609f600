"""What a reading may be of, seen from a belief: the map's answer for each kind of sonar, and why there may be none.

    RaySense     one exact ray a sonar: the wall it meets, or a refusal by the gate      setups `ideal` and `noisy`
    ConeSense    all that the cone may hear, each with its chance, and bad readings      setup `measured`, a real ring

Rules: pure; looks at belief and reading and changes neither. What a candidate makes of the belief is a rule of
correction's to say (updates). States may be longer than a pose (see systematic).
"""

from __future__ import annotations

from functools import partial
from math import sqrt
from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import HEADING, Belief, Floats
from localization.estimation.candidates import Candidates
from localization.estimation.observation import Refusal
from localization.estimation.systematic import POSE
from localization.sonar.cone import ConeModel, Ear, expected
from localization.sonar.gating import STRICT, Gate
from localization.sonar.measurement import Beams, SonarModel, SonarRing, range_jacobian, rays, sight, wall_map
from localization.sonar.reflectors import reflectors
from localization.sonar.single_beam import sound
from localization.sonar.single_cone import Listener

BAD_RAYS, SPAN_IN = 0.05, 249.0
"""What is taken for bad of exact rays' readings, anywhere from 6 to 255 in: for likelihoods alone, the gate decides."""
SURE: Final = np.ones(1)


class Sensed(NamedTuple):
    """What a reading may be of, or why it says nothing.

    likelihood    where it is refused: how well the belief explains that
    besides       share of readings that are bad beside those the candidates tell of; for the likelihood alone
    """

    refusal: Refusal
    likelihood: float
    candidates: Candidates | None = None
    besides: float = 0.0


class Sense(Protocol):
    """A kind of sonar, in a map, on a body."""

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Sensed:
        """What sonar number `sonar` may have heard, the turret being turned by so much against the heading."""
        ...


class RaySense:
    """Each reading is the range along one ray, or it is refused."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, sonar: SonarModel, gate: Gate = STRICT) -> None:
        self._walls, self._body, self._sonar, self._gate = wall_map(walls), body, sonar, gate
        self._angles = body.sonar_angles_rad

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Sensed:
        sonar_model, gate = self._sonar, self._gate
        if not sonar_model.lowest_in < reading_in < sonar_model.highest_in:
            return _REFUSED[Refusal.LIMIT]
        direction_rad, standoff_in = turret_offset_rad + self._angles[sonar], self._body.sonar_ring_radius_in
        beam = sound(belief, direction_rad, standoff_in, self._walls, gate.sigmas, gate.min_cos_incidence)
        if beam.refusal is not Refusal.NONE:
            return _REFUSED[beam.refusal]
        variance, innovation_in = sonar_model.variance_at(beam.range_in), reading_in - beam.range_in
        if not innovation_in * innovation_in <= gate.threshold * (beam.spread_in2 + variance):
            return _REFUSED[Refusal.GATE]
        expect = partial(_along, direction_rad, standoff_in, self._walls.lines[beam.row])
        candidates = Candidates(
            np.array([beam.range_in]),
            np.array([beam.jacobian]),
            np.array([variance]),
            np.array([sonar_model.constant_at(beam.range_in)]),
            SURE,
            expect,
            0.0,
            0.0,
        )
        return Sensed(Refusal.NONE, 1.0, candidates, BAD_RAYS)


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


def sense_of(walls: npt.ArrayLike, body: SonarRing, sonar: SonarModel | ConeModel, gate: Gate = STRICT) -> Sense:
    """How sonars of this model are understood."""
    if isinstance(sonar, ConeModel):
        return ConeSense(walls, body, sonar)
    return RaySense(walls, body, sonar, gate)


def pose_of(belief: Belief) -> Belief:
    """The part of a belief (..., n) that is about the pose."""
    return Belief(belief.mean[..., :POSE], belief.cov[..., :POSE, :POSE])


def _along(direction_rad: float, standoff_in: float, line: Floats, poses: Floats) -> tuple[Floats, Floats]:
    """Ranges (..., 1) along a beam to a line (3,), and their derivatives, from poses (..., 1, 3)."""
    way = np.array([[np.cos(direction_rad), np.sin(direction_rad)]])
    seen = sight(rays(poses, Beams(np.zeros((1, 2)), way, standoff_in)), line[None])
    return seen.ranges_in, range_jacobian(seen, line[None])


def _unexplained(refusal: Refusal) -> float:
    """The likelihood of a reading that a ray refused: that of a bad one where it was not met, else of any."""
    return 1.0 if refusal is Refusal.LIMIT else BAD_RAYS / SPAN_IN if refusal is Refusal.GATE else 1.0 / SPAN_IN


_REFUSED: Final = {refusal: Sensed(refusal, _unexplained(refusal)) for refusal in Refusal if refusal}
