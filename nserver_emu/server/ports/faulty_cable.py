"""A cable under a plan of faults, around another cable or none: what passes goes through the plan first. No I/O.

    host ──> FaultyLine ──> late? ──> the cable ──> robot          and back the same way

Rules: it is plugged in between two frames and then stays. A hang-up ends the connection when what was sent before it
has come through, and what was sent behind it is lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from nclient.faults.faulty_line import FaultyLine, InTransit
from nclient.faults.injector import Injector
from nclient.faults.language import Language
from nserver_emu.server.ports.cable import MOST_ON_A_WIRE, Arrival, Cable


class FaultyCable:
    """See the head of this file. `injector`: what acts on this line at present; `cable`: what lies behind."""

    def __init__(self, language: Language, injector: Callable[[], Injector], cable: Cable | None = None) -> None:
        self._line = FaultyLine(language, injector)
        self._cable = Wireless() if cable is None else cable
        self._asked, self._answered = InTransit(), InTransit()
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
        self._asked.add((delivery for delivery in deliveries if not delivery.back), now_s)
        self._answered.add((delivery for delivery in deliveries if delivery.back), now_s)
        patience_s = self._line.patience_s
        self._patient_until_s = now_s + patience_s if self._line.asking and patience_s is not None else None

    def to_host(self, data: bytes, now_s: float) -> None:
        """The robot sends these."""
        self._answered.add(self._line.reply(data, now_s), now_s)

    def arrived(self, now_s: float) -> Arrival | None:
        """What has come through next by now; None: nothing more."""
        self._move_on(now_s)
        arrival = self._cable.arrived(now_s)
        if arrival is None and self._ending and self._cable.due_s is None:
            self._ending, self._asked, self._answered = False, InTransit(), InTransit()
            return Arrival(now_s, b"", to_robot=False, hang_up=True)
        return arrival

    def _move_on(self, now_s: float) -> None:
        """What was late enters the cable; a part of a request that has waited long enough goes as it is."""
        if self._patient_until_s is not None and now_s >= self._patient_until_s:
            self._patient_until_s = None
            self._asked.add(self._line.rest_of_request(now_s), now_s)
        for transit, enter in ((self._asked, self._cable.to_robot), (self._answered, self._cable.to_host)):
            while not self._ending and (late := transit.take(now_s)):
                at_s, delivery = late
                if delivery.data:
                    enter(delivery.data, at_s)
                self._ending = delivery.hang_up


class Wireless:
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
