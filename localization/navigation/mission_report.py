"""Outcome of a mission and its steps: exceptions, values, JSON and text.

    StepFailed (NomadError)         a step failed; it may be retried, and a program may catch it
    MissionOver (BaseException)     the mission is over; nothing more is driven

MissionOver is raised on timeout, outside the fence and when lost. Like KeyboardInterrupt it passes `except Exception`;
a program that catches it anyway gets it again from the next step. Times are of the robot's clock, from the start of
the mission.
"""

from dataclasses import dataclass, field
from math import degrees
from typing import Any, Final

from localization.filters.belief import wrap_angle
from localization.live.log import Pose
from nclient.common.process import TerminatedBySignal
from nclient.errors import NomadError

DONE: Final = "done"
INTERRUPTED: Final = "interrupted"


class StepFailed(NomadError):
    """A step ended before it was done; `ending` is one word."""

    def __init__(self, ending: str, reason: str) -> None:
        self.ending = ending
        super().__init__(reason)


class MissionOver(BaseException):
    """The mission ended before it was done; `ending` is one word."""

    def __init__(self, ending: str, reason: str) -> None:
        self.ending = ending
        super().__init__(reason)


def ending_of(error: BaseException) -> tuple[str, str]:
    """Return how a step or mission that raised this ended: one word, and the reason as text."""
    # 1. Failures that the mission itself reports.
    if isinstance(error, StepFailed | MissionOver):
        return error.ending, str(error)
    # 2. Ctrl-C or a signal.
    if isinstance(error, KeyboardInterrupt | TerminatedBySignal):
        return INTERRUPTED, error.signal_name if isinstance(error, TerminatedBySignal) else "Ctrl-C"
    # 3. Anything else; a NomadError explains itself, of other errors the type is needed.
    kind = "" if isinstance(error, NomadError) else type(error).__name__
    return "error", ": ".join(part for part in (kind, str(error)) if part)


@dataclass
class Step:
    """One step of a mission.

    Attributes
    ----------
    name, arguments
        The step's name, such as "go_to", and its arguments as text.
    began_s, ended_s
        Seconds since the start of the mission.
    ending, reason
        "done", or why not in one word (an Ending of the pilot, timeout, fence, condition, interrupted, error); the
        reason as text.
    tries, touches, plans
        Number of attempts, contacts and plans.
    driven_in, planned_in
        Distance driven; length of the first plan.
    notes
        Pairs of seconds and text.
    """

    name: str
    arguments: str
    began_s: float
    ended_s: float = 0.0
    ending: str = ""
    reason: str = ""
    tries: int = 0
    driven_in: float = 0.0
    touches: int = 0
    plans: int = 0
    planned_in: float = 0.0
    notes: list[tuple[float, str]] = field(default_factory=list)

    @property
    def done(self) -> bool:
        """True if the step was completed."""
        return self.ending == DONE

    def line(self) -> str:
        """Return the step as one line of text."""
        # Three words of equal width, so that the columns stay aligned.
        ended = "done  " if self.done else INTERRUPTED if self.ending == INTERRUPTED else "FAILED"
        text = f"{self.began_s:7.1f} s  {ended}  {self.name} {self.arguments}".rstrip()
        details = [f"{self.ended_s - self.began_s:.1f} s", f"{self.driven_in:.0f} in"]
        details += [f"{self.tries} tries"] * (self.tries > 1) + [f"{self.touches} touches"] * (self.touches > 0)
        details += [f"planned {self.plans} times"] * (self.plans > 1)
        return f"{text}  ({', '.join(details)})" + ("" if self.done else f": {self.reason}")

    def as_json(self) -> dict[str, Any]:
        """Return the step as plain data; the keys are documented in docs/missions.md."""
        return {
            "do": self.name,
            "what": self.arguments,
            "ending": self.ending,
            "reason": self.reason,
            "began_s": round(self.began_s, 3),
            "duration_s": round(self.ended_s - self.began_s, 3),
            "tries": self.tries,
            "way_in": round(self.driven_in, 2),
            "touches": self.touches,
            "plans": self.plans,
            "planned_in": round(self.planned_in, 2),
            "notes": [{"at_s": round(at, 3), "words": words} for at, words in self.notes],
        }


@dataclass
class Report:
    """Report of a mission.

    Attributes
    ----------
    steps, ending, reason, duration_s
        The steps, and how the mission ended.
    pose, std
        Final estimate and its standard deviations (in, in, rad).
    truth
        Final true pose, of simulated robots.
    hint
        Hint that the readings do not fit the assumed sonar model; "" if they do.
    """

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
        """True if the whole mission was completed."""
        return self.ending == DONE

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain data: inches, seconds, degrees."""
        return {
            "title": self.title,
            "ending": self.ending,
            "reason": self.reason,
            "duration_s": round(self.duration_s, 3),
            "way_in": round(sum(step.driven_in for step in self.steps), 2),
            "touches": sum(step.touches for step in self.steps),
            "pose": _pose_as_json(self.pose),
            "std": _pose_as_json(self.std),
            "truth": _pose_as_json(self.truth),
            "hint": self.hint or None,
            "steps": [step.as_json() for step in self.steps],
        }

    def text(self) -> str:
        """Return the report as text."""
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
            lines.append(f"           true pose ({x:.1f}, {y:.1f}) in, {_degrees(heading):.0f} deg")
        lines += [self.hint] * bool(self.hint)
        return "\n".join(lines)


def _pose_as_json(pose: Pose | None) -> dict[str, float] | None:
    if pose is None:
        return None
    return {"x_in": round(pose[0], 3), "y_in": round(pose[1], 3), "heading_deg": round(_degrees(pose[2]), 3)}


def _degrees(heading_rad: float) -> float:
    """Return degrees in [-180, 180], for encoders and estimates alike."""
    return degrees(wrap_angle(heading_rad))
