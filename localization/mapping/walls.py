"""Walls with ends from the lines of a map: pieces, corners, open ends, and how well each is known.

    1. pieces     runs of reflecting spots along a line, cut at wide gaps and where sound or the robot has crossed it;
                  of a wall with levels each leads through the mean of its own levels
    2. corners    two pieces end where their lines meet, unless sound has crossed the part to be added
    3. ends       other ends move to a point on the line that the map has there, or stay open where the spots end;
                  walls between two points are found by what was not measured between them (spans.py)
    4. accuracy   covariance of the walls after the best rigid fit, since the frame of a map is free
    5. outlines   sides and corners of boxes that lead around a place that no path has crossed

References
----------
Baarda, S-Transformations and Criterion Matrices (1973): covariance without the choice of a frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress, pairwise
from math import radians
from typing import Final

import numpy as np

from localization.filters.belief import HEADING, POSE, Floats, wrap_angle
from localization.filters.surface import SPOT_STD_IN
from localization.mapping.association import ALONE_SIGMAS, MAX_DOOR_IN, MapEstimate
from localization.mapping.consistency import repeated_ranges
from localization.mapping.measurements import Indices
from localization.mapping.problem import LEVEL_CELL_IN, NO_FEATURE, NO_LEVEL, POINT, ROBUST_LIMIT, WALL, sensors_at
from localization.mapping.reflectors import BLOCKED_IN, MAX_GAP_IN, Mask, crossings, residual_matrix
from localization.mapping.spans import (
    MIN_CORNER_RAD,
    MIN_CROSSINGS,
    MIN_PIECE_IN,
    MIN_SQUARE_COS,
    MIN_STOPPED,
    OVERSHOOT_IN,
    POINT_ON_LINE_IN,
    SAME_CORNER_IN,
    Span,
    find_wall_ends,
    uncrossed_spans,
)
from worlds.geometry import nearest_points
from worlds.world import SPOT_REACH_IN, SurfaceSpot, WallAccuracy

MIN_CROSSED_GAP_IN: Final = 3.0
MIN_PASSED, MIN_PASSED_FRACTION = 5, 0.1
"""So many paths of sound through a wall, and such a fraction of its echoes, are no mistakes."""
MIN_DEPTH_IN: Final = 1.5
"""A path that ends less far behind a line has not crossed it."""
MIN_LENGTH_IN: Final = 2.0
"""Ends that were moved nearer to one another than this, or past one another, are those of no wall."""
DOUBLED_IN, DOUBLED_OVER_IN = 0.5, 1.0
"""Walls nearer than this over such a length are one: `nomad map check` reports them."""
HIDDEN_ASIDE_IN, HIDDEN_AHEAD_IN = 8.0, 18.0
"""What no path has crossed so far behind the end of a wall, and so far from the wall that it divides, is hidden."""
MIN_SPOTS: Final = 5
MAX_STRAY_SPOTS, MAX_ALONE, STRAY_GAP_IN = 4, 2, 8.0
"""So few spots beyond a point at the end of a wall, or so far from all others, are mistakes."""
REACH_IN: Final = 48.0
"""Farthest that an end is moved to a corner: a robot comes no nearer to one than its radius, and turns before."""
MAX_BOX_IN: Final = 40.0
"""Longest side of a box: a longer wall is one of a room, or of a part of it that was not entered."""
MIN_BOX_SINE: Final = 0.7
"""Sides of a box meet at 45 to 135 degrees: posts along a wall make none."""
MAX_SKEW_IN: Final = 4.0
"""Distance of the fourth corner of a box from where a parallelogram has it."""
MIN_SIDES: Final = 3
"""Sides of a box that are walls or silent, so that its corners are known; the fourth may be neither. Fewer do if all
corners are points, and sonars that were directed between them, MIN_STOPPED to all sides together, measured nothing."""
SAME_START_IN, SAME_END_IN = 12.0, 6.0
"""Paths of sound that begin and end nearer together are one: of a slanted wall a sonar receives what comes over
other walls, again and again from one place, and its range may fit a corner far behind."""
OUTSIDE: Final = 0.9
"""Least fraction of the sonars that measured a side of a box which were outside."""
WHOLE: Final = (-np.inf, np.inf)
"""The part of a wall that is all of it."""
TOUCHING_IN: Final = 1e-7
"""An end within this distance of another wall touches it."""
ON_LINE_IN: Final = 0.01
"""A corner lies this near to both of its lines."""
MAX_STD_IN: Final = 0.5
"""Highest standard deviation of a smooth wall that is written: beyond twice that, 1 in, a wall is a wrong one."""
GAUGE_STEPS, GAUGE_STD_IN = 3, 0.5
"""Steps of the weights of the rigid fit, and the standard deviation below which all displacements weigh the same."""
MIN_STD_IN: Final = 1e-4
"""Least standard deviation of a wall in a world file: its last decimal."""


@dataclass(slots=True)
class Piece:
    """A straight wall.

    Attributes
    ----------
    wall
        Number of the wall of the map that it is, or is a part of.
    low, high
        Coordinates along the line of the outermost reflecting spots, or of the points of a span (`Span`).
    ends
        (2, 2) ends, inches.
    closed
        Whether each end is at a corner or a point; an open end is where nothing was measured any more.
    echoes
        Number of its echoes.
    std_in, std_rad
        Standard deviations of its offset, at the middle of the measured part, and of its angle.
    end_stds_in
        Standard deviation of each closed end along the wall; None for an open one, which lies beyond.
    spots
        Coordinates of the outermost reflecting spots if these are not `low` and `high`.
    surface
        (k, 3) spots of its surface that were measured: x, y, and the standard deviation of the level, inches.
    """

    wall: int
    low: float
    high: float
    ends: Floats
    closed: list[bool]
    echoes: int
    std_in: float = 0.0
    std_rad: float = 0.0
    end_stds_in: tuple[float | None, float | None] = (None, None)
    spots: tuple[float, float] | None = None
    surface: Floats = field(default_factory=lambda: np.empty((0, 3)))

    def placed(self, places: Callable[[Floats], Floats]) -> Piece:
        """Return the wall in another frame, to which a function turns and shifts points (n, 2)."""
        found = replace(self, ends=places(self.ends), surface=self.surface.copy())
        found.surface[:, :2] = places(self.surface[:, :2])
        # Coordinates along the line are counted from the foot of the origin.
        by_in = float(found.ends[0] @ found.along - self.ends[0] @ self.along)
        found.low, found.high = self.low + by_in, self.high + by_in
        found.spots = None if self.spots is None else (self.spots[0] + by_in, self.spots[1] + by_in)
        return found

    @property
    def along(self) -> Floats:
        """The direction (2,) from the first end to the second."""
        direction: Floats = (self.ends[1] - self.ends[0]) / self.length_in
        return direction

    @property
    def measured(self) -> tuple[float, float]:
        """Coordinates along the line of the outermost reflecting spots; without any, of the points of a span."""
        return self.spots or (self.low, self.high)

    @property
    def measured_in(self) -> float:
        """Length of the measured part, inches."""
        low, high = self.measured
        return high - low

    @property
    def measured_ends(self) -> Floats:
        """The ends (2, 2) of the measured part."""
        spots: Floats = self.ends[0] + (np.array(self.measured) - self.ends[0] @ self.along)[:, None] * self.along
        return spots

    @property
    def accuracy(self) -> WallAccuracy:
        """Accuracy as a world file states it, above 0: after their rigid fit two walls alone have exact offsets."""
        surface = tuple(SurfaceSpot(*spot) for spot in (np.round(self.surface, 3) + 0.0).tolist())
        std_in = max(round(self.std_in, 4), MIN_STD_IN)
        return WallAccuracy(std_in, round(self.std_rad, 5), round(self.measured_in, 2), surface)

    @property
    def length_in(self) -> float:
        """Length between the ends, inches."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))


