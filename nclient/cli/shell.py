"""Control a robot interactively with the C library's command names.

    nomad shell nserver://localhost:7019/1          type help; Tab completes; Ctrl-C stops the robot; Ctrl-D exits
    nomad shell "sim:thesis_room?seed=1" --script square.nomad
    nomad shell serial:///dev/ttyUSB0 --command "pr 240 0 0; wait; state pose"
    echo "get_sn" | nomad shell

A script has the same lines as typed, with comments after #. A script in a file is checked before anything moves; it
ends at the first line that fails, which is reported as file:line. The robot is stopped at the end in any case.
Exit code 0: done; 1: a line failed, or the robot was lost; 2: wrong usage; 130: Ctrl-C ended a script.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final, Protocol

from prompt_toolkit import PromptSession
from prompt_toolkit.auto_suggest import AutoSuggestFromHistory
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory, History, InMemoryHistory

from nclient.cli import state_text
from nclient.cli.serving import print_message
from nclient.cli.shell_help import candidates, hint, parse
from nclient.cli.shell_session import Session
from nclient.common.exit_codes import ExitCode
from nclient.common.files import read_text
from nclient.connect import Connector, address_or_default
from nclient.errors import NomadError, ShellError
from nclient.protocol.wire_state import WireState
from nclient.url import parse_address

REDRAWN_S = 0.5


class Names(Completer):
    """Completion by what completion.py says."""

    def __init__(self, wire_state: Callable[[], WireState]) -> None:
        self._wire_state = wire_state

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
        """Names that the word before the cursor may become."""
        del complete_event
        typed = document.text_before_cursor
        last = document.get_word_before_cursor(WORD=True).rpartition(";")[2].rpartition("(")[2]
        for word, about in candidates(typed, self._wire_state()):
            yield Completion(word, start_position=-len(last), display_meta=about)


class PromptReader:
    """Lines typed at a terminal; `below`: what stands under them, asked anew twice a second."""

    def __init__(self, wire_state: Callable[[], WireState], below: Callable[[], str], history: Path | None) -> None:
        kept: History = InMemoryHistory() if history is None else FileHistory(str(history))
        self._below = below
        self._session: PromptSession[str] = PromptSession(
            history=kept, auto_suggest=AutoSuggestFromHistory(), completer=Names(wire_state),
            complete_while_typing=False, bottom_toolbar=self._toolbar, refresh_interval=REDRAWN_S,
        )

    def read(self, prompt: str) -> str:
        """A line. Raises EOFError at Ctrl-D, KeyboardInterrupt at Ctrl-C."""
        return self._session.prompt(prompt)

    def close(self) -> None:
        """Nothing is left to do: history is kept line by line."""

    def _toolbar(self) -> str:
        """The usage of what is being typed, and the state."""
        usage = hint(self._session.default_buffer.document.text_before_cursor)
        return f"{usage}\n{self._below()}" if usage else self._below()


LONGEST_HISTORY = 2000


class Reader(Protocol):
    """Who reads lines."""

    def read(self, prompt: str) -> str:
        """A line. Raises EOFError at its end, KeyboardInterrupt at Ctrl-C."""
        ...

    def close(self) -> None:
        """Keep what is to be kept."""
        ...


def reader(wire_state: Callable[[], WireState], below: Callable[[], str], history: Path | None) -> Reader:
    """Who reads from this terminal; `below`: the line to show under what is typed, where that can be."""
    if history is not None:
        history = _prepared(history)
    if importlib.util.find_spec("prompt_toolkit") is not None:
        # an extra

        return PromptReader(wire_state, below, history)
    return PlainReader(wire_state, history)


def default_history(environment: Mapping[str, str]) -> Path:
    """Where the lines typed are kept: $XDG_STATE_HOME/nomad/history, ~/.local/state/nomad/history."""
    state = environment.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "nomad" / "history"


def _prepared(history: Path) -> Path | None:
    """The file, made where there is none; None where it cannot be written, which stops nobody from driving."""
    try:
        history.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(history, os.O_RDWR | os.O_CREAT, 0o600))
    except OSError as error:
        print(f"nomad: no history is kept: {history}: {error.strerror}", file=sys.stderr)
        return None
    return history


class PlainReader:
    """input(), with readline's editing, history and completion where the system has readline."""

    def __init__(self, wire_state: Callable[[], WireState], history: Path | None) -> None:
        self._wire_state = wire_state
        self._history = history
        self._found: list[str] = []
        with contextlib.suppress(ImportError):  # Windows has none
            import readline

            readline.set_completer(self.complete)
            readline.set_completer_delims(" \t;(,")
            libedit = "libedit" in (readline.__doc__ or "")
            readline.parse_and_bind("bind ^I rl_complete" if libedit else "tab: complete")
            if history is not None:
                with contextlib.suppress(OSError):
                    readline.read_history_file(history)

    def read(self, prompt: str) -> str:
        """A line. Raises EOFError at Ctrl-D, KeyboardInterrupt at Ctrl-C."""
        return input(prompt)

    def complete(self, word: str, number: int) -> str | None:
        """The name of that number that the word may become, as readline asks: 0, 1, ... until None."""
        if number == 0:
            import readline

            typed = readline.get_line_buffer()[: readline.get_endidx()]
            self._found = [candidate.word for candidate in candidates(typed or word, self._wire_state())]
        return self._found[number] if number < len(self._found) else None

    def close(self) -> None:
        """Keep the lines."""
        with contextlib.suppress(ImportError, OSError):
            import readline

            if self._history is not None:
                readline.set_history_length(LONGEST_HISTORY)
                readline.write_history_file(self._history)


