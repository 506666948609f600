"""What verbs and Settings are given, by a program or by a list: the bounds, and what is said of a value beyond them.

    go_to: x_in: expected a length, a number, found the text '15'

Rules: pure; values of a program are read as if they stood in a file (worlds.schema), so that both are refused in the
same words. What is wrong is a MissionFileError: who was given it, which argument, what was expected and what was found;
files.py puts file and line before it.

What a mission is bound to: time, place, and what is done when the robot no longer knows where it is.

Rules: values. `settings_in` reads them, one by one, from the top of a list and from what a program hands to Settings,
so that both are refused in the same words.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from enum import Enum
from math import inf
from os import PathLike, fspath
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from nclient.common.hints import suggest
from nclient.errors import MissionFileError, WorldFileError
from worlds.schema import Point, Table, found, require_outline

__all__ = ["OnLost", "Point", "Settings", "settings_in"]

LEAST_S, LONGEST_S = 0.1, 86_400.0
LEAST_WITHIN_IN, MOST_WITHIN_IN = 0.1, 100.0
MOST_RETRIES, MOST_ROUNDS = 100, 10_000
MOST_TURN_DEG: Final = 3600.0
"""Ten times around: farther is nearly always a mistake, such as another unit."""


@contextmanager
def given(name: str, values: Mapping[str, object]) -> Iterator[Table]:
    """What `name` was given, as a table to read. Raises MissionFileError where a reader refuses."""
    try:
        yield Table(name, "", {key: plain(value) for key, value in values.items()})
    except WorldFileError as error:
        raise MissionFileError(str(error)) from None


def check(verb: str, **arguments: object) -> None:
    """Refuse arguments that the verb can do nothing with; heading_deg and by_deg of None are not given, but for a
    dock. Raises MissionFileError."""
    stated = {key: value for key, value in arguments.items() if value is not None or (verb, key) not in _LEFT_OUT}
    with given(verb, stated) as table:
        for key in stated:
            _READERS[key](table)


def points(verb: str, points_in: object) -> tuple[Point, ...]:
    """At least one point, as plain numbers. Raises MissionFileError."""
    with given(verb, {"points_in": points_in}) as table:
        return table.points_in("points", least=1)


def plain(value: object) -> object:
    """As a file would have it: collections and arrays are lists, numpy's numbers are Python's, a path is its text."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Collection) and not isinstance(value, str | bytes | Mapping):
        return [plain(one) for one in value]
    return fspath(value) if isinstance(value, PathLike) else value


def by_deg(table: Table) -> float:
    """How far to turn, to the left; the key is there."""
    return table.number("by_deg", -MOST_TURN_DEG, MOST_TURN_DEG)


def within_in(table: Table) -> float:
    """How near counts as there."""
    return table.number("within_in", LEAST_WITHIN_IN, MOST_WITHIN_IN) if "within_in" in table.values else 1.0


def retries(table: Table) -> int:
    """How often a step is tried again."""
    return table.index("retries", MOST_RETRIES + 1) or 0


def rounds(table: Table) -> int:
    """How often a patrol goes around."""
    return table.index("rounds", MOST_ROUNDS + 1, least=1) or 1


def _limit(table: Table) -> object:
    """Seconds that are left for it, as a program may have counted them: none is none, and inf no limit."""
    return table.values["limit_s"] == inf or table.number("limit_s", 0.0, LONGEST_S)


def _condition(table: Table) -> None:
    condition = table.values["condition"]
    if not callable(condition):
        table.fail("condition", f"expected a function of what is seen, found {found(condition)}")


_LEFT_OUT: Final = frozenset({("go_to", "heading_deg"), ("turn", "heading_deg"), ("turn", "by_deg")})
_READERS: Final[Mapping[str, Callable[[Table], object]]] = MappingProxyType(
    {
        "x_in": lambda table: table.length_in("x"),
        "y_in": lambda table: table.length_in("y"),
        "heading_deg": lambda table: table.angle_rad("heading"),
        "by_deg": by_deg,
        "within_in": within_in,
        "seconds": lambda table: table.number("seconds", 0.0, LONGEST_S),
        "condition": _condition,
        "words": lambda table: table.text("words", ""),
        "rounds": rounds,
        "limit_s": _limit,
        "retries": retries,
    }
)
"""Every argument of a verb by its name, but points."""


TIME_LIMIT_S: Final = 600.0


class OnLost(Enum):
    """What to do on LOST, for as long as lost_s."""

    STOP = "stop"
    """Stand and listen; go on once the place is known again."""
    SEARCH = "search"
    """Turn about, then drive where there is room, until the place is known again."""
    GIVE_UP = "give_up"
    """End the mission."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Of a mission.

    title           what the report calls it              map       the walls: a shipped world or a TOML file, "": given
    time_limit_s    seconds of the robot's clock that all of it may take         otherwise
    fence_in        corners of a polygon that the robot keeps inside of, none: no fence
    on_lost, lost_s what to do on LOST, and for how long

    Raises MissionFileError, which names the one that is wrong; a word of OnLost stands for it.
    """

    title: str = ""
    map: str = ""
    time_limit_s: float = TIME_LIMIT_S
    fence_in: tuple[Point, ...] = ()
    on_lost: OnLost = OnLost.STOP
    lost_s: float = 60.0

    def __post_init__(self) -> None:
        values = {field.name: plain(getattr(self, field.name)) for field in fields(self)}
        values["on_lost"] = self.on_lost.value if isinstance(self.on_lost, OnLost) else values["on_lost"]
        stated = {key: value for key, value in values.items() if key not in _NONE or value != _NONE[key]}
        with given("Settings", stated) as table:
            for key, value in settings_in(table).items():
                object.__setattr__(self, key, value)


_NONE: Final[Mapping[str, object]] = MappingProxyType({"title": "", "map": "", "fence_in": []})
"""What says that there is none of it; a list leaves the key out."""


def settings_in(table: Table) -> dict[str, Any]:
    """Those that are given in the table, by their names. Raises WorldFileError."""
    read = {key: reader(table) for key, reader in _READERS_SETTINGS.items() if key in table.values}
    if any(key.startswith("fence_") for key in table.values):
        read["fence_in"] = _fence(table)
    return read


def _policy(table: Table) -> OnLost:
    word, words = table.values["on_lost"], [policy.value for policy in OnLost]
    if word not in words:
        told = f"{word!r}{suggest(word, words)}" if isinstance(word, str) else found(word)
        table.fail("on_lost", f"expected one of {', '.join(words)}, found {told}")
    return OnLost(word)


def _fence(table: Table) -> tuple[Point, ...]:
    corners = table.points_in("fence", least=3)
    require_outline(table, table.key_of("fence"), corners)
    return corners


_READERS_SETTINGS: Final[Mapping[str, Callable[[Table], object]]] = MappingProxyType(
    {
        "title": lambda table: table.text("title", ""),
        "map": lambda table: table.text("map", ""),
        "time_limit_s": lambda table: table.number("time_limit_s", LEAST_S, LONGEST_S),
        "on_lost": _policy,
        "lost_s": lambda table: table.number("lost_s", LEAST_S, LONGEST_S),
    }
)
