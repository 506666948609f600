"""What can be done to a frame, each kind a value: its settings are its fields, and they check themselves.

    the whole frame   drop | delay | nak | silence | hang_up
    its bytes         corrupt | drop_byte | stray | cut | noise

Rules: values only, nothing happens here (injector.py). A setting out of its range is a FaultPlanError that names it.
`place` is an index into the frame, negative from its end (-2 is the checksum); left out, chance picks one.

A plan of faults as a value: rules, each with what it does, to which frames, and how often. Reading it: plan_file.py

    frame ──> rule 1 ──> rule 2 ──> ... ──> arrives        a frame that a rule took away never comes to those below it

Rules: immutable, and right once made: a FaultPlanError names rule and key. Every rule counts the frames that come to
it for itself and on each line for itself, so that `every = 10` is exactly every tenth of them.

Plans of faults as TOML: text in, a Plan out, and back. The only file here that touches the disk.

    seed = 7
    [[rule]]
    name = "every tenth"                  rule 1 where left out
    do = "corrupt"                        a kind of fault (kinds.py), or a list of them: one each time, by chance
    change = "bit"                        the settings of its kinds
    command = ["gs", "get_sn"]            C names; all where left out
    direction = "reply"                   request, reply (where left out) or both
    every = 10                            or percent, first, at; each frame where left out; from_s, until_s
    line = "serial:1"                     or a list; all where left out

Rules: whatever is wrong is a FaultPlanError: file, rule, key, what was expected.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar, Final

from nclient.common.files import parse_toml, read_text
from nclient.common.hints import suggest
from nclient.errors import FaultPlanError
from nclient.protocol.codec import describe_unknown_command
from nclient.protocol.commands import BY_NAME

BIT, BYTE = "bit", "byte"
MOST_STRAY = 0xFFFF
"""The most stray bytes at once."""
LONGEST_S = 86_400.0
"""The longest delay or silence, seconds: a day."""


@dataclass(frozen=True, slots=True)
class Drop:
    """The frame does not arrive."""

    kind: ClassVar[str] = "drop"


@dataclass(frozen=True, slots=True)
class Delay:
    """The frame arrives `delay_s` later, evenly spread over that +- `jitter_s`, and what follows it no earlier."""

    delay_s: float
    jitter_s: float = 0.0
    kind: ClassVar[str] = "delay"

    def __post_init__(self) -> None:
        check_number("delay_s", self.delay_s, 0.0, LONGEST_S)
        check_number("jitter_s", self.jitter_s, 0.0, LONGEST_S)
        if self.jitter_s > self.delay_s:
            fail("jitter_s", f"at most delay_s, {self.delay_s:g}, since nothing arrives before it is sent",
                 self.jitter_s)


@dataclass(frozen=True, slots=True)
class Corrupt:
    """One byte becomes another: by one `change`d bit, or any byte but what it was."""

    change: str = BYTE
    place: int | None = None
    kind: ClassVar[str] = "corrupt"

    def __post_init__(self) -> None:
        check_choice("change", self.change, (BIT, BYTE))
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class DropByte:
    """One byte does not arrive."""

    place: int | None = None
    kind: ClassVar[str] = "drop_byte"

    def __post_init__(self) -> None:
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class InsertBytes:
    """`count` bytes that nobody sent, at one place; before the first byte and behind the last are places, too."""

    count: int = 1
    place: int | None = None
    kind: ClassVar[str] = "stray"

    def __post_init__(self) -> None:
        check_whole("count", self.count, 1, MOST_STRAY)
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class Cut:
    """The first `keep` bytes arrive, at least one less than there are."""

    keep: int | None = None
    kind: ClassVar[str] = "cut"

    def __post_init__(self) -> None:
        if self.keep is not None:
            check_whole("keep", self.keep, 0)


@dataclass(frozen=True, slots=True)
class Nak:
    """A refusal instead: of a request, which then does not arrive, or in place of a reply.

    A NAK on a robot's own line, an ERROR reply over Nserver's protocol.
    """

    kind: ClassVar[str] = "nak"


@dataclass(frozen=True, slots=True)
class Blackout:
    """From this frame on nothing arrives for `silence_s`, whatever the command, in the directions of the rule."""

    silence_s: float
    kind: ClassVar[str] = "silence"

    def __post_init__(self) -> None:
        check_number("silence_s", self.silence_s, 0.0, LONGEST_S)


@dataclass(frozen=True, slots=True)
class HangUp:
    """The connection ends, after `keep` bytes of the frame."""

    keep: int = 0
    kind: ClassVar[str] = "hang_up"

    def __post_init__(self) -> None:
        check_whole("keep", self.keep, 0)


@dataclass(frozen=True, slots=True)
class Noise:
    """Each byte for itself, in per cent of all: becomes another, does not arrive, or has a stray one behind it."""

    corrupt_percent: float = 0.0
    drop_percent: float = 0.0
    add_percent: float = 0.0
    change: str = BYTE
    kind: ClassVar[str] = "noise"

    def __post_init__(self) -> None:
        rates = {name: getattr(self, name) for name in ("corrupt_percent", "drop_percent", "add_percent")}
        for name, rate in rates.items():
            check_number(name, rate, 0.0, 100.0)
        check_choice("change", self.change, (BIT, BYTE))
        if not 0.0 < sum(rates.values()) <= 100.0:
            fail(" + ".join(rates), "together more than 0 and at most 100", sum(rates.values()))


Alteration = Corrupt | DropByte | InsertBytes | Cut
"""What changes bytes of a frame by chance alone."""
Fault = Drop | Delay | Alteration | Nak | Blackout | HangUp | Noise
KINDS: dict[str, type[Fault]] = {
    kind.kind: kind for kind in (Drop, Delay, Corrupt, DropByte, InsertBytes, Cut, Nak, Blackout, HangUp, Noise)
}
"""Every kind by the name that a plan calls it."""


def fail(key: str, wanted: str, found: object) -> None:
    """Raise FaultPlanError about one setting."""
    shown = f"{found:g}" if isinstance(found, float) else repr(found)
    raise FaultPlanError(f"{key}: {wanted}, not {shown}")


def check_whole(key: str, value: object, least: int, most: int | None = None) -> None:
    """Refuse what is no whole number from `least` to `most`."""
    wanted = f"a whole number, {least} or more" if most is None else f"a whole number, {least} to {most}"
    if not isinstance(value, int) or isinstance(value, bool) or value < least or (most is not None and value > most):
        fail(key, wanted, value)


def check_number(key: str, value: object, least: float, most: float) -> None:
    """Refuse what is no number from `least` to `most`."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        upper = f"{least:g} or more" if math.isinf(most) else f"{least:g} to {most:g}"
        fail(key, f"a number, {upper}", value)


