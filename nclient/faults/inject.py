"""Fault injection into a connection: both directions of a line, delayed deliveries, and a stream with faults.

    request(bytes), reply(bytes) ──> deliveries      class FaultyLine; DelayQueue holds them until they are due

    send(frame)  ──> FaultyLine ──> the stream       receive  <── DelayQueue <── FaultyLine <── the stream

FaultyLine and DelayQueue have no I/O and no clock. FaultyStream is a ByteStream around another one, real or simulated;
it waits with the `sleep` and clock that it is given, which may be simulated time. After a hang-up it stays closed;
its injector with the counts may be used for the next stream.

Applying a fault plan to the frames of one line: framing, changes of bytes, injector, protocols.

    LineFrames    serial line      01 | length low, high | type | ... | checksum | 5c
    TcpFrames     Nserver          int16 type | uint16 count | count words; 8 bytes each for 64-bit clients
    Injector      process_frame(frame, command, direction, now) ──> [Delivery, ...]      an empty list: dropped

The framers lose no bytes: bytes that are no frame are passed on unchanged. They only find where frames end; both ends
of the connection still parse the frames themselves. Everything is seeded, without clock and I/O. Each rule has a random
stream of its own per line, so that another rule in the plan does not change its effect. Counts are exact: a fault is
counted when it changed something. The caller keeps the order of deliveries.

On the serial line a reply names its command; over TCP replies belong to the delivered requests in their order. The
substitute for a NAK over TCP is an ERROR reply with code 5, refused.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from random import Random
from typing import NamedTuple

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.faults import plan as faults
from nclient.protocol.client_state import HANDSHAKE_SIZE
from nclient.protocol.codec import build_frame as build_tcp_frame
from nclient.protocol.commands import BY_LINE_TYPE, BY_NAME, BY_TCP_TYPE, ERROR_TYPE, MAX_REPLY_WORDS, NAK_TYPE
from nclient.protocol.serial_framing import HOST_LIMIT, ROBOT_LIMIT, SerialFrame, SerialFramer, build_frame
from nclient.transports.stream import ByteStream, Deadline

_TCP_HEADER, _TYPE_SIZE, _WORD = 4, 2, 4
_CONNECT_TYPES = frozenset(BY_NAME[name].tcp_type for name in ("create_robot", "connect_robot", "disconnect_robot"))
_MAX_WORDS = max(MAX_REPLY_WORDS.values())


class StreamPiece(NamedTuple):
    """A whole frame and its type, or bytes that are no frame and None."""

    data: bytes
    type: int | None


class LineFrames:
    """Framer of one direction of the serial line.

    Parameters
    ----------
    limit
        Maximum size of a frame in bytes.
    bare
        Number of bytes before the first frame: the handshake.
    """

    def __init__(self, limit: int = ROBOT_LIMIT, bare: int = 0) -> None:
        self._framer = SerialFramer(limit)
        self._bare = bare
        self._head = b""

    @property
    def pending_bytes(self) -> int:
        """Return the number of buffered bytes."""
        return len(self._head) + self._framer.pending

    def receive(self, data: bytes) -> list[StreamPiece]:
        """Add bytes, and return the pieces that they complete, in order; the bare bytes at the start are one piece."""
        if not self._bare:
            return _pieces(self._framer.split(data))
        self._head += data
        if len(self._head) < self._bare:
            return []
        bare, rest = self._head[: self._bare], self._head[self._bare :]
        self._bare, self._head = 0, b""
        return [StreamPiece(bare, None), *_pieces(self._framer.split(rest))]

    def flush(self) -> list[StreamPiece]:
        """Return the buffered bytes, with frames found behind a wrong start byte."""
        head, self._head = self._head, b""
        found = [head[:1], *self._framer.split(head[1:])] if head else []
        return _pieces([*found, *self._framer.split_rest()])


def _pieces(found: Iterable[SerialFrame | bytes]) -> list[StreamPiece]:
    """Return frames, and the bytes between two of them joined: one piece of noise is one piece to the rules."""
    pieces: list[StreamPiece] = []
    for each in found:
        if isinstance(each, SerialFrame):
            pieces.append(StreamPiece(build_frame(each.type, each.data), each.type))
        elif pieces and pieces[-1].type is None:
            pieces[-1] = StreamPiece(pieces[-1].data + each, None)
        else:
            pieces.append(StreamPiece(each, None))
    return pieces


class TcpFrames:
    """Framer of one direction of a TCP connection.

    A count larger than that of any message means that synchronisation is lost: later bytes are passed on as they come.

    Parameters
    ----------
    wide
        True for a 64-bit client, None to detect it from CONNECT.
    """

    def __init__(self, wide: bool | None = False) -> None:
        self.wide = wide
        self._lost = False
        self._buffer = bytearray()

    @property
    def pending_bytes(self) -> int:
        """Return the number of buffered bytes."""
        return len(self._buffer)

    def receive(self, data: bytes) -> list[StreamPiece]:
        """Add bytes, and return the pieces that they complete, in order."""
        self._buffer += data
        found: list[StreamPiece] = []
        while not self._lost and len(self._buffer) >= _TCP_HEADER:
            # 1. Header: type and number of words, big-endian. An impossible count means lost synchronisation.
            frame_type = int.from_bytes(self._buffer[:_TYPE_SIZE], "big", signed=True)
            count = int.from_bytes(self._buffer[_TYPE_SIZE:_TCP_HEADER], "big")
            self._lost = count > _MAX_WORDS
            if self._lost or not self._detect_word_size(frame_type):
                break
            # 2. The whole frame; words have four or eight bytes.
            size = _TCP_HEADER + count * _WORD * (2 if self.wide else 1)
            if len(self._buffer) < size:
                break
            found.append(StreamPiece(bytes(self._buffer[:size]), frame_type))
            del self._buffer[:size]
        return found + self.flush() if self._lost else found

    def flush(self) -> list[StreamPiece]:
        """Return the buffered bytes; the next ones start a new frame."""
        flush = bytes(self._buffer)
        self._buffer.clear()
        return [StreamPiece(flush, None)] if flush else []

    def _detect_word_size(self, frame_type: int) -> bool:
        """Detect the word size: robot numbers are at least 1, so that a 64-bit client sends 0 as the first word."""
        if self.wide is None and frame_type in _CONNECT_TYPES:
            # The first word after the header is the robot's number, or the high half of it.
            first = self._buffer[_TCP_HEADER : _TCP_HEADER + _WORD]
            if len(first) < _WORD:
                return False
            self.wide = not any(first)
        return True


Frames = LineFrames | TcpFrames
"""Framer of one direction of a connection. `receive` returns the pieces that are complete, `flush` the rest."""


CORRUPTED, DROPPED, ADDED = "corrupted_bytes", "dropped_bytes", "added_bytes"


def alter_bytes(data: bytes, fault: faults.Alteration, rng: Random) -> bytes:
    """Return the bytes after a fault; `data` has at least one byte, the result may be empty."""
    match fault:
        case faults.Corrupt():
            place = _index(fault.place, len(data), rng)
            return data[:place] + bytes((_different_byte(data[place], fault.change, rng),)) + data[place + 1 :]
        case faults.DropByte():
            place = _index(fault.place, len(data), rng)
            return data[:place] + data[place + 1 :]
        case faults.InsertBytes():
            place = _index(fault.place, len(data) + 1, rng)
            return data[:place] + rng.randbytes(fault.count) + data[place:]
    # A cut delivers at least one byte if it can, and never the whole frame.
    maximum = len(data) - 1
    return data[: rng.randint(min(1, maximum), maximum) if fault.keep is None else min(fault.keep, maximum)]


def add_noise(data: bytes, noise: faults.Noise, rng: Random, tally: Counter[str]) -> bytes:
    """Return the bytes after random noise, and count changed bytes by kind and the frame in `tally`."""
    # One draw per byte, compared with cumulative probabilities: dropped | corrupted | added | unchanged.
    dropped = noise.drop_percent / 100.0
    corrupted = dropped + noise.corrupt_percent / 100.0
    added = corrupted + noise.add_percent / 100.0
    arrived, happened = bytearray(), Counter[str]()
    for byte in data:
        draw = rng.random()
        if draw >= added:
            arrived.append(byte)
        elif draw < dropped:
            happened[DROPPED] += 1
        elif draw < corrupted:
            happened[CORRUPTED] += 1
            arrived.append(_different_byte(byte, noise.change, rng))
        else:
            happened[ADDED] += 1
            arrived += bytes((byte, rng.randrange(256)))
    if happened:
        tally.update(happened)
        tally[noise.kind] += 1
    return bytes(arrived)


def _index(wanted: int | None, count: int, rng: Random) -> int:
    """Return an index from 0 below `count`: the given one, clamped, or a random one."""
    if wanted is None:
        return rng.randrange(count)
    return min(max(wanted + count if wanted < 0 else wanted, 0), count - 1)


def _different_byte(byte: int, change: str, rng: Random) -> int:
    return byte ^ (1 << rng.randrange(8) if change == faults.BIT else rng.randrange(1, 256))


SEEN, SWALLOWED = "seen", "swallowed"
LINE_NAK = build_frame(NAK_TYPE)
"""Refusal on the serial line."""


class Delivery(NamedTuple):
    """Bytes to deliver after a delay.

    `hang_up` closes the connection afterwards; `to_sender` returns the bytes to the sender of the frame, as its reply.
    """

    delay_s: float
    data: bytes
    hang_up: bool = False
    to_sender: bool = False


class Injector:
    """Executes a plan on one line.

    Parameters
    ----------
    plan
        The plan.
    line
        Name of the line, such as serial:1.
    start_s
        Time at which the plan comes into force, on the clock of `now_s` in `process_frame`.
    """

    def __init__(self, plan: faults.Plan, line: str, start_s: float = 0.0) -> None:
        self.plan = plan
        self.line = line
        self._start_s = start_s
        self._silences: dict[faults.Direction, tuple[float, RuleState]] = {}
        self._states = [RuleState(rule, Random(f"{plan.seed} {line} {rule.name}")) for rule in plan.rules
                        if rule.acts_on(line)]

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Return the counts so far, by name of rule.

        seen: frames that reached the rule; each kind: frames it was applied to; corrupted_bytes, dropped_bytes,
        added_bytes: bytes changed by noise; swallowed: frames dropped by a silence after its first one.
        """
        return {state.rule.name: state.snapshot() for state in self._states}

    def reset(self) -> None:
        """Set all counts to 0; the position of "every tenth" and the random streams do not change."""
        for state in self._states:
            state.tally.clear()

    def process_frame(self, data: bytes, command: str, direction: faults.Direction, now_s: float,
                      nak: bytes = LINE_NAK) -> list[Delivery]:
        """Apply the rules to a frame.

        Parameters
        ----------
        data
            The bytes of the frame.
        command
            C name of the request, or of the request that is replied to; "" for bytes that are no frame.
        direction
            Direction of the frame.
        now_s
            Current time in seconds.
        nak
            Refusal in the protocol of the line.

        Returns
        -------
        list
            One delivery, or none if the frame is dropped.
        """
        # 1. A silence that is in force drops everything.
        until_s, silencing = self._silences.get(direction, (now_s, None))
        if silencing is not None and now_s < until_s:
            silencing.tally[SWALLOWED] += 1
            return []
        # 2. Each rule in turn may end the frame, delay it or change its bytes.
        delay_s = 0.0
        for state in self._states:
            match state.next_fault(command, direction, now_s - self._start_s):
                case None:
                    continue
                case faults.HangUp() as fault:
                    return [Delivery(delay_s, data[: fault.keep], hang_up=True)]
                case faults.Nak() if direction is faults.Direction.REQUEST:
                    return [Delivery(delay_s, nak, to_sender=True)]
                case faults.Delay() as fault:
                    delay_s += max(0.0, fault.delay_s + fault.jitter_s * state.rng.uniform(-1.0, 1.0))
                case fault:
                    data = self._apply(data, fault, state, now_s, nak)
            if not data:
                return []
        return [Delivery(delay_s, data)]

    def _apply(self, data: bytes, fault: faults.Alteration | faults.Drop | faults.Blackout | faults.Nak | faults.Noise,
               state: RuleState, now_s: float, nak: bytes) -> bytes:
        """Return the bytes after a fault, empty if it drops the frame."""
        match fault:
            case faults.Drop():
                return b""
            case faults.Blackout():
                silence = (now_s + fault.silence_s, state)
                self._silences.update(dict.fromkeys(state.rule.directions, silence))
                return b""
            case faults.Nak():
                return nak
            case faults.Noise():
                return add_noise(data, fault, state.rng, state.tally)
            case _:
                return alter_bytes(data, fault, state.rng)


