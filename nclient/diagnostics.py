"""Diagnostics of a robot that stands still: measurements, checks of link and sensors, and the report.

    Diagnostics.run() ──> DiagnosticData ──> report() ──> [Finding, ...]

`Diagnostics` sends gs many times, then each get_ command of the model; it never moves the robot. Clock and sleep are
passed in; with simulated time that advances per request (State[0] is 0) it does not wait. Everything else is pure:

    dead    a sonar that always reads 0; one without echoes while both neighbours have some is suspect
    stuck   always the same number, while sensors with shorter ranges change by more than rounding: noise grows with
            range, so that a sensor steadier than those is suspect (not in a simulation without noise)
    link    fails if more than one gs in ten is lost or nothing replies; losses, stray bytes, slow replies: warnings
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
    """Severity of a finding."""

    OK = 0
    WARN = 1
    FAIL = 2


class Finding(NamedTuple):
    """One line of a report; `remedy` is empty if nothing is wrong."""

    grade: Grade
    what: str
    seen: str
    remedy: str = ""

    def __str__(self) -> str:
        """Return the line of the report."""
        return f"{self.grade.name:4}  {self.what:12} {self.seen}{'; ' + self.remedy if self.remedy else ''}"


def ok(what: str, seen: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(Grade.OK, what, seen)


def warn(what: str, seen: str, remedy: str) -> Finding:
    """Return a finding that should be checked."""
    return Finding(Grade.WARN, what, seen, remedy)


def fail(what: str, seen: str, remedy: str) -> Finding:
    """Return a finding of something that does not work."""
    return Finding(Grade.FAIL, what, seen, remedy)


def worst(findings: list[Finding]) -> Grade:
    """Return the worst grade of a report."""
    return max((finding.grade for finding in findings), default=Grade.OK)


RING: Final = 16
DEAD_IN: Final = 0
NOTHING_IR: Final = 15
MIN_CHANGING: Final = 3
"""Number of other sensors that must have changed before a constant one is suspect."""
MIN_CHANGE: Final = 2
"""Minimum change: a constant distance between two whole numbers already changes by 1."""
MIN_STATES: Final = 10
"""Minimum number of states for a finding about constant readings."""
LOW_V, EMPTY_V = 11.1, 10.5
"""Lead battery of six cells at 1.85 V per cell, to be charged, and at 1.75 V, the end of discharge."""
MIN_RATE_S: Final = 0.5
"""Minimum duration for the clock's rate; simulated time that advances per request takes less."""
_CLOCK_WORD: Final = 1 << 32
Readings = Sequence[Sequence[int]]


def sonars(states: Sequence[RobotState]) -> list[Finding]:
    """Return a finding for each faulty sonar, or one for all of them."""
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
        return [warn("sonars", "no echo on any", "is the ring off (conf_sn turns it on), or the hall empty?")]
    suspect = [number for number in silent if _have_neighbours_echoes(readings, number)]
    if suspect:
        findings.append(warn(
            "sonars", f"no echo while both neighbours have one: {', '.join(map(str, suspect))}",
            "an oblique wall causes this; hold a board 20 in before each: if it still reads 255 it is dead",
        ))
    return findings or [ok("sonars", f"{RING - len(silent)} of {RING} have echoes, none dead or stuck")]


def infrareds(states: Sequence[RobotState]) -> list[Finding]:
    """Return a finding for each faulty infrared sensor, or one for all of them."""
    readings = [state.infrareds for state in states]
    findings = [_stuck(f"infrared {n}", readings[0][n], "") for n in range(RING) if stuck(readings, n, (NOTHING_IR,))]
    if all(always(readings, number, 0) for number in range(RING)):
        return [fail("infrareds", "all read 0 always: dead", "look after the ring's cable and its board")]
    return findings or [ok("infrareds", f"{len(readings)} readings, none stuck")]


def bumpers(states: Sequence[RobotState]) -> Finding:
    """Return the finding about bumpers that are pressed, always or at times."""
    pressed = [frozenset(state.bumpers) for state in states]
    steady, ever = frozenset.intersection(*pressed), frozenset[int]().union(*pressed)
    if steady:
        return fail("bumpers", f"pressed all the time: {_listed(steady)}",
                    "free the robot from what it touches; if nothing does, the switch or its wire is stuck")
    if ever:
        return warn("bumpers", f"pressed at times: {_listed(ever)}", "a loose switch, or something touches it")
    return ok("bumpers", "none pressed")


def batteries(state: RobotState) -> list[Finding]:
    """Return a finding for each battery."""
    if state.raw_volts is None:
        return [warn("battery", "no voltage was reported", "gs reports it; see the finding about the firmware")]
    raws = zip(("computer", "motors"), state.raw_volts, (CPU_RANGE_V, MOTOR_RANGE_V), strict=True)
    return [_battery(f"{name}", volts(raw, full_v)) for name, raw, full_v in raws]


