"""Cuts what passes on a connection into its frames, losing no byte: what makes no frame passes as it is.

    LineFrames   a robot's own line     01 | length low, high | type | ... | checksum | 5c
    TcpFrames    Nserver's protocol     int16 type | uint16 count | count words; a 64-bit client's have eight bytes

Rules: no I/O, and nothing is judged but where a frame ends; the ends of the connection read the frames themselves.

What becomes of the bytes of one frame: functions of bytes, a fault and chance.

Rules: each changes something: a byte that is corrupted is another than it was; what is cut off is a byte or more.

What a plan does to the frames of one line: frames in, deliveries out. Pure and seeded: no clock, no stream.

    pass_on(frame, command, direction, now) ──> [Delivery, ...]       an empty list: it does not arrive

Rules: exact counts: a strike is counted when it happened and changed something. Chance is a stream of its own for each
rule on each line, so that adding a rule leaves what the others do. Whoever delivers keeps the order of bytes.

What a connection speaks, as far as faults need it: where its frames end, and which command each belongs to.

Rules: no I/O. On a robot's own line a reply names its command; over TCP replies are those of the requests that went
through, in their order. A NAK over TCP is an ERROR reply, and as no robot said it, its code is 5: refused.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping
from random import Random
from typing import NamedTuple, Protocol

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
from nclient.protocol.commands import BY_LINE_TYPE, BY_NAME, BY_TCP_TYPE, ERROR_TYPE, MAX_REPLY_WORDS, NAK_TYPE
from nclient.protocol.serial_framing import END, HOST_LIMIT, ROBOT_LIMIT, START, build_frame
from nclient.protocol.tcp_framing import build_frame as build_tcp_frame

_LINE_OVERHEAD, _LINE_SMALLEST = 4, 2
_TCP_HEADER, _TYPE_SIZE, _WORD = 4, 2, 4
_CONNECT_TYPES = frozenset(BY_NAME[name].tcp_type for name in ("create_robot", "connect_robot", "disconnect_robot"))
_MOST_WORDS = max(MAX_REPLY_WORDS.values())


class Piece(NamedTuple):
    """Bytes that passed: a whole frame and its type, or None for bytes that are no frame."""

    data: bytes
    type: int | None


class Frames(Protocol):
    """A stream in one direction, cut into pieces."""

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that is not whole yet."""
        ...

    def receive(self, data: bytes) -> list[Piece]:
        """The pieces that these bytes complete, in order."""
        ...

    def rest(self) -> list[Piece]:
        """What was kept of a frame that is not whole, as it is."""
        ...


class LineFrames:
    """One direction of a robot's own line. `limit`: its longest frame, bytes; `bare`: bytes before the first one."""

    def __init__(self, limit: int = ROBOT_LIMIT, bare: int = 0) -> None:
        self._limit = limit
        self._bare = bare
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def receive(self, data: bytes) -> list[Piece]:
        """As Frames says. The bare bytes at the start are one piece."""
        self._buffer += data
        if len(self._buffer) < self._bare:
            return []
        bare = [Piece(self._take(self._bare), None)] if self._bare else []
        self._bare = 0
        return bare + list(self._pieces())

    def rest(self) -> list[Piece]:
        """As Frames says; frames behind a start that led nowhere are found."""
        found: list[Piece] = []
        while self._buffer:
            found.append(Piece(self._take(1), None))
            found += self._pieces()
        return _joined(found)

    def _pieces(self) -> Iterator[Piece]:
        stray = bytearray()
        while self._buffer:
            size = self._size()
            if size is None or len(self._buffer) < size:
                break
            if size == 0:
                stray += self._take(1)
                continue
            if stray:
                yield Piece(bytes(stray), None)
                stray.clear()
            frame = self._take(size)
            yield Piece(frame, frame[3])
        if stray:
            yield Piece(bytes(stray), None)

    def _size(self) -> int | None:
        """Bytes of the frame in front, 0 where none begins, None where that cannot be told yet."""
        buffer = self._buffer
        if buffer[0] != START:
            return 0
        if len(buffer) < 3:
            return None
        length = buffer[1] | buffer[2] << 8
        size = length + _LINE_OVERHEAD
        if not _LINE_SMALLEST <= length <= self._limit - _LINE_OVERHEAD:
            return 0
        if len(buffer) >= size and (buffer[size - 1] != END or sum(buffer[: size - 2]) & 255 != buffer[size - 2]):
            return 0
        return size

    def _take(self, count: int) -> bytes:
        taken = bytes(self._buffer[:count])
        del self._buffer[:count]
        return taken


