"""Revision of a map: each change down to `square` is tried, optimized and reverted unless the total cost falls.

    prune    a feature without which the echoes cost less than PENALTY more is removed
    part     a point that looks different from two sides, or since a return, becomes two
    posts    points on the surface of a wall, or in a corner of two, whose echoes the walls had explained
    release  echoes of a level that other features explain nearly as well become theirs
    swallow  a short wall becomes a point
    join     two points become the ends of a wall
    absorb   a point on a wall becomes part of it
    square   a wall with levels turns to the axes of the building
    turn     a wall with levels turns to the direction of its most probable stretches
    together walls with levels turn onto the axes, and right angles have SQUARE_STD_RAD from then on
    drop     what is hidden behind walls, across their corners, or measured no more is removed, whatever it costs; and
             slanted walls with levels that explain hardly anything, and walls through parts of others
    trim     echoes of a wall with levels from where there is no wall in the end are left out
    close    the ends of walls whose faces both end there are added
    tie      points near a wall's line are corners or ends of it

Walls that are one or two: `localization/mapping/merging.py`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from math import radians
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from localization.mapping.association import PENALTY, MapEstimate, assign
from localization.mapping.consistency import late_scores
from localization.mapping.features import MIN_DIFFERENCE
from localization.mapping.measurements import Indices
from localization.mapping.merging import JOIN_STEPS, MERGE_GAP_IN
from localization.mapping.problem import (
    LEVEL_CELL_IN,
    MIN_GAIN,
    NO_FEATURE,
    NO_LEVEL,
    RIGHT_ANGLE_LIMIT_RAD,
    ROBUST_LIMIT,
    SQUARE_STD_RAD,
    Levels,
    robust_cost,
)
from localization.mapping.reflectors import Mask, along_and_across, is_blocked, residual_matrix, segments_of
from localization.mapping.spans import (
    DEEP_SIGMAS,
    MAX_SPAN_IN,
    MIN_CORNER_RAD,
    Span,
    cut_corners,
    find_wall_ends,
    pass_through,
    uncrossed_spans,
    walls_along,
)
from localization.mapping.surfaces import costs_of_turns
from localization.mapping.walls import REACH_IN, extract_walls, free_paths, unpassed_gaps
from worlds.world import SPOT_REACH_IN

LAST_STEPS: Final = 10
MAX_TURN_RAD: Final = radians(15.0)
"""A wall that is off the axes by more is meant to be."""
TURNS_RAD: Final = np.radians(np.linspace(-6.0, 6.0, 49))
"""Turns of a wall with levels that are compared: a step of 0.8 in within 34 in looks like a slope of 2.3 degrees."""
SHORT_IN: Final = 40.0
"""Walls that were learned with a false slope, of 5 to 12 degrees, are up to 27 in long. True slopes of 3 and 6 degrees
of a wall of which 70 in were measured cost as little."""
MIN_SLANTED_GAIN: Final = 20.0
"""Cost of ranges that a slanted wall must save: in 72 maps of 36 drives the true ones saved 31 or more."""
MAX_EXPLAINED: Final = 0.5
"""Fraction of a wall's echoes that other walls would explain before the map is tried without it."""
MIN_TURN_GAIN: Final = 1.0
"""Cost of its stretches that a turn must save to be tried."""
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
RIVAL_RAD: Final = radians(20.0)
"""Two spans from one point whose directions differ by less are the same wall to either of two ends."""
POINT_ON_WALL_IN: Final = 2.5
POST_APART_IN: Final = 2.0
"""Posts nearer to one another are one."""
MIN_POST_GAIN: Final = 0.5 * PENALTY["point"]
"""Least fall of the costs of single echoes for which a post is tried: optimized, it may save more."""
MAX_RELEASE_LOSS: Final = 5.0
"""Rise of the costs of single echoes, less what their levels cost, up to which a stretch is tried without: optimized,
the map may cost less."""
ABSORB_LOSS: Final = 4.0 * PENALTY["point"]
"""If a point's echoes cost so much more on the wall, the map is not optimized without it: that could hardly pay."""
TIE_IN: Final = 1.0
TIE_BEYOND_IN: Final = 6.0
"""A point within TIE_IN of a wall's line, and not farther beyond its end, lies on the wall."""


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


