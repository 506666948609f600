"""What a localizer publishes, checked: POST /publish, a JSON object a period; the answer is where to go. Pure.

    robot       whose estimate it is                    clock_s    the robot's clock
    pose        x, y, heading of the steering           turret     its direction as estimated
    cov         3 x 3 of the pose                       odometry, truth    poses; truth is null where unknown
    echoes      [{"sonar", "reading_in", "refusal", "innovation_in", "nis"} ...] since the one before
    trust       OK, DEGRADED, LOST    reason    in words, "" where all is well
    places      [{"pose", "share"} ...] where it may be, the likeliest first; LOST: pose and cov mean nothing
    waypoints   [[x, y] ...], and how many are passed      began       true: it goes on its own ones, whatever was set

    answer      {"waypoints": [[x, y] ...] or null, "set": how often they were set}

Inches and radians. Raises BadMessage for anything else.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from nserver_emu.viewer.messages import FARTHEST, MAX_POINTS, BadMessage, Message
from worlds.robots import SONARS

REFUSALS: Final = ("none", "limit", "no_wall", "ambiguous_wall", "grazing", "gate")
TRUSTS: Final = ("OK", "DEGRADED", "LOST")
MOST_ECHOES: Final = 64
MOST_PLACES: Final = 20
MOST_REASON: Final = 200
"""Characters."""
_POSE, _COV = 3, 9
_ROUNDING: Final = 1e-6
FARTHEST_READING_IN: Final = 1000.0
"""More than any sonar reads."""


def published(text: str) -> Message:
    """The message in a text, checked."""
    try:
        said = json.loads(text)
        told = {
            "robot": _whole(said["robot"]), "clock_s": _number(said["clock_s"]), "pose": _numbers(said["pose"], _POSE),
            "turret": _number(said["turret"]), "cov": _covariance(said["cov"]),
            "odometry": _numbers(said["odometry"], _POSE),
            "truth": None if said["truth"] is None else _numbers(said["truth"], _POSE),
            "echoes": [_echo(echo) for echo in said["echoes"][:MOST_ECHOES]],
            "waypoints": [_numbers(point, 2) for point in said["waypoints"][:MAX_POINTS]],
            "trust": _one_of(TRUSTS, said["trust"]), "reason": _text(said["reason"]),
            "places": _places(said["places"][:MOST_PLACES]), "passed": _whole(said["passed"]),
            "began": said.get("began") is True,
        }  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as error:
        raise BadMessage(f"what is published is robot, clock_s, pose, turret, cov, odometry, truth, echoes, "
                         f"waypoints, passed, trust, reason, places: {error!r}") from None
    return told


def _echo(said: Any) -> Message:
    return {
        "sonar": _whole(said["sonar"], below=SONARS), "refusal": _one_of(REFUSALS, said["refusal"]),
        "reading_in": _number(said["reading_in"], 0.0, FARTHEST_READING_IN),
        "innovation_in": _number(said["innovation_in"]), "nis": _number(said["nis"], 0.0),
    }  # fmt: skip


def _places(said: Any) -> list[Message]:
    places: list[Message] = [
        {"pose": _numbers(place["pose"], _POSE), "share": _number(place["share"], 0.0, 1.0)} for place in said
    ]
    if sum(place["share"] for place in places) > 1.0 + _ROUNDING:
        raise ValueError("places share more than all")
    return places


def _one_of(names: Sequence[str], value: Any) -> str:
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"one of {', '.join(names)}, not {value!r:.60}")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"no text: {value!r:.60}")
    return value[:MOST_REASON]


def _covariance(rows: Any) -> list[float]:
    cov = _numbers([n for row in rows for n in row], _COV)
    matrix = np.array(cov).reshape(_POSE, _POSE)
    most = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > _ROUNDING * most or np.linalg.eigvalsh(matrix)[0] < -_ROUNDING * most:
        raise ValueError("cov is no covariance: not symmetric, or negative in some direction")
    return cov


def _whole(value: Any, below: int = 2**31) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < below:
        raise ValueError(f"no whole number from 0 below {below}: {value!r}")
    return value


def _numbers(values: Any, count: int) -> list[float]:
    numbers = [_number(value) for value in values]
    if len(numbers) != count:
        raise ValueError(f"{count} numbers, not {len(numbers)}")
    return numbers


def _number(value: Any, least: float = -FARTHEST, most: float = FARTHEST) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        raise ValueError(f"no number from {least:g} to {most:g}: {value!r:.60}")
    return float(value)
