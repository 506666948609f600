"""What the owner of a simulation may do with one obstacle while it runs, and whatever undoes it. Pure.

    {"corners": [[x, y] ...], "by": [dx, dy]}            moved by so much
    {"corners": [[x, y] ...], "to": [[x, y] ...]}        given these corners
    {"corners": [[x, y] ...]}                            taken away
    {"put": [[x, y] ...], "name": text, "at": number}    put there, as that one of them (both left out: the last)

    told    {"obstacles": how many there are then, "was": corners, "name", "at": number of it, "is": corners}
            was and is to the bit, null where there was or is none

Inches. Rules: an obstacle is known by its corners as they are shown, of any number; the latest where several have them.
What was told undoes it: moved back to `was`, or put there again; what others did to other obstacles stays. Raises
ControlError, with what would be right.

What the owner of a simulation may change in it while it runs, besides its time: noise, world. Pure.

    noise    {"sensors": NAME, "motion": NAME, "robot": number}    what is left out stays; no robot: all of them
    world    {"text": TOML, "file": what errors call it}           all of it: rooms, walls, obstacles, starts, paths
    shown    true                                                  its text was told: that text is that very world

Rules: nothing changes unless all of it can. What was changed is on the recording, so that a replay changes it too.
Raises ControlError or WorldFileError, with what would be right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, Final

from nclient.common.hints import suggest
from nclient.errors import ControlError, StartError
from nserver_emu.server.context import ServerState
from nserver_emu.server.handlers.world import sound, stands_in_a_robot
from nserver_emu.simulation.noise import PARTS, part_choices, part_name, with_part
from nserver_emu.simulation.robot import SimulatedRobot
from worlds.io import format_world, parse_world
from worlds.world import Point, Polygon, World

SAME_IN: Final = 0.002
"""Corners are shown rounded to a thousandth of an inch."""
WANTED: Final = 'obstacle: such as {"corners": [[0, 0], [9, 0], [9, 9]], "by": [1, 0]}, in inches'


def change_obstacle(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Do it; what is told. Nothing changes where it raises."""
    obstacles = list(server.simulation.world.obstacles)
    was: Polygon | None = None
    now: Polygon | None
    try:
        if "put" in wanted:
            now = Polygon(_points(wanted["put"]), _name(wanted.get("name", "")))
            number = _place(wanted.get("at"), len(obstacles))
        else:
            number = _number_of(obstacles, _points(wanted["corners"]))
            was = obstacles[number]
            now = _moved(was, wanted)
    except ControlError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ControlError(f"{WANTED}, not {wanted!r:.200}") from None
    if now is not None:
        _require_possible(server, now)
    if was is None and len(obstacles) >= server.allowed.obstacles:
        raise ControlError(f"obstacle: there are {len(obstacles)} already, as many as may be")
    obstacles[number : number + (was is not None)] = [] if now is None else [now]
    server.simulation.change_world(server.simulation.world.with_obstacles(obstacles))
    server.invalidate_state_cache()
    known = now or was
    assert known is not None
    return {"obstacles": len(obstacles), "was": _corners(was), "name": known.name, "at": number, "is": _corners(now)}


def _moved(was: Polygon, wanted: Mapping[str, Any]) -> Polygon | None:
    """As it is to be; None: taken away."""
    if wanted.get("to") is not None:
        return Polygon(_points(wanted["to"]), was.name)
    if wanted.get("by") is None:
        return None
    ((dx_in, dy_in),) = _points([wanted["by"]])
    return was.moved(dx_in, dy_in)


def _require_possible(server: ServerState, obstacle: Polygon) -> None:
    if not sound(obstacle):
        raise ControlError("obstacle: it would reach off the map, or be none: no area, or sides that cross")
    if stands_in_a_robot(server, obstacle):
        raise ControlError("obstacle: a robot stands where it would be")


def _points(said: Any) -> tuple[Point, ...]:
    points = tuple((float(x), float(y)) for x, y in said)
    if not all(math.isfinite(number) for point in points for number in point):
        raise ValueError("no number")
    return points


