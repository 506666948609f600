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
from math import cos, sin
from typing import Final, NamedTuple

import numpy as np

from localization.estimation import chi_square
from localization.estimation.belief import Belief, Floats
from localization.estimation.observation import Codes, Mask, Observation, Refusal
from localization.sonar.measurement import (
    Beams,
    Complexes,
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
from localization.sonar.ring_code import RING, empty


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
        return chi_square.quantile(self.probability, 1)


STRICT = Gate()
"""The choice of beams all experiments share."""


_LEAST_IN2: Final = 1e-200
"""A variance that is none, but that can be divided by."""


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
    if belief.mean.ndim == 1 and beams.directions.ndim == 2:
        return _associate_one(belief, beams, walls, gate)
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


def _associate_one(belief: Belief, beams: Beams, walls: WallMap, gate: Gate) -> Association:
    """`associate` of a single belief, in complex numbers: two of each array's calls are one.

    A place is x + iy, to turn by a is to multiply by exp(ia), and conj(u) v is u . v + i (u x v).
    """
    x, y, heading = belief.mean.tolist()
    here = complex(x, y)
    arms, directions = beams.turning * complex(cos(heading), sin(heading))
    starts = arms + here
    met = walls.first_wall.rows(starts, directions)
    normals = walls.normals[met]
    cosine = (normals * directions).real
    all_met = bool(cosine.all())
    blind = None if all_met else cosine == 0.0
    if blind is not None:
        cosine[blind] = 1.0
    from_axis = (walls.offsets[met] - (normals * starts).real) / cosine
    points = arms + from_axis * directions
    lines = walls.lines[met]
    jacobian = np.empty((len(met), 3))
    np.negative(lines[:, :2], out=jacobian[:, :2])
    jacobian[:, 2] = (normals * points).imag
    jacobian /= cosine[:, None]
    refusals = np.zeros(len(met), dtype=np.int8)
    np.putmask(refusals, np.abs(cosine) < gate.min_cos_incidence, Refusal.GRAZING.value)
    same = _same_from_both_sides(belief.cov, here, (arms, directions, points), walls, met, gate.sigmas)
    np.putmask(refusals, ~same, Refusal.AMBIGUOUS_WALL.value)
    if blind is not None:
        refusals[blind] = Refusal.AMBIGUOUS_WALL.value
        refusals[met == walls.first_wall.nothing] = Refusal.NO_WALL.value
        for part in (cosine, from_axis, points, jacobian):
            part[blind] = np.nan
    in_pairs = points.view(np.float64).reshape(-1, 2)
    return Association(lines, Sight(from_axis - beams.standoff_in, cosine, in_pairs), jacobian, refusals)


def _same_from_both_sides(
    cov: Floats,
    here: complex,
    aimed: tuple[Complexes, Complexes, Complexes],
    walls: WallMap,
    met: Indices,
    sigmas: float,
) -> Mask:
    """`_same_wall_around` of a single belief; `aimed`: arms, directions, and ways to the points met, all finite."""
    arms, directions, points = aimed
    sideways = np.empty((3, len(met)))
    np.negative(directions.imag, out=sideways[0])
    sideways[1] = directions.real
    sideways[2] = (directions.conj() * points).real
    pull = cov @ sideways
    square = pull * sideways
    shift = pull * (sigmas / np.sqrt(np.maximum(square[0] + square[1] + square[2], _LEAST_IN2)))
    bends, there = np.empty((2, len(met)), complex), np.empty((2, len(met)), complex)
    np.exp(1j * shift[2], out=bends[0])
    np.conj(bends[0], out=bends[1])
    aside = shift[0] + 1j * shift[1]
    np.add(here, aside, out=there[0])
    np.subtract(here, aside, out=there[1])
    there += bends * arms
    bends *= directions
    one, other = walls.first_wall.rows(there, bends) == met
    both: Mask = one & other
    return both


def observe(
    belief: Belief, beams: Beams, readings_in: Floats, walls: WallMap, sonar: SonarModel, gate: Gate = STRICT
) -> Observation:
    """Readings (..., n) in inches of n beams, judged against beliefs of mean (..., 3) and cov (..., 3, 3).

    With machine code (ring_code) where that is loaded and there is one belief.
    """
    loop = RING.run
    if loop is not None and belief.mean.ndim == readings_in.ndim == 1 and beams.directions.ndim == 2:
        observation = Observation(*empty(len(readings_in)))
        loop(
            belief.mean,
            belief.cov,
            beams.axes_in,
            beams.directions,
            beams.standoff_in,
            walls.segments,
            walls.lines,
            (gate.sigmas, gate.min_cos_incidence, gate.threshold),
            (sonar.relative_std, sonar.floor_std_in, sonar.rounding_var_in2, sonar.lowest_in, sonar.highest_in),
            readings_in,
            observation.innovation,
            observation.jacobian,
            observation.variance,
            observation.refusals,
        )
        return observation
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
