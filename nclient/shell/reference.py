"""Usage and help of every command: read off the table, with the units of its numbers.

    pr translation steering turret           usage: the arguments as C has them, lists as name[16]

Rules: pure. What the C call does not have (pid, and Smask, which ct takes from the array) is left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from nclient.protocol.bounds import line_bounds
from nclient.protocol.commands import BY_NAME, COMMANDS, Argument, Command, on_line
from nclient.protocol.models import MODELS, Model
from nclient.protocol.requests import FLAG_WORD
from nclient.protocol.terms import Terms

UNITS = {
    "translation": "1/10 in", "steering": "1/10 deg", "turret": "1/10 deg", "x": "1/10 in", "y": "1/10 in",
    "x1": "1/10 in", "y1": "1/10 in", "x2": "1/10 in", "y2": "1/10 in", "x0": "1/10 in", "y0": "1/10 in",
    "w": "1/10 in", "h": "1/10 in", "th1": "1/10 deg", "th2": "1/10 deg", "timeout_s": "s",
}  # fmt: skip
_RATES = {"vm": "/s", "sp": "/s", "ac": "/s2"}
_LINEAR, _ANGULAR = ("translation",), ("steering", "turret")
MORE = {
    "add_obstacle": ("x1 y1 .. xn yn",), "delete_obstacle": ("x1 y1 .. xn yn",),
    "move_obstacle": ("x1 y1 .. xn yn", "dx dy"),
    "motion_check": ("x1 y1 x2 y2 | x1 y1 angle1 angle2 radius xc yc",), "special_request": ("byte ..",),
}  # fmt: skip
"""What follows the named arguments of commands of any length."""
_NOTES = {
    "ct": "sends Smask: set it by Smask[17] = 0, look at it by Smask; or ct {44 numbers}",
    "motion_check": "type 0 is a line, 1 an arc; lengths in 1/10 in, the two angles in rad; fractions are welcome",
    "tk": "several words need no quotes",
    "mv": "modes: 0 leave, 1 velocity, 2 relative, 3 limp, 4 acceleration, 5 speed; values in tenths",
    "conf_sn": "rate in steps of 4 ms; the order ends with 255 or after the last that is given: conf_sn 15 {0, 2, 15}",
    "conf_ir": "the order ends with 255 or after the last that is given",
    "sim_control": "verbs: 1 pause, 2 resume, 3 speed (times ten), 4 step (ms)",
    "special_request": "the packet's type and its bytes; length and serial are put before them",
}
_WHEELS = "a Scout's are its right wheel, its left wheel, and 0, all in tenths of an inch"
_ON_WHEELS = frozenset({"vm", "pr", "sp", "ac", "mv"})
_EXAMPLES = {
    "pr": "pr 240 0 0", "vm": "vm 100 0 0", "sp": "sp 200 450 450", "ac": "ac 300 300 300", "ws": "ws 1 1 1 20",
    "mv": "mv 1 100 0 0 0 0", "dp": "dp 0 0", "da": "da 0 0", "place_robot": "place_robot 600 400 0 0",
    "conf_tm": "conf_tm 5", "tk": "tk good morning", "add_obstacle": "add_obstacle 3 0 0 100 0 0 100",
    "motion_check": "motion_check 0 0 0 400 0", "sim_control": "sim_control 4 1000",
}  # fmt: skip


class Parameter(NamedTuple):
    """An argument as C has it: a number, or a list where `length` is more than 1."""

    name: str
    unit: str
    length: int = 1

    def __str__(self) -> str:
        return self.name if self.length == 1 else f"{self.name}[{self.length}]"


def parameters(row: Command) -> tuple[Parameter, ...]:
    """The arguments of the C call: order_0 to order_15 are one, order[16]."""
    found: list[Parameter] = []
    for argument in row.arguments:
        name, numbered = re.subn(r"_\d+$", "", argument.name)
        if row.beside is not None and row.beside[0] in ("pid", "mask") and name in ("pid", "Smask"):
            continue
        if numbered and found and found[-1].name == name:
            found[-1] = found[-1]._replace(length=found[-1].length + 1)
        else:
            found.append(Parameter(name, _unit(row, argument)))
    return tuple(found)


def usage(row: Command) -> str:
    """The command and its arguments in one line."""
    return " ".join((row.name, *map(str, parameters(row)), *MORE.get(row.name, ())))


def available(row: Command, terms: Terms) -> bool:
    """Whether the command exists where these terms hold: over TCP, or on that model's own line."""
    return on_line(row, terms.model) if terms.line else row.tcp_type is not None


def help_lines(name: str, terms: Terms) -> Iterator[str]:
    """All there is to say of a command of the table."""
    row = BY_NAME[name]
    yield usage(row)
    yield f"  {row.summary}"
    bounds = {bound: (least, most) for bound, least, most in line_bounds(name)} if terms.line else {}
    for parameter in parameters(row):
        if parameter.unit or parameter.name in bounds:
            least, most = bounds.get(parameter.name, ("", ""))
            span = f"{least} to {most}" if bounds else ""
            yield f"    {parameter.name:12} {parameter.unit:10} {span}".rstrip()
    if name in _NOTES:
        yield f"  {_NOTES[name]}"
    if name in _ON_WHEELS and not terms.model.has_turret:
        yield f"  {_WHEELS}"
    if name in _EXAMPLES:
        yield f"  such as: {_EXAMPLES[name]}"
    yield f"  in Python: robot.{row.method}; {_where(row)}"


def summaries(terms: Terms) -> dict[str, str]:
    """Usage and summary of every command that there is here, in the table's order."""
    return {usage(row): row.summary for row in COMMANDS if available(row, terms)}


def _where(row: Command) -> str:
    models = [model.name for model in MODELS.values() if on_line(row, model)]
    lines = f"on the own line of {', '.join(models)}" if models else "on no robot's own line"
    return f"{'over TCP' if row.tcp_type is not None else 'not over TCP'}, {lines}"


def _unit(row: Command, argument: Argument) -> str:
    if argument.tcp is FLAG_WORD:
        return "0 or 1"
    unit = UNITS.get(argument.name, "")
    return unit + _RATES.get(row.name, "") if argument.name in _LINEAR + _ANGULAR else unit


def model_note(model: Model) -> str:
    """One line about units that holds for all commands."""
    axes = "translation, steering, turret" if model.has_turret else "right wheel, left wheel"
    return f"numbers are C's: tenths of an inch and of a degree; axes are {axes}"
