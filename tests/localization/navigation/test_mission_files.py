"""Missions from files: values read, and the error messages of invalid files."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from localization.navigation.mission import Seen
from localization.navigation.mission_steps import MAX_BYTES, load_mission, parse_step_list
from localization.navigation.pilot import OnLost, Settings
from nclient.errors import MissionFileError

SEEN = Seen(1.0, 0.0, 0.0, 0.0, 0.3, "OK", (20,) * 15 + (12,), True, (3,), 1)


class CallRecorder:
    """Replace a Mission and record the calls of its verbs."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, verb: str) -> Any:
        return lambda *words, **more: self.calls.append((verb, words, more))


def recorded_calls(text: str) -> list[tuple[str, tuple[Any, ...], dict[str, Any]]]:
    robot: Any = CallRecorder()
    parse_step_list(text, "m.toml").run(robot)
    calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = robot.calls
    return calls


def test_every_verb_is_called_with_values_of_its_step() -> None:
    calls = recorded_calls("""
        [[step]]
        do = "go_to"
        to_cm = [254, 127]
        heading_deg = 90
        within_in = 2
        time_limit_s = 30
        retries = 2
        [[step]]
        do = "follow"
        points_in = [[1, 2], [3, 4]]
        [[step]]
        do = "patrol"
        points_in = [[1, 2]]
        rounds = 3
        [[step]]
        do = "turn"
        by_deg = -45
        [[step]]
        do = "dock"
        to_m = [0.254, 0]
        heading_deg = 180
        [[step]]
        do = "look"
        [[step]]
        do = "look"
        for_s = 4
        [[step]]
        do = "note"
        words = "hello"
    """)
    # Defaults of verbs that are not given: no limit, no retries.
    limits = {"limit_s": inf, "retries": 0}
    assert calls[0][0] == "go_to"
    # Centimetres and metres are converted to inches.
    assert calls[0][1] == pytest.approx((100.0, 50.0, 90.0))
    assert calls[0][2] == {"limit_s": 30.0, "retries": 2, "within_in": 2.0}
    assert calls[1] == ("follow", (((1.0, 2.0), (3.0, 4.0)),), limits | {"within_in": 1.0})
    assert calls[2] == ("patrol", (((1.0, 2.0),), 3), limits)
    assert calls[3] == ("turn", (None,), limits | {"by_deg": pytest.approx(-45.0)})
    assert calls[4][0] == "dock"
    assert calls[4][1] == pytest.approx((10.0, 0.0, 180.0))
    assert calls[5:] == [("look", (1.0,), {}), ("look", (4.0,), {}), ("note", ("hello",), {})]


@pytest.mark.parametrize(
    ("key", "holds"),
    [("nearer_than_in = 13", True), ("nearer_than_in = 12", False), ("farther_than_in = 11", True),
     ("farther_than_in = 12", False), ("known_to_in = 0.3", True), ("known_to_in = 0.2", False),
     ("finds = 1", True), ("finds = 2", False), ("touching = true", True), ("touching = false", False)],
)  # fmt: skip
def test_wait_for_conditions(key: str, holds: bool) -> None:
    ((verb, (condition, limit_s, words), _),) = recorded_calls(f'[[step]]\ndo = "wait_for"\ntime_limit_s = 5\n{key}\n')
    assert (verb, limit_s) == ("wait_for", 5.0)
    assert condition(SEEN) is holds
    assert words.split(" = ")[0] == key.split(" = ")[0]


