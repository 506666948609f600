"""A world as the text of a file: files.py reads the same world out of it. Pure.

Rules: every text can be read again. Obstacles move while a simulation runs; a start or a path that one of them has come
to stand on is left out, and a comment says so.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from math import degrees

from worlds.geometry import FloatArray
from worlds.world import Path, Point, Polygon, StartPose, World


def world_text(world: World, said: str = "") -> str:
    """The world as TOML, in inches and degrees; `said` stands above it as a comment, line by line."""
    return "\n".join([*(f"# {line}" for line in said.splitlines()), *_lines(world)]) + "\n"


def polylines(walls: FloatArray) -> Iterator[list[Point]]:
    """Walls (m, 4) as lines of points: each wall that begins where the one before it ends goes on with it."""
    line: list[Point] = []
    for x1, y1, x2, y2 in walls.tolist():
        if line and line[-1] != (x1, y1):
            yield line
            line = []
        line += [(x2, y2)] if line else [(x1, y1), (x2, y2)]
    if line:
        yield line


def _lines(world: World) -> Iterator[str]:
    yield f"name = {_text(world.name)}"
    if world.title.strip():
        yield f"title = {_text(world.title)}"
    for room in world.rooms:
        yield from _outline("room", room)
    for points in polylines(world.inner_walls):
        yield from ("", "[[wall]]", f"points_in = {_points(points)}")
    for thing in world.obstacles:
        yield from _outline("obstacle", thing)
    starts = [start for start in world.starts if world.clearance(start.x_in, start.y_in) > 0.0]
    for start in world.starts:
        if start not in starts:
            yield from ("", f"# left out, since something stands there: a start at {start.x_in!r}, {start.y_in!r}")
        elif world.starts != (StartPose(0.0, 0.0),):
            yield from ("", "[[start]]", f"x_in = {start.x_in!r}", f"y_in = {start.y_in!r}")
            yield f"steering_deg = {degrees(start.steering_rad)!r}"
            yield f"turret_deg = {degrees(start.turret_rad)!r}"
    for path in world.paths.values():
        if all(world.clearance(*point) > 0.0 for point in path.points_in):
            yield from _path(path, starts)
        else:
            yield from ("", f"# left out, since something stands on it: the path {_text(path.name)}")


def _path(path: Path, starts: list[StartPose]) -> Iterator[str]:
    yield from ("", "[[path]]", f"name = {_text(path.name)}")
    if path.figure:
        yield f"figure = {_text(path.figure)}"
    if path.start in starts and path.start != StartPose(*path.points_in[0]):
        yield f"start = {starts.index(path.start)}"
    yield f"points_in = {_points(path.points_in)}"


def _outline(kind: str, polygon: Polygon) -> Iterator[str]:
    yield from ("", f"[[{kind}]]")
    if polygon.name:
        yield f"name = {_text(polygon.name)}"
    yield f"corners_in = {_points(polygon.corners_in)}"


def _points(points: Iterable[Point]) -> str:
    return f"[{', '.join(f'[{float(x)!r}, {float(y)!r}]' for x, y in points)}]"


def _text(text: str) -> str:
    """A text as both JSON and TOML write it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
