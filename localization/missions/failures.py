"""Why a step of a mission ended before it was done, or all of it.

    StepFailed (NomadError)         a step; it may be tried again, and a program may catch it and do something else
    MissionOver (BaseException)     the mission; nothing more is driven: its time is over, it left the fence, is lost

Rules: `ending` in a word, the message in words. The end of a mission is no error that a program handles on its way: as
KeyboardInterrupt it passes by `except Exception`, and what catches it all the same gets it again from every verb.
"""

from __future__ import annotations

from nclient.errors import NomadError


class StepFailed(NomadError):
    """A step ended before it was done."""

    def __init__(self, ending: str, reason: str) -> None:
        self.ending = ending
        super().__init__(reason)


class MissionOver(BaseException):
    """The mission ended before it was done."""

    def __init__(self, ending: str, reason: str) -> None:
        self.ending = ending
        super().__init__(reason)
