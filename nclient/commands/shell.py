"""A terminal to a robot: commands by their C names, with help, completion and the state at a glance.

    nomad shell nserver://localhost:7019/1          type help; Tab completes; Ctrl-C stops the robot; Ctrl-D leaves
    nomad shell "sim:thesis_room?seed=1" --script square.nomad
    nomad shell serial:///dev/ttyUSB0 --command "pr 240 0 0; wait; state pose"
    echo "get_sn" | nomad shell

A script holds what one would type, and comments after #. A script in a file is looked through before it moves anything;
it ends at the first line that fails, which is told as file:line. Leaving stops the robot, however one leaves.
Exit code 0: all was done; 1: a line failed, or the robot was lost; 2: wrong usage; 130: Ctrl-C ended a script.

Rules: files, keys and printing only; what a line means is nclient.shell's.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from nclient.commands.serving import tell
from nclient.connect import address_or_default
from nclient.errors import NomadError, ShellError
from nclient.exit_codes import ExitCode
from nclient.file_text import read_text
from nclient.schemes import Wanted, opening_of
from nclient.shell.language import parse
from nclient.shell.session import Session
from nclient.shell.terminal import Reader, default_history, reader
from nclient.shell.watching import LOOK_S, Watcher

STDIN = "-"
MOST_BYTES: Final = 1 << 20
"""More than any script by hand; a larger file is something else."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """An address, and where the lines come from if not from the keyboard."""
    parser.add_argument("address", nargs="?", help="such as nserver://localhost:7019/1, serial:///dev/ttyUSB0 or "
                        "sim:thesis_room (default: $NOMAD_ROBOT, or this machine's Nserver)")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--script", metavar="FILE", help="do what a file says, and leave; - reads stdin")
    source.add_argument("--command", "-c", metavar="LINE", help="do what this line says, and leave")
    parser.add_argument("--history", type=Path, metavar="FILE",
                        help="where typed lines are kept (default: ~/.local/state/nomad/history)")


def run(options: argparse.Namespace) -> int:
    """Talk until all is said; the exit code."""
    opening = opening_of(address_or_default(options.address), Wanted())
    lines, name = _given(options)
    session = Session(opening.backend(), time.sleep)
    with session.robot:
        if lines is not None:
            return _do_all(session, lines, name)
        watcher = Watcher(session, 0.0 if opening.scheme.in_process else LOOK_S)
        keys = reader(lambda: session.terms, watcher.line, options.history or default_history(os.environ))
        try:
            return converse(session, keys, watcher)
        finally:
            watcher.close()
            keys.close()


def converse(session: Session, keys: Reader, watcher: Watcher) -> int:
    """Read and do, line by line, until somebody leaves; the exit code."""
    print(f"{session.terms.model.name}: {watcher.line()}")
    print("help lists all commands; Ctrl-C stops the robot, Ctrl-D leaves")
    while not session.finished:
        try:
            watcher.begin()
            text = keys.read(f"{session.terms.model.name}> ")
        except EOFError:
            break
        except KeyboardInterrupt:
            text = ""
            _halt_if_moving(session)
        finally:
            watcher.pause()
        _do_one(session, text)
        if session.robot.closed:
            return ExitCode.FAILED
    return ExitCode.DONE


def _do_one(session: Session, text: str) -> None:
    try:
        _show(session.run(text))
    except KeyboardInterrupt:
        print()
        _halt_if_moving(session)
    except NomadError as error:
        tell(str(error))


def _halt_if_moving(session: Session) -> None:
    try:
        if session.robot.refresh().moving:
            print(session.halt())
    except NomadError as error:
        tell(str(error))


def _do_all(session: Session, lines: Iterable[str], name: str) -> int:
    """A script, to its end or to the first line that fails; the exit code."""
    if not isinstance(lines, list):
        return _do_lines(session, lines, name)
    for number, text in enumerate(lines, 1):
        try:
            session.check(text)
        except NomadError as error:
            return _failed(name, number, error)
    return _do_lines(session, lines, name)


def _do_lines(session: Session, lines: Iterable[str], name: str) -> int:
    for number, text in enumerate(lines, 1):
        try:
            _show(session.run(text))
        except NomadError as error:
            return _failed(name, number, error)
        if session.finished:
            break
    return ExitCode.DONE


def _failed(name: str, number: int, error: NomadError) -> int:
    tell(f"{name}:{number}: {error}")
    return ExitCode.FAILED


def _show(lines: Iterator[str]) -> None:
    for line in lines:
        print(line, flush=True)


def _given(options: argparse.Namespace) -> tuple[Iterable[str] | None, str]:
    """The lines of a script and what it is called; None where they are typed. A file is read whole, stdin as it comes.

    Raises ShellError for a file that cannot be read, or a line of it that makes no sense.
    """
    if options.command is not None:
        return [options.command], "--command"
    if options.script == STDIN or (options.script is None and not sys.stdin.isatty()):
        return (line for line in sys.stdin), "stdin"
    if options.script is None:
        return None, ""
    lines = read_text(Path(options.script), MOST_BYTES, ShellError).splitlines()
    for number, line in enumerate(lines, 1):
        try:
            parse(line)
        except ShellError as error:
            raise ShellError(f"{options.script}:{number}: {error}") from None
    return lines, options.script
