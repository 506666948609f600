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
`inject.py` carries plans out.
"""

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from nclient.common import validation
from nclient.common.files import parse_toml, read_text
from nclient.errors import FaultPlanError, suggest
from nclient.protocol.codec import describe_unknown_command
from nclient.protocol.commands import BY_NAME

# Values of `change`: one flipped bit, as noise on a wire makes, or any other byte.
BIT: Literal["bit"] = "bit"
BYTE: Literal["byte"] = "byte"
MAX_INSERTED = 0xFFFF
"""Maximum number of bytes that one fault inserts."""
MAX_DURATION_S = 86_400.0
"""Maximum delay or silence in seconds: one day."""

Seconds = Annotated[float, Meta(ge=0.0, le=MAX_DURATION_S, description="seconds")]
Since = Annotated[float, Meta(ge=0.0, description="seconds since the plan came into force")]
Percent = Annotated[float, Meta(ge=0.0, le=100.0, description="probability in percent")]
Number = Annotated[int, Meta(ge=1, description="a count, from 1")]
Size = Annotated[int, Meta(ge=0, description="number of bytes that still arrive")]
Place = Annotated[int, Meta(title="a whole number, the index of a byte, negative from the end",
                            description="index of the byte; default: a random one")]
Change = Annotated[Literal["bit", "byte"], Meta(description="one flipped bit, or any other byte")]


class _Checked:
    """A dataclass whose values are checked against the types of its fields when it is created."""

    __slots__ = ()

    def __post_init__(self) -> None:
        validation.check_fields(self, FaultPlanError)


@dataclass(frozen=True, slots=True)
class Drop:
    """Drop the frame."""

    kind: ClassVar[str] = "drop"


@dataclass(frozen=True, slots=True)
class Delay(_Checked):
    """Delay the frame by `delay_s` +- `jitter_s`, uniformly distributed; later frames do not overtake it."""

    delay_s: Seconds
    jitter_s: Seconds = 0.0
    kind: ClassVar[str] = "delay"

    def __post_init__(self) -> None:
        validation.check_fields(self, FaultPlanError)
        # A jitter larger than the delay would need negative delays.
        if self.jitter_s > self.delay_s:
            raise FaultPlanError(f"jitter_s: expected at most delay_s, {self.delay_s:g}, because nothing arrives "
                                 f"before it was sent, found {self.jitter_s:g}")


@dataclass(frozen=True, slots=True)
class Corrupt(_Checked):
    """Change one byte: one bit of it, or to any other byte."""

    change: Change = BYTE
    place: Place | None = None
    kind: ClassVar[str] = "corrupt"


@dataclass(frozen=True, slots=True)
class DropByte(_Checked):
    """Drop one byte."""

    place: Place | None = None
    kind: ClassVar[str] = "drop_byte"


@dataclass(frozen=True, slots=True)
class InsertBytes(_Checked):
    """Insert `count` random bytes at one place, which may be before the first byte or behind the last."""

    count: Annotated[int, Meta(ge=1, le=MAX_INSERTED, description="number of bytes")] = 1
    place: Place | None = None
    kind: ClassVar[str] = "stray"


@dataclass(frozen=True, slots=True)
class Cut(_Checked):
    """Deliver only the first `keep` bytes, at most all but one."""

    keep: Size | None = None
    kind: ClassVar[str] = "cut"


@dataclass(frozen=True, slots=True)
class Nak:
    """Answer a request with a refusal instead of delivering it, or replace a reply by one.

    A refusal is a NAK on the serial line and an ERROR reply over TCP.
    """

    kind: ClassVar[str] = "nak"


@dataclass(frozen=True, slots=True)
class Blackout(_Checked):
    """Drop this frame and all later ones for `silence_s`, of any command, in the directions of the rule."""

    silence_s: Seconds
    kind: ClassVar[str] = "silence"


@dataclass(frozen=True, slots=True)
class HangUp(_Checked):
    """Close the connection after `keep` bytes of the frame."""

    keep: Size = 0
    kind: ClassVar[str] = "hang_up"


@dataclass(frozen=True, slots=True)
class Noise(_Checked):
    """Change, drop or add bytes at random: each rate is the percentage of all bytes."""

    corrupt_percent: Percent = 0.0
    drop_percent: Percent = 0.0
    add_percent: Percent = 0.0
    change: Change = BYTE
    kind: ClassVar[str] = "noise"

    def __post_init__(self) -> None:
        validation.check_fields(self, FaultPlanError)
        # The three rates share one draw per byte, so their sum is a probability.
        rate = self.corrupt_percent + self.drop_percent + self.add_percent
        if not 0.0 < rate <= 100.0:
            raise FaultPlanError("corrupt_percent + drop_percent + add_percent: expected together more than 0 and at "
                                 f"most 100, found {rate:g}")


Alteration = Corrupt | DropByte | InsertBytes | Cut
"""Faults that change the bytes of one frame."""
Fault = Drop | Delay | Alteration | Nak | Blackout | HangUp | Noise
KINDS: dict[str, type[Fault]] = {
    kind.kind: kind for kind in (Drop, Delay, Corrupt, DropByte, InsertBytes, Cut, Nak, Blackout, HangUp, Noise)
}
"""Kinds by their names in plans."""


GREETING = "hello"
"""Command name in plans of the handshake, eleven bytes that an N200 sends first over TCP."""
LINE_KINDS = ("serial", "robotd", "nserver", "real", "sim", "replay")
"""Kinds of lines: a robot's serial line, directly and over TCP; Nserver's; a gateway's to the real robot; a simulation
and a recording in the program's own process."""
# Upper limit of seeds: integers of TOML have 64 bits.
MAX_SEED = 2**63
Seed = Annotated[int, Meta(ge=0, description="seed of all random numbers", extra_json_schema={"maximum": MAX_SEED})]