def clock(states: Sequence[RobotState], elapsed_s: float) -> Finding:
    """Return the finding about the robot's clock: its direction, and its rate over `elapsed_s` of real time."""
    times = [state.clock_ms for state in states if state.clock_ms is not None]
    if len(times) < 2:
        return warn("clock", "was not reported", "gs reports it; see the finding about the firmware")
    # Differences modulo 2^32, because the clock wraps around.
    steps = [(later - earlier + _CLOCK_WORD // 2) % _CLOCK_WORD - _CLOCK_WORD // 2
             for earlier, later in pairwise(times)]
    back = sum(step < 0 for step in steps)
    if back:
        return fail("clock", f"went back {back} times, by {-min(steps) / 1000:g} s at most",
                    "the robot may have started anew, or corrupt answers were believed: look at the line")
    if not any(steps):
        return warn("clock", "stands still", "the simulation is paused, or the robot's firmware hangs")
    passed_s = sum(steps) / 1000
    rate = f", {passed_s / elapsed_s:.2f} s a second" if elapsed_s > MIN_RATE_S else ""
    return ok("clock", f"went forward {passed_s:.1f} s{rate}")


def motion(states: Sequence[RobotState]) -> Finding:
    """Return the finding about motion during the measurement, which invalidates the others."""
    if any(state.moving or any(state.raw[38:41]) for state in states):
        return warn("motion", "the robot moved meanwhile", "stop it (nomad stop) and ask again: it must stand still")
    return ok("motion", "the robot stood still")


def always(readings: Readings, number: int, value: int) -> bool:
    """Return True if a sensor had this reading in all states."""
    return all(reading[number] == value for reading in readings)


def stuck(readings: Readings, number: int, limits: tuple[int, ...]) -> bool:
    """Return True if a reading never changed while enough shorter ones did; readings at `limits` are not judged."""
    seen = {reading[number] for reading in readings}
    if len(readings) < MIN_STATES or len(seen) > 1 or seen & set(limits):
        return False
    (value,) = seen
    columns = [[reading[other] for reading in readings] for other in range(RING)]
    return sum(max(column) <= value and max(column) - min(column) >= MIN_CHANGE for column in columns) >= MIN_CHANGING


def _have_neighbours_echoes(readings: Readings, number: int) -> bool:
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
"""Interval of gs: in 100 of them the sonar ring fires about three times."""
MAX_LOSSES: Final = 10
"""Number of consecutive missing replies after which the measurement ends."""
_QUESTIONS: Final = tuple(row for row in COMMANDS if row.name.startswith("get_"))
_NOT_ABOUT_ROBOT: Final = frozenset({"get_rpx", "get_robot_conf"})
_ERRORS: Final = (ConnectionLost, ReplyTimeout, RobotRefused, WireError)


@dataclass(slots=True)
class DiagnosticData:
    """Results of the measurements.

    Attributes
    ----------
    model, is_serial
        Model of the robot, and True on its serial line.
    states
        State after each gs with a reply.
    latencies
        Latency of each of those in seconds.
    losses
        Error of each other gs.
    elapsed_s
        Time from the first gs to the last reply.
    answers
        By command: "" for a valid reply, else the error.
    link
        Counters of the connection, if it has any.
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
        """Return the number of gs requests."""
        return len(self.states) + len(self.losses)


class Diagnostics:
    """Measurements of one robot.

    Parameters
    ----------
    connect
        Opens a connection, at the start and again after a connection loss.
    clock
        Returns seconds.
    sleep
        Waits a number of seconds.

    Raises
    ------
    ConnectionLost
        If nothing answers at the start.
    """

    def __init__(
        self, connect: Callable[[], Backend], clock: Callable[[], float], sleep: Callable[[float], None]
    ) -> None:
        self._connect = connect
        self._clock, self._sleep = clock, sleep
        self._backend = connect()
        self._robot = Robot(self._backend)

    def run(self, exchanges: int = EXCHANGES, interval_s: float = INTERVAL_S) -> DiagnosticData:
        """Send `exchanges` gs requests, then each get_ command of the model, and return the results."""
        data = DiagnosticData(self._robot.model.name, self._backend.wire_state.line)
        try:
            self._measure(data, exchanges, interval_s)
            if data.states:
                self._question(data)
            self._count(data)
        finally:
            self._robot.disconnect()
        return data

    def _measure(self, data: DiagnosticData, exchanges: int, interval_s: float) -> None:
        start_s, missing = self._clock(), 0
        for _ in range(exchanges):
            asked_s = self._clock()
            try:
                state = self._connected().refresh()
            except _ERRORS as error:
                data.losses.append(str(error))
                missing += 1
                if missing >= MAX_LOSSES:
                    break
                continue
            missing = 0
            now_s = self._clock()
            data.states.append(state)
            data.latencies.append(now_s - asked_s)
            data.elapsed_s = now_s - start_s
            if data.is_serial or state.raw[0]:
                self._sleep(max(0.0, interval_s - (now_s - asked_s)))

    def _question(self, data: DiagnosticData) -> None:
        for row in _QUESTIONS:
            if row.name not in _NOT_ABOUT_ROBOT and self._has(row, data.is_serial):
                data.answers[row.name] = self._answer(row)

    def _answer(self, row: Command) -> str:
        """Return the error of a get_ command after one retry, "" for a valid reply."""
        error_text = ""
        for _ in range(2):
            try:
                self._connected().execute(Call(row.name))
                return ""
            except _ERRORS as error:
                error_text = str(error)
        return error_text

    def _has(self, row: Command, line: bool) -> bool:
        """Return True if the model has the sensor of a command; Nserver has a compass for the N150, too."""
        model = self._robot.model
        if line:
            return exists_on_serial(row, model)
        lacks = {"get_ir": not model.has_infrared, "get_cp": not model.has_turret,
                 "get_ls": not model.has_laser, "get_sg": not model.has_laser}
        return not lacks.get(row.name, False)

    def _connected(self) -> Robot:
        if self._robot.closed:
            self._backend = self._connect()
            self._robot = Robot(self._backend)
        return self._robot

    def _count(self, data: DiagnosticData) -> None:
        link = getattr(self._backend, "link", None)
        if link is not None:
            data.link = link.counts()


MAX_LOSS_FRACTION: Final = 0.1
SLOW_S: Final = 0.2
"""Limit of the 99th percentile of the latency: too slow for a program that sends gs at 10 Hz while driving."""
_FAULTS: Final = ("skipped_bytes", "checksum_errors", "misfits", "implausible", "strays", "naks")


def report(data: DiagnosticData) -> list[Finding]:
    """Return all findings: link, firmware, motion and clock, then the sensors."""
    findings = [_link(data)]
    if not data.states:
        return findings
    findings += _line_faults(data)
    findings += [_firmware(data), motion(data.states), clock(data.states, data.elapsed_s)]
    findings += sonars(data.states)
    if get_model(data.model).has_infrared:
        findings += infrareds(data.states)
    return [*findings, bumpers(data.states), *batteries(data.states[-1])]


def percentile_s(latencies: Sequence[float], fraction: float) -> float:
    """Return the smallest latency that at least this fraction of them does not exceed (nearest rank)."""
    ranked = sorted(latencies)
    return ranked[max(0, math.ceil(fraction * len(ranked)) - 1)]


def _link(data: DiagnosticData) -> Finding:
    lost = len(data.losses)
    if not data.states:
        return fail("link", f"no answer to {lost} questions: {data.losses[-1]}",
                    "is it switched on, the cable in, the address and the model right?")
    half, most = (1000 * percentile_s(data.latencies, fraction) for fraction in (0.5, 0.99))
    seen = f"{len(data.states)} of {data.asked} gs answered; {half:.2f} ms p50, {most:.2f} ms p99"
    if lost > MAX_LOSS_FRACTION * data.asked:
        return fail("link", f"{seen}; {data.losses[-1]}", "look after plugs, baud rate, and what else uses the line")
    if lost:
        return warn("link", f"{seen}; {data.losses[-1]}", "a noisy line; retries= in the address lets programs go on")
    if most > 1000 * SLOW_S:
        return warn("link", f"{seen}: slow", "a modem in between, or a busy machine? timeout_s= may have to be longer")
    return ok("link", seen)


def _line_faults(data: DiagnosticData) -> list[Finding]:
    faults = [f"{data.link[name]} {name.replace('_', ' ')}" for name in _FAULTS if data.link.get(name)]
    if faults:
        return [warn("line", ", ".join(faults), "the line is not clean: look after plugs, length, and ground")]
    return [ok("line", "no stray byte, no bad checksum")] if data.link else []


def _firmware(data: DiagnosticData) -> Finding:
    bad = {name: error_text for name, error_text in data.answers.items() if error_text}
    if bad:
        return fail(
            "firmware",
            "no good answer to " + "; ".join(f"{name} ({error_text})" for name, error_text in bad.items()),
            f"is it a {data.model}? model= in the address says which",
        )
    return ok("firmware", f"a {data.model} answered {' '.join(data.answers)}")
