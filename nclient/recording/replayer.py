"""Replaying a recorded connection: its requests and replies, and the player that answers a program with them.

    load_exchanges(recording) ──> RecordedConnection     initial data, then request and reply, request and reply, ...
    Player(connection).answers(bytes) ──> ReplyChunks    the recorded replies, or RecordingError

    strict   requests must come in the recorded order; keep-alive requests (gs, conf_tm) may be left out
    loose    each request gets the reply to the next equal recorded one
    both     disconnecting is always allowed; conf_tm, which clients send by themselves, gets the last recorded state;
             sim_control, by which `Robot.sleep` lets time of a simulation pass, is refused where it was not recorded

Over TCP a reply belongs to the next outstanding request; on the serial line to the request before it, including stray
bytes, incomplete frames and missing replies. Process ids differ in every run and are not compared.
No I/O and no clock: each chunk has its delay after the request, and the caller waits for it or does not.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from nclient.errors import AddressError, RecordingError, WireError
from nclient.protocol import codec, serial_framing
from nclient.protocol.codec import request_bounds
from nclient.protocol.commands import BY_NAME, REPLY_TYPES, Call
from nclient.protocol.replies import LINE_STATE, STATE, Reply
from nclient.protocol.types import N150, Model, get_model, serial_wire_state, tcp_wire_state
from nclient.recording.format import IN, OPEN, OUT, Entry, Recording
from nclient.recording.recorder import LINES, TCP, Frame, FrameTap, make_frame_tap

_STATE_TYPE = REPLY_TYPES[STATE].to_bytes(2, "big")
_TIMEOUT_TYPE = BY_NAME["conf_tm"].line_type or 0


class RequestKey(NamedTuple):
    """A request without its process id, for comparison; `error` is the reason if the bytes are no valid call."""

    name: str
    args: tuple[Any, ...] = ()
    error: str = ""

    def __str__(self) -> str:
        """Return the request as one would type it."""
        if self.error:
            return f"bytes that are no call ({self.error})"
        return f"`{' '.join((self.name, *map(str, self.args if self.name != 'ct' else ())))}`"


class ReplyChunk(NamedTuple):
    """Bytes from the robot, and their delay after the request in seconds."""

    after_s: float
    data: bytes


@dataclass(slots=True)
class RecordedExchange:
    """A request and its reply. `line` is the line of the file with the request."""

    request: RequestKey
    time_s: float
    line: int
    reply: list[ReplyChunk] = field(default_factory=list)


@dataclass(slots=True)
class RecordedConnection:
    """One connection of a recording. `name` is the name of the file, `line` the protocol.

    `initial` is the data that the robot sent before the first request, such as a handshake.
    """

    name: str
    line: str
    model: Model
    initial: list[ReplyChunk] = field(default_factory=list)
    exchanges: list[RecordedExchange] = field(default_factory=list)

    @property
    def robot_id(self) -> int:
        """Return the number of the first robot connected to, 1 if the recording has none."""
        connects = (each.request.args[0] for each in self.exchanges if each.request.name == "connect_robot")
        return int(next(connects, 1))


class RequestReader:
    """Incremental parser of a program's requests."""

    def __init__(self, line: str, model: Model) -> None:
        self.tap: FrameTap = make_frame_tap(line, model)
        self._tcp = line == TCP
        self._wire_state = serial_wire_state(model)

    def receive(self, data: bytes) -> list[RequestKey]:
        """Return the requests that these bytes complete; stray bytes on the serial line are skipped."""
        return [self._request_key(frame) for frame in self.tap.to_robot(data) if self._tcp or not frame.error]

    def _request_key(self, frame: Frame) -> RequestKey:
        if frame.error:
            return RequestKey("", error=frame.error)
        try:
            return request_key(self._decode(frame.data))
        except WireError:
            return RequestKey("", error=frame.data.hex())

    def _decode(self, data: bytes) -> Call:
        if self._tcp:
            return codec.decode_tcp_request(codec.parse_single_frame(data, request_bounds, self.tap.wide))
        return codec.decode_serial_request(serial_framing.parse_single_frame(data), self._wire_state)


