"""Control a robot interactively with the C library's command names.

    nomad shell nserver://localhost:7019/1          type help; Tab completes; Ctrl-C stops the robot; Ctrl-D exits
    nomad shell "sim:thesis_room?seed=1" --script square.nomad
    nomad shell serial:///dev/ttyUSB0 --command "pr 240 0 0; wait; state pose"
    echo "get_sn" | nomad shell

A script has the same lines as typed, with comments after #. A script in a file is checked before anything moves; it
ends at the first line that fails, which is reported as file:line. The robot is stopped at the end in any case.
Exit code 0: done; 1: a line failed, or the robot was lost; 2: wrong usage; 130: Ctrl-C ended a script.
"""

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

from nclient.cli import state_text
from nclient.cli.serving import print_message
from nclient.cli.shell_session import Session, candidates, parse
from nclient.common.arguments import add_address, add_value
from nclient.common.files import read_text
from nclient.common.process import ExitCode
from nclient.connector import Connector, address_or_default
from nclient.errors import NomadError, ShellError
from nclient.protocol.types import WireState
from nclient.url import parse_address

MAX_HISTORY = 2000
"""Maximum number of lines in the history file of readline."""


class Reader(Protocol):
    """Source of typed lines."""

    def read(self, prompt: str) -> str:
        """Return a line. Raises EOFError at its end, KeyboardInterrupt at Ctrl-C."""

    def close(self) -> None:
        """Save the history."""


def open_reader(wire_state: Callable[[], WireState], status: Callable[[], str], history: Path | None) -> Reader:
    """Return the best line editor that is installed.

    Parameters
    ----------
    wire_state
        Returns the state of the connection, which determines the completions.
    status
        Returns the status line, shown below the input by prompt_toolkit only.
    history
        History file, or None for no history.
    """
    if history is not None:
        history = _create_history(history)
    if importlib.util.find_spec("prompt_toolkit") is not None:
        # Imported here because prompt_toolkit is optional.
        from nclient.cli.shell_prompt import PromptReader

        return PromptReader(wire_state, status, history)
    return PlainReader(wire_state, history)


def default_history(environment: Mapping[str, str]) -> Path:
    """Return the history file: $XDG_STATE_HOME/nomad/history, default ~/.local/state/nomad/history."""
    state = environment.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "nomad" / "history"


def _create_history(history: Path) -> Path | None:
    """Create the history file if needed; return None with a message if it cannot be written."""
    try:
        # Readable by the user alone.
        history.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(history, os.O_RDWR | os.O_CREAT, 0o600))
    except OSError as error:
        print(f"nomad: no history is saved: {history}: {error.strerror}", file=sys.stderr)
        return None
    return history


class PlainReader:
    """Reads lines with input(), and with readline's editing, history and completion if the system has it."""

    def __init__(self, wire_state: Callable[[], WireState], history: Path | None) -> None:
        self._wire_state = wire_state
        self._history = history
        self._found: list[str] = []
        # Windows has no readline.
        with contextlib.suppress(ImportError):
            import readline

            readline.set_completer(self.complete)
            readline.set_completer_delims(" \t;(,")
            libedit = "libedit" in (readline.__doc__ or "")
            readline.parse_and_bind("bind ^I rl_complete" if libedit else "tab: complete")
            if history is not None:
                with contextlib.suppress(OSError):
                    readline.read_history_file(history)

    def read(self, prompt: str) -> str:
        """Return a line. Raises EOFError at Ctrl-D, KeyboardInterrupt at Ctrl-C."""
        return input(prompt)

    def complete(self, word: str, number: int) -> str | None:
        """Return completion `number` of a word; readline calls this with 0, 1, ... until it gets None."""
        # All completions are found at the first call, for the state of the line at that time.
        if number == 0:
            import readline

            typed = readline.get_line_buffer()[: readline.get_endidx()]
            self._found = [candidate.word for candidate in candidates(typed or word, self._wire_state())]
        return self._found[number] if number < len(self._found) else None

    def close(self) -> None:
        """Save the history."""
        with contextlib.suppress(ImportError, OSError):
            import readline

            if self._history is not None:
                readline.set_history_length(MAX_HISTORY)
                readline.write_history_file(self._history)


# Interval of queries for the status line, seconds.
POLL_INTERVAL_S = 0.5


