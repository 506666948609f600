"""What a localizer publishes, checked: POST /publish, a JSON object a period; the answer is where to go. Pure.

    robot       whose estimate it is                    clock_s    the robot's clock
    pose        x, y, heading of the steering           turret     its direction as estimated
    cov         3 x 3 of the pose                       odometry, truth    poses; truth is null where unknown
    echoes      [{"sonar", "reading_in", "refusal", "innovation_in", "nis"} ...] since the one before
    waypoints   [[x, y] ...], and how many are passed

    answer      {"waypoints": [[x, y] ...] or null, "set": how often they were set}

Inches and radians. Raises BadMessage for anything else.
"""

from __future__ import annotations

import json
from typing import Any, Final

from nserver_emu.viewer.protocol import FARTHEST, MOST_POINTS, BadMessage, Message
from worlds.bodies import SONARS

REFUSALS: Final = ("none", "limit", "no_wall", "ambiguous_wall", "grazing", "gate")
MOST_ECHOES: Final = 64
_POSE, _COV = 3, 9
_ROUNDING: Final = 1e-9


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
            "waypoints": [_numbers(point, 2) for point in said["waypoints"][:MOST_POINTS]],
            "passed": _whole(said["passed"]),
        }  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, OverflowError) as error:
        raise BadMessage(f"what is published is robot, clock_s, pose, turret, cov, odometry, truth, echoes, "
                         f"waypoints, passed: {error!r}") from None
    return told


def _echo(said: Any) -> Message:
    refusal = said["refusal"]
    if refusal not in REFUSALS:
        raise ValueError(f"no refusal {refusal!r}")
    return {
        "sonar": _whole(said["sonar"], below=SONARS), "reading_in": _number(said["reading_in"]), "refusal": refusal,
        "innovation_in": _number(said["innovation_in"]), "nis": _number(said["nis"]),
    }  # fmt: skip


def _covariance(rows: Any) -> list[float]:
    cov = _numbers([n for row in rows for n in row], _COV)
    if min(cov[0], cov[4], cov[8]) < 0.0 or cov[0] * cov[4] < cov[1] * cov[3] * (1 - _ROUNDING):
        raise ValueError("cov is no covariance")
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


def _number(value: Any) -> float:
    number = float(value)
    if not -FARTHEST <= number <= FARTHEST:
        raise ValueError(f"no number from -{FARTHEST:g} to {FARTHEST:g}: {value!r}")
    return number
