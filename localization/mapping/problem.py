"""The least-squares problem of a map: unknowns, residuals and their derivatives.

    poses        x_k, y_k, heading_k     node k of the trajectory
    walls        angle, offset           normal n = (cos, sin)(angle), the points p with n . p = offset
    points       x, y                    corners, posts, ends of walls
    parameters   distance scale, turn scale, drift; range offset of all sonars; own offset of each sonar
    levels       b_c, by how much a wall stands out towards its normal in a cell c along it, of walls with a surface

    odometry     (pose_k+1 relative to pose_k) - step - d step / d parameters . parameters      3 per step
    range        reading - offsets - |n . s - offset - level|  or  - |point - s|                1 per echo
    bearing      direction of the reflector - axis of the cone, a weak bound of the heading     1 per echo
    tie          n . point - offset, of a corner on a wall                                      1 per tie
    right angle  angle - nearest axis of the building, an unknown that is eliminated            1 per wall
    surface      level - level of the cell before, or level alone where the surface changes     1 per level
    prior        parameters, and the first pose, which fixes the frame

Surfaces are those of `localization/filters/surface.py`: a level is drawn from N(0, std^2), stays for an exponentially
distributed length, and is then drawn anew, so that it changes within d inches with probability 1 - exp(-d / length).
Where levels change is chosen with the association of the echoes, by the most probable stretches (surfaces.py).

Ranges have outliers: their squares are replaced by the Geman-McClure function c^2 r^2 / (c^2 + r^2), solved by
iteratively reweighted least squares. An echo that no reflector explains costs c^2.

References
----------
Leonard, Durrant-Whyte, Directed Sonar Sensing for Mobile Robot Navigation (1992): walls and corners as a cone measures
them. Dellaert, Kaess, Square Root SAM (2006): mapping as least squares over the trajectory. Barron, A General and
Adaptive Robust Loss Function (2019): Geman-McClure, alpha = -2. Papoulis, Probability, Random Variables, and Stochastic
Processes (1991), section 10.1: levels that change at random.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from math import erf, hypot, log, pi, radians, sqrt
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, POSE, Floats, rotate, wrap_angle
from localization.filters.sonar_cone import ConeSonar, range_jacobian, to_vertex, to_wall
from localization.filters.sonar_ray import intersect_line
from localization.mapping.measurements import Indices, Trajectory
from localization.mapping.solver import NormalEquations
from worlds.world import SPOT_REACH_IN

NO_FEATURE: Final = -1
"""Feature of an echo that nothing explains."""
NO_LEVEL: Final = -1
"""Level of an echo that is of no wall, or of a plane."""
LEVEL_CELL_IN: Final = 2.0 * SPOT_REACH_IN
"""4 in of a wall have one level: a sixth of the mean length of a level, so that few cells have two of them."""
SAME_LEVEL_STD_IN: Final = 0.06
"""Standard deviation of a level from the one before where the surface does not change: plaster is no plane. Such random
steps are 5 mm within 1 m and 10 mm within 4 m, the flatness that DIN 18202 requires of finished walls."""
WALL, POINT = 2, 2
COMMON_OFFSET: Final = 3
"""Index of the range offset of all sonars among the parameters; own offsets follow."""
PARAMETER_STDS: Final = (0.03, 0.03, 0.002, 0.25)
"""Prior standard deviations: wheels 3 % off, 2 mrad an inch, all sonars 0.25 in, which is the mean of 16 that are 1 in
off each: walls on all sides grow and shrink with the offset of all sonars, which corners alone tell apart."""
OWN_OFFSET_STD_IN: Final = 0.7
OWN_MEAN_STD_IN: Final = 0.01
"""Own offsets are differences from that of all sonars: their mean is 0."""
ROBUST_LIMIT: Final = 2.5
"""c, in standard deviations: beyond it the influence of a residual decreases."""
WALL_BEARING_STD_RAD: Final = 0.2
"""A reflector is anywhere in a cone of 25 degrees; wider, since this is a bound and no measurement."""
HALF_CONE_RAD, POINT_BEARING_STD_RAD = radians(12.5), radians(4.0)
"""Of a point only the direction beyond the edge of the cone counts. That of a wall depends on headings alone; that of a
point on its place, so a bound within the cone would draw it towards the axes, and with it the range offset of all
sonars: walls were 0.5 in off in a corridor. A point that stays in place bounds headings as walls do."""
BEARING_COST: Final = 2.0 * log(
    sqrt(2.0 * pi) * WALL_BEARING_STD_RAD / (2.0 * HALF_CONE_RAD)
    * erf(HALF_CONE_RAD / (sqrt(2.0) * WALL_BEARING_STD_RAD))
)  # fmt: skip
"""Cost of the bearing of a wall in the middle of the cone, less that of a point: twice the logarithm of the density
there of a uniform distribution over the cone by that of a normal one that ends at its edges. Without it, a wall would
cost 0.4 an echo more than points that explain its echoes as well. The same for each half angle, as its standard
deviation is proportional to that. It counts for walls with levels alone: of planes all were found in 36 maps of rooms
without and with it, and one of four maps of flats was refused with it, for a point that was measured late."""
TIE_STD_IN: Final = 0.05
"""A corner is where its walls meet: plaster is that straight over a hand's breadth."""
RIGHT_ANGLE_STD_RAD: Final = radians(0.5)
"""Walls of buildings are at right angles to one another within this, or they are not meant to be: what is off by more
than the robust limit counts hardly. A robot that turns by a radian loses its heading by 6 degrees, and gets it back
from walls; without this the directions of rooms would be known only by what is seen through their doors."""
RIGHT_ANGLE_LIMIT_RAD: Final = ROBUST_LIMIT * RIGHT_ANGLE_STD_RAD
"""A wall that is off the axes by more is meant to be slanted."""
SQUARE_STD_RAD: Final = radians(0.1)
"""Right angles of walls with levels in the end: DIN 18202 allows builders 8 mm in 3 m, 0.15 degrees."""
AXES_STEPS: Final = 8
"""Steps of reweighting from the direction of one wall to the axes that cost least."""
_FRAME_INFORMATION: Final = 1e8
"""Weight of the first pose: fixed."""
MIN_GAIN: Final = 0.05
"""A step that lowers the cost by less changes no decision: a likelihood ratio of 1.03."""