@dataclass(frozen=True, slots=True)
class Outline:
    """The closed outline of a box.

    Attributes
    ----------
    corners
        (4, 2) in order, inches.
    walls
        Numbers of the walls along its sides; a side that is closed by its corners alone has none.
    """

    corners: Floats
    walls: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Line:
    """A line of the map.

    Attributes
    ----------
    normal, along
        (2,) unit normal and direction.
    offset
        Of the line from the origin along the normal, inches.
    by_levels
        (l,) its derivative by the levels of all walls.
    crossed
        Coordinates along the line where paths have crossed it.
    """

    normal: Floats
    along: Floats
    offset: float
    by_levels: Floats
    crossed: Floats

    def at(self, coordinate: float) -> Floats:
        """Return the point (2,) at a coordinate along the line."""
        point: Floats = self.normal * self.offset + self.along * coordinate
        return point

    def off(self, ends: Floats) -> float:
        """Return the distance of the farther one of two points (4,) from the line."""
        return float(np.abs(ends.reshape(2, 2) @ self.normal - self.offset).max())

    def is_crossed(self, low: float, high: float) -> bool:
        """Return True if paths have crossed the line between two coordinates."""
        within = (self.crossed > low + BLOCKED_IN) & (self.crossed < high - BLOCKED_IN)
        return int(within.sum()) >= MIN_CROSSINGS

    def is_crossed_between(self, one: Floats, other: Floats) -> bool:
        """Return True if paths have crossed the line anywhere between two ends (2,)."""
        low, high = sorted((float(one @ self.along), float(other @ self.along)))
        return self.is_crossed(low - BLOCKED_IN, high + BLOCKED_IN)


def extract_walls(estimate: MapEstimate, *, with_accuracy: bool = True) -> list[Piece]:
    """Return the walls of a map, in the frame of its first pose, the longest first; their accuracy if it matters.

    With it they are as they are written: both sides of a thin wall are one.
    """
    # 1. Lines, and the paths that have crossed them.
    paths, weights = free_paths(estimate), level_weights(estimate)
    wall_lines = [_line(estimate, wall, weights, paths) for wall in range(len(estimate.state.walls))]
    # 2. Pieces.
    points = estimate.state.points
    spans = [span for span in uncrossed_spans(estimate, paths) if span.is_wall] + find_wall_ends(estimate, paths)
    runs_of = [_pieces(line, *_feet(estimate, number), points) for number, line in enumerate(wall_lines)]
    has_levels, near_in = estimate.surface_in > 0.0, POINT_ON_LINE_IN + estimate.surface_in
    owners = [_owner_of(span, wall_lines, runs_of, near_in, has_levels) for span in spans] if wall_lines else []
    pieces, piece_lines = list[Piece](), list[_Line]()
    for number, (line, runs) in enumerate(zip(wall_lines, runs_of, strict=True)):
        own = [span for span, owner in zip(spans, owners, strict=True) if owner == number]
        for low, high, count in _with_spans(runs, line, own, near_in):
            within = [run for run in runs if run[0] < high and run[1] > low]
            spots = (min(run[0] for run in within), max(run[1] for run in within)) if within else (low, high)
            piece_lines.append(_line(estimate, number, weights, paths, spots) if has_levels and within else line)
            places = np.array((piece_lines[-1].at(low), piece_lines[-1].at(high)))
            pieces.append(Piece(number, low, high, places, [False, False], count,
                                spots=None if spots == (low, high) else spots))  # fmt: skip
    # The runs of each wall of the map matter to a robot that drives.
    if with_accuracy:
        pieces, piece_lines = _without_doubled(pieces, piece_lines)
    # 3. Ends.
    pieces, piece_lines = _with_ends(pieces, piece_lines, points, paths, estimate.surface_in)
    if with_accuracy:
        _add_accuracy(estimate, pieces, piece_lines)
        _add_surfaces(estimate, pieces)
    return sorted(pieces, key=lambda piece: -piece.length_in)


def _line(
    estimate: MapEstimate, wall: int, weights: Floats, paths: tuple[Floats, Floats], part: tuple[float, float] = WHOLE
) -> _Line:
    """Return the line through the surface of a wall, or of a part of it, with the crossings of paths (p, 2)."""
    (angle, offset), by_levels = surface_line(estimate, wall, weights, part)
    normal, along = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    return _Line(normal, along, float(offset), by_levels, crossed_at(*paths, normal, along, float(offset)))


def free_paths(estimate: MapEstimate) -> tuple[Floats, Floats]:
    """Return starts and ends (p, 2) of free paths: of sound to the spots that reflected it, and of the robot."""
    face, spot, _ = _reflected_paths(estimate, estimate.assignment.feature != NO_FEATURE)
    poses = estimate.state.poses[:, :2]
    return np.concatenate((face, poses[:-1])), np.concatenate((spot, poses[1:]))