class TcpFrames:
    """One direction of a connection to an Nserver. `wide`: None until a CONNECT tells a 64-bit client.

    A count beyond every message's means that the stream is lost: from then on all passes as it comes.
    """

    def __init__(self, wide: bool | None = False) -> None:
        self.wide = wide
        self._lost = False
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def receive(self, data: bytes) -> list[Piece]:
        """As Frames says."""
        self._buffer += data
        found: list[Piece] = []
        while not self._lost and len(self._buffer) >= _TCP_HEADER:
            frame_type = int.from_bytes(self._buffer[:_TYPE_SIZE], "big", signed=True)
            count = int.from_bytes(self._buffer[_TYPE_SIZE:_TCP_HEADER], "big")
            self._lost = count > _MOST_WORDS
            if self._lost or not self._width_known(frame_type):
                break
            size = _TCP_HEADER + count * _WORD * (2 if self.wide else 1)
            if len(self._buffer) < size:
                break
            found.append(Piece(bytes(self._buffer[:size]), frame_type))
            del self._buffer[:size]
        return found + self.rest() if self._lost else found

    def rest(self) -> list[Piece]:
        """As Frames says. What follows is taken for the start of a frame."""
        rest = bytes(self._buffer)
        self._buffer.clear()
        return [Piece(rest, None)] if rest else []

    def _width_known(self, frame_type: int) -> bool:
        """Robot numbers are 1 or more: a first word of 0 comes from a 64-bit client."""
        if self.wide is None and frame_type in _CONNECT_TYPES:
            first = self._buffer[_TCP_HEADER : _TCP_HEADER + _WORD]
            if len(first) < _WORD:
                return False
            self.wide = not any(first)
        return True


def _joined(pieces: list[Piece]) -> list[Piece]:
    """Bytes that are no frame and stand side by side as one piece."""
    joined: list[Piece] = []
    for piece in pieces:
        if joined and piece.type is None and joined[-1].type is None:
            joined[-1] = Piece(joined[-1].data + piece.data, None)
        else:
            joined.append(piece)
    return joined


CORRUPTED, DROPPED, ADDED = "corrupted_bytes", "dropped_bytes", "added_bytes"


def altered(data: bytes, fault: Alteration, chance: Random) -> bytes:
    """The bytes after the fault; `data` has at least one, the result may have none."""
    match fault:
        case Corrupt():
            place = _place(fault.place, len(data), chance)
            return data[:place] + bytes((_other(data[place], fault.change, chance),)) + data[place + 1 :]
        case DropByte():
            place = _place(fault.place, len(data), chance)
            return data[:place] + data[place + 1 :]
        case InsertBytes():
            place = _place(fault.place, len(data) + 1, chance)
            return data[:place] + chance.randbytes(fault.count) + data[place:]
    most = len(data) - 1
    return data[: chance.randint(min(1, most), most) if fault.keep is None else min(fault.keep, most)]


def with_noise(data: bytes, noise: Noise, chance: Random, tally: Counter[str]) -> bytes:
    """The bytes after noise on each of them; what happened is added to the tally, bytes by kind and frames touched."""
    dropped = noise.drop_percent / 100.0
    corrupted = dropped + noise.corrupt_percent / 100.0
    added = corrupted + noise.add_percent / 100.0
    arrived, happened = bytearray(), Counter[str]()
    for byte in data:
        draw = chance.random()
        if draw >= added:
            arrived.append(byte)
        elif draw < dropped:
            happened[DROPPED] += 1
        elif draw < corrupted:
            happened[CORRUPTED] += 1
            arrived.append(_other(byte, noise.change, chance))
        else:
            happened[ADDED] += 1
            arrived += bytes((byte, chance.randrange(256)))
    if happened:
        tally.update(happened)
        tally[noise.kind] += 1
    return bytes(arrived)


