"""What a sonar with a cone may bring back: of each wall and vertex how far, and how likely it is heard first.

A ray model asks what stands on the axis. A real transducer hears everything within some 12 degrees of it, and of a
smooth wall only what is met head-on. So a wall's echo tells the perpendicular distance, wherever in the cone that lies,
and a vertex's the distance to it:

    face at p     p = (x, y) + ring Rot(theta) direction
    wall          range = |normal . (p - corner)|          heard where the foot lies on the wall and within the cone
    vertex        range = |vertex - p|                     heard within the cone

How likely each is heard follows from its level (datasheet decibels), from the rim of the cone, which the uncertain
heading makes soft, and from what is nearer: the first echo counts. Rules: pure functions on arrays, leading dimensions
are poses; no belief is changed here, no reading looked at.

What one sonar of one robot may hear out of its cone, in plain numbers: what cone does for many poses in arrays.

Most reflectors are far out of the cone; looked through one by one they cost half a microsecond each, and only the few
that are left are worked out. Rules: pure; cone.cone_returns is the same for any number of poses and its witness. What
each number means is told there.

A sonar as a cone: all that it may hear, each with its chance, and bad readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import atan2, cos, exp, hypot, log, pi, radians, sin, sqrt
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, Belief, Floats, wrap_angle, wrapped
from localization.filters.odometry import POSE
from localization.filters.reflectors import Reflectors, reflectors
from localization.filters.sonar_ray import RangeNoise, SonarRing, wall_map
from localization.filters.update import Association, Hypotheses, Refusal
from worlds.raycast import WallIndex, cast_rays

Indices = npt.NDArray[np.intp]
Complexes = npt.NDArray[np.complex128]

FOOT_STD_IN: Final = 0.5
"""How softly a wall ends: a foot this far beyond its end is heard in one of six cries."""
LEAST_ANGLE_STD_RAD: Final = 1e-3
SHORT_IN: Final = 0.05
"""How far before a reflector the way to it may be blocked and still count as free: its own walls meet there."""
NEVER: Final = 1e-3
"""Returns less likely than this are not looked for."""
LOGISTIC_SLOPE: Final = 1.702
"""With it a logistic curve is nowhere off the normal distribution by more than 0.0095 (Camilli 1994)."""
_SLACK: Final = 1e-6
"""What rounding may take away, inches or radians."""
NEVER_BELOW: Final = log(1.0 / NEVER - 1.0) / LOGISTIC_SLOPE
"""What is so many standard deviations out of reach has a chance of NEVER at most."""


@dataclass(frozen=True, slots=True)
class ConeSonar(RangeNoise):
    """A Polaroid ring by its datasheet, and what is believed of its bad readings.

    cone_rad                      whole angle of the cone
    relative_std to highest_in    as range_noise says
    margin_db, margin_std_db      how much louder than just audible a wall close by is met head-on; its spread
    rim_loss_db                   lost at the rim of the cone, out and back
    way_loss_db_in                lost an inch of range
    square_loss_db, edge_loss_db  lost at a square corner; at any other vertex
    bad_share                     of readings that no reflector of the map explains: spread evenly over all ranges
    """

    rounding_var_in2: float = 1.0 / 12.0
    lowest_in: float = 6.0
    highest_in: float = 255.0
    cone_rad: float = radians(25.0)
    margin_db: float = 30.0
    margin_std_db: float = 2.0
    rim_loss_db: float = 12.0
    way_loss_db_in: float = 0.1
    square_loss_db: float = 3.0
    edge_loss_db: float = 15.0
    outlier_probability: float = 0.1

    @property
    def bad_density(self) -> float:
        """Probability density of a bad reading, per inch."""
        return 1.0 / (self.highest_in - self.lowest_in)


class Returns(NamedTuple):
    """What k reflectors may send back: `ranges_in` (..., k), their derivative by the pose `jacobian` (..., k, 3), and
    the `probability` (..., k) that the reading is this one's; 0 where it cannot be."""

    ranges_in: Floats
    jacobian: Floats
    probability: Floats