def _reflected_paths(estimate: MapEstimate, among: Mask) -> tuple[Floats, Floats, Indices]:
    """Return starts and ends (p, 2) of the paths of sound of echoes `among` (e,), and the features (p,) they end at."""
    state, echoes = estimate.state, np.flatnonzero(among)
    residual, sensors, spots = residual_matrix(estimate.problem, state, estimate.extents, echoes)
    feature = estimate.assignment.feature[echoes]
    rows = np.arange(len(echoes))
    fits = np.abs(residual[rows, feature]) < ROBUST_LIMIT
    spot, face = spots[rows, feature][fits], sensors.face[fits]
    # The last inches before a reflecting spot may belong to another wall of the same corner.
    span = spot - face
    length = np.maximum(np.hypot(span[:, 0], span[:, 1]), 1e-9)[:, None]
    return face, face + span * np.maximum(length - estimate.blocked_in, 0.0) / length, feature[fits]


def passed_walls(estimate: MapEstimate, pieces: Sequence[Piece]) -> list[Piece]:
    """Return the walls through which sound has passed to others of about their direction: the place is twice in a map.

    A robot that comes back to a place and does not recognize it measures a second wall behind the first one. Ranges
    that do not repeat are no evidence.
    """
    repeats = repeated_ranges(estimate.problem.trajectory, rays=estimate.problem.rays)
    starts, ends, feature = _reflected_paths(estimate, repeats & (estimate.assignment.feature != NO_FEATURE))
    is_wall = feature < len(estimate.state.walls)
    starts, ends, angles = starts[is_wall], ends[is_wall], estimate.state.walls[feature[is_wall], 0]
    found = []
    for piece in pieces:
        along = (piece.ends[1] - piece.ends[0]) / max(piece.length_in, 1e-9)
        normal = np.array((-along[1], along[0]))
        is_parallel = np.abs(np.cos(angles) * along[0] + np.sin(angles) * along[1]) < np.sin(MIN_CORNER_RAD)
        at = crossed_at(starts[is_parallel], ends[is_parallel], normal, along, float(piece.ends[0] @ normal))
        low, high = piece.ends @ along
        passed = int(((at > low + BLOCKED_IN) & (at < high - BLOCKED_IN)).sum())
        if passed >= max(MIN_PASSED, MIN_PASSED_FRACTION * piece.echoes):
            found.append(piece)
    return found


def unpassed_gaps(estimate: MapEstimate, pieces: Sequence[Piece]) -> Floats:
    """Return the gaps (g, 4) between neighbouring pieces of a wall, at most a door wide, that no path has crossed."""
    rows = sorted(pieces, key=lambda piece: (piece.wall, piece.low))
    # A gap whose ends corners have moved past one another is reversed, which matters to no crossing.
    gaps = [
        np.concatenate((one.ends[1], other.ends[0]))
        for one, other in pairwise(rows) if one.wall == other.wall and 0.0 < other.low - one.high < MAX_DOOR_IN
    ]  # fmt: skip
    segments = np.array(gaps).reshape(-1, 4)
    found: Floats = segments[crossings(*free_paths(estimate), segments).sum(axis=0) < MIN_CROSSINGS]
    return found


def crossed_at(starts: Floats, ends: Floats, normal: Floats, along: Floats, offset: float) -> Floats:
    """Return the coordinates along a line at which paths cross it."""
    before, after = starts @ normal - offset, ends @ normal - offset
    # A spot just behind the line belongs to a corner of it.
    through = (before * after < 0.0) & (np.abs(after) > MIN_DEPTH_IN)
    fraction = before[through] / (before - after)[through]
    crossed: Floats = (starts[through] + fraction[:, None] * (ends - starts)[through]) @ along
    return crossed


def _feet(estimate: MapEstimate, wall: int) -> tuple[Floats, Mask]:
    """Return the coordinates (n,) along a wall of the spots on it, sorted, and whether no point explains each (n,).

    The others are left out of planes: there such an echo is of the point. A surface has posts, and beside one of these
    an echo may be of either.
    """
    state, echoes = estimate.state, estimate.echoes_of(wall)
    residual, _, spots = residual_matrix(estimate.problem, state, estimate.extents, echoes)
    walls = len(state.walls)
    is_clear = ~(np.abs(residual[:, walls:]).min(axis=1, initial=np.inf) < ALONE_SIGMAS)
    fits = (np.abs(residual[:, wall]) < ROBUST_LIMIT) & (is_clear | (estimate.surface_in > 0.0))
    angle = state.walls[wall, 0]
    feet: Floats = spots[fits, wall] @ np.array((-np.sin(angle), np.cos(angle)))
    order = np.argsort(feet, kind="stable")
    return feet[order], is_clear[fits][order]


def level_weights(estimate: MapEstimate) -> Floats:
    """Return the weights (l,) of the levels in the mean of a surface, from their variances: 1 / (var + SPOT_STD_IN^2).

    A cell between two of the same level weighs as much as these; one in a gap, whose level is unknown, hardly.
    """
    levels = estimate.state.levels
    variances = estimate.problem.level_variances(levels, estimate.assignment) if len(levels) else levels.var_in2
    weights: Floats = 1.0 / (variances + SPOT_STD_IN**2)
    return weights


def surface_line(
    estimate: MapEstimate, wall: int, weights: Floats, part: tuple[float, float] = WHOLE
) -> tuple[Floats, Floats]:
    """Return the line (2,) through the surface of a wall, or of a part of it, and its derivative (l,) by all levels.

    A wall with levels b_c keeps its direction, and its line is shifted to the mean of its levels, of weights w_c:

        angle' = angle,   offset' = offset + sum(w_c b_c) / sum(w_c)

    The straight line that fits the levels best would be slanted where a door stands back at one end, by degrees, and
    all walls beside it would not meet at right angles. A part has a line of its own: where an inner wall divides one
    whose surface stands back by 4 in on one side, the line through both parts would be that of neither. The derivative
    is that of the offset, with the weights as they are; of a plane it is 0.

    Parameters
    ----------
    estimate, wall
        The map, and the number of the wall.
    weights
        (l,) of all levels (`level_weights`).
    part
        Coordinates along the wall between which the cells count; if no cell is there, all cells of the wall do.
    """
    line, levels = estimate.state.walls[wall].copy(), estimate.state.levels
    by_levels, own = np.zeros(len(levels)), levels.of(wall)
    at = LEVEL_CELL_IN * (levels.cell[own] + 0.5)
    is_within = (at > part[0]) & (at < part[1])
    weight = np.where(is_within | (not is_within.any()), weights[own], 0.0)
    if len(at):
        by_levels[own] = weight / weight.sum()
        line[1] += by_levels[own] @ levels.value_in[own]
    return line, by_levels