def _place(wanted: int | None, count: int, chance: Random) -> int:
    """An index from 0 below `count`: the wanted one, or the nearest there is, or by chance."""
    if wanted is None:
        return chance.randrange(count)
    return min(max(wanted + count if wanted < 0 else wanted, 0), count - 1)


def _other(byte: int, change: str, chance: Random) -> int:
    return byte ^ (1 << chance.randrange(8) if change == BIT else chance.randrange(1, 256))


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
        self._silences: dict[Direction, tuple[float, RuleState]] = {}
        self._strikers = [
            RuleState(rule, Random(f"{plan.seed} {line} {rule.name}")) for rule in plan.rules if rule.acts_on(line)
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
        self, data: bytes, fault: Alteration | Drop | Blackout | Nak | Noise, striker: RuleState, now_s: float,
        nak: bytes,
    ) -> bytes:
        """What goes on of a frame, nothing where the fault swallows it."""
        match fault:
            case Drop():
                return b""
            case Blackout():
                silence = (now_s + fault.silence_s, striker)
                self._silences.update(dict.fromkeys(striker.rule.directions, silence))
                return b""
            case Nak():
                return nak
            case Noise():
                return with_noise(data, fault, striker.chance, striker.tally)
            case _:
                return altered(data, fault, striker.chance)


class RuleState:
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
        if not rule.when.matches(self._number, self.chance.random()):
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


NAK_ERROR = 5
"""The code of the ERROR reply that stands for a NAK."""
_MOST_OUTSTANDING = 1 << 16


class Language(Protocol):
    """What a connection speaks: where its frames end, and which command each belongs to."""

    requests: Frames
    replies: Frames
    patience_s: float | None
    """How long a part of a request may be kept: on a line a frame may never become whole."""

    @property
    def nak(self) -> bytes:
        """A refusal."""
        ...

    def request_name(self, piece: Piece) -> str:
        """The command that a request is; "" for what is none."""
        ...

    def went_through(self, command: str) -> None:
        """The robot has a request of this command before it."""
        ...

    def reply_name(self, piece: Piece) -> str:
        """The command that a reply answers; "" where that is not known."""
        ...


class LineLanguage:
    """A robot's own line. `greets`: it begins with a hello, as an N200 does over TCP."""

    nak = LINE_NAK
    patience_s: float | None = 0.25

    def __init__(self, has_handshake: bool = False) -> None:
        self.requests: Frames = LineFrames(HOST_LIMIT)
        self.replies: Frames = LineFrames(bare=HANDSHAKE_SIZE if has_handshake else 0)
        self._greets = has_handshake
        self._asked = ""

    def request_name(self, piece: Piece) -> str:
        return _line_name(piece)

    def went_through(self, command: str) -> None:
        self._asked = command

    def reply_name(self, piece: Piece) -> str:
        if self._greets:
            self._greets = False
            return GREETING
        return self._asked if piece.type == NAK_TYPE else _line_name(piece)


class TcpLanguage:
    """Nserver's protocol. `wide`: whether the client is a 64-bit one, None until its CONNECT tells."""

    patience_s: float | None = None

    def __init__(self, wide: bool | None = None) -> None:
        self.requests: Frames
        self.replies: Frames
        self.requests, self.replies = self._asking, self._answering = TcpFrames(wide), TcpFrames(wide)
        self._outstanding: deque[str] = deque(maxlen=_MOST_OUTSTANDING)

    @property
    def nak(self) -> bytes:
        return build_tcp_frame(ERROR_TYPE, NAK_ERROR.to_bytes(4, "big"), wide=bool(self._asking.wide), reply=True)

    def request_name(self, piece: Piece) -> str:
        self._answering.wide = bool(self._asking.wide)
        row = None if piece.type is None else BY_TCP_TYPE.get(piece.type)
        return row.name if row else ""

    def went_through(self, command: str) -> None:
        self._outstanding.append(command)

    def reply_name(self, piece: Piece) -> str:
        whole = piece.type is not None and self._outstanding
        return self._outstanding.popleft() if whole else ""


def _line_name(piece: Piece) -> str:
    row = None if piece.type is None else BY_LINE_TYPE.get(piece.type)
    return row.name if row else ""