class Direction(Enum):
    """Direction of a frame: to the robot, or to the host."""

    REQUEST = "request"
    REPLY = "reply"


BOTH = frozenset(Direction)
Numbers = Annotated[tuple[Number, ...], Meta(min_length=1, extra_json_schema={"x-items": "numbers of frames"})]
METHODS = ("every", "percent", "first", "at")
"""Methods of selecting frames, of which a rule has at most one."""


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

    every: Number | None = None
    percent: Percent | None = None
    first: Number | None = None
    at: Numbers | None = None
    from_s: Since = 0.0
    until_s: Since = math.inf

    def __post_init__(self) -> None:
        # 1. At most one method; none of them selects every frame.
        methods = [name for name in METHODS if getattr(self, name) is not None]
        if len(methods) > 1:
            raise FaultPlanError(f"{methods[1]}: {' and '.join(methods)} exclude each other; use one of them")
        # 2. Values.
        validation.check_fields(self, FaultPlanError)
        # 3. A time window of positive length.
        if self.until_s <= self.from_s:
            raise FaultPlanError(f"until_s: expected later than from_s, {self.from_s:g}, found {self.until_s:g}")

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
        with validation.reported_as(FaultPlanError):
            if validation.convert(self.seed, Seed, "seed") > MAX_SEED:
                complaint = f"expected a whole number from 0 to {MAX_SEED}, found {self.seed}"
                raise validation.InvalidValue(complaint, "seed")
        names: set[str] = set()
        for rule in self.rules:
            if rule.name in names:
                raise FaultPlanError(f"rule {rule.name!r}: name: an earlier rule has this name; choose another")
            names.add(rule.name)


