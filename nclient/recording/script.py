"""One connection of a recording as questions and answers: what a player goes by.

    Script   line, model | greeting (what the robot said unasked) | exchanges in their order
    Exchange what was asked, what came back and how long after, and the line of the file

Rules: over TCP an answer belongs to the request whose turn it is; on a robot's own line to the request before it, stray
bytes, half frames and silence included. Process ids do not count: they differ each time. No I/O.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from nclient.errors import AddressError, RecordingError, WireError
from nclient.protocol import language, serial_frame, tcp_frame
from nclient.protocol.commands import BY_NAME, REPLY_TYPES, Call
from nclient.protocol.models import N150, Model, model_named
from nclient.protocol.replies import LINE_STATE, STATE
from nclient.protocol.tcp_frame import request_bounds
from nclient.protocol.terms import line_terms
from nclient.recording.follower import LINES, TCP, Ears, Frame, ears_for
from nclient.recording.log import IN, OPEN, OUT, Entry, Recording

_STATE_TYPE = REPLY_TYPES[STATE].to_bytes(2, "big")
_TIMEOUT_TYPE = BY_NAME["conf_tm"].line_type or 0


class Asked(NamedTuple):
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

    asked: Asked
    time_s: float
    line: int
    answer: list[Piece] = field(default_factory=list)


@dataclass(slots=True)
class Script:
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


class Questions:
    """What a program asks, out of its bytes."""

    def __init__(self, line: str, model: Model) -> None:
        self.ears: Ears = ears_for(line, model)
        self._tcp = line == TCP
        self._terms = line_terms(model)

    def receive(self, data: bytes) -> list[Asked]:
        """What these bytes make whole; on a robot's own line stray bytes are passed over."""
        return [self._asked(frame) for frame in self.ears.to_robot(data) if self._tcp or not frame.wrong]

    def _asked(self, frame: Frame) -> Asked:
        if frame.wrong:
            return Asked("", wrong=frame.wrong)
        try:
            return asked(self._call(frame.data))
        except WireError:
            return Asked("", wrong=frame.data.hex())

    def _call(self, data: bytes) -> Call:
        if self._tcp:
            return language.tcp_call(tcp_frame.only_frame(data, request_bounds, self.ears.wide))
        return language.line_call(serial_frame.only_frame(data), self._terms)


def asked(call: Call) -> Asked:
    """A call, without the process id."""
    row, args = BY_NAME[call.name], list(call.args)
    if row.beside and row.beside[0] == "pid":
        del args[row.beside[1]]
    return Asked(call.name, tuple(args))


def script_of(recording: Recording, connection: str = "") -> Script:
    """The script of a connection by its name, of the first where none is given. Raises RecordingError for no such."""
    names = recording.connections()
    if not names:
        raise RecordingError(f"{recording.name}: nothing was recorded in it")
    if connection and connection not in names:
        raise RecordingError(f"{recording.name}: no connection {connection!r}; there are {', '.join(names)}")
    entries = [entry for entry in recording.entries if entry.connection == (connection or names[0])]
    line, model = _spoken(recording, entries)
    return _Writer(Script(recording.name, line, model)).write(entries)


def _spoken(recording: Recording, entries: list[Entry]) -> tuple[str, Model]:
    told = dict(recording.header) | dict(next((entry.more for entry in entries if entry.kind == OPEN), {}))
    line = told.get("wire", TCP)
    if line not in LINES:
        raise RecordingError(f"{recording.name}: a connection's wire is one of {', '.join(LINES)}, not {line!r}")
    try:
        return line, model_named(str(told.get("model", N150.name)))
    except AddressError as error:
        raise RecordingError(f"{recording.name}: {error}") from None


def state_before(script: Script, at: int) -> bytes:
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
            frames = [frame for frame in serial_frame.SerialFramer().receive(data) if frame.type == row.line_type]
            if frames:
                return serial_frame.build_frame(_TIMEOUT_TYPE, frames[-1].data)
    return b""


class _Writer:
    """Fills a script from the entries of one connection."""

    def __init__(self, script: Script) -> None:
        self._script = script
        self._questions = Questions(script.line, script.model)
        self._unanswered: deque[Exchange] = deque()

    def write(self, entries: list[Entry]) -> Script:
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
