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
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.belief import HEADING, Floats, wrap_angle
from localization.reflectors import Reflectors
from worlds.raycast import cast_rays

Indices = npt.NDArray[np.intp]

FOOT_STD_IN: Final = 0.5
"""How softly a wall ends: a foot this far beyond its end is heard in one of six cries."""
LEAST_ANGLE_STD_RAD: Final = 1e-3
SHORT_IN: Final = 0.05
"""How far before a reflector the way to it may be blocked and still count as free: its own walls meet there."""
NEVER: Final = 1e-3
"""Returns less likely than this are not looked for."""
LOGISTIC_SLOPE: Final = 1.702
"""With it a logistic curve is nowhere off the normal distribution by more than 0.0095 (Camilli 1994)."""


@dataclass(frozen=True, slots=True)
class ConeModel:
    """A Polaroid ring by its datasheet, and what is believed of its bad readings.

    cone_rad                      whole angle of the cone
    relative_std, floor_std_in    standard deviation of a range: a share of it, and the least; rounding_var_in2 besides
    lowest_in, highest_in         readings at or beyond these are limits, no ranges
    margin_db, margin_std_db      how much louder than just audible a wall close by is met head-on; its spread
    rim_loss_db                   lost at the rim of the cone, out and back
    way_loss_db_in                lost an inch of range
    square_loss_db, edge_loss_db  lost at a square corner; at any other vertex
    bad_share                     of readings that no reflector of the map explains: spread evenly over all ranges
    """

    cone_rad: float = radians(25.0)
    relative_std: float = 0.01
    floor_std_in: float = 0.05
    rounding_var_in2: float = 1.0 / 12.0
    lowest_in: float = 6.0
    highest_in: float = 255.0
    margin_db: float = 30.0
    margin_std_db: float = 2.0
    rim_loss_db: float = 12.0
    way_loss_db_in: float = 0.1
    square_loss_db: float = 3.0
    edge_loss_db: float = 15.0
    bad_share: float = 0.1

    @property
    def bad_density(self) -> float:
        """Probability density of a bad reading, per inch."""
        return 1.0 / (self.highest_in - self.lowest_in)

    def variance(self, ranges_in: Floats) -> Floats:
        """Variance in in^2 of readings of `ranges_in`, any shape."""
        std = np.maximum(self.relative_std * ranges_in, self.floor_std_in)
        variance: Floats = std * std + self.rounding_var_in2
        return variance

    def variance_at(self, range_in: float) -> float:
        """`variance` of a single range."""
        std = max(self.relative_std * range_in, self.floor_std_in)
        return std * std + self.rounding_var_in2


class Returns(NamedTuple):
    """What k reflectors may send back: `ranges_in` (..., k), their derivative by the pose `jacobian` (..., k, 3), and
    the `probability` (..., k) that the reading is this one's; 0 where it cannot be."""

    ranges_in: Floats
    jacobian: Floats
    probability: Floats


class Ear(NamedTuple):
    """A sonar on the robot: the direction of its axis in the robot's frame, and the radius of its ring."""

    direction_rad: float
    ring_in: float


def cone_returns(poses: Floats, heading_std_rad: Floats, ear: Ear, around: Reflectors, model: ConeModel) -> Returns:
    """What a sonar at poses (..., 3), their headings uncertain by (...) radians, may hear of all reflectors."""
    axis = poses[..., HEADING] + ear.direction_rad
    arm = ear.ring_in * np.stack((np.cos(axis), np.sin(axis)), axis=-1)
    face = poses[..., :2] + arm
    toward, ranges, on_wall = _nearest_points(face, around)
    off_axis = wrap_angle(np.arctan2(toward[..., 1], toward[..., 0]) - axis[..., None])
    heard = on_wall * _audible(ranges, off_axis, heading_std_rad[..., None], around, model)
    likely = heard > NEVER
    heard = np.where(likely, heard, 0.0)
    rows = np.nonzero(likely)
    heard[rows] *= _free(face[rows[:-1]], toward[rows], ranges[rows], around.walls)
    return Returns(ranges, _by_pose(toward, arm[..., None, :]), _first_heard(ranges, heard))


def expected(poses: Floats, ear: Ear, around: Reflectors, which: Indices) -> tuple[Floats, Floats]:
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


def _nearest_points(face: Floats, around: Reflectors) -> tuple[Floats, Floats, Floats]:
    """From faces (..., 2) to all reflectors: unit vectors (..., k, 2), ranges (..., k), and the chance (..., k) that a
    foot lies on its wall (1 for vertices)."""
    offset = face[..., None, :] - around.corners
    height = (offset * around.normals).sum(axis=-1)
    foot = (offset * around.along).sum(axis=-1)
    to_walls = -np.where(height < 0.0, -1.0, 1.0)[..., None] * around.normals
    on_wall = _chance_below(foot / FOOT_STD_IN) * _chance_below((around.lengths - foot) / FOOT_STD_IN)
    way = around.vertices - face[..., None, :]
    far = np.hypot(way[..., 0], way[..., 1])
    to_vertices = way / np.maximum(far, 1e-9)[..., None]
    toward = np.concatenate((to_walls, to_vertices), axis=-2)
    ranges = np.concatenate((np.abs(height), far), axis=-1)
    return toward, ranges, np.concatenate((on_wall, np.ones_like(far)), axis=-1)


def _audible(
    ranges_in: Floats, off_axis_rad: Floats, heading_std_rad: Floats, around: Reflectors, model: ConeModel
) -> Floats:
    """The chance (..., k) that a return is loud enough and within the cone."""
    half = 0.5 * model.cone_rad
    share = off_axis_rad / half
    reflected = np.zeros(around.count)
    reflected[len(around.walls) :] = np.where(around.square, model.square_loss_db, model.edge_loss_db)
    loss = model.rim_loss_db * share * share + model.way_loss_db_in * ranges_in + reflected
    softness = np.maximum(heading_std_rad, LEAST_ANGLE_STD_RAD)
    within: Floats = _chance_below((half - np.abs(off_axis_rad)) / softness)
    loud = _chance_below((model.margin_db - loss) / model.margin_std_db)
    return within * loud


def _chance_below(sigmas: Floats) -> Floats:
    """The chance that a normal variable stays below so many standard deviations, by a logistic curve."""
    chance: Floats = 1.0 / (1.0 + np.exp(np.clip(-LOGISTIC_SLOPE * sigmas, -300.0, 300.0)))
    return chance


def _free(face: Floats, toward: Floats, ranges_in: Floats, walls: Floats) -> Floats:
    """1 where nothing stands between faces (n, 2) and what lies at `ranges_in` (n,) towards (n, 2), else 0."""
    if not len(face):
        return np.zeros(0)
    met, _ = cast_rays(face, toward, walls)
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
