"""Differences between a map and a drive: walls that have moved, are missing or new, and an error of scale.

    drive --> walls of its own (learn.py) --> fit to the map --> comparison wall by wall --> the map with the changes

The map is not used to learn the walls, so that it cannot hide what has changed. Both are compared after a robust fit of
position, direction and scale, which begins at the start pose; walls that have moved are its outliers. A wall of the map
is missing where paths of sound or the robot have crossed it and nothing was measured on it.

References
----------
Holland, Welsch, Robust Regression Using Iteratively Reweighted Least-Squares (1977).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, radians
from typing import Any, Final, NamedTuple

import numpy as np

from localization.filters.belief import HEADING, Floats, compose, rotate, wrap_angle
from localization.mapping.association import MapEstimate
from localization.mapping.output import MapRefused, describe
from localization.mapping.problem import robust_weight
from localization.mapping.reflectors import Mask
from localization.mapping.spans import MIN_CORNER_RAD
from localization.mapping.walls import SMALL_GAP_IN, Piece, crossed_at, extract_walls, free_paths
from worlds.geometry import lengths, nearest_points
from worlds.world import StartPose, WallAccuracy, World, moved_surface, spots_beside

START_STD: Final = (2.0, 2.0, radians(5.0))
"""Standard deviations of the start pose, in, in, rad: the first legs of a drive measure its heading poorly."""
SCALE_STD: Final = 0.05
"""Prior of the scale: a map in other units is refused."""
MATCH_IN, MATCH_RAD = 24.0, radians(20.0)
"""A wall is compared with those of the map within this distance and turn."""
FIT_STDS_IN: Final = (3.0, 3.0, 1.5, 1.5, 0.8, 0.8, 0.5, 0.5, 0.5)
"""Standard deviation of a wall in each step of the fit: from the start pose's accuracy to that of the walls."""
MIN_CHANGE_IN, MIN_CHANGE_RAD = 1.0, radians(3.0)
"""Smaller differences are no change; and none within 3 standard deviations."""
MIN_SCALE_IN: Final = 0.5
"""An error of scale moves walls by more than this."""
MIN_MISSING_IN, MIN_PATHS = 8.0, 4
"""Part of a wall that paths have crossed, and their number, from which it is missing."""
REACH_IN: Final = 24.0
"""The rest of a missing part, to the next place where the wall was measured, is missing too if it is shorter."""
MIN_REST_IN: Final = 4.0
TOUCHING_IN: Final = 0.6
"""Ends of walls this near to one another are one corner."""


class Change(NamedTuple):
    """A proposed change: "moved", "missing" or "new"; the wall (4,) before and after, None if there is none.

    `row` is that of the wall in the map, -1 for a new one; `by_in` how far it has moved across its direction.
    """

    kind: str
    row: int
    before: Floats | None
    after: Floats | None
    by_in: float = 0.0
    accuracy: WallAccuracy | None = None

    def __str__(self) -> str:
        """Return a line of text."""
        shown = self.after if self.before is None else self.before
        assert shown is not None
        x1, y1, x2, y2 = shown
        by = f"  by {self.by_in:+.1f} in" if self.kind == "moved" else ""
        return f"{self.kind:8} ({x1:7.1f}, {y1:7.1f})-({x2:7.1f}, {y2:7.1f}){by}"


@dataclass(frozen=True, slots=True)
class MapDifference:
    """Differences between a map and a drive.

    Attributes
    ----------
    changes
        What to change.
    unchanged, unseen
        Rows of the walls that were measured where they are, and of those of which nothing was measured.
    scale, scale_std
        Size of the rooms over that of the map, and its standard deviation; 1 if the difference is not significant.
    pose
        Where the robot stands now (3,), in the frame of the map, after the change of scale.
    world
        The map with the changes.
    """

    changes: tuple[Change, ...]
    unchanged: tuple[int, ...]
    unseen: tuple[int, ...]
    scale: float
    scale_std: float
    pose: Floats
    world: World

    @property
    def is_empty(self) -> bool:
        """True if the drive confirms the map."""
        return not self.changes and self.scale == 1.0

    def as_json(self) -> dict[str, Any]:
        """Return the differences as plain data: inches and degrees, in the units of the keys."""
        return {
            "changes": [
                {
                    "kind": change.kind,
                    "row": None if change.row < 0 else change.row,
                    "before_in": None if change.before is None else change.before.tolist(),
                    "after_in": None if change.after is None else change.after.tolist(),
                    "by_in": change.by_in,
                }
                for change in self.changes
            ],
            "unchanged": list(self.unchanged),
            "unseen": list(self.unseen),
            "scale": self.scale,
            "scale_std": self.scale_std,
            "pose": [*self.pose[:2].tolist(), degrees(float(self.pose[HEADING]))],
        }

    def lines(self) -> list[str]:
        """Return the differences as lines of text."""
        lines = [str(change) for change in self.changes]
        if self.scale != 1.0:
            off = 100.0 * (self.scale - 1.0)
            lines.append(f"scale    the map is {abs(off):.2f} % too {'small' if off > 0 else 'large'} "
                         f"(standard deviation {100.0 * self.scale_std:.2f} %)")  # fmt: skip
        lines.append(
            f"{len(self.changes)} changes; {len(self.unchanged)} walls as in the map, {len(self.unseen)} not measured"
        )
        return lines