class Reflection(NamedTuple):
    """Reflection of sound by walls.

    Attributes
    ----------
    half_cone_rad
        Half angle of a cone.
    surface_std_in, surface_length_in
        Standard deviation and correlation length of the levels of walls; a standard deviation of 0: planes.
    """

    half_cone_rad: float = HALF_CONE_RAD
    surface_std_in: float = 0.0
    surface_length_in: float = 24.0

    @classmethod
    def of(cls, sonar: ConeSonar) -> Reflection:
        """Return how walls reflect to some sonars."""
        return cls(0.5 * sonar.cone_rad, sonar.surface_std_in, sonar.surface_length_in)

    def correlation(self, distance_in: Floats) -> Floats:
        """Return the correlation of levels so far apart along a wall."""
        return np.asarray(np.exp(-distance_in / self.surface_length_in), dtype=np.float64)


PLANES: Final = Reflection()


@dataclass(frozen=True, slots=True)
class Levels:
    """The surfaces of walls, in cells of LEVEL_CELL_IN along them.

    Attributes
    ----------
    wall, cell
        (l,) wall and cell of each level, in increasing order: coordinates along the wall from cell times LEVEL_CELL_IN.
    value_in
        (l,) the levels, towards the normal of the wall.
    var_in2
        (l,) their variances, given the levels before them, for the gate of echoes.
    is_new
        (l,) True where the surface changes to another level; elsewhere it stays within SAME_LEVEL_STD_IN of the last.
    """

    wall: Indices = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    cell: Indices = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    value_in: Floats = field(default_factory=lambda: np.empty(0))
    var_in2: Floats = field(default_factory=lambda: np.empty(0))
    is_new: npt.NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=np.bool_))

    def __len__(self) -> int:
        """Return their number."""
        return len(self.wall)

    @property
    def is_first(self) -> npt.NDArray[np.bool_]:
        """True (l,) for the first level of each wall."""
        first = np.ones(len(self), dtype=np.bool_)
        first[1:] = self.wall[1:] != self.wall[:-1]
        return first

    def some(self, at: npt.NDArray[np.bool_]) -> Levels:
        """Return some of them (l,)."""
        return Levels(self.wall[at], self.cell[at], self.value_in[at], self.var_in2[at], self.is_new[at])

    def of(self, wall: int) -> slice:
        """Return the rows of a wall."""
        first, end = np.searchsorted(self.wall, (wall, wall + 1))
        return slice(int(first), int(end))

    def nearest(self, walls: Indices, feet: Floats) -> tuple[Indices, Floats]:
        """Return the rows of the cells nearest to coordinates along walls (...), and how far away those are.

        The row is NO_LEVEL for a wall that has none.
        """
        cells = np.floor(feet / LEVEL_CELL_IN).astype(np.intp)
        if not len(self):
            return np.full(cells.shape, NO_LEVEL, dtype=np.intp), np.zeros(cells.shape)
        # 1. The last cell of the wall that does not begin after it, and its neighbour.
        reach = int(np.abs(self.cell).max()) + 1
        span = 2 * reach + 1
        keys = self.wall * span + self.cell + reach
        rows = np.searchsorted(keys, walls * span + np.clip(cells, -reach, reach) + reach, side="right") - 1
        pair = np.stack((np.maximum(rows, 0), np.minimum(rows + 1, len(self) - 1)))
        # 2. The nearer one of both that is of the wall.
        low = self.cell[pair] * LEVEL_CELL_IN
        away = np.maximum(np.maximum(low - feet, feet - low - LEVEL_CELL_IN), 0.0)
        away = np.where(self.wall[pair] == walls, away, np.inf)
        nearer = away.argmin(axis=0)
        row = np.take_along_axis(pair, nearer[None], axis=0)[0]
        distance = np.take_along_axis(away, nearer[None], axis=0)[0]
        is_known = np.isfinite(distance)
        return np.where(is_known, row, NO_LEVEL), np.where(is_known, distance, 0.0)


