"""The ray model of a sonar: the range along one beam to the nearest wall of the map, and the gate.

A beam leaves the robot's axis at an angle from the heading; the sonar sits `ring_radius_in` along it. A wall is a line
in normal form, normal . p = offset:

    direction d   = (cos, sin)(heading + angle)
    distance      = (offset - normal . (x, y)) / (normal . d)        range = distance - ring radius
    H             = d range / d (x, y, heading)

Which wall a beam meets is the ray caster's answer (worlds.raycast). A reading is used if the beam meets the same wall
from poses `sigmas` standard deviations to either side, meets it steeply enough, and its innovation passes a chi-square
gate of one degree of freedom.

`predict_beam` is the one beam model: of a float for each element for a live robot (`RayModel`), of arrays for many
robots and all beams of the ring at once (`observe_ring`, the experiments).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from math import exp, pi
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.filters.belief import (
    HEADING,
    Belief,
    Floats,
    Number,
    chi_square_quantile,
    choose,
    cos,
    sin,
    sqrt,
    unpack,
)
from localization.filters.update import RANGE_SPAN_IN, Association, Covariance, Refusal, State
from worlds.raycast import NO_WALL, WallIndex, cast_rays

Codes = npt.NDArray[np.int8]

RAY_OUTLIERS: Final = 0.05
"""Outliers taken for granted among the readings of exact rays: for likelihoods only, the gate decides."""
_MIN_VARIANCE_IN2: Final = 1e-200
"""Stands for a variance of 0 where it is divided by."""


# The noise of a range.


@dataclass(frozen=True, slots=True)
class RangeNoise:
    """Noise of a sonar's ranges, and its limits.

        std = max(range_std_relative * range, range_std_floor_in)        variance = std^2 + rounding_var_in2

    Attributes
    ----------
    range_std_relative, range_std_floor_in
        Standard deviation as a fraction of the range, and at least.
    rounding_var_in2
        Variance of rounding to the step of the readings.
    lowest_in, highest_in
        Readings at or beyond these mean "no nearer" and "nothing".
    """

    range_std_relative: float = 0.01
    range_std_floor_in: float = 0.05
    rounding_var_in2: float = 0.0
    lowest_in: float = -np.inf
    highest_in: float = np.inf

    def variance(self, ranges_in: Floats) -> Floats:
        """Return the variance R in in^2 of readings of `ranges_in`, any shape."""
        std = np.maximum(self.range_std_relative * ranges_in, self.range_std_floor_in)
        variance: Floats = std * std + self.rounding_var_in2
        return variance

    def variance_at(self, range_in: float) -> float:
        """Return `variance` of a single range."""
        std = max(self.range_std_relative * range_in, self.range_std_floor_in)
        return std * std + self.rounding_var_in2

    def constant_variance_at(self, range_in: float) -> float:
        """Return the part of the variance that is one error for all readings of a range that stays the same.

        Rounding repeats its error unless noise moves the reading from one step to the next. The errors of two readings
        of one range, with noise of `std` each, in steps of q, have the covariance
        q^2 sum_k exp(-4 pi^2 k^2 std^2 / q^2) / (2 pi^2 k^2) <= q^2 / 12 exp(-4 pi^2 std^2 / q^2).

        References
        ----------
        Widrow, Kollar, Quantization Noise (2008), appendix on dither; the bound is met without noise.
        """
        if not self.rounding_var_in2:
            return 0.0
        std = max(self.range_std_relative * range_in, self.range_std_floor_in)
        return self.rounding_var_in2 * exp(-((pi * std) ** 2) / (3.0 * self.rounding_var_in2))


@dataclass(frozen=True, slots=True)
class RaySonar(RangeNoise):
    """Parameters of sonars that measure along exact rays."""


IDEAL_SONAR = RaySonar()
"""The thesis' sonars: exact but for Gaussian noise, real-valued, without limits."""

WIRE_SONAR = RaySonar(rounding_var_in2=1.0 / 12.0, lowest_in=6.0, highest_in=255.0)
"""Readings of the real interface: whole inches (a uniform error, variance 1/12) from 6 to 255."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Conditions for a beam to be used.

    Attributes
    ----------
    sigmas
        The beam must meet the same wall from poses so many standard deviations to either side.
    min_cos_incidence
        Least |cosine| of the angle between beam and normal of the wall.
    probability
        With which a good reading passes the chi-square gate.
    """

    sigmas: float = 3.0
    min_cos_incidence: float = 0.3
    probability: float = 0.999

    @property
    def threshold(self) -> float:
        """Largest NIS that passes."""
        return chi_square_quantile(self.probability, 1)


