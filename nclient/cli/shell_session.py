"""From an order as it was written to the Call that goes out: the table's numbers, each looked at before anything moves.

Rules: pure. Whatever is wrong with an order is a ShellError or a WireError here, so that a script can be looked
through before its first line is done.

A shell's session with one robot: a line in, lines to show out.

    run("pr 240 0 0; wait")   ──>   each order: its call is made, said, and what came of it is told

Rules: no keyboard, no screen; clock and sleep come from outside. A line is looked through before its first order is
done. Whatever goes wrong is a NomadError, and the session goes on as long as the robot is there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from nclient.backends.base import Backend
from nclient.cli import state_text
from nclient.cli.shell_help import (
    ARRAYS,
    ARRAYS_HELP,
    OWN,
    Element,
    Parameter,
    ParsedCommand,
    Value,
    available,
    help_lines,
    model_note,
    parameters,
    parse,
    summaries,
    usage,
)
from nclient.cli.state_text import shown
from nclient.errors import ShellError, WireError
from nclient.protocol import codec
from nclient.protocol.client_state import STATE_SIZE
from nclient.protocol.codec import describe_serial_overflow
from nclient.protocol.commands import BY_NAME, Call, Command
from nclient.protocol.types import EVERYTHING, SLOTS, Mask
from nclient.protocol.wire_state import WireState
from nclient.robot import Robot

_END = 255
"""What ends a firing order."""
_THOUSANDTHS = 1000
_FARTHEST = 2**63
"""More than any command takes, and less than where floats end."""


def call_of(order: ParsedCommand, wire_state: WireState, smask: Sequence[int], pid: int) -> Call:
    """The call that an order is, where these terms hold; `smask`: what ct sends, `pid`: who connects.

    Raises ShellError for a command that there is not, or arguments that it does not take; WireError for numbers that
    cannot be sent.
    """
    row = _row(order.name, wire_state)
    call = Call(row.name, _arguments(row, order.values, smask, pid))
    if not wire_state.line:
        codec.encode_tcp_request(call)
    elif beyond := describe_serial_overflow(call):
        raise WireError(beyond)
    return call


def describe_unknown_command(name: str, beside: Iterable[str] = ()) -> str:
    """That there is no such command, and which was probably meant; `beside`: what else may have been."""
    return f"{codec.describe_unknown_command(name, (*OWN, *beside))}; help lists them all"


def _row(name: str, wire_state: WireState) -> Command:
    row = BY_NAME.get(name)
    if row is None:
        raise ShellError(describe_unknown_command(name, ARRAYS))
    if not available(row, wire_state):
        there = f"on the own line of a {wire_state.model.name}" if wire_state.line else "over TCP"
        raise ShellError(f"there is no {name} {there}; help {name} says where there is")
    return row


def _arguments(row: Command, values: tuple[Value, ...], smask: Sequence[int], pid: int) -> tuple[Any, ...]:
    if row.name == "tk":
        return (" ".join(str(value) for value in values),)
    if row.name == "ct":
        return _mask(values, smask)
    numbers = _numbers(row, values)
    if row.name == "motion_check":
        return (*numbers[:1], *(_THOUSANDTHS * number for number in numbers[1:]))
    if any(number != int(number) for number in numbers):
        raise ShellError(f"{row.name}: whole numbers are wanted (tenths, as in C), not {_shown(values)}")
    whole = tuple(map(int, numbers))
    return (*whole, pid) if row.extra_arguments is not None and row.extra_arguments[0] == "pid" else whole


def _mask(values: tuple[Value, ...], smask: Sequence[int]) -> tuple[int, ...]:
    given = _laid_open("ct", values)
    if given and len(given) != SLOTS:
        raise ShellError(f"ct: a mask has {SLOTS} numbers, not {len(given)}; ct alone sends Smask")
    return Mask(tuple(map(int, given)) if given else tuple(smask)).smask


def _numbers(row: Command, values: tuple[Value, ...]) -> tuple[int | float, ...]:
    """The numbers laid open, a firing order filled up; as many as the C call takes."""
    wanted = parameters(row)
    numbers = _laid_open(row.name, values)
    if row.any_length:
        return numbers
    least, most = _counts(wanted)
    if not least <= len(numbers) <= most or not _lists_fit(wanted, values):
        count = f"{most} numbers" if least == most else f"{least} to {most} numbers"
        raise ShellError(f"{row.name} takes {count if most else 'nothing'}, not {len(numbers)}: {usage(row)}")
    return (*numbers, *[_END] * (most - len(numbers)))


def _counts(wanted: tuple[Parameter, ...]) -> tuple[int, int]:
    single = sum(parameter.length == 1 for parameter in wanted)
    return single + (single < len(wanted)), sum(parameter.length for parameter in wanted)


def _lists_fit(wanted: tuple[Parameter, ...], values: tuple[Value, ...]) -> bool:
    """Whether lists stand only where C has an array."""
    return all(
        not isinstance(value, tuple) or (place < len(wanted) and wanted[place].length > 1)
        for place, value in enumerate(values)
    )


def _laid_open(name: str, values: tuple[Value, ...]) -> tuple[int | float, ...]:
    numbers: list[int | float] = []
    for value in values:
        if isinstance(value, str):
            raise ShellError(f"{name}: a number is wanted, not {value!r}")
        numbers.extend(value if isinstance(value, tuple) else (value,))
    if not all(abs(number) <= _FARTHEST for number in numbers):
        raise ShellError(f"{name}: finite numbers are wanted, of 64 bits at most, not {_shown(values):.60}")
    return tuple(numbers)


def _shown(values: tuple[Value, ...]) -> str:
    return " ".join(map(str, values))


WAIT_S = 60
POLL_INTERVAL_S = 0.05
"""Between two looks at the robot's clock, where time runs by itself."""
_MOST_STILL_LOOKS = 400
"""Looks at a clock that stands, before sleeping is given up."""
_LONGEST_S = 86400
_LEFT = 34
"""Columns of the usage in the list of all commands."""
_SIZES = {"State": STATE_SIZE, "Smask": SLOTS}
_CONNECTS = frozenset({"connect_robot", "create_robot"})