@dataclass(frozen=True, slots=True)
class MapState:
    """All unknowns: poses (n, 3), walls (w, 2), points (v, 2), parameters (4 + sonars,), and levels of walls."""

    poses: Floats
    walls: Floats
    points: Floats
    parameters: Floats
    levels: Levels = field(default_factory=Levels)

    @property
    def features(self) -> int:
        """Number of walls and points; in arrays of both the walls come first."""
        return len(self.walls) + len(self.points)

    def surface(self, wall: int) -> Floats:
        """Return the spots (k, 2) of a wall's levels, in the middle of their cells."""
        (angle, offset), own = self.walls[wall], self.levels.of(wall)
        normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
        at = LEVEL_CELL_IN * (self.levels.cell[own] + 0.5)
        spots: Floats = (offset + self.levels.value_in[own])[:, None] * normal + at[:, None] * along
        return spots

    def moved(self, poses: Floats, border: Floats) -> MapState:
        """Return the state after a step of the poses (n, 3) and of everything else (m,), (0,) if that is fixed."""
        if not len(border):
            return replace(self, poses=self.poses + poses)
        walls, points = self.walls.size, self.points.size
        first = walls + points + len(self.parameters)
        return MapState(
            self.poses + poses,
            self.walls + border[:walls].reshape(-1, WALL),
            self.points + border[walls : walls + points].reshape(-1, POINT),
            self.parameters + border[walls + points : first],
            replace(self.levels, value_in=self.levels.value_in + border[first:]) if len(self.levels) else self.levels,
        )


@dataclass(frozen=True, slots=True)
class Assignment:
    """The feature that explains each echo.

    Attributes
    ----------
    feature
        (e,) number of the feature, NO_FEATURE for none.
    ties
        (k, 2) pairs of a point and a wall that it lies on.
    level
        (e,) row of the level at which each echo was reflected, NO_LEVEL for none; (0,) if walls are planes.
    """

    feature: Indices
    ties: Indices = field(default_factory=lambda: np.empty((0, 2), dtype=np.intp))
    level: Indices = field(default_factory=lambda: np.empty(0, dtype=np.intp))


@dataclass(frozen=True, slots=True)
class Sensors:
    """World poses of the sonars at their echoes: face (e, 2), lever arm from the node (e, 2), axis (e,), range (e,)."""

    face: Floats
    arm: Floats
    axis: Floats
    range_in: Floats


@dataclass(frozen=True, slots=True)
class RangePrediction:
    """Expected ranges (e,) of echoes from a feature each, with derivatives and the direction of the reflector.

    `by_pose` is (e, 3), `by_feature` (e, 2); the direction is `bearing` (e,) with derivatives of the same shapes.
    `foot` (e,) is the coordinate of the reflecting spot along a wall, whose direction is the normal turned left.
    """

    range_in: Floats
    by_pose: Floats
    by_feature: Floats
    bearing: Floats
    bearing_by_pose: Floats
    bearing_by_feature: Floats
    foot: Floats


@dataclass(frozen=True, slots=True)
class LinearEchoes:
    """Range and bearing of the explained echoes (e,), linearized.

    `residuals` (e, 2) are in standard deviations, `weighted` times the root of the weight (the robust one, and that of
    the reading), as the derivatives by the poses `by_pose` (e, 2, 3) of the nodes `node` (e,), and by the unknowns `at`
    (e, 4) of the border, `by_border` (e, 2, 4); (e, 5) and (e, 2, 5) where walls have levels.
    """

    echoes: Indices
    residuals: Floats
    weighted: Floats
    node: Indices
    by_pose: Floats
    by_border: Floats
    at: Indices


def sensors_at(poses: Floats, parameters: Floats, trajectory: Trajectory, echoes: Indices | slice) -> Sensors:
    """Return the sonars at some echoes, by the poses of their nodes and the calibration."""
    pose = poses[trajectory.node[echoes]]
    arm = rotate(trajectory.mounts[echoes], pose[:, HEADING])
    offsets = parameters[COMMON_OFFSET] + parameters[COMMON_OFFSET + 1 + trajectory.sonar[echoes]]
    return Sensors(
        pose[:, :2] + arm, arm, pose[:, HEADING] + trajectory.axes_rad[echoes], trajectory.readings_in[echoes] - offsets
    )


def predict_wall(sensors: Sensors, walls: Floats, rays: bool = False) -> RangePrediction:
    """Return the expected ranges to walls (e, 2), one for each echo.

    A cone measures the perpendicular distance, a ray the distance along its axis.
    """
    angle, offset = walls[..., 0], walls[..., 1]
    c, s = np.cos(angle), np.sin(angle)
    x, y = sensors.face[..., 0], sensors.face[..., 1]
    arm_x, arm_y = sensors.arm[..., 0], sensors.arm[..., 1]
    zero, one = np.zeros_like(x + angle), np.ones_like(x + angle)
    if rays:
        # 1. Along the axis, which turns with the pose: about the node, and with it the face moves.
        dx, dy = np.cos(sensors.axis), np.sin(sensors.axis)
        distance, (by_x, by_y, by_turn), cosine = intersect_line(x, y, dx, dy, (c, s, offset))
        by_pose = (by_x, by_y, by_turn - by_x * arm_y + by_y * arm_x)
        by_feature = (((s * x - c * y) - distance * (c * dy - s * dx)) / cosine, 1.0 / cosine)
        foot = c * (y + distance * dy) - s * (x + distance * dx)
        return RangePrediction(
            distance, np.stack(np.broadcast_arrays(*by_pose), -1), np.stack(np.broadcast_arrays(*by_feature), -1),
            sensors.axis + zero, np.stack((zero, zero, one), -1), np.stack((zero, zero), -1), foot,
        )  # fmt: skip
    # 2. Perpendicular: the side of the wall decides the sign.
    distance, toward_x, toward_y, foot = to_wall(x, y, offset * c, offset * s, c, s)
    side = np.where(toward_x * c + toward_y * s > 0.0, 1.0, -1.0)
    by_pose = range_jacobian(toward_x, toward_y, arm_x, arm_y)
    by_feature = (side * (s * x - c * y), side)
    return RangePrediction(
        distance, np.stack(np.broadcast_arrays(*by_pose), -1), np.stack(np.broadcast_arrays(*by_feature), -1),
        angle + np.where(side > 0.0, 0.0, np.pi), np.stack((zero, zero, zero), -1), np.stack((one, zero), -1), -foot,
    )  # fmt: skip


