"""The seam between the verbs and the languages: who answers a call.

    execute(call) -> reply   close()   and what was agreed: terms, greeting

Rules: a call goes out once, unless a backend says that it retries; an answer belongs to its call or is
nobody's. Whatever wraps a backend (a retry, a speed cap, a log) is a backend again. One thread at a time: Robot locks.
"""

from __future__ import annotations

from typing import Protocol

from nclient.backends.statistics import LinkStatistics
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.terms import Terms


class Backend(Protocol):
    """One conversation with one robot."""

    @property
    def terms(self) -> Terms:
        """What the two ends have agreed: model, mask, laser shape."""
        ...

    @property
    def greeting(self) -> Reply | None:
        """The state that came with connecting, where one did."""
        ...

    @property
    def port(self) -> int:
        """What connecting was answered: the port that the other end takes connections on, 1 where it has none."""
        ...

    @property
    def closed(self) -> bool:
        """Whether the conversation is over; every call then raises ConnectionLost."""
        ...

    @property
    def link(self) -> LinkStatistics | None:
        """What the link has been through; None where nobody counts."""
        ...

    def execute(self, call: Call) -> Reply:
        """Say it and give the answer; for a call that has none, an empty reply.

        Raises RobotRefused (and stays usable), WireError for a call that cannot be sent (nothing was), ConnectionLost
        (and is closed), or ReplyTimeout (and is closed over TCP, usable on a robot's own line: `closed` tells).
        """
        ...

    def close(self) -> None:
        """Say goodbye where the language has a word for it, and leave; never waits for an answer. Twice is fine.

        From another thread than the one in `execute` it just leaves, and that one gets ConnectionLost.
        """
        ...