def _pieces(line: _Line, feet: Floats, is_clear: Mask, points: Floats) -> list[tuple[float, float, int]]:
    """Return runs of feet (sorted): low, high, number.

    Those that a point explains as well (not `is_clear`) fill gaps between posts side by side. They neither begin nor
    end a run, and are in no gap between two points that a door may be in.
    """
    at = np.sort(points[np.abs(points @ line.normal - line.offset) < POINT_ON_LINE_IN] @ line.along)
    gap_in = np.diff(at, prepend=-np.inf, append=np.inf)[np.searchsorted(at, feet)]
    is_kept = np.where(is_clear, _are_no_strays(feet, is_clear, at), gap_in <= MAX_GAP_IN)
    feet, is_clear = feet[is_kept], is_clear[is_kept]
    if is_clear.sum() < MIN_SPOTS:
        return []
    is_cut = [
        gap > MAX_GAP_IN or (gap > MIN_CROSSED_GAP_IN and line.is_crossed(low - BLOCKED_IN, high + BLOCKED_IN))
        for low, high, gap in zip(feet[:-1], feet[1:], np.diff(feet), strict=True)
    ]
    borders, found = np.flatnonzero(is_cut) + 1, []
    for run, is_run_clear in zip(np.split(feet, borders), np.split(is_clear, borders), strict=True):
        if is_run_clear.sum() < MIN_SPOTS:
            continue
        first, last = np.flatnonzero(is_run_clear)[[0, -1]]
        trimmed = _trimmed(_trimmed(run[first : last + 1], at)[::-1], at)[::-1]
        if len(trimmed) >= MIN_SPOTS and trimmed[-1] - trimmed[0] >= MIN_PIECE_IN:
            found.append((float(trimmed[0]), float(trimmed[-1]), len(trimmed)))
    return found


def _are_no_strays(feet: Floats, is_clear: Mask, points: Floats) -> Mask:
    """Return False for the one or two clear feet (sorted) between neighbouring points (sorted) with a gap between them.

    A door stands back between its posts: two mistaken spots on the line of the wall, and it would lead across the door.
    """
    is_kept = np.ones(len(feet), dtype=np.bool_)
    for low, high in pairwise(points.tolist()):
        between = is_clear & (feet > low + POINT_ON_LINE_IN) & (feet < high - POINT_ON_LINE_IN)
        if high - low > MAX_GAP_IN and between.sum() <= MAX_ALONE:
            is_kept &= ~between
    return is_kept


def _without_doubled(pieces: list[Piece], lines: list[_Line]) -> tuple[list[Piece], list[_Line]]:
    """Return pieces and their lines without those that lie on a longer one, which goes on as far as both.

    The sides of a thin wall that was not measured at its end may be two walls of the map: they may be as far apart as
    the sides of a thick one. Where they are not, they are written as one, whose measured part is that of the longer.
    """
    found = dict[int, Piece]()
    for row in sorted(range(len(pieces)), key=lambda row: (-pieces[row].measured_in, row)):
        piece = pieces[row]
        for number, longer in found.items():
            its = lines[number]
            low, high = sorted((piece.ends @ its.along).tolist())
            common_in = min(high, longer.high) - max(low, longer.low)
            if its.off(piece.ends.reshape(-1)) < DOUBLED_IN and common_in > DOUBLED_OVER_IN:
                low, high = min(longer.low, low), max(longer.high, high)
                found[number] = replace(
                    longer, low=low, high=high, ends=np.array((its.at(low), its.at(high))),
                    echoes=longer.echoes + piece.echoes, spots=longer.measured,
                )  # fmt: skip
                break
        else:
            found[row] = piece
    rows = sorted(found)
    return [found[row] for row in rows], [lines[row] for row in rows]


def _owner_of(
    span: Span, lines: list[_Line], runs_of: list[list[tuple[float, float, int]]], near_in: float, has_levels: bool
) -> int | None:
    """Return the number of the nearest line to a span; of walls with levels the nearest that was measured there.

    A wall of two parts with a wide gap between is two walls of the map, each with levels of its own: a post of the one
    may be nearer to the line of the other. Between them the level is unknown, and a span belongs to none of them: None.
    A line without any echoes of its own is as well known as its posts.
    """
    ends = span.ends.reshape(2, 2)
    off = np.array([line.off(span.ends) for line in lines])
    nearest = int(off.argmin())
    if not has_levels or not runs_of[nearest]:
        return nearest
    direction = (ends[1] - ends[0]) / max(float(np.hypot(*(ends[1] - ends[0]))), 1e-9)
    is_measured = np.zeros(len(lines), dtype=np.bool_)
    for number, (line, runs) in enumerate(zip(lines, runs_of, strict=True)):
        first, last = sorted((ends @ line.along).tolist())
        common_in = sum(max(min(high, last) - max(low, first), 0.0) for low, high, _ in runs)
        is_measured[number] = abs(direction @ line.along) > MIN_SQUARE_COS and common_in >= MIN_PIECE_IN
    is_measured &= off < near_in
    return int(np.where(is_measured, off, np.inf).argmin()) if is_measured.any() else None


def _with_spans(
    runs: list[tuple[float, float, int]], line: _Line, spans: list[Span], near_in: float
) -> list[tuple[float, float, int]]:
    """Return runs of feet; those on a line between the points of a near span become one, from point to point."""
    for span in spans:
        ends = span.ends.reshape(2, 2)
        if line.off(span.ends) > near_in:
            continue
        low, high = sorted((ends @ line.along).tolist())
        within = [run for run in runs if run[0] < high and run[1] > low]
        joined = (
            min([low, *(run[0] for run in within)]), max([high, *(run[1] for run in within)]),
            sum(run[2] for run in within) or span.stopped,
        )  # fmt: skip
        runs = [*(run for run in runs if run not in within), joined]
    return runs


def _trimmed(run: Floats, ends: Floats) -> Floats:
    """Return a run of feet without the few last ones that are farther out than a point near its end, or all others."""
    sign = 1.0 if run[-1] >= run[0] else -1.0
    for beyond in range(1, min(MAX_STRAY_SPOTS, len(run) - 1) + 1):
        outer, inner = run[-beyond], run[-beyond - 1]
        is_past_end = ((sign * (outer - ends) > 1.0) & (sign * (ends - inner) > -1.0)).any()
        is_alone = beyond <= MAX_ALONE and sign * (outer - inner) > STRAY_GAP_IN
        if is_past_end or is_alone:
            return run[:-beyond]
    return run


