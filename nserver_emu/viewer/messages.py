"""What page and daemon say to each other over the websocket: JSON objects, one a message. Pure.

to the page, by `type`
    hello        version, name (of this viewer), may_act, watch_token (of a link that only looks; None for who only
                 looks), waypoints (points by robot), lines (where each is reached, by name; none for who only looks)
    picture      picture.py
    traffic      rows of what clients said and were answered (traffic.py), missed: how many were left out
    localization what a localizer published last (localization.py), and how long ago: age_s
    asked        robots: at which robots clients wait for a click of a pose (get_robot_conf), and how many
    waypoints    robot, points: somebody set them
    missed       count: of other news, left out since the viewer was too slow
    answer       id, ok, and what was said: values, slots, or error; of a drive, others: who else drives the robot; of
                 stop and release, held: {robot: {"by", "ignored"} ...} of all that are held then

from the page, by `do`
    seen         frame: the picture that was drawn last
    watch        traffic, laser: whether it wants them; robot: whose laser (left out: every robot's)
    call         id, robot, call (C name), args (wire units): what a client of that robot could say
    drive        id, robot, args: a vm that ends by itself when the next does not come within DEAD_MAN_S
    stop         id, robot (left out: every robot): it stands, and nobody moves it until it is released, programs, other
                 viewers and the page itself (server/ownership.py)
    release      id, robot (left out: every robot): it may be moved again, and is as soon as a program says so
    control      id, command, argument: time, faults, noise, world (control.py)
    click        robot, pose: x, y, steer, turret in tenths
    waypoints    robot, points: [[x_in, y_in] ...] for who localizes it

Rules: whatever is not as here raises BadMessage, which says what would be right, and to which id. A viewer that only
looks may say seen and watch.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

VERSION: Final = 4
MOST_TEXT: Final = 2_000_000
"""Characters of a message from the page; a plan of faults is the longest."""
MOST_ARGS: Final = 64
MAX_POINTS: Final = 200
MAX_EXPORTED_WORLDS: Final = 60
"""Characters that a complaint repeats."""
FARTHEST: Final = 1e9
"""No number is farther from 0: inches, radians, seconds, and what is made of them."""
DEEPEST: Final = 3
"""Brackets in brackets in an argument: the corners of an obstacle."""
DEAD_MAN_S: Final = 0.5
"""Real seconds without a word from whoever drives by hand, after which the robot stops."""
CALLS: Final = frozenset({
    "st", "lp", "zr", "vm", "pr", "dp", "da", "conf_tm", "conf_sn", "place_robot", "add_obstacle", "delete_obstacle",
    "move_obstacle", "new_world", "refresh_all", "create_robot",
})  # fmt: skip
CONTROLS: Final = frozenset({
    "status", "pause", "resume", "speed", "step", "faults show", "faults set", "faults clear", "faults counts", "noise",
    "world show", "world set", "obstacle",
})  # fmt: skip
"""What the owner may do at the page: all of control.py but what writes files."""
LOOKING: Final = frozenset({"seen", "watch"})
_COMPACT: Final = json.JSONEncoder(separators=(",", ":"))
Message = dict[str, Any]


class BadMessage(ValueError):
    """A message that is none of those above; `number`: the id it gave itself, if it did."""

    def __init__(self, text: str, number: int | None = None) -> None:
        super().__init__(text)
        self.number = number


def from_page(text: str) -> Message:
    """The message in a text, checked. Raises BadMessage."""
    if len(text) > MOST_TEXT:
        raise BadMessage(f"a message is at most {MOST_TEXT} characters")
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        raise BadMessage("a message is a JSON object") from None
    kind = said.get("do") if isinstance(said, dict) else None
    row = FIELDS.get(kind) if isinstance(kind, str) else None
    number = said.get("id") if isinstance(said, dict) and _is_id(said.get("id")) else None
    if row is None:
        raise BadMessage(f"do is one of {', '.join(FIELDS)}, not {_short(kind)}", number)
    for name, (right, wanted) in row.items():
        if not right(said.get(name)):
            raise BadMessage(f"{kind}: {name} is {wanted}, not {_short(said.get(name))}", number)
    return {"do": kind} | {name: said[name] for name in row if name in said}


def to_page(kind: str, **fields: Any) -> str:
    """A message to the page."""
    return _COMPACT.encode({"type": kind} | fields)


def _short(value: object) -> str:
    shown = json.dumps(value)
    return shown if len(shown) <= MAX_EXPORTED_WORLDS else f"{shown[:MAX_EXPORTED_WORLDS]}..."


def _is_int(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -(2**31) <= value < 2**31


def _is_id(value: object) -> bool:
    return _is_int(value) and isinstance(value, int) and value >= 0


def _are_ints(value: object, count: int | None = None) -> bool:
    return (
        isinstance(value, list) and len(value) <= MOST_ARGS and all(map(_is_int, value))
        and (count is None or len(value) == count)
    )  # fmt: skip


def _are_points(value: object) -> bool:
    return isinstance(value, list) and len(value) <= MAX_POINTS and all(map(_is_point, value))


def _is_point(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(_is_number(number) for number in value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -FARTHEST <= value <= FARTHEST


def _is_argument(value: object) -> bool:
    return not isinstance(value, list | bool) and _is_plain(value, DEEPEST)


def _is_plain(value: object, deep: int) -> bool:
    """Whether no number in it is too far, and it is nested no deeper than that."""
    if isinstance(value, list | dict):
        held = value.values() if isinstance(value, dict) else value
        return deep > 0 and all(_is_plain(each, deep - 1) for each in held)
    return value is None or isinstance(value, str | bool) or _is_number(value)


Field = tuple[Callable[[object], bool], str]
_ID: Final[Field] = (_is_id, "a whole number of 0 or more")
_ROBOT_OR_ALL: Final[Field] = (
    lambda value: value is None or _is_id(value), "the number of a robot, or left out for every robot"
)
_FLAG: Final[Field] = (lambda value: isinstance(value, bool), "true or false")
_ARGS: Final[Field] = (_are_ints, f"a list of at most {MOST_ARGS} whole numbers of 32 bits")
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
"""Every message from the page: its fields, whether a value is right, and what would be."""
