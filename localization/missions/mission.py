"""What a mission does whose robot no longer knows where it is: stand, search (groping) or give up, for so long.

Rules: how it is searched is groping's, the same for all commands; a touch sets the robot back a little, and it looks
around anew. Ends by lost_s.

How far a turn in place by so much still has to go, however often around.

Rules: pure; headings of the estimate in, what is left out. What was turned is added up from one to the next, which are
less than half a turn apart; so it holds over tries, and a robot that was lost ends in the same heading all the same.

What a mission's program says: go to, follow, turn, look, wait for, patrol, dock.

    def mission(robot):
        robot.go_to(60, 40, heading_deg=90)
        robot.wait_for(lambda seen: seen.nearest_in < 20, limit_s=30)
        robot.patrol([(60, 40), (0, 0)], rounds=2)

Every verb returns when it is done and raises StepFailed when it cannot be; `limit_s` seconds of the robot's clock and
`retries` go with each. Rules: no clock and no file; a period of the helm is the only way that time passes, so all ends:
by itself, by its limit or the mission's, by the fence, or by LOST. What a verb is given is checked before anything else
(arguments.py). What ended a mission (MissionOver, Ctrl-C) is kept,
and every verb but note raises it again: a program that swallowed it drives no farther.

A mission from its first step to its report, whatever happens.

    done                        every step was
    a word of a failure         a step failed, and the program did not catch it; or time, fence, LOST, caught or not
    error, interrupted          the robot or the file failed; Ctrl-C, SIGTERM, SIGHUP. Both are told in the report, and
                                raised again

Rules: no options, no printing. The helm stops the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import cycle
from math import cos, degrees, hypot, inf, radians, sin
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.filters.health import HealthStatus
from localization.missions.controller import Observation, RobotController
from localization.missions.report import DONE, INTERRUPTED, MissionOver, Report, Step, StepFailed, ending_of
from localization.missions.settings import OnLost, Point, Settings, check, points
from localization.navigation.path import Stretch, angle_difference, straight
from localization.navigation.path_follower import STAND, TURNED_RAD, Follower, Velocities, turn
from localization.navigation.pilot import Ending, Patience, Pilot
from localization.navigation.recovery import DRIVE_IN_S, RecoveryBehavior
from localization.navigation.waypoints import PERIOD_S
from nclient.errors import MissionFileError
from worlds.geometry import inside, polygon_segments

BACK_S: Final = 1.5


def find_again(controller: RobotController, settings: Settings, reason: str) -> None:
    """Do as the settings say; returns once the place is known. Raises MissionOver."""
    if settings.on_lost is OnLost.GIVE_UP:
        raise MissionOver("lost", reason)
    until_s = controller.clock_s + settings.lost_s
    commands = _searching(controller) if settings.on_lost is OnLost.SEARCH else cycle([STAND])
    while controller.sight.estimate.health.status is HealthStatus.LOST:
        if controller.clock_s > until_s:
            raise MissionOver(
                "lost", f"not found again in {settings.lost_s:g} s: {controller.sight.estimate.health.reason}"
            )
        controller.period(next(commands))


def _searching(controller: RobotController) -> Iterator[Velocities]:
    """Commands without end."""
    groping = RecoveryBehavior(PERIOD_S)
    while True:
        if controller.sight.state.touching:
            yield from [Velocities(-DRIVE_IN_S, 0.0)] * round(BACK_S / PERIOD_S)
            groping.reset()
        yield Velocities(*groping.command(controller.sight.state))


class TurnProgress:
    """A turn from a heading, by so much to the left."""

    def __init__(self, heading_rad: float, by_rad: float) -> None:
        self._heading_rad, self._left_rad = heading_rad, by_rad

    def left_rad(self, heading_rad: float) -> float:
        """What is left of it at this heading, to the left."""
        self._left_rad -= angle_difference(self._heading_rad, heading_rad)
        self._heading_rad = heading_rad
        return self._left_rad


HALT_S: Final = 2.0
"""An axis at its top speed stands within this."""
RING_S: Final = 1.0
"""All sixteen sonars have fired once in this time."""
UNMOVED_S: Final = 5.0
"""Told to move for so long, a robot that can move has moved."""
DOCK_IN: Final = 12.0
DOCK_IN_S: Final = 2.0
DOCKED_IN: Final = 0.5


class Seen(NamedTuple):
    """What the robot knows at a moment: where it believes to be, and what its sensors say."""

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
    """Things that the map does not have, found so far and still there."""

    @property
    def nearest_in(self) -> int:
        """The shortest reading of the ring."""
        return min(self.sonars_in)


Condition = Callable[[Seen], bool]


class Mission:
    """The robot as a mission's program knows it; what it did is in `report`."""

    def __init__(self, controller: RobotController, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self._helm = controller
        self.report = Report(self.settings.title)
        self.ended: BaseException | None = None
        """What ended it before it was done: MissionOver, or what is no Exception, such as Ctrl-C; a program's own
        sys.exit is a mistake of the program (programs.py)."""
        self._began_s, self._step_ends_s = controller.clock_s, inf
        self._fence = polygon_segments(self.settings.fence_in) if self.settings.fence_in else None
        if self._fence is not None:
            controller.fence(self._fence)
        self._step: Step | None = None
        self._told_unmoved = False
        self._encoders = self._place_of(controller.sight)
        controller.watchers.append(self._watch)

    @property
    def seen(self) -> Seen:
        """What is known now; asks nobody."""
        estimate, state = self._helm.sight
        x, y, heading = (float(value) for value in estimate.pose)
        std = float(np.sqrt(np.linalg.eigvalsh(estimate.belief.cov[:2, :2])[-1]))
        return Seen(
            self._helm.clock_s - self._began_s, x, y, degrees(heading), std, estimate.health.status.value,
            state.sonars_in, state.touching, state.bumpers, len(self._helm.unmapped.segments),
        )  # fmt: skip

    # verbs

    def go_to(self, x_in: float, y_in: float, heading_deg: float | None = None, *, limit_s: float = inf,
              retries: int = 0, within_in: float = 1.0) -> Seen:  # fmt: skip
        """Go there by the shortest way, and turn to the heading."""
        check("go_to", x_in=x_in, y_in=y_in, heading_deg=heading_deg, within_in=within_in, limit_s=limit_s,
              retries=retries)  # fmt: skip
        words = f"({x_in:g}, {y_in:g})" + ("" if heading_deg is None else f" {heading_deg:g} deg")
        heading = None if heading_deg is None else radians(heading_deg)
        self._do("go_to", words, lambda: self._drive([(x_in, y_in)], heading, within_in), limit_s, retries)
        return self.seen

    def follow(self, points_in: Sequence[Point], *, limit_s: float = inf, retries: int = 0,
               within_in: float = 1.0) -> Seen:  # fmt: skip
        """Go along points by straight ways, passing by all but the last, where it stops."""
        goals = points("follow", points_in)
        check("follow", within_in=within_in, limit_s=limit_s, retries=retries)
        self._do("follow", _listed(goals), lambda: self._drive(goals, None, within_in), limit_s, retries)
        return self.seen

    def turn(self, heading_deg: float | None = None, *, by_deg: float | None = None, limit_s: float = inf,
             retries: int = 0) -> Seen:  # fmt: skip
        """Turn in place to a heading, the short way, or by so much to the left, also more than once around."""
        check("turn", heading_deg=heading_deg, by_deg=by_deg, limit_s=limit_s, retries=retries)
        if (heading_deg is None) == (by_deg is None):
            raise MissionFileError("turn: expected heading_deg or by_deg, one of them")
        if by_deg is not None:
            words, left_rad = f"by {by_deg:g} deg", TurnProgress(self._heading_rad, radians(by_deg)).left_rad
        else:
            words, left_rad = (
                f"to {heading_deg:g} deg",
                partial(angle_difference, second_rad=radians(heading_deg or 0.0)),
            )
        self._do("turn", words, lambda: self._turn(left_rad), limit_s, retries)
        return self.seen

    def look(self, seconds: float = RING_S) -> Seen:
        """Stand and listen for a while; what is seen then."""
        check("look", seconds=seconds)
        self._do("look", f"{seconds:g} s", lambda: self._stand(seconds), inf, 0)
        return self.seen

    def wait_for(self, condition: Condition, limit_s: float, words: str = "a condition") -> Seen:
        """Stand until the condition holds; StepFailed where it does not within the limit."""
        check("wait_for", condition=condition, limit_s=limit_s, words=words)
        self._do("wait_for", words, lambda: self._wait_for(condition, limit_s, words), inf, 0)
        return self.seen

    def patrol(self, points_in: Sequence[Point], rounds: int = 1, *, limit_s: float = inf, retries: int = 0) -> Seen:
        """Go to each of the points in turn, the shortest ways, and round again."""
        goals = points("patrol", points_in)
        check("patrol", rounds=rounds, limit_s=limit_s, retries=retries)
        for number in range(rounds):
            for point in goals:
                words = f"({point[0]:g}, {point[1]:g}), round {number + 1} of {rounds}"
                self._do("patrol", words, partial(self._drive, [point], None, 1.0), limit_s, retries)
        return self.seen

    def dock(self, x_in: float, y_in: float, heading_deg: float, *, limit_s: float = inf, retries: int = 0) -> Seen:
        """Go to a place before it, turn to it, and drive in slowly and straight: until there, or until it touches."""
        check("dock", x_in=x_in, y_in=y_in, heading_deg=heading_deg, limit_s=limit_s, retries=retries)
        words = f"({x_in:g}, {y_in:g}) {heading_deg:g} deg"
        self._do("dock", words, lambda: self._dock((x_in, y_in), radians(heading_deg)), limit_s, retries)
        return self.seen

    def note(self, words: str) -> None:
        """Write something into the report."""
        now_s = self._helm.clock_s - self._began_s
        self.report.steps.append(Step("note", str(words), now_s, now_s, DONE))

    # how they are done

    def _do(self, verb: str, words: str, act: Callable[[], None], limit_s: float, retries: int) -> None:
        """A step: act, again where it failed, and all of it into the report. Raises StepFailed, and what ended all."""
        if self.ended is not None:
            raise self.ended
        if self._step is not None:
            raise StepFailed("error", f"{verb} inside of {self._step.verb}: one step at a time")
        with self._reported(verb, words) as step:
            while not self._tried(step, act, limit_s, last=step.tries >= retries):
                self._helm.period()

    def _tried(self, step: Step, act: Callable[[], None], limit_s: float, last: bool) -> bool:
        """Whether it succeeded. Raises StepFailed where this was the last time."""
        step.tries += 1
        self._step_ends_s = self._helm.clock_s + limit_s
        try:
            act()
        except StepFailed as failure:
            if last:
                raise
            self._note(f"{failure}; tried again")
            return False
        return True

    @contextmanager
    def _reported(self, verb: str, words: str) -> Iterator[Step]:
        self._step = step = Step(verb, words, self._helm.clock_s - self._began_s)
        self.report.steps.append(step)
        try:
            yield step
            step.ending = DONE
        except BaseException as error:
            step.ending, step.reason = ending_of(error)
            if not isinstance(error, Exception) and (step.ending == INTERRUPTED or not isinstance(error, SystemExit)):
                self.ended = error
            raise
        finally:
            step.ended_s = self._helm.clock_s - self._began_s
            self._step, self._step_ends_s = None, inf

    def _drive(self, goals: Sequence[Point], heading_rad: float | None, within_in: float) -> None:
        left: Sequence[Point] = list(goals)
        while True:
            pilot = Pilot(
                self._helm.planner, self._helm.limits, self._helm.unmapped, left, heading_rad, Patience(within_in)
            )
            self._steer(pilot)
            assert pilot.outcome is not None
            self._halt()
            if pilot.outcome.ending is Ending.ARRIVED:
                return
            if pilot.outcome.ending is not Ending.LOST:
                raise StepFailed(pilot.outcome.ending.value, pilot.outcome.reason)
            self._find_again(pilot.outcome.reason)
            left = pilot.goals_left

    def _steer(self, pilot: Pilot) -> None:
        """Until the pilot is done; what it logs goes into the report."""
        try:
            while True:
                command = pilot.step(*self._helm.sight)
                if pilot.outcome:
                    return
                self._helm.period(command)
        finally:
            if self._step:
                if not self._step.plans and pilot.log.plans:
                    self._step.planned_in = pilot.log.plans[0].length_in
                self._step.plans += len(pilot.log.plans)
                self._step.touches += len(pilot.log.touches)
                self._step.notes += [(at - self._began_s, words) for at, words in pilot.log.notes]

    @property
    def _heading_rad(self) -> float:
        return float(self._helm.sight.estimate.pose[2])

    def _turn(self, left_rad: Callable[[float], float]) -> None:
        """Until nothing is left to turn, of what `left_rad` says of a heading."""
        while True:
            if self._helm.sight.estimate.health.status is HealthStatus.LOST:
                self._find_again(self._helm.sight.estimate.health.reason)
            left = left_rad(self._heading_rad)
            if abs(left) <= TURNED_RAD:
                self._halt()
                return
            self._helm.period(turn(left, self._helm.limits))

    def _stand(self, seconds: float) -> None:
        until_s = self._helm.clock_s + seconds
        while self._helm.clock_s < until_s:
            self._helm.period()

    def _wait_for(self, condition: Condition, limit_s: float, words: str) -> None:
        until_s = self._helm.clock_s + limit_s
        while not condition(self.seen):
            if self._helm.clock_s >= until_s:
                raise StepFailed("condition", f"{words}: did not come within {limit_s:g} s")
            self._helm.period()

    def _dock(self, place: Point, heading_rad: float) -> None:
        before = place[0] - DOCK_IN * cos(heading_rad), place[1] - DOCK_IN * sin(heading_rad)
        self._drive([before], heading_rad, 1.0)
        while not self._drive_in(place):
            self._find_again(self._helm.sight.estimate.health.reason)
            self._drive([before], heading_rad, 1.0)
        x, y, _ = self._helm.sight.estimate.pose
        off = hypot(x - place[0], y - place[1])
        if off > 1.0 + 2.0 * DOCKED_IN:
            raise StepFailed("touched", f"touched something {off:.1f} in before the dock")

    def _drive_in(self, place: Point) -> bool:
        """The last foot into a dock, until there or touching; False where the robot is LOST on it."""
        pose: Floats = self._helm.sight.estimate.pose
        way = straight((float(pose[0]), float(pose[1])), place)
        follower = Follower([Stretch((way,))], self._helm.limits.capped(DOCK_IN_S))
        while not follower.finished and not self._helm.sight.state.touching:
            if self._helm.sight.estimate.health.status is HealthStatus.LOST:
                break
            self._helm.period(follower.command(self._helm.sight.estimate.pose))
        self._halt()
        return self._helm.sight.estimate.health.status is not HealthStatus.LOST

    def _find_again(self, reason: str) -> None:
        """On LOST: as the settings say; returns once the place is known. Raises MissionOver."""
        self._note(f"lost: {reason}")
        since_s = self._helm.clock_s
        find_again(self._helm, self.settings, reason)
        self._note(f"found again after {self._helm.clock_s - since_s:.1f} s")

    def _halt(self) -> None:
        """Stand until the axes do, or for HALT_S."""
        until_s = self._helm.clock_s + HALT_S
        self._helm.period()
        while self._helm.sight.state.moving and self._helm.clock_s < until_s:
            self._helm.period()

    # what holds in every period

    def _watch(self, sight: Observation) -> None:
        """Time, fence and way, in every period of whatever is done. Raises StepFailed, MissionOver."""
        place = self._place_of(sight)
        if self._step:
            self._step.way_in += hypot(place[0] - self._encoders[0], place[1] - self._encoders[1])
        self._encoders = place
        now_s = sight.estimate.clock_s
        if now_s - self._began_s > self.settings.time_limit_s:
            raise MissionOver("timeout", self._over(f"the mission's time is over: {self.settings.time_limit_s:g} s"))
        x, y, _ = sight.estimate.pose
        known = sight.estimate.health.status is not HealthStatus.LOST
        if self._fence is not None and known and not inside((x, y), self._fence):
            raise MissionOver("fence", f"({x:.1f}, {y:.1f}) is outside of the fence")
        if now_s > self._step_ends_s:
            self._step_ends_s = inf
            raise StepFailed("timeout", self._over("the step's time is over"))
        if self._helm.unmoved_s < UNMOVED_S:
            self._told_unmoved = False
        elif not self._told_unmoved:
            self._told_unmoved = True
            self._note(self._unmoved())

    def _over(self, words: str) -> str:
        """That a time is over, and what may be why."""
        return words if self._helm.unmoved_s < UNMOVED_S else f"{words}; {self._unmoved()}"

    def _unmoved(self) -> str:
        """What to say of a robot that does not do what it is told: nobody tells a program that it is held."""
        return (
            f"it is told to drive and stands, {self._helm.unmoved_s:.0f} s now: is it held (nserver ctl status "
            "tells), or its emergency button pressed?"
        )

    def _place_of(self, sight: Observation) -> Point:
        return sight.state.x_in, sight.state.y_in

    def _note(self, words: str) -> None:
        if self._step:
            self._step.notes.append((self._helm.clock_s - self._began_s, words))


def _listed(points: Sequence[Point]) -> str:
    return " ".join(f"({x:g}, {y:g})" for x, y in points)


def run_mission(mission: Mission, act: Callable[[Mission], object]) -> None:
    """Run it; `mission.report` says how it ended. Raises what is no failure of a step."""
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
