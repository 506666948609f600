"""Validation of replies: a second check behind the checksum, whose eight bits let a few corrupt frames pass.

    ranges    angles and compass 0..3599, sonars 0 (dead) or 6..255 in, bumper bits at rest, motor bits, speeds
    changes   the clock advances; position, angles and battery change no further than a robot can in that time; no
              more sonars change than have fired (once conf_sn has set how fast they do)

Only the robot's clock counts. Validation must not lock out an unusual robot: replies of one kind that fail three times
in a row are accepted until one passes again. That also covers a clock that was reset and a robot that was carried.
Bumper bits at rest that belong to another model are the exception: they are never accepted before bits of this model
were received.
"""

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from nclient.protocol.commands import Call
from nclient.protocol.decode import model_mismatch_hint
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import (
    BUMPER_SLOT,
    COMPASS_SLOT,
    FULL_TURN_TENTHS,
    MAX_SONAR_IN,
    MIN_SONAR_IN,
    SONAR_RATE_STEP_S,
    Model,
)

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
            *[(slot, (MIN_SONAR_IN, MAX_SONAR_IN)) for slot in _SONARS],
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
            self._firing_ms = max(1, call.args[0]) * SONAR_RATE_STEP_S * _MS

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
