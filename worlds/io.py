"""World files: TOML in, a World out; and where the shipped ones are.

    name, title                                         texts, both optional
    [[room]]      corners, name                         a closed outline, free inside
    [[wall]]      points                                an open line of two points or more
    [[obstacle]]  corners, name                         a closed solid; clients may move and delete it
    [[start]]     x, y, steering_deg, turret_deg        degrees counter-clockwise, 0 where not given
    [[path]]      name, figure, points, start           way-points from the start on; start: number of a [[start]]

corners, points, x and y end in their unit: _in, _cm or _m. Whatever is wrong is a WorldFileError.

A world as the text of a file: files.py reads the same world out of it. Pure.

Rules: every text can be read again. Obstacles move while a simulation runs; a start or a path that one of them has come
to stand on is left out, and a comment says so.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable, Iterator
from math import degrees
from os import PathLike, fspath
from pathlib import Path as FilePath
from typing import Final

import numpy as np

from nclient.common.hints import suggest
from nclient.errors import WorldFileError
from worlds.geometry import FloatArray, lengths, polygon_segments, polyline_segments
from worlds.schema import SHORTEST_IN, Table, parse_toml, read_text, require_outline
from worlds.world import AT_ORIGIN, Path, Point, Polygon, StartPose, World

SHIPPED: Final = FilePath(__file__).resolve().parent
"""The folder of the worlds that come with this package."""
DEFAULT_WORLD: Final = "thesis_room"
"""Where a simulation is that names none."""


@functools.cache
def world_names() -> tuple[str, ...]:
    """The names of the shipped worlds, sorted; load_world takes each of them."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def load_world(name_or_path: str | PathLike[str]) -> World:
    """The world of a shipped name ("thesis_room") or of a file ("worlds/thesis_room.toml", "/abs/x.toml").

    A bare name is a shipped world before it is a file; a path "worlds/X.toml" that does not exist from here is the
    shipped world X. Raises WorldFileError whenever no valid world comes of it.
    """
    text, path = read_world_text(name_or_path)
    return parse_world(text, str(path), path.stem)


def read_world_text(name_or_path: str | PathLike[str]) -> tuple[str, FilePath]:
    """What the file says that load_world would read, and where it is. Raises WorldFileError where there is none."""
    name = fspath(name_or_path)
    try:
        path = _find(name)
        return _read(path), path
    except OSError as error:
        raise WorldFileError(f"{name}: cannot be read: {error.strerror}") from error


def parse_world(text: str, file: str, name: str) -> World:
    """The world that the text of a file describes; `file` is what errors call it, `name` what it is called
    unless it says so itself. Raises WorldFileError."""
    values = parse_toml(text, file)
    top = Table(file, "", values)
    top.allow(("name", "title", "room", "wall", "obstacle", "start", "path"))
    if not any(values.get(key) for key in ("room", "wall", "obstacle")):
        top.fail("", "expected at least one [[room]], [[wall]] or [[obstacle]], found none")
    name = top.text("name", name)
    starts = tuple(_start(table) for table in top.tables("start"))
    world = World(
        name=name,
        title=top.text("title", name),
        rooms=tuple(_polygon(table) for table in top.tables("room")),
        inner_walls=np.concatenate([np.empty((0, 4)), *(_wall(table) for table in top.tables("wall"))]),
        obstacles=tuple(_polygon(table) for table in top.tables("obstacle")),
        starts=starts or AT_ORIGIN,
        paths=_paths(top, starts or AT_ORIGIN),
    )
    for k, start in enumerate(starts):
        _require_free(top, f"start[{k}]", world, (start.x_in, start.y_in))
    for k, path in enumerate(world.paths.values()):
        for point in path.points_in:
            _require_free(top, f"path[{k}]", world, point)
    return world


def _require_free(top: Table, key: str, world: World, point: Point) -> None:
    """A place where even the smallest robot touches something is a mistake of the file."""
    x, y = point
    if world.clearance(x, y) <= 0:
        top.fail(key, f"expected a place inside the world and clear of its walls, found ({x:g}, {y:g}) in")


