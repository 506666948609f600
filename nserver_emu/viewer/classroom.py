"""A class: each student has a robot, and a token that drives that robot alone and watches all others (docs/class.md).

    students.csv           name[,token][,robot]       a line per student; a first line `name,token,robot` is skipped
    students.links.csv     name,robot,token,page,program     written at the start, readable by its owner only

A token that the class file leaves out is taken from the file of links, so that links stay the same over restarts, or
made. The Nserver protocol has no token: a program chooses its robot by number (docs/decisions/050-class.md).
"""

from __future__ import annotations

import contextlib
import csv
import io
import os
import re
import secrets
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from nclient.common.files import read_text
from nclient.errors import NomadError
from nserver_emu.server.config import MAX_ROBOTS
from nserver_emu.viewer import messages

WORLD: Final = "arena"
"""World of a class that names no other."""
LINKS_SUFFIX: Final = ".links.csv"
HEADER: Final = ("name", "robot", "token", "page", "program")
TEACHER: Final = "teacher"
# As in http_port.py: characters of a URL that need no escape, 96 bits at least.
_TOKEN: Final = re.compile(r"[A-Za-z0-9_-]{16,200}")
_MAX_NAME: Final = 40
MAX_BYTES: Final = 1_000_000
_MAX_COLUMNS: Final = 3
_MAX_DIGITS: Final = 9
# Group and others.
_OTHERS: Final = 0o077
# Calls that change the world, or another robot than the student's.
_OF_THE_WORLD: Final = frozenset(
    {"add_obstacle", "delete_obstacle", "move_obstacle", "new_world", "create_robot", "refresh_all"}
)


class ClassFileError(NomadError, ValueError):
    """A class file that cannot be used; the message names the file, the line and the remedy."""


class Student(NamedTuple):
    """A student, the token of the page, and the robot."""

    name: str
    token: str
    robot: int


def read_class(path: Path) -> list[Student]:
    """Read a class file; students without a token or robot get one.

    Raises
    ------
    ClassFileError
        For a file that cannot be read, a wrong line, or tokens that others may read.
    """
    # 1. Rows with their line numbers, without empty lines, comments and a heading.
    rows = [(line, row) for line, row in _rows(path) if any(row) and not row[0].startswith("#")]
    if rows and rows[0][1][0].lower() == "name":
        del rows[0]
    if not rows:
        raise ClassFileError(f"{path}: no students: write a line per student, name[,token][,robot]")
    if len(rows) > MAX_ROBOTS:
        raise ClassFileError(f"{path}: {len(rows)} students, and at most {MAX_ROBOTS} robots: is it the right file?")
    # 2. Robots named in the file, then the free numbers in order.
    entries = [_entry(path, line, row) for line, row in rows]
    taken: dict[object, int] = {}
    for (line, _), entry in zip(rows, entries, strict=True):
        for key, what in ((("name", entry.name.lower()), f"the name {entry.name}"),
                          (("robot", entry.robot), f"robot {entry.robot}"), (("token", entry.token), "this token")):
            if key[1] and taken.setdefault(key, line) != line:
                raise ClassFileError(f"{path}, line {line}: {what} is in line {taken[key]} already: change one")
    free = (number for number in range(1, MAX_ROBOTS + 1) if ("robot", number) not in taken)
    # 3. Secrets that others can read are refused.
    if any(entry.token for entry in entries) and path.stat().st_mode & _OTHERS:
        raise ClassFileError(f"{path}: others than its owner may read the tokens: chmod 600 {path}")
    old = _old_tokens(path)
    return [
        Student(entry.name, entry.token or old.get(entry.name) or secrets.token_urlsafe(24), entry.robot or next(free))
        for entry in entries
    ]


def links_path(path: Path) -> Path:
    """Return the file of links that belongs to a class file."""
    return path.with_name(path.name.removesuffix(".csv") + LINKS_SUFFIX)


