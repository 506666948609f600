"""What a daemon answers to `nserver ctl`: read, and shown for people to read. Pure.

    {"ok": true, "said": {...}} | {"ok": false, "error": "..."}

Rules: a daemon of another version, or something that is none, costs an error in words and no more.

`nserver ctl`: says one thing to a daemon that runs, over its control socket, and shows the answer.

    nserver ctl [--control PATH] [--json] COMMAND [ARGUMENT]

Rules: files are read here and named by their whole path, since the daemon may stand in another folder. Exit codes are
those of nclient.common.exit_codes.

What may follow `nserver ctl`, as a tree of parsers: for completion, which is made from parsers.

    status      faults ─ show, set FILE, clear ...      noise WORD ...      world ─ show, set WORLD | FILE

Rules: made from the table of commands and from ctl's own options. It reads nothing: what is typed is ctl's to judge.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from nclient.common.arguments import Parser
from nclient.common.exit_codes import ExitCode
from nclient.common.hints import suggest
from nclient.errors import ConnectionLost, ControlError, NomadError
from nclient.faults.plan import read_plan
from nserver_emu.control.commands import BY_NAME, COMMANDS, MAX_SPEED, ControlCommand
from nserver_emu.control.options import socket_path
from nserver_emu.control.socket import LONGEST_LINE, default_path
from nserver_emu.simulation.noise import PARTS, SETUPS
from worlds.io import read_world_text

Said = dict[str, Any]
NO_ANSWER: Final = "what answers there is no nserver of this version"
_NONSENSE: Final = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError)
"""What other answers lead to."""


def said_in(answer: bytes) -> Said:
    """What a line of the daemon says. Raises ControlError where it refuses, or the line is no answer."""
    try:
        told = json.loads(answer)
        refused, said = not told["ok"], told.get("said")
        error = _printable(str(told["error"])).strip() if refused else ""
    except _NONSENSE as nonsense:
        raise ControlError(f"{NO_ANSWER} ({nonsense!r:.80})") from None
    if refused:
        raise ControlError(error or "refused, without a word why")
    if not isinstance(said, dict):
        raise ControlError(NO_ANSWER)
    return said


def shown(said: Said) -> list[str]:
    """An answer for people to read, line by line. Raises ControlError where it is none that we know."""
    try:
        return [_printable(line) for line in _lines(said)]
    except _NONSENSE as error:
        raise ControlError(f"{NO_ANSWER} ({error!r:.80}); --json shows it as it is") from None


def _printable(text: str) -> str:
    """Half a surrogate, which JSON can spell, as it was spelt."""
    return text.encode("utf-8", "backslashreplace").decode()


def _lines(said: Said) -> Iterator[str]:
    if "plan" in said:
        yield said["plan"].rstrip()
    elif "text" in said:
        yield said["text"].rstrip()
    elif "noise" in said:
        yield from (f"robot {number}: {_noise(noise)}" for number, noise in said["noise"].items())
    elif "held" in said:
        yield from (f"robot {number}{_held(hold)}" for number, hold in said["held"].items())
        if not said["held"]:
            yield "no robot is held"
    elif "counts" in said:
        yield from _counts(said["counts"])
    elif "robots" in said:
        yield from _status(said)
    elif "time_s" in said:
        yield _time(said)
    else:
        yield ", ".join(f"{name}: {value}" for name, value in said.items())


def _status(said: dict[str, Any]) -> Iterator[str]:
    yield f"nserver {said['version']}, {said['world']}, seed {said['seed']}"
    yield _time(said)
    for robot in said["robots"]:
        touched = f", bumpers {robot['bumpers']:#x}" if robot["bumpers"] else ""
        yield (
            f"robot {robot['number']}: {robot['model']} at {robot['x_in']:.1f}, {robot['y_in']:.1f} in, "
            f"{robot['steering_deg']:.1f} deg, {'moving' if robot['moving'] else 'standing'}{touched}, "
            f"{_noise(robot['noise'])}{_held(robot['held'])}"
        )
    for name, place in said["lines"].items():
        yield f"line {name}: {place}"
    for client in said["connections"]:
        whose = "no robot yet" if client["robot"] is None else f"robot {client['robot']}"
        yield f"client {client['name']}: {whose}, {client['refused']} refused{', waiting' if client['waiting'] else ''}"
    struck = ", ".join(f"{kind} {count}" for kind, count in said["faults"]["struck"].items())
    yield f"faults: {said['faults']['rules']} rules{f', so far {struck}' if struck else ''}"


def _noise(noise: dict[str, str]) -> str:
    return f"sensors {noise['sensors']}, motion {noise['motion']}"


def _held(hold: dict[str, Any] | None) -> str:
    return "" if hold is None else f", held by {hold['by']}, told to move {hold['ignored']} times since"


def _time(said: dict[str, Any]) -> str:
    if said["paused"]:
        pace = "paused"
    elif said["lockstep_s"] is not None:
        pace = f"lockstep, {said['lockstep_s']:g} s a request"
    else:
        pace = "as fast as it can" if said["speed"] == "max" else f"{said['speed']:g} x real time"
    return f"time {said['time_s']:.3f} s, {pace}"


def _counts(counts: dict[str, dict[str, dict[str, int]]]) -> Iterator[str]:
    if not counts:
        yield "no faults"
    for line, rules in counts.items():
        for rule, tally in rules.items():
            yield f"{line}, {rule}: " + ", ".join(f"{kind} {count}" for kind, count in tally.items())


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
        parser.error(f"no command {name!r}; there are {', '.join(BY_NAME)}{suggest(name, BY_NAME)}")
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
            return {"file": given, "text": read_world_text(given)[0]}
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


_FILES: Final = frozenset({"FILE", "WORLD"})
"""Arguments that may name a file."""
_OFFERED: Final[Mapping[str, Iterable[str]]] = MappingProxyType({
    "noise": [f"{part}={setup}" for part in PARTS for setup in SETUPS], "speed": [MAX_SPEED],
})  # fmt: skip
"""Words that an argument may be, by the command."""


def add_commands(parser: argparse.ArgumentParser) -> None:
    """ctl's options, and every command as a subcommand with them."""
    add_options(parser)
    places = {"": parser.add_subparsers()}
    for row in COMMANDS:
        group, _, name = row.name.rpartition(" ")
        if group not in places:
            above = _add(places[""], group, _about(group))
            places[group] = above.add_subparsers()
        _add_argument(_add(places[group], name, row.about), row)


def _add(place: Any, name: str, about: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = place.add_parser(name, help=about)
    add_options(command)
    return command


def _about(group: str) -> str:
    """The commands of a group, by their second words."""
    return ", ".join(row.name.rpartition(" ")[2] for row in COMMANDS if row.name.startswith(f"{group} "))


def _add_argument(command: argparse.ArgumentParser, row: ControlCommand) -> None:
    if row.argument:
        command.add_argument(
            "argument", metavar=row.argument, nargs="*" if row.argument == WORDS else None,
            choices=_OFFERED.get(row.name), type=Path if row.argument in _FILES else str,
        )  # fmt: skip
