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
import math
from typing import Any, Final

from nserver_emu.viewer.protocol import MOST_POINTS, BadMessage, Message

REFUSALS: Final = ("none", "limit", "no_wall", "ambiguous_wall", "grazing", "gate")
MOST_ECHOES: Final = 64
_POSE, _COV = 3, 9


def published(text: str) -> Message:
    """The message in a text, checked."""
    try:
        said = json.loads(text)
        told = {
            "robot": int(said["robot"]), "clock_s": _number(said["clock_s"]), "pose": _numbers(said["pose"], _POSE),
            "turret": _number(said["turret"]), "cov": _numbers([n for row in said["cov"] for n in row], _COV),
            "odometry": _numbers(said["odometry"], _POSE),
            "truth": None if said["truth"] is None else _numbers(said["truth"], _POSE),
            "echoes": [_echo(echo) for echo in said["echoes"][:MOST_ECHOES]],
            "waypoints": [_numbers(point, 2) for point in said["waypoints"][:MOST_POINTS]],
            "passed": int(said["passed"]),
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
        "sonar": int(said["sonar"]), "reading_in": _number(said["reading_in"]), "refusal": refusal,
        "innovation_in": _number(said["innovation_in"]), "nis": _number(said["nis"]),
    }  # fmt: skip


def _numbers(values: Any, count: int) -> list[float]:
    numbers = [_number(value) for value in values]
    if len(numbers) != count:
        raise ValueError(f"{count} numbers, not {len(numbers)}")
    return numbers


def _number(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"not a number: {value!r}")
    return number