class RuleState:
    """Counters and random stream of a rule on one line."""

    def __init__(self, rule: faults.Rule, rng: Random) -> None:
        self.rule = rule
        self.rng = rng
        self.tally: Counter[str] = Counter()
        self._number = 0

    def next_fault(self, command: str, direction: faults.Direction, elapsed_s: float) -> faults.Fault | None:
        """Count a frame, and return the fault to apply to it, or None."""
        rule = self.rule
        # 1. Frames of other commands, directions and times are not counted.
        if not rule.when.covers(elapsed_s) or not rule.matches(command, direction):
            return None
        self._number += 1
        self.tally[SEEN] += 1
        if not rule.when.matches(self._number, self.rng.random()):
            return None
        # 2. With several kinds one is drawn each time.
        fault = rule.faults[0] if len(rule.faults) == 1 else self.rng.choice(rule.faults)
        # 3. Noise counts itself, because it may change nothing.
        if not isinstance(fault, faults.Noise):
            self.tally[fault.kind] += 1
        return fault

    def snapshot(self) -> dict[str, int]:
        """Return a copy of the counts, with 0 for kinds that have not happened."""
        kinds = dict.fromkeys((SEEN, *(fault.kind for fault in self.rule.faults)), 0)
        return kinds | dict(self.tally)


