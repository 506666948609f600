"""Where typed lines come from: prompt_toolkit where it is installed, else the standard library's readline or less.

Rules: who reads is decided once, at the start. History is a file of the user's own, readable by nobody else.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from nclient.protocol.terms import Terms
from nclient.shell.completion import candidates

LONGEST_HISTORY = 2000


class Reader(Protocol):
    """Who reads lines."""

    def read(self, prompt: str) -> str:
        """A line. Raises EOFError at its end, KeyboardInterrupt at Ctrl-C."""
        ...

    def close(self) -> None:
        """Keep what is to be kept."""
        ...


def reader(terms: Callable[[], Terms], below: Callable[[], str], history: Path | None) -> Reader:
    """Who reads from this terminal; `below`: the line to show under what is typed, where that can be."""
    if history is not None:
        history = _prepared(history)
    if importlib.util.find_spec("prompt_toolkit") is not None:
        from nclient.shell.prompting import PromptReader  # an extra

        return PromptReader(terms, below, history)
    return PlainReader(terms, history)


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

    def __init__(self, terms: Callable[[], Terms], history: Path | None) -> None:
        self._terms = terms
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
            self._found = [candidate.word for candidate in candidates(typed or word, self._terms())]
        return self._found[number] if number < len(self._found) else None

    def close(self) -> None:
        """Keep the lines."""
        with contextlib.suppress(ImportError, OSError):
            import readline

            if self._history is not None:
                readline.set_history_length(LONGEST_HISTORY)
                readline.write_history_file(self._history)
