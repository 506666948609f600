"""Argument parser with suggestions for misspelt options and choices.

    nomad --hlep                    nomad: error: no option --hlep; did you mean --help?
                                    nomad --help lists all options
    nomad wire --line seriall       argument --line: no 'seriall'; there are tcp, tcp64, serial; did you mean serial?
    nomad completion                the following arguments are required: shell

An unknown option is reported before other errors, which it usually causes.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final, NoReturn

from nclient.common.process import ExitCode
from nclient.errors import closest_match, suggest, version

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


def add_value(parser: argparse._ActionsContainer, names: str, metavar: str, parse: Callable[[str], object], about: str,
              default: object = None) -> None:
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
