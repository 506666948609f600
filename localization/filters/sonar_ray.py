"""How far a range that a sonar tells strays from the range there is, and which of them are ranges.

    std = max(relative_std * range, floor_std_in),    variance = std^2 + rounding_var_in2

Rounding errs the same way each time a range is read that stays the same, unless noise shakes it from one step to the
next. Of two readings of one range, with noise of std each, in steps of q, the errors of rounding have the covariance

    q^2 sum_k exp(-4 pi^2 k^2 std^2 / q^2) / (2 pi^2 k^2)  <=  q^2 / 12 exp(-4 pi^2 std^2 / q^2)

(Widrow, Kollar 2008, appendix on dither; the bound is met without noise.)

Rules: pure. What a sonar hears, a ray or a cone, is measurement's and cone's.

What a sonar would read: the distance from the ring, along its own direction, to a wall of the map.

Rules: pure functions on arrays; no gate, no gain (see gating, ekf). A wall is a line in normal form,
normal . p = offset; which wall a beam meets is the ray caster's answer, how far it is and how that changes with the
pose is worked out here. A beam is a ray tied to the robot, and its reading starts `standoff` along it (the ring):

    axis  = (x, y) + Rot(theta) axis_in      direction = Rot(theta) direction
    range = (offset - normal . axis) / (normal . direction) - standoff

so a ring, a turned turret, and a beam fired a moment ago from another pose are all the same thing: Beams.

Which readings may correct a belief, and why the others may not.

Rules: pure; looks at belief and readings and changes neither; every beam left out has its reason. A beam is used when
it meets the same wall from poses `sigmas` standard deviations to either side, strikes it steeply enough, and its
innovation passes a chi-square gate of one degree of freedom.

"To either side" is meant as the beam sees it. Of all poses on the ellipsoid d' P^-1 d = sigmas^2 the two that carry
the beam farthest sideways where it meets the wall are +-sigmas P g / sqrt(g' P g), g the derivative of that sideways
way by the pose: two rays a beam, whatever the units of the state, and to first order no pose of the ellipsoid carries
it farther. (The ends of the principal axes would be six rays, and may fall short of that by a factor of sqrt(3).)

One beam of one robot, in plain numbers: what gating and measurement do for many in arrays, ten times as quick.

Rules: pure; gating.associate is the same for any number of beams and its witness. What each number means, and why a
beam is refused, is told there.

A sonar as one exact ray: the wall it meets, or a refusal by the gate.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from math import cos, exp, pi, sin, sqrt
from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, Belief, Floats, chi_square_quantile
from localization.filters.update import SPAN_IN, Association, Codes, Hypotheses, Mask, Observation, Refusal
from worlds.raycast import NO_WALL, WallIndex, cast_rays


@dataclass(frozen=True, slots=True)
class RangeNoise:
    """Standard deviation `relative_std` of the range, at least `floor_std_in`; `rounding_var_in2` besides where
    readings are rounded. Readings at or beyond `lowest_in` and `highest_in` say "no nearer" and "nothing"."""

    relative_std: float = 0.01
    floor_std_in: float = 0.05
    rounding_var_in2: float = 0.0
    lowest_in: float = -np.inf
    highest_in: float = np.inf

    def variance(self, ranges_in: Floats) -> Floats:
        """Variance in in^2 of readings of `ranges_in`, any shape."""
        std = np.maximum(self.relative_std * ranges_in, self.floor_std_in)
        variance: Floats = std * std + self.rounding_var_in2
        return variance

    def constant_at(self, range_in: float) -> float:
        """Of the variance of readings of a range that stays the same, the part that is one error for all of them."""
        if not self.rounding_var_in2:
            return 0.0
        std = max(self.relative_std * range_in, self.floor_std_in)
        return self.rounding_var_in2 * exp(-((pi * std) ** 2) / (3.0 * self.rounding_var_in2))

    def variance_at(self, range_in: float) -> float:
        """`variance` of a single range."""
        std = max(self.relative_std * range_in, self.floor_std_in)
        return std * std + self.rounding_var_in2


Indices = npt.NDArray[np.intp]


class SonarRing(Protocol):
    """The part of a body that the sonars need; `worlds.robots.Body` has it."""

    @property
    def sonar_ring_radius_in(self) -> float: ...
    @property
    def sonar_angles_rad(self) -> tuple[float, ...]: ...


@dataclass(frozen=True, slots=True)
class Beams:
    """n rays tied to the robot, in the frame of its position and heading (x ahead, y to the left).

    `axes_in` (..., n, 2), the points they radiate from (the robot's axis: zeros, but for beams fired elsewhere); unit
    `directions` (..., n, 2); `standoff_in`, how far along them the sonars sit. Leading dimensions as the poses'.
    `axes_left` and `directions_left` are the same turned by a quarter, kept because every pose needs them.
    """

    axes_in: Floats
    directions: Floats
    standoff_in: float
    axes_left: Floats = field(init=False, repr=False)
    directions_left: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes_left", left_of(self.axes_in))
        object.__setattr__(self, "directions_left", left_of(self.directions))


class Rays(NamedTuple):
    """Beams at a pose, in the frame of the map: `axes_in`, unit `directions`, and `arms_in`, from the robot's position
    to the axes; each (..., n, 2); and the beams' `standoff_in`."""

    axes_in: Floats
    directions: Floats
    arms_in: Floats
    standoff_in: float


class Sight(NamedTuple):
    """Where rays meet lines; NaN where they run beside the line.

    `ranges_in` (..., n) from the sonars; `cos_incidence` (..., n), the cosine between ray and normal (its sign says
    from which side); `points_in` (..., n, 2), from the robot's position to the point met, in the frame of the map.
    """

    ranges_in: Floats
    cos_incidence: Floats
    points_in: Floats


@dataclass(frozen=True, slots=True)
class WallMap:
    """The walls a filter knows: `segments` (m, 4) for the ray caster and `lines` (m + 1, 3) of unit normal and offset.

    The last line is no line (zeros): index -1, the ray caster's "nothing", leads there. `index`: the caster for
    few rays.
    """

    segments: Floats
    lines: Floats
    index: WallIndex = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "index", WallIndex(self.segments))