def total(counts: Mapping[str, Mapping[str, int]]) -> Counter[str]:
    """Return the sum of the counts of all rules, by kind."""
    together: Counter[str] = Counter()
    for tally in counts.values():
        together.update(tally)
    del together[SEEN]
    return together


NAK_ERROR = 5
"""Error code of the ERROR reply that replaces a NAK over TCP: refused."""
# Bound of the memory for requests whose replies never come.
_MAX_OUTSTANDING = 1 << 16


class LineLanguage:
    """Serial line; with `has_handshake` the robot sends eleven bytes first, as an N200 does over TCP."""

    nak = LINE_NAK
    partial_timeout_s: float | None = 0.25
    """Time after which an incomplete request is passed on: it may never become complete."""

    def __init__(self, has_handshake: bool = False) -> None:
        self.requests = LineFrames(HOST_LIMIT)
        self.replies = LineFrames(bare=HANDSHAKE_SIZE if has_handshake else 0)
        self._greets = has_handshake
        # On the serial line one request is outstanding at most, so the last one is enough.
        self._last_command = ""

    def request_name(self, piece: StreamPiece) -> str:
        """Return the C name of a request, by its type byte."""
        return _line_name(piece)

    def request_delivered(self, command: str) -> None:
        """Store the command: a NAK does not say which request it refuses."""
        self._last_command = command

    def reply_name(self, piece: StreamPiece) -> str:
        """Return GREETING for the handshake, the last command for a NAK, else the command of the type byte."""
        if self._greets:
            self._greets = False
            return faults.GREETING
        return self._last_command if piece.type == NAK_TYPE else _line_name(piece)


