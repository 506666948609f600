"""Reading lines with prompt_toolkit: completion in a menu with what each name is for, history, the state below.

Rules: the only file that knows prompt_toolkit, an extra; terminal.py does without where it is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from prompt_toolkit import PromptSession
from prompt_toolkit.auto_suggest import AutoSuggestFromHistory
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory, History, InMemoryHistory

from nclient.protocol.terms import Terms
from nclient.shell.completion import candidates, hint

REDRAWN_S = 0.5


class Names(Completer):
    """Completion by what completion.py says."""

    def __init__(self, terms: Callable[[], Terms]) -> None:
        self._terms = terms

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
        """Names that the word before the cursor may become."""
        del complete_event
        typed = document.text_before_cursor
        last = document.get_word_before_cursor(WORD=True).rpartition(";")[2].rpartition("(")[2]
        for word, about in candidates(typed, self._terms()):
            yield Completion(word, start_position=-len(last), display_meta=about)


class PromptReader:
    """Lines typed at a terminal; `below`: what stands under them, asked anew twice a second."""

    def __init__(self, terms: Callable[[], Terms], below: Callable[[], str], history: Path | None) -> None:
        kept: History = InMemoryHistory() if history is None else FileHistory(str(history))
        self._below = below
        self._session: PromptSession[str] = PromptSession(
            history=kept, auto_suggest=AutoSuggestFromHistory(), completer=Names(terms),
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
