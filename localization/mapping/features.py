"""Features of a map: new walls and points, and old ones that the robot measures again when it comes back.

New ones, from echoes that nothing explains yet (`find_births`):

    1. votes      each echo votes for all walls tangent to its arc, and for all points on it (Hough transform)
    2. fit        the peak's supporters, by reweighted least squares with the poses fixed
    3. decision   wall or point, by the cost of both on the supporters of both

A robot that stands sees the same arc from either; the decision needs a base over which they differ.

Loops: features that were measured again and not recognized (`close_loops`):

    1. pairs        an old feature, and a new one of its kind that was measured only after it
    2. hypotheses   rigid motions that bring two new features onto old ones, and how many others they bring there
    3. trial        one feature for each pair of the best ones, optimized with the odometry of the whole loop
    4. test         the total cost falls, and the odometry of no loop contradicts the pairs (joint compatibility)

One pair may agree by chance, many together hardly do. The joint compatibility is tested after the optimization: before,
echoes that were taken for those of old features make the map more certain than it is, and wrong by 16 in.

Exact rays have no points. There the walls of the last 30 s alone, a local map, are laid onto the old ones:

    1. local map    the walls that the echoes of the last 30 s show without the map
    2. hypotheses   motions that bring one of them onto an old wall, or two that are not parallel onto two
    3. rating       the echoes of the last 30 s, moved, by the old walls alone
    4. trial, test  as above, with the poses of the last 30 s moved

References
----------
Tardos, Neira, Newman, Leonard, Robust Mapping and Localization in Indoor Environments Using Sonar Data (2002): the
Hough transform of sonar arcs for lines and points. Duda, Hart, Use of the Hough Transformation (1972). Neira, Tardos,
Data Association in Stochastic Mapping Using the Joint Compatibility Test (2001). Fischler, Bolles, Random Sample
Consensus (1981): hypotheses by few pairs, here by all. Bosse, Newman, Leonard, Teller, Simultaneous Localization and
Map Building in Large-Scale Cyclic Environments Using the Atlas Framework (2004): local maps matched to one another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import HEADING, Floats, rotate, wrap_angle
from localization.mapping.association import MapEstimate, assign
from localization.mapping.consistency import check_parts
from localization.mapping.measurements import Indices
from localization.mapping.problem import (
    HALF_CONE_RAD,
    NO_FEATURE,
    Assignment,
    RangePrediction,
    Sensors,
    predict_point,
    predict_wall,
    robust_weight,
    sensors_at,
)
from localization.mapping.reflectors import OFF_CONE_RAD, Mask, along_and_across, is_blocked, segments_of, sides_of

ANGLE_CELL_RAD: Final = radians(2.0)
OFFSET_CELL_IN: Final = 1.5
POINT_CELL_IN: Final = 2.0
RAY_FAN: Final = np.arange(-6, 7) * 3.0 * ANGLE_CELL_RAD
"""Directions off a ray for which an echo votes: normals of walls."""
MIN_VOTES: Final = 6
MIN_DOUBTFUL: Final = 12
"""Echoes of a point that may be a wall as well: it saves about twice its penalty."""
FRONT: Final = -1.0
"""Side of a new wall on which its sonars are: its normal points away from them."""
MAX_CANDIDATES: Final = 6
"""Peaks tried at a time, of walls and of points each."""
SUPPORT_IN: Final = 2.5
"""Distance from a peak within which echoes support it."""
SUPPORT_SIGMAS: Final = 2.5
MIN_BASE_IN: Final = 8.0
"""Shortest wall seen, and least path past a point, from which walls and points can be told apart."""
MIN_DIFFERENCE: Final = 10.0
"""Difference of the costs that decides: a ratio of likelihoods of e^5."""
TRUNCATION: Final = 9.0
"""Highest cost of an echo in the decision, 3 standard deviations."""
FIT_STEPS: Final = 6
MAX_WALL_STEP, MAX_POINT_STEP = np.array((0.25, 5.0)), np.array((5.0, 5.0))
"""Longest step of a fit: radians and inches of a wall, inches of a point."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted feature: its two numbers, cost (e,) of each echo, and supporters (e,)."""

    feature: Floats
    cost: Floats
    supports: Mask
    base_in: float