def check_choice(key: str, value: object, choices: Iterable[str]) -> None:
    """Refuse what is none of these words."""
    choices = tuple(choices)
    if value not in choices:
        fail(key, f"one of {', '.join(choices)}", value)


def _check_place(place: object) -> None:
    if place is not None and (not isinstance(place, int) or isinstance(place, bool)):
        fail("place", "a whole number, the index of a byte, negative from the end", place)


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

    def matches(self, number: int, draw: float) -> bool:
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
        raise FaultPlanError(f"rule {rule!r}: command: {describe_unknown_command(command, [GREETING])}")


def _check_line(rule: str, line: str) -> None:
    kind, colon, number = line.partition(":")
    if kind not in LINE_KINDS or (colon and not (number.isascii() and number.isdecimal())):
        known = ", ".join(LINE_KINDS)
        raise FaultPlanError(
            f"rule {rule!r}: line: no line {line!r}; a line is one of {known}, alone or with the robot's number, such "
            f"as serial:1{suggest(kind, LINE_KINDS)}"
        )


MOST_BYTES: Final = 1 << 20
"""More than any plan by hand; a larger file is something else."""
_ANY = "all"
_WHEN = tuple(entry.name for entry in dataclasses.fields(When))
_RULE = ("name", "do", "command", "direction", "line", *_WHEN)
_DIRECTIONS = {"both": BOTH} | {direction.value: frozenset({direction}) for direction in Direction}


def load_plan(path: Path) -> Plan:
    """The plan of a file. Raises FaultPlanError."""
    return parse_plan(read_plan(path), str(path))


