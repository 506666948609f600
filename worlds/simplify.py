"""Simplify a map: fewer walls, every point of the old ones within a tolerance of the new ones and vice versa.

    outlines       Douglas-Peucker all around, from two corners that are far apart and remain
    inner walls    walls on one line that touch or overlap become one; walls connected end to end become a polyline,
                   and Douglas-Peucker is applied to it

An outline whose simplified form would cross itself remains unchanged.

References
----------
Douglas, Peucker: Algorithms for the reduction of the number of points required to represent a digitized line (1973).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from worlds.geometry import FloatArray, area, crossing, lengths, nearest_points, polygon_segments, polyline_segments
from worlds.world import Point, Polygon, World

MIN_CORNERS = 3
SAMPLE_IN = 0.25
"""Sampling distance for comparing two maps."""


def simplify_world(world: World, tolerance_in: float) -> World:
    """Return a world with the same or fewer walls, all within `tolerance_in` of the original ones.

    Raises
    ------
    ValueError
        If the tolerance is not positive.
    """
    if not tolerance_in > 0.0:
        raise ValueError(f"a tolerance is above 0 in, not {tolerance_in!r}")
    # Each of the two steps may move a wall by half the tolerance.
    half = tolerance_in / 2.0
    merged = _merge_collinear(world.inner_walls, half)
    walls = [polyline_segments(_select(line, half)) for line in _chain(merged)]
    return replace(
        world,
        rooms=tuple(_simplify_polygon(room, tolerance_in) for room in world.rooms),
        obstacles=tuple(_simplify_polygon(thing, tolerance_in) for thing in world.obstacles),
        inner_walls=np.concatenate([np.empty((0, 4)), *walls]),
        # Walls have been moved and joined.
        accuracies={},
        wall_names={},
    )


def hausdorff_distance_in(one: FloatArray, other: FloatArray) -> float:
    """Return the Hausdorff distance between walls (m, 4) and others (k, 4), sampled every 1/4 in."""
    return max(_directed_distance(one, other), _directed_distance(other, one))


def _directed_distance(walls: FloatArray, others: FloatArray) -> float:
    farthest = 0.0
    for x1, y1, x2, y2 in walls:
        count = 2 + int(np.hypot(x2 - x1, y2 - y1) / SAMPLE_IN)
        points = np.linspace((x1, y1), (x2, y2), count)
        farthest = max(farthest, float(nearest_points(points, others)[1].min(axis=-1).max()))
    return farthest


def _simplify_polygon(polygon: Polygon, tolerance_in: float) -> Polygon:
    """Return the outline with fewer corners, or the original one if the result is not a valid outline."""
    corners = list(polygon.corners_in)
    # Split the outline at two corners far apart, which remain.
    far = int(np.argmax(np.hypot(*(np.array(corners) - corners[0]).T)))
    one, other = (
        _select(corners[: far + 1], tolerance_in),
        _select([*corners[far:], corners[0]], tolerance_in),
    )
    selected = [*one[:-1], *other[:-1]]
    edges = polygon_segments(selected)
    if len(selected) < MIN_CORNERS or crossing(edges) or not area(selected) * area(corners) > 0.0:
        return polygon
    return replace(polygon, corners_in=tuple(selected))


def _select(line: Sequence[Point], tolerance_in: float) -> list[Point]:
    """Return the points of a line that the Douglas-Peucker algorithm selects."""
    return [line[number] for number in douglas_peucker(np.array(line, dtype=np.float64), tolerance_in)]


def douglas_peucker(points: FloatArray, tolerance: float) -> list[int]:
    """Return the numbers of the points (n, 2) that the Douglas-Peucker algorithm selects, in order.

    It keeps the ends of each span and splits it at the point farthest from the chord if that is beyond the tolerance.
    """
    selected = [0, len(points) - 1]
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        chord = np.concatenate((points[first], points[last]))[None]
        off = nearest_points(points[first + 1 : last], chord)[1][:, 0]
        middle = first + 1 + int(off.argmax())
        if off.max() > tolerance:
            selected.append(middle)
            spans += [(first, middle), (middle, last)]
    return sorted(selected)


def _merge_collinear(walls: FloatArray, tolerance_in: float) -> FloatArray:
    """Merge walls on one line into one, along the longest of them."""
    left = sorted(walls.tolist(), key=lambda wall: -float(lengths(np.array(wall))))
    done: list[list[float]] = []
    while left:
        group = [left.pop(0)]
        while (joined := _find_joinable(group, left, tolerance_in)) is not None:
            group.append(joined)
            left.remove(joined)
        whole = _union(np.array(group), tolerance_in)
        done.append(group[0] if whole is None or len(group) == 1 else whole.tolist())
    return np.array(done, dtype=np.float64).reshape(-1, 4)


def _find_joinable(group: list[list[float]], others: list[list[float]], tolerance_in: float) -> list[float] | None:
    """Return the first other wall that forms one wall with the group; None if there is none."""
    return next((wall for wall in others if _union(np.array([*group, wall]), tolerance_in) is not None), None)


def _union(walls: FloatArray, tolerance_in: float) -> FloatArray | None:
    """Return the wall that covers all walls if they lie on the first one's line without a gap; else None."""
    origin, along = walls[0, :2], (walls[0, 2:] - walls[0, :2]) / lengths(walls[0])
    off = walls.reshape(-1, 2) - origin
    if np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]).max() > tolerance_in:
        return None
    # Intervals along the line, in order; a gap beyond the tolerance separates walls.
    spans = np.sort((off @ along).reshape(-1, 2), axis=1)
    spans = spans[spans[:, 0].argsort()]
    reach = np.maximum.accumulate(spans[:, 1])
    if (spans[1:, 0] > reach[:-1] + tolerance_in).any():
        return None
    return np.concatenate((origin + spans[0, 0] * along, origin + reach[-1] * along))


def _chain(walls: FloatArray) -> list[list[Point]]:
    """Return polylines of walls that meet end to end; where more than two meet, lines end."""
    ends: dict[Point, list[int]] = {}
    pairs = [((x1, y1), (x2, y2)) for x1, y1, x2, y2 in walls.tolist()]
    for number, pair in enumerate(pairs):
        for end in pair:
            ends.setdefault(end, []).append(number)
    # Extend each line at both of its ends.
    left, lines = set(range(len(pairs))), []
    while left:
        number = min(left)
        left.discard(number)
        line: list[Point] = list(pairs[number])
        for _ in range(2):
            while (at := _next_wall(ends, line[-1], left)) is not None:
                left.discard(at)
                one, other = pairs[at]
                line.append(other if one == line[-1] else one)
            line.reverse()
        lines.append(line)
    return lines


def _next_wall(ends: dict[Point, list[int]], place: Point, left: set[int]) -> int | None:
    there = ends[place]
    return next((number for number in there if number in left), None) if len(there) == 2 else None