@dataclass(frozen=True, slots=True)
class FreeEchoes:
    """Unexplained echoes: their sonars, standard deviations, and whether a known wall blocks each path."""

    sensors: Sensors
    std_in: Floats
    rays: bool
    half_cone_rad: float = HALF_CONE_RAD

    @property
    def fan(self) -> Floats:
        """Directions within the cone for which an echo votes."""
        count = int(self.half_cone_rad / ANGLE_CELL_RAD)
        return np.asarray(np.arange(-count, count + 1) * ANGLE_CELL_RAD, dtype=np.float64)

    def is_in_cone(self, bearing: Floats) -> Mask:
        """Return True (e,) for directions in the cones."""
        off_axis = np.abs(wrap_angle(bearing - self.sensors.axis))
        return np.asarray(off_axis < self.half_cone_rad + OFF_CONE_RAD, dtype=np.bool_)

    def __len__(self) -> int:
        """Return their number."""
        return len(self.std_in)

    def some(self, at: Mask) -> FreeEchoes:
        """Return some of them."""
        s = self.sensors
        sensors = Sensors(s.face[at], s.arm[at], s.axis[at], s.range_in[at])
        return replace(self, sensors=sensors, std_in=self.std_in[at])


def find_births(estimate: MapEstimate, first_node: int, *, with_doubtful: bool = False) -> int:
    """Add the walls and points that unexplained echoes since a node show, and return their number.

    With doubtful ones, what may be either becomes a point if it has MIN_DOUBTFUL echoes: a point is never a wrong wall.
    """
    echoes = estimate.echoes(first_node)
    echoes = echoes[estimate.assignment.feature[echoes] == NO_FEATURE]
    free = _free_echoes(estimate, echoes)
    born = 0
    # Exact rays meet no points: those that a short part of a wall explains as well would take its rays.
    for vote in (_wall_peak, _point_peak) if not free.rays else (_wall_peak,):
        left = np.ones(len(free), dtype=np.bool_)
        for _ in range(MAX_CANDIDATES):
            # 1. The highest peak of the echoes not used yet.
            if left.sum() < MIN_VOTES:
                break
            numbers = np.flatnonzero(left)
            remaining = free.some(left)
            feature, is_wall, votes = vote(remaining)
            if votes < MIN_VOTES:
                break
            # 2. What it is; its echoes are used up, decided or not.
            fit, found_wall, used = _decide(remaining, feature, is_wall, with_doubtful)
            if not used.any():
                break
            left[numbers[used]] = False
            if fit is None:
                continue
            born += 1
            if found_wall:
                feet = predict_wall(remaining.sensors, fit.feature[None], free.rays).foot[fit.supports]
                estimate.add_wall(fit.feature, np.array((feet.min(), feet.max())), FRONT)
            else:
                estimate.add_point(fit.feature)
        # 3. Echoes that the new walls explain vote for no points.
        if born:
            estimate.associate(first_node)
            echoes = echoes[estimate.assignment.feature[echoes] == NO_FEATURE]
            free = _free_echoes(estimate, echoes)
    return born


def _free_echoes(estimate: MapEstimate, echoes: Indices) -> FreeEchoes:
    """Return unexplained echoes, without those from behind a wall of the map."""
    trajectory, state = estimate.problem.trajectory, estimate.state
    sensors = sensors_at(state.poses, state.parameters, trajectory, echoes)
    problem = estimate.problem
    free = FreeEchoes(sensors, trajectory.std_in[echoes], problem.rays, problem.reflection.half_cone_rad)
    along = np.stack((np.cos(sensors.axis), np.sin(sensors.axis)), axis=-1)
    spots = sensors.face + sensors.range_in[:, None] * along
    blocked = is_blocked(sensors.face, spots, estimate.blocking, estimate.blocked_in)
    return free.some(~blocked)


# Votes.


def _wall_peak(free: FreeEchoes) -> tuple[Floats, bool, int]:
    """Return the wall (2,) with the most votes, True, and their number."""
    s = free.sensors
    fan = free.fan if not free.rays else RAY_FAN
    angles = wrap_angle(s.axis[:, None] + fan)
    c, sn = np.cos(angles), np.sin(angles)
    reach = s.range_in[:, None] * (np.cos(fan) if free.rays else 1.0)
    offsets = s.face[:, :1] * c + s.face[:, 1:] * sn + reach
    row = np.floor((angles + np.pi) / ANGLE_CELL_RAD).astype(np.intp)
    low = float(offsets.min()) - OFFSET_CELL_IN
    column = np.floor((offsets - low) / OFFSET_CELL_IN).astype(np.intp)
    shape = int(row.max()) + 1, int(column.max()) + 2
    peak, votes = _highest(row, column, shape)
    return np.array(((peak[0] + 0.5) * ANGLE_CELL_RAD - np.pi, low + peak[1] * OFFSET_CELL_IN)), True, votes


