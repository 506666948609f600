"""Why a step of a mission ended before it was done.

    StepFailed (NomadError)     a step; it may be tried again, and a program may catch it and do something else
    └── MissionOver             the mission; nothing more is driven: its time is over, the robot left the fence, is lost

Rules: `ending` in a word, the message in words.
"""

from __future__ import annotations

from nclient.errors import NomadError


class StepFailed(NomadError):
    """A step ended before it was done."""

    def __init__(self, ending: str, reason: str) -> None:
        self.ending = ending
        super().__init__(reason)


class MissionOver(StepFailed):
    """The mission ended before it was done."""
