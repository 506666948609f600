"""One connection of a recording as questions and answers: what a player goes by.

    Script   line, model | greeting (what the robot said unasked) | exchanges in their order
    Exchange what was asked, what came back and how long after, and the line of the file

Rules: over TCP an answer belongs to the request whose turn it is; on a robot's own line to the request before it, stray
bytes, half frames and silence included. Process ids do not count: they differ each time. No I/O.

Answers as a recorded robot did: bytes in, the recorded bytes out, or a clear word where something else is asked.

    strict   questions come in the recorded order; what keeps a robot fed (gs, conf_tm) may be left out
    loose    each question is answered as the next one like it was
    both     leaving is always allowed; conf_tm, which clients set by themselves, is answered with the last state

Rules: no I/O and no clock: each answer tells how long after its question it came, and whoever plays waits or does not.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from nclient.errors import AddressError, RecordingError, WireError
from nclient.protocol import (
    codec,
    serial_framing,
    tcp_framing,
)
from nclient.protocol.commands import BY_NAME, REPLY_TYPES, Call
from nclient.protocol.replies import LINE_STATE, STATE
from nclient.protocol.tcp_framing import request_bounds
from nclient.protocol.types import N150, Model, get_model
from nclient.protocol.wire_state import serial_wire_state
from nclient.recording.format import IN, OPEN, OUT, Entry, Recording
from nclient.recording.recorder import LINES, TCP, Frame, FrameTap, frame_tap_for

_STATE_TYPE = REPLY_TYPES[STATE].to_bytes(2, "big")
_TIMEOUT_TYPE = BY_NAME["conf_tm"].line_type or 0


class RequestKey(NamedTuple):
    """What is asked, apart from the process id; `wrong`: the bytes or what is wrong with them where it is no call."""

    name: str
    args: tuple[Any, ...] = ()
    wrong: str = ""

    def __str__(self) -> str:
        """As one would write the call."""
        if self.wrong:
            return f"bytes that are no call ({self.wrong})"
        return f"`{' '.join((self.name, *map(str, self.args if self.name != 'ct' else ())))}`"


class Piece(NamedTuple):
    """Bytes from the robot, so many seconds after what they answer."""

    after_s: float
    data: bytes


@dataclass(slots=True)
class Exchange:
    """A question and its answer. `line`: where the question stands."""

    asked: RequestKey
    time_s: float
    line: int
    answer: list[Piece] = field(default_factory=list)


@dataclass(slots=True)
class RecordedConnection:
    """See the head of this file. `name`: the file's."""

    name: str
    line: str
    model: Model
    greeting: list[Piece] = field(default_factory=list)
    exchanges: list[Exchange] = field(default_factory=list)

    @property
    def robot_id(self) -> int:
        """The robot that was connected to first; 1 where the recording tells none."""
        connects = (each.asked.args[0] for each in self.exchanges if each.asked.name == "connect_robot")
        return int(next(connects, 1))


class RequestReader:
    """What a program asks, out of its bytes."""

    def __init__(self, line: str, model: Model) -> None:
        self.ears: FrameTap = frame_tap_for(line, model)
        self._tcp = line == TCP
        self._wire_state = serial_wire_state(model)

    def receive(self, data: bytes) -> list[RequestKey]:
        """What these bytes make whole; on a robot's own line stray bytes are passed over."""
        return [self._asked(frame) for frame in self.ears.to_robot(data) if self._tcp or not frame.wrong]

    def _asked(self, frame: Frame) -> RequestKey:
        if frame.wrong:
            return RequestKey("", wrong=frame.wrong)
        try:
            return asked(self._call(frame.data))
        except WireError:
            return RequestKey("", wrong=frame.data.hex())

    def _call(self, data: bytes) -> Call:
        if self._tcp:
            return codec.decode_tcp_request(tcp_framing.parse_single_frame(data, request_bounds, self.ears.wide))
        return codec.decode_serial_request(serial_framing.parse_single_frame(data), self._wire_state)


def asked(call: Call) -> RequestKey:
    """A call, without the process id."""
    row, args = BY_NAME[call.name], list(call.args)
    if row.extra_arguments and row.extra_arguments[0] == "pid":
        del args[row.extra_arguments[1]]
    return RequestKey(call.name, tuple(args))


def load_exchanges(recording: Recording, connection: str = "") -> RecordedConnection:
    """The script of a connection by its name, of the first where none is given. Raises RecordingError for no such."""
    names = recording.connections()
    if not names:
        raise RecordingError(f"{recording.name}: nothing was recorded in it")
    if connection and connection not in names:
        raise RecordingError(f"{recording.name}: no connection {connection!r}; there are {', '.join(names)}")
    entries = [entry for entry in recording.entries if entry.connection == (connection or names[0])]
    line, model = _spoken(recording, entries)
    return _Writer(RecordedConnection(recording.name, line, model)).write(entries)


def _spoken(recording: Recording, entries: list[Entry]) -> tuple[str, Model]:
    told = dict(recording.header) | dict(next((entry.more for entry in entries if entry.kind == OPEN), {}))
    line = told.get("wire", TCP)
    if line not in LINES:
        raise RecordingError(f"{recording.name}: a connection's wire is one of {', '.join(LINES)}, not {line!r}")
    try:
        return line, get_model(str(told.get("model", N150.name)))
    except AddressError as error:
        raise RecordingError(f"{recording.name}: {error}") from None