class TcpLanguage:
    """Nserver over TCP. `wide` is True for a 64-bit client, None to detect it from CONNECT."""

    partial_timeout_s: float | None = None

    def __init__(self, wide: bool | None = None) -> None:
        self.requests, self.replies = TcpFrames(wide), TcpFrames(wide)
        self._outstanding: deque[str] = deque(maxlen=_MAX_OUTSTANDING)

    @property
    def nak(self) -> bytes:
        """Return an ERROR reply: over TCP there is no NAK."""
        return build_tcp_frame(ERROR_TYPE, NAK_ERROR.to_bytes(4, "big"), wide=bool(self.requests.wide), reply=True)

    def request_name(self, piece: StreamPiece) -> str:
        """Return the C name of a request, by its type word."""
        self.replies.wide = bool(self.requests.wide)
        row = None if piece.type is None else BY_TCP_TYPE.get(piece.type)
        return row.name if row else ""

    def request_delivered(self, command: str) -> None:
        """Append the command to those outstanding: replies come in the order of requests."""
        self._outstanding.append(command)

    def reply_name(self, piece: StreamPiece) -> str:
        """Return the oldest outstanding command; "" for bytes outside frames."""
        # Bytes that are no frame must not use up an outstanding request.
        whole = piece.type is not None and self._outstanding
        return self._outstanding.popleft() if whole else ""


