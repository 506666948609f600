"""Read and write world files in TOML, and locate the shipped ones.

    name, title                                         optional texts
    [[room]]      corners, name                         a closed outline, free inside
    [[wall]]      points, name                          an open line of two points or more
                  offset_std, angle_std_deg, measured   of a measured wall: how well it is known, the length measured
                  surface                               its measured spots: x, y, standard deviation of the distance
    [[obstacle]]  corners, name                         a closed solid; clients may move and delete it
    [[door]]      name, points, open                    a wall between two points while it is not open
    [[walker]]    points, speed, radius, closed, name   a person who walks along a route; speed per second
    [[start]]     x, y, steering_deg, turret_deg        degrees counter-clockwise, default 0
    [[path]]      name, figure, points, start           waypoints from the start on; start: number of a [[start]]

corners, points, surface, speed, radius, x and y end in their unit: _in, _cm or _m. All errors are WorldFileError.
"""

import functools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import degrees, radians
from os import PathLike, fspath
from pathlib import Path as FilePath
from typing import Annotated, Any, Final

import numpy as np
from msgspec import UNSET, Meta, UnsetType

import worlds.world
from nclient.common.validation import InvalidValue, Text, convert, reported_as
from nclient.errors import WorldFileError, suggest
from worlds import schema
from worlds.geometry import FloatArray, lengths, polygon_segments, polyline_segments
from worlds.schema import Distance, Line, Spots, Table, table
from worlds.world import (
    AT_ORIGIN,
    MAX_ROUTE_POINTS,
    Door,
    Path,
    Point,
    Polygon,
    StartPose,
    SurfaceSpot,
    Walker,
    WallAccuracy,
    World,
)

SHIPPED: Final = FilePath(__file__).resolve().parent
"""Folder of the shipped worlds."""
DEFAULT_WORLD: Final = "thesis_room"
"""World of a simulation whose address names none."""
MAX_ROUTE_CHECKS: Final = 20_000
"""Points at which a route is compared with the walls: 3.5 km at the default radius."""
CONTENT: Final = ("room", "wall", "obstacle")
"""Tables of which a world needs at least one."""


