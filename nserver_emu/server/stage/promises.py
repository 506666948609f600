"""Answers that only time can bring: who waits for what, asked each time some time has passed.

Rules: an answer is made at the moment it is there, however long its session takes to fetch it; a promise is asked no
more once it is kept, or once whoever waits has gone. No time passes here.
"""

from __future__ import annotations

from nclient.protocol.replies import Reply
from nserver_emu.server.conversation.session import Later, Visit


class Promise:
    """A Later that holds on to its reply."""

    def __init__(self, visit: Visit, later: Later) -> None:
        self.visit = visit
        self.reply: Reply | None = None
        self._later = later

    def __call__(self) -> Reply | None:
        """The reply, if it is there by now."""
        if self.reply is None:
            self.reply = self._later()
        return self.reply


class Promises:
    """All that is yet to be kept."""

    def __init__(self) -> None:
        self._open: list[Promise] = []

    def __len__(self) -> int:
        return len(self._open)

    def make(self, visit: Visit, later: Later) -> Promise:
        """Note that this connection waits for this answer."""
        promise = Promise(visit, later)
        self._open.append(promise)
        return promise

    def ask(self) -> None:
        """Time has passed: keep those that can be kept."""
        self._open = [promise for promise in self._open if promise() is None]

    def drop(self, visit: Visit) -> None:
        """This connection no longer waits."""
        self._open = [promise for promise in self._open if promise.visit is not visit]