@dataclass(frozen=True, slots=True)
class RaySonar(RangeNoise):
    """How a reading of an exact ray strays from its range, and which readings are no measurement."""


IDEAL_SONAR = RaySonar()
"""The thesis' sonars: exact but for gaussian noise, real-valued, without limits."""

WIRE_SONAR = RaySonar(rounding_var_in2=1.0 / 12.0, lowest_in=6.0, highest_in=255.0)
"""What the real interface gives: whole inches (a uniform error, variance 1/12) from 6 to 255."""


def wall_map(segments: npt.ArrayLike) -> WallMap:
    """The map of wall segments (m, 4), rows x1 y1 x2 y2 in inches. Raises ValueError on a wall without length."""
    walls = np.array(segments, dtype=np.float64).reshape(-1, 4)
    along = walls[:, 2:] - walls[:, :2]
    length = np.hypot(along[:, 0], along[:, 1])
    if not (length > 0).all():
        raise ValueError(f"wall {int(np.argmin(length > 0))} has no length: {walls[np.argmin(length > 0)]}")
    lines = np.zeros((len(walls) + 1, 3))
    lines[:-1, 0] = -along[:, 1] / length
    lines[:-1, 1] = along[:, 0] / length
    lines[:-1, 2] = (lines[:-1, :2] * walls[:, :2]).sum(axis=-1)
    return WallMap(walls, lines)


def ring(body: SonarRing, turret_offset_rad: float = 0.0) -> Beams:
    """All sonars of a body, number i in direction `turret_offset_rad` + its own angle from the heading.

    On a synchro drive the heading is the steering's, so the offset is the turret's encoder less the steering's; on a
    Scout it is 0.
    """
    angles = turret_offset_rad + np.asarray(body.sonar_angles_rad, dtype=np.float64)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return Beams(np.zeros_like(directions), directions, body.sonar_ring_radius_in)


def pick(beams: Beams, numbers: npt.ArrayLike) -> Beams:
    """Some of the beams, by number: an int for one, or a list."""
    chosen = np.atleast_1d(np.asarray(numbers, dtype=np.intp))
    return Beams(beams.axes_in[..., chosen, :], beams.directions[..., chosen, :], beams.standoff_in)


def fired_at(beams: Beams, displacement: Floats) -> Beams:
    """The beams as they lie in the frame of the pose at hand, each fired from another pose.

    `displacement` (..., n, 3), or (3,) for all: the pose at the firing instant in the frame of the pose at hand
    (inches ahead, inches to the left, radians), taken from odometry; the noise of that short way is left out.
    """
    there = rays(np.broadcast_to(displacement, (*np.broadcast_shapes(displacement.shape[:-1], (1,)), 3)), beams)
    return Beams(there.axes_in, there.directions, beams.standoff_in)


