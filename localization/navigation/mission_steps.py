"""Missions from files: lists of steps in TOML, and programs in Python.

    title = "Rounds"              all settings are optional (`Settings`)
    map = "several_walls"
    time_limit_s = 600
    fence_in = [[-10, -10], [100, -10], [100, 100], [-10, 100]]      or _cm, _m
    on_lost = "search"            stop, search, give_up
    lost_s = 60
    [[step]]                      one or more:
    do = "go_to"                  to_in, heading_deg, within_in
    do = "follow"                 points_in, within_in
    do = "patrol"                 points_in, rounds
    do = "dock"                   to_in, heading_deg
    do = "turn"                   heading_deg or by_deg
    do = "look"                   for_s
    do = "wait_for"               one condition (CONDITIONS), time_limit_s
    do = "note"                   words

Each step that moves also has time_limit_s and retries. A program has a plain function `mission(robot)`, which is done
when it returns, and optionally `settings = Settings(...)`.

All errors are MissionFileError: file, line or key, what was expected. TOML is read completely before anything moves.
An error of a program, including sys.exit (whose exit code 0 would look like success), has its file and line; errors of
the robot, the end of the mission, Ctrl-C and signals pass unchanged.
"""

import inspect
import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from math import inf
from os import PathLike, fspath
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final

from msgspec import UNSET, Meta, UnsetType

from localization.navigation import pilot
from localization.navigation.mission import Condition, Mission
from nclient.common.files import parse_toml, read_text
from nclient.common.process import TerminatedBySignal
from nclient.common.validation import InvalidValue, Text, convert
from nclient.errors import MissionFileError, NomadError, WorldFileError
from worlds.io import load_world
from worlds.schema import MAX_COORDINATE_IN, Angle, Outline, PointInUnits, Points, Table, require_outline, table

CONDITIONS: Final[Mapping[str, Callable[[float], Condition]]] = MappingProxyType({
    "nearer_than_in": lambda value: lambda seen: seen.nearest_in < value,
    "farther_than_in": lambda value: lambda seen: seen.nearest_in > value,
    "known_to_in": lambda value: lambda seen: seen.std_in <= value,
    "finds": lambda value: lambda seen: seen.finds >= value,
})
"""Conditions of `wait_for` by key: shortest reading of the ring below or above a value, standard deviation of the
position, number of obstacles that are not in the map. `touching = true` is one more."""
Threshold = Annotated[float, Meta(ge=0.0, le=MAX_COORDINATE_IN)]
Heading = Annotated[Angle, Meta(description="the heading at the end, in degrees")]


class _Motion(Table):
    """Keys of all steps that move."""

    time_limit_s: (
        Annotated[pilot.TimeLimit, Meta(description="the longest time of the step, in seconds")] | UnsetType
    ) = UNSET
    retries: pilot.Retries = 0

    def limits(self) -> dict[str, Any]:
        return {"limit_s": inf if self.time_limit_s is UNSET else self.time_limit_s, "retries": self.retries}


@table(do="go_to")
class _GoTo(_Motion):
    """Drive to a point by the shortest path."""

    to: PointInUnits
    heading_deg: Heading | UnsetType = UNSET
    within_in: pilot.Within = 1.0

    def act(self, robot: Mission) -> None:
        robot.go_to(*self.to, _or_none(self.heading_deg), within_in=self.within_in, **self.limits())


@table(do="follow")
class _Follow(_Motion):
    """Drive along straight lines between points."""

    points: Points
    within_in: pilot.Within = 1.0

    def act(self, robot: Mission) -> None:
        robot.follow(self.points, within_in=self.within_in, **self.limits())


@table(("heading_deg", "by_deg"), do="turn")
class _Turn(_Motion):
    """Turn in place."""

    heading_deg: Heading | UnsetType = UNSET
    by_deg: pilot.TurnAngle | UnsetType = UNSET

    def act(self, robot: Mission) -> None:
        robot.turn(_or_none(self.heading_deg), by_deg=_or_none(self.by_deg), **self.limits())


@table(do="look")
class _Look(Table):
    """Stand and measure."""

    for_s: Annotated[pilot.Seconds, Meta(description="time to stand and measure, seconds")] = 1.0

    def act(self, robot: Mission) -> None:
        robot.look(self.for_s)


