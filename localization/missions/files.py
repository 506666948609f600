"""Missions from files: TOML lists of steps, and programs in Python. The only file here that touches the disk.

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
moves; a program is compiled and its module run, and what its function raises is told with its line.
"""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Final

from localization.missions.mission import Mission
from localization.missions.settings import OnLost, Settings
from localization.missions.verbs import LONGEST_S, step_of
from nclient.errors import MissionFileError, NomadError, WorldFileError
from nclient.file_text import read_text, toml_of
from nclient.suggesting import did_you_mean
from worlds.tables import Table

MOST_BYTES: Final = 1 << 20
_TOP: Final = ("title", "map", "time_limit_s", "on_lost", "lost_s", "step")


@dataclass(frozen=True, slots=True)
class Orders:
    """A mission that was read: what it is bound to, and what it does."""

    settings: Settings
    run: Callable[[Mission], object]


def load_mission(path: str | PathLike[str]) -> Orders:
    """The mission of a file, *.toml or *.py. Raises MissionFileError."""
    file = Path(fspath(path))
    if file.suffix not in (".toml", ".py"):
        raise MissionFileError(f"{file}: expected a mission as .toml or .py, found {file.suffix or 'no ending'!r}")
    text = read_text(file, MOST_BYTES, MissionFileError)
    return parse_program(text, str(file)) if file.suffix == ".py" else parse_list(text, str(file))


def parse_list(text: str, file: str) -> Orders:
    """The mission that a text in TOML says; `file` is what errors call it. Raises MissionFileError."""
    values = toml_of(text, file, MissionFileError)
    try:
        top = Table(file, "", values)
        top.allow(_TOP, ("fence",))
        acts = [step_of(table) for table in top.tables("step")]
        if not acts:
            top.fail("step", "expected at least one [[step]], found none")
        settings = _settings(top)
    except (WorldFileError, MissionFileError) as error:
        raise MissionFileError(_with_line(str(error), file, text)) from None

    def run(robot: Mission) -> None:
        for act in acts:
            act(robot)

    return Orders(settings, run)


def parse_program(text: str, file: str) -> Orders:
    """The mission that a program in Python says. Raises MissionFileError."""
    names: dict[str, Any] = {"__name__": "mission", "__file__": file}
    try:
        exec(compile(text, file, "exec"), names)
    except SyntaxError as error:
        raise MissionFileError(f"{file}: line {error.lineno}: is no Python: {error.msg}") from error
    except Exception as error:
        raise MissionFileError(_told(error, file)) from error
    act, settings = names.get("mission"), names.get("settings", Settings())
    if not callable(act):
        raise MissionFileError(f"{file}: expected a function mission(robot), found none; its verbs: docs/missions.md")
    if not isinstance(settings, Settings):
        raise MissionFileError(f"{file}: settings: expected Settings(...), found {type(settings).__name__}")

    def run(robot: Mission) -> None:
        try:
            act(robot)
        except NomadError:
            raise
        except Exception as error:
            raise MissionFileError(_told(error, file)) from error

    return Orders(settings, run)


def _settings(top: Table) -> Settings:
    values, usual = top.values, Settings()
    policies = [policy.value for policy in OnLost]
    on_lost = top.text("on_lost", usual.on_lost.value)
    if on_lost not in policies:
        near = did_you_mean(on_lost, policies)
        top.fail("on_lost", f"expected one of {', '.join(policies)}, found {on_lost!r}{near}")
    fenced = any(key.startswith("fence_") for key in values)
    return Settings(
        title=top.text("title", usual.title),
        map=top.text("map", usual.map),
        time_limit_s=top.number("time_limit_s", 0.1, LONGEST_S) if "time_limit_s" in values else usual.time_limit_s,
        fence_in=top.points_in("fence", least=3) if fenced else (),
        on_lost=OnLost(on_lost),
        lost_s=top.number("lost_s", 0.1, LONGEST_S) if "lost_s" in values else usual.lost_s,
    )


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


def _told(error: Exception, file: str) -> str:
    """An error of a program with the last line of the file that it came through."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    where = f"line {lines[-1]}: " if lines else ""
    return f"{file}: {where}{type(error).__name__}: {error}"
