"""Why a step of a mission ended before it was done, or all of it, and how that is told.

    StepFailed (NomadError)         a step; it may be tried again, and a program may catch it and do something else
    MissionOver (BaseException)     the mission; nothing more is driven: its time is over, it left the fence, is lost

Rules: `ending` in a word, the message in words. The end of a mission is no error that a program handles on its way: as
KeyboardInterrupt it passes by `except Exception`, and what catches it all the same gets it again from every verb.

What became of a mission, step by step: values, their JSON, and lines for people.

Rules: values and words; no robot, no file. Times are of the robot's clock, from the start of the mission.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import degrees
from typing import Any, Final

from localization.filters.belief import wrap_angle
from localization.live.run import Pose
from nclient.common.process import TerminatedBySignal
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


INTERRUPTED: Final = "interrupted"


def ending_of(error: BaseException) -> tuple[str, str]:
    """How a step or a mission ends that raised this, in a word and in words; what interrupts is Ctrl-C, or a signal."""
    if isinstance(error, StepFailed | MissionOver):
        return error.ending, str(error)
    if isinstance(error, KeyboardInterrupt | TerminatedBySignal):
        return INTERRUPTED, error.signal_name if isinstance(error, TerminatedBySignal) else "Ctrl-C"
    kind = "" if isinstance(error, NomadError) else type(error).__name__
    return "error", ": ".join(part for part in (kind, str(error)) if part)


@dataclass
class Step:
    """One step. `ending`: "done", or why not in a word (planning.pilot's endings, timeout, fence, condition,
    interrupted, error); `reason` in words; `planned_in`, the length of its first plan; `notes`: (seconds, words)."""

    verb: str
    words: str
    began_s: float
    ended_s: float = 0.0
    ending: str = ""
    reason: str = ""
    tries: int = 0
    way_in: float = 0.0
    touches: int = 0
    plans: int = 0
    planned_in: float = 0.0
    notes: list[tuple[float, str]] = field(default_factory=list)

    @property
    def done(self) -> bool:
        """Whether it did what it was to do."""
        return self.ending == DONE

    def line(self) -> str:
        """In one line."""
        ended = "done  " if self.done else INTERRUPTED if self.ending == INTERRUPTED else "FAILED"
        text = f"{self.began_s:7.1f} s  {ended}  {self.verb} {self.words}".rstrip()
        more = [f"{self.ended_s - self.began_s:.1f} s", f"{self.way_in:.0f} in"]
        more += [f"{self.tries} tries"] * (self.tries > 1) + [f"{self.touches} touches"] * (self.touches > 0)
        more += [f"planned {self.plans} times"] * (self.plans > 1)
        return f"{text}  ({', '.join(more)})" + ("" if self.done else f": {self.reason}")


DONE = "done"


@dataclass
class Report:
    """Of a mission: its steps, and how it ended as a whole; `pose` as estimated at the end, `truth` where known;
    `hint`: where readings do not fit what the sonars are taken for."""

    title: str
    steps: list[Step] = field(default_factory=list)
    ending: str = ""
    reason: str = ""
    duration_s: float = 0.0
    pose: Pose | None = None
    std: Pose | None = None
    truth: Pose | None = None
    hint: str = ""

    @property
    def done(self) -> bool:
        """Whether all of it was done."""
        return self.ending == DONE

    def as_json(self) -> dict[str, Any]:
        """As plain data: inches, seconds, and degrees where it says so."""
        return {
            "title": self.title,
            "ending": self.ending,
            "reason": self.reason,
            "duration_s": round(self.duration_s, 3),
            "way_in": round(sum(step.way_in for step in self.steps), 2),
            "touches": sum(step.touches for step in self.steps),
            "pose": _pose(self.pose),
            "std": _pose(self.std),
            "truth": _pose(self.truth),
            "hint": self.hint or None,
            "steps": [_step(step) for step in self.steps],
        }

    def text(self) -> str:
        """For people."""
        lines = [self.title] if self.title else []
        for step in self.steps:
            lines.append(step.line())
            lines += [f"{at:7.1f} s          {words}" for at, words in step.notes]
        where = ""
        if self.pose:
            where = f" at ({self.pose[0]:.1f}, {self.pose[1]:.1f}) in, {_degrees(self.pose[2]):.0f} deg"
        lines.append(f"{self.duration_s:7.1f} s  {self.ending}{where}" + (f": {self.reason}" if self.reason else ""))
        if self.truth:
            x, y, heading = self.truth
            lines.append(f"           in truth at ({x:.1f}, {y:.1f}) in, {_degrees(heading):.0f} deg")
        lines += [self.hint] * bool(self.hint)
        return "\n".join(lines)


def _pose(pose: Pose | None) -> dict[str, float] | None:
    if pose is None:
        return None
    return {"x_in": round(pose[0], 3), "y_in": round(pose[1], 3), "heading_deg": round(_degrees(pose[2]), 3)}


def _degrees(heading_rad: float) -> float:
    """From -180 to 180, of encoders and of estimates alike."""
    return degrees(wrap_angle(heading_rad))


def _step(step: Step) -> dict[str, Any]:
    return {
        "do": step.verb,
        "what": step.words,
        "ending": step.ending,
        "reason": step.reason,
        "began_s": round(step.began_s, 3),
        "duration_s": round(step.ended_s - step.began_s, 3),
        "tries": step.tries,
        "way_in": round(step.way_in, 2),
        "touches": step.touches,
        "plans": step.plans,
        "planned_in": round(step.planned_in, 2),
        "notes": [{"at_s": round(at, 3), "words": words} for at, words in step.notes],
    }
