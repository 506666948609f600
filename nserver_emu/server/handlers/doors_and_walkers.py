"""Changes to doors and walkers by the operator (`nserver ctl`, viewer), as runtime_settings.py has them for walls.

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
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from nclient.common.hints import suggest
from nclient.errors import ControlError
from nserver_emu.server.handlers.runtime_settings import (
    CORNER_TOLERANCE_IN,
    MIN_WALL_IN,
    check_touches_no_robot,
    is_on_map,
    malformed_as,
    moved,
    read_name,
    read_points,
)
from nserver_emu.server.server_state import ServerState
from worlds.io import route_error
from worlds.world import MAX_DOORS, MAX_ROUTE_POINTS, MAX_WALKERS, Door, Point, Walker

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
        if len(doors) >= MAX_DOORS:
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
            row = _walker_of(walkers, read_points(wanted["walker"]))
            was = walkers[row]
            if (points := moved(was.points_in, wanted)) is not None:
                now = replace(was, points_in=points)
    # 2. Check that it fits.
    if now is not None:
        _check_walker(server, now)
        if was is None and len(walkers) >= MAX_WALKERS:
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


def _walker_of(walkers: Sequence[Walker], points: Sequence[Point]) -> int:
    """Return the index of the last walker with this route."""
    for number in reversed(range(len(walkers))):
        there = walkers[number].points_in
        if len(there) == len(points) and all(
            math.dist(*pair) < CORNER_TOLERANCE_IN for pair in zip(there, points, strict=True)
        ):
            return number
    raise ControlError("walker: there is none with this route, or it was changed meanwhile")


def _door_fields(door: Door | None) -> dict[str, Any] | None:
    return None if door is None else {"put": [*map(list, door.ends_in)], "name": door.name, "open": door.is_open}


def _walker_fields(walker: Walker | None) -> dict[str, Any] | None:
    return None if walker is None else {
        "put": [*map(list, walker.points_in)], "name": walker.name, "speed": walker.speed_in_s,
        "radius": walker.radius_in, "closed": walker.is_closed,
    }  # fmt: skip
