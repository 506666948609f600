"""Missions from files: TOML lists of steps, and programs in Python.

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
walls that they name are worlds.files', the report that is written is command.py's.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import takewhile
from os import PathLike, fspath
from pathlib import Path
from typing import Final

from localization.missions.mission import Mission
from localization.missions.orders import Orders
from localization.missions.programs import parse_program
from localization.missions.settings import Settings, settings_in
from localization.missions.verbs import step_of
from nclient.errors import MissionFileError, WorldFileError
from nclient.file_text import read_text, toml_of
from worlds.tables import Table

MOST_BYTES: Final = 1 << 20
_TOP: Final = ("title", "map", "time_limit_s", "on_lost", "lost_s", "step")


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
        settings = Settings(**settings_in(top))
    except (WorldFileError, MissionFileError) as error:
        raise MissionFileError(_with_line(str(error), file, text)) from None

    def run(robot: Mission) -> None:
        for act in acts:
            act(robot)

    return Orders(settings, run, _with_line(f"{file}: map", file, text))


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
