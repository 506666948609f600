"""A backend that asks again: questions and settings, which may be asked twice; never a motion, which would be two.

Rules: again after ReplyTimeout, and after a NAK, which may have meant a request that was corrupted on its way. Not
after ConnectionLost: who lost the robot hears of it.

A backend that lets nothing through that is faster than allowed: vm, mv, sp, and the speed that pr and pa go at.

    axis      translation | steering, turret            a Scout: right wheel | left wheel, which share both limits

Rules: numbers are brought down to the limit, never refused, and their signs stay. A Scout's wheels are slowed together,
so that the curve stays. A relative motion goes at the speed that sp or mv has set: before one, each limited axis of
which that is not sure is told it again, or its limit where nobody has said any; never more than the program asked.

A backend that stops a robot whose bumper begins to touch while it moves, and says so: BumperHit.

Rules: st goes out at once, before anything is raised. Only a bumper that did not touch before counts, so that a robot
that was stopped at a wall can be driven away from it. A robot that was told to move moves until a state shows it still.
A ws, which is silent until the robot stands, is asked in pieces of a second, so that a hit is seen during it.

What a program has told a robot that stays so until it is told otherwise: to be told again to one opened anew.

    connect_robot  ct  conf_ls  conf_tm  conf_ir  conf_sn  conf_cp  conf_sg  ac  sp  mv (its speeds and accelerations)

Rules: the last of each kind counts, and they are told in this order: who it is, the shape of answers, safety, sensors,
motion. Nothing here moves a robot. Accelerations and speeds are kept by axis, since mv sets them so.

A backend that comes back: the call during which the link broke says so, the next ones open it anew.

    lost ──> ConnectionLost ──> next call: wait 0.1 s, open, greet ──> nobody: ConnectionLost ──> 0.2 s ... longest

Rules: each loss is one ConnectionLost of the call that met it, and nothing is said twice: what that call was to do is
the program's to decide. Opened anew, the robot is told again what was agreed with it (agreed.py): which robot it is (an
Nserver's), mask and laser mode, the time-out of motion, sensors, speeds. Nothing moves by itself.

A simulated robot on its own line, and the simulation itself beside it: what no robot knows is asked of that.

    sim_truth, sim_control ──> the simulation        all else ──> the line, which refuses what a robot's line has not

Rules: a wrapper; only the words of simulations of ours go another way.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

from nclient.backends.base import Backend, Wrapper, in_pieces, is_wait
from nclient.errors import BumperHit, ConnectionLost, NomadError, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import BUMPER_SLOT, SCOUT_WHEEL_IN_PER_DEG

DEFAULT_RETRIES = 2
_QUESTIONS_AND_SETTINGS = ("get_", "conf_")
_OTHERS = frozenset({"gs", "ct", "sp", "ac", "st", "lp"})


def may_be_repeated(name: str) -> bool:
    """Whether a command said twice does what it does said once: questions, settings, and to stop."""
    return name.startswith(_QUESTIONS_AND_SETTINGS) or name in _OTHERS


class Retrying(Wrapper):
    """Asks up to `retries` times more."""

    def __init__(self, inner: Backend, retries: int) -> None:
        super().__init__(inner)
        self._retries = retries

    def execute(self, call: Call) -> Reply:
        """The first answer; what the last try raised where there is none."""
        for _ in range(self._retries if may_be_repeated(call.name) else 0):
            try:
                return self._inner.execute(call)
            except ReplyTimeout:
                if self._inner.closed:
                    raise
            except RobotRefused as refusal:
                if not refusal.is_nak:
                    raise
            if self.link is not None:
                self.link.retries += 1
        return self._inner.execute(call)


_VELOCITY, _RELATIVE, _SPEED, _ABSOLUTE = 1, 2, 5, 6
_NOWHERE = 0
_AXES = 3
_Limits = tuple[float, ...]


class Capped(Wrapper):
    """Limits in inches and degrees a second; infinite where none. Raises as the backend inside."""

    def __init__(
        self, inner: Backend, *, max_speed_in_s: float = float("inf"), max_turn_deg_s: float = float("inf")
    ) -> None:
        super().__init__(inner)
        self._speed, self._turn = 10 * max_speed_in_s, 10 * max_turn_deg_s
        if inner.wire_state.model.has_turret:
            self._limits: _Limits = (self._speed, self._turn, self._turn)
        else:
            wheel = min(self._speed, self._turn * SCOUT_WHEEL_IN_PER_DEG)
            self._limits = (wheel, wheel, float("inf"))
        self._asked: dict[int, int] = {}
        """The speed of each axis that the program has set, within the limits."""
        self._sure: set[int] = set()
        """The axes whose speed the robot is known to have."""

    def execute(self, call: Call) -> Reply:
        """The answer to the call as it may be."""
        within = self._within(call)
        try:
            if _goes_at_sp(call):
                self._make_sure(_speeds(within))
            return self._say(within)
        except ConnectionLost:
            self._sure.clear()
            raise

    def _say(self, call: Call) -> Reply:
        speeds = _speeds(call)
        try:
            reply = self._inner.execute(call)
        except (ReplyTimeout, ConnectionLost):  # it may have been heard, or not
            self._asked |= speeds
            self._sure -= speeds.keys()
            raise
        self._asked |= speeds
        self._sure |= speeds.keys()
        return reply

    def _make_sure(self, about_to_be_set: Mapping[int, int]) -> None:
        """Tell the speeds of relative motion that the robot may not have; axes without a limit keep theirs."""
        speeds = {
            axis: self._asked.get(axis, int(limit))
            for axis, limit in enumerate(self._limits)
            if limit < float("inf") and axis not in self._sure and axis not in about_to_be_set
        }
        if speeds:
            pairs = [(_SPEED, speeds[axis]) if axis in speeds else (_NOWHERE, 0) for axis in range(_AXES)]
            self._inner.execute(Call("mv", tuple(number for pair in pairs for number in pair)))
            self._sure |= speeds.keys()

    def _within(self, call: Call) -> Call:
        if call.name == "vm" and len(call.args) == _AXES:
            return Call("vm", self._velocities(call.args))
        if call.name == "sp" and len(call.args) == _AXES:
            return Call("sp", tuple(map(_limited, call.args, self._limits)))
        if call.name == "mv" and len(call.args) == 2 * _AXES:
            return Call("mv", self._by_modes(call.args[::2], call.args[1::2]))
        return call

    def _velocities(self, asked: Sequence[int]) -> tuple[int, ...]:
        if self._inner.wire_state.model.has_turret:
            return tuple(map(_limited, asked, self._limits))
        right, left, rest = asked
        turn = abs(right - left) / 2 / SCOUT_WHEEL_IN_PER_DEG
        share = min(1.0, _share(self._speed, max(abs(right), abs(left))), _share(self._turn, turn))
        return int(right * share), int(left * share), rest

    def _by_modes(self, modes: Sequence[int], values: Sequence[int]) -> tuple[int, ...]:
        """mv: velocities and speeds are limited by axis; a Scout's wheels, where both have a velocity, together."""
        if not self._inner.wire_state.model.has_turret and tuple(modes[:2]) == (_VELOCITY, _VELOCITY):
            values = self._velocities(values)
        within = []
        for mode, value, limit in zip(modes, values, self._limits, strict=True):
            within += [mode, _limited(value, limit) if mode in (_VELOCITY, _SPEED) else value]
        return tuple(within)


