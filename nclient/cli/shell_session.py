"""A shell's session with one robot: executes a line of commands and yields the lines to show.

    run("pr 240 0 0; wait")   ──>   for each command: build its call, send it, show the result

No keyboard and no screen; `sleep` is passed in. A line is checked completely before its first command is executed, so
that an error in a script moves nothing. Errors are NomadError, and the session continues while the robot is connected.

Command language of the shell: parsing of lines, built-in commands, help, completion.

    pr 240 0 0                    words, or commas, or the whole call of C: pr(240, 0, 0); ws(1, 1, 1, 20);
    conf_sn 15 {0, 2, 15}         a list for a C array, in braces or brackets
    tk "good morning"             a text; quotes are optional
    Smask[17] = 0                 an element of the mask that ct sends next; State[34] and Laser[0] are shown
    help pr   # a comment         built-in commands are listed in BUILTINS

Usage and help of the robot's commands are generated from the command table, with the units of the arguments. Arguments
that the C call does not have (pid, and Smask, which ct takes from the array) are left out. Completion offers only
commands that exist for the connected robot. `parse` does not know commands or robots; errors are ShellError.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any, Final, NamedTuple

from nclient.backends.base import Backend
from nclient.cli import state_text
from nclient.cli.state_text import format_reply
from nclient.errors import RobotRefused, ShellError, WireError
from nclient.protocol import codec
from nclient.protocol.client_state import STATE_SIZE
from nclient.protocol.codec import describe_serial_overflow, serial_argument_bounds
from nclient.protocol.commands import BY_NAME, COMMANDS, Argument, Call, Command, exists_on_serial
from nclient.protocol.types import EVERYTHING, MODELS, SLOTS, Mask, Model, WireState
from nclient.robot import Robot


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
    # The whole line is read first: a quote that does not end is its first error.
    groups = groupby(tuple(_tokens(text)), lambda token: token == ("mark", ";"))
    return tuple(_parse_statement(list(tokens)) for is_end, tokens in groups if not is_end)


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


_END = 255
"""End mark of a firing order."""
# motion_check takes doubles in C, thousandths in a Call.
_THOUSANDTHS = 1000
_SPEED_MODES = (1, 5)
"""Modes of mv whose value is a speed: motion at a speed, and the speed of relative motions."""
_MAX_NUMBER = 2**63
"""Limit of numbers: more than any command takes, and within the range of floats."""


def build_call(command: ParsedCommand, wire_state: WireState, smask: Sequence[int], pid: int) -> Call:
    """Return the call of a parsed command.

    Parameters
    ----------
    command
        The parsed command.
    wire_state
        State of the connection.
    smask
        Mask that ct sends if it has no arguments.
    pid
        Process id that connect_robot sends.

    Raises
    ------
    ShellError
        If the command does not exist here, or does not take these arguments.
    WireError
        If a number cannot be sent.
    """
    # A serial frame has narrow fields: what would overflow is refused here, before any byte is sent.
    row = _row(command.name, wire_state)
    call = Call(row.name, _arguments(row, command.values, smask, pid))
    if not wire_state.line:
        codec.encode_tcp_request(call)
    elif error := describe_serial_overflow(call):
        raise WireError(error)
    return call


def describe_excess_speed(call: Call, model: Model) -> Iterator[str]:
    """Yield a note for each axis that vm, sp or mv commands to go faster than the model can.

    The call is sent as it is: the robot drives at its top speed, and a simulated model may have a higher one.
    """
    match call.name, call.args:
        case "vm" | "sp", values:
            speeds = dict(enumerate(values))
        case "mv", values:
            speeds = {axis: values[2 * axis + 1] for axis in range(3) if values[2 * axis] in _SPEED_MODES}
        case _:
            return
    length, angle = (model.top_speed_in_s, "in/s"), (model.top_turn_deg_s, "deg/s")
    tops = (length, angle, angle) if model.has_turret else (length, length)
    names = ("translation", "steering", "turret") if model.has_turret else ("right wheel", "left wheel")
    for axis, (name, (top, unit)) in enumerate(zip(names, tops, strict=True)):
        tenths = speeds.get(axis, 0)
        if abs(tenths) > 10 * top:
            yield (f"{call.name}: {name} {tenths} is {abs(tenths) / 10:g} {unit}, more than the {top} {unit} of the "
                   f"{model.name}; it drives at its top speed (numbers are tenths: {10 * top})")


def describe_unknown_command(name: str, alternatives: Iterable[str] = ()) -> str:
    """Return an error text for an unknown command, with a suggestion out of commands and `alternatives`."""
    return f"{codec.describe_unknown_command(name, (*BUILTINS, *alternatives))}; help lists them all"


def _row(name: str, wire_state: WireState) -> Command:
    row = BY_NAME.get(name)
    if row is None:
        raise ShellError(describe_unknown_command(name, ARRAYS))
    if not available(row, wire_state):
        there = f"on the serial line of a {wire_state.model.name}" if wire_state.line else "over TCP"
        raise ShellError(f"there is no {name} {there}; help {name} shows where it exists")
    return row


def _arguments(row: Command, values: tuple[Value, ...], smask: Sequence[int], pid: int) -> tuple[Any, ...]:
    # 1. A text: words are joined again by single blanks.
    if row.name == "tk":
        return (" ".join(str(value) for value in values),)
    # 2. The mask: without arguments the one that Smask assignments have changed.
    if row.name == "ct":
        return _mask(values, smask)
    # 3. Numbers; all but motion_check take integers.
    numbers = _numbers(row, values)
    if row.name == "motion_check":
        return (*numbers[:1], *(_THOUSANDTHS * number for number in numbers[1:]))
    if any(number != int(number) for number in numbers):
        raise ShellError(f"{row.name}: expected whole numbers (tenths, as in C), not {_shown(values)}")
    whole = tuple(map(int, numbers))
    return (*whole, pid) if row.extra_arguments is not None and row.extra_arguments[0] == "pid" else whole


def _mask(values: tuple[Value, ...], smask: Sequence[int]) -> tuple[int, ...]:
    given = _flatten("ct", values)
    if given and len(given) != SLOTS:
        raise ShellError(f"ct: a mask has {SLOTS} numbers, not {len(given)}; ct alone sends Smask")
    return Mask(tuple(map(int, given)) if given else tuple(smask)).smask


def _numbers(row: Command, values: tuple[Value, ...]) -> tuple[int | float, ...]:
    """Return the arguments as flat numbers, as many as the C call takes; a short firing order is padded."""
    # 1. Commands of variable length take the list as it is.
    wanted = parameters(row)
    numbers = _flatten(row.name, values)
    if row.any_length:
        return numbers
    # 2. Others: check count and lists, then fill a firing order with its end mark.
    least, most = _counts(wanted)
    if not least <= len(numbers) <= most or not _lists_fit(wanted, values):
        count = f"{most} numbers" if least == most else f"{least} to {most} numbers"
        expected = f"{row.name} takes {count if most else 'no numbers'}"
        raise ShellError(f"{expected}, not {len(numbers)}: {usage(row)}")
    return (*numbers, *[_END] * (most - len(numbers)))


def _counts(wanted: tuple[Parameter, ...]) -> tuple[int, int]:
    # All single numbers are required; of an array at least one number is.
    single = sum(parameter.length == 1 for parameter in wanted)
    return single + (single < len(wanted)), sum(parameter.length for parameter in wanted)


def _lists_fit(wanted: tuple[Parameter, ...], values: tuple[Value, ...]) -> bool:
    """Return True if lists are given only for arrays of the C call."""
    return all(not isinstance(value, tuple) or (place < len(wanted) and wanted[place].length > 1)
               for place, value in enumerate(values))


def _flatten(name: str, values: tuple[Value, ...]) -> tuple[int | float, ...]:
    numbers: list[int | float] = []
    for value in values:
        if isinstance(value, str):
            raise ShellError(f"{name}: expected a number, not {value!r}")
        numbers.extend(value if isinstance(value, tuple) else (value,))
    if not all(abs(number) <= _MAX_NUMBER for number in numbers):
        raise ShellError(f"{name}: expected finite numbers of at most 64 bits, not {_shown(values):.60}")
    return tuple(numbers)


def _shown(values: tuple[Value, ...]) -> str:
    return " ".join(map(str, values))


# Default limit of `wait`, seconds.
WAIT_S = 60
POLL_INTERVAL_S = 0.05
"""Interval between two queries of the robot's clock, if time runs by itself."""
_MAX_CLOCK_STOPS = 400
"""Queries with the same clock after which `sleep` fails."""
# Limit of `wait` and `sleep`: one day.
_MAX_SECONDS = 86400
_USAGE_WIDTH = 34
"""Columns of the usage in the list of all commands."""
# Laser has no fixed size: it depends on the last reply.
_SIZES = {"State": STATE_SIZE, "Smask": SLOTS}
# After these the state is that of another robot, so it is queried and shown.
_CONNECTS = frozenset({"connect_robot", "create_robot"})