def _point_peak(free: FreeEchoes) -> tuple[Floats, bool, int]:
    """Return the point (2,) with the most votes, False, and their number."""
    s = free.sensors
    fan = s.axis[:, None] + (free.fan if not free.rays else np.zeros(1))
    x = s.face[:, :1] + s.range_in[:, None] * np.cos(fan)
    y = s.face[:, 1:] + s.range_in[:, None] * np.sin(fan)
    low_x, low_y = float(x.min()) - POINT_CELL_IN, float(y.min()) - POINT_CELL_IN
    row = np.floor((x - low_x) / POINT_CELL_IN).astype(np.intp)
    column = np.floor((y - low_y) / POINT_CELL_IN).astype(np.intp)
    peak, votes = _highest(row, column, (int(row.max()) + 1, int(column.max()) + 2))
    return np.array((low_x + (peak[0] + 0.5) * POINT_CELL_IN, low_y + peak[1] * POINT_CELL_IN)), False, votes


def _highest(row: Indices, column: Indices, shape: tuple[int, int]) -> tuple[tuple[int, int], int]:
    """Return the border between two columns with the most votes (e, k) in both, and their number."""
    # An echo votes once for a cell, however many of its directions fall into it.
    cells = np.sort(row * shape[1] + column, axis=1)
    first = np.ones(cells.shape, dtype=np.bool_)
    first[:, 1:] = cells[:, 1:] != cells[:, :-1]
    votes = np.bincount(cells[first], minlength=shape[0] * shape[1]).reshape(shape)
    pairs = votes[:, :-1] + votes[:, 1:]
    peak = int(pairs.argmax())
    at_row, at_column = divmod(peak, shape[1] - 1)
    return (at_row, at_column + 1), int(pairs[at_row, at_column])


# Fit and decision.


def _predict(free: FreeEchoes, feature: Floats, is_wall: bool) -> RangePrediction:
    """Return the expected ranges of all echoes from one feature."""
    one = np.broadcast_to(feature, (len(free), 2))
    return predict_wall(free.sensors, one, free.rays) if is_wall else predict_point(free.sensors, one)


def _fit(free: FreeEchoes, feature: Floats, is_wall: bool) -> Fit:
    """Return the feature fitted to the echoes that support it."""
    sensors = free.sensors
    for step in range(FIT_STEPS + 1):
        predicted = _predict(free, feature, is_wall)
        in_cone = free.is_in_cone(predicted.bearing)
        if is_wall:
            # From the other side the other face of the wall is measured. Normals point away from the sonars that voted.
            in_cone &= sides_of(sensors.face, feature[None])[:, 0] == FRONT
        residual = sensors.range_in - predicted.range_in
        # The first steps take echoes farther off, since a peak is as coarse as its cell.
        within = SUPPORT_IN if step < 2 else SUPPORT_SIGMAS * free.std_in + 0.3
        supports = in_cone & (np.abs(residual) < within)
        if step == FIT_STEPS or supports.sum() < 3:
            break
        J, r = predicted.by_feature[supports] / free.std_in[supports, None], (residual / free.std_in)[supports]
        weight = robust_weight(r)
        information = J.T @ (J * weight[:, None]) + 1e-6 * np.eye(2)
        change = np.linalg.solve(information, J.T @ (weight * r))
        # A limit of the length keeps the direction: angle and offset of a wall far from the origin change together.
        limits = MAX_WALL_STEP if is_wall else MAX_POINT_STEP
        feature = feature + change / max(float(np.abs(change / limits).max()), 1.0)
    cost = np.where(in_cone, np.minimum(np.square(residual / free.std_in), TRUNCATION), TRUNCATION)
    return Fit(feature, cost, supports, _base(free, predicted, supports, is_wall))


def _base(free: FreeEchoes, predicted: RangePrediction, supports: Mask, is_wall: bool) -> float:
    """Return the length over which a feature was observed, inches: along a wall, or of the path past a point."""
    if supports.sum() < 3:
        return 0.0
    if is_wall:
        # The outermost echo at either end may be a mistake.
        feet = np.sort(predicted.foot[supports])
        return float(feet[-2] - feet[1])
    bearing = predicted.bearing[supports]
    middle = np.arctan2(np.sin(bearing).mean(), np.cos(bearing).mean())
    across = np.sort(free.sensors.face[supports] @ np.array((-np.sin(middle), np.cos(middle))))
    return float(across[-2] - across[1])


