"""Command language of the shell: parsing of lines, built-in commands, help, completion.

    pr 240 0 0                    words, or commas, or the whole call of C: pr(240, 0, 0); ws(1, 1, 1, 20);
    conf_sn 15 {0, 2, 15}         a list for a C array, in braces or brackets
    tk "good morning"             a text; quotes are optional
    Smask[17] = 0                 an element of the mask that ct sends next; State[34] and Laser[0] are shown
    help pr   # a comment         built-in commands are listed in BUILTINS

Usage and help of the robot's commands are generated from the command table, with the units of the arguments. Arguments
that the C call does not have (pid, and Smask, which ct takes from the array) are left out. Completion offers only
commands that exist for the connected robot. `parse` does not know commands or robots; errors are ShellError.
"""

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from nclient.cli import state_text
from nclient.errors import ShellError
from nclient.protocol.codec import serial_argument_bounds
from nclient.protocol.commands import BY_NAME, COMMANDS, Argument, Command, exists_on_serial
from nclient.protocol.types import MODELS, Model
from nclient.protocol.wire_state import WireState


class BuiltinCommand(NamedTuple):
    """Name, usage and summary of a built-in command."""

    name: str
    usage: str
    summary: str


BUILTINS: Final = {word.name: word for word in (
    BuiltinCommand("help", "help [NAME]", "list all commands, or show help for one"),
    BuiltinCommand("state", "state [PART ...]", "query the state (gs) and show it, or parts of it, with units"),
    BuiltinCommand("wait", "wait [SECONDS]", "wait until the robot stands still, at most 60 s; else an error"),
    BuiltinCommand("sleep", "sleep SECONDS", "wait SECONDS of the robot's time, simulated or real"),
    BuiltinCommand("quit", "quit", "stop the robot and exit; as exit and Ctrl-D do"),
    BuiltinCommand("exit", "exit", "the same as quit"),
)}  # fmt: skip
ARRAYS_HELP: Final = {
    "State[34]": "show a number of the last state, as in C; State shows all 45, Laser those of the laser",
    "Smask[17] = 0": "set a number of the mask that ct sends; Smask shows all 44",
}


ARRAYS = ("State", "Smask", "Laser")
"""Arrays of the C library, for showing numbers and setting the mask."""
Value = int | float | str | tuple[int | float, ...]

_TOKEN = re.compile(
    r"""\s*(?:(?P<comment>\#.*)
    |"(?P<double>(?:[^"\\]|\\.)*)"|'(?P<single>[^']*)'
    |(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.]))
    |(?P<word>[^\s,;(){}\[\]="'\#]+)
    |(?P<mark>[,;(){}\[\]=]))""",
    re.VERBOSE,
)
# Maximum digits of an array index or mask value.
_MAX_DIGITS = 9
# Closing mark of each opening one.
_OPENS = {"(": ")", "{": "}", "[": "]"}


class ParsedCommand(NamedTuple):
    """A command and its values: integers, floats, texts, lists."""

    name: str
    values: tuple[Value, ...] = ()


class Element(NamedTuple):
    """An array element such as State[34] or Smask[17] = 0, or a whole array; `value` is the new value, if any."""

    array: str
    place: int | None = None
    value: int | None = None


class _Token(NamedTuple):
    kind: str
    text: str


def parse(text: str) -> tuple[ParsedCommand | Element, ...]:
    """Parse a line; an empty line or a comment has no commands. Raises ShellError."""
    return tuple(_parse_statement(tokens) for tokens in _statements(tuple(_tokens(text))))


def _tokens(text: str) -> Iterator[_Token]:
    place, text = 0, text.rstrip()
    while place < len(text):
        # Only an unfinished quote matches no alternative.
        found = _TOKEN.match(text, place)
        if found is None:
            raise ShellError(f"a quote that does not end: {text[place:].strip()}")
        place, kind = found.end(), found.lastgroup or ""
        token = found[kind]
        # Backslash escapes apply in double quotes only, as in C and shells.
        if kind == "double":
            token = re.sub(r"\\(.)", r"\1", token)
        if kind != "comment":
            yield _Token("text" if kind in ("double", "single") else kind, token)


def _statements(tokens: tuple[_Token, ...]) -> Iterator[list[_Token]]:
    statement: list[_Token] = []
    for token in tokens:
        if token == ("mark", ";"):
            if statement:
                yield statement
            statement = []
        else:
            statement.append(token)
    if statement:
        yield statement


