"""Fault plans: the kinds of faults, rules, and reading plans from TOML.

    frame ──> rule 1 ──> rule 2 ──> ... ──> delivered        a frame dropped by a rule does not reach the later ones

    seed = 7
    [[rule]]
    name = "every tenth"                  default: rule 1
    do = "corrupt"                        a kind of fault, or a list of which one is drawn each time
    change = "bit"                        settings of the kinds
    command = ["gs", "get_sn"]            C names; default: all
    direction = "reply"                   request, reply (default) or both
    every = 10                            or percent, first, at; default: each frame; from_s, until_s
    line = "serial:1"                     or a list; default: all

Kinds for whole frames: drop, delay, nak, silence, hang_up; for bytes: corrupt, drop_byte, stray, cut, noise.
`place` is an index into the frame, negative from its end (-2 is the checksum); by default it is drawn at random.

Plans are immutable and validated when created; errors are FaultPlanError with file, rule, key and the expected value.
Each rule counts the frames that reach it, separately per line, so that `every = 10` is exactly every tenth of them.
`frames.py` carries plans out.
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

# Values of `change`: one flipped bit, as noise on a wire makes, or any other byte.
BIT, BYTE = "bit", "byte"
MAX_INSERTED = 0xFFFF
"""Maximum number of bytes that one fault inserts."""
MAX_DURATION_S = 86_400.0
"""Maximum delay or silence in seconds: one day."""


@dataclass(frozen=True, slots=True)
class Drop:
    """Drop the frame."""

    kind: ClassVar[str] = "drop"


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay the frame by `delay_s` +- `jitter_s`, uniformly distributed; later frames do not overtake it."""

    delay_s: float
    jitter_s: float = 0.0
    kind: ClassVar[str] = "delay"

    def __post_init__(self) -> None:
        check_number("delay_s", self.delay_s, 0.0, MAX_DURATION_S)
        check_number("jitter_s", self.jitter_s, 0.0, MAX_DURATION_S)
        # A jitter larger than the delay would need negative delays.
        if self.jitter_s > self.delay_s:
            fail("jitter_s", f"at most delay_s, {self.delay_s:g}, because nothing arrives before it was sent",
                 self.jitter_s)


@dataclass(frozen=True, slots=True)
class Corrupt:
    """Change one byte: one bit of it, or to any other byte."""

    change: str = BYTE
    place: int | None = None
    kind: ClassVar[str] = "corrupt"

    def __post_init__(self) -> None:
        check_choice("change", self.change, (BIT, BYTE))
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class DropByte:
    """Drop one byte."""

    place: int | None = None
    kind: ClassVar[str] = "drop_byte"

    def __post_init__(self) -> None:
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class InsertBytes:
    """Insert `count` random bytes at one place, which may be before the first byte or behind the last."""

    count: int = 1
    place: int | None = None
    kind: ClassVar[str] = "stray"

    def __post_init__(self) -> None:
        check_whole("count", self.count, 1, MAX_INSERTED)
        _check_place(self.place)


@dataclass(frozen=True, slots=True)
class Cut:
    """Deliver only the first `keep` bytes, at most all but one."""

    keep: int | None = None
    kind: ClassVar[str] = "cut"

    def __post_init__(self) -> None:
        if self.keep is not None:
            check_whole("keep", self.keep, 0)


@dataclass(frozen=True, slots=True)
class Nak:
    """Answer a request with a refusal instead of delivering it, or replace a reply by one.

    A refusal is a NAK on the serial line and an ERROR reply over TCP.
    """

    kind: ClassVar[str] = "nak"


@dataclass(frozen=True, slots=True)
class Blackout:
    """Drop this frame and all later ones for `silence_s`, of any command, in the directions of the rule."""

    silence_s: float
    kind: ClassVar[str] = "silence"

    def __post_init__(self) -> None:
        check_number("silence_s", self.silence_s, 0.0, MAX_DURATION_S)


@dataclass(frozen=True, slots=True)
class HangUp:
    """Close the connection after `keep` bytes of the frame."""

    keep: int = 0
    kind: ClassVar[str] = "hang_up"

    def __post_init__(self) -> None:
        check_whole("keep", self.keep, 0)


