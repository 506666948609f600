"""Settings of a mission, and the checks of the arguments of steps.

Arguments of a Python program are checked against the types of files (worlds.schema), so that both get the same error
messages, for example "go_to: x_in: expected a length, a number, found the text '15'". All errors are MissionFileError:
which step or settings, which argument, what was expected and what was found.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import Enum
from math import inf
from os import PathLike, fspath
from types import MappingProxyType
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta

from nclient.common.validation import InvalidValue, Text, convert, describe_value, field_types, reported_as
from nclient.errors import MissionFileError
from worlds.schema import MAX_COORDINATE_IN, Angle, LengthIn, Point, PointsIn, points, require_outline

__all__ = ["OnLost", "Point", "Settings"]

MIN_TIME_S, MAX_TIME_S = 0.1, 86_400.0
MIN_WITHIN_IN, MAX_WITHIN_IN = 0.1, 100.0
MAX_RETRIES, MAX_ROUNDS = 100, 10_000
MAX_TURN_DEG: Final = 3600.0
"""Ten revolutions: a larger angle is nearly always a mistake, such as a wrong unit."""
# Seconds of the robot's clock, for missions that state no limit.
TIME_LIMIT_S: Final = 600.0

Seconds = Annotated[float, Meta(ge=0.0, le=MAX_TIME_S)]
TimeLimit = Annotated[float, Meta(ge=MIN_TIME_S, le=MAX_TIME_S)]
TurnAngle = Annotated[float, Meta(ge=-MAX_TURN_DEG, le=MAX_TURN_DEG, description="angle to turn by, degrees")]
Within = Annotated[
    float, Meta(ge=MIN_WITHIN_IN, le=MAX_WITHIN_IN, description="distance at which the goal is reached, inches")
]
Retries = Annotated[int, Meta(ge=0, le=MAX_RETRIES, description="number of retries")]
Rounds = Annotated[int, Meta(ge=1, le=MAX_ROUNDS, description="number of rounds")]


class OnLost(Enum):
    """Behaviour when the estimate is LOST, for at most lost_s."""

    STOP = "stop"
    """Stand until the robot is localized again."""
    SEARCH = "search"
    """Turn, then drive where there is free space, until the robot is localized again."""
    GIVE_UP = "give_up"
    """End the mission."""


LostPolicy = Annotated[OnLost, Meta(extra_json_schema={"enum": [policy.value for policy in OnLost]})]
MaybeText = Annotated[str, Meta(pattern=r"^$|\S", title="a text")]


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

    title: MaybeText = ""
    map: MaybeText = ""
    time_limit_s: TimeLimit = TIME_LIMIT_S
    fence_in: tuple[Point, ...] = ()
    on_lost: LostPolicy = OnLost.STOP
    lost_s: TimeLimit = 60.0

    def __post_init__(self) -> None:
        # Settings of programs are checked against the types of files: one set of limits and messages.
        kinds = field_types(Settings) | {"fence_in": points(3).type_for(MAX_COORDINATE_IN)}
        with reported_as(MissionFileError, "Settings"):
            for key, kind in kinds.items():
                value = to_plain_value(getattr(self, key))
                # The dataclass is frozen, so checked values are set past its __setattr__.
                object.__setattr__(self, key, () if key == "fence_in" and value == [] else convert(value, kind, key))
            if self.fence_in:
                require_outline("fence_in", self.fence_in)


# arguments of steps


def check_arguments(step: str, **arguments: object) -> None:
    """Check the arguments of a step; optional ones may be None. Raises MissionFileError."""
    with reported_as(MissionFileError, step):
        for key, argument in arguments.items():
            value = to_plain_value(argument)
            if key == "condition":
                if not callable(value):
                    raise InvalidValue(f"expected a function of what is seen, found {describe_value(value)}", key)
            # A time limit that a program may have computed: inf means none.
            elif not ((value is None and (step, key) in _OPTIONAL) or (key == "limit_s" and value == inf)):
                convert(value, _ARGUMENTS[key], key)


def read_points(step: str, points_in: object) -> tuple[Point, ...]:
    """Return one or more points as plain numbers. Raises MissionFileError."""
    with reported_as(MissionFileError, step):
        points: tuple[Point, ...] = convert(to_plain_value(points_in), PointsIn, "points_in")
        return points


def to_plain_value(value: object) -> object:
    """Return a value as a file would contain it: lists for collections and arrays, Python numbers, text for paths."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Collection) and not isinstance(value, str | bytes | Mapping):
        return [to_plain_value(one) for one in value]
    if isinstance(value, Enum):
        return value.value
    return fspath(value) if isinstance(value, PathLike) else value


_OPTIONAL: Final = frozenset({("go_to", "heading_deg"), ("turn", "heading_deg"), ("turn", "by_deg")})
_ARGUMENTS: Final[Mapping[str, Any]] = MappingProxyType({
    "x_in": LengthIn, "y_in": LengthIn, "heading_deg": Angle, "by_deg": TurnAngle, "within_in": Within,
    "seconds": Seconds, "words": Text, "rounds": Rounds, "limit_s": Seconds, "retries": Retries,
})  # fmt: skip
"""Type of every argument of a step, except points and conditions."""
