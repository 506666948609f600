"""Walls and points in the plane: where they are, what blocks sound, and which echoes they may return.

A reflector may explain an echo if its expected range is within the gate, it is in the cone, and the reflecting spot
lies on or near the part of the wall seen so far (`residual_matrix`). A wall with levels blocks sound where its surface
is: one that stands back by 6 in is seen there, and what is on it.

References
----------
Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 1.5: gating.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats, unit_vector
from localization.filters.sonar_cone import to_vertex, to_wall
from localization.filters.sonar_ray import intersect_line
from localization.mapping.measurements import Indices
from localization.mapping.problem import LEVEL_CELL_IN, NO_LEVEL, MapProblem, MapState, Sensors, sensors_at
from worlds import geometry

Mask = npt.NDArray[np.bool_]

GATE_SIGMAS: Final = 3.0
GATE_IN: Final = 0.4
"""Added to the gate: poses and features are uncertain as well."""
OFF_CONE_RAD: Final = radians(4.0)
"""Added to the half angle of a cone: the uncertainty of the heading."""
MIN_GROWTH_IN, MAX_GROWTH_IN, GROWTH = 20.0, 48.0, 0.4
"""A wall may be measured this fraction of its length beyond the part seen so far, within limits: beyond a gap that a
robot passes. The line of a wall of 120 in is known well enough beyond a door, but not beyond another wall: after a turn
at a door a cabinet of the next room, 16 in before an outer wall, was taken for more of that wall."""
MIN_RAY_COS: Final = 0.2
"""A ray may belong to a wall that it meets at most 78 degrees off the normal. In rooms 7 % of the rays meet their wall
at more than 60 degrees, fewer than 1 % at more than 78; what no wall explains gives birth to false ones."""
LEVEL_SIGMAS: Final = 3.5
"""A level that is farther from the line of its wall, as one in 2,000 is, is something else: the echoes of a post 9 in
before a wall were taken for a stretch of it, and its line was 1 in off."""
MIN_CROSSING_RAD: Final = radians(20.0)
"""Lines that cross at a smaller angle may be of one wall."""
BLOCKED_IN: Final = 2.0
"""A path is blocked by a wall at least this far before its end, and this far within the wall."""
END_IN, END_ASIDE_IN = 8.0, 1.0
"""A point so near to the end that a wall's echoes show, and to its line, is its end: sound from 30 in away that has its
foot 8 in beyond comes an inch late."""
MAX_GAP_IN: Final = 20.0
"""Widest part of a wall without a reflecting spot: a gap that a robot of 19 in passes is wider."""


def segments_of(walls: Floats, extents: Floats) -> Floats:
    """Return walls (w, 2) of extents (w, 2) as segments (w, 4)."""
    c, s = np.cos(walls[:, 0]), np.sin(walls[:, 0])
    along, base = np.stack((-s, c), -1), np.stack((c, s), -1) * walls[:, 1:]
    return np.concatenate((base + extents[:, :1] * along, base + extents[:, 1:] * along), axis=-1)


def surface_segments(state: MapState, parts: Floats) -> Floats:
    """Return the surfaces of parts of walls as segments (s, 4): of each level, and from one level to the next.

    Parameters
    ----------
    state
        Walls and their levels.
    parts
        (r, 3) wall, first and last coordinate along it.
    """
    levels, (walls, low, high) = state.levels, parts.T
    # 1. The parts end in pieces of one level each, where this changes.
    border_in = LEVEL_CELL_IN * levels.cell
    part, border = np.nonzero(
        levels.is_new & (levels.wall == walls[:, None]) & (border_in > low[:, None]) & (border_in < high[:, None])
    )
    all_parts = np.arange(len(parts))
    at, number = np.concatenate((low, border_in[border], high)), np.concatenate((all_parts, part, all_parts))
    order = np.lexsort((at, number))
    at, number = at[order], number[order]
    is_piece = number[1:] == number[:-1]
    ends, number = np.stack((at[:-1], at[1:]), axis=1)[is_piece], number[:-1][is_piece]
    # 2. Both ends of each in the plane.
    wall = walls[number].astype(np.intp)
    row, _ = levels.nearest(wall, ends.mean(axis=1))
    angle, offset = state.walls[wall].T
    offset = offset + np.append(levels.value_in, 0.0)[row]
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    spots = np.stack((c * offset[:, None] - s * ends, s * offset[:, None] + c * ends), axis=-1)
    # 3. From the end of a piece to the beginning of the next one of its part.
    is_step = number[1:] == number[:-1]
    steps = np.concatenate((spots[:-1, 1], spots[1:, 0]), axis=1)[is_step]
    return np.concatenate((spots.reshape(-1, 4), steps))


def crossings(starts: Floats, ends: Floats, segments: Floats) -> Mask:
    """Return True (p, s) where the path (p, 2) to (p, 2) crosses the segment (s, 4)."""
    return geometry.crossings(np.concatenate((starts, ends), axis=1), segments)


def is_blocked(starts: Floats, ends: Floats, segments: Floats, before_in: float = BLOCKED_IN) -> Mask:
    """Return True (p,) for paths that cross a segment at least so many inches before their end."""
    span = ends - starts
    length = np.maximum(np.hypot(span[:, 0], span[:, 1]), 1e-9)
    before = starts + span * (np.maximum(length - before_in, 0.0) / length)[:, None]
    return np.asarray(crossings(starts, before, segments).any(axis=1), dtype=np.bool_)


def sides_of(places: Floats, walls: Floats) -> Floats:
    """Return the side (p, w) of each wall (w, 2) on which each place (p, 2) is: 1 where its normal points, else -1."""
    normals = np.stack((np.cos(walls[:, 0]), np.sin(walls[:, 0])), axis=-1)
    return np.where(places @ normals.T > walls[:, 1], 1.0, -1.0)


def along_and_across(points: Floats, walls: Floats) -> tuple[Floats, Floats]:
    """Return the coordinates (v, w) of points (v, 2) along walls (w, 2), and their distances (v, w) from the lines.

    The direction of a wall is its normal turned left; distances are positive where the normal points.
    """
    c, s = np.cos(walls[:, 0]), np.sin(walls[:, 0])
    x, y = points[:, :1], points[:, 1:]
    return y * c - x * s, x * c + y * s - walls[:, 1]


class WallGeometry(NamedTuple):
    """Where walls are from sonars, each (e, w).

    Attributes
    ----------
    range_in
        Expected ranges.
    cosine
        Of the angle off the axis. Of exact rays it is 1, or -1 where a ray leads away from the wall or along it. So it
        is where the level is that of no surface.
    foot
        Coordinates along the walls at which the echoes are reflected.
    offset_in
        Of the surfaces there.
    level_var
        Variances of the levels there, in^2; (1, 1) of planes.
    """

    range_in: Floats
    cosine: Floats
    foot: Floats
    offset_in: Floats
    level_var: Floats


def wall_geometry(
    problem: MapProblem, state: MapState, sensors: Sensors, numbers: slice = slice(None)
) -> WallGeometry:
    """Return where walls are, all or some, from the sonars at echoes."""
    walls = state.walls[numbers]
    c, s = np.cos(walls[None, :, 0]), np.sin(walls[None, :, 0])
    offset = walls[None, :, 1]
    x, y, axis = sensors.face[:, :1], sensors.face[:, 1:], sensors.axis[:, None]
    reflection, variance, is_of_it = problem.reflection, np.zeros((1, 1)), np.ones((1, 1), dtype=np.bool_)
    if reflection.surface_std_in:
        # The level where the echo comes from, and how uncertain it is farther on.
        feet = c * y - s * x
        row, away_in = state.levels.nearest(np.arange(len(state.walls))[numbers], feet)
        a = np.where(row != NO_LEVEL, reflection.correlation(away_in), 0.0)
        level = a * np.append(state.levels.value_in, 0.0)[row]
        offset, is_of_it = offset + level, np.abs(level) < LEVEL_SIGMAS * reflection.surface_std_in
        variance = reflection.surface_std_in**2 * (1.0 - a * a) + a * a * np.append(state.levels.var_in2, 0.0)[row]
    if problem.rays:
        dx, dy = unit_vector(axis)
        ranges, _, cosine = intersect_line(x, y, dx, dy, (c, s, offset))
        cosine = np.where((ranges > 0.0) & (np.abs(cosine) > MIN_RAY_COS), 1.0, -1.0)
        foot = c * (y + ranges * dy) - s * (x + ranges * dx)
    else:
        ranges, toward_x, toward_y, back = to_wall(x, y, offset * c, offset * s, c, s)
        cosine, foot = toward_x * np.cos(axis) + toward_y * np.sin(axis), -back
    return WallGeometry(ranges, np.where(is_of_it, cosine, -1.0), foot, offset, variance)


def growth_of(walls: Floats, extents: Floats) -> Floats:
    """Return how far walls (w, 2) may go on beyond either end (w, 2) of the part of them that was seen.

    Beyond another wall that they meet there only MIN_GROWTH_IN: in line with them may be a cabinet of the next room.
    """
    growth = np.clip(GROWTH * (extents[:, 1:] - extents[:, :1]), MIN_GROWTH_IN, MAX_GROWTH_IN)
    # The crossing of two lines, (w, w) along the one and along the other.
    angle, offset = walls.T
    between = angle - angle[:, None]
    crosses = np.abs(np.sin(between)) > np.sin(MIN_CROSSING_RAD)
    along = (offset - offset[:, None] * np.cos(between)) / np.where(crosses, np.sin(between), 1.0)
    of_other, (low, high) = along.T, extents.T
    is_met = crosses & (of_other > low - END_IN) & (of_other < high + END_IN)
    onward = np.stack((extents[:, :1] - along, along - extents[:, 1:]), axis=-1)
    limit = np.where(is_met[..., None] & (onward > -END_IN), np.maximum(onward, 0.0) + MIN_GROWTH_IN, np.inf)
    found: Floats = np.minimum(growth, limit.min(axis=1, initial=np.inf))
    return found


def residual_matrix(
    problem: MapProblem, state: MapState, extents: Floats, echoes: Indices, sensors: Sensors | None = None
) -> tuple[Floats, Sensors, Floats]:
    """Return the residuals (e, f) of echoes by all features in standard deviations, inf where one cannot explain it.

    Parameters
    ----------
    problem, state, extents
        The map.
    echoes
        (e,) numbers of the echoes.
    sensors
        The sonars at them; by default those of the state.

    Returns
    -------
    tuple
        The residuals; the sonars (e,); the reflecting spots (e, f, 2).
    """
    if sensors is None:
        sensors = sensors_at(state.poses, state.parameters, problem.trajectory, echoes)
    # 1. Walls: in the cone, and near the part seen so far.
    of_walls = wall_geometry(problem, state, sensors)
    feet, growth = of_walls.foot, growth_of(state.walls, extents)
    on_wall = (feet > extents[:, 0] - growth[:, 0]) & (feet < extents[:, 1] + growth[:, 1])
    c, s = np.cos(state.walls[:, 0]), np.sin(state.walls[:, 0])
    spots = np.stack((c * of_walls.offset_in - s * feet, s * of_walls.offset_in + c * feet), axis=-1)
    # 2. Points.
    x, y = sensors.face[:, :1], sensors.face[:, 1:]
    far, toward_x, toward_y = to_vertex(x, y, state.points[None, :, 0], state.points[None, :, 1])
    of_point = toward_x * np.cos(sensors.axis)[:, None] + toward_y * np.sin(sensors.axis)[:, None]
    ranges, cosine = (
        np.concatenate(pair, axis=1) for pair in ((of_walls.range_in, far), (of_walls.cosine, of_point))
    )
    everywhere = np.ones(far.shape, dtype=np.bool_)
    spots = np.concatenate((spots, np.broadcast_to(state.points, (*far.shape, 2))), 1)
    # 3. The gate.
    std = problem.trajectory.std_in[echoes][:, None]
    if problem.reflection.surface_std_in:
        of_points = np.broadcast_to(std, far.shape)
        std = np.concatenate((np.sqrt(std**2 + of_walls.level_var), of_points), axis=1)
    residual = sensors.range_in[:, None] - ranges
    fits = np.abs(residual) < GATE_SIGMAS * std + GATE_IN
    in_cone = cosine > np.cos(problem.reflection.half_cone_rad + OFF_CONE_RAD)
    fits &= in_cone & np.concatenate((on_wall, everywhere), 1)
    return np.where(fits, residual / std, np.inf), sensors, spots


def parts_of(runs: Floats, extents: Floats) -> Floats:
    """Return the measured parts (r, 3) of walls: wall, first and last coordinate; walls without runs (r, 3) are one."""
    others = np.setdiff1d(np.arange(len(extents)), runs[:, 0].astype(np.intp))
    return np.concatenate((runs, np.column_stack((others, extents[others]))))


@dataclass(frozen=True, slots=True)
class PartEnds:
    """Points near ends of the parts of walls, each (v, w).

    `side` is 1 where the nearest part begins at a point, -1 where it ends, else 0. `is_within` is True for points
    inside of a part.
    """

    side: Floats
    is_within: Mask


def ends_of_parts(parts: Floats, along: Floats) -> PartEnds:
    """Return the points at ends of the parts (r, 3) of walls, by their coordinates (v, w) along these."""
    down, up = np.full(along.shape, np.inf), np.full(along.shape, np.inf)
    is_within = np.zeros(along.shape, dtype=np.bool_)
    for wall, low, high in parts.tolist():
        at, number = along[:, int(wall)], int(wall)
        # Each half of a short part belongs to its nearer end.
        inner = min(END_IN, 0.5 * (high - low))
        is_above, is_below = at > high - inner, at <= low + inner
        down[:, number] = np.where(is_above, np.minimum(down[:, number], np.abs(at - high)), down[:, number])
        up[:, number] = np.where(is_below, np.minimum(up[:, number], np.abs(low - at)), up[:, number])
        is_within[:, number] |= ~is_above & ~is_below
    is_near = (np.minimum(down, up) < MAX_GAP_IN) & ~is_within
    return PartEnds(np.where(is_near, np.where(down < up, -1.0, 1.0), 0.0), is_within)
