"""Learn a map of walls from a drive without a map: the procedure.

    for every 16 nodes (8 s of driving)
        extend by odometry --> headings after turns --> associate --> optimize
        --> births from the unexplained echoes of the last 30 s --> associate --> optimize --> merge, prune
    at the end
        join what was not recognized; births from all echoes; part, join, merge, split, swallow, absorb, square, prune;
        tie points to walls; optimize
    once more in rounds of another size, if the map is poor or walls have levels (`learn_log`)

Revision makes the map as simple as its echoes allow. Each change is tried, optimized and reverted unless the total
cost, with a penalty for each feature, falls:

    prune    a feature without which the echoes cost less than PENALTY more is removed
    merge    two nearly equal walls become one where the total cost falls
    split    a line with a wide gap becomes two walls, or the longest part of it, where the total cost falls
    part     a point that looks different from two sides, or since a return, becomes two, where the total cost falls
    swallow  a short wall becomes a point where the total cost falls
    join     two points become the ends of a wall where the total cost falls
    absorb   a point on a wall becomes part of it where the total cost falls
    square   a wall with levels turns to the axes of the building where the total cost falls
    tie      points near a wall's line are corners or ends of it

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
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.filters.surface import SPOT_STD_IN
from localization.mapping.association import (
    LAG_NODES,
    MIN_THICKNESS_IN,
    PENALTY,
    SIDED,
    MapEstimate,
    Mask,
    align_heading,
    along_and_across,
    assign,
    is_blocked,
    residual_matrix,
    segments_of,
    sides_of,
    track,
    weigh_ranges,
)
from localization.mapping.consistency import late_scores
from localization.mapping.features import MIN_BASE_IN, MIN_DIFFERENCE, close_loops, find_births
from localization.mapping.measurements import DriveLog, Indices, build_trajectory, relative_pose
from localization.mapping.problem import (
    LEVEL_CELL_IN,
    NO_FEATURE,
    PARAMETER_STDS,
    PLANES,
    RIGHT_ANGLE_STD_RAD,
    ROBUST_LIMIT,
    WALL,
    Levels,
    MapProblem,
    Reflection,
    sensors_at,
)
from localization.mapping.spans import (
    MAX_SPAN_IN,
    MIN_CORNER_RAD,
    Span,
    cut_corners,
    find_wall_ends,
    pass_through,
    uncrossed_spans,
    walls_along,
)
from localization.mapping.walls import REACH_IN, extract_walls, free_paths, unpassed_gaps
from worlds.geometry import nearest_points_of_pairs

NODES_PER_ROUND: Final = 16
OTHER_NODES, LEVEL_NODES = 12, 24
"""Nodes of a round that are tried as well where the map is poor, or where walls have levels: an early mistake of one is
none of the other."""
POOR_MISFIT: Final = 0.68
"""Misfit of a finished map that is learned once more. Sound ones of flats have 0.50 to 0.66, one of 26 had 0.71, and
one whose rooms were folded by the thickness of a wall 0.72."""
TRACKED_NODES: Final = 2
WINDOW_NODES: Final = 60
"""Nodes whose echoes may give birth to features: beyond 30 s the odometry has drifted too far for a Hough cell."""
LOOP_WINDOW_NODES: Final = 60
"""Features that are older by this are tried as new ones of a loop as well: several are needed."""
LAST_ROUNDS: Final = 3
LAST_STEPS: Final = 10
ROUGHNESS_IN: Final = 0.15
"""Deviation of smooth walls from a straight line, and random motion within a node."""
LEVEL_ROUGHNESS_IN: Final = SPOT_STD_IN
"""Deviation of the surface of a real wall from its levels."""

MAX_TURN_RAD: Final = radians(15.0)
"""A wall that is off the axes by more is meant to be."""
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
SWALLOW_IN: Final = 40.0
"""Walls seen over a shorter length may be a corner."""
DIVIDERS_RAD: Final = np.linspace(0.0, np.pi, 12, endpoint=False)
"""Normals of the lines that are tried."""
MIN_PART_ECHOES: Final = 5
PART_PENALTY: Final = 15.0
"""Of the second of two points that were one until late: 2 ln(200 echoes), and the choice of one of so many points."""
MIN_LATE_SCORE: Final = 0.5 * PART_PENALTY
"""Least score of a point for which two are tried: the robust weights of what is far off lower it."""
MIN_PART_GAIN: Final = 0.6 * PENALTY["point"]
"""Least fall of the sum of squares for which two points are tried: other echoes than their own fit better, too."""
HIDDEN_FRACTION: Final = 0.5
"""Of a wall's echoes; the false ones in the corner of a wedge had 0.9."""
NICHE_IN: Final = 12.0
"""Doors and windows stand back less from their wall."""
MIN_DETERMINED: Final = 2
"""Ranges and ties that determine the two unknowns of a feature."""
MIN_JOIN_ECHOES: Final = 4
"""Echoes that must support a wall between two points, unless no sound passes where it should."""
JOINED_PENALTY: Final = 15.0
"""Of a wall between two points, which has no unknowns of its own."""
POINT_ON_WALL_IN: Final = 2.5
ABSORB_LOSS: Final = 4.0 * PENALTY["point"]
"""If a point's echoes cost so much more on the wall, the map is not optimized without it: that could hardly pay."""
TIE_IN: Final = 1.0
TIE_BEYOND_IN: Final = 6.0
"""A point within TIE_IN of a wall's line, and not farther beyond its end, lies on the wall."""


