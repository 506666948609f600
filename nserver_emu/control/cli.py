"""`nserver ctl`: send one command to a running server over its control socket, and print the response.

    nserver ctl [--control PATH] [--json] COMMAND [ARGUMENT]

Files are read here, and named by absolute paths, because the server may run in another folder. Exit codes are those of
nclient.common.process. A server of another version costs an error message, never a traceback.
"""

import argparse
import json
import os
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from nclient.common.arguments import Parser, add_flag
from nclient.common.process import ExitCode
from nclient.errors import ConnectionLost, ControlError, NomadError, suggest
from nclient.faults.plan import read_plan
from nserver_emu.control import commands
from nserver_emu.control.commands import BY_NAME, COMMANDS, MAX_LINE, ControlCommand, default_path, socket_path
from nserver_emu.simulation.noise import PARTS, SETUPS
from worlds.io import read_world_text

JsonObject = dict[str, Any]
# The meaning of an unexpected response.
NO_ANSWER: Final = "the process that answers is no nserver of this version"
# Errors that unexpected responses lead to.
_UNEXPECTED: Final = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError)


def parse_response(line: bytes) -> JsonObject:
    """Return the result in a response line. Raise ControlError if the server refuses or the line is no response."""
    try:
        response = json.loads(line)
        refused, result = not response["ok"], response.get("said")
        error = _printable(str(response["error"])).strip() if refused else ""
    except _UNEXPECTED as error_:
        raise ControlError(f"{NO_ANSWER} ({error_!r:.80})") from None
    if refused:
        raise ControlError(error or "refused without a reason")
    if not isinstance(result, dict):
        raise ControlError(NO_ANSWER)
    return result


def format_result(result: JsonObject) -> list[str]:
    """Return a result as lines of text. Raise ControlError if it has an unknown form."""
    try:
        return [_printable(line) for line in _lines(result)]
    except _UNEXPECTED as error:
        raise ControlError(f"{NO_ANSWER} ({error!r:.80}); --json prints it unchanged") from None


def _printable(text: str) -> str:
    """Return a text with lone surrogates, which JSON allows, as escapes."""
    return text.encode("utf-8", "backslashreplace").decode()


def _lines(result: JsonObject) -> Iterator[str]:
    if "plan" in result:
        yield result["plan"].rstrip()
    elif "text" in result:
        yield result["text"].rstrip()
    elif "noise" in result:
        yield from (f"robot {number}: {_noise(noise)}" for number, noise in result["noise"].items())
    elif "held" in result:
        yield from (f"robot {number}{_held(hold)}" for number, hold in result["held"].items())
        if not result["held"]:
            yield "no robot is held"
    elif "counts" in result:
        yield from _counts(result["counts"])
    elif "robots" in result:
        yield from _status(result)
    elif "time_s" in result:
        yield _time(result)
    else:
        yield ", ".join(f"{name}: {value}" for name, value in result.items())


def _status(result: dict[str, Any]) -> Iterator[str]:
    yield f"nserver {result['version']}, {result['world']}, seed {result['seed']}"
    yield _time(result)
    for robot in result["robots"]:
        touched = f", bumpers {robot['bumpers']:#x}" if robot["bumpers"] else ""
        yield (f"robot {robot['number']}: {robot['model']} at {robot['x_in']:.1f}, {robot['y_in']:.1f} in, "
               f"{robot['steering_deg']:.1f} deg, {'moving' if robot['moving'] else 'standing'}{touched}, "
               f"{_noise(robot['noise'])}{_held(robot['held'])}")
    for name, place in result["lines"].items():
        yield f"line {name}: {place}"
    for client in result["connections"]:
        whose = "no robot yet" if client["robot"] is None else f"robot {client['robot']}"
        yield f"client {client['name']}: {whose}, {client['refused']} refused{', waiting' if client['waiting'] else ''}"
    injected = ", ".join(f"{kind} {count}" for kind, count in result["faults"]["struck"].items())
    yield f"faults: {result['faults']['rules']} rules{f', so far {injected}' if injected else ''}"


def _noise(noise: dict[str, str]) -> str:
    return f"sensors {noise['sensors']}, motion {noise['motion']}"


def _held(hold: dict[str, Any] | None) -> str:
    return "" if hold is None else f", held by {hold['by']}, {hold['ignored']} motion commands ignored since"


def _time(result: dict[str, Any]) -> str:
    if result["paused"]:
        speed = "paused"
    elif result["lockstep_s"] is not None:
        speed = f"lockstep, {result['lockstep_s']:g} s a request"
    else:
        speed = "unlimited speed" if result["speed"] == "max" else f"{result['speed']:g} x real time"
    return f"time {result['time_s']:.3f} s, {speed}"


def _counts(counts: dict[str, dict[str, dict[str, int]]]) -> Iterator[str]:
    if not counts:
        yield "no faults"
    for line, rules in counts.items():
        for rule, tally in rules.items():
            yield f"{line}, {rule}: " + ", ".join(f"{kind} {count}" for kind, count in tally.items())


# Answered without a server.
HELP: Final = "help"
# An argument of one or more words.
WORDS: Final = "WORDS"
# Seconds to wait for a response; less for commands that are urgent.
TIMEOUT_S: Final = 30.0
URGENT_TIMEOUT_S: Final = 5.0
_URGENT: Final = frozenset({"stop", "status"})
_GROUPS: Final = frozenset(row.name.partition(" ")[0] for row in COMMANDS if " " in row.name)


