"""What a doctor says: a grade, of what, what was seen, and what to do about it.

What many states of a robot that stands still tell of its sensors, bumpers, batteries and clock. Pure.

    dead    a sonar that reads 0, as dead ones do; one that always hears nothing while its neighbours hear is suspect
    stuck   always the same number, while others that look no farther change by more than rounding does: noise grows
            with the range, so a sensor that is steadier than nearer ones does not look

Rules: states in, findings out. In a simulation without noise nothing changes and so nothing is stuck.

Asks a robot what a doctor needs to know, and never moves it: gs many times, then every question its model has.

Rules: gs and get_ only. Time is handed in: `clock` gives seconds, `sleep` lets them pass. A connection that a missing
answer closed is opened anew. Who has no clock of its own (State[0] is 0: lockstep) is not waited for.

From what was found out to what is said: link and firmware here, the sensors in sensors.py. Pure.

    a link   fails where one gs in ten is lost or nobody answers; one lost, stray bytes or slow answers are a warning
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from typing import Final, NamedTuple

from nclient.backends.base import Backend
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import COMMANDS, Call, Command, exists_on_serial
from nclient.protocol.types import CPU_RANGE_V, MOTOR_RANGE_V, get_model, volts
from nclient.robot import Robot
from nclient.state import NO_ECHO_IN, RobotState


class Grade(IntEnum):
    """How bad it is, the worse the higher."""

    OK = 0
    WARN = 1
    FAIL = 2


class Finding(NamedTuple):
    """One line of a report. `remedy`: empty where all is well."""

    grade: Grade
    what: str
    seen: str
    remedy: str = ""

    def __str__(self) -> str:
        """The line as people read it."""
        return f"{self.grade.name:4}  {self.what:12} {self.seen}{'; ' + self.remedy if self.remedy else ''}"


def ok(what: str, seen: str) -> Finding:
    """All is well."""
    return Finding(Grade.OK, what, seen)


def warn(what: str, seen: str, remedy: str) -> Finding:
    """It runs, and should be looked at."""
    return Finding(Grade.WARN, what, seen, remedy)


def fail(what: str, seen: str, remedy: str) -> Finding:
    """It does not work."""
    return Finding(Grade.FAIL, what, seen, remedy)


def worst(findings: list[Finding]) -> Grade:
    """The worst grade of a report."""
    return max((finding.grade for finding in findings), default=Grade.OK)


RING: Final = 16
DEAD_IN: Final = 0
NOTHING_IR: Final = 15
WITNESSES: Final = 3
"""Others that must have changed before one that did not is suspect."""
SPREAD: Final = 2
"""Least change of a witness: by one, a steady reading between two whole numbers flickers."""
FEWEST: Final = 10
"""States below which nothing is said of what changes."""
LOW_V, EMPTY_V = 11.1, 10.5
"""A lead battery of six cells at 1.85 V and at 1.75 V a cell, where it is to be charged, and where discharge ends."""
SHORT_S: Final = 0.5
"""Time in which a rate says nothing; simulated time that moves with each question takes less."""
_CLOCK_WORD: Final = 1 << 32
Readings = Sequence[Sequence[int]]


def sonars(states: Sequence[RobotState]) -> list[Finding]:
    """A finding a sonar that is not well, or one for all."""
    readings = [state.sonars_in for state in states]
    findings = []
    for number in range(RING):
        name = f"sonar {number}"
        if always(readings, number, DEAD_IN):
            findings.append(fail(name, "reads 0 always: dead", "look after its cable and transducer"))
        elif stuck(readings, number, (DEAD_IN, NO_ECHO_IN)):
            findings.append(_stuck(name, readings[0][number], " in"))
    silent = [number for number in range(RING) if always(readings, number, NO_ECHO_IN)]
    if len(silent) == RING:
        return [warn("sonars", "none hears anything", "is the ring off (conf_sn turns it on), or the hall empty?")]
    alone = [number for number in silent if _neighbours_hear(readings, number)]
    if alone:
        findings.append(warn(
            "sonars", f"hear nothing while both neighbours do: {', '.join(map(str, alone))}",
            "a wall met at a slant does that; hold a board 20 in before each: still 255 means it is dead",
        ))
    return findings or [ok("sonars", f"{RING - len(silent)} of {RING} hear something, none dead or stuck")]


def infrareds(states: Sequence[RobotState]) -> list[Finding]:
    """The same of the infrareds."""
    readings = [state.infrareds for state in states]
    findings = [_stuck(f"infrared {n}", readings[0][n], "") for n in range(RING) if stuck(readings, n, (NOTHING_IR,))]
    if all(always(readings, number, 0) for number in range(RING)):
        return [fail("infrareds", "all read 0 always: dead", "look after the ring's cable and its board")]
    return findings or [ok("infrareds", f"{len(readings)} readings, none stuck")]


def bumpers(states: Sequence[RobotState]) -> Finding:
    """Whether one is pressed all the time, or flickers."""
    pressed = [frozenset(state.bumpers) for state in states]
    steady, ever = frozenset.intersection(*pressed), frozenset[int]().union(*pressed)
    if steady:
        return fail("bumpers", f"pressed all the time: {_listed(steady)}",
                    "free the robot from what it touches; if nothing does, the switch or its wire is stuck")
    if ever:
        return warn("bumpers", f"pressed now and then: {_listed(ever)}", "a loose switch, or somebody touches it")
    return ok("bumpers", "none pressed")


def batteries(state: RobotState) -> list[Finding]:
    """The volts of both."""
    if state.raw_volts is None:
        return [warn("battery", "its volts were never told", "gs tells them; see the firmware's answers")]
    raws = zip(("computer", "motors"), state.raw_volts, (CPU_RANGE_V, MOTOR_RANGE_V), strict=True)
    return [_battery(f"{name}", volts(raw, full_v)) for name, raw, full_v in raws]


def clock(states: Sequence[RobotState], elapsed_s: float) -> Finding:
    """Whether the robot's clock goes forward, and how fast against `elapsed_s` of ours."""
    times = [state.clock_ms for state in states if state.clock_ms is not None]
    if len(times) < 2:
        return warn("clock", "was never told", "gs tells it; see the firmware's answers")
    steps = [(later - earlier + _CLOCK_WORD // 2) % _CLOCK_WORD - _CLOCK_WORD // 2
             for earlier, later in pairwise(times)]
    back = sum(step < 0 for step in steps)
    if back:
        return fail("clock", f"went back {back} times, by {-min(steps) / 1000:g} s at most",
                    "the robot may have started anew, or corrupt answers were believed: look at the line")
    if not any(steps):
        return warn("clock", "stands still", "the simulation is paused, or the robot's firmware hangs")
    passed_s = sum(steps) / 1000
    rate = f", {passed_s / elapsed_s:.2f} s a second" if elapsed_s > SHORT_S else ""
    return ok("clock", f"went forward {passed_s:.1f} s{rate}")


def motion(states: Sequence[RobotState]) -> Finding:
    """Whether something else moved the robot meanwhile, which spoils the rest."""
    if any(state.moving or any(state.raw[38:41]) for state in states):
        return warn("motion", "the robot moved meanwhile", "stop it (nomad stop) and ask again: it must stand still")
    return ok("motion", "the robot stood still")


def always(readings: Readings, number: int, value: int) -> bool:
    """Whether a sensor gave this number each time."""
    return all(reading[number] == value for reading in readings)


def stuck(readings: Readings, number: int, limits: tuple[int, ...]) -> bool:
    """Whether a sensor never changed (its limits do not count), while enough others that look no farther did."""
    seen = {reading[number] for reading in readings}
    if len(readings) < FEWEST or len(seen) > 1 or seen & set(limits):
        return False
    (value,) = seen
    columns = [[reading[other] for reading in readings] for other in range(RING)]
    return sum(max(column) <= value and max(column) - min(column) >= SPREAD for column in columns) >= WITNESSES


def _neighbours_hear(readings: Readings, number: int) -> bool:
    sides = ((number - 1) % RING, (number + 1) % RING)
    return all(any(DEAD_IN < reading[side] < NO_ECHO_IN for reading in readings) for side in sides)


def _stuck(name: str, value: int, unit: str) -> Finding:
    return warn(name, f"reads {value}{unit} always, while others change: stuck?", "hold a hand before it and ask again")


def _battery(name: str, voltage_v: float) -> Finding:
    seen = f"{voltage_v:.2f} V"
    if voltage_v < EMPTY_V:
        return fail(name, f"{seen}: empty", "charge it before it takes harm")
    if voltage_v < LOW_V:
        return warn(name, f"{seen}: low", "charge it soon")
    return ok(name, seen)


def _listed(numbers: frozenset[int]) -> str:
    return ", ".join(map(str, sorted(numbers)))


EXCHANGES: Final = 100
INTERVAL_S: Final = 0.03
"""Between two questions, so that a hundred of them see a ring of sonars go round three times."""
MOST_LOSSES: Final = 10
"""Answers missing in a row after which nobody is there."""
_QUESTIONS: Final = tuple(row for row in COMMANDS if row.name.startswith("get_"))
_NOT_THE_ROBOTS: Final = frozenset({"get_rpx", "get_robot_conf"})
_TROUBLES: Final = (ConnectionLost, ReplyTimeout, RobotRefused, WireError)


@dataclass(slots=True)
class DiagnosticData:
    """What was found out.

    states      after each gs that was answered
    latencies   seconds that each of those took
    losses      what went wrong with the others, as it was told
    elapsed_s   from the first gs to the last
    answers     by C name of each question: "" for a good answer, else what went wrong
    link        the link's own counts, where it keeps any
    """

    model: str = ""
    is_serial: bool = False
    states: list[RobotState] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)
    elapsed_s: float = 0.0
    answers: dict[str, str] = field(default_factory=dict)
    link: dict[str, int] = field(default_factory=dict)

    @property
    def asked(self) -> int:
        """How often gs went out."""
        return len(self.states) + len(self.losses)