def left_of(vectors: Floats) -> Floats:
    """Vectors (..., 2) turned by a quarter, counter-clockwise."""
    turned = np.empty(vectors.shape)
    turned[..., 0] = -vectors[..., 1]
    turned[..., 1] = vectors[..., 0]
    return turned


def rays(poses: Floats, beams: Beams) -> Rays:
    """The n beams laid out in the map from poses (..., n, 3), a pose a beam, or (..., 1, 3), one for all."""
    heading = poses[..., HEADING, None]
    cos, sin = np.cos(heading), np.sin(heading)
    arms = cos * beams.axes_in + sin * beams.axes_left
    return Rays(poses[..., :2] + arms, cos * beams.directions + sin * beams.directions_left, arms, beams.standoff_in)


def meet(aimed: Rays, walls: WallMap) -> Indices:
    """The index (..., n) of the first wall each ray meets, -1 where there is none.

    Looked for from the axis, not from the ring: a wall within the ring is still the first wall.
    """
    hit: Indices = cast_rays(aimed.axes_in, aimed.directions, walls.segments)[1]
    return hit


def sight(aimed: Rays, lines: Floats) -> Sight:
    """Rays against lines (..., n, 3) of unit normal and offset, each beam against its own."""
    normal_x, normal_y = lines[..., 0], lines[..., 1]
    cosine = normal_x * aimed.directions[..., 0] + normal_y * aimed.directions[..., 1]
    np.copyto(cosine, np.nan, where=cosine == 0.0)
    left = lines[..., 2] - normal_x * aimed.axes_in[..., 0] - normal_y * aimed.axes_in[..., 1]
    from_axis = left / cosine
    points = aimed.arms_in + from_axis[..., None] * aimed.directions
    return Sight(from_axis - aimed.standoff_in, cosine, points)


def range_jacobian(seen: Sight, lines: Floats) -> Floats:
    """d range / d (x, y, theta), (..., n, 3), of what was seen of lines (..., n, 3).

    Differentiating the range of the module's head gives, with w from the robot's position to the point met,
    d range = ((n_x w_y - n_y w_x) dtheta - normal . dp) / (normal . direction).
    """
    jacobian = np.empty((*seen.ranges_in.shape, 3))
    np.negative(lines[..., :2], out=jacobian[..., :2])
    jacobian[..., 2] = lines[..., 0] * seen.points_in[..., 1] - lines[..., 1] * seen.points_in[..., 0]
    jacobian /= seen.cos_incidence[..., None]
    return jacobian


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


class BeamAssociation(NamedTuple):
    """Which wall each beam is taken to meet, what is expected there, and what speaks against it.

    `lines` (..., n, 3); `seen` and `jacobian` (..., n, 3) against them; `refusals` (..., n) as known without readings.
    """

    lines: Floats
    seen: Sight
    jacobian: Floats
    refusals: Codes


def associate(belief: Belief, beams: Beams, walls: WallMap, gate: Gate = STRICT) -> BeamAssociation:
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
    return BeamAssociation(lines, seen, range_jacobian(seen, lines), refusals)


def observe(
    belief: Belief, beams: Beams, readings_in: Floats, walls: WallMap, sonar: RaySonar, gate: Gate = STRICT
) -> Observation:
    """Readings (..., n) in inches of n beams, judged against beliefs of mean (..., 3) and cov (..., 3, 3)."""
    return judged(associate(belief, beams, walls, gate), belief, readings_in, sonar, gate)