def find_state_reply(script: RecordedConnection, at: int) -> bytes:
    """The state that was told last before an exchange, else first after it, as conf_tm is answered; empty for none."""
    for exchange in (*reversed(script.exchanges[:at]), *script.exchanges[at:]):
        row = BY_NAME.get(exchange.asked.name)
        data = b"".join(piece.data for piece in exchange.answer)
        if row is None or not data:
            continue
        if script.line == TCP:
            if row.tcp_reply is STATE and data[:2] == _STATE_TYPE:
                return data
        elif row.line_reply is LINE_STATE:
            frames = [frame for frame in serial_framing.SerialFramer().receive(data) if frame.type == row.line_type]
            if frames:
                return serial_framing.build_frame(_TIMEOUT_TYPE, frames[-1].data)
    return b""


class _Writer:
    """Fills a script from the entries of one connection."""

    def __init__(self, script: RecordedConnection) -> None:
        self._script = script
        self._questions = RequestReader(script.line, script.model)
        self._unanswered: deque[Exchange] = deque()

    def write(self, entries: list[Entry]) -> RecordedConnection:
        for entry in entries:
            if entry.kind == OUT:
                self._ask(entry)
            elif entry.kind == IN and entry.data:
                self._answer(entry)
        return self._script

    def _ask(self, entry: Entry) -> None:
        for question in self._questions.receive(entry.data):
            exchange = Exchange(question, entry.time_s, entry.line)
            self._script.exchanges.append(exchange)
            if not question.name or BY_NAME[question.name].has_tcp_reply:
                self._unanswered.append(exchange)

    def _answer(self, entry: Entry) -> None:
        if self._script.line != TCP:
            exchanges = self._script.exchanges
            self._add(exchanges[-1] if exchanges else None, entry.time_s, entry.data)
            return
        for frame in self._questions.ears.to_host(entry.data):
            self._add(self._unanswered.popleft() if self._unanswered else None, entry.time_s, frame.data)

    def _add(self, exchange: Exchange | None, time_s: float, data: bytes) -> None:
        if exchange is None:
            self._script.greeting.append(Piece(0.0, data))
        else:
            exchange.answer.append(Piece(max(0.0, time_s - exchange.time_s), data))


STRICT, LOOSE = "strict", "loose"
ORDERS: Final = (STRICT, LOOSE)
_FEEDING: Final = frozenset({"gs", "conf_tm"})
"""What clients say by themselves at moments of their own choice: a program need not repeat it."""
_LEAVING: Final = "disconnect_robot"
_TIMEOUT: Final = "conf_tm"


class Player:
    """One connection, played once. `order`: one of ORDERS."""

    def __init__(self, script: RecordedConnection, order: str = STRICT) -> None:
        self._script = script
        self._loose = order == LOOSE
        self._questions = RequestReader(script.line, script.model)
        self._next = 0

    @property
    def greeting(self) -> list[Piece]:
        """What the robot says unasked, as one comes."""
        return self._script.greeting

    @property
    def left(self) -> int:
        """Recorded questions that have not been passed yet."""
        return len(self._script.exchanges) - self._next

    def answers(self, data: bytes) -> list[Piece]:
        """What was answered to what these bytes ask. Raises RecordingError where it was not asked (there and then)."""
        return [piece for question in self._questions.receive(data) for piece in self._answer(question)]

    def _answer(self, question: RequestKey) -> list[Piece]:
        at = self._found(question)
        if at is None:
            if question.name == _LEAVING:
                return []
            state = find_state_reply(self._script, self._next) if question.name == _TIMEOUT else b""
            if state:
                return [Piece(0.0, state)]
            raise self._missing(question)
        self._next = at + 1
        return self._script.exchanges[at].answer

    def _found(self, question: RequestKey) -> int | None:
        for at, exchange in enumerate(self._script.exchanges[self._next :], start=self._next):
            if exchange.asked == question:
                return at
            if not self._loose and exchange.asked.name not in _FEEDING:
                return None
        return None

    def _missing(self, question: RequestKey) -> RecordingError:
        name, expected = self._script.name, self._expected()
        if expected is None:
            return RecordingError(f"{name}: it ends here, and the program asks {question}; record a longer run")
        if self._loose:
            return RecordingError(
                f"{name}: {question} was not asked again from line {expected.line} on; record a run that asks it"
            )
        return RecordingError(
            f"{name}, line {expected.line}: recorded was {expected.asked}, the program asks {question}; "
            f"order={LOOSE} answers as the next one like it was, or record the run anew"
        )

    def _expected(self) -> Exchange | None:
        """The next one that must come; where only what may be left out is left, the first of that."""
        left = self._script.exchanges[self._next :]
        return next((each for each in left if each.asked.name not in _FEEDING), left[0] if left else None)


class ReplayPeer:
    """A player as what answers in this process, at once: MemoryStream's other end."""

    def __init__(self, player: Player) -> None:
        self._player = player
        self._out = bytearray(b"".join(piece.data for piece in player.greeting))

    def send(self, data: bytes) -> None:
        """Take in bytes, and answer them. Raises RecordingError, see Player."""
        for piece in self._player.answers(data):
            self._out += piece.data

    def receive(self) -> bytes:
        """What has been answered."""
        answered = bytes(self._out)
        self._out.clear()
        return answered

    def close(self) -> None:
        """The client is gone."""