@functools.cache
def world_names() -> tuple[str, ...]:
    """Return the sorted names of the shipped worlds."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def load_world(name_or_path: str | PathLike[str]) -> World:
    """Return the world of a shipped name ("thesis_room") or a file ("worlds/thesis_room.toml", "/abs/x.toml").

    A shipped world takes precedence over a file of the same name; a path "worlds/X.toml" that does not exist is the
    shipped world X.

    Raises
    ------
    WorldFileError
        If the file cannot be read or is not a valid world.
    """
    text, path = read_world_text(name_or_path)
    return parse_world(text, str(path), path.stem)


def read_world_text(name_or_path: str | PathLike[str]) -> tuple[str, FilePath]:
    """Return the text that load_world would read, and its path. Raises WorldFileError if there is none."""
    name = fspath(name_or_path)
    try:
        path = _find(name)
        return _read(path), path
    except OSError as error:
        raise WorldFileError(f"{name}: cannot be read: {error.strerror}") from error


@table()
class _Outline(Table):
    """A polygon: the outline of a room or an obstacle."""

    name: Annotated[Text, Meta(description="name, shown on maps")] = ""
    corners: schema.Outline

    def check(self) -> None:
        _reject_repeats(self, "corners", polygon_segments(self.corners))
        schema.require_outline(self.key_of("corners"), self.corners)


_HAS_OFFSET: Final = {"anyOf": [{"required": [f"offset_std_{unit}"]} for unit in schema.INCHES_PER_UNIT]}


@table(condition={"dependentSchemas": dict.fromkeys(
    ["angle_std_deg", *(f"{name}_{unit}" for name in ("measured", "surface") for unit in schema.INCHES_PER_UNIT)],
    _HAS_OFFSET,
)})  # fmt: skip
class _Wall(Table):
    """An inner wall."""

    points: Line
    name: Annotated[Text, Meta(description="name of the wall, shown on maps")] = ""
    offset_std: Distance | UnsetType = UNSET
    angle_std_deg: (
        Annotated[float, Meta(ge=0.0, le=180.0, description="standard deviation of its direction")] | UnsetType
    ) = UNSET
    measured: Distance | UnsetType = UNSET
    surface: Spots | UnsetType = UNSET

    def accuracy(self) -> WallAccuracy | None:
        """Return the accuracy of each of its walls; None if it was not measured."""
        if self.offset_std is UNSET:
            return None
        angle_deg, measured_in = (0.0 if number is UNSET else number for number in (self.angle_std_deg, self.measured))
        surface = () if self.surface is UNSET else tuple(SurfaceSpot(*spot) for spot in self.surface)
        return WallAccuracy(self.offset_std, radians(angle_deg), measured_in, surface)

    def check(self) -> None:
        _reject_repeats(self, "points", polyline_segments(self.points))
        if self.offset_std is UNSET and not (self.angle_std_deg is self.measured is self.surface is UNSET):
            raise InvalidValue("expected it beside the other numbers of a measured wall, found none", "offset_std_in")
        if self.surface is UNSET:
            return
        if len(self.points) != 2:
            found = f"found one of {len(self.points)} points"
            raise InvalidValue(f"expected it of a wall between two points, {found}", self.key_of("surface"))
        if negative := [number for number, spot in enumerate(self.surface) if spot[2] < 0.0]:
            found = f"that of spot {negative[0]} is below"
            raise InvalidValue(f"expected standard deviations of 0 or more, {found}", self.key_of("surface"))


@table()
class _Door(Table):
    """A door, which may be opened and closed."""

    name: Annotated[Text, Meta(min_length=1, description="name of the door, by which it is opened and closed")]
    points: Line
    open: Annotated[bool, Meta(description="true: nothing is there")] = False

    def check(self) -> None:
        if len(self.points) != 2:
            found = f"found {len(self.points)} points"
            raise InvalidValue(f"expected the two ends of a door, {found}", self.key_of("points"))
        _reject_repeats(self, "points", polyline_segments(self.points))

    def door(self) -> Door:
        """Return the door."""
        return Door(self.name, (self.points[0], self.points[1]), self.open)


@table()
class _Walker(Table):
    """A person or thing that moves along a route."""

    name: Annotated[Text, Meta(description="name, shown on maps")] = ""
    points: Line
    speed: Distance | UnsetType = UNSET
    radius: Distance | UnsetType = UNSET
    closed: Annotated[bool, Meta(description="true: from the last point to the first; false: back the same route")] = (
        False
    )

    def check(self) -> None:
        if len(self.points) > MAX_ROUTE_POINTS:
            key = self.key_of("points")
            raise InvalidValue(f"expected at most {MAX_ROUTE_POINTS} points, found {len(self.points)}", key)
        _reject_repeats(self, "points", polyline_segments(self.points))

    def walker(self) -> Walker:
        """Return the walker."""
        given = {"speed_in_s": self.speed, "radius_in": self.radius}
        numbers = {name: number for name, number in given.items() if number is not UNSET}
        return Walker(self.points, is_closed=self.closed, name=self.name, **numbers)


@table()
class _Start(Table):
    """A start pose."""

    x: schema.Length
    y: schema.Length
    steering_deg: Annotated[schema.Angle, Meta(description="direction of the steering")] = 0.0
    turret_deg: Annotated[schema.Angle, Meta(description="direction of the turret")] = 0.0


@table(condition={"anyOf": [{"required": ["name"]}, {"required": ["figure"]}]})
class _Path(Table):
    """A path with a name, for `nomad localize --path`."""

    name: Annotated[Text, Meta(description="name of the path")] = ""
    figure: Annotated[Text, Meta(description="number of its figure in the thesis")] = ""
    start: Annotated[int, Meta(ge=0, description="number of the [[start]] where it begins")] | UnsetType = UNSET
    points: Line

    def check(self) -> None:
        if not (self.name or self.figure):
            raise InvalidValue("expected a name or a figure, found neither", "name")
        _reject_repeats(self, "points", polyline_segments(self.points))


@table(condition={"anyOf": [{"required": [key], "properties": {key: {"minItems": 1}}} for key in CONTENT]})
class WorldFile(Table):
    """A world file: walls, start poses and paths of a simulated building."""

    name: Annotated[Text, Meta(description="name of the world; default: the name of the file")] = ""
    title: Annotated[Text, Meta(description="title for people; default: the name")] = ""
    room: Annotated[tuple[_Outline, ...], Meta(description="a closed outline, free inside")] = ()
    wall: Annotated[tuple[_Wall, ...], Meta(description="an open line of two points or more")] = ()
    obstacle: Annotated[tuple[_Outline, ...], Meta(description="a closed solid; clients may move and delete it")] = ()
    door: Annotated[tuple[_Door, ...], Meta(description="a wall that can be opened")] = ()
    walker: Annotated[tuple[_Walker, ...], Meta(description="a person who walks along a route")] = ()
    start: Annotated[tuple[_Start, ...], Meta(description="a start pose")] = ()
    path: Annotated[tuple[_Path, ...], Meta(description="waypoints from the start on")] = ()

    def check(self) -> None:
        """Raise InvalidValue unless there is anything to see."""
        if not (self.room or self.wall or self.obstacle):
            raise InvalidValue("expected at least one [[room]], [[wall]] or [[obstacle]], found none")


@functools.lru_cache(maxsize=8)
def parse_world(text: str, file: str, name: str) -> World:
    """Return the world of a TOML text. Cached, as simulation and filter of a process read the same one.

    Parameters
    ----------
    text : str
    file : str
        Name of the file in error messages.
    name : str
        Name of the world, unless the text contains one.

    Raises
    ------
    WorldFileError
    """
    values = schema.parse_toml(text, file)
    with reported_as(WorldFileError, file):
        _check_size(values)
        return _build_world(convert(values, WorldFile), name)


def _build_world(values: WorldFile, name: str) -> World:
    """Return the world of a file's values. Raises InvalidValue."""
    # 1. Content.
    starts = tuple(StartPose(start.x, start.y, radians(start.steering_deg), radians(start.turret_deg))
                   for start in values.start)
    walls = [polyline_segments(wall.points) for wall in values.wall]
    accuracies = [wall.accuracy() for wall, segments in zip(values.wall, walls, strict=True) for _ in segments]
    names = [wall.name for wall, segments in zip(values.wall, walls, strict=True) for _ in segments]
    world = World(name=values.name or name, title=values.title or values.name or name,
                  rooms=tuple(Polygon(room.corners, room.name) for room in values.room),
                  inner_walls=np.concatenate([np.empty((0, 4)), *walls]),
                  obstacles=tuple(Polygon(obstacle.corners, obstacle.name) for obstacle in values.obstacle),
                  starts=starts or AT_ORIGIN, paths=_paths(values.path, starts or AT_ORIGIN),
                  accuracies={row: accuracy for row, accuracy in enumerate(accuracies) if accuracy},
                  wall_names={row: name for row, name in enumerate(names) if name},
                  doors=tuple(door.door() for door in values.door),
                  walkers=tuple(walker.walker() for walker in values.walker))
    # 2. The default start need not be free.
    _require_free_places(world, starts)
    # 3. Names of doors, and routes: doors on them may be opened later.
    for k, door in enumerate(world.doors):
        if door.name in [each.name for each in world.doors[:k]]:
            raise InvalidValue(f"{door.name!r} is used by an earlier door; expected another", f"door[{k}].name")
    for k, walker in enumerate(world.walkers):
        if complaint := route_error(world, walker):
            raise InvalidValue(complaint, f"walker[{k}].{values.walker[k].key_of('points')}")
    return world


