"""Check a robot without moving it: link, firmware, sensors, bumpers, batteries, clock.

    nomad doctor nserver://localhost:7019/1
    nomad doctor "serial:///dev/ttyUSB0?model=n150" --exchanges 500 --json
    nomad doctor                                   no address, no NOMAD_ROBOT: look for a robot on all serial ports

The search asks each port that no other program uses for its state, at every usual baud rate, and then an Nserver on
this machine.

Prints a line for each finding, OK, WARN or FAIL, with a remedy. Exit code 1 if any finding is FAIL.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from typing import Final, NamedTuple

from nclient.backends.base import Backend
from nclient.common.arguments import add_address, add_flag, add_value, seconds, whole_number
from nclient.common.process import ExitCode
from nclient.connector import DEFAULT_ADDRESS, VARIABLE, Connector, address_or_default, is_listening
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import BY_NAME, COMMANDS, Call, Command, exists_on_serial
from nclient.protocol.decode import guess_model
from nclient.protocol.serial_framing import SerialFramer, build_frame
from nclient.protocol.types import CPU_RANGE_V, MOTOR_RANGE_V, SONAR_SLOTS, Model, get_model, volts
from nclient.robot import Robot
from nclient.state import NO_ECHO_IN, RobotState
from nclient.transports import serial
from nclient.transports.stream import Deadline
from nclient.url import DEFAULT_PORT, parse_address

# Diagnostics of a robot that stands still: collect data with queries, and report findings with remedies.
#
#     Diagnostics.run()   sends gs many times and every query of the model once; never moves the robot
#     report(data)        findings on link, firmware, clock, sensors, bumpers and batteries, each OK, WARN or FAIL
#
# A dead sonar always reads 0. A sensor is stuck if it always reads the same while others with readings no larger change
# by more than rounding does: noise grows with range. Without noise, in an ideal simulation, nothing counts as stuck.

class Grade(IntEnum):
    """Severity of a finding."""

    OK = 0
    WARN = 1
    FAIL = 2


class Finding(NamedTuple):
    """One line of a report; `remedy` is empty if the grade is OK."""

    grade: Grade
    what: str
    seen: str
    remedy: str = ""

    def __str__(self) -> str:
        """Return the line for people."""
        return f"{self.grade.name:4}  {self.what:12} {self.seen}{'; ' + self.remedy if self.remedy else ''}"


def ok(what: str, seen: str) -> Finding:
    """Return a finding without fault."""
    return Finding(Grade.OK, what, seen)


def warn(what: str, seen: str, remedy: str) -> Finding:
    """Return a finding that needs attention."""
    return Finding(Grade.WARN, what, seen, remedy)


def fail(what: str, seen: str, remedy: str) -> Finding:
    """Return a finding of a failure."""
    return Finding(Grade.FAIL, what, seen, remedy)


def worst(findings: list[Finding]) -> Grade:
    """Return the worst grade of a report."""
    return max((finding.grade for finding in findings), default=Grade.OK)


RING: Final = SONAR_SLOTS
DEAD_IN: Final = 0
NOTHING_IR: Final = 15
MIN_CHANGED: Final = 3
"""Other sensors that must have changed before one that did not counts as stuck."""
MIN_CHANGE: Final = 2
"""Smallest change of those: a steady range between two whole numbers changes by one."""
MIN_STATES: Final = 10
"""States below which no sensor counts as stuck."""
LOW_V, EMPTY_V = 11.1, 10.5
"""A lead battery of six cells: 1.85 V per cell, to be charged, and 1.75 V, the end of discharge."""
SHORT_S: Final = 0.5
"""Duration below which no rate is computed; simulated time in lockstep takes less."""
ONE_WALL_RATIO: Final = 1.25
"""Ratio of the ranges of two sonars 45 degrees apart to one wall that is turned by up to 15 degrees against the sonar
between them: cos(7.5 deg) / cos(37.5 deg). Turned further, one of the two gets no echo from it."""
_CLOCK_WORD: Final = 1 << 32
Readings = Sequence[Sequence[int]]


def sonars(states: Sequence[RobotState]) -> list[Finding]:
    """Return a finding per faulty sonar, or one for all."""
    readings = [state.sonars_in for state in states]
    findings = []
    # 1. Each sonar by itself.
    for number in range(RING):
        name = f"sonar {number}"
        if always(readings, number, DEAD_IN):
            findings.append(fail(name, "reads 0 always: dead", "look after its cable and transducer"))
        elif stuck(readings, number, (DEAD_IN, NO_ECHO_IN)):
            findings.append(_stuck(name, readings[0][number], " in"))
    # 2. Sonars without any echo: suspicious if both neighbours may see the same wall. Beside a corner, or a wall met at
    # a slant, a healthy one has none.
    silent = [number for number in range(RING) if always(readings, number, NO_ECHO_IN)]
    if len(silent) == RING:
        return [warn("sonars", "none has an echo", "is the ring off (conf_sn turns it on), or the hall empty?")]
    alone = [number for number in silent if _neighbours_see_one_wall(readings, number)]
    if alone:
        findings.append(warn(
            "sonars", f"no echo while both neighbours have some: {', '.join(map(str, alone))}",
            "they may see one wall, and it should, too; hold a board 20 in before each: still 255 means it is dead",
        ))
    return findings or [ok("sonars", f"{RING - len(silent)} of {RING} have echoes, none dead or stuck")]


def infrareds(states: Sequence[RobotState]) -> list[Finding]:
    """Return a finding per faulty infrared, or one for all."""
    readings = [state.infrareds for state in states]
    findings = [_stuck(f"infrared {n}", readings[0][n], "") for n in range(RING) if stuck(readings, n, (NOTHING_IR,))]
    if all(always(readings, number, 0) for number in range(RING)):
        return [fail("infrareds", "all read 0 always: dead", "look after the ring's cable and its board")]
    return findings or [ok("infrareds", f"{len(readings)} readings, none stuck")]


def bumpers(states: Sequence[RobotState]) -> Finding:
    """Return a finding on bumpers that are pressed all the time or now and then."""
    pressed = [frozenset(state.bumpers) for state in states]
    # Pressed in every state, or in some.
    steady, ever = frozenset.intersection(*pressed), frozenset[int]().union(*pressed)
    if steady:
        return fail("bumpers", f"pressed all the time: {_listed(steady)}",
                    "free the robot from what it touches; if nothing does, the switch or its wire is stuck")
    if ever:
        return warn("bumpers", f"pressed now and then: {_listed(ever)}", "a loose switch, or a person touches it")
    return ok("bumpers", "none pressed")


def batteries(state: RobotState) -> list[Finding]:
    """Return a finding per battery."""
    if state.raw_volts is None:
        return [warn("battery", "its voltage was never received", "gs reports it; see the firmware's answers")]
    raws = zip(("computer", "motors"), state.raw_volts, (CPU_RANGE_V, MOTOR_RANGE_V), strict=True)
    return [_battery(f"{name}", volts(raw, full_v)) for name, raw, full_v in raws]


def clock(states: Sequence[RobotState], elapsed_s: float) -> Finding:
    """Return a finding on the robot's clock, and its rate relative to `elapsed_s` of this machine."""
    times = [state.clock_ms for state in states if state.clock_ms is not None]
    if len(times) < 2:
        return warn("clock", "was never received", "gs reports it; see the firmware's answers")
    # Differences of a 32-bit clock, as signed numbers.
    steps = [(later - earlier + _CLOCK_WORD // 2) % _CLOCK_WORD - _CLOCK_WORD // 2
             for earlier, later in pairwise(times)]
    back = sum(step < 0 for step in steps)
    if back:
        return fail("clock", f"went back {back} times, by {-min(steps) / 1000:g} s at most",
                    "the robot may have started anew, or corrupt replies were accepted: look at the line")
    if not any(steps):
        return warn("clock", "stands still", "the simulation is paused, or the robot's firmware hangs")
    passed_s = sum(steps) / 1000
    rate = f", {passed_s / elapsed_s:.2f} s a second" if elapsed_s > SHORT_S else ""
    return ok("clock", f"went forward {passed_s:.1f} s{rate}")


def motion(states: Sequence[RobotState]) -> Finding:
    """Return a warning if the robot moved meanwhile, which invalidates the other findings."""
    if any(state.moving or any(state.raw[38:41]) for state in states):
        return warn("motion", "the robot moved meanwhile", "stop it (nomad stop) and ask again: it must stand still")
    return ok("motion", "the robot stood still")


def always(readings: Readings, number: int, value: int) -> bool:
    """Return True if a sensor always read this value."""
    return all(reading[number] == value for reading in readings)


def stuck(readings: Readings, number: int, limits: tuple[int, ...]) -> bool:
    """Return True if a sensor never changed, except at its limits, while enough others with readings no larger did."""
    # 1. It has one value, which is no limit of its range.
    seen = {reading[number] for reading in readings}
    if len(readings) < MIN_STATES or len(seen) > 1 or seen & set(limits):
        return False
    (value,) = seen
    # 2. Others with readings no larger, and so with less noise, have changed.
    columns = [[reading[other] for reading in readings] for other in range(RING)]
    return sum(max(column) <= value and max(column) - min(column) >= MIN_CHANGE for column in columns) >= MIN_CHANGED


def _neighbours_see_one_wall(readings: Readings, number: int) -> bool:
    """Return True if the nearest echoes of both neighbours differ as little as those of one wall."""
    nearest = []
    for side in ((number - 1) % RING, (number + 1) % RING):
        echoes = [reading[side] for reading in readings if DEAD_IN < reading[side] < NO_ECHO_IN]
        if not echoes:
            return False
        nearest.append(min(echoes))
    return max(nearest) <= ONE_WALL_RATIO * min(nearest)


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
"""Interval between two requests: a hundred of them last for three cycles of the sonars."""
MAX_LOSSES_IN_ROW: Final = 10
"""Missing replies in a row after which the robot counts as absent."""
_QUERIES: Final = tuple(row for row in COMMANDS if row.name.startswith("get_")
                        and row.name not in ("get_rpx", "get_robot_conf"))
"""Queries to the robot itself, not to its server."""
_ERRORS: Final = (ConnectionLost, ReplyTimeout, RobotRefused, WireError)


@dataclass(slots=True)
class DiagnosticData:
    """The collected data.

    Attributes
    ----------
    states
        The state after each answered gs.
    latencies
        The time each of those took, in seconds.
    losses
        The errors of the other ones.
    elapsed_s
        Time from the first gs to the last reply.
    answers
        By C name of each query: "" for a valid reply, else the error.
    link
        Statistics of the link, if it has any.
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
        """Return the number of gs sent."""
        return len(self.states) + len(self.losses)


class Diagnostics:
    """Query one robot; gs and get_ only.

    A connection that was closed after a missing reply is opened again. Between requests it pauses, except if the
    robot's time advances only with requests (State[0] is 0).

    Parameters
    ----------
    open_session
        Opens a new connection to the robot.
    clock
        Returns seconds.
    sleep
        Waits for that many seconds.

    Raises
    ------
    ConnectionLost
        If the robot cannot be reached at the start.
    """

    def __init__(self, open_session: Callable[[], Backend], clock: Callable[[], float],
                 sleep: Callable[[float], None]) -> None:
        self._open_session = open_session
        self._clock, self._sleep = clock, sleep
        self._backend = open_session()
        self._robot = Robot(self._backend)

    def run(self, exchanges: int = EXCHANGES, interval_s: float = INTERVAL_S) -> DiagnosticData:
        """Send all requests and return the data."""
        data = DiagnosticData(self._robot.model.name, self._backend.wire_state.line)
        try:
            self._measure(data, exchanges, interval_s)
            if data.states:
                data.answers = {row.name: self._query_error(row) for row in _QUERIES if self._has(row, data.is_serial)}
            if self._backend.link is not None:
                data.link = self._backend.link.counts()
        finally:
            self._robot.disconnect()
        return data

    def _measure(self, data: DiagnosticData, exchanges: int, interval_s: float) -> None:
        start_s, missing = self._clock(), 0
        for _ in range(exchanges):
            # 1. One gs; after an error the next one goes over a new connection, if this one was closed.
            asked_s = self._clock()
            try:
                state = self._connected().refresh()
            except _ERRORS as error:
                data.losses.append(str(error))
                missing += 1
                if missing >= MAX_LOSSES_IN_ROW:
                    break
                continue
            # 2. Record it.
            missing = 0
            now_s = self._clock()
            data.states.append(state)
            data.latencies.append(now_s - asked_s)
            data.elapsed_s = now_s - start_s
            # 3. Pause, unless time advances only with requests.
            if data.is_serial or state.raw[0]:
                self._sleep(max(0.0, interval_s - (now_s - asked_s)))

    def _query_error(self, row: Command) -> str:
        """Return the error of a query, "" if it was answered at the first or second attempt."""
        message = ""
        for _ in range(2):
            try:
                self._connected().execute(Call(row.name))
                return ""
            except _ERRORS as error:
                message = str(error)
        return message

    def _has(self, row: Command, line: bool) -> bool:
        """Return True if this model has what is queried. An Nserver answers for the compass of an N150, too."""
        model = self._robot.model
        if line:
            return exists_on_serial(row, model)
        # Over TCP every query is answered, with error 4 if the model lacks the sensor.
        lacks = {"get_ir": not model.has_infrared, "get_cp": not model.has_turret,
                 "get_ls": not model.has_laser, "get_sg": not model.has_laser}
        return not lacks.get(row.name, False)

    def _connected(self) -> Robot:
        if self._robot.closed:
            self._backend = self._open_session()
            self._robot = Robot(self._backend)
        return self._robot


MAX_LOST_FRACTION: Final = 0.1
SLOW_S: Final = 0.2
"""A 99th percentile above this is too slow for a program that drives with 10 requests per second."""
_FAULTS: Final = ("skipped_bytes", "checksum_errors", "misfits", "implausible", "strays", "naks")


def report(data: DiagnosticData) -> list[Finding]:
    """Return all findings, from the link to the batteries."""
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
    """Return a percentile of the latencies by nearest rank; `fraction` is 0 to 1."""
    ranked = sorted(latencies)
    return ranked[max(0, math.ceil(fraction * len(ranked)) - 1)]


def _link(data: DiagnosticData) -> Finding:
    lost = len(data.losses)
    if not data.states:
        return fail("link", f"no answer to {lost} questions: {data.losses[-1]}",
                    "is it switched on, the cable in, the address, the model and the baud rate right?")
    p50_ms, p99_ms = (1000 * percentile_s(data.latencies, fraction) for fraction in (0.5, 0.99))
    seen = f"{len(data.states)} of {data.asked} gs answered; {p50_ms:.2f} ms p50, {p99_ms:.2f} ms p99"
    # Grades, from the worst: lost replies, then slow ones.
    if lost > MAX_LOST_FRACTION * data.asked:
        return fail("link", f"{seen}; {data.losses[-1]}", "look after plugs, baud rate, and who else talks to it")
    if lost:
        return warn("link", f"{seen}; {data.losses[-1]}", "a noisy line; retries= in the address lets programs go on")
    if p99_ms > 1000 * SLOW_S:
        return warn("link", f"{seen}: slow", "a modem in between, or a busy machine? timeout_s= may have to be longer")
    return ok("link", seen)


def _line_faults(data: DiagnosticData) -> list[Finding]:
    faults = [f"{data.link[name]} {name.replace('_', ' ')}" for name in _FAULTS if data.link.get(name)]
    if faults:
        return [warn("line", ", ".join(faults), "the line is not clean: look after plugs, length, and ground")]
    return [ok("line", "no stray byte, no bad checksum")] if data.link else []


def _firmware(data: DiagnosticData) -> Finding:
    bad = {name: error for name, error in data.answers.items() if error}
    if bad:
        return fail("firmware", "no good answer to " + "; ".join(f"{name} ({error})" for name, error in bad.items()),
                    f"is it a {data.model}? model= in the address says which")
    return ok("firmware", f"a {data.model} answered {' '.join(data.answers)}")


_GET_STATE: Final = BY_NAME["gs"].line_type or 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_address(parser, "the first robot found")
    count = whole_number("the number of exchanges", 1, 1_000_000)
    add_value(parser, "--exchanges", "N", count, f"send gs N times (default: {EXCHANGES})", EXCHANGES)
    add_value(parser, "--interval", "S", seconds,
              f"send gs at intervals of S seconds (default: {INTERVAL_S:g})", INTERVAL_S)
    add_flag(parser, "--json", "print one JSON object instead of lines")


def run(options: argparse.Namespace) -> int:
    """Check the robot, print the findings, and return the exit code."""
    if not options.address and not os.environ.get(VARIABLE):
        return _search(options)
    return _check(address_or_default(options.address), options)


def _check(address: str, options: argparse.Namespace, search: dict[str, object] | None = None) -> int:
    """Check one robot, print the findings, in JSON with those of a search before, and return the exit code."""
    connector = Connector(parse_address(address))
    chart = Diagnostics(connector.open_session, time.perf_counter, time.sleep).run(options.exchanges, options.interval)
    findings = report(chart)
    grade = worst(findings)
    if options.json:
        print(json.dumps({"address": address, "model": chart.model, "worst": grade.name, "findings": _dicts(findings)}
                         | (search or {})))
    else:
        print(*findings, sep="\n")
    return ExitCode.FAILED if grade is Grade.FAIL else ExitCode.DONE


def _dicts(findings: list[Finding]) -> list[dict[str, object]]:
    return [finding._asdict() | {"grade": finding.grade.name} for finding in findings]


# -- search -----------------------------------------------------------------------------------------------------------

USUAL_BAUDS: Final = (38400, 9600, 19200, 57600, 115200)
"""Baud rates that are tried, that of a Nomad as it was delivered first."""
ANSWER_S: Final = 0.4
"""Wait for an answer at each rate: a whole state packet of a N150 takes 0.06 s at 9600 baud."""
_QUIET_S: Final = 0.05


def _search(options: argparse.Namespace) -> int:
    """Look for robots on all ports and for an Nserver; check the Nserver if there is one, and return the exit code."""
    findings, found = [], []
    for port in serial.ports():
        finding, address = search_port(port)
        findings.append(finding)
        found += [address] if address else []
    if not findings:
        findings.append(warn("ports", "this machine has no serial ports", "is the adapter plugged in?"))
    is_nserver = is_listening("localhost", DEFAULT_PORT)
    if not found and not is_nserver:
        findings.append(fail(
            "robot", "none found", "switch it on, plug its cable in, and look at docs/real-robot.md; "
            f"for an Nserver elsewhere give its address, or start one: {DEFAULT_ADDRESS} does not answer"))
    if options.json and is_nserver:
        return _check(DEFAULT_ADDRESS, options, {"addresses": found, "ports": _dicts(findings)})
    if options.json:
        grade = Grade.OK if found else Grade.FAIL
        print(json.dumps({"addresses": found, "worst": grade.name, "findings": _dicts(findings)}))
    else:
        print(*findings, sep="\n")
        for address in found:
            print(f"      next: nomad doctor {shlex.quote(address)}")
    if is_nserver:
        return _check(DEFAULT_ADDRESS, options)
    return ExitCode.DONE if found else ExitCode.FAILED


def search_port(port: str) -> tuple[Finding, str]:
    """Ask a port at every usual baud rate for a Nomad's state, which moves nothing.

    Returns
    -------
    tuple of Finding and str
        What was found, and the address of the robot, "" without one.
    """
    # 1. A port that another program has open: to set its baud rate would disturb that program, lock or not.
    if users := ", ".join(serial.users(port)):
        return warn(port, f"not asked: in use by {users}", "end that program to look for a robot there"), ""
    # 2. Every rate.
    noisy = []
    for baud in USUAL_BAUDS:
        try:
            model, is_noisy = ask_port(port, baud)
        except ConnectionLost as error:
            return warn(port, "cannot be asked", str(error)), ""
        if model is not None:
            rate = "" if baud == serial.DEFAULT_BAUD else f"&baud={baud}"
            place = port if port.startswith("/") else f"/{port}"  # COM3: serial:///COM3
            return ok(port, f"a {model.name} answers at {baud} baud"), f"serial://{place}?model={model.name}{rate}"
        noisy += [baud] if is_noisy else []
    rates = ", ".join(map(str, USUAL_BAUDS))
    if noisy:
        return warn(port, f"answers at {', '.join(map(str, noisy))} baud, but not as a Nomad",
                    "another device, or a robot at an unusual rate: try baud= in the address"), ""
    return warn(port, f"silent at {rates} baud", "another device, or a robot that is off or not plugged in"), ""


def ask_port(port: str, baud: int) -> tuple[Model | None, bool]:
    """Return the model of the robot that answers at this baud rate, None without one, and whether bytes came at all.

    Raises
    ------
    ConnectionLost
        If the port cannot be opened.
    """
    framer, is_noisy = SerialFramer(), False
    with contextlib.closing(serial.open_port(port, baud)) as stream:
        # 1. What was under way before is no answer. Another device may send without a pause.
        deadline = Deadline.after(ANSWER_S)
        with contextlib.suppress(ReplyTimeout):
            while deadline.remaining():
                stream.receive(Deadline.after(_QUIET_S))
        # 2. gs only reads the state.
        stream.send(build_frame(_GET_STATE))
        deadline = Deadline.after(ANSWER_S)
        with contextlib.suppress(ReplyTimeout):
            while deadline.remaining():
                data = stream.receive(deadline)
                is_noisy = True
                for frame in framer.receive(data):
                    if frame.type == _GET_STATE and (model := guess_model(frame.data)):
                        return model, True
    return None, is_noisy