def drop_spurious_walls(estimate: MapEstimate) -> int:
    """Remove walls most of whose echoes other walls would explain where the total cost falls; return their number.

    A line that leads through parts of two walls takes from each the echoes whose noise suits it. Single echoes do not
    show what the map costs without it (`prune`): the other walls have turned away from those that they have lost.
    """
    revised, dropped = estimate, 0
    for wall in reversed(range(len(estimate.state.walls))):
        echoes = revised.echoes_of(wall)
        others, _ = assign(revised, echoes, other_than=revised.assignment.feature[echoes])
        of_walls = (others != NO_FEATURE) & (others < len(revised.state.walls))
        if of_walls.sum() <= MAX_EXPLAINED * len(echoes):
            continue
        if revised is estimate:
            revised = estimate.copy()
            _settle(revised)
        trial = revised.copy()
        trial.remove(wall)
        _settle(trial)
        if trial.cost < revised.cost:
            revised, dropped = trial, dropped + 1
    if dropped:
        estimate.replace_by(revised)
    return dropped


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
    """Remove what is behind walls, if most of its echoes would have passed through these; return the number.

    Sound that is reflected twice in a corner comes late, as if from beyond it. Where nothing else was measured beyond,
    the other walls reach as far as the corner. A wall that is open at both ends is also dropped if its echoes alone
    pass through the gap of a wall, and it is no door that stands back: sound between that wall and a box before it
    comes late. Points are dropped that far behind walls, of planes: surfaces have posts that are not known so well.
    """
    dropped = 0
    # 1. Points, whose paths may keep a corner open.
    points = range(len(estimate.state.walls), estimate.state.features)
    for point in reversed(points) if not estimate.surface_in else ():
        echoes = estimate.echoes_of(point)
        _, sensors, spots = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
        without = estimate.copy()
        without.remove(point)
        pieces = extract_walls(without, with_accuracy=False)
        others = np.array([piece.ends.reshape(4) for piece in pieces]).reshape(-1, 4)
        if len(echoes) and is_blocked(sensors.face, spots[:, point], others, NICHE_IN).mean() > HIDDEN_FRACTION:
            without.associate()
            estimate.replace_by(without)
            dropped += 1
    # 2. Walls.
    for wall in reversed(range(len(estimate.state.walls))):
        echoes = estimate.echoes_of(wall)
        _, sensors, spots = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
        own = [piece for piece in extract_walls(estimate, with_accuracy=False) if piece.wall == wall]
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


def drop_slanted(estimate: MapEstimate) -> int:
    """Remove walls with levels that are off the axes and explain hardly anything; return their number.

    A wall between two posts is added if a few echoes are of its surface (`Span.is_measured`), although it costs more
    than it saves: a true one that is seen mainly from its ends does so as well. Two posts beside the corner of a room
    make such a wall across the corner. Slanted walls are rare, so these must save something.
    """
    slanted = np.flatnonzero(np.abs(_off_axes(estimate)) > RIGHT_ANGLE_LIMIT_RAD).tolist()
    if not estimate.surface_in or not slanted:
        return 0
    revised, dropped = estimate.copy(), 0
    _settle(revised)
    # From the last one, since those after a removed wall have other numbers.
    for wall in reversed(slanted):
        trial = revised.copy()
        trial.remove(wall)
        _settle(trial)
        saved = trial.cost - revised.cost + PENALTY["wall"] + float(revised.surface_costs[wall])
        if saved < MIN_SLANTED_GAIN:
            revised, dropped = trial, dropped + 1
    if dropped:
        estimate.replace_by(revised)
    return dropped


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