def judged(
    paired: BeamAssociation, belief: Belief, readings_in: Floats, sonar: RaySonar, gate: Gate = STRICT
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


class BeamPrediction(NamedTuple):
    """A beam paired with a wall: its row, the range from the sonar, its derivative by the pose, the variance that the
    belief leaves to it, and what speaks against it."""

    row: int
    range_in: float
    jacobian: tuple[float, float, float]
    spread_in2: float
    refusal: Refusal


def predict_beam(
    belief: Belief, direction_rad: float, standoff_in: float, walls: WallMap, sigmas: float, least_cosine: float
) -> BeamPrediction:
    """The beam from the robot's axis in a direction from the heading, its sonar so far along it.

    `belief`: mean (n,), cov (n, n), pose first; `sigmas` and `least_cosine` as in gating.Gate.
    """
    x, y, heading = belief.mean[:3].tolist()
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = belief.cov[:3, :3].tolist()
    dx, dy = cos(heading + direction_rad), sin(heading + direction_rad)
    first = walls.index.nearest
    row = first(x, y, dx, dy)[1]
    normal_x, normal_y, offset = walls.lines[row].tolist()
    cosine = normal_x * dx + normal_y * dy
    if row == NO_WALL:
        return BeamPrediction(row, 0.0, (0.0, 0.0, 0.0), 0.0, Refusal.NO_WALL)
    if not cosine:
        return BeamPrediction(row, 0.0, (0.0, 0.0, 0.0), 0.0, Refusal.AMBIGUOUS_WALL)
    way = (offset - normal_x * x - normal_y * y) / cosine
    pull_x = xt * way - xx * dy + xy * dx
    pull_y = yt * way - xy * dy + yy * dx
    pull_t = tt * way - xt * dy + yt * dx
    aside = pull_t * way - pull_x * dy + pull_y * dx
    share = sigmas / sqrt(aside) if aside > 0.0 else sigmas
    refusal = Refusal.NONE if abs(cosine) >= least_cosine else Refusal.GRAZING
    for reach in (share, -share):
        there = heading + reach * pull_t + direction_rad
        if first(x + reach * pull_x, y + reach * pull_y, cos(there), sin(there))[1] != row:
            refusal = Refusal.AMBIGUOUS_WALL
            break
    by_x, by_y, by_t = -normal_x / cosine, -normal_y / cosine, way * (normal_x * dy - normal_y * dx) / cosine
    spread = (
        by_x * (by_x * xx + 2.0 * by_y * xy) + by_y * by_y * yy + by_t * (2.0 * (by_x * xt + by_y * yt) + by_t * tt)
    )
    return BeamPrediction(row, way - standoff_in, (by_x, by_y, by_t), spread, refusal)


BAD_RAYS: Final = 0.05
"""What is taken for bad of exact rays' readings: for likelihoods alone, the gate decides."""
SURE: Final = np.ones(1)


class RayModel:
    """Each reading is the range along one ray, or it is refused."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar, gate: Gate = STRICT) -> None:
        self._walls, self._body, self._sonar, self._gate = wall_map(walls), body, sonar, gate
        self._angles = body.sonar_angles_rad

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Association:
        sonar_model, gate = self._sonar, self._gate
        if not sonar_model.lowest_in < reading_in < sonar_model.highest_in:
            return _REFUSED[Refusal.LIMIT]
        direction_rad, standoff_in = turret_offset_rad + self._angles[sonar], self._body.sonar_ring_radius_in
        beam = predict_beam(belief, direction_rad, standoff_in, self._walls, gate.sigmas, gate.min_cos_incidence)
        if beam.refusal is not Refusal.NONE:
            return _REFUSED[beam.refusal]
        variance, innovation_in = sonar_model.variance_at(beam.range_in), reading_in - beam.range_in
        if not innovation_in * innovation_in <= gate.threshold * (beam.spread_in2 + variance):
            return _REFUSED[Refusal.GATE]
        expect = partial(_along, direction_rad, standoff_in, self._walls.lines[beam.row])
        candidates = Hypotheses(
            np.array([beam.range_in]),
            np.array([beam.jacobian]),
            np.array([variance]),
            np.array([sonar_model.constant_at(beam.range_in)]),
            SURE,
            expect,
            0.0,
            0.0,
        )
        return Association(Refusal.NONE, 1.0, candidates, BAD_RAYS)


def _along(direction_rad: float, standoff_in: float, line: Floats, poses: Floats) -> tuple[Floats, Floats]:
    """Ranges (..., 1) along a beam to a line (3,), and their derivatives, from poses (..., 1, 3)."""
    way = np.array([[np.cos(direction_rad), np.sin(direction_rad)]])
    seen = sight(rays(poses, Beams(np.zeros((1, 2)), way, standoff_in)), line[None])
    return seen.ranges_in, range_jacobian(seen, line[None])


def _unexplained(refusal: Refusal) -> float:
    """The likelihood of a reading that a ray refused: that of a bad one where it was not met, else of any."""
    return 1.0 if refusal is Refusal.LIMIT else BAD_RAYS / SPAN_IN if refusal is Refusal.GATE else 1.0 / SPAN_IN


_REFUSED: Final = {refusal: Association(refusal, _unexplained(refusal)) for refusal in Refusal if refusal}
