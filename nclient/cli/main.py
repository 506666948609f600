"""The command `nomad`: finds its subcommands by entry points and runs the one that is named.

    nomad COMMAND ...    COMMAND: an entry point of the group `nomad.commands`, a module, or a class in one, with
                         add_arguments(parser) and run(options) -> exit code; its docstring's first line is the help
    nomad help [COMMAND] the same as --help, or as COMMAND --help

Only the module of the named subcommand is imported, so that a missing extra affects no other. A NomadError is printed
on stderr; exit codes are those of nclient.common.process. SIGTERM and SIGHUP end every command through its `with`
blocks, which stop the robot (nclient/common/process.py).
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from nclient.common import exit_on_interrupt, process
from nclient.common.arguments import Parser, add_version, protect_coordinates
from nclient.common.process import ExitCode, TerminatedBySignal, handle_termination_signals, in_short
from nclient.errors import NomadError, closest_match, entry_points, install_hint

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "nomad.commands"
HELP = "help"


class Subcommand(Protocol):
    """Interface of a subcommand: a module, or a class with static methods."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the options of the command."""

    def run(self, options: argparse.Namespace) -> int:
        """Run the command, and return the exit code."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `nomad`, and return the exit code.

    Parameters
    ----------
    argv
        Arguments; default: those of the process.

    Raises
    ------
    SystemExit
        For help, version and invalid arguments, by argparse.
    """
    process.ensure_std_streams()
    try:
        with handle_termination_signals():
            code = _dispatch(list(sys.argv[1:] if argv is None else argv))
            sys.stdout.flush()
    except NomadError as error:
        print(f"nomad: {error}", file=sys.stderr)
        return ExitCode.USAGE if error.usage else ExitCode.FAILED
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    except TerminatedBySignal as left:
        return left.exit_code
    except OSError as error:
        return process.handle_broken_pipe(error, "nomad")
    return code


def _dispatch(arguments: list[str]) -> int:
    # 1. `nomad help wire` is `nomad wire --help`.
    commands = {point.name: point for point in entry_points(group=GROUP)}
    if arguments[:1] == [HELP]:
        arguments = [*(word for word in arguments[1:] if word != HELP), "--help"]
    if not arguments or arguments[0].startswith("-"):
        parser = _top_parser(commands)
        parser.parse_args(arguments or ["--help"])
        parser.error("expected a command")
    name, *rest = arguments
    if name not in commands:
        return _report_usage_error(_unknown(name, commands))
    try:
        # 2. Import only the command that is run: others may need packages that are not installed.
        with exit_on_interrupt():
            command: Subcommand = commands[name].load()
    except ImportError as error:
        return _report_usage_error(_unloadable(name, error))
    # 3. Parse its arguments and run it.
    parser = Parser(prog=f"nomad {name}", **_description(command))
    command.add_arguments(parser)
    return command.run(parser.parse_args([protect_coordinates(word) for word in rest]))


def whole_parser() -> Parser:
    """Return a parser with all subcommands, for completion; one that cannot be imported has its name only."""
    points = {point.name: point for point in entry_points(group=GROUP)}
    parser = _top_parser(points)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    for name, point in sorted(points.items()):
        try:
            command: Subcommand = point.load()
        except ImportError:
            commands.add_parser(name, help=_escape_percent(summary(point)))
            continue
        below = commands.add_parser(name, help=_escape_percent(summary(point)), **_description(command))
        command.add_arguments(below)
    about = commands.add_parser(HELP, help="show help for all commands or for one", add_help=False)
    about.add_argument("name", nargs="?", choices=sorted(points))
    return parser


def _description(command: Subcommand) -> dict[str, Any]:
    import inspect  # here: the list of commands does without

    # The docstring is the help text, up to its rules.
    about = re.split(r"\s*\bRules:", inspect.getdoc(command) or "", maxsplit=1)[0]
    return {"description": about, "formatter_class": argparse.RawDescriptionHelpFormatter}


def _escape_percent(text: str) -> str:
    """Escape % signs, which argparse would expand."""
    return text.replace("%", "%%")




class _TopParser(Parser):
    """The parser of `nomad` itself; its help lists the commands, whose files are read only for that."""

    commands: dict[str, EntryPoint]

    def format_help(self) -> str:
        width = max(map(len, self.commands), default=0)
        lines = [f"  {name:{width}}  {summary(point)}".rstrip() for name, point in sorted(self.commands.items())]
        self.epilog = "\n".join(("commands (nomad help COMMAND shows their options):", *lines))
        return super().format_help()


def _top_parser(commands: dict[str, EntryPoint]) -> Parser:
    parser = _TopParser(prog="nomad", usage="nomad COMMAND ...",
                        description=f"Nomad robots and their Nserver from the command line.\nExit codes: {in_short()}.",
                        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.commands = commands
    add_version(parser)
    return parser


def summary(point: EntryPoint) -> str:
    """Return the first docstring line of a subcommand without importing its module; "" if it cannot be read."""
    # Importing all subcommands would take seconds, and fail without their extras.
    try:
        spec = importlib.util.find_spec(point.module)
    except (ImportError, ValueError):
        return "(not installed whole)"
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    source = importlib.util.decode_source(Path(spec.origin).read_bytes())
    # Only the beginning is read: parsing all these files would take longer than everything else.
    opening = rf"^class {point.attr}\b.*:\n\s+" if point.attr else r"\A(?:#.*\n|\s)*"
    docstring = re.search(rf'{opening}[rR]?"""(.*)', source, re.MULTILINE)
    return docstring[1].removesuffix('"""') if docstring else ""


def _unknown(name: str, commands: dict[str, EntryPoint]) -> str:
    near = closest_match(name, (*commands, HELP))
    hint = f"did you mean {near}?" if near else f"there are: {', '.join(sorted(commands))}"
    return f"no command {name!r}; {hint}"


def _unloadable(name: str, error: ImportError) -> str:
    if not isinstance(error, ModuleNotFoundError):
        return f"the command {name!r} cannot be loaded: {error}"
    return f"the command {name!r} needs {error.name}, which is not installed: {install_hint(error.name or '')}"


def _report_usage_error(message: str) -> int:
    print(f"nomad: {message}", file=sys.stderr)
    return ExitCode.USAGE