def trim_surfaces(estimate: MapEstimate) -> int:
    """Leave out the echoes of walls with levels from where there is no wall in the end, and return their number.

    A line is continued by echoes that are of no other wall, beyond a corner or a post that ends the wall. Without them
    its extent is that of the wall, and the levels beside its end are those of its own echoes.
    """
    if not estimate.surface_in:
        return 0
    pieces = extract_walls(estimate, with_accuracy=False)
    feature, walls = estimate.assignment.feature.copy(), estimate.state.walls
    for wall in range(len(walls)):
        echoes, parts = estimate.echoes_of(wall), [piece for piece in pieces if piece.wall == wall]
        if not parts or not len(echoes):
            continue
        _, _, spots = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
        feet = spots[:, wall] @ np.array((-np.sin(walls[wall, 0]), np.cos(walls[wall, 0])))
        within = [(feet > part.low - SPOT_REACH_IN) & (feet < part.high + SPOT_REACH_IN) for part in parts]
        feature[echoes[~np.any(within, axis=0)]] = NO_FEATURE
    trimmed = int((feature != estimate.assignment.feature).sum())
    estimate.assignment = replace(estimate.assignment, feature=feature)
    estimate.measure_extents()
    estimate.measure_levels()
    return trimmed


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


def add_posts(estimate: MapEstimate) -> int:
    """Add points on the surfaces of walls and in their corners where the total cost falls, and return their number.

    A wall with levels explains the echoes of its posts nearly as well: they give birth to nothing. The places at which
    a point would lower the costs of single echoes most are tried, with everything optimized.
    """
    if not estimate.surface_in or estimate.problem.rays:
        return 0
    added, tried = 0, list[Floats]()
    while (trial := _with_post(estimate, tried)) is not None:
        estimate.replace_by(trial)
        added += 1
    return added


def _with_post(estimate: MapEstimate, tried: list[Floats]) -> MapEstimate | None:
    """Return the map with one point more that lowers the total cost, None if there is none; add what was tried."""
    for place in _post_places(estimate, np.reshape(tried, (-1, 2))):
        tried.append(place)
        trial = estimate.copy()
        trial.add_point(place)
        _settle(trial)
        if trial.cost < estimate.cost:
            return trial
    return None


def release_stretches(estimate: MapEstimate) -> int:
    """Leave stretches of levels to other features where the total cost falls, and return their number.

    Each echo takes the nearest feature, and a level moves to its echoes: some of a post beside a corner, with their
    feet on the other wall, become a stretch of that one, inches off its surface, though the map has the post.
    """
    if not estimate.surface_in:
        return 0
    released = 0
    for wall, echoes, features in _other_features(estimate):
        if not (estimate.assignment.feature[echoes] == wall).all():
            continue
        trial = estimate.copy()
        feature = trial.assignment.feature.copy()
        feature[echoes] = features
        trial.assignment = replace(trial.assignment, feature=feature)
        trial.measure_extents()
        for _ in range(2):
            trial.optimize(3)
            trial.associate()
        is_released = (trial.assignment.feature[echoes] != wall).any()
        if is_released and trial.cost < estimate.cost - MIN_GAIN:
            estimate.replace_by(trial)
            released += 1
    return released


def _other_features(estimate: MapEstimate) -> list[tuple[int, Indices, Indices]]:
    """Return stretches of levels that are hardly worth it: their walls, echoes (k,), and other features of these (k,).

    Of walls that have other stretches as well.
    """
    levels, assignment, problem = estimate.state.levels, estimate.assignment, estimate.problem
    echoes = np.flatnonzero(assignment.level != NO_LEVEL)
    _, now = assign(estimate, echoes)
    others, then = assign(estimate, echoes, other_than=assignment.feature[echoes])
    # What it saves to leave each stretch to others: what its levels cost, less what its echoes cost more.
    begins = np.flatnonzero(~problem.level_stays(levels))
    costs = np.square(problem.level_residuals(levels)[0]) + problem.level_penalties(levels, assignment)
    gain = np.add.reduceat(costs, begins)
    stretch = np.searchsorted(begins, assignment.level[echoes], side="right") - 1
    np.add.at(gain, stretch, now - then)
    counts = np.bincount(levels.wall[begins], minlength=len(estimate.state.walls))
    return [
        (int(levels.wall[begins[number]]), echoes[stretch == number], others[stretch == number])
        for number in np.flatnonzero((gain > -MAX_RELEASE_LOSS) & (counts[levels.wall[begins]] > 1)).tolist()
    ]


