"""A look at the robot now and then while somebody types, so that the state below the line is of now.

Rules: one thread, which asks gs and nothing else, and only while it is let: a command that runs, or a robot whose time
passes with what is asked, is left alone. What goes wrong is shown, and told by the next command.
"""

from __future__ import annotations

import threading

from nclient.errors import NomadError
from nclient.shell import glance
from nclient.shell.session import Session

LOOK_S = 0.5


class Watcher:
    """The line below. `every_s`: seconds between two looks; 0: never looks, shows what commands brought."""

    def __init__(self, session: Session, every_s: float = LOOK_S) -> None:
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
        state = glance.line(self._session.robot.state)
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
            if self._over.is_set() or self._session.keeps_time_out:
                continue
            try:
                self._session.robot.refresh()
                self._trouble = ""
            except NomadError as error:
                self._trouble = str(error)
                if self._session.robot.closed:
                    return