Language = LineLanguage | TcpLanguage
"""Wire protocol of a connection: its framers, the command of each frame, and a refusal (`nak`)."""


def _line_name(piece: StreamPiece) -> str:
    row = None if piece.type is None else BY_LINE_TYPE.get(piece.type)
    return row.name if row else ""


class FaultyLine:
    """Both directions of a connection with faults.

    Parameters
    ----------
    language
        Protocol of the connection.
    injector
        Returns the injector in force; called for every frame, so that a new plan applies at once.
    """

    def __init__(self, language: Language, injector: Callable[[], Injector]) -> None:
        self.injector = injector
        self._language = language
        # Time after which an incomplete request is passed on; None for no limit.
        self.partial_timeout_s = language.partial_timeout_s

    @property
    def has_partial_request(self) -> bool:
        """Return True if an incomplete request is buffered."""
        return self._language.requests.pending_bytes > 0

    def request(self, data: bytes, now_s: float, whole: bool = False) -> list[Delivery]:
        """Return the deliveries for bytes to the robot; `whole`: they end with a frame, so that none is buffered."""
        deliveries = self._requests(self._language.requests.receive(data), now_s)
        return deliveries + (self.flush_request(now_s) if whole else [])

    def reply(self, data: bytes, now_s: float) -> list[Delivery]:
        """Return the deliveries for bytes to the host."""
        return self._replies(self._language.replies.receive(data), now_s)

    def flush_reply(self, now_s: float) -> list[Delivery]:
        """Return the deliveries for an incomplete reply after its timeout."""
        return self._replies(self._language.replies.flush(), now_s)

    def flush_request(self, now_s: float) -> list[Delivery]:
        """Return the deliveries for an incomplete request after its timeout."""
        return self._requests(self._language.requests.flush(), now_s)

    def _requests(self, pieces: Iterable[StreamPiece], now_s: float) -> list[Delivery]:
        language, found = self._language, []
        for piece in pieces:
            name = language.request_name(piece)
            deliveries = self.injector().process_frame(piece.data, name, faults.Direction.REQUEST, now_s, language.nak)
            # A refused or dropped request gets no reply from the robot, so none may be expected.
            if any(not delivery.to_sender for delivery in deliveries):
                language.request_delivered(name)
            found += deliveries
        return found

    def _replies(self, pieces: Iterable[StreamPiece], now_s: float) -> list[Delivery]:
        language, found = self._language, []
        for piece in pieces:
            name = language.reply_name(piece)
            found += self.injector().process_frame(piece.data, name, faults.Direction.REPLY, now_s, language.nak)
        return found


class DelayQueue:
    """Queue of delayed deliveries; none overtakes an earlier one."""

    def __init__(self) -> None:
        self.size = 0
        """Number of bytes in the queue."""
        self._queue: deque[tuple[float, Delivery]] = deque()

    @property
    def next_s(self) -> float | None:
        """Return the time at which the next delivery is due, on the clock of `add`; None if the queue is empty."""
        return self._queue[0][0] if self._queue else None

    def add(self, deliveries: Iterable[Delivery], now_s: float) -> None:
        """Add deliveries that are sent now."""
        for delivery in deliveries:
            due_s = now_s + delivery.delay_s
            # A line keeps the order of its bytes: a short delay after a long one ends with it.
            if self._queue:
                due_s = max(due_s, self._queue[-1][0])
            self._queue.append((due_s, delivery))
            self.size += len(delivery.data)

    def take(self, now_s: float) -> tuple[float, Delivery] | None:
        """Remove and return the next due delivery and its time; None if none is due."""
        if not self._queue or self._queue[0][0] > now_s:
            return None
        due_s, delivery = self._queue.popleft()
        self.size -= len(delivery.data)
        return due_s, delivery