@table(("touching", *CONDITIONS), do="wait_for")
class _WaitFor(Table):
    """Stand until a condition holds."""

    time_limit_s: Annotated[pilot.TimeLimit, Meta(description="the longest time to wait, in seconds")]
    touching: Annotated[bool, Meta(description="true: until a bumper touches")] | UnsetType = UNSET
    nearer_than_in: Annotated[Threshold, Meta(description="until a sonar reads less, in inches")] | UnsetType = UNSET
    farther_than_in: Annotated[Threshold, Meta(description="until all sonars read more, in inches")] | UnsetType = UNSET
    known_to_in: (
        Annotated[Threshold, Meta(description="until the position is so certain: std in inches")] | UnsetType
    ) = UNSET
    finds: Annotated[Threshold, Meta(description="until so many unmapped obstacles are confirmed")] | UnsetType = UNSET

    def act(self, robot: Mission) -> None:
        if self.touching is not UNSET:
            wanted = self.touching
            robot.wait_for(lambda seen: seen.touching is wanted, self.time_limit_s, f"touching = {wanted}")
            return
        key, value = next((key, getattr(self, key)) for key in CONDITIONS if getattr(self, key) is not UNSET)
        robot.wait_for(CONDITIONS[key](value), self.time_limit_s, f"{key} = {value:g}")


@table(do="patrol")
class _Patrol(_Motion):
    """Drive from point to point, for some rounds."""

    points: Points
    rounds: pilot.Rounds = 1

    def act(self, robot: Mission) -> None:
        robot.patrol(self.points, self.rounds, **self.limits())


@table(do="dock")
class _Dock(_Motion):
    """Drive slowly to a dock, until there or in contact."""

    to: PointInUnits
    heading_deg: Annotated[Angle, Meta(description="the heading to drive in, in degrees")]

    def act(self, robot: Mission) -> None:
        robot.dock(*self.to, self.heading_deg, **self.limits())


@table(do="note")
class _Note(Table):
    """Write a text into the report."""

    words: Annotated[Text, Meta(description="the text for the report")]

    def act(self, robot: Mission) -> None:
        robot.note(self.words)


Step = _GoTo | _Follow | _Turn | _Look | _WaitFor | _Patrol | _Dock | _Note


@table(condition={"required": ["step"], "properties": {"step": {"minItems": 1}}})
class MissionFile(Table):
    """A mission as a list of steps."""

    title: Annotated[Text, Meta(description="title of the report")] = ""
    map: Annotated[Text, Meta(description="walls: a shipped world or a TOML file")] = ""
    time_limit_s: Annotated[pilot.TimeLimit, Meta(description="limit of all steps, seconds")] = pilot.TIME_LIMIT_S
    on_lost: Annotated[pilot.LostPolicy, Meta(description="behaviour when the estimate is LOST")] = pilot.OnLost.STOP
    lost_s: Annotated[pilot.TimeLimit, Meta(description="for how long, seconds")] = 60.0
    fence: Outline | UnsetType = UNSET
    step: Annotated[tuple[Step, ...], Meta(description="the steps, in order")] = ()

    def check(self) -> None:
        """Raise InvalidValue unless there is a step, and the fence is an outline."""
        if self.fence is not UNSET:
            require_outline(self.key_of("fence"), self.fence)
        if not self.step:
            raise InvalidValue("expected at least one [[step]], found none", "step")


def _or_none(value: float | UnsetType) -> float | None:
    return None if value is UNSET else value


@dataclass(frozen=True, slots=True)
class MissionSpec:
    """A mission read from a file: settings, action, and the place of its map in the file for error messages."""

    settings: pilot.Settings
    run: Callable[[Mission], object]
    map_place: str

    def check_map(self) -> None:
        """Check that the map it names, if any, can be read. Raises MissionFileError."""
        try:
            if self.settings.map:
                load_world(self.settings.map)
        except WorldFileError as error:
            raise MissionFileError(f"{self.map_place}: {error}") from error


def parse_program(text: str, file: str) -> MissionSpec:
    """Return the mission of a Python program; `file` is its name in errors. Raises MissionFileError."""
    names: dict[str, Any] = {"__name__": "mission", "__file__": file}
    try:
        # 1. Run the module: definitions, and whatever else it contains.
        exec(compile(text, file, "exec"), names)
    except SyntaxError as error:
        raise MissionFileError(f"{file}: line {error.lineno}: is not valid Python: {error.msg}") from error
    except TerminatedBySignal:
        raise
    except (Exception, SystemExit) as error:
        raise MissionFileError(_with_program_line(error, file)) from error
    # 2. Its function and its settings.
    act, settings = names.get("mission"), names.get("settings", pilot.Settings())
    if not callable(act):
        raise MissionFileError(f"{file}: expected a function mission(robot), found none; see docs/missions.md")
    _require_plain(act, file)
    if not isinstance(settings, pilot.Settings):
        raise MissionFileError(f"{file}: settings: expected Settings(...), found {type(settings).__name__}")

    def run(robot: Mission) -> None:
        try:
            result = act(robot)
            # Nothing of a coroutine that is returned without awaiting it was done.
            if inspect.iscoroutine(result):
                result.close()
                expected = "expected mission(robot) to be done when it returns"
                raise MissionFileError(f"{file}: {expected}, found a coroutine")
        except MissionFileError as error:
            raise MissionFileError(_with_program_line(error, file)) from error
        except (NomadError, TerminatedBySignal):
            raise
        except (Exception, SystemExit) as error:
            raise MissionFileError(_with_program_line(error, file)) from error

    return MissionSpec(settings, run, f"{file}: settings: map")


