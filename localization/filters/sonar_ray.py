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

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from math import exp, inf, pi
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.filters import update
from localization.filters.belief import (
    HEADING,
    Belief,
    Floats,
    Number,
    add_outer,
    chi_square_quantile,
    choose,
    sqrt,
    unit_vector,
    unpack,
)
from localization.filters.update import NONE, Association, Covariance, DirectModel, Outcome, Refusal, State
from worlds import raycast
from worlds.geometry import MAX_LOOP_WALLS
from worlds.raycast import cast_ray, nearest_wall, sole_wall
from worlds.raycast_arrays import cast_rays
from worlds.rings import Ring, SonarMount
from worlds.robots import N150, Body

Codes = npt.NDArray[np.int8]

RAY_OUTLIERS: Final = 0.05
"""Outliers taken for granted among the readings of exact rays: for likelihoods only, the gate decides."""
_MIN_VARIANCE_IN2: Final = 1e-200
"""Stands for a variance of 0 where it is divided by."""


# The noise of a range.


@dataclass(frozen=True, slots=True)
class RangeNoise:
    """Noise of a sonar's ranges, and its limits.

        std = max(range_std_relative * range, range_std_floor_in)
        variance = std^2 + rounding_var_in2 + place_var_in2

    Attributes
    ----------
    range_std_relative, range_std_floor_in
        Standard deviation as a fraction of the range, and at least.
    rounding_var_in2
        Variance of rounding to the step of the readings.
    place_var_in2
        Variance of what is the same for all readings from one pose: errors of the map, and of the shape of an echo.
    lowest_in, highest_in
        Readings at or beyond these mean "so near or nearer" and "nothing".
    """

    range_std_relative: float = 0.01
    range_std_floor_in: float = 0.05
    rounding_var_in2: float = 0.0
    place_var_in2: float = 0.0
    lowest_in: float = -np.inf
    highest_in: float = np.inf

    @property
    def range_span_in(self) -> float:
        """Length of the interval in which a reading is a range; without limits that of a Nomad."""
        span_in = self.highest_in - self.lowest_in
        return span_in if span_in < inf else NOMAD.range_span_in

    def variance(self, ranges_in: Floats) -> Floats:
        """Return the variance R in in^2 of readings of `ranges_in`, any shape."""
        std = np.maximum(self.range_std_relative * ranges_in, self.range_std_floor_in)
        return std * std + (self.rounding_var_in2 + self.place_var_in2)


def range_variance(noise: RangeNoise, range_in: float) -> float:
    """Return `RangeNoise.variance` of a single range."""
    std = max(noise.range_std_relative * range_in, noise.range_std_floor_in)
    return std * std + (noise.rounding_var_in2 + noise.place_var_in2)


def constant_variance(noise: RangeNoise, range_in: float) -> float:
    """Return the part of the variance that is one error for all readings of a range that stays the same.

    That is `place_var_in2`, and a part of the rounding, which repeats its error unless noise moves the reading from one
    step to the next. The errors of two readings
    of one range, with noise of `std` each, in steps of q, have the covariance
    q^2 sum_k exp(-4 pi^2 k^2 std^2 / q^2) / (2 pi^2 k^2) <= q^2 / 12 exp(-4 pi^2 std^2 / q^2).

    References
    ----------
    Widrow, Kollar, Quantization Noise (2008), appendix on dither; the bound is met without noise.
    """
    if not noise.rounding_var_in2:
        return noise.place_var_in2
    std = max(noise.range_std_relative * range_in, noise.range_std_floor_in)
    return noise.place_var_in2 + noise.rounding_var_in2 * exp(-((pi * std) ** 2) / (3.0 * noise.rounding_var_in2))


@dataclass(frozen=True, slots=True)
class RaySonar(RangeNoise):
    """Parameters of sonars that measure along exact rays."""


IDEAL_SONAR = RaySonar()
"""The thesis' sonars: exact but for Gaussian noise, real-valued, without limits."""

NOMAD: Final = N150.ring
PLACE_VAR_IN2: Final = 0.02
"""Variance of the errors that all rays from one pose repeat (`RangeNoise`)."""


def ray_sonar(ring: Ring) -> RaySonar:
    """Return exact rays of a ring: a uniform error of its resolution q, variance q^2/12, and its limits."""
    return RaySonar(rounding_var_in2=ring.resolution_in**2 / 12.0, place_var_in2=PLACE_VAR_IN2,
                    lowest_in=ring.min_range_in, highest_in=ring.max_range_in)  # fmt: skip


