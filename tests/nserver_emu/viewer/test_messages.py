"""Messages from the page, one by one, and the error for each wrong form."""

from __future__ import annotations

import json
from typing import Any, get_args

import msgspec
import pytest

from nserver_emu.viewer.messages import (
    MAX_ARGS,
    MAX_POINTS,
    MAX_TEXT,
    InvalidMessage,
    Message,
    encode_message,
    parse_message,
)

GOOD: list[dict[str, Any]] = [
    {"do": "seen", "frame": 3},
    {"do": "watch", "traffic": True, "laser": False},
    {"do": "watch", "traffic": False, "laser": True, "robot": 2},
    {"do": "call", "id": 1, "robot": 1, "call": "place_robot", "args": [1, -2, 3, 4]},
    {"do": "drive", "id": 2, "robot": 1, "args": [100, 0, 0]},
    {"do": "stop", "id": 3},
    {"do": "stop", "id": 3, "robot": 2},
    {"do": "release", "id": 4},
    {"do": "reset", "id": 4},
    {"do": "reset", "id": 4, "robot": 2},
    {"do": "control", "id": 3, "command": "pause"},
    {"do": "control", "id": 3, "command": "speed", "argument": 2.5},
    {"do": "control", "id": 3, "command": "faults set", "argument": {"text": "", "file": "x"}},
    {"do": "control", "id": 3, "command": "obstacle", "argument": {"by": None, "to": [[1, 2.5], [3, 4]]}},
    {"do": "click", "robot": 1, "pose": [1, 2, 3, 4]},
    {"do": "waypoints", "robot": 1, "points": [[1, 2.5], [3, 4]]},
    {"do": "localize", "id": 5, "robot": 1, "method": "finder", "is_lost": True},
    {"do": "localize", "id": 5, "robot": 1, "method": "ekf", "is_lost": False, "resumes": True},
    {"do": "unlocalize", "id": 6, "robot": 1},
    {"do": "gallery", "id": 8},
    {"do": "adjust", "id": 9, "lengths": [{"ends": [[0, 0], [9, 0]], "length": 9.5, "std": 0.2}]},
    {"do": "kidnap", "id": 7, "robot": 1, "pose": [1, 2, 3, 4]},
]
BAD: list[tuple[Any, str]] = [
    ([], "a JSON object"),
    ({"do": "format"}, "do: expected one of seen, watch, call"),
    ({"do": ["seen"]}, "do: expected one of seen, watch, call"),
    ({"do": "seen"}, "frame: is missing"),
    ({"do": "seen", "frame": -1}, "frame: expected a whole number"),
    ({"do": "seen", "frame": True}, "frame: expected a whole number"),
    ({"do": "seen", "frame": 2**31}, "frame: expected a whole number"),
    ({"do": "watch", "traffic": 1, "laser": False}, "traffic: expected true or false"),
    ({"do": "call", "id": 1, "robot": 1, "call": "quit_server", "args": []}, "call: expected one of add_obstacle"),
    ({"do": "call", "id": 1, "robot": 1, "call": "vm", "args": [1.5]}, r"args\[0\]: expected a whole number"),
    ({"do": "call", "id": 1, "robot": 1, "call": "vm", "args": [0] * (MAX_ARGS + 1)}, "args: expected at most 64"),
    ({"do": "drive", "id": 1, "robot": 1, "args": [1, 2]}, "three whole numbers"),
    ({"do": "stop", "id": 1, "robot": "all"}, "the number of a robot, or left out"),
    ({"do": "control", "id": 1, "command": "save", "argument": "/etc/passwd"}, "command: expected one of door, faults"),
    ({"do": "control", "id": 1, "command": "speed", "argument": [1]}, "argument: expected nothing"),
    ({"do": "click", "robot": 1, "pose": [1, 2, 3]}, "pose: expected x, y"),
    ({"do": "waypoints", "robot": 1, "points": [[1, 2, 3]]}, r"points\[0\]: expected a point"),
    ({"do": "waypoints", "robot": 1, "points": [[0, 0]] * (MAX_POINTS + 1)}, "points: expected at most 200"),
    ({"do": "waypoints", "robot": 1, "points": [[0, float("inf")]]}, r"points\[0\]\[1\]: expected .* finite"),
    ({"do": "waypoints", "robot": 1, "points": [[10**400, 0]]}, r"points\[0\]\[0\]: expected .* finite"),
    ({"do": "control", "id": 1, "command": "speed", "argument": 10**400}, "argument: expected nothing, a number"),
    ({"do": "control", "id": 1, "command": "obstacle", "argument": {"to": [[0, float("inf")]]}}, "an object of such"),
    ({"do": "control", "id": 1, "command": "obstacle", "argument": {"to": [[[0]]]}}, "an object of such"),
    ({"do": "control", "id": 1, "command": "noise", "argument": True}, "argument: expected nothing"),
]


@pytest.mark.parametrize("message", GOOD, ids=lambda message: str(message["do"]))
def test_what_is_right_comes_through_as_it_is(message: dict[str, Any]) -> None:
    assert msgspec.to_builtins(parse_message(json.dumps(message | {"more": "is left out"}))) == message


def test_every_message_has_an_example() -> None:
    assert {message["do"] for message in GOOD} == {kind.__struct_config__.tag for kind in get_args(Message)}


@pytest.mark.parametrize(("message", "words"), BAD)
def test_an_error_names_the_correct_form(message: object, words: str) -> None:
    with pytest.raises(InvalidMessage, match=words):
        parse_message(json.dumps(message))


def test_a_wrong_message_is_answered_by_id_and_abbreviated() -> None:
    with pytest.raises(InvalidMessage) as refusal:
        parse_message(json.dumps({"do": "call", "id": 7, "robot": 1, "call": "vm", "args": list(range(5000))}))
    assert refusal.value.number == 7
    assert len(str(refusal.value)) < 200
    for number in (None, -1, "7", 10**400):
        with pytest.raises(InvalidMessage) as refusal:
            parse_message(json.dumps({"do": "dance", "id": number}))
        assert refusal.value.number is None


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "x" * (MAX_TEXT + 1)])
def test_no_text_is_more_than_a_refusal(text: str) -> None:
    with pytest.raises(InvalidMessage):
        parse_message(text)


def test_a_message_to_the_page_is_one_object() -> None:
    assert json.loads(encode_message("hello", version=1)) == {"type": "hello", "version": 1}
