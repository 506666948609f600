"""The cone model of a sonar: all reflectors of the map that may return its first echo, each with its probability.

A Polaroid transducer receives from some 12 degrees to either side of its axis, and from a smooth wall only what meets
it at a right angle. So the echo of a wall is its perpendicular distance, wherever in the cone the foot of the
perpendicular lies, and the echo of a vertex the distance to it:

    face      p = (x, y) + ring radius (cos, sin)(heading + direction)
    wall      range = |normal . (p - corner)|       detected if the foot is on the wall and within the cone
    vertex    range = |vertex - p|                  detected if within the cone

The probability of each detection follows from its level (decibels, from the data sheet), from the edge of the cone,
which the uncertain heading blurs, and from nearer reflectors: the first echo counts.

A vertex is an end of a wall, or a point where walls meet at an angle. A square corner returns all that it receives (its
two walls are a mirror for any direction), other vertices little. `reflectors` computes all of them once for a map.

The formulas (`to_wall`, `to_vertex`, `detection_probability`, `range_jacobian`) are here once, for numbers and arrays.
`first_echoes` applies them to one pose and loops over few reflectors; `expected_echoes` to many poses in arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import atan2, cos, log, pi, radians
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters import sonar_ray, update
from localization.filters.belief import HEADING, Floats, Number, choose, clip, exp, sqrt, unit_vector, wrap_angle
from localization.filters.sonar_ray import NOMAD, WIRE_SONAR, RangeNoise
from localization.filters.update import Association, Covariance, DirectModel, Outcome, Refusal, State
from worlds.raycast import sort_by_range
from worlds.raycast_arrays import cast_rays
from worlds.rings import Ring, SonarMount
from worlds.robots import Body

Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# The map as sound meets it.

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall."""
SQUARE_RAD: Final = 0.02
"""Two walls that meet within this of a right angle return sound by both of them."""


@dataclass(frozen=True, slots=True)
class Reflectors:
    """m walls and v vertices, inches; in arrays of both, the walls come first.

    Attributes
    ----------
    walls
        (m, 4), rows x1 y1 x2 y2.
    corners
        (m, 2), the first ends.
    along, lengths
        (m, 2) unit vectors from the first ends, and (m,).
    normals
        (m, 2), to the left of them.
    vertices, square, free
        (v, 2), and (v,) True for square corners and for free ends, where one wall ends and no other begins.
    """

    walls: Floats
    corners: Floats
    along: Floats
    normals: Floats
    lengths: Floats
    vertices: Floats
    square: Mask
    free: Mask

    @property
    def count(self) -> int:
        """Number of walls and vertices together."""
        return len(self.walls) + len(self.vertices)

    def within(self, x_in: float, y_in: float, reach_in: float) -> Reflectors:
        """Return those of which a part is nearer to a point than `reach_in`."""
        from_corner = np.array((x_in, y_in)) - self.corners
        foot = np.einsum("ij,ij->i", from_corner, self.along)
        beyond = foot - np.clip(foot, 0.0, self.lengths)
        height = np.einsum("ij,ij->i", from_corner, self.normals)
        vertices = self.vertices - np.array((x_in, y_in))
        return self.some(np.hypot(height, beyond) < reach_in, np.hypot(*vertices.T) < reach_in)

    def some(self, walls: Mask, vertices: Mask) -> Reflectors:
        """Return those alone that are selected, (m,) and (v,)."""
        return Reflectors(self.walls[walls], self.corners[walls], self.along[walls], self.normals[walls],
                          self.lengths[walls], self.vertices[vertices], self.square[vertices], self.free[vertices])