WIRE_SONAR = ray_sonar(NOMAD)
"""Readings of the Nomads' interface: whole inches from 6 to 255."""


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

    @property
    def sonar_angles_rad(self) -> tuple[float, ...]:
        """Return the direction of each sonar from that of the turret, counter-clockwise."""


# The map.


@dataclass(frozen=True, slots=True)
class WallMap:
    """The walls of a map.

    Attributes
    ----------
    segments
        (m, 4), rows x1 y1 x2 y2 in inches.
    lines
        (m + 1, 3) unit normal and offset; the last, which row raycast.NO_WALL leads to, is no line (zeros).
    """

    segments: Floats
    lines: Floats
    rows: list[list[float]] = field(init=False, repr=False)
    """The segments as lists."""
    listed: list[list[float]] = field(init=False, repr=False)
    """The lines as lists."""
    middle: tuple[float, float, float] = field(init=False, repr=False)
    """x and y of the middle of the bounding box, and half its diagonal."""

    def __post_init__(self) -> None:
        ends = self.segments.reshape(-1, 2) if len(self.segments) else np.zeros((1, 2))
        low, high = ends.min(axis=0), ends.max(axis=0)
        middle = (*(0.5 * (low + high)).tolist(), 0.5 * float(np.hypot(*(high - low))))
        object.__setattr__(self, "middle", middle)
        object.__setattr__(self, "rows", self.segments.tolist())
        object.__setattr__(self, "listed", self.lines.tolist())


def nearest(x: Number, y: Number, dx: Number, dy: Number, walls: WallMap) -> tuple[Any, Any]:
    """Return the range from (x, y) along (dx, dy) to the first wall, and its row; inf and raycast.NO_WALL for none."""
    if isinstance(x, float):
        few = len(walls.segments) <= MAX_LOOP_WALLS
        return nearest_wall(x, y, dx, dy, walls.rows) if few else cast_ray(x, y, dx, dy, walls.segments)
    starts, directions = np.empty((*dx.shape, 2)), np.empty((*dx.shape, 2))
    starts[..., 0], starts[..., 1], directions[..., 0], directions[..., 1] = x, y, dx, dy
    return cast_rays(starts, directions, walls.segments)


def row_from(x: Number, y: Number, direction: Number, left_in: float, walls: WallMap) -> Any:
    """Return the row of the first wall along a beam in a direction, so far to the left of the axis at (x, y)."""
    dx, dy = unit_vector(direction)
    return nearest(x - left_in * dy, y + left_in * dx, dx, dy, walls)[1]


def only_wall(x: Sequence[float], P: Sequence[Sequence[float]], dx: float, dy: float, walls: WallMap, gate: Gate,
              left_in: float = 0.0) -> int:  # fmt: skip
    """Return the only wall that a beam can meet from any pose of the ellipsoid of `gate.sigmas`.

    These poses move the end of a wall, in the frame of the beam, by no more than the origin moves and the angle times
    the distance of the end. raycast.NO_WALL if there may be another.
    """
    middle_x, middle_y, half_in = walls.middle
    to_end_in = math.hypot(x[0] - middle_x, x[1] - middle_y) + half_in
    margin_in = gate.sigmas * (math.sqrt(P[0][0] + P[1][1]) + to_end_in * math.sqrt(P[HEADING][HEADING]))
    return sole_wall(x[0] - left_in * dy, x[1] + left_in * dx, dx, dy, wall_rows(walls), margin_in)


def wall_rows(walls: WallMap) -> Sequence[Sequence[float]]:
    """Return the ends of the walls, in rows of four numbers: `compiled` has one for arrays."""
    return walls.rows


def line_of(row: Any, walls: WallMap) -> Sequence[Any]:
    """Return normal x, normal y and offset of the walls of these rows."""
    return walls.listed[row] if isinstance(row, int) else np.moveaxis(walls.lines[row], -1, 0)


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
        The wall, a row of the map; raycast.NO_WALL for none.
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


