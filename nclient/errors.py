"""All errors that this project raises on purpose: one root, and the standard errors that programs already catch.

    NomadError
    ├── AddressError (ValueError)          an address that is not valid, or whose scheme no package opens
    ├── ConnectionLost (ConnectionError)   the other end has closed the connection, or never accepted it
    ├── ReplyTimeout (TimeoutError)        the other end is there and does not reply
    ├── RobotRefused                       a refusal: ERROR or NAK, with the command
    │   └── RobotHeld                      a person stopped the robot and holds it: by name, with how to release it
    ├── BumperHit                          a bumper closed while the robot moved, and it was stopped (bumper_stop)
    ├── WireError (ValueError)             malformed bytes, or values that cannot be encoded
    ├── WorldFileError (ValueError)        a world, model or setup file in TOML that is not valid: file, key
    ├── MapFileError (ValueError)          a map of another tool that cannot be read, or written
    ├── StartError (ValueError)            a start pose that touches a wall or lies outside
    ├── VariableError (ValueError)         an environment variable with a value that is not allowed
    ├── SetupFileError (ValueError)        an old robot.setup or world.setup that is not valid: file, line
    ├── FaultPlanError (ValueError)        a fault plan that is not valid: file, rule, key, what was expected
    ├── MissionFileError (ValueError)      a mission file that is not valid: file, line or key, what was expected
    ├── ControlError (ValueError)          a request that a daemon's control socket cannot fulfil
    ├── SnapshotError (ValueError)         a saved simulation that cannot be written or read
    ├── OutputFileError (ValueError)       a result file that cannot be written: file, reason, remedy
    ├── EstimateFileError (ValueError)     a saved estimate that cannot be written, read or continued
    ├── LogFileError (ValueError)          a recorded drive (CSV) that cannot be read: file, row, column
    ├── ShellError (ValueError)            a line of the shell or of a script that cannot be executed
    ├── RecordingError (ValueError)        a recording that cannot be written, read or replayed: file, line
    └── ExtraMissing (ImportError)         a feature whose extra is not installed: how to install it

Messages name the cause and the remedy. Only nclient.capi converts errors to FALSE and State[44].

The hints in messages are here as well: the most similar word, the extra of a missing module; the version, and entry
points.
"""

from __future__ import annotations

import functools
import importlib.util
import re
import shlex
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

REFUSALS: Final = {
    1: "unknown message type",
    2: "wrong number or range of values",
    3: "not connected to a robot",
    4: "not available on this robot",
    5: "not allowed by the setup or a limit, or another client drives the robot",
    6: "the real robot did not answer",
    7: "a person stopped the robot and holds it",
}
"""Meaning of the codes of an ERROR reply (docs/protocol.md, Error codes)."""
HELD: Final = 7
"""Code of an ERROR reply to a motion of a held robot, and word 44 of its state replies over TCP."""


class NomadError(Exception):
    """The root of all errors of this project."""

    usage: ClassVar[bool] = False
    """True for errors in what the user typed: repeating it makes no sense."""


class AddressError(NomadError, ValueError):
    """An address is not valid, or no installed package opens its scheme."""

    usage = True


class ConnectionLost(NomadError, ConnectionError):
    """The other end has closed the connection, or never accepted it."""


class ReplyTimeout(NomadError, TimeoutError):
    """No complete reply arrived in time."""


class RobotRefused(NomadError):
    """The other end, or this side on its behalf, refused a command.

    Attributes
    ----------
    command
        C name of the call.
    code
        Number of the ERROR reply; None for a NAK on a serial line, and for a command that the model does not have.
    reason
        Details beyond the code.
    """

    def __init__(self, command: str, code: int | None, reason: str = "") -> None:
        self.command = command
        self.code = code
        self.reason = reason
        if not reason:
            reason = "NAK" if code is None else REFUSALS.get(code, "undocumented code")
        super().__init__(f"{command} was refused: {reason}" + ("" if code is None else f" (error {code})"))

    def __reduce__(self) -> tuple[type[RobotRefused], tuple[str, int | None, str]]:
        return type(self), (self.command, self.code, self.reason)

    @property
    def is_nak(self) -> bool:
        """True for a NAK on a serial line, which the C library takes for success."""
        return self.code is None and not self.reason


