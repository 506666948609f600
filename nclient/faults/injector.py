"""What a plan does to the frames of one line: frames in, deliveries out. Pure and seeded: no clock, no stream.

    pass_on(frame, command, direction, now) ──> [Delivery, ...]       an empty list: it does not arrive

Rules: exact counts: a strike is counted when it happened and changed something. Chance is a stream of its own for each
rule on each line, so that adding a rule leaves what the others do. Whoever delivers keeps the order of bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from random import Random
from typing import NamedTuple

from nclient.faults.alter import altered, with_noise
from nclient.faults.kinds import Alteration, Delay, Drop, Fault, HangUp, Nak, Noise, Silence
from nclient.faults.plan import Direction, Plan, Rule
from nclient.protocol.commands import NAK_TYPE
from nclient.protocol.serial_frame import build_frame

SEEN, SWALLOWED = "seen", "swallowed"
LINE_NAK = build_frame(NAK_TYPE)
"""The refusal on a robot's own line."""


class Delivery(NamedTuple):
    """What arrives: `data`, so many seconds late, and then perhaps the end of the connection.

    `back`: it goes to whoever sent the frame, as the answer to it.
    """

    delay_s: float
    data: bytes
    hang_up: bool = False
    back: bool = False


class Injector:
    """A plan at work on one line. `start_s`: when it came into force, on the clock of pass_on's `now_s`."""

    def __init__(self, plan: Plan, line: str, start_s: float = 0.0) -> None:
        self.plan = plan
        self.line = line
        self._start_s = start_s
        self._silences: dict[Direction, tuple[float, _Striker]] = {}
        self._strikers = [
            _Striker(rule, Random(f"{plan.seed} {line} {rule.name}")) for rule in plan.rules if rule.acts_on(line)
        ]

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """What happened so far, by the name of each rule for this line.

        seen: frames that came to it; then the kinds by name: frames struck; corrupted_bytes, dropped_bytes,
        added_bytes of noise; swallowed: frames that a silence took after the one it began with.
        """
        return {striker.rule.name: striker.snapshot() for striker in self._strikers}

    def reset(self) -> None:
        """Begin to count anew, from 0; "every tenth" goes on where it was, and so does chance."""
        for striker in self._strikers:
            striker.tally.clear()

    def pass_on(
        self, data: bytes, command: str, direction: Direction, now_s: float, nak: bytes = LINE_NAK
    ) -> list[Delivery]:
        """What arrives of a frame, none or one delivery. `nak`: the refusal in the language that is spoken here.

        `command`: the C name of what is asked or answered, "" for bytes that are no frame.
        """
        until_s, silencer = self._silences.get(direction, (now_s, None))
        if silencer is not None and now_s < until_s:
            silencer.tally[SWALLOWED] += 1
            return []
        delay_s = 0.0
        for striker in self._strikers:
            match striker.struck(command, direction, now_s - self._start_s):
                case None:
                    continue
                case HangUp() as fault:
                    return [Delivery(delay_s, data[: fault.keep], hang_up=True)]
                case Nak() if direction is Direction.REQUEST:
                    return [Delivery(delay_s, nak, back=True)]
                case Delay() as fault:
                    delay_s += max(0.0, fault.delay_s + fault.jitter_s * striker.chance.uniform(-1.0, 1.0))
                case fault:
                    data = self._changed(data, fault, striker, now_s, nak)
            if not data:
                return []
        return [Delivery(delay_s, data)]

    def _changed(
        self, data: bytes, fault: Alteration | Drop | Silence | Nak | Noise, striker: _Striker, now_s: float, nak: bytes
    ) -> bytes:
        """What goes on of a frame, nothing where the fault swallows it."""
        match fault:
            case Drop():
                return b""
            case Silence():
                silence = (now_s + fault.silence_s, striker)
                self._silences.update(dict.fromkeys(striker.rule.directions, silence))
                return b""
            case Nak():
                return nak
            case Noise():
                return with_noise(data, fault, striker.chance, striker.tally)
            case _:
                return altered(data, fault, striker.chance)


class _Striker:
    """A rule on one line: how many frames came, and what it did to them."""

    def __init__(self, rule: Rule, chance: Random) -> None:
        self.rule = rule
        self.chance = chance
        self.tally: Counter[str] = Counter()
        self._number = 0

    def struck(self, command: str, direction: Direction, elapsed_s: float) -> Fault | None:
        """What it does to this frame, counted; None for nothing."""
        rule = self.rule
        if not rule.when.covers(elapsed_s) or not rule.matches(command, direction):
            return None
        self._number += 1
        self.tally[SEEN] += 1
        if not rule.when.strikes(self._number, self.chance.random()):
            return None
        fault = rule.faults[0] if len(rule.faults) == 1 else self.chance.choice(rule.faults)
        if not isinstance(fault, Noise):
            self.tally[fault.kind] += 1
        return fault

    def snapshot(self) -> dict[str, int]:
        """The counts as they are, with a 0 for what has not happened."""
        kinds = dict.fromkeys((SEEN, *(fault.kind for fault in self.rule.faults)), 0)
        return kinds | dict(self.tally)


def total(counts: Mapping[str, Mapping[str, int]]) -> Counter[str]:
    """The counts of all rules together, by kind."""
    together: Counter[str] = Counter()
    for tally in counts.values():
        together.update(tally)
    del together[SEEN]
    return together
