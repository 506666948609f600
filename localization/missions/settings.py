"""What a mission is bound to: time, place, and what is done when the robot no longer knows where it is.

Rules: values. `settings_in` reads them, one by one, from the top of a list and from what a program hands to Settings,
so that both are refused in the same words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from types import MappingProxyType
from typing import Any, Final

from localization.missions.arguments import LEAST_S, LONGEST_S, given, plain
from nclient.suggesting import did_you_mean
from worlds.outlines import require_outline
from worlds.tables import Point, Table, found

__all__ = ["OnLost", "Point", "Settings", "settings_in"]

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
    read = {key: reader(table) for key, reader in _READERS.items() if key in table.values}
    if any(key.startswith("fence_") for key in table.values):
        read["fence_in"] = _fence(table)
    return read


def _policy(table: Table) -> OnLost:
    word, words = table.values["on_lost"], [policy.value for policy in OnLost]
    if word not in words:
        told = f"{word!r}{did_you_mean(word, words)}" if isinstance(word, str) else found(word)
        table.fail("on_lost", f"expected one of {', '.join(words)}, found {told}")
    return OnLost(word)


def _fence(table: Table) -> tuple[Point, ...]:
    corners = table.points_in("fence", least=3)
    require_outline(table, table.key_of("fence"), corners)
    return corners


_READERS: Final[Mapping[str, Callable[[Table], object]]] = MappingProxyType(
    {
        "title": lambda table: table.text("title", ""),
        "map": lambda table: table.text("map", ""),
        "time_limit_s": lambda table: table.number("time_limit_s", LEAST_S, LONGEST_S),
        "on_lost": _policy,
        "lost_s": lambda table: table.number("lost_s", LEAST_S, LONGEST_S),
    }
)