def _decide(
    free: FreeEchoes, feature: Floats, is_wall: bool, with_doubtful: bool = False
) -> tuple[Fit | None, bool, Mask]:
    """Return the fit of the better kind or None if undecided, True for a wall, and the echoes that are used up."""
    # 1. The kind that the peak is of, then the other one from the same echoes.
    first = _fit(free, feature, is_wall)
    if first.supports.sum() < MIN_VOTES:
        predicted = _predict(free, feature, is_wall)
        near = np.abs(free.sensors.range_in - predicted.range_in) < SUPPORT_IN
        return None, is_wall, near & free.is_in_cone(predicted.bearing)
    if free.rays:
        is_known = first.supports.sum() >= MIN_VOTES and first.base_in >= MIN_BASE_IN
        return first if is_known else None, True, first.supports
    spots = _spots(free, first, is_wall)
    if is_wall:
        other = _fit(free, np.median(spots[first.supports], axis=0), False)
    else:
        bearing = _predict(free, first.feature, False).bearing[first.supports]
        middle = np.arctan2(np.sin(bearing).mean(), np.cos(bearing).mean())
        other = _fit(free, np.array((middle, first.feature @ (np.cos(middle), np.sin(middle)))), True)
    wall, point = (first, other) if is_wall else (other, first)
    # 2. Compared on the echoes of both.
    union = wall.supports | point.supports
    gain = float((point.cost - wall.cost)[union].sum())
    if gain > MIN_DIFFERENCE and wall.supports.sum() >= MIN_VOTES and wall.base_in >= MIN_BASE_IN:
        return wall, True, wall.supports
    if gain < -MIN_DIFFERENCE and point.supports.sum() >= MIN_VOTES and point.base_in >= MIN_BASE_IN:
        return point, False, point.supports
    is_doubtful = with_doubtful and abs(gain) <= MIN_DIFFERENCE
    if is_doubtful and point.supports.sum() >= MIN_DOUBTFUL and point.base_in >= MIN_BASE_IN:
        return point, False, point.supports
    return None, is_wall, first.supports


def _spots(free: FreeEchoes, fit: Fit, is_wall: bool) -> Floats:
    """Return the reflecting spots (e, 2) of a fitted feature."""
    if not is_wall:
        return np.broadcast_to(fit.feature, (len(free), 2))
    c, s = np.cos(fit.feature[0]), np.sin(fit.feature[0])
    feet = _predict(free, fit.feature, True).foot
    return np.stack((c * fit.feature[1] - s * feet, s * fit.feature[1] + c * feet), axis=-1)


MAX_DRIFT_IN, MAX_DRIFT_RAD = 60.0, radians(20.0)
"""Farther off, a place is not recognized."""
MIN_LEFT_NODES: Final = 40
"""Half of an old feature's echoes were measured 20 s or more before a new one's."""
MIN_PAIRS: Final = 4
"""Features that must agree."""
PAIR_BASE_IN: Final = 12.0
"""Distance of two points from which they give a direction."""
NEAR_IN, NEAR_RAD = 4.0, radians(4.0)
"""Two features agree that are nearer than this, after the motion."""
MAX_TRIALS: Final = 3
MOTIONS_AT_ONCE: Final = 256
JOIN_STEPS: Final = 8

LOCAL_NODES: Final = 60
"""Nodes of a local map, 30 s: longer than between two corners, shorter than the odometry needs to bend it."""
MIN_LOCAL_ECHOES: Final = 12
"""Echoes of a wall of a local map, and of an old one."""
MIN_CROSSING_RAD: Final = radians(30.0)
"""Two walls that meet at a smaller angle give no position."""
RATED_MOTIONS: Final = 40
"""Motions that are rated by echoes, those first that bring the most echoes' walls onto old ones."""
RATED_ECHOES: Final = 240
MIN_RATED_GAIN: Final = 0.15
"""Least part of the cost of the rated echoes by the old walls that a motion must save to be tried."""
LOCAL_ROUNDS: Final = 3
"""Rounds of births in a local map: each takes the highest peaks alone."""
DISTINCT_IN, DISTINCT_RAD = 6.0, radians(2.0)
"""Of motions that differ by less only the best one is tried."""


