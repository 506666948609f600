"""Which walls of a map are one, and which are two.

Each change is tried, optimized and reverted unless the total cost, with a penalty for each feature, falls:

    merge    two nearly equal walls become one, unless they may be the faces of a thick wall
    open     a wall that was measured from one side returns echoes to the other one as well
    split    a line with a wide gap becomes two walls, or the longest part of it

References
----------
Schwarz, Estimating the Dimension of a Model (1978): penalty of (unknowns) ln(echoes), here two unknowns more for the
choice of the echoes.
"""

from __future__ import annotations

from dataclasses import replace
from math import log, radians
from typing import Final

import numpy as np

from localization.filters.belief import Floats, wrap_angle
from localization.mapping.association import MIN_THICKNESS_IN, SIDED, MapEstimate
from localization.mapping.features import MIN_BASE_IN, MIN_DIFFERENCE
from localization.mapping.problem import NO_FEATURE, WALL, sensors_at
from localization.mapping.reflectors import residual_matrix, segments_of, sides_of
from worlds.geometry import nearest_points_of_pairs

MERGE_RAD: Final = radians(20.0)
MERGE_IN: Final = 8.0
"""Walls that differ by less may be the same wall."""
JOIN_STEPS: Final = 6
"""Steps of plain least squares that bring the echoes of two walls onto one line, far as they may be."""
FACE_SIGMAS: Final = 2.0
"""Standard deviations by which the thickness of a wall must be less to make one of two faces."""
PRIOR_INFORMATION: Final = 1e-6
CHOICE_COST: Final = 2.0 * log(2.0)
"""Twice the negative logarithm of the probability of one of two walls."""
MERGE_GAP_IN: Final = 40.0
"""Of walls on one line, the widest gap between them: more than a door."""


def merge(estimate: MapEstimate, *, with_faces: bool = True) -> int:
    """Merge pairs of features where the total cost falls, and return their number.

    Without faces, walls that were measured from opposite sides remain two.
    """
    merged = 0
    tried: set[tuple[int, int]] = set()
    while (pair := next((pair for pair in _merge_pairs(estimate, with_faces) if pair not in tried), None)) is not None:
        tried.add(pair)
        if _try_merge(estimate, *pair):
            merged, tried = merged + 1, set()
    return merged


def _merge_pairs(estimate: MapEstimate, with_faces: bool = True) -> list[tuple[int, int]]:
    """Return pairs of walls, and of a wall and a point on it, that may be one feature: (remaining, removed)."""
    state = estimate.state
    sizes = [len(estimate.echoes_of(number)) for number in range(len(state.walls))]
    segments = segments_of(state.walls, estimate.extents)
    turns = np.abs(wrap_angle(2.0 * (state.walls[:, None, 0] - state.walls[:, 0]))) / 2.0
    near = [
        (one, other) for one, other in np.argwhere(np.triu(turns < MERGE_RAD, 1)).tolist()
        if _is_near(segments[one], segments[other])
    ]  # fmt: skip
    if not near:
        return []
    information = None
    if with_faces:
        information, _ = estimate.problem.normal_equations(state, estimate.assignment).reduced()
    return [
        (one, other) if sizes[one] >= sizes[other] else (other, one)
        for one, other in near if not _may_be_faces(estimate, one, other, information)
    ]  # fmt: skip


def _is_near(one: Floats, other: Floats) -> bool:
    """Return True if a segment (4,) lies within MERGE_IN of the line of another, and not beyond MERGE_GAP_IN."""
    along = (one[2:] - one[:2]) / max(float(np.hypot(*(one[2:] - one[:2]))), 1e-9)
    off = other.reshape(2, 2) - one[:2]
    across = np.abs(off @ np.array((-along[1], along[0])))
    ends = np.concatenate((other.reshape(2, 2), one.reshape(2, 2)))
    walls = np.stack((one, one, other, other))
    gap = nearest_points_of_pairs(ends, walls)[1].min()
    return bool(across.min() < MERGE_IN and across.mean() < 1.5 * MERGE_IN and gap < MERGE_GAP_IN)