@dataclass(frozen=True, slots=True)
class _Corner:
    """Two pieces whose lines meet: by how much each must grow, and which end of each moves, None for its middle."""

    growth_in: float
    one: int
    other: int
    place: Floats
    one_end: int | None
    other_end: int | None


def _with_ends(
    pieces: list[Piece], lines: list[_Line], points: Floats, paths: tuple[Floats, Floats], surface_in: float
) -> tuple[list[Piece], list[_Line]]:
    """Return pieces with their ends at corners, points and other walls, and their lines, without those of no length.

    Both ends of a short piece across another wall move to where it crosses. It is no wall, and nothing ends at it.
    Where walls have a surface, they have posts: a point on the line before a corner is no end of it.
    """
    while True:
        # 1. As if all of them were walls.
        found = [replace(piece, ends=piece.ends.copy(), closed=[*piece.closed]) for piece in pieces]
        ended = _end_at_dividers(found, lines, paths)
        _join_corners(found, lines, points[:0] if surface_in else points, surface_in)
        # What has no corner there ends at the divider all the same, and not at a post of the span.
        for number, end in ended:
            found[number].closed[end] = True
        _move_ends_to_points(found, lines, points)
        _close_gaps_in_line(found, lines)
        _close_small_gaps(found, surface_in)
        # 2. Once more without those that are none.
        is_long = [
            float((piece.ends[1] - piece.ends[0]) @ line.along) >= MIN_LENGTH_IN
            for piece, line in zip(found, lines, strict=True)
        ]
        if all(is_long):
            return found, lines
        pieces, lines = list(compress(pieces, is_long)), list(compress(lines, is_long))


def _end_at_dividers(
    pieces: list[Piece], lines: list[_Line], paths: tuple[Floats, Floats]
) -> list[tuple[int, int]]:
    """Let walls that lead by a span past the end of another one, behind which no path (p, 2) has led, end there.

    Behind a wedge no sound passes, and its posts make spans that no path has crossed. What is there is not known; both
    parts of the wall that it divides, whose surfaces may stand out differently, would lie side by side.

    Returns
    -------
    list of (int, int)
        Numbers of the pieces, and their ends, that were moved onto the line of a divider.
    """
    moved = []
    for number, (piece, line) in enumerate(zip(pieces, lines, strict=True)):
        for divider, its in zip(pieces, lines, strict=True):
            slope = float(line.along @ its.normal)
            if divider is piece or abs(slope) < np.sin(MIN_CORNER_RAD):
                continue
            # 1. Where it is crossed, up to MAX_GAP_IN beyond the other wall: a robot comes no nearer to the corner.
            at = (its.offset - float(line.at(0.0) @ its.normal)) / slope
            along, (low, high) = float(line.at(at) @ its.along), divider.measured
            nearest = min(max(along, low), high)
            if abs(along - nearest) > MAX_GAP_IN or its.is_crossed(min(nearest, along), max(nearest, along)):
                continue
            # 2. The end beyond, if all that was measured is on the other side, and it is hidden.
            first, last = piece.measured
            for end, sign, hidden_in in ((0, -1.0, at - piece.low), (1, 1.0, piece.high - at)):
                beyond_in = sign * ((first, last)[end] - at)
                if hidden_in <= OVERSHOOT_IN or beyond_in >= OVERSHOOT_IN:
                    continue
                middle = line.at(at + sign * min(HIDDEN_ASIDE_IN, 0.5 * hidden_in))
                probe = np.concatenate((middle - HIDDEN_AHEAD_IN * line.normal, middle + HIDDEN_AHEAD_IN * line.normal))
                if crossings(*paths, probe[None]).sum() < MIN_CROSSINGS:
                    piece.ends[end] = line.at(at)
                    piece.low, piece.high = (at, piece.high) if end == 0 else (piece.low, at)
                    piece.spots = max(first, piece.low), min(last, piece.high)
                    moved.append((number, end))
    return moved


def _join_corners(pieces: list[Piece], lines: list[_Line], points: Floats, step_in: float) -> None:
    """Move ends to the corners of two walls, the nearest corners first.

    Where the surfaces of two parts of a wall differ by up to a step, both have a corner with the wall that divides
    them, whose end is moved to one of these.
    """
    corners = []
    for one in range(len(pieces)):
        for other in range(one + 1, len(pieces)):
            corner = _corner(pieces, lines, one, other)
            if corner is not None:
                corners.append(corner)
    for corner in sorted(corners, key=lambda corner: (corner.growth_in, corner.one, corner.other)):
        ends = ((corner.one, corner.one_end), (corner.other, corner.other_end))
        moves = [
            (number, end) for number, end in ends
            if end is not None and not _is_beside(pieces[number], end, corner.place, step_in)
        ]  # fmt: skip
        if all(_may_move(pieces[number], lines[number], points, end, corner.place) for number, end in moves):
            for number, end in moves:
                pieces[number].ends[end], pieces[number].closed[end] = corner.place, True


def _is_beside(piece: Piece, end: int, place: Floats, step_in: float) -> bool:
    """Return True if an end of a piece has a corner at most so far from a place."""
    return piece.closed[end] and float(np.hypot(*(piece.ends[end] - place))) < step_in


def _corner(pieces: list[Piece], lines: list[_Line], one: int, other: int) -> _Corner | None:
    """Return the corner of two pieces; None if their lines do not meet near an end."""
    first, second = lines[one], lines[other]
    cross = first.normal[0] * second.normal[1] - first.normal[1] * second.normal[0]
    if abs(cross) < np.sin(MIN_CORNER_RAD):
        return None
    place = np.linalg.solve(np.stack((first.normal, second.normal)), np.array((first.offset, second.offset)))
    growths, ends = [], []
    for piece, line in ((pieces[one], first), (pieces[other], second)):
        coordinate = float(place @ line.along)
        beyond = (piece.low - coordinate, coordinate - piece.high)
        end = int(beyond[1] > beyond[0])
        growth = beyond[end]
        if growth > REACH_IN:
            return None
        # Well inside: the other wall ends here, this one goes on.
        ends.append(end if growth > -OVERSHOOT_IN else None)
        growths.append(max(growth, 0.0))
    if ends == [None, None]:
        return None
    return _Corner(sum(growths), one, other, place, *ends)


