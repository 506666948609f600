"""The steps of a mission's TOML file: for each verb its keys, and what it does. THE table.

    do = "go_to"      to_in, heading_deg, within_in          do = "turn"       heading_deg or by_deg
    do = "follow"     points_in, within_in                   do = "look"       for_s
    do = "patrol"     points_in, rounds                      do = "wait_for"   one condition (CONDITIONS), time_limit_s
    do = "dock"       to_in, heading_deg                     do = "note"       words

and with each that moves: time_limit_s, retries. Lengths may be _in, _cm or _m. Rules: reads tables, drives nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import degrees, inf
from types import MappingProxyType
from typing import Final

from localization.missions import arguments
from localization.missions.arguments import LEAST_S, LONGEST_S
from localization.missions.mission import Condition, Mission
from localization.missions.settings import Point
from nclient.errors import MissionFileError
from nclient.suggesting import did_you_mean
from worlds.tables import FARTHEST_IN, Table

Act = Callable[[Mission], object]
_LIMITS: Final = ("do", "time_limit_s", "retries")

CONDITIONS: Final[Mapping[str, Callable[[float], Condition]]] = MappingProxyType(
    {
        "nearer_than_in": lambda value: lambda seen: seen.nearest_in < value,
        "farther_than_in": lambda value: lambda seen: seen.nearest_in > value,
        "known_to_in": lambda value: lambda seen: seen.std_in <= value,
        "finds": lambda value: lambda seen: seen.finds >= value,
    }
)
"""What can be waited for: the shortest reading of the ring below or above this, the place known to this standard
deviation, so many things found that the map does not have. `touching = true` besides."""


def step_of(table: Table) -> Act:
    """What one [[step]] does. Raises MissionFileError."""
    if "do" not in table.values:
        table.fail("do", f"is wanted; there are {', '.join(VERBS)}")
    verb = table.text("do", "")
    if verb not in VERBS:
        table.fail("do", f"expected one of {', '.join(VERBS)}, found {verb!r}{did_you_mean(verb, VERBS)}")
    return VERBS[verb](table)


def _go_to(table: Table) -> Act:
    table.allow((*_LIMITS, "heading_deg", "within_in"), ("to",))
    (x, y), heading, within = _point(table), _heading(table), arguments.within_in(table)
    limit_s, retries = _limits(table)
    return lambda robot: robot.go_to(x, y, heading, limit_s=limit_s, retries=retries, within_in=within)


def _follow(table: Table) -> Act:
    table.allow((*_LIMITS, "within_in"), ("points",))
    points, within = table.points_in("points", least=1), arguments.within_in(table)
    limit_s, retries = _limits(table)
    return lambda robot: robot.follow(points, limit_s=limit_s, retries=retries, within_in=within)


def _patrol(table: Table) -> Act:
    table.allow((*_LIMITS, "rounds"), ("points",))
    points, rounds = table.points_in("points", least=1), arguments.rounds(table)
    limit_s, retries = _limits(table)
    return lambda robot: robot.patrol(points, rounds, limit_s=limit_s, retries=retries)


def _turn(table: Table) -> Act:
    table.allow((*_LIMITS, "heading_deg", "by_deg"))
    if ("heading_deg" in table.values) == ("by_deg" in table.values):
        table.fail("", "expected heading_deg or by_deg, one of them")
    heading, by = _heading(table), arguments.by_deg(table) if "by_deg" in table.values else None
    limit_s, retries = _limits(table)
    return lambda robot: robot.turn(heading, by_deg=by, limit_s=limit_s, retries=retries)


def _dock(table: Table) -> Act:
    table.allow((*_LIMITS, "heading_deg"), ("to",))
    (x, y), heading = _point(table), _heading(table)
    if heading is None:
        table.fail("heading_deg", "is wanted: which way to drive in, in degrees")
    limit_s, retries = _limits(table)
    return lambda robot: robot.dock(x, y, heading, limit_s=limit_s, retries=retries)


def _look(table: Table) -> Act:
    table.allow(("do", "for_s"))
    seconds = table.number("for_s", 0.0, LONGEST_S) if "for_s" in table.values else 1.0
    return lambda robot: robot.look(seconds)


def _wait_for(table: Table) -> Act:
    table.allow(("do", "time_limit_s", "touching", *CONDITIONS))
    given = [key for key in ("touching", *CONDITIONS) if key in table.values]
    if len(given) != 1:
        table.fail("", f"expected one of touching, {', '.join(CONDITIONS)}, found {' and '.join(given) or 'none'}")
    if "time_limit_s" not in table.values:
        table.fail("time_limit_s", "is wanted: how many seconds to wait at most")
    limit_s, _ = _limits(table)
    (key,) = given
    if key == "touching":
        wanted = table.flag(key)
        return lambda robot: robot.wait_for(lambda seen: seen.touching is wanted, limit_s, f"touching = {wanted}")
    value = table.number(key, 0.0, FARTHEST_IN)
    return lambda robot: robot.wait_for(CONDITIONS[key](value), limit_s, f"{key} = {value:g}")


def _note(table: Table) -> Act:
    table.allow(("do", "words"))
    words = table.text("words", "")
    if not words:
        table.fail("words", "is wanted: what to write into the report")
    return lambda robot: robot.note(words)


VERBS: Final[Mapping[str, Callable[[Table], Act]]] = MappingProxyType(
    {
        "go_to": _go_to,
        "follow": _follow,
        "turn": _turn,
        "look": _look,
        "wait_for": _wait_for,
        "patrol": _patrol,
        "dock": _dock,
        "note": _note,
    }
)
"""Every verb by its name."""


def _point(table: Table) -> Point:
    """The one point under to_in, to_cm or to_m."""
    key = table.key_of("to")
    row = Table(table.file, table.path, {key.replace("to_", "points_"): [table.values[key]]})
    try:
        return row.points_in("points", least=1)[0]
    except ValueError as error:
        raise MissionFileError(str(error).replace(key.replace("to_", "points_") + "[0]", key)) from None


def _heading(table: Table) -> float | None:
    """A heading in degrees, None where it is not given."""
    return degrees(table.angle_rad("heading")) if "heading_deg" in table.values else None


def _limits(table: Table) -> tuple[float, int]:
    """Seconds that a step may take, and how often it is tried again."""
    limit_s = table.number("time_limit_s", LEAST_S, LONGEST_S) if "time_limit_s" in table.values else inf
    return limit_s, arguments.retries(table)
