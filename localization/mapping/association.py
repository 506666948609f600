"""Data association: the reflector that explains each echo of a map in the making.

An echo belongs to the reflector whose expected range is nearest, if that is within the gate, the reflector is in the
cone, the reflecting spot lies on or near the part of the wall seen so far, and no other wall is in between. In the
finished map, what is behind a wall that must have returned the first echo is the less probable.

References
----------
Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 1.5 (nearest
neighbour, gating). Neira, Tardos, Data Association in Stochastic Mapping (2001).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import is_
from typing import Final

import numpy as np

from localization.filters.belief import Floats, compose, wrap_angle
from localization.mapping.measurements import Indices
from localization.mapping.problem import (
    COMMON_OFFSET,
    LEVEL_CELL_IN,
    NO_FEATURE,
    NO_LEVEL,
    ROBUST_LIMIT,
    Assignment,
    Levels,
    MapProblem,
    MapState,
    Sensors,
    predict_wall,
    robust_cost,
    sensors_at,
)
from localization.mapping.reflectors import (
    BLOCKED_IN,
    END_ASIDE_IN,
    END_IN,
    MAX_GAP_IN,
    MIN_CROSSING_RAD,
    Mask,
    along_and_across,
    ends_of_parts,
    growth_of,
    is_blocked,
    parts_of,
    residual_matrix,
    sides_of,
    surface_segments,
    wall_geometry,
)
from localization.mapping.surfaces import divided, gate_variances

FIRST_CONE, FIRST_SIGMAS = 0.75, 2.0
"""A wall whose foot is within this fraction of the half cone returns an echo, before all that is behind it: what is
farther off explains an echo only if it is nearer to its range by so many standard deviations."""
SAME_RANGE_IN: Final = 1e-6
"""Of one and the same spot, computed twice."""
SURFACE_SIGMAS: Final = 2.0
"""Standard deviations of a surface by which a wall may be beside its line: so much farther before its end."""
MAX_STRAYS, MIN_INNER_FEET = 2, 4
"""So few feet beyond a post at the end of a wall with levels are of something else, if so many are left."""
MIN_RUN_SPOTS: Final = 3
"""Spots without such a gap that make a part of a wall which blocks paths."""
SIDED_ECHOES, SIDED = 4, 0.8
"""A wall that so many echoes have measured from one side, that is with a mean sign of their sonars' distances from it
at least so far from 0, is a face: nothing is assigned to it from its back, where the other face of a thick wall is. One
with levels is none if so many echoes of it or of its posts are from its back (`MapEstimate._is_thin`)."""
ALONE_SIGMAS: Final = 1.5
"""An echo of a wall that is nearer to the range of a point may be of the point."""
MIN_DOOR_IN, MAX_DOOR_IN = 20.0, 60.0
"""Width of a door: the robot is 19 in wide."""
MIN_STRIP_IN: Final = 8.0
"""Width of the strip between what may be echoes of its posts in which a wall would have spots, and a door has none."""
MIN_THICKNESS_IN, MAX_THICKNESS_IN = 2.0, 12.0
"""Of a wall with two faces."""
OPPOSITE_IN: Final = 3.0
"""Both edges of the end of a wall differ by less along the wall."""
CORNER_IN, INNER_IN = 3.0, 12.0
"""A point so near to two walls is their corner; an inner one if one goes on so far in front of the other."""
PENALTY: Final = {"wall": 40.0, "point": 25.0}
"""Cost that a feature must save to be worth its unknowns: 4 or 6 echoes that nothing else explains."""


@dataclass
class MapEstimate:
    """A map in the making: the problem, its state and assignment, and the part of each wall seen so far.

    `extents` (w, 2) are the coordinates along the wall, whose direction is the normal turned left. `runs` (r, 3) are
    the parts of it without wide gaps, rows of wall, first and last coordinate: they alone block paths, since of a wrong
    line across a room only some spots are measured, and what is seen behind it would otherwise never be explained.
    `sides` (w,) are 1 or -1 for walls measured only from where their normal points or from the other side, else 0.
    """

    problem: MapProblem
    state: MapState
    assignment: Assignment
    extents: Floats = field(default_factory=lambda: np.empty((0, 2)))
    runs: Floats = field(default_factory=lambda: np.empty((0, 3)))
    sides: Floats = field(default_factory=lambda: np.empty(0))
    expects_first_echoes: bool = False
    """True for a finished map, whose walls must return the first echo (`_are_behind`). While a map grows, a wrong wall
    would take echoes of others."""
    _level_inputs: tuple[object, ...] = field(default=(), repr=False, compare=False)
    """Problem, state, and features and levels of the echoes, as they were after the last `measure_levels`."""

    @classmethod
    def start(cls, problem: MapProblem) -> MapEstimate:
        """Return an estimate of the first pose alone."""
        nothing = np.full(len(problem.trajectory.node), NO_FEATURE, dtype=np.intp)
        return cls(problem, problem.initial(), Assignment(nothing))

    def replace_by(self, other: MapEstimate) -> None:
        """Take over another estimate of the same problem."""
        self.state, self.assignment = other.state, other.assignment
        self.extents, self.runs, self.sides = other.extents, other.runs, other.sides
        self._level_inputs = other._level_inputs

    def copy(self) -> MapEstimate:
        """Return an estimate that changes independently; arrays are replaced, never changed in place."""
        return replace(self)

    @property
    def cost(self) -> float:
        """Cost of all residuals, and of all features by PENALTY."""
        state = self.state
        penalty = PENALTY["wall"] * len(state.walls) + PENALTY["point"] * len(state.points)
        return self.problem.cost(state, self.assignment) + penalty + float(self._level_penalties.sum())

    @property
    def _level_penalties(self) -> Floats:
        """Cost (l,) of the choice of each level: how much its echoes narrow its prior."""
        return self.problem.level_penalties(self.state.levels, self.assignment)

    @property
    def surface_costs(self) -> Floats:
        """Cost (w,) of the levels of each wall, which is saved without the wall."""
        levels = self.state.levels
        if not len(levels):
            return np.zeros(len(self.state.walls))
        costs = np.square(self.problem.level_residuals(levels)[0]) + self._level_penalties
        totals: Floats = np.zeros(len(self.state.walls))
        np.add.at(totals, levels.wall, costs)
        return totals

    @property
    def misfit(self) -> float:
        """Cost of all ranges by their number, without the odometry, the bounds of the cone and the penalties."""
        _, residuals, _ = self.problem.range_residuals(self.state, self.assignment)
        count = int((self.problem.trajectory.node < len(self.state.poses)).sum())
        cost = float(robust_cost(residuals[:, 0]).sum()) + ROBUST_LIMIT**2 * (count - len(residuals))
        return cost / max(count, 1)

    def extend(self, count: int) -> None:
        """Add nodes up to a number of them, by the odometry."""
        trajectory, poses = self.problem.trajectory, [*self.state.poses]
        steps = trajectory.steps + trajectory.step_by_parameters @ self.state.parameters[:COMMON_OFFSET]
        for step in steps[len(poses) - 1 : count - 1]:
            poses.append(compose(poses[-1], step))
        self.state = replace(self.state, poses=np.array(poses))

    def optimize(self, iterations: int = 4, *, robust: bool = True) -> None:
        """Optimize everything for the present assignment."""
        self.measure_levels()
        problem = self.problem if robust else self.problem.plain
        self.state = problem.optimize(self.state, self.assignment, iterations)

    def associate(self, first_node: int = 0) -> None:
        """Assign all echoes from a node on."""
        echoes = self.echoes(first_node)
        feature = self.assignment.feature.copy()
        feature[echoes], _ = assign(self, echoes)
        self.assignment = replace(self.assignment, feature=feature)
        self.measure_extents()
        self.measure_levels()

    def measure_levels(self) -> None:
        """Give each wall the levels of the part that its echoes show, and each of these echoes its level.

        A wall with cells that are new has the levels of its most probable stretches (surfaces.py).
        """
        reflection = self.problem.reflection
        if not reflection.surface_std_in or self._are_measured:
            return
        feature, levels = self.assignment.feature, self.state.levels
        echoes = np.flatnonzero((feature != NO_FEATURE) & (feature < len(self.state.walls)))
        walls = feature[echoes]
        feet = self._feet(echoes)
        # 1. All cells from the first to the last echo of each wall.
        if not self.problem.has_fixed_map:
            cells = np.floor(feet / LEVEL_CELL_IN).astype(np.intp)
            parts = [
                (wall, np.arange(own.min(), own.max() + 1))
                for wall in np.unique(walls).tolist() for own in (cells[walls == wall],)
            ]  # fmt: skip
            wall = np.concatenate([np.full(len(part), number) for number, part in parts] or [levels.wall[:0]])
            cell = np.concatenate([part for _, part in parts] or [levels.cell[:0]])
            row, away_in = levels.nearest(wall, (cell + 0.5) * LEVEL_CELL_IN)
            away_in = np.where(away_in > 0.0, away_in + 0.5 * LEVEL_CELL_IN, 0.0)
            values = np.append(levels.value_in, 0.0)[row] * reflection.correlation(away_in)
            had_level = (row != NO_LEVEL) & (away_in == 0.0)
            was_new = np.append(levels.is_new, False)[row] & had_level
            levels = Levels(wall, cell, values, np.zeros(len(wall)), was_new)
            levels = replace(levels, is_new=was_new & ~levels.is_first)
        # 2. The level of each echo.
        level = np.full(len(feature), NO_LEVEL, dtype=np.intp)
        level[echoes], _ = levels.nearest(walls, feet)
        self.assignment = replace(self.assignment, level=level)
        # 3. Where the surface changes, and how well each level is known.
        if not self.problem.has_fixed_map:
            levels = divided(self.problem, replace(self.state, levels=levels), self.assignment, had_level)
            variances = gate_variances(self.problem, levels, self.assignment)
            self.state = replace(self.state, levels=replace(levels, var_in2=variances))
        self._level_inputs = self._present_inputs

    @property
    def _present_inputs(self) -> tuple[object, ...]:
        """All that levels depend on. Arrays are replaced, never changed in place."""
        return self.problem, self.state, self.assignment.feature, self.assignment.level

    @property
    def _are_measured(self) -> bool:
        """True if nothing that levels depend on has changed since they were measured."""
        return bool(self._level_inputs) and all(map(is_, self._level_inputs, self._present_inputs))

    def _feet(self, echoes: Indices) -> Floats:
        """Return the coordinates (e,) along the walls that explain echoes at which these were reflected."""
        sensors = sensors_at(self.state.poses, self.state.parameters, self.problem.trajectory, echoes)
        walls = self.state.walls[self.assignment.feature[echoes]]
        return predict_wall(sensors, walls, self.problem.rays).foot

    def echoes(self, first_node: int = 0) -> Indices:
        """Return the echoes of the nodes from one on."""
        node = self.problem.trajectory.node
        return np.flatnonzero((node >= first_node) & (node < len(self.state.poses)))

    def echoes_of(self, feature: int) -> Indices:
        """Return the echoes that a feature explains."""
        return np.flatnonzero(self.assignment.feature == feature)

    def _feet_and_sides(self, wall: int, echoes: Indices) -> tuple[Floats, Floats, Mask]:
        """Return where along a wall echoes within ROBUST_LIMIT were reflected, from which side, and if by it alone.

        Others may be echoes of points on its line.
        """
        sensors = sensors_at(self.state.poses, self.state.parameters, self.problem.trajectory, echoes)
        lines, std_in = self.state.walls[wall : wall + 1], self.problem.trajectory.std_in[echoes]
        of_wall = wall_geometry(self.problem, self.state, sensors, slice(wall, wall + 1))
        ranges, feet = of_wall.range_in, of_wall.foot
        fits = np.abs(sensors.range_in - ranges[:, 0]) < ROBUST_LIMIT * std_in
        points = self.state.points[np.abs(along_and_across(self.state.points, lines)[1][:, 0]) < END_ASIDE_IN]
        away = np.hypot(*(sensors.face[:, None] - points).transpose(2, 0, 1))
        is_of_point = np.abs(sensors.range_in[:, None] - away) < ALONE_SIGMAS * std_in[:, None]
        return feet[fits, 0], sides_of(sensors.face[fits], lines)[:, 0], ~is_of_point.any(axis=1)[fits]

    def _unambiguous_features(self) -> Indices:
        """Return the feature of each echo (e,), none where a wall that crosses the one assigned explains it as well.

        A ray that ends where the line of a wall crosses another wall is of either: that wall does not reach there by
        it, and so does not block the rays that pass between.
        """
        feature, walls = self.assignment.feature.copy(), self.state.walls
        echoes = np.flatnonzero((feature != NO_FEATURE) & (feature < len(walls)))
        residual, _, _ = residual_matrix(self.problem, self.state, self.extents, echoes)
        crosses = np.abs(np.sin(walls[:, None, 0] - walls[:, 0])) > np.sin(MIN_CROSSING_RAD)
        is_other = (np.abs(residual[:, : len(walls)]) < ROBUST_LIMIT) & crosses[feature[echoes]]
        feature[echoes[is_other.any(axis=1)]] = NO_FEATURE
        return feature

    def measure_extents(self) -> None:
        """Set the extents to the feet of the echoes; the outermost foot at either end may be a mistake."""
        if self.problem.has_fixed_map:
            return
        extents, runs = np.empty((len(self.state.walls), 2)), [np.empty((0, 3))]
        sides, passed = np.zeros(len(extents)), self._passed_at()
        feature = self._unambiguous_features() if self.problem.rays else self.assignment.feature
        for wall in range(len(extents)):
            feet, signs, is_alone = self._feet_and_sides(wall, np.flatnonzero(feature == wall))
            order = np.argsort(feet, kind="stable")
            feet, is_alone = feet[order], is_alone[order]
            is_sided = len(signs) >= SIDED_ECHOES and abs(signs.mean()) >= SIDED
            if is_sided and not (self.surface_in and self._is_thin(wall, signs)):
                sides[wall] = np.sign(signs.mean())
            if len(feet) > 3:
                points = self._points_along(wall)
                if self.surface_in:
                    inner = _inner_feet(feet, points)
                    feet, is_alone = feet[inner], is_alone[inner]
                feet = np.clip(feet, *_end_points(points, feet[1], feet[-2]))
                extents[wall] = feet[1], feet[-2]
                runs.append(_runs(wall, feet[1:-1], is_alone[1:-1], points, passed[wall], self._radius_in))
            else:
                extents[wall] = self.extents[wall]
                runs.append(self.runs[self.runs[:, 0] == wall])
        self.extents, self.runs, self.sides = extents, np.concatenate(runs), sides

    def _is_thin(self, wall: int, signs: Floats) -> bool:
        """Return True if enough echoes of a wall, or of posts on its surface, are from either side of it.

        Posts near the ends of its parts may be corners of both faces of a thick wall, or of a door in it.
        """
        along, across = along_and_across(self.state.points, self.state.walls[wall : wall + 1])
        is_within = np.zeros(along.shape, dtype=np.bool_)
        for number, low, high in parts_of(self.runs, self.extents).tolist():
            is_within |= (number == wall) & (along > low + END_IN) & (along < high - END_IN)
        posts = len(self.state.walls) + np.flatnonzero(is_within & (np.abs(across) < self.surface_in))
        echoes = np.flatnonzero(np.isin(self.assignment.feature, posts))
        face = sensors_at(self.state.poses, self.state.parameters, self.problem.trajectory, echoes).face
        of_posts = sides_of(face, self.state.walls[wall : wall + 1])[:, 0]
        return _fewer_sign(np.concatenate((signs, of_posts))) >= SIDED_ECHOES

    @property
    def _radius_in(self) -> float:
        """Radius of the ring of sonars: the robot is at least as wide."""
        return float(np.hypot(*self.problem.trajectory.mounts.T).max(initial=0.0))

    def _passed_at(self) -> list[Floats]:
        """Return where the path crosses the line of each wall: coordinates along it, of a list of walls."""
        (x, y), walls = self.state.poses[:, :2].T, self.state.walls
        c, s = np.cos(walls[:, :1]), np.sin(walls[:, :1])
        across, along = c * x + s * y - walls[:, 1:], c * y - s * x
        crosses = across[:, :-1] * across[:, 1:] < 0.0
        return [
            row[:-1][crossed] + np.diff(row)[crossed] * off[:-1][crossed] / -np.diff(off)[crossed]
            for off, row, crossed in zip(across, along, crosses, strict=True)
        ]

    def _points_along(self, wall: int) -> Floats:
        """Return the sorted coordinates (k,) along a wall of the points on its line."""
        along, across = along_and_across(self.state.points, self.state.walls[wall : wall + 1])
        return np.sort(along[np.abs(across) < END_ASIDE_IN])

    @property
    def blocking(self) -> Floats:
        """Segments (s, 4) that block paths: surfaces of measured parts of walls, without BLOCKED_IN at their ends."""
        return surface_segments(self.state, self.runs + np.array((0.0, BLOCKED_IN, -BLOCKED_IN)))

    @property
    def surface_in(self) -> float:
        """How far the surface of a wall may be from its line, inches; 0 for planes."""
        return SURFACE_SIGMAS * self.problem.reflection.surface_std_in

    @property
    def blocked_in(self) -> float:
        """A path is blocked by a wall at least this far before its end, inches."""
        return BLOCKED_IN + self.surface_in

    def narrow(self, wall: int, extent: Floats) -> None:
        """Set the extent (2,) of a wall, of which all is measured."""
        self.extents = np.where(np.arange(len(self.extents))[:, None] == wall, extent, self.extents)
        self.runs = np.concatenate((self.runs[self.runs[:, 0] != wall], [(wall, *extent)]))

    def add_wall(self, line: Floats, extent: Floats, side: float = 0.0) -> None:
        """Add a wall (2,) with its extent (2,), and the side from which it was measured if that is known."""
        walls = len(self.state.walls)
        feature = self.assignment.feature
        self.state = replace(self.state, walls=np.concatenate((self.state.walls, line[None])))
        self.assignment = replace(self.assignment, feature=feature + (feature >= walls))
        self.extents = np.concatenate((self.extents, extent[None]))
        self.runs = np.concatenate((self.runs, [(walls, *extent)]))
        self.sides = np.append(self.sides, side)

    def add_point(self, point: Floats) -> None:
        """Add a point (2,)."""
        self.state = replace(self.state, points=np.concatenate((self.state.points, point[None])))

    def remove(self, removed: int) -> None:
        """Remove a feature; its echoes are unexplained until the next association."""
        state, walls, feature = self.state, len(self.state.walls), self.assignment.feature
        feature, level = np.where(feature == removed, NO_FEATURE, feature - (feature > removed)), self.assignment.level
        if removed < walls:
            own = state.levels.of(removed)
            is_later, is_own = level >= own.stop, (level >= own.start) & (level < own.stop)
            level = np.where(is_own, NO_LEVEL, level - is_later * (own.stop - own.start))
            levels = state.levels.some(state.levels.wall != removed)
            levels = replace(levels, wall=levels.wall - (levels.wall > removed))
            self.state = replace(state, walls=np.delete(state.walls, removed, axis=0), levels=levels)
            self.extents = np.delete(self.extents, removed, axis=0)
            self.sides = np.delete(self.sides, removed)
            runs = self.runs[self.runs[:, 0] != removed]
            self.runs = runs - np.stack((runs[:, 0] > removed, *np.zeros((2, len(runs)))), axis=-1)
        else:
            self.state = replace(state, points=np.delete(state.points, removed - walls, axis=0))
        # Ties are found again when they are needed.
        self.assignment = Assignment(feature, level=level)


def _fewer_sign(signs: Floats) -> int:
    """Return the number of those of the rarer sign."""
    return int(min((signs < 0.0).sum(), (signs > 0.0).sum()))


def _inner_feet(feet: Floats, points: Floats) -> slice:
    """Return which feet (sorted) are left without one or two at either end that are alone beyond a point on the line.

    Beyond a post a level may be anywhere, and so takes echoes of others; with them the wall would go on past its end.
    """
    first, last = 0, len(feet)
    for count in range(1, min(MAX_STRAYS, len(feet) - MIN_INNER_FEET) + 1):
        low, high = feet[count - 1], feet[count]
        if high - low > END_IN and ((points > low) & (points < high + END_ASIDE_IN)).any():
            first = count
        low, high = feet[-count - 1], feet[-count]
        if high - low > END_IN and ((points > low - END_ASIDE_IN) & (points < high)).any():
            last = len(feet) - count
    return slice(first, last) if last - first >= MIN_INNER_FEET else slice(None)


def _end_points(points: Floats, low: float, high: float) -> tuple[float, float]:
    """Return where points on the line of a wall end it, near the ends that its echoes show.

    A cone that has the foot of the wall's line beyond its end measures the end, by the foot's distance squared over
    twice the range more, which noise hides. Without this the wall would hide what is measured past its end.
    """
    first, last = points[(points > low) & (points < low + END_IN)], points[(points < high) & (points > high - END_IN)]
    return min(first.tolist(), default=low), max(last.tolist(), default=high)


def _runs(wall: int, feet: Floats, is_alone: Mask, points: Floats, passed: Floats, radius_in: float) -> Floats:
    """Return the parts (r, 3) of a wall between spots (sorted) without a wide gap: wall, first, last coordinate.

    Where the robot has passed it is open: a mistaken spot there is none. So it is between two points of its line, the
    posts of a door, with hardly any spots but near to them, or whose ranges fit the posts as well (not `is_alone`).
    """
    is_door = (np.diff(points) > 2.0 * END_IN + MIN_STRIP_IN) & (np.diff(points) < MAX_DOOR_IN)
    for low, high in zip(points[:-1][is_door], points[1:][is_door], strict=True):
        is_between = (feet > low) & (feet < high)
        if (is_between & is_alone & (feet > low + END_IN) & (feet < high - END_IN)).sum() < MIN_RUN_SPOTS:
            feet, is_alone = feet[~is_between], is_alone[~is_between]
    feet = feet[(np.abs(feet[:, None] - passed) > radius_in).all(axis=1)]
    is_passed = ((feet[:-1, None] < passed) & (passed < feet[1:, None])).any(axis=1)
    parts = np.split(feet, np.flatnonzero((np.diff(feet) > MAX_GAP_IN) | is_passed) + 1)
    rows = [
        (wall, part[0], part[-1])
        for part in parts if len(part) >= MIN_RUN_SPOTS and part[-1] - part[0] > 2.0 * BLOCKED_IN
    ]  # fmt: skip
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def assign(
    estimate: MapEstimate, echoes: Indices, sensors: Sensors | None = None, *, other_than: Indices | None = None
) -> tuple[Indices, Floats]:
    """Return the feature of each echo (e,), and the robust cost (e,) by it; see `residual_matrix`.

    With `other_than` (e,) another feature than that one, which still blocks paths.
    """
    if not estimate.state.features:
        return np.full(len(echoes), NO_FEATURE), np.full(len(echoes), ROBUST_LIMIT**2)
    # 1. What is behind a wall explains nothing, and a face is not measured from its back.
    residual, sensors, spots = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes, sensors)
    walls = estimate.state.walls
    is_back = sides_of(sensors.face, walls) * estimate.sides < 0.0
    residual[:, : len(walls)][is_back] = np.inf
    hidden = _hidden_points(estimate)
    row, pair = np.nonzero(hidden.hides(sensors.face, is_back, walls))
    residual[row, len(walls) + hidden.points[pair]] = np.inf
    echo, feature = np.nonzero(np.isfinite(residual))
    blocked = is_blocked(sensors.face[echo], spots[echo, feature], estimate.blocking, estimate.blocked_in)
    residual[echo[blocked], feature[blocked]] = np.inf
    if estimate.surface_in:
        residual[:, : len(walls)][_are_of_ends(estimate, residual, spots)] = np.inf
    if other_than is not None:
        residual[np.arange(len(echoes)), other_than] = np.inf
    # 2. The nearest, and nothing that is behind what echoes first unless that is farther off by FIRST_SIGMAS.
    sizes = np.abs(residual)
    if estimate.expects_first_echoes and not estimate.problem.rays:
        echo, feature = np.nonzero(np.isfinite(residual))
        is_behind = _are_behind(estimate, sensors, residual[echo, feature], spots[echo, feature], (echo, feature))
        sizes[echo[is_behind], feature[is_behind]] += FIRST_SIGMAS
    best = sizes.argmin(axis=1)
    left = residual[np.arange(len(echoes)), best]
    is_explained = np.isfinite(left)
    cost = np.where(is_explained, robust_cost(np.where(is_explained, left, 0.0)), ROBUST_LIMIT**2)
    return np.where(is_explained, best, NO_FEATURE), cost


def _are_of_ends(estimate: MapEstimate, residual: Floats, spots: Floats) -> Mask:
    """Return True (e, w) for echoes with their foot beyond the end of a wall that are of the end: a point.

    A level there would explain them as well, and turn the line of the wall.
    """
    state, count = estimate.state, len(estimate.state.walls)
    along, across = along_and_across(state.points, state.walls)
    side = ends_of_parts(parts_of(estimate.runs, estimate.extents), along).side
    feet = spots[:, :count, 1] * np.cos(state.walls[:, 0]) - spots[:, :count, 0] * np.sin(state.walls[:, 0])
    found = np.zeros(feet.shape, dtype=np.bool_)
    for point, wall in np.argwhere((np.abs(across) < estimate.surface_in) & (side != 0.0)):
        beyond = side[point, wall] * (along[point, wall] - feet[:, wall])
        found[:, wall] |= (beyond > 0.0) & (beyond < MIN_DOOR_IN) & (np.abs(residual[:, count + point]) < FIRST_SIGMAS)
    return found


def _are_behind(
    estimate: MapEstimate, sensors: Sensors, residual: Floats, spots: Floats, pairs: tuple[Indices, Indices]
) -> Mask:
    """Return True (k,) for features from which an echo comes later than from a wall that must have returned one.

    That is a wall whose foot is well within the cone, and well within a part that was measured. By the nearest range
    alone an echo of it that is too long would be one of the corner behind it, and one that is too short would remain
    its own: the mean of what remains is too short, and rooms become too small.

    Parameters
    ----------
    estimate, sensors
        The map, and the sonars (e,).
    residual, spots
        (k,) residuals and (k, 2) reflecting spots of the pairs.
    pairs
        (k,) numbers of echoes, and of features that may explain each.
    """
    echo, feature = pairs
    off = spots - sensors.face[echo]
    away = np.hypot(*off.T)
    off_axis = np.abs(wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - sensors.axis[echo]))
    walls = np.flatnonzero(
        (feature < len(estimate.state.walls)) & (np.abs(residual) < ROBUST_LIMIT)
        & (off_axis < FIRST_CONE * estimate.problem.reflection.half_cone_rad)
    )  # fmt: skip
    angle = estimate.state.walls[feature[walls], 0]
    at = spots[walls, 1] * np.cos(angle) - spots[walls, 0] * np.sin(angle)
    is_measured = np.zeros(len(walls), dtype=np.bool_)
    for wall, low, high in estimate.runs.tolist():
        is_measured |= (feature[walls] == wall) & (at > low + END_IN) & (at < high - END_IN)
    first = walls[is_measured]
    first_in = np.full(len(sensors.face), np.inf)
    np.minimum.at(first_in, echo[first], away[first])
    return np.asarray(away > first_in[echo] + SAME_RANGE_IN, dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class _HiddenPoints:
    """Points that are not measured from behind a face: numbers of both (k,), and from which part of its back.

    `hidden_from` (k,) is 1 for a point that is hidden from where the coordinate along the face is higher than its own,
    -1 from where it is lower, 0 from all of the back. `at` (k,) are the coordinates of the points.
    """

    points: Indices
    faces: Indices
    hidden_from: Floats
    at: Floats

    def hides(self, places: Floats, is_back: Mask, walls: Floats) -> Mask:
        """Return True (p, k) where a point is hidden from a place (p, 2), which is behind walls by `is_back` (p, w)."""
        angle = walls[self.faces, 0]
        beyond = places[:, 1:] * np.cos(angle) - places[:, :1] * np.sin(angle) - self.at
        return np.asarray(is_back[:, self.faces] & (self.hidden_from * beyond >= 0.0), dtype=np.bool_)


def _hidden_points(estimate: MapEstimate) -> _HiddenPoints:
    """Return which points are hidden from behind which faces.

    An inner corner is on a face and a wall that goes on in front of it: behind it there is the corner of the next room.
    A point within a face is hidden as well. Both edges of a door are at which all that is known of a face ends: from
    behind, the edge on that side of the wall is nearer, in about the same direction, and echoes first. Once that edge
    is known, the point is seen past it through the door, and hidden by the wall itself. If the face is known on both
    sides of the door, its edges are what locates a robot in the door, though some echoes are of the other edges.
    Another end of a face may be the corner of a box, which is seen from beside the face, or the end of a wall too thin
    to have two edges.
    """
    state, extents, sides = estimate.state, estimate.extents, estimate.sides
    c, s = np.cos(state.walls[:, 0]), np.sin(state.walls[:, 0])
    # 1. Points (v, w) on lines, and not farther beyond the part that was seen than a wall may go on.
    along, off = along_and_across(state.points, state.walls)
    across = np.abs(off)
    onward = np.stack((extents[:, 0] - along, along - extents[:, 1]), axis=-1)
    on_wall = (across < CORNER_IN) & (onward < growth_of(state.walls, extents)).all(axis=-1)
    # Of both faces of a thin wall it is on the nearer one: the other one would hide it from where it is measured.
    facing = sides[:, None] * sides * np.cos(state.walls[:, None, 0] - state.walls[:, 0])
    is_opposite, is_nearer = facing < -np.cos(MIN_CROSSING_RAD), across[:, None] < across[..., None]
    on_wall &= ~(is_nearer & on_wall[:, None] & is_opposite).any(axis=2)
    # 2. Inner corners: whether a part of the other wall goes on from there to where the face's normal points.
    parts = parts_of(estimate.runs, extents)
    slope = (c[:, None] * -s + s[:, None] * c) * sides[:, None]
    is_inner = np.zeros(on_wall.shape, dtype=np.bool_)
    for direction, goes_on in zip((-1.0, 1.0), _go_on(parts, along), strict=True):
        is_inner |= (on_wall & goes_on) @ (direction * slope > np.sin(MIN_CROSSING_RAD)).T
    # 3. Ends: on which side of the point its wall is; across a door in a face it is beyond.
    ends = ends_of_parts(parts, along)
    is_across = onward > MIN_DOOR_IN
    wall_side = np.where(is_across.any(axis=-1), is_across @ np.array((-1.0, 1.0)), ends.side)
    # 4. Edges of doors at the end of a face: across one, or with another point at that distance beyond them.
    is_door = is_across & (onward < MAX_DOOR_IN)
    at_end = np.abs(onward) < END_IN
    has_door = is_door.any(axis=-1) | (at_end & (on_wall[..., None] & is_door).any(axis=0)).any(axis=-1)
    # 5. Is the other edge of the wall known, behind this one?
    behind = (off[:, None] - off) * sides
    has_other = ((behind > MIN_THICKNESS_IN) & (behind < MAX_THICKNESS_IN)
                 & (np.abs(along[:, None] - along) < OPPOSITE_IN)).any(axis=1)  # fmt: skip
    from_all = is_inner | ends.is_within | (has_door & ~has_other)
    points, faces = np.nonzero(on_wall & (sides != 0.0) & (from_all | (has_other & (wall_side != 0.0))))
    at = points, faces
    return _HiddenPoints(points, faces, np.where(from_all, 0.0, wall_side)[at], along[at])


def _go_on(parts: Floats, along: Floats) -> tuple[Mask, Mask]:
    """Return True (v, w) where a part (r, 3) of a wall begins soon after a coordinate, downwards and upwards.

    And reaches INNER_IN beyond it.
    """
    down, up = np.zeros(along.shape, dtype=np.bool_), np.zeros(along.shape, dtype=np.bool_)
    for wall, low, high in parts.tolist():
        at, number = along[:, int(wall)], int(wall)
        down[:, number] |= (high > at - MAX_GAP_IN) & (low < at - INNER_IN)
        up[:, number] |= (low < at + MAX_GAP_IN) & (high > at + INNER_IN)
    return down, up