def route_error(world: World, walker: Walker) -> str:
    """Return why a walker cannot walk its route in a world, except for doors; "" if it can."""
    # As many points on each leg as it has radii, so that no wall stands between them.
    points = np.array([*walker.points_in, *walker.points_in[: int(walker.is_closed)]])
    legs = polyline_segments(points)
    counts = np.ceil(lengths(legs) / walker.radius_in).astype(np.intp) + 1
    if counts.sum() > MAX_ROUTE_CHECKS:
        return f"expected a shorter route: at most {MAX_ROUTE_CHECKS} times the walker's radius"
    on_route = np.concatenate([np.linspace(leg[:2], leg[2:], count)
                               for leg, count in zip(legs, counts.tolist(), strict=True)])
    blocked = np.flatnonzero(replace(world, doors=()).clearances(on_route) <= 0.9 * walker.radius_in)
    if not blocked.size:
        return ""
    x, y = on_route[blocked[0]].tolist()
    return f"expected a route clear of walls for a radius of {walker.radius_in:g} in, found ({x:g}, {y:g}) in"


def _require_free_places(world: World, starts: tuple[StartPose, ...]) -> None:
    """Raise InvalidValue unless starts and paths are in free space, where the smallest robot touches nothing."""
    places = [(f"start[{k}]", (start.x_in, start.y_in)) for k, start in enumerate(starts)]
    places += [(f"path[{k}]", point) for k, path in enumerate(world.paths.values()) for point in path.points_in]
    clearances = world.clearances(np.array([point for _, point in places]).reshape(-1, 2))
    for (key, (x, y)), clearance in zip(places, clearances.tolist(), strict=True):
        if clearance <= 0:
            found = f"found ({x:g}, {y:g}) in"
            raise InvalidValue(f"expected a place inside the world and clear of its walls, {found}", key)


