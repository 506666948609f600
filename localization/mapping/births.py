"""New walls and points from echoes that nothing explains yet.

    1. votes      each echo votes for all walls tangent to its arc, and for all points on it (Hough transform)
    2. fit        the peak's supporters, by reweighted least squares with the poses fixed
    3. decision   wall or point, by the cost of both on the supporters of both

A robot that stands sees the same arc from either; the decision needs a base over which they differ.

References
----------
Tardos, Neira, Newman, Leonard, Robust Mapping and Localization in Indoor Environments Using Sonar Data (2002): the
Hough transform of sonar arcs for lines and points. Duda, Hart, Use of the Hough Transformation (1972).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

from localization.filters.belief import Floats, wrap_angle
from localization.mapping.association import MAX_OFF_AXIS_RAD, MapEstimate, Mask, is_blocked
from localization.mapping.measurements import Indices
from localization.mapping.problem import (
    NO_FEATURE,
    RangePrediction,
    Sensors,
    predict_point,
    predict_wall,
    robust_weight,
    sensors_at,
)

ANGLE_CELL_RAD: Final = radians(2.0)
OFFSET_CELL_IN: Final = 1.5
POINT_CELL_IN: Final = 2.0
FAN: Final = np.arange(-6, 7) * ANGLE_CELL_RAD
"""Directions within the cone for which an echo votes."""
MIN_VOTES: Final = 6
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

    def __len__(self) -> int:
        """Return their number."""
        return len(self.std_in)

    def some(self, at: Mask) -> FreeEchoes:
        """Return some of them."""
        s = self.sensors
        return FreeEchoes(Sensors(s.face[at], s.arm[at], s.axis[at], s.range_in[at]), self.std_in[at], self.rays)


def find_births(estimate: MapEstimate, first_node: int) -> int:
    """Add the walls and points that unexplained echoes since a node show, and return their number."""
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
            fit, found_wall, used = _decide(remaining, feature, is_wall)
            if not used.any():
                break
            left[numbers[used]] = False
            if fit is None:
                continue
            born += 1
            if found_wall:
                feet = predict_wall(remaining.sensors, fit.feature[None], free.rays).foot[fit.supports]
                estimate.add_wall(fit.feature, np.array((feet.min(), feet.max())))
            else:
                estimate.add_point(fit.feature)
        # 3. Echoes that the new walls explain vote for no points.
        if born:
            estimate.associate(first_node)
            echoes = echoes[estimate.assignment.feature[echoes] == NO_FEATURE]
            free = _free_echoes(estimate, echoes)
    return born


def find_masked_walls(estimate: MapEstimate) -> list[tuple[Floats, Floats]]:
    """Return walls (2,) and their extents (2,) that unexplained echoes and echoes of points show together.

    A point that was born of a part of a wall's echoes explains these, and the others are too few to tell a wall from
    another point. Points in which two walls meet are what they seem.
    """
    walls, points = len(estimate.state.walls), len(estimate.state.points)
    ties = np.bincount(estimate.assignment.ties[:, 0], minlength=points)[:points]
    masking = walls + np.flatnonzero(ties < 2)
    echoes = estimate.echoes()
    assigned = estimate.assignment.feature[echoes]
    free = _free_echoes(estimate, echoes[(assigned == NO_FEATURE) | np.isin(assigned, masking)])
    left, found = np.ones(len(free), dtype=np.bool_), []
    for _ in range(MAX_CANDIDATES):
        if left.sum() < MIN_VOTES:
            break
        numbers, remaining = np.flatnonzero(left), free.some(left)
        feature, _, votes = _wall_peak(remaining)
        if votes < MIN_VOTES:
            break
        fit = _fit(remaining, feature, True)
        if not fit.supports.any():
            break
        left[numbers[fit.supports]] = False
        if fit.supports.sum() >= MIN_VOTES and fit.base_in >= MIN_BASE_IN:
            feet = predict_wall(remaining.sensors, fit.feature[None], free.rays).foot[fit.supports]
            found.append((fit.feature, np.array((feet.min(), feet.max()))))
    return found


def _free_echoes(estimate: MapEstimate, echoes: Indices) -> FreeEchoes:
    """Return unexplained echoes, without those from behind a wall of the map."""
    trajectory, state = estimate.problem.trajectory, estimate.state
    sensors = sensors_at(state.poses, state.parameters, trajectory, echoes)
    free = FreeEchoes(sensors, trajectory.std_in[echoes], estimate.problem.rays)
    along = np.stack((np.cos(sensors.axis), np.sin(sensors.axis)), axis=-1)
    spots = sensors.face + sensors.range_in[:, None] * along
    blocked = is_blocked(sensors.face, spots, estimate.blocking)
    return free.some(~blocked)


# Votes.


def _wall_peak(free: FreeEchoes) -> tuple[Floats, bool, int]:
    """Return the wall (2,) with the most votes, True, and their number."""
    s = free.sensors
    fan = FAN if not free.rays else FAN * 3.0
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
    fan = s.axis[:, None] + (FAN if not free.rays else np.zeros(1))
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
        in_cone = np.abs(wrap_angle(predicted.bearing - sensors.axis)) < MAX_OFF_AXIS_RAD
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


def _decide(free: FreeEchoes, feature: Floats, is_wall: bool) -> tuple[Fit | None, bool, Mask]:
    """Return the fit of the better kind or None if undecided, True for a wall, and the echoes that are used up."""
    # 1. The kind that the peak is of, then the other one from the same echoes.
    first = _fit(free, feature, is_wall)
    if first.supports.sum() < MIN_VOTES:
        predicted = _predict(free, feature, is_wall)
        near = np.abs(free.sensors.range_in - predicted.range_in) < SUPPORT_IN
        return None, is_wall, near & (np.abs(wrap_angle(predicted.bearing - free.sensors.axis)) < MAX_OFF_AXIS_RAD)
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
    return None, is_wall, first.supports


def _spots(free: FreeEchoes, fit: Fit, is_wall: bool) -> Floats:
    """Return the reflecting spots (e, 2) of a fitted feature."""
    if not is_wall:
        return np.broadcast_to(fit.feature, (len(free), 2))
    c, s = np.cos(fit.feature[0]), np.sin(fit.feature[0])
    feet = _predict(free, fit.feature, True).foot
    return np.stack((c * fit.feature[1] - s * feet, s * fit.feature[1] + c * feet), axis=-1)