def _may_be_faces(estimate: MapEstimate, one: int, other: int, information: Floats | None) -> bool:
    """Return True if two lines, each measured from its own side, may be the faces of a thick wall.

    Their distance is known by the odometry on the way from one side to the other. Unless it excludes a thickness of
    MIN_THICKNESS_IN they remain two: a single wall would fold the rooms on both sides together by its thickness.

    Parameters
    ----------
    estimate, one, other
        The map, and the numbers of two walls.
    information
        (m, m) of walls, points, parameters and levels, with the poses eliminated; without it all opposite sides count.
    """
    angles = estimate.state.walls[[one, other], 0]
    sides = [_side_of(estimate, wall) for wall in (one, other)]
    if min(np.abs(sides)) < SIDED or sides[0] * sides[1] * np.cos(angles[0] - angles[1]) > 0.0:
        return False
    # What `open_faces` has opened is no face.
    if estimate.surface_in and not estimate.sides[[one, other]].all():
        return False
    if information is None:
        return True
    thickness, std_in = _thickness(estimate, one, other, information)
    return thickness + FACE_SIGMAS * std_in > MIN_THICKNESS_IN


def _thickness(estimate: MapEstimate, one: int, other: int, information: Floats) -> tuple[float, float]:
    """Return how far two faces are apart, positive if their sonars are outside, and the deviation of this, inches."""
    walls, segments = estimate.state.walls[[one, other]], segments_of(estimate.state.walls, estimate.extents)
    c, s = np.cos(walls[:, 0]), np.sin(walls[:, 0])
    # 1. Between the middles of both.
    x, y = segments[[one, other]].reshape(4, 2).mean(axis=0)
    sign = np.sign([_side_of(estimate, wall) for wall in (one, other)])
    thickness = float(sign @ (walls[:, 1] - c * x - s * y))
    # 2. By its derivatives. What nothing determines has a deviation of 1 / PRIOR_INFORMATION**0.5.
    by_unknowns = np.zeros(len(information))
    for wall, by_angle, by_offset in zip((one, other), sign * (s * x - c * y), sign, strict=True):
        by_unknowns[WALL * wall : WALL * (wall + 1)] = by_angle, by_offset
    information = information + PRIOR_INFORMATION * np.eye(len(information))
    return thickness, float(by_unknowns @ np.linalg.solve(information, by_unknowns)) ** 0.5


def _side_of(estimate: MapEstimate, wall: int) -> float:
    """Return the mean side from which a wall was measured: 1 or -1 for a face, 0 without echoes."""
    state, echoes = estimate.state, estimate.echoes_of(wall)
    face = sensors_at(state.poses, state.parameters, estimate.problem.trajectory, echoes).face
    return float(sides_of(face, state.walls[wall : wall + 1]).mean()) if len(echoes) else 0.0


def _try_merge(estimate: MapEstimate, remaining: int, removed: int) -> bool:
    """Merge two walls if the total cost falls; return True if it did.

    Each echo takes the nearer one of two lines, which explain noise better than a single one does. So one that either
    may explain costs CHOICE_COST more: it is of one of two equally probable components of a mixture.
    """
    trial = _merged(estimate, remaining, removed)
    echoes = np.concatenate((estimate.echoes_of(remaining), estimate.echoes_of(removed)))
    residual, _, _ = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
    choices = int(np.isfinite(residual[:, [remaining, removed]]).all(axis=1).sum())
    if trial.cost >= estimate.cost + CHOICE_COST * choices:
        return False
    estimate.replace_by(trial)
    return True


def _merged(estimate: MapEstimate, remaining: int, removed: int) -> MapEstimate:
    """Return the map with one wall in place of two."""
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
    # It may have been measured from both sides, unless both were measured from the same one.
    angles = trial.state.walls[[remaining, removed], 0]
    is_same = trial.sides[remaining] * trial.sides[removed] * np.cos(angles[0] - angles[1]) > 0.0
    if not is_same:
        trial.sides = np.where(np.arange(len(trial.sides)) == remaining, 0.0, trial.sides)
    trial.remove(removed)
    # 2. Optimized with the echoes of both by plain least squares, as robust weights would leave out those of the
    # removed one where the map is bent; then with those that it explains.
    trial.optimize(JOIN_STEPS, robust=False)
    trial.optimize(3)
    trial.associate()
    trial.optimize(3)
    # What the longer wall hides counts against it.
    trial.associate()
    return trial


def find_undecided(estimate: MapEstimate) -> list[tuple[int, int]]:
    """Return pairs of walls side by side that may as well be one: their echoes do not decide it.

    Both maps cost the same within MIN_DIFFERENCE, and have another topology. Two walls one after the other are the
    same map, however many they are. Walls without echoes, such as the ends of others, are left out: they cost nothing.
    """
    estimate = estimate.copy()
    sizes = [len(estimate.echoes_of(wall)) for wall in range(len(estimate.state.walls))]
    numbers = np.flatnonzero(sizes)
    for wall in reversed(np.flatnonzero(np.array(sizes) == 0).tolist()):
        estimate.remove(wall)
    segments = segments_of(estimate.state.walls, estimate.extents)
    return [
        (int(numbers[one]), int(numbers[other]))
        for one, other in _merge_pairs(estimate)
        if overlap_in(segments[one], segments[other]) > MIN_BASE_IN
        and _merged(estimate, one, other).cost < estimate.cost + MIN_DIFFERENCE
    ]