def predict_point(sensors: Sensors, points: Floats) -> RangePrediction:
    """Return the expected ranges to points (e, 2), one for each echo."""
    x, y = sensors.face[..., 0], sensors.face[..., 1]
    distance, toward_x, toward_y = to_vertex(x, y, points[..., 0], points[..., 1])
    arm_x, arm_y = sensors.arm[..., 0], sensors.arm[..., 1]
    divisor = np.maximum(distance, 1.0)
    by_point = np.stack((-toward_y / divisor, toward_x / divisor), axis=-1)
    turn = -(by_point[..., 1] * arm_x - by_point[..., 0] * arm_y)
    return RangePrediction(
        distance, np.stack(range_jacobian(toward_x, toward_y, arm_x, arm_y), -1), np.stack((toward_x, toward_y), -1),
        np.arctan2(toward_y, toward_x), np.concatenate((-by_point, turn[..., None]), -1), by_point,
        np.zeros_like(distance),
    )  # fmt: skip


def robust_cost(residual: Floats, limit: float = ROBUST_LIMIT) -> Floats:
    """Return the Geman-McClure cost c^2 r^2 / (c^2 + r^2) of residuals in standard deviations."""
    square = residual * residual
    cost: Floats = limit * limit * square / (limit * limit + square)
    return cost


def robust_weight(residual: Floats, limit: float = ROBUST_LIMIT) -> Floats:
    """Return the weight of a residual's square in reweighted least squares: half the cost's derivative over r."""
    weight: Floats = np.square(limit * limit / (limit * limit + residual * residual))
    return weight


