"""Changes to a running simulation by its operator (`nserver ctl`, viewer): obstacles, noise, the world. No I/O.

    obstacle   {"corners": [[x, y] ...], "by": [dx, dy]}            move it
               {"corners": [[x, y] ...], "to": [[x, y] ...]}        replace its corners
               {"corners": [[x, y] ...]}                            remove it
               {"put": [[x, y] ...], "name": text, "at": index}     add it; name and index (default: last) are optional
               reply   {"obstacles": count, "was": corners, "name", "at": index, "is": corners}; null if absent
    wall       {"wall": [[x, y], [x, y]], "by"/"to": as above, or neither: remove it}, {"put": [[x, y], [x, y]]}
               reply   {"walls": count, "was": ends, "is": ends}; inner walls only, rooms keep their outlines
               "accuracy": of a measured wall before the change (WallAccuracy), in the reply, and with "to" or "put"
    noise      {"sensors": NAME, "motion": NAME, "robot": number}   omitted parts stay; no robot: all of them
    world      {"text": TOML, "file": name in error messages}       replaces rooms, walls, obstacles, starts and paths
               "places": true                                       robots without room are placed at its starts
    shown      true                                                 its text was exported and restores exactly it

Inches. An obstacle is identified by its corners as displayed, the last one if several have them. The reply undoes a
change: "was" and "is" are exact. Nothing changes if a request is invalid; changes are recorded, so that a replay
repeats them. Errors are ControlError or WorldFileError, and say what is valid.

Changes to doors and walkers by the operator (`nserver ctl`, viewer), as runtime_settings.py has them for walls.

    door     {"door": name, "open": true or false}                       open, close; without "open": the other state
             {"put": [[x, y], [x, y]], "name": text, "open": bool}       add it
             {"door": name, "by": [dx, dy]}, {"door": name, "to": ends}  move it
             {"door": name, "remove": true}                              remove it
             reply   {"doors": count, "was": door, "is": door}: a door as for "put", null if absent
    walker   {"put": [[x, y] ...], "speed", "radius", "closed", "name"}  add one; only its points are required
             {"walker": [[x, y] ...], "by"/"to": as above, or neither: remove it}
             reply   {"walkers": count, "was": walker, "is": walker}

Inches, and inches per second. Nothing changes if a request is invalid. Errors are ControlError.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import PurePath
from typing import Any, Final

import numpy as np

import worlds.world
from nclient.errors import ControlError, StartError, suggest
from nserver_emu.server.handlers.world import MAX_COORDINATE_IN, is_valid_polygon, overlaps_robot
from nserver_emu.server.server_state import ServerState
from nserver_emu.simulation.multi_robot import Disc
from nserver_emu.simulation.noise import PARTS, part_choices, part_name, with_part
from nserver_emu.simulation.robot import SimulatedRobot
from worlds.geometry import nearest_distances
from worlds.io import format_world, parse_world, route_error
from worlds.world import (
    MAX_ROUTE_POINTS,
    Door,
    Point,
    Polygon,
    StartPose,
    SurfaceSpot,
    Walker,
    WallAccuracy,
    World,
    is_valid_accuracy,
    spots_beside,
)

# Corners are displayed rounded to a thousandth of an inch.
CORNER_TOLERANCE_IN: Final = 0.002
WALL_USAGE: Final = 'wall: such as {"wall": [[0, 0], [9, 0]], "by": [1, 0], "name": "north"}, in inches'
MIN_WALL_IN: Final = 0.5
"""Shorter walls are clicks, not drags."""
OBSTACLE_USAGE: Final = 'obstacle: such as {"corners": [[0, 0], [9, 0], [9, 9]], "by": [1, 0]}, in inches'


@contextmanager
def malformed_as(usage: str, wanted: Mapping[str, Any]) -> Iterator[None]:
    """Raise ControlError with the usage if keys of a change are missing, or values cannot be read."""
    try:
        yield
    except ControlError:  # one of a part, with its own words
        raise
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ControlError(f"{usage}, not {wanted!r:.200}") from None


def change_obstacle(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Add, move, change or remove an obstacle; return what undoes it."""
    # 1. Find the obstacle and its new shape.
    obstacles = list(server.simulation.world.obstacles)
    was: Polygon | None = None
    now: Polygon | None
    with malformed_as(OBSTACLE_USAGE, wanted):
        if "put" in wanted:
            now = Polygon(read_points(wanted["put"]), read_name(wanted.get("name", "")))
            number = _index(wanted.get("at"), len(obstacles))
        else:
            outlines = [obstacle.corners_in for obstacle in obstacles]
            number = _find(outlines, read_points(wanted["corners"]), "obstacle: there is none with these corners")
            was = obstacles[number]
            corners = moved(was.corners_in, wanted)
            now = None if corners is None else Polygon(corners, was.name)
    # 2. Check that it fits.
    if now is not None:
        _check_obstacle(server, now)
    if was is None and len(obstacles) >= server.allowed.obstacles:
        raise ControlError(f"obstacle: there are {len(obstacles)} already, the maximum (--limit-obstacles)")
    # 3. Replace, insert or remove it.
    obstacles[number : number + (was is not None)] = [] if now is None else [now]
    server.simulation.change_world(server.simulation.world.with_obstacles(obstacles))
    server.invalidate_state_cache()
    obstacle = now or was
    assert obstacle is not None
    return {"obstacles": len(obstacles), "was": _corners(was), "name": obstacle.name, "at": number, "is": _corners(now)}