def _post_places(estimate: MapEstimate, tried: Floats) -> Floats:
    """Return where points would lower the costs of single echoes by MIN_POST_GAIN (k, 2), the best first.

    Not beside points of the map, nor beside those that were tried (t, 2), nor beside one another.
    """
    state = estimate.state
    # 1. On surfaces, and where the lines of two walls meet near both.
    corners = [
        corner for one, other in combinations(range(len(state.walls)), 2)
        if (corner := _corner_of(estimate, one, other)) is not None
    ]  # fmt: skip
    places = np.concatenate([*(state.surface(wall) for wall in range(len(state.walls))), np.reshape(corners, (-1, 2))])
    others = np.concatenate((state.points, tried))
    if len(others):
        places = places[np.hypot(*(places[:, None] - others).transpose(2, 0, 1)).min(axis=1) > POST_APART_IN]
    # 2. What echoes would cost less.
    echoes = estimate.echoes()
    alone = replace(state, walls=state.walls[:0], points=places, levels=Levels())
    residual, sensors, _ = residual_matrix(estimate.problem, alone, estimate.extents[:0], echoes)
    fits = np.isfinite(residual)
    then = robust_cost(np.where(fits, residual, 0.0))
    gain = np.where(fits, np.maximum(assign(estimate, echoes)[1][:, None] - then, 0.0), 0.0)
    echo, place = np.nonzero(gain)
    blocked = is_blocked(sensors.face[echo], places[place], estimate.blocking, estimate.blocked_in)
    gain[echo[blocked], place[blocked]] = 0.0
    total = gain.sum(axis=0)
    # 3. The best of those side by side.
    order = np.argsort(-total, kind="stable")[: int((total > MIN_POST_GAIN).sum())]
    found = list[Floats]()
    for place in places[order]:
        if all(np.hypot(*(place - other)) > POST_APART_IN for other in found):
            found.append(place)
    return np.reshape(found, (-1, 2))


def _corner_of(estimate: MapEstimate, one: int, other: int) -> Floats | None:
    """Return where the lines of two walls meet, if at an angle and at most REACH_IN beyond both."""
    walls = estimate.state.walls[[one, other]]
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    if abs(np.sin(walls[1, 0] - walls[0, 0])) < np.sin(MIN_CORNER_RAD):
        return None
    corner: Floats = np.linalg.solve(normals, walls[:, 1])
    at = along_and_across(corner[None], walls)[0][0]
    low, high = estimate.extents[[one, other]].T
    return corner if ((at > low - REACH_IN) & (at < high + REACH_IN)).all() else None


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
    """Turn walls with levels to the axes of the building where that costs hardly more, and return their number.

    What is off by more than its robust limit is hardly pulled to a right angle, and levels make up for the slope. So
    whether a short wall has a slope or a few levels is seldom decided by its echoes: it stays slanted only if that
    saves MIN_DIFFERENCE. A longer one is turned where the total cost falls.
    """
    turned = 0
    for wall in range(len(estimate.state.walls) if estimate.surface_in else 0):
        off = _off_axes(estimate)
        if not len(off) or not RIGHT_ANGLE_LIMIT_RAD < abs(off[wall]) < MAX_TURN_RAD:
            continue
        length_in = float(np.ptp(estimate.extents[wall]))
        turned += _try_turn(estimate, wall, -float(off[wall]), MIN_DIFFERENCE if length_in < SHORT_IN else 0.0)
    return turned