class MapProblem:
    """Residuals and normal equations of a drive.

    Parameters
    ----------
    trajectory
        The measurements.
    sonars
        Number of sonars.
    rays
        True if readings are ranges along the axis of a sonar, not of a cone.
    robust
        False for plain least squares.
    has_fixed_map
        True if only the poses are unknown: localization in a map that stays as it is.
    parameter_stds
        (4,) prior standard deviations of the parameters without the own offsets of the sonars.
    reflection
        How walls reflect.
    right_angle_std_rad
        Standard deviation of right angles.
    """

    def __init__(
        self, trajectory: Trajectory, sonars: int, *, rays: bool = False, robust: bool = True,
        has_fixed_map: bool = False, parameter_stds: tuple[float, ...] = PARAMETER_STDS,
        reflection: Reflection = PLANES, right_angle_std_rad: float = RIGHT_ANGLE_STD_RAD,
    ) -> None:  # fmt: skip
        self.trajectory, self.rays, self.robust, self.has_fixed_map = trajectory, rays, robust, has_fixed_map
        self.reflection, self.right_angle_std_rad = reflection, right_angle_std_rad
        self._wall_bearing_std_rad = WALL_BEARING_STD_RAD * (reflection.half_cone_rad / HALF_CONE_RAD)
        self._stds, self._parameters = parameter_stds, len(parameter_stds) + sonars
        own = np.r_[np.zeros(len(parameter_stds)), np.full(sonars, 1.0 / (sonars * OWN_MEAN_STD_IN))]
        self.prior: Floats = np.vstack((np.diag(1.0 / np.r_[parameter_stds, np.full(sonars, OWN_OFFSET_STD_IN)]), own))
        """Prior of the parameters c as rows P of residuals P c: each one, and the mean of the own offsets."""
        self._prior_information: Floats = self.prior.T @ self.prior

    @property
    def plain(self) -> MapProblem:
        """The same problem by plain least squares, without robust weights."""
        found = copy(self)
        found.robust = False
        return found

    def with_trajectory(self, trajectory: Trajectory, *, has_fixed_map: bool = False) -> MapProblem:
        """Return the same problem with other measurements."""
        found = copy(self)
        found.trajectory, found.has_fixed_map = trajectory, has_fixed_map
        return found

    def with_right_angles(self, std_rad: float) -> MapProblem:
        """Return the same problem with another standard deviation of right angles."""
        found = copy(self)
        found.right_angle_std_rad = std_rad
        return found

    def initial(self) -> MapState:
        """Return the first pose at the origin, nothing else, and an ideal robot."""
        return MapState(np.zeros((1, POSE)), np.empty((0, WALL)), np.empty((0, POINT)), np.zeros(self._parameters))

    # Residuals, in standard deviations, with their derivatives.

    def odometry(self, state: MapState) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the residuals (n-1, 3) and their derivatives by both poses and the odometry parameters."""
        count = len(state.poses) - 1
        before, after = state.poses[:-1], state.poses[1:]
        by_parameters = self.trajectory.step_by_parameters[:count]
        W = self.trajectory.step_info[:count]
        # 1. The relative pose, in the frame of the first.
        change = after[:, :2] - before[:, :2]
        local = rotate(change, -before[:, HEADING])
        step = self.trajectory.steps[:count] + by_parameters @ state.parameters[:COMMON_OFFSET]
        turn = wrap_angle(after[:, HEADING] - before[:, HEADING] - step[:, HEADING])
        residual = np.concatenate((local - step[:, :2], turn[:, None]), axis=-1)
        # 2. Derivatives.
        c, s = np.cos(before[:, HEADING]), np.sin(before[:, HEADING])
        by_after = np.zeros((count, POSE, POSE))
        by_after[:, 0, 0], by_after[:, 0, 1], by_after[:, 1, 0], by_after[:, 1, 1] = c, s, -s, c
        by_after[:, HEADING, HEADING] = 1.0
        by_before = -by_after
        by_before[:, 0, HEADING], by_before[:, 1, HEADING] = local[:, 1], -local[:, 0]
        return (W @ residual[..., None])[..., 0], W @ by_before, W @ by_after, -(W @ by_parameters)

    def predict(self, state: MapState, assignment: Assignment, echoes: Indices) -> tuple[Sensors, RangePrediction]:
        """Return the sonars at some explained echoes, and the predictions by their features."""
        sensors = sensors_at(state.poses, state.parameters, self.trajectory, echoes)
        number, walls = assignment.feature[echoes], len(state.walls)
        both = np.concatenate((state.walls, state.points))[number]
        if len(state.levels) and len(assignment.level):
            # A wall that stands out is one at another offset.
            level = assignment.level[echoes]
            both[:, 1] += np.where(level != NO_LEVEL, state.levels.value_in[level], 0.0)
        wall, point = predict_wall(sensors, both, self.rays), predict_point(sensors, both)
        is_wall = number < walls
        chosen = [
            np.where(is_wall if w.ndim == 1 else is_wall[:, None], w, p)
            for w, p in ((getattr(wall, name), getattr(point, name)) for name in RangePrediction.__slots__)
        ]
        return sensors, RangePrediction(*chosen)

    def range_residuals(self, state: MapState, assignment: Assignment) -> tuple[Indices, Floats, RangePrediction]:
        """Return the explained echoes, residuals (e, 2) of range and bearing, and the predictions."""
        inside = self.trajectory.node < len(state.poses)
        echoes = np.flatnonzero((assignment.feature != NO_FEATURE) & inside)
        sensors, prediction = self.predict(state, assignment, echoes)
        ranges = (sensors.range_in - prediction.range_in) / self.trajectory.std_in[echoes]
        off_axis = wrap_angle(prediction.bearing - sensors.axis)
        half_cone_rad = self.reflection.half_cone_rad
        beyond = off_axis - np.clip(off_axis, -half_cone_rad, half_cone_rad)
        is_whole = self._has_whole_bearing(state, assignment, echoes)
        bearings = np.where(is_whole, off_axis / self._wall_bearing_std_rad, beyond / POINT_BEARING_STD_RAD)
        return echoes, np.stack((ranges, bearings), axis=-1), prediction

    @property
    def _counts_cone(self) -> bool:
        """True if BEARING_COST counts: of cones, of a map in the making whose walls have levels."""
        return bool(self.reflection.surface_std_in) and not (self.rays or self.has_fixed_map)

    def _has_whole_bearing(self, state: MapState, assignment: Assignment, echoes: Indices) -> npt.NDArray[np.bool_]:
        """Return True for echoes whose bearing counts within the cone too: of walls, and of all that stays in place."""
        return np.asarray((assignment.feature[echoes] < len(state.walls)) | self.has_fixed_map, dtype=np.bool_)

    def tie_residuals(self, state: MapState, assignment: Assignment) -> Floats:
        """Return the residuals (k,) of points that lie on walls."""
        points, walls = state.points[assignment.ties[:, 0]], state.walls[assignment.ties[:, 1]]
        residual: Floats = (
            points[:, 0] * np.cos(walls[:, 0]) + points[:, 1] * np.sin(walls[:, 0]) - walls[:, 1]
        ) / self._tie_stds(state, assignment)
        return residual

    def _tie_stds(self, state: MapState, assignment: Assignment) -> Floats:
        """Return the standard deviations (k,) of ties: a corner is anywhere on a surface with levels."""
        has_levels = np.isin(assignment.ties[:, 1], state.levels.wall)
        stds: Floats = np.where(has_levels, hypot(TIE_STD_IN, self.reflection.surface_std_in), TIE_STD_IN)
        return stds

    def level_residuals(self, levels: Levels) -> tuple[Floats, Floats, Floats]:
        """Return the residuals (l,) of the surface, and their derivatives by each level and by the one before."""
        is_same = self.level_stays(levels)
        scale = np.where(is_same, 1.0 / SAME_LEVEL_STD_IN, 1.0 / self.reflection.surface_std_in)
        residual = scale * (levels.value_in - is_same * np.concatenate(([0.0], levels.value_in[:-1])))
        return residual, scale, np.where(is_same, -scale, 0.0)

    def level_stays(self, levels: Levels) -> npt.NDArray[np.bool_]:
        """Return True (l,) for levels that are those before them."""
        return np.asarray(~levels.is_first & ~levels.is_new, dtype=np.bool_)

    def level_penalties(self, levels: Levels, assignment: Assignment) -> Floats:
        """Return the cost (l,) of the choice of each level.

        Twice the negative logarithm of the probability that the surface changes there, or does not; and twice the
        logarithm of how much the echoes of the level narrow it. With n echoes of variance R and the variance v that it
        has by the cells before, that is ln(1 + n v / R). Without it a wall with many levels would explain any echoes
        near it.

        References
        ----------
        MacKay, Information Theory, Inference, and Learning Algorithms (2003), section 28.1: the Occam factor.
        """
        if not len(levels):
            return np.zeros(0)
        stays = self.reflection.correlation(LEVEL_CELL_IN * np.diff(levels.cell, prepend=0))
        chosen = np.where(levels.is_first, 1.0, np.where(levels.is_new, 1.0 - stays, stays))
        before, _ = self._level_chain(levels, assignment)
        return np.log1p(self.level_information(levels, assignment) * before) - 2.0 * np.log(chosen)

    def _level_chain(self, levels: Levels, assignment: Assignment) -> tuple[Floats, Floats]:
        """Return the variances (l,) of each level given the echoes of the cells before it, and given all of its chain.

        References
        ----------
        Rauch, Tung, Striebel, Maximum Likelihood Estimates of Linear Dynamic Systems (1965): the filter of a random
        walk, and its smoother.
        """
        stays, information = self.level_stays(levels).tolist(), self.level_information(levels, assignment).tolist()
        new_var, step_var = self.reflection.surface_std_in**2, SAME_LEVEL_STD_IN**2
        before, after = list[float](), list[float]()
        for is_same, w in zip(stays, information, strict=True):
            before.append(after[-1] + step_var if is_same else new_var)
            after.append(before[-1] / (1.0 + w * before[-1]))
        smooth = after.copy()
        for row in reversed(range(len(smooth) - 1)):
            if stays[row + 1]:
                gain = after[row] / before[row + 1]
                smooth[row] += gain**2 * (smooth[row + 1] - before[row + 1])
        return np.array(before), np.array(smooth)

    def level_variances(self, levels: Levels, assignment: Assignment) -> Floats:
        """Return the variances (l,) of the levels by all echoes of their stretches, as far as these may have changed.

        A cell without echoes is of the level beside it unless the surface has changed since; between two cells of one
        level it has changed twice then.
        """
        rows, begins = np.arange(len(levels)), ~self.level_stays(levels)
        stretch, information = np.cumsum(begins) - 1, self.level_information(levels, assignment)
        first = np.flatnonzero(begins)
        last = np.append(first[1:], len(levels))[stretch] - 1
        # 1. The nearest cells with echoes of the same stretch, before and after.
        has_echoes = information > 0.0
        before = np.maximum.accumulate(np.where(has_echoes, rows, -1))
        after = np.minimum.accumulate(np.where(has_echoes, rows, len(levels))[::-1])[::-1]
        changes = np.ones(len(levels))
        for away, is_of_it in ((rows - before, before >= first[stretch]), (after - rows, after <= last)):
            changes *= np.where(is_of_it, 1.0 - self.reflection.correlation(np.asarray(LEVEL_CELL_IN * away)), 1.0)
        # 2. A level that is drawn anew has the variance of all.
        _, smooth = self._level_chain(levels, assignment)
        variances: Floats = (1.0 - changes) * smooth + changes * self.reflection.surface_std_in**2
        return variances

    def level_information(self, levels: Levels, assignment: Assignment) -> Floats:
        """Return the sum (l,) of the inverse variances of the echoes of each level."""
        information: Floats = np.zeros(len(levels))
        if len(assignment.level):
            has_level = assignment.level != NO_LEVEL
            weight = self.trajectory.weight[has_level] / np.square(self.trajectory.std_in[has_level])
            np.add.at(information, assignment.level[has_level], weight)
        return information

    def angle_residuals(self, state: MapState, assignment: Assignment) -> tuple[Floats, Floats]:
        """Return the residuals (w,) of walls from the building's axes, and derivatives (w, w); none if plain.

        The directions of the axes are unknown: those that the walls cost least by, beginning at the wall with the most
        echoes. A cost that is minimized over an unknown has the derivative by the others as if that one were fixed.
        Its normal equations, with the unknown eliminated, have the information W - w w' / sum(w) instead of W.
        """
        angles = state.walls[:, 0]
        if len(angles) < 2 or self.has_fixed_map or not self.robust:
            return np.zeros(0), np.zeros((0, 0))
        explained = assignment.feature[(assignment.feature != NO_FEATURE) & (assignment.feature < len(angles))]
        axis = float(angles[np.bincount(explained, minlength=len(angles)).argmax()])
        quarter = 0.5 * np.pi
        for _ in range(AXES_STEPS):
            off = (angles - axis + 0.5 * quarter) % quarter - 0.5 * quarter
            weight = robust_weight(off / self.right_angle_std_rad)
            axis += float(weight @ off / weight.sum())
        off = (angles - axis + 0.5 * quarter) % quarter - 0.5 * quarter
        centred = np.eye(len(angles)) - weight / weight.sum()
        return off / self.right_angle_std_rad, centred / self.right_angle_std_rad

    def cost(self, state: MapState, assignment: Assignment) -> float:
        """Return twice the negative log-likelihood of all, up to a constant."""
        echoes, residuals, _ = self.range_residuals(state, assignment)
        is_wall = assignment.feature[echoes] < len(state.walls)
        ranges = robust_cost(residuals[:, 0]) if self.robust else np.square(residuals[:, 0])
        ranges *= self.trajectory.weight[echoes]
        unexplained = int((self.trajectory.node < len(state.poses)).sum()) - len(residuals)
        return float(
            np.square(self.odometry(state)[0]).sum()
            + ranges.sum()
            + np.square(residuals[:, 1]).sum()
            + (BEARING_COST * is_wall.sum() if self._counts_cone else 0.0)
            + ROBUST_LIMIT**2 * unexplained
            + np.square(self.tie_residuals(state, assignment)).sum()
            + robust_cost(self.angle_residuals(state, assignment)[0]).sum()
            + np.square(self.prior @ state.parameters).sum()
            + (np.square(self.level_residuals(state.levels)[0]).sum() if len(state.levels) else 0.0)
        )

    def residual_vector(self, state: MapState, assignment: Assignment) -> Floats:
        """Return all residuals in one vector (r,), without the robust weights and the first pose's prior."""
        parts = (
            self.odometry(state)[0],
            self.range_residuals(state, assignment)[1],
            self.tie_residuals(state, assignment),
            self.angle_residuals(state, assignment)[0],
            self.prior @ state.parameters,
            *((self.level_residuals(state.levels)[0],) if len(state.levels) else ()),
        )
        return np.concatenate([part.reshape(-1) for part in parts])

    # The normal equations.

    def normal_equations(self, state: MapState, assignment: Assignment) -> NormalEquations:
        """Return J' W J and -J' W r at a state."""
        count, walls, points = len(state.poses), state.walls.size, state.points.size
        first = walls + points
        parameters = slice(first, first + len(state.parameters))
        size = parameters.stop + len(state.levels)
        T, U = np.zeros((count, POSE, POSE)), np.zeros((count - 1, POSE, POSE))
        C, D = np.zeros((count, POSE, size)), np.zeros((size, size))
        g, h = np.zeros((count, POSE)), np.zeros(size)
        # 1. Odometry: neighbours, and its parameters.
        r, before, after, by_parameters = self.odometry(state)
        before_t, after_t, by_parameters_t = (J.swapaxes(-1, -2) for J in (before, after, by_parameters))
        odometry = slice(first, first + COMMON_OFFSET)
        T[:-1] += before_t @ before
        T[1:] += after_t @ after
        U += before_t @ after
        C[:-1, :, odometry] += before_t @ by_parameters
        C[1:, :, odometry] += after_t @ by_parameters
        D[odometry, odometry] += (by_parameters_t @ by_parameters).sum(axis=0)
        g[:-1] -= (before_t @ r[..., None])[..., 0]
        g[1:] -= (after_t @ r[..., None])[..., 0]
        h[odometry] -= (by_parameters_t @ r[..., None])[..., 0].sum(axis=0)
        # 2. Echoes: a pose, a feature, the offset of all sonars and that of one.
        self._add_echoes(state, assignment, NormalEquations(T, U, C, D, g, h))
        # 3. Ties, of a point and a wall.
        residuals, stds = self.tie_residuals(state, assignment), self._tie_stds(state, assignment)
        for (point, wall), residual, std in zip(assignment.ties, residuals, stds, strict=True):
            (x, y), (angle, _) = state.points[point], state.walls[wall]
            c, s = np.cos(angle), np.sin(angle)
            at = [WALL * wall, WALL * wall + 1, walls + POINT * point, walls + POINT * point + 1]
            J = np.array((y * c - x * s, -1.0, c, s)) / std
            D[np.ix_(at, at)] += np.outer(J, J)
            h[at] -= J * residual
        # 4. Right angles.
        r, J = self.angle_residuals(state, assignment)
        weight = robust_weight(r)
        angles = slice(0, WALL * len(r), WALL)
        D[angles, angles] += J.T @ (weight[:, None] * J)
        h[angles] -= J.T @ (weight * r)
        # 5. Priors. Features without echoes would make the border singular.
        D[parameters, parameters] += self._prior_information
        h[parameters] -= self._prior_information @ state.parameters
        if len(state.levels):
            self._add_levels(state, NormalEquations(T, U, C, D, g, h))
        D[range(first), range(first)] += 1e-9
        T[0] += _FRAME_INFORMATION * np.eye(POSE)
        if self.has_fixed_map:
            return NormalEquations(T, U, C[..., :0], D[:0, :0], g, h[:0])
        return NormalEquations(T, U, C, D, g, h)

    def linearize_echoes(self, state: MapState, assignment: Assignment) -> LinearEchoes:
        """Return weighted residuals and Jacobians of range and bearing of all explained echoes."""
        echoes, residuals, prediction = self.range_residuals(state, assignment)
        # 1. Jacobians in standard deviations, times the root of the robust weight.
        std = self.trajectory.std_in[echoes]
        scale = np.sqrt(self.trajectory.weight[echoes])
        if self.robust:
            scale *= np.sqrt(robust_weight(residuals[:, 0]))
        weighted = residuals * np.stack((scale, np.ones_like(scale)), axis=-1)
        by_range = scale / std
        by_bearing = np.where(residuals[:, 1] == 0.0, 0.0, 1.0 / POINT_BEARING_STD_RAD)
        is_whole = self._has_whole_bearing(state, assignment, echoes)
        by_bearing = np.where(is_whole, 1.0 / self._wall_bearing_std_rad, by_bearing)
        by_pose = np.stack(
            (-prediction.by_pose * by_range[:, None], prediction.bearing_by_pose * by_bearing[:, None]), axis=1
        )
        by_pose[:, 1, HEADING] -= by_bearing
        by_feature = np.stack(
            (-prediction.by_feature * by_range[:, None], prediction.bearing_by_feature * by_bearing[:, None]), axis=1
        )
        # 2. The derivative by everything in the border: the feature, and both offsets; rows of (e, 2, 4).
        offsets = np.zeros((len(echoes), 2, 2))
        offsets[:, 0] = -by_range[:, None]
        first = state.walls.size + state.points.size + COMMON_OFFSET
        column = WALL * assignment.feature[echoes]
        own = first + 1 + self.trajectory.sonar[echoes]
        at = np.stack((column, column + 1, np.full(len(echoes), first), own), axis=-1)
        by_border = np.concatenate((by_feature, offsets), axis=-1)
        if len(state.levels) and len(assignment.level):
            # 3. The level, which is added to the offset of the wall.
            level = assignment.level[echoes]
            by_level = np.where((level != NO_LEVEL)[:, None], by_feature[:, :, 1], 0.0)
            by_border = np.concatenate((by_border, by_level[..., None]), axis=-1)
            last = state.walls.size + state.points.size + len(state.parameters)
            at = np.concatenate((at, (last + np.maximum(level, 0))[:, None]), axis=-1)
        return LinearEchoes(echoes, residuals, weighted, self.trajectory.node[echoes], by_pose, by_border, at)

    def _add_levels(self, state: MapState, N: NormalEquations) -> None:
        """Add the prior of the levels, in place: the end of the border."""
        residual, by_own, by_before = self.level_residuals(state.levels)
        own = np.arange(len(N.border) - len(residual), len(N.border))
        before = own[:-1]
        N.border[own, own] += by_own**2
        N.border[before, before] += by_before[1:] ** 2
        N.border[own[1:], before] += (by_own * by_before)[1:]
        N.border[before, own[1:]] += (by_own * by_before)[1:]
        N.border_gradient[own] -= by_own * residual
        N.border_gradient[before] -= (by_before * residual)[1:]

    def _add_echoes(self, state: MapState, assignment: Assignment, N: NormalEquations) -> None:
        """Add range and bearing of all explained echoes, in place."""
        linear = self.linearize_echoes(state, assignment)
        if not len(linear.echoes):
            return
        # Sums over the echoes of each block, by the places of its numbers in the flat arrays.
        at, residuals, size = linear.at, linear.weighted[..., None], len(N.border)
        pose_t, border_t = linear.by_pose.swapaxes(-1, -2), linear.by_border.swapaxes(-1, -2)
        pose = POSE * linear.node[:, None] + np.arange(POSE)
        _add_at(N.diagonal, POSE * pose[..., None] + np.arange(POSE), pose_t @ linear.by_pose)
        _add_at(N.pose_gradient, pose, -(pose_t @ residuals))
        _add_at(N.coupling, size * pose[..., None] + at[:, None, :], pose_t @ linear.by_border)
        _add_at(N.border, size * at[:, :, None] + at[:, None, :], border_t @ linear.by_border)
        _add_at(N.border_gradient, at, -(border_t @ residuals))

    def optimize(
        self, state: MapState, assignment: Assignment, iterations: int = 4, min_gain: float = MIN_GAIN
    ) -> MapState:
        """Return the state after at most so many steps of Levenberg-Marquardt with reweighting.

        A step that lowers the cost by less than `min_gain` is the last.

        References
        ----------
        Nocedal, Wright, Numerical Optimization (2006), section 10.3.
        """
        cost, damping = self.cost(state, assignment), 0.0
        for _ in range(iterations):
            equations = self.normal_equations(state, assignment)
            for _ in range(6):
                step = equations.solve(damping)
                found = state.moved(*step)
                new_cost = self.cost(found, assignment)
                if new_cost <= cost + 1e-9:
                    break
                damping = max(10.0 * damping, 1e-3)
            else:
                return state
            gain, state, cost, damping = cost - new_cost, found, new_cost, 0.1 * damping if damping > 1e-6 else 0.0
            if gain < min_gain:
                break
        return normalized(state)


def _add_at(total: Floats, at: Indices, values: Floats) -> None:
    """Add values to the numbers at some places of an array, in place; numpy does so several times faster in one row."""
    np.add.at(total.reshape(-1), at.reshape(-1), values.reshape(-1))


def normalized(state: MapState) -> MapState:
    """Return the state with headings and angles of walls within half a turn."""
    poses, walls = state.poses.copy(), state.walls.copy()
    poses[:, HEADING], walls[:, 0] = wrap_angle(poses[:, HEADING]), wrap_angle(walls[:, 0])
    return replace(state, poses=poses, walls=walls)
