"""A shell's session with one robot: a line in, lines to show out.

    run("pr 240 0 0; wait")   ──>   each order: its call is made, said, and what came of it is told

Rules: no keyboard, no screen; clock and sleep come from outside. A line is looked through before its first order is
done. Whatever goes wrong is a NomadError, and the session goes on as long as the robot is there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

from nclient.backends.backend import Backend
from nclient.errors import ShellError
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.mask import EVERYTHING, SLOTS
from nclient.protocol.state import STATE_SIZE
from nclient.protocol.terms import Terms
from nclient.robot import Robot
from nclient.shell import glance
from nclient.shell.answers import shown
from nclient.shell.calls import call_of, no_command
from nclient.shell.language import Element, Order, Value, parse
from nclient.shell.own_words import ARRAYS_HELP, OWN
from nclient.shell.reference import help_lines, model_note, summaries

WAIT_S = 60
LOOK_S = 0.05
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
    def terms(self) -> Terms:
        """The robot's model, and whether this is its own line."""
        return self._backend.terms

    def check(self, text: str) -> None:
        """Look a line through, and do nothing. Raises ShellError or WireError."""
        for order in parse(text):
            if isinstance(order, Element):
                _check_element(order)
            elif order.name in OWN:
                _check_own(order)
            else:
                call_of(order, self.terms, self._smask, self._pid)

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
                yield from self._said(call_of(order, self.terms, self._smask, self._pid))

    def halt(self) -> str:
        """Stop the robot, whatever it does; what to show."""
        return f"stopped: {glance.line(self.robot.stop())}"

    def _said(self, call: Call) -> Iterator[str]:
        if call.name == "disconnect_robot":
            self.finished = True
            return
        reply = self.robot.execute(call)
        self.keeps_time_out |= call.name == "conf_tm"
        if call.name == "ct":
            self._smask[:] = call.args
        if call.name in _CONNECTS:
            yield glance.line(self.robot.refresh())
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
                yield from help_lines(name, self.terms)

    def _overview(self) -> Iterator[str]:
        rows = {word.usage: word.summary for word in OWN.values()} | ARRAYS_HELP | summaries(self.terms)
        for left, right in rows.items():
            yield f"{left:{_LEFT}}  {right}" if len(left) <= _LEFT else f"{left}\n{'':{_LEFT}}  {right}"
        yield f"{model_note(self.terms.model)}; help NAME says more"

    def _state(self, values: tuple[Value, ...]) -> Iterator[str]:
        yield from glance.lines(self.robot.refresh(), map(str, values))

    def _wait(self, values: tuple[Value, ...]) -> Iterator[str]:
        seconds = _seconds(values or (WAIT_S,))
        state = self.robot.wait_until_still(seconds)
        if state.moving:
            raise ShellError(f"wait: after {seconds:g} s the robot is {glance.moving(state)}")
        yield glance.line(state)

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
        if self.terms.line or self.robot.state.speed_factor:
            self._sleep(min(left_s, LOOK_S))

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


def _check_own(order: Order) -> None:
    """Raises ShellError where a word of the shell's own is given what it does not take."""
    name, values = order
    match name:
        case "help":
            for word in map(str, values):
                if word not in BY_NAME and word not in OWN:
                    raise ShellError(f"help: {no_command(word)}")
        case "state":
            glance.check(map(str, values))
        case "wait" | "sleep" if values or name == "sleep":
            _seconds(values, OWN[name].usage)
        case _ if values:
            raise ShellError(f"{name} takes nothing")


def _seconds(values: tuple[Value, ...], usage: str = "") -> float:
    if len(values) != 1 or isinstance(values[0], str | tuple) or not 0 <= values[0] <= _LONGEST_S:
        raise ShellError(f"{usage}: a number of seconds is wanted, 0 to {_LONGEST_S}")
    return float(values[0])
