"""Plans of faults as TOML: text in, a Plan out, and back. The only file here that touches the disk.

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
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from nclient.errors import FaultPlanError
from nclient.faults.kinds import KINDS, Fault, check_choice
from nclient.faults.plan import BOTH, Direction, Plan, Rule, When
from nclient.file_text import read_text, toml_of
from nclient.suggesting import did_you_mean

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
    top = toml_of(text, file, FaultPlanError)
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
        raise FaultPlanError(f"do: no kind of fault {word!r}; there are {', '.join(KINDS)}{did_you_mean(word, KINDS)}")
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
            raise FaultPlanError(f"{key}: unknown here; expected one of {', '.join(known)}{did_you_mean(key, known)}")


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