def change_wall(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Add, move, change or remove an inner wall; return what undoes it."""
    world = server.simulation.world
    # 1. The wall as it is, as it will be, and how accurately that was measured.
    with malformed_as(WALL_USAGE, wanted):
        row, was, now = _wanted_wall(world, wanted)
        accuracy = _read_accuracy(wanted.get("accuracy"))
        name = read_name(wanted["name"]).strip() if "name" in wanted else None
    before = world.accuracies.get(row)
    if accuracy is None and was is not None and now is not None and _is_on_line(now, was):
        # Longer or shorter, it is where it was measured to be.
        accuracy = before and before._replace(surface=spots_beside(before.surface, (*now[0], *now[-1])))
    # 2. Check that it fits.
    if was is None and len(world.inner_walls) >= server.allowed.obstacles:
        raise ControlError(f"wall: there are {len(world.inner_walls)} already, the maximum (--limit-obstacles)")
    if now is None:
        changed = world.with_inner_wall(row)
        if not len(changed.walls):
            raise ControlError("wall: it is the last wall of this world, which needs at least one")
    else:
        if len(now) != 2 or math.dist(*now) < MIN_WALL_IN or not is_on_map(now):
            raise ControlError(f"wall: expected two ends on the map, at least {MIN_WALL_IN:g} in apart")
        check_touches_no_robot(server, now, "wall")
        changed = world.with_inner_wall(row, (*now[0], *now[1]))
        if accuracy is not None:
            changed = replace(changed, accuracies={**changed.accuracies, row: accuracy})
        if name is not None:
            names = {**changed.wall_names, row: name}
            changed = replace(changed, wall_names={row: name for row, name in names.items() if name})
    # 3. Replace, insert or remove it.
    server.simulation.change_world(changed)
    server.invalidate_state_cache()
    ends = [None if one is None else [list(end) for end in one] for one in (was, now)]
    measured = {} if before is None else {"accuracy": list(before)}
    named = {"name": world.wall_names[row]} if row in world.wall_names else {}
    return {"walls": len(changed.inner_walls), "was": ends[0], "is": ends[1], **measured, **named}


def _wanted_wall(world: World,
                 wanted: Mapping[str, Any]) -> tuple[int, tuple[Point, ...] | None, tuple[Point, ...] | None]:
    """Return the row of an inner wall, its ends, and its new ends; None where there is none."""
    if "put" in wanted:
        return len(world.inner_walls), None, read_points(wanted["put"])
    walls = [((x1, y1), (x2, y2)) for x1, y1, x2, y2 in world.inner_walls.tolist()]
    row = _find(walls, read_points(wanted["wall"]), "wall: there is no inner wall with these ends")
    return row, walls[row], moved(walls[row], wanted)


def check_touches_no_robot(server: ServerState, ends: Sequence[Point], kind: str) -> None:
    """Raise ControlError if a robot stands where a wall between two ends would be."""
    for number, robot in server.simulation.robots.items():
        x, y, radius_in = robot.disc
        if float(nearest_distances(np.array([x, y]), np.reshape(ends, (1, 4)))) <= radius_in:
            raise ControlError(f"{kind}: it would touch robot {number}")


def _is_on_line(points: Sequence[Point], ends: Sequence[Point]) -> bool:
    """Return True if points are on the line through two ends."""
    (x1, y1), (x2, y2) = ends
    length = math.dist(*ends)
    return all(abs((x2 - x1) * (y - y1) - (y2 - y1) * (x - x1)) <= CORNER_TOLERANCE_IN * length for x, y in points)


def is_on_map(points: Sequence[Point]) -> bool:
    """Return True if all points are on the map."""
    return all(max(abs(x), abs(y)) <= MAX_COORDINATE_IN for x, y in points)


def moved(points: Sequence[Point], wanted: Mapping[str, Any]) -> tuple[Point, ...] | None:
    """Return points after a change "to" others or "by" a vector; None for neither."""
    if wanted.get("to") is not None:
        return read_points(wanted["to"])
    if wanted.get("by") is None:
        return None
    ((dx_in, dy_in),) = read_points([wanted["by"]])
    return tuple((x + dx_in, y + dy_in) for x, y in points)


def _check_obstacle(server: ServerState, obstacle: Polygon) -> None:
    if not is_valid_polygon(obstacle):
        raise ControlError("obstacle: it would leave the map, have no area, or have sides that cross")
    if overlaps_robot(server, obstacle):
        raise ControlError("obstacle: it would overlap a robot")


def read_points(value: Any) -> tuple[Point, ...]:
    """Return a list of points. Raises TypeError or ValueError."""
    points = tuple((float(x), float(y)) for x, y in value)
    if not all(math.isfinite(number) for point in points for number in point):
        raise ValueError("not a number")
    return points


def _read_accuracy(value: Any) -> WallAccuracy | None:
    """Return the accuracy of a wall, None if it was not measured. Raises TypeError or ValueError."""
    if value is None:
        return None
    offset_std_in, angle_std_rad, measured_in, *surfaces = value
    spots = tuple(SurfaceSpot(*map(float, spot)) for surface in surfaces for spot in surface)
    accuracy = WallAccuracy(float(offset_std_in), float(angle_std_rad), float(measured_in), spots)
    if not is_valid_accuracy(accuracy):
        raise ValueError("not an accuracy")
    return accuracy


def read_name(value: Any) -> str:
    """Return a name. Raises TypeError."""
    if not isinstance(value, str):
        raise TypeError("not a name")
    return value


def _index(value: Any, last: int) -> int:
    """Return the index at which an obstacle is inserted."""
    if value is None:
        return last
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError("not an index of an obstacle")
    return min(value, last)


def _find(outlines: Sequence[Sequence[Point]], points: Sequence[Point], complaint: str) -> int:
    """Return the place of the latest of equal outlines."""
    for number in reversed(range(len(outlines))):
        there = outlines[number]
        pairs = zip(there, points, strict=False)
        if len(there) == len(points) and all(math.dist(*pair) < CORNER_TOLERANCE_IN for pair in pairs):
            return number
    raise ControlError(f"{complaint}, or it was changed meanwhile")


def _corners(obstacle: Polygon | None) -> list[list[float]] | None:
    return None if obstacle is None else [list(corner) for corner in obstacle.corners_in]


# Noise and world.

ROBOT: Final = "robot"
# Exported worlds that can be restored exactly: the number of undo steps in the viewer.
MAX_EXPORTED_WORLDS: Final = 200
NOISE_USAGE: Final = "noise: such as sensors=measured motion=ideal robot=1"


def noise_of(robot: SimulatedRobot) -> dict[str, str]:
    """Return the name of the noise model in force by part (sensors, motion)."""
    return {part: part_name(part, robot.setup, robot.model, robot.initial_setup) for part in PARTS}


def noise_choices(robot: SimulatedRobot) -> dict[str, list[str]]:
    """Return the available noise models by part (sensors, motion)."""
    return {part: list(part_choices(part, robot.model, robot.initial_setup)) for part in PARTS}


def switch_noise(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Change noise models; return those in force by robot."""
    if unknown := [name for name in wanted if name not in (*PARTS, ROBOT)]:
        raise ControlError(f"{NOISE_USAGE}, not {unknown[0]!r}")
    if not any(part in wanted for part in PARTS):
        raise ControlError(f"{NOISE_USAGE}; {' and '.join(PARTS)} were both omitted")
    robots = server.simulation.robots
    chosen = list(robots) if wanted.get(ROBOT) is None else [_robot_number(server, wanted[ROBOT])]
    for robot, setup in [(robots[number], _setup(robots[number], wanted)) for number in chosen]:
        robot.set_noise_model(setup)
    server.invalidate_state_cache()
    return {str(number): noise_of(robots[number]) for number in chosen}


def noise_words(text: str) -> dict[str, Any]:
    """Parse words KEY=VALUE to the dictionary of `switch_noise`."""
    pairs = [word.partition("=") for word in text.split()]
    if not pairs or not all(middle and value for _, middle, value in pairs):
        raise ControlError(f"{NOISE_USAGE}, not {text!r}")
    return {key: int(value) if key == ROBOT and value.isdecimal() else value for key, _, value in pairs}


def read_world_file(text: str, file: str) -> World:
    """Return the world of a file's text. Raises WorldFileError."""
    return parse_world(text, file, PurePath(file).stem)


def put_world(server: ServerState, text: str, file: str, world: World | None = None, *, places: bool = False) -> World:
    """Replace the world; robots keep their poses, where there must be no wall or obstacle.

    `world` is that of the text, if it was read before. `places` puts robots without room at the starts of the world.
    """
    world = server.exported_worlds.get(text) or world or read_world_file(text, file)
    # 1. Robots that fit where they are; the reason for each that does not.
    robots = server.simulation.robots
    reasons = {number: reason for number, robot in robots.items() if (reason := _obstruction(world, *robot.disc))}
    if reasons and not places:
        number, reason = next(iter(reasons.items()))
        raise ControlError(f"{file}: there is no room for robot {number} at its pose: {reason}")
    # 2. Free starts for the others.
    taken = [robot.disc for number, robot in robots.items() if number not in reasons]
    starts: dict[int, StartPose] = {}
    for number in reasons:
        *_, radius_in = robots[number].disc
        start = _free_start(world, radius_in, taken)
        if start is None:
            raise ControlError(f"{file}: no start of this world is free for robot {number}: add [[start]] tables, or "
                               "choose another world")
        starts[number] = start
        taken.append((start.x_in, start.y_in, radius_in))
    # 3. Nothing can fail from here on.
    server.simulation.change_world(world)
    for number, start in starts.items():
        server.simulation.place(number, start.x_in, start.y_in, start.steering_rad, start.turret_rad)
    server.invalidate_state_cache()
    return world


def _obstruction(world: World, x_in: float, y_in: float, radius_in: float) -> str:
    """Return why a robot does not fit at a position; "" if it does."""
    try:
        world.require_free(x_in, y_in, radius_in)
    except StartError as error:
        return str(error)
    for walker in world.walkers:
        x, y = walker.points_in[0]
        if math.dist((x, y), (x_in, y_in)) <= walker.radius_in + radius_in:
            return f"a walker begins at ({x:g}, {y:g}) in"
    return ""


def _free_start(world: World, radius_in: float, taken: Sequence[Disc]) -> StartPose | None:
    """Return the first start of a world where a robot of this radius fits and touches none of the discs."""
    for start in world.starts:
        here = start.x_in, start.y_in
        is_apart = all(math.dist(here, (x, y)) > radius_in + radius for x, y, radius in taken)
        if is_apart and not _obstruction(world, *here, radius_in):
            return start
    return None


def show_world(server: ServerState) -> str:
    """Return the world as the text of a file.

    `put_world` with that text restores exactly this world, including what a file cannot express: starts and paths that
    are obstructed.
    """
    world = server.simulation.world
    text = format_world(world)
    server.exported_worlds.pop(text, None)
    server.exported_worlds[text] = world
    while len(server.exported_worlds) > MAX_EXPORTED_WORLDS:
        del server.exported_worlds[next(iter(server.exported_worlds))]
    return text


def _robot_number(server: ServerState, wanted: object) -> int:
    if not isinstance(wanted, int) or wanted not in server.simulation.robots:
        raise ControlError(f"noise: no robot {wanted}; there are {', '.join(map(str, server.simulation.robots))}")
    return wanted


def _setup(robot: SimulatedRobot, wanted: Mapping[str, Any]) -> Any:
    setup = robot.setup
    for part in PARTS:
        if part not in wanted:
            continue
        choices, name = part_choices(part, robot.model, robot.initial_setup), wanted[part]
        if not isinstance(name, str) or name not in choices:
            near = suggest(str(name), choices)
            raise ControlError(f"noise: {part} is one of {', '.join(choices)}, not {name}{near}")
        setup = with_part(setup, part, choices[name])
    return setup


DOOR_USAGE: Final = 'door: such as "kitchen open", "kitchen close" or {"put": [[0, 0], [30, 0]], "name": "kitchen"}'
WALKER_USAGE: Final = 'walker: such as {"put": [[10, 10], [90, 10]], "speed": 20}, in inches'
MAX_SPEED_IN_S, MIN_RADIUS_IN, MAX_RADIUS_IN = 200.0, 1.0, 40.0
"""A sprinter; a table's leg; a forklift."""
_STATES: Final = {"open": True, "close": False}


def door_words(text: str) -> dict[str, Any]:
    """Parse "NAME open" or "NAME close" to the dictionary of `change_door`; the name alone is the other state."""
    name, _, state = text.rpartition(" ")
    return {"door": name.strip(), "open": _STATES[state]} if name and state in _STATES else {"door": text.strip()}


def change_door(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Open, close, add, move or remove a door; return what undoes it."""
    world = server.simulation.world
    doors, was, now = list(world.doors), None, None
    row = len(doors)
    with malformed_as(DOOR_USAGE, wanted):
        # 1. The door as it is, and as it will be.
        if "put" in wanted:
            now = Door(read_name(wanted["name"]), _ends(wanted["put"]), _is_true(wanted.get("open"), False))
        else:
            row = _door_of(doors, wanted["door"])
            was = now = doors[row]
            if wanted.get("remove") is True:
                now = None
            elif (ends := moved(was.ends_in, wanted)) is not None:
                now = replace(was, ends_in=_ends(ends))
            else:
                now = replace(was, is_open=_is_true(wanted.get("open"), not was.is_open))
    # 2. Check that it fits.
    if now is not None and was is None:
        if len(doors) >= worlds.world.MAX_DOORS:
            raise ControlError(f"door: there are {len(doors)} already, the maximum")
        if not now.name.strip() or now.name in [door.name for door in doors]:
            raise ControlError(f"door: expected a name that no other door has, found {now.name!r}")
    if now is not None and not now.is_open:
        check_touches_no_robot(server, now.ends_in, "door")
    # 3. Replace, insert or remove it.
    doors[row : row + 1] = [] if now is None else [now]
    server.simulation.change_world(replace(world, doors=tuple(doors)))
    server.invalidate_state_cache()
    return {"doors": len(doors), "was": _door_fields(was), "is": _door_fields(now)}


def change_walker(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Add, move or remove a walker; return what undoes it."""
    world = server.simulation.world
    walkers, was, now = list(world.walkers), None, None
    row = len(walkers)
    with malformed_as(WALKER_USAGE, wanted):
        # 1. The walker as it is, and as it will be.
        if "put" in wanted:
            numbers = {key: float(wanted[name]) for name, key in _NUMBERS.items() if wanted.get(name) is not None}
            is_closed, name = _is_true(wanted.get("closed"), False), read_name(wanted.get("name", ""))
            now = Walker(read_points(wanted["put"]), is_closed=is_closed, name=name, **numbers)
        else:
            routes = [walker.points_in for walker in walkers]
            row = _find(routes, read_points(wanted["walker"]), "walker: there is none with this route")
            was = walkers[row]
            if (points := moved(was.points_in, wanted)) is not None:
                now = replace(was, points_in=points)
    # 2. Check that it fits.
    if now is not None:
        _check_walker(server, now)
        if was is None and len(walkers) >= worlds.world.MAX_WALKERS:
            raise ControlError(f"walker: there are {len(walkers)} already, the maximum")
    # 3. Replace, insert or remove it.
    walkers[row : row + 1] = [] if now is None else [now]
    server.simulation.change_world(replace(world, walkers=tuple(walkers)))
    server.invalidate_state_cache()
    return {"walkers": len(walkers), "was": _walker_fields(was), "is": _walker_fields(now)}


_NUMBERS: Final = {"speed": "speed_in_s", "radius": "radius_in"}


def _check_walker(server: ServerState, walker: Walker) -> None:
    points = walker.points_in
    if not 2 <= len(points) <= MAX_ROUTE_POINTS or not is_on_map(points):
        raise ControlError(f"walker: expected a route of 2 to {MAX_ROUTE_POINTS} points on the map")
    if min(map(math.dist, points, points[1:])) < MIN_WALL_IN:
        raise ControlError(f"walker: expected points at least {MIN_WALL_IN:g} in apart")
    if not (0.0 < walker.speed_in_s <= MAX_SPEED_IN_S and MIN_RADIUS_IN <= walker.radius_in <= MAX_RADIUS_IN):
        limits = f"speed of at most {MAX_SPEED_IN_S:g} in/s, a radius of {MIN_RADIUS_IN:g} to {MAX_RADIUS_IN:g} in"
        raise ControlError(f"walker: expected a {limits}")
    if complaint := route_error(server.simulation.world, walker):
        raise ControlError(f"walker: {complaint}")
    for number, robot in server.simulation.robots.items():
        x, y, radius_in = robot.disc
        if math.dist((x, y), points[0]) <= radius_in + walker.radius_in:
            raise ControlError(f"walker: robot {number} stands where the route begins")


def _is_true(value: Any, default: bool) -> bool:
    """Return a truth value, the default for None. Raises TypeError."""
    if not isinstance(value, bool | None):
        raise TypeError("neither true nor false")
    return default if value is None else value


def _ends(value: Any) -> tuple[Point, Point]:
    """Return the ends of a door."""
    points = read_points(value)
    if len(points) != 2 or math.dist(*points) < MIN_WALL_IN or not is_on_map(points):
        raise ControlError(f"door: expected two ends on the map, at least {MIN_WALL_IN:g} in apart")
    return points[0], points[1]


def _door_of(doors: Sequence[Door], name: object) -> int:
    names = [door.name for door in doors]
    if name not in names:
        there = f"there are {', '.join(names)}" if names else "this world has no doors"
        raise ControlError(f"door: no door {name!r}; {there}{suggest(str(name), names)}")
    return names.index(name)


def _door_fields(door: Door | None) -> dict[str, Any] | None:
    return None if door is None else {"put": [*map(list, door.ends_in)], "name": door.name, "open": door.is_open}


def _walker_fields(walker: Walker | None) -> dict[str, Any] | None:
    return None if walker is None else {
        "put": [*map(list, walker.points_in)], "name": walker.name, "speed": walker.speed_in_s,
        "radius": walker.radius_in, "closed": walker.is_closed,
    }  # fmt: skip


CHANGES: Final = {"obstacle": change_obstacle, "wall": change_wall, "door": change_door, "walker": change_walker}
"""Changes of the world by the kind that commands and recordings name."""