def _may_move(piece: Piece, line: _Line, points: Floats, end: int, place: Floats) -> bool:
    """Return True if an end of a piece may move to a place: it is open, and nothing speaks against it."""
    if piece.closed[end]:
        return False
    coordinate, present = float(place @ line.along), (piece.low, piece.high)[end]
    if line.is_crossed(min(coordinate, present), max(coordinate, present)):
        return False
    # A point on the line before the corner is where the wall ends.
    sign = 1.0 if end else -1.0
    ahead = sign * (points @ line.along - present)
    on_line = np.abs(points @ line.normal - line.offset) < POINT_ON_LINE_IN
    nearer = on_line & (ahead > -OVERSHOOT_IN) & (ahead < sign * (coordinate - present) - OVERSHOOT_IN)
    return not nearer.any()


def _move_ends_to_points(pieces: list[Piece], lines: list[_Line], points: Floats) -> None:
    """Move open ends to the nearest point on their line."""
    for piece, line in zip(pieces, lines, strict=True):
        on_line = points[np.abs(points @ line.normal - line.offset) < POINT_ON_LINE_IN]
        for end, (present, sign) in enumerate(((piece.low, -1.0), (piece.high, 1.0))):
            if piece.closed[end] or not len(on_line):
                continue
            ahead = sign * (on_line @ line.along - present)
            ahead = np.where(ahead > -OVERSHOOT_IN, np.abs(ahead), np.inf)
            nearest = int(ahead.argmin())
            coordinate = float(on_line[nearest] @ line.along)
            if ahead[nearest] < REACH_IN and not line.is_crossed(min(coordinate, present), max(coordinate, present)):
                piece.ends[end], piece.closed[end] = line.at(coordinate), True


SMALL_GAP_IN: Final = 4.0
"""A gap that `nomad map check` reports, and that no robot passes."""


def _close_gaps_in_line(pieces: list[Piece], lines: list[_Line]) -> None:
    """Let a wall that ends just before another one beside its line, at the faces of a thick wall, reach that one's end.

    It goes on along its own line. What divides them is moved onto it with all other small gaps.
    """
    for piece, line in zip(pieces, lines, strict=True):
        for end in np.flatnonzero(piece.closed).tolist():
            present, sign = float(piece.ends[end] @ line.along), 1.0 if end else -1.0
            for other, its in zip(pieces, lines, strict=True):
                nearest = int(np.argmin(sign * (other.ends @ line.along)))
                off, at = other.ends[nearest] - piece.ends[end], float(other.ends[nearest] @ line.along)
                is_next = sign * (at - present) > ON_LINE_IN and float(np.hypot(*off)) < SMALL_GAP_IN
                is_parallel = abs(float(its.along @ line.normal)) < np.sin(MIN_CORNER_RAD)
                is_open = any(one.is_crossed_between(piece.ends[end], other.ends[nearest]) for one in (line, its))
                if is_next and is_parallel and other.closed[nearest] and not is_open:
                    piece.ends[end] = line.at(at)


def _close_small_gaps(pieces: list[Piece], surface_in: float) -> None:
    """Move ends that stop just before another wall, and touch none, onto it.

    The end of that one may be at the other part of a wall that it divides, whose surface stands out differently.
    """
    beyond_in = SMALL_GAP_IN + surface_in
    # All ends move along their walls, whose directions stay; those of no length have none. A short one across another
    # wall comes to have no length here.
    walls = [(piece, piece.along) for piece in pieces if piece.length_in >= MIN_LENGTH_IN]
    for piece, own in walls:
        for end in range(2):
            others = [(other, along) for other, along in walls if other is not piece]
            segments = np.array([other.ends for other, _ in others]).reshape(-1, 4)
            if nearest_points(piece.ends[end], segments)[1].min(initial=np.inf) < TOUCHING_IN:
                continue
            reached = []
            for number, (other, along) in enumerate(others):
                normal = np.array((-along[1], along[0]))
                slope, distance = float(own @ normal), float((piece.ends[end] - other.ends[0]) @ normal)
                if abs(slope) < np.sin(MIN_CORNER_RAD) or abs(distance) >= SMALL_GAP_IN:
                    continue
                place = piece.ends[end] - own * (distance / slope)
                at, (first, last) = float(place @ along), (other.ends @ along).tolist()
                if first - beyond_in < at < last + beyond_in:
                    # Beyond the end of the other wall, that one must reach the same place.
                    moves = None if first <= at <= last else int(at > last)
                    reached.append((abs(distance / slope), number, place, moves))
            if reached:
                _, number, place, moves = min(reached, key=lambda one: one[:2])
                piece.ends[end], piece.closed[end] = place, True
                if moves is not None:
                    others[number][0].ends[moves], others[number][0].closed[moves] = place, True


# Outlines.


def find_outlines(estimate: MapEstimate, pieces: Sequence[Piece]) -> list[Outline]:
    """Return the closed outlines of boxes, of walls with ends and of points.

    A box has four corners, each at the end of a wall or at a point. At least MIN_SIDES of its sides are walls, or
    silent: sound should have passed there, and has not; or it has not passed all sides together. No path of sound or of
    the robot has crossed a side or a diagonal, and its walls were measured from outside: what lies between a box and a
    wall beside it is not seen either, and no box.
    """
    paths = _distinct(*free_paths(estimate))
    ends = np.array([piece.ends for piece in pieces]).reshape(-1, 2)
    corners, number_of = _corners_of(np.concatenate((ends, estimate.state.points)))
    # 1. Sides: walls, and spans between two points that stop sound.
    walls = {
        (min(one, other), max(one, other)): number
        for number, (one, other) in enumerate(number_of[: len(ends)].reshape(-1, 2).tolist())
        if one != other and pieces[number].length_in <= MAX_BOX_IN
    }
    points = number_of[len(ends) :]
    spans = {
        (min(one, other), max(one, other)): span
        for span in uncrossed_spans(estimate, paths)
        for one, other in [points[[span.one, span.other]].tolist()]
    }  # fmt: skip
    # 2. Two sides that meet, and the fourth corner.
    found: dict[tuple[int, ...], Outline] = {}
    for a, b, c in _meeting([*walls, *(side for side in spans if side not in walls)]):
        for d in _fourth_corners(corners, a, b, c):
            around = [(min(pair), max(pair)) for pair in pairwise((a, b, c, d, a))]
            place, own = corners[[a, b, c, d]], tuple(walls[side] for side in around if side in walls)
            is_new = tuple(sorted((a, b, c, d))) not in found
            if is_new and _is_known(around, walls, spans) and not _is_entered(place, paths) and all(
                _is_outside(estimate, pieces[row], place) for row in own
            ):
                found[tuple(sorted((a, b, c, d)))] = Outline(place, own)
    return list(found.values())


