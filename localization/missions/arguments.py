"""What verbs and Settings are given, by a program or by a list: the bounds, and what is said of a value beyond them.

    go_to: x_in: expected a length, a number, found the text '15'

Rules: pure; values of a program are read as if they stood in a file (worlds.tables), so that both are refused in the
same words. What is wrong is a MissionFileError: who was given it, which argument, what was expected and what was found;
files.py puts file and line before it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from math import inf
from os import PathLike, fspath
from types import MappingProxyType
from typing import Final

import numpy as np

from nclient.errors import MissionFileError, WorldFileError
from worlds.tables import Point, Table, found

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
