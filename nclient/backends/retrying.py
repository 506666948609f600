"""A backend that asks again: questions and settings, which may be asked twice; never a motion, which would be two.

Rules: again after ReplyTimeout, and after a NAK, which may have meant a request that was corrupted on its way. Not
after ConnectionLost: who lost the robot hears of it.
"""

from __future__ import annotations

from nclient.backends.backend import Backend
from nclient.backends.wrapper import Wrapper
from nclient.errors import ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply

DEFAULT_RETRIES = 2
_QUESTIONS_AND_SETTINGS = ("get_", "conf_")
_OTHERS = frozenset({"gs", "ct", "sp", "ac", "st", "lp"})


def may_be_repeated(name: str) -> bool:
    """Whether a command said twice does what it does said once: questions, settings, and to stop."""
    return name.startswith(_QUESTIONS_AND_SETTINGS) or name in _OTHERS


class Retrying(Wrapper):
    """Asks up to `retries` times more."""

    def __init__(self, inner: Backend, retries: int) -> None:
        super().__init__(inner)
        self._retries = retries

    def execute(self, call: Call) -> Reply:
        """The first answer; what the last try raised where there is none."""
        for _ in range(self._retries if may_be_repeated(call.name) else 0):
            try:
                return self._inner.execute(call)
            except ReplyTimeout:
                if self._inner.closed:
                    raise
            except RobotRefused as refusal:
                if not refusal.is_nak:
                    raise
            if self.link is not None:
                self.link.retries += 1
        return self._inner.execute(call)