def _goes_at_sp(call: Call) -> bool:
    modes = call.args[::2] if call.name == "mv" else ()
    return call.name in ("pr", "pa") or not {_RELATIVE, _ABSOLUTE}.isdisjoint(modes)


def _speeds(call: Call) -> dict[int, int]:
    """The axes whose speed of relative motion a call sets, and the speed."""
    if call.name == "sp":
        return dict(enumerate(call.args))
    if call.name == "mv":
        pairs = zip(call.args[::2], call.args[1::2], strict=False)
        return {axis: value for axis, (mode, value) in enumerate(pairs) if mode == _SPEED}
    return {}


def _limited(value: int, limit: float) -> int:
    return value if abs(value) <= limit else int(limit if value > 0 else -limit)


def _share(limit: float, value: float) -> float:
    return limit / value if value > limit else 1.0


POLL_S = 0.2
"""How often a robot is to be asked that nobody asks, so that a hit is seen."""
_MOTIONS = frozenset({"vm", "pr", "pa", "mv", "zr"})
_ATTEMPTS = 3
_PIECE_S = 1
"""The shortest wait that ws can say."""


class BumperStop(Wrapper):
    """Watches the bumpers in every answer that has them."""

    def __init__(self, inner: Backend) -> None:
        super().__init__(inner)
        model = inner.wire_state.model
        self._rest = model.bumper_rest
        self._motors = 7 if model.has_turret else 3
        self._touching = self._bits(inner.greeting) if inner.greeting else 0
        self._moving = False

    def execute(self, call: Call) -> Reply:
        """The answer. Raises BumperHit, after st, where a bumper has begun to touch."""
        return in_pieces(call, _PIECE_S, self._watched) if is_wait(call) else self._watched(call)

    def _watched(self, call: Call) -> Reply:
        self._moving |= call.name in _MOTIONS
        reply = self._inner.execute(call)
        moved, touched = self._moving, self._touching
        self._touching = self._bits(reply)
        if MOTOR_SLOT in reply.slots:
            self._moving = bool(reply.slots[MOTOR_SLOT] & self._motors)
        began = self._touching & ~touched
        if began and (moved or self._moving):
            self._stop()
            raise BumperHit(call.name, tuple(number for number in range(began.bit_length()) if began >> number & 1))
        return reply

    def _bits(self, reply: Reply) -> int:
        return reply.slots[BUMPER_SLOT] & ~self._rest if BUMPER_SLOT in reply.slots else self._touching

    def _stop(self) -> None:
        """st until it is answered; where it is not, the robot's own time-out is left."""
        for _ in range(_ATTEMPTS):
            with contextlib.suppress(NomadError):
                self._inner.execute(Call("st"))
                self._moving = False
                return


