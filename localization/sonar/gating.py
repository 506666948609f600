"""Which readings may correct a belief, and why the others may not.

Rules: pure; looks at belief and readings and changes neither; every beam left out has its reason. A beam is used when
it meets the same wall from poses `sigmas` standard deviations to either side, strikes it steeply enough, and its
innovation passes a chi-square gate of one degree of freedom.

"To either side" is meant as the beam sees it. Of all poses on the ellipsoid d' P^-1 d = sigmas^2 the two that carry
the beam farthest sideways where it meets the wall are +-sigmas P g / sqrt(g' P g), g the derivative of that sideways
way by the pose: two rays a beam, whatever the units of the state, and to first order no pose of the ellipsoid carries
it farther. (The ends of the principal axes would be six rays, and may fall short of that by a factor of sqrt(3).)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from localization.estimation.belief import Belief, Floats
from localization.estimation.chi_square import chi_square_quantile
from localization.estimation.observation import Codes, Mask, Observation, Refusal
from localization.sonar.measurement import (
    Beams,
    Indices,
    Rays,
    Sight,
    SonarModel,
    WallMap,
    left_of,
    meet,
    range_jacobian,
    rays,
    sight,
)


@dataclass(frozen=True, slots=True)
class Gate:
    """How strictly beams are chosen: `sigmas` to either side, the least |cos(incidence)|, and the probability with
    which a good reading passes the chi-square gate."""

    sigmas: float = 3.0
    min_cos_incidence: float = 0.3
    probability: float = 0.999

    @property
    def threshold(self) -> float:
        """The largest squared innovation, over its variance, that passes."""
        return chi_square_quantile(self.probability, 1)


STRICT = Gate()
"""The choice of beams all experiments share."""


class Association(NamedTuple):
    """Which wall each beam is taken to meet, what is expected there, and what speaks against it.

    `lines` (..., n, 3); `seen` and `jacobian` (..., n, 3) against them; `refusals` (..., n) as known without readings.
    """

    lines: Floats
    seen: Sight
    jacobian: Floats
    refusals: Codes


def associate(belief: Belief, beams: Beams, walls: WallMap, gate: Gate = STRICT) -> Association:
    """Pair the n beams of each belief (mean (..., 3), cov (..., 3, 3)) with walls of the map."""
    aimed = rays(belief.mean[..., None, :], beams)
    met = meet(aimed, walls)
    lines = walls.lines[met]
    seen = sight(aimed, lines)
    refusals = np.zeros(met.shape, dtype=np.int8)
    np.putmask(refusals, ~(np.abs(seen.cos_incidence) >= gate.min_cos_incidence), Refusal.GRAZING.value)
    ambiguous = ~_same_wall_around(belief, beams, walls, (met, aimed, seen), gate.sigmas)
    np.putmask(refusals, ambiguous, Refusal.AMBIGUOUS_WALL.value)
    np.putmask(refusals, met < 0, Refusal.NO_WALL.value)
    return Association(lines, seen, range_jacobian(seen, lines), refusals)


def observe(
    belief: Belief, beams: Beams, readings_in: Floats, walls: WallMap, sonar: SonarModel, gate: Gate = STRICT
) -> Observation:
    """Readings (..., n) in inches of n beams, judged against beliefs of mean (..., 3) and cov (..., 3, 3)."""
    return judged(associate(belief, beams, walls, gate), belief, readings_in, sonar, gate)


def judged(
    paired: Association, belief: Belief, readings_in: Floats, sonar: SonarModel, gate: Gate = STRICT
) -> Observation:
    """What readings (..., n) of beams that are paired with walls say; `paired` is left as it was."""
    _, seen, by_pose, known = paired
    jacobian, refusals = by_pose.copy(), known.copy()
    innovation = readings_in - seen.ranges_in
    variance = sonar.variance(seen.ranges_in)
    spread = np.einsum("...i,...i->...", jacobian @ belief.cov, jacobian)
    likely = innovation * innovation <= gate.threshold * (spread + variance)
    np.putmask(refusals, ~(likely | (refusals != Refusal.NONE.value)), Refusal.GATE.value)
    measured = (readings_in > sonar.lowest_in) & (readings_in < sonar.highest_in)
    np.putmask(refusals, ~measured, Refusal.LIMIT.value)
    silent = refusals != Refusal.NONE.value
    np.copyto(innovation, 0.0, where=silent)
    np.copyto(jacobian, 0.0, where=silent[..., None])
    np.copyto(variance, 1.0, where=silent)
    return Observation(innovation, jacobian, variance, refusals)


def _same_wall_around(
    belief: Belief, beams: Beams, walls: WallMap, at_mean: tuple[Indices, Rays, Sight], sigmas: float
) -> Mask:
    """Which beams meet the wall they meet at the mean from both extreme poses too (see the head of this file).

    Where a beam meets w from the robot's position, it moves sideways by e . (dp + J w dtheta), e its left normal:
    g = (-d_y, d_x, d . w).
    """
    met, aimed, seen = at_mean
    sideways = np.empty((*met.shape, 3))
    sideways[..., :2] = left_of(aimed.directions)
    sideways[..., 2] = (aimed.directions * seen.points_in).sum(axis=-1)
    np.copyto(sideways, 0.0, where=(met < 0)[..., None])  # the ray caster wants finite poses
    pull = sideways @ belief.cov
    way = np.sqrt((pull * sideways).sum(axis=-1, keepdims=True))
    np.copyto(way, 1.0, where=~(way > 0.0))
    shift = (sigmas / way) * pull
    poses = np.empty((2, *shift.shape))
    np.add(belief.mean[..., None, :], shift, out=poses[0])
    np.subtract(belief.mean[..., None, :], shift, out=poses[1])
    same: Mask = (meet(rays(poses, beams), walls) == met).all(axis=0)
    return same