def _fourth_corners(corners: Floats, a: int, b: int, c: int) -> list[int]:
    """Return the corners near to where a parallelogram of the sides a b and b c has its fourth one."""
    one, other = corners[a] - corners[b], corners[c] - corners[b]
    sizes = np.hypot(*one), np.hypot(*other)
    if max(sizes) > MAX_BOX_IN or abs(one[0] * other[1] - one[1] * other[0]) < MIN_BOX_SINE * sizes[0] * sizes[1]:
        return []
    away = np.hypot(*(corners - (corners[a] + corners[c] - corners[b])).T)
    return [d for d in np.flatnonzero(away <= MAX_SKEW_IN).tolist() if d not in {a, b, c}]


def _is_known(
    sides: Sequence[tuple[int, int]], walls: Mapping[tuple[int, int], int], spans: Mapping[tuple[int, int], Span]
) -> bool:
    """Return True if enough of the four sides are walls or silent, or sound has not passed all of them together."""
    own = [spans[side] for side in sides if side in spans]
    closed = sum(side in walls or (side in spans and spans[side].is_wall) for side in sides)
    return closed >= MIN_SIDES or (len(own) == len(sides) and sum(span.stopped for span in own) >= MIN_STOPPED)


def _distinct(starts: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """Return paths (p, 2) to (p, 2) without those that begin and end beside an earlier one; all steps of the robot."""
    is_distinct = np.zeros(len(starts), dtype=np.bool_)
    is_step = np.hypot(*(ends - starts).T) < SAME_END_IN
    for row in range(len(starts)):
        there = np.flatnonzero(is_distinct & ~is_step)
        is_same = np.hypot(*(starts[there] - starts[row]).T) < SAME_START_IN
        is_same &= np.hypot(*(ends[there] - ends[row]).T) < SAME_END_IN
        is_distinct[row] = is_step[row] or not is_same.any()
    return starts[is_distinct], ends[is_distinct]


def _corners_of(places: Floats) -> tuple[Floats, Indices]:
    """Return the different ones (k, 2) of places (n, 2), and the number of each place."""
    corners, numbers = list[Floats](), []
    for place in places:
        away = [float(np.hypot(*(place - corner))) for corner in corners]
        nearest = int(np.argmin(away)) if away else 0
        if not away or away[nearest] > SAME_CORNER_IN:
            nearest = len(corners)
            corners.append(place)
        numbers.append(nearest)
    return np.array(corners).reshape(-1, 2), np.array(numbers, dtype=np.intp)


def _meeting(sides: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int, int]]:
    """Yield the corners of two sides that have one in common, which is the second of the three."""
    for row, one in enumerate(sides):
        for other in sides[row + 1 :]:
            if common := set(one) & set(other):
                (b,) = common
                yield sum(one) - b, b, sum(other) - b


def _is_entered(corners: Floats, paths: tuple[Floats, Floats]) -> bool:
    """Return True if paths have crossed a side or a diagonal of a box with these corners (4, 2)."""
    ones, others = corners[[0, 1, 2, 3, 0, 1]], corners[[1, 2, 3, 0, 2, 3]]
    along = (others - ones) / np.maximum(np.hypot(*(others - ones).T), 1e-9)[:, None]
    inner = np.concatenate((ones + BLOCKED_IN * along, others - BLOCKED_IN * along), axis=1)
    return bool((crossings(*paths, inner).sum(axis=0) >= MIN_CROSSINGS).any())


def _is_outside(estimate: MapEstimate, piece: Piece, corners: Floats) -> bool:
    """Return True if the sonars that measured a wall were on the other side of it than the middle of a box (4, 2)."""
    state, echoes = estimate.state, estimate.echoes_of(piece.wall)
    face = sensors_at(state.poses, state.parameters, estimate.problem.trajectory, echoes).face
    along = (piece.ends[1] - piece.ends[0]) / piece.length_in
    normal, at = np.array((-along[1], along[0])), (face - piece.ends[0]) @ along
    beside = face[(at > 0.0) & (at < piece.length_in)]
    inward = float((corners.mean(axis=0) - piece.ends[0]) @ normal)
    return not len(beside) or float(((beside - piece.ends[0]) @ normal * inward < 0.0).mean()) >= OUTSIDE


# Accuracy.


def _add_accuracy(estimate: MapEstimate, pieces: list[Piece], lines: list[_Line]) -> None:
    """Set the standard deviations of the pieces, of what remains after the best rigid fit of all.

    The displacements of both ends of each piece across it, as far as it was measured, and of all points, are linear in
    the unknowns: d = A u. A rigid motion moves them by N (x, y, turn). What remains after the best fit is
    (I - N F) d with the weighted fit
    F = (N' W N)^-1 N' W. The weights are those of what remains itself, or a single point whose standard deviation is a
    foot would move the whole map. Without the points the only wall across a corridor would be exact, since it alone
    would tell the position along it.
    """
    if not pieces:
        return
    state = estimate.state
    covariance = _covariance_of_lines(estimate, pieces, lines)
    walls = np.array([(np.arctan2(line.normal[1], line.normal[0]), line.offset) for line in lines])
    rows = 2 * (len(pieces) + len(state.points))
    A, N = np.zeros((rows, len(covariance))), np.zeros((rows, POSE))
    for number, (piece, line) in enumerate(zip(pieces, lines, strict=True)):
        for end, coordinate in enumerate(piece.measured):
            row, place = 2 * number + end, line.at(coordinate)
            # The end moves across the wall by d offset - coordinate * d angle.
            A[row, WALL * number : WALL * number + 2] = -coordinate, 1.0
            N[row] = *line.normal, line.normal[1] * place[0] - line.normal[0] * place[1]
    for number, (x, y) in enumerate(state.points):
        row, column = 2 * (len(pieces) + number), WALL * len(pieces) + POINT * number
        A[row, column] = A[row + 1, column + 1] = 1.0
        N[row : row + 2] = (1.0, 0.0, -y), (0.0, 1.0, x)
    weights = np.ones(len(A))
    for _ in range(GAUGE_STEPS):
        fit = np.linalg.pinv(np.sqrt(weights)[:, None] * N) * np.sqrt(weights)
        rest = A - N @ (fit @ A)
        spread = rest @ covariance @ rest.T
        weights = 1.0 / (GAUGE_STD_IN**2 + np.maximum(np.diag(spread), 0.0))
    for number, piece in enumerate(pieces):
        low, high = 2 * number, 2 * number + 1
        middle = 0.25 * (spread[low, low] + spread[high, high] + 2.0 * spread[low, high])
        turn = (spread[low, low] + spread[high, high] - 2.0 * spread[low, high]) / piece.measured_in**2
        piece.std_in, piece.std_rad = float(np.sqrt(max(middle, 0.0))), float(np.sqrt(max(turn, 0.0)))
    # Ends along their walls, without the same rigid motion.
    gauge = fit @ A
    for number, (piece, line) in enumerate(zip(pieces, lines, strict=True)):
        stds: list[float | None] = [None, None]
        for end in range(2):
            derivative = end_derivative(walls, state.points, number, piece.ends[end])
            if not piece.closed[end] or derivative is None:
                continue
            along, place = line.along, piece.ends[end]
            rigid = np.array((along[0], along[1], along[1] * place[0] - along[0] * place[1]))
            end_row = derivative - rigid @ gauge
            stds[end] = max(float(end_row @ covariance @ end_row), 0.0) ** 0.5
        piece.end_stds_in = (stds[0], stds[1])


