"""The same map with fewer walls: every point of the old walls lies within a tolerance of the new ones, and the reverse.

    outlines       Douglas-Peucker all round, from two corners that are far apart and stay (Douglas, Peucker 1973)
    inner walls    those on one line that touch or overlap become one; what then hangs together end to end is a line of
                   points, and Douglas-Peucker again

Each of the two steps may move a wall by half the tolerance. An outline whose simpler form would cross itself stays.
Rules: pure; a world in, a world out; `apart_in` measures what it is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from worlds.geometry import FloatArray, area, crossing, lengths, nearest_points, polygon_segments, polyline_segments
from worlds.world import Point, Polygon, World

FEWEST_CORNERS = 3
SAMPLE_IN = 0.25
"""How densely walls are looked at when two maps are compared."""


def simplified(world: World, tolerance_in: float) -> World:
    """A world whose walls are within `tolerance_in` of this one's, of no more walls. Raises ValueError for a tolerance
    that is not above 0."""
    if not tolerance_in > 0.0:
        raise ValueError(f"a tolerance is above 0 in, not {tolerance_in!r}")
    half = tolerance_in / 2.0
    merged = _merged(world.inner_walls, half)
    walls = [polyline_segments(_thinned(line, half)) for line in _chained(merged)]
    return replace(
        world,
        rooms=tuple(_simpler(room, tolerance_in) for room in world.rooms),
        obstacles=tuple(_simpler(thing, tolerance_in) for thing in world.obstacles),
        inner_walls=np.concatenate([np.empty((0, 4)), *walls]),
    )


def apart_in(one: FloatArray, other: FloatArray) -> float:
    """How far walls (m, 4) and others (k, 4) are apart at most: the Hausdorff distance, looked at every 1/4 in."""
    return max(_farthest(one, other), _farthest(other, one))


def _farthest(walls: FloatArray, others: FloatArray) -> float:
    farthest = 0.0
    for x1, y1, x2, y2 in walls:
        count = 2 + int(np.hypot(x2 - x1, y2 - y1) / SAMPLE_IN)
        points = np.linspace((x1, y1), (x2, y2), count)
        farthest = max(farthest, float(nearest_points(points, others)[1].min(axis=-1).max()))
    return farthest


def _simpler(polygon: Polygon, tolerance_in: float) -> Polygon:
    """An outline with fewer corners; the one given where that would be none any more."""
    corners = list(polygon.corners_in)
    far = int(np.argmax(np.hypot(*(np.array(corners) - corners[0]).T)))
    one, other = _thinned(corners[: far + 1], tolerance_in), _thinned([*corners[far:], corners[0]], tolerance_in)
    kept = [*one[:-1], *other[:-1]]
    edges = polygon_segments(kept)
    if len(kept) < FEWEST_CORNERS or crossing(edges) or not area(kept) * area(corners) > 0.0:
        return polygon
    return replace(polygon, corners_in=tuple(kept))


def _thinned(line: Sequence[Point], tolerance_in: float) -> list[Point]:
    """Douglas-Peucker: the ends, and of what lies between the point that is farthest off, if it is too far."""
    kept = [0, len(line) - 1]
    spans = [(0, len(line) - 1)]
    points = np.array(line, dtype=np.float64)
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        chord = np.concatenate((points[first], points[last]))[None]
        off = nearest_points(points[first + 1 : last], chord)[1][:, 0]
        middle = first + 1 + int(off.argmax())
        if off.max() > tolerance_in:
            kept.append(middle)
            spans += [(first, middle), (middle, last)]
    return [line[number] for number in sorted(kept)]


def _merged(walls: FloatArray, tolerance_in: float) -> FloatArray:
    """Walls on one line, as many as can be, become one that goes along the longest of them."""
    left = sorted(walls.tolist(), key=lambda wall: -float(lengths(np.array(wall))))
    done: list[list[float]] = []
    while left:
        group = [left.pop(0)]
        while (joined := _joining(group, left, tolerance_in)) is not None:
            group.append(joined)
            left.remove(joined)
        whole = _one_of(np.array(group), tolerance_in)
        done.append(group[0] if whole is None or len(group) == 1 else whole.tolist())
    return np.array(done, dtype=np.float64).reshape(-1, 4)


def _joining(group: list[list[float]], others: list[list[float]], tolerance_in: float) -> list[float] | None:
    """The first of the others that is one wall with the group, None where none is."""
    return next((wall for wall in others if _one_of(np.array([*group, wall]), tolerance_in) is not None), None)


def _one_of(walls: FloatArray, tolerance_in: float) -> FloatArray | None:
    """The wall from end to end of walls that lie on the first one's line and leave no hole in it; None for others."""
    origin, along = walls[0, :2], (walls[0, 2:] - walls[0, :2]) / lengths(walls[0])
    off = walls.reshape(-1, 2) - origin
    if np.abs(off[:, 0] * along[1] - off[:, 1] * along[0]).max() > tolerance_in:
        return None
    spans = np.sort((off @ along).reshape(-1, 2), axis=1)
    spans = spans[spans[:, 0].argsort()]
    reach = np.maximum.accumulate(spans[:, 1])
    if (spans[1:, 0] > reach[:-1] + tolerance_in).any():
        return None
    return np.concatenate((origin + spans[0, 0] * along, origin + reach[-1] * along))


def _chained(walls: FloatArray) -> list[list[Point]]:
    """Lines of points: walls that meet end to end, two and no more in a place, hang together."""
    ends: dict[Point, list[int]] = {}
    pairs = [((x1, y1), (x2, y2)) for x1, y1, x2, y2 in walls.tolist()]
    for number, pair in enumerate(pairs):
        for end in pair:
            ends.setdefault(end, []).append(number)
    left, lines = set(range(len(pairs))), []
    while left:
        number = min(left)
        left.discard(number)
        line: list[Point] = list(pairs[number])
        for _ in range(2):
            while (at := _next(ends, line[-1], left)) is not None:
                left.discard(at)
                one, other = pairs[at]
                line.append(other if one == line[-1] else one)
            line.reverse()
        lines.append(line)
    return lines


def _next(ends: dict[Point, list[int]], place: Point, left: set[int]) -> int | None:
    there = ends[place]
    return next((number for number in there if number in left), None) if len(there) == 2 else None