log = logging.getLogger(__name__)

MAX_SLEEP_S = 0.05
"""Maximum duration of one sleep, so that a close from another thread is noticed soon."""
_HUNG_UP = "the connection was closed on purpose by the fault plan"


class FaultyStream:
    """A ByteStream with faults.

    Parameters
    ----------
    stream
        The stream to wrap.
    line
        Line with the injector.
    now
        Returns seconds on any clock.
    sleep
        Waits a number of seconds on that clock.
    """

    def __init__(self, stream: ByteStream, line: FaultyLine, now: Callable[[], float],
                 sleep: Callable[[float], None]) -> None:
        self._stream = stream
        self._line = line
        self._now = now
        self._sleep = sleep
        # Deliveries to the host that are not due yet, and the reason of the end once the stream is over.
        self._coming = DelayQueue()
        self._over: str | None = None
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send data as the plan changes and delays it. Raises ConnectionLost."""
        self._refuse_if_over()
        for delivery in self._line.request(data, self._now(), whole=True):
            # 1. A delayed request blocks the sender, as a slow line does.
            if delivery.delay_s > 0.0:
                self._sleep(delivery.delay_s)
            # 2. A refusal goes back as if the robot had sent it.
            if delivery.to_sender:
                self._coming.add([Delivery(0.0, delivery.data)], self._now())
            elif delivery.data:
                self._stream.send(delivery.data)
            if delivery.hang_up:
                self._hang_up()

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte that the plan lets pass. Raises ReplyTimeout, or ConnectionLost after a hang-up."""
        while True:
            # 1. Bytes that are due.
            if data := self._arrived():
                return data
            self._refuse_if_over()
            # 2. Nothing in transit: read from the stream; otherwise wait for what is.
            if self._coming.next_s is None:
                self._take_in(deadline)
            else:
                self._wait_until(self._coming.next_s, deadline.remaining())

    def close(self) -> None:
        """Close the stream and log the counts so far; a waiting `receive` raises ConnectionLost."""
        if not self._closed:
            self._closed = True
            injector = self._line.injector()
            if injector.counts:
                log.info("faults on %s so far: %s", injector.line, dict(total(injector.counts)))
        self._over = self._over or "this end has closed the connection"
        self._stream.close()

    def _arrived(self) -> bytes:
        """Return the due bytes, up to a hang-up."""
        data = b""
        while arrived := self._coming.take(self._now()):
            _, delivery = arrived
            data += delivery.data
            if delivery.hang_up:
                self._hang_up()
                break
        return data

    def _take_in(self, deadline: Deadline) -> None:
        """Receive from the stream; after the deadline an incomplete frame is delivered as it is."""
        try:
            deliveries = self._line.reply(self._stream.receive(deadline), self._now())
        except ReplyTimeout:
            # A dropped byte leaves a frame incomplete: the host gets what has arrived, as on a real line.
            deliveries = self._line.flush_reply(self._now())
            if not deliveries:
                raise
        self._coming.add(deliveries, self._now())

    def _wait_until(self, due_s: float, timeout_s: float) -> None:
        """Sleep until a time. Raises ReplyTimeout if the timeout ends first."""
        give_up_s = self._now() + timeout_s
        while not self._over and (left_s := min(due_s, give_up_s) - self._now()) > 0.0:
            self._sleep(min(left_s, MAX_SLEEP_S))
        if not self._over and give_up_s < due_s:
            raise ReplyTimeout("a delivery is delayed on purpose by the fault plan")

    def _hang_up(self) -> None:
        self._over = self._over or _HUNG_UP
        self._stream.close()

    def _refuse_if_over(self) -> None:
        if self._over:
            raise ConnectionLost(self._over)