class SonarMount(NamedTuple):
    """A sonar on the robot: the direction of its axis in the robot's frame, and the radius of its ring."""

    direction_rad: float
    ring_in: float


def cone_returns(
    poses: Floats, heading_std_rad: Floats, ear: SonarMount, around: Reflectors, model: ConeSonar
) -> Returns:
    """What a sonar at poses (..., 3), their headings uncertain by (...) radians, may hear of all reflectors."""
    if poses.ndim == 1:
        alone = cone_returns(poses[None], heading_std_rad, ear, around, model)
        return Returns(*(part[0] for part in alone))
    axis, arm, ways = _ways(poses, ear, around)
    probability = _first_heard(ways.ranges_in, _heard(axis, heading_std_rad, ways, around, model, around.walls))
    toward = ways.toward.view(np.float64).reshape(*ways.toward.shape, 2)
    return Returns(ways.ranges_in, _by_pose(toward, arm), probability)


def cone_chances(
    poses: Floats, heading_std_rad: Floats, ear: SonarMount, around: Reflectors, model: ConeSonar
) -> tuple[Floats, Floats]:
    """Ranges and probabilities (n, j) of `cone_returns` at poses (n, 3): of those j reflectors alone that are heard
    from any of them."""
    near = _within_reach(poses, heading_std_rad, ear, around, model)
    axis, _, ways = _ways(poses, ear, near)
    heard = _heard(axis, heading_std_rad, ways, near, model, around.walls)
    which = heard.any(axis=0)
    ranges = ways.ranges_in[:, which]
    return ranges, _first_heard(ranges, heard[:, which])


def expected(poses: Floats, ear: SonarMount, around: Reflectors, which: Indices) -> tuple[Floats, Floats]:
    """Ranges (..., k) of the reflectors numbered `which` (k,), heard or not, and their derivatives (..., k, 3), from
    poses (..., k, 3), one each, or (..., 1, 3), one for all."""
    axis = poses[..., HEADING] + ear.direction_rad
    arm = ear.ring_in * np.stack((np.cos(axis), np.sin(axis)), axis=-1)
    way = np.concatenate((around.corners, around.vertices))[which] - poses[..., :2] - arm
    walls = which < len(around.walls)
    normals = np.zeros((len(which), 2))
    normals[walls] = around.normals[which[walls]]
    height = (way * normals).sum(axis=-1)
    ranges = np.where(walls, np.abs(height), np.hypot(way[..., 0], way[..., 1]))
    to_vertices = way / np.maximum(ranges, 1e-9)[..., None]
    toward = np.where(walls[:, None], np.where(height < 0.0, -1.0, 1.0)[..., None] * normals, to_vertices)
    return ranges, _by_pose(toward, arm)


def _by_pose(toward: Floats, arm: Floats) -> Floats:
    """The derivative (..., k, 3) of ranges towards unit vectors (..., k, 2) from the end of arms (..., k or 1, 2)."""
    jacobian = np.empty((*toward.shape[:-1], 3))
    jacobian[..., :2] = -toward
    jacobian[..., 2] = toward[..., 0] * arm[..., 1] - toward[..., 1] * arm[..., 0]
    return jacobian