def _add_surfaces(estimate: MapEstimate, pieces: list[Piece]) -> None:
    """Add the measured spots of their surfaces to the pieces: the middles of cells whose levels have echoes."""
    levels, echoes = estimate.state.levels, estimate.assignment.level
    counts = np.bincount(echoes[echoes != NO_LEVEL], minlength=len(levels))
    stds = np.sqrt(estimate.problem.level_variances(levels, estimate.assignment)) if len(levels) else levels.var_in2
    for piece in pieces:
        own = levels.of(piece.wall)
        at = LEVEL_CELL_IN * (levels.cell[own] + 0.5)
        is_of_piece = (at > piece.low - SPOT_REACH_IN) & (at < piece.high + SPOT_REACH_IN) & (counts[own] > 0)
        spots = np.column_stack((estimate.state.surface(piece.wall), stds[own]))
        piece.surface = spots[is_of_piece]


def end_derivative(walls: Floats, points: Floats, own: int, place: Floats) -> Floats | None:
    """Return the derivative (2 w + 2 v,) of an end along its wall by all walls and points; None if it is of neither.

    Parameters
    ----------
    walls, points
        (w, 2) angle and offset, (v, 2) positions.
    own
        Number of the wall that ends.
    place
        (2,) the end: a point of the map, or where the wall's line meets another, n_i . p = offset_i of both.
    """
    derivative = np.zeros(walls.size + points.size)
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    alongs = np.stack((-normals[:, 1], normals[:, 0]), axis=-1)
    # 1. Where another line passes: p moves by a across the own wall and b along it, n_j . (a n_i + b t_i) = d offset_j.
    for other, (normal, along) in enumerate(zip(normals, alongs, strict=True)):
        slope, cosine = float(alongs[own] @ normal), float(normals[own] @ normal)
        if abs(slope) < np.sin(MIN_CORNER_RAD) or abs(float(place @ normal) - walls[other, 1]) > ON_LINE_IN:
            continue
        derivative[WALL * other : WALL * other + 2] = -float(place @ along) / slope, 1.0 / slope
        derivative[WALL * own : WALL * own + 2] = float(place @ alongs[own]) * cosine / slope, -cosine / slope
        return derivative
    # 2. The point.
    off = points - place
    for number in np.flatnonzero(np.abs(off @ alongs[own]) < ON_LINE_IN):
        if abs(float(off[number] @ normals[own])) < POINT_ON_LINE_IN:
            derivative[walls.size + POINT * number : walls.size + POINT * number + 2] = alongs[own]
            return derivative
    return None


def _covariance_of_lines(estimate: MapEstimate, pieces: Sequence[Piece], lines: Sequence[_Line]) -> Floats:
    """Return the covariance (m, m) of the lines of pieces and of all points, which are linear in the unknowns."""
    covariance, state = covariance_of(estimate), estimate.state
    J = np.zeros((WALL * len(pieces) + state.points.size, len(covariance)))
    first_level = len(covariance) - len(state.levels)
    for number, (piece, line) in enumerate(zip(pieces, lines, strict=True)):
        own = slice(WALL * number, WALL * (number + 1))
        J[own, WALL * piece.wall : WALL * (piece.wall + 1)] = np.eye(WALL)
        J[own.stop - 1, first_level:] = line.by_levels
    J[WALL * len(pieces) :, WALL * len(state.walls) :][:, : state.points.size] = np.eye(state.points.size)
    found: Floats = J @ covariance @ J.T
    return found


def covariance_of(estimate: MapEstimate) -> Floats:
    """Return the covariance (m, m) of the unknowns of a map but its poses: walls, points, parameters, levels."""
    return estimate.problem.normal_equations(estimate.state, estimate.assignment).border_covariance()


def parameter_covariance(estimate: MapEstimate) -> Floats:
    """Return the covariance of the calibration parameters."""
    state = estimate.state
    first = WALL * len(state.walls) + POINT * len(state.points)
    own = slice(first, first + len(state.parameters))
    return covariance_of(estimate)[own, own]


def axes_rad(pieces: Sequence[Piece]) -> float:
    """Return the angle of the axis that lies along most of the length of the walls, from -45 to 45 degrees.

    Walls within 2 degrees of the longest one's direction, or of its perpendicular, are averaged by their length.
    """
    if not pieces:
        return 0.0
    quarter = np.pi / 2.0
    angles = np.array([np.arctan2(piece.along[1], piece.along[0]) for piece in pieces])
    sizes = np.array([piece.measured_in for piece in pieces])
    off = (angles - angles[0] + quarter / 2.0) % quarter - quarter / 2.0
    parallel = np.abs(off) < radians(2.0)
    mean = angles[0] + float((sizes * off)[parallel].sum() / sizes[parallel].sum())
    return float((mean + quarter / 2.0) % quarter - quarter / 2.0)


def final_pose(estimate: MapEstimate) -> Floats:
    """Return the last pose (3,), heading within half a turn."""
    pose: Floats = estimate.state.poses[-1].copy()
    pose[HEADING] = wrap_angle(pose[HEADING])
    return pose
