"""Backends around backends: retries, speed limits, bumper stop, reconnect, and the simulation behind a serial line.

`nclient.connector.Connector.open` shows the order in which they are put around a protocol backend.

Validation of replies: a second check behind the checksum, whose eight bits let a few corrupt frames pass.

    ranges    angles and compass 0..3599, sonars 0 (dead) or 6..255 in, bumper bits at rest, motor bits, speeds
    changes   the clock advances; position, angles and battery change no further than a robot can in that time; no
              more sonars change than have fired (once conf_sn has set how fast they do)

Only the robot's clock counts. Validation must not lock out an unusual robot: replies of one kind that fail three times
in a row are accepted until one passes again. That also covers a clock that was reset and a robot that was carried.
Bumper bits at rest that belong to another model are the exception: they are never accepted before bits of this model
were received.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from nclient.backends.base import Backend, Wrapper, is_wait, split_wait
from nclient.errors import BumperHit, ConnectionLost, NomadError, ReplyTimeout, RobotRefused
from nclient.protocol import types
from nclient.protocol.commands import Call
from nclient.protocol.decode import model_mismatch_hint
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, FULL_TURN_TENTHS, SCOUT_WHEEL_IN_PER_DEG, Model
from nclient.transports.stream import on_error

ACCEPTED_AFTER: Final = 3
"""Inconsistent replies of one kind in a row, of which the last is accepted."""

_NAMES: Final = {
    34: "x", 35: "y", 36: "steering", 37: "turret", COMPASS_SLOT: "compass", MOTOR_SLOT: "the motors' status",
}  # fmt: skip
_POSE, _POSITION, _ANGLES = range(34, 38), (34, 35), (36, 37, COMPASS_SLOT)
_SONARS: Final = range(17, 33)
_VELOCITIES: Final = range(38, 41)
_SET_BY: Final = {"dp": _POSE, "da": _POSE, "zr": _POSE, "conf_sn": _SONARS}
"""State slots that a command sets, so that their next change is no jump."""

# ranges
_DEAD: Final = 0
_MAX_RATE: Final = 2000
"""1/10 in/s and 1/10 deg/s: four times the maximum of any model."""
_TURRET_MOTORS, _SCOUT_MOTORS = 0x07, 0x7F
_OTHERS_REST: Final = 0x0000F0
"""Resting bumper bits of the other models, as they read in a Scout's byte order."""
_MISSING_REST_BITS: Final = "without those that always read 1"

# changes
_CLOCK_PERIOD_MS: Final = 1 << 32
_MAX_PAUSE_MS: Final = 600_000
"""Maximum advance of the clock; a program that paused for longer repeats its request once."""
_MAX_STEP: Final = (60, 600)
"""Maximum change of a position in 1/10 in, at once and per second; a Scout reaches 390 per second."""
_MAX_TURN: Final = (100, 1000)
_MAX_SCOUT_TURN: Final = (100, 4000)
"""Maximum change of an angle in 1/10 deg, at once and per second; the turret reaches 450, a Scout 3290 per second."""
_MAX_VOLT_STEP: Final = 64
"""Maximum change of a battery byte: 1.8 V, the drop when motors start."""
_MS: Final = 1000


class _Accepted(NamedTuple):
    """Clock, State slots and battery bytes of the last accepted reply."""

    clock: int
    slots: dict[int, int]
    volts: tuple[int, int] | None