def test_settings_are_read_and_have_defaults() -> None:
    step = '[[step]]\ndo = "look"\n'
    assert parse_step_list(step, "m").settings == Settings()
    text = (
        'title = "T"\nmap = "w"\ntime_limit_s = 9\nfence_m = [[0, 0], [0, 2.54], [2.54, 0]]\n'
        'on_lost = "give_up"\nlost_s = 3\n'
    )
    read = parse_step_list(text + step, "m").settings
    np.testing.assert_allclose(read.fence_in, [(0.0, 0.0), (0.0, 100.0), (100.0, 0.0)])
    assert (read.title, read.map, read.time_limit_s, read.on_lost, read.lost_s) == ("T", "w", 9.0, OnLost.GIVE_UP, 3.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a = \n", "m.toml: is no TOML: Invalid value (at line 1, column 5)"),
        ("", "m.toml: step: expected at least one [[step]], found none"),
        ("step = 3", "m.toml: line 1: step: expected tables under [[step]], each with its double brackets, found 3"),
        ('tite = "x"', "m.toml: line 1: tite: unknown key; expected one of title, map, time_limit_s, on_lost, lost_s, "
                       "fence_in, fence_cm, fence_m, step; did you mean title?"),
        ('[[step]]\ndo = "go_too"\n', "m.toml: line 2: step[0].do: expected one of go_to, follow, turn, "
         "look, wait_for, patrol, dock, note, found 'go_too'; did you mean go_to?"),
        ('[[step]]\ndo = "look"\n\n[[step]]\n\ndo = "go_to"\nto_in = [1, "x"]\n',
         "m.toml: line 7: step[1].to_in[1]: expected a length, a number, found the text 'x'"),
        ('[[step]]\ndo = "go_to"\nto_in = [1, 2, 3]\n',
         "m.toml: line 3: step[0].to_in: expected a point [x, y], found the list [1, 2, 3]"),
        ('[[step]]\ndo = "go_to"\n', "m.toml: line 1: step[0].to_in: expected exactly one of to_in, to_cm, to_m, found "
                                     "none of them"),
        ('[[step]]\ndo = "turn"\n', "m.toml: line 1: step[0].heading_deg: expected exactly one of heading_deg, "
         "by_deg, found none of them"),
        ('[[step]]\ndo = "dock"\nto_in = [1, 2]\n',
         "m.toml: line 1: step[0].heading_deg: is missing: the heading to drive in, in degrees"),
        ('[[step]]\nwords = "hello"\n',
         "m.toml: line 1: step[0].do: is missing; expected one of go_to, follow, turn, "
         "look, wait_for, patrol, dock, note"),
        ('[[step]]\ndo = "patrol"\npoints_in = [[1, 2]]\nrounds = 0\n',
         "m.toml: line 4: step[0].rounds: expected a whole number from 1 to 10000, found 0"),
        ('[[step]]\ndo = "turn"\nby_deg = 3601\n',
         "m.toml: line 3: step[0].by_deg: expected -3600 to 3600, found 3601"),
        ('[[step]]\ndo = "note"\n', "m.toml: line 1: step[0].words: is missing: the text for the report"),
        ('[[step]]\ndo = "wait_for"\ntime_limit_s = 3\n', "m.toml: line 1: step[0].touching: expected exactly one of "
         "touching, nearer_than_in, farther_than_in, known_to_in, finds, found none of them"),
        ('[[step]]\ndo = "wait_for"\nfinds = 3\n',
         "m.toml: line 1: step[0].time_limit_s: is missing: the longest time to wait, in seconds"),
        ('[[step]]\ndo = "look"\nretries = 3\n',
         "m.toml: line 3: step[0].retries: unknown key; expected one of do, for_s"),
        ('[[step]]\ndo = "turn"\nby_deg = 3\nretries = -1\n',
         "m.toml: line 4: step[0].retries: expected a whole number from 0 to 100, found -1"),
        ('on_lost = "serch"\n[[step]]\ndo = "look"\n',
         "m.toml: line 1: on_lost: expected one of stop, search, give_up, found 'serch'; did you mean search?"),
        ('lost_s = 0\n[[step]]\ndo = "look"\n', "m.toml: line 1: lost_s: expected 0.1 to 86400, found 0"),
        ('fence_in = [[1, 2]]\n[[step]]\ndo = "look"\n',
         "m.toml: line 1: fence_in: expected at least 3 points, found 1"),
        ('fence_m = [[0, 0], [1, 1], [2, 2]]\n[[step]]\ndo = "look"\n',
         "m.toml: line 1: fence_m: expected an outline around some area, found corners on one line"),
        ('\nfence_in = [[0, 0], [9, 9], [9, 0], [0, 9]]\n[[step]]\ndo = "look"\n', "m.toml: line 2: fence_in: expected "
         "the corners in their order around, found edges 0 and 2 that cross"),
        ('# rounds\n\n[[stp]]\ndo = "look"\n', "m.toml: stp: unknown key; expected one of title, map, time_limit_s, "
         "on_lost, lost_s, fence_in, fence_cm, fence_m, step; did you mean step?"),
    ],
)  # fmt: skip
def test_invalid_step_list_is_reported_with_its_line(text: str, expected: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_step_list(text, "m.toml")
    assert str(refused.value) == expected


def test_files_are_read_by_their_ending(tmp_path: Path) -> None:
    listed, program = tmp_path / "m.toml", tmp_path / "m.py"
    listed.write_text('title = "L"\n[[step]]\ndo = "look"\n')
    program.write_text("def mission(robot): pass\n")
    assert load_mission(listed).settings.title == "L"
    assert load_mission(str(program)).settings == Settings()


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("m.txt", b"", r"expected a mission as .toml or .py, found '.txt'"),
        ("m", b"", r"found 'no suffix'"),
        ("m.toml", None, "cannot be read: No such file or directory"),
        ("m.toml", b"\xff\xfe", "expected text in UTF-8, found other bytes at 0"),
        ("m.toml", b"#" * (MAX_BYTES + 1), "is longer than"),
    ],
)
def test_files_that_cannot_be_read(tmp_path: Path, name: str, content: bytes | None, expected: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(MissionFileError, match=expected):
        load_mission(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("m.toml", '# x\nmap = "several_wals"\n[[step]]\ndo = "look"\n', "line 2: map: several_wals: no such file"),
        ("m.py", "from localization.navigation.mission import Settings\nsettings = Settings(map='several_wals')\n"
         "def mission(robot): pass\n", "settings: map: several_wals: no such file"),
    ],
)  # fmt: skip
def test_missing_map_is_reported_with_file_and_key(tmp_path: Path, name: str, text: str, expected: str) -> None:
    file = tmp_path / name
    file.write_text(text)
    orders = load_mission(file)
    with pytest.raises(MissionFileError, match="mean several_walls") as refused:
        orders.check_map()
    assert str(refused.value).startswith(f"{file}: {expected}")
    file.write_text(text.replace("several_wals", "several_walls"))
    load_mission(file).check_map()