class Session:
    """Words to a robot. `sleep` passes seconds of real time; `terms` says what there is to be said."""

    def __init__(self, backend: Backend, sleep: Callable[[float], None], pid: int | None = None) -> None:
        self.robot = Robot(backend)
        self.finished = False
        self.keeps_time_out = False
        """Whether conf_tm was said here: then nobody asks anything of his own accord, so that it counts."""
        self._backend = backend
        self._sleep = sleep
        self._pid = os.getpid() if pid is None else pid
        self._smask = list(EVERYTHING.smask)
        self._own: dict[str, Callable[[tuple[Value, ...]], Iterator[str]]] = {
            "help": self._help, "state": self._state, "wait": self._wait, "sleep": self._pass_time,
            "quit": self._quit, "exit": self._quit,
        }  # fmt: skip

    @property
    def wire_state(self) -> WireState:
        """The robot's model, and whether this is its own line."""
        return self._backend.wire_state

    def check(self, text: str) -> None:
        """Look a line through, and do nothing. Raises ShellError or WireError."""
        for order in parse(text):
            if isinstance(order, Element):
                _check_element(order)
            elif order.name in OWN:
                _check_own(order)
            else:
                call_of(order, self.wire_state, self._smask, self._pid)

    def run(self, text: str) -> Iterator[str]:
        """Do what a line says, to its end or to `quit`; what to show, as it comes. Raises NomadError at the first order
        that cannot be done."""
        self.check(text)
        for order in parse(text):
            if self.finished:
                return
            if isinstance(order, Element):
                yield from self._element(order)
            elif order.name in self._own:
                yield from self._own[order.name](order.values)
            else:
                yield from self._said(call_of(order, self.wire_state, self._smask, self._pid))

    def halt(self) -> str:
        """Stop the robot, whatever it does; what to show."""
        return f"stopped: {state_text.line(self.robot.stop())}"

    def _said(self, call: Call) -> Iterator[str]:
        if call.name == "disconnect_robot":
            self.finished = True
            return
        reply = self.robot.execute(call)
        self.keeps_time_out |= call.name == "conf_tm"
        if call.name == "ct":
            self._smask[:] = call.args
        if call.name in _CONNECTS:
            yield state_text.line(self.robot.refresh())
        else:
            yield from shown(call, reply, self.robot.state)

    def _help(self, values: tuple[Value, ...]) -> Iterator[str]:
        if not values:
            yield from self._overview()
            return
        for name in map(str, values):
            if name in OWN:
                yield from (OWN[name].usage, f"  {OWN[name].summary}")
            else:
                yield from help_lines(name, self.wire_state)

    def _overview(self) -> Iterator[str]:
        rows = {word.usage: word.summary for word in OWN.values()} | ARRAYS_HELP | summaries(self.wire_state)
        for left, right in rows.items():
            yield f"{left:{_LEFT}}  {right}" if len(left) <= _LEFT else f"{left}\n{'':{_LEFT}}  {right}"
        yield f"{model_note(self.wire_state.model)}; help NAME says more"

    def _state(self, values: tuple[Value, ...]) -> Iterator[str]:
        yield from state_text.lines(self.robot.refresh(), map(str, values))

    def _wait(self, values: tuple[Value, ...]) -> Iterator[str]:
        seconds = _seconds(values or (WAIT_S,))
        state = self.robot.wait_until_still(seconds)
        if state.moving:
            raise ShellError(f"wait: after {seconds:g} s the robot is {state_text.moving(state)}")
        yield state_text.line(state)

    def _pass_time(self, values: tuple[Value, ...]) -> Iterator[str]:
        self._sleep_by_its_clock(_seconds(values))
        return iter(())

    def _sleep_by_its_clock(self, seconds: float) -> None:
        begun_s = self.robot.refresh().clock_s
        if begun_s is None:
            self._sleep(seconds)
            return
        until_s, last_s, still = begun_s + seconds, begun_s, 0
        while last_s < until_s - 1e-9:
            self._let_time_run(until_s - last_s)
            now_s = self.robot.refresh().clock_s or 0.0
            still = 0 if now_s != last_s else still + 1
            if still >= _MOST_STILL_LOOKS:
                raise ShellError("sleep: the robot's clock stands; a paused simulation goes on with sim_control 2 0")
            last_s = now_s

    def _let_time_run(self, left_s: float) -> None:
        """Where time passes with what is asked there is nothing to wait for."""
        if self.wire_state.line or self.robot.state.speed_factor:
            self._sleep(min(left_s, POLL_INTERVAL_S))

    def _quit(self, values: tuple[Value, ...]) -> Iterator[str]:
        del values
        self.finished = True
        return iter(())

    def _element(self, element: Element) -> Iterator[str]:
        array, place, value = element
        if place is not None and value is not None:
            self._smask[place] = value
        state = self.robot.state
        numbers = {"State": state.raw, "Laser": state.laser, "Smask": tuple(self._smask)}[array]
        if place is not None and place >= len(numbers):
            raise ShellError(f"Laser holds {len(numbers)} numbers now, and no {place}")
        yield " ".join(map(str, numbers)) if place is None else f"{array}[{place}] = {numbers[place]}"


def _check_element(element: Element) -> None:
    array, place, value = element
    size = _SIZES.get(array)
    if place is not None and size is not None and place >= size:
        raise ShellError(f"{array} has {size} numbers, 0 to {size - 1}, and no {place}")
    if value is not None and value > (31 if place == 0 else 1):
        raise ShellError("Smask[0] is a sum of 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass; the others 0 or 1")


def _check_own(order: ParsedCommand) -> None:
    """Raises ShellError where a word of the shell's own is given what it does not take."""
    name, values = order
    match name:
        case "help":
            for word in map(str, values):
                if word not in BY_NAME and word not in OWN:
                    raise ShellError(f"help: {describe_unknown_command(word)}")
        case "state":
            state_text.check(map(str, values))
        case "wait" | "sleep" if values or name == "sleep":
            _seconds(values, OWN[name].usage)
        case _ if values:
            raise ShellError(f"{name} takes nothing")


def _seconds(values: tuple[Value, ...], usage: str = "") -> float:
    if len(values) != 1 or isinstance(values[0], str | tuple) or not 0 <= values[0] <= _LONGEST_S:
        raise ShellError(f"{usage}: a number of seconds is wanted, 0 to {_LONGEST_S}")
    return float(values[0])
