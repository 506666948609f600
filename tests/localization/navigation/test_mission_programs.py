"""Missions as Python programs: how they run, and the error messages of invalid ones."""

from __future__ import annotations

from typing import Any

import pytest

from localization.navigation.mission import Mission, MissionOver, StepFailed
from localization.navigation.mission_steps import parse_program
from nclient.common.process import TerminatedBySignal
from nclient.errors import MissionFileError, RobotRefused


class CallRecorder:
    """Replace a Mission and record the calls of its verbs."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, verb: str) -> Any:
        return lambda *words, **more: self.calls.append((verb, words, more))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("def mission(robot)\n  pass", "m.py: line 1: is not valid Python: expected ':'"),
        ("x = 1\ny = x / 0\n", "m.py: line 2: ZeroDivisionError: division by zero"),
        ("def mision(robot): pass",
         "m.py: expected a function mission(robot), found none; see docs/missions.md"),
        ("settings = 3\ndef mission(robot): pass", "m.py: settings: expected Settings(...), found int"),
    ],
)  # fmt: skip
def test_invalid_program_is_reported_with_its_line(text: str, expected: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_program(text, "m.py")
    assert str(refused.value) == expected


def test_program_runs_and_exception_is_reported_with_line() -> None:
    # A recorder in place of the robot: the program's calls, without driving.
    robot: Any = CallRecorder()
    program = parse_program(
        "from localization.navigation.mission import Settings\nsettings = Settings(title='T')\n"
        "def mission(robot):\n    robot.go_to(1, 2)\n    {}['x']\n", "m.py",
    )  # fmt: skip
    assert program.settings.title == "T"
    # The line is that of the program, not of the loader.
    with pytest.raises(MissionFileError, match=r"^m\.py: line 5: KeyError: 'x'$"):
        program.run(robot)
    assert robot.calls == [("go_to", (1, 2), {})]


def test_robot_errors_pass_unchanged() -> None:
    # A refusal by the robot is no error of the program.
    def refuse(*_: object) -> None:
        raise RobotRefused("vm", 4)

    robot: Any = CallRecorder()
    robot.look = refuse
    with pytest.raises(RobotRefused):
        parse_program("def mission(robot): robot.look()", "m.py").run(robot)
    # A missing verb is one.
    broken: Any = object.__new__(Mission)
    with pytest.raises(MissionFileError, match=r"^m\.py: line 1: AttributeError"):
        parse_program("def mission(robot): robot.fly()", "m.py").run(broken)


EXIT = "expected mission(robot) to return, or to raise StepFailed"


@pytest.mark.parametrize("words", ["0", "5", ""])
def test_sys_exit_is_an_error_at_top_and_in_function(words: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_program(f"import sys\nsys.exit({words})\n", "m.py")
    assert str(refused.value) == f"m.py: line 2: calls sys.exit ({words}); {EXIT}"
    robot: Any = CallRecorder()
    program = parse_program(f"import sys\ndef mission(robot):\n    robot.look()\n    sys.exit({words})\n", "m.py")
    with pytest.raises(MissionFileError) as refused:
        program.run(robot)
    assert str(refused.value) == f"m.py: line 4: calls sys.exit ({words}); {EXIT}"


PLAIN = "m.py: line 1: expected a plain function mission(robot), found"
ONE = "m.py: line 1: expected a function mission(robot) of one argument, found"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("async def mission(robot): pass", f"{PLAIN} async def"),
        ("async def mission(robot): yield", f"{PLAIN} an asynchronous generator"),
        ("def mission(robot): yield", f"{PLAIN} a generator: it has a yield"),
        ("class Act:\n    async def __call__(self, robot): pass\nmission = Act()",
         "m.py: expected a plain function mission(robot), found async def"),
        ("def mission(): pass", f"{ONE} mission()"),
        ("def mission(robot, place): pass", f"{ONE} mission(robot, place)"),
        ("def mission(*, robot): pass", f"{ONE} mission(*, robot)"),
    ],
)  # fmt: skip
def test_wrong_kind_of_function_is_refused_at_load(text: str, expected: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_program(text, "m.py")
    assert str(refused.value) == expected


@pytest.mark.parametrize(
    "text",
    ["def mission(robot, speed=3, *, more=2): robot.look()", "def mission(*robots): robots[0].look()",
     "mission = lambda robot: robot.look()", "class mission:\n    def __init__(self, robot): robot.look()",
     "class Act:\n    def __call__(self, robot): robot.look()\nmission = Act()",
     "from operator import methodcaller\nmission = methodcaller('look')"],
)  # fmt: skip
def test_any_callable_with_one_argument_is_a_mission(text: str) -> None:
    robot: Any = CallRecorder()
    parse_program(text, "m.py").run(robot)
    assert [verb for verb, _, _ in robot.calls] == ["look"]


def test_unawaited_coroutine_is_an_error() -> None:
    robot: Any = CallRecorder()
    program = parse_program("async def go(robot): pass\nmission = lambda robot: go(robot)", "m.py")
    with pytest.raises(MissionFileError, match="found a coroutine"):
        program.run(robot)


@pytest.mark.parametrize("error", [TerminatedBySignal("SIGTERM"), KeyboardInterrupt(), MissionOver("lost", "x"),
                                   StepFailed("blocked", "x")])  # fmt: skip
def test_signals_and_end_of_mission_pass_unchanged(error: BaseException) -> None:
    def raise_it(*_: object) -> None:
        raise error

    robot: Any = CallRecorder()
    robot.look = raise_it
    with pytest.raises(type(error)) as raised:
        parse_program("def mission(robot): robot.look()", "m.py").run(robot)
    assert raised.value is error


def test_signal_during_load_passes_unchanged() -> None:
    with pytest.raises(TerminatedBySignal):
        parse_program("from nclient.common import process\nraise process.TerminatedBySignal('SIGTERM')", "m.py")


def test_refused_argument_is_reported_with_its_line() -> None:
    text = "from localization.navigation.mission import Settings\n\nsettings = Settings(time_limit_s='300')\n"
    with pytest.raises(MissionFileError) as refused:
        parse_program(text, "m.py")
    # The message has file, line, name of the setting, range and the value.
    expected = "m.py: line 3: Settings: time_limit_s: expected 0.1 to 86400, a number, found the text '300'"
    assert str(refused.value) == expected
    # Arguments of verbs are checked in the same way, before the robot moves.
    program = parse_program("def mission(robot):\n    robot.go_to('15', 5)\n", "m.py")
    with pytest.raises(MissionFileError) as refused:
        program.run(object.__new__(Mission))
    assert str(refused.value) == "m.py: line 2: go_to: x_in: expected a length, a number, found the text '15'"