class Diagnostics:
    """One robot. `opens`: a new conversation with it. Raises ConnectionLost where nobody is there from the start."""

    def __init__(
        self, opens: Callable[[], Backend], clock: Callable[[], float], sleep: Callable[[float], None]
    ) -> None:
        self._opens = opens
        self._clock, self._sleep = clock, sleep
        self._backend = opens()
        self._robot = Robot(self._backend)

    def run(self, exchanges: int = EXCHANGES, interval_s: float = INTERVAL_S) -> DiagnosticData:
        """Ask all there is to ask."""
        chart = DiagnosticData(self._robot.model.name, self._backend.wire_state.line)
        try:
            self._measure(chart, exchanges, interval_s)
            if chart.states:
                self._question(chart)
            self._count(chart)
        finally:
            self._robot.disconnect()
        return chart

    def _measure(self, chart: DiagnosticData, exchanges: int, interval_s: float) -> None:
        start_s, missing = self._clock(), 0
        for _ in range(exchanges):
            asked_s = self._clock()
            try:
                state = self._connected().refresh()
            except _TROUBLES as error:
                chart.losses.append(str(error))
                missing += 1
                if missing >= MOST_LOSSES:
                    break
                continue
            missing = 0
            now_s = self._clock()
            chart.states.append(state)
            chart.latencies.append(now_s - asked_s)
            chart.elapsed_s = now_s - start_s
            if chart.is_serial or state.raw[0]:
                self._sleep(max(0.0, interval_s - (now_s - asked_s)))

    def _question(self, chart: DiagnosticData) -> None:
        for row in _QUESTIONS:
            if row.name not in _NOT_THE_ROBOTS and self._has(row, chart.is_serial):
                chart.answers[row.name] = self._answer(row)

    def _answer(self, row: Command) -> str:
        """What is wrong with the answer, asked twice where it was none."""
        told = ""
        for _ in range(2):
            try:
                self._connected().execute(Call(row.name))
                return ""
            except _TROUBLES as error:
                told = str(error)
        return told

    def _has(self, row: Command, line: bool) -> bool:
        """Whether this model has what the question asks for. Nserver answers for the compass of a N150, too."""
        model = self._robot.model
        if line:
            return exists_on_serial(row, model)
        lacks = {"get_ir": not model.has_infrared, "get_cp": not model.has_turret,
                 "get_ls": not model.has_laser, "get_sg": not model.has_laser}
        return not lacks.get(row.name, False)

    def _connected(self) -> Robot:
        if self._robot.closed:
            self._backend = self._opens()
            self._robot = Robot(self._backend)
        return self._robot

    def _count(self, chart: DiagnosticData) -> None:
        link = getattr(self._backend, "link", None)
        if link is not None:
            chart.link = link.counts()