def read_plan(path: Path) -> str:
    """The text of a file that may be a plan. Raises FaultPlanError where it cannot be read."""
    return read_text(path, MOST_BYTES, FaultPlanError)


def parse_plan(text: str, file: str = "plan") -> Plan:
    """The plan that a text says; `file` is what errors call it. Raises FaultPlanError."""
    top = parse_toml(text, file, FaultPlanError)
    try:
        _allow(top, ("seed", "rule"))
        tables = top.get("rule", [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise FaultPlanError("rule: expected tables under [[rule]], each with its double brackets")
        return Plan(tuple(_rule(table, number) for number, table in enumerate(tables, start=1)), top.get("seed", 0))
    except FaultPlanError as error:
        raise FaultPlanError(f"{file}: {error}") from None


def plan_text(plan: Plan) -> str:
    """A plan as TOML; parse_plan makes the same plan of it."""
    lines = [f"seed = {plan.seed}"]
    for rule in plan.rules:
        lines += ["", "[[rule]]", *(f"{key} = {_value(value)}" for key, value in _entries(rule))]
    return "\n".join(lines) + "\n"


def _rule(table: Mapping[str, Any], number: int) -> Rule:
    name = table.get("name", f"rule {number}")
    if not isinstance(name, str) or not name.strip():
        raise FaultPlanError(f"rule {number}: name: expected a text, found {name!r}")
    try:
        kinds = [_kind(word) for word in _words(table, "do", ())]
        settings = {entry.name for kind in kinds for entry in dataclasses.fields(kind)}
        _allow(table, (*_RULE, *sorted(settings)))
        faults = tuple(_fault(kind, table) for kind in kinds)
        when = When(**{key: _plain(key, table[key]) for key in _WHEN if key in table})
        direction = table.get("direction", Direction.REPLY.value)
        check_choice("direction", direction, _DIRECTIONS)
        commands, lines = _names(table, "command"), _names(table, "line")
    except FaultPlanError as error:
        raise FaultPlanError(f"rule {name!r}: {error}") from None
    return Rule(name, faults, when, commands, _DIRECTIONS[direction], lines)


def _kind(word: str) -> type[Fault]:
    if word not in KINDS:
        raise FaultPlanError(f"do: no kind of fault {word!r}; there are {', '.join(KINDS)}{suggest(word, KINDS)}")
    return KINDS[word]


def _fault(kind: type[Fault], table: Mapping[str, Any]) -> Fault:
    given = {}
    for entry in dataclasses.fields(kind):
        if entry.name in table:
            given[entry.name] = table[entry.name]
        elif entry.default is dataclasses.MISSING:
            raise FaultPlanError(f"{entry.name}: is wanted by do = {kind.kind!r}")
    return kind(**given)


def _words(table: Mapping[str, Any], key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """One text or a list of them."""
    value = table.get(key, list(default))
    words = [value] if isinstance(value, str) else value
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise FaultPlanError(f"{key}: expected a text or a list of texts, found {value!r}")
    return tuple(words)


def _names(table: Mapping[str, Any], key: str) -> tuple[str, ...]:
    words = _words(table, key, (_ANY,))
    return () if _ANY in words else words


def _plain(key: str, value: Any) -> Any:
    if key != "at":
        return value
    return tuple(value) if isinstance(value, list) else (value,)


def _allow(table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            raise FaultPlanError(f"{key}: unknown here; expected one of {', '.join(known)}{suggest(key, known)}")


def _entries(rule: Rule) -> Iterator[tuple[str, Any]]:
    """The keys of a rule that are not what they are where left out."""
    yield "name", rule.name
    yield "do", [fault.kind for fault in rule.faults]
    settings = {
        entry.name: getattr(value, entry.name)
        for value in (*rule.faults, rule.when)
        for entry in dataclasses.fields(value)
        if getattr(value, entry.name) != entry.default
    }
    yield from settings.items()
    yield from ((key, list(names)) for key, names in (("command", rule.commands), ("line", rule.lines)) if names)
    yield "direction", next(word for word, directions in _DIRECTIONS.items() if directions == rule.directions)


def _value(value: object) -> str:
    """A value as TOML writes it: numbers, texts and lists are as in JSON, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