def _name(said: Any) -> str:
    if not isinstance(said, str):
        raise TypeError("no name")
    return said


def _place(said: Any, last: int) -> int:
    """Which one of them it is to be."""
    if said is None:
        return last
    if not isinstance(said, int) or isinstance(said, bool) or said < 0:
        raise ValueError("no number of an obstacle")
    return min(said, last)


def _number_of(obstacles: Sequence[Polygon], corners: Sequence[Point]) -> int:
    """The latest of the obstacles that has these corners."""
    for number in reversed(range(len(obstacles))):
        there = obstacles[number].corners_in
        if len(there) == len(corners) and all(math.dist(*pair) < SAME_IN for pair in zip(there, corners, strict=True)):
            return number
    raise ControlError("obstacle: there is none with these corners (any more)")


def _corners(obstacle: Polygon | None) -> list[list[float]] | None:
    return None if obstacle is None else [list(corner) for corner in obstacle.corners_in]


Said = dict[str, Any]
ROBOT: Final = "robot"
MOST_SHOWN: Final = 200
"""Worlds that can be put back to the bit; as many steps as a page can take back."""
NOISE_WANTED: Final = "noise: such as sensors=measured motion=ideal robot=1"


def noise_of(robot: SimulatedRobot) -> dict[str, str]:
    """By part, the name of the noise in force."""
    return {part: part_name(part, robot.setup, robot.model, robot.initial_setup) for part in PARTS}


def noise_choices(robot: SimulatedRobot) -> dict[str, list[str]]:
    """By part, the names there are."""
    return {part: list(part_choices(part, robot.model, robot.initial_setup)) for part in PARTS}


def switch_noise(server: ServerState, wanted: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Switch noise; what is in force then, by robot."""
    if unknown := [name for name in wanted if name not in (*PARTS, ROBOT)]:
        raise ControlError(f"{NOISE_WANTED}, not {unknown[0]!r}")
    if not any(part in wanted for part in PARTS):
        raise ControlError(f"{NOISE_WANTED}; {' and '.join(PARTS)} were both left out")
    robots = server.simulation.robots
    chosen = list(robots) if wanted.get(ROBOT) is None else [_robot_number(server, wanted[ROBOT])]
    for robot, setup in [(robots[number], _setup(robots[number], wanted)) for number in chosen]:
        robot.set_noise_model(setup)
    server.invalidate_state_cache()
    return {str(number): noise_of(robots[number]) for number in chosen}


def noise_words(text: str) -> dict[str, Any]:
    """The same as a dictionary from words KEY=VALUE."""
    pairs = [word.partition("=") for word in text.split()]
    if not pairs or not all(middle and value for _, middle, value in pairs):
        raise ControlError(f"{NOISE_WANTED}, not {text!r}")
    return {key: int(value) if key == ROBOT and value.isdecimal() else value for key, _, value in pairs}


def put_world(server: ServerState, text: str, file: str) -> World:
    """Put another world in place of the one there; robots stay where they are, which must be free."""
    shown = server.shown.get(text)
    world = parse_world(text, file, PurePath(file).stem) if shown is None else shown
    for number, robot in server.simulation.robots.items():
        x, y, radius_in = robot.disc
        try:
            world.require_free(x, y, radius_in)
        except StartError as error:
            raise ControlError(f"{file}: robot {number} stands where there is no room for it: {error}") from None
    server.simulation.change_world(world)
    server.invalidate_state_cache()
    return world


def show_world(server: ServerState) -> str:
    """The world as the text of a file. Put back in time (put_world), that text is this very world again, to the bit,
    with what a file could not say: starts and paths on which something stands."""
    world = server.simulation.world
    text = format_world(world)
    server.shown.pop(text, None)
    server.shown[text] = world
    while len(server.shown) > MOST_SHOWN:
        del server.shown[next(iter(server.shown))]
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