def turn_walls(estimate: MapEstimate) -> int:
    """Turn walls with levels to the direction of their most probable stretches, and return the number of those turned.

    Levels that may drift by SAME_LEVEL_STD_IN from cell to cell follow a slope, so the optimizer leaves a wall that was
    found with a slope as it is, although its surface may have a step instead.
    """
    turned, present = 0, len(TURNS_RAD) // 2
    for wall in range(len(estimate.state.walls) if estimate.surface_in else 0):
        if not len(estimate.echoes_of(wall)):
            continue
        middle_in = float(estimate.extents[wall].mean())
        costs = costs_of_turns(estimate.problem, estimate.state, estimate.assignment, wall, middle_in, TURNS_RAD)
        best = int(costs.argmin())
        if costs[best] <= costs[present] - MIN_TURN_GAIN:
            turned += _try_turn(estimate, wall, float(TURNS_RAD[best]))
    return turned


def square_together(estimate: MapEstimate) -> None:
    """Bring walls with levels to right angles, and keep them there: the problem has SQUARE_STD_RAD from then on.

    A slope of a single wall costs hardly anything, since levels may drift from cell to cell. One that all walls have in
    common costs more, so the optimizer finds their direction once they are at right angles.
    """
    off = _off_axes(estimate)
    is_square = np.abs(off) < RIGHT_ANGLE_LIMIT_RAD
    if not estimate.surface_in or not is_square.any():
        return
    for wall in np.flatnonzero(is_square).tolist():
        estimate.replace_by(_turned_wall(estimate, wall, -float(off[wall])))
    estimate.problem = estimate.problem.with_right_angles(SQUARE_STD_RAD)
    for _ in range(2):
        estimate.optimize(LAST_STEPS)
        estimate.associate()


def _off_axes(estimate: MapEstimate) -> Floats:
    """Return the angles (w,) of walls from the axes of the building; none of fewer than two walls."""
    problem = estimate.problem
    return problem.angle_residuals(estimate.state, estimate.assignment)[0] * problem.right_angle_std_rad