def _find(name: str) -> FilePath:
    """The file that a name or path means; raises WorldFileError with the shipped names if there is none."""
    names = world_names()
    if name in names:
        return SHIPPED / f"{name}.toml"
    path = FilePath(name)
    if name and path.exists():
        return path
    if path.stem in names and path.name == f"{path.stem}.toml" and str(path.parent) in (".", "worlds"):
        return SHIPPED / path.name
    raise WorldFileError(
        f"{name or repr(name)}: no such file, and no world that is shipped; "
        f"expected a path or one of {', '.join(names)}{suggest(path.stem, names)}"
    )


def _read(path: FilePath) -> str:
    """The text of a world file; raises WorldFileError if it is no readable UTF-8 file."""
    if not path.is_file():
        kind = "a directory" if path.is_dir() else "no regular file"
        raise WorldFileError(f"{path}: expected a world file in TOML, found {kind}")
    return read_text(path)


def _polygon(table: Table) -> Polygon:
    table.allow(("name",), lengths=("corners",))
    corners = table.points_in("corners", least=3)
    _refuse_repeats(table, "corners", polygon_segments(corners))
    require_outline(table, table.key_of("corners"), corners)
    return Polygon(corners, table.text("name", ""))


def _wall(table: Table) -> FloatArray:
    table.allow((), lengths=("points",))
    return _line(table, table.points_in("points", least=2))


def _line(table: Table, points: tuple[Point, ...]) -> FloatArray:
    segments = polyline_segments(points)
    _refuse_repeats(table, "points", segments)
    return segments


def _refuse_repeats(table: Table, name: str, segments: FloatArray) -> None:
    """Refuse an edge without a length: a corner given twice in a row."""
    short = np.flatnonzero(lengths(segments) < SHORTEST_IN)
    if not short.size:
        return
    key, number = table.key_of(name), int(short[0])
    if name == "corners" and number == len(segments) - 1:
        table.fail(f"{key}[{number}]", "is the first corner again; outlines close by themselves: leave it out")
    table.fail(f"{key}[{number + 1}]", "is the same point as the one before; expected walls with a length")


def _start(table: Table) -> StartPose:
    table.allow(("steering_deg", "turret_deg"), lengths=("x", "y"))
    return StartPose(table.length_in("x"), table.length_in("y"), table.angle_rad("steering"), table.angle_rad("turret"))


def _paths(top: Table, starts: tuple[StartPose, ...]) -> dict[str, Path]:
    """The paths by their figure, or by their name where they have none."""
    paths: dict[str, Path] = {}
    for table in top.tables("path"):
        path = _path(table, starts)
        key = path.figure or path.name
        if key in paths:
            table.fail("figure" if path.figure else "name", f"{key!r} is taken by an earlier path; expected another")
        paths[key] = path
    return paths


def _path(table: Table, starts: tuple[StartPose, ...]) -> Path:
    table.allow(("name", "figure", "start"), lengths=("points",))
    figure = table.text("figure", "")
    name = table.text("name", figure)
    if not name:
        table.fail("name", "expected a name or a figure, found neither")
    points = table.points_in("points", least=2)
    _line(table, points)
    number = table.index("start", len(starts))
    start = StartPose(*points[0]) if number is None else starts[number]
    if max(abs(start.x_in - points[0][0]), abs(start.y_in - points[0][1])) > SHORTEST_IN:
        table.fail(
            f"{table.key_of('points')}[0]",
            f"expected the place of start[{number}], ({start.x_in:g}, {start.y_in:g}) in, "
            f"found ({points[0][0]:g}, {points[0][1]:g}) in",
        )
    return Path(name, figure, start, points)


def format_world(world: World, said: str = "") -> str:
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
            yield from _path_writing(path, starts)
        else:
            yield from ("", f"# left out, since something stands on it: the path {_text(path.name)}")


def _path_writing(path: Path, starts: list[StartPose]) -> Iterator[str]:
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
