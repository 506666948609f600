"""Adjustment of the world to taped lengths for a page: the program that does it, and what it may answer."""

from __future__ import annotations

import sys

import pytest

from nserver_emu.viewer.controller import adjust_world
from nserver_emu.viewer.messages import Adjust, InvalidMessage, Tape, parse_message
from worlds.io import format_world, load_world

ROOM = format_world(load_world("thesis_room"))
TAPE = Tape([[-12.0, -12.0], [102.2, -12.0]], 100.0)


@pytest.mark.parametrize(
    ("script", "words"),
    [("echo hello; exit 3", "ended with 3"), ("echo 'nomad: no such wall' >&2; exit 1", "no such wall")],
)
def test_errors_of_the_program_are_answers(script: str, words: str) -> None:
    answer = adjust_world(ROOM, [TAPE], ("sh", "-c", script, "nomad"))
    assert answer == {"ok": False, "error": words}


def test_missing_program_is_an_answer() -> None:
    assert "nowhere" in adjust_world(ROOM, [TAPE], ("/nowhere/nomad",))["error"]


def test_program_gets_the_world_and_the_lengths() -> None:
    script = (
        "import json, sys, shutil; shutil.copy(sys.argv[3], sys.argv[5]);"
        "assert open(sys.argv[3]).read().startswith('name = '); print(json.dumps({'moved_in': len(sys.argv)}))"
    )
    answer = adjust_world(ROOM, [TAPE, TAPE], (sys.executable, "-c", script))
    assert (answer["ok"], answer["moved_in"], answer["text"][:7]) == (True, 17, "name = ")


def test_adjust_messages_are_checked() -> None:
    text = '{"do": "adjust", "id": 1, "lengths": [{"ends": [[0, 0], [9, 0]], "length": %s}]}'
    message = parse_message(text % "9.5")
    assert isinstance(message, Adjust)
    assert (message.lengths[0].length, message.lengths[0].std) == (9.5, 0.1)
    for wrong in ("0", "1e9", '"x"'):
        with pytest.raises(InvalidMessage, match="length"):
            parse_message(text % wrong)
