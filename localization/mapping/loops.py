"""Loops: features that the robot measures again when it comes back, and has not recognized.

    1. pairs        an old feature, and a new one of its kind that was measured only after it
    2. hypotheses   rigid motions that bring two new features onto old ones, and how many others they bring there
    3. trial        one feature for each pair of the best ones, optimized with the odometry of the whole loop
    4. test         the total cost falls, and the odometry of no loop contradicts the pairs (joint compatibility)

One pair may agree by chance, many together hardly do. The joint compatibility is tested after the optimization: before,
echoes that were taken for those of old features make the map more certain than it is, and wrong by 16 in.

References
----------
Neira, Tardos, Data Association in Stochastic Mapping Using the Joint Compatibility Test (2001). Fischler, Bolles,
Random Sample Consensus (1981): hypotheses by few pairs, here by all.
"""

from __future__ import annotations

from dataclasses import replace
from math import radians
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import HEADING, Floats, wrap_angle
from localization.mapping.association import MapEstimate, segments_of
from localization.mapping.births import MIN_DIFFERENCE
from localization.mapping.consistency import check_parts
from localization.mapping.measurements import Indices, rotate

MAX_DRIFT_IN, MAX_DRIFT_RAD = 60.0, radians(20.0)
"""Farther off, a place is not recognized."""
MIN_LEFT_NODES: Final = 40
"""Half of an old feature's echoes were measured 20 s or more before a new one's."""
MIN_PAIRS: Final = 4
"""Features that must agree."""
MIN_BASE_IN: Final = 12.0
"""Distance of two points from which they give a direction."""
NEAR_IN, NEAR_RAD = 4.0, radians(4.0)
"""Two features agree that are nearer than this, after the motion."""
MAX_TRIALS: Final = 3
JOIN_STEPS: Final = 8


class _Motion(NamedTuple):
    """A rigid motion, and the pairs (k, 2) of an old and a new feature that it brings together."""

    turn: float
    shift: Floats
    pairs: Indices
    error: float


def close_loops(estimate: MapEstimate, first_node: int = 0) -> int:
    """Join new features, measured only since a node, with old ones where the total cost falls; return their number."""
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
    found = [
        (old, new)
        for new in np.flatnonzero((begins >= first_node) & np.isfinite(begins))
        for old in np.flatnonzero(middles + MIN_LEFT_NODES < begins[new])
        if (old < walls) == (new < walls)
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
    points, motions = np.flatnonzero(~is_wall), list[tuple[float, Floats]]()
    for number, one in enumerate(points):
        others = points[number + 1 :]
        a, b = middles[old[others]] - middles[old[one]], middles[new[others]] - middles[new[one]]
        lengths, new_lengths = np.hypot(*a.T), np.hypot(*b.T)
        turns = wrap_angle(np.arctan2(a[:, 1], a[:, 0]) - np.arctan2(b[:, 1], b[:, 0]))
        fits = (np.abs(lengths - new_lengths) < NEAR_IN) & (lengths > MIN_BASE_IN) & (np.abs(turns) < MAX_DRIFT_RAD)
        by_walls = wrap_angle(2.0 * (angles[old[is_wall]] - angles[new[is_wall]])) / 2.0
        for turn in (*turns[fits], *by_walls[np.abs(by_walls) < MAX_DRIFT_RAD]):
            motions.append((float(turn), middles[old[one]] - rotate(middles[new[one]], np.array(turn))))
    found = [_supported(estimate, pairs, middles, segments, *motion) for motion in motions]
    enough = [motion for motion in found if len(motion.pairs) >= MIN_PAIRS]
    # 2. The best of each set of pairs.
    best: dict[bytes, _Motion] = {}
    for motion in sorted(enough, key=lambda motion: (-len(motion.pairs), motion.error)):
        best.setdefault(motion.pairs.tobytes(), motion)
    return list(best.values())


def _supported(
    estimate: MapEstimate, pairs: Indices, middles: Floats, segments: Floats, turn: float, shift: Floats
) -> _Motion:
    """Return a motion with the pairs that it brings together: the nearest old feature of each new one."""
    state, count = estimate.state, len(estimate.state.walls)
    old, new = pairs.T
    moved = rotate(middles[new], np.full(len(new), turn)) + shift
    off = moved - middles[old]
    error = np.hypot(*off.T)
    # 1. Walls: across the old one, side by side with it, and in its direction.
    walls = old < count
    angle = state.walls[old[walls], 0]
    normal = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    half = 0.5 * np.hypot(*(segments[old[walls], 1] - segments[old[walls], 0]).T)
    along = np.abs(off[walls, 1] * normal[:, 0] - off[walls, 0] * normal[:, 1])
    turned = wrap_angle(2.0 * (state.walls[new[walls], 0] + turn - angle)) / 2.0
    across = np.abs((off[walls] * normal).sum(axis=1))
    error[walls] = np.where((along < half + NEAR_IN) & (np.abs(turned) < NEAR_RAD), across, np.inf)
    # 2. Within the drift; each feature in one pair.
    near = np.hypot(*(moved - middles[new]).T) < MAX_DRIFT_IN
    rows, used_old, used_new = list[int](), set[int](), set[int]()
    for row in np.argsort(error):
        if error[row] > NEAR_IN:
            break
        if near[row] and old[row] not in used_old and new[row] not in used_new:
            rows.append(int(row))
            used_old.add(int(old[row]))
            used_new.add(int(new[row]))
    rows.sort()
    return _Motion(turn, shift, pairs[rows], float(error[rows].sum()))


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
    trial.state = replace(state, poses=poses, walls=lines, points=points)
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
