"""A plan of faults as a value: rules, each with what it does, to which frames, and how often. Reading it: plan_file.py

    frame ──> rule 1 ──> rule 2 ──> ... ──> arrives        a frame that a rule took away never comes to those below it

Rules: immutable, and right once made: a FaultPlanError names rule and key. Every rule counts the frames that come to
it for itself and on each line for itself, so that `every = 10` is exactly every tenth of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from enum import Enum

from nclient.errors import FaultPlanError
from nclient.faults.kinds import Fault, check_number, check_whole, fail
from nclient.protocol.commands import BY_NAME
from nclient.protocol.language import no_command
from nclient.suggesting import did_you_mean

GREETING = "hello"
"""What a plan calls the eleven bytes that an N200 sends first over TCP."""
LINE_KINDS = ("serial", "robotd", "nserver", "real", "sim", "replay")
"""What lines there are: a robot's own, two ways; Nserver's; a gateway's to the real robot; a simulation or a recording
in a program's own process."""
MOST_SEED = 2**63


class Direction(Enum):
    """Which way a frame goes: to the robot, or back to the host."""

    REQUEST = "request"
    REPLY = "reply"


BOTH = frozenset(Direction)


@dataclass(frozen=True, slots=True)
class When:
    """Which of the frames that come to a rule it strikes: all, or by one of four ways to count; and when.

    `every` n: the nth, 2nth, ...; `percent`: by chance; `first` n: those; `at`: the frames of these numbers, from 1.
    `from_s` up to `until_s`: seconds since the plan came into force.
    """

    every: int | None = None
    percent: float | None = None
    first: int | None = None
    at: tuple[int, ...] | None = None
    from_s: float = 0.0
    until_s: float = math.inf

    def __post_init__(self) -> None:
        ways = [name for name in ("every", "percent", "first", "at") if getattr(self, name) is not None]
        if len(ways) > 1:
            raise FaultPlanError(f"{ways[1]}: {' and '.join(ways)} count differently; keep one of them")
        if self.every is not None:
            check_whole("every", self.every, 1)
        if self.percent is not None:
            check_number("percent", self.percent, 0.0, 100.0)
        if self.first is not None:
            check_whole("first", self.first, 1)
        if self.at == ():
            raise FaultPlanError("at: the numbers of the frames it strikes, such as [3, 7]; there are none")
        for number in self.at or ():
            check_whole("at", number, 1)
        check_number("from_s", self.from_s, 0.0, math.inf)
        check_number("until_s", self.until_s, 0.0, math.inf)
        if self.until_s <= self.from_s:
            fail("until_s", f"later than from_s, {self.from_s:g}", self.until_s)

    def covers(self, elapsed_s: float) -> bool:
        """Whether the rule is in force so long after the plan began."""
        return self.from_s <= elapsed_s < self.until_s

    def strikes(self, number: int, draw: float) -> bool:
        """Whether it strikes the frame of that number, counted from 1; `draw`: chance, 0 to below 1."""
        if self.every is not None:
            return number % self.every == 0
        if self.percent is not None:
            return 100.0 * draw < self.percent
        if self.first is not None:
            return number <= self.first
        return self.at is None or number in self.at


@dataclass(frozen=True, slots=True)
class Rule:
    """What is done (`faults`: one of them each time, by chance) to which frames (empty: any command, any line), when.

    `commands`: C names. `lines`: such as serial:1, robotd:1, nserver; serial alone means every such line.
    The kinds in one rule differ, and where two have the same setting it has the same value.
    """

    name: str
    faults: tuple[Fault, ...]
    when: When = field(default_factory=When)
    commands: tuple[str, ...] = ()
    directions: frozenset[Direction] = frozenset({Direction.REPLY})
    lines: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.faults:
            raise FaultPlanError(f"rule {self.name!r}: do: at least one kind of fault is wanted")
        if not self.directions:
            raise FaultPlanError(f"rule {self.name!r}: direction: request, reply or both is wanted")
        _check_agreement(self.name, self.faults)
        for command in self.commands:
            _check_command(self.name, command)
        for line in self.lines:
            _check_line(self.name, line)

    def acts_on(self, line: str) -> bool:
        """Whether the rule is for the line of that name."""
        return not self.lines or line in self.lines or line.partition(":")[0] in self.lines

    def matches(self, command: str, direction: Direction) -> bool:
        """Whether the rule is for frames of that command, going that way."""
        return direction in self.directions and (not self.commands or command in self.commands)


@dataclass(frozen=True, slots=True)
class Plan:
    """Rules in the order in which frames come to them, and the seed of all chance."""

    rules: tuple[Rule, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        check_whole("seed", self.seed, 0, MOST_SEED)
        names: set[str] = set()
        for rule in self.rules:
            if rule.name in names:
                raise FaultPlanError(f"rule {rule.name!r}: name: an earlier rule is called so; expected another")
            names.add(rule.name)


def require_rules_for(line: str, plan: Plan) -> None:
    """Refuse a plan that never acts on the line it is meant for. Raises FaultPlanError."""
    if plan.rules and not any(rule.acts_on(line) for rule in plan.rules):
        named = sorted({name for rule in plan.rules for name in rule.lines})
        raise FaultPlanError(
            f"rule {plan.rules[0].name!r}: line: no rule is for {line}, but for {', '.join(named)}; "
            f"name {line}, or leave it out"
        )


def _check_agreement(rule: str, faults: tuple[Fault, ...]) -> None:
    kinds: set[str] = set()
    settings: dict[str, object] = {}
    for fault in faults:
        if fault.kind in kinds:
            raise FaultPlanError(f"rule {rule!r}: do: {fault.kind} is named twice; name it once")
        kinds.add(fault.kind)
        for entry in fields(fault):
            value = getattr(fault, entry.name)
            if settings.setdefault(entry.name, value) != value:
                raise FaultPlanError(f"rule {rule!r}: {entry.name}: is one for all kinds of a rule; make two rules")


def _check_command(rule: str, command: str) -> None:
    row = BY_NAME.get(command)
    if row is not None and row.packet_type is not None:
        raise FaultPlanError(f"rule {rule!r}: command: on the wire {command} is a special_request; write that")
    if row is None and command != GREETING:
        raise FaultPlanError(f"rule {rule!r}: command: {no_command(command, [GREETING])}")


def _check_line(rule: str, line: str) -> None:
    kind, colon, number = line.partition(":")
    if kind not in LINE_KINDS or (colon and not (number.isascii() and number.isdecimal())):
        known = ", ".join(LINE_KINDS)
        raise FaultPlanError(
            f"rule {rule!r}: line: no line {line!r}; a line is one of {known}, alone or with the robot's number, such "
            f"as serial:1{did_you_mean(kind, LINE_KINDS)}"
        )