class StatusPoller:
    """Polls the state in a thread while the prompt waits for input.

    Parameters
    ----------
    session
        The shell's session.
    every_s
        Interval in seconds; 0 to show only the state after commands.
    """

    def __init__(self, session: Session, every_s: float = POLL_INTERVAL_S) -> None:
        self._session = session
        self._every_s = every_s
        self._error = ""
        self._enabled = threading.Event()
        # Start or continue polling; interrupt it.
        self.begin, self.pause = self._enabled.set, self._enabled.clear
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._poll, name="nomad-shell-poller", daemon=True)
        if every_s:
            self._thread.start()

    def line(self) -> str:
        """Return the state in one line, with the last error of polling."""
        state = state_text.format_state(self._session.robot.state)
        return f"{self._error} | last known: {state}" if self._error else state

    def close(self) -> None:
        """End polling, and wait for the thread."""
        self._ended.set()
        self._enabled.set()
        if self._thread.is_alive():
            self._thread.join()

    def _poll(self) -> None:
        while not self._ended.wait(self._every_s):
            self._enabled.wait()
            # After conf_tm polling would keep the motion timeout from working.
            if self._ended.is_set() or self._session.user_set_timeout:
                continue
            try:
                self._session.robot.refresh()
                self._error = ""
            except NomadError as error:
                self._error = str(error)
                if self._session.robot.closed:
                    return


STDIN = "-"
MAX_BYTES: Final = 1 << 20
"""Maximum size of a script; a larger file is something else."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_address(parser)
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--script", metavar="FILE", help="execute the lines of FILE and exit; - reads stdin")
    source.add_argument("--command", "-c", metavar="LINE", help="execute LINE and exit")
    add_value(parser, "--history", "FILE", Path, "save typed lines to FILE (default: ~/.local/state/nomad/history)")


def run(options: argparse.Namespace) -> int:
    """Run the shell or the script, and return the exit code."""
    # 1. Robot and session; a script, or the prompt.
    connector = Connector(parse_address(address_or_default(options.address)))
    lines, name = _script_lines(options)
    session = Session(connector.open(), time.sleep, lockstep=connector.address.in_process)
    with session.robot:
        if lines is not None:
            return _execute_script(session, lines, name)
        # 2. A simulation in this process advances with each query: no polling there.
        poller = StatusPoller(session, 0.0 if connector.address.in_process else POLL_INTERVAL_S)
        keys = open_reader(lambda: session.wire_state, poller.line, options.history or default_history(os.environ))
        try:
            return converse(session, keys, poller)
        finally:
            poller.close()
            keys.close()


def converse(session: Session, keys: Reader, poller: StatusPoller) -> int:
    """Read and execute lines until the end of input or `quit`, and return the exit code."""
    print(f"{session.wire_state.model.name}: {poller.line()}")
    print("help lists all commands; Ctrl-C stops the robot, Ctrl-D exits")
    while not session.finished:
        try:
            poller.begin()
            text = keys.read(f"{session.wire_state.model.name}> ")
        except EOFError:
            break
        except KeyboardInterrupt:
            text = ""
            _stop_if_moving(session)
        finally:
            poller.pause()
        _execute_line(session, text)
        if session.robot.closed:
            return ExitCode.FAILED
    return ExitCode.DONE


def _execute_line(session: Session, text: str) -> None:
    try:
        _show(session.run(text))
    except KeyboardInterrupt:
        print()
        _stop_if_moving(session)
    except NomadError as error:
        print_message(str(error))


def _stop_if_moving(session: Session) -> None:
    try:
        if session.robot.refresh().moving:
            print(session.halt())
    except NomadError as error:
        print_message(str(error))


def _execute_script(session: Session, lines: Iterable[str], name: str) -> int:
    """Execute a script up to the first line that fails, and return the exit code."""
    def execute(text: str) -> None:
        _show(session.run(text))

    # Lines from stdin cannot be checked in advance: they may be typed by another program as it goes.
    for process in (session.check, execute) if isinstance(lines, list) else (execute,):
        for number, text in enumerate(lines, 1):
            try:
                process(text)
            except NomadError as error:
                print_message(f"{name}:{number}: {error}")
                return ExitCode.FAILED
            if session.finished:
                break
    return ExitCode.DONE


def _show(lines: Iterator[str]) -> None:
    for line in lines:
        print(line, flush=True)


def _script_lines(options: argparse.Namespace) -> tuple[Iterable[str] | None, str]:
    """Return the lines of a script and its name, None if lines are typed. A file is read as a whole, stdin by lines.

    Raises
    ------
    ShellError
        If the file cannot be read, or has a line that cannot be parsed.
    """
    if options.command is not None:
        return [options.command], "--command"
    if options.script == STDIN or (options.script is None and not sys.stdin.isatty()):
        return (line for line in sys.stdin), "stdin"
    if options.script is None:
        return None, ""
    lines = read_text(Path(options.script), MAX_BYTES, ShellError).splitlines()
    for number, line in enumerate(lines, 1):
        try:
            parse(line)
        except ShellError as error:
            raise ShellError(f"{options.script}:{number}: {error}") from None
    return lines, options.script
