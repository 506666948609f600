"""Missions that are programs: what is run, and what is stated of those that are wrong."""

from __future__ import annotations

from typing import Any

import pytest

from localization.missions.mission import Mission
from localization.missions.report import MissionOver, StepFailed
from localization.missions.steps import parse_program
from nclient.common.process import TerminatedBySignal
from nclient.errors import MissionFileError, RobotRefused


class Told:
    """In place of a Mission: writes down what it is reported."""

    def __init__(self) -> None:
        self.said: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, verb: str) -> Any:
        return lambda *words, **more: self.said.append((verb, words, more))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def mission(robot)\n  pass", "m.py: line 1: is not valid Python: expected ':'"),
        ("x = 1\ny = x / 0\n", "m.py: line 2: ZeroDivisionError: division by zero"),
        ("def mision(robot): pass",
         "m.py: expected a function mission(robot), found none; see docs/missions.md"),
        ("settings = 3\ndef mission(robot): pass", "m.py: settings: expected Settings(...), found int"),
    ],
)  # fmt: skip
def test_a_program_that_is_wrong_is_reported_with_its_line(text: str, said: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_program(text, "m.py")
    assert str(refused.value) == said


def test_a_program_runs_and_what_it_raises_is_reported_with_its_line() -> None:
    robot: Any = Told()
    program = parse_program(
        "from localization.missions import Settings\nsettings = Settings(title='T')\n"
        "def mission(robot):\n    robot.go_to(1, 2)\n    {}['x']\n", "m.py",
    )  # fmt: skip
    assert program.settings.title == "T"
    with pytest.raises(MissionFileError, match=r"^m\.py: line 5: KeyError: 'x'$"):
        program.run(robot)
    assert robot.said == [("go_to", (1, 2), {})]


def test_errors_of_the_robot_stay_what_they_are() -> None:
    def refuse(*_: object) -> None:
        raise RobotRefused("vm", 4)

    robot: Any = Told()
    robot.look = refuse
    with pytest.raises(RobotRefused):
        parse_program("def mission(robot): robot.look()", "m.py").run(robot)
    broken: Any = object.__new__(Mission)
    with pytest.raises(MissionFileError, match=r"^m\.py: line 1: AttributeError"):
        parse_program("def mission(robot): robot.fly()", "m.py").run(broken)


EXIT = "expected mission(robot) to return, or to raise StepFailed"


@pytest.mark.parametrize("words", ["0", "5", ""])
def test_a_program_that_exits_is_wrong_at_its_top_and_in_its_function(words: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_program(f"import sys\nsys.exit({words})\n", "m.py")
    assert str(refused.value) == f"m.py: line 2: calls sys.exit ({words}); {EXIT}"
    robot: Any = Told()
    program = parse_program(f"import sys\ndef mission(robot):\n    robot.look()\n    sys.exit({words})\n", "m.py")
    with pytest.raises(MissionFileError) as refused:
        program.run(robot)
    assert str(refused.value) == f"m.py: line 4: calls sys.exit ({words}); {EXIT}"


PLAIN = "m.py: line 1: expected a plain function mission(robot), found"
ONE = "m.py: line 1: expected a function mission(robot) of one argument, found"


@pytest.mark.parametrize(
    ("text", "said"),
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
def test_what_would_not_be_run_or_cannot_be_called_is_refused_before_it_is(text: str, said: str) -> None:
    with pytest.raises(MissionFileError) as refused:
        parse_program(text, "m.py")
    assert str(refused.value) == said


@pytest.mark.parametrize(
    "text",
    ["def mission(robot, speed=3, *, more=2): robot.look()", "def mission(*robots): robots[0].look()",
     "mission = lambda robot: robot.look()", "class mission:\n    def __init__(self, robot): robot.look()",
     "class Act:\n    def __call__(self, robot): robot.look()\nmission = Act()",
     "from operator import methodcaller\nmission = methodcaller('look')"],
)  # fmt: skip
def test_whatever_takes_one_robot_is_a_mission(text: str) -> None:
    robot: Any = Told()
    parse_program(text, "m.py").run(robot)
    assert [verb for verb, _, _ in robot.said] == ["look"]


def test_a_coroutine_that_nothing_waits_for_is_no_mission_done() -> None:
    robot: Any = Told()
    program = parse_program("async def go(robot): pass\nmission = lambda robot: go(robot)", "m.py")
    with pytest.raises(MissionFileError, match="to be done when it returns, found a coroutine"):
        program.run(robot)


@pytest.mark.parametrize("error", [TerminatedBySignal("SIGTERM"), KeyboardInterrupt(), MissionOver("lost", "x"),
                                   StepFailed("blocked", "x")])  # fmt: skip
def test_signals_and_the_end_of_the_mission_are_no_mistake_of_a_program(error: BaseException) -> None:
    def raise_it(*_: object) -> None:
        raise error

    robot: Any = Told()
    robot.look = raise_it
    with pytest.raises(type(error)) as raised:
        parse_program("def mission(robot): robot.look()", "m.py").run(robot)
    assert raised.value is error


def test_a_signal_while_a_program_is_read_is_no_mistake_of_it() -> None:
    with pytest.raises(TerminatedBySignal):
        parse_program("from nclient.common import process\nraise process.TerminatedBySignal('SIGTERM')", "m.py")


def test_what_a_verb_or_settings_refuse_is_reported_with_the_line_that_states_it() -> None:
    text = "from localization.missions import Settings\n\nsettings = Settings(time_limit_s='300')\n"
    with pytest.raises(MissionFileError) as refused:
        parse_program(text, "m.py")
    said = "m.py: line 3: Settings: time_limit_s: expected 0.1 to 86400, a number, found the text '300'"
    assert str(refused.value) == said
    program = parse_program("def mission(robot):\n    robot.go_to('15', 5)\n", "m.py")
    with pytest.raises(MissionFileError) as refused:
        program.run(object.__new__(Mission))
    assert str(refused.value) == "m.py: line 2: go_to: x_in: expected a length, a number, found the text '15'"
