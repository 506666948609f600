"""The steps of a mission's TOML file: for each verb its keys, and what it does. THE table.

    do = "go_to"      to_in, heading_deg, within_in          do = "turn"       heading_deg or by_deg
    do = "follow"     points_in, within_in                   do = "look"       for_s
    do = "patrol"     points_in, rounds                      do = "wait_for"   one condition (CONDITIONS), time_limit_s
    do = "dock"       to_in, heading_deg                     do = "note"       words

and with each that moves: time_limit_s, retries. Lengths may be _in, _cm or _m. Rules: reads tables, drives nothing.

A mission that was read, of whatever kind its file is: values, and the question whether its map is there.

Missions that are programs in Python: run as a module, and its function `mission(robot)` as the mission.

    settings = Settings(title="Mail")           where it wants other ones

    def mission(robot):                         a plain function of one robot; it is done where it returns
        robot.go_to(60, 40)

Rules: whatever is wrong with a program is a MissionFileError with its file and, where there is one, its line: also that
it leaves by sys.exit, for then its exit code would be its own, 0 with nothing done. What is no mistake of the program
passes by: errors of the robot, the end of the mission, Ctrl-C and signals.

Missions from files: TOML lists of steps, and programs in Python.

    title = "Rounds"              all of this may be left out (settings)
    map = "several_walls"
    time_limit_s = 600
    fence_in = [[-10, -10], [100, -10], [100, 100], [-10, 100]]      or _cm, _m
    on_lost = "search"            stop, search, give_up
    lost_s = 60
    [[step]]                      at least one; see verbs
    do = "go_to"
    to_in = [35, 55]

    a program has a function `mission(robot)`, and `settings = Settings(...)` where it wants other ones

Rules: whatever is wrong is a MissionFileError: file, line or key, what was expected. TOML is read whole before anything
moves; a program is compiled and its module run (programs.py). The only file here that reads missions from the disk; the
walls that they name are worlds.io', the report that is written is command.py's.
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

from localization.missions import settings as arguments
from localization.missions.mission import Condition, Mission
from localization.missions.settings import LEAST_S, LONGEST_S, Point, Settings, settings_in
from nclient.common.files import parse_toml, read_text
from nclient.common.hints import suggest
from nclient.common.process import TerminatedBySignal
from nclient.errors import MissionFileError, NomadError, WorldFileError
from worlds.io import load_world
from worlds.schema import FARTHEST_IN, Table

Act = Callable[[Mission], object]
_LIMITS: Final = ("do", "time_limit_s", "retries")

CONDITIONS: Final[Mapping[str, Callable[[float], Condition]]] = MappingProxyType(
    {
        "nearer_than_in": lambda value: lambda seen: seen.nearest_in < value,
        "farther_than_in": lambda value: lambda seen: seen.nearest_in > value,
        "known_to_in": lambda value: lambda seen: seen.std_in <= value,
        "finds": lambda value: lambda seen: seen.finds >= value,
    }
)
"""What can be waited for: the shortest reading of the ring below or above this, the place known to this standard
deviation, so many things found that the map does not have. `touching = true` besides."""


def step_of(table: Table) -> Act:
    """What one [[step]] does. Raises MissionFileError."""
    if "do" not in table.values:
        table.fail("do", f"is wanted; there are {', '.join(VERBS)}")
    verb = table.text("do", "")
    if verb not in VERBS:
        table.fail("do", f"expected one of {', '.join(VERBS)}, found {verb!r}{suggest(verb, VERBS)}")
    return VERBS[verb](table)


def _go_to(table: Table) -> Act:
    table.allow((*_LIMITS, "heading_deg", "within_in"), ("to",))
    (x, y), heading, within = _point(table), _heading(table), arguments.within_in(table)
    limit_s, retries = _limits(table)
    return lambda robot: robot.go_to(x, y, heading, limit_s=limit_s, retries=retries, within_in=within)


def _follow(table: Table) -> Act:
    table.allow((*_LIMITS, "within_in"), ("points",))
    points, within = table.points_in("points", least=1), arguments.within_in(table)
    limit_s, retries = _limits(table)
    return lambda robot: robot.follow(points, limit_s=limit_s, retries=retries, within_in=within)


def _patrol(table: Table) -> Act:
    table.allow((*_LIMITS, "rounds"), ("points",))
    points, rounds = table.points_in("points", least=1), arguments.rounds(table)
    limit_s, retries = _limits(table)
    return lambda robot: robot.patrol(points, rounds, limit_s=limit_s, retries=retries)


def _turn(table: Table) -> Act:
    table.allow((*_LIMITS, "heading_deg", "by_deg"))
    if ("heading_deg" in table.values) == ("by_deg" in table.values):
        table.fail("", "expected heading_deg or by_deg, one of them")
    heading, by = _heading(table), arguments.by_deg(table) if "by_deg" in table.values else None
    limit_s, retries = _limits(table)
    return lambda robot: robot.turn(heading, by_deg=by, limit_s=limit_s, retries=retries)


def _dock(table: Table) -> Act:
    table.allow((*_LIMITS, "heading_deg"), ("to",))
    (x, y), heading = _point(table), _heading(table)
    if heading is None:
        table.fail("heading_deg", "is wanted: which way to drive in, in degrees")
    limit_s, retries = _limits(table)
    return lambda robot: robot.dock(x, y, heading, limit_s=limit_s, retries=retries)


def _look(table: Table) -> Act:
    table.allow(("do", "for_s"))
    seconds = table.number("for_s", 0.0, LONGEST_S) if "for_s" in table.values else 1.0
    return lambda robot: robot.look(seconds)


def _wait_for(table: Table) -> Act:
    table.allow(("do", "time_limit_s", "touching", *CONDITIONS))
    given = [key for key in ("touching", *CONDITIONS) if key in table.values]
    if len(given) != 1:
        table.fail("", f"expected one of touching, {', '.join(CONDITIONS)}, found {' and '.join(given) or 'none'}")
    if "time_limit_s" not in table.values:
        table.fail("time_limit_s", "is wanted: how many seconds to wait at most")
    limit_s, _ = _limits(table)
    (key,) = given
    if key == "touching":
        wanted = table.flag(key)
        return lambda robot: robot.wait_for(lambda seen: seen.touching is wanted, limit_s, f"touching = {wanted}")
    value = table.number(key, 0.0, FARTHEST_IN)
    return lambda robot: robot.wait_for(CONDITIONS[key](value), limit_s, f"{key} = {value:g}")


def _note(table: Table) -> Act:
    table.allow(("do", "words"))
    words = table.text("words", "")
    if not words:
        table.fail("words", "is wanted: what to write into the report")
    return lambda robot: robot.note(words)


VERBS: Final[Mapping[str, Callable[[Table], Act]]] = MappingProxyType(
    {
        "go_to": _go_to,
        "follow": _follow,
        "turn": _turn,
        "look": _look,
        "wait_for": _wait_for,
        "patrol": _patrol,
        "dock": _dock,
        "note": _note,
    }
)
"""Every verb by its name."""


def _point(table: Table) -> Point:
    """The one point under to_in, to_cm or to_m."""
    key = table.key_of("to")
    row = Table(table.file, table.path, {key.replace("to_", "points_"): [table.values[key]]})
    try:
        return row.points_in("points", least=1)[0]
    except ValueError as error:
        raise MissionFileError(str(error).replace(key.replace("to_", "points_") + "[0]", key)) from None


def _heading(table: Table) -> float | None:
    """A heading in degrees, None where it is not given."""
    return degrees(table.angle_rad("heading")) if "heading_deg" in table.values else None


def _limits(table: Table) -> tuple[float, int]:
    """Seconds that a step may take, and how often it is tried again."""
    limit_s = table.number("time_limit_s", LEAST_S, LONGEST_S) if "time_limit_s" in table.values else inf
    return limit_s, arguments.retries(table)


@dataclass(frozen=True, slots=True)
class MissionSpec:
    """What a mission is bound to, what it does, and where its map is told: file, line or key."""

    settings: Settings
    run: Callable[[Mission], object]
    map_told: str

    def check_map(self) -> None:
        """Read the walls that it names, if any. Raises MissionFileError."""
        try:
            if self.settings.map:
                load_world(self.settings.map)
        except WorldFileError as error:
            raise MissionFileError(f"{self.map_told}: {error}") from error


def parse_program(text: str, file: str) -> MissionSpec:
    """The mission that a program in Python says; `file` is what errors call it. Raises MissionFileError."""
    names: dict[str, Any] = {"__name__": "mission", "__file__": file}
    try:
        exec(compile(text, file, "exec"), names)
    except SyntaxError as error:
        raise MissionFileError(f"{file}: line {error.lineno}: is no Python: {error.msg}") from error
    except TerminatedBySignal:
        raise
    except (Exception, SystemExit) as error:
        raise MissionFileError(_told(error, file)) from error
    act, settings = names.get("mission"), names.get("settings", Settings())
    if not callable(act):
        raise MissionFileError(f"{file}: expected a function mission(robot), found none; its verbs: docs/missions.md")
    _require_plain(act, file)
    if not isinstance(settings, Settings):
        raise MissionFileError(f"{file}: settings: expected Settings(...), found {type(settings).__name__}")

    def run(robot: Mission) -> None:
        try:
            _require_no_promise(act(robot), file)
        except MissionFileError as error:
            raise MissionFileError(_told(error, file)) from error
        except (NomadError, TerminatedBySignal):
            raise
        except (Exception, SystemExit) as error:
            raise MissionFileError(_told(error, file)) from error

    return MissionSpec(settings, run, f"{file}: settings: map")


def _require_plain(act: Callable[..., object], file: str) -> None:
    """Refuse what would return at once, with nothing done, and what cannot be called with a robot."""
    code = getattr(inspect.unwrap(act), "__code__", None)
    where = f"{file}: line {code.co_firstlineno}" if code is not None and code.co_filename == file else file
    called = act if inspect.isroutine(act) else getattr(act, "__call__", act)  # noqa: B004
    for kind, is_one in _KINDS.items():
        if is_one(act) or is_one(called):
            raise MissionFileError(f"{where}: expected a plain function mission(robot), found {kind}")
    try:
        inspect.signature(act).bind(None)
    except TypeError:
        found = f"mission{inspect.signature(act)}"
        raise MissionFileError(f"{where}: expected a function mission(robot) of one argument, found {found}") from None
    except ValueError:
        return  # of C, without a signature: what it takes shows when it is called


_KINDS: dict[str, Callable[[object], bool]] = {
    "async def": inspect.iscoroutinefunction,
    "an asynchronous generator": inspect.isasyncgenfunction,
    "a generator: it has a yield": inspect.isgeneratorfunction,
}


def _require_no_promise(came: object, file: str) -> None:
    """Refuse what a plain function got from an async one and did not wait for: nothing of it was done."""
    if inspect.iscoroutine(came):
        came.close()
        raise MissionFileError(f"{file}: expected mission(robot) to be done when it returns, found a coroutine")


def _told(error: BaseException, file: str) -> str:
    """An error of a program with the last line of the file that it came through."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    where = f"{file}: line {lines[-1]}" if lines else file
    if isinstance(error, MissionFileError):
        return f"{where}: {str(error).removeprefix(f'{file}: ')}"
    if isinstance(error, SystemExit):
        return f"{where}: leaves by SystemExit({error}); expected mission(robot) to return, or to raise StepFailed"
    return f"{where}: {type(error).__name__}: {error}"


