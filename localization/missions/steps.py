"""Missions from files: lists of steps in TOML, and programs in Python.

    title = "Rounds"              all settings are optional (settings.py)
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

from __future__ import annotations

import inspect
import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from math import degrees, inf
from os import PathLike, fspath
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from localization.missions.mission import Condition, Mission
from localization.missions.settings import (
    MAX_TIME_S,
    MIN_TIME_S,
    Point,
    Settings,
    read_by_deg,
    read_retries,
    read_rounds,
    read_settings,
    read_within_in,
)
from nclient.common.files import parse_toml, read_text
from nclient.common.hints import suggest
from nclient.common.process import TerminatedBySignal
from nclient.errors import MissionFileError, NomadError, WorldFileError
from worlds.io import load_world
from worlds.schema import MAX_COORDINATE_IN, Table

Action = Callable[[Mission], object]
_COMMON_KEYS: Final = ("do", "time_limit_s", "retries")

CONDITIONS: Final[Mapping[str, Callable[[float], Condition]]] = MappingProxyType(
    {
        "nearer_than_in": lambda value: lambda seen: seen.nearest_in < value,
        "farther_than_in": lambda value: lambda seen: seen.nearest_in > value,
        "known_to_in": lambda value: lambda seen: seen.std_in <= value,
        "finds": lambda value: lambda seen: seen.finds >= value,
    }
)
"""Conditions of `wait_for` by key: shortest reading of the ring below or above a value, standard deviation of the
position, number of obstacles that are not in the map. `touching = true` is one more."""


def parse_step(table: Table) -> Action:
    """Return the action of one [[step]]. Raises MissionFileError."""
    if "do" not in table.values:
        table.fail("do", f"is missing; expected one of {', '.join(STEP_PARSERS)}")
    name = table.text("do", "")
    if name not in STEP_PARSERS:
        table.fail("do", f"expected one of {', '.join(STEP_PARSERS)}, found {name!r}{suggest(name, STEP_PARSERS)}")
    return STEP_PARSERS[name](table)


def _parse_go_to(table: Table) -> Action:
    table.allow((*_COMMON_KEYS, "heading_deg", "within_in"), ("to",))
    (x, y), heading, within = _read_point(table), _read_heading(table), read_within_in(table)
    limit_s, retries = _read_limits(table)
    return lambda robot: robot.go_to(x, y, heading, limit_s=limit_s, retries=retries, within_in=within)


def _parse_follow(table: Table) -> Action:
    table.allow((*_COMMON_KEYS, "within_in"), ("points",))
    points, within = table.points_in("points", minimum=1), read_within_in(table)
    limit_s, retries = _read_limits(table)
    return lambda robot: robot.follow(points, limit_s=limit_s, retries=retries, within_in=within)


def _parse_patrol(table: Table) -> Action:
    table.allow((*_COMMON_KEYS, "rounds"), ("points",))
    points, rounds = table.points_in("points", minimum=1), read_rounds(table)
    limit_s, retries = _read_limits(table)
    return lambda robot: robot.patrol(points, rounds, limit_s=limit_s, retries=retries)


def _parse_turn(table: Table) -> Action:
    table.allow((*_COMMON_KEYS, "heading_deg", "by_deg"))
    if ("heading_deg" in table.values) == ("by_deg" in table.values):
        table.fail("", "expected heading_deg or by_deg, one of them")
    heading, by = _read_heading(table), read_by_deg(table) if "by_deg" in table.values else None
    limit_s, retries = _read_limits(table)
    return lambda robot: robot.turn(heading, by_deg=by, limit_s=limit_s, retries=retries)


def _parse_dock(table: Table) -> Action:
    table.allow((*_COMMON_KEYS, "heading_deg"), ("to",))
    (x, y), heading = _read_point(table), _read_heading(table)
    if heading is None:
        table.fail("heading_deg", "is missing: the heading to drive in, in degrees")
    limit_s, retries = _read_limits(table)
    return lambda robot: robot.dock(x, y, heading, limit_s=limit_s, retries=retries)


def _parse_look(table: Table) -> Action:
    table.allow(("do", "for_s"))
    seconds = table.number("for_s", 0.0, MAX_TIME_S) if "for_s" in table.values else 1.0
    return lambda robot: robot.look(seconds)


def _parse_wait_for(table: Table) -> Action:
    table.allow(("do", "time_limit_s", "touching", *CONDITIONS))
    given = [key for key in ("touching", *CONDITIONS) if key in table.values]
    # 1. Exactly one condition and a time limit, so that no mission waits forever.
    if len(given) != 1:
        table.fail("", f"expected one of touching, {', '.join(CONDITIONS)}, found {' and '.join(given) or 'none'}")
    if "time_limit_s" not in table.values:
        table.fail("time_limit_s", "is missing: the longest time to wait, in seconds")
    limit_s, _ = _read_limits(table)
    # 2. The condition as a function of the estimate and readings.
    (key,) = given
    if key == "touching":
        wanted = table.flag(key)
        return lambda robot: robot.wait_for(lambda seen: seen.touching is wanted, limit_s, f"touching = {wanted}")
    value = table.number(key, 0.0, MAX_COORDINATE_IN)
    return lambda robot: robot.wait_for(CONDITIONS[key](value), limit_s, f"{key} = {value:g}")


def _parse_note(table: Table) -> Action:
    table.allow(("do", "words"))
    words = table.text("words", "")
    if not words:
        table.fail("words", "is missing: the text for the report")
    return lambda robot: robot.note(words)


STEP_PARSERS: Final[Mapping[str, Callable[[Table], Action]]] = MappingProxyType(
    {
        "go_to": _parse_go_to,
        "follow": _parse_follow,
        "turn": _parse_turn,
        "look": _parse_look,
        "wait_for": _parse_wait_for,
        "patrol": _parse_patrol,
        "dock": _parse_dock,
        "note": _parse_note,
    }
)
"""Parser of each step by its name."""


def _read_point(table: Table) -> Point:
    """Return the point under to_in, to_cm or to_m."""
    # A point is read as a list of one; errors then name the key of the file again.
    key = table.key_of("to")
    row = Table(table.file, table.path, {key.replace("to_", "points_"): [table.values[key]]})
    try:
        return row.points_in("points", minimum=1)[0]
    except ValueError as error:
        raise MissionFileError(str(error).replace(key.replace("to_", "points_") + "[0]", key)) from None


def _read_heading(table: Table) -> float | None:
    """Return the heading in degrees, None if it is not given."""
    return degrees(table.angle_rad("heading")) if "heading_deg" in table.values else None


def _read_limits(table: Table) -> tuple[float, int]:
    """Return the time limit of a step in seconds (default: none) and its number of retries."""
    limit_s = table.number("time_limit_s", MIN_TIME_S, MAX_TIME_S) if "time_limit_s" in table.values else inf
    return limit_s, read_retries(table)


@dataclass(frozen=True, slots=True)
class MissionSpec:
    """A mission read from a file: settings, action, and the place of its map in the file for error messages."""

    settings: Settings
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
    act, settings = names.get("mission"), names.get("settings", Settings())
    if not callable(act):
        raise MissionFileError(f"{file}: expected a function mission(robot), found none; see docs/missions.md")
    _require_plain(act, file)
    if not isinstance(settings, Settings):
        raise MissionFileError(f"{file}: settings: expected Settings(...), found {type(settings).__name__}")

    def run(robot: Mission) -> None:
        try:
            _require_no_coroutine(act(robot), file)
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


def _require_no_coroutine(result: object, file: str) -> None:
    """Reject a coroutine returned without awaiting it: nothing of it was done."""
    if inspect.iscoroutine(result):
        result.close()
        raise MissionFileError(f"{file}: expected mission(robot) to be done when it returns, found a coroutine")


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
_TOP_KEYS: Final = ("title", "map", "time_limit_s", "on_lost", "lost_s", "step")


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
        top = Table(file, "", values)
        top.allow(_TOP_KEYS, ("fence",))
        # All steps are checked before the first one is driven.
        acts = [parse_step(table) for table in top.tables("step")]
        if not acts:
            top.fail("step", "expected at least one [[step]], found none")
        settings = Settings(**read_settings(top))
    except (WorldFileError, MissionFileError) as error:
        raise MissionFileError(_with_line(str(error), file, text)) from None

    def run(robot: Mission) -> None:
        for act in acts:
            act(robot)

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
