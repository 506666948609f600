"""Revision of a map: features that are not worth their unknowns are removed, two that are one are merged.

    prune    a feature without which the echoes cost less than PENALTY more is removed
    merge    two nearly equal walls become one where the total cost falls
    swallow  a short wall becomes a point where the total cost falls
    absorb   a point on a wall becomes part of it where the total cost falls
    tie      points near a wall's line are corners or ends of it

Each change is tried, optimized and reverted unless the total cost falls: a choice between models by penalized
likelihood.

References
----------
Schwarz, Estimating the Dimension of a Model (1978): penalty of (unknowns) ln(echoes), here two unknowns more for the
choice of the echoes.
"""

from __future__ import annotations

from dataclasses import replace
from math import radians
from typing import Final

import numpy as np

from localization.filters.belief import Floats, wrap_angle
from localization.mapping.association import PENALTY, MapEstimate, assign, segments_of
from worlds.geometry import nearest_points_of_pairs

MERGE_RAD: Final = radians(12.0)
MERGE_IN: Final = 8.0
"""Walls that differ by less may be the same wall."""
MERGE_GAP_IN: Final = 40.0
"""Of walls on one line, the widest gap between them: more than a door."""
SWALLOW_IN: Final = 24.0
"""Walls seen over a shorter length may be a corner."""
TIE_IN: Final = 1.0
TIE_BEYOND_IN: Final = 6.0
"""A point within TIE_IN of a wall's line, and not farther beyond its end, lies on the wall."""


def prune(estimate: MapEstimate) -> int:
    """Remove features that save less than their penalty, the least useful first, and return their number."""
    removed = 0
    while estimate.state.features:
        losses = _losses(estimate)
        walls = len(estimate.state.walls)
        penalties = np.where(np.arange(len(losses)) < walls, PENALTY["wall"], PENALTY["point"])
        worst = int((losses - penalties).argmin())
        if losses[worst] >= penalties[worst]:
            break
        estimate.remove(worst)
        estimate.associate()
        removed += 1
    return removed


def _losses(estimate: MapEstimate) -> Floats:
    """Return by how much the cost of the echoes rises without each feature (f,)."""
    problem, state = estimate.problem, estimate.state
    losses = np.empty(state.features)
    for feature in range(state.features):
        echoes = estimate.echoes_of(feature)
        without = estimate.copy()
        without.remove(feature)
        _, now = assign(problem, state, estimate.extents, echoes)
        _, then = assign(problem, without.state, without.extents, echoes)
        losses[feature] = then.sum() - now.sum()
    return losses


def merge(estimate: MapEstimate) -> int:
    """Merge pairs of features where the total cost falls, and return their number."""
    merged = 0
    tried: set[tuple[int, int]] = set()
    while (pair := next((pair for pair in _merge_pairs(estimate) if pair not in tried), None)) is not None:
        tried.add(pair)
        if _try_merge(estimate, *pair):
            merged, tried = merged + 1, set()
    return merged


def swallow(estimate: MapEstimate) -> int:
    """Replace short walls by points where the total cost falls, and return their number.

    A line past a corner picks those of the corner's echoes whose noise suits it.
    """
    swallowed = 0
    for wall in reversed(range(len(estimate.state.walls))):
        low, high = estimate.extents[wall]
        if high - low > SWALLOW_IN:
            continue
        trial = estimate.copy()
        segment = segments_of(trial.state.walls, trial.extents)[wall]
        trial.remove(wall)
        trial.associate()
        without = trial.copy()
        # With a point in its place, and without.
        trial.add_point(segment.reshape(2, 2).mean(axis=0))
        for candidate in (trial, without):
            candidate.associate()
            candidate.optimize(3)
            candidate.associate()
            candidate.optimize(3)
        best = min((estimate, trial, without), key=lambda candidate: candidate.cost)
        if best is not estimate:
            _replace(estimate, best)
            swallowed += 1
    return swallowed


