"""Channels between a port and its session, without I/O: bytes enter at once and leave when they are due.

    to_robot(bytes, now), to_host(bytes, now) -> arrived(now): what has come through in either direction, in order

    ImmediateChannel     no delay
    RateLimitedChannel   a serial line at a baud rate: 8N1, ten bits a byte, each direction by itself
    FaultyChannel        a fault plan in front of another channel:  host -> FaultyLine -> delay -> channel -> robot
    FaultController      the fault plan of a server, with one injector for each of its lines

Times are seconds of a monotonic clock, passed in. A fault channel is installed between two frames and then stays. An
injected hang-up ends the connection after everything sent before it has come through; what follows is lost.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, Protocol

from nclient.errors import FaultPlanError
from nclient.faults.frames import Injector, Language
from nclient.faults.inject import DelayQueue, FaultyLine
from nclient.faults.plan import Plan

BITS_PER_BYTE: Final = 10
# Bytes that leave a line together; a longer reply arrives in pieces.
PIECE_BYTES: Final = 64
# Bytes in transit in one direction; the port is not read while there are more, and further replies are lost.
MAX_IN_TRANSIT: Final = 16_384
# Maximum delay of the event loop that is compensated.
MAX_COMPENSATED_S: Final = 0.02


class Arrival(NamedTuple):
    """Bytes that have come through a channel."""

    # Time at which they arrived, which may be before now.
    at_s: float
    data: bytes
    # True if they are for the robot, False for the host.
    to_robot: bool
    # True if the connection ends after them.
    hang_up: bool = False


class SerialChannel(Protocol):
    """A channel between a host and a robot."""

    @property
    def due_s(self) -> float | None:
        """Time of the next arrival, None if nothing is in transit."""

    @property
    def full(self) -> bool:
        """True if no more should be read from the host."""

    def to_robot(self, data: bytes, now_s: float) -> None:
        """Send bytes from the host."""

    def to_host(self, data: bytes, now_s: float) -> None:
        """Send bytes from the robot."""

    def arrived(self, now_s: float) -> Arrival | None:
        """Return the next arrival by now, None if there is none."""


class WiredChannel:
    """One direction of a serial line."""

    def __init__(self, baud: int) -> None:
        self._byte_s = BITS_PER_BYTE / baud
        # Time at which all bytes in transit will have arrived.
        self._free_s = -math.inf
        self._pieces: deque[tuple[float, bytes]] = deque()
        self.size = 0

    def put(self, data: bytes, now_s: float) -> None:
        """Send bytes behind those in transit."""
        self._free_s = max(self._free_s, now_s)
        for start in range(0, len(data), PIECE_BYTES):
            piece = data[start : start + PIECE_BYTES]
            self._free_s += len(piece) * self._byte_s
            self._pieces.append((self._free_s, piece))
            self.size += len(piece)

    @property
    def due_s(self) -> float:
        """Time of arrival of the next piece, infinity if there is none."""
        return self._pieces[0][0] if self._pieces else math.inf

    def take(self) -> tuple[float, bytes]:
        """Remove the next piece; return its time of arrival and its bytes."""
        at_s, piece = self._pieces.popleft()
        self.size -= len(piece)
        return at_s, piece


class RateLimitedChannel:
    """A serial line at a baud rate.

    Event-loop timers are coarse. The delay of a reply by a late timer is given back to the host: a request that follows
    at once counts from the moment when the reply was due, so that the rate is exact.
    """

    def __init__(self, baud: int) -> None:
        self._in, self._out = WiredChannel(baud), WiredChannel(baud)
        # Delay of the last reply by a late timer, and when it was delivered.
        self._late_s = 0.0
        self._replied_s = -math.inf
        # Number of bytes lost because a host requested more than the line carries.
        self.lost = 0

    @property
    def due_s(self) -> float | None:
        """Return the time of the next arrival, None if nothing is in transit."""
        due_s = min(self._in.due_s, self._out.due_s)
        return None if due_s == math.inf else due_s

    @property
    def full(self) -> bool:
        """Return True if no more should be read from the host."""
        return self._in.size >= MAX_IN_TRANSIT

    def to_robot(self, data: bytes, now_s: float) -> None:
        """Send bytes from the host, dated back by the delay of the last reply."""
        is_immediate = now_s - self._replied_s < MAX_COMPENSATED_S
        self._in.put(data, now_s - self._late_s if is_immediate else now_s)
        self._late_s = 0.0

    def to_host(self, data: bytes, now_s: float) -> None:
        """Send bytes from the robot; drop them if too many are in transit."""
        if self._out.size >= MAX_IN_TRANSIT:
            self.lost += len(data)
            return
        self._out.put(data, now_s)

    def arrived(self, now_s: float) -> Arrival | None:
        """Return the next arrival by now, in either direction, None if there is none."""
        inward = self._in.due_s <= self._out.due_s
        wire = self._in if inward else self._out
        if wire.due_s > now_s:
            return None
        at_s, data = wire.take()
        if not inward:
            self._late_s, self._replied_s = min(now_s - at_s, MAX_COMPENSATED_S), now_s
        return Arrival(at_s, data, inward)


class FaultyChannel:
    """A fault plan in front of another channel.

    Parameters
    ----------
    language
        The framing of the line.
    injector
        Returns the fault injector of the line at present.
    channel
        The channel behind the faults; None for no delay.
    """

    def __init__(
        self, language: Language, injector: Callable[[], Injector], channel: SerialChannel | None = None
    ) -> None:
        self._line = FaultyLine(language, injector)
        self._channel = ImmediateChannel() if channel is None else channel
        # Bytes delayed by a fault, to the robot and to the host.
        self._to_robot, self._to_host = DelayQueue(), DelayQueue()
        # Time at which an incomplete request is passed on; None if there is none.
        self._request_due_s: float | None = None
        # True after an injected hang-up, until the channel is empty.
        self._ending = False

    @property
    def due_s(self) -> float | None:
        """Return the time of the next arrival or fault, None if there is none."""
        times = (self._to_robot.next_s, self._to_host.next_s, self._channel.due_s, self._request_due_s)
        return min((time_s for time_s in times if time_s is not None), default=None)

    @property
    def full(self) -> bool:
        """True if no more should be read from the host."""
        return self._channel.full or max(self._to_robot.size, self._to_host.size) >= MAX_IN_TRANSIT

    def to_robot(self, data: bytes, now_s: float) -> None:
        """Send bytes from the host."""
        deliveries = self._line.request(data, now_s)
        self._to_robot.add((delivery for delivery in deliveries if not delivery.to_sender), now_s)
        self._to_host.add((delivery for delivery in deliveries if delivery.to_sender), now_s)
        timeout_s = self._line.partial_timeout_s
        self._request_due_s = now_s + timeout_s if self._line.has_partial_request and timeout_s is not None else None

    def to_host(self, data: bytes, now_s: float) -> None:
        """Send bytes from the robot."""
        self._to_host.add(self._line.reply(data, now_s), now_s)

    def arrived(self, now_s: float) -> Arrival | None:
        """Return the next arrival by now, None if there is none."""
        self._advance(now_s)
        arrival = self._channel.arrived(now_s)
        if arrival is None and self._ending and self._channel.due_s is None:
            self._ending, self._to_robot, self._to_host = False, DelayQueue(), DelayQueue()
            return Arrival(now_s, b"", to_robot=False, hang_up=True)
        return arrival

    def _advance(self, now_s: float) -> None:
        """Pass delayed bytes and an incomplete request that waited long enough to the channel."""
        if self._request_due_s is not None and now_s >= self._request_due_s:
            self._request_due_s = None
            self._to_robot.add(self._line.flush_request(now_s), now_s)
        for transit, enter in ((self._to_robot, self._channel.to_robot), (self._to_host, self._channel.to_host)):
            while not self._ending and (late := transit.take(now_s)):
                at_s, delivery = late
                if delivery.data:
                    enter(delivery.data, at_s)
                self._ending = delivery.hang_up


class ImmediateChannel:
    """A channel without delay. Bytes sent at the same time arrive together, as from a socket."""

    full = False

    def __init__(self) -> None:
        self._arrivals: deque[Arrival] = deque()

    @property
    def due_s(self) -> float | None:
        """Time of the next arrival: at once."""
        return self._arrivals[0].at_s if self._arrivals else None

    def to_robot(self, data: bytes, now_s: float) -> None:
        """Implement SerialChannel."""
        self._put(Arrival(now_s, data, to_robot=True))

    def to_host(self, data: bytes, now_s: float) -> None:
        """Implement SerialChannel."""
        self._put(Arrival(now_s, data, to_robot=False))

    def arrived(self, now_s: float) -> Arrival | None:
        """Implement SerialChannel."""
        del now_s
        return self._arrivals.popleft() if self._arrivals else None

    def _put(self, arrival: Arrival) -> None:
        last = self._arrivals[-1] if self._arrivals else None
        if last is not None and (last.at_s, last.to_robot) == (arrival.at_s, arrival.to_robot):
            self._arrivals[-1] = last._replace(data=last.data + arrival.data)
        else:
            self._arrivals.append(arrival)


# The plan without rules.
NO_FAULTS = Plan()


class FaultController:
    """The fault plan in force and an injector for each line, whose counts outlive connections.

    `clock` returns monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._since_s = clock()
        self._injectors: dict[str, Injector] = {}
        self.plan = NO_FAULTS

    def put(self, plan: Plan, lines: Iterable[str]) -> None:
        """Put a plan in force with all counts at 0.

        Parameters
        ----------
        plan
            The fault plan.
        lines
            Names of all lines.

        Raises
        ------
        FaultPlanError
            If a rule names a line that does not exist; the previous plan then stays in force.
        """
        lines = tuple(lines)
        for rule in plan.rules:
            for named in rule.lines:
                if not any(named in (line, line.partition(":")[0]) for line in lines):
                    existing = ", ".join(lines)
                    raise FaultPlanError(f"rule {rule.name!r}: line: there is no {named}; the lines are {existing}")
        self.plan = plan
        self._since_s = self._clock()
        self._injectors = {line: Injector(plan, line, self._since_s) for line in lines}

    def clear(self) -> None:
        """Remove the plan."""
        self.put(NO_FAULTS, ())

    def acts_on(self, line: str) -> bool:
        """Return True if a rule in force applies to a line."""
        return any(rule.acts_on(line) for rule in self.plan.rules)

    def injector(self, line: str) -> Injector:
        """Return the injector of a line."""
        if line not in self._injectors:
            self._injectors[line] = Injector(self.plan, line, self._since_s)
        return self._injectors[line]

    def counts(self) -> dict[str, dict[str, dict[str, int]]]:
        """Return the number of injected faults by line, rule and kind."""
        return {line: injector.counts for line, injector in self._injectors.items() if injector.counts}

    def reset(self) -> None:
        """Set all counts to 0."""
        for injector in self._injectors.values():
            injector.reset()