def intersect_line(x: Number, y: Number, dx: Number, dy: Number, line: Sequence[Number],
                   left_in: float = 0.0) -> tuple[Number, tuple[Number, Number, Number], Number]:
    """Return distance, derivative and cosine of incidence of a ray from (x, y) along (dx, dy) to a line.

    Parameters
    ----------
    line
        Unit normal and offset.
    left_in
        The ray turns with the robot about an axis so far to its right.

    Returns
    -------
    tuple
        The distance along the ray; its derivatives by x, y and heading; the cosine between ray and normal, of either
        sign. NaN for a ray parallel to the line.

    Notes
    -----
    With d' = left of d and (left of d)' = -d, differentiating normal . ((x, y) + distance d) = offset gives
    d distance = -(normal . (dx, dy) + distance (normal . left of d) dheading) / (normal . d) + left_in dheading.
    """
    normal_x, normal_y, offset = line
    cosine = normal_x * dx + normal_y * dy
    cosine = choose(cosine == 0.0, np.nan, cosine)
    distance = (offset - normal_x * x - normal_y * y) / cosine
    H = (-normal_x / cosine, -normal_y / cosine, distance * (normal_x * dy - normal_y * dx) / cosine + left_in)
    return distance, H, cosine


def sideways_shift(P: Sequence[Sequence[Number]], dx: Number, dy: Number, distance: Number,
                   sigmas: float) -> tuple[Number, Number, Number]:
    """Return the change of the pose, `sigmas` standard deviations, that moves the end of a beam farthest sideways.

    With g = (-dy, dx, distance), the derivative of the sideways motion by the pose, that is sigmas P g / sqrt(g^T P g):
    to first order, no other pose of the ellipsoid dx^T P^-1 dx = sigmas^2 moves the end farther. The ends of the
    principal axes would be six poses, and may fall short by a factor of sqrt(3).
    """
    Pg_x = P[0][2] * distance - P[0][0] * dy + P[0][1] * dx
    Pg_y = P[1][2] * distance - P[1][0] * dy + P[1][1] * dx
    Pg_heading = P[2][2] * distance - P[2][0] * dy + P[2][1] * dx
    variance = Pg_heading * distance - Pg_x * dy + Pg_y * dx
    scale = sigmas / sqrt(choose(variance > _MIN_VARIANCE_IN2, variance, 1.0))
    return scale * Pg_x, scale * Pg_y, scale * Pg_heading


def predict_beam(x: Sequence[Any], P: Sequence[Sequence[Any]], angle_rad: Any, ring_radius_in: Any, walls: WallMap,
                 gate: Gate, left_in: float = 0.0) -> BeamPrediction:  # fmt: skip
    """Return the expected reading of beams at `angle_rad` from the heading.

    Parameters
    ----------
    x, P
        State and covariance, pose first (`belief.unpack`): floats, or arrays that broadcast with the angles.
    angle_rad, ring_radius_in
        A float for one beam, or an array.
    left_in
        Distance of the beam to the left of the robot's axis.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 6.3: the beam model, here with its mode alone; outliers
    are the gate's to refuse.
    """
    x_in, y_in, heading = x[0], x[1], x[HEADING]
    # 1. The wall that the beam meets, from beside the axis: a wall within the ring is still the first.
    direction = heading + angle_rad
    dx, dy = unit_vector(direction)
    from_x, from_y = x_in - left_in * dy, y_in + left_in * dx
    few = isinstance(x_in, float) and len(walls.segments) <= MAX_LOOP_WALLS
    sole = only_wall(x, P, dx, dy, walls, gate, left_in) if few else raycast.NO_WALL
    row = nearest(from_x, from_y, dx, dy, walls)[1] if sole == raycast.NO_WALL else sole
    # 2. The expected range and its derivative.
    distance, H, cosine = intersect_line(from_x, from_y, dx, dy, line_of(row, walls), left_in)
    if sole != raycast.NO_WALL:  # no other wall, from any pose
        refusal = NONE if abs(cosine) >= gate.min_cos_incidence else update.GRAZING
        return BeamPrediction(row, distance - ring_radius_in, H, refusal)
    # 3. The wall from the two poses that move the end of the beam farthest sideways.
    reach = choose(cosine == cosine, distance, 0.0)  # NaN where there is no wall: the ray caster wants finite rays
    shift_x, shift_y, shift_heading = sideways_shift(P, dx, dy, reach, gate.sigmas)
    ambiguous = row_from(x_in + shift_x, y_in + shift_y, direction + shift_heading, left_in, walls) != row
    ambiguous = ambiguous | (row_from(x_in - shift_x, y_in - shift_y, direction - shift_heading, left_in, walls) != row)
    # 4. The first reason, in the order of Refusal, that excludes the beam. A wall seen end-on is ambiguous.
    refusal = choose(abs(cosine) >= gate.min_cos_incidence, NONE, update.GRAZING)
    refusal = choose(ambiguous | (cosine != cosine), update.AMBIGUOUS_WALL, refusal)
    refusal = choose(row == raycast.NO_WALL, update.NO_WALL, refusal)
    return BeamPrediction(row, distance - ring_radius_in, H, refusal)