def _check_size(values: Mapping[str, Any]) -> None:
    """Raise InvalidValue if a world is too large, before anything is computed from it."""
    # The values have any type yet; those of a wrong one are reported later.
    tables = {key: rows if isinstance(rows, list) else [] for key, rows in values.items()}
    sizes = {
        key: sum(len(each) for row in rows if isinstance(row, dict) for each in row.values() if isinstance(each, list))
        for key, rows in tables.items()
    }
    for key, found, maximum, what in (
        ("", sum(sizes.get(key, 0) for key in CONTENT), worlds.world.MAX_CORNERS, "corners in total"),
        ("start", len(tables.get("start", ())), worlds.world.MAX_STARTS, "starts"),
        ("door", len(tables.get("door", ())), worlds.world.MAX_DOORS, "doors"),
        ("walker", len(tables.get("walker", ())), worlds.world.MAX_WALKERS, "walkers"),
        ("path", sizes.get("path", 0), worlds.world.MAX_PATH_POINTS, "points in total"),
    ):
        if found > maximum:
            raise InvalidValue(f"expected at most {maximum} {what}, found {found}", key)


def _find(name: str) -> FilePath:
    """Return the file of a name or path. Raises WorldFileError with the shipped names if there is none."""
    # 1. A shipped name.
    names = world_names()
    if name in names:
        return SHIPPED / f"{name}.toml"
    # 2. A file.
    path = FilePath(name)
    if name and path.exists():
        return path
    # 3. A path as in the source tree, which an installed package does not have.
    if path.stem in names and path.name == f"{path.stem}.toml" and str(path.parent) in (".", "worlds"):
        return SHIPPED / path.name
    raise WorldFileError(f"{name or repr(name)}: no such file, and no shipped world of this name; expected a path or "
                         f"one of {', '.join(names)}{suggest(path.stem, names)}")


def _read(path: FilePath) -> str:
    """Return the text of a world file. Raises WorldFileError if it is not a readable UTF-8 file."""
    if not path.is_file():
        kind = "a directory" if path.is_dir() else "no regular file"
        raise WorldFileError(f"{path}: expected a world file in TOML, found {kind}")
    return schema.read_text(path)


def _reject_repeats(table: Table, name: str, segments: FloatArray) -> None:
    """Reject an edge without length: a corner given twice in a row."""
    # The first edge without length; of an outline the closing edge gets a message of its own.
    short = np.flatnonzero(lengths(segments) < schema.MIN_WALL_IN)
    if not short.size:
        return
    key, number = table.key_of(name), int(short[0])
    if name == "corners" and number == len(segments) - 1:
        raise InvalidValue("is the first corner again; outlines close by themselves: leave it out", f"{key}[{number}]")
    raise InvalidValue("is the same point as the one before; expected walls with a length", f"{key}[{number + 1}]")


def _paths(rows: tuple[_Path, ...], starts: tuple[StartPose, ...]) -> dict[str, Path]:
    """Return the paths by figure, or by name if they have no figure."""
    paths: dict[str, Path] = {}
    for k, row in enumerate(rows):
        # A path begins at its start pose, or at its first point with heading 0.
        x, y = row.points[0]
        if row.start is not UNSET and row.start >= len(starts):
            complaint = f"expected a whole number from 0 to {len(starts) - 1}, found {row.start}"
            raise InvalidValue(complaint, f"path[{k}].start")
        start = StartPose(x, y) if row.start is UNSET else starts[row.start]
        if max(abs(start.x_in - x), abs(start.y_in - y)) > schema.MIN_WALL_IN:
            raise InvalidValue(
                f"expected the place of start[{row.start}], ({start.x_in:g}, {start.y_in:g}) in, "
                f"found ({x:g}, {y:g}) in", f"path[{k}].{row.key_of('points')}[0]",
            )  # fmt: skip
        key = row.figure or row.name
        if key in paths:
            where = f"path[{k}].{'figure' if row.figure else 'name'}"
            raise InvalidValue(f"{key!r} is used by an earlier path; expected another", where)
        paths[key] = Path(row.name or row.figure, row.figure, start, row.points)
    return paths


def format_world(world: World, comment: str = "") -> str:
    """Return a world as TOML, in inches and degrees; each line of `comment` precedes it as a comment.

    The text can be read again: starts and paths that an obstacle has been moved onto are omitted, with a comment.
    """
    return "\n".join([*(f"# {line}" for line in comment.splitlines()), *_format_lines(world)]) + "\n"