class Session:
    """A session with one robot.

    Parameters
    ----------
    backend
        Connection to the robot.
    sleep
        Waits a number of seconds of real time.
    pid
        Process id for connect_robot; default: that of this process.
    lockstep
        True if time passes by requests of this session only.
    """

    def __init__(self, backend: Backend, sleep: Callable[[float], None], pid: int | None = None, *,
                 lockstep: bool = False) -> None:
        self.robot = Robot(backend, lockstep=lockstep)
        self._lockstep = lockstep
        self.finished = False
        self.user_set_timeout = False
        """True after conf_tm: then nothing is sent automatically, so that the robot's timeout works."""
        self._backend = backend
        self._sleep = sleep
        self._pid = os.getpid() if pid is None else pid
        self._smask = list(EVERYTHING.smask)

    @property
    def wire_state(self) -> WireState:
        """Return the state of the connection: model, mask, protocol."""
        return self._backend.wire_state

    def check(self, text: str) -> None:
        """Check a line without executing it. Raises ShellError or WireError."""
        for command in parse(text):
            if isinstance(command, Element):
                _check_element(command)
            elif command.name in BUILTINS:
                _check_builtin(command)
            else:
                build_call(command, self.wire_state, self._smask, self._pid)

    def run(self, text: str) -> Iterator[str]:
        """Execute a line up to its end or `quit`, and yield the lines to show.

        Raises
        ------
        NomadError
            If a command fails; later ones are not executed.
        """
        # The whole line first: an error at its end must not leave the robot moving.
        self.check(text)
        for command in parse(text):
            if self.finished:
                return
            if isinstance(command, Element):
                yield from self._element(command)
            elif command.name in BUILTINS:
                yield from self._execute_builtin(command)
            else:
                call = build_call(command, self.wire_state, self._smask, self._pid)
                yield from describe_excess_speed(call, self.wire_state.model)
                yield from self._execute(call)

    def halt(self) -> str:
        """Stop the robot, and return the line to show."""
        return f"stopped: {state_text.format_state(self.robot.stop())}"

    def _execute(self, call: Call) -> Iterator[str]:
        if call.name == "disconnect_robot":
            self.finished = True
            return
        # A ct that the robot accepted becomes the Smask of the session.
        reply = self.robot.execute(call)
        self.user_set_timeout |= call.name == "conf_tm"
        if call.name == "ct":
            self._smask[:] = call.args
        if call.name in _CONNECTS:
            yield state_text.format_state(self.robot.refresh())
        else:
            yield from format_reply(call, reply, self.robot.state)

    def _execute_builtin(self, command: ParsedCommand) -> Iterator[str]:
        match command.name:
            case "help":
                yield from self._help(command.values)
            case "state":
                yield from state_text.format_parts(self.robot.refresh(), map(str, command.values))
            case "wait":
                yield self._wait(_seconds(command.values or (WAIT_S,)))
            case "sleep":
                self._sleep_by_robot_clock(_seconds(command.values))
            case _:
                self.finished = True

    def _help(self, values: tuple[Value, ...]) -> Iterator[str]:
        if not values:
            yield from self._overview()
            return
        for name in map(str, values):
            if name in BUILTINS:
                yield from (BUILTINS[name].usage, f"  {BUILTINS[name].summary}")
            else:
                yield from help_lines(name, self.wire_state)

    def _overview(self) -> Iterator[str]:
        # Long usages get a line of their own, so that summaries stay aligned.
        rows = {word.usage: word.summary for word in BUILTINS.values()}
        rows |= ARRAYS_HELP | summaries(self.wire_state)
        for left, right in rows.items():
            line_end = "" if len(left) <= _USAGE_WIDTH else f"\n{'':{_USAGE_WIDTH}}"
            yield f"{left:{_USAGE_WIDTH}}{line_end}  {right}"
        yield f"{model_note(self.wire_state.model)}; help NAME says more"

    def _wait(self, seconds: float) -> str:
        state = self.robot.wait_until_still(seconds)
        if state.moving:
            raise ShellError(f"wait: after {seconds:g} s the robot is {state_text.format_motion(state)}")
        return state_text.format_state(state)

    def _sleep_by_robot_clock(self, seconds: float) -> None:
        # A recording refuses to let time pass, and goes on by its requests.
        with contextlib.suppress(RobotRefused):
            if self._lockstep and not self.robot.control_time("step").paused:
                self.robot.sleep(seconds)
                return
        # A lockstep simulation advances with each query, a real robot by itself; both end by the robot's clock.
        begun_s = self.robot.refresh().clock_s
        if begun_s is None:
            self._sleep(seconds)
            return
        # 1e-9 s absorbs the rounding of clock differences.
        until_s, last_s, stops = begun_s + seconds, begun_s, 0
        while last_s < until_s - 1e-9:
            self._wait_for_clock(until_s - last_s)
            now_s = self.robot.refresh().clock_s or 0.0
            # A paused simulation would otherwise make this loop endless.
            stops = 0 if now_s != last_s else stops + 1
            if stops >= _MAX_CLOCK_STOPS:
                raise ShellError("sleep: the clock has stopped; resume a paused simulation with sim_control 2 0")
            last_s = now_s

    def _wait_for_clock(self, left_s: float) -> None:
        """Wait, unless simulated time advances only with requests."""
        if self.wire_state.line or self.robot.state.speed_factor:
            self._sleep(min(left_s, POLL_INTERVAL_S))

    def _element(self, element: Element) -> Iterator[str]:
        array, place, value = element
        if place is not None and value is not None:
            self._smask[place] = value
        state = self.robot.state
        # The last state without a query, as in a C program.
        numbers = {"State": state.raw, "Laser": state.laser, "Smask": tuple(self._smask)}[array]
        if place is not None and place >= len(numbers):
            raise ShellError(f"Laser holds {len(numbers)} numbers now, not {place}")
        yield " ".join(map(str, numbers)) if place is None else f"{array}[{place}] = {numbers[place]}"