def require_rules_for(line: str, plan: Plan) -> None:
    """Raise FaultPlanError if a plan has no rule for this line."""
    if plan.rules and not any(rule.acts_on(line) for rule in plan.rules):
        named = sorted({name for rule in plan.rules for name in rule.lines})
        raise FaultPlanError(f"rule {plan.rules[0].name!r}: line: no rule applies to {line}, only to "
                             f"{', '.join(named)}; name {line}, or leave it out")


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
        raise FaultPlanError(f"rule {rule!r}: line: no line {line!r}; a line is one of {choices}, alone or with the "
                             f"number of a robot, such as serial:1{suggest(kind, LINE_KINDS)}")


MAX_BYTES: Final = 1 << 20
"""Maximum size of a plan; a larger file is something else."""
_ANY = "all"
_DIRECTIONS = {"both": BOTH} | {direction.value: frozenset({direction}) for direction in Direction}
_COMMANDS = [name for name, row in BY_NAME.items() if row.packet_type is None]
_LINE = Annotated[str, Meta(extra_json_schema={"pattern": f"^({'|'.join(LINE_KINDS)})(:[0-9]+)?$|^{_ANY}$"})]
_COMMAND = Annotated[str, Meta(title="a text", extra_json_schema={"enum": [*_COMMANDS, GREETING, _ANY]})]
_KIND: Any = validation.one_of(KINDS)
_KINDS = Annotated[tuple[_KIND, ...], Meta(min_length=1, extra_json_schema={"uniqueItems": True, "x-items": "kinds"})]
_RULE_FIELDS: list[Any] = [
    ("name", Annotated[validation.Text, Meta(description="name in errors and counts; default: rule 1, rule 2 ...")],
     "rule"),
    ("do", Annotated[_KIND | _KINDS, Meta(description="a kind of fault, or several, drawn each time")]),
    ("command", Annotated[_COMMAND | tuple[_COMMAND, ...], Meta(description="C names of the commands it acts on")],
     _ANY),
    ("line", Annotated[_LINE | tuple[_LINE, ...], Meta(description="lines it acts on, such as nserver or serial:2")],
     _ANY),
    ("direction", Annotated[validation.one_of(_DIRECTIONS), Meta(description="frames it acts on")],
     Direction.REPLY.value),
    *(row for row in validation.dataclass_keys(When) if row[0] != "at"),
    # `at = 3` is short for `at = [3]`.
    ("at", Annotated[Number | Numbers, Meta(description="numbers of the frames it acts on, from 1")] | UnsetType,
     UNSET),
]
_RULE_KEYS: list[str] = [row[0] for row in _RULE_FIELDS]
_SETTINGS: dict[str, Any] = {row[0]: row for kind in KINDS.values() for row in validation.dataclass_keys(kind)}


def _does(*kinds: str) -> dict[str, Any]:
    """Return the condition that a rule's `do` has one of these kinds, as JSON Schema."""
    names = {"enum": kinds}
    return {"properties": {"do": {"anyOf": [names, {"type": "array", "contains": names}]}}}


def _conditions() -> Iterator[dict[str, Any]]:
    """Yield the conditions on several keys of a rule, as JSON Schema."""
    yield validation.at_most_one(METHODS)
    for key in _SETTINGS:
        kinds = (name for name, kind in KINDS.items() if key in validation.field_types(kind))
        yield {"if": {"required": [key]}, "then": _does(*kinds)}
    for name, kind in KINDS.items():
        required = [entry.name for entry in fields(kind) if entry.default is dataclasses.MISSING]
        yield {"if": _does(name), "then": {"required": required}}


RuleTable: Any = msgspec.defstruct(
    "Rule", [*_RULE_FIELDS, *_SETTINGS.values()],
    namespace={"__doc__": "Faults, and the frames they are applied to.", "CONDITIONS": [*_conditions()]},
    forbid_unknown_fields=True, kw_only=True,
)  # fmt: skip
"""A [[rule]] of a plan file."""


class _PlanTables(msgspec.Struct, forbid_unknown_fields=True):
    """The tables of a plan file; each rule is converted on its own, since errors name the rule."""

    seed: Seed = 0
    rule: tuple[dict[str, Any], ...] = ()