def polylines(walls: FloatArray) -> Iterator[list[Point]]:
    """Yield walls (m, 4) as polylines: a wall that starts at the end of the previous one continues it."""
    line: list[Point] = []
    # Exact comparison: consecutive walls of one line share the same numbers.
    for x1, y1, x2, y2 in walls.tolist():
        if line and line[-1] != (x1, y1):
            yield line
            line = []
        line += [(x2, y2)] if line else [(x1, y1), (x2, y2)]
    if line:
        yield line


def _format_lines(world: World) -> Iterator[str]:
    yield f"name = {_quote(world.name)}"
    if world.title.strip():
        yield f"title = {_quote(world.title)}"
    for room in world.rooms:
        yield from _format_outline("room", room)
    yield from _format_walls(world)
    for thing in world.obstacles:
        yield from _format_outline("obstacle", thing)
    yield from _format_doors_and_walkers(world)
    # Only starts in free space can be read again.
    is_free = world.clearances(np.array([(start.x_in, start.y_in) for start in world.starts])) > 0.0
    starts = [start for start, free in zip(world.starts, is_free, strict=True) if free]
    for start in world.starts:
        if start not in starts:
            yield from ("", f"# omitted because an obstacle stands there: a start at {start.x_in!r}, {start.y_in!r}")
        elif world.starts != (StartPose(0.0, 0.0),):
            yield from ("", "[[start]]", f"x_in = {start.x_in!r}", f"y_in = {start.y_in!r}")
            yield f"steering_deg = {degrees(start.steering_rad)!r}"
            yield f"turret_deg = {degrees(start.turret_rad)!r}"
    for path in world.paths.values():
        if (world.clearances(np.array(path.points_in)) > 0.0).all():
            yield from _format_path(path, starts)
        else:
            yield from ("", f"# omitted because an obstacle stands on it: the path {_quote(path.name)}")


def _format_walls(world: World) -> Iterator[str]:
    # Measured walls have an accuracy each and labelled ones a name, so they are separate tables.
    single = sorted(world.accuracies.keys() | world.wall_names.keys())
    others = np.array([row for row in range(len(world.inner_walls)) if row not in single], dtype=np.intp)
    for points in polylines(world.inner_walls[others]):
        yield from ("", "[[wall]]", f"points_in = {_format_points(points)}")
    for row in single:
        x1, y1, x2, y2 = world.inner_walls[row].tolist()
        yield from ("", "[[wall]]", f"points_in = {_format_points([(x1, y1), (x2, y2)])}")
        if row in world.wall_names:
            yield f"name = {_quote(world.wall_names[row])}"
        if (accuracy := world.accuracies.get(row)) is None:
            continue
        yield f"offset_std_in = {accuracy.offset_std_in!r}"
        yield f"angle_std_deg = {degrees(accuracy.angle_std_rad)!r}"
        if accuracy.measured_in:
            yield f"measured_in = {accuracy.measured_in!r}"
        if accuracy.surface:
            yield f"surface_in = {_format_points(accuracy.surface)}"


def _format_doors_and_walkers(world: World) -> Iterator[str]:
    for door in world.doors:
        yield from ("", "[[door]]", f"name = {_quote(door.name)}", f"points_in = {_format_points(door.ends_in)}")
        if door.is_open:
            yield "open = true"
    for walker in world.walkers:
        if route_error(world, walker):
            yield from ("", f"# omitted because something stands on the route: the walker {_quote(walker.name)}")
            continue
        yield from ("", "[[walker]]")
        if walker.name:
            yield f"name = {_quote(walker.name)}"
        yield f"points_in = {_format_points(walker.points_in)}"
        yield from (f"speed_in = {float(walker.speed_in_s)!r}", f"radius_in = {float(walker.radius_in)!r}")
        if walker.is_closed:
            yield "closed = true"


def _format_path(path: Path, starts: list[StartPose]) -> Iterator[str]:
    yield from ("", "[[path]]", f"name = {_quote(path.name)}")
    if path.figure:
        yield f"figure = {_quote(path.figure)}"
    if path.start in starts and path.start != StartPose(*path.points_in[0]):
        yield f"start = {starts.index(path.start)}"
    yield f"points_in = {_format_points(path.points_in)}"


def _format_outline(kind: str, polygon: Polygon) -> Iterator[str]:
    yield from ("", f"[[{kind}]]")
    if polygon.name:
        yield f"name = {_quote(polygon.name)}"
    yield f"corners_in = {_format_points(polygon.corners_in)}"


def _format_points(points: Iterable[Sequence[float]]) -> str:
    rows = (", ".join(repr(float(number)) for number in point) for point in points)
    return f"[{', '.join(f'[{row}]' for row in rows)}]"


def _quote(text: str) -> str:
    """Return a quoted text, valid in JSON and TOML alike."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
