"""A shell's session with one robot: executes a line of commands and yields the lines to show.

    run("pr 240 0 0; wait")   ──>   for each command: build its call, send it, show the result

No keyboard and no screen; `sleep` is passed in. A line is checked completely before its first command is executed, so
that an error in a script moves nothing. Errors are NomadError, and the session continues while the robot is connected.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from nclient.backends.base import Backend
from nclient.cli import shell_help, state_text
from nclient.cli.state_text import format_reply
from nclient.errors import RobotRefused, ShellError, WireError
from nclient.protocol import codec
from nclient.protocol.client_state import STATE_SIZE
from nclient.protocol.codec import describe_serial_overflow
from nclient.protocol.commands import BY_NAME, Call, Command
from nclient.protocol.types import EVERYTHING, SLOTS, Mask, Model
from nclient.protocol.wire_state import WireState
from nclient.robot import Robot

_END = 255
"""End mark of a firing order."""
# motion_check takes doubles in C, thousandths in a Call.
_THOUSANDTHS = 1000
_SPEED_MODES = (1, 5)
"""Modes of mv whose value is a speed: motion at a speed, and the speed of relative motions."""
_MAX_NUMBER = 2**63
"""Limit of numbers: more than any command takes, and within the range of floats."""


def build_call(command: shell_help.ParsedCommand, wire_state: WireState, smask: Sequence[int], pid: int) -> Call:
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
    return f"{codec.describe_unknown_command(name, (*shell_help.BUILTINS, *alternatives))}; help lists them all"


def _row(name: str, wire_state: WireState) -> Command:
    row = BY_NAME.get(name)
    if row is None:
        raise ShellError(describe_unknown_command(name, shell_help.ARRAYS))
    if not shell_help.available(row, wire_state):
        there = f"on the serial line of a {wire_state.model.name}" if wire_state.line else "over TCP"
        raise ShellError(f"there is no {name} {there}; help {name} shows where it exists")
    return row


def _arguments(row: Command, values: tuple[shell_help.Value, ...], smask: Sequence[int], pid: int) -> tuple[Any, ...]:
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


def _mask(values: tuple[shell_help.Value, ...], smask: Sequence[int]) -> tuple[int, ...]:
    given = _flatten("ct", values)
    if given and len(given) != SLOTS:
        raise ShellError(f"ct: a mask has {SLOTS} numbers, not {len(given)}; ct alone sends Smask")
    return Mask(tuple(map(int, given)) if given else tuple(smask)).smask


def _numbers(row: Command, values: tuple[shell_help.Value, ...]) -> tuple[int | float, ...]:
    """Return the arguments as flat numbers, as many as the C call takes; a short firing order is padded."""
    # 1. Commands of variable length take the list as it is.
    wanted = shell_help.parameters(row)
    numbers = _flatten(row.name, values)
    if row.any_length:
        return numbers
    # 2. Others: check count and lists, then fill a firing order with its end mark.
    least, most = _counts(wanted)
    if not least <= len(numbers) <= most or not _lists_fit(wanted, values):
        count = f"{most} numbers" if least == most else f"{least} to {most} numbers"
        expected = f"{row.name} takes {count if most else 'no numbers'}"
        raise ShellError(f"{expected}, not {len(numbers)}: {shell_help.usage(row)}")
    return (*numbers, *[_END] * (most - len(numbers)))


def _counts(wanted: tuple[shell_help.Parameter, ...]) -> tuple[int, int]:
    # All single numbers are required; of an array at least one number is.
    single = sum(parameter.length == 1 for parameter in wanted)
    return single + (single < len(wanted)), sum(parameter.length for parameter in wanted)


def _lists_fit(wanted: tuple[shell_help.Parameter, ...], values: tuple[shell_help.Value, ...]) -> bool:
    """Return True if lists are given only for arrays of the C call."""
    return all(
        not isinstance(value, tuple) or (place < len(wanted) and wanted[place].length > 1)
        for place, value in enumerate(values)
    )


def _flatten(name: str, values: tuple[shell_help.Value, ...]) -> tuple[int | float, ...]:
    numbers: list[int | float] = []
    for value in values:
        if isinstance(value, str):
            raise ShellError(f"{name}: expected a number, not {value!r}")
        numbers.extend(value if isinstance(value, tuple) else (value,))
    if not all(abs(number) <= _MAX_NUMBER for number in numbers):
        raise ShellError(f"{name}: expected finite numbers of at most 64 bits, not {_shown(values):.60}")
    return tuple(numbers)


def _shown(values: tuple[shell_help.Value, ...]) -> str:
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

    def __init__(
        self, backend: Backend, sleep: Callable[[float], None], pid: int | None = None, *, lockstep: bool = False
    ) -> None:
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
        for command in shell_help.parse(text):
            if isinstance(command, shell_help.Element):
                _check_element(command)
            elif command.name in shell_help.BUILTINS:
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
        for command in shell_help.parse(text):
            if self.finished:
                return
            if isinstance(command, shell_help.Element):
                yield from self._element(command)
            elif command.name in shell_help.BUILTINS:
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

    def _execute_builtin(self, command: shell_help.ParsedCommand) -> Iterator[str]:
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

    def _help(self, values: tuple[shell_help.Value, ...]) -> Iterator[str]:
        if not values:
            yield from self._overview()
            return
        for name in map(str, values):
            if name in shell_help.BUILTINS:
                yield from (shell_help.BUILTINS[name].usage, f"  {shell_help.BUILTINS[name].summary}")
            else:
                yield from shell_help.help_lines(name, self.wire_state)

    def _overview(self) -> Iterator[str]:
        # Long usages get a line of their own, so that summaries stay aligned.
        rows = {word.usage: word.summary for word in shell_help.BUILTINS.values()}
        rows |= shell_help.ARRAYS_HELP | shell_help.summaries(self.wire_state)
        for left, right in rows.items():
            yield (
                f"{left:{_USAGE_WIDTH}}  {right}"
                if len(left) <= _USAGE_WIDTH
                else f"{left}\n{'':{_USAGE_WIDTH}}  {right}"
            )
        yield f"{shell_help.model_note(self.wire_state.model)}; help NAME says more"

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
                raise ShellError(
                    "sleep: the clock has stopped; resume a paused simulation with sim_control 2 0"
                )
            last_s = now_s

    def _wait_for_clock(self, left_s: float) -> None:
        """Wait, unless simulated time advances only with requests."""
        if self.wire_state.line or self.robot.state.speed_factor:
            self._sleep(min(left_s, POLL_INTERVAL_S))

    def _element(self, element: shell_help.Element) -> Iterator[str]:
        array, place, value = element
        if place is not None and value is not None:
            self._smask[place] = value
        state = self.robot.state
        # The last state without a query, as in a C program.
        numbers = {"State": state.raw, "Laser": state.laser, "Smask": tuple(self._smask)}[array]
        if place is not None and place >= len(numbers):
            raise ShellError(f"Laser holds {len(numbers)} numbers now, not {place}")
        yield " ".join(map(str, numbers)) if place is None else f"{array}[{place}] = {numbers[place]}"


def _check_element(element: shell_help.Element) -> None:
    array, place, value = element
    # Indices are checked in advance where the size is fixed.
    size = _SIZES.get(array)
    if place is not None and size is not None and place >= size:
        raise ShellError(f"{array} has {size} numbers, 0 to {size - 1}, not {place}")
    # Smask[0] is a bit field of the sensors with position stamps; all others are switches.
    if value is not None and value > (31 if place == 0 else 1):
        raise ShellError("Smask[0] is a sum of 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass; the others 0 or 1")


def _check_builtin(command: shell_help.ParsedCommand) -> None:
    """Raise ShellError if a built-in command does not take these arguments."""
    name, values = command
    match name:
        case "help":
            for word in map(str, values):
                if word not in BY_NAME and word not in shell_help.BUILTINS:
                    raise ShellError(f"help: {describe_unknown_command(word)}")
        case "state":
            state_text.check_parts(map(str, values))
        case "wait" | "sleep" if values or name == "sleep":
            _seconds(values, shell_help.BUILTINS[name].usage)
        case _ if values:
            raise ShellError(f"{name} takes no arguments")


def _seconds(values: tuple[shell_help.Value, ...], form: str = "") -> float:
    if len(values) != 1 or isinstance(values[0], str | tuple) or not 0 <= values[0] <= _MAX_SECONDS:
        raise ShellError(f"{form}: expected a number of seconds, 0 to {_MAX_SECONDS}")
    return float(values[0])