class RobotHeld(RobotRefused):
    """A person stopped the robot and holds it: motions are refused until it is released; queries and st still work.

    Attributes
    ----------
    robot_id
        Number of the robot on its server; None if it is not known.
    by
        The page or tool that stopped it; empty if the server does not report it.
    """

    def __init__(self, command: str, robot_id: int | None = None, by: str = "") -> None:
        self.robot_id = robot_id
        self.by = by
        robot = "the robot" if robot_id is None else f"robot {robot_id}"
        reason = f"{robot} is held{by and f' by {by}'}; release it on the page or with nserver ctl release"
        super().__init__(command, HELD, reason if robot_id is None else f"{reason} {robot_id}")

    def __reduce__(self) -> tuple[type[RobotHeld], tuple[str, int | None, str]]:
        return type(self), (self.command, self.robot_id, self.by)


class BumperHit(NomadError):
    """A bumper closed while the robot moved, and st was sent at once (option bumper_stop).

    Attributes
    ----------
    command
        C name of the call whose reply showed the hit.
    bumpers
        Numbers of the bumpers that closed.
    """

    def __init__(self, command: str, bumpers: tuple[int, ...]) -> None:
        self.command = command
        self.bumpers = bumpers
        numbers = ", ".join(map(str, bumpers))
        super().__init__(f"{command}: bumper {numbers} closed; the robot was stopped")

    def __reduce__(self) -> tuple[type[BumperHit], tuple[str, tuple[int, ...]]]:
        return type(self), (self.command, self.bumpers)


class WireError(NomadError, ValueError):
    """Bytes are malformed, or values cannot be encoded."""


class WorldFileError(NomadError, ValueError):
    """A world, model or setup file in TOML is not valid; the message names file, key and what was expected."""


class MapFileError(NomadError, ValueError):
    """A map of another tool that cannot be read or written; the message names the file and the cause."""


class StartError(NomadError, ValueError):
    """A start pose touches a wall or lies outside the world."""


class VariableError(NomadError, ValueError):
    """An environment variable has a value that is not allowed; the message lists those that are."""

    usage = True


class SetupFileError(NomadError, ValueError):
    """An old robot.setup or world.setup is not valid; the message names file, line and what was expected."""


class FaultPlanError(NomadError, ValueError):
    """A fault plan is not valid; the message names file, rule, key and what was expected."""


class MissionFileError(NomadError, ValueError):
    """A mission file is not valid; the message names file, line or key, and what was expected."""


class ControlError(NomadError, ValueError):
    """A daemon's control socket cannot fulfil a request; the message names the valid ones."""


class SnapshotError(NomadError, ValueError):
    """A saved simulation cannot be written or read; the message names file and cause."""


class OutputFileError(NomadError, ValueError):
    """A result file cannot be written; reported before the run where that is possible."""


class EstimateFileError(NomadError, ValueError):
    """A saved estimate cannot be written, read or continued; the message names cause and remedy."""


class LogFileError(NomadError, ValueError):
    """A recorded drive cannot be read: file, row, column, what was expected."""

    usage = True


class ShellError(NomadError, ValueError):
    """A line of the shell or of a script is no command or cannot be executed; the message names the cause."""


class RecordingError(NomadError, ValueError):
    """A recording cannot be written or read, or the program departs from the recorded requests."""


class ExtraMissing(NomadError, ImportError):
    """A feature needs an extra of this distribution; the message shows how to install it."""

    usage = True


SIMILARITY = 0.6
"""Minimum similarity of a suggestion, 0 to 1 (difflib's ratio)."""
_SIMILARITY_OF_TWO = 0.5
"""Minimum for words of two letters, as many C names have: one equal letter is half of the word."""
_MIN_PREFIX = 3
"""Letters of an abbreviation from which on it suggests the only word that begins with it."""


