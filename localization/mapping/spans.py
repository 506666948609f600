"""Walls between two points of a map: by what has not been measured between them, and the ends of thick walls.

A wall that is seen from its ends, or too short to be told from a point, has its two ends in the map as points. No path
of sound or of the robot has crossed the line between them (`uncrossed_spans`). It is a wall if paths should have:

    silent      sonars whose axes lead between the points, clear of both, have measured nothing behind
    measured    of walls with levels: sonars that face it have measured it, with ranges that no point has
    closing     three walls lead from one point to the other: it is the fourth side of a box

Where both faces of a thick wall end, a wall leads from one corner to the other (`find_wall_ends`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats, wrap_angle
from localization.mapping.association import ALONE_SIGMAS, MAX_THICKNESS_IN, MIN_THICKNESS_IN, OPPOSITE_IN, MapEstimate
from localization.mapping.measurements import Indices
from localization.mapping.problem import Sensors, sensors_at
from localization.mapping.reflectors import (
    BLOCKED_IN,
    MAX_GAP_IN,
    Mask,
    along_and_across,
    crossings,
    ends_of_parts,
    is_blocked,
    parts_of,
    residual_matrix,
)

MIN_CROSSINGS: Final = 2
"""A single path across a wall may be a mistaken echo."""
MIN_ACROSS_RAD: Final = radians(10.0)
"""A path that leads along a span crosses it by an error."""
MIN_PIECE_IN: Final = 4.0
OVERSHOOT_IN: Final = 6.0
"""A mistaken spot may lie this far beyond the true end."""
POINT_ON_LINE_IN: Final = 2.5
MIN_SPAN_IN, MAX_SPAN_IN = 8.0, 60.0
"""Lengths of walls that are looked for between two points."""
CORNER_DEPTHS: Final = 3.0
"""No path crosses a span whose corner is less deep behind it than so many distances of a surface from its line: one for
the surface of the corner, one by which paths are shortened, and one by which they must end beyond the span."""
MIN_STOPPED: Final = 4
"""Sonars that were directed between two points, not one of which has measured anything behind."""
MAX_SILENT_IN: Final = 30.0
"""A longer wall is measured itself by a robot that passes: it is none by what is not measured behind it alone."""
MIN_MEASURED, MAX_BEHIND = 3, 0.2
"""Readings of sonars that face a span which no point explains, and the fraction of those behind of those on it: so a
surface with levels shows."""
SPAN_SIGHT_IN: Final = 80.0
SPAN_INCIDENCE_COS: Final = 0.35
"""From so far, and at most 70 degrees off the normal, a sonar would have measured what is behind."""
SPAN_MARGIN: Final = 0.1
"""The outer tenths of a span belong to its points."""
FACING_COS: Final = 0.98
"""A sonar whose axis is within 11 degrees of the normal of a wall measures it, if its foot is on the wall."""
FACING_MARGIN: Final = 0.25
"""The outer quarters of a span are too near to its points, whose ranges are nearly those of a wall."""
RECESS_IN: Final = 1.5
"""So much beyond a span, what a sonar measures is behind it: 3 standard deviations of a range of 40 in."""
DEEP_SIGMAS: Final = 3.0
"""The same of walls with levels, in standard deviations of these."""
SHORT_IN: Final = 1.0
"""What ends so much before a span was measured off something else."""
CLEAR_OF_ENDS_RAD: Final = radians(0.5)
"""A point farther off the axis than half of a cone and this reflects nothing."""
MIN_CORNER_RAD: Final = radians(20.0)
"""Lines that cross at a smaller angle make no corner: its position would be uncertain."""
FACE_RAD: Final = radians(5.0)
"""Greatest angle between the faces of a wall."""
MIN_SQUARE_COS: Final = 0.9
"""The ends of both faces of a wall are opposite one another, within 26 degrees."""
END_MARGIN: Final = 0.3
"""Paths may cross the outer three tenths of the end of a wall: they pass its corners."""
SAME_CORNER_IN: Final = 2.5
"""Ends of walls and points nearer than this are one corner of a box."""


@dataclass(frozen=True, slots=True)
class Span:
    """Two points of the map, and what was measured between them.

    Attributes
    ----------
    one, other
        Numbers of the points.
    ends
        (4,) the points.
    stopped
        Number of readings of sonars that were directed between the points, nearer to neither than half of a cone. All
        of them end before the line or at things that no reflector explains: no sound has passed.
    gap_in
        Widest part of the span at which none of them was directed, inches.
    closes_outline
        Whether three walls lead from one point to the other: it is the fourth side of a box.
    is_measured
        Whether sonars that face the span have measured a surface there, and nothing behind it (walls with levels).
    """

    one: int
    other: int
    ends: Floats
    stopped: int
    gap_in: float = 0.0
    closes_outline: bool = False
    is_measured: bool = False

    @property
    def is_wall(self) -> bool:
        """True if sonars have measured it, or sound should have passed along all of it.

        A box before a part of the span is no wall.
        """
        is_silent = self.stopped >= MIN_STOPPED and self.gap_in <= MAX_GAP_IN
        is_short = float(np.hypot(*(self.ends[2:] - self.ends[:2]))) <= MAX_SILENT_IN
        return self.is_measured or (is_short and (is_silent or self.closes_outline))


class _Frame(NamedTuple):
    """A span as a line: its first point (2,), its direction (2,), and its length in inches."""

    first: Floats
    along: Floats
    length_in: float

    @property
    def normal(self) -> Floats:
        """The direction turned left."""
        return np.array((-self.along[1], self.along[0]))


def uncrossed_spans(estimate: MapEstimate, paths: tuple[Floats, Floats]) -> list[Span]:
    """Return the pairs of points between which no path (p, 2) to (p, 2) has passed, the shortest first.

    Without the diagonals of boxes.
    """
    state, points = estimate.state, estimate.state.points
    lengths = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    ones, others = np.nonzero(np.triu((lengths > MIN_SPAN_IN) & (lengths < MAX_SPAN_IN)))
    if not len(ones):
        return []
    ends = np.concatenate((points[ones], points[others]), axis=1)
    along = (ends[:, 2:] - ends[:, :2]) / lengths[ones, others, None]
    # 1. Paths that have passed.
    is_uncrossed = _count_crossings(paths, ends, along, estimate.surface_in) < MIN_CROSSINGS
    is_uncrossed &= ~_are_diagonals(ends, ones, others, is_uncrossed, lengths)
    is_uncrossed &= ~cut_corners(estimate, ends)
    closes = _closing(estimate, ends, ones, others, is_uncrossed)
    # 2. Sonars that should have measured it, or what is behind.
    echoes, found = estimate.echoes(), list[Span]()
    sensors = sensors_at(state.poses, state.parameters, estimate.problem.trajectory, echoes)
    is_alone = _are_alone(estimate, echoes) if estimate.surface_in else np.zeros(len(echoes), dtype=np.bool_)
    depth_in = max(DEEP_SIGMAS * estimate.problem.reflection.surface_std_in, RECESS_IN)
    for number in np.flatnonzero(is_uncrossed):
        one, other = int(ones[number]), int(others[number])
        frame = _Frame(ends[number, :2], along[number], float(lengths[one, other]))
        faces, beyond_in = _facing(sensors, frame)
        is_there = faces & (np.abs(beyond_in) <= depth_in)
        behind, there = int((faces & (beyond_in > depth_in)).sum()), int(is_there.sum())
        # A door that stands back, or a niche between the points.
        if behind >= MIN_CROSSINGS and behind > there:
            continue
        is_measured = bool((is_there & is_alone).sum() >= MIN_MEASURED and behind <= MAX_BEHIND * there)
        fractions = _directed(estimate, sensors, frame, ends[number])
        gap_in = float(np.diff(np.sort([0.0, 1.0, *fractions])).max()) * frame.length_in
        found.append(Span(one, other, ends[number], len(fractions), gap_in, bool(closes[number]), is_measured))
    return sorted(found, key=lambda span: float(lengths[span.one, span.other]))


def _count_crossings(paths: tuple[Floats, Floats], ends: Floats, along: Floats, surface_in: float) -> Indices:
    """Return the number of paths that cross each span (s, 4) of a direction (s, 2), not near its ends, nor along it.

    A path that ends nearer to the line than the surface of a wall may be from it has not crossed the wall.
    """
    inner = np.concatenate((ends[:, :2] + BLOCKED_IN * along, ends[:, 2:] - BLOCKED_IN * along), axis=1)
    path = paths[1] - paths[0]
    lengths = np.maximum(np.hypot(path[:, 0], path[:, 1]), 1e-9)[:, None]
    across = np.abs(path[:, 1:] * along[:, 0] - path[:, :1] * along[:, 1]) / lengths
    off = paths[1][:, None] - ends[:, :2]
    beyond_in = np.abs(off[..., 1] * along[:, 0] - off[..., 0] * along[:, 1])
    crosses = crossings(*paths, inner) & (across > np.sin(MIN_ACROSS_RAD)) & (beyond_in >= surface_in)
    return np.asarray(crosses.sum(axis=0), dtype=np.intp)


def _facing(sensors: Sensors, frame: _Frame) -> tuple[Mask, Floats]:
    """Return which sonars (e,) face a span, and how much longer than their distance from its line their ranges are.

    A wall reflects into every cone that has its perpendicular well inside, so a longer range is of something behind it.
    """
    off = frame.first - sensors.face
    away, foot = off @ frame.normal, -(off @ frame.along) / frame.length_in
    cosine = np.cos(sensors.axis) * frame.normal[0] + np.sin(sensors.axis) * frame.normal[1]
    faces = (cosine * np.sign(away) > FACING_COS) & (np.abs(away) < SPAN_SIGHT_IN)
    faces &= np.abs(foot - 0.5) < 0.5 - FACING_MARGIN
    return faces, sensors.range_in - np.abs(away)


def _directed(estimate: MapEstimate, sensors: Sensors, frame: _Frame, ends: Floats) -> Floats:
    """Return where along a span (0 to 1) the axes of sonars lead through it (k,), past no wall and neither end (4,)."""
    axis = np.stack((np.cos(sensors.axis), np.sin(sensors.axis)), axis=-1)
    cosine = axis @ frame.normal
    slanted = np.abs(cosine) < SPAN_INCIDENCE_COS
    reach = (frame.first - sensors.face) @ frame.normal / np.where(slanted, np.inf, cosine)
    at = sensors.face + reach[:, None] * axis
    fraction = (at - frame.first) @ frame.along / frame.length_in
    directed = ~slanted & (reach > 0.0) & (reach < SPAN_SIGHT_IN)
    directed &= (fraction > SPAN_MARGIN) & (fraction < 1.0 - SPAN_MARGIN)
    clear_rad = estimate.problem.reflection.half_cone_rad + CLEAR_OF_ENDS_RAD
    for x, y in ends.reshape(2, 2):
        bearing = np.arctan2(y - sensors.face[:, 1], x - sensors.face[:, 0])
        directed &= np.abs(wrap_angle(bearing - sensors.axis)) > clear_rad
    rows = np.flatnonzero(directed & (sensors.range_in > np.abs(reach * cosine) - SHORT_IN))
    rows = rows[~is_blocked(sensors.face[rows], at[rows], estimate.blocking, estimate.blocked_in)]
    found: Floats = fraction[rows]
    return found


def _are_alone(estimate: MapEstimate, echoes: Indices) -> Mask:
    """Return True (e,) for echoes whose range is that of no point: what is between two points may have sent them."""
    residual, _, _ = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)
    of_points = np.abs(residual[:, len(estimate.state.walls) :])
    return np.asarray((of_points > ALONE_SIGMAS).all(axis=1), dtype=np.bool_)


def cut_corners(estimate: MapEstimate, segments: Floats) -> Mask:
    """Return True (s,) for segments (s, 4) from one wall to another across their corner, not far from it.

    Or from behind one wall to behind the other, through their corner. Both walls are longer, and for the second case
    were measured from one side. Posts of both are seen between which no sound passes, since behind is the corner; and
    echoes of the corner itself, which is where the levels of both walls meet, move with the feet of the walls.
    """
    found = np.zeros(len(segments), dtype=np.bool_)
    if not estimate.surface_in or not len(segments):
        return found
    walls, sizes = estimate.state.walls, estimate.extents[:, 1] - estimate.extents[:, 0]
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    span = segments[:, 2:] - segments[:, :2]
    lengths = np.maximum(np.hypot(*span.T), 1e-9)
    along = span / lengths[:, None]
    # 1. Walls that each segment begins and ends at, or behind, at an angle to it.
    meets = (np.abs(along @ normals.T) > np.sin(MIN_CORNER_RAD)) & (sizes > lengths[:, None])
    near_in, sides = estimate.surface_in, estimate.sides
    is_behind = [
        np.abs(across) < np.where(sides * across < 0.0, np.maximum(lengths[:, None], near_in), near_in)
        for across in (along_and_across(places, walls)[1] for places in (segments[:, :2], segments[:, 2:]))
    ]
    first, second = meets & is_behind[0], meets & is_behind[1]
    # 2. The corners of these walls.
    deepest_in = CORNER_DEPTHS * estimate.surface_in + BLOCKED_IN
    crosses = np.abs(np.sin(walls[:, :1] - walls[:, 0])) > np.sin(MIN_CORNER_RAD)
    for one, other in np.argwhere(crosses):
        corner = np.linalg.solve(normals[[one, other]], walls[[one, other], 1])
        off, away = corner - segments[:, :2], corner - segments[:, 2:]
        depth_in = np.abs(along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0])
        # A wall that ends in the corner is none across it.
        is_across = np.minimum(np.hypot(*off.T), np.hypot(*away.T)) > estimate.surface_in
        found |= first[:, one] & second[:, other] & is_across & (depth_in < deepest_in)
    return found


def _are_diagonals(ends: Floats, ones: Indices, others: Indices, is_uncrossed: Mask, lengths: Floats) -> Mask:
    """Return True (s,) for spans that cross another one inside a box: no path has passed its four sides either."""
    # 1. Sides: uncrossed spans, and those too short for one.
    sides = lengths <= MIN_SPAN_IN
    sides[ones[is_uncrossed], others[is_uncrossed]] = sides[others[is_uncrossed], ones[is_uncrossed]] = True
    # 2. Spans that cross, at no common end.
    candidates = np.flatnonzero(is_uncrossed)
    apart = 1e-6 * (ends[candidates, 2:] - ends[candidates, :2])
    inner = np.concatenate((ends[candidates, :2] + apart, ends[candidates, 2:] - apart), axis=1)
    first, second = np.nonzero(crossings(inner[:, :2], inner[:, 2:], inner))
    one, other = candidates[first], candidates[second]
    around = sides[ones[one], ones[other]] & sides[ones[one], others[other]]
    around &= sides[others[one], ones[other]] & sides[others[one], others[other]]
    found = np.zeros(len(ends), dtype=np.bool_)
    found[one[around]] = True
    return found


def _closing(estimate: MapEstimate, ends: Floats, ones: Indices, others: Indices, is_uncrossed: Mask) -> Mask:
    """Return True (s,) for spans from point to point (s, 4) that three walls and no fourth one lead around."""
    walls, count = estimate.state.walls, len(estimate.state.points)
    # 1. Spans on which a wall was measured.
    along = np.stack((-np.sin(walls[:, 0]), np.cos(walls[:, 0])), axis=-1)
    coordinates = np.sort(np.stack((along @ ends[:, :2].T, along @ ends[:, 2:].T)), axis=0)
    low, high = estimate.extents[:, :1], estimate.extents[:, 1:]
    common = np.minimum(coordinates[1], high) - np.maximum(coordinates[0], low)
    is_side = (pass_through(walls, ends, POINT_ON_LINE_IN) & (common > MIN_PIECE_IN)).any(axis=0) & is_uncrossed
    sides = np.zeros((count, count), dtype=np.bool_)
    sides[ones[is_side], others[is_side]] = sides[others[is_side], ones[is_side]] = True
    # 2. One side from either end, and a third one between those.
    closes = np.zeros(len(ends), dtype=np.bool_)
    for number in np.flatnonzero(is_uncrossed & ~is_side):
        one, other = ones[number], others[number]
        first, last = np.flatnonzero(sides[one]), np.flatnonzero(sides[other])
        closes[number] = sides[np.ix_(first, last)].any()
    return closes


def find_wall_ends(estimate: MapEstimate, paths: tuple[Floats, Floats]) -> list[Span]:
    """Return the pairs of points at which both faces of a wall end: its end leads from one to the other.

    So the reveals of doors are found, a hand's breadth long, which few sonars face. Each face was measured from its own
    side and ends at its own point, and the points are opposite one another; at the two posts of a door the faces end
    in opposite directions. No paths (p, 2) to (p, 2) have crossed, and no wall meets the faces there.
    """
    points, walls = estimate.state.points, estimate.state.walls
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    along, outward = np.stack((-normals[:, 1], normals[:, 0]), axis=-1), estimate.sides[:, None] * normals
    at, across = along_and_across(points, walls)
    is_on_face = (np.abs(across) < POINT_ON_LINE_IN) & (estimate.sides != 0.0)
    parts = parts_of(estimate.runs, estimate.extents)
    ends = np.where(is_on_face, ends_of_parts(parts, at).side, 0.0)
    off = points[:, None] - points
    away = np.hypot(*off.transpose(2, 0, 1))
    # 1. Pairs of points: faces that look away from one another, across the line between them, on one side of it.
    candidates = []
    for one, other in np.argwhere(np.triu((away > MIN_THICKNESS_IN) & (away < MAX_THICKNESS_IN))).tolist():
        i, j = np.flatnonzero(ends[one]), np.flatnonzero(ends[other])
        toward = off[one, other] / away[one, other]
        fits = outward[i] @ outward[j].T < -np.cos(FACE_RAD)
        fits &= (ends[one, i, None] * along[i]) @ (ends[other, j, None] * along[j]).T > 0.0
        fits &= np.abs(along[i] @ off[one, other])[:, None] < OPPOSITE_IN
        square = np.where(fits, np.minimum((outward[i] @ toward)[:, None], outward[j] @ -toward), 0.0)
        if square.max(initial=0.0) > MIN_SQUARE_COS:
            candidates.append((float(square.max()), one, other))
    # 2. The squarest where a corner is more than one point; one that nothing has crossed, and that is no junction.
    found, path = list[Span](), estimate.state.poses[:, :2]
    for _, one, other in sorted(candidates, reverse=True):
        span = Span(one, other, np.concatenate((points[one], points[other])), 0)
        inner = span.ends + np.tile(END_MARGIN * (points[other] - points[one]), 2) * (1.0, 1.0, -1.0, -1.0)
        # A path of sound may be a mistake, one of the robot is none.
        is_crossed = int(crossings(*paths, inner[None]).sum()) >= MIN_CROSSINGS
        is_crossed |= bool(crossings(path[:-1], path[1:], inner[None]).any())
        middle = span.ends.reshape(2, 2).mean(axis=0)
        beside = (np.hypot(*(known.ends.reshape(2, 2).mean(axis=0) - middle)) < SAME_CORNER_IN for known in found)
        if not is_crossed and not any(beside) and not _is_junction(estimate, span, parts):
            found.append(span)
    return found


def walls_along(walls: Floats, span: Span) -> Indices:
    """Return the numbers of the walls (w, 2) that lead from the one point of a span to the other."""
    return np.flatnonzero(pass_through(walls, span.ends[None], POINT_ON_LINE_IN)[:, 0])


def _is_junction(estimate: MapEstimate, span: Span, parts: Floats) -> bool:
    """Return True if a wall along a span goes on beyond it, by its parts (r, 3): the faces meet that wall."""
    for wall in walls_along(estimate.state.walls, span):
        angle = estimate.state.walls[wall, 0]
        low, high = np.sort(span.ends.reshape(2, 2) @ np.array((-np.sin(angle), np.cos(angle))))
        _, first, last = parts[parts[:, 0] == wall].T
        goes_on = (last > low - MAX_GAP_IN) & (first < low - OVERSHOOT_IN)
        goes_on |= (first < high + MAX_GAP_IN) & (last > high + OVERSHOOT_IN)
        if goes_on.any():
            return True
    return False


def pass_through(walls: Floats, segments: Floats, within_in: float) -> Mask:
    """Return True (w, s) for walls (w, 2) along whose lines a segment (s, 4) lies: both ends, and not aslant."""
    c, s = np.cos(walls[:, 0])[:, None, None], np.sin(walls[:, 0])[:, None, None]
    off = c * segments[:, 0::2] + s * segments[:, 1::2] - walls[:, 1][:, None, None]
    span = segments[:, 2:] - segments[:, :2]
    cosine = (c[..., 0] * span[:, 1] - s[..., 0] * span[:, 0]) / np.maximum(np.hypot(*span.T), 1e-9)
    return np.asarray((np.abs(off) < within_in).all(axis=2) & (np.abs(cosine) > MIN_SQUARE_COS), dtype=np.bool_)
