"""Estimates published by a localizer: POST /publish, one JSON object per update; the reply contains way-points.

    robot       number of the robot                     clock_s    the robot's clock
    pose        x, y, heading of the steering           turret     its estimated direction
    cov         3 x 3 covariance of the pose            odometry, truth    poses; truth is null where unknown
    echoes      [{"sonar", "reading_in", "refusal", "innovation_in", "nis"} ...] since the previous update
    trust       OK, DEGRADED, LOST    reason    in words, "" for OK
    places      [{"pose", "share"} ...] candidate poses, the most probable first; with LOST pose and cov are undefined
    waypoints   [[x, y] ...], and the number passed     began      true: the localizer starts with its own way-points

    reply       {"waypoints": [[x, y] ...] or null, "set": how often they were set}

Units are inches and radians. Anything else raises InvalidMessage.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from nserver_emu.viewer.messages import MAX_NUMBER, MAX_POINTS, InvalidMessage, Message
from worlds.robots import SONARS

REFUSALS: Final = ("none", "limit", "no_wall", "ambiguous_wall", "grazing", "gate")
TRUSTS: Final = ("OK", "DEGRADED", "LOST")
MAX_ECHOES: Final = 64
MAX_PLACES: Final = 20
MAX_REASON: Final = 200
"""Characters of a reason."""
MAX_READING_IN: Final = 1000.0
"""More than any sonar measures."""
_POSE, _COV = 3, 9
_ROUNDING: Final = 1e-6


def parse_estimate(text: str) -> Message:
    """Parse and check a published estimate.

    Raises
    ------
    InvalidMessage
        If a field is missing or wrong.
    """
    try:
        raw = json.loads(text)
        message = {
            "robot": _integer(raw["robot"]), "clock_s": _number(raw["clock_s"]), "pose": _numbers(raw["pose"], _POSE),
            "turret": _number(raw["turret"]), "cov": _covariance(raw["cov"]),
            "odometry": _numbers(raw["odometry"], _POSE),
            "truth": None if raw["truth"] is None else _numbers(raw["truth"], _POSE),
            "echoes": [_echo(echo) for echo in raw["echoes"][:MAX_ECHOES]],
            "waypoints": [_numbers(point, 2) for point in raw["waypoints"][:MAX_POINTS]],
            "trust": _one_of(TRUSTS, raw["trust"]), "reason": _text(raw["reason"]),
            "places": _places(raw["places"][:MAX_PLACES]), "passed": _integer(raw["passed"]),
            "began": raw.get("began") is True,
        }  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as error:
        raise InvalidMessage(f"what is published is robot, clock_s, pose, turret, cov, odometry, truth, echoes, "
                             f"waypoints, passed, trust, reason, places: {error!r}") from None
    return message


def _echo(raw: Any) -> Message:
    return {
        "sonar": _integer(raw["sonar"], below=SONARS), "refusal": _one_of(REFUSALS, raw["refusal"]),
        "reading_in": _number(raw["reading_in"], 0.0, MAX_READING_IN),
        "innovation_in": _number(raw["innovation_in"]), "nis": _number(raw["nis"], 0.0),
    }  # fmt: skip


def _places(raw: Any) -> list[Message]:
    places: list[Message] = [
        {"pose": _numbers(place["pose"], _POSE), "share": _number(place["share"], 0.0, 1.0)} for place in raw
    ]
    if sum(place["share"] for place in places) > 1.0 + _ROUNDING:
        raise ValueError("the shares of places sum to more than 1")
    return places


def _covariance(rows: Any) -> list[float]:
    """Return the nine numbers of a covariance: symmetric and positive semidefinite, up to rounding."""
    cov = _numbers([n for row in rows for n in row], _COV)
    matrix = np.array(cov).reshape(_POSE, _POSE)
    largest = float(np.abs(matrix).max())
    is_symmetric = np.abs(matrix - matrix.T).max() <= _ROUNDING * largest
    if not is_symmetric or np.linalg.eigvalsh(matrix)[0] < -_ROUNDING * largest:
        raise ValueError("cov is no covariance: not symmetric, or not positive semidefinite")
    return cov


def _one_of(names: Sequence[str], value: Any) -> str:
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"one of {', '.join(names)}, not {value!r:.60}")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"no text: {value!r:.60}")
    return value[:MAX_REASON]


def _integer(value: Any, below: int = 2**31) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < below:
        raise ValueError(f"no whole number from 0 below {below}: {value!r}")
    return value


def _numbers(values: Any, count: int) -> list[float]:
    numbers = [_number(value) for value in values]
    if len(numbers) != count:
        raise ValueError(f"{count} numbers, not {len(numbers)}")
    return numbers


def _number(value: Any, low: float = -MAX_NUMBER, high: float = MAX_NUMBER) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"no number from {low:g} to {high:g}: {value!r:.60}")
    return float(value)