MOST_BYTES: Final = 1 << 20
_TOP: Final = ("title", "map", "time_limit_s", "on_lost", "lost_s", "step")


def load_mission(path: str | PathLike[str]) -> MissionSpec:
    """The mission of a file, *.toml or *.py. Raises MissionFileError."""
    file = Path(fspath(path))
    if file.suffix not in (".toml", ".py"):
        raise MissionFileError(f"{file}: expected a mission as .toml or .py, found {file.suffix or 'no ending'!r}")
    text = read_text(file, MOST_BYTES, MissionFileError)
    return parse_program(text, str(file)) if file.suffix == ".py" else parse_list(text, str(file))


def parse_list(text: str, file: str) -> MissionSpec:
    """The mission that a text in TOML says; `file` is what errors call it. Raises MissionFileError."""
    values = parse_toml(text, file, MissionFileError)
    try:
        top = Table(file, "", values)
        top.allow(_TOP, ("fence",))
        acts = [step_of(table) for table in top.tables("step")]
        if not acts:
            top.fail("step", "expected at least one [[step]], found none")
        settings = Settings(**settings_in(top))
    except (WorldFileError, MissionFileError) as error:
        raise MissionFileError(_with_line(str(error), file, text)) from None

    def run(robot: Mission) -> None:
        for act in acts:
            act(robot)

    return MissionSpec(settings, run, _with_line(f"{file}: map", file, text))


def _with_line(message: str, file: str, text: str) -> str:
    """The message with the line its key stands in, where that can be told: a key, or the head of its step."""
    place = re.match(r"(?:step\[(\d+)\])?\.?([A-Za-z_]+)?", message.removeprefix(f"{file}: "))
    step, key = place.groups() if place else (None, None)
    at = _line_of(key, None if step is None else int(step), text.splitlines())
    return message if at is None else message.replace(f"{file}: ", f"{file}: line {at + 1}: ", 1)


def _line_of(key: str | None, step: int | None, lines: Sequence[str]) -> int | None:
    """Where the key stands in its step, or above all steps; else the head of the step."""
    heads = [at for at, line in enumerate(lines) if re.match(r"\s*\[\[\s*step\s*\]\]", line)]
    head = heads[step] if step is not None and step < len(heads) else None
    first = 0 if head is None else head
    section = takewhile(lambda at: at == first or not lines[at].lstrip().startswith("[["), range(first, len(lines)))
    stands = (at for at in section if key and re.match(rf"\s*\"?{key}\"?\s*=", lines[at]))
    return next(stands, head)