def _check_element(element: Element) -> None:
    array, place, value = element
    # Indices are checked in advance where the size is fixed.
    size = _SIZES.get(array)
    if place is not None and size is not None and place >= size:
        raise ShellError(f"{array} has {size} numbers, 0 to {size - 1}, not {place}")
    # Smask[0] is a bit field of the sensors with position stamps; all others are switches.
    if value is not None and value > (31 if place == 0 else 1):
        raise ShellError("Smask[0] is a sum of 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass; the others 0 or 1")


def _check_builtin(command: ParsedCommand) -> None:
    """Raise ShellError if a built-in command does not take these arguments."""
    name, values = command
    match name:
        case "help":
            for word in map(str, values):
                if word not in BY_NAME and word not in BUILTINS:
                    raise ShellError(f"help: {describe_unknown_command(word)}")
        case "state":
            state_text.check_parts(map(str, values))
        case "wait" | "sleep" if values or name == "sleep":
            _seconds(values, BUILTINS[name].usage)
        case _ if values:
            raise ShellError(f"{name} takes no arguments")


def _seconds(values: tuple[Value, ...], form: str = "") -> float:
    if len(values) != 1 or isinstance(values[0], str | tuple) or not 0 <= values[0] <= _MAX_SECONDS:
        raise ShellError(f"{form}: expected a number of seconds, 0 to {_MAX_SECONDS}")
    return float(values[0])