MOST_LOST: Final = 0.1
SLOW_S: Final = 0.2
"""A 99th percentile above this is too slow for a program that asks at 10 Hz while it drives."""
_FAULTS: Final = ("skipped_bytes", "checksum_errors", "misfits", "implausible", "strays", "naks")


def report(chart: DiagnosticData) -> list[Finding]:
    """All findings, in the order one would look."""
    findings = [_link(chart)]
    if not chart.states:
        return findings
    findings += _line_faults(chart)
    findings += [_firmware(chart), motion(chart.states), clock(chart.states, chart.elapsed_s)]
    findings += sonars(chart.states)
    if get_model(chart.model).has_infrared:
        findings += infrareds(chart.states)
    return [*findings, bumpers(chart.states), *batteries(chart.states[-1])]


def percentile_s(latencies: Sequence[float], share: float) -> float:
    """The smallest latency that at least this share (0 to 1) of them do not exceed (nearest rank)."""
    ranked = sorted(latencies)
    return ranked[max(0, math.ceil(share * len(ranked)) - 1)]


def _link(chart: DiagnosticData) -> Finding:
    lost = len(chart.losses)
    if not chart.states:
        return fail("link", f"no answer to {lost} questions: {chart.losses[-1]}",
                    "is it switched on, the cable in, the address and the model right?")
    half, most = (1000 * percentile_s(chart.latencies, share) for share in (0.5, 0.99))
    seen = f"{len(chart.states)} of {chart.asked} gs answered; {half:.2f} ms p50, {most:.2f} ms p99"
    if lost > MOST_LOST * chart.asked:
        return fail("link", f"{seen}; {chart.losses[-1]}", "look after plugs, baud rate, and who else talks to it")
    if lost:
        return warn("link", f"{seen}; {chart.losses[-1]}", "a noisy line; retries= in the address lets programs go on")
    if most > 1000 * SLOW_S:
        return warn("link", f"{seen}: slow", "a modem in between, or a busy machine? timeout_s= may have to be longer")
    return ok("link", seen)


def _line_faults(chart: DiagnosticData) -> list[Finding]:
    faults = [f"{chart.link[name]} {name.replace('_', ' ')}" for name in _FAULTS if chart.link.get(name)]
    if faults:
        return [warn("line", ", ".join(faults), "the line is not clean: look after plugs, length, and ground")]
    return [ok("line", "no stray byte, no bad checksum")] if chart.link else []


def _firmware(chart: DiagnosticData) -> Finding:
    bad = {name: told for name, told in chart.answers.items() if told}
    if bad:
        return fail("firmware", "no good answer to " + "; ".join(f"{name} ({told})" for name, told in bad.items()),
                    f"is it a {chart.model}? model= in the address says which")
    return ok("firmware", f"a {chart.model} answered {' '.join(chart.answers)}")