class ReplyValidator:
    """Validate the replies of one robot, in order."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._max_turn = _MAX_TURN if model.has_turret else _MAX_SCOUT_TURN
        self._ranges = [
            *[(slot, (types.MIN_SONAR_IN, types.MAX_SONAR_IN)) for slot in _SONARS],
            *[(slot, (0, FULL_TURN_TENTHS - 1)) for slot in _ANGLES],
            *[(slot, (-_MAX_RATE, _MAX_RATE)) for slot in _VELOCITIES],
            (MOTOR_SLOT, (0, _TURRET_MOTORS if model.has_turret else _SCOUT_MOTORS)),
        ]
        self._last: _Accepted | None = None
        self._firing_ms: float | None = None
        self._failures: dict[str, int] = {}
        self._model_confirmed = False

    def update_from_request(self, call: Call) -> None:
        """Record a request before it is sent: what it sets without moving the robot is no jump."""
        slots_set = _SET_BY.get(call.name)
        if slots_set is not None and self._last is not None:
            others = {slot: value for slot, value in self._last.slots.items() if slot not in slots_set}
            self._last = self._last._replace(slots=others)
        if call.name == "conf_sn":
            self._firing_ms = max(1, call.args[0]) * types.SONAR_RATE_STEP_S * _MS

    def find_inconsistency(self, reply: Reply) -> str:
        """Return a description of what cannot be true of a reply, "" if it is accepted."""
        # 1. Bumper bits of another model: never accepted by repetition.
        if mismatch := self._find_model_mismatch(reply):
            return mismatch
        # 2. Ranges and changes: accepted the third time in a row.
        found = next(self._inconsistencies(reply), "")
        failures = self._failures.get(reply.kind, 0) + 1 if found else 0
        self._failures[reply.kind] = failures
        if found and failures < ACCEPTED_AFTER:
            return found
        # 3. Accepted: the next reply is compared with this one.
        if reply.clock is not None:
            slots = {**self._last.slots, **reply.slots} if self._last else dict(reply.slots)
            self._last = _Accepted(reply.clock, slots, reply.volts or (self._last.volts if self._last else None))
        return ""

    def _find_model_mismatch(self, reply: Reply) -> str:
        bits = reply.slots.get(BUMPER_SLOT)
        if self._model_confirmed or bits is None:
            return ""
        rest = self._model.bumper_rest
        if not rest and bits & _OTHERS_REST == _OTHERS_REST:
            hint = model_mismatch_hint(self._model)
            return f"bumper bits {bits:06x}, of which four always read 1 on other models; {hint}"
        if bits & rest != rest:
            return f"bumper bits {bits:06x} {_MISSING_REST_BITS}; {model_mismatch_hint(self._model)}"
        self._model_confirmed = True
        return ""

    def _inconsistencies(self, reply: Reply) -> Iterator[str]:
        yield from self._out_of_range(reply)
        if self._last is not None and reply.clock is not None:
            passed_ms = (reply.clock - self._last.clock) % _CLOCK_PERIOD_MS
            if passed_ms > _MAX_PAUSE_MS:
                yield f"the clock goes from {self._last.clock} to {reply.clock} ms"
            yield from self._jumps(reply.slots, self._last.slots, passed_ms)
            yield from self._too_many_sonars(reply.slots, self._last.slots, passed_ms)
            for old, new in zip(self._last.volts or (), reply.volts or (), strict=False):
                if abs(new - old) > _MAX_VOLT_STEP:
                    yield f"a battery byte goes from {old} to {new}"

    def _out_of_range(self, reply: Reply) -> Iterator[str]:
        slots = reply.slots
        for slot, (lowest, highest) in self._ranges:
            value = slots.get(slot)
            is_dead_sonar = value == _DEAD and slot in _SONARS
            if value is not None and not lowest <= value <= highest and not is_dead_sonar:
                yield f"{_name(slot)} reads {value}, and a {self._model.name}'s lies from {lowest} to {highest}"
        rest = self._model.bumper_rest
        if slots.get(BUMPER_SLOT, rest) & rest != rest:
            yield f"bumper bits {slots[BUMPER_SLOT]:06x} {_MISSING_REST_BITS}"

    def _jumps(self, slots: Mapping[int, int], before: Mapping[int, int], passed_ms: int) -> Iterator[str]:
        """Yield changes of position and angles that no robot can make in that time."""
        for slot in (slot for slot in _POSE if slot in slots and slot in before):
            step = abs(slots[slot] - before[slot])
            if slot in _POSITION:
                is_possible = step <= _max_change(_MAX_STEP, passed_ms)
            else:
                # Angles wrap: the shorter direction counts.
                is_possible = min(step, FULL_TURN_TENTHS - step) <= _max_change(self._max_turn, passed_ms)
            if not is_possible:
                yield f"{_name(slot)} jumps from {before[slot]} to {slots[slot]} in {passed_ms} ms"

    def _too_many_sonars(self, slots: Mapping[int, int], before: Mapping[int, int], passed_ms: int) -> Iterator[str]:
        if self._firing_ms is None:
            return
        changed = sum(before.get(slot, slots[slot]) != slots[slot] for slot in _SONARS if slot in slots)
        # Two more than the quotient: one firing at either end of the interval.
        if changed > passed_ms / self._firing_ms + 2:
            yield f"{changed} sonars changed in {passed_ms} ms, and one fires every {self._firing_ms:g}"


def _name(slot: int) -> str:
    return f"sonar {slot - _SONARS[0]}" if slot in _SONARS else _NAMES.get(slot, f"State[{slot}]")


def _max_change(limit: tuple[int, int], passed_ms: int) -> float:
    at_once, per_second = limit
    return at_once + per_second * passed_ms / _MS


_AXES: Final = 3
# Modes of an axis in mv.
_NONE, _VELOCITY, _RELATIVE, _ACCELERATION, _SPEED, _ABSOLUTE = 0, 1, 2, 4, 5, 6


# -- retries ----------------------------------------------------------------------------------------------------------

DEFAULT_RETRIES: Final = 2
_REPEATABLE: Final = frozenset({"gs", "ct", "sp", "ac", "st", "lp"})
_REPEATABLE_PREFIXES: Final = ("get_", "conf_")


def may_be_repeated(name: str) -> bool:
    """Return True for commands that have the same effect if sent twice: queries, settings and stops, no motions."""
    return name.startswith(_REPEATABLE_PREFIXES) or name in _REPEATABLE


class RetryingBackend(Wrapper):
    """Repeat requests that are safe to repeat, up to `retries` times.

    Repeated are requests that got no reply, and those that got a NAK, since the request itself may have been
    corrupted. After ConnectionLost nothing is repeated: the program has to know that the link was lost.
    """

    def __init__(self, inner: Backend, retries: int) -> None:
        super().__init__(inner)
        self._retries = retries

    def execute(self, call: Call) -> Reply:
        """Return the first reply. Raises the error of the last attempt."""
        for _ in range(self._retries if may_be_repeated(call.name) else 0):
            try:
                return self._inner.execute(call)
            except ReplyTimeout:
                if self._inner.closed:  # over TCP
                    raise
            except RobotRefused as refusal:
                if not refusal.is_nak:
                    raise
            if self.link is not None:
                self.link.retries += 1
        return self._inner.execute(call)


# -- speed limits -----------------------------------------------------------------------------------------------------


class SpeedLimiter(Wrapper):
    """Limit the speeds of vm, mv and sp, and with them those of relative and absolute motions.

    Values are reduced to the limit, never refused, and keep their signs. The wheels of a Scout are reduced together,
    so that the curve stays the same. Relative motions use the speed that sp or mv has set: before one, each limited
    axis whose speed the robot may not have gets it again, or the limit if the program has set none.

    Parameters
    ----------
    inner
        The backend to wrap.
    max_speed_in_s
        Maximum translation in inches per second.
    max_turn_deg_s
        Maximum rate of steering and turret in degrees per second; of a Scout, of its body.
    """

    def __init__(self, inner: Backend, *, max_speed_in_s: float = float("inf"),
                 max_turn_deg_s: float = float("inf")) -> None:
        super().__init__(inner)
        self._speed, self._turn = 10 * max_speed_in_s, 10 * max_turn_deg_s  # tenths, as on the wire
        if inner.wire_state.model.has_turret:
            self._limits: tuple[float, ...] = (self._speed, self._turn, self._turn)
        else:
            # Axes of a Scout are its right and left wheel; a turn on the spot moves both.
            wheel = min(self._speed, self._turn * SCOUT_WHEEL_IN_PER_DEG)
            self._limits = (wheel, wheel, float("inf"))
        self._set_speeds: dict[int, int] = {}
        """Speed of each axis that the program has set, limited."""
        self._confirmed: set[int] = set()
        """Axes whose speed the robot has confirmed."""

    def execute(self, call: Call) -> Reply:
        """Return the reply to the limited call. Raises as the inner backend."""
        limited = self._limit(call)
        try:
            # 1. The speed of a relative motion was set earlier, possibly on a link that is lost.
            if _uses_set_speed(call):
                self._confirm_speeds(_speeds_of(limited))
            # 2. The call itself.
            return self._execute(limited)
        except ConnectionLost:
            self._confirmed.clear()
            raise

    def _execute(self, call: Call) -> Reply:
        # The call may set speeds itself, which count once it is answered.
        speeds = _speeds_of(call)
        try:
            reply = self._inner.execute(call)
        except (ReplyTimeout, ConnectionLost):  # the robot may have received it, or not
            self._set_speeds |= speeds
            self._confirmed -= speeds.keys()
            raise
        self._set_speeds |= speeds
        self._confirmed |= speeds.keys()
        return reply

    def _confirm_speeds(self, set_by_call: Mapping[int, int]) -> None:
        """Send the speeds that the robot may not have; axes without a limit are left alone."""
        speeds = {axis: self._set_speeds.get(axis, int(limit)) for axis, limit in enumerate(self._limits)
                  if limit < float("inf") and axis not in self._confirmed and axis not in set_by_call}
        if speeds:
            self._inner.execute(_mv_call(_SPEED, speeds))
            self._confirmed |= speeds.keys()

    def _limit(self, call: Call) -> Call:
        if call.name == "vm" and len(call.args) == _AXES:
            return Call("vm", self._limit_velocities(call.args))
        if call.name == "sp" and len(call.args) == _AXES:
            return Call("sp", tuple(map(_clamp, call.args, self._limits)))
        if call.name == "mv" and len(call.args) == 2 * _AXES:
            return Call("mv", self._limit_modes(call.args[::2], call.args[1::2]))
        return call

    def _limit_velocities(self, velocities: Sequence[int]) -> tuple[int, ...]:
        if self._inner.wire_state.model.has_turret:
            return tuple(map(_clamp, velocities, self._limits))
        # A Scout: one factor for both wheels keeps the curve.
        right, left, rest = velocities
        turn = abs(right - left) / 2 / SCOUT_WHEEL_IN_PER_DEG
        factor = min(1.0, _factor(self._speed, max(abs(right), abs(left))), _factor(self._turn, turn))
        return int(right * factor), int(left * factor), rest

    def _limit_modes(self, modes: Sequence[int], values: Sequence[int]) -> tuple[int, ...]:
        """Limit mv, axis by axis; the wheels of a Scout together if both have a velocity."""
        if not self._inner.wire_state.model.has_turret and tuple(modes[:2]) == (_VELOCITY, _VELOCITY):
            values = self._limit_velocities(values)
        args: list[int] = []
        for mode, value, limit in zip(modes, values, self._limits, strict=True):
            args += [mode, _clamp(value, limit) if mode in (_VELOCITY, _SPEED) else value]
        return tuple(args)


def _uses_set_speed(call: Call) -> bool:
    """Return True for motions that use the speed of sp: relative and absolute ones."""
    modes = call.args[::2] if call.name == "mv" else ()
    return call.name in ("pr", "pa") or not {_RELATIVE, _ABSOLUTE}.isdisjoint(modes)


def _speeds_of(call: Call) -> dict[int, int]:
    """Return the speeds of relative motion that a call sets, by axis."""
    if call.name == "sp":
        return dict(enumerate(call.args))
    if call.name == "mv":
        pairs = zip(call.args[::2], call.args[1::2], strict=False)
        return {axis: value for axis, (mode, value) in enumerate(pairs) if mode == _SPEED}
    return {}


def _mv_call(mode: int, values: Mapping[int, int]) -> Call:
    """Return the mv that sets these axes in one mode and leaves the others alone."""
    pairs = [(mode, values[axis]) if axis in values else (_NONE, 0) for axis in range(_AXES)]
    return Call("mv", tuple(number for pair in pairs for number in pair))


def _clamp(value: int, limit: float) -> int:
    return value if abs(value) <= limit else int(limit if value > 0 else -limit)


def _factor(limit: float, value: float) -> float:
    return limit / value if value > limit else 1.0


# -- bumper stop ------------------------------------------------------------------------------------------------------

POLL_S: Final = 0.2
"""Interval of the requests that keep-alive sends for the bumper stop."""
_MOTIONS: Final = frozenset({"vm", "pr", "pa", "mv", "zr"})
_STOP_ATTEMPTS: Final = 3
_WAIT_PIECE_S: Final = 1
"""The shortest ws; a hit is noticed between two pieces."""


class BumperStop(Wrapper):
    """Stop the robot when a bumper closes while it moves, and raise BumperHit.

    st is sent before anything is raised. Only a bumper that was open before counts, so that a robot that was stopped
    at a wall can be driven away from it. After a motion command the robot counts as moving until a state shows that
    it is still.
    """

    def __init__(self, inner: Backend) -> None:
        super().__init__(inner)
        model = inner.wire_state.model
        self._rest = model.bumper_rest
        self._motors = 0b111 if model.has_turret else 0b011
        self._closed_bumpers = self._bumper_bits(inner.greeting) if inner.greeting else 0
        self._moving = False

    def execute(self, call: Call) -> Reply:
        """Return the reply. Raises BumperHit, after st, if a bumper has closed."""
        return split_wait(call, _WAIT_PIECE_S, self._execute) if is_wait(call) else self._execute(call)

    def _execute(self, call: Call) -> Reply:
        # 1. Exchange, and update both states from the reply.
        self._moving |= call.name in _MOTIONS
        reply = self._inner.execute(call)
        was_moving, before = self._moving, self._closed_bumpers
        self._closed_bumpers = self._bumper_bits(reply)
        if MOTOR_SLOT in reply.slots:
            self._moving = bool(reply.slots[MOTOR_SLOT] & self._motors)
        # 2. Bumpers that closed with this reply.
        hit = self._closed_bumpers & ~before
        if hit and (was_moving or self._moving):
            self._stop()
            raise BumperHit(call.name, tuple(number for number in range(hit.bit_length()) if hit >> number & 1))
        return reply

    def _bumper_bits(self, reply: Reply) -> int:
        return reply.slots[BUMPER_SLOT] & ~self._rest if BUMPER_SLOT in reply.slots else self._closed_bumpers

    def _stop(self) -> None:
        """Send st until it is answered; after the last attempt only the robot's motion timeout is left."""
        for _ in range(_STOP_ATTEMPTS):
            with contextlib.suppress(NomadError):
                self._inner.execute(Call("st"))
                self._moving = False
                return