def reflectors(segments: npt.ArrayLike) -> Reflectors:
    """Return the reflectors of a map of wall segments (m, 4), rows x1 y1 x2 y2; none may have length 0."""
    # 1. Walls: unit vectors and lengths.
    walls = np.array(segments, dtype=np.float64).reshape(-1, 4)
    spans = walls[:, 2:] - walls[:, :2]
    lengths = np.hypot(spans[:, 0], spans[:, 1])
    along = spans / lengths[:, None]
    # 2. The directions of the walls that leave each point.
    directions: dict[tuple[float, float], list[float]] = {}
    for (x1, y1, x2, y2), (ux, uy) in zip(walls.tolist(), along.tolist(), strict=True):
        directions.setdefault((x1, y1), []).append(float(np.arctan2(uy, ux)))
        directions.setdefault((x2, y2), []).append(float(np.arctan2(-uy, -ux)))
    # 3. Vertices: all points but those in the middle of a straight wall.
    angles = {point: _angle_between(leaving) for point, leaving in directions.items()}
    points = [point for point, angle in angles.items() if abs(angle - np.pi) >= STRAIGHT_RAD]
    square = [abs(angles[point] - np.pi / 2.0) <= SQUARE_RAD for point in points]
    free = [len(directions[point]) == 1 for point in points]
    normals = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    vertices = np.array(points, dtype=np.float64).reshape(-1, 2)
    masks = (np.array(mask, dtype=np.bool_) for mask in (square, free))
    return Reflectors(walls, walls[:, :2], along, normals, lengths, vertices, *masks)


def _angle_between(directions_rad: list[float]) -> float:
    """Return the angle from 0 to pi between the two walls that meet in a point; 0 where there are not just two."""
    if len(directions_rad) != 2:
        return 0.0
    return abs(wrap_angle(directions_rad[0] - directions_rad[1]))


# The sonar.

FOOT_STD_IN: Final = 0.5
"""Blur of the ends of a wall: a foot this far beyond an end is detected by one ping of six."""
MIN_ANGLE_STD_RAD: Final = 1e-3
"""Least blur of the edge of the cone."""
CLEARANCE_IN: Final = 0.05
"""The path to a reflector is clear if blocked this little before it: its own walls meet there."""
MIN_PROBABILITY: Final = 1e-3
"""Less probable detections are left out."""
LOGISTIC_SLOPE: Final = 1.702
"""A logistic curve of this slope is nowhere off the normal distribution by more than 0.0095 (Camilli 1994)."""
MAX_SIGMAS: Final = log(1.0 / MIN_PROBABILITY - 1.0) / LOGISTIC_SLOPE
"""A reflector so many standard deviations out of reach has MIN_PROBABILITY at most."""
REACH_IN: Final = MAX_SIGMAS * FOOT_STD_IN
"""A foot farther than this beyond an end is not detected."""
_MIN_ABSORPTION: Final = 1e-9
"""Least absorption, dB per inch, that limits the range at which a reflector is loud enough."""
_ROUNDING: Final = 1e-6
"""Margin for rounding, inches or radians."""
CONE_RAD: Final = radians(25.0)
"""Cone of a Polaroid transducer, for rings that state none."""
_MIN_RANGE_IN: Final = 1e-9
"""Stands for a range of 0 where it is divided by."""


@dataclass(frozen=True, slots=True)
class ConeSonar(RangeNoise):
    """Parameters of a Polaroid ring by its data sheet, and of its outliers.

    Attributes
    ----------
    range_std_relative
        A quarter more than the 1 % of the data sheet: echoes of one reflector that follow one another err alike.
    cone_rad
        Whole angle of the cone.
    margin_db, margin_std_db
        Level of a near wall at a right angle above the threshold of detection; its standard deviation.
    cone_loss_db
        Two-way loss at the rim of the cone.
    absorption_db_in
        Loss per inch of range.
    bounce_loss_db, edge_loss_db
        Loss at the second wall of a square corner; at any other vertex.
    outlier_probability
        Fraction of readings that no reflector of the map explains: spread evenly over all ranges.
    surface_std_in, surface_length_in
        Standard deviation and correlation length of the surface of walls (surface.py); 0: walls are where the map says.
    """

    range_std_relative: float = 0.0125
    rounding_var_in2: float = WIRE_SONAR.rounding_var_in2
    place_var_in2: float = 0.04
    lowest_in: float = NOMAD.min_range_in
    highest_in: float = NOMAD.max_range_in
    cone_rad: float = CONE_RAD
    margin_db: float = 30.0
    margin_std_db: float = 2.0
    cone_loss_db: float = 12.0
    absorption_db_in: float = 0.1
    bounce_loss_db: float = 3.0
    edge_loss_db: float = 15.0
    outlier_probability: float = 0.1
    surface_std_in: float = 0.0
    surface_length_in: float = 24.0

    @property
    def outlier_density(self) -> float:
        """Probability density of an outlier, per inch."""
        return 1.0 / (self.highest_in - self.lowest_in)