@dataclass(frozen=True, slots=True)
class Noise:
    """Change, drop or add bytes at random: each rate is the percentage of all bytes."""

    corrupt_percent: float = 0.0
    drop_percent: float = 0.0
    add_percent: float = 0.0
    change: str = BYTE
    kind: ClassVar[str] = "noise"

    def __post_init__(self) -> None:
        # The three rates share one draw per byte, so their sum is a probability.
        rates = {name: getattr(self, name) for name in ("corrupt_percent", "drop_percent", "add_percent")}
        for name, rate in rates.items():
            check_number(name, rate, 0.0, 100.0)
        check_choice("change", self.change, (BIT, BYTE))
        if not 0.0 < sum(rates.values()) <= 100.0:
            fail(" + ".join(rates), "together more than 0 and at most 100", sum(rates.values()))


Alteration = Corrupt | DropByte | InsertBytes | Cut
"""Faults that change the bytes of one frame."""
Fault = Drop | Delay | Alteration | Nak | Blackout | HangUp | Noise
KINDS: dict[str, type[Fault]] = {
    kind.kind: kind for kind in (Drop, Delay, Corrupt, DropByte, InsertBytes, Cut, Nak, Blackout, HangUp, Noise)
}
"""Kinds by their names in plans."""


def fail(key: str, wanted: str, found: object) -> None:
    """Raise FaultPlanError for one setting."""
    # Numbers without trailing zeros, texts in quotes.
    shown = f"{found:g}" if isinstance(found, float) else repr(found)
    raise FaultPlanError(f"{key}: {wanted}, not {shown}")


def check_whole(key: str, value: object, minimum: int, maximum: int | None = None) -> None:
    """Raise FaultPlanError unless `value` is a whole number from `minimum` to `maximum`."""
    wanted = f"a whole number, {minimum} or more" if maximum is None else f"a whole number, {minimum} to {maximum}"
    if (
        not isinstance(value, int)
        or isinstance(value, bool)
        or value < minimum
        or (maximum is not None and value > maximum)
    ):
        fail(key, wanted, value)


def check_number(key: str, value: object, minimum: float, maximum: float) -> None:
    """Raise FaultPlanError unless `value` is a number from `minimum` to `maximum`."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not minimum <= value <= maximum:
        upper = f"{minimum:g} or more" if math.isinf(maximum) else f"{minimum:g} to {maximum:g}"
        fail(key, f"a number, {upper}", value)


def check_choice(key: str, value: object, choices: Iterable[str]) -> None:
    """Raise FaultPlanError unless `value` is one of `choices`."""
    choices = tuple(choices)
    if value not in choices:
        fail(key, f"one of {', '.join(choices)}", value)


def _check_place(place: object) -> None:
    if place is not None and (not isinstance(place, int) or isinstance(place, bool)):
        fail("place", "a whole number, the index of a byte, negative from the end", place)


GREETING = "hello"
"""Command name in plans of the handshake, eleven bytes that an N200 sends first over TCP."""
LINE_KINDS = ("serial", "robotd", "nserver", "real", "sim", "replay")
"""Kinds of lines: a robot's serial line, directly and over TCP; Nserver's; a gateway's to the real robot; a simulation
and a recording in the program's own process."""
# Upper limit of seeds: integers of TOML have 64 bits.
MAX_SEED = 2**63


class Direction(Enum):
    """Direction of a frame: to the robot, or to the host."""

    REQUEST = "request"
    REPLY = "reply"


BOTH = frozenset(Direction)