def _require_plain(act: Callable[..., object], file: str) -> None:
    """Reject functions that would return at once with nothing done, and ones not callable with one argument."""
    code = getattr(inspect.unwrap(act), "__code__", None)
    where = f"{file}: line {code.co_firstlineno}" if code is not None and code.co_filename == file else file
    called = act if inspect.isroutine(act) else getattr(act, "__call__", act)  # noqa: B004
    # 1. Coroutines and generators, also as the __call__ of an object.
    for kind, is_one in _REJECTED_KINDS.items():
        if is_one(act) or is_one(called):
            raise MissionFileError(f"{where}: expected a plain function mission(robot), found {kind}")
    # 2. The signature.
    try:
        inspect.signature(act).bind(None)
    except TypeError:
        found = f"mission{inspect.signature(act)}"
        raise MissionFileError(f"{where}: expected a function mission(robot) of one argument, found {found}") from None
    except ValueError:
        return  # a C function has no signature: calling it will show


_REJECTED_KINDS: dict[str, Callable[[object], bool]] = {
    "async def": inspect.iscoroutinefunction,
    "an asynchronous generator": inspect.isasyncgenfunction,
    "a generator: it has a yield": inspect.isgeneratorfunction,
}


def _with_program_line(error: BaseException, file: str) -> str:
    """Return the text of a program's error with the last line of the file in its traceback."""
    # The last line of the mission's own file: deeper frames are this package's.
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    where = f"{file}: line {lines[-1]}" if lines else file
    if isinstance(error, MissionFileError):
        return f"{where}: {str(error).removeprefix(f'{file}: ')}"
    if isinstance(error, SystemExit):
        return f"{where}: calls sys.exit ({error}); expected mission(robot) to return, or to raise StepFailed"
    return f"{where}: {type(error).__name__}: {error}"


MAX_BYTES: Final = 1 << 20


def load_mission(path: str | PathLike[str]) -> MissionSpec:
    """Return the mission of a file, *.toml or *.py. Raises MissionFileError."""
    # The suffix decides the language: a program is executed, a list of steps only read.
    file = Path(fspath(path))
    if file.suffix not in (".toml", ".py"):
        raise MissionFileError(f"{file}: expected a mission as .toml or .py, found {file.suffix or 'no suffix'!r}")
    text = read_text(file, MAX_BYTES, MissionFileError)
    return parse_program(text, str(file)) if file.suffix == ".py" else parse_step_list(text, str(file))


def parse_step_list(text: str, file: str) -> MissionSpec:
    """Return the mission of a TOML text; `file` is its name in errors. Raises MissionFileError."""
    # Syntax first; then keys and values, where errors get the line of their key.
    values = parse_toml(text, file, MissionFileError)
    try:
        # All steps are checked before the first one is driven.
        mission = convert(values, MissionFile)
    except InvalidValue as error:
        raise MissionFileError(_with_line(f"{file}: {error}", file, text)) from None
    fence = () if mission.fence is UNSET else mission.fence
    settings = pilot.Settings(mission.title, mission.map, mission.time_limit_s, fence, mission.on_lost, mission.lost_s)

    def run(robot: Mission) -> None:
        for step in mission.step:
            step.act(robot)

    return MissionSpec(settings, run, _with_line(f"{file}: map", file, text))


def _with_line(message: str, file: str, text: str) -> str:
    """Return the message with the line of its key, or of the head of its step, if that can be found."""
    # The message starts with "step[2].key: ..." or "key: ...".
    place = re.match(r"(?:step\[(\d+)\])?\.?([A-Za-z_]+)?", message.removeprefix(f"{file}: "))
    step, key = place.groups() if place else (None, None)
    at = _line_of(key, None if step is None else int(step), text.splitlines())
    return message if at is None else message.replace(f"{file}: ", f"{file}: line {at + 1}: ", 1)


def _line_of(key: str | None, step: int | None, lines: Sequence[str]) -> int | None:
    """Return the line index of a key in its step or above all steps; else of the head of the step."""
    # 1. Restrict the search to the section of the step.
    heads = [at for at, line in enumerate(lines) if re.match(r"\s*\[\[\s*step\s*\]\]", line)]
    head = heads[step] if step is not None and step < len(heads) else None
    first = 0 if head is None else head
    section = takewhile(lambda at: at == first or not lines[at].lstrip().startswith("[["), range(first, len(lines)))
    # 2. Find the key in it.
    stands = (at for at in section if key and re.match(rf"\s*\"?{key}\"?\s*=", lines[at]))
    return next(stands, head)