def request_key(call: Call) -> RequestKey:
    """Return the key of a call: everything except the process id."""
    row, args = BY_NAME[call.name], list(call.args)
    if row.extra_arguments and row.extra_arguments[0] == "pid":
        del args[row.extra_arguments[1]]
    return RequestKey(call.name, tuple(args))


# -- loading ----------------------------------------------------------------------------------------------------------


def load_exchanges(recording: Recording, connection: str = "") -> RecordedConnection:
    """Return one connection of a recording.

    Parameters
    ----------
    recording
        A recording that was read.
    connection
        Name of the connection; "" for the first one.

    Raises
    ------
    RecordingError
        If there is no such connection, or its protocol or model is unknown.
    """
    names = recording.connections()
    if not names:
        raise RecordingError(f"{recording.name}: nothing was recorded in it")
    if connection and connection not in names:
        raise RecordingError(f"{recording.name}: no connection {connection!r}; there are {', '.join(names)}")
    entries = [entry for entry in recording.entries if entry.connection == (connection or names[0])]
    line, model = _line_and_model(recording, entries)
    return _ExchangeBuilder(RecordedConnection(recording.name, line, model)).build(entries)


def _line_and_model(recording: Recording, entries: list[Entry]) -> tuple[str, Model]:
    # An entry `open` takes precedence over the header of the file.
    values = dict(recording.header) | dict(next((entry.more for entry in entries if entry.kind == OPEN), {}))
    line = values.get("wire", TCP)
    if line not in LINES:
        raise RecordingError(f"{recording.name}: a connection's wire is one of {', '.join(LINES)}, not {line!r}")
    try:
        return line, get_model(str(values.get("model", N150.name)))
    except AddressError as error:
        raise RecordingError(f"{recording.name}: {error}") from None


class _ExchangeBuilder:
    """Assigns the entries of one connection to exchanges."""

    def __init__(self, connection: RecordedConnection) -> None:
        self._connection = connection
        self._reader = RequestReader(connection.line, connection.model)
        self._outstanding: deque[RecordedExchange] = deque()

    def build(self, entries: list[Entry]) -> RecordedConnection:
        for entry in entries:
            if entry.kind == OUT:
                self._add_requests(entry)
            elif entry.kind == IN and entry.data:
                self._add_replies(entry)
        return self._connection

    def _add_requests(self, entry: Entry) -> None:
        for request in self._reader.receive(entry.data):
            exchange = RecordedExchange(request, entry.time_s, entry.line)
            self._connection.exchanges.append(exchange)
            if not request.name or BY_NAME[request.name].has_tcp_reply:
                self._outstanding.append(exchange)

    def _add_replies(self, entry: Entry) -> None:
        # Serial line: everything belongs to the last request, whether it is a frame or not.
        if self._connection.line != TCP:
            exchanges = self._connection.exchanges
            self._add(exchanges[-1] if exchanges else None, entry.time_s, entry.data)
            return
        # TCP: replies come in the order of the requests.
        for frame in self._reader.tap.to_host(entry.data):
            self._add(self._outstanding.popleft() if self._outstanding else None, entry.time_s, frame.data)

    def _add(self, exchange: RecordedExchange | None, time_s: float, data: bytes) -> None:
        if exchange is None:
            self._connection.initial.append(ReplyChunk(0.0, data))
        else:
            exchange.reply.append(ReplyChunk(max(0.0, time_s - exchange.time_s), data))


def find_state_reply(connection: RecordedConnection, index: int) -> bytes:
    """Return the last state reply before exchange `index`, else the first one after it, as a reply to conf_tm.

    Empty if the recording has no state reply.
    """
    # The nearest state before the place, then the nearest after it.
    for exchange in (*reversed(connection.exchanges[:index]), *connection.exchanges[index:]):
        row = BY_NAME.get(exchange.request.name)
        data = b"".join(chunk.data for chunk in exchange.reply)
        if row is None or not data:
            continue
        if connection.line == TCP:
            # Over TCP every state reply has the same bytes, whatever its request.
            if row.tcp_reply is STATE and data[:2] == _STATE_TYPE:
                return data
        elif row.line_reply is LINE_STATE:
            # On the serial line the type is that of the request: it is rebuilt with that of conf_tm.
            frames = [frame for frame in serial_framing.SerialFramer().receive(data) if frame.type == row.line_type]
            if frames:
                return serial_framing.build_frame(_TIMEOUT_TYPE, frames[-1].data)
    return b""


