"""Why a step of a mission ended before it was done, or all of it, and how that is told.

    StepFailed (NomadError)         a step; it may be tried again, and a program may catch it and do something else
    MissionOver (BaseException)     the mission; nothing more is driven: its time is over, it left the fence, is lost

Rules: `ending` in a word, the message in words. The end of a mission is no error that a program handles on its way: as
KeyboardInterrupt it passes by `except Exception`, and what catches it all the same gets it again from every verb.
"""

from __future__ import annotations

from typing import Final

from nclient.errors import NomadError
from nclient.leaving import Left


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


INTERRUPTED: Final = "interrupted"


def ending_of(error: BaseException) -> tuple[str, str]:
    """How a step or a mission ends that raised this, in a word and in words; what interrupts is Ctrl-C, or a signal."""
    if isinstance(error, StepFailed | MissionOver):
        return error.ending, str(error)
    if isinstance(error, KeyboardInterrupt | Left):
        return INTERRUPTED, error.signal_name if isinstance(error, Left) else "Ctrl-C"
    kind = "" if isinstance(error, NomadError) else type(error).__name__
    return "error", ": ".join(part for part in (kind, str(error)) if part)