class _Motion(NamedTuple):
    """A rigid motion, and the pairs (k, 2) of an old and a new feature that it brings together."""

    turn: float
    shift: Floats
    pairs: Indices
    error: float


def close_loops(estimate: MapEstimate, first_node: int = 0) -> int:
    """Join new features, measured only since a node, with old ones where the total cost falls; return their number."""
    if estimate.problem.rays:
        return _recognize_walls(estimate)
    pairs, begins = _pairs(estimate, first_node)
    for motion in _motions(estimate, pairs)[:MAX_TRIALS]:
        trial = _joined(estimate, motion, begins)
        if trial.cost < estimate.cost - MIN_DIFFERENCE and _are_loops_sound(trial):
            estimate.replace_by(trial)
            return len(motion.pairs)
    return 0


def _are_loops_sound(estimate: MapEstimate) -> bool:
    """Return True if neither the odometry of a loop nor the whole drive contradicts the map."""
    return all(part.excess <= 1.0 for part in check_parts(estimate) if part.kind in ("drive", "loop"))


def _pairs(estimate: MapEstimate, first_node: int) -> tuple[Indices, Floats]:
    """Return candidate pairs (k, 2) of an old and a new feature, and the node at which each feature begins (f,)."""
    feature, node = estimate.assignment.feature, estimate.problem.trajectory.node
    count, walls = estimate.state.features, len(estimate.state.walls)
    begins, middles = np.full(count, np.inf), np.full(count, np.inf)
    for number in range(count):
        nodes = node[feature == number]
        if len(nodes):
            # Some echoes of the new one were taken for the old one's before it was found.
            begins[number], middles[number] = np.quantile(nodes, (0.1, 0.5))
    # Walls measured from opposite sides may be the faces of a thick one.
    angle, opposite = estimate.state.walls[:, 0], np.zeros((count, count), dtype=np.bool_)
    opposite[:walls, :walls] = np.outer(estimate.sides, estimate.sides) * np.cos(angle[:, None] - angle) < 0.0
    found = [
        (old, new)
        for new in np.flatnonzero((begins >= first_node) & np.isfinite(begins))
        for old in np.flatnonzero(middles + MIN_LEFT_NODES < begins[new])
        if (old < walls) == (new < walls) and not opposite[old, new]
    ]
    return np.array(found, dtype=np.intp).reshape(-1, 2), begins


def _motions(estimate: MapEstimate, pairs: Indices) -> list[_Motion]:
    """Return the motions that bring at least MIN_PAIRS features together, those of most pairs first."""
    if len(pairs) < MIN_PAIRS:
        return []
    state, count = estimate.state, len(estimate.state.walls)
    segments = segments_of(state.walls, estimate.extents).reshape(-1, 2, 2)
    middles = np.concatenate((segments.mean(axis=1), state.points))
    angles = np.concatenate((state.walls[:, 0], np.zeros(len(state.points))))
    is_wall = pairs[:, 0] < count
    old, new = pairs.T
    # 1. By two pairs of points, or by a pair of walls for the turn and one of points.
    away = np.hypot(*(middles[old] - middles[new]).T)
    points, motions = np.flatnonzero(~is_wall & (away < MAX_DRIFT_IN)), list[tuple[float, Floats]]()
    for number, one in enumerate(points):
        others = points[number + 1 :]
        a, b = middles[old[others]] - middles[old[one]], middles[new[others]] - middles[new[one]]
        lengths, new_lengths = np.hypot(*a.T), np.hypot(*b.T)
        turns = wrap_angle(np.arctan2(a[:, 1], a[:, 0]) - np.arctan2(b[:, 1], b[:, 0]))
        fits = (np.abs(lengths - new_lengths) < NEAR_IN) & (lengths > PAIR_BASE_IN) & (np.abs(turns) < MAX_DRIFT_RAD)
        by_walls = wrap_angle(2.0 * (angles[old[is_wall]] - angles[new[is_wall]])) / 2.0
        for turn in (*turns[fits], *by_walls[np.abs(by_walls) < MAX_DRIFT_RAD]):
            motions.append((float(turn), middles[old[one]] - rotate(middles[new[one]], np.array(turn))))
    # 2. Those that bring enough pairs together, all at once first: there are thousands.
    enough = []
    for start in range(0, len(motions), MOTIONS_AT_ONCE):
        some = motions[start : start + MOTIONS_AT_ONCE]
        turns, shifts = np.array([turn for turn, _ in some]), np.array([shift for _, shift in some])
        errors = _errors(estimate, pairs, middles, segments, turns, shifts)
        candidates = np.flatnonzero((errors <= NEAR_IN).sum(axis=1) >= MIN_PAIRS)
        found = [_Motion(*some[row], *_matched(pairs, errors[row])) for row in candidates]
        enough += [motion for motion in found if len(motion.pairs) >= MIN_PAIRS]
    # 3. The best of each set of pairs.
    best: dict[bytes, _Motion] = {}
    for motion in sorted(enough, key=lambda motion: (-len(motion.pairs), motion.error)):
        best.setdefault(motion.pairs.tobytes(), motion)
    return list(best.values())