def _within_reach(
    poses: Floats, heading_std_rad: Floats, ear: SonarMount, around: Reflectors, model: ConeSonar
) -> Reflectors:
    """Those reflectors that may lie in the cone from any of the poses (n, 3): seen from the middle of all, a direction
    is off by no more than the headings differ, and to a vertex by the angle that all poses are seen under besides."""
    middle = np.append(poses[:, :2].mean(axis=0), poses[0, HEADING])
    headings = np.abs(wrap_angle(poses[:, HEADING] - middle[HEADING])).max()
    axis = middle[HEADING] + ear.direction_rad
    about = np.hypot(*(poses[:, :2] - middle[:2]).T).max() + 2.0 * ear.ring_in * np.sin(0.5 * headings)
    widest = 0.5 * model.cone_rad + NEVER_BELOW * max(float(np.max(heading_std_rad)), LEAST_ANGLE_STD_RAD) + headings
    face = middle[:2] + ear.ring_in * np.array([np.cos(axis), np.sin(axis)])
    offset = face - around.corners
    height, foot = (offset * around.normals).sum(axis=-1), (offset * around.along).sum(axis=-1)
    normal = np.arctan2(around.normals[:, 1], around.normals[:, 0]) + np.where(height < 0.0, 0.0, np.pi)
    reach = about + NEVER_BELOW * FOOT_STD_IN + _SLACK
    walls = (np.abs(height) <= about) | (np.abs(wrap_angle(normal - axis)) <= widest + _SLACK)
    walls &= (foot >= -reach) & (foot <= around.lengths + reach)
    way = around.vertices - face
    wider = np.arcsin(np.minimum(about / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9), 1.0))
    wider[np.hypot(way[:, 0], way[:, 1]) <= about] = np.pi
    vertices = np.abs(wrap_angle(np.arctan2(way[:, 1], way[:, 0]) - axis)) <= widest + wider + _SLACK
    return around.some(walls, vertices)


class _Ways(NamedTuple):
    """From faces (...), complex numbers, to all k reflectors: `toward` (..., k), unit vectors as complex numbers,
    `ranges_in` (..., k), and `feet_in` (..., m), how far along each wall its foot lies."""

    faces: Complexes
    toward: Complexes
    ranges_in: Floats
    feet_in: Floats


def _ways(poses: Floats, ear: SonarMount, around: Reflectors) -> tuple[Floats, Floats, _Ways]:
    """The axes (...) of the sonar, its arms (..., 1, 2), and the ways from its face."""
    axis = poses[..., HEADING] + ear.direction_rad
    arm = ear.ring_in * np.stack((np.cos(axis), np.sin(axis)), axis=-1)
    face = poses[..., :2] + arm
    faces = face[..., 0] + 1j * face[..., 1]
    count = len(around.walls)
    toward = np.empty((*faces.shape, around.count), dtype=np.complex128)
    ranges = np.empty(toward.shape)
    parts = around.along, around.corners, around.vertices
    along, corners, vertices = (part[:, 0] + 1j * part[:, 1] for part in parts)
    seen = (faces[..., None] - corners) * along.conj()
    np.abs(seen.imag, out=ranges[..., :count])
    np.multiply(np.where(seen.imag < 0.0, 1.0, -1.0), 1j * along, out=toward[..., :count])
    way = vertices - faces[..., None]
    np.abs(way, out=ranges[..., count:])
    np.divide(way, np.maximum(ranges[..., count:], 1e-9), out=toward[..., count:])
    return axis, arm[..., None, :], _Ways(faces, toward, ranges, seen.real)


def _heard(
    axis: Floats, heading_std_rad: Floats, ways: _Ways, around: Reflectors, model: ConeSonar, walls_in: Floats
) -> Floats:
    """The chance (..., k) that each is heard, were there no other: 0 where it is no more than NEVER, or where one of
    the walls (m', 4) stands before it.

    What is so far out of the cone, or beyond the end of its wall, is left out first: most of all.
    """
    count, half = len(around.walls), 0.5 * model.cone_rad
    softness = np.maximum(heading_std_rad, LEAST_ANGLE_STD_RAD)
    widest = np.minimum(half + NEVER_BELOW * softness + 1e-9, np.pi)
    facing = ways.toward * np.exp(-1j * axis)[..., None]
    able = facing.real >= np.cos(widest)[..., None] - 1e-12
    reach = NEVER_BELOW * FOOT_STD_IN
    able[..., :count] &= (ways.feet_in > -reach) & (ways.feet_in < around.lengths + reach)
    at = np.nonzero(able)
    poses, which = at[:-1], at[-1]
    share = np.angle(facing[at]) / half
    reflected = np.zeros(around.count)
    reflected[count:] = np.where(around.square, model.square_loss_db, model.edge_loss_db)
    loss = model.rim_loss_db * share * share + model.way_loss_db_in * ways.ranges_in[at] + reflected[which]
    chance = _chance_below((half - half * np.abs(share)) / np.broadcast_to(softness, axis.shape)[poses])
    chance *= _chance_below((model.margin_db - loss) / model.margin_std_db)
    walls = which < count
    foot = ways.feet_in[(*(index[walls] for index in poses), which[walls])]
    on_wall = _chance_below(foot / FOOT_STD_IN)
    chance[walls] *= on_wall * _chance_below((around.lengths[which[walls]] - foot) / FOOT_STD_IN)
    likely = chance > NEVER
    at = tuple(index[likely] for index in at)
    heard = np.zeros(able.shape)
    heard[at] = chance[likely] * _free(ways.faces[at[:-1]], ways.toward[at], ways.ranges_in[at], walls_in)
    return heard