# -- reconnect --------------------------------------------------------------------------------------------------------

MIN_PAUSE_S: Final = 0.1
MAX_PAUSE_S: Final = 5.0
"""Default maximum of the pause between two attempts to reconnect."""
_RESTORED: Final = ("connect_robot", "ct", "conf_ls", "conf_tm", "conf_ir", "conf_sn", "conf_cp", "conf_sg")
"""Settings in the order in which they are sent again: robot, reply format, safety, sensors; speeds come after them."""
_AXIS_SETTINGS: Final = {_ACCELERATION: "ac", _SPEED: "sp"}
"""Modes of mv that set something and move nothing, and the command that sets it for all axes."""
_COMPASS_CALIBRATION: Final = 2


class PersistentSettings:
    """Persistent robot settings, sent again after a reconnect. None of them moves the robot."""

    def __init__(self) -> None:
        self._calls: dict[str, Call] = {}
        self._axes: dict[str, dict[int, int]] = {name: {} for name in _AXIS_SETTINGS.values()}

    def record(self, call: Call) -> None:
        """Record a call that was answered; the last one of each kind counts, of accelerations and speeds by axis."""
        # A created robot exists when the link is lost: connect to it.
        if call.name == "create_robot":
            self._calls["connect_robot"] = Call("connect_robot", call.args)
        elif call.name in self._axes:
            self._axes[call.name] = dict(enumerate(call.args))
        elif call.name == "mv":
            for axis, (mode, value) in enumerate(zip(call.args[::2], call.args[1::2], strict=True)):
                if mode in _AXIS_SETTINGS:
                    self._axes[_AXIS_SETTINGS[mode]][axis] = value
        elif call.name in _RESTORED and call != Call("conf_cp", (_COMPASS_CALIBRATION,)):
            # A calibration of the compass is an action, and must not be repeated.
            self._calls[call.name] = call

    def calls(self) -> Iterator[Call]:
        """Yield the calls that restore the settings, in order."""
        yield from (self._calls[name] for name in _RESTORED if name in self._calls)
        for mode, name in _AXIS_SETTINGS.items():
            values = self._axes[name]
            # ac and sp set all axes; mv only those that the program has set.
            if len(values) == _AXES:
                yield Call(name, tuple(values[axis] for axis in range(_AXES)))
            elif values:
                yield _mv_call(mode, values)