def overlap_in(one: Floats, other: Floats) -> float:
    """Return the length that two segments (4,) have in common along the first one."""
    along = one[2:] - one[:2]
    length = max(float(np.hypot(*along)), 1e-9)
    low, high = np.sort((other.reshape(2, 2) - one[:2]) @ along / length)
    return float(min(high, length) - max(low, 0.0))


def split(estimate: MapEstimate) -> int:
    """Replace lines with a wide gap by a wall for each part, or by the longest part; return their number.

    A line that leads by chance along a part of two walls explains both a little worse than their own lines do.
    """
    divided = 0
    for wall in range(len(estimate.state.walls)):
        runs = estimate.runs[estimate.runs[:, 0] == wall, 1:]
        if len(runs) < 2:
            continue
        best = min((estimate, _parted(estimate, wall, runs), _parted(estimate, wall, runs, only_longest=True)),
                   key=lambda candidate: candidate.cost)  # fmt: skip
        if best is not estimate:
            estimate.replace_by(best)
            divided += 1
    return divided


def split_surfaces(estimate: MapEstimate) -> None:
    """Replace walls with levels that have a wide gap by one for each part.

    Levels are independent across a gap, so one line through both parts would be the line of neither.
    """
    if not estimate.surface_in:
        return
    for wall in range(len(estimate.state.walls)):
        runs = estimate.runs[estimate.runs[:, 0] == wall, 1:]
        if len(runs) > 1:
            estimate.replace_by(_parted(estimate, wall, runs))


def _parted(estimate: MapEstimate, wall: int, runs: Floats, *, only_longest: bool = False) -> MapEstimate:
    """Return the map with a wall for each part (r, 2) of one, or for the longest one alone."""
    trial = estimate.copy()
    order = np.argsort(runs[:, 0] - runs[:, 1])
    line, echoes = trial.state.walls[wall], trial.echoes_of(wall)
    _, _, spots = residual_matrix(trial.problem, trial.state, trial.extents, echoes)
    feet = spots[:, wall] @ np.array((-np.sin(line[0]), np.cos(line[0])))
    # 1. Each part gets the echoes nearest to it.
    off = np.maximum(np.maximum(runs[:, 0] - feet[:, None], feet[:, None] - runs[:, 1]), 0.0)
    nearest = off.argmin(axis=1)
    trial.narrow(wall, runs[order[0]])
    numbers = np.full(len(runs), NO_FEATURE, dtype=np.intp)
    numbers[order[0]] = wall
    for part in order[1:] if not only_longest else ():
        numbers[part] = len(trial.state.walls)
        trial.add_wall(line, runs[part], float(trial.sides[wall]))
    feature = trial.assignment.feature.copy()
    feature[echoes] = numbers[nearest]
    trial.assignment = replace(trial.assignment, feature=feature)
    # 2. Optimized with these, then with those that each explains.
    trial.optimize(JOIN_STEPS)
    for _ in range(2):
        trial.associate()
        trial.optimize(3)
    return trial


def open_faces(estimate: MapEstimate) -> int:
    """Let walls that were measured from one side return echoes to the other one where the cost falls by MIN_DIFFERENCE.

    A wall that is a face hides its points from behind, and takes no echo from there. What a robot then measures of a
    thin wall from its other side may be too little for a wall of its own, which would become one with the first. Only
    of walls with levels: of planes both faces are found, and a flat was folded by the thickness of a wall.

    Returns
    -------
    int
        The number of walls that are none of one side any more.
    """
    opened = 0
    for wall in np.flatnonzero(estimate.sides).tolist() if estimate.surface_in else ():
        if not estimate.sides[wall]:
            continue
        trial = estimate.copy()
        trial.sides = np.where(np.arange(len(trial.sides)) == wall, 0.0, trial.sides)
        trial.associate()
        # It is a face again if hardly an echo is from behind.
        if trial.sides[wall]:
            continue
        trial.optimize(3)
        trial.associate()
        if not trial.sides[wall] and trial.cost < estimate.cost - MIN_DIFFERENCE:
            estimate.replace_by(trial)
            opened += 1
    return opened