@dataclass(frozen=True, slots=True)
class When:
    """Frames that a rule applies to, of those that reach it: all, or selected by one of four methods; and the time.

    Attributes
    ----------
    every
        Every n-th frame.
    percent
        Probability in per cent.
    first
        The first n frames.
    at
        Frames of these numbers, counted from 1.
    from_s, until_s
        Seconds since the plan came into force.
    """

    every: int | None = None
    percent: float | None = None
    first: int | None = None
    at: tuple[int, ...] | None = None
    from_s: float = 0.0
    until_s: float = math.inf

    def __post_init__(self) -> None:
        # 1. At most one method; none of them selects every frame.
        methods = [name for name in ("every", "percent", "first", "at") if getattr(self, name) is not None]
        if len(methods) > 1:
            raise FaultPlanError(f"{methods[1]}: {' and '.join(methods)} exclude each other; use one of them")
        # 2. Its value.
        if self.every is not None:
            check_whole("every", self.every, 1)
        if self.percent is not None:
            check_number("percent", self.percent, 0.0, 100.0)
        if self.first is not None:
            check_whole("first", self.first, 1)
        if self.at == ():
            raise FaultPlanError("at: expected numbers of frames, such as [3, 7]; there are none")
        for number in self.at or ():
            check_whole("at", number, 1)
        # 3. A time window of positive length.
        check_number("from_s", self.from_s, 0.0, math.inf)
        check_number("until_s", self.until_s, 0.0, math.inf)
        if self.until_s <= self.from_s:
            fail("until_s", f"later than from_s, {self.from_s:g}", self.until_s)

    def covers(self, elapsed_s: float) -> bool:
        """Return True if the rule is in force `elapsed_s` after the start of the plan."""
        return self.from_s <= elapsed_s < self.until_s

    def matches(self, number: int, draw: float) -> bool:
        """Return True if the rule applies to a frame.

        Parameters
        ----------
        number
            Number of the frame, counted from 1.
        draw
            Random number in [0, 1).
        """
        if self.every is not None:
            return number % self.every == 0
        if self.percent is not None:
            return 100.0 * draw < self.percent
        if self.first is not None:
            return number <= self.first
        return self.at is None or number in self.at


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule: faults, the frames they are applied to, and when.

    Attributes
    ----------
    name
        Name in errors and counts.
    faults
        Kinds of which one is drawn each time. They differ in kind; a setting that two of them have is equal.
    when
        Selection by number, probability and time.
    commands
        C names; empty for all.
    directions
        Directions of the frames.
    lines
        Names such as serial:1, robotd:1, nserver; `serial` means every serial line, empty all lines.
    """

    name: str
    faults: tuple[Fault, ...]
    when: When = field(default_factory=When)
    commands: tuple[str, ...] = ()
    directions: frozenset[Direction] = frozenset({Direction.REPLY})
    lines: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.faults:
            raise FaultPlanError(f"rule {self.name!r}: do: expected at least one kind of fault")
        if not self.directions:
            raise FaultPlanError(f"rule {self.name!r}: direction: expected request, reply or both")
        # Unknown names are errors: a misspelt command would otherwise never match.
        _check_agreement(self.name, self.faults)
        for command in self.commands:
            _check_command(self.name, command)
        for line in self.lines:
            _check_line(self.name, line)

    def acts_on(self, line: str) -> bool:
        """Return True if the rule applies to the line of this name."""
        # "serial" matches "serial:1", "serial:2", ...
        return not self.lines or line in self.lines or line.partition(":")[0] in self.lines

    def matches(self, command: str, direction: Direction) -> bool:
        """Return True if the rule applies to frames of this command in this direction."""
        return direction in self.directions and (not self.commands or command in self.commands)


@dataclass(frozen=True, slots=True)
class Plan:
    """Rules, in the order in which a frame passes them, and the seed of all random numbers."""

    rules: tuple[Rule, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        check_whole("seed", self.seed, 0, MAX_SEED)
        names: set[str] = set()
        for rule in self.rules:
            if rule.name in names:
                raise FaultPlanError(f"rule {rule.name!r}: name: an earlier rule has this name; choose another")
            names.add(rule.name)


def require_rules_for(line: str, plan: Plan) -> None:
    """Raise FaultPlanError if a plan has no rule for this line."""
    if plan.rules and not any(rule.acts_on(line) for rule in plan.rules):
        named = sorted({name for rule in plan.rules for name in rule.lines})
        raise FaultPlanError(
            f"rule {plan.rules[0].name!r}: line: no rule applies to {line}, only to {', '.join(named)}; "
            f"name {line}, or leave it out"
        )


def _check_agreement(rule: str, faults: tuple[Fault, ...]) -> None:
    # Kinds share the rule's table of settings, so one key cannot have two values.
    kinds: set[str] = set()
    settings: dict[str, object] = {}
    for fault in faults:
        if fault.kind in kinds:
            raise FaultPlanError(f"rule {rule!r}: do: {fault.kind} is named twice; name it once")
        kinds.add(fault.kind)
        for entry in fields(fault):
            value = getattr(fault, entry.name)
            if settings.setdefault(entry.name, value) != value:
                raise FaultPlanError(f"rule {rule!r}: {entry.name}: applies to all kinds of a rule; write two rules")


def _check_command(rule: str, command: str) -> None:
    # Commands of the arm are sent as packets, whose frames have the name special_request.
    row = BY_NAME.get(command)
    if row is not None and row.packet_type is not None:
        raise FaultPlanError(f"rule {rule!r}: command: {command} is sent as a special_request; write that")
    if row is None and command != GREETING:
        raise FaultPlanError(f"rule {rule!r}: command: {describe_unknown_command(command, [GREETING])}")


def _check_line(rule: str, line: str) -> None:
    # A kind of line, alone or with the number of a robot.
    kind, colon, number = line.partition(":")
    if kind not in LINE_KINDS or (colon and not (number.isascii() and number.isdecimal())):
        choices = ", ".join(LINE_KINDS)
        raise FaultPlanError(
            f"rule {rule!r}: line: no line {line!r}; a line is one of {choices}, alone or with the number of a robot, "
            f"such as serial:1{suggest(kind, LINE_KINDS)}"
        )


MAX_BYTES: Final = 1 << 20
"""Maximum size of a plan; a larger file is something else."""
_ANY = "all"
# Keys of the selection are the fields of When; the same applies to the settings of kinds.
_WHEN = tuple(entry.name for entry in dataclasses.fields(When))
_RULE = ("name", "do", "command", "direction", "line", *_WHEN)
_DIRECTIONS = {"both": BOTH} | {direction.value: frozenset({direction}) for direction in Direction}


def load_plan(path: Path) -> Plan:
    """Read a plan from a file. Raises FaultPlanError."""
    return parse_plan(read_plan(path), str(path))


def read_plan(path: Path) -> str:
    """Return the text of a plan file. Raises FaultPlanError if it cannot be read."""
    return read_text(path, MAX_BYTES, FaultPlanError)


def parse_plan(text: str, file: str = "plan") -> Plan:
    """Parse a plan; `file` is the name in error messages. Raises FaultPlanError."""
    top = parse_toml(text, file, FaultPlanError)
    try:
        # Unknown keys are errors, with a suggestion, since a misspelt one would be ignored.
        _allow(top, ("seed", "rule"))
        tables = top.get("rule", [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise FaultPlanError("rule: expected tables under [[rule]], each with its double brackets")
        return Plan(tuple(_rule(table, number) for number, table in enumerate(tables, start=1)), top.get("seed", 0))
    except FaultPlanError as error:
        raise FaultPlanError(f"{file}: {error}") from None


def plan_text(plan: Plan) -> str:
    """Return a plan as TOML; `parse_plan` reads it back to an equal plan."""
    lines = [f"seed = {plan.seed}"]
    for rule in plan.rules:
        lines += ["", "[[rule]]", *(f"{key} = {_value(value)}" for key, value in _entries(rule))]
    return "\n".join(lines) + "\n"


def _rule(table: Mapping[str, Any], number: int) -> Rule:
    name = table.get("name", f"rule {number}")
    if not isinstance(name, str) or not name.strip():
        raise FaultPlanError(f"rule {number}: name: expected a text, found {name!r}")
    try:
        # 1. The kinds decide which other keys the rule may have.
        kinds = [_kind(word) for word in _words(table, "do", ())]
        # Keys of a rule: its own, and the settings of its kinds.
        settings = {entry.name for kind in kinds for entry in dataclasses.fields(kind)}
        _allow(table, (*_RULE, *sorted(settings)))
        # 2. Faults, selection and direction; each checks its own values.
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
        # Keys that are not given take the default of the dataclass.
        if entry.name in table:
            given[entry.name] = table[entry.name]
        elif entry.default is dataclasses.MISSING:
            raise FaultPlanError(f"{entry.name}: required by do = {kind.kind!r}")
    return kind(**given)


def _words(table: Mapping[str, Any], key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """Return the value of a key as a tuple: one text or a list of texts."""
    value = table.get(key, list(default))
    words = [value] if isinstance(value, str) else value
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise FaultPlanError(f"{key}: expected a text or a list of texts, found {value!r}")
    return tuple(words)


def _names(table: Mapping[str, Any], key: str) -> tuple[str, ...]:
    words = _words(table, key, (_ANY,))
    return () if _ANY in words else words


def _plain(key: str, value: Any) -> Any:
    # `at = 3` is short for `at = [3]`.
    if key != "at":
        return value
    return tuple(value) if isinstance(value, list) else (value,)


def _allow(table: Mapping[str, Any], choices: tuple[str, ...]) -> None:
    for key in table:
        if key not in choices:
            raise FaultPlanError(f"{key}: unknown here; expected one of {', '.join(choices)}{suggest(key, choices)}")


def _entries(rule: Rule) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a rule whose values differ from their defaults."""
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
    """Format a value as TOML, where numbers, texts and lists are as in JSON, except for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