_FIRST = ("connect_robot", "ct", "conf_ls", "conf_tm", "conf_ir", "conf_sn", "conf_cp", "conf_sg")


_MODES = {4: "ac", 5: "sp"}
"""mv's modes that set something and move nothing, and the command that sets it for all axes."""
_CALIBRATING = 2


class Agreed:
    """What has been told, newest of each kind."""

    def __init__(self) -> None:
        self._told: dict[str, Call] = {}
        self._axes: dict[str, dict[int, int]] = {name: {} for name in _MODES.values()}

    def remember(self, call: Call) -> None:
        """A call was answered."""
        if call.name == "create_robot":
            self._told["connect_robot"] = Call("connect_robot", call.args)
        elif call.name in self._axes:
            self._axes[call.name] = dict(enumerate(call.args))
        elif call.name == "mv":
            for axis, (mode, value) in enumerate(zip(call.args[::2], call.args[1::2], strict=True)):
                if mode in _MODES:
                    self._axes[_MODES[mode]][axis] = value
        elif call.name in _FIRST and call != Call("conf_cp", (_CALIBRATING,)):
            self._told[call.name] = call

    def calls(self) -> Iterator[Call]:
        """What to tell a robot that may have forgotten, in order."""
        yield from (self._told[name] for name in _FIRST if name in self._told)
        for mode, name in _MODES.items():
            values = self._axes[name]
            if len(values) == _AXES:
                yield Call(name, tuple(values[axis] for axis in range(_AXES)))
            elif values:
                pairs = [(mode, values[axis]) if axis in values else (_NOWHERE, 0) for axis in range(_AXES)]
                yield Call("mv", tuple(number for pair in pairs for number in pair))


FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 5.0
"""Default of the longest pause between two tries."""


class Reconnecting(Wrapper):
    """A backend, and how to open another in its place; `longest_pause_s`: what the pauses grow to, doubling."""

    def __init__(
        self,
        inner: Backend,
        opens: Callable[[], Backend],
        longest_pause_s: float = LONGEST_PAUSE_S,
        *,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        super().__init__(inner)
        self._opens = opens
        self._longest_pause_s = longest_pause_s
        self._clock = clock
        self._left = threading.Event()
        self._wait = wait or self._left.wait
        self._agreed = Agreed()
        self._pause_s = 0.0
        self._next_try_s = 0.0

    @property
    def closed(self) -> bool:
        """Whether this side has closed it; a link that broke is not over."""
        return self._left.is_set()

    def execute(self, call: Call) -> Reply:
        """The answer, of a backend opened anew where it was lost. Raises ConnectionLost for each loss and each try."""
        if self._left.is_set():
            raise ConnectionLost(f"{call.name}: this side closed the connection; connect again")
        if self._inner.closed:
            self._come_back(call.name)
        try:
            reply = self._inner.execute(call)
        except NomadError:
            if self._inner.closed and not self._left.is_set():
                self._lost()
            raise
        self._remember(call)
        return reply

    def close(self) -> None:
        """Close it for good; a wait for the next try ends."""
        self._left.set()
        self._inner.close()

    def _lost(self) -> None:
        if self.link is not None:
            self.link.losses += 1
        self._pause_s = 0.0
        self._pause()

    def _pause(self) -> None:
        self._pause_s = min(max(FIRST_PAUSE_S, 2 * self._pause_s), self._longest_pause_s)
        self._next_try_s = self._clock() + self._pause_s

    def _come_back(self, name: str) -> None:
        """One try, not before its time. Raises ConnectionLost when nobody is there yet."""
        self._wait(max(0.0, self._next_try_s - self._clock()))
        try:
            self._inner = self._greeted()
        except NomadError as error:
            self._pause()
            raise ConnectionLost(f"{name}: not back yet, the next try in {self._pause_s:g} s: {error}") from error
        if self._left.is_set():
            self._inner.close()
        if self.link is not None:
            self.link.reconnects += 1

    def _greeted(self) -> Backend:
        backend = self._opens()
        try:
            for call in self._agreed.calls():
                backend.execute(call)
        except BaseException:
            backend.close()
            raise
        return backend

    def _remember(self, call: Call) -> None:
        self._agreed.remember(call)
        if call.name == "disconnect_robot":
            self._left.set()


OF_SIMULATIONS: Final = frozenset({"sim_truth", "sim_control"})
"""Commands that only a simulation understands."""


class Beside(Wrapper):
    """The line's backend, with another one to the simulation behind it."""

    def __init__(self, line: Backend, simulation: Backend) -> None:
        super().__init__(line)
        self._simulation = simulation

    def execute(self, call: Call) -> Reply:
        """The answer of the one that understands it. Raises what that one raises."""
        if call.name in OF_SIMULATIONS and not self.closed:
            return self._simulation.execute(call)
        return super().execute(call)

    def close(self) -> None:
        """Close both."""
        super().close()
        self._simulation.close()
