"""Settings of a mission, and the checks of the arguments of steps.

Arguments of a Python program are read as if they stood in a file (worlds.schema), so that both get the same error
messages, for example "go_to: x_in: expected a length, a number, found the text '15'". All errors are MissionFileError:
which step or settings, which argument, what was expected and what was found.
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
from worlds.schema import Point, Table, describe_value, require_outline

__all__ = ["OnLost", "Point", "Settings", "read_settings"]

MIN_TIME_S, MAX_TIME_S = 0.1, 86_400.0
MIN_WITHIN_IN, MAX_WITHIN_IN = 0.1, 100.0
MAX_RETRIES, MAX_ROUNDS = 100, 10_000
MAX_TURN_DEG: Final = 3600.0
"""Ten revolutions: a larger angle is nearly always a mistake, such as a wrong unit."""
# Seconds of the robot's clock, for missions that state no limit.
TIME_LIMIT_S: Final = 600.0


class OnLost(Enum):
    """Behaviour when the estimate is LOST, for at most lost_s."""

    STOP = "stop"
    """Stand until the robot is localized again."""
    SEARCH = "search"
    """Turn, then drive where there is free space, until the robot is localized again."""
    GIVE_UP = "give_up"
    """End the mission."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a mission.

    Attributes
    ----------
    title
        Title of the report.
    map
        Walls: a shipped world or a TOML file; "" if given on the command line.
    time_limit_s
        Time limit of the mission, seconds of the robot's clock.
    fence_in
        Corners of a polygon that the robot must stay inside; empty for no fence.
    on_lost, lost_s
        Behaviour when the estimate is LOST (or its name), and for how long.

    Raises
    ------
    MissionFileError
        If a value is wrong; the message names it.
    """

    title: str = ""
    map: str = ""
    time_limit_s: float = TIME_LIMIT_S
    fence_in: tuple[Point, ...] = ()
    on_lost: OnLost = OnLost.STOP
    lost_s: float = 60.0

    def __post_init__(self) -> None:
        # Settings of programs pass the same readers as those of TOML files: one set of limits and messages.
        values = {field.name: to_plain_value(getattr(self, field.name)) for field in fields(self)}
        values["on_lost"] = self.on_lost.value if isinstance(self.on_lost, OnLost) else values["on_lost"]
        stated = {key: value for key, value in values.items() if key not in _EMPTY or value != _EMPTY[key]}
        # The dataclass is frozen, so checked values are set past its __setattr__.
        with as_table("Settings", stated) as table:
            for key, value in read_settings(table).items():
                object.__setattr__(self, key, value)


_EMPTY: Final[Mapping[str, object]] = MappingProxyType({"title": "", "map": "", "fence_in": []})
"""Values that mean "not given" in a program; a TOML file omits the key instead."""


def read_settings(table: Table) -> dict[str, Any]:
    """Return the settings that are in a table, by name. Raises WorldFileError."""
    values = {key: reader(table) for key, reader in _SETTING_READERS.items() if key in table.values}
    if any(key.startswith("fence_") for key in table.values):
        values["fence_in"] = _read_fence(table)
    return values


def _read_on_lost(table: Table) -> OnLost:
    value, names = table.values["on_lost"], [policy.value for policy in OnLost]
    if value not in names:
        description = f"{value!r}{suggest(value, names)}" if isinstance(value, str) else describe_value(value)
        table.fail("on_lost", f"expected one of {', '.join(names)}, found {description}")
    return OnLost(value)


def _read_fence(table: Table) -> tuple[Point, ...]:
    corners = table.points_in("fence", minimum=3)
    require_outline(table, table.key_of("fence"), corners)
    return corners


_SETTING_READERS: Final[Mapping[str, Callable[[Table], object]]] = MappingProxyType(
    {
        "title": lambda table: table.text("title", ""),
        "map": lambda table: table.text("map", ""),
        "time_limit_s": lambda table: table.number("time_limit_s", MIN_TIME_S, MAX_TIME_S),
        "on_lost": _read_on_lost,
        "lost_s": lambda table: table.number("lost_s", MIN_TIME_S, MAX_TIME_S),
    }
)


# arguments of steps


@contextmanager
def as_table(name: str, values: Mapping[str, object]) -> Iterator[Table]:
    """Provide the values given to `name` as a table; errors of its readers become MissionFileError."""
    try:
        yield Table(name, "", {key: to_plain_value(value) for key, value in values.items()})
    except WorldFileError as error:
        raise MissionFileError(str(error)) from None


def check_arguments(step: str, **arguments: object) -> None:
    """Check the arguments of a step; optional ones may be None. Raises MissionFileError."""
    stated = {key: value for key, value in arguments.items() if value is not None or (step, key) not in _OPTIONAL}
    with as_table(step, stated) as table:
        for key in stated:
            _ARGUMENT_READERS[key](table)


def read_points(step: str, points_in: object) -> tuple[Point, ...]:
    """Return one or more points as plain numbers. Raises MissionFileError."""
    with as_table(step, {"points_in": points_in}) as table:
        return table.points_in("points", minimum=1)


def to_plain_value(value: object) -> object:
    """Return a value as a file would contain it: lists for collections and arrays, Python numbers, text for paths."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Collection) and not isinstance(value, str | bytes | Mapping):
        return [to_plain_value(one) for one in value]
    return fspath(value) if isinstance(value, PathLike) else value


def read_by_deg(table: Table) -> float:
    """Return the angle to turn by, counter-clockwise; the key must be present."""
    return table.number("by_deg", -MAX_TURN_DEG, MAX_TURN_DEG)


def read_within_in(table: Table) -> float:
    """Return the distance at which a goal counts as reached. Default: 1."""
    return table.number("within_in", MIN_WITHIN_IN, MAX_WITHIN_IN) if "within_in" in table.values else 1.0


def read_retries(table: Table) -> int:
    """Return the number of retries. Default: 0."""
    return table.index("retries", MAX_RETRIES + 1) or 0


def read_rounds(table: Table) -> int:
    """Return the number of rounds of a patrol. Default: 1."""
    return table.index("rounds", MAX_ROUNDS + 1, minimum=1) or 1


def _read_limit(table: Table) -> object:
    """Check a time limit that a program may have computed: 0 is allowed, and inf means no limit."""
    return table.values["limit_s"] == inf or table.number("limit_s", 0.0, MAX_TIME_S)


def _check_condition(table: Table) -> None:
    condition = table.values["condition"]
    if not callable(condition):
        table.fail("condition", f"expected a function of what is seen, found {describe_value(condition)}")


_OPTIONAL: Final = frozenset({("go_to", "heading_deg"), ("turn", "heading_deg"), ("turn", "by_deg")})
_ARGUMENT_READERS: Final[Mapping[str, Callable[[Table], object]]] = MappingProxyType(
    {
        "x_in": lambda table: table.length_in("x"),
        "y_in": lambda table: table.length_in("y"),
        "heading_deg": lambda table: table.angle_rad("heading"),
        "by_deg": read_by_deg,
        "within_in": read_within_in,
        "seconds": lambda table: table.number("seconds", 0.0, MAX_TIME_S),
        "condition": _check_condition,
        "words": lambda table: table.text("words", ""),
        "rounds": read_rounds,
        "limit_s": _read_limit,
        "retries": read_retries,
    }
)
"""Reader of every argument of a step, except points."""
