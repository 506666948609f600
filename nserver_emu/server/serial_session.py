"""A session on a robot's own serial line and the channel to its port, without I/O (docs/protocol.md, On a serial line).

    receive(bytes) -> framer -> queue -> answer(call, context) -> state packets, replies of get_ commands, NAK
                                               `- deferred (ws, zr, arm): tick() polls until the reply exists

The line belongs to one robot, so there is no CONNECT. Mask and laser mode belong to the robot too: they stay in force
when a host disconnects and apply to all its lines. Commands that the model lacks, wrong data and refused commands get a
NAK; bytes that form no frame get no reply, and the host repeats its request.

A host sends one request at a time. A new request during a deferred reply means that the host gave up on that reply, so
it is cancelled; `st` therefore works during `ws` (project decision: no source says what the original does).

A channel is between a port and its session: bytes enter at once and leave when they are due.

    to_robot(bytes, now), to_host(bytes, now) -> arrived(now): what has come through in either direction, in order

    ImmediateChannel     no delay
    RateLimitedChannel   a serial line at a baud rate: 8N1, ten bits a byte, each direction by itself
    FaultyChannel        a fault plan in front of another channel:  host -> FaultyLine -> delay -> channel -> robot
    FaultController      the fault plan of a server, with one injector for each of its lines

Times are seconds of a monotonic clock, passed in. A fault channel is installed between two frames and then stays. An
injected hang-up ends the connection after everything sent before it has come through; what follows is lost.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, Protocol

from nclient.errors import FaultPlanError, WireError
from nclient.faults.inject import DelayQueue, FaultyLine, Injector, Language
from nclient.faults.plan import Plan
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFrame, SerialFramer
from nclient.protocol.types import BUMPER_SLOT, Model, WireState, serial_wire_state
from nserver_emu.server.session import Answer, BaseSession, ConnectionContext

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

    def __init__(self, language: Language, injector: Callable[[], Injector],
                 channel: SerialChannel | None = None) -> None:
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


# Seconds after its first byte within which a frame must be complete: half of a host's timeout, and twice the duration
# of a host's longest frame at 9600 baud. After that its bytes are searched for frames inside it.
FRAME_TIMEOUT_S: Final = 0.5
# Decoded requests cached by their bytes: most hosts repeat the same few requests.
MAX_CACHED_CALLS: Final = 256
NAK: Final = Reply("nak")
_POSITION_SLOTS: Final = (34, 35)
# Limits of sign-magnitude numbers of two and four bytes.
_MAX_SHORT, _MAX_LONG = 0x7FFF, 0x7FFFFFFF


class SerialSession(BaseSession[SerialFrame]):
    """A session with one host on the line of a robot.

    Parameters
    ----------
    answer
        Executes calls.
    robot_id, model
        The robot of this line.
    clock
        Monotonic seconds of any origin.
    name
        Name of the line in logs.
    wire_state
        Mask and laser mode in force on the robot's lines; None for those at power-on.
    """

    def __init__(self, answer: Answer, robot_id: int, model: Model, clock: Callable[[], float], name: str = "line",
                 wire_state: WireState | None = None) -> None:
        super().__init__(answer, name, ConnectionContext(wire_state or serial_wire_state(model), robot_id))
        self.model = model
        self._clock = clock
        self._framer = SerialFramer(limit=HOST_LIMIT)
        # Time of the first byte of the incomplete frame; None if there is none.
        self._frame_start_s: float | None = None
        # Frames and skipped bytes when that time was taken: a change means that another frame is first now.
        self._progress = (0, 0)
        self._cached_calls: dict[SerialFrame, Call] = {}

    @property
    def greeting(self) -> bytes:
        """The handshake that a N200 sends when a host connects over TCP; empty for other models."""
        wire_state = self.context.wire_state
        return build_handshake(Handshake(wire_state.mask, wire_state.laser_mode)) if self.model.sends_mask else b""

    @property
    def unfinished(self) -> int:
        """Return the number of buffered bytes of an incomplete frame."""
        return self._framer.pending

    @property
    def skipped_bytes(self) -> int:
        """Number of bytes that belonged to no frame."""
        return self._framer.skipped_bytes

    @property
    def ready(self) -> bool:
        """Return True if a request can be answered now."""
        # A deferred reply does not block the next request: it is cancelled.
        return bool(self._queue) and not self.closing

    def receive(self, data: bytes) -> None:
        """Add bytes from the host, after dropping a frame that took too long."""
        if self.closing:
            return
        self._drop_expired_frame()
        self._queue.extend(self._framer.receive(data))
        if self._framer.pending or self._frame_start_s is not None:
            self._update_frame_start()

    def tick(self) -> bytes:
        """Return the deferred reply if it exists now; also drop an expired frame, which frees those behind it."""
        if self._framer.pending:
            self._drop_expired_frame()
        return super().tick()

    def _update_frame_start(self) -> None:
        """Take the time if an incomplete frame has become the first one."""
        progress = (self._framer.frames, self._framer.skipped_bytes)
        if self._framer.pending and (progress != self._progress or self._frame_start_s is None):
            self._frame_start_s = self._clock()
        elif not self._framer.pending:
            self._frame_start_s = None
        self._progress = progress

    def _drop_expired_frame(self) -> None:
        if self._frame_start_s is not None and self._clock() - self._frame_start_s > FRAME_TIMEOUT_S:
            self._queue.extend(self._framer.expire())
            self._update_frame_start()

    def _process_one(self, request: SerialFrame) -> bytes:
        self._deferred = None
        wire_state = self.context.wire_state
        call = self._cached_calls.get(request)
        if call is None:
            try:
                call = codec.decode_serial_request(request, wire_state)
            except WireError as error:
                self._count_refused(f"type {request.type}", str(error))
                return codec.encode_serial_reply(BY_NAME["gs"], NAK, wire_state)
            if len(self._cached_calls) < MAX_CACHED_CALLS:
                self._cached_calls[request] = call
        codec.update_from_request(call, wire_state)
        return self._reply_or_defer(call.name, self._answer(call, self.context))

    def _encode_anew(self, name: str, reply: Reply) -> bytes:
        if reply.kind == "error":
            reply = NAK
        return codec.encode_serial_reply(BY_NAME[name], to_line_units(reply, self.model), self.context.wire_state)


def to_line_units(reply: Reply, model: Model) -> Reply:
    """Return the reply as a line carries it: bumper bits with their rest value, positions clamped to +-3276.7 in."""
    changed = {slot: _clamp(reply.slots[slot], _MAX_SHORT) for slot in _POSITION_SLOTS if slot in reply.slots}
    if BUMPER_SLOT in reply.slots:
        changed[BUMPER_SLOT] = reply.slots[BUMPER_SLOT] | model.bumper_rest
    if not changed and not reply.stamps:
        return reply
    stamps = {key: stamp._replace(x=_clamp(stamp.x, _MAX_LONG), y=_clamp(stamp.y, _MAX_LONG))
              for key, stamp in reply.stamps.items()}
    slots = {**reply.slots, **changed}
    return Reply(reply.kind, slots, reply.laser, stamps, reply.clock, reply.volts, reply.values)


def _clamp(number: int, limit: int) -> int:
    return max(-limit, min(limit, number))
