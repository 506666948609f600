"""Messages between page and daemon over the websocket: JSON objects, one per message.

to the page, by `type`
    hello        version, name (of this viewer), may_act, watch_token (of a link that may only watch; null for viewers
                 that may only watch), waypoints (points by robot), lines (addresses by name; none for watchers)
    picture      the scene or its changes (scene.py)
    traffic      rows of requests and replies (traffic.py), missed: number of frames left out
    localization the latest published estimate (localization.py), and its age: age_s
    asked        robots: number of clients that wait for a click of a pose (get_robot_conf), by robot
    waypoints    robot, points: new way-points
    missed       count: other messages that were dropped since the viewer was too slow
    answer       id, ok, and the result: values, slots, or error; of drive, others: the other viewers that drive the
                 robot; of stop and release, held: {robot: {"by", "ignored"} ...} of all robots that are held

from the page, by `do`
    seen         frame: the picture that was drawn last
    watch        traffic, laser: whether it wants them; robot: the robot whose laser (left out: all)
    call         id, robot, call (C name), args (wire units): a client's call to that robot
    drive        id, robot, args: a vm that ends by itself unless the next comes within DRIVE_TIMEOUT_S
    stop         id, robot (left out: all): stop it, and refuse motions until it is released, from programs, other
                 viewers and this page (server/estop.py)
    release      id, robot (left out: all): allow motions again
    control      id, command, argument: time, faults, noise, world (control/commands.py)
    click        robot, pose: x, y, steer, turret in tenths
    waypoints    robot, points: [[x_in, y_in] ...] for its localizer

A message of any other form raises InvalidMessage, which names the correct form. A viewer that may only watch may send
seen and watch.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

VERSION: Final = 4
MAX_TEXT: Final = 2_000_000
"""Characters of a message from the page; a plan of faults is the longest."""
MAX_ARGS: Final = 64
MAX_POINTS: Final = 200
MAX_SHOWN: Final = 60
"""Characters of a wrong value that an error message shows."""
MAX_NUMBER: Final = 1e9
"""Largest absolute value of any number: inches, radians, seconds."""
MAX_DEPTH: Final = 3
"""Nesting of an argument: the corners of an obstacle."""
DRIVE_TIMEOUT_S: Final = 0.5
"""Real seconds without a repeated drive message after which the robot stops."""
CALLS: Final = frozenset({
    "st", "lp", "zr", "vm", "pr", "dp", "da", "conf_tm", "conf_sn", "place_robot", "add_obstacle", "delete_obstacle",
    "move_obstacle", "new_world", "refresh_all", "create_robot",
})  # fmt: skip
CONTROLS: Final = frozenset({
    "status", "pause", "resume", "speed", "step", "faults show", "faults set", "faults clear", "faults counts", "noise",
    "world show", "world set", "obstacle",
})  # fmt: skip
"""Control commands of the page: all but those that write files."""
WATCH_MESSAGES: Final = frozenset({"seen", "watch"})
_COMPACT: Final = json.JSONEncoder(separators=(",", ":"))
Message = dict[str, Any]


class InvalidMessage(ValueError):
    """A message of a wrong form; `number` is its id, if it has one."""

    def __init__(self, text: str, number: int | None = None) -> None:
        super().__init__(text)
        self.number = number


def parse_message(text: str) -> Message:
    """Parse and check a message from the page. Raises InvalidMessage."""
    if len(text) > MAX_TEXT:
        raise InvalidMessage(f"a message is at most {MAX_TEXT} characters")
    try:
        raw = json.loads(text)
    except (ValueError, RecursionError):
        raise InvalidMessage("a message is a JSON object") from None
    kind = raw.get("do") if isinstance(raw, dict) else None
    row = FIELDS.get(kind) if isinstance(kind, str) else None
    number = raw.get("id") if isinstance(raw, dict) and _is_id(raw.get("id")) else None
    if row is None:
        raise InvalidMessage(f"do is one of {', '.join(FIELDS)}, not {_short(kind)}", number)
    for name, (is_valid, expected) in row.items():
        if not is_valid(raw.get(name)):
            raise InvalidMessage(f"{kind}: {name} is {expected}, not {_short(raw.get(name))}", number)
    return {"do": kind} | {name: raw[name] for name in row if name in raw}


def encode_message(kind: str, **fields: Any) -> str:
    """Encode a message to the page."""
    return _COMPACT.encode({"type": kind} | fields)


def _short(value: object) -> str:
    shown = json.dumps(value)
    return shown if len(shown) <= MAX_SHOWN else f"{shown[:MAX_SHOWN]}..."


def _is_int(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -(2**31) <= value < 2**31


def _is_id(value: object) -> bool:
    return _is_int(value) and isinstance(value, int) and value >= 0


def _are_ints(value: object, count: int | None = None) -> bool:
    return (
        isinstance(value, list) and len(value) <= MAX_ARGS and all(map(_is_int, value))
        and (count is None or len(value) == count)
    )  # fmt: skip


def _are_points(value: object) -> bool:
    return isinstance(value, list) and len(value) <= MAX_POINTS and all(map(_is_point, value))


def _is_point(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(_is_number(number) for number in value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -MAX_NUMBER <= value <= MAX_NUMBER


def _is_argument(value: object) -> bool:
    return not isinstance(value, list | bool) and _is_plain(value, MAX_DEPTH)


def _is_plain(value: object, depth: int) -> bool:
    """Return True if a value is plain JSON with numbers in range and at most this nesting."""
    if isinstance(value, list | dict):
        items = value.values() if isinstance(value, dict) else value
        return depth > 0 and all(_is_plain(item, depth - 1) for item in items)
    return value is None or isinstance(value, str | bool) or _is_number(value)


Field = tuple[Callable[[object], bool], str]
_ID: Final[Field] = (_is_id, "a whole number of 0 or more")
_ROBOT_OR_ALL: Final[Field] = (
    lambda value: value is None or _is_id(value), "the number of a robot, or left out for every robot"
)
_FLAG: Final[Field] = (lambda value: isinstance(value, bool), "true or false")
_ARGS: Final[Field] = (_are_ints, f"a list of at most {MAX_ARGS} whole numbers of 32 bits")
FIELDS: Final[dict[str, dict[str, Field]]] = {
    "seen": {"frame": _ID},
    "watch": {"traffic": _FLAG, "laser": _FLAG, "robot": _ROBOT_OR_ALL},
    "call": {
        "id": _ID, "robot": _ID, "args": _ARGS,
        "call": (lambda value: isinstance(value, str) and value in CALLS, f"one of {', '.join(sorted(CALLS))}"),
    },
    "drive": {"id": _ID, "robot": _ID, "args": (lambda value: _are_ints(value, 3), "three whole numbers")},
    "stop": {"id": _ID, "robot": _ROBOT_OR_ALL},
    "release": {"id": _ID, "robot": _ROBOT_OR_ALL},
    "control": {
        "id": _ID, "argument": (_is_argument, "nothing, a number, a text or an object of such"),
        "command": (
            lambda value: isinstance(value, str) and value in CONTROLS, f"one of {', '.join(sorted(CONTROLS))}"
        ),
    },
    "click": {"robot": _ID, "pose": (lambda value: _are_ints(value, 4), "x, y, steer and turret in whole tenths")},
    "waypoints": {"robot": _ID, "points": (_are_points, f"a list of at most {MAX_POINTS} points [x, y] in inches")},
}  # fmt: skip
"""All messages from the page: for each field a check and a description of correct values."""
