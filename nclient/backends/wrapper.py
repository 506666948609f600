"""A backend around a backend, which changes nothing: what every wrapper is made from.

Rules: a wrapper overrides `execute`, and whatever else it means to change, and hands on the rest.
"""

from __future__ import annotations

from nclient.backends.backend import Backend
from nclient.backends.statistics import LinkStatistics
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.terms import Terms


class Wrapper:
    """The backend inside, by all of its names."""

    def __init__(self, inner: Backend) -> None:
        self._inner = inner

    @property
    def terms(self) -> Terms:
        """What the two ends have agreed."""
        return self._inner.terms

    @property
    def greeting(self) -> Reply | None:
        """The state that came with connecting, where one did."""
        return self._inner.greeting

    @property
    def port(self) -> int:
        """What connecting was answered."""
        return self._inner.port

    @property
    def closed(self) -> bool:
        """Whether the conversation is over."""
        return self._inner.closed

    @property
    def link(self) -> LinkStatistics | None:
        """What the link has been through, where somebody counts."""
        return self._inner.link

    def execute(self, call: Call) -> Reply:
        """The answer of the backend inside. Raises what it raises."""
        return self._inner.execute(call)

    def close(self) -> None:
        """Close the backend inside."""
        self._inner.close()