def closest_match(word: str, candidates: Iterable[str]) -> str:
    """Return the candidate most similar to a word, or the only one that begins with it; "" if there is none."""
    from difflib import get_close_matches  # here: only a wrong word needs it

    words = list(candidates)
    similar = get_close_matches(word, words, n=1, cutoff=_SIMILARITY_OF_TWO if len(word) == 2 else SIMILARITY)
    if similar:
        return similar[0]
    longer = [candidate for candidate in words if candidate.startswith(word)]
    return longer[0] if len(word) >= _MIN_PREFIX and len(longer) == 1 else ""


def suggest(word: str, candidates: Iterable[str], before: str = "; ", after: str = "?") -> str:
    """Return `; did you mean CANDIDATE?` with the most similar candidate; "" if there is none."""
    match = closest_match(word, candidates)
    return f"{before}did you mean {match}{after}" if match else ""


DISTRIBUTION: Final = "nomad-nserver"


@functools.cache
def version() -> str:
    """Return the installed version. Cached, because reading the metadata reads the whole README."""
    from importlib import metadata  # here: its import is a twentieth of the start of nserver

    return metadata.version(DISTRIBUTION)


@functools.cache
def entry_points(group: str) -> EntryPoints:
    """Return the entry points of a group. Cached: selecting them takes half a millisecond."""
    found: EntryPoints = _all_entry_points().select(group=group)
    return found


@functools.cache
def _all_entry_points() -> Any:
    """Return the entry points of all groups. Cached: reading them takes 20 ms where 250 packages are installed."""
    from importlib import metadata

    return metadata.entry_points()


_GROUPS = frozenset({"all", "dev", "bench"})
"""Extras that consist of others, or have nothing that a command needs."""
_REQUIREMENT = re.compile(r"""(?P<name>[\w.-]+).*extra == ["'](?P<extra>[\w-]+)["']""")
_CLONE: Final = Path(__file__).parents[1]
"""The folder with pyproject.toml, if this is an editable installation of a clone."""


def require_packages(option: str, extra: str, *packages: str) -> None:
    """Raise ExtraMissing if a package that an option of nserver needs is not installed."""
    for package in packages:
        if importlib.util.find_spec(package) is None:
            raise ExtraMissing(f"{option} needs {package}: {install_command(extra)}")


def install_hint(module: str) -> str:
    """Return the command that installs the extra with a module, as `install_command` does."""
    return install_command(find_extra(module) or "all")


def install_command(extra: str) -> str:
    """Return a command that installs an extra from the clone: `pip install -e '.[EXTRA]'`.

    The package is in no registry. Outside of the clone the command has its path, and where another `pip` comes first in
    PATH it has the path of this Python.
    """
    pip = shutil.which("pip")
    is_ours = pip is not None and Path(pip).parent == Path(sys.executable).parent
    is_clone = (_CLONE / "pyproject.toml").is_file()
    folder = str(_CLONE) if is_clone and Path.cwd() != _CLONE else "."
    program = "pip" if is_ours or not is_clone else f"{shlex.quote(sys.executable)} -m pip"
    command = f"{program} install -e {shlex.quote(f'{folder}[{extra}]')}"
    return command if is_clone else f"{command} in the folder of {DISTRIBUTION}"


def find_extra(module: str) -> str:
    """Return the extra that installs a module; "" if there is none, or the package is not installed.

    Extras are read from the installed metadata, so that pyproject.toml is the only list of them.
    """
    from importlib import metadata

    wanted = _normalize(module.partition(".")[0])
    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return ""
    matches = filter(None, map(_REQUIREMENT.match, requirements))
    return next(
        (one["extra"] for one in matches if _normalize(one["name"]) == wanted and one["extra"] not in _GROUPS), ""
    )


def _normalize(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