BUILDING_SONAR: Final = ConeSonar(
    range_std_relative=0.003,
    cone_rad=radians(50.0),
    cone_loss_db=24.0,
    outlier_probability=0.67,
    place_var_in2=0.0,  # the surface stands for it
    surface_std_in=1.75,
    surface_length_in=24.0,
)
"""A real ring in a real building, fitted to a corridor (docs/real-data.md): soft edges of cones, walls with surfaces,
two of three echoes from things that are not on the map."""


def cone_sonar(ring: Ring) -> ConeSonar:
    """Return the sonars of a real ring: its limits, resolution and cone, the levels of the data sheet."""
    return _on_ring(ConeSonar(), ring)


def building_sonar(ring: Ring) -> ConeSonar:
    """Return the sonars of a real ring in a real building."""
    return _on_ring(BUILDING_SONAR, ring)


def _on_ring(sonar: ConeSonar, ring: Ring) -> ConeSonar:
    rays = sonar_ray.ray_sonar(ring)
    return replace(sonar, rounding_var_in2=rays.rounding_var_in2, lowest_in=rays.lowest_in, highest_in=rays.highest_in,
                   cone_rad=sonar.cone_rad if ring.half_cone_rad is None else 2.0 * ring.half_cone_rad)  # fmt: skip


def arm_of(mount: SonarMount, axis_x: Number, axis_y: Number) -> tuple[Number, Number]:
    """Return the vector from the robot's axis to the face of a sonar whose beam has this unit vector."""
    return mount.ring_in * axis_x - mount.left_in * axis_y, mount.ring_in * axis_y + mount.left_in * axis_x


# The formulas, for one number or an array.


def to_wall(x: Number, y: Number, corner_x: Number, corner_y: Number, normal_x: Number,
            normal_y: Number) -> tuple[Number, Number, Number, Number]:
    """Return range, unit vector (two numbers) and foot of the perpendicular from (x, y) to a wall.

    The foot is the distance along the wall from its corner; the wall's direction is its normal turned to the right.
    """
    from_x, from_y = x - corner_x, y - corner_y
    height = from_x * normal_x + from_y * normal_y
    side = choose(height < 0.0, 1.0, -1.0)
    return abs(height), side * normal_x, side * normal_y, from_x * normal_y - from_y * normal_x


def to_vertex(x: Number, y: Number, vertex_x: Number, vertex_y: Number) -> tuple[Number, Number, Number]:
    """Return range and unit vector (two numbers) from (x, y) to a vertex."""
    to_x, to_y = vertex_x - x, vertex_y - y
    range_in = sqrt(to_x * to_x + to_y * to_y)  # the same bits everywhere, which hypot has not
    divisor = choose(range_in > _MIN_RANGE_IN, range_in, _MIN_RANGE_IN)
    return range_in, to_x / divisor, to_y / divisor


def range_jacobian(toward_x: Number, toward_y: Number, arm_x: Number, arm_y: Number) -> tuple[Number, Number, Number]:
    """Return H, the derivative by the pose of a range along a unit vector from the end of an arm."""
    return -toward_x, -toward_y, toward_x * arm_y - toward_y * arm_x


def normal_cdf(sigmas: Number) -> Number:
    """Return the probability that a normal variable stays below so many standard deviations, by a logistic curve."""
    return 1.0 / (1.0 + exp(clip(-LOGISTIC_SLOPE * sigmas, -300.0, 300.0)))


