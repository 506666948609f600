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
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from nclient.errors import ControlError
from nserver_emu.server.handling.ground import sound, stands_in_a_robot
from nserver_emu.server.stage.stage import Stage
from worlds.world import Point, Polygon

SAME_IN: Final = 0.002
"""Corners are shown rounded to a thousandth of an inch."""
WANTED: Final = 'obstacle: such as {"corners": [[0, 0], [9, 0], [9, 9]], "by": [1, 0]}, in inches'


def change_obstacle(stage: Stage, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Do it; what is told. Nothing changes where it raises."""
    obstacles = list(stage.simulation.world.obstacles)
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
        _require_possible(stage, now)
    if was is None and len(obstacles) >= stage.allowed.obstacles:
        raise ControlError(f"obstacle: there are {len(obstacles)} already, as many as may be")
    obstacles[number : number + (was is not None)] = [] if now is None else [now]
    stage.simulation.change_world(stage.simulation.world.with_obstacles(obstacles))
    stage.look_anew()
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


def _require_possible(stage: Stage, obstacle: Polygon) -> None:
    if not sound(obstacle):
        raise ControlError("obstacle: it would reach off the map, or be none: no area, or sides that cross")
    if stands_in_a_robot(stage, obstacle):
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
