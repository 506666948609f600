"""What many states of a robot that stands still tell of its sensors, bumpers, batteries and clock. Pure.

    dead    a sonar that reads 0, as dead ones do; one that always hears nothing while its neighbours hear is suspect
    stuck   always the same number, while others that look no farther change by more than rounding does: noise grows
            with the range, so a sensor that is steadier than nearer ones does not look

Rules: states in, findings out. In a simulation without noise nothing changes and so nothing is stuck.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from nclient.doctor.finding import Finding, fail, ok, warn
from nclient.protocol.units import CPU_RANGE_V, MOTOR_RANGE_V, volts
from nclient.robot_state import NOTHING_IN, RobotState

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
        elif stuck(readings, number, (DEAD_IN, NOTHING_IN)):
            findings.append(_stuck(name, readings[0][number], " in"))
    silent = [number for number in range(RING) if always(readings, number, NOTHING_IN)]
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
    return all(any(DEAD_IN < reading[side] < NOTHING_IN for reading in readings) for side in sides)


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