def foot_probability(foot: Number, length: Number) -> Number:
    """Return the probability that the foot of a perpendicular lies on a wall of this length."""
    return normal_cdf(foot / FOOT_STD_IN) * normal_cdf((length - foot) / FOOT_STD_IN)


def detection_probability(off_axis_rad: Number, range_in: Number, loss_db: Number, blur_rad: Number,
                          sonar: ConeSonar) -> Number:
    """Return the probability that a reflector is detected, if no other is nearer.

    Parameters
    ----------
    off_axis_rad
        Its angle from the axis of the cone.
    loss_db
        Loss at the reflector itself.
    blur_rad
        Standard deviation of the edge of the cone: that of the heading.
    """
    half = 0.5 * sonar.cone_rad
    ratio = off_axis_rad / half
    # 1. The level: less at the edge of the cone, with the range, and by the reflector.
    total_db = sonar.cone_loss_db * ratio * ratio + sonar.absorption_db_in * range_in + loss_db
    # 2. Within the cone, and loud enough.
    return normal_cdf((half - abs(off_axis_rad)) / blur_rad) * normal_cdf(
        (sonar.margin_db - total_db) / sonar.margin_std_db
    )


# One sonar at one pose.

Rows = list[list[float]]


def rows_of_five(rows: Rows) -> Rows:
    """Return an iterable of rows of five numbers: `compiled` has one for arrays."""
    return rows


def rows_of_three(rows: Rows) -> Rows:
    """Return an iterable of rows of three numbers: `compiled` has one for arrays."""
    return rows


class EchoCandidate(NamedTuple):
    """A reflector that may return the first echo: its number, range, derivative by the pose, and probability."""

    reflector: int
    range_in: float
    H: tuple[float, float, float]
    probability: float


def first_echoes(x: float, y: float, heading: float, heading_std_rad: float, mount: SonarMount,
                 model: ConeModel) -> list[EchoCandidate]:
    """Return what a sonar in a direction from the heading may detect from a pose, the nearest first."""
    # 1. The face of the sonar, its axis, and the widest angle at which anything is detected.
    sonar, axis = model.noise, heading + mount.direction_rad
    axis_x, axis_y = unit_vector(axis)
    arm_x, arm_y = arm_of(mount, axis_x, axis_y)
    face_x, face_y = x + arm_x, y + arm_y
    blur = max(heading_std_rad, MIN_ANGLE_STD_RAD)
    widest = 0.5 * sonar.cone_rad + MAX_SIGMAS * blur
    min_cosine = cos(widest) - 1e-9 if widest < pi else -2.0
    # 2. The reflectors in the cone that are loud enough: walls with their foot on them, and vertices.
    audible_in = (sonar.margin_db + MAX_SIGMAS * sonar.margin_std_db) / max(sonar.absorption_db_in, _MIN_ABSORPTION)
    found, number = [], -1
    for corner_x, corner_y, normal_x, normal_y, length in rows_of_five(model.faces):
        number += 1
        if abs(normal_x * axis_x + normal_y * axis_y) <= min_cosine:  # from either side
            continue
        range_in, to_x, to_y, foot = to_wall(face_x, face_y, corner_x, corner_y, normal_x, normal_y)
        is_in_cone = to_x * axis_x + to_y * axis_y > min_cosine
        if is_in_cone and range_in < audible_in and -REACH_IN < foot < length + REACH_IN:
            off_axis = wrap_angle(atan2(to_y, to_x) - axis)
            probability = foot_probability(foot, length) * detection_probability(off_axis, range_in, 0.0, blur, sonar)
            if probability > MIN_PROBABILITY:
                found.append((range_in, number, to_x, to_y, probability))
    for vertex_x, vertex_y, loss_db in rows_of_three(model.vertices):
        number += 1
        ahead_in = (vertex_x - face_x) * axis_x + (vertex_y - face_y) * axis_y
        if ahead_in < 0.0 < min_cosine or ahead_in > audible_in:  # behind, or too far
            continue
        range_in, to_x, to_y = to_vertex(face_x, face_y, vertex_x, vertex_y)
        if to_x * axis_x + to_y * axis_y >= min_cosine and range_in < audible_in:
            off_axis = wrap_angle(atan2(to_y, to_x) - axis)
            probability = detection_probability(off_axis, range_in, loss_db, blur, sonar)
            if probability > MIN_PROBABILITY:
                found.append((range_in, number, to_x, to_y, probability))
    # 3. The first echo: the probability of each, if the path to it is clear, and that no nearer one was detected.
    sort_by_range(found)
    undetected, echoes = 1.0, []
    for range_in, number, to_x, to_y, probability in found:
        if sonar_ray.nearest(face_x, face_y, to_x, to_y, model.walls)[0] < range_in - CLEARANCE_IN:
            continue
        if undetected > 0.0:
            H = range_jacobian(to_x, to_y, arm_x, arm_y)
            echoes.append(EchoCandidate(number, range_in, H, probability * undetected))
        undetected *= 1.0 - probability
    return echoes