POLL_INTERVAL_S = 0.5


class StatusPoller:
    """The line below. `every_s`: seconds between two looks; 0: never looks, shows what commands brought."""

    def __init__(self, session: Session, every_s: float = POLL_INTERVAL_S) -> None:
        self._session = session
        self._every_s = every_s
        self._trouble = ""
        self._let = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="nomad-shell-watcher", daemon=True)
        if every_s:
            self._thread.start()

    def line(self) -> str:
        """The state in one line, and what went wrong while looking."""
        state = state_text.format_state(self._session.robot.state)
        return f"{self._trouble} | last seen: {state}" if self._trouble else state

    def begin(self) -> None:
        """Look, from now on."""
        self._let.set()

    def pause(self) -> None:
        """Do not look for now."""
        self._let.clear()

    def close(self) -> None:
        """Look no more; comes back when nobody does."""
        self._over.set()
        self._let.set()
        if self._thread.is_alive():
            self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(self._every_s):
            self._let.wait()
            if self._over.is_set() or self._session.user_set_timeout:
                continue
            try:
                self._session.robot.refresh()
                self._trouble = ""
            except NomadError as error:
                self._trouble = str(error)
                if self._session.robot.closed:
                    return


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
    connector = Connector(parse_address(address_or_default(options.address)))
    lines, name = _given(options)
    session = Session(connector.open(), time.sleep)
    with session.robot:
        if lines is not None:
            return _do_all(session, lines, name)
        watcher = StatusPoller(session, 0.0 if connector.address.in_process else POLL_INTERVAL_S)
        keys = reader(lambda: session.wire_state, watcher.line, options.history or default_history(os.environ))
        try:
            return converse(session, keys, watcher)
        finally:
            watcher.close()
            keys.close()


def converse(session: Session, keys: Reader, watcher: StatusPoller) -> int:
    """Read and do, line by line, until somebody leaves; the exit code."""
    print(f"{session.wire_state.model.name}: {watcher.line()}")
    print("help lists all commands; Ctrl-C stops the robot, Ctrl-D leaves")
    while not session.finished:
        try:
            watcher.begin()
            text = keys.read(f"{session.wire_state.model.name}> ")
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
        print_message(str(error))


def _halt_if_moving(session: Session) -> None:
    try:
        if session.robot.refresh().moving:
            print(session.halt())
    except NomadError as error:
        print_message(str(error))


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
    print_message(f"{name}:{number}: {error}")
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
