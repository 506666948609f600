"""A sonar as one exact ray: the wall it meets, or a refusal by the gate."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import Belief, Floats
from localization.estimation.candidates import Candidates
from localization.estimation.hearing import Sensed
from localization.estimation.observation import SPAN_IN, Refusal
from localization.sonar.gating import STRICT, Gate
from localization.sonar.measurement import Beams, SonarModel, SonarRing, range_jacobian, rays, sight, wall_map
from localization.sonar.single_beam import sound

BAD_RAYS: Final = 0.05
"""What is taken for bad of exact rays' readings: for likelihoods alone, the gate decides."""
SURE: Final = np.ones(1)


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


def _along(direction_rad: float, standoff_in: float, line: Floats, poses: Floats) -> tuple[Floats, Floats]:
    """Ranges (..., 1) along a beam to a line (3,), and their derivatives, from poses (..., 1, 3)."""
    way = np.array([[np.cos(direction_rad), np.sin(direction_rad)]])
    seen = sight(rays(poses, Beams(np.zeros((1, 2)), way, standoff_in)), line[None])
    return seen.ranges_in, range_jacobian(seen, line[None])


def _unexplained(refusal: Refusal) -> float:
    """The likelihood of a reading that a ray refused: that of a bad one where it was not met, else of any."""
    return 1.0 if refusal is Refusal.LIMIT else BAD_RAYS / SPAN_IN if refusal is Refusal.GATE else 1.0 / SPAN_IN


_REFUSED: Final = {refusal: Sensed(refusal, _unexplained(refusal)) for refusal in Refusal if refusal}