def _parse_statement(tokens: list[_Token]) -> ParsedCommand | Element:
    # 1. An array element, or the name of a command.
    head, rest = tokens[0], tokens[1:]
    if head.kind != "word":
        raise ShellError(f"a line begins with a command, not with {head.text!r}; help lists them")
    if head.text in ARRAYS:
        return _element(head.text, rest)
    # 2. The parentheses of a call as in C are optional.
    if rest and rest[0] == ("mark", "("):
        if rest[-1] != ("mark", ")") or ("mark", "(") in rest[1:]:
            raise ShellError(f"{head.text}: a call is {head.text}(1, 2, 3), one pair of parentheses")
        rest = rest[1:-1]
    return ParsedCommand(head.text, tuple(_values(head.text, rest)))


def _values(name: str, tokens: list[_Token]) -> Iterator[Value]:
    """Yield numbers, texts and lists; commas between them are optional."""
    waiting: list[int | float] | None = None
    closing = ""
    for token in tokens:
        if token.kind == "mark":
            if waiting is None and token.text in "{[":
                waiting, closing = [], _OPENS[token.text]
            elif waiting is not None and token.text == closing:
                yield tuple(waiting)
                waiting = None
            elif token.text != ",":
                raise ShellError(f"{name}: {token.text!r} does not belong there")
        elif waiting is None:
            yield _number(token.text) if token.kind == "number" else token.text
        elif token.kind == "number":
            waiting.append(_number(token.text))
        else:
            raise ShellError(f"{name}: a list holds numbers, not {token.text!r}")
    if waiting is not None:
        raise ShellError(f"{name}: the list does not end; {closing} is missing")


def _element(array: str, tokens: list[_Token]) -> Element:
    match [(token.kind, token.text) for token in tokens]:
        case []:
            return Element(array)
        case [("mark", "["), ("number", index), ("mark", "]"), *rest] if _is_place(index):
            match rest:
                case []:
                    return Element(array, int(index))
                case [("mark", "="), ("number", value)] if array == "Smask" and _is_place(value):
                    return Element(array, int(index), int(value))
    example = "Smask[17] = 0" if array == "Smask" else f"{array} or {array}[0]"
    raise ShellError(f"{array}: it is written {example}")


def _is_place(text: str) -> bool:
    return text.isdecimal() and len(text) <= _MAX_DIGITS