class ReconnectingBackend(Wrapper):
    """Open a lost link again.

        lost -> ConnectionLost -> next call: wait 0.1 s, open, restore settings -> fails: ConnectionLost -> 0.2 s ...

    Each loss is raised once, by the call that notices it, and that call is not repeated: the program decides. The
    next call reconnects and restores the robot's number, mask and laser mode, motion timeout, sensors and speeds.
    Nothing moves.

    Parameters
    ----------
    inner
        The backend to wrap.
    open_session
        Returns a new backend with a new link.
    max_pause_s
        Maximum pause between two attempts, up to which pauses double, in seconds.
    clock
        Seconds.
    wait
        Waits for that many seconds, or less if the backend is closed.
    """

    def __init__(self, inner: Backend, open_session: Callable[[], Backend], max_pause_s: float = MAX_PAUSE_S, *,
                 clock: Callable[[], float] = time.monotonic, wait: Callable[[float], object] | None = None) -> None:
        super().__init__(inner)
        self._open_session = open_session
        self._max_pause_s = max_pause_s
        self._clock = clock
        self._closed = threading.Event()
        self._wait = wait or self._closed.wait
        self._settings = PersistentSettings()
        self._pause_s = 0.0
        self._next_attempt_s = 0.0

    @property
    def closed(self) -> bool:
        """Return True if this side has closed the connection; a lost link is not closed."""
        return self._closed.is_set()

    def execute(self, call: Call) -> Reply:
        """Return the reply, on a new link if the last one was lost. Raises ConnectionLost per loss and attempt."""
        if self._closed.is_set():
            raise ConnectionLost(f"{call.name}: this side closed the connection; connect again")
        # 1. Reconnect if an earlier call, or a keep-alive, noticed a loss.
        if self._inner.closed:
            self._reconnect(call.name)
        # 2. A loss during this call is raised and counted; the next call reconnects.
        try:
            reply = self._inner.execute(call)
        except NomadError:
            if self._inner.closed and not self._closed.is_set():
                if self.link is not None:
                    self.link.losses += 1
                self._pause_s = 0.0
                self._schedule_attempt()
            raise
        # 3. Only what was answered is restored later.
        self._settings.record(call)
        if call.name == "disconnect_robot":
            self._closed.set()
        return reply

    def close(self) -> None:
        """Close for good; a pause before an attempt ends."""
        self._closed.set()
        self._inner.close()

    def _schedule_attempt(self) -> None:
        self._pause_s = min(max(MIN_PAUSE_S, 2 * self._pause_s), self._max_pause_s)
        self._next_attempt_s = self._clock() + self._pause_s

    def _reconnect(self, name: str) -> None:
        """Make one attempt, not before its time. Raises ConnectionLost if it fails."""
        self._wait(max(0.0, self._next_attempt_s - self._clock()))
        try:
            self._inner = self._open_and_restore()
        except NomadError as error:
            self._schedule_attempt()
            raise ConnectionLost(f"{name}: not back yet, the next try in {self._pause_s:g} s: {error}") from error
        if self._closed.is_set():  # another thread closed the backend during the attempt
            self._inner.close()
        if self.link is not None:
            self.link.reconnects += 1

    def _open_and_restore(self) -> Backend:
        backend = self._open_session()
        with on_error(backend.close):
            for call in self._settings.calls():
                backend.execute(call)
        return backend


# -- a simulated serial line ------------------------------------------------------------------------------------------

SIMULATION_COMMANDS: Final = frozenset({"sim_truth", "sim_control"})
"""Commands that only a simulation answers."""


class SimulationBackendMux(Wrapper):
    """Route commands of the simulation to a session of their own, and all others to a simulated serial line."""

    def __init__(self, line: Backend, simulation: Backend) -> None:
        super().__init__(line)
        self._simulation = simulation

    def execute(self, call: Call) -> Reply:
        """Return the reply of the backend that has the command. Raises as that one."""
        if call.name in SIMULATION_COMMANDS and not self.closed:
            return self._simulation.execute(call)
        return super().execute(call)

    def close(self) -> None:
        """Close both backends."""
        super().close()
        self._simulation.close()
