"""The command `nomad`: finds its subcommands by entry point and hands over to the one that is named.

    nomad COMMAND ...    COMMAND: an entry point of the group `nomad.commands`, a module with
                         add_arguments(parser) and run(options) -> exit code; its docstring's first line is the help
    nomad help [COMMAND] the same as --help, or as COMMAND --help

Rules: knows no subcommand by name and imports only the one that is asked for, so that one which lacks an extra
hurts no other. A NomadError is printed on stderr; exit codes are those of nclient.common.exit_codes. Every command
ends in order on SIGTERM and SIGHUP (nclient/common/process.py), so that its `with` blocks stop what they drive.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import re
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol

from nclient.common import process
from nclient.common.arguments import Parser
from nclient.common.exit_codes import ExitCode, in_short
from nclient.common.hints import closest_match, install_hint, version
from nclient.common.process import TerminatedBySignal, handle_termination_signals
from nclient.errors import NomadError

GROUP = "nomad.commands"
HELP = "help"


class Subcommand(Protocol):
    """What a module must have to be a subcommand."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Say what the command line holds."""
        ...

    def run(self, options: argparse.Namespace) -> int:
        """Do it; the exit code."""
        ...


def main(argv: Sequence[str] | None = None) -> int:
    """Run `nomad` with these arguments (those of the process when None); the exit code.

    Help, version and arguments that make no sense leave by argparse's SystemExit.
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
    commands = {point.name: point for point in entry_points(group=GROUP)}
    if arguments[:1] == [HELP]:
        arguments = [*(word for word in arguments[1:] if word != HELP), "--help"]
    if not arguments or arguments[0].startswith("-"):
        parser = _top_parser(commands)
        parser.parse_args(arguments or ["--help"])
        parser.error("a command is wanted")
    name, *rest = arguments
    if name not in commands:
        return _complain(_unknown(name, commands))
    try:
        command: Subcommand = commands[name].load()
    except ImportError as error:
        return _complain(_unloadable(name, error))
    parser = Parser(prog=f"nomad {name}", **_description(command))
    command.add_arguments(parser)
    return command.run(parser.parse_args([_as_value(word) for word in rest]))


def whole_parser() -> Parser:
    """All subcommands as subparsers of one, for completion: those that cannot be loaded by their names alone."""
    points = {point.name: point for point in entry_points(group=GROUP)}
    parser = _top_parser(points)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, point in sorted(points.items()):
        try:
            command: Subcommand = point.load()
        except ImportError:
            commands.add_parser(name, help=_plain(summary(point)))
            continue
        below = commands.add_parser(name, help=_plain(summary(point)), **_description(command))
        command.add_arguments(below)
    about = commands.add_parser(HELP, help="show what there is, or what a command takes", add_help=False)
    about.add_argument("name", nargs="?", choices=sorted(points))
    return parser


def _description(command: Subcommand) -> dict[str, Any]:
    about = re.split(r"\s*\bRules:", command.__doc__ or "", maxsplit=1)[0]
    return {"description": about, "formatter_class": argparse.RawDescriptionHelpFormatter}


def _plain(text: str) -> str:
    """Help in which argparse finds nothing to fill in."""
    return text.replace("%", "%%")


def _as_value(word: str) -> str:
    """Coordinates such as -5,3 are a value: argparse takes what begins with a minus and is no number for an option."""
    return f" {word}" if re.match(r"-[\d.][^,]*,", word) else word


def _top_parser(commands: dict[str, EntryPoint]) -> Parser:
    width = max(map(len, commands), default=0)
    lines = [f"  {name:{width}}  {summary(point)}".rstrip() for name, point in sorted(commands.items())]
    parser = Parser(
        prog="nomad",
        usage="nomad COMMAND ...",
        description=f"Nomad robots and their Nserver from the command line.\nExit codes: {in_short()}.",
        epilog="\n".join(("commands (nomad help COMMAND says more):", *lines)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"nomad {version()}")
    return parser


def summary(point: EntryPoint) -> str:
    """The first line of the docstring of a subcommand's module, read without importing it; empty if it cannot be."""
    try:
        spec = importlib.util.find_spec(point.module)
    except (ImportError, ValueError):
        return "(not installed whole)"
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    source = importlib.util.decode_source(Path(spec.origin).read_bytes())
    docstring = ast.get_docstring(ast.parse(source)) or ""
    return docstring.partition("\n")[0]


def _unknown(name: str, commands: dict[str, EntryPoint]) -> str:
    near = closest_match(name, (*commands, HELP))
    hint = f"did you mean {near}?" if near else f"there are: {', '.join(sorted(commands))}"
    return f"no command {name!r}; {hint}"


def _unloadable(name: str, error: ImportError) -> str:
    if not isinstance(error, ModuleNotFoundError):
        return f"the command {name!r} cannot be loaded: {error}"
    return f"the command {name!r} needs {error.name}, which is not installed: {install_hint(error.name or '')}"


def _complain(message: str) -> int:
    print(f"nomad: {message}", file=sys.stderr)
    return ExitCode.USAGE