class _Fit(NamedTuple):
    """Places of the drive in the map: scale, turn, shift (2,); which walls (n,) agree; standard deviation of scale."""

    scale: float
    turn: float
    shift: Floats
    agrees: Mask
    scale_std: float

    def places(self, points: Floats) -> Floats:
        """Return points (n, 2) of the drive in the map."""
        return self.scale * rotate(points, np.full(len(points), self.turn)) + self.shift


def compare(world: World, estimate: MapEstimate, start: Floats, rest: Floats, turret_rad: float = 0.0) -> MapDifference:
    """Return the differences between a map and a drive.

    Parameters
    ----------
    world
        The map.
    estimate
        The finished estimate of the drive.
    start
        Pose (3,) at its beginning in the frame of the map, within START_STD.
    rest
        Motion after its last pose (3,).
    turret_rad
        Angle of the turret from the heading at the end.

    Raises
    ------
    MapRefused
        If the drive makes no map, or one that does not fit this map from that start.
    """
    # 1. Walls of the drive, as far as they were measured, in the frame of its first pose.
    own = describe(estimate)
    if reason := own.reason_to_refuse():
        raise MapRefused(reason)
    pieces = extract_walls(estimate)
    measured = np.array([piece.measured_ends for piece in pieces])
    stds = np.array([piece.std_in for piece in pieces])
    first = estimate.state.poses[0]
    turn = float(wrap_angle(start[HEADING] - first[HEADING]))
    begin = _Fit(1.0, turn, start[:2] - rotate(first[:2], np.array(turn)), np.zeros(len(pieces), dtype=np.bool_), 0.0)
    # 2. The fit, with scale if that is significant.
    fit = _fitted(world.walls, measured, stds, begin, SCALE_STD)
    size_in = float(np.ptp(measured.reshape(-1, 2), axis=0).max()) / 2.0
    if abs(fit.scale - 1.0) < max(3.0 * fit.scale_std, MIN_SCALE_IN / size_in):
        fit = _fitted(world.walls, measured, stds, begin, 0.0)
    directions = _directions(measured)[fit.agrees]
    if not len(directions) or np.abs(np.sin(directions[:, None] - directions)).max() < np.sin(MATCH_RAD):
        raise MapRefused(
            f"{int(fit.agrees.sum())} of {len(pieces)} walls fit the map from this start, and none at an angle to "
            "them: give the pose at which the drive began with --start X,Y,DEG"
        )
    # 3. The map at the size of the rooms: a place of the drive is scaled no more.
    true = _Fit(1.0, fit.turn, fit.shift / fit.scale, fit.agrees, fit.scale_std)
    walls = world.walls / fit.scale
    starts, ends = (true.places(points) for points in free_paths(estimate))
    pieces = [piece.placed(true.places) for piece in pieces]
    ends_of = np.array([piece.ends for piece in pieces]).reshape(-1, 4)
    placed = true.places(measured.reshape(-1, 2)).reshape(-1, 4)
    last = estimate.state.poses[-1]
    pose = compose(np.array((*true.places(last[None, :2])[0], last[HEADING] + true.turn)), rest)
    pose[HEADING] = wrap_angle(pose[HEADING])
    found = _compared(walls, pieces, placed, ends_of, starts, ends)
    after, accuracies, names = _changed(world, walls, found.changes, found.parts)
    x, y, heading = pose.tolist()
    standing = StartPose(round(x, 3), round(y, 3), round(heading, 4), round(wrap_angle(heading + turret_rad), 4))
    changed = World(
        world.name, world.title, inner_walls=after, starts=(standing,), accuracies=accuracies, wall_names=names
    )
    scale = 1.0 / fit.scale
    return MapDifference(
        tuple(found.changes), tuple(found.unchanged), tuple(found.unseen), scale, fit.scale_std, pose, changed
    )


