"""Argument parser with suggestions for misspelt options and choices.

    nomad --hlep                    nomad: error: no option --hlep; did you mean --help?
                                    nomad --help lists all options
    nomad wire --line seriall       argument --line: no 'seriall'; there are tcp, tcp64, serial; did you mean serial?
    nomad completion                the following arguments are required: shell

An unknown option is reported before other errors, which it usually causes.

Hints in error messages: the most similar word, the extra of a missing module; the version, and entry points.
"""

from __future__ import annotations

import argparse
import functools
import math
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

from nclient.common.process import ExitCode

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


SIMILARITY = 0.6
"""Minimum similarity of a suggestion, 0 to 1 (difflib's ratio)."""
_SIMILARITY_OF_TWO = 0.5
"""Minimum for words of two letters, as many C names have: one equal letter is half of the word."""
_MIN_PREFIX = 3
"""Letters of an abbreviation from which on it suggests the only word that begins with it."""


def closest_match(word: str, candidates: Iterable[str]) -> str:
    """Return the candidate most similar to a word, or the only one that begins with it; "" if there is none."""
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


def entry_points(group: str) -> EntryPoints:
    """Return the entry points of a group."""
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


_CLONE: Final = Path(__file__).parents[2]
"""The folder with pyproject.toml, if this is an editable installation of a clone."""


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


MAX_DIGITS = 18
"""Maximum length of a whole number; int() refuses very long ones."""


class Parser(argparse.ArgumentParser):
    """An ArgumentParser with suggestions; its subparsers are of this class, too."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does, and exit with a suggestion at an unknown long option."""
        self._mark_optional_words()
        words: Sequence[str] = () if args is None else tuple(args)
        options = self._option_names()
        # A parser with subparsers does not know which options belong to them.
        if self._subparsers is None:
            for word in words[: words.index("--")] if "--" in words else words:
                name = word.partition("=")[0]
                if name.startswith("--") and not any(option.startswith(name) for option in options):
                    self._reject_option(name)
        return super().parse_known_args(args, namespace)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does; options may stand between positional arguments."""
        options, rest = self.parse_known_args(args, namespace)
        if rest and self._subparsers is None and not any(word.startswith("-") for word in rest):
            options, rest = self.parse_known_intermixed_args(args, namespace)
        if rest and rest[0].startswith("-"):
            self._reject_option(rest[0].partition("=")[0])
        if rest:
            self.error(f"too many arguments: {' '.join(rest)}")
        return options

    def error(self, message: str) -> NoReturn:
        """Print the error and a hint, without the usage of all options, and exit with 2."""
        self.exit(ExitCode.USAGE, f"{self.prog}: error: {message}\n{self.prog} --help lists all options\n")

    def _mark_optional_words(self) -> None:
        # Python before 3.13 reports positional arguments with nargs="*" as required.
        for action in self._actions:
            if action.nargs == argparse.ZERO_OR_MORE and not action.option_strings:
                action.required = False

    def _reject_option(self, name: str) -> NoReturn:
        # Compared without dashes, which would make all options similar.
        options = {option.strip("-"): option for option in self._option_names()}
        match = options.get(closest_match(name.strip("-"), options))
        hint = f"; did you mean {match}?" if match else ""
        self.error(f"no option {name}{hint}")

    def _option_names(self) -> list[str]:
        return [option for action in self._actions for option in action.option_strings]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices]
            message = f"no {value!r}; there are {', '.join(choices)}{suggest(str(value), choices)}"
            raise argparse.ArgumentError(action, message)


def protect_coordinates(word: str) -> str:
    """Mark coordinates such as -5,3 as a value with a blank; argparse would take them for an option."""
    return f" {word}" if re.match(r"-[\d.][^,]*,", word) else word


def number(expected: str, low: float, high: float = math.inf) -> Callable[[str], float]:
    """Return a parser of finite numbers from low to high; its ArgumentTypeError says what is expected."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and low <= value <= high):
            raise argparse.ArgumentTypeError(f"{expected}, not {text!r}")
        return value

    return parse


ABOVE_ZERO: Final = math.ulp(0.0)
"""The smallest number above 0, as a lower bound."""
seconds: Final = number("a number of seconds, 0 or more", 0.0)


def whole_number(what: str, low: int, high: int = sys.maxsize) -> Callable[[str], int]:
    """Return a parser of whole numbers; `what` names the number in the message of its ArgumentTypeError."""

    def parse(text: str) -> int:
        # isdecimal() accepts the digits of other scripts, and int() reads them.
        if not (text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS) or not low <= int(text) <= high:
            bounds = f"{low} or more" if high == sys.maxsize else f"{low} to {high}"
            raise argparse.ArgumentTypeError(f"{what} is {bounds}, not {text}")
        return int(text)

    return parse


def add_value(
    parser: argparse._ActionsContainer, names: str, metavar: str, parse: Callable[[str], object], about: str,
    default: object = None,
) -> None:  # fmt: skip
    """Add an option with a value; other names of it follow after blanks.

    Its help ends with the default, unless there is none or `about` names it.
    """
    shown = "" if default is None or "(default" in about else " (default: %(default)s)"
    parser.add_argument(*names.split(), metavar=metavar, type=parse, default=default, help=about + shown)


def add_flag(parser: argparse._ActionsContainer, name: str, about: str) -> None:
    """Add an option without a value."""
    parser.add_argument(name, action="store_true", help=about)


class _PrintVersion(argparse.Action):
    """Print the installed version and exit. argparse's own action takes a text, for which each start would read it."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"{parser.prog} {version()}")
        parser.exit()


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add --version."""
    parser.add_argument("--version", action=_PrintVersion, nargs=0, default=argparse.SUPPRESS,
                        help="show program's version number and exit")  # fmt: skip


def add_address(parser: argparse.ArgumentParser, default: str = "robot 1 of a local nserver") -> None:
    """Add the address of a robot; without it and NOMAD_ROBOT the command takes `default`."""
    parser.add_argument("address", nargs="?", metavar="ADDRESS",
                        help="robot, such as nserver://localhost:7019/1, serial:///dev/ttyUSB0 or sim:thesis_room "
                        f"(default: $NOMAD_ROBOT, or {default})")
