"""What lies between a port and the session behind it, without I/O: bytes go in at once and come out when it is time.

    to_robot(bytes, now), to_host(bytes, now) ──> arrived(now): what has come through to either side, in order
    PacedCable    a serial cable at a baud rate: 8N1, ten bits a byte, each way by itself

Rules: the clock is handed in. What a late look at the clock took from the host is given back to it: a request that
follows at once counts from the moment the answer was due, so that the rate holds however coarse alarms are.

A cable under a plan of faults, around another cable or none: what passes goes through the plan first. No I/O.

    host ──> FaultyLine ──> late? ──> the cable ──> robot          and back the same way

Rules: it is plugged in between two frames and then stays. A hang-up ends the connection when what was sent before it
has come through, and what was sent behind it is lost.

Which plan of faults is in force in a daemon, and an injector for each of its lines. Pure: the clock is handed in.

    put(plan) ──> injector("serial:1")  injector("nserver")  ...        counts of all lines together

Rules: one injector a line, whoever talks over it and however often: its counts outlive connections. Without a plan
there are injectors without rules, so that who once asked goes on asking.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, Protocol

from nclient.errors import FaultPlanError
from nclient.faults.frames import Injector, Language
from nclient.faults.inject import DelayQueue, FaultyLine
from nclient.faults.plan import Plan

BITS_A_BYTE: Final = 10
PIECE: Final = 64
"""Bytes that come out of a wire together; a longer answer comes piece by piece."""
MOST_ON_A_WIRE: Final = 16_384
"""Bytes on their way; a cable that holds more takes no more in, and loses what is put in all the same."""
MOST_GIVEN_BACK_S: Final = 0.02
"""Of a longer lateness the rest is lost to the host."""


class Arrival(NamedTuple):
    """Bytes that came through, when they did, and to which end; and whether the connection ends with them."""

    at_s: float
    data: bytes
    to_robot: bool
    hang_up: bool = False


class SerialChannel(Protocol):
    """See the head of this file."""

    @property
    def due_s(self) -> float | None:
        """When something will have come through; None: nothing is on its way."""
        ...

    @property
    def full(self) -> bool:
        """Whether no more should be read from the host."""
        ...

    def to_robot(self, data: bytes, now_s: float) -> None:
        """The host sends these."""
        ...

    def to_host(self, data: bytes, now_s: float) -> None:
        """The robot sends these."""
        ...

    def arrived(self, now_s: float) -> Arrival | None:
        """What has come through next by now; None: nothing more."""
        ...


class WiredChannel:
    """One direction of a serial cable."""

    def __init__(self, baud: int) -> None:
        self._byte_s = BITS_A_BYTE / baud
        self._free_s = -math.inf
        self._pieces: deque[tuple[float, bytes]] = deque()
        self.size = 0

    def put(self, data: bytes, now_s: float) -> None:
        """Send these behind what is on its way."""
        self._free_s = max(self._free_s, now_s)
        for start in range(0, len(data), PIECE):
            piece = data[start : start + PIECE]
            self._free_s += len(piece) * self._byte_s
            self._pieces.append((self._free_s, piece))
            self.size += len(piece)

    @property
    def due_s(self) -> float:
        """When the next piece will be through; infinity where none is on its way."""
        return self._pieces[0][0] if self._pieces else math.inf

    def take(self) -> tuple[float, bytes]:
        """The next piece, and when it is through."""
        at_s, piece = self._pieces.popleft()
        self.size -= len(piece)
        return at_s, piece


class RateLimitedChannel:
    """A serial cable at so many bits a second. `lost`: bytes to a host that asks more than the wire can carry."""

    def __init__(self, baud: int) -> None:
        self._in, self._out = WiredChannel(baud), WiredChannel(baud)
        self._late_s = 0.0
        self._answered_s = -math.inf
        self.lost = 0

    @property
    def due_s(self) -> float | None:
        due_s = min(self._in.due_s, self._out.due_s)
        return None if due_s == math.inf else due_s

    @property
    def full(self) -> bool:
        return self._in.size >= MOST_ON_A_WIRE

    def to_robot(self, data: bytes, now_s: float) -> None:
        at_once = now_s - self._answered_s < MOST_GIVEN_BACK_S
        self._in.put(data, now_s - self._late_s if at_once else now_s)
        self._late_s = 0.0

    def to_host(self, data: bytes, now_s: float) -> None:
        if self._out.size >= MOST_ON_A_WIRE:
            self.lost += len(data)
            return
        self._out.put(data, now_s)

    def arrived(self, now_s: float) -> Arrival | None:
        inward = self._in.due_s <= self._out.due_s
        wire = self._in if inward else self._out
        if wire.due_s > now_s:
            return None
        at_s, data = wire.take()
        if not inward:
            self._late_s, self._answered_s = min(now_s - at_s, MOST_GIVEN_BACK_S), now_s
        return Arrival(at_s, data, inward)


class FaultyChannel:
    """See the head of this file. `injector`: what acts on this line at present; `cable`: what lies behind."""

    def __init__(
        self, language: Language, injector: Callable[[], Injector], cable: SerialChannel | None = None
    ) -> None:
        self._line = FaultyLine(language, injector)
        self._cable = ImmediateChannel() if cable is None else cable
        self._asked, self._answered = DelayQueue(), DelayQueue()
        self._patient_until_s: float | None = None
        self._ending = False

    @property
    def due_s(self) -> float | None:
        """When something will have come through, or must be looked at."""
        moments = (self._asked.next_s, self._answered.next_s, self._cable.due_s, self._patient_until_s)
        return min((moment for moment in moments if moment is not None), default=None)

    @property
    def full(self) -> bool:
        """Whether no more should be read from the host."""
        return self._cable.full or max(self._asked.size, self._answered.size) >= MOST_ON_A_WIRE

    def to_robot(self, data: bytes, now_s: float) -> None:
        """The host sends these."""
        deliveries = self._line.request(data, now_s)
        self._asked.add((delivery for delivery in deliveries if not delivery.to_sender), now_s)
        self._answered.add((delivery for delivery in deliveries if delivery.to_sender), now_s)
        patience_s = self._line.partial_timeout_s
        self._patient_until_s = (
            now_s + patience_s if self._line.has_partial_request and patience_s is not None else None
        )

    def to_host(self, data: bytes, now_s: float) -> None:
        """The robot sends these."""
        self._answered.add(self._line.reply(data, now_s), now_s)

    def arrived(self, now_s: float) -> Arrival | None:
        """What has come through next by now; None: nothing more."""
        self._move_on(now_s)
        arrival = self._cable.arrived(now_s)
        if arrival is None and self._ending and self._cable.due_s is None:
            self._ending, self._asked, self._answered = False, DelayQueue(), DelayQueue()
            return Arrival(now_s, b"", to_robot=False, hang_up=True)
        return arrival

    def _move_on(self, now_s: float) -> None:
        """What was late enters the cable; a part of a request that has waited long enough goes as it is."""
        if self._patient_until_s is not None and now_s >= self._patient_until_s:
            self._patient_until_s = None
            self._asked.add(self._line.flush_request(now_s), now_s)
        for transit, enter in ((self._asked, self._cable.to_robot), (self._answered, self._cable.to_host)):
            while not self._ending and (late := transit.take(now_s)):
                at_s, delivery = late
                if delivery.data:
                    enter(delivery.data, at_s)
                self._ending = delivery.hang_up


class ImmediateChannel:
    """A cable that takes no time. What comes through together comes out together, as it does from a socket."""

    full = False

    def __init__(self) -> None:
        self._through: deque[Arrival] = deque()

    @property
    def due_s(self) -> float | None:
        """At once, if anything is there."""
        return self._through[0].at_s if self._through else None

    def to_robot(self, data: bytes, now_s: float) -> None:
        """As Cable says."""
        self._put(Arrival(now_s, data, to_robot=True))

    def to_host(self, data: bytes, now_s: float) -> None:
        """As Cable says."""
        self._put(Arrival(now_s, data, to_robot=False))

    def arrived(self, now_s: float) -> Arrival | None:
        """As Cable says."""
        del now_s
        return self._through.popleft() if self._through else None

    def _put(self, arrival: Arrival) -> None:
        last = self._through[-1] if self._through else None
        if last is not None and (last.at_s, last.to_robot) == (arrival.at_s, arrival.to_robot):
            self._through[-1] = last._replace(data=last.data + arrival.data)
        else:
            self._through.append(arrival)


NOTHING = Plan()


class FaultController:
    """See the head of this file. `clock`: seconds that only grow."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._since_s = clock()
        self._injectors: dict[str, Injector] = {}
        self.plan = NOTHING

    def put(self, plan: Plan, lines: Iterable[str]) -> None:
        """This plan is in force from now on, all its counts at 0. `lines`: those that there are.

        Raises FaultPlanError where a rule names a line that is not there; the plan before it then stays.
        """
        lines = tuple(lines)
        for rule in plan.rules:
            for named in rule.lines:
                if not any(named in (line, line.partition(":")[0]) for line in lines):
                    raise FaultPlanError(f"rule {rule.name!r}: line: there is no {named} here, but {', '.join(lines)}")
        self.plan = plan
        self._since_s = self._clock()
        self._injectors = {line: Injector(plan, line, self._since_s) for line in lines}

    def clear(self) -> None:
        """No plan from now on."""
        self.put(NOTHING, ())

    def acts_on(self, line: str) -> bool:
        """Whether a rule in force is for that line."""
        return any(rule.acts_on(line) for rule in self.plan.rules)

    def injector(self, line: str) -> Injector:
        """What acts on that line at present."""
        if line not in self._injectors:
            self._injectors[line] = Injector(self.plan, line, self._since_s)
        return self._injectors[line]

    def counts(self) -> dict[str, dict[str, dict[str, int]]]:
        """What happened under this plan: by line, by rule, by kind (nclient.faults.frames.Injector.counts)."""
        return {line: injector.counts for line, injector in self._injectors.items() if injector.counts}

    def reset(self) -> None:
        """Count from 0 again."""
        for injector in self._injectors.values():
            injector.reset()
