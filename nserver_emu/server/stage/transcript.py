"""What the robots were told to say: a talking robot's last words, kept to be read out. Pure."""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

KEPT: Final = 1000
"""Utterances kept; older ones are forgotten, so that a robot that chatters for days fills no memory."""


class Utterance(NamedTuple):
    """Who said what, and at which simulated second."""

    time_s: float
    robot_id: int
    text: str


class Transcript:
    """Utterances in their order, the latest last."""

    def __init__(self) -> None:
        self._said: deque[Utterance] = deque(maxlen=KEPT)

    @property
    def said(self) -> tuple[Utterance, ...]:
        """All that is kept."""
        return tuple(self._said)

    def add(self, utterance: Utterance) -> None:
        """Note what was said now."""
        self._said.append(utterance)