class PlanFile(_PlanTables, forbid_unknown_fields=True):
    """A fault plan: which frames on the way to and from robots are lost, delayed or changed."""

    rule: Annotated[tuple[RuleTable, ...], Meta(description="rules, in the order in which a frame passes them")] = ()


def load_plan(path: Path) -> Plan:
    """Read a plan from a file. Raises FaultPlanError."""
    return parse_plan(read_plan(path), str(path))


def read_plan(path: Path) -> str:
    """Return the text of a plan file. Raises FaultPlanError if it cannot be read."""
    return read_text(path, MAX_BYTES, FaultPlanError)


def parse_plan(text: str, file: str = "plan") -> Plan:
    """Parse a plan; `file` is the name in error messages. Raises FaultPlanError."""
    top = parse_toml(text, file, FaultPlanError)
    with validation.reported_as(FaultPlanError, file):
        values = validation.convert(top, _PlanTables)
    try:
        return Plan(tuple(_rule(table, number) for number, table in enumerate(values.rule, start=1)), values.seed)
    except FaultPlanError as error:
        raise FaultPlanError(f"{file}: {error}") from None


def plan_text(plan: Plan) -> str:
    """Return a plan as TOML; `parse_plan` reads it back to an equal plan."""
    lines = [f"seed = {plan.seed}"]
    for rule in plan.rules:
        lines += ["", "[[rule]]", *(f"{key} = {_value(value)}" for key, value in _entries(rule))]
    return "\n".join(lines) + "\n"


def _rule(table: dict[str, Any], number: int) -> Rule:
    name = table.get("name", f"rule {number}")
    with validation.reported_as(FaultPlanError, f"rule {number}"):
        validation.convert(name, validation.Text, "name")
    with validation.reported_as(FaultPlanError, f"rule {name!r}"):
        row = validation.convert(table, RuleTable)
        # 1. Settings of other kinds are unknown keys.
        kinds = [KINDS[word] for word in _words(row.do)]
        settings = sorted(key for kind in kinds for key in validation.field_types(kind))
        for key in table:
            if key not in _RULE_KEYS and key not in settings:
                raise validation.unknown_key(key, (*_RULE_KEYS, *settings))
    try:
        # 2. Faults, selection and direction; each checks how its own values fit together.
        values = validation.given(row)
        faults = tuple(_fault(kind, values) for kind in kinds)
        times = {key: values[key] for key in validation.field_types(When) if key in values}
        if isinstance(row.at, int):
            times["at"] = (row.at,)
        when = When(**times)
    except FaultPlanError as error:
        raise FaultPlanError(f"rule {name!r}: {error}") from None
    return Rule(name, faults, when, _names(row.command), _DIRECTIONS[row.direction], _names(row.line))


def _fault(kind: type[Fault], values: Mapping[str, Any]) -> Fault:
    for entry in fields(kind):
        if entry.name not in values and entry.default is dataclasses.MISSING:
            raise FaultPlanError(f"{entry.name}: required by do = {kind.kind!r}")
    return kind(**{key: values[key] for key in validation.field_types(kind) if key in values})


def _words(value: str | tuple[str, ...]) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else value


def _names(value: str | tuple[str, ...]) -> tuple[str, ...]:
    return () if _ANY in _words(value) else _words(value)


def _entries(rule: Rule) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a rule whose values differ from their defaults."""
    yield "name", rule.name
    yield "do", [fault.kind for fault in rule.faults]
    settings = {entry.name: getattr(value, entry.name) for value in (*rule.faults, rule.when)
                for entry in dataclasses.fields(value) if getattr(value, entry.name) != entry.default}
    yield from settings.items()
    yield from ((key, list(names)) for key, names in (("command", rule.commands), ("line", rule.lines)) if names)
    yield "direction", next(word for word, directions in _DIRECTIONS.items() if directions == rule.directions)


def _value(value: object) -> str:
    """Format a value as TOML, where numbers, texts and lists are as in JSON, except for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
