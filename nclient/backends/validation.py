"""Whether an answer can be true: the second net behind the checksum, whose eight bits let a few wrong frames through.

    ranges    angles and compass 0..3599, sonars 0 (dead) or 6..255 in, bumper bits at rest, motor bits, speeds
    changes   the clock goes forward; position, angles and battery no further than a robot gets in that time; no more
              sonars changed than fired (where conf_sn has said how fast they do)

Rules: pure; the robot's clock is the only time. A check must not shut out a robot that is odd: answers of one kind
that fail three times in a row are the robot's way and not the line's, and are believed until one passes again. The
same heals a clock that was reset and a robot that somebody carried away. But bumper bits at rest that are another
model's are not believed however often they come, until they have once been this model's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from nclient.protocol.commands import Call
from nclient.protocol.decode import model_mismatch_hint
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, FULL_TURN_TENTHS, SONAR_RATE_STEP_S, Model

BELIEVED_AFTER = 3
"""Doubtful answers of one kind in a row."""
_NAMES = {34: "x", 35: "y", 36: "steering", 37: "turret", COMPASS_SLOT: "compass", MOTOR_SLOT: "the motors' status"}
_POSE, _PLACE, _ANGLES = range(34, 38), (34, 35), (36, 37, COMPASS_SLOT)
_SONARS = range(17, 33)
_MOVED = {"dp": _POSE, "da": _POSE, "zr": _POSE, "conf_sn": _SONARS}
"""What a command sets, so that it is no jump."""
_VELOCITIES = range(38, 41)
_NEAREST_IN, _NOTHING_IN, _DEAD = 6, 255, 0
_TOP_RATE = 2000
"""1/10 in/s and 1/10 deg/s: four times what any model does."""
_TURRET_MOTORS, _SCOUT_MOTORS = 0x07, 0x7F
_LONGEST_PAUSE_MS = 600_000
"""The clock may jump so far: a program that slept ten minutes asks once more."""
_WORD = 1 << 32
_REACH = (60, 600)
"""1/10 in that a position may differ, and more a second; a Scout does 390."""
_SWING = (100, 1000)
_SCOUT_SWING = (100, 4000)
"""1/10 degree that an angle may differ, and more a second; the turret does 450, a Scout 3290."""
_VOLT_STEP = 64
"""Steps of 1/255 that a battery byte may differ: 1.8 V, what starting motors cost."""
_WITHOUT = "without those that always read 1"
_OTHERS_REST = 0x0000F0
"""What the others' resting bits read as in a Scout's order of bytes."""
_MS = 1000


class _Seen(NamedTuple):
    """What was believed last."""

    clock: int
    slots: dict[int, int]
    volts: tuple[int, int] | None


class Plausibility:
    """Judges the answers of one robot, in order."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._swing = _SWING if model.has_turret else _SCOUT_SWING
        self._ranges = [
            *[(slot, (_NEAREST_IN, _NOTHING_IN)) for slot in _SONARS],
            *[(slot, (0, FULL_TURN_TENTHS - 1)) for slot in _ANGLES],
            *[(slot, (-_TOP_RATE, _TOP_RATE)) for slot in _VELOCITIES],
            (MOTOR_SLOT, (0, _TURRET_MOTORS if model.has_turret else _SCOUT_MOTORS)),
        ]
        self._seen: _Seen | None = None
        self._firing_ms: float | None = None
        self._doubted: dict[str, int] = {}
        self._model_seen = False

    def note(self, call: Call) -> None:
        """A request went out: what it moves without driving is no jump."""
        moved = _MOVED.get(call.name)
        if moved is not None and self._seen is not None:
            kept = {slot: value for slot, value in self._seen.slots.items() if slot not in moved}
            self._seen = self._seen._replace(slots=kept)
        if call.name == "conf_sn":
            self._firing_ms = max(1, call.args[0]) * SONAR_RATE_STEP_S * _MS

    def doubt(self, reply: Reply) -> str:
        """What cannot be true of an answer; "" for one to believe."""
        contradiction = self._contradiction(reply)
        if contradiction:
            return contradiction
        found = next(self._doubts(reply), "")
        count = self._doubted[reply.kind] = self._doubted.get(reply.kind, 0) + 1 if found else 0
        if found and count < BELIEVED_AFTER:
            return found
        if reply.clock is not None:
            slots = {**self._seen.slots, **reply.slots} if self._seen else dict(reply.slots)
            self._seen = _Seen(reply.clock, slots, reply.volts or (self._seen.volts if self._seen else None))
        return ""

    def _contradiction(self, reply: Reply) -> str:
        """Bumper bits of another model, as long as they have never been this one's."""
        bits = reply.slots.get(BUMPER_SLOT)
        if self._model_seen or bits is None:
            return ""
        rest = self._model.bumper_rest
        if not rest and bits & _OTHERS_REST == _OTHERS_REST:
            hint = model_mismatch_hint(self._model)
            return f"bumper bits {bits:06x}, of which four always read 1 on other models; {hint}"
        if bits & rest != rest:
            return f"bumper bits {bits:06x} {_WITHOUT}; {model_mismatch_hint(self._model)}"
        self._model_seen = True
        return ""

    def _doubts(self, reply: Reply) -> Iterator[str]:
        yield from self._out_of_range(reply)
        if self._seen is not None and reply.clock is not None:
            passed_ms = (reply.clock - self._seen.clock) % _WORD
            if passed_ms > _LONGEST_PAUSE_MS:
                yield f"the clock goes from {self._seen.clock} to {reply.clock} ms"
            yield from self._leaps(reply.slots, self._seen.slots, passed_ms)
            yield from self._too_many_fired(reply.slots, self._seen.slots, passed_ms)
            for old, new in zip(self._seen.volts or (), reply.volts or (), strict=False):
                if abs(new - old) > _VOLT_STEP:
                    yield f"a battery byte goes from {old} to {new}"

    def _out_of_range(self, reply: Reply) -> Iterator[str]:
        slots = reply.slots
        for slot, (least, most) in self._ranges:
            value = slots.get(slot)
            if value is not None and not least <= value <= most and (value != _DEAD or slot not in _SONARS):
                yield f"{_name(slot)} reads {value}, and a {self._model.name}'s lies from {least} to {most}"
        rest = self._model.bumper_rest
        if slots.get(BUMPER_SLOT, rest) & rest != rest:
            yield f"bumper bits {slots[BUMPER_SLOT]:06x} {_WITHOUT}"

    def _leaps(self, slots: Mapping[int, int], before: Mapping[int, int], passed_ms: int) -> Iterator[str]:
        """Of place and directions, farther than a robot comes."""
        for slot in (slot for slot in _POSE if slot in slots and slot in before):
            step = abs(slots[slot] - before[slot])
            if slot in _PLACE:
                within = step <= _way(_REACH, passed_ms)
            else:
                within = min(step, FULL_TURN_TENTHS - step) <= _way(self._swing, passed_ms)
            if not within:
                yield f"{_name(slot)} jumps from {before[slot]} to {slots[slot]} in {passed_ms} ms"

    def _too_many_fired(self, slots: Mapping[int, int], before: Mapping[int, int], passed_ms: int) -> Iterator[str]:
        if self._firing_ms is None:
            return
        changed = sum(before.get(slot, slots[slot]) != slots[slot] for slot in _SONARS if slot in slots)
        if changed > passed_ms / self._firing_ms + 2:
            yield f"{changed} sonars changed in {passed_ms} ms, and one fires every {self._firing_ms:g}"


def _name(slot: int) -> str:
    return f"sonar {slot - _SONARS[0]}" if slot in _SONARS else _NAMES.get(slot, f"State[{slot}]")


def _way(limit: tuple[int, int], passed_ms: int) -> float:
    least, a_second = limit
    return least + a_second * passed_ms / _MS