def _errors(
    estimate: MapEstimate, pairs: Indices, middles: Floats, segments: Floats, turns: Floats, shifts: Floats
) -> Floats:
    """Return how far each of m motions leaves the two features of k pairs apart (m, k), inf beyond the drift."""
    state, count = estimate.state, len(estimate.state.walls)
    old, new = pairs.T
    moved = rotate(np.broadcast_to(middles[new], (len(turns), len(new), 2)), turns[:, None]) + shifts[:, None]
    off = moved - middles[old]
    error: Floats = np.hypot(off[..., 0], off[..., 1])
    # 1. Walls: across the old one, side by side with it, and in its direction.
    walls = old < count
    angle = state.walls[old[walls], 0]
    normal = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    half = 0.5 * np.hypot(*(segments[old[walls], 1] - segments[old[walls], 0]).T)
    along = np.abs(off[:, walls, 1] * normal[:, 0] - off[:, walls, 0] * normal[:, 1])
    turned = wrap_angle(2.0 * (state.walls[new[walls], 0] + turns[:, None] - angle)) / 2.0
    across = np.abs((off[:, walls] * normal).sum(axis=-1))
    error[:, walls] = np.where((along < half + NEAR_IN) & (np.abs(turned) < NEAR_RAD), across, np.inf)
    # 2. Within the drift.
    drift = moved - middles[new]
    return np.where(np.hypot(drift[..., 0], drift[..., 1]) < MAX_DRIFT_IN, error, np.inf)


def _matched(pairs: Indices, error: Floats) -> tuple[Indices, float]:
    """Return the pairs that a motion brings together, each feature in the nearest one alone, and their total error."""
    rows, used_old, used_new = list[int](), set[int](), set[int]()
    for row in np.argsort(error):
        if error[row] > NEAR_IN:
            break
        old, new = pairs[row].tolist()
        if old not in used_old and new not in used_new:
            rows.append(int(row))
            used_old.add(old)
            used_new.add(new)
    rows.sort()
    return pairs[rows], float(error[rows].sum())


def _joined(estimate: MapEstimate, motion: _Motion, begins: Floats) -> MapEstimate:
    """Return the map with one feature for each pair, optimized; what was measured since the first new one is moved."""
    trial, state = estimate.copy(), estimate.state
    walls = len(state.walls)
    node = int(begins[motion.pairs[:, 1]].min())
    # 1. Poses, and features that only they have measured.
    poses = state.poses.copy()
    poses[node:, :2] = rotate(poses[node:, :2], np.full(len(poses) - node, motion.turn)) + motion.shift
    poses[node:, HEADING] += motion.turn
    later = begins >= node
    lines, points = state.walls.copy(), state.points.copy()
    extents, runs = trial.extents.copy(), trial.runs.copy()
    # The levels of walls that are moved are measured anew.
    levels = state.levels.some(~later[:walls][state.levels.wall])
    for number in np.flatnonzero(later[:walls]):
        lines[number, 0] += motion.turn
        normal = np.array((np.cos(lines[number, 0]), np.sin(lines[number, 0])))
        lines[number, 1] += float(normal @ motion.shift)
        moved_in = float(motion.shift @ np.array((-normal[1], normal[0])))
        extents[number] += moved_in
        runs[runs[:, 0] == number, 1:] += moved_in
    points[later[walls:]] = rotate(points[later[walls:]], np.full(int(later[walls:].sum()), motion.turn)) + motion.shift
    # 2. The echoes of the new features are those of the old ones, which reach as far as both.
    feature = trial.assignment.feature.copy()
    segments = segments_of(lines, extents).reshape(-1, 2, 2)
    for old, new in motion.pairs:
        feature[feature == new] = old
        if old < walls:
            along = np.array((-np.sin(lines[old, 0]), np.cos(lines[old, 0])))
            reached = segments[new] @ along
            extents[old] = min(extents[old, 0], reached.min()), max(extents[old, 1], reached.max())
    trial.state = replace(state, poses=poses, walls=lines, points=points, levels=levels)
    trial.extents, trial.runs = extents, runs
    trial.assignment = replace(trial.assignment, feature=feature)
    for new in sorted(motion.pairs[:, 1].tolist(), reverse=True):
        trial.remove(new)
    # 3. By plain least squares the odometry of the whole loop takes up the motion; then the echoes are assigned anew.
    trial.optimize(JOIN_STEPS, robust=False)
    for _ in range(2):
        trial.optimize(4)
        trial.associate()
    trial.optimize(4)
    return trial


