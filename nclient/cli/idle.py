"""Whether the one who has a line still says something: what decides that he makes room for another who waits.

    Silence      since when he is silent; whoever waits for an answer that takes its time (ws, zr) is not
    Overheard    the same, learnt from the bytes that pass between him and a robot

Rules: any byte of his counts, those of the robot do not. No I/O; the clock is handed in. The two directions of
Overheard may be heard on two threads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from nclient.backends.nserver import CLICK_S, ORDINARY_S
from nclient.protocol.commands import BY_NAME
from nclient.protocol.types import Model
from nclient.recording.replayer import RequestKey, RequestReader

SILENT_S: Final = 5.0
"""As long as connect() lets a robot wait for its program before it stops by itself."""
NONE: Final = 0.0
"""The limit that lets everybody be silent for ever."""


class IdleTimer:
    """`limit_s`: how long is too long, or NONE; `clock`: seconds. Begins now."""

    def __init__(self, limit_s: float, clock: Callable[[], float]) -> None:
        self._limit_s, self._clock = limit_s, clock
        self._until_s = clock() + limit_s
        self._waits = False

    def heard(self, answer_s: float = 0.0) -> None:
        """He said something. `answer_s`: how long the answer to it may take of its own accord."""
        self._until_s = max(self._until_s, self._clock() + self._limit_s + answer_s)
        self._waits = self._waits or answer_s > 0

    def answered(self) -> None:
        """He was answered, and has no more to wait for."""
        if self._waits:
            self._waits = False
            self._until_s = self._clock() + self._limit_s

    @property
    def expired(self) -> bool:
        """Whether it was longer than the limit."""
        return self._limit_s != NONE and self._clock() >= self._until_s


class IdleMonitor:
    """A conversation in one of recording.follower's LINES. What it hears goes into `silence`."""

    def __init__(self, silence: IdleTimer, line: str, model: Model) -> None:
        self._silence = silence
        self._questions = RequestReader(line, model)
        self._one_at_a_time = threading.Lock()

    def to_robot(self, data: bytes) -> None:
        """He said this."""
        with self._one_at_a_time:
            self._silence.heard(max(map(_answer_s, self._questions.receive(data)), default=0.0))

    def to_host(self, data: bytes) -> None:
        """The robot said this; only a whole frame answers anything."""
        with self._one_at_a_time:
            if not all(frame.wrong for frame in self._questions.ears.to_host(data)):
                self._silence.answered()


def _answer_s(asked: RequestKey) -> float:
    """How long an answer may take besides the way; 0 for what is answered at once."""
    if asked.name == "ws":
        return float(max(0, asked.args[-1]))
    if asked.name == "get_robot_conf":
        return CLICK_S
    row = BY_NAME.get(asked.name)
    return row.line_timeout_s if row and row.line_timeout_s > ORDINARY_S else 0.0