def main(argv: Sequence[str]) -> int:
    """Run `nserver ctl` with these arguments and return its exit code."""
    parser = _parser()
    options = parser.parse_args(argv)
    name, argument = _command(parser, options.words)
    if name == HELP:
        parser.print_help()
        return ExitCode.DONE
    path = options.control or default_path(os.environ)
    try:
        result = request(path, name, _argument(name, argument))
        lines = [json.dumps(result, indent=2)] if options.json else format_result(result)
    except NomadError as error:
        print(f"nserver ctl: {error}", file=sys.stderr)
        return ExitCode.FAILED
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    print("\n".join(lines))
    return ExitCode.DONE


def request(path: Path, name: str, argument: object = None) -> dict[str, Any]:
    """Send a command to a server and return its result.

    Raises
    ------
    ConnectionLost
        If no server answers.
    ControlError
        If it refuses.
    """
    timeout_s = URGENT_TIMEOUT_S if name in _URGENT else TIMEOUT_S
    line = json.dumps({"command": name, "argument": argument}).encode() + b"\n"
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout_s)
            connection.connect(str(path))
            connection.sendall(line)
            response = _read_response(connection, path)
    except ConnectionLost:
        raise
    except TimeoutError:
        raise ConnectionLost(
            f"the nserver at {path} did not answer in {timeout_s:g} s: it hangs, or its process is stopped"
        ) from None
    except OSError as error:
        raise ConnectionLost(f"no nserver answers at {path} ({error.strerror or error}); start it with nserver "
                             "--control, or give its socket: nserver ctl --control PATH") from error
    return parse_response(response)


def _read_response(connection: socket.socket, path: Path) -> bytes:
    """Read a whole line. Raise ConnectionLost, or OSError of the socket."""
    with connection.makefile("rb") as stream:
        response = stream.readline(MAX_LINE + 1)
    if len(response) > MAX_LINE:
        raise ConnectionLost(f"the response from {path} is too long: is it an nserver?")
    if not response.endswith(b"\n"):
        raise ConnectionLost(f"the nserver at {path} closed the connection; its stderr has the reason")
    return response


def _command(parser: argparse.ArgumentParser, words: list[str]) -> tuple[str, str | None]:
    """Split the words into a command and its argument."""
    length = 2 if words[0] in _GROUPS else 1
    name, arguments = " ".join(words[:length]), words[length:]
    if name not in BY_NAME:
        parser.error(f"no command {name!r}; there are {', '.join(BY_NAME)}{suggest(name, BY_NAME)}")
    expected = BY_NAME[name].argument
    if expected == WORDS and arguments:
        arguments = [" ".join(arguments)]
    if not BY_NAME[name].requires_argument <= len(arguments) <= bool(expected):
        parser.error(f"{name} takes {expected or 'no argument'}, not {' '.join(arguments) or 'nothing'}")
    return name, arguments[0] if arguments else None


def _argument(name: str, given: str | None) -> object:
    """Return the argument as it is sent. Raise FaultPlanError or WorldFileError for a file that cannot be read."""
    match name, given:
        case "faults set", str():
            return {"file": given, "text": read_plan(Path(given))}
        case "world set", str():
            return {"file": given, "text": read_world_text(given)[0]}
        case "save", str():
            return str(Path(given).absolute())
        case _:
            return given


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options, which may stand before, between and after the words."""
    parser.add_argument("--control", type=socket_path, metavar="PATH",
                        help="control socket of the server (default: the user's own)")
    add_flag(parser, "--json", "print the result as JSON")


def _parser() -> argparse.ArgumentParser:
    rows = {f"{row.name} {row.argument}".strip(): row.about for row in COMMANDS}
    width = max(map(len, rows))
    listed = "\n".join(f"  {usage:{width}}  {about}" for usage, about in rows.items())
    parser = Parser(
        prog="nserver ctl",
        usage="nserver ctl [-h] [--control PATH] [--json] COMMAND [ARGUMENT]",
        description="Send a command to a server that was started with --control.\n\n"
        "    nserver ctl status\n    nserver ctl --control /tmp/nomad.ctl faults set plan.toml\n"
        "    nserver ctl step 0.5 --json",
        epilog=f"commands:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    parser.add_argument("words", nargs="+", metavar="COMMAND", help="one of the commands below, with its argument")
    return parser


# For completion, which is made from parsers.

# Arguments that may name a file.
_FILES: Final = frozenset({"FILE", "WORLD"})
# Values that an argument may have, by command.
_CHOICES: Final[Mapping[str, Iterable[str]]] = MappingProxyType({
    "noise": [f"{part}={setup}" for part in PARTS for setup in SETUPS], "speed": [commands.MAX_SPEED],
})  # fmt: skip


def add_commands(parser: argparse.ArgumentParser) -> None:
    """Add the options, and every command as a subcommand with them."""
    add_options(parser)
    groups = {"": parser.add_subparsers()}
    for row in COMMANDS:
        group, _, name = row.name.rpartition(" ")
        if group not in groups:
            above = _add(groups[""], group, _about(group))
            groups[group] = above.add_subparsers()
        _add_argument(_add(groups[group], name, row.about), row)


def _add(subparsers: Any, name: str, about: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = subparsers.add_parser(name, help=about)
    add_options(command)
    return command


def _about(group: str) -> str:
    """Return a description of a group: the second words of its commands."""
    return ", ".join(row.name.rpartition(" ")[2] for row in COMMANDS if row.name.startswith(f"{group} "))


def _add_argument(command: argparse.ArgumentParser, row: ControlCommand) -> None:
    if row.argument:
        command.add_argument("argument", metavar=row.argument, nargs="*" if row.argument == WORDS else None,
                             choices=_CHOICES.get(row.name), type=Path if row.argument in _FILES else str)
