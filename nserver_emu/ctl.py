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
from nclient.errors import ConnectionLost, ControlError, NomadError, WorldFileError
from nclient.exit_codes import ExitCode
from nclient.faults.plan_file import read_plan
from nclient.suggesting import did_you_mean
from nserver_emu.server.control import BY_NAME, COMMANDS
from nserver_emu.server.control_socket import default_path

HELP: Final = "help"
"""Answered here, daemon or not."""
WORDS: Final = "WORDS"
"""An argument of one word or more."""
PATIENCE_S: Final = 30.0
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
    except NomadError as error:
        print(f"nserver ctl: {error}", file=sys.stderr)
        return ExitCode.FAILED
    print(json.dumps(said, indent=2) if options.json else "\n".join(shown(said)))
    return ExitCode.DONE


def ask(path: Path, name: str, argument: object = None) -> dict[str, Any]:
    """What a daemon says to a command. Raises ConnectionLost where none answers, ControlError where it refuses."""
    request = json.dumps({"command": name, "argument": argument}).encode() + b"\n"
    answer = b""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
            line.settimeout(PATIENCE_S)
            line.connect(str(path))
            line.sendall(request)
            while not answer.endswith(b"\n"):
                piece = line.recv(_CHUNK)
                if not piece:
                    raise ConnectionLost(f"the daemon at {path} hung up; its own stderr says why")
                answer += piece
    except (TimeoutError, OSError) as error:
        if isinstance(error, ConnectionLost):
            raise
        raise ConnectionLost(
            f"no daemon answers at {path} ({error.strerror or error}); start it with nserver --control, "
            "or say where it is: nserver ctl --control PATH"
        ) from error
    told = json.loads(answer)
    if not told["ok"]:
        raise ControlError(told["error"])
    said: dict[str, Any] = told["said"]
    return said


def shown(said: dict[str, Any]) -> Iterator[str]:
    """An answer for people to read."""
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
    """The argument as it is sent. Raises FaultPlanError for a plan that cannot be read."""
    match name, given:
        case "faults set", str():
            return {"file": given, "text": read_plan(Path(given))}
        case "world set", str():
            return {"file": given, "text": _world(Path(given))}
        case "save", str():
            return str(Path(given).absolute())
        case _:
            return given


def _world(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise WorldFileError(f"{path}: cannot be read: {error}") from error


def _parser() -> argparse.ArgumentParser:
    commands = "\n".join("  " + line for line in _rows({f"{c.name} {c.argument}".strip(): c.about for c in COMMANDS}))
    parser = Parser(
        prog="nserver ctl",
        description="Say something to a daemon that was started with --control.",
        epilog=f"commands:\n{commands}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--control", type=Path, metavar="PATH", help="the daemon's socket (default: the user's own)")
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")
    parser.add_argument("words", nargs="+", metavar="COMMAND", help="see below")
    return parser