# Exact rays: a local map.


def _recognize_walls(estimate: MapEstimate) -> int:
    """Move the last poses to where their walls are old ones if the total cost falls; return the number of walls."""
    start = len(estimate.state.poses) - LOCAL_NODES
    is_old = _measured_before(estimate, start - MIN_LEFT_NODES)
    if not is_old.any():
        return 0
    # 1. The local map, and the map of before.
    local = _without(estimate, np.zeros(len(is_old), dtype=np.bool_))
    for _ in range(LOCAL_ROUNDS):
        find_births(local, start)
        local.associate(start)
    old = _without(estimate, is_old)
    # 2. Motions, rated by a part of the echoes, evenly spread.
    echoes = estimate.echoes(start)
    echoes = echoes[:: max(len(echoes) // RATED_ECHOES, 1)]
    sensors = sensors_at(estimate.state.poses, estimate.state.parameters, estimate.problem.trajectory, echoes)
    rated = [
        (float(assign(old, echoes, _moved(sensors, *motion))[1].sum()), motion)
        for motion in _wall_motions(local, old)
    ]  # fmt: skip
    # 3. They must explain more of them than where the odometry has led.
    now = (1.0 - MIN_RATED_GAIN) * float(assign(old, echoes, sensors)[1].sum())
    tried: list[tuple[float, Floats]] = []
    centre = estimate.state.poses[start:, :2].mean(axis=0)
    for cost, (turn, shift) in sorted(rated, key=lambda pair: pair[0]):
        if cost > now or len(tried) == MAX_TRIALS:
            break
        place = rotate(centre, np.array(turn)) + shift
        if any(abs(turn - other) < DISTINCT_RAD and np.hypot(*(place - at)) < DISTINCT_IN for other, at in tried):
            continue
        tried.append((turn, place))
        trial = _relocated(estimate, start, turn, shift)
        if trial.cost < estimate.cost - MIN_DIFFERENCE and _are_loops_sound(trial):
            estimate.replace_by(trial)
            return len(local.state.walls)
    return 0


def _measured_before(estimate: MapEstimate, node: int) -> Mask:
    """Return True (w,) for walls with enough echoes before a node."""
    feature = estimate.assignment.feature[estimate.problem.trajectory.node < node]
    feature = feature[feature != NO_FEATURE]
    return np.asarray(
        np.bincount(feature, minlength=estimate.state.features)[: len(estimate.state.walls)] >= MIN_LOCAL_ECHOES,
        dtype=np.bool_,
    )


def _without(estimate: MapEstimate, remaining: Mask) -> MapEstimate:
    """Return the map with some of its walls (w,) alone, and no point."""
    found = estimate.copy()
    numbers = np.where(remaining, np.cumsum(remaining) - 1, NO_FEATURE)
    feature = estimate.assignment.feature
    is_wall = (feature != NO_FEATURE) & (feature < len(remaining))
    feature = np.where(is_wall, np.append(numbers, NO_FEATURE)[np.where(is_wall, feature, -1)], NO_FEATURE)
    state = estimate.state
    levels = state.levels.some(remaining[state.levels.wall])
    levels = replace(levels, wall=numbers[levels.wall])
    found.state = replace(state, walls=state.walls[remaining], points=state.points[:0], levels=levels)
    found.assignment = Assignment(feature)
    found.extents, found.sides = estimate.extents[remaining], estimate.sides[remaining]
    rows = estimate.runs[:, 0].astype(np.intp)
    runs = estimate.runs[remaining[rows]]
    found.runs = np.column_stack((numbers[rows[remaining[rows]]], runs[:, 1:]))
    return found


def _moved(sensors: Sensors, turn: float, shift: Floats) -> Sensors:
    """Return sonars after a rigid motion."""
    turned = np.full(len(sensors.face), turn)
    return Sensors(
        rotate(sensors.face, turned) + shift, rotate(sensors.arm, turned), sensors.axis + turn, sensors.range_in
    )


def _wall_motions(local: MapEstimate, old: MapEstimate) -> list[tuple[float, Floats]]:
    """Return the motions (turn, shift) that bring the most of a local map's walls onto old ones, at most so many.

    A pair of walls gives the turn, and the shift across them; two pairs that are not parallel give the whole shift.
    """
    echoes = np.bincount(
        local.assignment.feature[local.assignment.feature != NO_FEATURE], minlength=len(local.state.walls)
    )
    middles = segments_of(local.state.walls, local.extents).reshape(-1, 2, 2).mean(axis=1)
    centre = local.state.poses[-LOCAL_NODES:, :2].mean(axis=0)
    # 1. Pairs of about the same direction, of a normal either way.
    turns = wrap_angle(2.0 * (old.state.walls[:, 0] - local.state.walls[:, None, 0])) / 2.0
    ones, others = np.nonzero((np.abs(turns) < MAX_DRIFT_RAD) & (echoes[:, None] >= MIN_LOCAL_ECHOES))
    turn, angle, offset = turns[ones, others], old.state.walls[others, 0], old.state.walls[others, 1]
    normal = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    # 2. About the centre of the last poses, so that the shift is that of the robot: d of n . d, to be on the line.
    arm = rotate(middles[ones] - centre, turn) + centre
    across = offset - (normal * arm).sum(axis=1)
    motions = [(turn, across[:, None] * normal)]
    i, j = np.nonzero(np.triu(np.abs(np.sin(angle[:, None] - angle)) > np.sin(MIN_CROSSING_RAD), 1))
    agree = (ones[i] != ones[j]) & (np.abs(turn[i] - turn[j]) < NEAR_RAD)
    i, j = i[agree], j[agree]
    both = np.stack((normal[i], normal[j]), axis=1)
    mean = 0.5 * (turn[i] + turn[j])
    off = np.stack([
        offset[k] - (normal[k] * (rotate(middles[ones[k]] - centre, mean) + centre)).sum(axis=1) for k in (i, j)
    ], axis=-1)  # fmt: skip
    motions.append((mean, np.linalg.solve(both, off[..., None])[..., 0]))
    turn, shift = np.concatenate([one for one, _ in motions]), np.concatenate([one for _, one in motions])
    near = np.hypot(*shift.T) < MAX_DRIFT_IN
    turn, shift = turn[near], shift[near]
    # 3. Those first whose walls with the most echoes lie on old ones.
    weight = np.zeros(len(turn))
    low, high = old.extents.T
    for number in np.flatnonzero(echoes >= MIN_LOCAL_ECHOES):
        place = rotate(middles[number] - centre, turn) + centre + shift
        along, off_line = along_and_across(place, old.state.walls)
        turned = np.abs(np.sin(local.state.walls[number, 0] + turn[:, None] - old.state.walls[:, 0]))
        fits = (np.abs(off_line) < NEAR_IN) & (turned < np.sin(NEAR_RAD))
        fits &= (along > low - MIN_BASE_IN) & (along < high + MIN_BASE_IN)
        weight += echoes[number] * fits.any(axis=1)
    best = np.argsort(-weight, kind="stable")[:RATED_MOTIONS]
    back = rotate(np.broadcast_to(centre, (len(turn), 2)), turn)
    return [(float(turn[row]), centre + shift[row] - back[row]) for row in best]


def _relocated(estimate: MapEstimate, start: int, turn: float, shift: Floats) -> MapEstimate:
    """Return the map with the poses from a node on moved, and without the walls of their own, optimized."""
    remaining = _measured_before(estimate, start)
    trial = _without(estimate, remaining)
    poses = trial.state.poses.copy()
    count = len(poses) - start
    poses[start:, :2] = rotate(poses[start:, :2], np.full(count, turn)) + shift
    poses[start:, HEADING] += turn
    trial.state = replace(trial.state, poses=poses)
    # By plain least squares the odometry of the whole loop takes up the motion.
    trial.associate(start)
    trial.optimize(JOIN_STEPS, robust=False)
    for _ in range(2):
        trial.optimize(4)
        trial.associate(start)
    find_births(trial, start)
    trial.associate()
    trial.optimize(4)
    trial.associate()
    return trial