def write_links(path: Path, students: list[Student], page: str, program: str) -> Path:
    """Write the links of a class, readable by its owner only; return the file.

    Parameters
    ----------
    page, program
        Address of the page without a token, and of the server without a robot.
    """
    target = links_path(path)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for name, token, robot in students:
        writer.writerow((name, robot, token, f"{page}/?token={token}", f"{program}/{robot}"))
    made = target.with_name(f"{target.name}.{os.getpid()}")
    try:
        # A new file, whose permissions are set before the secrets are written, replaces the old one as a whole.
        made.unlink(missing_ok=True)
        with os.fdopen(os.open(made, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(text.getvalue())
        made.replace(target)
    except OSError as error:
        with contextlib.suppress(OSError):
            made.unlink()
        raise ClassFileError(f"{target}: links cannot be written: {error.strerror}; use a folder of yours") from error
    return target


def refusal(message: messages.Message, robot: int, person: str, operators: Collection[str]) -> str:
    """Return the reason why a student may not send a message; empty if it is allowed.

    Parameters
    ----------
    robot, person
        The student's robot and name.
    operators
        Viewers and tools that have stopped the robot and hold it.
    """
    match message:
        case messages.Seen() | messages.Watch() | messages.Gallery():
            return ""
        case messages.ControlServer() | messages.Adjust():
            return "only the teacher changes the world, its time, noise and faults"
        case messages.CallRobot() if message.call in _OF_THE_WORLD:
            return "only the teacher changes the world"
        case _ if message.robot != robot:
            return f"this page drives robot {robot} only"
        case messages.Release() if others := sorted(one for one in operators if person_of(one) != person):
            return f"robot {robot} is held by {others[0]}, who may release it"
        case _:
            return ""


def person_of(viewer: str) -> str:
    """Return the person in the name of a viewer: `Ada` of `Ada (viewer 3)`."""
    return viewer.rpartition(" (viewer ")[0]


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(read_text(path, MAX_BYTES, ClassFileError)), strict=True)
    try:
        for row in reader:
            yield reader.line_num, [word.strip() for word in row] or [""]
    except csv.Error as error:
        raise ClassFileError(f"{path}, line {reader.line_num}: {error}; write name[,token][,robot]") from error


class _Entry(NamedTuple):
    """A line of the class file; what it leaves out is empty or 0."""

    name: str
    token: str
    robot: int


def _entry(path: Path, line: int, row: list[str]) -> _Entry:
    if len(row) > _MAX_COLUMNS:
        raise ClassFileError(f"{path}, line {line}: {len(row)} columns: write name[,token][,robot], and a name "
                             "with a comma in quotes")
    name, token, robot = (*row, "", "")[:_MAX_COLUMNS]
    # A name and a number are usual, too: Ada,7.
    if token.isdecimal() and not robot and not _TOKEN.fullmatch(token):
        token, robot = "", token
    # A program for tables runs what begins as a formula; semicolons separate the columns of some of them.
    if not 0 < len(name) <= _MAX_NAME or not name.isprintable() or name[0] in "=+-@" or ";" in name:
        raise ClassFileError(f"{path}, line {line}: a name has 1 to {_MAX_NAME} characters, begins with none of "
                             f"= + - @, and has no semicolon (columns are separated by commas), not {name!r}")
    if name.lower() == TEACHER:
        raise ClassFileError(f"{path}, line {line}: {name} is the name of the teacher's pages: write another one")
    if token and not _TOKEN.fullmatch(token):
        raise ClassFileError(f"{path}, line {line}: a token has 16 to 200 letters, digits, - and _; leave it out, and "
                             "one is made")
    if robot and not (robot.isdecimal() and len(robot) <= _MAX_DIGITS and 1 <= int(robot) <= MAX_ROBOTS):
        raise ClassFileError(f"{path}, line {line}: a robot is a number from 1 to {MAX_ROBOTS}, not {robot[:20]!r}; "
                             "leave it out for the next free one")
    return _Entry(name, token, int(robot or 0))


def _old_tokens(path: Path) -> dict[str, str]:
    """Return the tokens of the last start by name; none if there was none, or others may read them."""
    target = links_path(path)
    if not target.is_file() or target.stat().st_mode & _OTHERS:
        return {}
    rows = csv.DictReader(io.StringIO(read_text(target, MAX_BYTES, ClassFileError)))
    return {row["name"]: token for row in rows if row.get("name") and _TOKEN.fullmatch(token := row.get("token") or "")}