def detectable(x: State, P: Covariance, mount: SonarMount, reading_in: float,
               model: ConeModel) -> tuple[int, float, list[EchoCandidate]]:
    """Return NONE or why a reading is no echo, its likelihood then, and the reflectors that may have returned it."""
    noise = model.noise
    candidates = []
    for number, range_in, H, probability in first_echoes(
        x[0], x[1], x[HEADING], sqrt(P[HEADING][HEADING]), mount, model
    ):
        # A reflector beyond the limit reads "nothing".
        nearer = normal_cdf((noise.highest_in - range_in) / sqrt(sonar_ray.range_variance(noise, range_in)))
        if nearer > MIN_PROBABILITY:
            candidates.append(EchoCandidate(number, range_in, H, probability * nearer))
    if reading_in <= noise.lowest_in:
        return update.LIMIT, 1.0, candidates
    if reading_in >= noise.highest_in:  # "nothing": the probability that nothing was detected
        detected = sum([candidate.probability for candidate in candidates])
        return update.LIMIT, 1.0 - (1.0 - noise.outlier_probability) * detected, candidates
    return (update.NONE, 1.0, candidates) if candidates else (update.NO_WALL, noise.outlier_density, candidates)


def hypotheses(x: State, candidates: list[EchoCandidate], model: ConeModel) -> Association:
    """Return the hypotheses for a reading of one of these reflectors."""
    noise, parameters = model.noise, model.range_parameters
    expected = [update.expected_reading(x, candidate.range_in, candidate.H, parameters) for candidate in candidates]
    return Association(Refusal.NONE, 1.0, [reading_in for reading_in, _ in expected], [H for _, H in expected],
                       [sonar_ray.range_variance(noise, candidate.range_in) for candidate in candidates],
                       [sonar_ray.constant_variance(noise, candidate.range_in) for candidate in candidates],
                       [candidate.probability for candidate in candidates], None, noise.outlier_probability,
                       noise.outlier_density, 0.0, parameters, 1.0)  # fmt: skip


def update_by_cone(x: State, P: Covariance, mount: SonarMount, reading_in: float, model: ConeModel, count: int,
                   outlier_fraction: float) -> Outcome:  # fmt: skip
    """Correct x and P by the reading of a sonar, its direction from the heading, in place (`pda_update`)."""
    refusal, likelihood, candidates = detectable(x, P, mount, reading_in, model)
    if refusal != update.NONE:
        return refusal, 0.0, 0.0, 1.0, likelihood, 0.0
    association = hypotheses(x, candidates, model)
    return update.update_by_association(x, P, reading_in, association, update.linear, count, outlier_fraction)


