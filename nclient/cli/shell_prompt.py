"""Line editor of the shell with prompt_toolkit (extra `shell`): completion, history, and a status line.

A module of its own because prompt_toolkit is optional; without it the shell uses input() and readline.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from prompt_toolkit import PromptSession
from prompt_toolkit.auto_suggest import AutoSuggestFromHistory
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory, History, InMemoryHistory

from nclient.cli.shell_session import candidates, hint
from nclient.protocol.types import WireState

REFRESH_S = 0.5
"""Interval at which the status line is drawn."""


class CommandCompleter(Completer):
    """Completes command names and parts of the state."""

    def __init__(self, wire_state: Callable[[], WireState]) -> None:
        self._wire_state = wire_state

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
        """Yield the completions of the word before the cursor."""
        del complete_event
        typed = document.text_before_cursor
        # Replace the part of the word behind the last ; or (.
        last = document.get_word_before_cursor(WORD=True).rpartition(";")[2].rpartition("(")[2]
        for word, about in candidates(typed, self._wire_state()):
            yield Completion(word, start_position=-len(last), display_meta=about)


class PromptReader:
    """Reads lines from a terminal.

    Parameters
    ----------
    wire_state
        Returns the state of the connection, which determines the completions.
    status
        Returns the status line, drawn below the input.
    history
        History file, or None for a history in memory.
    """

    def __init__(self, wire_state: Callable[[], WireState], status: Callable[[], str], history: Path | None) -> None:
        past_lines: History = InMemoryHistory() if history is None else FileHistory(str(history))
        self._status = status
        self._session: PromptSession[str] = PromptSession(
            history=past_lines, auto_suggest=AutoSuggestFromHistory(), completer=CommandCompleter(wire_state),
            complete_while_typing=False, bottom_toolbar=self._toolbar, refresh_interval=REFRESH_S,
        )

    def read(self, prompt: str) -> str:
        """Return a line. Raises EOFError at Ctrl-D, KeyboardInterrupt at Ctrl-C."""
        return self._session.prompt(prompt)

    def close(self) -> None:
        """Do nothing: the history is saved line by line."""

    def _toolbar(self) -> str:
        """Return the usage of the command being typed, and the status line."""
        usage = hint(self._session.default_buffer.document.text_before_cursor)
        return f"{usage}\n{self._status()}" if usage else self._status()
