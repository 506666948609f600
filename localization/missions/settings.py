"""What a mission is bound to: time, place, and what is done when the robot no longer knows where it is. Values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

Point = tuple[float, float]

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
    """

    title: str = ""
    map: str = ""
    time_limit_s: float = TIME_LIMIT_S
    fence_in: tuple[Point, ...] = ()
    on_lost: OnLost = OnLost.STOP
    lost_s: float = 60.0