STRICT = Gate()
"""The gate of all experiments."""


class SonarRing(Protocol):
    """The part of a robot body that the sonars need; `worlds.robots.Body` has it."""

    @property
    def sonar_ring_radius_in(self) -> float:
        """Return the distance of the sonars from the centre."""
        ...

    @property
    def sonar_angles_rad(self) -> tuple[float, ...]:
        """Return the direction of each sonar from that of the turret, counter-clockwise."""
        ...


# The map.


@dataclass(frozen=True, slots=True)
class WallMap:
    """The walls of a map.

    Attributes
    ----------
    segments
        (m, 4), rows x1 y1 x2 y2 in inches.
    lines
        (m + 1, 3) unit normal and offset; the last, which row NO_WALL leads to, is no line (zeros).
    """

    segments: Floats
    lines: Floats
    _index: WallIndex = field(init=False, repr=False)
    _listed: list[list[float]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_index", WallIndex(self.segments))
        object.__setattr__(self, "_listed", self.lines.tolist())

    def first_wall(self, x: Number, y: Number, dx: Number, dy: Number) -> Any:
        """Return the row of the first wall on the ray from (x, y) along (dx, dy), NO_WALL for none."""
        if isinstance(x, float):
            return self._index.nearest(x, y, dx, dy)[1]
        starts, directions = np.empty((*dx.shape, 2)), np.empty((*dx.shape, 2))
        starts[..., 0], starts[..., 1], directions[..., 0], directions[..., 1] = x, y, dx, dy
        return cast_rays(starts, directions, self.segments)[1]

    def line(self, row: Any) -> Sequence[Any]:
        """Return normal x, normal y and offset of the walls of these rows."""
        return self._listed[row] if isinstance(row, int) else np.moveaxis(self.lines[row], -1, 0)


def wall_map(segments: npt.ArrayLike) -> WallMap:
    """Return the map of wall segments (m, 4), rows x1 y1 x2 y2 in inches.

    Raises
    ------
    ValueError
        A wall has no length.
    """
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


# The beam model.


class BeamPrediction(NamedTuple):
    """The expected reading of a beam: each of one element a beam.

    Attributes
    ----------
    row
        The wall, a row of the map; NO_WALL for none.
    range_in
        Expected range from the sonar, inches.
    H
        Its derivatives by x, y and heading.
    refusal
        Why the beam cannot be used whatever it reads, a `Refusal`.
    """

    row: Any
    range_in: Any
    H: tuple[Any, Any, Any]
    refusal: Any


def intersect_line(
    x: Number, y: Number, dx: Number, dy: Number, line: Sequence[Number]
) -> tuple[Number, tuple[Number, Number, Number], Number]:
    """Return distance, derivative and cosine of incidence of a ray from (x, y) along (dx, dy) to a line.

    Parameters
    ----------
    line
        Unit normal and offset.

    Returns
    -------
    tuple
        The distance along the ray; its derivatives by x, y and heading, the ray turning with the robot about (x, y);
        the cosine between ray and normal, of either sign. NaN for a ray parallel to the line.

    Notes
    -----
    Differentiating normal . ((x, y) + distance d) = offset with d' = left of d gives
    d distance = -(normal . (dx, dy) + distance (normal . left of d) dheading) / (normal . d).
    """
    normal_x, normal_y, offset = line
    cosine = normal_x * dx + normal_y * dy
    cosine = choose(cosine == 0.0, np.nan, cosine)
    distance = (offset - normal_x * x - normal_y * y) / cosine
    H = (-normal_x / cosine, -normal_y / cosine, distance * (normal_x * dy - normal_y * dx) / cosine)
    return distance, H, cosine


def sideways_shift(
    P: Sequence[Sequence[Number]], dx: Number, dy: Number, distance: Number, sigmas: float
) -> tuple[Number, Number, Number]:
    """Return the change of the pose, `sigmas` standard deviations, that moves the end of a beam farthest sideways.

    With g = (-dy, dx, distance), the derivative of the sideways motion by the pose, that is sigmas P g / sqrt(g' P g):
    to first order, no other pose of the ellipsoid dx' P^-1 dx = sigmas^2 moves the end farther. The ends of the
    principal axes would be six poses, and may fall short by a factor of sqrt(3).
    """
    Pg_x = P[0][2] * distance - P[0][0] * dy + P[0][1] * dx
    Pg_y = P[1][2] * distance - P[1][0] * dy + P[1][1] * dx
    Pg_heading = P[2][2] * distance - P[2][0] * dy + P[2][1] * dx
    variance = Pg_heading * distance - Pg_x * dy + Pg_y * dx
    scale = sigmas / sqrt(choose(variance > _MIN_VARIANCE_IN2, variance, 1.0))
    return scale * Pg_x, scale * Pg_y, scale * Pg_heading


def predict_beam(
    x: Sequence[Any], P: Sequence[Sequence[Any]], angle_rad: Any, ring_radius_in: float, walls: WallMap, gate: Gate
) -> BeamPrediction:
    """Return the expected reading of beams at `angle_rad` from the heading.

    Parameters
    ----------
    x, P
        State and covariance, pose first (`belief.unpack`): floats, or arrays that broadcast with the angles.
    angle_rad
        A float for one beam, or an array.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 6.3: the beam model, here with its mode alone; outliers
    are the gate's to refuse.
    """
    x_in, y_in, heading = x[0], x[1], x[HEADING]
    # 1. The wall that the beam meets, from the axis: a wall within the ring is still the first.
    direction = heading + angle_rad
    dx, dy = cos(direction), sin(direction)
    row = walls.first_wall(x_in, y_in, dx, dy)
    # 2. The expected range and its derivative.
    distance, H, cosine = intersect_line(x_in, y_in, dx, dy, walls.line(row))
    # 3. The wall from the two poses that move the end of the beam farthest sideways.
    reach = choose(cosine == cosine, distance, 0.0)  # NaN where there is no wall: the ray caster wants finite rays
    shift_x, shift_y, shift_heading = sideways_shift(P, dx, dy, reach, gate.sigmas)
    left, right = direction + shift_heading, direction - shift_heading
    ambiguous = (walls.first_wall(x_in + shift_x, y_in + shift_y, cos(left), sin(left)) != row) | (
        walls.first_wall(x_in - shift_x, y_in - shift_y, cos(right), sin(right)) != row
    )
    # 4. The first reason, in the order of Refusal, that excludes the beam. A wall seen end-on is ambiguous.
    refusal = choose(abs(cosine) >= gate.min_cos_incidence, Refusal.NONE, Refusal.GRAZING)
    refusal = choose(ambiguous | (cosine != cosine), Refusal.AMBIGUOUS_WALL, refusal)
    refusal = choose(row == NO_WALL, Refusal.NO_WALL, refusal)
    return BeamPrediction(row, distance - ring_radius_in, H, refusal)


def predicted_variance(P: Sequence[Sequence[Number]], H: Sequence[Number]) -> Number:
    """Return H P H', the variance of the expected range, for a derivative by the pose."""
    a, b, c = H
    return (
        a * (a * P[0][0] + 2.0 * (b * P[0][1] + c * P[0][2])) + b * (b * P[1][1] + 2.0 * c * P[1][2]) + c * c * P[2][2]
    )


# One reading of a live robot.


class RayModel:
    """Measurement model of sonars whose readings are the range along one ray, or refused by the gate."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, sonar: RaySonar, gate: Gate = STRICT) -> None:
        self._walls, self._sonar, self._gate = wall_map(walls), sonar, gate
        self._angles, self._radius_in = body.sonar_angles_rad, body.sonar_ring_radius_in
        self._threshold = gate.threshold

    def associate(
        self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float
    ) -> Association:
        """Return the one hypothesis for a reading: the wall that its beam meets, or the reason why it is refused."""
        noise = self._sonar
        # 1. A reading at a limit is no range.
        if not noise.lowest_in < reading_in < noise.highest_in:
            return _REFUSED[Refusal.LIMIT]
        # 2. The expected reading, and whether the beam can be used.
        angle_rad = turret_offset_rad + self._angles[sonar]
        beam = predict_beam(x, P, angle_rad, self._radius_in, self._walls, self._gate)
        if beam.refusal is not Refusal.NONE:
            return _REFUSED[beam.refusal]
        # 3. The chi-square gate: innovation^2 <= threshold S.
        R, innovation = noise.variance_at(beam.range_in), reading_in - beam.range_in
        if not innovation * innovation <= self._threshold * (predicted_variance(P, beam.H) + R):
            return _REFUSED[Refusal.GATE]
        return Association(
            Refusal.NONE,
            1.0,
            (beam.range_in,),
            (beam.H,),
            (R,),
            (noise.constant_variance_at(beam.range_in),),
            (1.0,),
            partial(_ranges_to_line, angle_rad, self._radius_in, self._walls.line(beam.row)),
            gate_outliers=RAY_OUTLIERS,
        )


def _ranges_to_line(
    angle_rad: float, ring_radius_in: float, line: Sequence[float], poses: Floats
) -> tuple[Floats, Floats]:
    """Return ranges (..., 1) of a beam to a line, and their derivatives (..., 1, 3), from poses (..., 1, 3)."""
    direction = poses[..., HEADING] + angle_rad
    along_x, along_y = np.cos(direction), np.sin(direction)
    distance, H, _ = intersect_line(poses[..., 0], poses[..., 1], along_x, along_y, [np.full((), v) for v in line])
    return distance - ring_radius_in, np.stack(np.broadcast_arrays(*H), axis=-1)


def _refused_likelihood(refusal: Refusal) -> float:
    """Return the likelihood of a refused reading: of an outlier where it missed the gate, else of any reading."""
    match refusal:
        case Refusal.LIMIT:
            return 1.0
        case Refusal.GATE:
            return RAY_OUTLIERS / RANGE_SPAN_IN
        case _:
            return 1.0 / RANGE_SPAN_IN


_REFUSED: Final = {refusal: Association(refusal, _refused_likelihood(refusal)) for refusal in Refusal if refusal}


# A whole ring of many robots.


@dataclass(frozen=True, slots=True)
class Observation:
    """Innovations and Jacobians of n beams, ready for `ekf.update_ring`.

    A beam left out has innovation 0, derivative 0 and variance 1: it changes nothing, and arrays keep their shape.

    Attributes
    ----------
    innovation
        (..., n) reading less expected range, inches.
    H
        (..., n, 3) derivative of the expected range by the pose.
    R
        (..., n) variance of the reading, in^2.
    refusals
        (..., n) int8, a `Refusal` each.
    """

    innovation: Floats
    H: Floats
    R: Floats
    refusals: Codes

    @property
    def used(self) -> npt.NDArray[np.bool_]:
        """The beams that may correct, (..., n)."""
        used: npt.NDArray[np.bool_] = self.refusals == Refusal.NONE.value
        return used

    def reasons(self) -> tuple[Refusal, ...]:
        """Return the refusals of a single robot's beams."""
        return tuple(Refusal(int(code)) for code in self.refusals.reshape(-1))


def ranges_from(poses: Floats, angles_rad: Floats, body: SonarRing, walls: WallMap) -> BeamPrediction:
    """Return the expected readings of beams at angles (n,) from known poses (..., 3): arrays (..., n).

    Beams without a wall, or parallel to it, are NaN.
    """
    x, y, heading = (poses[..., index, None] for index in range(3))
    direction = heading + angles_rad
    dx, dy = np.cos(direction), np.sin(direction)
    row = walls.first_wall(x, y, dx, dy)
    distance, H, cosine = intersect_line(x, y, dx, dy, walls.line(row))
    flat = choose(np.abs(cosine) >= STRICT.min_cos_incidence, Refusal.NONE, Refusal.GRAZING)
    return BeamPrediction(row, distance - body.sonar_ring_radius_in, H, choose(row == NO_WALL, Refusal.NO_WALL, flat))


def observe_ring(
    belief: Belief,
    angles_rad: Floats,
    readings_in: Floats,
    body: SonarRing,
    walls: WallMap,
    sonar: RaySonar,
    gate: Gate = STRICT,
) -> Observation:
    """Return what readings (..., n) of beams at angles (n,) from the heading say about beliefs over poses (..., 3)."""
    # 1. The expected readings; elements of the belief get a dimension for the beams.
    x, P = unpack(Belief(belief.mean[..., None, :], belief.cov[..., None, :, :]))
    beams = predict_beam(x, P, angles_rad, body.sonar_ring_radius_in, walls, gate)
    # 2. The chi-square gate, and the limits.
    innovation = readings_in - beams.range_in
    R = sonar.variance(beams.range_in)
    passed = innovation * innovation <= gate.threshold * (predicted_variance(P, beams.H) + R)
    refusals = np.where((beams.refusal == Refusal.NONE.value) & ~passed, Refusal.GATE.value, beams.refusal)
    is_range = (readings_in > sonar.lowest_in) & (readings_in < sonar.highest_in)
    refusals = np.where(is_range, refusals, Refusal.LIMIT.value).astype(np.int8)
    # 3. Beams left out change nothing.
    used = refusals == Refusal.NONE.value
    H = np.stack(np.broadcast_arrays(*beams.H), axis=-1)
    return Observation(
        np.where(used, innovation, 0.0), np.where(used[..., None], H, 0.0), np.where(used, R, 1.0), refusals
    )