class MapLearner:
    """The estimator of one drive: `advance` takes the next nodes into account, `finish` revises the whole map.

    Parameters
    ----------
    log
        The drive.
    noise
        Random errors of the odometry.
    sonar
        Noise and limits of the readings.
    rays
        True if sonars measure along exact rays.
    roughness_in
        Standard deviation of the walls' surfaces from straight lines; None: see `reflection_of`.
    nodes_per_round
        Nodes that `advance` adds.
    scale_stds
        Prior standard deviations of the first of distance scale, turn scale and drift; the others have PARAMETER_STDS.
    """

    def __init__(
        self,
        log: DriveLog,
        noise: OdometryNoise,
        sonar: ConeSonar,
        *,
        rays: bool = False,
        roughness_in: float | None = None,
        nodes_per_round: int = NODES_PER_ROUND,
        scale_stds: tuple[float, ...] = (),
    ) -> None:
        self._noise, self._sonar, self._nodes_per_round = noise, sonar, nodes_per_round
        roughness_in, reflection = reflection_of(sonar, roughness_in)
        self.trajectory = build_trajectory(log, noise, sonar, roughness_in, rays=rays)
        stds = (*scale_stds, *PARAMETER_STDS[len(scale_stds) :])
        problem = MapProblem(
            self.trajectory, len(log.angles_rad), rays=rays, parameter_stds=stds, reflection=reflection
        )
        self.estimate = MapEstimate.start(problem)
        self.turret_rad = float(log.encoders[-1, 4] - log.encoders[-1, 3])
        """Angle of the turret from the heading at the end."""
        self.rest = relative_pose(self.trajectory.odometry[-1], log.encoders[-1, 1:4])
        """Motion after the last node, by the encoders."""

    @property
    def is_complete(self) -> bool:
        """True once all nodes are in the map."""
        return len(self.estimate.state.poses) == len(self.trajectory)

    def advance(self) -> None:
        """Add the next nodes."""
        estimate = self.estimate
        before = len(estimate.state.poses)
        count = min(before + self._nodes_per_round, len(self.trajectory))
        window = max(count - WINDOW_NODES, 0)
        # 1. Where the robot is, by the features so far, in small steps: the odometry of 8 s may lead to another wall.
        for known in range(before, count, TRACKED_NODES):
            first, last = max(known - LAG_NODES, 0), min(known + TRACKED_NODES, count)
            stretch = track(estimate, self.trajectory.part(first, last), estimate.state.poses[first:], self._noise)
            poses = np.concatenate((estimate.state.poses[:first], stretch.state.poses))
            estimate.state = replace(estimate.state, poses=poses)
        align_heading(estimate, before - self._nodes_per_round // 2, self._noise)
        update_features(estimate, window)

    def finish(self) -> None:
        """Revise the map with all echoes."""
        close_loops(self.estimate)
        for _ in range(LAST_ROUNDS):
            if not revise(self.estimate):
                break
        if find_births(self.estimate, 0, with_doubtful=True):
            self.estimate.associate()
            self.estimate.optimize()
            merge(self.estimate)
            prune(self.estimate)
        square(self.estimate)
        drop_hidden(self.estimate)
        drop_corner_cuts(self.estimate)
        tie_points(self.estimate)
        # With the weights of its ranges and first echoes, and without those that the map then explains no more.
        self.estimate.expects_first_echoes = True
        for _ in range(2):
            weigh_ranges(self.estimate, self._sonar)
            self.estimate.optimize(LAST_STEPS)
            self.estimate.associate()
        # Walls that were two by the weights of before.
        if merge(self.estimate):
            tie_points(self.estimate)
            self.estimate.optimize(LAST_STEPS)
            self.estimate.associate()
        if drop_unmeasured(self.estimate):
            tie_points(self.estimate)
        split_surfaces(self.estimate)
        close_wall_ends(self.estimate)


def reflection_of(sonar: ConeSonar, roughness_in: float | None) -> tuple[float, Reflection]:
    """Return the roughness of walls, and how they reflect.

    With a given roughness walls are planes that are so rough everywhere. By default those of sonars in a building have
    levels, and LEVEL_ROUGHNESS_IN on each; others have ROUGHNESS_IN.
    """
    if roughness_in is None and sonar.surface_std_in:
        return LEVEL_ROUGHNESS_IN, Reflection.of(sonar)
    return ROUGHNESS_IN if roughness_in is None else roughness_in, PLANES


def revise(estimate: MapEstimate) -> int:
    """Add, join, merge and remove features by all echoes, optimize, and return the number of changes."""
    changed = find_births(estimate, 0)
    estimate.associate()
    estimate.optimize()
    for change in (part_points, part_late_points, join_points, merge, split, swallow, absorb_points, square, prune):
        changed += change(estimate)
    tie_points(estimate)
    estimate.optimize()
    estimate.associate()
    return changed


def update_features(estimate: MapEstimate, first_node: int) -> None:
    """Optimize everything, and add, merge and remove features by the echoes of the nodes since one."""
    estimate.associate(first_node)
    estimate.optimize()
    # 1. New features.
    estimate.associate(first_node)
    if find_births(estimate, first_node):
        estimate.associate(first_node)
        estimate.optimize()
    # 2. Revision.
    if merge(estimate, with_faces=False) + prune(estimate, first_node):
        estimate.optimize()
    # 3. Places that were not recognized.
    if close_loops(estimate, first_node - LOOP_WINDOW_NODES) and merge(estimate, with_faces=False) + prune(estimate):
        estimate.optimize()


def learn_log(
    log: DriveLog,
    noise: OdometryNoise,
    sonar: ConeSonar,
    *,
    rays: bool = False,
    roughness_in: float | None = None,
    scale_stds: tuple[float, ...] = (),
) -> MapLearner:
    """Return the learner of a drive after its end; see `MapLearner` for the parameters.

    Where walls have levels, or the map is poor, the drive is learned once more, in rounds of another size: early
    mistakes are others then. The cheaper map is taken.
    """
    has_levels = reflection_of(sonar, roughness_in)[1] is not PLANES

    def learned(nodes: int) -> MapLearner:
        learner = MapLearner(
            log, noise, sonar, rays=rays, roughness_in=roughness_in, scale_stds=scale_stds, nodes_per_round=nodes
        )
        while not learner.is_complete:
            learner.advance()
        learner.finish()
        return learner

    first = learned(NODES_PER_ROUND)
    # What is poor is known of smooth walls alone.
    is_poor = roughness_in is None and first.estimate.misfit > POOR_MISFIT
    if not has_levels and not is_poor:
        return first
    second = learned(LEVEL_NODES if has_levels else OTHER_NODES)
    return min((first, second), key=_cost_by_readings)


def _cost_by_readings(learner: MapLearner) -> float:
    """Return the cost of a map with the weights that ranges have before there is one: the same for all maps."""
    estimate = learner.estimate.copy()
    estimate.problem = estimate.problem.with_trajectory(learner.trajectory)
    return estimate.cost


def learn_map(
    log: DriveLog, noise: OdometryNoise, sonar: ConeSonar, *, rays: bool = False, roughness_in: float | None = None
) -> MapEstimate:
    """Return the map of a drive; see `MapLearner` for the parameters."""
    return learn_log(log, noise, sonar, rays=rays, roughness_in=roughness_in).estimate


# Revision.


def prune(estimate: MapEstimate, first_node: int = 0) -> int:
    """Remove features that save less than their penalty, the least useful first, and return their number.

    Only those that were measured since a node: of the others nothing has changed.
    """
    removed = 0
    while estimate.state.features:
        losses = _losses(estimate, first_node)
        walls = len(estimate.state.walls)
        penalties = np.where(np.arange(len(losses)) < walls, PENALTY["wall"], PENALTY["point"])
        penalties[:walls][_have_ends(estimate)] = JOINED_PENALTY
        penalties[:walls] += estimate.surface_costs
        penalties[:walls][_are_spans(estimate)] = 0.0
        worst = int((losses - penalties).argmin())
        if losses[worst] >= penalties[worst]:
            break
        estimate.remove(worst)
        estimate.associate()
        removed += 1
    return removed


def _are_spans(estimate: MapEstimate) -> Mask:
    """Return True (w,) for walls through two points between which there is one by what sonars measured (`Span`)."""
    spans = [span.ends for span in uncrossed_spans(estimate, free_paths(estimate)) if span.is_wall]
    within_in = TIE_IN + estimate.surface_in
    return np.asarray(pass_through(estimate.state.walls, np.reshape(spans, (-1, 4)), within_in).any(axis=1))


def _losses(estimate: MapEstimate, first_node: int) -> Floats:
    """Return by how much the cost of the echoes rises without each feature (f,); inf for those not measured lately."""
    state, node = estimate.state, estimate.problem.trajectory.node
    losses = np.full(state.features, np.inf)
    echoes_of = [estimate.echoes_of(feature) for feature in range(state.features)]
    recent = [feature for feature, echoes in enumerate(echoes_of)
              if not first_node or not len(echoes) or node[echoes[-1]] >= first_node]
    if not recent:
        return losses
    bounds = np.cumsum([len(echoes_of[feature]) for feature in recent])
    _, costs = assign(estimate, np.concatenate([echoes_of[feature] for feature in recent]))
    for feature, now in zip(recent, np.split(costs, bounds[:-1]), strict=True):
        without = estimate.copy()
        without.remove(feature)
        _, then = assign(without, echoes_of[feature])
        losses[feature] = then.sum() - now.sum()
    return losses


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


def part_points(estimate: MapEstimate) -> int:
    """Replace points that are nearer from one side than from the other by two where the total cost falls.

    The corners of two rooms on either side of a wall are a hand's breadth apart, and so are the edges of a door. They
    are told apart by the sides of a line through the point, the one that divides the residuals best.
    """
    parted, walls = 0, len(estimate.state.walls)
    for number in range(len(estimate.state.points)):
        echoes = estimate.echoes_of(walls + number)
        residual, sensors, _ = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
        z = residual[:, walls + number]
        z = np.clip(np.where(np.isfinite(z), z, 0.0), -ROBUST_LIMIT, ROBUST_LIMIT)
        off = sensors.face - estimate.state.points[number]
        is_left = off @ np.stack((np.cos(DIVIDERS_RAD), np.sin(DIVIDERS_RAD))) > 0.0
        left = is_left.sum(axis=0)
        right = len(z) - left
        # By how much the sum of squares falls if both sides have a mean of their own.
        difference = z @ is_left / np.maximum(left, 1) - z @ ~is_left / np.maximum(right, 1)
        gain = np.square(difference) * left * right / max(len(z), 1)
        gain[np.minimum(left, right) < MIN_PART_ECHOES] = 0.0
        if not len(z) or gain.max() < MIN_PART_GAIN:
            continue
        trial = _with_two_points(estimate, number, echoes[is_left[:, gain.argmax()]])
        if trial.cost < estimate.cost:
            estimate.replace_by(trial)
            parted += 1
    return parted


def part_late_points(estimate: MapEstimate) -> int:
    """Replace points that are elsewhere since the robot came back by two where the total cost falls.

    A map that is bent until one point fits the echoes of both has small residuals: the score of late echoes shows it.

    Returns
    -------
    int
        The number of new points.
    """
    parted, walls = 0, len(estimate.state.walls)
    explained = np.flatnonzero(estimate.assignment.feature != NO_FEATURE)
    for number, score, rows in late_scores(estimate):
        if number < walls or score < MIN_LATE_SCORE:
            continue
        trial = _with_two_points(estimate, number - walls, explained[rows])
        if trial.cost - PENALTY["point"] + PART_PENALTY < estimate.cost:
            estimate.replace_by(trial)
            parted += 1
    return parted


def _with_two_points(estimate: MapEstimate, number: int, echoes: Indices) -> MapEstimate:
    """Return the map with a second point, which starts with some echoes of one, optimized."""
    trial = estimate.copy()
    trial.add_point(estimate.state.points[number])
    feature = trial.assignment.feature.copy()
    feature[echoes] = trial.state.features - 1
    trial.assignment = replace(trial.assignment, feature=feature)
    trial.optimize(JOIN_STEPS, robust=False)
    for _ in range(2):
        trial.optimize(3)
        trial.associate()
    return trial


def drop_hidden(estimate: MapEstimate) -> int:
    """Remove walls behind others, most of whose echoes would have passed through these; return their number.

    Sound that is reflected twice in a corner comes late, as if from beyond it. Where nothing else was measured beyond,
    the other walls reach as far as the corner. What is open at both ends is also dropped if its echoes alone pass
    through the gap of a wall, and it is no door that stands back: sound between that wall and a box before it comes
    late.
    """
    dropped = 0
    for wall in reversed(range(len(estimate.state.walls))):
        echoes = estimate.echoes_of(wall)
        _, sensors, spots = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
        own = [piece for piece in extract_walls(estimate, with_accuracy=False) if piece.line == wall]
        without = estimate.copy()
        without.remove(wall)
        pieces = extract_walls(without, with_accuracy=False)
        others = np.array([piece.ends.reshape(4) for piece in pieces]).reshape(-1, 4)
        blocked = is_blocked(sensors.face, spots[:, wall], others, estimate.blocked_in)
        if not any(any(piece.closed) for piece in own):
            blocked |= is_blocked(sensors.face, spots[:, wall], unpassed_gaps(without, pieces), NICHE_IN)
        if len(echoes) and blocked.mean() > HIDDEN_FRACTION:
            without.associate()
            estimate.replace_by(without)
            dropped += 1
    return dropped


def drop_corner_cuts(estimate: MapEstimate) -> int:
    """Remove walls with levels that lead from one wall to another across their corner; return their number."""
    numbers = np.flatnonzero(cut_corners(estimate, segments_of(estimate.state.walls, estimate.extents)))
    for number in reversed(numbers.tolist()):
        estimate.remove(number)
    if len(numbers):
        estimate.associate()
    return len(numbers)


def drop_unmeasured(estimate: MapEstimate) -> int:
    """Remove features that neither ranges nor two ties determine, since all lost theirs; return their number.

    They are anywhere, and with them the rigid fit of the whole map, by which the accuracy of all walls is stated.
    """
    dropped = 0
    feature, ties = estimate.assignment.feature, estimate.assignment.ties
    counts = np.bincount(feature[feature != NO_FEATURE], minlength=estimate.state.features)
    np.add.at(counts, np.concatenate((ties[:, 0] + len(estimate.state.walls), ties[:, 1])), 1)
    for number in reversed(np.flatnonzero(counts < MIN_DETERMINED).tolist()):
        estimate.remove(number)
        dropped += 1
    return dropped


def swallow(estimate: MapEstimate) -> int:
    """Replace short walls by points where the total cost falls, and return their number.

    A line past a corner picks those of the corner's echoes whose noise suits it.
    """
    swallowed = 0
    for wall in reversed(range(len(estimate.state.walls))):
        low, high = estimate.extents[wall]
        if high - low > SWALLOW_IN or _have_ends(estimate)[wall] or _are_spans(estimate)[wall]:
            continue
        trial = estimate.copy()
        segment = segments_of(trial.state.walls, trial.extents)[wall]
        trial.remove(wall)
        trial.associate()
        without = trial.copy()
        # With a point in its place, which no ray meets, and without.
        if not estimate.problem.rays:
            trial.add_point(segment.reshape(2, 2).mean(axis=0))
        for candidate in (trial, without):
            candidate.associate()
            candidate.optimize(3)
            candidate.associate()
            candidate.optimize(3)
        best = min((estimate, trial, without), key=lambda candidate: candidate.cost)
        if best is not estimate:
            estimate.replace_by(best)
            swallowed += 1
    return swallowed


def absorb_points(estimate: MapEstimate) -> int:
    """Remove points on a wall's line that the wall explains as well, if it is seen as far; return their number."""
    absorbed = 0
    for number in reversed(range(len(estimate.state.points))):
        state = estimate.state
        walls, point = len(state.walls), state.points[number]
        along, across = (of_point[0] for of_point in along_and_across(point[None], state.walls))
        echoes = estimate.echoes_of(walls + number)
        now = _cost_of(estimate, echoes)
        for wall in np.flatnonzero(np.abs(across) < TIE_IN + 2.0):
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
            if _cost_of(trial, echoes) - now > ABSORB_LOSS:
                continue
            trial.optimize(3)
            trial.associate()
            trial.optimize(3)
            if trial.cost < estimate.cost:
                estimate.replace_by(trial)
                absorbed += 1
                break
    return absorbed


def square(estimate: MapEstimate) -> int:
    """Turn walls with levels to the axes of the building where the total cost falls, and return their number.

    What is off by more than its robust limit is hardly pulled to a right angle, and levels make up for the slope.
    """
    turned = 0
    for wall in range(len(estimate.state.walls) if estimate.surface_in else 0):
        off = estimate.problem.angle_residuals(estimate.state, estimate.assignment)[0] * RIGHT_ANGLE_STD_RAD
        if not len(off) or not ROBUST_LIMIT * RIGHT_ANGLE_STD_RAD < abs(off[wall]) < MAX_TURN_RAD:
            continue
        trial = _turned_wall(estimate, wall, -float(off[wall]))
        for _ in range(2):
            trial.optimize(JOIN_STEPS)
            trial.associate()
        if trial.cost < estimate.cost:
            estimate.replace_by(trial)
            turned += 1
    return turned


def _turned_wall(estimate: MapEstimate, wall: int, by_rad: float) -> MapEstimate:
    """Return the map with a wall turned about its middle, and its surface where it was.

    Coordinates along it are counted from the foot of the origin, which moves.
    """
    trial, levels = estimate.copy(), estimate.state.levels
    own, walls = levels.of(wall), estimate.state.walls.copy()
    middle = segments_of(walls, estimate.extents)[wall].reshape(2, 2).mean(axis=0)
    # 1. The line, and the distances of the surface from it.
    angle = float(walls[wall, 0]) + by_rad
    normal = np.array((np.cos(angle), np.sin(angle)))
    walls[wall], values = (angle, normal @ middle), levels.value_in.copy()
    values[own] = estimate.state.surface(wall) @ normal - walls[wall, 1]
    # 2. Coordinates along it, and cells.
    by_in = float(middle @ np.array((-normal[1], normal[0])) - trial.extents[wall].mean())
    extents, runs, cells = trial.extents.copy(), trial.runs.copy(), levels.cell.copy()
    extents[wall] += by_in
    runs[runs[:, 0] == wall, 1:] += by_in
    cells[own] += round(by_in / LEVEL_CELL_IN)
    trial.extents, trial.runs = extents, runs
    trial.state = replace(estimate.state, walls=walls, levels=replace(levels, cell=cells, value_in=values))
    return trial


def _cost_of(estimate: MapEstimate, echoes: Indices) -> float:
    """Return the robust cost of some echoes, assigned anew."""
    return float(assign(estimate, echoes)[1].sum())


def join_points(estimate: MapEstimate) -> int:
    """Add walls between two points where no sound has passed and the total cost falls, and return their number.

    A short wall is seen over too little of its length to be told from a point; its ends are seen from farther off.
    Where sound should have passed, or sonars have measured a surface, the wall need not pay for itself.
    """
    joined, tried = 0, set[tuple[float, ...]]()
    while True:
        for span in uncrossed_spans(estimate, free_paths(estimate)):
            key = tuple(span.ends.tolist())
            if key in tried:
                continue
            tried.add(key)
            if _try_join(estimate, span):
                joined += 1
                break
        else:
            return joined


def _have_ends(estimate: MapEstimate) -> Mask:
    """Return True (w,) for walls with a point on their line beyond either end, which determine it."""
    along, across = along_and_across(estimate.state.points, estimate.state.walls)
    on_line = np.abs(across) < TIE_IN + estimate.surface_in
    low, high = estimate.extents.T
    before = on_line & (along < low + POINT_ON_WALL_IN) & (along > low - MAX_SPAN_IN)
    after = on_line & (along > high - POINT_ON_WALL_IN) & (along < high + MAX_SPAN_IN)
    return np.asarray(before.any(axis=0) & after.any(axis=0), dtype=np.bool_)


def _try_join(estimate: MapEstimate, span: Span) -> bool:
    """Add a wall between two points if the total cost falls; return True if it did."""
    state, problem = estimate.state, estimate.problem
    # 1. The line through both.
    line, extent = _line_of(span)
    if pass_through(state.walls, span.ends[None], POINT_ON_WALL_IN + estimate.surface_in).any():
        return False
    # 2. It must explain echoes of its inner part that no wall explains.
    if not span.is_wall:
        echoes = estimate.echoes()
        feature, walls = estimate.assignment.feature[echoes], len(state.walls)
        short = np.flatnonzero(estimate.extents[:, 1] - estimate.extents[:, 0] < SWALLOW_IN)
        is_open = (feature == NO_FEATURE) | np.isin(feature, short) | (feature >= walls)
        echoes = echoes[is_open & ~np.isin(feature, (walls + span.one, walls + span.other))]
        alone = replace(state, walls=line[None], points=state.points[:0], levels=Levels())
        residual, _, spots = residual_matrix(problem, alone, extent[None], echoes)
        feet = spots[:, 0] @ (-np.sin(line[0]), np.cos(line[0]))
        supports = (np.abs(residual[:, 0]) < ROBUST_LIMIT) & (feet > extent[0]) & (feet < extent[1])
        if supports.sum() < MIN_JOIN_ECHOES:
            return False
    trial = _with_wall(estimate, line, extent)
    penalty = PENALTY["wall"] + float(trial.surface_costs[-1]) if span.is_wall else PENALTY["wall"] - JOINED_PENALTY
    if trial.cost - penalty > estimate.cost:
        return False
    estimate.replace_by(trial)
    return True


def close_wall_ends(estimate: MapEstimate) -> int:
    """Add the ends of walls whose faces both end there (`find_wall_ends`), and optimize; return their number.

    They have no echoes of their own. What determines them are their corners, and that walls are at right angles.
    """
    spans = [
        span for span in find_wall_ends(estimate, free_paths(estimate))
        if not len(walls_along(estimate.state.walls, span))
    ]  # fmt: skip
    if not spans:
        return 0
    first = len(estimate.state.walls)
    for span in spans:
        estimate.add_wall(*_line_of(span))
    tie_points(estimate)
    estimate.optimize(LAST_STEPS)
    # They have turned, and coordinates along them have changed.
    for number, span in enumerate(spans, start=first):
        angle = estimate.state.walls[number, 0]
        at = estimate.state.points[[span.one, span.other]] @ (-np.sin(angle), np.cos(angle))
        estimate.narrow(number, np.sort(at))
    return len(spans)


def _line_of(span: Span) -> tuple[Floats, Floats]:
    """Return the line (2,) through both points of a span, and its extent (2,)."""
    first, second = span.ends.reshape(2, 2)
    along = (second - first) / np.hypot(*(second - first))
    angle = float(np.arctan2(-along[0], along[1]))
    normal = np.array((np.cos(angle), np.sin(angle)))
    forward = np.array((-normal[1], normal[0]))
    extent = np.sort((float(first @ forward), float(second @ forward)))
    return np.array((angle, float(first @ normal))), extent


def _with_wall(estimate: MapEstimate, line: Floats, extent: Floats) -> MapEstimate:
    """Return the map with one wall (2,) more, optimized. Points in its middle are part of it, unless it has levels."""
    trial, state = estimate.copy(), estimate.state
    c, s = np.cos(line[0]), np.sin(line[0])
    along, across = state.points @ (-s, c), state.points @ (c, s) - line[1]
    between = (along > extent[0] + POINT_ON_WALL_IN) & (along < extent[1] - POINT_ON_WALL_IN)
    # A wall with a surface has posts.
    if not estimate.surface_in:
        for number in reversed(np.flatnonzero(between & (np.abs(across) < POINT_ON_WALL_IN))):
            trial.remove(len(state.walls) + int(number))
    trial.add_wall(line, extent)
    for _ in range(2):
        trial.associate()
        tie_points(trial)
        trial.optimize(3)
    # What it hides counts against it, by the extent that its echoes show at the end.
    trial.associate()
    tie_points(trial)
    return trial


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
        (m, m) of walls, points and parameters, with the poses eliminated; without it all opposite sides count.
    """
    angles = estimate.state.walls[[one, other], 0]
    sides = [_side_of(estimate, wall) for wall in (one, other)]
    if min(np.abs(sides)) < SIDED or sides[0] * sides[1] * np.cos(angles[0] - angles[1]) > 0.0:
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
        if _overlap(segments[one], segments[other]) > MIN_BASE_IN
        and _merged(estimate, one, other).cost < estimate.cost + MIN_DIFFERENCE
    ]


def _overlap(one: Floats, other: Floats) -> float:
    """Return the length that two segments (4,) have in common along the first one."""
    along = one[2:] - one[:2]
    length = max(float(np.hypot(*along)), 1e-9)
    low, high = np.sort((other.reshape(2, 2) - one[:2]) @ along / length)
    return float(min(high, length) - max(low, 0.0))


def tie_points(estimate: MapEstimate) -> None:
    """Tie each point to the walls on whose lines it lies: one that it is near to, or two that meet in it.

    Both walls of a corner are tied to it, wherever their extents end: the ranges of the corner and of its walls are
    what tells the range offset of all sonars apart from the size of a room.
    """
    state, ties = estimate.state, []
    low, high = estimate.extents.T
    for number, (along, off) in enumerate(zip(*along_and_across(state.points, state.walls), strict=True)):
        across, beyond = np.abs(off), np.maximum(np.maximum(low - along, along - high), 0.0)
        meeting = np.flatnonzero((across < TIE_IN) & (beyond < REACH_IN))
        slope = np.abs(np.sin(state.walls[meeting, 0][:, None] - state.walls[meeting, 0]))
        is_corner = (slope > np.sin(MIN_CORNER_RAD)).any(axis=1)
        ties += [(number, wall) for wall in meeting[is_corner | (beyond[meeting] < TIE_BEYOND_IN + across[meeting])]]
    estimate.assignment = replace(estimate.assignment, ties=np.array(ties, dtype=np.intp).reshape(-1, 2))