def predicted_variance(P: Sequence[Sequence[Number]], H: Sequence[Number]) -> Number:
    """Return H P H^T, the variance of the expected range, for a derivative by the pose."""
    a, b, c = H
    return (
        a * (a * P[0][0] + 2.0 * (b * P[0][1] + c * P[0][2])) + b * (b * P[1][1] + 2.0 * c * P[1][2]) + c * c * P[2][2]
    )


# One reading of a live robot.


def update_by_ray(x: State, P: Covariance, mount: SonarMount, reading_in: float, model: RayModel, count: int,
                  _outlier_fraction: float = 1.0) -> Outcome:  # fmt: skip
    """Correct x and P by the reading of a beam, in place, if it passes the gate: the Kalman update.

    Parameters
    ----------
    mount
        The sonar, its direction from the heading.
    count
        Number of this reading among those from the same pose (`update.count_used`).
    _outlier_fraction
        Of no use: outliers do not correct at all.
    """
    # 1. A reading at a limit is no range.
    noise = model.noise
    if not noise.lowest_in < reading_in < noise.highest_in:
        return update.LIMIT, 0.0, 0.0, 1.0, 1.0, 0.0
    # 2. The expected reading, and whether the beam can be used.
    beam = predict_beam(x, P, mount.direction_rad, mount.ring_in, model.walls, model.gate, mount.left_in)
    if beam.refusal != NONE:
        return beam.refusal, 0.0, 0.0, 1.0, 1.0 / noise.range_span_in, 0.0
    # 3. innovation = z - h(x), S = H P H^T + R, K = P H^T / S.
    R = range_variance(noise, beam.range_in)
    expected_in, H = update.expected_reading(x, beam.range_in, beam.H, model.range_parameters)
    innovation = reading_in - expected_in
    K, S = update.kalman_gain(P, H, R)
    # 4. The chi-square gate. For the likelihood some readings are outliers, and these are beyond it.
    nis = innovation * innovation / S
    slope = update.forward_slope(H, *unit_vector(x[HEADING]))
    if not nis <= model.threshold:
        return update.GATE, innovation, nis, 1.0, RAY_OUTLIERS / noise.range_span_in, slope
    density = exp(-0.5 * nis) / sqrt(2.0 * pi * S)
    # 5. x+ = x + K innovation, P+ = P - K S K^T; of a repeated reading with the R that leaves its new information.
    if count > 1:
        K, S = update.kalman_gain(P, H, update.inflated_variance(R, constant_variance(noise, beam.range_in), count))
    update.shift(x, K, innovation)
    add_outer(P, -S, K)
    return NONE, innovation, nis, 0.0, (1.0 - RAY_OUTLIERS) * density + RAY_OUTLIERS / noise.range_span_in, slope


class RayModel(DirectModel):
    """Measurement model of sonars whose readings are the range along one ray, or refused by the gate."""

    noise: RaySonar

    def __init__(self, walls: npt.ArrayLike, body: Body, sonar: RaySonar, gate: Gate = STRICT,
                 range_parameters: int = 0) -> None:
        self.walls, self.noise, self.gate, self.threshold = wall_map(walls), sonar, gate, gate.threshold
        self.mounts = body.ring.mounts
        self.update, self.range_parameters = update_by_ray, range_parameters

    def associate(self, x: State, P: Covariance, sonar: int, turret_offset_rad: float,
                  reading_in: float) -> Association:
        """Return the one hypothesis for a reading: the wall that its beam meets, or the reason why it is refused."""
        mount = update.mount_at(self.mounts, sonar, turret_offset_rad)
        # A trial update of a copy, so that all rules refuse the same readings.
        refusal, *_, likelihood, _ = update_by_ray(x.copy(), [row.copy() for row in P], mount, reading_in, self, 1)
        if refusal != NONE:
            return Association(update.REFUSALS[refusal], likelihood)
        beam = predict_beam(x, P, mount.direction_rad, mount.ring_in, self.walls, self.gate, mount.left_in)
        expected_in, H = update.expected_reading(x, beam.range_in, beam.H, self.range_parameters)
        return Association(Refusal.NONE, 1.0, [expected_in], [H], [range_variance(self.noise, beam.range_in)],
                           [constant_variance(self.noise, beam.range_in)], [1.0],
                           partial(_ranges_to_line, mount, line_of(beam.row, self.walls)), gate_outliers=RAY_OUTLIERS,
                           range_parameters=self.range_parameters, range_span_in=self.noise.range_span_in)  # fmt: skip