# -- playing ----------------------------------------------------------------------------------------------------------

STRICT, LOOSE = "strict", "loose"
ORDERS: Final = (STRICT, LOOSE)
_KEEP_ALIVE: Final = frozenset({"gs", "conf_tm"})
"""Requests that clients send by themselves at times of their own choice: a program need not repeat them."""
_NOT_AVAILABLE: Final = Reply("error", values=(4,))


class Player:
    """The robot's side of one recorded connection, played once.

    Parameters
    ----------
    connection
        The recorded connection.
    order
        One of ORDERS.
    """

    def __init__(self, connection: RecordedConnection, order: str = STRICT) -> None:
        self._connection = connection
        # What the robot sends before the first request.
        self.initial = connection.initial
        self._loose = order == LOOSE
        self._reader = RequestReader(connection.line, connection.model)
        self._next = 0

    @property
    def remaining(self) -> int:
        """Return the number of recorded exchanges that have not been passed yet."""
        return len(self._connection.exchanges) - self._next

    def answers(self, data: bytes) -> list[ReplyChunk]:
        """Return the recorded replies to the requests in these bytes.

        Raises
        ------
        RecordingError
            If a request was not recorded at this place.
        """
        return [chunk for request in self._reader.receive(data) for chunk in self._answer(request)]

    def _answer(self, request: RequestKey) -> list[ReplyChunk]:
        # 1. The recorded exchange from here on.
        index = self._find(request)
        if index is None:
            # 2. Not recorded, but harmless: a disconnect, a sleep, or the motion timeout that connecting sets.
            if request.name == "disconnect_robot":
                return []
            if request.name == "sim_control":
                state = tcp_wire_state(self._connection.model)
                state.wide = bool(self._reader.tap.wide)
                return [ReplyChunk(0.0, codec.encode_tcp_reply(BY_NAME[request.name], _NOT_AVAILABLE, state))]
            data = find_state_reply(self._connection, self._next) if request.name == "conf_tm" else b""
            if data:
                return [ReplyChunk(0.0, data)]
            raise self._mismatch_error(request)
        # 3. Continue behind it.
        self._next = index + 1
        return self._connection.exchanges[index].reply

    def _find(self, request: RequestKey) -> int | None:
        for index, exchange in enumerate(self._connection.exchanges[self._next :], start=self._next):
            if exchange.request == request:
                return index
            # In strict order only keep-alive requests may be skipped.
            if not self._loose and exchange.request.name not in _KEEP_ALIVE:
                return None
        return None

    def _mismatch_error(self, request: RequestKey) -> RecordingError:
        # Three cases with different remedies: past the end, loose order, strict order.
        name, expected = self._connection.name, self._expected()
        if expected is None:
            return RecordingError(f"{name}: the recording ends here, and the program sends {request}; record a longer "
                                  "run")
        if self._loose:
            return RecordingError(
                f"{name}: {request} does not come again from line {expected.line} on; record a run that sends it"
            )
        return RecordingError(f"{name}, line {expected.line}: recorded was {expected.request}, the program sends "
                              f"{request}; order={LOOSE} replies as to the next equal request, or record the run again")

    def _expected(self) -> RecordedExchange | None:
        """Return the next exchange that must come, or the first optional one if no others are left."""
        rest = self._connection.exchanges[self._next :]
        return next((each for each in rest if each.request.name not in _KEEP_ALIVE), rest[0] if rest else None)


class ReplayPeer:
    """A player as the other end of a MemoryStream: it answers in this process, without delays."""

    def __init__(self, player: Player) -> None:
        self._player = player
        self._out = bytearray(b"".join(chunk.data for chunk in player.initial))

    def send(self, data: bytes) -> None:
        """Process requests. Raises RecordingError as the player does."""
        for chunk in self._player.answers(data):
            self._out += chunk.data

    def receive(self) -> bytes:
        """Return and remove the replies so far."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def close(self) -> None:
        """Do nothing: a recording has no connection to close."""