def _chance_below(sigmas: Floats) -> Floats:
    """The chance that a normal variable stays below so many standard deviations, by a logistic curve."""
    chance: Floats = 1.0 / (1.0 + np.exp(np.clip(-LOGISTIC_SLOPE * sigmas, -300.0, 300.0)))
    return chance


def _free(faces: Complexes, toward: Complexes, ranges_in: Floats, walls: Floats) -> Floats:
    """1 where nothing stands between faces (n,) and what lies at `ranges_in` (n,) towards (n,), else 0."""
    if not len(faces):
        return np.zeros(0)
    face, way = (numbers.view(np.float64).reshape(-1, 2) for numbers in (faces, toward))
    met, _ = cast_rays(face, way, walls)
    free: Floats = (met >= ranges_in - SHORT_IN).astype(np.float64)
    return free


def _first_heard(ranges_in: Floats, heard: Floats) -> Floats:
    """The chance (..., k) that a return is heard and none that is nearer."""
    order = np.argsort(ranges_in, axis=-1)
    by_range = np.take_along_axis(heard, order, axis=-1)
    silence = np.cumprod(1.0 - by_range, axis=-1)
    first = by_range.copy()
    first[..., 1:] *= silence[..., :-1]
    probability = np.empty_like(first)
    np.put_along_axis(probability, order, first, axis=-1)
    return probability


_SLACK_SINGLE_CONE: Final = 1e-9


class EchoCandidate(NamedTuple):
    """A reflector that may be heard: its number, range, the derivative by the pose, and the chance that it is heard."""

    which: int
    range_in: float
    jacobian: tuple[float, float, float]
    probability: float