def _number(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:
        return float(text)


UNITS = {
    "translation": "1/10 in", "steering": "1/10 deg", "turret": "1/10 deg", "x": "1/10 in", "y": "1/10 in",
    "x1": "1/10 in", "y1": "1/10 in", "x2": "1/10 in", "y2": "1/10 in", "x0": "1/10 in", "y0": "1/10 in",
    "w": "1/10 in", "h": "1/10 in", "th1": "1/10 deg", "th2": "1/10 deg", "timeout_s": "s",
}  # fmt: skip
# Added to the unit of an axis: velocities, speeds, accelerations.
_RATES = {"vm": "/s", "sp": "/s", "ac": "/s2"}
_LINEAR, _ANGULAR = ("translation",), ("steering", "turret")
MORE = {
    "add_obstacle": ("x1 y1 .. xn yn",), "delete_obstacle": ("x1 y1 .. xn yn",),
    "move_obstacle": ("x1 y1 .. xn yn", "dx dy"),
    "motion_check": ("x1 y1 x2 y2 | x1 y1 angle1 angle2 radius xc yc",), "special_request": ("byte ..",),
}  # fmt: skip
"""Usage behind the named arguments, for commands of variable length."""
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
    """An argument of the C call: a number, or an array if `length` is more than 1."""

    name: str
    unit: str
    length: int = 1

    def __str__(self) -> str:
        return self.name if self.length == 1 else f"{self.name}[{self.length}]"


def parameters(row: Command) -> tuple[Parameter, ...]:
    """Return the arguments of the C call; numbered ones such as order_0 to order_15 become one array, order[16]."""
    found: list[Parameter] = []
    for argument in row.arguments:
        # Names such as order_3 are elements of one C array.
        name, numbered = re.subn(r"_\d+$", "", argument.name)
        if row.extra_arguments is not None and row.extra_arguments[0] in ("pid", "mask") and name in ("pid", "Smask"):
            continue
        if numbered and found and found[-1].name == name:
            found[-1] = found[-1]._replace(length=found[-1].length + 1)
        else:
            found.append(Parameter(name, _unit(row, argument)))
    return tuple(found)


def usage(row: Command) -> str:
    """Return the command and its arguments in one line."""
    return " ".join((row.name, *map(str, parameters(row)), *MORE.get(row.name, ())))


def available(row: Command, wire_state: WireState) -> bool:
    """Return True if the command exists on this connection: over TCP, or on this model's serial line."""
    return exists_on_serial(row, wire_state.model) if wire_state.line else row.tcp_type is not None


def help_lines(name: str, wire_state: WireState) -> Iterator[str]:
    """Yield the help of a robot command: usage, summary, units and ranges, notes, example."""
    row = BY_NAME[name]
    yield usage(row)
    yield f"  {row.summary}"
    # Ranges are those of the serial line's fields; over TCP every number is a 32-bit word.
    bounds = {bound: (least, most) for bound, least, most in serial_argument_bounds(name)} if wire_state.line else {}
    for parameter in parameters(row):
        if parameter.unit or parameter.name in bounds:
            least, most = bounds.get(parameter.name, ("", ""))
            span = f"{least} to {most}" if bounds else ""
            yield f"    {parameter.name:12} {parameter.unit:10} {span}".rstrip()
    if name in _NOTES:
        yield f"  {_NOTES[name]}"
    if name in _ON_WHEELS and not wire_state.model.has_turret:
        yield f"  {_WHEELS}"
    if name in _EXAMPLES:
        yield f"  such as: {_EXAMPLES[name]}"
    yield f"  in Python: robot.{row.method}; {_where(row)}"


def summaries(wire_state: WireState) -> dict[str, str]:
    """Return usage and summary of all commands of this connection, in the table's order."""
    return {usage(row): row.summary for row in COMMANDS if available(row, wire_state)}


def _where(row: Command) -> str:
    models = [model.name for model in MODELS.values() if exists_on_serial(row, model)]
    lines = f"on the serial line of {', '.join(models)}" if models else "on no serial line"
    return f"{'over TCP' if row.tcp_type is not None else 'not over TCP'}, {lines}"


def _unit(row: Command, argument: Argument) -> str:
    if argument.is_flag:
        return "0 or 1"
    unit = UNITS.get(argument.name, "")
    return unit + _RATES.get(row.name, "") if argument.name in _LINEAR + _ANGULAR else unit


def model_note(model: Model) -> str:
    """Return a line about the units of all commands."""
    axes = "translation, steering, turret" if model.has_turret else "right wheel, left wheel"
    return f"numbers are C's: tenths of an inch and of a degree; axes are {axes}"


class Candidate(NamedTuple):
    """A completion and its description."""

    word: str
    about: str


def candidates(text: str, wire_state: WireState) -> Iterator[Candidate]:
    """Return the completions of the last word of `text`, the line up to the cursor."""
    before, last = _split(text)
    # First word: commands; after `help` all of them again; after `state` the parts not typed yet.
    if not before:
        words = dict(_names(wire_state))
    elif before == ["help"]:
        words = {name: about for name, about in _names(wire_state) if name not in ARRAYS}
    elif before[0] == "state":
        words = {part: "part of the state" for part in state_text.PARTS if part not in before}
    else:
        words = {}
    return (Candidate(word, about) for word, about in words.items() if word.startswith(last))


def hint(text: str) -> str:
    """Return the usage of the command that is being typed; "" if there is none yet."""
    before, last = _split(text)
    name = before[0] if before else last
    if name in BY_NAME:
        return usage(BY_NAME[name])
    return BUILTINS[name].usage if name in BUILTINS else ""


def _split(text: str) -> tuple[list[str], str]:
    """Return the complete words of the last statement, and the incomplete one."""
    # Commands may be written as words, with commas or as a C call.
    statement = text.rpartition(";")[2].lstrip()
    *before, last = re.split(r"[\s,(]+", statement)
    return before, last


def _names(wire_state: WireState) -> Iterator[tuple[str, str]]:
    for word in BUILTINS.values():
        yield word.name, word.summary
    for row in COMMANDS:
        if available(row, wire_state):
            yield row.name, row.summary
    for array in ARRAYS:
        yield array, "the C library's array"