def _directions(ends: Floats) -> Floats:
    """Return the directions (n,) of walls (n, 2, 2)."""
    span = ends[:, 1] - ends[:, 0]
    directions: Floats = np.arctan2(span[:, 1], span[:, 0])
    return directions


def _normals(walls: Floats) -> tuple[Floats, Floats, Floats]:
    """Return directions and normals (m, 2) of walls (m, 4), and their offsets (m,)."""
    along = (walls[:, 2:] - walls[:, :2]) / np.maximum(lengths(walls), 1e-9)[:, None]
    normals = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    return along, normals, (normals * walls[:, :2]).sum(axis=1)


def _turns(walls: Floats, ends: Floats) -> Floats:
    """Return the angles (n, m) from walls (m, 4) to walls (n, 2, 2), within a quarter turn."""
    along = _directions(walls.reshape(-1, 2, 2))
    turns: Floats = wrap_angle(2.0 * (_directions(ends)[:, None] - along)) / 2.0
    return turns


def _partners(walls: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """Return for walls (n, 2, 2) the row of the nearest wall of about their direction, and its distance (n,)."""
    distances = nearest_points(ends.mean(axis=1), walls)[1]
    distances = np.where(np.abs(_turns(walls, ends)) < MATCH_RAD, distances, np.inf)
    return distances.argmin(axis=1), distances.min(axis=1)


def _fitted(walls: Floats, measured: Floats, stds_in: Floats, begin: _Fit, scale_std: float) -> _Fit:
    """Return the robust fit of walls (n, 2, 2) to a map (m, 4); without scale if its standard deviation is 0."""
    _, normals, offsets = _normals(walls)
    sizes = np.hypot(*(measured[:, 1] - measured[:, 0]).T)
    # 1. The direction, of which walls that have moved are as good a measure.
    ends = begin.places(measured.reshape(-1, 2)).reshape(measured.shape)
    rows, away = _partners(walls, ends)
    turns = _turns(walls, ends)[np.arange(len(rows)), rows]
    near = away < MATCH_IN
    if not near.any():
        return begin
    turn = begin.turn - _weighted_median(turns[near], sizes[near])
    scale, shift = 1.0, begin.shift.copy()
    agrees, information = begin.agrees, np.eye(4)
    for std_in in FIT_STDS_IN:
        # 2. Distances of both ends from the nearest wall, and their derivatives by shift, turn and log scale.
        fit = _Fit(scale, turn, shift, agrees, 0.0)
        ends = fit.places(measured.reshape(-1, 2)).reshape(measured.shape)
        rows, away = _partners(walls, ends)
        normal = normals[rows]
        r = (ends * normal[:, None]).sum(axis=-1) - offsets[rows, None]
        from_shift = ends - shift
        by_turn = normal[:, None, 1] * from_shift[..., 0] - normal[:, None, 0] * from_shift[..., 1]
        by_scale = (normal[:, None] * from_shift).sum(axis=-1)
        J = np.stack((*np.broadcast_arrays(normal[:, None, 0], normal[:, None, 1], by_turn), by_scale), axis=-1)
        # 3. Weighted by length, at most that of a few feet; outliers lose their weight.
        std = np.hypot(std_in, stds_in)[:, None]
        weight = np.where(away[:, None] < MATCH_IN, robust_weight(r / std) * np.minimum(sizes, 48.0)[:, None] / 48.0, 0)
        weight = (weight / std**2).reshape(-1)
        J, r = J.reshape(-1, 4), r.reshape(-1)
        prior = np.array((*(begin.shift - shift), begin.turn - turn, -np.log(scale)))
        information = np.diag([*(np.array(START_STD) ** -2), 1e-4 + max(scale_std, 1e-6) ** -2])
        step = np.linalg.solve(
            information + J.T @ (J * weight[:, None]), -J.T @ (weight * r) + information @ prior
        )
        shift, turn = shift + step[:2], turn + float(step[2])
        scale = scale * float(np.exp(step[3])) if scale_std else 1.0
        agrees = (np.abs(r.reshape(-1, 2)).max(axis=1) < np.maximum(MIN_CHANGE_IN, 3.0 * stds_in)) & (away < MATCH_IN)
    # 4. The errors of the walls may be common to all, as that of the sonars' offset is: no average.
    arms = by_scale[agrees].mean(axis=1) if agrees.any() else np.ones(1)
    spread = float(np.sqrt(np.square(arms - arms.mean()).mean()))
    common = float(np.sqrt(np.square(stds_in).mean()))
    return _Fit(scale, turn, shift, agrees, common / max(spread, 1.0))


def _weighted_median(values: Floats, weights: Floats) -> float:
    """Return the value below which half of the weight is."""
    order = np.argsort(values)
    half = np.searchsorted(np.cumsum(weights[order]), 0.5 * weights.sum())
    return float(values[order][min(half, len(values) - 1)])


# The comparison.


class _Comparison(NamedTuple):
    """Changes, rows of unchanged and of unseen walls, and the missing parts (from, to) along each wall."""

    changes: list[Change]
    unchanged: list[int]
    unseen: list[int]
    parts: dict[int, list[tuple[float, float]]]


def _compared(
    walls: Floats, pieces: Sequence[Piece], placed: Floats, ends_of: Floats, starts: Floats, ends: Floats
) -> _Comparison:
    """Return the comparison of a map (m, 4) with the walls of a drive, measured (n, 4) and with their ends (n, 4)."""
    found = _Comparison([], [], [], {})
    along, normals, offsets = _normals(walls)
    sizes, turns = lengths(walls), np.abs(_turns(walls, placed.reshape(-1, 2, 2)))
    middles = placed.reshape(-1, 2, 2).mean(axis=1)
    across = middles @ normals.T - offsets
    std_in, std_rad = (np.array([getattr(piece, name) for piece in pieces]) for name in ("std_in", "std_rad"))
    # 1. Walls of the drive on walls of the map, and the intervals that they confirm.
    base = (walls[:, :2] * along).sum(axis=1)
    spans = np.sort(np.einsum("nkd,md->nmk", placed.reshape(-1, 2, 2), along) - base[:, None], axis=-1)
    overlap = np.minimum(spans[..., 1], sizes) - np.maximum(spans[..., 0], 0.0)
    overlaps = overlap > 0.5 * np.minimum(spans[..., 1] - spans[..., 0], sizes)
    is_on = (np.abs(across) < np.maximum(MIN_CHANGE_IN, 3.0 * std_in)[:, None]) & overlaps
    is_on &= turns < np.maximum(MIN_CHANGE_RAD, 3.0 * std_rad)[:, None]
    # The ends of thick walls, which have no echoes of their own, confirm walls and show no change.
    is_free = ~is_on.any(axis=1) & (np.array([piece.echoes for piece in pieces]) > 0)
    for row in range(len(walls)):
        confirmed = [(float(low), float(high)) for low, high in spans[is_on[:, row], row]]
        crossed = crossed_at(starts, ends, normals[row], along[row], float(offsets[row])) - base[row]
        parts = _missing_parts(sizes[row], np.sort(crossed), sorted(confirmed))
        missing_in = sum(high - low for low, high in parts)
        # 2. Moved: nothing is on it, and beside it is a wall that is on none.
        beside = is_free & (turns[:, row] < MATCH_RAD) & overlaps[:, row] & (np.abs(across[:, row]) < MATCH_IN)
        is_moved = not confirmed and bool(beside.any())
        if is_moved:
            number = int(np.where(beside, np.abs(across[:, row]), np.inf).argmin())
            is_free[number] = False
            by_in = float(across[number, row])
            found.changes.append(
                Change("moved", row, walls[row], ends_of[number], by_in, pieces[number].accuracy)
            )
        elif parts:
            found.parts[row] = parts
            found.changes.extend(
                Change("missing", row, np.concatenate([walls[row, :2] + at * along[row] for at in part]), None)
                for part in parts
            )
        # 3. The rest of it, or all: as it was, or unseen.
        if not is_moved and missing_in < sizes[row]:
            (found.unchanged if confirmed else found.unseen).append(row)
    # 4. New: what is left.
    found.changes.extend(
        Change("new", -1, None, ends_of[number], 0.0, pieces[number].accuracy)
        for number in np.flatnonzero(is_free).tolist()
    )
    return found


def _missing_parts(
    size_in: float, crossed: Floats, confirmed: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return the parts of a wall that paths cross at coordinates (sorted), between the intervals that are confirmed."""
    parts, low = [], 0.0
    for begin, end in [*confirmed, (size_in, size_in)]:
        inside = crossed[(crossed > low) & (crossed < min(begin, size_in))]
        if len(inside) >= MIN_PATHS and inside[-1] - inside[0] >= MIN_MISSING_IN:
            first, last = float(inside[0]), float(inside[-1])
            # To the next place where the wall is, if that is not far.
            first = low if first - low < REACH_IN else first
            last = begin if begin - last < REACH_IN else last
            parts.append((first, min(last, size_in)))
        low = max(low, end)
    return parts


# The map with the changes.


def _changed(
    world: World, walls: Floats, changes: Sequence[Change], parts: dict[int, list[tuple[float, float]]]
) -> tuple[Floats, dict[int, WallAccuracy], dict[int, str]]:
    """Return the walls (k, 4) after the changes, the accuracies of those that were measured, and the names."""
    first = len(world.fixed_walls) - len(world.inner_walls)
    rows = {row: wall.copy() for row, wall in enumerate(walls)}
    accuracies = {
        row: accuracy._replace(surface=moved_surface(accuracy.surface, world.walls[row], walls[row]))
        for row, accuracy in ((first + row, accuracy) for row, accuracy in world.accuracies.items())
    }
    moved = {change.row: change for change in changes if change.kind == "moved"}
    # 1. Moved walls keep their corners: both lines go on to where they meet.
    for row, change in moved.items():
        assert change.after is not None
        assert change.accuracy is not None
        line = change.after
        wall = _projected(walls[row], line)
        for end in (0, 2):
            for other, neighbour in rows.items():
                corner = walls[row, end : end + 2]
                at = [k for k in (0, 2) if np.hypot(*(walls[other, k : k + 2] - corner)) < TOUCHING_IN]
                if other == row or not at:
                    continue
                other_line = moved[other].after if other in moved else neighbour
                assert other_line is not None
                place = _intersection(line, other_line)
                if place is not None:
                    wall[end : end + 2] = place
                    neighbour[at[0] : at[0] + 2] = place
        rows[row], accuracies[row] = wall, change.accuracy
    # 2. Missing parts are cut out.
    after: list[Floats] = []
    stated: dict[int, WallAccuracy] = {}
    names: dict[int, str] = {}
    for row, wall in rows.items():
        for rest in _without(wall, parts.get(row, [])):
            if row in accuracies:
                surface = spots_beside(accuracies[row].surface, rest.tolist())
                stated[len(after)] = accuracies[row]._replace(surface=surface)
            if row - first in world.wall_names:
                names[len(after)] = world.wall_names[row - first]
            after.append(rest)
    # 3. New walls end at the walls that they reach.
    for change in changes:
        if change.kind == "new":
            assert change.after is not None
            assert change.accuracy is not None
            stated[len(after)] = change.accuracy
            after.append(_snapped(change.after, np.array(after).reshape(-1, 4)))
    return np.round(np.array(after).reshape(-1, 4), 4) + 0.0, stated, names


def _projected(wall: Floats, line: Floats) -> Floats:
    """Return a wall (4,) with its ends on a line (4,)."""
    along = (line[2:] - line[:2]) / lengths(line)
    return np.concatenate([line[:2] + along * ((wall[k : k + 2] - line[:2]) @ along) for k in (0, 2)])


def _intersection(one: Floats, other: Floats) -> Floats | None:
    """Return where the lines of two walls (4,) meet; None if they are nearly parallel."""
    _, normals, offsets = _normals(np.stack((one, other)))
    if abs(normals[0, 0] * normals[1, 1] - normals[0, 1] * normals[1, 0]) < np.sin(MIN_CORNER_RAD):
        return None
    place: Floats = np.asarray(np.linalg.solve(normals, offsets), dtype=np.float64)
    return place


def _without(wall: Floats, parts: list[tuple[float, float]]) -> list[Floats]:
    """Return what is left of a wall (4,) without parts (from, to) of its length."""
    size, along = float(lengths(wall)), (wall[2:] - wall[:2]) / max(float(lengths(wall)), 1e-9)
    cuts = [0.0, *(at for part in parts for at in part), size]
    return [
        np.concatenate((wall[:2] + low * along, wall[:2] + high * along))
        for low, high in zip(cuts[::2], cuts[1::2], strict=True)
        if high - low > (MIN_REST_IN if parts else 0.0)
    ]


def _snapped(wall: Floats, walls: Floats) -> Floats:
    """Return a wall (4,) whose ends are moved to the lines of walls that they nearly reach."""
    wall = wall.copy()
    for end in (0, 2):
        distances = nearest_points(wall[None, end : end + 2], walls)[1][0]
        for row in np.argsort(distances):
            if distances[row] > SMALL_GAP_IN:
                break
            place = _intersection(wall, walls[row])
            if place is not None:
                wall[end : end + 2] = place
                break
    return wall


def start_pose(world: World, given: Sequence[float] | None) -> Floats:
    """Return the pose (3,) at which a drive begins: as given, or the first start of the map."""
    start = world.starts[0]
    return np.array(given if given is not None else (start.x_in, start.y_in, start.steering_rad), dtype=np.float64)
