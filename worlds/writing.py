"""A world as the text of a world file (files.py), which reads back as the same world. Rules: values in, text out."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from math import degrees

from worlds.geometry import FloatArray
from worlds.world import Path, Point, Polygon, StartPose, World


def world_text(world: World, said: str = "") -> str:
    """The file; `said` stands above it as a comment, line by line."""
    parts = [
        *(f"# {line}" for line in said.splitlines()),
        f"name = {_text(world.name)}",
        f"title = {_text(world.title or world.name)}",
        *(_outline("room", room) for room in world.rooms),
        *(f"\n[[wall]]\npoints_in = {_points(points)}" for points in polylines(world.inner_walls)),
        *(_outline("obstacle", thing) for thing in world.obstacles),
        *(_start(start) for start in world.starts),
        *(_path(key, path, world.starts) for key, path in world.paths.items()),
    ]
    return "\n".join(parts) + "\n"


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


def _outline(kind: str, polygon: Polygon) -> str:
    name = f"name = {_text(polygon.name)}\n" if polygon.name else ""
    return f"\n[[{kind}]]\n{name}corners_in = {_points(polygon.corners_in)}"


def _start(start: StartPose) -> str:
    angles = {"steering_deg": start.steering_rad, "turret_deg": start.turret_rad}
    lines = [f"{key} = {degrees(angle)!r}" for key, angle in angles.items() if angle]
    return "\n".join(["\n[[start]]", f"x_in = {float(start.x_in)!r}", f"y_in = {float(start.y_in)!r}", *lines])


def _path(key: str, path: Path, starts: tuple[StartPose, ...]) -> str:
    lines = ["\n[[path]]", f"name = {_text(path.name)}"]
    lines += [f"figure = {_text(path.figure)}"] if path.figure else []
    lines += [f"start = {starts.index(path.start)}"] if path.start in starts else []
    assert key == (path.figure or path.name)
    return "\n".join([*lines, f"points_in = {_points(path.points_in)}"])


def _points(points: Iterable[Point]) -> str:
    return f"[{', '.join(f'[{float(x)!r}, {float(y)!r}]' for x, y in points)}]"


def _text(text: str) -> str:
    """A JSON string is a TOML string, but for one character that TOML wants escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