def _ranges_to_line(mount: SonarMount, line: Sequence[float], poses: Floats) -> tuple[Floats, Floats]:
    """Return ranges (..., 1) of a beam to a line, and their derivatives (..., 1, 3), from poses (..., 1, 3)."""
    along_x, along_y = unit_vector(poses[..., HEADING] + mount.direction_rad)
    x, y = poses[..., 0] - mount.left_in * along_y, poses[..., 1] + mount.left_in * along_x
    distance, H, _ = intersect_line(x, y, along_x, along_y, [np.full((), v) for v in line], mount.left_in)
    return distance - mount.ring_in, np.stack(np.broadcast_arrays(*H), axis=-1)


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
        used: npt.NDArray[np.bool_] = self.refusals == NONE
        return used

    def reasons(self) -> tuple[Refusal, ...]:
        """Return the refusals of a single robot's beams."""
        return tuple(Refusal(int(code)) for code in self.refusals.reshape(-1))


def ranges_from(poses: Floats, angles_rad: Floats, body: SonarRing, walls: WallMap) -> BeamPrediction:
    """Return the expected readings of a ring without shifts: `ranges_along` of beams at angles (n,)."""
    return ranges_along(poses, SonarMount(angles_rad, body.sonar_ring_radius_in), walls)


def ranges_along(poses: Floats, mount: SonarMount, walls: WallMap) -> BeamPrediction:
    """Return the expected readings of beams from known poses (..., 3), in directions (n,): arrays (..., n).

    Beams without a wall, or parallel to it, are NaN.
    """
    x, y, heading = (poses[..., index, None] for index in range(3))
    dx, dy = unit_vector(heading + mount.direction_rad)
    x, y = x - mount.left_in * dy, y + mount.left_in * dx
    _, row = nearest(x, y, dx, dy, walls)
    distance, H, cosine = intersect_line(x, y, dx, dy, line_of(row, walls), mount.left_in)
    flat = np.where(np.abs(cosine) >= STRICT.min_cos_incidence, NONE, update.GRAZING)
    refusal = np.where(row == raycast.NO_WALL, update.NO_WALL, flat)
    return BeamPrediction(row, distance - mount.ring_in, H, refusal)


def observe_ring(belief: Belief, angles_rad: Floats, readings_in: Floats, body: SonarRing, walls: WallMap,
                 sonar: RaySonar, gate: Gate = STRICT) -> Observation:  # fmt: skip
    """Return what readings (..., n) of beams at angles (n,) from the heading say about beliefs over poses (..., 3)."""
    # 1. The expected readings; elements of the belief get a dimension for the beams.
    x, P = unpack(Belief(belief.mean[..., None, :], belief.cov[..., None, :, :]))
    beams = predict_beam(x, P, angles_rad, body.sonar_ring_radius_in, walls, gate)
    # 2. The chi-square gate, and the limits.
    innovation = readings_in - beams.range_in
    R = sonar.variance(beams.range_in)
    passed = innovation * innovation <= gate.threshold * (predicted_variance(P, beams.H) + R)
    refusals = np.where((beams.refusal == NONE) & ~passed, update.GATE, beams.refusal)
    is_range = (readings_in > sonar.lowest_in) & (readings_in < sonar.highest_in)
    refusals = np.where(is_range, refusals, update.LIMIT).astype(np.int8)
    # 3. Beams left out change nothing.
    used = refusals == NONE
    H = np.stack(np.broadcast_arrays(*beams.H), axis=-1)
    return Observation(np.where(used, innovation, 0.0), np.where(used[..., None], H, 0.0), np.where(used, R, 1.0),
                       refusals)
