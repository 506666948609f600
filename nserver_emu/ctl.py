"""`nserver ctl`: says one thing to a daemon that runs, over its control socket, and shows the answer.

    nserver ctl [--control PATH] [--json] COMMAND [ARGUMENT]

Rules: files are read here and named by their whole path, since the daemon may stand in another folder. Exit codes are
those of nclient.exit_codes.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from nclient.arguments import Parser
from nclient.errors import ConnectionLost, NomadError
from nclient.exit_codes import ExitCode
from nclient.faults.plan_file import read_plan
from nclient.suggesting import did_you_mean
from nserver_emu.ctl_answers import said_in, shown
from nserver_emu.server.control.control import BY_NAME, COMMANDS
from nserver_emu.server.control.control_options import socket_path
from nserver_emu.server.control.control_socket import LONGEST_LINE, default_path
from worlds.files import world_text

HELP: Final = "help"
"""Answered here, daemon or not."""
WORDS: Final = "WORDS"
"""An argument of one word or more."""
PATIENCE_S: Final = 30.0
QUICK_S: Final = 5.0
"""For what is asked in a hurry."""
_QUICK: Final = frozenset({"stop", "status"})
_CHUNK: Final = 65536
_GROUPS: Final = frozenset(row.name.partition(" ")[0] for row in COMMANDS if " " in row.name)


def main(argv: Sequence[str]) -> int:
    """Run `nserver ctl` with these arguments; the exit code."""
    parser = _parser()
    options = parser.parse_args(argv)
    name, argument = _command(parser, options.words)
    if name == HELP:
        parser.print_help()
        return ExitCode.DONE
    path = options.control or default_path(os.environ)
    try:
        said = ask(path, name, _argument(name, argument))
        lines = [json.dumps(said, indent=2)] if options.json else shown(said)
    except NomadError as error:
        print(f"nserver ctl: {error}", file=sys.stderr)
        return ExitCode.FAILED
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    print("\n".join(lines))
    return ExitCode.DONE


def ask(path: Path, name: str, argument: object = None) -> dict[str, Any]:
    """What a daemon says to a command. Raises ConnectionLost where none answers, ControlError where it refuses."""
    patience_s = QUICK_S if name in _QUICK else PATIENCE_S
    request = json.dumps({"command": name, "argument": argument}).encode() + b"\n"
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
            line.settimeout(patience_s)
            line.connect(str(path))
            line.sendall(request)
            answer = _answer(line, path)
    except ConnectionLost:
        raise
    except TimeoutError:
        raise ConnectionLost(
            f"the daemon at {path} did not answer in {patience_s:g} s: it hangs, or its process is stopped"
        ) from None
    except OSError as error:
        raise ConnectionLost(
            f"no daemon answers at {path} ({error.strerror or error}); start it with nserver --control, "
            "or say where it is: nserver ctl --control PATH"
        ) from error
    return said_in(answer)


def _answer(line: socket.socket, path: Path) -> bytes:
    """A whole line. Raises ConnectionLost, or what the socket does."""
    answer = b""
    while not answer.endswith(b"\n"):
        piece = line.recv(_CHUNK)
        if not piece:
            raise ConnectionLost(f"the daemon at {path} hung up; its own stderr says why")
        answer += piece
        if len(answer) > LONGEST_LINE:
            raise ConnectionLost(f"what answers at {path} goes on without an end: is it an nserver?")
    return answer


def _rows(rows: dict[str, str]) -> Iterator[str]:
    width = max(map(len, rows))
    for left, right in rows.items():
        yield f"{left:{width}}  {right}"


def _command(parser: argparse.ArgumentParser, words: list[str]) -> tuple[str, str | None]:
    """The command among the words, and its argument."""
    length = 2 if words[0] in _GROUPS else 1
    name, arguments = " ".join(words[:length]), words[length:]
    if name not in BY_NAME:
        parser.error(f"no command {name!r}; there are {', '.join(BY_NAME)}{did_you_mean(name, BY_NAME)}")
    wanted = BY_NAME[name].argument
    if wanted == WORDS and arguments:
        arguments = [" ".join(arguments)]
    if not BY_NAME[name].wants <= len(arguments) <= bool(wanted):
        parser.error(f"{name} takes {wanted or 'no argument'}, not {' '.join(arguments) or 'nothing'}")
    return name, arguments[0] if arguments else None


def _argument(name: str, given: str | None) -> object:
    """The argument as it is sent. Raises FaultPlanError and WorldFileError for a file that cannot be read."""
    match name, given:
        case "faults set", str():
            return {"file": given, "text": read_plan(Path(given))}
        case "world set", str():
            return {"file": given, "text": world_text(given)[0]}
        case "save", str():
            return str(Path(given).absolute())
        case _:
            return given


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options, which may stand before, between and after the words."""
    parser.add_argument("--control", type=socket_path, metavar="PATH",
                        help="the daemon's socket (default: the user's own)")
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def _parser() -> argparse.ArgumentParser:
    commands = "\n".join("  " + line for line in _rows({f"{c.name} {c.argument}".strip(): c.about for c in COMMANDS}))
    parser = Parser(
        prog="nserver ctl",
        description="Say something to a daemon that was started with --control.",
        epilog=f"commands:\n{commands}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    parser.add_argument("words", nargs="+", metavar="COMMAND", help="see below")
    return parser