class ConeSensor:
    """A model of cones in a map."""

    def __init__(self, around: Reflectors, model: ConeSonar) -> None:
        self._model, self._first = model, WallIndex(around.walls).nearest
        self._walls = list(
            enumerate(zip(*(part.tolist() for part in (around.corners, around.normals, around.lengths)), strict=True))
        )
        losses = [model.square_loss_db if square else model.edge_loss_db for square in around.square.tolist()]
        self._vertices = list(enumerate(zip(around.vertices.tolist(), losses, strict=True), start=len(around.walls)))

    def hear(self, pose: tuple[float, float, float], heading_std_rad: float, ear: SonarMount) -> list[EchoCandidate]:
        """What a sonar may hear from a pose, in the order of the reflectors."""
        model = self._model
        axis = pose[2] + ear.direction_rad
        axis_x, axis_y = cos(axis), sin(axis)
        arm_x, arm_y = ear.ring_in * axis_x, ear.ring_in * axis_y
        x, y = pose[0] + arm_x, pose[1] + arm_y
        half, softness = 0.5 * model.cone_rad, max(heading_std_rad, LEAST_ANGLE_STD_RAD)
        widest = half + NEVER_BELOW * softness
        least_cosine = cos(widest) - _SLACK_SINGLE_CONE if widest < pi else -2.0
        heard = []
        for which, range_in, to_x, to_y, on_wall, lost_db in self._within(x, y, axis_x, axis_y, least_cosine):
            off = wrapped(atan2(to_y, to_x) - axis)
            loss_db = model.rim_loss_db * (off / half) ** 2 + model.way_loss_db_in * range_in + lost_db
            loud = _below((model.margin_db - loss_db) / model.margin_std_db)
            chance = on_wall * _below((half - abs(off)) / softness) * loud
            if chance > NEVER and self._first(x, y, to_x, to_y)[0] >= range_in - SHORT_IN:
                heard.append((range_in, which, (-to_x, -to_y, to_x * arm_y - to_y * arm_x), chance))
        silence, found = 1.0, []
        for range_in, which, jacobian, chance in sorted(heard):
            if chance * silence:
                found.append(EchoCandidate(which, range_in, jacobian, chance * silence))
            silence *= 1.0 - chance
        return sorted(found)

    def _within(
        self, x: float, y: float, axis_x: float, axis_y: float, least_cosine: float
    ) -> list[tuple[int, float, float, float, float, float]]:
        """Of reflectors that may lie in the cone: number, range, direction, chance that a foot is on its wall, loss."""
        far = NEVER_BELOW * FOOT_STD_IN
        found = []
        for which, ((corner_x, corner_y), (normal_x, normal_y), length) in self._walls:
            off_x, off_y = x - corner_x, y - corner_y
            height, foot = off_x * normal_x + off_y * normal_y, off_x * normal_y - off_y * normal_x
            if not -far < foot < length + far:
                continue
            side = 1.0 if height < 0.0 else -1.0
            if side * (normal_x * axis_x + normal_y * axis_y) > least_cosine:
                on_wall = _below(foot / FOOT_STD_IN) * _below((length - foot) / FOOT_STD_IN)
                found.append((which, abs(height), side * normal_x, side * normal_y, on_wall, 0.0))
        for which, ((vertex_x, vertex_y), lost_db) in self._vertices:
            way_x, way_y = vertex_x - x, vertex_y - y
            range_in = hypot(way_x, way_y)
            if way_x * axis_x + way_y * axis_y >= least_cosine * range_in:
                divisor = max(range_in, 1e-9)
                found.append((which, range_in, way_x / divisor, way_y / divisor, 1.0, lost_db))
        return found


def _below(sigmas: float) -> float:
    """cone's logistic curve, of one number."""
    return 1.0 / (1.0 + exp(min(max(-LOGISTIC_SLOPE * sigmas, -300.0), 300.0)))


class ConeModel:
    """Each reading is the first echo out of a cone, or a bad one, with probabilities."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, model: ConeSonar) -> None:
        self._around, self._body, self._model = reflectors(wall_map(walls).segments), body, model
        self._listener = ConeSensor(self._around, model)

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Association:
        model = self._model
        if reading_in <= model.lowest_in:
            return Association(Refusal.LIMIT, 1.0)
        ear = SonarMount(turret_offset_rad + self._body.sonar_angles_rad[sonar], self._body.sonar_ring_radius_in)
        x, y, heading = belief.mean[:POSE].tolist()
        returns = self._listener.hear((x, y, heading), sqrt(belief.cov[HEADING, HEADING]), ear)
        if reading_in >= model.highest_in:
            heard = sum([found.probability for found in returns])
            return Association(Refusal.LIMIT, 1.0 - (1.0 - model.outlier_probability) * heard)
        if not returns:
            return Association(Refusal.NO_WALL, model.bad_density)
        which, ranges, jacobian, probability = zip(*returns, strict=True)
        candidates = Hypotheses(
            np.array(ranges),
            np.array(jacobian),
            np.array([model.variance_at(range_in) for range_in in ranges]),
            np.array([model.constant_at(range_in) for range_in in ranges]),
            np.array(probability),
            partial(expected, ear=ear, around=self._around, which=np.array(which)),
            model.outlier_probability,
            model.bad_density,
        )
        return Association(Refusal.NONE, 1.0, candidates)