def rows_of(around: Reflectors, sonar: ConeSonar) -> tuple[Floats, Floats]:
    """Return walls (m, 5) and vertices (v, 3) as rows for `first_echoes`.

    A wall is its corner, normal and length; a vertex its place, and the loss of its echo in decibels.
    """
    losses = np.where(around.square, sonar.bounce_loss_db, sonar.edge_loss_db)
    faces = np.concatenate((around.corners, around.normals, around.lengths[:, None]), axis=1)
    return faces, np.column_stack((around.vertices, losses))


class ConeModel(DirectModel):
    """Measurement model of sonars whose reading is the first echo out of a cone, or an outlier."""

    noise: ConeSonar

    def __init__(self, walls: npt.ArrayLike, body: Body, sonar: ConeSonar, range_parameters: int = 0) -> None:
        self.walls, self.noise = sonar_ray.wall_map(walls), sonar
        self.mounts = body.ring.mounts
        around = reflectors(self.walls.segments)
        if sonar.surface_std_in:
            # A free end of a wall on the map of a building is often only the end of what was mapped: an echo off a post
            # or a door frame that is taken for it puts the robot off along the wall.
            around = around.some(np.full(len(around.walls), fill_value=True), ~around.free)
        self.around = around
        faces, vertices = rows_of(around, sonar)
        self.faces, self.vertices = faces.tolist(), vertices.tolist()
        self.update, self.range_parameters = update_by_cone, range_parameters

    def associate(self, x: State, P: Covariance, sonar: int, turret_offset_rad: float,
                  reading_in: float) -> Association:
        """Return a hypothesis for each reflector that may return the first echo."""
        mount = update.mount_at(self.mounts, sonar, turret_offset_rad)
        refusal, likelihood, candidates = detectable(x, P, mount, reading_in, self)
        if refusal != update.NONE:
            return Association(update.REFUSALS[refusal], likelihood)
        numbers = np.array([one.reflector for one in candidates])
        expect = partial(ranges_to, mount=mount, around=self.around, numbers=numbers)
        return hypotheses(x, candidates, self)._replace(range_function=expect)


# Many poses, in arrays.


class ExpectedEchoes(NamedTuple):
    """Expected echoes of k reflectors, walls first.

    Attributes
    ----------
    ranges_in
        (..., k) inches.
    H
        (..., k, 3) derivative of the range by the pose.
    probability
        (..., k) that the first echo is of this reflector; 0 where it cannot be.
    """

    ranges_in: Floats
    H: Floats
    probability: Floats


class _Geometry(NamedTuple):
    """Faces (..., 1), axis (..., 1) and arm of a sonar; ranges and unit vectors (..., k); feet (..., m)."""

    x: Floats
    y: Floats
    axis: Floats
    arm_x: Floats
    arm_y: Floats
    ranges_in: Floats
    to_x: Floats
    to_y: Floats
    feet_in: Floats


def expected_echoes(poses: Floats, heading_std_rad: Floats, mount: SonarMount, around: Reflectors, sonar: ConeSonar,
                    walls_in: Floats | None = None) -> ExpectedEchoes:  # fmt: skip
    """Return the expected echoes of all reflectors at poses (..., 3), their headings uncertain by (...) radians.

    `walls_in` (m', 4) may block the path. Default: all walls of `around`.
    """
    if poses.ndim == 1:
        alone = expected_echoes(poses[None], heading_std_rad, mount, around, sonar, walls_in)
        return ExpectedEchoes(*(part[0] for part in alone))
    seen = _geometry(poses, mount, around)
    walls_in = around.walls if walls_in is None else walls_in
    probability = _first_echo(seen.ranges_in, _detected(seen, heading_std_rad, around, sonar, walls_in))
    return ExpectedEchoes(seen.ranges_in, _stacked(seen.to_x, seen.to_y, seen.arm_x, seen.arm_y), probability)


