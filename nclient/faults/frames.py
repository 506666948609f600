"""Applying a fault plan to the frames of one line: framing, changes of bytes, injector, protocols.

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

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from random import Random
from typing import NamedTuple

from nclient.faults.plan import (
    BIT,
    GREETING,
    Alteration,
    Blackout,
    Corrupt,
    Delay,
    Direction,
    Drop,
    DropByte,
    Fault,
    HangUp,
    InsertBytes,
    Nak,
    Noise,
    Plan,
    Rule,
)
from nclient.protocol.client_state import HANDSHAKE_SIZE
from nclient.protocol.codec import build_frame as build_tcp_frame
from nclient.protocol.commands import BY_LINE_TYPE, BY_NAME, BY_TCP_TYPE, ERROR_TYPE, MAX_REPLY_WORDS, NAK_TYPE
from nclient.protocol.serial_framing import HOST_LIMIT, ROBOT_LIMIT, SerialFrame, SerialFramer, build_frame

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


def alter_bytes(data: bytes, fault: Alteration, rng: Random) -> bytes:
    """Return the bytes after a fault; `data` has at least one byte, the result may be empty."""
    match fault:
        case Corrupt():
            place = _index(fault.place, len(data), rng)
            return data[:place] + bytes((_different_byte(data[place], fault.change, rng),)) + data[place + 1 :]
        case DropByte():
            place = _index(fault.place, len(data), rng)
            return data[:place] + data[place + 1 :]
        case InsertBytes():
            place = _index(fault.place, len(data) + 1, rng)
            return data[:place] + rng.randbytes(fault.count) + data[place:]
    # A cut delivers at least one byte if it can, and never the whole frame.
    maximum = len(data) - 1
    return data[: rng.randint(min(1, maximum), maximum) if fault.keep is None else min(fault.keep, maximum)]


def add_noise(data: bytes, noise: Noise, rng: Random, tally: Counter[str]) -> bytes:
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
    return byte ^ (1 << rng.randrange(8) if change == BIT else rng.randrange(1, 256))


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

    def __init__(self, plan: Plan, line: str, start_s: float = 0.0) -> None:
        self.plan = plan
        self.line = line
        self._start_s = start_s
        self._silences: dict[Direction, tuple[float, RuleState]] = {}
        self._states = [
            RuleState(rule, Random(f"{plan.seed} {line} {rule.name}")) for rule in plan.rules if rule.acts_on(line)
        ]

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

    def process_frame(
        self, data: bytes, command: str, direction: Direction, now_s: float, nak: bytes = LINE_NAK
    ) -> list[Delivery]:
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
                case HangUp() as fault:
                    return [Delivery(delay_s, data[: fault.keep], hang_up=True)]
                case Nak() if direction is Direction.REQUEST:
                    return [Delivery(delay_s, nak, to_sender=True)]
                case Delay() as fault:
                    delay_s += max(0.0, fault.delay_s + fault.jitter_s * state.rng.uniform(-1.0, 1.0))
                case fault:
                    data = self._apply(data, fault, state, now_s, nak)
            if not data:
                return []
        return [Delivery(delay_s, data)]

    def _apply(
        self, data: bytes, fault: Alteration | Drop | Blackout | Nak | Noise, state: RuleState, now_s: float,
        nak: bytes,
    ) -> bytes:
        """Return the bytes after a fault, empty if it drops the frame."""
        match fault:
            case Drop():
                return b""
            case Blackout():
                silence = (now_s + fault.silence_s, state)
                self._silences.update(dict.fromkeys(state.rule.directions, silence))
                return b""
            case Nak():
                return nak
            case Noise():
                return add_noise(data, fault, state.rng, state.tally)
            case _:
                return alter_bytes(data, fault, state.rng)


class RuleState:
    """Counters and random stream of a rule on one line."""

    def __init__(self, rule: Rule, rng: Random) -> None:
        self.rule = rule
        self.rng = rng
        self.tally: Counter[str] = Counter()
        self._number = 0

    def next_fault(self, command: str, direction: Direction, elapsed_s: float) -> Fault | None:
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
        if not isinstance(fault, Noise):
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
            return GREETING
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