def absorb_points(estimate: MapEstimate) -> int:
    """Remove points on a wall's line that the wall explains as well, if it is seen as far; return their number."""
    absorbed = 0
    for number in reversed(range(len(estimate.state.points))):
        state = estimate.state
        walls, point = len(state.walls), state.points[number]
        c, s = np.cos(state.walls[:, 0]), np.sin(state.walls[:, 0])
        across = np.abs(point[0] * c + point[1] * s - state.walls[:, 1])
        along = point[1] * c - point[0] * s
        for wall in np.flatnonzero(across < TIE_IN + 2.0):
            low, high = estimate.extents[wall]
            if not low - MERGE_GAP_IN < along[wall] < high + MERGE_GAP_IN:
                continue
            # Its echoes are the wall's, which then reaches as far as the point.
            trial = estimate.copy()
            feature = np.where(trial.assignment.feature == walls + number, wall, trial.assignment.feature)
            extents = trial.extents.copy()
            extents[wall] = min(low, along[wall]), max(high, along[wall])
            trial.assignment, trial.extents = replace(trial.assignment, feature=feature), extents
            trial.remove(walls + number)
            trial.optimize(3)
            trial.associate()
            trial.optimize(3)
            if trial.cost < estimate.cost:
                _replace(estimate, trial)
                absorbed += 1
                break
    return absorbed


def _replace(estimate: MapEstimate, by: MapEstimate) -> None:
    """Take over another estimate."""
    estimate.state, estimate.assignment, estimate.extents = by.state, by.assignment, by.extents


def _merge_pairs(estimate: MapEstimate) -> list[tuple[int, int]]:
    """Return pairs of walls, and of a wall and a point on it, that may be one feature: (remaining, removed)."""
    state, count = estimate.state, len(estimate.state.walls)
    sizes = [len(estimate.echoes_of(number)) for number in range(state.features)]
    segments = segments_of(state.walls, estimate.extents)
    pairs = []
    for one in range(count):
        for other in range(one + 1, count):
            turn = abs(float(wrap_angle(2.0 * (state.walls[one, 0] - state.walls[other, 0])))) / 2.0
            if turn < MERGE_RAD and _is_near(segments[one], segments[other]):
                pairs.append((one, other) if sizes[one] >= sizes[other] else (other, one))
    return pairs


def _is_near(one: Floats, other: Floats) -> bool:
    """Return True if a segment (4,) lies within MERGE_IN of the line of another, and not beyond MERGE_GAP_IN."""
    along = (one[2:] - one[:2]) / max(float(np.hypot(*(one[2:] - one[:2]))), 1e-9)
    off = other.reshape(2, 2) - one[:2]
    across = np.abs(off @ np.array((-along[1], along[0])))
    ends = np.concatenate((other.reshape(2, 2), one.reshape(2, 2)))
    walls = np.stack((one, one, other, other))
    gap = nearest_points_of_pairs(ends, walls)[1].min()
    return bool(across.min() < MERGE_IN and across.mean() < 1.5 * MERGE_IN and gap < MERGE_GAP_IN)


def _try_merge(estimate: MapEstimate, remaining: int, removed: int) -> bool:
    """Merge two walls if the total cost falls; return True if it did."""
    trial = estimate.copy()
    feature = trial.assignment.feature.copy()
    feature[feature == removed] = remaining
    # 1. The extent covers both.
    ends = segments_of(trial.state.walls, trial.extents)[[remaining, removed]].reshape(-1, 2)
    angle = trial.state.walls[remaining, 0]
    coordinates = ends @ np.array((-np.sin(angle), np.cos(angle)))
    extents = trial.extents.copy()
    extents[remaining] = coordinates.min(), coordinates.max()
    trial.extents, trial.assignment = extents, replace(trial.assignment, feature=feature)
    trial.remove(removed)
    # 2. Optimized with the echoes of both, then with those that it explains.
    trial.optimize(3)
    trial.associate()
    trial.optimize(3)
    if trial.cost >= estimate.cost:
        return False
    _replace(estimate, trial)
    return True


def tie_points(estimate: MapEstimate) -> None:
    """Tie each point to the walls on whose lines it lies."""
    state, ties = estimate.state, []
    for number, point in enumerate(state.points):
        for wall, (angle, offset) in enumerate(state.walls):
            c, s = np.cos(angle), np.sin(angle)
            across, along = abs(c * point[0] + s * point[1] - offset), c * point[1] - s * point[0]
            low, high = estimate.extents[wall]
            if across < TIE_IN and low - TIE_BEYOND_IN - across < along < high + 48.0:
                ties.append((number, wall))
    estimate.assignment = replace(estimate.assignment, ties=np.array(ties, dtype=np.intp).reshape(-1, 2))