def echo_probabilities(poses: Floats, heading_std_rad: Floats, mount: SonarMount, around: Reflectors, sonar: ConeSonar,
                       walls_in: Floats | None = None) -> tuple[Floats, Floats]:  # fmt: skip
    """Return ranges and probabilities (n, j) of `expected_echoes` at poses (n, 3).

    Only the j reflectors that are detected from at least one of the poses are included. `walls_in` (m', 4) may block
    the path. Default: all walls of `around`.
    """
    near = _within_reach(poses, heading_std_rad, mount, around, sonar)
    seen = _geometry(poses, mount, near)
    detected = _detected(seen, heading_std_rad, near, sonar, around.walls if walls_in is None else walls_in)
    which = detected.any(axis=0)
    ranges = seen.ranges_in[:, which]
    return ranges, _first_echo(ranges, detected[:, which])


def ranges_to(poses: Floats, mount: SonarMount, around: Reflectors, numbers: Indices) -> tuple[Floats, Floats]:
    """Return ranges (..., k) of the reflectors of these numbers (k,), detected or not, and H (..., k, 3).

    From poses (..., k, 3), one each, or (..., 1, 3), one for all.
    """
    # 1. The face of the sonar at each pose, and its arm.
    axis = poses[..., HEADING] + mount.direction_rad
    arm_x, arm_y = (
        np.broadcast_to(part, (*axis.shape[:-1], len(numbers))) for part in arm_of(mount, np.cos(axis), np.sin(axis))
    )
    x, y = poses[..., 0] + arm_x, poses[..., 1] + arm_y
    # 2. Walls and vertices, each into its columns.
    ranges, to_x, to_y = np.empty(x.shape), np.empty(x.shape), np.empty(x.shape)
    walls = numbers < len(around.walls)
    wall, vertex = numbers[walls], numbers[~walls] - len(around.walls)
    at = np.s_[..., walls]
    ranges[at], to_x[at], to_y[at], _ = to_wall(x[at], y[at], *around.corners[wall].T, *around.normals[wall].T)
    at = np.s_[..., ~walls]
    ranges[at], to_x[at], to_y[at] = to_vertex(x[at], y[at], *around.vertices[vertex].T)
    return ranges, _stacked(to_x, to_y, arm_x, arm_y)


def _stacked(to_x: Floats, to_y: Floats, arm_x: Floats, arm_y: Floats) -> Floats:
    """Return `range_jacobian` as one array (..., k, 3)."""
    return np.stack(np.broadcast_arrays(*range_jacobian(to_x, to_y, arm_x, arm_y)), axis=-1)


def _geometry(poses: Floats, mount: SonarMount, around: Reflectors) -> _Geometry:
    """Return the perpendiculars to all walls and the lines to all vertices from the faces at poses (..., 3)."""
    axis = poses[..., HEADING, None] + mount.direction_rad
    arm_x, arm_y = arm_of(mount, np.cos(axis), np.sin(axis))
    x, y = poses[..., 0, None] + arm_x, poses[..., 1, None] + arm_y
    *walls, feet = to_wall(x, y, *around.corners.T, *around.normals.T)
    vertices = to_vertex(x, y, *around.vertices.T)
    ranges, to_x, to_y = (np.concatenate(pair, axis=-1) for pair in zip(walls, vertices, strict=True))
    return _Geometry(x, y, axis, arm_x, arm_y, ranges, to_x, to_y, feet)