def _try_turn(estimate: MapEstimate, wall: int, by_rad: float, allowed: float = 0.0) -> bool:
    """Turn a wall if the total cost after optimizing rises by less than is allowed; return whether it was turned."""
    trial = _turned_wall(estimate, wall, by_rad)
    for _ in range(2):
        trial.optimize(JOIN_STEPS)
        trial.associate()
    is_turned = trial.cost < estimate.cost + allowed
    if is_turned:
        estimate.replace_by(trial)
    return is_turned


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
    Where sound should have passed, or sonars have measured a surface, the wall need not pay for itself. It is
    added once only: if it turns away from its points when everything is optimized, so may all that follow it.
    Of spans from the same point in about the same direction the best one is added: a point beside the wall is no end.
    """
    joined, tried = list[Floats](), set[tuple[float, ...]]()
    while True:
        spans = uncrossed_spans(estimate, free_paths(estimate))
        for span in spans:
            key = tuple(span.ends.tolist())
            if key in tried or _was_joined(span, joined):
                continue
            tried.add(key)
            if (trial := _with_span(estimate, span)) is None:
                continue
            rivals = [other for other in spans if _are_rivals(span, other) and not _was_joined(other, joined)]
            trials = [(span, trial), *((other, _with_span(estimate, other)) for other in rivals)]
            best, trial = min(((each, one) for each, one in trials if one is not None), key=lambda pair: pair[1].cost)
            estimate.replace_by(trial)
            joined.append(best.ends)
            break
        else:
            return len(joined)


def _are_rivals(one: Span, other: Span) -> bool:
    """Return True for two spans from the same point in about the same direction."""
    common = {one.one, one.other} & {other.one, other.other}
    if len(common) != 1:
        return False
    first, second = (
        np.subtract(*span.ends.reshape(2, 2)) * (1.0 if span.one in common else -1.0) for span in (one, other)
    )
    angle = np.arctan2(first[0] * second[1] - first[1] * second[0], first @ second)
    return bool(abs(angle) < RIVAL_RAD)


def _was_joined(span: Span, joined: list[Floats]) -> bool:
    """Return True for a span whose points were joined (4,), and have moved by less than POINT_ON_WALL_IN since."""
    ends = span.ends.reshape(2, 2)
    return any(
        float(np.hypot(*(ends - turned).T).max()) < POINT_ON_WALL_IN
        for before in joined for turned in (before.reshape(2, 2), before.reshape(2, 2)[::-1])
    )


def _have_ends(estimate: MapEstimate) -> Mask:
    """Return True (w,) for walls with a point on their line beyond either end, which determine it."""
    along, across = along_and_across(estimate.state.points, estimate.state.walls)
    on_line = np.abs(across) < TIE_IN + estimate.surface_in
    low, high = estimate.extents.T
    before = on_line & (along < low + POINT_ON_WALL_IN) & (along > low - MAX_SPAN_IN)
    after = on_line & (along > high - POINT_ON_WALL_IN) & (along < high + MAX_SPAN_IN)
    return np.asarray(before.any(axis=0) & after.any(axis=0), dtype=np.bool_)


def _with_span(estimate: MapEstimate, span: Span) -> MapEstimate | None:
    """Return the map with a wall between two points; None if the total cost does not fall."""
    state, problem = estimate.state, estimate.problem
    # 1. The line through both.
    line, extent = _line_of(span)
    if pass_through(state.walls, span.ends[None], POINT_ON_WALL_IN + estimate.surface_in).any():
        return None
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
            return None
    trials = [_with_wall(estimate, line, extent)]
    within_in = DEEP_SIGMAS * problem.reflection.surface_std_in
    if len(_points_between(estimate, line, extent, within_in)) and estimate.surface_in:
        # A surface that was measured from a few places alone may be a point that is off the line.
        trials.append(_with_wall(estimate, line, extent, within_in))
    penalty = PENALTY["wall"] if span.is_wall else PENALTY["wall"] - JOINED_PENALTY
    costs = [trial.cost - penalty - (float(trial.surface_costs[-1]) if span.is_wall else 0.0) for trial in trials]
    return None if min(costs) > estimate.cost else trials[int(np.argmin(costs))]


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


def _points_between(estimate: MapEstimate, line: Floats, extent: Floats, within_in: float) -> Indices:
    """Return the numbers of the points so near to a line (2,), well within an extent (2,) of it."""
    along, across = (of_wall[:, 0] for of_wall in along_and_across(estimate.state.points, line[None]))
    is_between = (along > extent[0] + POINT_ON_WALL_IN) & (along < extent[1] - POINT_ON_WALL_IN)
    return np.flatnonzero(is_between & (np.abs(across) < within_in))


def _with_wall(estimate: MapEstimate, line: Floats, extent: Floats, within_in: float | None = None) -> MapEstimate:
    """Return the map with one wall (2,) more, optimized, without the points in its middle up to so far off its line.

    By default those on the line of a plane are part of it; a wall with a surface has posts.
    """
    trial, walls = estimate.copy(), len(estimate.state.walls)
    if within_in is None:
        within_in = 0.0 if estimate.surface_in else POINT_ON_WALL_IN
    for number in reversed(_points_between(estimate, line, extent, within_in)):
        trial.remove(walls + int(number))
    trial.add_wall(line, extent)
    _settle(trial)
    return trial


def _settle(estimate: MapEstimate) -> None:
    """Optimize a map that has a feature more or less. What a new one hides counts against it, by the last extents."""
    for _ in range(2):
        estimate.associate()
        tie_points(estimate)
        estimate.optimize(3)
    estimate.associate()
    tie_points(estimate)


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
