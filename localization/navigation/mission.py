"""A mission: its outcome, and the steps that a program calls: go_to, follow, turn, look, wait_for, patrol, dock, note.

    def mission(robot):
        robot.go_to(60, 40, heading_deg=90)
        robot.wait_for(lambda seen: seen.nearest_in < 20, limit_s=30)
        robot.patrol([(60, 40), (0, 0)], rounds=2)

Each step returns when it is done and raises StepFailed when it cannot be; `limit_s` (seconds of the robot's clock) and
`retries` apply to each. Time passes only in periods of the controller, so every step ends: by itself, by its limit or
the mission's, by the fence, or because the robot is lost. Arguments are checked first (pilot.py). The
exception that ended a mission (MissionOver, Ctrl-C) is stored, and every later step except `note` raises it again, so a
program that caught it drives no farther.

The outcome of a mission and its steps is exceptions, values, JSON and text.

    StepFailed (NomadError)         a step failed; it may be retried, and a program may catch it
    MissionOver (BaseException)     the mission is over; nothing more is driven

MissionOver is raised on timeout, outside the fence and when lost. Like KeyboardInterrupt it passes `except Exception`;
a program that catches it anyway gets it again from the next step. Times are of the robot's clock, from the start of
the mission.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import cycle
from math import cos, degrees, hypot, inf, radians, sin
from typing import Any, Final, NamedTuple

from localization.filters.belief import Floats, wrap_angle
from localization.live.sensor_input import Pose
from localization.navigation import path, pilot
from localization.navigation.control_law import STAND, RecoveryBehavior, VelocityCommand
from localization.navigation.obstacles import position_std_in
from localization.navigation.pilot import Ending, Observation, OnLost, Pilot, Point, RobotController, Settings
from localization.navigation.waypoints import PERIOD_S
from nclient.common.process import TerminatedBySignal
from nclient.errors import MissionFileError, NomadError
from worlds.geometry import inside, polygon_segments

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
            "do": self.name, "what": self.arguments, "ending": self.ending, "reason": self.reason,
            "began_s": round(self.began_s, 3), "duration_s": round(self.ended_s - self.began_s, 3), "tries": self.tries,
            "way_in": round(self.driven_in, 2), "touches": self.touches, "plans": self.plans,
            "planned_in": round(self.planned_in, 2),
            "notes": [{"at_s": round(at, 3), "words": words} for at, words in self.notes],
        }  # fmt: skip


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
            "title": self.title, "ending": self.ending, "reason": self.reason, "duration_s": round(self.duration_s, 3),
            "way_in": round(sum(step.driven_in for step in self.steps), 2),
            "touches": sum(step.touches for step in self.steps), "pose": _pose_as_json(self.pose),
            "std": _pose_as_json(self.std), "truth": _pose_as_json(self.truth), "hint": self.hint or None,
            "steps": [step.as_json() for step in self.steps],
        }  # fmt: skip

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


__all__ = ["Mission", "MissionOver", "OnLost", "Seen", "Settings", "StepFailed", "run_mission"]

HALT_S: Final = 2.0
"""An axis at its top speed stops within this time."""
RING_S: Final = 1.0
"""All sixteen sonars measure once in this time."""
UNMOVED_S: Final = 5.0
"""A robot that can move has moved after being commanded for this time."""
DOCK_IN: Final = 12.0
"""Distance from the dock at which docking begins."""
DOCK_IN_S: Final = 2.0
DOCKED_IN: Final = 0.5


class Seen(NamedTuple):
    """Estimate and sensor readings at one time, as conditions and programs use them."""

    clock_s: float
    x_in: float
    y_in: float
    heading_deg: float
    std_in: float
    trust: str
    sonars_in: tuple[int, ...]
    touching: bool
    bumpers: tuple[int, ...]
    finds: int
    """Number of confirmed obstacles that are not in the map."""

    @property
    def nearest_in(self) -> int:
        """Shortest reading of the sonar ring."""
        return min(self.sonars_in)


Condition = Callable[[Seen], bool]


class Mission:
    """The robot as a mission program uses it; `report` contains what was done."""

    def __init__(self, controller: RobotController, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self._controller = controller
        self.report = Report(self.settings.title)
        self.ended: BaseException | None = None
        """The exception that ended the mission early: MissionOver, or one that is no Exception, such as Ctrl-C.
        A sys.exit of the program is an error of the program (mission_steps.py)."""
        self._began_s, self._step_ends_s = controller.clock_s, inf
        self._fence = polygon_segments(self.settings.fence_in) if self.settings.fence_in else None
        if self._fence is not None:
            controller.add_fence(self._fence)
        self._step: Step | None = None
        self._is_unmoved_noted = False
        self._encoders = controller.last.state.x_in, controller.last.state.y_in
        controller.observers.append(self._check_period)

    @property
    def seen(self) -> Seen:
        """Current estimate and readings, without asking the robot."""
        estimate, state = self._controller.last
        x, y, heading = (float(value) for value in estimate.pose)
        return Seen(self._controller.clock_s - self._began_s, x, y, degrees(heading), position_std_in(estimate),
                    estimate.health.status.value, state.sonars_in, state.touching, state.bumpers,
                    len(self._controller.obstacles.confirmed))  # fmt: skip

    # steps

    def go_to(self, x_in: float, y_in: float, heading_deg: float | None = None, *, limit_s: float = inf,
              retries: int = 0, within_in: float = 1.0) -> Seen:  # fmt: skip
        """Drive to a point by the shortest path, and turn to the heading if one is given."""
        pilot.check_arguments("go_to", x_in=x_in, y_in=y_in, heading_deg=heading_deg, within_in=within_in,
                              limit_s=limit_s, retries=retries)  # fmt: skip
        words = f"({x_in:g}, {y_in:g})" + ("" if heading_deg is None else f" {heading_deg:g} deg")
        heading = None if heading_deg is None else radians(heading_deg)
        return self._run_step("go_to", words, lambda: self._drive([(x_in, y_in)], heading, within_in), limit_s, retries)

    def follow(self, points_in: Sequence[Point], *, limit_s: float = inf, retries: int = 0,
               within_in: float = 1.0) -> Seen:  # fmt: skip
        """Drive along straight lines between points, passing all but the last, where the robot stops."""
        goals = pilot.read_points("follow", points_in)
        pilot.check_arguments("follow", within_in=within_in, limit_s=limit_s, retries=retries)
        drive = partial(self._drive, goals, None, within_in)
        return self._run_step("follow", _format_points(goals), drive, limit_s, retries)

    def turn(self, heading_deg: float | None = None, *, by_deg: float | None = None, limit_s: float = inf,
             retries: int = 0) -> Seen:  # fmt: skip
        """Turn in place: to a heading by the smaller turn, or by an angle, counter-clockwise positive."""
        pilot.check_arguments("turn", heading_deg=heading_deg, by_deg=by_deg, limit_s=limit_s, retries=retries)
        if (heading_deg is None) == (by_deg is None):
            raise MissionFileError("turn: expected heading_deg or by_deg, one of them")
        remaining: Callable[[float], float]
        if by_deg is not None:
            words, remaining = f"by {by_deg:g} deg", path.TurnProgress(self._heading_rad, radians(by_deg)).remaining_rad
        else:
            target_rad = radians(heading_deg or 0.0)
            words, remaining = f"to {heading_deg:g} deg", partial(path.angle_difference, second_rad=target_rad)
        return self._run_step("turn", words, lambda: self._turn(remaining), limit_s, retries)

    def look(self, seconds: float = RING_S) -> Seen:
        """Stand for a time and return the readings."""
        pilot.check_arguments("look", seconds=seconds)
        return self._run_step("look", f"{seconds:g} s", lambda: self._stand(seconds), inf, 0)

    def wait_for(self, condition: Condition, limit_s: float, words: str = "a condition") -> Seen:
        """Stand until the condition holds. Raises StepFailed if it does not within the limit."""
        pilot.check_arguments("wait_for", condition=condition, limit_s=limit_s, words=words)
        return self._run_step("wait_for", words, lambda: self._wait_for(condition, limit_s, words), inf, 0)

    def patrol(self, points_in: Sequence[Point], rounds: int = 1, *, limit_s: float = inf, retries: int = 0) -> Seen:
        """Drive to each of the points by the shortest paths, `rounds` times; each point is a step of its own."""
        goals = pilot.read_points("patrol", points_in)
        pilot.check_arguments("patrol", rounds=rounds, limit_s=limit_s, retries=retries)
        for number in range(rounds):
            for point in goals:
                words = f"({point[0]:g}, {point[1]:g}), round {number + 1} of {rounds}"
                self._run_step("patrol", words, partial(self._drive, [point], None, 1.0), limit_s, retries)
        return self.seen

    def dock(self, x_in: float, y_in: float, heading_deg: float, *, limit_s: float = inf, retries: int = 0) -> Seen:
        """Drive to a point before the dock, turn to it, and drive in slowly until the dock or a contact."""
        pilot.check_arguments("dock", x_in=x_in, y_in=y_in, heading_deg=heading_deg, limit_s=limit_s, retries=retries)
        words = f"({x_in:g}, {y_in:g}) {heading_deg:g} deg"
        return self._run_step("dock", words, lambda: self._dock((x_in, y_in), radians(heading_deg)), limit_s, retries)

    def note(self, words: str) -> None:
        """Write a text into the report."""
        now_s = self._controller.clock_s - self._began_s
        self.report.steps.append(Step("note", str(words), now_s, now_s, DONE))

    # running a step

    def _run_step(self, name: str, words: str, act: Callable[[], None], limit_s: float, retries: int) -> Seen:
        """Run a step with its retries, report it and return what is seen.

        Raises StepFailed, and the exception that ended the mission.
        """
        # A program that catches MissionOver gets it again from its next step.
        if self.ended is not None:
            raise self.ended
        if self._step is not None:
            raise StepFailed("error", f"{name} inside of {self._step.name}: one step at a time")
        with self._reported(name, words) as step:
            while not self._try_step(step, act, limit_s, is_last=step.tries >= retries):
                self._controller.period()
        return self.seen

    def _try_step(self, step: Step, act: Callable[[], None], limit_s: float, *, is_last: bool) -> bool:
        """Return True if an attempt succeeds. Raises StepFailed if the last one fails."""
        step.tries += 1
        self._step_ends_s = self._controller.clock_s + limit_s
        try:
            act()
        except StepFailed as failure:
            if is_last:
                raise
            self._note(f"{failure}; trying again")
            return False
        return True

    @contextmanager
    def _reported(self, name: str, words: str) -> Iterator[Step]:
        """Add a step to the report and record how it ends."""
        self._step = step = Step(name, words, self._controller.clock_s - self._began_s)
        self.report.steps.append(step)
        try:
            yield step
            step.ending = DONE
        except BaseException as error:
            # Exceptions that are no Exception end the mission, except sys.exit, which is an error of the program.
            step.ending, step.reason = ending_of(error)
            if not isinstance(error, Exception) and (step.ending == INTERRUPTED or not isinstance(error, SystemExit)):
                self.ended = error
            raise
        finally:
            step.ended_s = self._controller.clock_s - self._began_s
            self._step, self._step_ends_s = None, inf

    def _drive(self, goals: Sequence[Point], heading_rad: float | None, within_in: float) -> None:
        """Drive to goals; if the robot gets lost, recover and continue with the remaining ones."""
        remaining: Sequence[Point] = list(goals)
        while True:
            # 1. Plan and drive with the remaining goals.
            controller = self._controller
            driver = Pilot(controller.planner, controller.limits, controller.obstacles, remaining, heading_rad,
                           pilot.RetryPolicy(within_in))  # fmt: skip
            ending, reason = self._run_pilot(driver)
            self._halt()
            # 2. Arrived, failed, or lost: only the last one is recovered from.
            if ending is Ending.ARRIVED:
                return
            if ending is not Ending.LOST:
                raise StepFailed(ending.value, reason)
            self._recover(reason)
            remaining = driver.remaining_goals

    def _run_pilot(self, driver: Pilot) -> pilot.PilotResult:
        """Run a pilot to its result, and copy its log into the report."""
        try:
            while True:
                command = driver.step(*self._controller.last)
                if driver.result:
                    return driver.result
                self._controller.period(command)
        finally:
            if self._step:
                # The first plan's length is reported; counts add up over attempts.
                if not self._step.plans and driver.log.plans:
                    self._step.planned_in = driver.log.plans[0].length_in
                self._step.plans += len(driver.log.plans)
                self._step.touches += len(driver.log.touches)
                self._step.notes += [(at - self._began_s, words) for at, words in driver.log.notes]

    @property
    def _heading_rad(self) -> float:
        return float(self._controller.last.estimate.pose[2])

    @property
    def _is_lost(self) -> bool:
        return self._controller.last.estimate.health.is_lost

    def _turn(self, remaining_rad: Callable[[float], float]) -> None:
        """Turn in place until `remaining_rad(heading)` is nearly 0."""
        while True:
            if self._is_lost:
                self._recover(self._controller.last.estimate.health.reason)
            remaining = remaining_rad(self._heading_rad)
            if abs(remaining) <= path.TURNED_RAD:
                self._halt()
                return
            self._controller.period(path.turn_command(remaining, self._controller.limits))

    def _stand(self, seconds: float) -> None:
        until_s = self._controller.clock_s + seconds
        while self._controller.clock_s < until_s:
            self._controller.period()

    def _wait_for(self, condition: Condition, limit_s: float, words: str) -> None:
        until_s = self._controller.clock_s + limit_s
        while not condition(self.seen):
            if self._controller.clock_s >= until_s:
                raise StepFailed("condition", f"{words}: not fulfilled within {limit_s:g} s")
            self._controller.period()

    def _dock(self, dock: Point, heading_rad: float) -> None:
        before = dock[0] - DOCK_IN * cos(heading_rad), dock[1] - DOCK_IN * sin(heading_rad)
        # 1. Drive to the point before the dock and in; start again after the robot was lost.
        self._drive([before], heading_rad, 1.0)
        while not self._drive_in(dock):
            self._recover(self._controller.last.estimate.health.reason)
            self._drive([before], heading_rad, 1.0)
        # 2. Check the end: a contact far before the dock is a failure.
        x, y, _ = self._controller.last.estimate.pose
        distance = hypot(x - dock[0], y - dock[1])
        if distance > 1.0 + 2.0 * DOCKED_IN:
            raise StepFailed("touched", f"touched something {distance:.1f} in before the dock")

    def _drive_in(self, dock: Point) -> bool:
        """Drive straight to the dock until there or in contact; return False if the robot gets lost."""
        pose: Floats = self._controller.last.estimate.pose
        # Straight and without planning, which would keep its distance from the dock.
        line = path.line_between((float(pose[0]), float(pose[1])), dock)
        follower = path.PathFollower([path.PathSection((line,))], self._controller.limits.capped(DOCK_IN_S))
        while not follower.finished and not self._controller.last.state.touching:
            if self._is_lost:
                break
            self._controller.period(follower.command(self._controller.last.estimate.pose))
        self._halt()
        return not self._is_lost

    def _recover(self, reason: str) -> None:
        """Recover from LOST as the settings define, and note it. Raises MissionOver."""
        self._note(f"lost: {reason}")
        since_s = self._controller.clock_s
        recover_from_lost(self._controller, self.settings, reason)
        self._note(f"localized again after {self._controller.clock_s - since_s:.1f} s")

    def _halt(self) -> None:
        """Stand until the axes stop, or for HALT_S."""
        until_s = self._controller.clock_s + HALT_S
        self._controller.period()
        while self._controller.last.state.moving and self._controller.clock_s < until_s:
            self._controller.period()

    # checks in every period

    def _check_period(self, observation: Observation) -> None:
        """Observe a period: distance driven, time limits, fence, standing robot. Raises StepFailed, MissionOver."""
        # 1. Distance by the encoders.
        position = observation.state.x_in, observation.state.y_in
        if self._step:
            self._step.driven_in += hypot(position[0] - self._encoders[0], position[1] - self._encoders[1])
        self._encoders = position
        # 2. Time limit of the mission.
        now_s = observation.estimate.clock_s
        if now_s - self._began_s > self.settings.time_limit_s:
            limit = f"time limit of the mission exceeded: {self.settings.time_limit_s:g} s"
            raise MissionOver("timeout", self._explain_timeout(limit))
        # 3. Fence.
        x, y, _ = observation.estimate.pose
        is_localized = not observation.estimate.health.is_lost
        if self._fence is not None and is_localized and not inside((x, y), self._fence):
            raise MissionOver("fence", f"({x:.1f}, {y:.1f}) is outside of the fence")
        # 4. Time limit of the step.
        if now_s > self._step_ends_s:
            self._step_ends_s = inf
            raise StepFailed("timeout", self._explain_timeout("time limit of the step exceeded"))
        # 5. A robot that does not move, noted once.
        if self._controller.unmoved_s < UNMOVED_S:
            self._is_unmoved_noted = False
        elif not self._is_unmoved_noted:
            self._is_unmoved_noted = True
            self._note(self._unmoved_text())

    def _explain_timeout(self, text: str) -> str:
        """Return the text, with a possible cause if the robot does not move."""
        return text if self._controller.unmoved_s < UNMOVED_S else f"{text}; {self._unmoved_text()}"

    def _unmoved_text(self) -> str:
        """Return the note about a robot that ignores commands; a held robot does not report it to its client."""
        return (
            f"the robot has not moved for {self._controller.unmoved_s:.0f} s although commanded to: is it held (see "
            "nserver ctl status), or its emergency button pressed?"
        )

    def _note(self, words: str) -> None:
        if self._step:
            self._step.notes.append((self._controller.clock_s - self._began_s, words))


def recover_from_lost(controller: RobotController, settings: Settings, reason: str) -> None:
    """Stand, search or give up, as the settings define; return when the robot is localized again.

    Raises
    ------
    MissionOver
        If the settings say so, or after lost_s.
    """
    if settings.on_lost is OnLost.GIVE_UP:
        raise MissionOver("lost", reason)
    until_s = controller.clock_s + settings.lost_s
    commands = _search_commands(controller) if settings.on_lost is OnLost.SEARCH else cycle([STAND])
    while (health := controller.last.estimate.health).is_lost:
        if controller.clock_s > until_s:
            raise MissionOver("lost", f"not localized again within {settings.lost_s:g} s: {health.reason}")
        controller.period(next(commands))


def _search_commands(controller: RobotController) -> Iterator[VelocityCommand]:
    """Yield commands of the recovery behaviour without end, backing off after contacts."""
    recovery = RecoveryBehavior(PERIOD_S, ring=controller.body.ring)
    while True:
        turn_rad = controller.last.estimate.informative_turn_rad
        yield VelocityCommand(*recovery.command(controller.last.state, turn_rad))


def run_mission(mission: Mission, act: Callable[[Mission], object]) -> None:
    """Run a mission to its end; `mission.report` states how it ended.

    The ending is "done", or one word of the failure: a step that failed, or a timeout, the fence or LOST, caught by
    the program or not. Other exceptions (errors of the robot or the file, Ctrl-C, signals) are reported as error or
    interrupted and raised again.
    """
    report = mission.report
    try:
        act(mission)
        if mission.ended is not None:
            raise mission.ended
        report.ending, report.reason = DONE, ""
    except (StepFailed, MissionOver) as failure:
        report.ending, report.reason = ending_of(failure)
    except BaseException as error:
        report.ending, report.reason = ending_of(error)
        raise
    finally:
        if isinstance(mission.ended, MissionOver):
            report.ending, report.reason = mission.ended.ending, str(mission.ended)
        report.duration_s = mission.seen.clock_s


def _format_points(points: Sequence[Point]) -> str:
    return " ".join(f"({x:g}, {y:g})" for x, y in points)