def _within_reach(poses: Floats, heading_std_rad: Floats, mount: SonarMount, around: Reflectors,
                  sonar: ConeSonar) -> Reflectors:
    """Return the reflectors that may lie in the cone from any of the poses (n, 3).

    From the middle of all poses a direction differs by no more than the headings do, and that to a vertex besides by
    the angle under which it sees all poses.
    """
    # 1. The middle pose, how far the faces are from its own, and the widest angle from its axis.
    middle = np.append(poses[:, :2].mean(axis=0), poses[0, HEADING])
    headings = np.abs(wrap_angle(poses[:, HEADING] - middle[HEADING])).max()
    arm = np.hypot(mount.ring_in, mount.left_in)
    about = np.hypot(*(poses[:, :2] - middle[:2]).T).max() + 2.0 * arm * np.sin(0.5 * headings)
    widest = 0.5 * sonar.cone_rad + MAX_SIGMAS * max(float(np.max(heading_std_rad)), MIN_ANGLE_STD_RAD) + headings
    seen = _geometry(middle, mount, around)
    off_axis = np.abs(wrap_angle(np.arctan2(seen.to_y, seen.to_x) - seen.axis))
    # 2. Walls: near, or in the widened cone with the foot on them.
    count = len(around.walls)
    reach = about + REACH_IN + _ROUNDING
    walls = (seen.ranges_in[:count] <= about) | (off_axis[:count] <= widest + _ROUNDING)
    walls &= (seen.feet_in >= -reach) & (seen.feet_in <= around.lengths + reach)
    # 3. Vertices: in the cone widened by the angle under which they see all poses.
    ranges = seen.ranges_in[count:]
    parallax = np.arcsin(np.minimum(about / np.maximum(ranges, _MIN_RANGE_IN), 1.0))
    parallax[ranges <= about] = np.pi
    return around.some(walls, off_axis[count:] <= widest + parallax + _ROUNDING)


def _detected(seen: _Geometry, heading_std_rad: Floats, around: Reflectors, sonar: ConeSonar,
              walls_in: Floats) -> Floats:
    """Return the probability (..., k) that each is detected, if it were the only one.

    It is 0 up to MIN_PROBABILITY, and where one of the walls (m', 4) blocks the path.
    """
    # 1. Leave out what is clearly outside of the cone or beyond the end of its wall: most of all.
    count, half = len(around.walls), 0.5 * sonar.cone_rad
    blur = np.maximum(heading_std_rad, MIN_ANGLE_STD_RAD)[..., None]
    widest = np.minimum(half + MAX_SIGMAS * blur + 1e-9, np.pi)
    able: Mask = seen.to_x * np.cos(seen.axis) + seen.to_y * np.sin(seen.axis) >= np.cos(widest) - 1e-12
    able[..., :count] &= (seen.feet_in > -REACH_IN) & (seen.feet_in < around.lengths + REACH_IN)
    # 2. The probability of the others, pair by pair of pose and reflector.
    at = np.nonzero(able)
    poses, which = at[:-1], at[-1]
    loss_db = np.zeros(around.count)
    loss_db[count:] = np.where(around.square, sonar.bounce_loss_db, sonar.edge_loss_db)
    to_x, to_y, ranges = seen.to_x[at], seen.to_y[at], seen.ranges_in[at]
    off_axis = wrap_angle(np.arctan2(to_y, to_x) - seen.axis[..., 0][poses])
    blurs = np.broadcast_to(blur[..., 0], seen.axis.shape[:-1])[poses]
    probability = detection_probability(off_axis, ranges, loss_db[which], blurs, sonar)
    walls = which < count
    feet = seen.feet_in[(*(index[walls] for index in poses), which[walls])]
    probability[walls] *= foot_probability(feet, around.lengths[which[walls]])
    # 3. A clear path.
    likely = probability > MIN_PROBABILITY
    at = tuple(index[likely] for index in at)
    faces = np.stack((seen.x[..., 0][at[:-1]], seen.y[..., 0][at[:-1]]), axis=-1)
    detected = np.zeros(able.shape)
    if len(faces):
        blocked_in, _ = cast_rays(faces, np.stack((to_x[likely], to_y[likely]), axis=-1), walls_in)
        detected[at] = np.where(blocked_in >= ranges[likely] - CLEARANCE_IN, probability[likely], 0.0)
    return detected


def _first_echo(ranges_in: Floats, detected: Floats) -> Floats:
    """Return the probability (..., k) that each is detected and none that is nearer."""
    order = np.argsort(ranges_in, axis=-1)
    by_range = np.take_along_axis(detected, order, axis=-1)
    undetected = np.cumprod(1.0 - by_range, axis=-1)
    first = by_range.copy()
    first[..., 1:] *= undetected[..., :-1]
    probability: Any = np.empty_like(first)
    np.put_along_axis(probability, order, first, axis=-1)
    return np.asarray(probability, dtype=np.float64)
